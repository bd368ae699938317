//! One kernel for a number of steps and nothing else: for counting instructions (`make instructions`).
//!
//! `work KERNEL STEPS` prints how many items that were; `work list` prints the kernels, `work level` the
//! instruction set. What is set up does not depend on the number of steps, so that it drops out of the difference
//! of two runs.
#![allow(clippy::unwrap_used, clippy::panic)]

use celestcore_core::attitude::{
    self, Attitude, AttitudeSensor, AttitudeSensors, Buffers, Flight, GyroModel, GyroSeries, GyroTiming, LANES,
    Sampling, StarSeries,
};
use celestcore_core::celestial::{self, CelestialSensors, Form, Horizon, Outliers, Results, Source, Use};
use celestcore_core::cloud::Settings;
use celestcore_core::filter::{Ekf, SrUkf, Ukf};
use celestcore_core::horizon::{AngleNoise, AngleSeries, Epochs, Shape};
use celestcore_core::linalg::{Matrix, zeros};
use celestcore_core::orbit::{Environment, Field, ForceModel, Gravity, J2, Method, OrbitModel, Tables, propagate};
use celestcore_core::quaternion::{self, Integrator, exp, multiply};
use celestcore_core::replay::{Output, Start};
use celestcore_core::resample::{Resampling, resample};
use celestcore_core::scalar::{Level, Real, Run};
use celestcore_core::simulate::rng::{Stream, channel};
use std::hint::black_box;
use std::sync::Arc;

/// Longest run.
const MOST: usize = 4096;
const DT: f64 = 0.01;
const ARW: f64 = 2.5e-5;
const RRW: f64 = 3.0e-7;
const SIGMA: f64 = 1.45e-4;
/// Epochs of star angles are so far apart, s.
const PERIOD: f64 = 10.0;
const MU: f64 = 3.986_004_415e14;
const RE: f64 = 6_378_136.3;
const START: [f64; 6] = [7.0e6, 0.0, 0.0, 0.0, 2734.0, 7033.0];
const STARS: [[f64; 3]; 3] = [[0.30, 0.50, 0.81], [-0.84, 0.24, 0.48], [0.10, -0.82, 0.56]];
/// Particles of the bootstrap filter.
const PARTICLES: usize = 1000;

/// Does so many steps and tells how many items those are.
type Kernel = fn(usize) -> usize;
const KERNELS: [(&str, Kernel); 14] = [
    ("propagation", propagation),
    ("ekf", |steps| filter(&attitude::AnyFilter::Ekf(Ekf::default()), Integrator::Exponential, steps, 1)),
    ("ukf", |steps| filter(&attitude::AnyFilter::Ukf(Ukf::default()), Integrator::Rk4, steps, 1)),
    ("srukf", |steps| filter(&attitude::AnyFilter::SrUkf(SrUkf::default()), Integrator::Rk4, steps, 1)),
    ("ekf_batch", |steps| filter(&attitude::AnyFilter::Ekf(Ekf::default()), Integrator::Exponential, steps, LANES)),
    ("ukf_batch", |steps| filter(&attitude::AnyFilter::Ukf(Ukf::default()), Integrator::Rk4, steps, LANES)),
    ("orbit_ukf", |steps| orbit_filter(&celestial::AnyFilter::Ukf(Ukf::default()), steps)),
    ("upf20", |steps| orbit_filter(&celestial::AnyFilter::Cloud(Form::Literal, Settings::default()), steps)),
    ("bootstrap", bootstrap),
    ("rk4_j2", rk4),
    ("gravity21", gravity),
    ("systematic", |count| resampling(Resampling::Systematic, count)),
    ("multinomial", |count| resampling(Resampling::Multinomial, count)),
    ("residual", |count| resampling(Resampling::Residual, count)),
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let names: Vec<&str> = KERNELS.iter().map(|k| k.0).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        // what `cargo bench` without a kernel runs
        ["list"] | [] => println!("{}", names.join("\n")),
        ["level"] => println!("{}", format!("{:?}", Level::best()).to_lowercase()),
        [name, steps] => {
            let kernel = KERNELS.iter().find(|k| k.0 == name).unwrap_or_else(|| panic!("kernels: {names:?}"));
            let steps: usize = steps.parse().unwrap();
            assert!((1..=MOST).contains(&steps), "steps must be from 1 to {MOST}");
            println!("{}", kernel.1(steps));
        }
        _ => panic!("work KERNEL STEPS, or work list"),
    }
}

fn rates() -> Vec<[f64; 3]> {
    (0..=MOST)
        .map(|k| {
            let t = k as f64 * DT;
            [0.02 * (0.1 * t).sin(), 0.02 * (0.13 * t).cos(), 0.01 * (0.07 * t).sin() + 0.01]
        })
        .collect()
}

fn propagation(steps: usize) -> usize {
    let (rate, mut out) = (rates(), vec![[0.0; 4]; MOST + 1]);
    quaternion::propagate(&[1.0, 0.0, 0.0, 0.0], black_box(&rate[..steps]), &[DT], Integrator::Exponential, &mut out);
    black_box(out);
    steps
}

fn diagonal(first: f64, second: f64) -> Matrix<f64, 6, 6> {
    let mut p = zeros();
    for i in 0..3 {
        p[(i, i)] = first * first;
        p[(i + 3, i + 3)] = second * second;
    }
    p
}

/// An attitude filter with a star fix every second sample, the last row written; alone, or several side by side.
fn filter(filter: &attitude::AnyFilter, integrator: Integrator, steps: usize, count: usize) -> usize {
    let mut stream = Stream::new(1, 0, channel::WHITE);
    let (truth, t): (Vec<_>, Vec<_>) = (rates(), (0..=MOST).map(|k| k as f64 * DT).collect());
    let mut q = vec![[1.0, 0.0, 0.0, 0.0]; MOST + 1];
    quaternion::propagate(&[1.0, 0.0, 0.0, 0.0], &truth[..MOST], &[DT], Integrator::Exponential, &mut q);
    let fix_q: Vec<_> =
        q.iter().step_by(2).map(|q| multiply(q, &exp(&stream.normals::<3>().map(|e| SIGMA * e)))).collect();
    let rate: Vec<_> =
        truth.iter().map(|w| std::array::from_fn(|i| w[i] + 1e-4 + ARW / DT.sqrt() * stream.normal())).collect();
    let fix_t: Vec<_> = t.iter().step_by(2).copied().collect();
    let variance = SIGMA * SIGMA;
    let noise = vec![[variance, 0.0, 0.0, variance, 0.0, variance]; fix_t.len()];
    let fixes = steps / 2 + 1;
    let stars = [AttitudeSensor::Star(StarSeries {
        t: &fix_t[..fixes],
        q: &fix_q[..fixes],
        noise: noise[..fixes].into(),
        mounting: None,
    })];
    let timing = GyroTiming { sampling: Sampling::Hold, max_gap: 1.0, gap_rate_sigma: 1e-3 };
    let gyro = GyroSeries { t: &t[..=steps], rate: &rate[..=steps], turn: None, timing };
    let sensors = AttitudeSensors::new(&stars, 1.0).unwrap();
    let mean = Attitude { q: fix_q[0], bias: [0.0; 3] };
    let start = Start { t: 0.0, mean, covariance: diagonal(SIGMA, 1e-3), used: Some(0) };
    let options = attitude::Options { output: Output::Every(MOST), level: Level::best() };
    let mut buffers =
        vec![Buffers::new(attitude::rows(&gyro, &sensors, &start, options.output).unwrap(), false); count];
    let model = GyroModel::new(ARW, RRW, integrator).unwrap();
    let log = attitude::Log { model: &model, gyro: &gyro, sensors: &sensors };
    if let [buffers] = &mut buffers[..] {
        let (columns, measured) = buffers.columns();
        attitude::run(filter, log, black_box(&start), &options, columns, measured, &mut |_| Ok(())).unwrap();
    } else {
        let flights = buffers.iter_mut().map(|buffers| {
            let (columns, measured) = buffers.columns();
            let Start { t, mean, covariance, used } = start;
            Flight { log, start: Start { t, mean, covariance, used }, columns, measured }
        });
        attitude::run_many(filter, flights.collect(), &options, &mut |_| Ok(())).unwrap();
    }
    black_box(buffers);
    steps * count
}

fn j2() -> ForceModel {
    ForceModel::gravity(Gravity::J2(J2::new(MU, RE, 1.082_636e-3).unwrap())).unwrap()
}

fn times(count: usize, step: f64) -> Vec<f64> {
    (0..=count).map(|k| k as f64 * step).collect()
}

/// An orbit's filter on three star angles every ten seconds, the last row written.
fn orbit_filter(filter: &celestial::AnyFilter, steps: usize) -> usize {
    let mut stream = Stream::new(1, 0, channel::ANGLES);
    let stars = STARS.map(|s| {
        let length = s.iter().map(|c| c * c).sum::<f64>().sqrt();
        s.map(|c| c / length)
    });
    let all = times(MOST, PERIOD);
    let path = propagate(&j2(), &START, &all, Method::Rk4 { step: 30.0 }, false, &mut |_| Ok(())).unwrap().state;
    let (mut t, mut star, mut angle) = (vec![], vec![], vec![]);
    for (time, x) in all.iter().zip(&path).skip(1) {
        let radius = (x[0] * x[0] + x[1] * x[1] + x[2] * x[2]).sqrt();
        for s in stars {
            t.push(*time);
            star.push(s);
            angle.push((-(s[0] * x[0] + s[1] * x[1] + s[2] * x[2]) / radius).acos() + 1e-4 * stream.normal());
        }
    }
    let rows = 3 * steps;
    let epochs = Epochs::new(&AngleSeries { t: &t[..rows], star: &star[..rows], angle: &angle[..rows] }).unwrap();
    let noise = AngleNoise::new(1e-4, 0.0, Shape::Normal).unwrap();
    let sources = [Source::Horizon(Horizon { epochs: &epochs, noise, how: Use::Together })];
    let sensors = CelestialSensors::new(&sources, Outliers::Keep).unwrap();
    let dynamics = OrbitModel::new(j2(), 1e-7, 30.0).unwrap();
    let log = celestial::Log { dynamics: &dynamics, times: &all[..=steps], sensors: &sensors };
    let mean = [START[0] + 500.0, START[1] - 500.0, START[2] + 500.0, START[3], START[4], START[5]];
    let start = Start { t: 0.0, mean, covariance: diagonal(1e3, 1.0), used: None };
    let options = celestial::Options { every: MOST, level: Level::best(), random: (1, 0) };
    let mut results = Results::default();
    celestial::run(filter, log, black_box(&start), &options, &mut results, &mut |_| Ok(())).unwrap();
    black_box(results);
    steps
}

fn bootstrap(steps: usize) -> usize {
    let settings = Settings { particles: PARTICLES, threshold: 1.0, kernel: false, ..Settings::default() };
    PARTICLES * orbit_filter(&celestial::AnyFilter::Cloud(Form::Bootstrap, settings), steps)
}

fn rk4(steps: usize) -> usize {
    let t = times(MOST, 3.0);
    let method = Method::Rk4 { step: 3.0 };
    black_box(propagate(black_box(&j2()), &START, &t[..=steps], method, false, &mut |_| Ok(())).unwrap());
    steps
}

/// Accelerations along a slightly moving state.
struct Accelerations<'a>(&'a ForceModel, usize);

impl Run for Accelerations<'_> {
    type Output = f64;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> f64 {
        let mut y = START.map(T::splat);
        for k in 0..self.1 {
            let at = self.0.moment(T::splat(k as f64));
            y[0] += self.0.acceleration(&at, &[y[0], y[1], y[2]], &[y[3], y[4], y[5]])[0];
        }
        y[0].lane(0)
    }
}

fn gravity(steps: usize) -> usize {
    let (degree, hours) = (21, 16);
    let size = (degree + 1) * (degree + 2) / 2;
    let mut c = vec![1e-7; size];
    c[3] = -4.841_695_484_56e-4;
    let field = Field::new(MU, RE, degree, degree, &c, &vec![1e-7; size]).unwrap();
    let t: Vec<f64> = (0..hours).map(|k| -21_600.0 + 3600.0 * f64::from(k)).collect();
    let tables = Tables {
        earth_t: &t,
        cip: &vec![[7e-4, 3e-5, 1e-8]; t.len()],
        pole: &vec![[1e-6, 2e-6]; t.len()],
        sp: &vec![0.0; t.len()],
        ut1: [2_454_283.0, 0.0],
        dut1: &vec![0.0; t.len()],
        body_t: &t,
        sun: &vec![[1.5e11, 0.0, 0.0]; t.len()],
        moon: &vec![[3.8e8, 0.0, 0.0]; t.len()],
    };
    let environment = Some(Arc::new(Environment::new(&tables).unwrap()));
    let force = ForceModel::new(Gravity::Field(Arc::new(field)), [false; 2], None, None, environment).unwrap();
    black_box(Level::best().run(Accelerations(black_box(&force), steps)));
    steps
}

fn resampling(way: Resampling, count: usize) -> usize {
    let mut stream = Stream::new(1, 0, channel::PARTICLES);
    let weights: Vec<f64> = (0..MOST).map(|_| (-2.0 * stream.normal().powi(2)).exp()).collect();
    let mut out = vec![0; MOST];
    resample(way, black_box(&weights[..count]), || stream.uniform(), &mut out[..count]).unwrap();
    black_box(out);
    count
}

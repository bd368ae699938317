//! Time per particle of resampling and of the bootstrap filter, per step of the other particle filters and of the Kalman
//! filters on an orbit, with angles between stars and the nadir every ten seconds.
//!
//! `cargo bench -p celestcore-core --bench particles`
#![allow(clippy::unwrap_used)]

use celestcore_core::celestial::{
    AnyFilter, CelestialSensors, Form, Horizon, Log, Options, Outliers, Results, Source, Use, run,
};
use celestcore_core::cloud::Settings;
use celestcore_core::filter::{Ekf, SrUkf, Ukf};
use celestcore_core::horizon::{AngleNoise, AngleSeries, Epochs, Shape};
use celestcore_core::linalg::from_fn;
use celestcore_core::manifold::Euclidean;
use celestcore_core::orbit::{ForceModel, Gravity, J2, Method, OrbitModel, propagate};
use celestcore_core::replay::Start;
use celestcore_core::resample::{Resampling, resample};
use celestcore_core::scalar::Level;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use std::hint::black_box;

const PARTICLES: usize = 100_000;
const DT: f64 = 10.0;
const SIGMA: f64 = 1e-4;
const START: [f64; 6] = [7e6, 0.0, 0.0, 0.0, 2734.0, 7033.0];
const STARS: [[f64; 3]; 6] =
    [[0.3, 0.5, 0.81], [-0.7, 0.2, 0.4], [0.1, -0.8, 0.55], [0.5, 0.1, -0.6], [-0.2, 0.9, -0.3], [-0.5, -0.6, 0.2]];

/// An orbit about an oblate Earth, and the angles seen from it.
struct Flight {
    dynamics: OrbitModel,
    times: Vec<f64>,
    truth: Vec<[f64; 6]>,
    epochs: Epochs,
}

fn flight(steps: usize, stars: usize) -> Flight {
    let force = ForceModel::gravity(Gravity::J2(J2::new(3.986_004_418e14, 6_378_136.3, 1.082_626_68e-3).unwrap()));
    let dynamics = OrbitModel::new(force.unwrap(), 4e-7, 30.0).unwrap();
    let times: Vec<f64> = (0..=steps).map(|k| DT * k as f64).collect();
    let method = Method::Rk4 { step: DT };
    let truth = propagate(&dynamics.force, &START, &times, method, false, &mut |_| Ok(())).unwrap().state;
    let mut rng = StdRng::seed_from_u64(20_240_608);
    let (mut t, mut star, mut angle) = (vec![], vec![], vec![]);
    for (time, x) in times.iter().zip(&truth).skip(1) {
        let radius = x[..3].iter().map(|c| c * c).sum::<f64>().sqrt();
        for s in &STARS[..stars] {
            let length = s.iter().map(|c| c * c).sum::<f64>().sqrt();
            let unit = s.map(|c| c / length);
            let along: f64 = (0..3).map(|i| -unit[i] * x[i] / radius).sum();
            t.push(*time);
            star.push(unit);
            angle.push(along.acos() + SIGMA * rng.sample::<f64, _>(StandardNormal));
        }
    }
    let epochs = Epochs::new(&AngleSeries { t: &t, star: &star, angle: &angle }).unwrap();
    Flight { dynamics, times, truth, epochs }
}

impl Flight {
    fn steps(&self) -> u64 {
        self.times.len() as u64 - 1
    }

    /// The whole flight through a filter; the error of the position at its end, m.
    fn estimate(&self, filter: &AnyFilter, how: Use, sigma: [f64; 2]) -> f64 {
        let noise = AngleNoise::new(SIGMA, 0.0, Shape::Normal).unwrap();
        let source = Source::Horizon(Horizon { epochs: &self.epochs, noise, how });
        let sensors = CelestialSensors::new(&[source], Outliers::Keep).unwrap();
        let covariance = from_fn(|i, j| if i == j { sigma[i / 3] * sigma[i / 3] } else { 0.0 });
        let start = Start::<Euclidean<6>, 6> { t: 0.0, mean: START, covariance, used: None };
        let log = Log { dynamics: &self.dynamics, times: &self.times, sensors: &sensors };
        let options = Options { every: usize::MAX, level: Level::best(), random: (7, 0) };
        let mut results = Results::default();
        let end = run(filter, log, &start, &options, &mut results, &mut |_| Ok(())).unwrap();
        let last = self.truth[self.truth.len() - 1];
        (0..3).map(|i| (end.mean[i] - last[i]).powi(2)).sum::<f64>().sqrt()
    }
}

/// Weights of a filter that has just seen a measurement.
fn weights() -> Vec<f64> {
    let mut rng = StdRng::seed_from_u64(20_240_609);
    (0..PARTICLES).map(|_| (-2.0 * rng.sample::<f64, _>(StandardNormal).powi(2)).exp()).collect()
}

const WAYS: [(&str, Resampling); 4] = [
    ("systematic", Resampling::Systematic),
    ("stratified", Resampling::Stratified),
    ("residual", Resampling::Residual),
    ("multinomial", Resampling::Multinomial),
];

fn resampling(c: &mut Criterion) {
    let (weights, mut rng) = (weights(), StdRng::seed_from_u64(3));
    let mut chosen = vec![0; PARTICLES];
    let mut group = c.benchmark_group("resample 100000");
    group.throughput(Throughput::Elements(PARTICLES as u64));
    for (name, way) in WAYS {
        group.bench_function(name, |b| {
            b.iter(|| resample(way, black_box(&weights), || rng.random(), black_box(&mut chosen)).unwrap());
        });
    }
    group.finish();
}

/// The plain filter: three angles one by one, resampled at every step, no kernels.
fn bootstrap() -> AnyFilter {
    let settings = Settings { particles: PARTICLES, threshold: 1.0, kernel: false, ..Settings::default() };
    AnyFilter::Cloud(Form::Bootstrap, settings)
}

const FORMS: [(&str, Form); 3] = [("proposal", Form::Proposal), ("literal", Form::Literal), ("bank", Form::Bank)];

/// What the limit of these filters begins with: half a kilometre, half a metre per second.
const NEAR: [f64; 2] = [500.0, 0.5];
const FAR: [f64; 2] = [1000.0, 1.0];

fn particles(c: &mut Criterion) {
    let short = flight(10, 3);
    let mut group = c.benchmark_group("bootstrap 100000, per particle and step");
    group.throughput(Throughput::Elements(PARTICLES as u64 * short.steps()));
    group.sample_size(10);
    group.bench_function("3 angles", |b| b.iter(|| short.estimate(&bootstrap(), Use::OneByOne, NEAR)));
    group.finish();

    let log = flight(60, 3);
    let mut group = c.benchmark_group("20 particles, per step");
    group.throughput(Throughput::Elements(log.steps()));
    for (name, form) in FORMS {
        let filter = AnyFilter::Cloud(form, Settings::default());
        group.bench_function(name, |b| b.iter(|| log.estimate(black_box(&filter), Use::Together, NEAR)));
    }
    group.finish();
}

fn kalman(c: &mut Criterion) {
    let filters = [
        ("ekf", AnyFilter::Ekf(Ekf::default())),
        ("ukf", AnyFilter::Ukf(Ukf::default())),
        ("srukf", AnyFilter::SrUkf(SrUkf::default())),
    ];
    let mut group = c.benchmark_group("orbit, per step");
    for stars in [3, 6] {
        let log = flight(2000, stars);
        group.throughput(Throughput::Elements(log.steps()));
        for (name, filter) in &filters {
            group.bench_function(BenchmarkId::new(*name, format!("{stars} stars")), |b| {
                b.iter(|| log.estimate(black_box(filter), Use::Together, FAR));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, resampling, particles, kalman);
criterion_main!(benches);

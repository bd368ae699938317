//! Particle filters beside exact ones: Kalman where all is normal, a grid or quadrature where it is not.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{Attitude, AttitudeBias, GyroModel};
use celestcore_core::belief::{Belief, Gaussian};
use celestcore_core::cloud::{Bank, Bootstrap, Cloud, Literal, Proposal, Settings, Weighing};
use celestcore_core::filter::{Filter, Ukf};
use celestcore_core::linalg::{Matrix, from_fn, identity};
use celestcore_core::manifold::{Euclidean, Manifold};
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::quaternion::angle_between;
use celestcore_core::replay::{Drive, End, Output, Replay, Report, Sampled, Sensors, Sink, Start};
use celestcore_core::resample::Resampling;
use celestcore_core::scalar::{Level, Real, Run};
use celestcore_core::simulate::rng::{Stream, channel};
use celestcore_core::{Error, Result};
use common::{attitude, normals};

/// A position whose velocity decays and is pushed about.
struct Decay(f64);
impl Dynamics<2> for Decay {
    type Space = Euclidean<2>;
    type Input = Euclidean<1>;
    fn step<T: Real>(&self, x: &[T; 2], u: &[T; 1], _: T, dt: T) -> [T; 2] {
        [x[0] + x[1] * dt, x[1] - x[1] * dt * 0.5 + u[0] * dt]
    }
    fn noise<T: Real>(&self, _: &[T; 2], _: &[T; 1], _: T, dt: T) -> Matrix<T, 2, 2> {
        from_fn(|i, j| if i == j { dt * self.0 } else { T::zero() })
    }
}

/// How the errors of fixes are distributed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Normal,
    /// Three degrees of freedom.
    Student,
    /// Within ± √3 σ, by an edge of 5 %.
    Uniform,
    /// Zero outside: what nobody should use.
    Hard,
    /// Not a number.
    Unknown,
}

const SIGMA: f64 = 0.5;

/// The position.
struct Fix;
impl Measurement<2, 1> for Fix {
    type Space = Euclidean<2>;
    type Given = Euclidean<1>;
    type Value = Euclidean<1>;
    fn predict<T: Real>(&self, x: &[T; 2], _: &[T; 1]) -> [T; 1] {
        [x[0]]
    }
    fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> [T; 1] {
        [z[0] - zhat[0]]
    }
    fn noise<T: Real>(&self, _: &[T; 1]) -> Matrix<T, 1, 1> {
        from_fn(|_, _| T::splat(SIGMA * SIGMA))
    }
}

impl Kind {
    /// Log-density of an error; with its constant only where it is normal.
    fn log<T: Real>(self, error: T) -> T {
        let x = error * (1.0 / SIGMA);
        match self {
            Kind::Normal => x * x * -0.5 - T::splat(0.5 * (std::f64::consts::TAU * SIGMA * SIGMA).ln()),
            Kind::Student => x.map(|x| -2.0 * (1.0 + x * x).ln()),
            Kind::Uniform => {
                let b = 3.0f64.sqrt();
                x.map(|x| if x.abs() > b { -0.5 * ((x.abs() / b - 1.0) / 0.05).powi(2) } else { 0.0 })
            }
            Kind::Hard => x.map(|x| if x.abs() > 3.0f64.sqrt() { f64::NEG_INFINITY } else { 0.0 }),
            Kind::Unknown => T::splat(f64::NAN),
        }
    }
    fn draw(self, normal: &mut impl FnMut() -> f64) -> f64 {
        let uniform = |n: f64| 0.5 * libm_erfc(-n * std::f64::consts::FRAC_1_SQRT_2);
        match self {
            // equal variances: t with three degrees of freedom has 3 times its scale's square
            Kind::Student => {
                let chi = (0..3).map(|_| normal().powi(2)).sum::<f64>();
                SIGMA * normal() / (chi / 3.0).sqrt() / 3.0f64.sqrt()
            }
            Kind::Uniform | Kind::Hard => SIGMA * 3.0f64.sqrt() * (2.0 * uniform(normal()) - 1.0),
            _ => SIGMA * normal(),
        }
    }
}

/// Complementary error function by its integral: slow, plain.
fn libm_erfc(x: f64) -> f64 {
    let steps = 400;
    let h = (8.0 - x.max(-8.0)) / f64::from(steps);
    let f = |k: i32| (-(x.max(-8.0) + h * f64::from(k)).powi(2)).exp();
    let inner: f64 = (1..steps).map(|k| f(k) * if k % 2 == 1 { 4.0 } else { 2.0 }).sum();
    (inner + f(0) + f(steps)) * h / 3.0 * std::f64::consts::FRAC_2_SQRT_PI
}

/// Fixes: time and value.
struct Fixes(Vec<(f64, f64)>, Kind);
impl Sensors<Euclidean<2>, 2> for Fixes {
    fn len(&self) -> usize {
        self.0.len()
    }
    fn time(&self, i: usize) -> f64 {
        self.0[i].0
    }
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<Euclidean<2>, T, 2>,
    ) -> Report {
        let (z, gate) = ([T::splat(self.0[i].1)], T::splat(f64::INFINITY));
        filter.update::<_, T, 2, 1>(belief, &Fix, &[T::zero()], &z, gate).into()
    }
    fn log_likelihood<T: Real>(&self, i: usize, x: &[T; 2]) -> T {
        self.1.log(T::splat(self.0[i].1) - x[0])
    }
}

struct Push(Vec<f64>);
impl Drive<Decay, 2> for Push {
    fn times(&self) -> &[f64] {
        &self.0
    }
    fn input<T: Real>(&self, _: usize) -> [T; 1] {
        [T::splat(0.1)]
    }
}

/// All that a replay says.
#[derive(Default, Debug, PartialEq, Clone)]
struct Rows {
    t: Vec<f64>,
    mean: Vec<[f64; 2]>,
    cov: Vec<f64>,
    nis: Vec<f64>,
    weighed: Vec<(usize, Weighing)>,
}
impl Sink<Euclidean<2>, 2> for Rows {
    fn state<T: Real, B: Belief<Euclidean<2>, T, 2>>(&mut self, t: f64, _: usize, belief: &B) {
        self.t.push(t);
        self.mean.push(belief.mean().map(|x| x.lane(0)));
        self.cov.push(belief.covariance()[(0, 1)].lane(0));
    }
    fn measured(&mut self, _: usize, report: &Report) {
        self.nis.push(report.nis);
    }
    fn weighed(&mut self, i: usize, weighing: &Weighing) {
        self.weighed.push((i, *weighing));
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Proposal,
    Literal,
    Bank,
    Bootstrap,
}

const Q: f64 = 0.04;
const DT: f64 = 0.5;

fn start() -> Start<Euclidean<2>, 2> {
    Start { t: 0.0, mean: [0.0, 0.3], covariance: identity(), used: None }
}

struct Job<'a>(Form, Settings, &'a Fixes, (u64, f64), &'a mut Rows);
impl Run for Job<'_> {
    type Output = Result<End<Euclidean<2>, 2>>;
    fn run<T: Real<Mask = bool>>(self) -> Self::Output {
        let Job(form, settings, sensors, (run, q), rows) = self;
        let count = sensors.0.last().map_or(0.0, |z| z.0 / DT).round() as i32;
        let drive = Push((0..=count).map(|k| f64::from(k) * DT).collect());
        let replay = Sampled { dynamics: &Decay(q), drive: &drive, sensors, every: 1 };
        let (s, stream, poll) = (start(), Stream::new(9, run, channel::PARTICLES), &mut |_| Ok(()));
        let (x, p) = (&s.mean, &s.covariance);
        match form {
            Form::Proposal => {
                replay.run::<T, _, _, 2>(&s, &mut Proposal::<_, T, 2>::new(x, p, settings, stream)?, rows, poll)
            }
            Form::Literal => {
                replay.run::<T, _, _, 2>(&s, &mut Literal::<_, T, 2>::new(x, p, settings, stream)?, rows, poll)
            }
            Form::Bank => replay.run::<T, _, _, 2>(&s, &mut Bank::<_, T, 2>::new(x, p, settings, stream)?, rows, poll),
            Form::Bootstrap => {
                replay.run::<T, _, _, 2>(&s, &mut Bootstrap::<_, T, 2>::new(x, p, settings, stream)?, rows, poll)
            }
        }
    }
}

fn replayed(form: Form, settings: Settings, fixes: &Fixes, run: u64) -> (End<Euclidean<2>, 2>, Rows) {
    let mut rows = Rows::default();
    let end = Job(form, settings, fixes, (run, Q), &mut rows).run::<f64>().unwrap();
    (end, rows)
}

fn kalman(fixes: &Fixes) -> (End<Euclidean<2>, 2>, Rows) {
    let count = fixes.0.last().map_or(0.0, |z| z.0 / DT).round() as i32;
    let drive = Push((0..=count).map(|k| f64::from(k) * DT).collect());
    let filter = Ukf::default();
    let replay =
        Replay { filter: &filter, dynamics: &Decay(Q), drive: &drive, sensors: fixes, output: Output::Every(1) };
    let mut rows = Rows::default();
    let end = replay.run::<f64, _, 2>(&start(), &mut rows, &mut |_| Ok(())).unwrap();
    (end, rows)
}

/// A log made by the model itself, and the positions behind it.
fn made(kind: Kind, count: usize, seed: u64) -> (Fixes, Vec<f64>) {
    made_by(Q, kind, count, seed)
}

fn made_by(q: f64, kind: Kind, count: usize, seed: u64) -> (Fixes, Vec<f64>) {
    let mut normal = normals(seed);
    let mut x = [normal(), 0.3 + normal()];
    let (mut fixes, mut truth) = (Vec::new(), Vec::new());
    for k in 1..=count {
        x = Decay(q).step(&x, &[0.1], 0.0, DT);
        x = x.map(|c| c + (q * DT).sqrt() * normal());
        fixes.push((k as f64 * DT, x[0] + kind.draw(&mut normal)));
        truth.push(x[0]);
    }
    (Fixes(fixes, kind), truth)
}

fn with(particles: usize) -> Settings {
    Settings { particles, ..Settings::default() }
}

#[test]
fn the_proposal_form_is_the_kalman_filter_where_all_is_normal() {
    let (fixes, _) = made(Kind::Normal, 30, 1);
    let (end, rows) = kalman(&fixes);
    for particles in [1, 2, 7, 20, 33] {
        for moves in [0, 2] {
            let settings = Settings { moves, ..with(particles) };
            let (upf, got) = replayed(Form::Proposal, settings, &fixes, 5);
            for (a, b) in rows.mean.iter().zip(&got.mean) {
                assert!((a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12, "{particles} {a:?} {b:?}");
            }
            assert!(rows.cov.iter().zip(&got.cov).all(|(a, b)| (a - b).abs() < 1e-13));
            assert!(rows.nis.iter().zip(&got.nis).all(|(a, b)| (a - b).abs() < 1e-10));
            assert!((end.log_likelihood - upf.log_likelihood).abs() < 1e-10);
            assert!(got.weighed.iter().all(|(_, w)| (w.effective - particles as f64).abs() < 1e-9 && !w.resampled));
        }
    }
}

#[test]
fn a_bank_comes_to_be_the_kalman_filter() {
    let (fixes, _) = made(Kind::Normal, 60, 2);
    let (_, rows) = kalman(&fixes);
    for run in 0..4 {
        let (_, got) = replayed(Form::Bank, with(20), &fixes, run);
        // the start is forgotten
        for (a, b) in rows.mean.iter().zip(&got.mean).skip(30) {
            assert!((a[0] - b[0]).abs() < 1e-4 && (a[1] - b[1]).abs() < 1e-4, "{a:?} {b:?}");
        }
        assert!((rows.cov.last().unwrap() / got.cov.last().unwrap() - 1.0).abs() < 1e-6);
        assert!(got.weighed.iter().all(|(_, w)| w.effective >= 1.0 && w.effective <= 20.0 + 1e-9));
    }
}

/// Mean, covariance and log-likelihood: without bias, and with a scatter that falls as 1/√N.
#[test]
fn bootstrap_comes_to_be_the_kalman_filter() {
    let (fixes, _) = made(Kind::Normal, 12, 3);
    let (end, _) = kalman(&fixes);
    for resampling in [Resampling::Systematic, Resampling::Stratified, Resampling::Residual, Resampling::Multinomial] {
        let scatter = |particles: usize, runs: u64| {
            let (mut square, mut sum, mut log, mut cov) = (0.0, 0.0, 0.0, 0.0);
            for run in 0..runs {
                let (got, _) = replayed(Form::Bootstrap, Settings { resampling, ..with(particles) }, &fixes, run);
                let off = got.mean[0] - end.mean[0];
                (square, sum) = (square + off * off, sum + off);
                log += (got.log_likelihood - end.log_likelihood) / runs as f64;
                cov += got.covariance[(0, 1)] / runs as f64;
            }
            let rms = (square / runs as f64).sqrt();
            let bias = sum / runs as f64;
            assert!(bias.abs() < 4.0 * rms / (runs as f64).sqrt(), "{resampling:?} {bias} {rms}");
            (rms, log, cov)
        };
        let (few, ..) = scatter(150, 100);
        let (many, log, cov) = scatter(2400, 100);
        // a ratio of 4; that of two scatters from 100 runs each is uncertain by 10 %
        assert!((2.8..5.6).contains(&(few / many)), "{resampling:?} {few} {many}");
        assert!(log.abs() < 0.05, "{resampling:?} {log}");
        assert!((cov / end.covariance[(0, 1)] - 1.0).abs() < 0.05, "{resampling:?} {cov}");
    }
}

/// Posterior mean of the position after one fix of a normal prior, by the midpoint rule.
fn posterior(prior: &Gaussian<Euclidean<2>, f64, 2>, fix: f64, kind: Kind) -> [f64; 2] {
    let (s, slope) = (prior.cov[(0, 0)], prior.cov[(0, 1)] / prior.cov[(0, 0)]);
    let (mut mass, mut first) = (0.0, 0.0);
    for k in -40_000..40_000 {
        let d = (f64::from(k) + 0.5) * 2.5e-4;
        let w = (kind.log(fix - prior.mean[0] - d) - 0.5 * d * d / s).exp();
        (mass, first) = (mass + w, first + w * d);
    }
    let d = first / mass;
    [prior.mean[0] + d, prior.mean[1] + d * slope]
}

#[test]
fn every_noise_has_its_own_posterior() {
    let prior = Gaussian { mean: [0.2, -0.1], cov: from_fn(|i, j| [[0.5, 0.2], [0.2, 0.4]][i][j]) };
    for kind in [Kind::Student, Kind::Uniform] {
        for fix in [-0.3, 0.9, 2.0] {
            let exact = posterior(&prior, fix, kind);
            let fixes = Fixes(vec![(0.0, fix)], kind);
            let settings = with(100_000);
            // five standard errors of as many samples as are effective, of a scatter of 0.7
            let check = |what: &str, (got, weighing): (Gaussian<Euclidean<2>, f64, 2>, Weighing)| {
                let tolerance = 3.5 / weighing.effective.sqrt();
                assert!(tolerance < 0.06, "{kind:?} {fix} {what} {weighing:?}");
                for i in 0..2 {
                    let off = got.mean[i] - exact[i];
                    assert!(off.abs() < tolerance, "{kind:?} {fix} {what} {off} {weighing:?}");
                }
            };
            check("proposal", once::<Proposal<_, f64, 2>>(&prior, settings, &fixes).unwrap());
            check("bootstrap", once::<Bootstrap<_, f64, 2>>(&prior, settings, &fixes).unwrap());
            let walked = Settings { particles: 10_000, threshold: 1.0, moves: 20, ..settings };
            let (got, weighing) = once::<Proposal<_, f64, 2>>(&prior, walked, &fixes).unwrap();
            assert!(weighing.resampled && weighing.moved > 0.1 && weighing.moved < 0.8, "{weighing:?}");
            check("moves", (got, weighing));
        }
    }
}

/// One update of a cloud made from a normal prior.
fn once<C: Made + Cloud<Decay, f64, 2>>(
    prior: &Gaussian<Euclidean<2>, f64, 2>,
    settings: Settings,
    fixes: &Fixes,
) -> Result<(Gaussian<Euclidean<2>, f64, 2>, Weighing)> {
    let mut cloud = C::made(prior, settings)?;
    let weighing = cloud.update(fixes, 0..fixes.0.len(), &mut |_, _| {})?;
    Ok((cloud.moments(), weighing))
}

trait Made: Sized {
    fn made(prior: &Gaussian<Euclidean<2>, f64, 2>, settings: Settings) -> Result<Self>;
}
macro_rules! made {
    ($($cloud:ident),*) => {$(
        impl Made for $cloud<Euclidean<2>, f64, 2> {
            fn made(prior: &Gaussian<Euclidean<2>, f64, 2>, settings: Settings) -> Result<Self> {
                Self::new(&prior.mean, &prior.cov, settings, Stream::new(3, 0, channel::PARTICLES))
            }
        }
    )*};
}
made!(Proposal, Literal, Bank, Bootstrap);

/// Over many logs: better than the Kalman filter where the noise is not normal, worse nowhere.
#[test]
fn knowing_the_noise_pays() {
    let rms = |kind: Kind, form: Option<Form>| {
        let mut square = 0.0;
        for run in 0..60 {
            let (fixes, truth) = made(kind, 80, 100 + run);
            let rows = match form {
                Some(form) => replayed(form, with(if form == Form::Proposal { 20 } else { 500 }), &fixes, run).1,
                None => kalman(&fixes).1,
            };
            for (x, mean) in truth.iter().zip(&rows.mean[1..]).skip(10) {
                square += (mean[0] - x).powi(2) / (60.0 * 70.0);
            }
        }
        square.sqrt()
    };
    for kind in [Kind::Student, Kind::Uniform] {
        let (plain, proposal, bootstrap) =
            (rms(kind, None), rms(kind, Some(Form::Proposal)), rms(kind, Some(Form::Bootstrap)));
        println!("{kind:?}: Kalman {plain:.4}, proposal {proposal:.4}, bootstrap {bootstrap:.4}");
        assert!(proposal < 0.98 * plain && bootstrap < 0.96 * plain, "{kind:?} {plain} {proposal} {bootstrap}");
    }
}

/// The letter of the paper: its weights are a ratio of a narrow density and a wide one.
#[test]
fn the_literal_form_collapses() {
    let (fixes, _) = made(Kind::Normal, 60, 4);
    // median part of the particles that are effective, for a variance `q` that comes in each second
    let median = |form, q| {
        let mut rows = Rows::default();
        let settings = Settings { moves: 1, ..with(50) };
        Job(form, settings, &fixes, (1, q), &mut rows).run::<f64>().unwrap();
        let mut all: Vec<f64> = rows.weighed.iter().map(|(_, w)| w.effective / 50.0).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let parts = [Q, 1e-3, 1e-6].map(|q| median(Form::Literal, q));
    println!("literal: {parts:?}, bootstrap: {}", median(Form::Bootstrap, 1e-6));
    assert!(parts[0] > parts[1] && parts[1] > parts[2] && parts[2] < 0.06, "{parts:?}");
    assert!(median(Form::Bootstrap, 1e-6) > 0.5 && median(Form::Proposal, 1e-6) > 0.999);
    let (end, rows) = replayed(Form::Literal, Settings { moves: 1, ..with(400) }, &fixes, 1);
    assert!(rows.weighed.iter().any(|(_, w)| w.resampled && w.moved > 0.0));
    // on this toy, whose process noise is large, it still follows
    assert!((end.mean[0] - kalman(&fixes).0.mean[0]).abs() < 1.0);
}

/// Without noise in the dynamics copies stay copies; kernels keep the particles as spread as they should be.
#[test]
fn kernels_keep_particles_apart() {
    let (fixes, _) = made_by(0.0, Kind::Normal, 400, 4);
    let filter = Ukf::default();
    let drive = Push((0..=400).map(|k| f64::from(k) * DT).collect());
    let exact =
        Replay { filter: &filter, dynamics: &Decay(0.0), drive: &drive, sensors: &fixes, output: Output::Every(1) };
    let exact = exact.run::<f64, _, 2>(&start(), &mut Rows::default(), &mut |_| Ok(())).unwrap();
    // variance in units of the exact one, and the error of the mean in exact sigmas
    let scores = |kernel| {
        let (mut variance, mut square) = (0.0, 0.0);
        for run in 0..20 {
            let mut rows = Rows::default();
            let settings = Settings { kernel, ..with(60) };
            let end = Job(Form::Bootstrap, settings, &fixes, (run, 0.0), &mut rows).run::<f64>().unwrap();
            variance += end.covariance[(0, 0)] / exact.covariance[(0, 0)] / 20.0;
            square += (end.mean[0] - exact.mean[0]).powi(2) / exact.covariance[(0, 0)] / 20.0;
        }
        (variance, square.sqrt())
    };
    let (with, without) = (scores(true), scores(false));
    println!("with kernels {with:?}, without {without:?}");
    assert!((0.7..1.4).contains(&with.0) && with.1 < 0.5, "{with:?}");
    assert!(without.0 < 0.7 * with.0 && without.1 > 3.0 * with.1, "{without:?}");
}

#[test]
fn weights_that_vanish_are_an_error_or_recovered() {
    let prior = Gaussian { mean: [0.0, 0.0], cov: identity() * 0.01 };
    let far = Fixes(vec![(2.5, 30.0)], Kind::Hard);
    let (mut kalman, _) = Ukf::default().belief::<Euclidean<2>, f64, 2>(prior.mean, &prior.cov);
    far.update(0, &Ukf::default(), &mut kalman);
    let strict = Settings { recover: false, ..with(20) };

    let found = |e: Option<Error>| match e {
        Some(Error::Vanished { step: 0, t: 2.5, largest, broken: 0, count: 20 }) => {
            assert_eq!(largest, f64::NEG_INFINITY)
        }
        other => panic!("{other:?}"),
    };
    found(once::<Proposal<_, f64, 2>>(&prior, strict, &far).err());
    found(once::<Bootstrap<_, f64, 2>>(&prior, strict, &far).err());
    found(once::<Literal<_, f64, 2>>(&prior, strict, &far).err());

    let (got, weighing) = once::<Proposal<_, f64, 2>>(&prior, with(20), &far).unwrap();
    assert!(weighing.recovered && got.mean == kalman.mean && got.cov == kalman.cov);
    let (got, weighing) = once::<Bootstrap<_, f64, 2>>(&prior, with(20), &far).unwrap();
    assert!(weighing.recovered && got.mean[0].abs() < 0.2 && (weighing.effective - 20.0).abs() < 1e-9);
    let (got, weighing) = once::<Literal<_, f64, 2>>(&prior, with(20), &far).unwrap();
    assert!(weighing.recovered && (got.mean[0] - kalman.mean[0]).abs() < 0.3, "{:?} {:?}", got.mean, kalman.mean);

    let unknown = Fixes(vec![(2.5, 0.0)], Kind::Unknown);
    let error = once::<Bootstrap<_, f64, 2>>(&prior, strict, &unknown).err().unwrap();
    assert!(matches!(error, Error::Vanished { broken: 20, .. }) && error.to_string().contains("t = 2.5 s"), "{error}");

    // far off, but with a likelihood: told apart however small it is
    let (got, weighing) =
        once::<Bootstrap<_, f64, 2>>(&prior, with(20), &Fixes(vec![(0.0, 1e4)], Kind::Normal)).unwrap();
    assert!(!weighing.recovered && weighing.effective < 1.5 && weighing.resampled && got.mean[0] > 0.0);
}

#[test]
fn the_same_stream_gives_the_same_bits() {
    for form in [Form::Proposal, Form::Literal, Form::Bank, Form::Bootstrap] {
        for kind in [Kind::Normal, Kind::Student] {
            let (fixes, _) = made(kind, 40, 8);
            let settings = Settings { moves: 1, ..with(21) };
            let (a, b) = (replayed(form, settings, &fixes, 3), replayed(form, settings, &fixes, 3));
            // rows hold numbers that are none
            assert_eq!(format!("{:?}", a.1), format!("{:?}", b.1));
            if (form, kind) != (Form::Proposal, Kind::Normal) && form != Form::Bank {
                assert_ne!(a.0.mean, replayed(form, settings, &fixes, 4).0.mean, "{form:?}");
            }
            let mut fused = Rows::default();
            Level::best().run(Job(form, settings, &fixes, (3, Q), &mut fused)).unwrap();
            if form != Form::Literal {
                for (x, y) in a.1.mean.iter().zip(&fused.mean) {
                    assert!((x[0] - y[0]).abs() < 1e-9, "{form:?} {x:?} {y:?}");
                }
            }
        }
    }
}

#[test]
fn a_replay_uses_what_lies_in_its_time() {
    // two before the start, one used by it, two at one time, one after the end
    let fixes = Fixes(
        vec![(-1.0, 0.0), (-0.5, 0.0), (0.0, 9.0), (0.25, 0.1), (0.25, 0.3), (0.5, 0.2), (7.0, 0.0)],
        Kind::Normal,
    );
    let drive = Push(vec![0.0, 0.5, 1.0, 1.5]);
    let start = Start { used: Some(2), ..start() };
    let run = |drive: &Push, every: usize, poll: &mut dyn FnMut(usize) -> Result<()>| {
        let mut cloud =
            Proposal::<Euclidean<2>, f64, 2>::new(&start.mean, &start.covariance, with(8), Stream::new(1, 1, 5))?;
        let mut rows = Rows::default();
        let replay = Sampled { dynamics: &Decay(Q), drive, sensors: &fixes, every };
        replay.run::<f64, _, _, 2>(&start, &mut cloud, &mut rows, poll).map(|end| (end, rows))
    };
    let (end, rows) = run(&drive, 2, &mut |_| Ok(())).unwrap();
    assert_eq!(end.outside, 3);
    assert_eq!(rows.t, [0.0, 1.0]);
    assert_eq!(rows.weighed.iter().map(|w| w.0).collect::<Vec<_>>(), [3, 4, 5]);
    assert_eq!(rows.weighed[0].1.log_likelihood, rows.weighed[1].1.log_likelihood);
    assert_eq!((end.t, rows.nis.len()), (1.5, 3));

    let filter = Ukf::default();
    let exact =
        Replay { filter: &filter, dynamics: &Decay(Q), drive: &drive, sensors: &fixes, output: Output::Every(2) };
    let exact = exact.run::<f64, _, 2>(&start, &mut Rows::default(), &mut |_| Ok(())).unwrap();
    assert!((exact.mean[0] - end.mean[0]).abs() < 1e-12 && exact.outside == end.outside);

    assert!(matches!(run(&Push(vec![0.0, 1.0, 1.0]), 1, &mut |_| Ok(())), Err(Error::NotIncreasing { row: 2, .. })));
    assert!(matches!(run(&Push(vec![1.0, 2.0]), 1, &mut |_| Ok(())), Err(Error::Parameter { .. })));
    assert!(matches!(run(&Push(vec![]), 1, &mut |_| Ok(())), Err(Error::Empty { .. })));
    let long = Fixes((0..600).map(|k| (f64::from(k), 0.0)).collect(), Kind::Normal);
    let drive = Push((0..601).map(f64::from).collect());
    let mut cloud =
        Proposal::<Euclidean<2>, f64, 2>::new(&start.mean, &start.covariance, with(8), Stream::new(1, 1, 5)).unwrap();
    let replay = Sampled { dynamics: &Decay(Q), drive: &drive, sensors: &long, every: 1 };
    let stopped =
        replay.run::<f64, _, _, 2>(&start, &mut cloud, &mut Rows::default(), &mut |_| Err(Error::Interrupted));
    assert_eq!(stopped.err(), Some(Error::Interrupted));
}

#[test]
fn settings_without_meaning_are_refused() {
    let prior = Gaussian { mean: [0.0; 2], cov: identity() };
    let fixes = Fixes(vec![(0.0, 0.0)], Kind::Normal);
    for settings in [with(0), Settings { threshold: 1.5, ..with(5) }, Settings { threshold: f64::NAN, ..with(5) }] {
        assert!(matches!(once::<Proposal<_, f64, 2>>(&prior, settings, &fixes), Err(Error::Parameter { .. })));
        assert!(matches!(once::<Bootstrap<_, f64, 2>>(&prior, settings, &fixes), Err(Error::Parameter { .. })));
        assert!(matches!(once::<Bank<_, f64, 2>>(&prior, settings, &fixes), Err(Error::Parameter { .. })));
        assert!(matches!(once::<Literal<_, f64, 2>>(&prior, settings, &fixes), Err(Error::Parameter { .. })));
    }
    let bad = Gaussian { mean: [0.0; 2], cov: -identity::<f64, 2>() };
    assert!(matches!(once::<Proposal<_, f64, 2>>(&bad, with(5), &fixes), Err(Error::NotPositiveDefinite { .. })));
    assert!(matches!(once::<Bootstrap<_, f64, 2>>(&bad, with(5), &fixes), Err(Error::NotPositiveDefinite { .. })));
    assert!(matches!(once::<Literal<_, f64, 2>>(&bad, with(5), &fixes), Err(Error::NotPositiveDefinite { .. })));
}

#[test]
fn moments_on_rotations_are_those_drawn_from() {
    let mut normal = normals(8);
    let x: Attitude<f64> = attitude(&mut normal);
    let p: Matrix<f64, 6, 6> = from_fn(|i, j| if i == j { 0.01 * (1.0 + i as f64) } else { 0.002 });
    let cloud = Bootstrap::<AttitudeBias, f64, 6>::new(&x, &p, with(200_000), Stream::new(3, 0, 0)).unwrap();
    let Gaussian { mean, cov } = Cloud::<GyroModel, f64, 6>::moments(&cloud);
    assert!(angle_between(&mean.q, &x.q) < 2e-3);
    let total: f64 = (0..6).map(|i| AttitudeBias::local(&mean, &x)[i].powi(2)).sum();
    assert!(total.sqrt() < 3e-3);
    for i in 0..6 {
        for j in 0..6 {
            assert!((cov[(i, j)] - p[(i, j)]).abs() < 0.02 * (p[(i, i)] * p[(j, j)]).sqrt(), "{i} {j}");
        }
    }
}

//! The smoother on a linear system: what a batch least-squares solution over all states says.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::belief::Belief;
use celestcore_core::error::{Error, Result};
use celestcore_core::filter::{Ekf, Filter, Iterated, SrUkf, Ukf, Unscented};
use celestcore_core::linalg::{Matrix, from_fn, identity, zeros};
use celestcore_core::manifold::Euclidean;
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::replay::{Drive, End, Output, Recorder, Replay, Report, Sensors, Sink, Start, smooth};
use celestcore_core::scalar::Real;
use common::{normals, spd};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};

type Space = Euclidean<4>;

/// Two axes of constant velocity with white acceleration, and an input on the first one.
struct Cart;

impl Dynamics<4> for Cart {
    type Space = Space;
    type Input = Euclidean<1>;
    fn step<T: Real>(&self, x: &[T; 4], u: &[T; 1], _: T, dt: T) -> [T; 4] {
        [x[0] + x[2] * dt, x[1] + x[3] * dt, x[2] + u[0] * dt, x[3]]
    }
    fn transition<T: Real>(&self, _: &[T; 4], _: &[T; 1], _: T, dt: T) -> Matrix<T, 4, 4> {
        let mut f = identity();
        f[(0, 2)] = dt;
        f[(1, 3)] = dt;
        f
    }
    fn noise<T: Real>(&self, _: &[T; 4], _: &[T; 1], _: T, dt: T) -> Matrix<T, 4, 4> {
        let mut q = zeros();
        for i in 0..2 {
            q[(i, i)] = dt * dt * dt * (0.1 / 3.0);
            q[(i, i + 2)] = dt * dt * 0.05;
            q[(i + 2, i)] = dt * dt * 0.05;
            q[(i + 2, i + 2)] = dt * 0.1;
        }
        q
    }
}

/// Mixed positions, with correlated noise.
struct Fix;

const R: [[f64; 2]; 2] = [[0.3, 0.1], [0.1, 0.5]];
const H: [[f64; 4]; 2] = [[1.0, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]];

impl Measurement<4, 2> for Fix {
    type Space = Space;
    type Given = Euclidean<1>;
    type Value = Euclidean<2>;
    fn predict<T: Real>(&self, x: &[T; 4], _: &[T; 1]) -> [T; 2] {
        [x[0] + x[1] * 0.5, x[1]]
    }
    fn residual<T: Real>(&self, z: &[T; 2], zhat: &[T; 2]) -> [T; 2] {
        [z[0] - zhat[0], z[1] - zhat[1]]
    }
    fn noise<T: Real>(&self, _: &[T; 1]) -> Matrix<T, 2, 2> {
        from_fn(|i, j| T::splat(R[i][j]))
    }
    fn jacobian<T: Real>(&self, _: &[T; 4], _: &[T; 1]) -> Matrix<T, 2, 4> {
        from_fn(|i, j| T::splat(H[i][j]))
    }
}

/// Uneven samples of the input; fixes at samples, between them, two at once, and long without any.
struct Log {
    t: Vec<f64>,
    u: Vec<f64>,
    fix_t: Vec<f64>,
    z: Vec<[f64; 2]>,
    x0: [f64; 4],
    p0: Matrix<f64, 4, 4>,
}

impl Log {
    fn new(seed: u64) -> Self {
        let mut normal = normals(seed);
        let mut log = Self {
            t: vec![0.0],
            u: vec![normal()],
            fix_t: vec![],
            z: vec![],
            x0: std::array::from_fn(|_| normal()),
            p0: spd(&mut normal, 0.5),
        };
        for k in 0..60 {
            let (t, dt) = (log.t[k], 0.1 + 0.05 * normal().abs());
            log.t.push(t + dt);
            log.u.push(normal());
            match k % 7 {
                0 => log.fix_t.push(t),
                2 => log.fix_t.extend([t + 0.3 * dt, t + 0.8 * dt]),
                4 if !(30..=50).contains(&k) => log.fix_t.extend([t + 0.5 * dt, t + 0.5 * dt]),
                _ => {}
            }
        }
        log.z = log.fix_t.iter().map(|_| [3.0 * normal(), 3.0 * normal()]).collect();
        log
    }
}

impl Drive<Cart, 4> for Log {
    fn times(&self) -> &[f64] {
        &self.t
    }
    fn input<T: Real>(&self, k: usize) -> [T; 1] {
        [T::splat(self.u[k])]
    }
}

impl Sensors<Space, 4> for Log {
    fn len(&self) -> usize {
        self.fix_t.len()
    }
    fn time(&self, i: usize) -> f64 {
        self.fix_t[i]
    }
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<Space, T, 4>,
    ) -> Report {
        let (given, z) = ([T::one()], self.z[i].map(T::splat));
        filter.update::<_, T, 4, 2>(belief, &Fix, &given, &z, T::splat(f64::INFINITY)).into()
    }
}

/// Records the way there, then takes down the way back.
struct Tape {
    recorder: Option<Recorder<Space, 4>>,
    rows: Vec<(f64, Vector4<f64>, Matrix4<f64>)>,
}

impl Sink<Space, 4> for Tape {
    fn state<T: Real, B: Belief<Space, T, 4>>(&mut self, t: f64, k: usize, belief: &B) {
        match &mut self.recorder {
            Some(recorder) => recorder.row(t, k),
            None => {
                let p = belief.covariance();
                let x = Vector4::from_fn(|i, _| belief.mean()[i].lane(0));
                self.rows.push((t, x, Matrix4::from_fn(|i, j| p[(i, j)].lane(0))));
            }
        }
    }
    fn measured(&mut self, _: usize, report: &Report) {
        assert!(report.accepted);
    }
    fn leaving<T: Real, B: Belief<Space, T, 4>>(&mut self, t: f64, to: f64, k: usize, belief: &B) {
        self.recorder.as_mut().unwrap().node(t, to, k, belief);
    }
}

type Poll<'a> = &'a mut dyn FnMut(usize) -> Result<()>;

fn there_and_back<F: Filter>(filter: &F, log: &Log, every: usize, poll: Poll<'_>) -> Result<(Tape, End<Space, 4>)> {
    let mut tape = Tape { recorder: Some(Recorder::new(0, 0)), rows: vec![] };
    let replay = Replay { filter, dynamics: &Cart, drive: log, sensors: log, output: Output::Every(every) };
    let start = Start { t: log.t[0], mean: log.x0, covariance: log.p0, used: None };
    let end = replay.run::<f64, _, 4>(&start, &mut tape, &mut |_| Ok(()))?;
    let recorder = tape.recorder.take().unwrap();
    smooth::<_, _, _, _, f64, 4>((filter, &Cart, log), recorder, &end, &mut tape, poll)?;
    tape.rows.reverse();
    Ok((tape, end))
}

/// Least squares over the states at all samples and fixes at once: rows are whitened residuals, solved by an
/// orthogonal factorisation. Returns the times, the states and their covariances.
fn batch(log: &Log) -> (Vec<f64>, DVector<f64>, DMatrix<f64>) {
    let mut times: Vec<f64> = log.t.iter().chain(&log.fix_t).copied().collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let n = 4 * times.len();
    let mut a = DMatrix::<f64>::zeros(n + 2 * log.z.len(), n);
    let mut b = DVector::<f64>::zeros(a.nrows());
    let white = |p: &Matrix4<f64>| p.cholesky().unwrap().l().try_inverse().unwrap();
    let w = white(&log.p0);
    a.view_mut((0, 0), (4, 4)).copy_from(&w);
    b.rows_mut(0, 4).copy_from(&(w * Vector4::from(log.x0)));
    for i in 1..times.len() {
        let (from, dt) = (times[i - 1], times[i] - times[i - 1]);
        let u = log.u[log.t.partition_point(|t| *t <= from) - 1];
        let mut f = Matrix4::identity();
        f[(0, 2)] = dt;
        f[(1, 3)] = dt;
        let w = white(&Cart.noise(&[0.0; 4], &[0.0], 0.0, dt));
        a.view_mut((4 * i, 4 * i), (4, 4)).copy_from(&w);
        a.view_mut((4 * i, 4 * i - 4), (4, 4)).copy_from(&-(w * f));
        b.rows_mut(4 * i, 4).copy_from(&(w * Vector4::new(0.0, 0.0, u * dt, 0.0)));
    }
    let h = Matrix2x4::from_fn(|i, j| H[i][j]);
    let w = Matrix2::from_fn(|i, j| R[i][j]).cholesky().unwrap().l().try_inverse().unwrap();
    for (k, (t, z)) in log.fix_t.iter().zip(&log.z).enumerate() {
        let i = times.iter().position(|at| at == t).unwrap();
        a.view_mut((n + 2 * k, 4 * i), (2, 4)).copy_from(&(w * h));
        b.rows_mut(n + 2 * k, 2).copy_from(&(w * Vector2::from(*z)));
    }
    let qr = a.qr();
    let root = qr.r().try_inverse().unwrap();
    (times, &root * (qr.q().transpose() * b), &root * root.transpose())
}

fn agrees_with_least_squares<F: Filter>(filter: &F, tolerance: f64) {
    for seed in [1, 2, 3] {
        let log = Log::new(seed);
        let (times, x, p) = batch(&log);
        let (tape, _) = there_and_back(filter, &log, 1, &mut |_| Ok(())).unwrap();
        assert_eq!(tape.rows.len(), log.t.len());
        let (mut worst, mut widest) = (0.0_f64, 0.0_f64);
        for (t, mean, cov) in &tape.rows {
            let i = 4 * times.iter().position(|at| at == t).unwrap();
            for j in 0..4 {
                let sigma = p[(i + j, i + j)].sqrt();
                worst = worst.max((mean[j] - x[i + j]).abs() / x[i + j].abs().max(sigma));
                for k in 0..4 {
                    let scale = sigma * p[(i + k, i + k)].sqrt();
                    widest = widest.max((cov[(j, k)] - p[(i + j, i + k)]).abs() / scale);
                }
            }
        }
        assert!(worst < tolerance && widest < tolerance, "mean {worst:e}, covariance {widest:e}");
    }
}

#[test]
fn every_smoother_is_batch_least_squares_on_a_linear_system() {
    agrees_with_least_squares(&Ekf::default(), 1e-9);
    agrees_with_least_squares(&Ekf { reset: false }, 1e-9);
    agrees_with_least_squares(&Iterated::default(), 1e-9);
    agrees_with_least_squares(&Ukf::default(), 1e-9);
    agrees_with_least_squares(&SrUkf::default(), 1e-9);
    for (alpha, beta, kappa) in [(1.0, 2.0, Some(0.0)), (0.5, 0.25, Some(1.0))] {
        let weights = Unscented::new(alpha, beta, kappa).unwrap();
        agrees_with_least_squares(&Ukf { weights }, 1e-9);
        agrees_with_least_squares(&SrUkf::new(weights).unwrap(), 1e-9);
    }
}

#[test]
fn the_last_row_is_the_filters_and_rows_do_not_depend_on_each_other() {
    let log = Log::new(5);
    let filter = Ukf::default();
    let (all, end) = there_and_back(&filter, &log, 1, &mut |_| Ok(())).unwrap();
    let (t, mean, cov) = all.rows.last().unwrap();
    assert_eq!((*t, mean.as_slice(), cov), (end.t, end.mean.as_slice(), &end.covariance));
    for every in [2, 7, 60, 1000] {
        let (some, _) = there_and_back(&filter, &log, every, &mut |_| Ok(())).unwrap();
        let expected: Vec<_> = all.rows.iter().step_by(every).cloned().collect();
        assert_eq!(some.rows, expected);
    }
}

#[test]
fn whoever_is_polled_may_end_the_way_back() {
    let log = Log::new(6);
    let stop = |k: usize| Err(Error::Parameter { field: "stopped", value: k as f64, need: "" });
    let Err(Error::Parameter { field, value, .. }) = there_and_back(&Ekf::default(), &log, 1, &mut |k| stop(k)) else {
        unreachable!("the poll ends it");
    };
    assert_eq!((field, value), ("stopped", 0.0)); // the first node, which every way back comes to
}

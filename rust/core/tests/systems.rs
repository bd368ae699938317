//! Systems beside the plain one: the same attitude in other states, and the paper's three repairs.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{
    Attitude, AttitudeBias, Calibrated, CalibratedSpace, Calibration, ErrorQuaternion, GyroInput, GyroInputs,
    GyroModel, InertialError, Invariant, Literal, LiteralModel, LiteralSpace, Reference, Symmetric3, System,
    UnitQuaternion,
};
use celestcore_core::belief::{Belief, Gaussian};
use celestcore_core::filter::{Ekf, Filter, Ukf};
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::manifold::Manifold;
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::quaternion::{
    Integrator, conjugate, cross, difference, dot3, exp, integrate, multiply, to_matrix,
};
use celestcore_core::scalar::Real;
use common::{ARW, DT, Made, RRW, attitude, close, made, normals, spd, start};

const OPEN: [f64; 3] = [f64::INFINITY; 3];

fn model() -> GyroModel {
    GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap()
}

fn calibration() -> Calibration {
    Calibration { model: model(), aligned: Some(1), prior: [0.01, 0.02, 0.03] }
}

#[test]
fn what_a_system_starts_from_it_says_again() {
    let mut normal = normals(41);
    for _ in 0..50 {
        let (x, p) = (attitude(&mut normal), spd::<6>(&mut normal, 1e-6));
        let (y, q) = Invariant(model()).start(&x, &p);
        assert_eq!(Invariant(model()).attitude(&y), x);
        close(&Invariant(model()).covariance(&y, &q), &p, 1e-19);
        let (y, q) = LiteralModel(model()).start(&x, &p);
        let off = AttitudeBias::local(&x, &LiteralModel(model()).attitude(&y));
        assert!(off.iter().all(|c| c.abs() < 1e-15));
        close(&LiteralModel(model()).covariance(&y, &q), &p, 1e-19);
        let (y, q) = calibration().start(&x, &p);
        assert_eq!(calibration().attitude(&y), x);
        close(&calibration().covariance(&y, &q), &p, 0.0);
        let sigma: [f64; 12] = std::array::from_fn(|i| q[(6 + i, 6 + i)].sqrt());
        let expected = [[0.01; 3], [0.02; 3], [0.02; 3], [0.03; 3]].concat();
        assert!(sigma.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-15));
    }
}

/// An update on the inertial side is the one on the body side, in turned axes; the covariance stays where
/// it was in inertial axes.
#[test]
fn invariant_updates_are_turned_updates() {
    let mut normal = normals(43);
    let filter = Ekf { reset: false };
    let noise = [4e-6, 1e-6, 0.0, 2e-6, 5e-7, 3e-6];
    for round in 0..40 {
        let (x, p) = (attitude(&mut normal), spd::<6>(&mut normal, 1e-6));
        let (y, left) = Invariant(model()).start(&x, &p);
        let mut body = Gaussian::<AttitudeBias, f64, 6> { mean: x, cov: p };
        let mut inertial = Gaussian::<InertialError, f64, 6> { mean: y, cov: left };
        let (a, b) = if round % 2 == 0 {
            let z = multiply(&x.q, &exp(&std::array::from_fn(|_| 2e-3 * normal())));
            let fix = (&z, &noise);
            (
                model().star::<_, f64>(&filter, &mut body, 0, fix, &OPEN),
                Invariant(model()).star::<_, f64>(&filter, &mut inertial, 0, fix, &OPEN),
            )
        } else {
            let reference = Reference { inertial: [0.6, -0.48, 0.64], sigma: 1e-3 };
            let seen = multiply(&x.q, &exp(&std::array::from_fn(|_| 2e-3 * normal())));
            let z = celestcore_core::quaternion::rotate(&conjugate(&seen), &reference.inertial);
            (
                model().direction::<_, f64>(&filter, &mut body, &z, &reference, &OPEN),
                Invariant(model()).direction::<_, f64>(&filter, &mut inertial, &z, &reference, &OPEN),
            )
        };
        assert!(a.accepted && b.accepted);
        assert!((a.nis - b.nis).abs() < 1e-9 * a.nis);
        let off = AttitudeBias::local(&body.mean, &inertial.mean);
        assert!(off.iter().all(|c| c.abs() < 1e-14), "{off:?}");
        let mut turn = Matrix::<f64, 6, 6>::identity();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&to_matrix(&x.q));
        close(&inertial.cov, &(turn * body.cov * turn.transpose()), 1e-17);
    }
}

/// What a camera's fix says of the eighteen states, from the innovation's covariance: H by differences.
#[test]
fn an_aligned_cameras_jacobian_is_the_derivative_of_its_fix() {
    let mut normal = normals(47);
    for _ in 0..40 {
        let (one, two) = (attitude(&mut normal), attitude(&mut normal));
        let gyro = std::array::from_fn(|_| 0.01 * normal());
        let x = Calibrated { q: one.q, bias: one.bias, gyro, alignment: two.q };
        let p = spd::<18>(&mut normal, 1e-6);
        let noise = [4e-6, 1e-6, 0.0, 2e-6, 5e-7, 3e-6];
        for (sensor, turned) in [(0, false), (1, true), (2, false)] {
            let fix = |x: &Calibrated<f64>| if turned { multiply(&x.q, &x.alignment) } else { x.q };
            let h = Matrix::<f64, 3, 18>::from_fn(|i, j| {
                let image = |e: f64| {
                    let mut d = [0.0; 18];
                    d[j] = e;
                    difference(&fix(&x), &fix(&CalibratedSpace::retract(&x, &d)))[i]
                };
                (image(1e-5) - image(-1e-5)) / 2e-5
            });
            let step: [f64; 3] = std::array::from_fn(|_| 1e-3 * normal());
            let z = multiply(&fix(&x), &exp(&step));
            let mut belief = Gaussian::<CalibratedSpace, f64, 18> { mean: x, cov: p };
            let report = calibration().star::<_, f64>(&Ekf::default(), &mut belief, sensor, (&z, &noise), &OPEN);
            let r = Symmetric3Matrix(noise).full();
            let s = Matrix::<f64, 3, 3>::from_fn(|i, j| report.covariance[i][j]);
            close(&s, &(h * p * h.transpose() + r), 1e-13);
            for i in 0..3 {
                assert!((report.innovation[i] - step[i]).abs() < 1e-14);
            }
            // and the update is the textbook's
            let gain = p * h.transpose() * s.try_inverse().unwrap();
            let moved = gain * Matrix::<f64, 3, 1>::from_fn(|i, _| step[i]);
            let found = CalibratedSpace::local(&x, &belief.mean);
            assert!((0..18).all(|i| (found[i] - moved[i]).abs() < 1e-11), "{found:?} {moved}");
        }
    }
}

struct Symmetric3Matrix([f64; 6]);
impl Symmetric3Matrix {
    fn full(&self) -> Matrix<f64, 3, 3> {
        let r = &self.0;
        Matrix::<f64, 3, 3>::new(r[0], r[1], r[2], r[1], r[3], r[4], r[2], r[4], r[5])
    }
}

#[test]
fn a_direction_tells_the_calibrated_state_what_it_tells_the_plain_one() {
    let mut normal = normals(53);
    let reference = Reference { inertial: [0.6, -0.48, 0.64], sigma: 1e-3 };
    let (x, p) = (attitude(&mut normal), spd::<6>(&mut normal, 1e-6));
    let (y, q) = calibration().start(&x, &p);
    let mut plain = Gaussian::<AttitudeBias, f64, 6> { mean: x, cov: p };
    let mut full = Gaussian::<CalibratedSpace, f64, 18> { mean: y, cov: q };
    let body = celestcore_core::quaternion::rotate(&conjugate(&x.q), &[0.6, -0.481, 0.639]);
    let a = model().direction::<_, f64>(&Ekf::default(), &mut plain, &body, &reference, &OPEN);
    let b = calibration().direction::<_, f64>(&Ekf::default(), &mut full, &body, &reference, &OPEN);
    assert!(a.accepted && b.accepted && a.nis > 0.1);
    let off = AttitudeBias::local(&plain.mean, &calibration().attitude(&full.mean));
    assert!(off.iter().all(|c| c.abs() < 1e-15), "{off:?}");
    close(&calibration().covariance(&full.mean, &full.cov), &plain.cov, 1e-18);
}

// the paper's three repairs: what happens without each

/// Eq. 13 as printed: without `−½ Δq₀ Δb`.
struct Printed(GyroModel);

impl Dynamics<7> for Printed {
    type Space = LiteralSpace;
    type Input = GyroInputs;
    fn step<T: Real>(&self, x: &Literal<T>, u: &GyroInput<T>, _: T, dt: T) -> Literal<T> {
        let rate: [T; 3] = std::array::from_fn(|i| u.rate[i] - x.bias[i]);
        let derivative = |dq: &[T; 4]| {
            let v = [dq[1], dq[2], dq[3]];
            let (turn, mixed) = (cross(&rate, &v), cross(&v, &x.db));
            let vector = |i: usize| -turn[i] - mixed[i] * 0.5;
            [dot3(&v, &x.db) * 0.5, vector(0), vector(1), vector(2)]
        };
        let middle: [T; 4] = {
            let k = derivative(&x.dq);
            std::array::from_fn(|i| x.dq[i] + k[i] * dt * 0.5)
        };
        let k = derivative(&middle);
        Literal {
            q: integrate(&x.q, &rate, dt, self.0.integrator),
            dq: std::array::from_fn(|i| x.dq[i] + k[i] * dt),
            ..*x
        }
    }
    fn noise<T: Real>(&self, x: &Literal<T>, u: &GyroInput<T>, t: T, dt: T) -> Matrix<T, 7, 7> {
        LiteralModel(self.0).noise(x, u, t, dt)
    }
}

/// Eq. 15, a measured error quaternion, whichever side it is of.
struct Direct;

impl Measurement<7, 4> for Direct {
    type Space = LiteralSpace;
    type Given = Symmetric3;
    type Value = UnitQuaternion;
    fn predict<T: Real>(&self, x: &Literal<T>, _: &[T; 6]) -> [T; 4] {
        x.dq
    }
    fn residual<T: Real>(&self, z: &[T; 4], zhat: &[T; 4]) -> [T; 4] {
        std::array::from_fn(|i| z[i] - zhat[i])
    }
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 4, 4> {
        ErrorQuaternion.noise(r)
    }
}

type Seven = Gaussian<LiteralSpace, f64, 7>;

/// Runs a log by hand; `error` makes the measured error quaternion of fix and reference.
fn replay<D>(log: &Made, dynamics: &D, error: impl Fn(&[f64; 4], &[f64; 4]) -> [f64; 4]) -> Attitude<f64>
where
    D: Dynamics<7, Space = LiteralSpace, Input = GyroInputs>,
{
    let filter = Ukf::default();
    let first = start(log);
    let (x, p) = LiteralModel(model()).start(&first.mean, &first.covariance);
    let (mut belief, ok): (Seven, bool) = filter.belief::<LiteralSpace, f64, 7>(x, &p);
    assert!(ok);
    for k in 0..log.t.len() - 1 {
        let input = GyroInput { rate: log.rate[k], extra: 0.0 };
        assert!(filter.predict(&mut belief, dynamics, &input, log.t[k], DT));
        let next = k + 1;
        if next.is_multiple_of(2) {
            let fix = next / 2;
            belief.mean = LiteralSpace::normalise(&belief.mean);
            let z = error(&log.star_q[fix], &belief.mean.q);
            let z = if z[0] < 0.0 { z.map(|c| -c) } else { z };
            let o = filter.update::<_, f64, 7, 4>(&mut belief, &Direct, &log.noise[fix], &z, f64::INFINITY);
            assert!(o.accepted);
        }
    }
    LiteralModel(model()).attitude(belief.mean())
}

fn body_side(star: &[f64; 4], reference: &[f64; 4]) -> [f64; 4] {
    multiply(&conjugate(reference), star)
}

fn off(log: &Made, x: &Attitude<f64>) -> f64 {
    let turn = difference(log.truth.last().unwrap(), &x.q);
    turn.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// The gyro's bias at the start of [`made`]; it walks on by some 1e-5.
const BIAS: [f64; 3] = [1e-4, -2e-4, 1.5e-4];

/// Largest share of the true bias by which an estimate is wrong after half a minute.
fn wrong(x: &Attitude<f64>) -> f64 {
    x.bias.iter().zip(BIAS).map(|(b, true_b)| (b / true_b - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn without_the_first_repair_the_bias_is_not_estimated() {
    let log = made(301, 61);
    let good = replay(&log, &LiteralModel(model()), body_side);
    assert!(off(&log, &good) < 1e-4 && wrong(&good) < 0.3, "{} {}", off(&log, &good), wrong(&good));
    // it starts at zero, and there it stays but for terms of second order
    let bad = replay(&log, &Printed(model()), body_side);
    assert!(wrong(&bad) > 0.95, "{:?}", bad.bias);
}

#[test]
fn without_the_second_repair_it_loses_its_way_once_the_body_has_turned() {
    let log = made(3001, 61); // three radians
    let good = replay(&log, &LiteralModel(model()), body_side);
    let bad = replay(&log, &LiteralModel(model()), |star, reference| multiply(star, &conjugate(reference)));
    assert!(off(&log, &good) < 1e-4, "{}", off(&log, &good));
    assert!(off(&log, &bad) > 1e-2, "{}", off(&log, &bad));
}

#[test]
fn without_the_third_repair_there_is_no_square_root_to_draw_points_from() {
    let log = made(3, 61);
    let first = start(&log);
    let (x, p) = LiteralModel(model()).start(&first.mean, &first.covariance);
    let singular: Matrix<f64, 7, 7> = from_fn(|i, j| if i == 0 && j == 0 { 0.0 } else { p[(i, j)] });
    assert!(Ukf::default().belief::<LiteralSpace, f64, 7>(x, &p).1);
    assert!(!Ukf::default().belief::<LiteralSpace, f64, 7>(x, &singular).1);
    let quarter = 0.25 * (first.covariance[(0, 0)] + first.covariance[(1, 1)] + first.covariance[(2, 2)]) / 3.0;
    assert!((p[(0, 0)] / quarter - 1.0).abs() < 1e-15);
}

//! Short cuts against the plain, generic way: the same numbers to rounding.
#![allow(clippy::unwrap_used)]

use celestcore_core::attitude::{
    Attitude, AttitudeBias, GyroInput, GyroInputs, GyroModel, StarQuaternion, Symmetric3, UnitQuaternion,
};
use celestcore_core::belief::{Belief, Gaussian};
use celestcore_core::filter::{Ekf, Filter, SrUkf, Ukf};
use celestcore_core::linalg::{Matrix, Vector, from_fn, mul_t};
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::quaternion::{
    Integrator, Quaternion, exp, integrate, multiply, norm_squared, normalise, propagate,
};
use celestcore_core::scalar::Real;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// A gyro model without its short cuts.
struct Plain(GyroModel);

impl Dynamics<6> for Plain {
    type Space = AttitudeBias;
    type Input = GyroInputs;
    fn step<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Attitude<T> {
        self.0.step(x, u, t, dt)
    }
    fn noise<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Matrix<T, 6, 6> {
        self.0.noise(x, u, t, dt)
    }
    fn transition<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Matrix<T, 6, 6> {
        self.0.transition(x, u, t, dt)
    }
}

/// A star camera without its short cuts.
struct Dense;

impl Measurement<6, 3> for Dense {
    type Space = AttitudeBias;
    type Given = Symmetric3;
    type Value = UnitQuaternion;
    fn predict<T: Real>(&self, x: &Attitude<T>, r: &[T; 6]) -> Quaternion<T> {
        StarQuaternion.predict(x, r)
    }
    fn residual<T: Real>(&self, z: &Quaternion<T>, zhat: &Quaternion<T>) -> Vector<T, 3> {
        StarQuaternion.residual(z, zhat)
    }
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 3, 3> {
        StarQuaternion.noise(r)
    }
    fn jacobian<T: Real>(&self, x: &Attitude<T>, r: &[T; 6]) -> Matrix<T, 3, 6> {
        StarQuaternion.jacobian(x, r)
    }
}

struct Case {
    x: Attitude<f64>,
    p: Matrix<f64, 6, 6>,
    u: GyroInput<f64>,
    dt: f64,
    z: Quaternion<f64>,
    r: [f64; 6],
}

/// Beliefs from arcseconds to half a radian, turns from nothing to a radian a step, noise that is not the same about
/// all axes.
fn cases() -> Vec<Case> {
    let mut rng = StdRng::seed_from_u64(7);
    let mut normal = move || -> f64 { rng.sample(StandardNormal) };
    (0..200)
        .map(|i| {
            let size = [1e-5, 1e-3, 0.05, 0.3][i % 4];
            let turn = [0.0, 1e-3, 0.1, 1.0][i / 4 % 4];
            let root: Matrix<f64, 6, 6> = from_fn(|i, _| normal() * if i < 3 { size } else { 0.01 * size });
            let q = normalise(&std::array::from_fn(|_| normal()));
            let mut three = |s: f64| -> [f64; 3] { std::array::from_fn(|_| s * normal()) };
            let (bias, rate, off) = (three(1e-3), three(turn), three(size));
            let s = [size * size, 4.0 * size * size, 0.01 * size * size];
            Case {
                x: Attitude { q, bias },
                p: mul_t(&root, &root),
                u: GyroInput { rate, extra: 0.0 },
                dt: 1.0,
                z: multiply(&q, &exp(&off)),
                r: [s[0], 0.1 * s[2], 0.0, s[1], 0.0, s[2]],
            }
        })
        .collect()
}

/// Largest difference of two covariances, each entry in units of its standard deviations.
fn apart(a: &Matrix<f64, 6, 6>, b: &Matrix<f64, 6, 6>) -> f64 {
    let scale = |i: usize, j: usize| (a[(i, i)] * a[(j, j)]).sqrt();
    (0..36).map(|k| (k % 6, k / 6)).map(|(i, j)| (a[(i, j)] - b[(i, j)]).abs() / scale(i, j)).fold(0.0, f64::max)
}

fn agree(a: &Gaussian<AttitudeBias, f64, 6>, b: &Gaussian<AttitudeBias, f64, 6>, tolerance: f64) {
    assert!(apart(&a.cov, &b.cov) < tolerance, "{:e}", apart(&a.cov, &b.cov));
    for i in 0..4 {
        assert!((a.mean.q[i] - b.mean.q[i]).abs() < 1e-12);
    }
    for i in 0..3 {
        assert!((a.mean.bias[i] - b.mean.bias[i]).abs() < 1e-12);
    }
}

#[test]
fn predictions_by_blocks_and_by_displaced_errors_are_the_plain_ones() {
    for integrator in [Integrator::Exponential, Integrator::Rk4] {
        let model = GyroModel::new(1e-5, 1e-7, integrator).unwrap();
        for c in cases() {
            let before = Gaussian { mean: c.x, cov: c.p };
            let (mut a, mut b) = (before, before);
            assert!(Ekf::default().predict::<GyroModel, f64, 6>(&mut a, &model, &c.u, 0.0, c.dt));
            assert!(Ekf::default().predict::<Plain, f64, 6>(&mut b, &Plain(model), &c.u, 0.0, c.dt));
            agree(&a, &b, 1e-12);
            let (mut a, mut b) = (before, before);
            let ok = Ukf::default().predict::<GyroModel, f64, 6>(&mut a, &model, &c.u, 0.0, c.dt);
            assert_eq!(ok, Ukf::default().predict::<Plain, f64, 6>(&mut b, &Plain(model), &c.u, 0.0, c.dt));
            if ok {
                agree(&a, &b, 5e-11);
            }
        }
    }
}

#[test]
fn a_direct_correction_is_that_through_the_jacobian() {
    for c in cases() {
        let before = Gaussian { mean: c.x, cov: c.p };
        for filter in [Ekf::default(), Ekf { reset: false }] {
            let (mut a, mut b) = (before, before);
            let one = filter.update::<_, f64, 6, 3>(&mut a, &StarQuaternion, &c.r, &c.z, f64::INFINITY);
            let two = filter.update::<_, f64, 6, 3>(&mut b, &Dense, &c.r, &c.z, f64::INFINITY);
            assert!(one.ok && two.ok && (one.nis / two.nis - 1.0).abs() < 1e-11);
            agree(&a, &b, 1e-11);
        }
    }
}

#[test]
fn a_linear_correction_is_that_of_sigma_points() {
    for c in cases() {
        let before = Gaussian { mean: c.x, cov: c.p };
        let (mut a, mut b) = (before, before);
        let one = Ukf::default().update::<_, f64, 6, 3>(&mut a, &StarQuaternion, &c.r, &c.z, f64::INFINITY);
        let two = Ukf::default().update::<_, f64, 6, 3>(&mut b, &Dense, &c.r, &c.z, f64::INFINITY);
        if one.ok && two.ok {
            assert!((one.nis / two.nis - 1.0).abs() < 1e-9);
            agree(&a, &b, 1e-9);
        }
        let (mut a, ok) = SrUkf::default().belief::<AttitudeBias, f64, 6>(c.x, &c.p);
        if ok {
            let mut b = a;
            SrUkf::default().update::<_, f64, 6, 3>(&mut a, &StarQuaternion, &c.r, &c.z, f64::INFINITY);
            SrUkf::default().update::<_, f64, 6, 3>(&mut b, &Dense, &c.r, &c.z, f64::INFINITY);
            assert!(apart(&a.covariance(), &b.covariance()) < 1e-9);
        }
    }
}

/// A measurement a million times better than the belief leaves its own noise, to the last digits.
#[test]
fn nothing_cancels_where_the_measurement_is_all_that_is_known() {
    let p: Matrix<f64, 6, 6> = from_fn(|i, j| if i == j { 1.0 } else { 0.2 });
    let x = Attitude { q: [1.0, 0.0, 0.0, 0.0], bias: [0.0; 3] };
    for sigma in [1e-3, 1e-6, 1e-9] {
        let s = sigma * sigma;
        let mut b = Gaussian::<AttitudeBias, f64, 6> { mean: x, cov: p };
        let seen = Ekf::default().update::<_, f64, 6, 3>(&mut b, &StarQuaternion, &[s, 0.0, 0.0, s, 0.0, s], &x.q, 1e9);
        assert!(seen.accepted);
        for i in 0..3 {
            assert!((b.cov[(i, i)] / s - 1.0).abs() < 2.0 * s + 1e-12, "{:e}", b.cov[(i, i)]);
        }
    }
}

/// A history in one call, whose length is corrected now and then, and step by step.
#[test]
fn a_history_is_that_of_its_steps() {
    let mut random = StdRng::seed_from_u64(8);
    let n = 5000;
    let rates: Vec<[f64; 3]> =
        (0..n).map(|_| std::array::from_fn(|_| 0.3 * random.sample::<f64, _>(StandardNormal))).collect();
    let (same, each) = (vec![0.1], (0..n).map(|k| 0.05 + 1e-5 * k as f64).collect::<Vec<f64>>());
    for integrator in [Integrator::Exponential, Integrator::Rk4] {
        for dt in [&same, &each] {
            let mut q = normalise(&[0.5, -0.3, 0.7, 0.2]);
            let mut history = vec![[0.0; 4]; n + 1];
            propagate(&[0.5, -0.3, 0.7, 0.2], &rates, dt, integrator, &mut history);
            for k in 0..n {
                q = integrate(&q, &rates[k], dt[if dt.len() == 1 { 0 } else { k }], integrator);
                let row = history[k + 1];
                assert!((norm_squared(&row).sqrt() - 1.0).abs() < 4.0 * f64::EPSILON, "row {k}: {row:?}");
                for i in 0..4 {
                    assert!((row[i] - q[i]).abs() < 2e-16 * (k + 20) as f64, "row {k}: {row:?} {q:?}");
                }
            }
        }
    }
}

/// The four stages of Runge and Kutta, as the textbook has them.
#[test]
fn rk4_multiplied_out_is_rk4_by_stages() {
    let along = |q: &Quaternion<f64>, k: &Quaternion<f64>, h: f64| std::array::from_fn(|i| q[i] + h * k[i]);
    for c in cases() {
        for size in [1e-4, 0.1, 0.5, 1.0, 3.0] {
            let w = c.u.rate.map(|w| w * size);
            let slope = |q: &Quaternion<f64>| multiply(q, &[0.0, 0.5 * w[0], 0.5 * w[1], 0.5 * w[2]]);
            let q = c.x.q;
            let k1 = slope(&q);
            let k2 = slope(&along(&q, &k1, 0.5 * c.dt));
            let k3 = slope(&along(&q, &k2, 0.5 * c.dt));
            let k4 = slope(&along(&q, &k3, c.dt));
            let sum = std::array::from_fn(|i| (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) / 6.0);
            let (plain, short) = (normalise(&along(&q, &sum, c.dt)), integrate(&q, &w, c.dt, Integrator::Rk4));
            for i in 0..4 {
                assert!((plain[i] - short[i]).abs() < 2e-15 * (1.0 + w[i.min(2)].abs()), "{plain:?} {short:?}");
            }
        }
    }
}

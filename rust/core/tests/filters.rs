//! The generic filters on a linear system with a known answer, and what they do when a step fails.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::Error;
use celestcore_core::belief::{Belief, Outcome};
use celestcore_core::filter::{Ekf, Filter, SrUkf, Ukf, Unscented};
use celestcore_core::linalg::{Matrix, zeros};
use celestcore_core::manifold::Euclidean;
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::scalar::{Lanes, Mask, Real};
use common::{close, normals, spd};
use nalgebra::{Matrix4, Vector2, Vector4};

/// Two axes of constant velocity with white acceleration.
struct Cart;
impl Dynamics<4> for Cart {
    type Space = Euclidean<4>;
    type Input = Euclidean<1>;
    fn step<T: Real>(&self, x: &[T; 4], u: &[T; 1], _: T, dt: T) -> [T; 4] {
        [x[0] + x[2] * dt, x[1] + x[3] * dt, x[2] + u[0] * dt, x[3]]
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

/// Positions, with correlated noise.
struct Fix;
const R: [[f64; 2]; 2] = [[0.3, 0.1], [0.1, 0.5]];
impl Measurement<4, 2> for Fix {
    type Space = Euclidean<4>;
    type Given = Euclidean<1>;
    type Value = Euclidean<2>;
    fn predict<T: Real>(&self, x: &[T; 4], _: &[T; 1]) -> [T; 2] {
        [x[0] + x[1] * 0.5, x[1]]
    }
    fn residual<T: Real>(&self, z: &[T; 2], zhat: &[T; 2]) -> [T; 2] {
        [z[0] - zhat[0], z[1] - zhat[1]]
    }
    fn noise<T: Real>(&self, scale: &[T; 1]) -> Matrix<T, 2, 2> {
        celestcore_core::linalg::from_fn(|i, j| scale[0] * R[i][j])
    }
}

fn transition(dt: f64) -> Matrix4<f64> {
    let mut f = Matrix4::identity();
    f[(0, 2)] = dt;
    f[(1, 3)] = dt;
    f
}

/// A hundred steps beside the textbook's Kalman filter.
fn agrees_with_the_textbook<F: Filter>(filter: &F, tolerance: f64) {
    let mut normal = normals(3);
    let p0 = spd::<4>(&mut normal, 0.5);
    let x0: [f64; 4] = std::array::from_fn(|_| normal());
    let (mut belief, ok) = filter.belief::<Euclidean<4>, f64, 4>(x0, &p0);
    assert!(ok);
    let (mut x, mut p) = (Vector4::from(x0), p0);
    let h = nalgebra::Matrix2x4::new(1.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0);
    let r = nalgebra::Matrix2::from(R);
    for k in 0..100 {
        let (u, dt) = (normal(), 0.1 + 0.05 * normal().abs());
        assert!(filter.predict(&mut belief, &Cart, &[u], 0.0, dt));
        let f = transition(dt);
        x = f * x + Vector4::new(0.0, 0.0, u * dt, 0.0);
        p = f * p * f.transpose() + Cart.noise(&[0.0; 4], &[0.0], 0.0, dt);
        if k % 3 == 0 {
            let z = [normal(), normal()];
            let o = filter.update(&mut belief, &Fix, &[1.0], &z, f64::INFINITY);
            let s = h * p * h.transpose() + r;
            let gain = p * h.transpose() * s.try_inverse().unwrap();
            let nu = Vector2::from(z) - h * x;
            assert!((o.nis - (nu.transpose() * s.try_inverse().unwrap() * nu)[0]).abs() < 1e-9);
            close(&o.covariance, &s, tolerance);
            assert!(o.accepted && o.ok);
            x += gain * nu;
            p -= gain * s * gain.transpose();
        }
        assert!((Vector4::from(*belief.mean()) - x).abs().max() < tolerance);
        close(&belief.covariance(), &p, tolerance);
    }
}

#[test]
fn every_filter_is_the_kalman_filter_on_a_linear_system() {
    agrees_with_the_textbook(&Ekf::default(), 2e-8); // its transition is by differences here
    agrees_with_the_textbook(&Ukf::default(), 1e-11);
    for (alpha, beta, kappa) in [(1.0, 2.0, Some(0.0)), (0.5, 0.25, Some(1.0)), (1e-2, 2.0, None)] {
        let weights = Unscented::new(alpha, beta, kappa).unwrap();
        agrees_with_the_textbook(&Ukf { weights }, 1e-9);
        agrees_with_the_textbook(&SrUkf::new(weights).unwrap(), 1e-9);
    }
}

#[test]
fn weights_that_have_no_meaning_are_refused() {
    for (alpha, beta, kappa) in [(0.0, 2.0, None), (1.5, 2.0, None), (1.0, -1.0, None), (f64::NAN, 2.0, None)] {
        assert!(matches!(Unscented::new(alpha, beta, kappa), Err(Error::Parameter { .. })));
    }
    assert!(Unscented::new(1.0, 2.0, Some(f64::INFINITY)).is_err());
    assert!(Unscented::new(1.0, 2.0, Some(-6.0)).unwrap().check(6).is_err());
    assert!(Unscented::new(1.0, 2.0, Some(-3.0)).unwrap().check(6).is_ok());
    assert!(SrUkf::new(Unscented::new(1.0, 0.5, None).unwrap()).is_err());
}

/// Measurement noise that is no covariance, a measured value that is not a number, and a gate.
fn failed_steps_leave_the_belief<F: Filter>(filter: &F) {
    let mut normal = normals(9);
    let (belief, _) = filter.belief::<Euclidean<4>, f64, 4>([1.0, 2.0, 3.0, 4.0], &spd::<4>(&mut normal, 1.0));
    let same = |b: &F::Belief<Euclidean<4>, f64, 4>| b.mean() == belief.mean() && b.covariance() == belief.covariance();
    let update = |scale: f64, z: [f64; 2], gate: f64| {
        let mut b = belief;
        let o: Outcome<f64, 2> = filter.update(&mut b, &Fix, &[scale], &z, gate);
        (o.ok, o.accepted, same(&b))
    };
    assert_eq!(update(-100.0, [0.0, 0.0], f64::INFINITY), (false, false, true));
    assert_eq!(update(1.0, [f64::NAN, 0.0], f64::INFINITY), (false, false, true));
    assert_eq!(update(1.0, [1e4, 0.0], 20.0), (true, false, true));
    assert_eq!(update(1.0, [2.0, 2.0], 20.0), (true, true, false));

    let mut b = belief;
    assert!(!filter.predict(&mut b, &Cart, &[0.0], 0.0, f64::NAN));
    assert!(same(&b));
    assert!(!filter.predict(&mut b, &Cart, &[f64::INFINITY], 0.0, 1.0));
    assert!(same(&b));
    let mut not_positive = spd::<4>(&mut normal, 1.0);
    not_positive[(2, 2)] = -1.0;
    assert!(!filter.belief::<Euclidean<4>, f64, 4>([0.0; 4], &not_positive).1);
}

#[test]
fn a_failed_step_leaves_the_belief_as_it_was() {
    failed_steps_leave_the_belief(&Ekf::default());
    failed_steps_leave_the_belief(&Ukf::default());
    failed_steps_leave_the_belief(&SrUkf::default());
}

/// Eight filters in lanes: each lane is the single filter, and a bad lane does not disturb the others.
fn lanes_are_single_filters<F: Filter>(filter: &F) {
    type Eight = Lanes<false>;
    let mut normal = normals(21);
    let p0 = spd::<4>(&mut normal, 1.0);
    let lane = |i: usize, k: usize| (i as f64 * 0.7 + k as f64 * 0.3).sin();
    let (mut eight, ok) = filter.belief::<Euclidean<4>, Eight, 4>(
        std::array::from_fn(|c| Eight::from_lanes(|i| lane(i, c))),
        &celestcore_core::linalg::from_fn(|i, j| Eight::splat(p0[(i, j)])),
    );
    assert!(ok.all());
    let mut singles: Vec<_> =
        (0..8).map(|i| filter.belief::<Euclidean<4>, f64, 4>(std::array::from_fn(|c| lane(i, c)), &p0).0).collect();
    for k in 0..20 {
        // lane 3 is fed nonsense at step 7
        let u = |i: usize| if k == 7 && i == 3 { f64::NAN } else { lane(i, k) };
        let ok = filter.predict(
            &mut eight,
            &Cart,
            &[Eight::from_lanes(u)],
            Eight::splat(0.0),
            Eight::from_lanes(|i| 0.1 + 0.01 * i as f64),
        );
        let z = |i: usize, c: usize| lane(i, k + c) * 3.0;
        let values = [0, 1].map(|c| Eight::from_lanes(|i| z(i, c)));
        let o = filter.update(&mut eight, &Fix, &[Eight::splat(1.0)], &values, Eight::splat(6.0));
        for (i, single) in singles.iter_mut().enumerate() {
            assert_eq!(filter.predict(single, &Cart, &[u(i)], 0.0, 0.1 + 0.01 * i as f64), ok.lane(i));
            let one = filter.update(single, &Fix, &[1.0], &[z(i, 0), z(i, 1)], 6.0);
            assert_eq!(one.accepted, o.accepted.lane(i));
            assert!((one.nis - o.nis.lane(i)).abs() < 1e-9 * (1.0 + one.nis));
        }
    }
    for (i, single) in singles.iter().enumerate() {
        for c in 0..4 {
            assert!((single.mean()[c] - eight.mean()[c].lane(i)).abs() < 1e-10);
            let (a, b) = (single.covariance(), eight.covariance());
            assert!((a[(c, 0)] - b[(c, 0)].lane(i)).abs() < 1e-10);
        }
    }
}

#[test]
fn eight_filters_in_lanes_are_eight_filters() {
    lanes_are_single_filters(&Ekf::default());
    lanes_are_single_filters(&Ukf::default());
    lanes_are_single_filters(&SrUkf::default());
}

/// One axis seen directly, with noise far below the last digit of the prior's variance.
#[test]
fn a_very_precise_measurement_leaves_its_own_variance() {
    struct Direct;
    impl Measurement<1, 1> for Direct {
        type Space = Euclidean<1>;
        type Given = Euclidean<1>;
        type Value = Euclidean<1>;
        fn predict<T: Real>(&self, x: &[T; 1], _: &[T; 1]) -> [T; 1] {
            *x
        }
        fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> [T; 1] {
            [z[0] - zhat[0]]
        }
        fn noise<T: Real>(&self, r: &[T; 1]) -> Matrix<T, 1, 1> {
            celestcore_core::linalg::from_fn(|_, _| r[0])
        }
        fn jacobian<T: Real>(&self, _: &[T; 1], _: &[T; 1]) -> Matrix<T, 1, 1> {
            celestcore_core::linalg::identity()
        }
    }
    fn left<F: Filter>(filter: &F, r: f64) -> (bool, f64) {
        let one = celestcore_core::linalg::identity();
        let (mut b, _) = filter.belief::<Euclidean<1>, f64, 1>([0.0], &one);
        let o = filter.update::<_, f64, 1, 1>(&mut b, &Direct, &[r], &[0.5], f64::INFINITY);
        (o.accepted, b.covariance()[(0, 0)])
    }
    for r in [1e-10, 1e-18, 1e-30] {
        let (accepted, variance) = left(&Ekf::default(), r);
        let exact = r / (1.0 + r);
        assert!(accepted && (variance / exact - 1.0).abs() < 1e-5, "{variance:e} {exact:e}");
        // a square root is known to the last digit of the prior's, 1e-16 here
        let (accepted, variance) = left(&SrUkf::default(), r);
        assert!(accepted && (variance.sqrt() - exact.sqrt()).abs() < 4e-16, "{variance:e} {r:e}");
    }
}

//! Particles beside the Kalman filter on a linear system, and what they do when nothing fits.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::Error;
use celestcore_core::attitude::{Attitude, AttitudeBias};
use celestcore_core::belief::Belief;
use celestcore_core::filter::{Filter, Ukf};
use celestcore_core::linalg::{Matrix, from_fn, identity};
use celestcore_core::manifold::{Euclidean, Manifold};
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::particles::Particles;
use celestcore_core::quaternion::angle_between;
use celestcore_core::resample::Resampling;
use celestcore_core::scalar::Real;
use celestcore_core::simulate::rng::Stream;
use common::{attitude, normals};

/// A position that decays and is pushed about.
struct Decay;
impl Dynamics<2> for Decay {
    type Space = Euclidean<2>;
    type Input = Euclidean<1>;
    fn step<T: Real>(&self, x: &[T; 2], u: &[T; 1], _: T, dt: T) -> [T; 2] {
        [x[0] + x[1] * dt, x[1] - x[1] * dt * 0.5 + u[0] * dt]
    }
    fn noise<T: Real>(&self, _: &[T; 2], _: &[T; 1], _: T, dt: T) -> Matrix<T, 2, 2> {
        from_fn(|i, j| if i == j { dt * 0.04 } else { T::zero() })
    }
}

/// The position, with noise of the variance given.
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
    fn noise<T: Real>(&self, r: &[T; 1]) -> Matrix<T, 1, 1> {
        from_fn(|_, _| r[0])
    }
}

/// Mean, covariance and log-likelihood of both after some steps; many particles come near the exact ones.
#[test]
fn many_particles_are_the_kalman_filter() {
    let mut normal = normals(4);
    let zs: Vec<f64> = (0..12).map(|k| 0.2 * f64::from(k) + 0.5 * normal()).collect();
    let (mut belief, _) = Ukf::default().belief::<Euclidean<2>, f64, 2>([0.0, 0.3], &identity());
    let mut exact = 0.0;
    for z in &zs {
        Ukf::default().predict(&mut belief, &Decay, &[0.1], 0.0, 0.5);
        let o = Ukf::default().update::<_, f64, 2, 1>(&mut belief, &Fix, &[0.25], &[*z], f64::INFINITY);
        exact -= 0.5 * (o.nis + o.covariance[(0, 0)].ln() + std::f64::consts::TAU.ln());
    }
    for way in [Resampling::Systematic, Resampling::Stratified, Resampling::Residual, Resampling::Multinomial] {
        let (mut mean, mut square, mut cov, mut log) = ([0.0; 2], [0.0; 2], 0.0, 0.0);
        let runs = 40;
        for run in 0..runs {
            let mut stream = Stream::new(9, run, 0);
            let mut particles = Particles::<Euclidean<2>, 2>::new(&[0.0, 0.3], &identity(), 2000, &mut stream).unwrap();
            for z in &zs {
                particles.predict(&Decay, &[0.1], 0.0, 0.5, &mut stream);
                log += particles.update(&Fix, &[0.25], &[*z]).unwrap() / runs as f64;
                particles.refresh(way, 0.5, &mut stream).unwrap();
            }
            let (m, p) = particles.moments();
            for i in 0..2 {
                mean[i] += m[i] / runs as f64;
                square[i] += m[i] * m[i] / runs as f64;
            }
            cov += p[(0, 1)] / runs as f64;
        }
        for i in 0..2 {
            // five standard errors of the mean over the runs, taken from their own scatter
            let error = ((square[i] - mean[i] * mean[i]).max(0.0) / runs as f64).sqrt();
            assert!(error < 0.01, "{error}");
            assert!((mean[i] - belief.mean()[i]).abs() < 5.0 * error, "{way:?} {} {}", mean[i], belief.mean()[i]);
        }
        assert!((cov / belief.covariance()[(0, 1)] - 1.0).abs() < 0.05, "{way:?}");
        assert!((log - exact).abs() < 0.05, "{way:?} {log} {exact}");
    }
}

#[test]
fn a_measurement_that_nothing_explains_is_an_error() {
    let mut stream = Stream::new(1, 0, 0);
    let mut particles = Particles::<Euclidean<2>, 2>::new(&[0.0, 0.0], &identity(), 50, &mut stream).unwrap();
    let before = particles.weights().to_vec();
    // so far off that every likelihood is zero
    let result = particles.update(&Fix, &[1e-300], &[1e10]);
    assert!(matches!(result, Err(Error::Parameter { field: "weights", .. })), "{result:?}");
    assert!(particles.update(&Fix, &[-1.0], &[0.0]).is_err());
    assert_eq!(particles.weights(), before);
    // far off, but with a likelihood: one particle is left, and refreshing makes many of it
    particles.update(&Fix, &[1e-3], &[40.0]).unwrap();
    assert!(particles.effective_sample_size() < 1.5);
    assert!(particles.refresh(Resampling::Systematic, 0.5, &mut stream).unwrap());
    assert!((particles.effective_sample_size() - 50.0).abs() < 1e-9);
    assert!(!particles.refresh(Resampling::Systematic, 0.5, &mut stream).unwrap());
    assert!(Particles::<Euclidean<2>, 2>::new(&[0.0; 2], &identity(), 0, &mut stream).is_err());
    assert!(Particles::<Euclidean<2>, 2>::new(&[0.0; 2], &-identity::<f64, 2>(), 5, &mut stream).is_err());
}

#[test]
fn moments_on_rotations_are_those_drawn_from() {
    let mut normal = normals(8);
    let x: Attitude<f64> = attitude(&mut normal);
    let p: Matrix<f64, 6, 6> = from_fn(|i, j| if i == j { 0.01 * (1.0 + i as f64) } else { 0.002 });
    let mut stream = Stream::new(3, 0, 0);
    let particles = Particles::<AttitudeBias, 6>::new(&x, &p, 200_000, &mut stream).unwrap();
    let (mean, cov) = particles.moments();
    assert!(angle_between(&mean.q, &x.q) < 2e-3);
    let total: f64 = (0..6).map(|i| AttitudeBias::local(&mean, &x)[i].powi(2)).sum();
    assert!(total.sqrt() < 3e-3);
    for i in 0..6 {
        for j in 0..6 {
            assert!((cov[(i, j)] - p[(i, j)]).abs() < 0.02 * (p[(i, i)] * p[(j, j)]).sqrt(), "{i} {j}");
        }
    }
}

//! Star angles: derivatives, and the combined nadir against least squares with the full covariance.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::horizon::{NadirPlane, PlaneGiven, StarAngle, StarGiven, combine};
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::manifold::{Euclidean, Manifold};
use celestcore_core::model::Measurement;
use celestcore_core::quaternion::{dot3, tangents};
use common::normals;
use nalgebra::{DMatrix, DVector};

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = dot3(&v, &v).sqrt();
    v.map(|c| c / n)
}

fn random_unit(normal: &mut impl FnMut() -> f64) -> [f64; 3] {
    unit(std::array::from_fn(|_| normal()))
}

fn state(normal: &mut impl FnMut() -> f64) -> [f64; 6] {
    let r = random_unit(normal).map(|c| c * 7.1e6);
    [r[0], r[1], r[2], 7e3 * normal(), 7e3 * normal(), 7e3 * normal()]
}

fn angle(star: &[f64; 3], nadir: &[f64; 3]) -> f64 {
    dot3(star, nadir).acos()
}

#[test]
fn measurements_have_the_derivatives_they_say() {
    fn differs<H: Measurement<6, M, Space = Euclidean<6>>, const M: usize>(
        sensor: &H,
        x: &[f64; 6],
        given: &<H::Given as celestcore_core::manifold::Family>::Of<f64>,
    ) -> f64 {
        let origin = sensor.predict(x, given);
        let difference: Matrix<f64, M, 6> = from_fn(|i, j| {
            let image = |h: f64| {
                let mut d = [0.0; 6];
                d[j] = h;
                sensor.residual(&sensor.predict(&Euclidean::<6>::retract(x, &d), given), &origin)[i]
            };
            // metres
            (image(10.0) - image(-10.0)) / 20.0
        });
        (sensor.jacobian(x, given) - difference).abs().max() * 7.1e6
    }
    let mut normal = normals(3);
    for _ in 0..200 {
        let x = state(&mut normal);
        let star = random_unit(&mut normal);
        let sine = (1.0 - dot3(&star, &unit([x[0], x[1], x[2]])).powi(2)).sqrt();
        assert!(differs(&StarAngle, &x, &StarGiven { star, sigma: 1e-4 }) < 1e-7 / sine.powi(2));
        let axes = tangents(&random_unit(&mut normal));
        assert!(differs(&NadirPlane, &x, &PlaneGiven { axes, noise: [1.0, 0.2, 3.0] }) < 1e-7);
    }
}

#[test]
fn an_angle_is_that_between_star_and_nadir() {
    let mut normal = normals(4);
    for _ in 0..200 {
        let x = state(&mut normal);
        let star = random_unit(&mut normal);
        let nadir = unit([-x[0], -x[1], -x[2]]);
        let found = StarAngle.predict(&x, &StarGiven { star, sigma: 1.0 })[0];
        assert!((found - angle(&star, &nadir)).abs() < 1e-7);
        // precise where a cosine is not
        let near = unit(std::array::from_fn(|i| nadir[i] + 1e-6 * tangents(&nadir)[0][i]));
        let small = StarAngle.predict(&x, &StarGiven { star: near, sigma: 1.0 })[0];
        assert!((small - 1e-6).abs() < 1e-15, "{small:e}");
    }
}

/// Generalised least squares on the angles themselves, with their full covariance.
fn reference(stars: &[[f64; 3]], angles: &[f64], own: f64, shared: f64, start: [f64; 3]) -> ([f64; 3], DMatrix<f64>) {
    let n = stars.len();
    let mut nadir = start;
    let mut cov = DMatrix::zeros(2, 2);
    for _ in 0..10 {
        let axes = tangents(&nadir);
        let e = DMatrix::from_fn(n, 2, |k, j| -dot3(&stars[k], &axes[j]) / angle(&stars[k], &nadir).sin());
        let r = DMatrix::identity(n, n) * (own * own) + &e * e.transpose() * (shared * shared);
        let weight = r.try_inverse().unwrap();
        let left = DVector::from_fn(n, |k, _| angles[k] - angle(&stars[k], &nadir));
        cov = (e.transpose() * &weight * &e).try_inverse().unwrap();
        let step = &cov * e.transpose() * weight * left;
        nadir = unit(std::array::from_fn(|i| nadir[i] + step[0] * axes[0][i] + step[1] * axes[1][i]));
    }
    (nadir, cov)
}

#[test]
fn combined_angles_lose_nothing() {
    let mut normal = normals(5);
    let mut compared = 0;
    for round in 0..200 {
        let nadir = random_unit(&mut normal);
        let stars: Vec<[f64; 3]> = (0..2 + round % 7).map(|_| random_unit(&mut normal)).collect();
        let (own, shared) = (1.5e-5, if round % 2 == 0 { 3.5e-4 } else { 0.0 });
        let angles: Vec<f64> = stars.iter().map(|s| angle(s, &nadir) + 3e-4 * normal()).collect();
        // two stars fit a direction and its mirror image in their plane: only a near guess tells them apart
        let near = if stars.len() == 2 { 1e-4 } else { 0.02 };
        let guess: [f64; 3] = std::array::from_fn(|i| nadir[i] + near * normal());
        let (direction, cov) = reference(&stars, &angles, own, shared, nadir);
        // stars in one plane with the nadir say little across it
        if cov.trace() - 2.0 * shared * shared > 20.0 * own * own {
            continue;
        }
        compared += 1;
        let found = combine(&stars, &angles, own, shared, &guess).unwrap();
        for i in 0..3 {
            assert!((found.direction[i] - direction[i]).abs() < 1e-10, "{:?} {direction:?}", found.direction);
        }
        let axes = tangents(&direction);
        for (i, j, c) in [(0, 0, found.noise[0]), (0, 1, found.noise[1]), (1, 1, found.noise[2])] {
            let turned: f64 = (0..2)
                .flat_map(|a| (0..2).map(move |b| (a, b)))
                .map(|(a, b)| dot3(&found.axes[i], &axes[a]) * cov[(a, b)] * dot3(&found.axes[j], &axes[b]))
                .sum();
            assert!((c - turned).abs() < 1e-6 * (cov[(0, 0)] + cov[(1, 1)]), "{c:e} {turned:e}");
        }
    }
    assert!(compared > 120, "{compared}");
}

#[test]
fn stars_that_fix_no_direction_are_refused() {
    let up = [0.0, 0.0, 1.0];
    for stars in [vec![], vec![[1.0, 0.0, 0.0]], vec![[1.0, 0.0, 0.0], unit([1.0, 0.0, 1.0]), unit([-1.0, 0.0, 0.3])]] {
        let angles: Vec<f64> = stars.iter().map(|s| angle(s, &up)).collect();
        assert!(combine(&stars, &angles, 1e-5, 0.0, &up).is_err(), "{stars:?}");
    }
    assert!(combine(&[[1.0, 0.0, 0.0]], &[], 1e-5, 0.0, &up).is_err());
}

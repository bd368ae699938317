//! Star angles: derivatives, and the fitted nadir against least squares with the full covariance.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::horizon::{
    AngleNoise, AngleSeries, Epochs, Expected, Fitted, NadirPlane, PlaneGiven, Robust, Shape, StarAngle, StarGiven,
};
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::manifold::{Euclidean, Manifold};
use celestcore_core::model::Measurement;
use celestcore_core::quaternion::{cross, dot3, tangents};
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
        assert!(differs(&StarAngle::default(), &x, &StarGiven { star, sigma: 1e-4 }) < 1e-7 / sine.powi(2));
        let limb = StarAngle { limb: 6.4e6, ..StarAngle::default() };
        assert!(differs(&limb, &x, &StarGiven { star, sigma: 1e-4 }) < 1e-7 / sine.powi(2));
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
        let found = StarAngle::default().predict(&x, &StarGiven { star, sigma: 1.0 })[0];
        assert!((found - angle(&star, &nadir)).abs() < 1e-7);
        // the limb stands where a line of sight touches the sphere
        let limb = StarAngle { limb: 6.4e6, ..StarAngle::default() };
        let dip = limb.predict(&x, &StarGiven { star, sigma: 1.0 })[0] - found;
        assert!((dip + (6.4e6f64 / 7.1e6).asin()).abs() < 1e-12);
        // precise where a cosine is not
        let near = unit(std::array::from_fn(|i| nadir[i] + 1e-6 * tangents(&nadir)[0][i]));
        let small = StarAngle::default().predict(&x, &StarGiven { star: near, sigma: 1.0 })[0];
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

/// An epoch of these angles, and what it says.
fn fit(
    stars: &[[f64; 3]],
    angles: &[f64],
    noise: &AngleNoise,
    robust: Robust,
    expected: &Expected<f64>,
) -> Option<Fitted<f64>> {
    let t = vec![0.0; stars.len()];
    Epochs::new(&AngleSeries { t: &t, star: stars, angle: angles }).unwrap().fit(0, noise, robust, expected)
}

fn normal_noise(own: f64, shared: f64) -> AngleNoise {
    AngleNoise::new(own, shared, Shape::Normal).unwrap()
}

/// The direction that the angles give, on the side of a known one.
fn direction(fitted: &Fitted<f64>, near: &[f64; 3]) -> [f64; 3] {
    let [u, v] = &fitted.given.axes;
    let normal = cross(u, v);
    let side = dot3(&normal, near).signum();
    unit(std::array::from_fn(|i| side * normal[i] + fitted.value[0] * u[i] + fitted.value[1] * v[i]))
}

/// An expectation that says next to nothing.
fn vague(nadir: [f64; 3]) -> Expected<f64> {
    Expected { nadir, spread: from_fn(|i, j| if i == j { 1.0 } else { 0.0 }) }
}

#[test]
fn combined_angles_lose_nothing() {
    let mut normal = normals(5);
    let mut compared = 0;
    for round in 0..400 {
        let nadir = random_unit(&mut normal);
        let stars: Vec<[f64; 3]> = (0..2 + round % 19).map(|_| random_unit(&mut normal)).collect();
        let (own, shared) = (1.5e-5, if round % 2 == 0 { 3.5e-4 } else { 0.0 });
        let angles: Vec<f64> = stars.iter().map(|s| angle(s, &nadir) + 3e-4 * normal()).collect();
        // two stars fit a direction and its mirror image in their plane: only a near guess tells them apart
        let near = if stars.len() == 2 { 1e-4 } else { 0.02 };
        let guess: [f64; 3] = unit(std::array::from_fn(|i| nadir[i] + near * normal()));
        let (best, cov) = reference(&stars, &angles, own, shared, nadir);
        // stars in one plane with the nadir say little across it
        if cov.trace() - 2.0 * shared * shared > 20.0 * own * own {
            continue;
        }
        compared += 1;
        let expected = vague(guess);
        let found = fit(&stars, &angles, &normal_noise(own, shared), Robust::No, &expected).unwrap();
        assert_eq!((found.used, found.rank), (stars.len(), 2));
        // what is left of the last step is in the value
        let found_direction = direction(&found, &best);
        for i in 0..3 {
            assert!((found_direction[i] - best[i]).abs() < 1e-3 * own, "{found_direction:?} {best:?}");
        }
        let (axes, noise) = (tangents(&best), found.given.noise);
        for (i, j, c) in [(0, 0, noise[0]), (0, 1, noise[1]), (1, 1, noise[2])] {
            let turned: f64 = (0..2)
                .flat_map(|a| (0..2).map(move |b| (a, b)))
                .map(|(a, b)| dot3(&found.given.axes[i], &axes[a]) * cov[(a, b)] * dot3(&found.given.axes[j], &axes[b]))
                .sum();
            assert!((c - turned).abs() < 1e-5 * (cov[(0, 0)] + cov[(1, 1)]), "{c:e} {turned:e}");
        }
    }
    assert!(compared > 240, "{compared}");
}

#[test]
fn stars_in_a_plane_fix_one_direction_only() {
    let up = [0.0, 0.0, 1.0];
    let expected = vague(up);
    let noise = normal_noise(1e-5, 1e-4);
    for stars in [vec![[1.0, 0.0, 0.0]], vec![[1.0, 0.0, 0.0], unit([1.0, 0.0, 1.0]), unit([-1.0, 0.0, 0.3])]] {
        let tilted = unit([2e-4, 5e-4, 1.0]);
        let angles: Vec<f64> = stars.iter().map(|s| angle(s, &tilted)).collect();
        let found = fit(&stars, &angles, &noise, Robust::No, &expected).unwrap();
        assert_eq!((found.used, found.rank), (stars.len(), 1));
        let [first, second] = found.given.axes;
        assert!((first[0].abs() - 1.0).abs() < 1e-6 && (second[1].abs() - 1.0).abs() < 1e-6);
        // along the plane as good as the stars, across it as good as nothing
        let own = 1e-10 / stars.len() as f64;
        assert!((found.given.noise[0] - own - 1e-8).abs() < 1e-14, "{:?}", found.given.noise);
        assert!(found.given.noise[2] > 1e-2);
        let along = direction(&found, &up)[0];
        assert!((along - tilted[0]).abs() < 1e-7, "{along}");
    }
}

#[test]
fn two_stars_nearly_in_a_plane_with_the_nadir_do_not_lead_astray() {
    // both stars 3 degrees from the nadir's opposite, 1 degree from one line through it
    let tilt = 3f64.to_radians();
    let star = |azimuth: f64| [tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos()];
    let stars = [star(0.0), star(std::f64::consts::PI - 1f64.to_radians())];
    let noise = normal_noise(3.5e-4, 0.0);
    let sigma = 1e-5;
    let spread = from_fn(|i, j| if i == j { sigma * sigma } else { 0.0 });
    let nadir = [0.0, 0.0, -1.0];
    let (mut normal, mut squares) = (normals(8), 0.0);
    let (rounds, mut largest) = (400, 0.0f64);
    for _ in 0..rounds {
        let angles: Vec<f64> = stars.iter().map(|s| angle(s, &nadir) + 3.5e-4 * normal()).collect();
        let found = fit(&stars, &angles, &noise, Robust::No, &Expected { nadir, spread }).unwrap();
        let away = cross(&found.given.axes[0], &found.given.axes[1]);
        largest = largest.max(away[0].hypot(away[1]));
        let [aa, ab, bb] = found.given.noise;
        let [a, b] = found.value;
        squares += (bb * a * a - 2.0 * ab * a * b + aa * b * b) / (aa * bb - ab * ab);
    }
    // linearised within a few of the expectation's standard deviations
    assert!(largest < 5.0 * sigma, "{largest:e}");
    // chi-square with two degrees of freedom each, 3 standard deviations of the mean
    let mean = squares / f64::from(rounds);
    assert!((mean - 2.0).abs() < 3.0 * 2.0 / f64::from(rounds).sqrt(), "{mean}");
}

#[test]
fn an_angle_that_does_not_fit_its_prediction_is_left_out_or_counts_less() {
    let mut normal = normals(6);
    let nadir = random_unit(&mut normal);
    let stars: Vec<[f64; 3]> = (0..9).map(|_| random_unit(&mut normal)).collect();
    let noise = normal_noise(1e-4, 0.0);
    let mut angles: Vec<f64> = stars.iter().map(|s| angle(s, &nadir)).collect();
    angles[8] += 50e-4;
    // the prediction is as uncertain as an angle, so that its limits are √2 times as wide
    let spread = from_fn(|i, j| if i == j { 1e-8 } else { 0.0 });
    let expected = Expected { nadir, spread };
    let off = |robust| {
        let found = fit(&stars, &angles, &noise, robust, &expected).unwrap();
        let d = direction(&found, &nadir);
        let away = cross(&d, &nadir);
        (dot3(&away, &away).sqrt(), found.used)
    };
    let (all, used) = off(Robust::No);
    assert!(all > 2e-4 && used == 9);
    let (gated, used) = off(Robust::Gate(25.0));
    assert!(gated < 1e-7 && used == 8, "{gated:e} {used}");
    let (huber, used) = off(Robust::Huber(1.5));
    assert!(huber < 0.15 * all && huber > 1e-6 && used == 9, "{huber:e} {all:e}");
    angles.iter_mut().for_each(|a| *a += 1e-2);
    assert!(fit(&stars, &angles, &noise, Robust::Gate(25.0), &expected).is_none());
}

#[test]
fn the_density_of_an_epoch_is_that_of_its_joint_normal_distribution() {
    let mut normal = normals(7);
    for shared in [0.0, 3e-4] {
        let (own, nadir) = (2e-4, random_unit(&mut normal));
        let stars: Vec<[f64; 3]> = (0..5).map(|_| random_unit(&mut normal)).collect();
        let angles: Vec<f64> = stars.iter().map(|s| angle(s, &nadir) + own * normal()).collect();
        let epochs = Epochs::new(&AngleSeries { t: &[1.0; 5], star: &stars, angle: &angles }).unwrap();
        let noise = normal_noise(own, shared);
        let axes = tangents(&nadir);
        let e = DMatrix::from_fn(5, 2, |k, j| -dot3(&stars[k], &axes[j]) / angle(&stars[k], &nadir).sin());
        let r = DMatrix::identity(5, 5) * (own * own) + &e * e.transpose() * (shared * shared);
        let weight = r.try_inverse().unwrap();
        let expected = |at: &[f64; 3]| {
            let left = DVector::from_fn(5, |k, _| angles[k] - angle(&stars[k], at));
            -0.5 * (left.transpose() * &weight * &left)[0]
        };
        let found = |at: &[f64; 3]| -> f64 { epochs.log_density(0, &noise, at) };
        // but for a constant, and for how much the angles bend over 1e-4 rad
        let other = unit(std::array::from_fn(|i| nadir[i] + 1e-4 * axes[0][i] - 2e-4 * axes[1][i]));
        let (found, expected) = (found(&other) - found(&nadir), expected(&other) - expected(&nadir));
        assert!((found - expected).abs() < 3e-3 * expected.abs().max(1.0), "{shared} {found} {expected}");
    }
}

#[test]
fn shared_errors_leave_nothing_to_learn_but_the_direction() {
    // a star half a degree from the zenith, others further off; the horizon is wrong by 72 arcsec
    let star = |tilt: f64, azimuth: f64| [tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos()];
    let stars = [star(0.009, 0.3), star(0.05, 2.0), star(0.07, 4.0)];
    let noise = normal_noise(1.5e-5, 3.5e-4);
    let seen = unit([2.5e-4, -2.5e-4, -1.0]);
    let angles: Vec<f64> = stars.iter().map(|s| angle(s, &seen)).collect();
    let epochs = Epochs::new(&AngleSeries { t: &[1.0; 3], star: &stars, angle: &angles }).unwrap();
    for at in [[0.0, 0.0, -1.0], [1e-4, 2e-4, -1.0], [-3e-4, 1e-4, -1.0]] {
        let found: f64 = epochs.log_density(0, &noise, &unit(at));
        let off = [at[0] - 2.5e-4, at[1] + 2.5e-4];
        let expected = -0.5 * (off[0] * off[0] + off[1] * off[1]) / (3.5e-4f64 * 3.5e-4);
        assert!((found - expected).abs() < 0.02 * expected.abs().max(0.5), "{found} {expected}");
    }
}

#[test]
fn densities_are_those_of_their_names() {
    let sigma = 2e-4;
    let ratio = |shape: Shape, x: f64| (shape.log_density(x * sigma, sigma) - shape.log_density(0.0, sigma)).exp();
    // Student's t with 3 degrees of freedom and variance 1: scale 1/√3
    let t = |x: f64| (1.0 + x * x).powi(-2);
    for x in [0.0, 0.5, -2.0, 30.0] {
        assert!((ratio(Shape::StudentT { dof: 3.0 }, x) - t(x)).abs() < 1e-12 * t(x));
        assert!((ratio(Shape::Normal, x) - (-0.5 * x * x).exp()).abs() < 1e-12);
    }
    let uniform = Shape::Uniform { edge: 0.05 };
    assert_eq!((ratio(uniform, 1.7), ratio(uniform, -1.7)), (1.0, 1.0));
    let beyond = 3.0f64.sqrt() * 1.1;
    assert!((ratio(uniform, -beyond) - (-0.5f64 * 4.0).exp()).abs() < 1e-9);
}

#[test]
fn angles_that_cannot_be_are_refused() {
    let star = [1.0, 0.0, 0.0];
    let bad = |t: &[f64], star: &[[f64; 3]], angle: &[f64]| Epochs::new(&AngleSeries { t, star, angle }).is_err();
    assert!(bad(&[0.0], &[star], &[]));
    assert!(bad(&[0.0], &[[1.0, 0.1, 0.0]], &[1.0]));
    assert!(bad(&[0.0], &[star], &[4.0]));
    assert!(bad(&[0.0], &[star], &[f64::NAN]));
    assert!(bad(&[1.0, 0.0], &[star, star], &[1.0, 1.0]));
    assert!(bad(&[f64::NAN], &[star], &[1.0]));
    assert!(AngleNoise::new(0.0, 0.0, Shape::Normal).is_err());
    assert!(AngleNoise::new(1e-5, -1.0, Shape::Normal).is_err());
    assert!(AngleNoise::new(1e-5, 1e-4, Shape::StudentT { dof: 3.0 }).is_err());
    assert!(AngleNoise::new(1e-5, 0.0, Shape::StudentT { dof: 2.0 }).is_err());
    assert!(AngleNoise::new(1e-5, 0.0, Shape::Uniform { edge: 0.0 }).is_err());
}

//! Starlight refraction: published angles, derivatives, and the equations that define a ray.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::belief::Belief;
use celestcore_core::filter::{Ekf, Filter};
use celestcore_core::horizon::{
    Atmosphere, Bending, Ellipsoid, REFRACTIVITY, RefractionAngle, RefractionGiven, UnknownDensity, WithDensity,
};
use celestcore_core::linalg::from_fn;
use celestcore_core::manifold::{Euclidean, Manifold};
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::orbit::{ForceModel, Gravity, J2, OrbitModel};
use celestcore_core::quaternion::{cross, dot3};
use celestcore_core::scalar::{Lanes, Real};
use common::normals;

const ARCSEC: f64 = std::f64::consts::PI / 648_000.0;

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = dot3(&v, &v).sqrt();
    v.map(|c| c / n)
}

fn random_unit(normal: &mut impl FnMut() -> f64) -> [f64; 3] {
    unit(std::array::from_fn(|_| normal()))
}

/// A position 760 km up and a star whose straight line passes `height` above a sphere.
fn sight(height: f64, normal: &mut impl FnMut() -> f64) -> ([f64; 6], [f64; 3]) {
    let up = random_unit(normal);
    let ahead = unit(cross(&up, &random_unit(normal)));
    let sine = (6_378_137.0 + height) / 7.138e6;
    let star = std::array::from_fn(|i| ahead[i] * sine - up[i] * (1.0 - sine * sine).sqrt());
    let v: [f64; 3] = std::array::from_fn(|_| 7e3 * normal());
    ([up[0] * 7.138e6, up[1] * 7.138e6, up[2] * 7.138e6, v[0], v[1], v[2]], star)
}

#[test]
fn the_standard_atmosphere_has_the_published_densities() {
    // US Standard Atmosphere 1976, table I, geometric heights
    let air = Atmosphere::standard();
    for (height, density) in [
        (0.0, 1.2250),
        (5e3, 7.3643e-1),
        (10e3, 4.1351e-1),
        (15e3, 1.9476e-1),
        (20e3, 8.8910e-2),
        (25e3, 4.0084e-2),
        (30e3, 1.8410e-2),
        (40e3, 3.9957e-3),
        (50e3, 1.0269e-3),
        (60e3, 3.0968e-4),
        (70e3, 8.2829e-5),
        (80e3, 1.8458e-5),
        (86e3, 6.958e-6),
    ] {
        let found = air.density(height);
        assert!((found / density - 1.0).abs() < 2e-4, "{height}: {found:e}");
    }
    // and a like order where the standard is no more a sum of layers
    for (height, density) in [(100e3, 5.604e-7), (120e3, 2.222e-8)] {
        assert!((air.density(height) / density).ln().abs() < 0.35, "{height}: {:e}", air.density(height));
    }
}

#[test]
fn rays_are_bent_by_the_published_angles() {
    let bending = Bending::standard();
    for (height, arcsec, digit) in
        [(20e3, 334.0, 1.0), (25e3, 149.0, 1.0), (30e3, 67.6, 0.1), (40e3, 14.1, 0.1), (50e3, 3.4, 0.1)]
    {
        let found = bending.at(height).angle[0] / ARCSEC;
        assert!((found - arcsec).abs() < 0.5 * digit, "{height}: {found}");
        assert!((bending.height(found * ARCSEC) - height).abs() < 1e-6);
    }
}

#[test]
fn the_table_follows_the_integral() {
    let bending = Bending::standard();
    // geometric heights where the temperature's gradient jumps: just below, the bending has a vertical tangent
    let jumps = [11.019e3, 20.063e3, 32.162e3, 47.350e3, 51.413e3, 71.802e3, 86e3];
    for i in 0..400 {
        let height = 1e3 + 2.71e2 * f64::from(i);
        let integral = bending.atmosphere().bending(height, 6_378_137.0);
        let wrong = (bending.at(height).angle[0] / integral - 1.0).abs();
        let near = jumps.iter().any(|j| (height - j).abs() < 600.0);
        let tolerance = if !near {
            3e-5
        } else if height < 12e3 {
            1e-2
        } else {
            1.2e-3
        };
        assert!(wrong < tolerance, "{height} {wrong:e}");
        let air = REFRACTIVITY * bending.atmosphere().density(height);
        // the temperature's gradient jumps between layers; in heights that is below 3 cm from 20 km on
        let tolerance = if height < 12e3 { 1e-3 } else { 4e-4 };
        assert!((bending.at(height).refractivity[0] / air - 1.0).abs() < tolerance, "{height}");
        for (f, h) in [(0, 0.5), (1, 0.5)] {
            let pick = |at: f64| if f == 0 { bending.at(at).angle } else { bending.at(at).refractivity };
            let slope = (pick(height + h)[0] - pick(height - h)[0]) / (2.0 * h);
            assert!((pick(height)[1] / slope - 1.0).abs() < 1e-5, "{height} {f}");
        }
    }
}

/// Exponential air bends a ray by `2 b/H N K0(b/H) e^(b/H)` to first order in `N` (Goody 1963): asymptotic series of `K0`.
#[test]
fn exponential_air_bends_as_in_the_closed_form() {
    let (h, rho) = (7000.0, 1e-4f64);
    let height: Vec<f64> = (0..140).map(|i| 1e3 * f64::from(i)).collect();
    let density: Vec<f64> = height.iter().map(|z| rho * (-z / h).exp()).collect();
    let air = Atmosphere::table(&height, &density).unwrap();
    for z in [20e3, 35e3, 50.5e3] {
        let x = (6_378_137.0 + z) / h;
        let bessel = (std::f64::consts::PI / (2.0 * x)).sqrt() * (1.0 - 1.0 / (8.0 * x) + 9.0 / (128.0 * x * x));
        let closed = 2.0 * x * REFRACTIVITY * rho * (-z / h).exp() * bessel;
        assert!((air.bending(z, 6_378_137.0) / closed - 1.0).abs() < 2e-6, "{z}");
    }
}

#[test]
fn a_ray_solves_its_equations() {
    let sensor = RefractionAngle::standard(Ellipsoid::SPHERE);
    let mut normal = normals(1);
    for i in 0..600 {
        let (x, star) = sight(-20e3 + 200.0 * f64::from(i), &mut normal);
        let r = [x[0], x[1], x[2]];
        let ray = sensor.ray(&r, &star, 1.0);
        let level = sensor.bending.at(ray.height);
        assert!((ray.angle / level.angle[0] - 1.0).abs() < 1e-10);
        let u = -dot3(&r, &star);
        let b = (dot3(&r, &r) - u * u).sqrt() * ray.angle.cos() + u * ray.angle.sin();
        let lowest = (1.0 + level.refractivity[0]) * (6_378_137.0 + ray.height);
        assert!((b - lowest).abs() < 1e-6 * (1.0 + u * ray.angle), "{i} {}", b - lowest);
    }
}

/// Derivative of the angle by differences, rad/m.
fn difference(sensor: &RefractionAngle, x: &[f64; 6], given: &RefractionGiven<f64>, j: usize, h: f64) -> f64 {
    let image = |h: f64| {
        let mut d = [0.0; 6];
        d[j] = h;
        sensor.predict(&Euclidean::<6>::retract(x, &d), given)[0]
    };
    (8.0 * (image(h) - image(-h)) - (image(2.0 * h) - image(-2.0 * h))) / (12.0 * h)
}

#[test]
fn the_jacobian_is_the_derivative() {
    let mut normal = normals(2);
    for (oblate, tolerance) in [(false, 1e-7), (true, 3e-5)] {
        for i in 0..200 {
            let (x, star) = sight(12e3 + 200.0 * f64::from(i), &mut normal);
            let earth = if oblate { Ellipsoid::wgs84(random_unit(&mut normal)) } else { Ellipsoid::SPHERE };
            let sensor = RefractionAngle::standard(earth);
            let given = RefractionGiven { star, sigma: 1e-5, density: 0.0 };
            let h = sensor.jacobian(&x, &given);
            let largest = h.abs().max();
            for j in 0..6 {
                let by = difference(&sensor, &x, &given, j, 2.0);
                assert!((h[(0, j)] - by).abs() < tolerance * largest, "{i} {j} {:e} {by:e}", h[(0, j)]);
            }
            let r = [x[0], x[1], x[2]];
            let ray = sensor.ray(&r, &star, 1.0);
            let denser = |s: f64| sensor.ray(&r, &star, s).angle;
            let by = (denser(1.001) - denser(0.999)) / (1.001f64 / 0.999).ln();
            assert!((ray.by_density / by - 1.0).abs() < 1e-5);
            assert!(ray.by_density < ray.angle && ray.by_density > 0.2 * ray.angle);
        }
    }
}

#[test]
fn lanes_are_numbers_side_by_side() {
    type Eight = Lanes<false>;
    let mut normal = normals(3);
    let sights: Vec<_> = (0..8).map(|i| sight(5e3 + 6e3 * f64::from(i), &mut normal)).collect();
    let sensor = RefractionAngle::standard(Ellipsoid::wgs84(unit([1e-3, -2e-3, 1.0])));
    let x: [Eight; 6] = std::array::from_fn(|j| Eight::from_lanes(|i| sights[i].0[j]));
    let star: [Eight; 3] = std::array::from_fn(|j| Eight::from_lanes(|i| sights[i].1[j]));
    let ray = sensor.ray(&[x[0], x[1], x[2]], &star, Eight::one());
    for (i, (x, star)) in sights.iter().enumerate() {
        let alone = sensor.ray(&[x[0], x[1], x[2]], star, 1.0);
        assert_eq!(ray.angle.lane(i), alone.angle);
        assert_eq!(ray.height.lane(i), alone.height);
        assert_eq!(ray.by_position[2].lane(i), alone.by_position[2]);
    }
}

#[test]
fn any_line_of_sight_has_an_answer() {
    let sensor = RefractionAngle::standard(Ellipsoid::SPHERE);
    let mut normal = normals(4);
    let mut before = f64::INFINITY;
    // from through the Earth's centre up to straight across: the lower, the more bent
    for i in 1..1000 {
        let sine = f64::from(i) / 1000.0;
        let ray = sensor.ray(&[0.0, 0.0, 7.138e6], &[sine, 0.0, -(1.0 - sine * sine).sqrt()], 1.0);
        assert!(ray.angle.is_finite() && ray.angle > 0.0 && ray.angle < before, "{sine} {ray:?}");
        assert!(ray.by_position.iter().all(|c| c.is_finite()) && ray.by_density >= 0.0);
        before = ray.angle;
    }
    for _ in 0..100 {
        let (x, star) = sight(100e3, &mut normal);
        let ahead = star.map(|c| -c);
        let ray = sensor.ray(&[x[0], x[1], x[2]], &ahead, 1.0);
        assert_eq!((ray.angle, ray.by_position, ray.by_density), (0.0, [-0.0; 3], 0.0));
    }
    assert!(sensor.ray(&[f64::NAN, 0.0, 0.0], &[1.0, 0.0, 0.0], 1.0).angle.is_nan());
}

#[test]
fn a_flattened_earth_is_a_sphere_where_it_has_no_flattening() {
    let mut normal = normals(5);
    let round = Ellipsoid { second_eccentricity2: 0.0, ..Ellipsoid::wgs84(unit([0.3, 0.2, 0.9])) };
    for i in 0..50 {
        let (x, star) = sight(20e3 + 500.0 * f64::from(i), &mut normal);
        let r = [x[0], x[1], x[2]];
        let ray = |earth| RefractionAngle::standard(earth).ray(&r, &star, 1.0);
        let (one, other) = (ray(round), ray(Ellipsoid::SPHERE));
        assert!((one.angle / other.angle - 1.0).abs() < 1e-9);
    }
    let flat = RefractionAngle::standard(Ellipsoid::wgs84([0.0, 0.0, 1.0]));
    let sine: f64 = 6_408_137.0 / 7.138e6;
    let cosine = (1.0 - sine * sine).sqrt();
    let height = |sensor: &RefractionAngle, r, star| sensor.ray(&r, &star, 1.0).height;
    let sphere = RefractionAngle::standard(Ellipsoid::SPHERE);
    let east = ([7.138e6, 0.0, 0.0], [-cosine, sine, 0.0]);
    assert!((height(&flat, east.0, east.1) - height(&sphere, east.0, east.1)).abs() < 1e-6);
    // over the pole the ground has the curvature a²/b and the height b: what is left is what refraction lifts
    let over = ([7.138e6 * cosine, 0.0, 7.138e6 * sine], [-1.0, 0.0, 0.0]);
    let ray = flat.ray(&over.0, &over.1, 1.0);
    let lift = 7.138e6 * cosine * ray.angle - 0.5 * 6.451e6 * ray.angle.powi(2);
    let air = flat.bending.at(ray.height).refractivity[0] * 6.451e6;
    assert!((ray.height - (6_408_137.0 - 6_356_752.314) - lift + air).abs() < 0.01, "{ray:?} {lift} {air}");
}

#[test]
fn air_that_is_none_is_refused() {
    for (height, density) in [
        (vec![0.0, 1e4], vec![1.2, 0.4]),
        (vec![0.0, 1e4, 1e4], vec![1.2, 0.4, 0.3]),
        (vec![0.0, 1e4, 2e4], vec![1.2, 0.4, 0.5]),
        (vec![0.0, 1e4, 2e4], vec![1.2, 0.4]),
        (vec![0.0, 1e4, 2e4], vec![1.2, 0.4, -0.1]),
        (vec![0.0, 1e4, f64::NAN], vec![1.2, 0.4, 0.1]),
        (vec![0.0, 1e4, 2e4], vec![1.2e9, 0.4e9, 0.1e9]),
    ] {
        assert!(Atmosphere::table(&height, &density).is_err());
    }
}

/// An EKF on refractions all around, of air 1 % too dense: what it makes of the density, and its position.
#[test]
fn the_air_s_density_is_found_with_the_orbit() {
    let mut normal = normals(6);
    let force = ForceModel::new(
        Gravity::J2(J2::new(3.986004415e14, 6_378_136.3, 1.082636e-3).unwrap()),
        [false; 2],
        None,
        None,
        None,
    );
    let orbit = OrbitModel::new(force.unwrap(), 1e-10, 30.0).unwrap();
    let dynamics = WithDensity { orbit: orbit.clone(), sigma: 0.02, memory: 1e9 };
    let sensor = RefractionAngle::standard(Ellipsoid::SPHERE);
    let through = UnknownDensity(sensor.clone());
    let stars: Vec<[f64; 3]> = (0..4000).map(|_| random_unit(&mut normal)).collect();
    let (mut truth, speed) = ([7.138e6, 0.0, 0.0, 0.0, 0.0, 0.0], 7.46e3f64);
    (truth[4], truth[5]) = (speed * 0.42, speed * 0.907);
    let sigmas = [1e3, 1e3, 1e3, 1.0, 1.0, 1.0, 0.02];
    let start: [f64; 7] = std::array::from_fn(|i| if i < 6 { truth[i] + sigmas[i] * normal() } else { 0.0 });
    let p = from_fn(|i, j| if i == j { sigmas[i] * sigmas[i] } else { 0.0 });
    let (mut known, _) = Ekf::default().belief::<Euclidean<7>, f64, 7>(start, &p);
    let six = std::array::from_fn(|i| start[i]);
    let (mut blind, _) = Ekf::default().belief::<Euclidean<6>, f64, 6>(six, &from_fn(|i, j| p[(i, j)]));
    let (mut error, mut blind_error, mut n) = (0.0, 0.0, 0.0);
    for k in 1..=400 {
        let (t, dt) = (15.0 * f64::from(k - 1), 15.0);
        truth = orbit.step(&truth, &(), t, dt);
        assert!(Ekf::default().predict(&mut known, &dynamics, &(), t, dt));
        assert!(Ekf::default().predict(&mut blind, &orbit, &(), t, dt));
        let r = [truth[0], truth[1], truth[2]];
        for star in &stars {
            let ray = sensor.ray(&r, star, 1.01);
            if !(ray.height > 20e3 && ray.height < 50e3) {
                continue;
            }
            let given = RefractionGiven { star: *star, sigma: 3.0 * ARCSEC, density: 0.0 };
            let z = [ray.angle + 3.0 * ARCSEC * normal()];
            Ekf::default().update::<_, f64, 7, 1>(&mut known, &through, &given, &z, f64::INFINITY);
            let given = RefractionGiven { density: 0.01 * ray.by_density, ..given };
            Ekf::default().update::<_, f64, 6, 1>(&mut blind, &sensor, &given, &z, f64::INFINITY);
        }
        if k > 200 {
            let off = |x: &[f64]| (0..3).map(|i| (x[i] - truth[i]).powi(2)).sum::<f64>();
            (error, blind_error, n) = (error + off(known.mean()), blind_error + off(blind.mean()), n + 1.0);
        }
    }
    let (density, sigma) = (known.mean()[6], known.covariance()[(6, 6)].sqrt());
    assert!(sigma < 1e-3 && (density - 0.01).abs() < 4.0 * sigma, "{density} {sigma}");
    let (error, blind_error) = ((error / n).sqrt(), (blind_error / n).sqrt());
    assert!(error < 0.6 * blind_error, "{error} {blind_error}");
}

#[test]
fn the_density_has_the_derivatives_it_says() {
    let mut normal = normals(7);
    let sensor = UnknownDensity(RefractionAngle::standard(Ellipsoid::SPHERE));
    for i in 0..50 {
        let (x, star) = sight(15e3 + 600.0 * f64::from(i), &mut normal);
        let state: [f64; 7] = std::array::from_fn(|i| if i < 6 { x[i] } else { 0.03 });
        let given = RefractionGiven { star, sigma: 1e-5, density: 0.0 };
        let h = sensor.jacobian(&state, &given);
        let image = |d: f64| sensor.predict(&std::array::from_fn(|i| if i < 6 { x[i] } else { 0.03 + d }), &given)[0];
        assert!((h[(0, 6)] / ((image(1e-4) - image(-1e-4)) / 2e-4) - 1.0).abs() < 1e-6);
        let six = sensor.0.ray(&[x[0], x[1], x[2]], &star, 1.03).by_position;
        assert_eq!([h[(0, 0)], h[(0, 1)], h[(0, 2)], h[(0, 4)]], [six[0], six[1], six[2], 0.0]);
    }
}

#[test]
fn denser_is_lower_all_the_way() {
    let bending = Bending::standard();
    let mut before = f64::INFINITY;
    for i in -400..6000 {
        let level = bending.at(25.0 * f64::from(i));
        assert!(level.angle[0] < before && level.angle[1] < 0.0, "{i}");
        before = level.angle[0];
    }
    // lines over any latitude and at all heights have a ray that solves them
    let mut normal = normals(8);
    for i in 0..4000 {
        let (x, star) = sight(-30e3 + 25.0 * f64::from(i), &mut normal);
        let ray = RefractionAngle::standard(Ellipsoid::wgs84(random_unit(&mut normal))).ray(
            &[x[0], x[1], x[2]],
            &star,
            1.0 + 0.01 * normal(),
        );
        assert!(ray.height.is_finite() && ray.angle > 0.0 && ray.by_density > 0.0, "{i} {ray:?}");
    }
}

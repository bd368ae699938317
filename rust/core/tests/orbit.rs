//! Orbit dynamics: closed forms, derivatives against differences, lanes against scalars, order of the
//! integrators. The references from other packages stand in the Python tests.
#![allow(clippy::unwrap_used)]

use celestcore_core::linalg::Matrix;
use celestcore_core::model::Dynamics;
use celestcore_core::orbit::{
    Drag, Environment, Field, ForceModel, Gravity, J2, Method, OrbitModel, SolarPressure, Tables, harris_priester,
    propagate, sunlight,
};
use celestcore_core::scalar::{Lanes, Real};
use celestcore_core::{Error, Result};
use std::sync::Arc;

const MU: f64 = 3.986_004_415e14;
const RE: f64 = 6_378_136.3;
const J: f64 = 1.082_636_022_983e-3;

fn j2() -> J2 {
    J2::new(MU, RE, J).unwrap()
}

/// Coefficients of the size of the Earth's, the same at every call.
fn coefficients(degree: usize) -> (Vec<f64>, Vec<f64>) {
    let mut seed = 12_345u64;
    let mut next = move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let (mut c, mut s) = (vec![], vec![]);
    for n in 0..=degree {
        for m in 0..=n {
            let size = 2e-5 / (n * n).max(1) as f64;
            c.push(if n == 2 && m == 0 { -J / 5f64.sqrt() } else { size * next() });
            s.push(if m == 0 { 0.0 } else { size * next() });
        }
    }
    (c, s)
}

fn field(degree: usize, order: usize) -> Gravity {
    let (c, s) = coefficients(degree);
    Gravity::Field(Arc::new(Field::new(MU, RE, degree, order, &c, &s).unwrap()))
}

/// A Sun in the plane of the equator, a Moon above it, a pole off the z axis.
fn environment() -> Arc<Environment> {
    let earth_t: Vec<f64> = (0..40).map(|k| -7200.0 + 3600.0 * k as f64).collect();
    let body_t: Vec<f64> = (0..24).map(|k| -14_400.0 + 7200.0 * k as f64).collect();
    let cip: Vec<_> = earth_t.iter().map(|t| [7e-4 + 1e-12 * t, 3e-5, 1e-8]).collect();
    let pole = vec![[1e-6, 2e-6]; 40];
    let turn = |t: &f64, rate: f64, r: f64, z: f64| [r * (rate * t).cos(), r * (rate * t).sin(), z];
    let sun: Vec<_> = body_t.iter().map(|t| turn(t, 2e-7, 1.496e11, 0.0)).collect();
    let moon: Vec<_> = body_t.iter().map(|t| turn(t, 2.66e-6, 3.8e8, 1e8)).collect();
    Arc::new(
        Environment::new(&Tables {
            earth_t: &earth_t,
            cip: &cip,
            pole: &pole,
            sp: &[0.0; 40],
            ut1: [2_454_283.0, 0.0],
            dut1: &[0.0; 40],
            body_t: &body_t,
            sun: &sun,
            moon: &moon,
        })
        .unwrap(),
    )
}

fn everything(degree: usize) -> ForceModel {
    let srp = SolarPressure { cr: 1.3, area_to_mass: 0.02, pressure: 4.56e-6 };
    let drag = Drag { cd: 2.2, area_to_mass: 0.02, lag: std::f64::consts::FRAC_PI_6, exponent: 6.0 };
    ForceModel::new(field(degree, degree), [true; 2], Some(srp), Some(drag), Some(environment())).unwrap()
}

fn start() -> [f64; 6] {
    let (r, v) = (7.0e6f64, (MU / 7.0e6f64).sqrt());
    let (s, c) = (65f64.to_radians().sin(), 65f64.to_radians().cos());
    [0.8 * r, 0.6 * r * c, 0.6 * r * s, -0.6 * v, 0.8 * v * c, 0.8 * v * s]
}

fn distance(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

fn run(force: &ForceModel, t: &[f64], method: Method) -> Vec<[f64; 6]> {
    propagate(force, &start(), t, method, false, &mut |_| Ok(())).unwrap().state
}

fn check_gradient(force: &ForceModel, t: f64, x: &[f64; 6], tolerance: f64) {
    let at = force.moment(t);
    let at_state = |y: &[f64; 6]| force.acceleration(&at, &[y[0], y[1], y[2]], &[y[3], y[4], y[5]]);
    let g = force.gradient(&at, &[x[0], x[1], x[2]], &[x[3], x[4], x[5]]);
    let plain = at_state(x);
    for i in 0..3 {
        assert!((plain[i] - g.acceleration[i]).abs() <= 4e-15, "{plain:?} {:?}", g.acceleration);
    }
    for j in 0..6 {
        let h = if j < 3 { 20.0 } else { 30.0 };
        let moved = |k: f64| {
            let mut y = *x;
            y[j] += k * h;
            at_state(&y)
        };
        let (m2, m1, p1, p2) = (moved(-2.0), moved(-1.0), moved(1.0), moved(2.0));
        for i in 0..3 {
            let found = (8.0 * (p1[i] - m1[i]) - (p2[i] - m2[i])) / (12.0 * h);
            let made = if j < 3 { g.by_position[(i, j)] } else { g.by_velocity.map_or(0.0, |d| d[(i, j - 3)]) };
            let scale = if j < 3 { MU / 7.0e6f64.powi(3) } else { 1e-8 };
            assert!((found - made).abs() < tolerance * scale, "({i}, {j}): {found} {made}");
        }
    }
}

#[test]
fn gradients_are_the_derivatives_of_the_accelerations() {
    let x = start();
    check_gradient(&ForceModel::gravity(Gravity::TwoBody { mu: MU }).unwrap(), 0.0, &x, 1e-9);
    check_gradient(&ForceModel::gravity(Gravity::J2(j2())).unwrap(), 0.0, &x, 1e-9);
    for degree in [2, 8, 21] {
        let force = ForceModel::new(field(degree, degree), [true; 2], None, None, Some(environment())).unwrap();
        check_gradient(&force, 500.0, &x, 1e-9);
    }
    check_gradient(&everything(8), 500.0, &x, 1e-8);
}

#[test]
fn light_falls_from_one_to_zero_and_its_slope_is_its_derivative() {
    let sun = [1.496e11, 0.0, 0.0];
    let at = |y: f64| sunlight(&sun, &[-2.6e6, y, 1.2e6]);
    let (mut before, mut partial) = (0.0, 0);
    for k in 0..400 {
        let y = 6.2e6 + 500.0 * f64::from(k);
        let (light, slope) = at(y);
        assert!(light >= before, "{y}");
        before = light;
        if light > 0.01 && light < 0.99 {
            partial += 1;
            let difference = (at(y + 1.0).0 - at(y - 1.0).0) / 2.0;
            assert!((difference - slope[1]).abs() < 1e-6 * difference, "{difference} {slope:?}");
        }
    }
    assert!(before == 1.0 && at(5e6).0 == 0.0 && partial > 20, "{partial}");
    assert_eq!(sunlight(&sun, &[2.6e6, 6.5e6, 0.0]).0, 1.0);
}

#[test]
fn drag_opposes_the_wind_and_fades_above_a_thousand_kilometres() {
    assert!((harris_priester(100e3)[0] / 4.974e-7 - 1.0).abs() < 1e-12);
    let [low, high, ..] = harris_priester(300e3);
    assert!((low / 1.708e-11 - 1.0).abs() < 1e-12 && (high / 3.526e-11 - 1.0).abs() < 1e-12);
    // exponential between the rows
    let middle = harris_priester(310e3)[0];
    assert!((middle / (1.708e-11f64 * 1.099e-11).sqrt() - 1.0).abs() < 1e-12);
    assert_eq!(harris_priester(1000.1e3), [0.0; 4]);
    assert!(harris_priester(f64::NAN)[0].is_nan());
    for h in [119.9e3, 120.1e3, 299e3, 301e3, 799e3, 801e3, 999e3] {
        let (a, b) = (harris_priester(h - 1.0), harris_priester(h + 1.0));
        let g = harris_priester(h);
        for k in 0..2 {
            assert!(((b[k] - a[k]) / 2.0 / g[k + 2] - 1.0).abs() < 1e-6, "{h}");
        }
    }
}

#[test]
fn a_field_of_one_zonal_is_the_closed_form() {
    let c = [1.0, 0.0, 0.0, -J / 5f64.sqrt(), 0.0, 0.0];
    let field = Field::new(MU, RE, 2, 2, &c, &[0.0; 6]).unwrap();
    for r in [[7e6, 1e5, -2e6], [0.0, 0.0, 7e6], [0.0, 0.0, -6.6e6], [1e-3, 0.0, 7e6], [6.9e6, 0.0, 0.0]] {
        let whole = j2().acceleration(&r);
        let radius = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sqrt();
        let made = field.acceleration(&r);
        for i in 0..3 {
            let point = -MU * r[i] / radius.powi(3);
            assert!((made[i] + point - whole[i]).abs() < 4e-15, "{r:?}");
        }
    }
}

#[test]
fn lanes_compute_what_scalars_do() {
    let (force, x) = (everything(21), start());
    let one = force.acceleration(&force.moment(900.0), &[x[0], x[1], x[2]], &[x[3], x[4], x[5]]);
    let times = [900.0, 0.0, 3e3, 900.0, 7.2e3, 1e4, 5.0, 900.0];
    for mixed in [false, true] {
        let t = Lanes::<false>::from_lanes(|i| if mixed { times[i] } else { 900.0 });
        let y = x.map(Lanes::<false>::splat);
        let at = force.moment(t);
        let many = force.acceleration(&at, &[y[0], y[1], y[2]], &[y[3], y[4], y[5]]);
        let slope = force.gradient(&at, &[y[0], y[1], y[2]], &[y[3], y[4], y[5]]);
        for lane in 0..8 {
            let alone = force.acceleration(&force.moment(t.lane(lane)), &[x[0], x[1], x[2]], &[x[3], x[4], x[5]]);
            for i in 0..3 {
                assert!((many[i].lane(lane) - alone[i]).abs() < 4e-15);
                assert!((slope.acceleration[i].lane(lane) - alone[i]).abs() < 4e-15);
                assert_eq!(times[lane] == 900.0 || !mixed, alone[i] == one[i]);
            }
        }
    }
}

#[test]
fn rk4_is_of_fourth_order_and_keeps_energy_and_momentum() {
    let force = ForceModel::gravity(Gravity::TwoBody { mu: MU }).unwrap();
    let period = std::f64::consts::TAU * (7.0e6f64.powi(3) / MU).sqrt();
    let mut errors = vec![];
    for step in [60.0, 30.0, 15.0] {
        let end = run(&force, &[0.0, period], Method::Rk4 { step: period / (period / step).ceil() });
        errors.push(distance(&end[1], &start()));
        let y = end[1];
        let energy = |y: &[f64; 6]| {
            let (r, v) = (distance(y, &[0.0; 6]), y[3] * y[3] + y[4] * y[4] + y[5] * y[5]);
            v / 2.0 - MU / r
        };
        // on a circle a step turns by w: an orbit loses 2π w⁵ / 36 of its energy, half of that in momentum
        let turn = std::f64::consts::TAU / (period / step).ceil();
        let expected = std::f64::consts::TAU * turn.powi(5) / 36.0;
        let drift = (energy(&y) / energy(&start()) - 1.0).abs();
        assert!((drift / expected - 1.0).abs() < 3e-3, "{step}: {drift} {expected}");
        let momentum = |y: &[f64; 6]| y[0] * y[4] - y[1] * y[3];
        let drift = (momentum(&y) / momentum(&start()) - 1.0).abs();
        assert!((2.0 * drift / expected - 1.0).abs() < 3e-3, "{step}: {drift} {expected}");
    }
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((3.8..4.4).contains(&order), "{errors:?}");
    }
}

#[test]
fn dop853_agrees_with_many_rk4_steps_also_between_its_own() {
    let force = everything(8);
    let t: Vec<f64> = (0..=600).map(|k| f64::from(k) * 10.0).collect();
    let tight = run(&force, &t, Method::Dop853 { rtol: 1e-13, step: f64::INFINITY });
    let small = run(&force, &t, Method::Rk4 { step: 1.0 });
    for (a, b) in tight.iter().zip(&small) {
        assert!(distance(a, b) < 2e-5, "{}", distance(a, b));
    }
    // dense output against steps that end at every output
    let short = run(&force, &t, Method::Dop853 { rtol: 1e-13, step: 10.0 });
    for (a, b) in tight.iter().zip(&short) {
        assert!(distance(a, b) < 2e-5, "{}", distance(a, b));
    }
}

#[test]
fn dop853_returns_to_its_start_backwards() {
    let force = everything(8);
    let there = run(&force, &[0.0, 6000.0], Method::Dop853 { rtol: 1e-13, step: f64::INFINITY });
    let method = Method::Dop853 { rtol: 1e-13, step: f64::INFINITY };
    let back = propagate(&force, &there[1], &[6000.0, 3000.0, 0.0], method, false, &mut |_| Ok(())).unwrap();
    assert!(distance(&back.state[2], &start()) < 2e-5, "{}", distance(&back.state[2], &start()));
}

#[test]
fn two_body_orbits_close() {
    let force = ForceModel::gravity(Gravity::TwoBody { mu: MU }).unwrap();
    let period = std::f64::consts::TAU * (7.0e6f64.powi(3) / MU).sqrt();
    let end = run(&force, &[0.0, 10.0 * period], Method::Dop853 { rtol: 1e-13, step: f64::INFINITY });
    assert!(distance(&end[1], &start()) < 1e-4, "{}", distance(&end[1], &start()));
}

#[test]
fn the_state_transition_is_the_derivative_of_the_flow() {
    let force = everything(8);
    let t = [0.0, 1500.0, 5000.0];
    for method in [Method::Dop853 { rtol: 1e-13, step: f64::INFINITY }, Method::Rk4 { step: 20.0 }] {
        let out = propagate(&force, &start(), &t, method, true, &mut |_| Ok(())).unwrap();
        assert_eq!(out.stm[0][2], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        for j in 0..6 {
            // wide enough for the rounding of seven thousand kilometres not to show in the difference
            let h = if j < 3 { 30.0 } else { 3.0 };
            let moved = |k: f64| {
                let mut x = start();
                x[j] += k * h;
                propagate(&force, &x, &t, method, false, &mut |_| Ok(())).unwrap().state[2]
            };
            let (m2, m1, p1, p2) = (moved(-2.0), moved(-1.0), moved(1.0), moved(2.0));
            for i in 0..6 {
                let found = (8.0 * (p1[i] - m1[i]) - (p2[i] - m2[i])) / (12.0 * h);
                let scale = [10.0, 1e-2, 1e4, 10.0][usize::from(i > 2) + 2 * usize::from(j > 2)];
                assert!((found - out.stm[2][i][j]).abs() < 2e-6 * scale, "{i} {j}: {found} {}", out.stm[2][i][j]);
            }
        }
    }
}

/// The model without its analytic transition.
struct Plain<'a>(&'a OrbitModel);
impl Dynamics<6> for Plain<'_> {
    type Space = <OrbitModel as Dynamics<6>>::Space;
    type Input = <OrbitModel as Dynamics<6>>::Input;
    fn step<T: Real>(&self, x: &[T; 6], u: &(), t: T, dt: T) -> [T; 6] {
        // differences need larger steps than those of the space
        self.0.step(&x.map(|v| v), u, t, dt)
    }
    fn noise<T: Real>(&self, x: &[T; 6], u: &(), t: T, dt: T) -> Matrix<T, 6, 6> {
        self.0.noise(x, u, t, dt)
    }
}

#[test]
fn the_models_transition_is_the_derivative_of_its_step() {
    let model = OrbitModel::new(everything(8), 4e-7, 30.0).unwrap();
    let plain = Plain(&model);
    let x = start();
    let f = model.transition(&x, &(), 100.0, 60.0);
    for j in 0..6 {
        // wide enough for the rounding of seven thousand kilometres not to show in the difference
        let h = if j < 3 { 30.0 } else { 3.0 };
        let moved = |k: f64| {
            let mut y = x;
            y[j] += k * h;
            plain.step(&y, &(), 100.0, 60.0)
        };
        let (a, b) = (moved(-1.0), moved(1.0));
        for i in 0..6 {
            let found = (b[i] - a[i]) / (2.0 * h);
            assert!((found - f[(i, j)]).abs() < 1e-8 * f[(i, j)].abs().max(if i < 3 { 1.0 } else { 1e-3 }));
        }
    }
    let p = celestcore_core::linalg::identity();
    let (after, carried) = model.propagate(&x, &p, &(), 100.0, 60.0);
    let stepped = model.step(&x, &(), 100.0, 60.0);
    assert!(distance(&after, &stepped) < 1e-8);
    let (_, image, noise) = model.carry(&x, &p, &(), 100.0, 60.0);
    let sum = image * image.transpose() + noise;
    assert!((sum - carried).norm() < 1e-9 * carried.norm());
}

#[test]
fn the_models_noise_composes_over_steps() {
    let model = OrbitModel::new(ForceModel::gravity(Gravity::J2(j2())).unwrap(), 4e-7, 30.0).unwrap();
    let (x, q) = (start(), |dt| model.noise(&start(), &(), 0.0, dt));
    let free: Matrix<f64, 6, 6> = celestcore_core::linalg::from_fn(|i, j| {
        if i == j {
            1.0
        } else if j == i + 3 {
            2.0
        } else {
            0.0
        }
    });
    let composed: Matrix<f64, 6, 6> = free * q(1.0) * free.transpose() + q(2.0);
    assert!((composed - q(3.0)).norm() < 1e-18);
    assert_eq!(model.step(&x, &(), 0.0, 60.0), model.step(&model.step(&x, &(), 0.0, 30.0), &(), 30.0, 30.0));
}

fn fails<T>(made: Result<T>, what: &str) {
    let message = made.err().map(|e| e.to_string()).unwrap_or_default();
    assert!(message.contains(what), "{message:?} lacks {what:?}");
}

#[test]
fn what_cannot_be_used_is_refused() {
    let force = ForceModel::gravity(Gravity::J2(j2())).unwrap();
    let go = |x: [f64; 6], t: &[f64], m| propagate(&force, &x, t, m, false, &mut |_| Ok(()));
    let rk4 = Method::Rk4 { step: 10.0 };
    fails(go([7e3, 0.0, 0.0, 0.0, 7.5, 0.0], &[0.0, 1.0], rk4), "inside the Earth");
    fails(go(start(), &[], rk4), "t is empty");
    fails(go(start(), &[0.0, 2.0, 1.0, 3.0], rk4), "t row 2");
    fails(go(start(), &[0.0, 1.0], Method::Rk4 { step: 0.0 }), "step");
    fails(go(start(), &[0.0, 1.0], Method::Dop853 { rtol: 1e-17, step: 10.0 }), "rtol");
    let mut falling = start();
    falling[3..].fill(0.0);
    let dop = Method::Dop853 { rtol: 1e-12, step: f64::INFINITY };
    assert!(matches!(go(falling, &[0.0, 3000.0], dop), Err(Error::Impact { .. })));
    assert!(matches!(go(falling, &[0.0, 3000.0], Method::Rk4 { step: 1.0 }), Err(Error::Impact { .. })));
    fails(ForceModel::gravity(field(4, 4)), "environment is empty");
    fails(Field::new(MU, RE, 71, 2, &[], &[]), "degree");
    fails(Field::new(MU, RE, 2, 3, &[], &[]), "order");
    fails(Field::new(MU, RE, 2, 2, &[0.0; 5], &[0.0; 6]), "c has 5 rows");
    let far = propagate(&everything(4), &start(), &[0.0, 1e6], dop, false, &mut |_| Ok(()));
    fails(far, "outside the environment");
    let stopped = propagate(&everything(4), &start(), &[0.0, 1e4], dop, false, &mut |_| Err(Error::Interrupted));
    fails(stopped, "interrupted");
}

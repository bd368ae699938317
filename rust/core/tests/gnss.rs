//! Orbits from fixes and attitudes without a gyro: laws, derivatives, consistency.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{Attitude, AttitudeBias, GyroInput, GyroModel, Pointing, PointingModel, PointingSpace};
use celestcore_core::augmented::{Augmented, Fading, Joined, JoinedSpace};
use celestcore_core::filter::{Ekf, Filter, Ukf, Unscented};
use celestcore_core::gnss::{
    AttitudeFix, AttitudeFixes, AttitudeJob, AttitudeModel, AxisFixes, AxisModel, FixGiven, History, Options,
    OrbitFilter, OrbitFixes, OrbitJob, PositionFix, Seeing, Stops, VelocityFix, attitude, axis, orbit,
};
use celestcore_core::linalg::{Matrix, congruence, identity, zeros};
use celestcore_core::manifold::{Euclidean, Family, Manifold};
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::orbit::{ForceModel, Gravity, J2, Nothing, OrbitModel};
use celestcore_core::quaternion::{Integrator, difference, exp, multiply};
use celestcore_core::scalar::{Level, Real};
use common::{close, normals, spd};

type Slow = JoinedSpace<PointingSpace, 9, 2, 15>;
type Body = Joined<Pointing<f64>, f64, 2>;

fn turned(normal: &mut impl FnMut() -> f64) -> [f64; 4] {
    exp(&[normal(), normal(), normal()])
}

fn three(normal: &mut impl FnMut() -> f64, scale: f64) -> [f64; 3] {
    [normal() * scale, normal() * scale, normal() * scale]
}

fn pointing(normal: &mut impl FnMut() -> f64) -> Pointing<f64> {
    Pointing { q: turned(normal), rate: three(normal, 1e-2), acceleration: three(normal, 1e-3) }
}

fn body(normal: &mut impl FnMut() -> f64) -> Body {
    Joined { head: pointing(normal), tail: [three(normal, 1e-2), three(normal, 1e-2)] }
}

#[test]
fn a_joined_space_obeys_the_laws_of_a_manifold() {
    let mut normal = normals(11);
    for round in 0..200 {
        let reach = if round % 2 == 0 { 0.5 } else { 1e-3 };
        let (x, z) = (body(&mut normal), body(&mut normal));
        let d: [f64; 15] = std::array::from_fn(|_| normal() * reach);
        let y = Slow::retract(&x, &d);
        for (a, b) in Slow::local(&x, &y).iter().zip(&d) {
            assert!((a - b).abs() < 1e-12, "local undoes retract: {a} {b}");
        }
        let there = Slow::local(&z, &Slow::retract(&x, &Slow::local(&x, &z)));
        assert!(there.iter().all(|c| c.abs() < 1e-12), "retract undoes local: {there:?}");

        let j = Slow::reset(&x, &d);
        let h = 1e-6;
        let mut differences: Matrix<f64, 15, 15> = zeros();
        for k in 0..15 {
            let image = |e: f64| {
                let mut moved = d;
                moved[k] += e;
                Slow::local(&y, &Slow::retract(&x, &moved))
            };
            let (plus, minus) = (image(h), image(-h));
            for i in 0..15 {
                differences[(i, k)] = (plus[i] - minus[i]) / (2.0 * h);
            }
        }
        close(&j, &differences, 1e-8);
        let p = spd::<15>(&mut normal, 1.0);
        let carried = Slow::transport(&x, &d, &p);
        close(&carried, &congruence(&j, &p), 1e-12);
        assert_eq!(carried, carried.transpose());
        close(&Slow::transport_factor(&x, &d, &p), &(j * p), 1e-12);
        let back = Slow::transport_back(&x, &d, &carried);
        close(&back, &p, 1e-11 * p.abs().max());
        let mut columns = [d.map(|c| c.stack())];
        Slow::carry_columns::<f64>(&x, &d, &mut columns);
        let expected = j * Matrix::<f64, 15, 1>::from_column_slice(&d);
        for i in 0..15 {
            assert!((f64::extract(columns[0][i], 3) - expected[i]).abs() < 1e-12);
        }
    }
}

/// The step itself, with the traits' differences as its derivative.
struct Plain<D>(D);

macro_rules! plain {
    ($model:ty, $space:ty, $input:ty, $n:expr) => {
        impl Dynamics<$n> for Plain<$model> {
            type Space = $space;
            type Input = $input;
            fn step<T: Real>(
                &self,
                x: &<$space as Family>::Of<T>,
                u: &<$input as Family>::Of<T>,
                t: T,
                dt: T,
            ) -> <$space as Family>::Of<T> {
                self.0.step(x, u, t, dt)
            }
            fn noise<T: Real>(
                &self,
                x: &<$space as Family>::Of<T>,
                u: &<$input as Family>::Of<T>,
                t: T,
                dt: T,
            ) -> Matrix<T, $n, $n> {
                self.0.noise(x, u, t, dt)
            }
        }
    };
}

type SlowPointing = Augmented<PointingModel, 9, 2, 15>;
type BiasedOrbit = Augmented<OrbitModel, 6, 1, 9>;
plain!(PointingModel, PointingSpace, Nothing, 9);
plain!(SlowPointing, Slow, Nothing, 15);
plain!(BiasedOrbit, JoinedSpace<Euclidean<6>, 6, 1, 9>, Nothing, 9);

fn slow_pointing() -> SlowPointing {
    let fades = [Fading { rate: 0.0, sigma: 0.0 }, Fading { rate: 0.01, sigma: 0.3 }];
    Augmented::new(PointingModel::new(1e-8).unwrap(), fades)
}

fn low_orbit(accel_psd: f64) -> OrbitModel {
    let j2 = J2::new(3.986004418e14, 6_378_137.0, 1.0826e-3).unwrap();
    OrbitModel::new(ForceModel::gravity(Gravity::J2(j2)).unwrap(), accel_psd, 10.0).unwrap()
}

#[test]
fn transitions_are_the_derivatives_of_the_steps() {
    let mut normal = normals(12);
    for _ in 0..50 {
        let x = pointing(&mut normal);
        let model = PointingModel::new(1e-8).unwrap();
        let (exact, numerical) = (model.transition(&x, &(), 0.0, 7.0), Plain(model).transition(&x, &(), 0.0, 7.0));
        close(&exact, &numerical, 1e-5);
        let x = body(&mut normal);
        let model = slow_pointing();
        close(&model.transition(&x, &(), 0.0, 7.0), &Plain(slow_pointing()).transition(&x, &(), 0.0, 7.0), 1e-5);
        let x = Joined { head: [7e6, 1e5, -2e5, 100.0, 7.5e3, -300.0], tail: [three(&mut normal, 3.0)] };
        let orbit = || BiasedOrbit::new(low_orbit(1e-6), [Fading { rate: 1.0 / 1800.0, sigma: 1.0 }]);
        let (exact, numerical) =
            (orbit().transition(&x, &(), 0.0, 10.0), Plain(orbit()).transition(&x, &(), 0.0, 10.0));
        // differences over 1e-5 m of numbers of 1e7 m: four digits
        close(&exact, &numerical, 2e-3);
    }
}

#[test]
fn a_joined_step_is_its_parts() {
    let mut normal = normals(13);
    let model = slow_pointing();
    for _ in 0..50 {
        let x = body(&mut normal);
        let p = spd::<15>(&mut normal, 1.0);
        let (f, q) = (model.transition(&x, &(), 0.0, 7.0), model.noise(&x, &(), 0.0, 7.0));
        let (mean, cov) = model.propagate(&x, &p, &(), 0.0, 7.0);
        assert_eq!(mean, model.step(&x, &(), 0.0, 7.0));
        let expected = congruence(&f, &p) + q;
        close(&cov, &expected, 1e-10 * expected.abs().max());
        assert_eq!(cov, cov.transpose());
        let (carried, image, rest) = model.carry(&x, &p, &(), 0.0, 7.0);
        assert_eq!(carried, mean);
        close(&image, &(f * p), 1e-10 * image.abs().max());
        close(&rest, &q, 0.0);
        let root = model.noise_factor(&x, &(), 0.0, 7.0);
        close(&(root * root.transpose()), &q, 1e-12);
    }
}

/// A fading error keeps its variance: what is left of it and what is added make up for each other.
#[test]
fn a_fading_error_is_stationary() {
    let model = BiasedOrbit::new(low_orbit(0.0), [Fading { rate: 1.0 / 1800.0, sigma: 2.0 }]);
    let x = Joined { head: [7e6, 0.0, 0.0, 0.0, 7.5e3, 0.0], tail: [[0.0; 3]] };
    let mut p: Matrix<f64, 9, 9> = identity();
    for i in 6..9 {
        p[(i, i)] = 4.0;
    }
    for dt in [1e-3, 10.0, 5000.0] {
        let (_, after) = model.propagate(&x, &p, &(), 0.0, dt);
        for i in 6..9 {
            assert!((after[(i, i)] - 4.0).abs() < 1e-12);
        }
    }
}

/// Against many small steps with the rate of their middle; both take the same acceleration.
#[test]
fn an_accelerated_turn_is_that_of_many_small_ones() {
    let mut normal = normals(14);
    let model = PointingModel::new(0.0).unwrap();
    for _ in 0..50 {
        let x =
            Pointing { q: turned(&mut normal), rate: three(&mut normal, 5e-3), acceleration: three(&mut normal, 5e-4) };
        let off = |dt: f64| {
            let (n, mut q) = (20_000, x.q);
            for k in 0..n {
                let t = (k as f64 + 0.5) * dt / n as f64;
                let rate: [f64; 3] = std::array::from_fn(|i| (x.rate[i] + x.acceleration[i] * t) * dt / n as f64);
                q = multiply(&q, &exp(&rate));
            }
            let after = model.step(&x, &(), 0.0, dt);
            for i in 0..3 {
                assert!((after.rate[i] - x.rate[i] - x.acceleration[i] * dt).abs() < 1e-15);
            }
            difference(&q, &after.q).iter().map(|c| c * c).sum::<f64>().sqrt()
        };
        // what Magnus' series leaves out is of the order of the fifth power of the step
        let (long, short) = (off(10.0), off(5.0));
        assert!(long < 2e-5 && short < 1e-6, "{long} {short}");
        assert!(short < long / 20.0 + 1e-11, "{long} {short}");
    }
}

/// White jerk over a step, cut into small steps of white jerk.
#[test]
fn white_jerk_adds_up() {
    let model = PointingModel::new(3e-5).unwrap();
    let still = Pointing { q: [1.0, 0.0, 0.0, 0.0], rate: [0.0; 3], acceleration: [0.0; 3] };
    let whole = model.noise(&still, &(), 0.0, 12.0);
    let mut sum: Matrix<f64, 9, 9> = zeros();
    for _ in 0..48 {
        let f = model.transition(&still, &(), 0.0, 0.25);
        sum = congruence(&f, &sum) + model.noise(&still, &(), 0.0, 0.25);
    }
    close(&whole, &sum, 1e-12 * whole.abs().max());
    let axis = AxisModel { jerk_psd: 3e-5 }.noise(&[0.0; 3], &(), 0.0, 12.0);
    for i in 0..3 {
        for j in 0..3 {
            assert!((axis[(i, j)] - whole[(3 * i, 3 * j)]).abs() < 1e-15 * whole.abs().max());
        }
    }
}

#[test]
fn jacobians_are_derivatives() {
    let mut normal = normals(15);
    for _ in 0..50 {
        let x = body(&mut normal);
        let given = FixGiven { noise: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0], weights: [normal(), normal()] };
        let sensor = Seeing::<AttitudeFix<PointingSpace, 9>, 2, 15>::new();
        let exact = sensor.jacobian(&x, &given);
        let origin = sensor.predict(&x, &given);
        for k in 0..15 {
            let image = |h: f64| {
                let mut d = [0.0; 15];
                d[k] = h;
                sensor.residual(&sensor.predict(&Slow::retract(&x, &d), &given), &origin)
            };
            let (plus, minus) = (image(1e-5), image(-1e-5));
            for i in 0..3 {
                assert!((exact[(i, k)] - (plus[i] - minus[i]) / 2e-5).abs() < 1e-8);
            }
        }
        let orbit = Joined { head: std::array::from_fn(|_| normal()), tail: [three(&mut normal, 1.0)] };
        let noise = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0];
        let (position, velocity) = (Seeing::<PositionFix, 1, 9>::new(), Seeing::<VelocityFix, 1, 9>::new());
        let d: [f64; 9] = std::array::from_fn(|_| normal());
        let moved = JoinedSpace::<Euclidean<6>, 6, 1, 9>::retract(&orbit, &d);
        let column = Matrix::<f64, 9, 1>::from_column_slice(&d);
        let r = position.residual(&position.predict(&moved, &noise), &position.predict(&orbit, &noise));
        let v = velocity.residual(&velocity.predict(&moved, &noise), &velocity.predict(&orbit, &noise));
        let (hr, hv) = (position.jacobian(&orbit, &noise) * column, velocity.jacobian(&orbit, &noise) * column);
        for i in 0..3 {
            assert!((r[i] - hr[i]).abs() < 1e-12 && (v[i] - hv[i]).abs() < 1e-12);
        }
    }
}

const GOOD: Options = Options { gate: 1.0, back: false, level: Level::Portable };

struct Orbit {
    t: Vec<f64>,
    truth: Vec<[f64; 6]>,
    z: Vec<[f64; 3]>,
    noise: Vec<[f64; 6]>,
}

/// An orbit with white accelerations as the filter believes, and positions of 2 m noise.
fn flown(n: usize, seed: u64, accel_psd: f64) -> Orbit {
    let mut normal = normals(seed);
    let model = low_orbit(accel_psd);
    let mut x = [7e6, 0.0, 0.0, 0.0, 4e3, 6.4e3];
    let mut made = Orbit { t: vec![], truth: vec![], z: vec![], noise: vec![] };
    for k in 0..n {
        if k > 0 {
            x = model.step(&x, &(), 0.0, 10.0);
            let root = model.noise_factor(&x, &(), 0.0, 10.0);
            let e = root * Matrix::<f64, 6, 1>::from_fn(|_, _| normal());
            for i in 0..6 {
                x[i] += e[i];
            }
        }
        made.t.push(k as f64 * 10.0);
        made.truth.push(x);
        made.z.push(std::array::from_fn(|i| x[i] + 2.0 * normal()));
        made.noise.push([4.0, 0.0, 0.0, 4.0, 0.0, 4.0]);
    }
    made
}

fn nees<const N: usize>(state: &[f64], truth: &[f64; 6], covariance: &[f64]) -> f64 {
    let e = Matrix::<f64, 6, 1>::from_fn(|i, _| truth[i] - state[i]);
    let p = Matrix::<f64, 6, 6>::from_fn(|i, j| covariance[N * i + j]);
    (e.transpose() * p.try_inverse().unwrap() * e)[(0, 0)]
}

#[test]
fn orbit_filters_and_their_smoother_are_consistent() {
    let (runs, n) = (40, 60);
    let ukf = Ukf { weights: Unscented::new(1.0, 2.0, None).unwrap() };
    let filters = [OrbitFilter::Ekf(Ekf::default()), OrbitFilter::Ukf(ukf)];
    for filter in filters {
        for back in [false, true] {
            let mut all = vec![];
            for seed in 0..runs {
                let made = flown(n, 100 + seed, 1e-4);
                let dynamics = low_orbit(1e-4);
                let mut start = made.truth[0];
                let mut normal = normals(900 + seed);
                let mut p = vec![0.0; 36];
                for i in 0..6 {
                    let sigma = if i < 3 { 30.0 } else { 1.0 };
                    start[i] += sigma * normal();
                    p[7 * i] = sigma * sigma;
                }
                let (wanted, velocity) = (vec![true; n], vec![false; n]);
                let job = OrbitJob {
                    filter,
                    dynamics: &dynamics,
                    bias: None,
                    stops: Stops { t: &made.t, wanted: &wanted, gyro: &[] },
                    fixes: OrbitFixes { t: &made.t, velocity: &velocity, value: &made.z, noise: &made.noise },
                    options: Options { back, ..GOOD },
                };
                let mut history = History { with_covariance: true, ..History::default() };
                orbit(job, (0.0, &start, &p), &mut history, &mut |_| Ok(())).unwrap();
                assert_eq!(history.t, made.t);
                let sum: f64 = (0..n)
                    .map(|k| nees::<6>(&history.state[6 * k..], &made.truth[k], &history.covariance[36 * k..]))
                    .sum();
                all.push(sum / n as f64);
            }
            let mean = all.iter().sum::<f64>() / runs as f64;
            let spread = (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (runs * (runs - 1)) as f64).sqrt();
            assert!((mean - 6.0).abs() < 4.0 * spread, "{filter:?} back {back}: {mean} +- {spread}");
        }
    }
}

/// The augmented covariance of the slow error: NEES of all states of the attitude filter, forward and back.
#[test]
fn attitude_filters_with_a_slow_error_are_consistent() {
    let (runs, n, sigma, prior) = (40u64, 80, 1e-4, 5e-5);
    for back in [false, true] {
        let mut all = vec![];
        for seed in 0..runs {
            let mut normal = normals(500 + seed);
            let model = PointingModel::new(1e-13).unwrap();
            let q0 = turned(&mut normal);
            let mut truth = Pointing { q: q0, rate: three(&mut normal, 1e-4), acceleration: three(&mut normal, 1e-6) };
            let slow = [three(&mut normal, prior), three(&mut normal, prior)];
            let (mut t, mut q, mut noise, mut weights, mut states) = (vec![], vec![], vec![], vec![], vec![]);
            for k in 0..n {
                let at = 10.0 * f64::from(k);
                if k > 0 {
                    truth = model.step(&truth, &(), 0.0, 10.0);
                    let root = model.noise_factor(&truth, &(), 0.0, 10.0);
                    let e = root * Matrix::<f64, 9, 1>::from_fn(|_, _| normal());
                    truth = PointingSpace::retract(&truth, &std::array::from_fn(|i| e[i]));
                }
                let w = [(0.01 * at).cos(), (0.01 * at).sin()];
                let b: [f64; 3] = std::array::from_fn(|i| w[0] * slow[0][i] + w[1] * slow[1][i] + sigma * normal());
                t.push(at);
                q.push(multiply(&truth.q, &exp(&b)));
                noise.push([sigma * sigma, 0.0, 0.0, sigma * sigma, 0.0, sigma * sigma]);
                weights.extend(w);
                states.push(truth);
            }
            let mut start = vec![0.0; 16];
            let begin = multiply(&states[0].q, &exp(&three(&mut normal, 1e-2)));
            start[..4].copy_from_slice(&begin);
            start[4..7].copy_from_slice(&[1e-4 * normal(), 1e-4 * normal(), 1e-4 * normal()]);
            for (i, v) in states[0].rate.iter().enumerate() {
                start[4 + i] += v;
            }
            for (i, v) in states[0].acceleration.iter().enumerate() {
                start[7 + i] = v + 1e-6 * normal();
            }
            let mut p = vec![0.0; 225];
            for i in 0..15 {
                let s = [1e-2, 1e-4, 1e-6, prior, prior][i / 3];
                p[16 * i] = s * s;
            }
            let wanted = vec![true; n as usize];
            let job = AttitudeJob {
                model: AttitudeModel::Kinematic(model),
                tail: &[Fading::default(), Fading::default()],
                stops: Stops { t: &t, wanted: &wanted, gyro: &[] },
                fixes: AttitudeFixes { t: &t, q: &q, noise: &noise, weights: &weights },
                options: Options { back, ..GOOD },
            };
            let mut history = History { with_covariance: true, ..History::default() };
            attitude(job, (0.0, &start, &p), &mut history, &mut |_| Ok(())).unwrap();
            let mut sum = 0.0;
            for k in 0..n as usize {
                let s = &history.state[16 * k..16 * (k + 1)];
                let estimate = Joined {
                    head: Pointing {
                        q: std::array::from_fn(|i| s[i]),
                        rate: std::array::from_fn(|i| s[4 + i]),
                        acceleration: std::array::from_fn(|i| s[7 + i]),
                    },
                    tail: [std::array::from_fn(|i| s[10 + i]), std::array::from_fn(|i| s[13 + i])],
                };
                let e = Slow::local(&estimate, &Joined { head: states[k], tail: slow });
                let covariance = Matrix::<f64, 15, 15>::from_fn(|i, j| history.covariance[225 * k + 15 * i + j]);
                let e = Matrix::<f64, 15, 1>::from_column_slice(&e);
                let solved = covariance.cholesky().unwrap().solve(&e);
                sum += e.dot(&solved);
            }
            all.push(sum / f64::from(n));
        }
        let mean = all.iter().sum::<f64>() / runs as f64;
        let spread = (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (runs * (runs - 1)) as f64).sqrt();
        assert!((mean - 15.0).abs() < 4.0 * spread, "back {back}: {mean} +- {spread}");
    }
}

/// With a gyro the augmented filter without a slow error is the MEKF of the attitude module, to rounding.
#[test]
fn without_a_slow_error_the_gyro_mode_is_the_plain_filter() {
    let log = common::made(200, 3);
    let start = common::start(&log);
    let gyro: Vec<[f64; 4]> = log.rate.iter().map(|w| [w[0], w[1], w[2], 0.0]).collect();
    let wanted = vec![true; log.t.len()];
    let job = AttitudeJob {
        model: AttitudeModel::Gyro(GyroModel::new(common::ARW, common::RRW, Integrator::Exponential).unwrap()),
        tail: &[],
        stops: Stops { t: &log.t, wanted: &wanted, gyro: &gyro },
        fixes: AttitudeFixes { t: &log.star_t[1..], q: &log.star_q[1..], noise: &log.noise[1..], weights: &[] },
        options: GOOD,
    };
    let state: Vec<f64> = start.mean.q.iter().chain(&start.mean.bias).copied().collect();
    let p: Vec<f64> = (0..36).map(|i| start.covariance[(i / 6, i % 6)]).collect();
    let mut history = History::default();
    let end = attitude(job, (0.0, &state, &p), &mut history, &mut |_| Ok(())).unwrap();
    let mut x = start.mean;
    let mut cov = start.covariance;
    let model = GyroModel::new(common::ARW, common::RRW, Integrator::Exponential).unwrap();
    let filter = Ekf::default();
    let mut belief = celestcore_core::belief::Gaussian::<AttitudeBias, f64, 6> { mean: x, cov };
    let mut fix = 1;
    for k in 0..log.t.len() - 1 {
        let u = GyroInput { rate: log.rate[k], extra: 0.0 };
        assert!(filter.predict(&mut belief, &model, &u, log.t[k], log.t[k + 1] - log.t[k]));
        if fix < log.star_t.len() && log.star_t[fix] == log.t[k + 1] {
            let given = log.noise[fix];
            let sensor = celestcore_core::attitude::StarQuaternion;
            filter.update::<_, f64, 6, 3>(&mut belief, &sensor, &given, &log.star_q[fix], f64::INFINITY);
            fix += 1;
        }
    }
    (x, cov) = (belief.mean, belief.cov);
    let last = Attitude { q: std::array::from_fn(|i| end.state[i]), bias: std::array::from_fn(|i| end.state[4 + i]) };
    assert!(AttitudeBias::local(&x, &last).iter().all(|c| c.abs() < 1e-12));
    for i in 0..36 {
        assert!((end.covariance[i] - cov[(i / 6, i % 6)]).abs() < 1e-12 * cov[(0, 0)].max(1e-12));
    }
}

#[test]
fn one_axis_smooths_a_parabola_exactly() {
    let t: Vec<f64> = (0..20).map(f64::from).collect();
    let value: Vec<f64> = t.iter().map(|t| 3.0 + 0.2 * t + 0.05 * t * t).collect();
    let (rate, variance, wanted) = (vec![false; 20], vec![1e-4; 20], vec![true; 20]);
    let fixes = AxisFixes { t: &t, rate: &rate, value: &value, variance: &variance, wraps: true };
    let mut history = History::default();
    let wide: Matrix<f64, 3, 3> = identity::<f64, 3>() * 100.0;
    let stops = Stops { t: &t, wanted: &wanted, gyro: &[] };
    axis(1e-12, (0.0, [3.0, 0.0, 0.0], wide), stops, fixes, &Options { back: true, ..GOOD }, &mut history).unwrap();
    for k in 0..20 {
        // angles come back whole turns apart or not at all
        let off = history.state[3 * k] - value[k];
        assert!((off / std::f64::consts::TAU).fract().abs() < 1e-3, "{off}");
    }
}

#[test]
fn faults_have_names() {
    let wanted = [true];
    let stops = Stops { t: &[0.0], wanted: &wanted, gyro: &[] };
    let fixes = AttitudeFixes { t: &[0.0], q: &[], noise: &[], weights: &[] };
    let model = AttitudeModel::Kinematic(PointingModel::new(1e-16).unwrap());
    let job = AttitudeJob { model, tail: &[], stops, fixes, options: GOOD };
    let error = attitude(job, (0.0, &[], &[]), &mut History::default(), &mut |_| Ok(())).unwrap_err();
    assert_eq!(error.to_string(), "star.q has 0 rows, but 1 are needed: all columns of one table have the same length");
    let empty = AttitudeFixes { t: &[], q: &[], noise: &[], weights: &[] };
    let many = [Fading::default(); 6];
    let job = AttitudeJob { model, tail: &many, stops, fixes: empty, options: GOOD };
    let error = attitude(job, (0.0, &[], &[]), &mut History::default(), &mut |_| Ok(())).unwrap_err();
    assert!(error.to_string().contains("two harmonics"), "{error}");
    assert!(PointingModel::new(-1.0).is_err());
}

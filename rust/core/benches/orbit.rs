//! Time per step, per right-hand side and per propagation of orbits.
//!
//! `cargo bench -p celestcore-core --bench orbit`
#![allow(clippy::unwrap_used)]

use celestcore_core::linalg::identity;
use celestcore_core::model::Dynamics;
use celestcore_core::orbit::{
    Drag, Environment, Field, ForceModel, Gravity, J2, Method, OrbitModel, SolarPressure, Tables, propagate,
};
use celestcore_core::scalar::{Level, Real, Run};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::sync::Arc;

const MU: f64 = 3.986_004_415e14;
const RE: f64 = 6_378_136.3;
const START: [f64; 6] = [7.1237e6, 0.0, 0.0, 0.0, 3.165e3, 6.787e3];
const MANY: usize = 1000;

fn field(degree: usize) -> Gravity {
    let size = (degree + 1) * (degree + 2) / 2;
    let mut c = vec![1e-7; size];
    c[3] = -4.841_695_484_56e-4;
    Gravity::Field(Arc::new(Field::new(MU, RE, degree, degree, &c, &vec![1e-7; size]).unwrap()))
}

fn environment() -> Arc<Environment> {
    let earth_t: Vec<f64> = (0..30).map(|k| -21_600.0 + 3600.0 * f64::from(k)).collect();
    let body_t: Vec<f64> = (0..20).map(|k| -21_600.0 + 7200.0 * f64::from(k)).collect();
    let turn = |t: &f64, rate: f64, r: f64| [r * (rate * t).cos(), r * (rate * t).sin(), 0.2 * r];
    Arc::new(
        Environment::new(&Tables {
            earth_t: &earth_t,
            cip: &[[7e-4, 3e-5, 1e-8]; 30],
            pole: &[[1e-6, 2e-6]; 30],
            sp: &[0.0; 30],
            ut1: [2_454_283.0, 0.0],
            dut1: &[0.0; 30],
            body_t: &body_t,
            sun: &body_t.iter().map(|t| turn(t, 2e-7, 1.5e11)).collect::<Vec<_>>(),
            moon: &body_t.iter().map(|t| turn(t, 2.7e-6, 3.8e8)).collect::<Vec<_>>(),
        })
        .unwrap(),
    )
}

fn forces() -> Vec<(&'static str, ForceModel)> {
    let srp = SolarPressure { cr: 1.0, area_to_mass: 0.02, pressure: 4.56e-6 };
    let drag = Drag { cd: 2.0, area_to_mass: 0.02, lag: std::f64::consts::FRAC_PI_6, exponent: 6.0 };
    let e = Some(environment());
    vec![
        ("j2", ForceModel::gravity(Gravity::J2(J2::new(MU, RE, 1.082_636e-3).unwrap())).unwrap()),
        ("8x8", ForceModel::new(field(8), [false; 2], None, None, e.clone()).unwrap()),
        ("21x21", ForceModel::new(field(21), [false; 2], None, None, e.clone()).unwrap()),
        ("everything", ForceModel::new(field(21), [true; 2], Some(srp), Some(drag), e).unwrap()),
    ]
}

/// Right-hand sides along a slightly moving state, `MANY` of them.
struct Sides<'a>(&'a ForceModel, bool);
impl Run for Sides<'_> {
    type Output = f64;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> f64 {
        let mut y = START.map(T::splat);
        for k in 0..MANY {
            let at = self.0.moment(T::splat(k as f64));
            let (r, v) = ([y[0], y[1], y[2]], [y[3], y[4], y[5]]);
            let a = if self.1 { self.0.gradient(&at, &r, &v).acceleration } else { self.0.acceleration(&at, &r, &v) };
            y[0] += a[0];
        }
        y[0].lane(0)
    }
}

/// Steps of a filter's dynamics: one at a time, with the covariance, or eight in lanes.
enum Kind {
    One,
    Covariance,
    Eight,
}
struct Steps<'a>(&'a OrbitModel, Kind);
impl Run for Steps<'_> {
    type Output = f64;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> f64 {
        let mut y = START.map(T::splat);
        let (t, dt) = (T::zero(), T::splat(3.0));
        match self.1 {
            Kind::One => {
                for _ in 0..MANY {
                    y = self.0.step(&y, &(), t, dt);
                }
            }
            Kind::Covariance => {
                let mut p = identity();
                for _ in 0..MANY {
                    (y, p) = self.0.propagate(&y, &p, &(), t, dt);
                }
                y[0] += p[(0, 0)];
            }
            Kind::Eight => {
                let mut x = START.map(|v| T::splat(v).stack());
                for _ in 0..MANY {
                    x = self.0.step(&x, &(), t.stack(), dt.stack());
                }
                y[0] = T::extract(x[0], 0);
            }
        }
        y[0].lane(0)
    }
}

fn kernels(c: &mut Criterion) {
    for (name, force) in forces() {
        let model = OrbitModel::new(force.clone(), 4e-7, 30.0).unwrap();
        let mut group = c.benchmark_group(format!("orbit/{name} (per 1000)"));
        group.bench_function("acceleration", |b| b.iter(|| Level::best().run(Sides(black_box(&force), false))));
        group.bench_function("gradient", |b| b.iter(|| Level::best().run(Sides(black_box(&force), true))));
        group.bench_function("rk4 step", |b| b.iter(|| Level::best().run(Steps(black_box(&model), Kind::One))));
        group.bench_function("rk4 step, covariance", |b| {
            b.iter(|| Level::best().run(Steps(black_box(&model), Kind::Covariance)));
        });
        group.bench_function("rk4 step, eight lanes", |b| {
            b.iter(|| Level::best().run(Steps(black_box(&model), Kind::Eight)));
        });
        group.finish();
    }
}

fn orbit(c: &mut Criterion) {
    let t: Vec<f64> = (0..=12_000).map(|k| 3.0 * f64::from(k)).collect();
    let method = Method::Dop853 { rtol: 1e-12, step: f64::INFINITY };
    let mut group = c.benchmark_group("600 min, 12001 rows");
    group.sample_size(20);
    for (name, force) in forces() {
        group.bench_function(name, |b| {
            b.iter(|| propagate(black_box(&force), &START, &t, method, false, &mut |_| Ok(())).unwrap());
        });
    }
    group.finish();
}

criterion_group!(benches, kernels, orbit);
criterion_main!(benches);

//! Time per gyro sample of the attitude kernels, arrays in memory, a star fix every second sample.
//!
//! `cargo bench -p celestcore-core`; `cargo bench` is always a release build.
#![allow(clippy::unwrap_used, clippy::panic)]

use celestcore_core::attitude::{
    AnyFilter, Attitude, AttitudeSensor, AttitudeSensors, Buffers, GyroModel, GyroSeries, GyroTiming, Log, Options,
    Sampling, StarSeries, rows, run,
};
use celestcore_core::filter::{Ekf, SrUkf, Ukf};
use celestcore_core::linalg::zeros;
use celestcore_core::quaternion::{Integrator, exp, multiply, propagate};
use celestcore_core::replay::{Output, Start};
use celestcore_core::scalar::Level;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use std::hint::black_box;

const N: usize = 10_000;
const DT: f64 = 0.01;
const ARW: f64 = 2.5e-5;
const RRW: f64 = 3.0e-7;
const SIGMA: f64 = 1.45e-4;

struct Made {
    t: Vec<f64>,
    rate: Vec<[f64; 3]>,
    star_t: Vec<f64>,
    star_q: Vec<[f64; 4]>,
    noise: Vec<[f64; 6]>,
}

fn log() -> Made {
    let mut rng = StdRng::seed_from_u64(20_240_607);
    let mut normal = move || -> f64 { rng.sample(StandardNormal) };
    let (mut q, mut bias) = ([1.0, 0.0, 0.0, 0.0], [1e-4, -2e-4, 1.5e-4]);
    let mut log = Made { t: vec![], rate: vec![], star_t: vec![], star_q: vec![], noise: vec![] };
    for k in 0..N {
        let t = k as f64 * DT;
        let truth = [0.02 * (0.1 * t).sin(), 0.02 * (0.13 * t).cos(), 0.01 * (0.07 * t).sin() + 0.01];
        if k % 2 == 0 {
            log.star_t.push(t);
            log.star_q.push(multiply(&q, &exp(&std::array::from_fn(|_| SIGMA * normal()))));
            log.noise.push([SIGMA * SIGMA, 0.0, 0.0, SIGMA * SIGMA, 0.0, SIGMA * SIGMA]);
        }
        for b in &mut bias {
            *b += RRW * DT.sqrt() * normal();
        }
        log.t.push(t);
        log.rate.push(std::array::from_fn(|i| truth[i] + bias[i] + ARW / DT.sqrt() * normal()));
        q = multiply(&q, &exp(&truth.map(|w| w * DT)));
    }
    log
}

fn start(log: &Made) -> Start<celestcore_core::attitude::AttitudeBias, 6> {
    let mut covariance = zeros();
    for i in 0..3 {
        covariance[(i, i)] = 1e-6;
        covariance[(i + 3, i + 3)] = 1e-7;
    }
    Start { t: 0.0, mean: Attitude { q: log.star_q[0], bias: [0.0; 3] }, covariance, used: Some(0) }
}

fn filters(c: &mut Criterion) {
    if cfg!(debug_assertions) {
        panic!("benchmarks need a release build: use cargo bench");
    }
    let log = log();
    let timing = GyroTiming { sampling: Sampling::Hold, max_gap: 1.0, gap_rate_sigma: 1e-3 };
    let gyro = GyroSeries { t: &log.t, rate: &log.rate, turn: None, timing };
    let stars = [AttitudeSensor::Star(StarSeries {
        t: &log.star_t,
        q: &log.star_q,
        noise: log.noise.as_slice().into(),
        mounting: None,
    })];
    let sensors = AttitudeSensors::new(&stars, 1.0).unwrap();
    let start = start(&log);

    let mut group = c.benchmark_group("replay");
    group.throughput(Throughput::Elements(N as u64));
    group.sample_size(20);
    for (name, filter, integrator) in [
        ("ekf", AnyFilter::Ekf(Ekf::default()), Integrator::Exponential),
        ("ukf-rk4", AnyFilter::Ukf(Ukf::default()), Integrator::Rk4),
        ("ukf-exponential", AnyFilter::Ukf(Ukf::default()), Integrator::Exponential),
        ("srukf-rk4", AnyFilter::SrUkf(SrUkf::default()), Integrator::Rk4),
    ] {
        let model = GyroModel::new(ARW, RRW, integrator).unwrap();
        for level in [Level::Portable, Level::Avx2] {
            if !level.available() {
                continue;
            }
            let options = Options { output: Output::Every(1), level };
            let mut buffers = Buffers::new(rows(&gyro, &sensors, &start, options.output).unwrap(), false);
            group.bench_function(format!("{name}/{level:?}"), |b| {
                b.iter(|| {
                    let (columns, measured) = buffers.columns();
                    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
                    run(&filter, log, black_box(&start), &options, columns, measured, &mut |_| Ok(())).unwrap()
                });
            });
        }
    }
    group.finish();
}

fn propagation(c: &mut Criterion) {
    let log = log();
    let mut out = vec![[0.0; 4]; N + 1];
    let mut group = c.benchmark_group("propagate");
    group.throughput(Throughput::Elements(N as u64));
    for integrator in [Integrator::Exponential, Integrator::Rk4] {
        group.bench_function(format!("{integrator:?}"), |b| {
            b.iter(|| propagate(&[1.0, 0.0, 0.0, 0.0], black_box(&log.rate), &[DT], integrator, black_box(&mut out)))
        });
    }
    group.finish();
}

criterion_group!(benches, propagation, filters);
criterion_main!(benches);

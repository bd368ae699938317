//! Logs side by side in lanes against logs one by one.
#![allow(clippy::unwrap_used, clippy::panic)]

use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, Attitude, AttitudeBias, AttitudeSensor, AttitudeSensors, Buffers, FixNoise, Flight, GyroModel,
    GyroSeries, GyroTiming, Log, Options, Sampling, StarSeries, rows, run, run_many,
};
use celestcore_core::filter::{Ekf, SrUkf, Ukf};
use celestcore_core::linalg::zeros;
use celestcore_core::quaternion::{Integrator, exp, multiply, renormalise};
use celestcore_core::replay::{End, Output, Start};
use celestcore_core::scalar::Level;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

const ARW: f64 = 2e-5;
const RRW: f64 = 3e-7;
const SIGMA: f64 = 1e-4;

/// One spacecraft's log.
struct Made {
    t: Vec<f64>,
    rate: Vec<[f64; 3]>,
    star_t: Vec<f64>,
    star_q: Vec<[f64; 4]>,
    first: [f64; 4],
}

/// A log of some length, period of fixes, rate of turn and offset of the fixes' times.
fn made(seed: u64, samples: usize, dt: f64, every: usize, turn: f64, offset: f64) -> Made {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut normal = move || -> f64 { rng.sample(StandardNormal) };
    let (mut q, bias) = ([1.0, 0.0, 0.0, 0.0], [1e-4, -2e-4, 1.5e-4]);
    let mut log = Made { t: vec![], rate: vec![], star_t: vec![], star_q: vec![], first: q };
    for k in 0..samples {
        let t = k as f64 * dt;
        let truth = [turn * (0.1 * t).sin(), turn, 0.5 * turn * (0.07 * t).cos()];
        if k % every == 0 {
            let there = multiply(&q, &exp(&truth.map(|w| w * offset)));
            log.star_t.push(t + offset);
            log.star_q.push(multiply(&there, &exp(&std::array::from_fn(|_| SIGMA * normal()))));
        }
        log.t.push(t);
        log.rate.push(std::array::from_fn(|i| truth[i] + bias[i] + ARW / dt.sqrt() * normal()));
        q = renormalise(&multiply(&q, &exp(&truth.map(|w| w * dt))));
    }
    log
}

fn start(log: &Made, sigma: f64) -> Start<AttitudeBias, 6> {
    let mut covariance = zeros();
    for i in 0..3 {
        covariance[(i, i)] = sigma * sigma;
        covariance[(i + 3, i + 3)] = 1e-6;
    }
    Start { t: 0.0, mean: Attitude { q: log.first, bias: [0.0; 3] }, covariance, used: None }
}

type Results = Vec<(Buffers, Result<End<AttitudeBias, 6>, Error>)>;

/// All logs in one call, or each in a call of its own.
fn replayed(
    filter: &AnyFilter,
    logs: &[(Made, f64)],
    every: usize,
    level: Level,
    gate: f64,
    together: bool,
) -> Results {
    let model = GyroModel::new(ARW, RRW, Integrator::Rk4).unwrap();
    let timing = GyroTiming { sampling: Sampling::Hold, max_gap: 10.0, gap_rate_sigma: 1e-3 };
    let options = Options { output: Output::Every(every), level };
    let gyros: Vec<_> = logs.iter().map(|(l, _)| GyroSeries { t: &l.t, rate: &l.rate, turn: None, timing }).collect();
    let noise = FixNoise::Same([SIGMA * SIGMA, 0.0, 0.0, SIGMA * SIGMA, 0.0, SIGMA * SIGMA]);
    let stars: Vec<_> = logs
        .iter()
        .map(|(l, _)| [AttitudeSensor::Star(StarSeries { t: &l.star_t, q: &l.star_q, noise, mounting: None })])
        .collect();
    let sensors: Vec<_> = stars.iter().map(|s| AttitudeSensors::new(s, gate).unwrap()).collect();
    let starts: Vec<_> = logs.iter().map(|(l, sigma)| start(l, *sigma)).collect();
    let mut buffers: Vec<_> = (0..logs.len())
        .map(|i| Buffers::new(rows(&gyros[i], &sensors[i], &starts[i], options.output).unwrap(), true))
        .collect();
    let log = |i: usize| Log { model: &model, gyro: &gyros[i], sensors: &sensors[i] };
    let ends = if together {
        let flights = buffers.iter_mut().zip(starts).enumerate().map(|(i, (b, start))| {
            let (columns, measured) = b.columns();
            Flight { log: log(i), start, columns, measured }
        });
        run_many(filter, flights.collect(), &options, &mut |_| Ok(())).unwrap()
    } else {
        let one = |(i, (b, start)): (usize, (&mut Buffers, Start<AttitudeBias, 6>))| {
            let (columns, measured) = b.columns();
            run(filter, log(i), &start, &options, columns, measured, &mut |_| Ok(()))
        };
        buffers.iter_mut().zip(starts).enumerate().map(one).collect()
    };
    buffers.into_iter().zip(ends).collect()
}

/// Logs of different lengths, rates, periods and phases: eleven of them, so that a second group is not full.
fn mixed() -> Vec<(Made, f64)> {
    (0..11)
        .map(|i| {
            let turn = if i == 3 { 4.0 } else { 0.01 * (1 + i) as f64 };
            let log =
                made(i as u64, 400 + 37 * i, 0.1 + 0.01 * (i % 3) as f64, 1 + i % 4, turn, 0.013 * (i % 2) as f64);
            (log, if i == 5 { 2.5 } else { 1e-2 })
        })
        .collect()
}

/// What rounding may change of a standard deviation: where the first fix takes most of a wide start away, the unscented
/// update subtracts, and loses digits as the variances are apart.
fn rounding(sigma0: f64, sigma: f64) -> f64 {
    1e-9 + 1e-15 * (sigma0 / sigma).powi(2)
}

fn filters() -> [AnyFilter; 3] {
    [AnyFilter::Ekf(Ekf::default()), AnyFilter::Ukf(Ukf::default()), AnyFilter::SrUkf(SrUkf::default())]
}

#[test]
fn lanes_agree_with_logs_one_by_one() {
    let logs = mixed();
    for filter in filters() {
        for every in [1, 7] {
            let alone = replayed(&filter, &logs, every, Level::best(), 1.0, false);
            let lanes = replayed(&filter, &logs, every, Level::best(), 1.0, true);
            for (((a, end_a), (b, end_b)), (_, sigma0)) in alone.iter().zip(&lanes).zip(&logs) {
                let (end_a, end_b) = (end_a.as_ref().unwrap(), end_b.as_ref().unwrap());
                assert_eq!((a.t.clone(), a.accepted.clone()), (b.t.clone(), b.accepted.clone()));
                assert_eq!((end_a.t, end_a.outside), (end_b.t, end_b.outside));
                for (p, q) in a.sigma.iter().zip(&b.sigma) {
                    for i in 0..6 {
                        assert!((p[i] / q[i] - 1.0).abs() < rounding(*sigma0, p[i]), "{filter:?}: {p:?} {q:?}");
                    }
                }
                for ((p, q), sigma) in a.q.iter().zip(&b.q).zip(&a.sigma) {
                    for i in 0..4 {
                        assert!((p[i] - q[i]).abs() < 1e-9 * sigma[0].max(1e-3), "{filter:?}: {p:?} {q:?}");
                    }
                }
                assert!((end_a.log_likelihood - end_b.log_likelihood).abs() < 1e-6 * end_a.log_likelihood.abs());
            }
        }
    }
}

#[test]
fn a_lane_does_not_depend_on_its_neighbours() {
    let logs = mixed();
    for filter in filters() {
        let all = replayed(&filter, &logs, 3, Level::best(), 0.99, true);
        for (i, (expected, end)) in all.iter().enumerate() {
            let others: Vec<_> = (0..3).map(|k| (i + k) % logs.len()).collect();
            let some: Vec<_> = others.iter().map(|k| (made_again(*k), logs[*k].1)).collect();
            let (found, again) = &replayed(&filter, &some, 3, Level::best(), 0.99, true)[0];
            assert_eq!(expected.q, found.q, "{filter:?}, log {i}");
            assert_eq!(expected.covariance, found.covariance);
            assert_eq!(expected.nis, found.nis);
            assert_eq!(end.as_ref().unwrap().log_likelihood, again.as_ref().unwrap().log_likelihood);
        }
    }
}

/// Wider registers hold the same lanes: the same operations, the same bits.
#[test]
fn levels_with_lanes_agree_to_the_bit() {
    if !Level::Avx512.available() {
        return;
    }
    let logs = mixed();
    for filter in filters() {
        let two = replayed(&filter, &logs, 3, Level::Avx2, 0.99, true);
        let one = replayed(&filter, &logs, 3, Level::Avx512, 0.99, true);
        for ((a, end_a), (b, end_b)) in two.iter().zip(&one) {
            assert_eq!(
                (&a.q, &a.bias, &a.sigma, &a.covariance),
                (&b.q, &b.bias, &b.sigma, &b.covariance),
                "{filter:?}"
            );
            assert_eq!((&a.nis, &a.accepted, &a.innovation), (&b.nis, &b.accepted, &b.innovation));
            let (a, b) = (end_a.as_ref().unwrap(), end_b.as_ref().unwrap());
            assert_eq!((a.log_likelihood, a.covariance), (b.log_likelihood, b.covariance));
        }
    }
}

fn made_again(i: usize) -> Made {
    mixed().swap_remove(i).0
}

#[test]
fn a_level_without_lanes_runs_one_by_one() {
    let logs = mixed();
    for filter in filters() {
        let plain = replayed(&filter, &logs, 5, Level::Portable, 1.0, true);
        let alone = replayed(&filter, &logs, 5, Level::Portable, 1.0, false);
        let best = replayed(&filter, &logs, 5, Level::best(), 1.0, true);
        for ((((a, _), (b, _)), (c, _)), (_, sigma0)) in plain.iter().zip(&best).zip(&alone).zip(&logs) {
            assert_eq!((&a.q, &a.sigma, &a.nis), (&c.q, &c.sigma, &c.nis));
            for (p, q) in a.sigma.iter().flatten().zip(b.sigma.iter().flatten()) {
                assert!((p / q - 1.0).abs() < rounding(*sigma0, *p));
            }
        }
    }
}

#[test]
fn a_log_that_breaks_down_leaves_the_others_alone() {
    let mut logs: Vec<_> = (0..5).map(|i| (made(i, 200, 0.1, 2, 0.02, 0.0), 1e-2)).collect();
    logs[2].0.rate[100] = [f64::NAN; 3];
    let broken_t = 150;
    logs[4].0.t[broken_t] = logs[4].0.t[broken_t - 1];
    for filter in filters() {
        let found = replayed(&filter, &logs, 1, Level::best(), 1.0, true);
        let alone = replayed(&filter, &logs, 1, Level::best(), 1.0, false);
        for (i, ((_, a), (_, b))) in found.iter().zip(&alone).enumerate() {
            match (a, b) {
                (Ok(a), Ok(b)) => assert!((a.log_likelihood / b.log_likelihood - 1.0).abs() < 1e-9),
                (Err(a), Err(b)) => assert_eq!(a.to_string(), b.to_string()),
                _ => panic!("log {i}: {:?} {:?}", a.as_ref().err(), b.as_ref().err()),
            }
        }
    }
}

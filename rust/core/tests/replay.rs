//! Replay of made logs: rows, times, levels, errors, and the stream beside it.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, AttitudeSensor, AttitudeSensors, Buffers, GyroModel, GyroSeries, GyroTiming, Log, Options, Sampling,
    StarSeries, Stream, first_fix, rows, run,
};
use celestcore_core::filter::{Ekf, SrUkf, Ukf};
use celestcore_core::quaternion::{Integrator, angle_between, exp, multiply};
use celestcore_core::replay::Output;
use celestcore_core::scalar::Level;
use common::{ARW, Made, RRW, SIGMA, made, start};

const TIMING: GyroTiming = GyroTiming { sampling: Sampling::Hold, max_gap: 10.0, gap_rate_sigma: 1e-3 };

fn filters() -> [AnyFilter; 3] {
    [AnyFilter::Ekf(Ekf::default()), AnyFilter::Ukf(Ukf::default()), AnyFilter::SrUkf(SrUkf::default())]
}

fn stars_of(made: &Made) -> StarSeries<'_> {
    StarSeries { t: &made.star_t, q: &made.star_q, noise: made.noise.as_slice().into(), mounting: None }
}

fn replay(made: &Made, filter: &AnyFilter, output: Output, level: Level, t: f64) -> Result<Buffers, Error> {
    let gyro = GyroSeries { t: &made.t, rate: &made.rate, turn: None, timing: TIMING };
    let stars = [AttitudeSensor::Star(stars_of(made))];
    let sensors = AttitudeSensors::new(&stars, 1.0)?;
    let model = GyroModel::new(ARW, RRW, Integrator::Exponential)?;
    let mut start = start(made);
    start.t = t;
    if t > 0.0 {
        start.used = None;
    }
    let mut buffers = Buffers::new(rows(&gyro, &sensors, &start, output)?, true);
    let (columns, measured) = buffers.columns();
    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
    run(filter, log, &start, &Options { output, level }, columns, measured, &mut |_| Ok(()))?;
    Ok(buffers)
}

#[test]
fn every_filter_finds_the_attitude() {
    let made = made(6000, 1);
    for filter in filters() {
        let out = replay(&made, &filter, Output::Every(1), Level::best(), 0.0).unwrap();
        assert_eq!(out.t, made.t);
        let rms = |q: &[[f64; 4]]| {
            let sum: f64 = (3000..6000).map(|k| angle_between(&q[k], &made.truth[k]).powi(2)).sum();
            (sum / 3000.0 / 3.0).sqrt()
        };
        let expected = out.sigma[5999][0];
        assert!((rms(&out.q) / expected - 1.0).abs() < 0.15, "{} {expected}", rms(&out.q));
        assert!(expected < 0.7 * SIGMA);
    }
}

#[test]
fn rows_are_counted_as_they_are_written() {
    let made = made(101, 2);
    for (t, output) in [
        (0.0, Output::Every(1)),
        (0.0, Output::Every(7)),
        (0.05, Output::Every(1)),
        (3.0, Output::Every(3)),
        (3.01, Output::Every(3)),
        (0.0, Output::Period(0.1)),
        (0.05, Output::Period(0.25)),
        (0.0, Output::Period(100.0)),
        (10.0, Output::Every(2)),
    ] {
        let out = replay(&made, &AnyFilter::Ekf(Ekf::default()), output, Level::Portable, t).unwrap();
        assert_eq!(out.t[0], t);
        for pair in out.t.windows(2) {
            assert!(pair[1] > pair[0], "{output:?} {t}: {pair:?}");
        }
        if let Output::Period(p) = output {
            for (k, time) in out.t.iter().enumerate() {
                assert_eq!(*time, t + k as f64 * p);
            }
            assert!(out.t[out.t.len() - 1] + p > 10.0);
        }
    }
    for bad in [Output::Every(0), Output::Period(0.0), Output::Period(f64::NAN), Output::Period(1e-300)] {
        let result = replay(&made, &AnyFilter::Ekf(Ekf::default()), bad, Level::Portable, 0.0);
        assert!(matches!(result, Err(Error::Parameter { .. })));
    }
}

#[test]
fn levels_agree() {
    let made = made(4000, 3);
    for filter in filters() {
        let portable = replay(&made, &filter, Output::Every(1), Level::Portable, 0.0).unwrap();
        let best = replay(&made, &filter, Output::Every(1), Level::best(), 0.0).unwrap();
        for k in 0..made.t.len() {
            assert!(angle_between(&portable.q[k], &best.q[k]) < 1e-12);
            for i in 0..6 {
                assert!((portable.sigma[k][i] / best.sigma[k][i] - 1.0).abs() < 1e-10);
            }
        }
        let again = replay(&made, &filter, Output::Every(1), Level::best(), 0.0).unwrap();
        assert_eq!(again.q, best.q);
        assert_eq!(again.covariance, best.covariance);
    }
}

#[test]
fn a_stream_of_the_same_samples_gives_the_same_bits() {
    let made = made(600, 4);
    for filter in filters() {
        let out = replay(&made, &filter, Output::Every(1), Level::best(), 0.0).unwrap();
        let model = GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap();
        let s = start(&made);
        let mut stream = Stream::new(filter, model, TIMING, 1.0, s.t, s.mean, &s.covariance).unwrap();
        for k in 0..made.t.len() {
            stream.predict(made.t[k], &made.rate[k]).unwrap();
            if k % 2 == 0 && k > 0 {
                stream.update_star(made.t[k], 0, &made.star_q[k / 2], &made.noise[k / 2]).unwrap();
            }
            let (mean, cov) = stream.state();
            let sign = if mean.q.iter().zip(&out.q[k]).map(|(a, b)| a * b).sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
            assert_eq!(mean.q.map(|c| c * sign), out.q[k], "{k}");
            assert_eq!(mean.bias, out.bias[k]);
            for i in 0..6 {
                for j in 0..6 {
                    assert_eq!(cov[(i, j)], out.covariance[k][i][j]);
                }
            }
        }
        // a copy from a snapshot goes on with the same bits; time does not go back
        let mut copy = Stream::new(filter, model, TIMING, 1.0, 0.0, s.mean, &s.covariance).unwrap();
        copy.restore(&stream.snapshot());
        copy.predict(100.0, &[0.0; 3]).unwrap();
        stream.predict(100.0, &[0.0; 3]).unwrap();
        assert_eq!(copy.snapshot(), stream.snapshot());
        let before = stream.snapshot();
        assert!(matches!(stream.predict(1.0, &[0.0; 3]), Err(Error::OutOfOrder { .. })));
        assert!(stream.predict(101.0, &[f64::NAN; 3]).is_err());
        assert_eq!(stream.snapshot(), before);
    }
}

#[test]
fn a_bad_first_fix_is_not_started_from() {
    let model = GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap();
    // from a few sigma to half a turn, about any axis; and a bias of any size that is believed
    for off in [3e-4, 2e-3, 1e-2, 0.3, 3.0] {
        for axis in 0..3 {
            let mut made = made(200, 5);
            let mut turn = [0.0; 3];
            turn[axis] = off;
            for rate in &mut made.rate {
                rate[axis] += 1e-3;
            }
            made.star_q[0] = multiply(&made.star_q[0], &exp(&turn));
            let gyro = GyroSeries { t: &made.t, rate: &made.rate, turn: None, timing: TIMING };
            let stars = [AttitudeSensor::Star(stars_of(&made))];
            let sensors = AttitudeSensors::new(&stars, 1.0).unwrap();
            let start = first_fix(&gyro, &sensors, &model, [0.0; 3], [1e-3; 3]).unwrap();
            // not the bad one; which of the good ones depends on their noise
            assert!(start.used > Some(0) && start.t < 1.0, "{off} {axis}: {:?}", start.used);
        }
    }
    let good = made(200, 5);
    let gyro = GyroSeries { t: &good.t, rate: &good.rate, turn: None, timing: TIMING };
    let stars = [AttitudeSensor::Star(stars_of(&good))];
    let sensors = AttitudeSensors::new(&stars, 1.0).unwrap();
    let start = first_fix(&gyro, &sensors, &model, [0.0; 3], [1e-3; 3]).unwrap();
    assert_eq!((start.t, start.used), (0.0, Some(0)));
    let none = AttitudeSensors::new(&[], 1.0).unwrap();
    let nothing = first_fix(&gyro, &none, &model, [0.0; 3], [1e-3; 3]);
    assert!(matches!(nothing, Err(Error::NoStart { .. })));
}

#[test]
fn times_that_go_back_are_named() {
    let mut bad = made(100, 6);
    bad.t[40] = bad.t[39];
    let result = replay(&bad, &AnyFilter::Ekf(Ekf::default()), Output::Every(1), Level::Portable, 0.0);
    assert!(matches!(result, Err(Error::NotIncreasing { row: 40, .. })), "{result:?}");
    let mut bad = made(100, 6);
    bad.star_t[7] = 0.0;
    let result = replay(&bad, &AnyFilter::Ekf(Ekf::default()), Output::Every(1), Level::Portable, 0.0);
    assert!(matches!(result, Err(Error::NotIncreasing { row: 7, .. })), "{result:?}");
}

#[test]
fn a_poll_can_end_the_run() {
    let made = made(20_000, 8);
    let gyro = GyroSeries { t: &made.t, rate: &made.rate, turn: None, timing: TIMING };
    let sensors = AttitudeSensors::new(&[], 1.0).unwrap();
    let model = GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap();
    let start = start(&made);
    let output = Output::Every(1);
    let mut buffers = Buffers::new(rows(&gyro, &sensors, &start, output).unwrap(), false);
    let (columns, measured) = buffers.columns();
    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
    let mut poll = |k: usize| if k > 5000 { Err(Error::Interrupted) } else { Ok(()) };
    let options = Options { output, level: Level::Portable };
    let result = run(&AnyFilter::Ekf(Ekf::default()), log, &start, &options, columns, measured, &mut poll);
    assert_eq!(result.err(), Some(Error::Interrupted));
}

/// Found by fuzzing: rows were counted up to a last sample that was not the latest.
#[test]
fn times_that_go_back_are_an_error_with_a_period_too() {
    let mut made = made(40, 5);
    made.t[39] = made.t[20];
    let result = replay(&made, &AnyFilter::Ekf(Ekf::default()), Output::Period(0.05), Level::Portable, 0.0);
    assert!(matches!(result, Err(Error::NotIncreasing { row: 39, .. })));
}

//! Doubtful measurements and unknown noise: the weights' closed forms, what they change and what they do not.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, Attitude, AttitudeBias, AttitudeSensor, AttitudeSensors, Buffers, DirectionSeries, GyroModel,
    GyroSeries, GyroTiming, Log, Options, Reference, Robust, Sampling, StarSeries, Stream, Trust, first_fix, rows, run,
};
use celestcore_core::consistency::{chi2_cdf, chi2_quantile};
use celestcore_core::filter::{Ekf, Iterated, SrUkf, Ukf};
use celestcore_core::linalg::{Matrix, from_fn, zeros};
use celestcore_core::manifold::Manifold;
use celestcore_core::quaternion::{Integrator, angle_between, exp, multiply};
use celestcore_core::replay::{Output, Report};
use celestcore_core::scalar::Level;
use common::{ARW, Made, RRW, SIGMA, made, normals, start};

const TIMING: GyroTiming = GyroTiming { sampling: Sampling::Hold, max_gap: 10.0, gap_rate_sigma: 1e-3 };

fn filters() -> [AnyFilter; 3] {
    [AnyFilter::Ekf(Ekf::default()), AnyFilter::Ukf(Ukf::default()), AnyFilter::SrUkf(SrUkf::default())]
}

fn model() -> GyroModel {
    GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap()
}

fn trust(robust: Robust) -> Trust {
    Trust { gate: 1.0, robust, memory: None }
}

fn adaptive(memory: f64) -> Trust {
    Trust { gate: 1.0, robust: Robust::Full, memory: Some(memory) }
}

fn over(made: &Made, filter: AnyFilter, trust: Trust, scale: &[f64]) -> Result<Buffers, Error> {
    let gyro = GyroSeries { t: &made.t, rate: &made.rate, turn: None, timing: TIMING };
    let stars = [AttitudeSensor::Star(StarSeries {
        t: &made.star_t,
        q: &made.star_q,
        noise: made.noise.as_slice().into(),
        mounting: None,
    })];
    let sensors = AttitudeSensors::new(&stars, trust)?;
    let (model, start) = (model(), start(made));
    let mut buffers = Buffers::new(rows(&gyro, &sensors, &start, Output::Every(1))?, true);
    buffers.scale = scale.to_vec();
    let options = Options { output: Output::Every(1), level: Level::best() };
    let (columns, measured) = buffers.columns();
    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
    run(&filter, log, &start, &options, columns, measured, &mut |_| Ok(()))?;
    Ok(buffers)
}

/// One update of a stream at rest: state and covariance before and after, and the report.
type Step = (Attitude<f64>, Matrix<f64, 6, 6>, Report);

fn prior() -> Matrix<f64, 6, 6> {
    let mut p = zeros();
    for i in 0..6 {
        p[(i, i)] = if i < 3 { (1.0 + i as f64) * 1e-8 } else { 1e-12 };
    }
    for i in 0..3 {
        p[(i, i + 3)] = -5e-11;
        p[(i + 3, i)] = -5e-11;
    }
    p[(0, 1)] = 4e-9;
    p[(1, 0)] = 4e-9;
    p
}

fn star(filter: AnyFilter, trust: Trust, off: [f64; 3]) -> Step {
    let mean = Attitude { q: [1.0, 0.0, 0.0, 0.0], bias: [0.0; 3] };
    let mut stream = Stream::new(filter, model(), TIMING, trust, 0.0, mean, &prior()).unwrap();
    let report = stream.update_star(0.0, 0, &exp(&off), &[2e-8, 1e-9, 0.0, 1e-8, 0.0, 3e-8]).unwrap();
    let (x, p) = stream.state();
    (x, p, report)
}

/// What a correction with gain `w K` leaves of the prior: a linear system at these angles.
fn weighed(w: f64, nu: [f64; 3]) -> ([f64; 6], Matrix<f64, 6, 6>) {
    let p = prior();
    let r = Matrix::<f64, 3, 3>::new(2e-8, 1e-9, 0.0, 1e-9, 1e-8, 0.0, 0.0, 0.0, 3e-8);
    let pht: Matrix<f64, 6, 3> = from_fn(|i, j| p[(i, j)]);
    let s: Matrix<f64, 3, 3> = from_fn(|i, j| p[(i, j)] + r[(i, j)]);
    let inverse = s.try_inverse().unwrap();
    let moved = pht * inverse * w * Matrix::<f64, 3, 1>::from_column_slice(&nu);
    (std::array::from_fn(|i| moved[i]), p - pht * inverse * pht.transpose() * w)
}

#[test]
fn a_weight_is_that_of_the_correction() {
    let off = [6e-4, -3e-4, 5e-4];
    for filter in filters() {
        let (_, _, plain) = star(filter, 1.0.into(), off);
        let d2 = plain.nis;
        assert!(d2 > 20.0);
        let limit = chi2_quantile(chi2_cdf(1.5 * 1.5, 1.0), 3.0).unwrap().sqrt();
        for (robust, w) in [(Robust::Huber(1.5), limit / d2.sqrt()), (Robust::StudentT(4.0), (4.0 + 3.0) / (4.0 + d2))]
        {
            let (x, p, report) = star(filter, trust(robust), off);
            // the measurement is reported as it came
            assert_eq!((report.nis, report.innovation, report.accepted), (d2, plain.innovation, true));
            let (moved, left) = weighed(w, off);
            let found = AttitudeBias::local(&Attitude { q: [1.0, 0.0, 0.0, 0.0], bias: [0.0; 3] }, &x);
            for i in 0..6 {
                let unit = if i < 3 { 1e-4 } else { 1e-6 };
                assert!((found[i] - moved[i]).abs() < 1e-3 * unit, "{robust:?} {i}: {} {}", found[i], moved[i]);
                for j in 0..6 {
                    let scale = (left[(i, i)] * left[(j, j)]).sqrt();
                    // the reset of the error state turns it by the correction, some 1e-4 rad
                    assert!((p[(i, j)] - left[(i, j)]).abs() < 1e-3 * scale, "{robust:?} {i} {j}");
                }
            }
        }
    }
}

#[test]
fn what_fits_counts_in_full() {
    let made = made(2000, 3);
    for filter in filters() {
        let plain = over(&made, filter, 1.0.into(), &[]).unwrap();
        let wide = over(&made, filter, trust(Robust::Huber(50.0)), &[]).unwrap();
        assert_eq!((&plain.q, &plain.covariance, &plain.nis), (&wide.q, &wide.covariance, &wide.nis));
        assert_eq!((plain.innovation, plain.tally), (wide.innovation, wide.tally));
    }
}

#[test]
fn the_gate_comes_first() {
    let off = [6e-4, -3e-4, 5e-4];
    for filter in filters() {
        for robust in [Robust::Huber(1.5), Robust::StudentT(3.0)] {
            let closed = Trust { gate: 0.999, ..trust(robust) };
            let (x, p, report) = star(filter, closed, off);
            assert!(report.ok && !report.accepted && report.nis > 20.0);
            assert_eq!(x.q, [1.0, 0.0, 0.0, 0.0]);
            let (_, wide, _) = star(filter, 1e-9.into(), off);
            assert_eq!(p, wide);
        }
    }
}

#[test]
fn directions_are_weighed_too() {
    for filter in filters() {
        let step = |trust: Trust, angle: f64| {
            let mean = Attitude { q: [1.0, 0.0, 0.0, 0.0], bias: [0.0; 3] };
            let mut stream = Stream::new(filter, model(), TIMING, trust, 0.0, mean, &prior()).unwrap();
            let seen = [angle.sin(), 0.0, angle.cos()];
            let given = Reference { inertial: [0.0, 0.0, 1.0], sigma: 1e-4 };
            let report = stream.update_direction(0.0, 0, &seen, &given).unwrap();
            (angle_between(&stream.state().0.q, &[1.0, 0.0, 0.0, 0.0]), report)
        };
        let (full, report) = step(1.0.into(), 2e-3);
        let (huber, _) = step(trust(Robust::Huber(1.5)), 2e-3);
        let (same, _) = step(trust(Robust::Huber(1.5)), 4e-3);
        let (student, _) = step(trust(Robust::StudentT(3.0)), 2e-3);
        let (farther, _) = step(trust(Robust::StudentT(3.0)), 4e-3);
        assert!(report.nis > 50.0 && huber < 0.3 * full, "{huber:e} {full:e}");
        // Huber's moves no farther; Student's less, the farther off it is
        assert!((same / huber - 1.0).abs() < 0.05, "{same:e} {huber:e}");
        assert!(farther < 0.6 * student && student < huber, "{farther:e} {student:e}");
    }
}

/// Mean and standard deviation.
fn moments(x: &[f64]) -> (f64, f64) {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    (mean, (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

#[test]
fn the_noise_is_found_from_either_side() {
    for filter in filters() {
        for told in [0.2, 1.0, 5.0] {
            // the standard deviation that is told; the variance's factor is its square, the other way
            let found: Vec<f64> = (0..12)
                .map(|seed| {
                    let mut log = made(20_000, 100 + seed);
                    for r in &mut log.noise {
                        *r = r.map(|v| v * told * told);
                    }
                    over(&log, filter, adaptive(300.0), &[1.0]).unwrap().scale[0] * told * told
                })
                .collect();
            let (mean, spread) = moments(&found);
            // one run is off by some (3 * 300)^-1/2 / (share of the noise in the innovations)
            assert!(spread < 0.08, "{told}: {spread}");
            assert!((mean - 1.0).abs() < 4.0 * spread / 12_f64.sqrt(), "{told}: {mean} {spread}");
        }
    }
}

#[test]
fn outliers_are_not_taken_for_noise() {
    let mut log = made(20_000, 7);
    let mut normal = normals(8);
    for (k, q) in log.star_q.iter_mut().enumerate() {
        if k % 20 == 19 {
            *q = multiply(q, &exp(&std::array::from_fn(|_| 100.0 * SIGMA * normal())));
        }
    }
    let out = over(&log, AnyFilter::Ekf(Ekf::default()), Trust { gate: 0.999, ..adaptive(300.0) }, &[1.0]).unwrap();
    // 5 % that count as the 99 % quantile of chi-square, 3.8 times the mean: a seventh too much, not 500 times
    assert!(out.scale[0] < 1.35, "{}", out.scale[0]);
    // a gate alone would never open again where the noise is five times what is told
    let mut wrong = made(20_000, 9);
    for r in &mut wrong.noise {
        *r = r.map(|v| v / 25.0);
    }
    let out = over(&wrong, AnyFilter::Ekf(Ekf::default()), Trust { gate: 0.999, ..adaptive(300.0) }, &[1.0]).unwrap();
    assert!((out.scale[0] / 25.0 - 1.0).abs() < 0.25, "{}", out.scale[0]);
}

#[test]
fn a_run_goes_on_from_the_scale_it_is_given() {
    let log = made(200, 3);
    let one = over(&log, AnyFilter::Ekf(Ekf::default()), adaptive(1e12), &[4.0]).unwrap();
    let mut loud = made(200, 3);
    for r in &mut loud.noise {
        *r = r.map(|v| 4.0 * v);
    }
    let other = over(&loud, AnyFilter::Ekf(Ekf::default()), 1.0.into(), &[]).unwrap();
    assert_eq!(one.nis.len(), other.nis.len());
    for (a, b) in one.nis.iter().zip(&other.nis) {
        assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
    }
}

#[test]
fn a_stream_gives_the_same_bits() {
    let made = made(600, 4);
    let careful = Trust { gate: 0.9999, robust: Robust::StudentT(4.0), memory: Some(50.0) };
    for filter in filters() {
        let out = over(&made, filter, careful, &[1.0]).unwrap();
        let s = start(&made);
        let mut stream = Stream::new(filter, model(), TIMING, careful, s.t, s.mean, &s.covariance).unwrap();
        for k in 0..made.t.len() {
            stream.predict(made.t[k], &made.rate[k]).unwrap();
            if k % 2 == 0 && k > 0 {
                stream.update_star(made.t[k], 3, &made.star_q[k / 2], &made.noise[k / 2]).unwrap();
            }
            assert_eq!(stream.state().0.bias, out.bias[k], "{k}");
        }
        assert_eq!(stream.noise_scale()[3], out.scale[0]);
        assert_ne!(out.scale[0], 1.0);
        let mut copy = Stream::new(filter, model(), TIMING, careful, 0.0, s.mean, &s.covariance).unwrap();
        copy.restore(&stream.snapshot());
        assert_eq!(copy.snapshot(), stream.snapshot());
    }
}

#[test]
fn two_sensors_have_a_noise_each() {
    let made = made(20_000, 11);
    let (mut body, mut normal) = (Vec::new(), normals(12));
    let up = [0.0, 0.0, 1.0];
    for k in (0..made.t.len()).step_by(5) {
        let q = multiply(&made.truth[k], &exp(&std::array::from_fn(|_| 2e-4 * normal())));
        body.push(celestcore_core::quaternion::rotate(&celestcore_core::quaternion::conjugate(&q), &up));
    }
    let t: Vec<f64> = made.t.iter().copied().step_by(5).collect();
    let inertial = vec![up; t.len()];
    let sensors = [
        AttitudeSensor::Star(StarSeries {
            t: &made.star_t,
            q: &made.star_q,
            noise: made.noise.as_slice().into(),
            mounting: None,
        }),
        AttitudeSensor::Direction(DirectionSeries {
            t: &t,
            body: &body,
            inertial: &inertial,
            sigma: &[1e-4],
            turn: None,
        }),
    ];
    let sensors = AttitudeSensors::new(&sensors, adaptive(300.0)).unwrap();
    let gyro = GyroSeries { t: &made.t, rate: &made.rate, turn: None, timing: TIMING };
    let model = model();
    let start = first_fix(&gyro, &sensors, &model, [0.0; 3], [1e-3; 3]).unwrap();
    let mut buffers = Buffers::new(rows(&gyro, &sensors, &start, Output::Every(1)).unwrap(), false);
    buffers.scale = vec![1.0; 2];
    let options = Options { output: Output::Every(1), level: Level::best() };
    let (columns, measured) = buffers.columns();
    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
    run(&AnyFilter::Ekf(Ekf::default()), log, &start, &options, columns, measured, &mut |_| Ok(())).unwrap();
    // spreads of some 4 and 6 %
    assert!((buffers.scale[0] - 1.0).abs() < 0.2, "{:?}", buffers.scale);
    assert!((buffers.scale[1] / 4.0 - 1.0).abs() < 0.25, "{:?}", buffers.scale);
}

#[test]
fn bad_numbers_are_refused() {
    let made = made(20, 1);
    let ekf = AnyFilter::Ekf(Ekf::default());
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        for (trust, field) in [
            (trust(Robust::Huber(bad)), "huber"),
            (trust(Robust::StudentT(bad)), "student_t"),
            (adaptive(bad), "adaptive"),
        ] {
            let found = over(&made, ekf, trust, &[]).err();
            assert!(matches!(found, Some(Error::Parameter { field: f, .. }) if f == field), "{found:?}");
        }
    }
    assert!(matches!(over(&made, ekf, adaptive(9.0), &[1.0, 1.0]), Err(Error::Length { field: "noise scale", .. })));
    let iterated = AnyFilter::Iterated(Iterated::default());
    for careful in [trust(Robust::Huber(1.5)), adaptive(9.0)] {
        assert_eq!(over(&made, iterated, careful, &[]).unwrap_err(), Error::NotRobust);
    }
    let mut stream = Stream::new(ekf, model(), TIMING, 1.0, 0.0, start(&made).mean, &prior()).unwrap();
    assert!(matches!(
        stream.update_star(0.0, 16, &[1.0, 0.0, 0.0, 0.0], &made.noise[0]),
        Err(Error::Parameter { field: "sensor", .. })
    ));
}

/// Found by fuzzing.
#[test]
fn a_start_that_is_not_finite_is_refused() {
    for bad in [f64::INFINITY, f64::NAN] {
        for filter in filters() {
            let mut p = prior();
            p[(1, 1)] = bad;
            let s = start(&made(2, 1));
            assert!(Stream::new(filter, model(), TIMING, 1.0, 0.0, s.mean, &p).is_err());
            let lost = Attitude { bias: [0.0, bad, 0.0], ..s.mean };
            assert!(Stream::new(filter, model(), TIMING, 1.0, 0.0, lost, &prior()).is_err());
        }
    }
}

/// Found by fuzzing.
#[test]
fn one_sample_has_no_gap() {
    for t in [&[][..], &[3.0]] {
        assert_eq!(celestcore_core::attitude::gap_limit(t, -1.0), f64::INFINITY);
    }
}

/// Found by fuzzing.
#[test]
fn a_covariance_beyond_all_bounds_tells_nothing_of_the_noise() {
    let (mut p, s) = (prior(), start(&made(2, 1)));
    p[(2, 2)] = 1e300;
    let ekf = AnyFilter::Ekf(Ekf::default());
    let mut stream = Stream::new(ekf, model(), TIMING, adaptive(9.0), 0.0, s.mean, &p).unwrap();
    let _ = stream.update_star(0.0, 0, &exp(&[0.0, 0.0, 1.0]), &made(2, 1).noise[0]);
    assert!(stream.noise_scale()[0].is_finite());
}

//! What is read where it is: several sensors in one order of time, mountings, noise of each kind; and blocks
//! of samples for a stream.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, AttitudeSensor, AttitudeSensors, Buffers, Columns, DirectionSeries, FixNoise, GyroModel, GyroSeries,
    GyroTiming, Log, Measured, Options, Rows, Samples, Sampling, StarSeries, Stream, Tally, Times, rows, run, turned,
};
use celestcore_core::filter::{Ekf, SrUkf, Ukf};
use celestcore_core::quaternion::{Integrator, conjugate, exp, multiply, to_matrix};
use celestcore_core::replay::Output;
use celestcore_core::scalar::Level;
use common::{ARW, Made, RRW, SIGMA, made, start};
use proptest::prelude::*;

const TIMING: GyroTiming = GyroTiming { sampling: Sampling::Average, max_gap: 10.0, gap_rate_sigma: 1e-3 };
const TURN: [f64; 3] = [0.4, -0.7, 1.1];

fn filters() -> [AnyFilter; 3] {
    [AnyFilter::Ekf(Ekf::default()), AnyFilter::Ukf(Ukf::default()), AnyFilter::SrUkf(SrUkf::default())]
}

fn stream(filter: AnyFilter, made: &Made) -> Stream {
    let (s, model) = (start(made), GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap());
    Stream::new(filter, model, TIMING, 1.0, s.t, s.mean, &s.covariance).unwrap()
}

fn row_by_row(q: &[f64; 4]) -> [f64; 9] {
    let m = to_matrix(q);
    std::array::from_fn(|i| m[(i / 3, i % 3)])
}

proptest! {
    /// Ties included: times are small whole numbers.
    #[test]
    fn order_is_that_of_a_stable_sort(steps in prop::collection::vec(prop::collection::vec(1_u8..4, 0..90), 0..5)) {
        let times: Vec<Vec<f64>> = steps
            .iter()
            .map(|s| s.iter().scan(0.0, |t, step| { *t += f64::from(*step); Some(*t) }).collect())
            .collect();
        let rows: Vec<Vec<[f64; 3]>> = times.iter().map(|t| vec![[1.0, 0.0, 0.0]; t.len()]).collect();
        let series: Vec<AttitudeSensor<'_>> = times
            .iter()
            .zip(&rows)
            .map(|(t, v)| AttitudeSensor::Direction(DirectionSeries { t, body: v, inertial: v, sigma: &[1.0], turn: None }))
            .collect();
        let all = AttitudeSensors::new(&series, 1.0).unwrap();
        for left_out in (0..series.len()).map(Some).chain([None]) {
            let sensors = all.without(left_out).unwrap();
            let mut expected: Vec<(usize, usize)> = (0..times.len())
                .filter(|s| Some(*s) != left_out)
                .flat_map(|s| (0..times[s].len()).map(move |row| (s, row)))
                .collect();
            expected.sort_by(|(s, a), (r, b)| times[*s][*a].total_cmp(&times[*r][*b]));
            let found: Vec<(usize, usize)> = (0..sensors.len()).map(|i| sensors.source(i)).collect();
            prop_assert_eq!(&found, &expected);
            for (i, source) in expected.iter().enumerate() {
                prop_assert_eq!(sensors.find(*source), Some(i));
                prop_assert_eq!(sensors.time(i), times[source.0][source.1]);
            }
            for (from, to) in [(0.0, 1e9), (10.0, 30.0), (11.0, 11.0), (30.0, 10.0)] {
                let inside = expected.iter().filter(|(s, row)| (from..=to).contains(&times[*s][*row])).count();
                prop_assert_eq!(sensors.count(from, to), inside);
            }
        }
    }
}

/// A run with what is given, and what became of the measurements.
fn flown(made: &Made, gyro: &GyroSeries<'_>, sensors: &[AttitudeSensor<'_>]) -> Buffers {
    let sensors = AttitudeSensors::new(sensors, 1.0).unwrap();
    let model = GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap();
    let (start, output) = (start(made), Output::Every(1));
    let mut buffers = Buffers::new(rows(gyro, &sensors, &start, output).unwrap(), true);
    let (columns, measured) = buffers.columns();
    let log = Log { model: &model, gyro, sensors: &sensors };
    let options = Options { output, level: Level::best() };
    run(&AnyFilter::Ekf(Ekf::default()), log, &start, &options, columns, measured, &mut |_| Ok(())).unwrap();
    buffers
}

#[test]
fn mountings_and_noise_are_those_of_turned_columns() {
    let made = made(400, 3);
    let (mounting, m) = (exp(&TURN), row_by_row(&exp(&TURN)));
    let body: Vec<[f64; 3]> = made.rate.iter().map(|w| turned(&m, w)).collect();
    let fixes: Vec<[f64; 4]> = made.star_q.iter().map(|q| multiply(q, &conjugate(&mounting))).collect();
    let sigma: Vec<[f64; 3]> = (0..fixes.len()).map(|k| [SIGMA, 2.0 * SIGMA, SIGMA * (1.0 + k as f64)]).collect();
    let matrices: Vec<[[f64; 3]; 3]> = sigma
        .iter()
        .map(|s| std::array::from_fn(|i| std::array::from_fn(|j| if i == j { s[i] * s[i] } else { 0.0 })))
        .collect();
    let each: Vec<[f64; 6]> = sigma
        .iter()
        .map(|s| {
            let c = |i: usize, j: usize| (0..3).map(|k| m[3 * i + k] * m[3 * j + k] * s[k] * s[k]).sum();
            [c(0, 0), c(0, 1), c(0, 2), c(1, 1), c(1, 2), c(2, 2)]
        })
        .collect();
    let plain = GyroSeries { t: &made.t, rate: &body, turn: None, timing: TIMING };
    let mounted = GyroSeries { t: &made.t, rate: &made.rate, turn: Some(m), timing: TIMING };
    let star = |q, noise, mounting| AttitudeSensor::Star(StarSeries { t: &made.star_t, q, noise, mounting });
    let expected = flown(&made, &plain, &[star(&fixes, each.as_slice().into(), None)]);
    let same = |found: &Buffers, bound: f64| {
        assert_eq!(found.t, expected.t);
        for (a, b) in found.sigma.iter().zip(&expected.sigma) {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= bound * b));
        }
        for (a, b) in found.nis.iter().zip(&expected.nis) {
            assert!((a - b).abs() <= bound * (1.0 + b), "{a} {b}");
        }
    };
    same(&flown(&made, &mounted, &[star(&fixes, each.as_slice().into(), None)]), 0.0);
    same(&flown(&made, &plain, &[star(&made.star_q, each.as_slice().into(), Some(mounting))]), 0.0);
    let by_sigma = flown(&made, &mounted, &[star(&made.star_q, FixNoise::Sigma(&sigma), Some(mounting))]);
    same(&by_sigma, 1e-8);
    let by_matrix = flown(&made, &mounted, &[star(&made.star_q, FixNoise::Covariance(&matrices), Some(mounting))]);
    assert_eq!(by_matrix.q, by_sigma.q);
    let one: Vec<[f64; 6]> = vec![each[7]; fixes.len()];
    let all = flown(&made, &plain, &[star(&fixes, FixNoise::Same(each[7]), None)]);
    assert_eq!(all.nis, flown(&made, &plain, &[star(&fixes, one.as_slice().into(), None)]).nis);
}

#[test]
fn what_is_not_kept_is_counted_all_the_same() {
    let made = made(300, 4);
    let gyro = GyroSeries { t: &made.t, rate: &made.rate, turn: None, timing: TIMING };
    let star = StarSeries { t: &made.star_t, q: &made.star_q, noise: made.noise.as_slice().into(), mounting: None };
    let stars = [AttitudeSensor::Star(star)];
    let sensors = AttitudeSensors::new(&stars, 0.5).unwrap();
    let model = GyroModel::new(ARW, RRW, Integrator::Exponential).unwrap();
    let (log, start) = (Log { model: &model, gyro: &gyro, sensors: &sensors }, start(&made));
    let options = Options { output: Output::Every(1), level: Level::best() };
    let counted = rows(&gyro, &sensors, &start, options.output).unwrap();
    let filter = AnyFilter::Ekf(Ekf::default());
    let mut full = Buffers::new(counted, false);
    let (columns, measured) = full.columns();
    let end = run(&filter, log, &start, &options, columns, measured, &mut |_| Ok(())).unwrap();
    let used = full.accepted.iter().filter(|a| **a).count();
    assert_eq!(full.tally, Tally { accepted: used, rejected: counted.measured - used, unused: 0 });
    assert!(full.tally.rejected > 10);

    let mut bare = Buffers::new(counted, false);
    let mut tally = Tally::default();
    let (columns, _) = bare.columns();
    let nothing = Measured { tally: Some(&mut tally), ..Measured::default() };
    let again = run(&filter, log, &start, &options, columns, nothing, &mut |_| Ok(())).unwrap();
    assert_eq!((tally, again.log_likelihood), (full.tally, end.log_likelihood));
    assert_eq!(bare.q, full.q);

    let mut short = [0.0; 3];
    let (columns, _) = bare.columns();
    let wrong = Measured { nis: &mut short, ..Measured::default() };
    let result = run(&filter, log, &start, &options, columns, wrong, &mut |_| Ok(()));
    assert!(matches!(result, Err(Error::Length { field: "measurement column", found: 3, .. })));
}

#[test]
fn a_block_is_its_samples_one_by_one() {
    let (made, m) = (made(500, 5), row_by_row(&exp(&TURN)));
    let steps: Vec<f64> = (0..made.rate.len()).map(|k| 0.05 + 0.001 * (k % 7) as f64).collect();
    for filter in filters() {
        for (turn, lag) in [(None, None), (Some(m), Some(3.0))] {
            for times in [Times::At(&made.t), Times::After(&steps), Times::Every(0.1)] {
                let mut one = stream(filter, &made);
                lag.map(|lag| one.keep(lag).unwrap());
                let mut block = one.clone();
                let (mut t, mut expected) = (0.0, Buffers::new(Rows { output: 0, measured: 0 }, true));
                for (k, rate) in made.rate.iter().enumerate() {
                    t = match times {
                        Times::At(at) => at[k],
                        Times::After(dt) => t + dt[k],
                        Times::Every(dt) => t + dt,
                    };
                    let body = turn.map_or(*rate, |m| turned(&m, rate));
                    one.predict(t, &body).unwrap();
                    if (k + 1) % 7 == 0 {
                        let (mean, p) = one.state();
                        expected.t.push(t);
                        expected.q.push(mean.q);
                        expected.sigma.push(std::array::from_fn(|i| p[(i, i)].sqrt()));
                        expected.rate.push(std::array::from_fn(|i| body[i] - mean.bias[i]));
                        expected.covariance.push(std::array::from_fn(|i| std::array::from_fn(|j| p[(i, j)])));
                    }
                }
                let mut found = Buffers::new(Rows { output: made.rate.len() / 7, measured: 0 }, true);
                let samples = Samples { times, rate: &made.rate, turn };
                block.process(&samples, 7, found.columns().0, &mut |_| Ok(())).unwrap();
                assert_eq!(block.snapshot(), one.snapshot());
                assert!(block.history().eq(one.history()));
                assert_eq!(block.history().count() > 10, lag.is_some());
                assert_eq!((&found.t, &found.q, &found.rate), (&expected.t, &expected.q, &expected.rate));
                assert_eq!((&found.sigma, &found.covariance), (&expected.sigma, &expected.covariance));
            }
        }
    }
}

#[test]
fn a_bad_block_leaves_the_stream_as_it_was() {
    let made = made(3000, 6);
    let bad = |change: &dyn Fn(&mut Vec<f64>, &mut Vec<[f64; 3]>), expected: &dyn Fn(&Error) -> bool| {
        let (mut t, mut rate) = (made.t[1..].to_vec(), made.rate[1..].to_vec());
        change(&mut t, &mut rate);
        let mut s = stream(AnyFilter::Ukf(Ukf::default()), &made);
        s.keep(5.0).unwrap();
        s.predict(0.05, &made.rate[0]).unwrap();
        let (before, past) = (s.snapshot(), s.history().copied().collect::<Vec<_>>());
        let samples = Samples { times: Times::At(&t), rate: &rate, turn: None };
        let stop = |k: usize| if k >= 2048 { Err(Error::Interrupted) } else { Ok(()) };
        let error = s.process(&samples, usize::MAX, Columns::default(), &mut { stop }).unwrap_err();
        assert!(expected(&error), "{error:?}");
        assert_eq!(s.snapshot(), before);
        assert!(s.history().eq(past.iter()));
    };
    bad(&|_, _| (), &|e| matches!(e, Error::Interrupted));
    bad(&|_, w| w[700][1] = f64::NAN, &|e| matches!(e, Error::Row { field: "rates", row: 700, .. }));
    bad(&|_, w| w[0][2] = f64::INFINITY, &|e| matches!(e, Error::Row { field: "rates", row: 0, .. }));
    bad(&|t, _| t[9] = t[8], &|e| matches!(e, Error::NotIncreasing { field: "t", row: 9, .. }));
    bad(&|t, _| t[0] = 0.0, &|e| matches!(e, Error::Row { field: "t", row: 0, .. }));
    bad(&|t, _| t[5] = f64::NAN, &|e| matches!(e, Error::Row { field: "t", row: 5, .. }));
    bad(&|t, _| drop(t.pop()), &|e| matches!(e, Error::Length { field: "t", .. }));
    bad(&|_, w| w[600] = [1e300; 3], &|e| matches!(e, Error::NotPositiveDefinite { step: 601, .. }));

    let mut s = stream(AnyFilter::Ekf(Ekf::default()), &made);
    let mut step = |times| {
        let samples = Samples { times, rate: &made.rate[..2], turn: None };
        s.process(&samples, usize::MAX, Columns::default(), &mut |_| Ok(())).unwrap_err()
    };
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(step(Times::Every(dt)), Error::Parameter { field: "dt", .. }));
        assert!(matches!(step(Times::After(&[1.0, dt])), Error::Row { field: "dt", row: 1, .. }));
    }
    let stuck = step(Times::After(&[1e20, 1.0]));
    assert!(matches!(stuck, Error::Row { field: "dt", row: 1, need: "is too short to move the time", .. }));
}

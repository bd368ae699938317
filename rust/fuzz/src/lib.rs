//! What comes of arbitrary bytes as logs, options and calls. Nothing may panic or hang, and whatever is not an error is
//! finite: unit quaternions, biases, standard deviations.
//!
//! The tests try some thousands, or as many as `CELESTCORE_FUZZ_CASES` says; libFuzzer goes on for as long as it is let,
//! and looks for inputs that reach new code: `cargo fuzz run --fuzz-dir rust/fuzz --features libfuzzer --sanitizer none
//! replay`. A sanitizer would need a nightly compiler, and would have little to look at: the only `unsafe` code is that of
//! the registers.

mod values;

use arbitrary::{Result, Unstructured};
use celestcore_core::attitude::{
    AttitudeSensor, AttitudeSensors, Buffers, Columns, DirectionSeries, GyroSeries, Log, Options, Reference, Samples,
    StarSeries, Stream, Times, first_fix, gap_limit, gaps, rows, run, smooth,
};
use celestcore_core::replay::{Output, Start};
use celestcore_core::scalar::Level;
use values::{
    Given, attitude, covariance, filter, model, noise, quaternion, rate, times, timing, trust, value, vector,
};

/// Rows that a run may ask for: memory is not what is looked at.
const ROWS: usize = 10_000;
/// Variances, rad², beyond which squares overflow: what a filter makes of them is of no interest.
const ABSURD: f64 = 1e100;

/// A log through any filter, forward or forward and back.
pub fn replay(data: &[u8]) {
    // bytes that are no log are no failure
    let _ = replayed(&mut Unstructured::new(data));
}

/// Calls of a stream in any order.
pub fn stream(data: &[u8]) {
    let _ = streamed(&mut Unstructured::new(data));
}

fn replayed(u: &mut Unstructured<'_>) -> Result<()> {
    let Some(model) = model(u)? else { return Ok(()) };
    let t = times(u, 48)?;
    let rates = t.iter().map(|_| rate(u)).collect::<Result<Vec<_>>>()?;
    let turn = if u.ratio(1, 4)? { Some(Given::many(u, |u| value(u, 1.0))?) } else { None };
    let gyro = GyroSeries { t: &t, rate: &rates, turn, timing: timing(u)? };
    let star_t = times(u, 24)?;
    let star_q = star_t.iter().map(|_| quaternion(u)).collect::<Result<Vec<_>>>()?;
    let star_noise = star_t.iter().map(|_| noise(u)).collect::<Result<Vec<_>>>()?;
    let mounting = if u.ratio(1, 4)? { Some(quaternion(u)?) } else { None };
    let seen_t = times(u, 12)?;
    let body = seen_t.iter().map(|_| vector(u)).collect::<Result<Vec<_>>>()?;
    let inertial = seen_t.iter().map(|_| vector(u)).collect::<Result<Vec<_>>>()?;
    let sigma = [value(u, 1e-3)?.abs()];
    let series = [
        AttitudeSensor::Star(StarSeries { t: &star_t, q: &star_q, noise: star_noise.as_slice().into(), mounting }),
        AttitudeSensor::Direction(DirectionSeries {
            t: &seen_t,
            body: &body,
            inertial: &inertial,
            sigma: &sigma,
            turn: None,
        }),
    ];
    let Ok(sensors) = AttitudeSensors::new(&series[..if u.arbitrary()? { 2 } else { 1 }], trust(u)?) else {
        return Ok(());
    };
    let Some(filter) = filter(u)? else { return Ok(()) };
    let start = if u.arbitrary()? {
        let Ok(start) = first_fix(&gyro, &sensors, &model, rate(u)?, [value(u, 1e-3)?; 3]) else { return Ok(()) };
        start
    } else {
        Start { t: value(u, 1.0)?, mean: attitude(u)?, covariance: covariance(u)?, used: None }
    };
    let output = if u.arbitrary()? { Output::Every(u.int_in_range(0..=5)?) } else { Output::Period(value(u, 1.0)?) };
    let level = if u.arbitrary()? { Level::best() } else { Level::Portable };
    let (options, back) = (Options { output, level }, u.arbitrary()?);
    let _ = gaps(&t, gap_limit(&t, value(u, 3.0)?));
    let Ok(needed) = rows(&gyro, &sensors, &start, output) else { return Ok(()) };
    if needed.output > ROWS {
        return Ok(());
    }
    let mut memory = Buffers::new(needed, true);
    if u.arbitrary()? {
        memory.scale = vec![value(u, 1.0)?; series.len()];
    }
    let (columns, measured) = memory.columns();
    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
    let call = if back { smooth } else { run };
    if let Ok(end) = call(&filter, log, &start, &options, columns, measured, &mut |_| Ok(())) {
        assert!(unit(&end.mean.q) && finite(&end.mean.bias), "end: {:?}", end.mean);
        assert!(end.covariance.iter().all(|p| p.is_finite()), "end: {}", end.covariance);
        for k in 0..memory.t.len() {
            assert!(unit(&memory.q[k]) && finite(&memory.bias[k]), "row {k}: {:?} {:?}", memory.q[k], memory.bias[k]);
            assert!(
                memory.sigma[k].iter().all(|s| *s >= 0.0 && s.is_finite()),
                "row {k}, {filter:?}, back {back}: {:?}\n{}",
                memory.sigma[k],
                start.covariance
            );
        }
        let tally = memory.tally;
        assert_eq!(tally.accepted + tally.rejected + tally.unused, needed.measured);
    }
    Ok(())
}

fn streamed(u: &mut Unstructured<'_>) -> Result<()> {
    let (Some(model), Some(filter)) = (model(u)?, filter(u)?) else { return Ok(()) };
    let (trust, begin) = (trust(u)?, value(u, 1.0)?);
    let made = Stream::new(filter, model, timing(u)?, trust, begin, attitude(u)?, &covariance(u)?);
    let Ok(mut stream) = made else { return Ok(()) };
    if !begin.is_finite() {
        return Ok(()); // its maker checks the time
    }
    if u.arbitrary()? {
        let _ = stream.keep(value(u, 2.0)?);
    }
    let mut kept = stream.snapshot();
    for _ in 0..u.int_in_range(0..=40)? {
        if stream.state().1.iter().any(|p| p.abs() > ABSURD) {
            return Ok(());
        }
        let t = stream.time() + value(u, 0.3)?;
        let before = stream.snapshot();
        let failed = match u.int_in_range(0..=6)? {
            0..=1 => stream.predict(t, &rate(u)?).is_err(),
            2..=3 => stream.update_star(t, u.int_in_range(0..=17)?, &quaternion(u)?, &noise(u)?).is_err(),
            4 => {
                let reference = Reference { inertial: vector(u)?, sigma: value(u, 1e-3)?.abs() };
                stream.update_direction(t, 0, &vector(u)?, &reference).is_err()
            }
            5 => {
                let rates = (0..u.int_in_range(0..=9)?).map(|_| rate(u)).collect::<Result<Vec<_>>>()?;
                let samples = Samples { times: Times::Every(value(u, 0.1)?), rate: &rates, turn: None };
                stream.process(&samples, usize::MAX, Columns::default(), &mut |_| Ok(())).is_err()
            }
            _ => {
                let _ = stream.smoothed();
                if u.arbitrary()? {
                    kept = stream.snapshot();
                } else {
                    stream.restore(&kept);
                }
                continue;
            }
        };
        if failed {
            assert_eq!(stream.snapshot(), before, "what fails leaves the state as it was");
        }
        let (x, p) = stream.state();
        assert!(unit(&x.q) && finite(&x.bias), "{x:?}");
        assert!(p.iter().all(|p| p.is_finite()), "{p}");
    }
    Ok(())
}

fn unit(q: &[f64; 4]) -> bool {
    (q.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-9
}

fn finite(x: &[f64; 3]) -> bool {
    x.iter().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn config() -> ProptestConfig {
        let told = std::env::var("CELESTCORE_FUZZ_CASES").ok().and_then(|n| n.parse().ok());
        // the same ones in every run of the tests; other ones when more are asked for
        let rng_seed = if told.is_some() { RngSeed::Random } else { RngSeed::Fixed(2026) };
        let cases = told.unwrap_or(10_000);
        let given = ProptestConfig { cases, rng_seed, ..ProptestConfig::default() };
        ProptestConfig { max_shrink_iters: 300, failure_persistence: None, ..given }
    }

    proptest! {
        #![proptest_config(config())]
        #[test]
        fn arbitrary_logs_do_no_harm(data in vec(any::<u8>(), 0..6000)) {
            super::replay(&data);
        }

        #[test]
        fn arbitrary_calls_do_no_harm(data in vec(any::<u8>(), 0..3000)) {
            super::stream(&data);
        }
    }
}

//! Many trials over threads, each run through several estimators.

use super::parallel::{keep_on, over_threads};
use super::rng::{Stream, channel};
use super::score::{Flown, Score};
use super::{Fixes, GyroErrors, Readings, Scenario, StarSource};
use crate::attitude::{
    AnyFilter, Attitude, AttitudeBias, AttitudeSensor, AttitudeSensors, Buffers, Flight, GyroModel, GyroSeries,
    GyroTiming, LANES, Log, Options, StarSeries, Trust, first_fix, rows, run, run_many, smooth,
};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, apply, cholesky_semidefinite, mul, transpose};
use crate::manifold::Manifold;
use crate::quaternion::{Quaternion, conjugate, multiply, rotate, to_matrix};
use crate::replay::{End, Output, Start};
use crate::scalar::Level;
use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// A star camera as an estimator knows it.
#[derive(Clone, Copy, Debug)]
pub struct KnownCamera {
    /// Camera frame to body, `q_bc`.
    pub mounting: Option<Quaternion<f64>>,
    /// Covariance in the body frame, rad²: `(xx, xy, xz, yy, yz, zz)`; of no use where fixes bring their own.
    pub noise: [f64; 6],
}

/// What an estimator starts from.
#[derive(Clone, Debug)]
pub enum Begin {
    /// See [`first_fix`]; the bias starts at zero with this standard deviation, rad/s.
    FirstFix([f64; 3]),
    /// Truth with an error drawn from this covariance, at the first time.
    Drawn(Box<Matrix<f64, 6, 6>>),
}

/// A filter or smoother, and what it knows of the sensors.
#[derive(Clone, Debug)]
pub struct Estimator {
    /// The filter.
    pub filter: AnyFilter,
    /// Noise of the gyro.
    pub model: GyroModel,
    /// What a gyro sample says.
    pub timing: GyroTiming,
    /// How far measurements are believed.
    pub trust: Trust,
    /// From measured rates to rates of the body: mounting, and scale factors and misalignments taken out.
    pub gyro_turn: Option<Matrix<f64, 3, 3>>,
    /// One for each camera of the scenario.
    pub cameras: Vec<KnownCamera>,
    /// The start.
    pub begin: Begin,
    /// Whether to smooth.
    pub smooth: bool,
}

/// What a campaign runs.
#[derive(Clone, Debug)]
pub struct Campaign<'a> {
    /// What is flown.
    pub scenario: Scenario<'a>,
    /// What estimates it.
    pub estimators: Vec<Estimator>,
    /// Key of all random numbers.
    pub seed: u64,
    /// Numbers of the trials.
    pub trials: Range<u64>,
    /// Time left out of the scores at the start, for a smoother also at the end, s.
    pub skip: f64,
    /// Instruction set of the filters.
    pub level: Level,
}

/// One estimator's result in one trial; an error if its covariance broke down.
pub type Scored = Result<Score>;

/// Runs all trials, by number of the trial and then of the estimator. The same bits for any number of
/// threads. `poll` is called on the calling thread, at least 20 times a second, with the number of
/// trials done, and may end the campaign.
///
/// # Errors
/// What `poll` returns; input that no estimator can run on. A filter that breaks down in a trial is a
/// result, not an error.
pub fn monte_carlo(
    campaign: &Campaign<'_>,
    threads: usize,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<Vec<Scored>>> {
    let shared = Shared::new(campaign)?;
    let stop = AtomicBool::new(false);
    let trials = campaign.trials.clone();
    let count = trials.end.saturating_sub(trials.start);
    let size = side_by_side(campaign.scenario.truth.t.len()) as u64;
    let block = |worker: &mut Worker<'_>, number: u64| {
        let first = trials.start + number * size;
        worker.block(first..(first + size).min(trials.end))
    };
    let work = (|| Worker::new(&shared, &stop), block);
    let done = over_threads(0..count.div_ceil(size), threads, &stop, work, &mut |blocks| {
        poll((blocks * size as usize).min(count as usize))
    })?;
    Ok(done.into_iter().flatten().collect())
}

/// What all threads read.
struct Shared<'a> {
    campaign: &'a Campaign<'a>,
    /// Noise of each fix, by estimator and camera; empty where fixes bring their own.
    noise: Vec<Vec<Vec<[f64; 6]>>>,
    /// Whether there is a fix at a time of the truth, or since the one before, in every trial.
    fixed: Vec<bool>,
}

/// Marks the times of the truth at or after those of fixes.
fn mark(fixed: &mut [bool], truth: &[f64], fixes: &[f64]) {
    for t in fixes {
        if let Some(at) = fixed.get_mut(truth.partition_point(|s| s < t)) {
            *at = true;
        }
    }
}

impl<'a> Shared<'a> {
    fn new(campaign: &'a Campaign<'a>) -> Result<Self> {
        let (truth, cameras) = (&campaign.scenario.truth, &campaign.scenario.cameras);
        if truth.t.is_empty() {
            return Err(Error::Empty { field: "truth" });
        }
        let same = |field, found, expected| {
            if found == expected { Ok(()) } else { Err(Error::Length { field, expected, found }) }
        };
        same("truth.q", truth.q.len(), truth.t.len())?;
        same("truth.rate", truth.rate.len(), truth.t.len())?;
        let mut fixed = vec![false; truth.t.len()];
        for camera in cameras {
            let (t, q) = camera.frames();
            same("star.q", q.len(), t.len())?;
            if let StarSource::Noise(camera) = camera {
                mark(&mut fixed, truth.t, camera.t);
            }
        }
        let mut noise = Vec::new();
        for e in &campaign.estimators {
            same("estimator cameras", e.cameras.len(), cameras.len())?;
            let always = |(known, camera): (&KnownCamera, &StarSource<'_>)| match camera {
                StarSource::Noise(camera) => vec![known.noise; camera.t.len()],
                StarSource::Field(_) => Vec::new(),
            };
            noise.push(e.cameras.iter().zip(cameras).map(always).collect());
        }
        Ok(Self { campaign, noise, fixed })
    }
}

/// Memory that trials side by side may take in each thread, in bytes, and what a row of one takes.
const MEMORY: usize = 384 << 20;
const ROW: usize = 640;

/// Trials that run side by side: all lanes, or one where eight trials take too much memory. By the scenario alone, so that
/// a trial's result does not depend on how a campaign is cut.
fn side_by_side(steps: usize) -> usize {
    if MEMORY / (ROW * steps.max(1)) < LANES { 1 } else { LANES }
}

/// One trial's memory.
#[derive(Default)]
struct Trial {
    number: u64,
    readings: Readings,
    /// Where there are fixes in this trial; see [`Shared`].
    fixed: Vec<bool>,
    own: Own,
    buffers: Buffers,
}

/// Readings in the body frame, where a mounting makes them differ from the sensors'.
#[derive(Default)]
struct Own {
    rate: Vec<[f64; 3]>,
    fixes: Vec<Vec<Quaternion<f64>>>,
    /// Noise of fixes that bring their own.
    noise: Vec<Vec<[f64; 6]>>,
    /// Biases as an estimator sees them.
    bias: Vec<[f64; 3]>,
}

/// A trial as an estimator sees it.
struct View<'a> {
    number: u64,
    rate: &'a [[f64; 3]],
    bias: &'a [[f64; 3]],
    fixed: &'a [bool],
    fixes: Vec<&'a [Quaternion<f64>]>,
    true_fixes: Vec<&'a [Quaternion<f64>]>,
    series: Vec<AttitudeSensor<'a>>,
}

impl Trial {
    fn simulate(&mut self, shared: &Shared<'_>, number: u64, stop: &AtomicBool) -> Result<()> {
        let campaign = shared.campaign;
        self.number = number;
        campaign.scenario.simulate(campaign.seed, number, &mut self.readings, &mut || keep_on(stop))?;
        self.fixed.clone_from(&shared.fixed);
        for (camera, fixes) in campaign.scenario.cameras.iter().zip(&self.readings.fixes) {
            if matches!(camera, StarSource::Field(_)) {
                mark(&mut self.fixed, campaign.scenario.truth.t, camera.known(fixes).0);
            }
        }
        Ok(())
    }

    /// What estimator `e` sees, and the memory for its results.
    fn view<'a>(
        &'a mut self,
        campaign: &'a Campaign<'_>,
        e: &Estimator,
        noise: &'a [Vec<[f64; 6]>],
    ) -> (View<'a>, &'a mut Buffers) {
        let Self { number, readings, fixed, own, buffers } = self;
        let cameras = &campaign.scenario.cameras;
        own.fixes.resize_with(cameras.len(), Vec::new);
        own.noise.resize_with(cameras.len(), Vec::new);
        let rate = turned(e.gyro_turn.as_ref(), &readings.rate, &mut own.rate);
        let bias = bias_of(e.gyro_turn.as_ref(), &campaign.scenario.gyro, &readings.bias, &mut own.bias);
        let kept = readings.fixes.iter().zip(&mut own.fixes).zip(&e.cameras);
        let fixes: Vec<&[Quaternion<f64>]> = kept.map(|((f, own), c)| of_body(c.mounting, &f.q, own)).collect();
        let known: Vec<_> = cameras.iter().zip(&readings.fixes).map(|(c, f)| c.known(f)).collect();
        let always = readings.fixes.iter().zip(&mut own.noise).zip(noise).zip(&e.cameras);
        let noise = always.map(|(((f, own), always), c)| noise_of(c.mounting, f, always, own));
        let series = (fixes.iter().zip(&known).zip(noise))
            .map(|((q, (t, _)), noise)| AttitudeSensor::Star(StarSeries { t, q, noise: noise.into(), mounting: None }))
            .collect();
        let true_fixes = known.into_iter().map(|(_, q)| q).collect();
        (View { number: *number, rate, bias, fixed, fixes, true_fixes, series }, buffers)
    }
}

/// One thread's memory.
struct Worker<'a> {
    shared: &'a Shared<'a>,
    stop: &'a AtomicBool,
    trials: Vec<Trial>,
}

impl<'a> Worker<'a> {
    fn new(shared: &'a Shared<'a>, stop: &'a AtomicBool) -> Self {
        Self { shared, stop, trials: Vec::new() }
    }

    /// Some trials side by side: their scores, by trial and estimator.
    fn block(&mut self, numbers: Range<u64>) -> Result<Vec<Vec<Scored>>> {
        let count = (numbers.end - numbers.start) as usize;
        self.trials.resize_with(count.max(self.trials.len()), Trial::default);
        for (trial, number) in self.trials.iter_mut().zip(numbers) {
            trial.simulate(self.shared, number, self.stop)?;
        }
        let mut out: Vec<Vec<Scored>> = (0..count).map(|_| Vec::new()).collect();
        for number in 0..self.shared.campaign.estimators.len() {
            for (scores, score) in out.iter_mut().zip(self.estimate(number, count)?) {
                scores.push(score);
            }
        }
        Ok(out)
    }

    /// Runs one estimator on the readings and scores it.
    fn estimate(&mut self, number: usize, count: usize) -> Result<Vec<Scored>> {
        let campaign = self.shared.campaign;
        let truth = &campaign.scenario.truth;
        let e = &campaign.estimators[number];
        let noise = &self.shared.noise[number];
        let seen = self.trials[..count].iter_mut().map(|trial| trial.view(campaign, e, noise));
        let (views, mut buffers): (Vec<View<'_>>, Vec<&mut Buffers>) = seen.unzip();
        let gyros: Vec<_> =
            views.iter().map(|v| GyroSeries { t: truth.t, rate: v.rate, turn: None, timing: e.timing }).collect();
        let sensors: Vec<_> = views.iter().map(|v| AttitudeSensors::new(&v.series, e.trust)).collect::<Result<_>>()?;
        let mut flights = Vec::with_capacity(count);
        for (((view, gyro), sensors), buffers) in views.iter().zip(&gyros).zip(&sensors).zip(&mut buffers) {
            let start = match &e.begin {
                Begin::FirstFix(bias_sigma) => first_fix(gyro, sensors, &e.model, [0.0; 3], *bias_sigma)?,
                Begin::Drawn(covariance) => {
                    drawn(campaign, view.number, covariance, &Attitude { q: truth.q[0], bias: view.bias[0] })
                }
            };
            let needed = rows(gyro, sensors, &start, Output::Every(1))?;
            if needed.output != buffers.t.len() || needed.measured != buffers.measured_t.len() {
                **buffers = Buffers::new(needed, true);
            }
            let (columns, measured) = buffers.columns();
            flights.push(Flight { log: Log { model: &e.model, gyro, sensors }, start, columns, measured });
        }
        let began = Instant::now();
        let ends = run_or_smooth(e, flights, campaign.level, side_by_side(truth.t.len()) > 1, self.stop)?;
        let seconds = began.elapsed().as_secs_f64() / count as f64;

        let last = if e.smooth { truth.t[truth.t.len() - 1] - campaign.skip } else { f64::INFINITY };
        let window = [truth.t[0] + campaign.skip, last];
        let mut scored = Vec::with_capacity(count);
        for ((view, buffers), end) in views.into_iter().zip(buffers).zip(ends) {
            let View { bias, fixed, true_fixes, fixes, .. } = view;
            let flown = Flown { truth, bias, fixed, true_fixes, fixes, window };
            scored.push(match end.and_then(|end| flown.score(buffers, &end, seconds)) {
                Err(error @ Error::NotPositiveDefinite { .. }) => Err(error),
                other => Ok(other?),
            });
        }
        Ok(scored)
    }
}

/// The one place where trials meet a filter or a smoother.
fn run_or_smooth(
    e: &Estimator,
    flights: Vec<Flight<'_>>,
    level: Level,
    lanes: bool,
    stop: &AtomicBool,
) -> Result<Vec<Result<End<AttitudeBias, 6>>>> {
    let options = Options { output: Output::Every(1), level };
    if lanes && !e.smooth {
        return run_many(&e.filter, flights, &options, &mut |_| keep_on(stop));
    }
    let one = |flight: Flight<'_>| {
        let Flight { log, start, columns, measured } = flight;
        let call = if e.smooth { smooth } else { run };
        let end = call(&e.filter, log, &start, &options, columns, measured, &mut |_| keep_on(stop));
        if let Err(Error::Interrupted) = end { Err(Error::Interrupted) } else { Ok(end) }
    };
    flights.into_iter().map(one).collect()
}

/// Truth with an error drawn from the covariance; truth = start ⊞ error.
fn drawn(
    campaign: &Campaign<'_>,
    trial: u64,
    covariance: &Matrix<f64, 6, 6>,
    truth: &Attitude<f64>,
) -> Start<AttitudeBias, 6> {
    let root = cholesky_semidefinite(covariance);
    let error = apply(&root, &Stream::new(campaign.seed, trial, channel::START).normals());
    let mean = AttitudeBias::retract(truth, &error.map(|x| -x));
    Start { t: campaign.scenario.truth.t[0], mean, covariance: *covariance, used: None }
}

/// Rates of the gyro frame as rates of the body.
fn turned<'a>(turn: Option<&Matrix<f64, 3, 3>>, rate: &'a [[f64; 3]], own: &'a mut Vec<[f64; 3]>) -> &'a [[f64; 3]] {
    let Some(turn) = turn else { return rate };
    own.clear();
    own.extend(rate.iter().map(|w| apply(turn, w)));
    own
}

/// True biases of the gyro as an estimator sees them, behind what it does to the readings.
fn bias_of<'a>(
    turn: Option<&Matrix<f64, 3, 3>>,
    gyro: &GyroErrors,
    bias: &'a [[f64; 3]],
    own: &'a mut Vec<[f64; 3]>,
) -> &'a [[f64; 3]] {
    if turn.is_none() && gyro.mounting.is_none() {
        return bias;
    }
    let back = gyro.mounting.map(|m| conjugate(&m));
    own.clear();
    own.extend(bias.iter().map(|b| {
        let read = back.map_or(*b, |q| rotate(&q, b));
        turn.map_or(read, |turn| apply(turn, &read))
    }));
    own
}

/// Fixes of a camera as fixes of the body.
fn of_body<'a>(
    mounting: Option<Quaternion<f64>>,
    q: &'a [Quaternion<f64>],
    own: &'a mut Vec<Quaternion<f64>>,
) -> &'a [Quaternion<f64>] {
    let Some(m) = mounting else { return q };
    let back = conjugate(&m);
    own.clear();
    own.extend(q.iter().map(|q| multiply(q, &back)));
    own
}

/// Noise of a camera's fixes in the body frame: their own, or what is always assumed.
fn noise_of<'a>(
    mounting: Option<Quaternion<f64>>,
    fixes: &Fixes,
    always: &'a [[f64; 6]],
    own: &'a mut Vec<[f64; 6]>,
) -> &'a [[f64; 6]] {
    if fixes.covariance.is_empty() {
        return always;
    }
    let turn = mounting.map(|m| to_matrix(&m));
    own.clear();
    own.extend(fixes.covariance.iter().map(|p| {
        let p = turn.as_ref().map_or(*p, |turn| mul(turn, &mul(p, &transpose(turn))));
        [p[(0, 0)], p[(0, 1)], p[(0, 2)], p[(1, 1)], p[(1, 2)], p[(2, 2)]]
    }));
    own
}

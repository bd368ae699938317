//! A whole log in one call.

use super::results::{Pass, Results};
use super::sensors::CelestialSensors;
use crate::cloud::{Bank, Bootstrap, Literal, Proposal, Settings};
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, Iterated, Score, SrUkf, Ukf};
use crate::manifold::{Euclidean, Family};
use crate::model::Dynamics;
use crate::orbit::{Nothing, OrbitModel};
use crate::replay::{Drive, End, Output, Recorder, Replay, Sampled, Start, smooth as back};
use crate::scalar::{Baseline, Level, Real, Run, Runner};
use crate::simulate::rng::{Stream, channel};

/// The filters, chosen at run time, once per run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyFilter {
    /// Extended Kalman filter.
    Ekf(Ekf),
    /// Unscented Kalman filter.
    Ukf(Ukf),
    /// Square-root unscented Kalman filter.
    SrUkf(SrUkf),
    /// Extended Kalman filter that re-linearises the last interval.
    Iterated(Iterated),
    /// Score-function filter; for angles used one by one.
    Score(Score),
    /// Particles.
    Cloud(Form, Settings),
}

/// The particle filters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// See [`Proposal`].
    Proposal,
    /// See [`Literal`].
    Literal,
    /// See [`Bank`].
    Bank,
    /// See [`Bootstrap`].
    Bootstrap,
}

/// A satellite's dynamics and what it measured.
#[derive(Clone, Copy, Debug)]
pub struct Log<'a> {
    /// How it moves.
    pub dynamics: &'a OrbitModel,
    /// Times that the run stops at, s, increasing: the last one ends it.
    pub times: &'a [f64],
    /// All measurements.
    pub sensors: &'a CelestialSensors<'a>,
}

/// How to compute, and how often to write.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Rows are written at the start and at every n-th of the times.
    pub every: usize,
    /// Instruction set.
    pub level: Level,
    /// Seed and trial of the particles' random numbers.
    pub random: (u64, u64),
}

/// Times without inputs between them.
struct Times<'a>(&'a [f64]);

impl<D: Dynamics<N, Input = Nothing>, const N: usize> Drive<D, N> for Times<'_> {
    fn times(&self) -> &[f64] {
        self.0
    }
    #[inline(always)]
    fn input<T: Real>(&self, _: usize) -> <Nothing as Family>::Of<T> {}
}

/// Estimates the orbit over a log; `results` is overwritten.
///
/// # Errors
/// See [`Replay::run`].
pub fn run(
    filter: &AnyFilter,
    log: Log<'_>,
    start: &Start<Euclidean<6>, 6>,
    options: &Options,
    results: &mut Results,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<End<Euclidean<6>, 6>> {
    Call { log, start, options, results, poll, back: false }.dispatch(filter)
}

/// Goes over a log forward and back: every row knows all measurements, before and after it. Measurements
/// are reported as the forward pass saw them. `poll` is called with numbers up to twice that of the times.
///
/// # Errors
/// See [`Replay::run`].
pub fn smooth(
    filter: &AnyFilter,
    log: Log<'_>,
    start: &Start<Euclidean<6>, 6>,
    options: &Options,
    results: &mut Results,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<End<Euclidean<6>, 6>> {
    Call { log, start, options, results, poll, back: true }.dispatch(filter)
}

struct Call<'a> {
    log: Log<'a>,
    start: &'a Start<Euclidean<6>, 6>,
    options: &'a Options,
    results: &'a mut Results,
    poll: &'a mut dyn FnMut(usize) -> Result<()>,
    back: bool,
}

impl Call<'_> {
    /// The one place where filters and the orbit meet.
    fn dispatch(self, filter: &AnyFilter) -> Result<End<Euclidean<6>, 6>> {
        let level = self.options.level;
        match filter {
            AnyFilter::Ekf(f) => self.with(level, f),
            AnyFilter::Ukf(f) => self.with(level, f),
            AnyFilter::SrUkf(f) => self.with(level, f),
            AnyFilter::Iterated(f) => self.with(Baseline, f),
            AnyFilter::Score(f) => self.with(level, f),
            AnyFilter::Cloud(form, settings) => self.sampled(*form, *settings),
        }
    }

    fn sampled(self, form: Form, settings: Settings) -> Result<End<Euclidean<6>, 6>> {
        if self.back {
            let need = "do not go with smoothing: particles have no way back; smooth the UKF";
            return Err(Error::Parameter { field: "particles", value: settings.particles as f64, need });
        }
        self.results.clear();
        let Log { dynamics, times, sensors } = self.log;
        let pass = Pass { results: self.results, sensors, recorder: None };
        let replay = Sampled { dynamics, drive: &Times(times), sensors, every: self.options.every.max(1) };
        let (seed, trial) = self.options.random;
        let stream = Stream::new(seed, trial, channel::PARTICLES);
        let job = CloudJob { replay, start: self.start, pass, settings, stream, poll: self.poll };
        let level = self.options.level;
        match form {
            Form::Proposal => level.run(ProposalJob(job)),
            Form::Literal => level.run(LiteralJob(job)),
            Form::Bank => level.run(BankJob(job)),
            Form::Bootstrap => level.run(BootstrapJob(job)),
        }
    }

    fn with<F: Filter>(self, runner: impl Runner, filter: &F) -> Result<End<Euclidean<6>, 6>> {
        self.results.clear();
        let Log { dynamics, times, sensors } = self.log;
        let output = Output::Every(self.options.every.max(1));
        // no more steps than times and measurements together
        let recorder = self.back.then(|| Recorder::new(times.len() + sensors.count(), times.len()));
        let pass = Pass { results: self.results, sensors, recorder };
        let replay = Replay { filter, dynamics, drive: &Times(times), sensors, output };
        let end = runner.run(Job { replay, start: self.start, pass, poll: self.poll })?;
        Ok(end)
    }
}

/// A pass of one filter, and the way back if it was recorded.
struct Job<'a, 'c, F> {
    replay: Replay<'c, F, OrbitModel, Times<'c>, CelestialSensors<'c>>,
    start: &'c Start<Euclidean<6>, 6>,
    pass: Pass<'a>,
    poll: &'c mut dyn FnMut(usize) -> Result<()>,
}

impl<F: Filter> Run for Job<'_, '_, F> {
    type Output = Result<End<Euclidean<6>, 6>>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(mut self) -> Self::Output {
        let end = self.replay.run::<T, _, 6>(self.start, &mut self.pass, self.poll)?;
        if let Some(recorder) = self.pass.recorder.take() {
            let (times, poll) = (self.replay.drive.0.len(), self.poll);
            let parts = (self.replay.filter, self.replay.dynamics, self.replay.drive);
            back::<F, _, _, _, T, 6>(parts, recorder, &end, &mut self.pass, &mut |k| poll(2 * times - k))?;
            self.pass.results.reverse();
        }
        Ok(end)
    }
}

/// A pass of a particle filter.
struct CloudJob<'a, 'c> {
    replay: Sampled<'c, OrbitModel, Times<'c>, CelestialSensors<'c>>,
    start: &'c Start<Euclidean<6>, 6>,
    pass: Pass<'a>,
    settings: Settings,
    stream: Stream,
    poll: &'c mut dyn FnMut(usize) -> Result<()>,
}

macro_rules! cloud_jobs {
    ($($job:ident $cloud:ident),*) => {$(
        struct $job<'a, 'c>(CloudJob<'a, 'c>);
        impl Run for $job<'_, '_> {
            type Output = Result<End<Euclidean<6>, 6>>;
            #[inline(always)]
            fn run<T: Real<Mask = bool>>(self) -> Self::Output {
                let CloudJob { replay, start, mut pass, settings, stream, poll } = self.0;
                let mut cloud = $cloud::<Euclidean<6>, T, 6>::new(&start.mean, &start.covariance, settings, stream)?;
                replay.run::<T, _, _, 6>(start, &mut cloud, &mut pass, poll)
            }
        }
    )*};
}
cloud_jobs!(ProposalJob Proposal, LiteralJob Literal, BankJob Bank, BootstrapJob Bootstrap);

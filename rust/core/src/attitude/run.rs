//! A whole log in one call: columns in, columns out.

use super::calibration::{CALIBRATED, CalibratedSpace, Calibration, GuidedSeries, guide};
use super::columns::{Buffers, Columns, Measured, rows};
use super::gyro::{GyroInputs, GyroModel};
use super::invariant::Invariant;
use super::literal::LiteralModel;
use super::series::{AttitudeSensors, GyroSeries};
use super::state::AttitudeBias;
use super::system::{Seen, System};
use super::writer::Writer;
use crate::belief::Belief;
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, Iterated, SrUkf, Ukf};
use crate::replay::{Drive, End, Output, Recorder, Replay, Report, Sink, Start, smooth as back};
use crate::scalar::{Baseline, Level, Real, Run, Runner};
use std::cell::Cell;

/// The filters, chosen at run time, once per run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyFilter {
    /// Multiplicative extended Kalman filter.
    Ekf(Ekf),
    /// Unscented Kalman filter.
    Ukf(Ukf),
    /// Square-root unscented Kalman filter.
    SrUkf(SrUkf),
    /// Extended Kalman filter that re-linearises the last interval.
    Iterated(Iterated),
    /// Right-invariant extended Kalman filter: the error on the inertial side, no reset.
    Invariant,
    /// Unscented Kalman filter on the literal error-quaternion state of the paper.
    Literal(Ukf),
}

/// What to write, and how to compute it.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// At which times.
    pub output: Output,
    /// Instruction set.
    pub level: Level,
}

/// A system and its log.
#[derive(Clone, Copy, Debug)]
pub struct Log<'a> {
    /// The gyro's noise and the kinematics.
    pub model: &'a GyroModel,
    /// The gyro's samples.
    pub gyro: &'a GyroSeries<'a>,
    /// All measurements.
    pub sensors: &'a AttitudeSensors<'a>,
}

/// Replays a log into columns that have the rows that [`rows`] counts.
///
/// # Errors
/// See [`Replay::run`]; also columns of another length.
pub fn run<'a>(
    filter: &AnyFilter,
    log: Log<'a>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    columns: Columns<'a>,
    measured: Measured<'a>,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<End<AttitudeBias, 6>> {
    Call { log, start, options, columns, measured, poll, back: false }.dispatch(filter)
}

/// Replays a log forward and goes back over it: every row knows all measurements, before and after it.
/// Measurements are reported as the forward pass saw them. `poll` is called with numbers up to twice that
/// of the input samples.
///
/// # Errors
/// See [`run`]; also an output at a period of its own.
pub fn smooth<'a>(
    filter: &AnyFilter,
    log: Log<'a>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    columns: Columns<'a>,
    measured: Measured<'a>,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<End<AttitudeBias, 6>> {
    if let Output::Period(value) = options.output {
        let need = "does not go with smoothing, which writes at gyro samples; use every";
        return Err(Error::Parameter { field: "period", value, need });
    }
    Call { log, start, options, columns, measured, poll, back: true }.dispatch(filter)
}

/// How often [`calibrate`] goes over a log: there, back, and there again with the calibration, twice.
pub const CALIBRATION_PASSES: usize = 6;

/// Replays a log with the extended Kalman filter on the state that also holds calibration parameters. A
/// smoothed attitude guides it; the second time it is that of the gyro corrected by what the first time
/// has found. `poll` is called with numbers up to [`CALIBRATION_PASSES`] times that of the samples.
///
/// # Errors
/// See [`run`].
pub fn calibrate<'a>(
    calibration: &Calibration,
    log: Log<'a>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    columns: Columns<'a>,
    measured: Measured<'a>,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<End<CalibratedSpace, CALIBRATED>> {
    let n = log.gyro.t.len();
    let every = Options { output: Output::Every(1), ..*options };
    let first = {
        let guide = smoothed_rates(calibration, log, start, &every, poll)?;
        let drive = GuidedSeries { gyro: log.gyro, guide: &guide };
        let mut memory = Buffers::new(rows(log.gyro, log.sensors, start, every.output)?, false);
        let (columns, measured) = memory.columns();
        let poll = &mut |k| poll(2 * n + k);
        let call = Call { log, start, options: &every, columns, measured, poll, back: false };
        call.pass(Baseline, &Ekf::default(), calibration, &drive)?.mean
    };
    let rate: Vec<[f64; 3]> = (0..n).map(|k| first.corrected(&log.gyro.at(k))).collect();
    let corrected = Log { gyro: &GyroSeries { rate: &rate, turn: None, ..*log.gyro }, ..log };
    let guide = smoothed_rates(calibration, corrected, start, &every, &mut |k| poll(3 * n + k))?;
    let drive = GuidedSeries { gyro: log.gyro, guide: &guide };
    let poll = &mut |k| poll(5 * n + k);
    let call = Call { log, start, options, columns, measured, poll, back: false };
    call.check()?;
    call.pass(Baseline, &Ekf::default(), calibration, &drive)
}

/// Rates of the smoothed attitude that the gyro and the cameras of known alignment give.
fn smoothed_rates(
    calibration: &Calibration,
    log: Log<'_>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<[f64; 3]>> {
    let (gyro, sensors) = (log.gyro, log.sensors.without(calibration.aligned)?);
    let used = start.used.and_then(|i| sensors.find(log.sensors.source(i)));
    let start = Start { used, ..*start };
    let mut memory = Buffers::new(rows(gyro, &sensors, &start, options.output)?, false);
    let (columns, measured) = memory.columns();
    let log = Log { sensors: &sensors, ..log };
    smooth(&AnyFilter::Ekf(Ekf::default()), log, &start, options, columns, measured, poll)?;
    let first = gyro.t.partition_point(|t| *t <= start.t).saturating_sub(1);
    Ok(guide(gyro, first, &memory.t, &memory.q))
}

/// One call of [`run`], [`smooth`] or [`calibrate`].
struct Call<'a, 'c> {
    log: Log<'a>,
    start: &'c Start<AttitudeBias, 6>,
    options: &'c Options,
    columns: Columns<'a>,
    measured: Measured<'a>,
    poll: &'c mut dyn FnMut(usize) -> Result<()>,
    back: bool,
}

impl Call<'_, '_> {
    /// The one place where filters and systems meet.
    fn dispatch(self, filter: &AnyFilter) -> Result<End<AttitudeBias, 6>> {
        self.check()?;
        if matches!(filter, AnyFilter::Iterated(_)) && !self.log.sensors.trust().is_plain() {
            return Err(Error::NotRobust);
        }
        let model = *self.log.model;
        let level = self.options.level;
        match filter {
            AnyFilter::Ekf(f) => self.with(level, f, &model),
            AnyFilter::Ukf(f) => self.with(level, f, &model),
            AnyFilter::SrUkf(f) => self.with(level, f, &model),
            AnyFilter::Iterated(f) => self.with(Baseline, f, &model),
            AnyFilter::Invariant => self.with(Baseline, &Ekf { reset: false }, &Invariant(model)),
            AnyFilter::Literal(f) => self.with(level, f, &LiteralModel(model)),
        }
    }

    fn check(&self) -> Result<()> {
        let same = |field, found, expected| {
            if found == expected { Ok(()) } else { Err(Error::Length { field, expected, found }) }
        };
        let log = &self.log;
        same("gyro.rate", log.gyro.rate.len(), log.gyro.t.len())?;
        let rows = rows(log.gyro, log.sensors, self.start, self.options.output)?;
        let (c, m) = (&self.columns, &self.measured);
        for found in [c.t.len(), c.q.len(), c.rate.len(), c.bias.len(), c.sigma.len()] {
            same("output column", found, rows.output)?;
        }
        let lengths =
            [m.t.len(), m.sensor.len(), m.row.len(), m.dof.len(), m.nis.len(), m.accepted.len(), m.innovation.len()];
        if !m.scale.is_empty() {
            same("noise scale", m.scale.len(), log.sensors.sensors().len())?;
        }
        for found in lengths.into_iter().chain([m.innovation_sigma.len()]).filter(|found| *found > 0) {
            same("measurement column", found, rows.measured)?;
        }
        Ok(())
    }

    fn with<F: Filter, Y: System<N, Input = GyroInputs>, const N: usize>(
        self,
        runner: impl Runner,
        filter: &F,
        system: &Y,
    ) -> Result<End<AttitudeBias, 6>> {
        let gyro = self.log.gyro;
        let end = self.pass(runner, filter, system, gyro)?;
        Ok(End {
            t: end.t,
            mean: system.attitude(&end.mean),
            covariance: system.covariance(&end.mean, &end.covariance),
            outside: end.outside,
            log_likelihood: end.log_likelihood,
        })
    }

    fn pass<F: Filter, Y: System<N>, I: Drive<Y, N>, const N: usize>(
        mut self,
        runner: impl Runner,
        filter: &F,
        system: &Y,
        drive: &I,
    ) -> Result<End<Y::Space, N>> {
        let (mean, covariance) = system.start(&self.start.mean, &self.start.covariance);
        let start = Start { t: self.start.t, mean, covariance, used: self.start.used };
        let rows = self.columns.t.len();
        let mut own = Vec::new();
        let mut scale = std::mem::take(&mut self.measured.scale);
        if scale.is_empty() && !self.log.sensors.trust().is_plain() {
            own.resize(self.log.sensors.sensors().len(), 1.0);
            scale = &mut own;
        }
        let scale = Cell::from_mut(scale).as_slice_of_cells();
        let writer = Writer::new(self.log, system, self.columns, self.measured, self.back);
        let sensors = Seen { sensors: self.log.sensors, system, scale };
        let output = self.options.output;
        let replay = Replay { filter, dynamics: system, drive, sensors: &sensors, output };
        // no more steps than samples and measurements together; memory not written is not used
        let nodes = self.log.gyro.t.len() + self.log.sensors.len();
        let recorder = self.back.then(|| Recorder::new(nodes, rows));
        let pass = Pass { writer, recorder };
        runner.run(Job { replay, start: &start, pass, poll: self.poll })
    }
}

/// Where a pass over the log reports to: straight to the writer, or to a recorder that a smoother reads.
struct Pass<'a, Y: System<N>, const N: usize> {
    writer: Writer<'a, Y>,
    recorder: Option<Recorder<Y::Space, N>>,
}

impl<Y: System<N>, const N: usize> Sink<Y::Space, N> for Pass<'_, Y, N> {
    #[inline(always)]
    fn state<T: Real, B: Belief<Y::Space, T, N>>(&mut self, t: f64, k: usize, belief: &B) {
        match &mut self.recorder {
            Some(recorder) => recorder.row(t, k),
            None => self.writer.state(t, k, belief),
        }
    }
    #[inline(always)]
    fn measured(&mut self, i: usize, report: &Report) {
        self.writer.measured(i, report);
    }
    #[inline(always)]
    fn leaving<T: Real, B: Belief<Y::Space, T, N>>(&mut self, t: f64, to: f64, k: usize, belief: &B) {
        if let Some(recorder) = &mut self.recorder {
            recorder.node(t, to, k, belief);
        }
    }
}

/// A pass of one filter on one system, and the way back if it was recorded.
struct Job<'a, 'c, F, Y: System<N>, I, const N: usize> {
    replay: Replay<'c, F, Y, I, Seen<'c, Y>>,
    start: &'c Start<Y::Space, N>,
    pass: Pass<'a, Y, N>,
    poll: &'c mut dyn FnMut(usize) -> Result<()>,
}

impl<F: Filter, Y: System<N>, I: Drive<Y, N>, const N: usize> Run for Job<'_, '_, F, Y, I, N> {
    type Output = Result<End<Y::Space, N>>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(mut self) -> Self::Output {
        let end = self.replay.run::<T, _, N>(self.start, &mut self.pass, self.poll)?;
        if let Some(recorder) = self.pass.recorder.take() {
            let (samples, poll) = (self.pass.writer.gyro.t.len(), self.poll);
            let parts = (self.replay.filter, self.replay.dynamics, self.replay.drive);
            back::<F, Y, _, _, T, N>(parts, recorder, &end, &mut self.pass.writer, &mut |k| poll(2 * samples - k))?;
        }
        Ok(end)
    }
}

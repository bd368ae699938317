//! A whole log in one call: columns in, columns out.

use super::gyro::GyroModel;
use super::series::{AttitudeSensors, GyroSeries};
use super::state::AttitudeBias;
use crate::belief::Belief;
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, SrUkf, Ukf};
use crate::replay::{Drive, End, MAX_DOF, Output, Replay, Report, Sensors, Sink, Start};
use crate::scalar::{Level, Real, Run};

/// The filters, chosen at run time, once per run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyFilter {
    /// Multiplicative extended Kalman filter.
    Ekf(Ekf),
    /// Unscented Kalman filter.
    Ukf(Ukf),
    /// Square-root unscented Kalman filter.
    SrUkf(SrUkf),
}

/// What to write, and how to compute it.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// At which times.
    pub output: Output,
    /// Instruction set.
    pub level: Level,
}

/// Columns over the output times, to be written. All have [`Rows::output`] rows.
#[derive(Debug, Default)]
pub struct Columns<'a> {
    /// Times, s.
    pub t: &'a mut [f64],
    /// Attitudes `q_ib`, sign-continuous.
    pub q: &'a mut [[f64; 4]],
    /// Body rates, measured less bias, rad/s.
    pub rate: &'a mut [[f64; 3]],
    /// Gyro biases, rad/s.
    pub bias: &'a mut [[f64; 3]],
    /// Standard deviations of the six error states, rad and rad/s.
    pub sigma: &'a mut [[f64; 6]],
    /// Covariances of the error state; no rows if they are not wanted.
    pub covariance: &'a mut [[[f64; 6]; 6]],
}

/// Columns over the measurements, to be written. All have [`Rows::measured`] rows.
#[derive(Debug, Default)]
pub struct Measured<'a> {
    /// Times, s.
    pub t: &'a mut [f64],
    /// Number of the sensor.
    pub sensor: &'a mut [i32],
    /// Row in that sensor's table.
    pub row: &'a mut [i32],
    /// Degrees of freedom.
    pub dof: &'a mut [i32],
    /// Normalised innovation squared.
    pub nis: &'a mut [f64],
    /// Whether the measurement was inside the gate and used.
    pub accepted: &'a mut [bool],
    /// Innovations, rad.
    pub innovation: &'a mut [[f64; MAX_DOF]],
    /// Their standard deviations, rad.
    pub innovation_sigma: &'a mut [[f64; MAX_DOF]],
}

/// How many rows a run writes, exactly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rows {
    /// At the output times.
    pub output: usize,
    /// At the measurements.
    pub measured: usize,
}

/// Counts the rows that [`run`] writes.
///
/// # Errors
/// An output rate that is not positive, or so high that the rows cannot be counted.
pub fn rows(
    gyro: &GyroSeries<'_>,
    sensors: &AttitudeSensors<'_>,
    start: &Start<AttitudeBias, 6>,
    output: Output,
) -> Result<Rows> {
    let last = gyro.t.last().copied().unwrap_or(start.t);
    let inside = |i: usize| sensors.time(i) >= start.t && sensors.time(i) <= last;
    let measured = (0..sensors.len()).filter(|i| inside(*i) && start.used != Some(*i)).count();
    Ok(Rows { output: output_rows(gyro.t, start.t, last, output)?, measured })
}

/// Rows beyond which a period is taken for a mistake.
const MAX_ROWS: f64 = 1e9;

fn output_rows(times: &[f64], start: f64, last: f64, output: Output) -> Result<usize> {
    match output {
        Output::Every(0) => Err(Error::Parameter { field: "every", value: 0.0, need: "must be at least 1" }),
        Output::Every(n) => {
            // the start, then the n-th, 2n-th … sample after it
            let first = times.partition_point(|t| *t <= start).saturating_sub(1);
            Ok((times.len() - first).div_ceil(n))
        }
        Output::Period(p) if p.is_finite() && p > 0.0 => {
            let estimate = ((last - start) / p).max(0.0);
            if estimate > MAX_ROWS || last + p <= last {
                let need = "is too short for the log's span: it makes too many rows, or does not move the time";
                return Err(Error::Parameter { field: "period", value: p, need });
            }
            // the same expression as the replay's, so that rounding cannot make a difference
            let mut n = (estimate as usize).saturating_sub(1);
            while start + n as f64 * p <= last {
                n += 1;
            }
            Ok(n)
        }
        Output::Period(p) => Err(Error::Parameter { field: "period", value: p, need: "must be positive and finite" }),
    }
}

/// Columns with memory of their own, for use from Rust.
#[derive(Clone, Debug, Default)]
pub struct Buffers {
    /// See [`Columns::t`].
    pub t: Vec<f64>,
    /// See [`Columns::q`].
    pub q: Vec<[f64; 4]>,
    /// See [`Columns::rate`].
    pub rate: Vec<[f64; 3]>,
    /// See [`Columns::bias`].
    pub bias: Vec<[f64; 3]>,
    /// See [`Columns::sigma`].
    pub sigma: Vec<[f64; 6]>,
    /// See [`Columns::covariance`].
    pub covariance: Vec<[[f64; 6]; 6]>,
    /// See [`Measured::t`].
    pub measured_t: Vec<f64>,
    /// See [`Measured::sensor`], [`Measured::row`], [`Measured::dof`].
    pub source: [Vec<i32>; 3],
    /// See [`Measured::nis`].
    pub nis: Vec<f64>,
    /// See [`Measured::accepted`].
    pub accepted: Vec<bool>,
    /// See [`Measured::innovation`].
    pub innovation: Vec<[f64; MAX_DOF]>,
    /// See [`Measured::innovation_sigma`].
    pub innovation_sigma: Vec<[f64; MAX_DOF]>,
}

impl Buffers {
    /// Memory for a run.
    pub fn new(rows: Rows, covariance: bool) -> Self {
        let (n, m) = (rows.output, rows.measured);
        Self {
            t: vec![0.0; n],
            q: vec![[0.0; 4]; n],
            rate: vec![[0.0; 3]; n],
            bias: vec![[0.0; 3]; n],
            sigma: vec![[0.0; 6]; n],
            covariance: vec![[[0.0; 6]; 6]; if covariance { n } else { 0 }],
            measured_t: vec![0.0; m],
            source: std::array::from_fn(|_| vec![0; m]),
            nis: vec![0.0; m],
            accepted: vec![false; m],
            innovation: vec![[0.0; MAX_DOF]; m],
            innovation_sigma: vec![[0.0; MAX_DOF]; m],
        }
    }

    /// The columns to hand to [`run`].
    pub fn columns(&mut self) -> (Columns<'_>, Measured<'_>) {
        let [sensor, row, dof] = &mut self.source;
        let columns = Columns {
            t: &mut self.t,
            q: &mut self.q,
            rate: &mut self.rate,
            bias: &mut self.bias,
            sigma: &mut self.sigma,
            covariance: &mut self.covariance,
        };
        let measured = Measured {
            t: &mut self.measured_t,
            sensor,
            row,
            dof,
            nis: &mut self.nis,
            accepted: &mut self.accepted,
            innovation: &mut self.innovation,
            innovation_sigma: &mut self.innovation_sigma,
        };
        (columns, measured)
    }
}

struct Writer<'a> {
    columns: Columns<'a>,
    measured: Measured<'a>,
    gyro: &'a GyroSeries<'a>,
    sensors: &'a AttitudeSensors<'a>,
    written: Rows,
}

impl Sink<AttitudeBias, 6> for Writer<'_> {
    #[inline(always)]
    fn state<T: Real, B: Belief<AttitudeBias, T, 6>>(&mut self, t: f64, k: usize, belief: &B) {
        let row = self.written.output;
        self.written.output += 1;
        let x = belief.mean();
        let mut q = [x.q[0].lane(0), x.q[1].lane(0), x.q[2].lane(0), x.q[3].lane(0)];
        if row > 0 {
            let last = self.columns.q[row - 1];
            if last[0] * q[0] + last[1] * q[1] + last[2] * q[2] + last[3] * q[3] < 0.0 {
                q = [-q[0], -q[1], -q[2], -q[3]];
            }
        }
        let bias = [x.bias[0].lane(0), x.bias[1].lane(0), x.bias[2].lane(0)];
        let rate = match self.gyro.t.get(k + 1) {
            Some(next) if t >= *next => self.gyro.rate[k + 1],
            _ if t > self.gyro.t[k] => Drive::<GyroModel, 6>::input::<f64>(self.gyro, k).rate,
            _ => self.gyro.rate[k],
        };
        let variance = belief.variance();
        let mut sigma = [0.0; 6];
        for i in 0..6 {
            sigma[i] = variance[i].lane(0).sqrt();
        }
        self.columns.t[row] = t;
        self.columns.q[row] = q;
        self.columns.rate[row] = [rate[0] - bias[0], rate[1] - bias[1], rate[2] - bias[2]];
        self.columns.bias[row] = bias;
        self.columns.sigma[row] = sigma;
        if let Some(p) = self.columns.covariance.get_mut(row) {
            let cov = belief.covariance();
            for i in 0..6 {
                for j in 0..6 {
                    p[i][j] = cov[(i, j)].lane(0);
                }
            }
        }
    }

    #[inline(always)]
    fn measured(&mut self, i: usize, report: &Report) {
        let n = self.written.measured;
        self.written.measured += 1;
        let (sensor, row) = self.sensors.source(i);
        let m = &mut self.measured;
        m.t[n] = self.sensors.sensors()[sensor].times()[row];
        m.sensor[n] = sensor as i32;
        m.row[n] = row as i32;
        m.dof[n] = report.dof as i32;
        m.nis[n] = report.nis;
        m.accepted[n] = report.accepted;
        m.innovation[n] = report.innovation;
        for i in 0..MAX_DOF {
            m.innovation_sigma[n][i] = report.covariance[i][i].sqrt();
        }
    }
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
    let same = |field, found, expected| {
        if found == expected { Ok(()) } else { Err(Error::Length { field, expected, found }) }
    };
    same("gyro.rate", log.gyro.rate.len(), log.gyro.t.len())?;
    let rows = rows(log.gyro, log.sensors, start, options.output)?;
    let (c, m) = (&columns, &measured);
    for found in [c.t.len(), c.q.len(), c.rate.len(), c.bias.len(), c.sigma.len()] {
        same("output column", found, rows.output)?;
    }
    let lengths =
        [m.t.len(), m.sensor.len(), m.row.len(), m.dof.len(), m.nis.len(), m.accepted.len(), m.innovation.len()];
    for found in lengths.into_iter().chain([m.innovation_sigma.len()]) {
        same("measurement column", found, rows.measured)?;
    }
    let writer =
        Writer { columns, measured, gyro: log.gyro, sensors: log.sensors, written: Rows { output: 0, measured: 0 } };
    match filter {
        AnyFilter::Ekf(f) => run_with(f, log, start, options, writer, poll),
        AnyFilter::Ukf(f) => run_with(f, log, start, options, writer, poll),
        AnyFilter::SrUkf(f) => run_with(f, log, start, options, writer, poll),
    }
}

fn run_with<F: Filter>(
    filter: &F,
    log: Log<'_>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    writer: Writer<'_>,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<End<AttitudeBias, 6>> {
    let replay = Replay { filter, dynamics: log.model, drive: log.gyro, sensors: log.sensors, output: options.output };
    options.level.run(Job { replay, start, writer, poll })
}

struct Job<'a, F> {
    replay: Replay<'a, F, GyroModel, GyroSeries<'a>, AttitudeSensors<'a>>,
    start: &'a Start<AttitudeBias, 6>,
    writer: Writer<'a>,
    poll: &'a mut dyn FnMut(usize) -> Result<()>,
}

impl<F: Filter> Run for Job<'_, F> {
    type Output = Result<End<AttitudeBias, 6>>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(mut self) -> Self::Output {
        self.replay.run::<T, _, 6>(self.start, &mut self.writer, self.poll)
    }
}

//! A whole log in one call: columns in, columns out.

use super::gyro::GyroModel;
use super::series::{AttitudeSensors, GyroSeries};
use super::state::{Attitude, AttitudeBias};
use crate::belief::Belief;
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, SrUkf, Ukf};
use crate::linalg::Matrix;
use crate::replay::{MAX_DOF, Output, Replay, Report, Sink, Start};
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
    /// Whether to write full covariances.
    pub covariance: bool,
    /// Instruction set.
    pub level: Level,
}

/// Columns over the output times.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    /// Times, s.
    pub t: Vec<f64>,
    /// Attitudes `q_ib`, sign-continuous.
    pub q: Vec<[f64; 4]>,
    /// Body rates, measured less bias, rad/s.
    pub rate: Vec<[f64; 3]>,
    /// Gyro biases, rad/s.
    pub bias: Vec<[f64; 3]>,
    /// Standard deviations of the six error states, rad and rad/s.
    pub sigma: Vec<[f64; 6]>,
    /// Covariances of the error state, if asked for.
    pub covariance: Vec<[[f64; 6]; 6]>,
}

/// Columns over the measurements that were processed.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Times, s.
    pub t: Vec<f64>,
    /// Number of the sensor.
    pub sensor: Vec<i64>,
    /// Row in that sensor's table.
    pub row: Vec<i64>,
    /// Degrees of freedom.
    pub dof: Vec<i64>,
    /// Normalised innovation squared.
    pub nis: Vec<f64>,
    /// Whether the measurement was inside the gate and used.
    pub accepted: Vec<bool>,
    /// Innovations, rad.
    pub innovation: Vec<[f64; MAX_DOF]>,
    /// Covariances of the innovations, rad².
    pub covariance: Vec<[[f64; MAX_DOF]; MAX_DOF]>,
}

/// What a replay gives.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Columns over the output times.
    pub columns: Columns,
    /// Columns over the measurements.
    pub measured: Measured,
    /// Time of the last sample, s.
    pub t: f64,
    /// State at the end.
    pub mean: Attitude<f64>,
    /// Covariance of its error.
    pub covariance: Matrix<f64, 6, 6>,
    /// Measurements before the start or after the last gyro sample.
    pub outside: usize,
    /// Measurement that the start used up.
    pub used: Option<usize>,
}

struct Writer<'a> {
    columns: Columns,
    measured: Measured,
    gyro: &'a GyroSeries<'a>,
    sensors: &'a AttitudeSensors<'a>,
    covariance: bool,
}

impl<'a> Writer<'a> {
    fn new(gyro: &'a GyroSeries<'a>, sensors: &'a AttitudeSensors<'a>, rows: usize, covariance: bool) -> Self {
        let m = crate::replay::Sensors::len(sensors);
        Self {
            columns: Columns {
                t: Vec::with_capacity(rows),
                q: Vec::with_capacity(rows),
                rate: Vec::with_capacity(rows),
                bias: Vec::with_capacity(rows),
                sigma: Vec::with_capacity(rows),
                covariance: Vec::with_capacity(if covariance { rows } else { 0 }),
            },
            measured: Measured {
                t: Vec::with_capacity(m),
                sensor: Vec::with_capacity(m),
                row: Vec::with_capacity(m),
                dof: Vec::with_capacity(m),
                nis: Vec::with_capacity(m),
                accepted: Vec::with_capacity(m),
                innovation: Vec::with_capacity(m),
                covariance: Vec::with_capacity(m),
            },
            gyro,
            sensors,
            covariance,
        }
    }
}

impl Sink<AttitudeBias, 6> for Writer<'_> {
    #[inline(always)]
    fn state<T: Real, B: Belief<AttitudeBias, T, 6>>(&mut self, t: f64, k: usize, belief: &B) {
        let x = belief.mean();
        let mut q = [x.q[0].lane(0), x.q[1].lane(0), x.q[2].lane(0), x.q[3].lane(0)];
        if let Some(last) = self.columns.q.last() {
            let along = last[0] * q[0] + last[1] * q[1] + last[2] * q[2] + last[3] * q[3];
            if along < 0.0 {
                q = [-q[0], -q[1], -q[2], -q[3]];
            }
        }
        let bias = [x.bias[0].lane(0), x.bias[1].lane(0), x.bias[2].lane(0)];
        let rate = if t > self.gyro.t[k] && k + 1 < self.gyro.t.len() {
            crate::replay::Drive::<GyroModel, 6>::input::<f64>(self.gyro, k).rate
        } else {
            self.gyro.rate[k]
        };
        let variance = belief.variance();
        let mut sigma = [0.0; 6];
        for i in 0..6 {
            sigma[i] = variance[i].lane(0).sqrt();
        }
        self.columns.t.push(t);
        self.columns.q.push(q);
        self.columns.rate.push([rate[0] - bias[0], rate[1] - bias[1], rate[2] - bias[2]]);
        self.columns.bias.push(bias);
        self.columns.sigma.push(sigma);
        if self.covariance {
            let p = belief.covariance();
            self.columns.covariance.push(std::array::from_fn(|i| std::array::from_fn(|j| p[(i, j)].lane(0))));
        }
    }

    #[inline(always)]
    fn measured(&mut self, i: usize, report: &Report) {
        let (sensor, row) = self.sensors.source(i);
        let m = &mut self.measured;
        m.t.push(self.sensors.sensors()[sensor].times()[row]);
        m.sensor.push(sensor as i64);
        m.row.push(row as i64);
        m.dof.push(report.dof as i64);
        m.nis.push(report.nis);
        m.accepted.push(report.accepted);
        m.innovation.push(report.innovation);
        m.covariance.push(report.covariance);
    }
}

/// Replays a log.
///
/// # Errors
/// See [`Replay::run`]; also gyro columns of different length and an output rate that is not positive.
pub fn run(
    filter: &AnyFilter,
    model: &GyroModel,
    gyro: &GyroSeries<'_>,
    sensors: &AttitudeSensors<'_>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Solution> {
    if gyro.rate.len() != gyro.t.len() {
        return Err(Error::Length { field: "gyro rates", expected: gyro.t.len(), found: gyro.rate.len() });
    }
    let log = (model, gyro, sensors);
    match filter {
        AnyFilter::Ekf(f) => run_with(f, log, start, options, poll),
        AnyFilter::Ukf(f) => run_with(f, log, start, options, poll),
        AnyFilter::SrUkf(f) => run_with(f, log, start, options, poll),
    }
}

type Log<'a> = (&'a GyroModel, &'a GyroSeries<'a>, &'a AttitudeSensors<'a>);

fn run_with<F: Filter>(
    filter: &F,
    (dynamics, gyro, sensors): Log<'_>,
    start: &Start<AttitudeBias, 6>,
    options: &Options,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Solution> {
    let rows = output_rows(gyro.t, start.t, options.output)?;
    let job = Job {
        replay: Replay { filter, dynamics, drive: gyro, sensors, output: options.output },
        start,
        writer: Writer::new(gyro, sensors, rows, options.covariance),
        poll,
    };
    options.level.run(job)
}

struct Job<'a, F> {
    replay: Replay<'a, F, GyroModel, GyroSeries<'a>, AttitudeSensors<'a>>,
    start: &'a Start<AttitudeBias, 6>,
    writer: Writer<'a>,
    poll: &'a mut dyn FnMut(usize) -> Result<()>,
}

impl<F: Filter> Run for Job<'_, F> {
    type Output = Result<Solution>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(mut self) -> Result<Solution> {
        let end = self.replay.run::<T, _, 6>(self.start, &mut self.writer, self.poll)?;
        Ok(Solution {
            columns: self.writer.columns,
            measured: self.writer.measured,
            t: end.t,
            mean: end.mean,
            covariance: end.covariance,
            outside: end.outside,
            used: self.start.used,
        })
    }
}

/// Rows that an output needs at most.
fn output_rows(times: &[f64], start: f64, output: Output) -> Result<usize> {
    match output {
        Output::Every(0) => Err(Error::Parameter { field: "every", value: 0.0, need: "must be at least 1" }),
        Output::Every(n) => Ok((times.len() - times.partition_point(|t| *t < start)) / n + 1),
        Output::Period(p) if p.is_finite() && p > 0.0 => {
            let rows = ((times.last().copied().unwrap_or(start) - start) / p).max(0.0) + 2.0;
            if rows > 1e10 {
                return Err(Error::Parameter { field: "period", value: p, need: "is too short for the log's span" });
            }
            Ok(rows as usize)
        }
        Output::Period(p) => Err(Error::Parameter { field: "period", value: p, need: "must be positive and finite" }),
    }
}

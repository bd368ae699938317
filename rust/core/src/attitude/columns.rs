//! The columns that a run writes, and how many rows they have.

use super::series::{AttitudeSensors, GyroSeries};
use super::state::AttitudeBias;
use crate::error::{Error, Result};
use crate::replay::{MAX_DOF, Output, Report, Start};

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

/// Columns over the measurements, to be written. Each has [`Rows::measured`] rows, or none if it is not wanted.
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
    /// What became of them all, whether columns are written or not.
    pub tally: Option<&'a mut Tally>,
    /// By which factor each sensor's noise is multiplied: at the start, and at the end to be written, where noise is found
    /// as the filter runs. Without any they start at 1.
    pub scale: &'a mut [f64],
}

/// What became of a run's measurements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Inside the gate and used.
    pub accepted: usize,
    /// Outside the gate.
    pub rejected: usize,
    /// Left alone by a filter that has no use for them.
    pub unused: usize,
}

impl Tally {
    /// Counts one.
    #[inline(always)]
    pub(super) fn add(&mut self, report: &Report) {
        let outside = !report.accepted && report.nis > 0.0;
        self.accepted += usize::from(report.accepted);
        self.rejected += usize::from(outside);
        self.unused += usize::from(!report.accepted && !outside);
    }
}

/// How many rows a run writes, exactly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rows {
    /// At the output times.
    pub output: usize,
    /// At the measurements.
    pub measured: usize,
}

/// Counts the rows that [`super::run`] writes.
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
    let inside = |i: &usize| *i < sensors.len() && sensors.time(*i) >= start.t && sensors.time(*i) <= last;
    let measured = sensors.count(start.t, last) - usize::from(start.used.as_ref().is_some_and(inside));
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
            // rows are counted up to the last sample: it has to be the latest
            for (row, pair) in times.windows(2).enumerate() {
                if pair[1].partial_cmp(&pair[0]) != Some(std::cmp::Ordering::Greater) {
                    let (previous, value) = (pair[0], pair[1]);
                    return Err(Error::NotIncreasing { field: "gyro.t", row: row + 1, previous, value });
                }
            }
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
    /// See [`Measured::tally`].
    pub tally: Tally,
    /// See [`Measured::scale`].
    pub scale: Vec<f64>,
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
            tally: Tally::default(),
            scale: Vec::new(),
        }
    }

    /// The columns to hand to [`super::run`].
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
            tally: Some(&mut self.tally),
            scale: &mut self.scale,
        };
        (columns, measured)
    }
}

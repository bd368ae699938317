//! Where a run over a log writes to.

use super::columns::{Columns, Measured};
use super::run::Log;
use super::series::{AttitudeSensors, GyroSeries};
use super::system::System;
use crate::belief::Belief;
use crate::replay::{Report, Sink};
use crate::scalar::Real;

/// Writes what a replay reports into columns.
pub(super) struct Writer<'a, Y> {
    columns: Columns<'a>,
    measured: Measured<'a>,
    pub(super) gyro: &'a GyroSeries<'a>,
    sensors: &'a AttitudeSensors<'a>,
    system: &'a Y,
    /// Row that comes next, and the one written before it: a smoother writes from the end.
    next: usize,
    before: Option<usize>,
    backwards: bool,
    reports: usize,
}

impl<'a, Y> Writer<'a, Y> {
    /// Writes from the first row on, or from the last one back.
    pub(super) fn new(log: Log<'a>, system: &'a Y, columns: Columns<'a>, measured: Measured<'a>, back: bool) -> Self {
        let next = if back { columns.t.len().wrapping_sub(1) } else { 0 };
        let (gyro, sensors) = (log.gyro, log.sensors);
        Self { columns, measured, gyro, sensors, system, next, before: None, backwards: back, reports: 0 }
    }

    #[inline(always)]
    fn advance(&mut self) -> (usize, Option<usize>) {
        let (row, before) = (self.next, self.before);
        self.next = if self.backwards { row.wrapping_sub(1) } else { row + 1 };
        self.before = Some(row);
        (row, before)
    }

    /// Measured rate at time `t`, at or after input sample `k`.
    #[inline(always)]
    fn rate(&self, t: f64, k: usize) -> [f64; 3] {
        match self.gyro.t.get(k + 1) {
            Some(next) if t >= *next => self.gyro.at(k + 1),
            _ if t > self.gyro.t[k] => self.gyro.between(k).rate,
            _ => self.gyro.at(k),
        }
    }

    /// Writes one output row.
    #[inline(always)]
    pub(super) fn row(&mut self, t: f64, k: usize, state: &State, covariance: impl FnOnce() -> [[f64; 6]; 6]) {
        let (row, before) = self.advance();
        let State { mut q, bias, variance } = *state;
        if let Some(before) = before {
            let last = self.columns.q[before];
            if last[0] * q[0] + last[1] * q[1] + last[2] * q[2] + last[3] * q[3] < 0.0 {
                q = [-q[0], -q[1], -q[2], -q[3]];
            }
        }
        let rate = self.rate(t, k);
        self.columns.t[row] = t;
        self.columns.q[row] = q;
        self.columns.rate[row] = [rate[0] - bias[0], rate[1] - bias[1], rate[2] - bias[2]];
        self.columns.bias[row] = bias;
        self.columns.sigma[row] = variance.map(f64::sqrt);
        if let Some(p) = self.columns.covariance.get_mut(row) {
            *p = covariance();
        }
    }

    #[inline(always)]
    pub(super) fn report(&mut self, (sensor, row): (usize, usize), report: &Report) {
        let n = self.reports;
        self.reports += 1;
        let m = &mut self.measured;
        if let Some(tally) = &mut m.tally {
            tally.add(report);
        }
        if n < m.t.len() {
            m.t[n] = self.sensors.sensors()[sensor].times()[row];
            write(m.sensor, n, sensor as i32);
            write(m.row, n, row as i32);
        }
        write(m.dof, n, report.dof as i32);
        write(m.nis, n, report.nis);
        write(m.accepted, n, report.accepted);
        write(m.innovation, n, report.innovation);
        if n < m.innovation_sigma.len() {
            m.innovation_sigma[n] = std::array::from_fn(|i| report.covariance[i][i].sqrt());
        }
    }
}

/// What an output row tells of a belief.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// Attitude `q_ib`.
    pub(super) q: [f64; 4],
    /// Gyro bias, rad/s.
    pub(super) bias: [f64; 3],
    /// Variances of the six error states.
    pub(super) variance: [f64; 6],
}

impl<Y: System<N>, const N: usize> Sink<Y::Space, N> for Writer<'_, Y> {
    #[inline(always)]
    fn state<T: Real, B: Belief<Y::Space, T, N>>(&mut self, t: f64, k: usize, belief: &B) {
        let x = self.system.attitude(belief.mean());
        let variance = self.system.variance(belief);
        let state =
            State { q: x.q.map(|c| c.lane(0)), bias: x.bias.map(|c| c.lane(0)), variance: variance.map(|v| v.lane(0)) };
        let system = self.system;
        self.row(t, k, &state, || {
            let cov = system.covariance(belief.mean(), &belief.covariance());
            std::array::from_fn(|i| std::array::from_fn(|j| cov[(i, j)].lane(0)))
        });
    }

    #[inline(always)]
    fn measured(&mut self, i: usize, report: &Report) {
        self.report(self.sensors.source(i), report);
    }
}

/// Writes one row of a column, if it is wanted.
#[inline(always)]
fn write<T>(column: &mut [T], row: usize, value: T) {
    if let Some(to) = column.get_mut(row) {
        *to = value;
    }
}

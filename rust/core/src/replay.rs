//! Replays a log: input samples drive the filter, measurements with their own time stamps correct it.

use crate::belief::{Belief, Outcome};
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::{Matrix, from_fn};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input};
use crate::scalar::Real;

/// Largest number of degrees of freedom of a measurement in a replay.
pub const MAX_DOF: usize = 3;

/// Input samples: sample `k` has a time, and between `k` and `k + 1` the input is constant.
pub trait Drive<D: Dynamics<N>, const N: usize> {
    /// Times of the samples, s.
    fn times(&self) -> &[f64];
    /// Input between samples `k` and `k + 1`.
    fn input<T: Real>(&self, k: usize) -> Input<D, T, N>;
}

/// Measurements of any kinds in order of time.
pub trait Sensors<S: Manifold<N>, const N: usize> {
    /// How many there are.
    fn len(&self) -> usize;
    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Time of measurement `i`, s.
    fn time(&self, i: usize) -> f64;
    /// Corrects a belief by measurement `i`.
    fn update<F: Filter, T: Real<Mask = bool>>(&self, i: usize, filter: &F, belief: &mut F::Belief<S, T, N>) -> Report;
}

/// An [`Outcome`] in plain numbers, whatever its size; unused entries are not a number.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// See [`Outcome::ok`].
    pub ok: bool,
    /// See [`Outcome::accepted`].
    pub accepted: bool,
    /// Degrees of freedom.
    pub dof: usize,
    /// Normalised innovation squared.
    pub nis: f64,
    /// Measured minus predicted.
    pub innovation: [f64; MAX_DOF],
    /// Covariance of the innovation.
    pub covariance: [[f64; MAX_DOF]; MAX_DOF],
}

impl<T: Real<Mask = bool>, const M: usize> From<Outcome<T, M>> for Report {
    #[inline(always)]
    fn from(o: Outcome<T, M>) -> Self {
        let mut innovation = [f64::NAN; MAX_DOF];
        let mut covariance = [[f64::NAN; MAX_DOF]; MAX_DOF];
        for i in 0..M.min(MAX_DOF) {
            innovation[i] = o.innovation[i].lane(0);
            for j in 0..M.min(MAX_DOF) {
                covariance[i][j] = o.covariance[(i, j)].lane(0);
            }
        }
        Self { ok: o.ok, accepted: o.accepted, dof: M, nis: o.nis.lane(0), innovation, covariance }
    }
}

/// Where the results go.
pub trait Sink<S: Manifold<N>, const N: usize> {
    /// The belief at time `t`, reached within the interval after input sample `k` or at that sample.
    fn state<T: Real, B: Belief<S, T, N>>(&mut self, t: f64, k: usize, belief: &B);
    /// The report on measurement `i`.
    fn measured(&mut self, i: usize, report: &Report);
}

/// At which times the belief is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// At every n-th input sample from the start on.
    Every(usize),
    /// At the start and each so many seconds after it. The filter is not disturbed: a copy of the belief
    /// is moved to the time.
    Period(f64),
}

/// What a replay starts from.
pub struct Start<S: Family, const N: usize> {
    /// Time, s: within the span of the input samples.
    pub t: f64,
    /// State at that time.
    pub mean: S::Of<f64>,
    /// Covariance of its error.
    pub covariance: Matrix<f64, N, N>,
    /// A measurement that the start has used up.
    pub used: Option<usize>,
}

/// What a replay ends with.
pub struct End<S: Family, const N: usize> {
    /// Time of the last input sample, s.
    pub t: f64,
    /// State at that time.
    pub mean: S::Of<f64>,
    /// Covariance of its error.
    pub covariance: Matrix<f64, N, N>,
    /// Measurements before the start or after the last input sample.
    pub outside: usize,
}

/// Samples between two calls of `poll`.
const CHUNK: usize = 4096;

/// One replay, over any filter and system.
pub struct Replay<'a, F, D, I, Q> {
    /// The filter.
    pub filter: &'a F,
    /// The dynamics.
    pub dynamics: &'a D,
    /// What drives the dynamics.
    pub drive: &'a I,
    /// The measurements.
    pub sensors: &'a Q,
    /// At which times to write.
    pub output: Output,
}

/// How far a replay has come.
struct Cursor<B> {
    belief: B,
    t: f64,
    /// Next measurement.
    next: usize,
    /// Rows written at a period.
    written: usize,
}

impl<F: Filter, D, I, Q> Replay<'_, F, D, I, Q> {
    /// Runs from `start` to the last input sample. At equal times measurements come before output.
    /// `poll` is called with the number of the sample every few thousand samples and may end the run.
    ///
    /// # Errors
    /// Times that do not increase, a start outside the samples, a covariance that is not positive
    /// definite, and what `poll` returns.
    #[inline(always)]
    pub fn run<T: Real<Mask = bool>, K, const N: usize>(
        &self,
        start: &Start<D::Space, N>,
        sink: &mut K,
        poll: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<End<D::Space, N>>
    where
        D: Dynamics<N>,
        I: Drive<D, N>,
        Q: Sensors<D::Space, N>,
        K: Sink<D::Space, N>,
    {
        let times = self.drive.times();
        let first = first_sample(times, start.t)?;
        let mean = D::Space::map(&start.mean, T::splat);
        let (belief, ok) = self.filter.belief::<D::Space, T, N>(mean, &from_fn(|i, j| T::splat(start.covariance[(i, j)])));
        if !ok {
            return Err(Error::NotPositiveDefinite { what: "initial covariance", step: first, t: start.t });
        }
        let mut cursor = Cursor { belief, t: start.t, next: 0, written: 0 };
        while cursor.next < self.sensors.len() && self.sensors.time(cursor.next) < start.t {
            cursor.next += 1;
        }
        let before = cursor.next;
        while cursor.next < self.sensors.len() && self.sensors.time(cursor.next) <= start.t {
            self.measure::<T, K, N>(&mut cursor, start.used, sink)?;
        }
        let every = match self.output {
            Output::Every(n) => n,
            Output::Period(_) => usize::MAX,
        };
        if every < usize::MAX && times[first] >= start.t {
            sink.state(start.t, first, &cursor.belief);
        }
        for k in first..times.len() - 1 {
            self.interval::<T, K, N>(&mut cursor, start, k, sink)?;
            if (k + 1 - first).is_multiple_of(every) {
                sink.state(cursor.t, k + 1, &cursor.belief);
            }
            if k % CHUNK == 0 {
                poll(k)?;
            }
        }
        let cov = cursor.belief.covariance();
        Ok(End {
            t: cursor.t,
            mean: D::Space::map(cursor.belief.mean(), |x: T| x.lane(0)),
            covariance: from_fn(|i, j| cov[(i, j)].lane(0)),
            outside: before + self.sensors.len() - cursor.next,
        })
    }

    /// From input sample `k`, or from the start within the interval, to sample `k + 1`.
    #[inline(always)]
    fn interval<T: Real<Mask = bool>, K, const N: usize>(
        &self,
        cursor: &mut Cursor<F::Belief<D::Space, T, N>>,
        start: &Start<D::Space, N>,
        k: usize,
        sink: &mut K,
    ) -> Result<()>
    where
        D: Dynamics<N>,
        I: Drive<D, N>,
        Q: Sensors<D::Space, N>,
        K: Sink<D::Space, N>,
    {
        let times = self.drive.times();
        let (begin, end) = (times[k], times[k + 1]);
        if end.partial_cmp(&begin) != Some(std::cmp::Ordering::Greater) {
            return Err(Error::NotIncreasing { field: "input time", row: k + 1, previous: begin, value: end });
        }
        let u = self.drive.input::<T>(k);
        while cursor.next < self.sensors.len() && self.sensors.time(cursor.next) <= end {
            let t = self.sensors.time(cursor.next);
            self.write_periodic::<T, K, N>(cursor, start.t, (t, false), (k, &u), sink)?;
            cursor.t = self.advance::<T, N>(&mut cursor.belief, cursor.t, t, (k, &u))?;
            self.measure::<T, K, N>(cursor, start.used, sink)?;
        }
        self.write_periodic::<T, K, N>(cursor, start.t, (end, true), (k, &u), sink)?;
        cursor.t = self.advance::<T, N>(&mut cursor.belief, cursor.t, end, (k, &u))?;
        Ok(())
    }

    /// Moves a belief to time `to`, which it returns.
    #[inline(always)]
    fn advance<T: Real<Mask = bool>, const N: usize>(
        &self,
        belief: &mut F::Belief<D::Space, T, N>,
        from: f64,
        to: f64,
        (k, u): (usize, &Input<D, T, N>),
    ) -> Result<f64>
    where
        D: Dynamics<N>,
    {
        if to > from && !self.filter.predict(belief, self.dynamics, u, T::splat(from), T::splat(to - from)) {
            return Err(Error::NotPositiveDefinite { what: "predicted covariance", step: k, t: to });
        }
        Ok(to)
    }

    #[inline(always)]
    fn measure<T: Real<Mask = bool>, K, const N: usize>(
        &self,
        cursor: &mut Cursor<F::Belief<D::Space, T, N>>,
        used: Option<usize>,
        sink: &mut K,
    ) -> Result<()>
    where
        D: Dynamics<N>,
        Q: Sensors<D::Space, N>,
        K: Sink<D::Space, N>,
    {
        let i = cursor.next;
        cursor.next += 1;
        if used == Some(i) {
            return Ok(());
        }
        let report = self.sensors.update(i, self.filter, &mut cursor.belief);
        if !report.ok {
            return Err(Error::NotPositiveDefinite { what: "covariance in the update", step: i, t: cursor.t });
        }
        sink.measured(i, &report);
        Ok(())
    }

    /// Writes the rows before `until` (or up to it, if `inclusive`) from copies of the belief.
    #[inline(always)]
    fn write_periodic<T: Real<Mask = bool>, K, const N: usize>(
        &self,
        cursor: &mut Cursor<F::Belief<D::Space, T, N>>,
        start: f64,
        (until, inclusive): (f64, bool),
        (k, u): (usize, &Input<D, T, N>),
        sink: &mut K,
    ) -> Result<()>
    where
        D: Dynamics<N>,
        K: Sink<D::Space, N>,
    {
        let Output::Period(period) = self.output else { return Ok(()) };
        loop {
            let t = start + cursor.written as f64 * period;
            if !(t < until || inclusive && t <= until) {
                return Ok(());
            }
            let mut belief = cursor.belief;
            self.advance::<T, N>(&mut belief, cursor.t, t, (k, u))?;
            sink.state(t, k, &belief);
            cursor.written += 1;
        }
    }
}

/// The last input sample not after `t`.
fn first_sample(times: &[f64], t: f64) -> Result<usize> {
    let Some(last) = times.last() else { return Err(Error::Empty { field: "gyro" }) };
    if !(t >= times[0] && t <= *last) {
        return Err(Error::Parameter { field: "start time", value: t, need: "must lie within the gyro's time span" });
    }
    Ok(times.partition_point(|s| *s <= t) - 1)
}

//! Replays a log: input samples drive the filter, measurements with their own time stamps correct it.

mod sampled;
mod smooth;
mod window;

pub use sampled::Sampled;
pub use smooth::{Recorder, smooth, step_back};
pub use window::{Epoch, Past, Window};

use crate::belief::{Belief, Outcome};
use crate::cloud::Weighing;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::{Matrix, from_fn};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input};
use crate::scalar::{Mask, Real};
use std::cmp::Ordering;

/// Largest number of degrees of freedom of a measurement in a replay.
pub const MAX_DOF: usize = 3;

/// Input samples: sample `k` has a time, and between `k` and `k + 1` the input is constant.
pub trait Drive<D: Dynamics<N>, const N: usize> {
    /// Times of the samples, s.
    fn times(&self) -> &[f64];
    /// Input between samples `k` and `k + 1`; after the last sample what would hold from there on.
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
    /// Logarithm of the probability density of measurement `i` in state `x`, up to a constant: what weighs
    /// particles. Not a number for sensors that do not know it.
    #[inline(always)]
    fn log_likelihood<T: Real>(&self, _i: usize, _x: &S::Of<T>) -> T {
        T::splat(f64::NAN)
    }
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
    /// Rows of the log that it is made of, and how many of them were used.
    pub rows: [usize; 2],
}

impl<T: Real<Mask = bool>, const M: usize> From<Outcome<T, M>> for Report {
    #[inline(always)]
    fn from(o: Outcome<T, M>) -> Self {
        Self::of_lane(&o, 0)
    }
}

impl Report {
    /// One lane of an outcome.
    #[inline(always)]
    pub(crate) fn of_lane<T: Real, const M: usize>(o: &Outcome<T, M>, lane: usize) -> Self {
        let mut innovation = [f64::NAN; MAX_DOF];
        let mut covariance = [[f64::NAN; MAX_DOF]; MAX_DOF];
        for i in 0..M.min(MAX_DOF) {
            innovation[i] = o.innovation[i].lane(lane);
            for j in 0..M.min(MAX_DOF) {
                covariance[i][j] = o.covariance[(i, j)].lane(lane);
            }
        }
        let (ok, accepted) = (o.ok.lane(lane), o.accepted.lane(lane));
        Self { ok, accepted, dof: M, nis: o.nis.lane(lane), innovation, covariance, rows: [1, usize::from(accepted)] }
    }

    /// Determinant of the innovation's covariance.
    #[inline(always)]
    pub(crate) fn determinant(&self) -> f64 {
        let s = &self.covariance;
        match self.dof {
            1 => s[0][0],
            2 => s[0][0] * s[1][1] - s[0][1] * s[1][0],
            _ => {
                s[0][0] * (s[1][1] * s[2][2] - s[1][2] * s[2][1]) - s[0][1] * (s[1][0] * s[2][2] - s[1][2] * s[2][0])
                    + s[0][2] * (s[1][0] * s[2][1] - s[1][1] * s[2][0])
            }
        }
    }
}

/// Where the results go.
pub trait Sink<S: Manifold<N>, const N: usize> {
    /// The belief at time `t`, reached within the interval after input sample `k` or at that sample.
    fn state<T: Real, B: Belief<S, T, N>>(&mut self, t: f64, k: usize, belief: &B);
    /// The report on measurement `i`.
    fn measured(&mut self, i: usize, report: &Report);
    /// How the particles were weighed by measurement `i`; together with others of its time, if there are any.
    #[inline(always)]
    fn weighed(&mut self, _i: usize, _weighing: &Weighing) {}
    /// The belief at time `t`, all measurements used, before it moves on to `to` within the interval
    /// after input sample `k`: what a smoother comes back to.
    #[inline(always)]
    fn leaving<T: Real, B: Belief<S, T, N>>(&mut self, _t: f64, _to: f64, _k: usize, _belief: &B) {}
}

/// At which times the belief is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Output {
    /// At the start and every n-th input sample after it.
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
    /// Logarithm of the probability density of the measurements that were used, each given those before
    /// it.
    pub log_likelihood: f64,
}

/// Events (samples, measurements, rows) between two calls of `poll`.
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
    /// Next measurement, and its time, not a number after the last one: asked for once, not at every event.
    measurement: usize,
    due: f64,
    /// What an update may go back over.
    window: Window<B>,
    evidence: Evidence,
    /// Rows written at a period.
    written: usize,
    /// What has happened since the start.
    events: usize,
}

/// Log-likelihood of measurements. Determinants are multiplied, and powers of two counted apart before they leave the
/// range of a number: a logarithm of each would cost as much as a part of the update.
pub(crate) struct Evidence {
    squares: f64,
    product: f64,
    powers: i64,
    numbers: usize,
}

impl Default for Evidence {
    fn default() -> Self {
        Self { squares: 0.0, product: 1.0, powers: 0, numbers: 0 }
    }
}

impl Evidence {
    #[inline(always)]
    pub(crate) fn add(&mut self, report: &Report) {
        if report.accepted {
            self.add_accepted(report, report.determinant());
        }
    }
    /// One that was accepted, by the determinant of its innovation's covariance.
    #[inline(always)]
    pub(crate) fn add_accepted(&mut self, report: &Report, determinant: f64) {
        self.squares += report.nis;
        self.numbers += report.dof;
        self.product *= determinant;
        // a normal number's exponent, taken out of its bits
        const ONE: u64 = 1023 << 52;
        let bits = self.product.to_bits();
        if self.product.is_normal() {
            self.powers += (bits >> 52 & 0x7ff) as i64 - 1023;
            self.product = f64::from_bits(bits & !(0x7ff << 52) | ONE);
        }
    }
    pub(crate) fn log(&self) -> f64 {
        let logs = self.product.ln() + self.powers as f64 * std::f64::consts::LN_2;
        -0.5 * (self.squares + logs + self.numbers as f64 * std::f64::consts::TAU.ln())
    }
}

/// What comes next.
#[derive(Clone, Copy, PartialEq)]
enum Event {
    Measurement,
    PeriodicOutput,
    EndOfLeg,
}

impl<F: Filter, D, I, Q> Replay<'_, F, D, I, Q> {
    /// Runs from `start` to the last input sample. At equal times measurements come before output.
    /// `poll` is called with the number of the sample every few thousand events and may end the run.
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
        let (belief, ok) = self.filter.belief::<D::Space, T, N>(
            D::Space::map(&start.mean, T::splat),
            &from_fn(|i, j| T::splat(start.covariance[(i, j)])),
        );
        if !ok {
            return Err(Error::NotPositiveDefinite { what: "initial covariance", step: first, t: start.t });
        }
        let before = (0..self.sensors.len()).take_while(|i| self.sensors.time(*i) < start.t).count();
        let window = Window::new(belief, start.t, first);
        let mut cursor = Box::new(Cursor {
            belief,
            t: start.t,
            measurement: before,
            due: self.due::<D::Space, N>(before),
            window,
            evidence: Evidence::default(),
            written: 0,
            events: 0,
        });
        let every = match self.output {
            Output::Every(n) => n,
            Output::Period(_) => usize::MAX,
        };
        // leg 0 ends where it begins and holds what happens at the start itself
        for leg in 0..times.len() - first {
            let (k, reached) = (first + leg.saturating_sub(1), first + leg);
            let end = if leg == 0 { start.t } else { times[reached] };
            if leg > 0 && end.partial_cmp(&times[k]) != Some(Ordering::Greater) {
                return Err(Error::NotIncreasing { field: "gyro.t", row: reached, previous: times[k], value: end });
            }
            self.leg::<T, K, N>(&mut cursor, start, (k, end), sink, poll)?;
            if leg.is_multiple_of(every) && every < usize::MAX {
                sink.state(end, reached, &cursor.belief);
            }
        }
        let cov = cursor.belief.covariance();
        Ok(End {
            t: cursor.t,
            mean: D::Space::map(cursor.belief.mean(), |x: T| x.lane(0)),
            covariance: from_fn(|i, j| cov[(i, j)].lane(0)),
            outside: before + self.sensors.len() - cursor.measurement,
            log_likelihood: cursor.evidence.log(),
        })
    }

    /// Everything up to time `end`, within the interval after input sample `k`. One loop over what
    /// comes next, so that prediction and update are compiled once.
    #[inline(always)]
    fn leg<T: Real<Mask = bool>, K, const N: usize>(
        &self,
        cursor: &mut Cursor<F::Belief<D::Space, T, N>>,
        start: &Start<D::Space, N>,
        (k, end): (usize, f64),
        sink: &mut K,
        poll: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<()>
    where
        D: Dynamics<N>,
        I: Drive<D, N>,
        Q: Sensors<D::Space, N>,
        K: Sink<D::Space, N>,
    {
        let u = self.drive.input::<T>(k);
        loop {
            cursor.events += 1;
            if cursor.events.is_multiple_of(CHUNK) {
                poll(k)?;
            }
            let (to, event) = self.next_event(cursor, start.t, end);
            let before = (event == Event::PeriodicOutput).then_some(cursor.belief);
            if to > cursor.t {
                if before.is_none() {
                    sink.leaving(cursor.t, to, k, &cursor.belief);
                }
                let (t, dt) = (T::splat(cursor.t), T::splat(to - cursor.t));
                if !self.filter.predict(&mut cursor.belief, self.dynamics, &u, t, dt) {
                    return Err(Error::NotPositiveDefinite { what: "predicted covariance", step: k, t: to });
                }
            }
            if let Some(before) = before {
                sink.state(to, k, &cursor.belief);
                cursor.belief = before;
                cursor.written += 1;
                continue;
            }
            cursor.t = to;
            if event == Event::EndOfLeg {
                return Ok(());
            }
            let i = cursor.measurement;
            cursor.measurement += 1;
            cursor.due = self.due::<D::Space, N>(i + 1);
            if start.used == Some(i) {
                continue;
            }
            let past = Past { dynamics: self.dynamics, drive: self.drive, sensors: self.sensors };
            let report = self.filter.correct(&past, &mut cursor.window, &mut cursor.belief, (to, k, i));
            if !report.ok {
                return Err(Error::NotPositiveDefinite { what: "covariance in the update", step: i, t: to });
            }
            cursor.evidence.add(&report);
            sink.measured(i, &report);
        }
    }

    /// Time of measurement `i`, not a number (never due) after the last one.
    #[inline(always)]
    fn due<S: Manifold<N>, const N: usize>(&self, i: usize) -> f64
    where
        Q: Sensors<S, N>,
    {
        if i < self.sensors.len() { self.sensors.time(i) } else { f64::NAN }
    }

    #[inline(always)]
    fn next_event<B>(&self, cursor: &Cursor<B>, start: f64, end: f64) -> (f64, Event) {
        let next = if cursor.due <= end { (cursor.due, Event::Measurement) } else { (end, Event::EndOfLeg) };
        if let Output::Period(period) = self.output {
            let t = start + cursor.written as f64 * period;
            if t < next.0 || t == end && next.1 == Event::EndOfLeg {
                return (t, Event::PeriodicOutput);
            }
        }
        next
    }
}

/// The last input sample not after `t`.
pub(crate) fn first_sample(times: &[f64], t: f64) -> Result<usize> {
    let Some(last) = times.last() else { return Err(Error::Empty { field: "gyro" }) };
    if !(t >= times[0] && t <= *last) {
        return Err(Error::Parameter { field: "start time", value: t, need: "must lie within the log's time span" });
    }
    Ok(times.partition_point(|s| *s <= t) - 1)
}

//! Replays a log through a particle filter.

use super::{Drive, End, Sensors, Sink, Start, first_sample};
use crate::belief::Belief;
use crate::cloud::Cloud;
use crate::error::{Error, Result};
use crate::linalg::from_fn;
use crate::manifold::{Family, Manifold};
use crate::model::Dynamics;
use crate::scalar::Real;
use std::cmp::Ordering;
use std::ops::Range;

/// One replay of a particle filter: as [`super::Replay`], but measurements of one time are used together.
pub struct Sampled<'a, D, I, Q> {
    /// The dynamics.
    pub dynamics: &'a D,
    /// What drives the dynamics.
    pub drive: &'a I,
    /// The measurements.
    pub sensors: &'a Q,
    /// The state is written at the start and every n-th input sample after it.
    pub every: usize,
}

/// Epochs between two calls of `poll`.
const CHUNK: usize = 256;

/// How far a replay has come.
struct Cursor {
    t: f64,
    /// Next measurement.
    measurement: usize,
    log_likelihood: f64,
    epochs: usize,
}

impl<D, I, Q> Sampled<'_, D, I, Q> {
    /// Runs from `start` to the last input sample; the cloud was made from the same start. At equal times
    /// measurements come before output. `poll` is called with the number of the sample every few hundred
    /// epochs and may end the run.
    ///
    /// # Errors
    /// Times that do not increase, a start outside the samples, weights that vanish, and what `poll`
    /// returns.
    #[inline(always)]
    pub fn run<T: Real<Mask = bool>, C, K, const N: usize>(
        &self,
        start: &Start<D::Space, N>,
        cloud: &mut C,
        sink: &mut K,
        poll: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<End<D::Space, N>>
    where
        D: Dynamics<N>,
        C: Cloud<D, T, N>,
        I: Drive<D, N>,
        Q: Sensors<D::Space, N>,
        K: Sink<D::Space, N>,
    {
        let times = self.drive.times();
        let first = first_sample(times, start.t)?;
        let before = (0..self.sensors.len()).take_while(|i| self.sensors.time(*i) < start.t).count();
        let mut cursor = Cursor { t: start.t, measurement: before, log_likelihood: 0.0, epochs: 0 };
        // leg 0 ends where it begins and holds what happens at the start itself
        for leg in 0..times.len() - first {
            let (k, reached) = (first + leg.saturating_sub(1), first + leg);
            let end = if leg == 0 { start.t } else { times[reached] };
            if leg > 0 && end.partial_cmp(&times[k]) != Some(Ordering::Greater) {
                return Err(Error::NotIncreasing { field: "gyro.t", row: reached, previous: times[k], value: end });
            }
            self.leg(&mut cursor, cloud, start.used, (k, end), sink, poll)?;
            if leg.is_multiple_of(self.every.max(1)) {
                sink.state::<T, _>(end, reached, &cloud.moments());
            }
        }
        let last = cloud.moments();
        let cov = last.covariance();
        Ok(End {
            t: cursor.t,
            mean: D::Space::map(&last.mean, |x: T| x.lane(0)),
            covariance: from_fn(|i, j| cov[(i, j)].lane(0)),
            outside: before + self.sensors.len() - cursor.measurement,
            log_likelihood: cursor.log_likelihood,
        })
    }

    /// Everything up to time `end`, within the interval after input sample `k`. One loop over what comes
    /// next, so that prediction and update are compiled once.
    #[inline(always)]
    fn leg<T: Real<Mask = bool>, C, K, const N: usize>(
        &self,
        cursor: &mut Cursor,
        cloud: &mut C,
        used: Option<usize>,
        (k, end): (usize, f64),
        sink: &mut K,
        poll: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<()>
    where
        D: Dynamics<N>,
        C: Cloud<D, T, N>,
        I: Drive<D, N>,
        Q: Sensors<D::Space, N>,
        K: Sink<D::Space, N>,
    {
        let u = self.drive.input::<T>(k);
        loop {
            if used == Some(cursor.measurement) {
                cursor.measurement += 1;
            }
            let epoch = self.epoch::<D::Space, N>(cursor.measurement, end, used);
            let to = if epoch.is_empty() { end } else { self.sensors.time(epoch.start) };
            if to > cursor.t {
                let (t, dt) = (T::splat(cursor.t), T::splat(to - cursor.t));
                if !cloud.predict(self.dynamics, &u, t, dt) {
                    return Err(Error::NotPositiveDefinite { what: "predicted covariance", step: k, t: to });
                }
                cursor.t = to;
            }
            if epoch.is_empty() {
                return Ok(());
            }
            cursor.epochs += 1;
            if cursor.epochs.is_multiple_of(CHUNK) {
                poll(k)?;
            }
            let weighing = cloud.update(self.sensors, epoch.clone(), &mut |i, report| sink.measured(i, report))?;
            cursor.log_likelihood += weighing.log_likelihood;
            for i in epoch.clone() {
                sink.weighed(i, &weighing);
            }
            cursor.measurement = epoch.end;
        }
    }

    /// The measurements of one time from `next` on, none of them after `end`.
    #[inline(always)]
    fn epoch<S: Manifold<N>, const N: usize>(&self, next: usize, end: f64, used: Option<usize>) -> Range<usize>
    where
        Q: Sensors<S, N>,
    {
        let count = self.sensors.len();
        if next >= count || self.sensors.time(next) > end {
            return next..next;
        }
        let t = self.sensors.time(next);
        let mut last = next + 1;
        while last < count && self.sensors.time(last) == t && used != Some(last) {
            last += 1;
        }
        next..last
    }
}

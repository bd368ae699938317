//! Gyro samples that a stream is fed, one or a block of them.

use super::columns::Columns;
use super::gyro::{GyroInput, GyroInputs, GyroModel, GyroTiming};
use super::history::{History, PastStep};
use super::series::turned;
use super::state::{Attitude, AttitudeBias};
use crate::belief::Belief;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::Matrix;
use crate::manifold::Family;
use crate::scalar::{Real, Run};

/// Samples between two calls of `poll`.
const CHUNK: usize = 1024;
const MISSING: &str = "must be finite; leave out a gyro sample that is missing";

/// When the samples of a block were taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Times<'a> {
    /// At these times, s.
    At(&'a [f64]),
    /// Each so long after the one before it, s; the first one after the state.
    After(&'a [f64]),
    /// The same with steps that are all equal, s.
    Every(f64),
}

/// Gyro samples in order of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Samples<'a> {
    /// When they were taken.
    pub times: Times<'a>,
    /// Measured rates, rad/s.
    pub rate: &'a [[f64; 3]],
    /// From measured rates to rates of the body, row by row; by default they are rates of the body.
    pub turn: Option<[f64; 9]>,
}

impl Samples<'_> {
    /// Time of sample `k`, `t` being that of the sample before it.
    #[inline(always)]
    fn time(&self, k: usize, t: f64) -> f64 {
        match self.times {
            Times::At(times) => times[k],
            Times::After(steps) => t + steps[k],
            Times::Every(step) => t + step,
        }
    }

    #[inline(always)]
    fn rate(&self, k: usize) -> [f64; 3] {
        self.turn.as_ref().map_or(self.rate[k], |turn| turned(turn, &self.rate[k]))
    }

    /// Whether all samples may follow the time `now`; nothing is computed with a block that is not good.
    pub(super) fn check(&self, now: f64) -> Result<()> {
        let expected = self.rate.len();
        match self.times {
            Times::At(x) if x.len() != expected => Err(Error::Length { field: "t", expected, found: x.len() }),
            Times::After(x) if x.len() != expected => Err(Error::Length { field: "dt", expected, found: x.len() }),
            Times::Every(value) if !good_step(value) => Err(Error::Parameter { field: "dt", value, need: STEP }),
            _ => Ok(()),
        }?;
        let mut t = now;
        for k in 0..expected {
            let next = self.time(k, t);
            // the first one may be taken at the state's own time
            let first = k == 0 && next == t && matches!(self.times, Times::At(_));
            if !(next > t && next < f64::INFINITY || first) {
                return Err(self.bad_time(k, t));
            }
            if let Some(w) = self.rate(k).iter().find(|w| !w.is_finite()) {
                let value = *self.rate[k].iter().find(|w| !w.is_finite()).unwrap_or(w);
                return Err(Error::Row { field: "rates", row: k, value, need: MISSING });
            }
            t = next;
        }
        Ok(())
    }

    fn bad_time(&self, row: usize, t: f64) -> Error {
        let still = "is too short to move the time";
        match self.times {
            Times::At(times) => {
                let value = times[row];
                let need = "lies before the state's time; samples must come in order of time";
                match (value.is_finite(), row) {
                    (false, _) => Error::Row { field: "t", row, value, need: "must be finite" },
                    (true, 0) => Error::Row { field: "t", row, value, need },
                    (true, _) => Error::NotIncreasing { field: "t", row, previous: t, value },
                }
            }
            Times::After(steps) => {
                let value = steps[row];
                Error::Row { field: "dt", row, value, need: if good_step(value) { still } else { STEP } }
            }
            Times::Every(value) => Error::Parameter { field: "dt", value, need: still },
        }
    }
}

const STEP: &str = "must be positive and finite, in s";

fn good_step(dt: f64) -> bool {
    dt > 0.0 && dt < f64::INFINITY
}

/// Whether one sample may follow the time `now`: what [`Samples::check`] is for a block.
pub(super) fn check_one(t: f64, rate: &[f64; 3], now: f64) -> Result<()> {
    in_order("predict", t, now)?;
    match rate.iter().find(|w| !w.is_finite()) {
        Some(value) => Err(Error::Parameter { field: "rate", value: *value, need: MISSING }),
        None => Ok(()),
    }
}

pub(super) fn in_order(field: &'static str, t: f64, now: f64) -> Result<()> {
    if !t.is_finite() {
        return Err(Error::Parameter { field: "t", value: t, need: "must be finite" });
    }
    if t >= now { Ok(()) } else { Err(Error::OutOfOrder { field, t, now }) }
}

/// How far a stream has come.
#[derive(Clone)]
pub(super) struct Course {
    pub(super) t: f64,
    /// The latest gyro sample and its time.
    pub(super) last: Option<(f64, [f64; 3])>,
    pub(super) steps: usize,
    pub(super) history: Option<History>,
}

/// What to write while a block is fed, and whom to tell.
pub(super) struct Listening<'a, 'c> {
    /// A row after every n-th sample.
    pub(super) every: usize,
    pub(super) columns: Columns<'a>,
    pub(super) poll: &'c mut dyn FnMut(usize) -> Result<()>,
}

/// Steps of one filter over good samples, at any instruction set. Where a step fails the belief is as it was
/// before the first; the course is so only with a single sample, whose past the caller forgets, too.
pub(super) struct Feed<'a, 'r, 'c, F: Filter> {
    pub(super) filter: &'a F,
    pub(super) model: &'a GyroModel,
    pub(super) timing: &'a GyroTiming,
    pub(super) belief: &'a mut F::Belief<AttitudeBias, f64, 6>,
    /// State and matrix that a belief carries.
    pub(super) parts: fn(&F::Belief<AttitudeBias, f64, 6>) -> (Attitude<f64>, Matrix<f64, 6, 6>),
    pub(super) course: &'a mut Course,
    pub(super) samples: &'a Samples<'a>,
    pub(super) listening: Option<&'a mut Listening<'r, 'c>>,
}

impl<F: Filter> Run for Feed<'_, '_, '_, F> {
    type Output = Result<()>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(mut self) -> Result<()> {
        let mut belief = F::cast::<AttitudeBias, f64, T, 6>(self.belief);
        for k in 0..self.samples.rate.len() {
            let course = &mut *self.course;
            let (t, rate) = (self.samples.time(k, course.t), self.samples.rate(k));
            let dt = t - course.t;
            if dt > 0.0 {
                let input = match &course.last {
                    Some((before, old)) => self.timing.between(old, &rate, t - before),
                    // the first sample is all there is to know of the time before it
                    None => GyroInput { rate, extra: 0.0 },
                };
                if let Some(history) = &mut course.history {
                    let (mean, matrix) = (self.parts)(&F::cast::<AttitudeBias, T, f64, 6>(&belief));
                    history.push(PastStep { t: course.t, to: t, input, mean, matrix });
                }
                let u = GyroInputs::map(&input, T::splat);
                if !self.filter.predict(&mut belief, self.model, &u, T::splat(course.t), T::splat(dt)) {
                    if let Some(history) = &mut course.history {
                        history.steps.pop_back();
                    }
                    return Err(Error::NotPositiveDefinite { what: "predicted covariance", step: course.steps, t });
                }
                course.t = t;
                course.steps += 1;
            }
            course.last = Some((t, rate));
            if let Some(listening) = &mut self.listening {
                if let Some(history) = &mut course.history {
                    history.trim(t);
                }
                listening.hear::<T, _>(k, t, &rate, &belief)?;
            }
        }
        *self.belief = F::cast::<AttitudeBias, T, f64, 6>(&belief);
        Ok(())
    }
}

impl Listening<'_, '_> {
    /// Writes a row if there is one after sample `k`.
    #[inline(always)]
    fn hear<T: Real, B: Belief<AttitudeBias, T, 6>>(
        &mut self,
        k: usize,
        t: f64,
        rate: &[f64; 3],
        belief: &B,
    ) -> Result<()> {
        if (k + 1).is_multiple_of(CHUNK) {
            (self.poll)(k + 1)?;
        }
        if !(k + 1).is_multiple_of(self.every) {
            return Ok(());
        }
        let (row, columns) = ((k + 1) / self.every - 1, &mut self.columns);
        let mean = AttitudeBias::map(belief.mean(), |x: T| x.lane(0));
        let covariance = belief.covariance();
        columns.t[row] = t;
        columns.q[row] = mean.q;
        columns.bias[row] = mean.bias;
        columns.rate[row] = std::array::from_fn(|i| rate[i] - mean.bias[i]);
        columns.sigma[row] = std::array::from_fn(|i| covariance[(i, i)].lane(0).sqrt());
        if let Some(p) = columns.covariance.get_mut(row) {
            *p = std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)].lane(0)));
        }
        Ok(())
    }
}

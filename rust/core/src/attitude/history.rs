//! The last steps of a stream, for smoothing with a fixed lag.

use super::gyro::{GyroInput, GyroInputs, GyroModel};
use super::state::{Attitude, AttitudeBias};
use crate::belief::{Belief, Gaussian};
use crate::filter::Filter;
use crate::linalg::{Matrix, from_fn};
use crate::manifold::Family;
use crate::replay::step_back;
use crate::scalar::{Real, Run};
use std::collections::VecDeque;

/// A state that a stream has left, and the step it left by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PastStep {
    /// Time of the state, and where the step from it ends, s.
    pub t: f64,
    /// See [`Self::t`].
    pub to: f64,
    /// Input of the step.
    pub input: GyroInput<f64>,
    /// The state, all measurements up to its time used.
    pub mean: Attitude<f64>,
    /// Covariance of its error, or the square root that a square-root filter carries.
    pub matrix: Matrix<f64, 6, 6>,
}

/// The steps since the latest state that is at least a lag old.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct History {
    pub(super) lag: f64,
    pub(super) steps: VecDeque<PastStep>,
}

impl History {
    pub(super) fn new(lag: f64) -> Self {
        Self { lag, steps: VecDeque::new() }
    }

    /// Remembers a step that has just been made. It may still be taken back, so nothing is forgotten.
    pub(super) fn push(&mut self, step: PastStep) {
        self.steps.push_back(step);
    }

    /// Forgets what is older than the lag.
    pub(super) fn trim(&mut self, now: f64) {
        while self.steps.front().is_some_and(|s| s.to <= now - self.lag) {
            self.steps.pop_front();
        }
    }
}

/// A smoothed state: its time, the state, the covariance of its error.
pub type SmoothedState = (f64, Attitude<f64>, Matrix<f64, 6, 6>);

/// Goes back over the remembered steps from the present belief; the oldest state comes first. None where
/// a covariance is not positive definite.
pub(super) struct Back<'a, F: Filter> {
    pub(super) filter: &'a F,
    pub(super) model: &'a GyroModel,
    pub(super) now: f64,
    pub(super) belief: &'a F::Belief<AttitudeBias, f64, 6>,
    pub(super) steps: &'a VecDeque<PastStep>,
    /// A belief from what a step remembers.
    pub(super) recall: fn(&PastStep) -> F::Belief<AttitudeBias, f64, 6>,
}

impl<F: Filter> Run for Back<'_, F> {
    type Output = Option<Vec<SmoothedState>>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> Self::Output {
        let present = F::cast::<AttitudeBias, f64, T, 6>(self.belief);
        let mut after = Gaussian::<AttitudeBias, T, 6> { mean: *present.mean(), cov: present.covariance() };
        let mut out = vec![plain(self.now, &after)];
        for step in self.steps.iter().rev() {
            let belief = F::cast::<AttitudeBias, f64, T, 6>(&(self.recall)(step));
            let input = GyroInputs::map(&step.input, T::splat);
            let times = (&input, T::splat(step.t), T::splat(step.to - step.t));
            after = step_back(self.filter, self.model, &belief, times, &after)?;
            out.push(plain(step.t, &after));
        }
        out.reverse();
        Some(out)
    }
}

#[inline(always)]
fn plain<T: Real>(t: f64, x: &Gaussian<AttitudeBias, T, 6>) -> SmoothedState {
    (t, AttitudeBias::map(&x.mean, |c: T| c.lane(0)), from_fn(|i, j| x.cov[(i, j)].lane(0)))
}

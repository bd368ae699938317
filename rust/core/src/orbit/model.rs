//! The orbit as dynamics of a filter.

use super::force::ForceModel;
use super::oblate;
use super::step::Steps;
use crate::error::{Error, Result};
use crate::linalg::{Matrix, add, congruence, mul, zeros};
use crate::manifold::{Euclidean, Family};
use crate::model::Dynamics;
use crate::scalar::Real;

/// An input of no numbers.
pub struct Nothing;

impl Family for Nothing {
    type Of<T: Real> = ();
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>((): &(), (): &(), _: impl FnMut(A, B) -> C) {}
}

/// Position and velocity (GCRS, m and m/s) under a force model and white acceleration noise.
///
/// A step is cut into equal RK4 steps of at most `max_step`; the transition is the exact derivative of
/// these, by the variational equations.
#[derive(Clone, Debug)]
pub struct OrbitModel {
    /// The accelerations that are modelled.
    pub force: ForceModel,
    /// Power spectral density of those that are not, per axis, m²/s³.
    pub accel_psd: f64,
    /// Longest RK4 step, s.
    pub max_step: f64,
    /// How a step is taken.
    pub scheme: Scheme,
}

/// How a step of the orbit is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scheme {
    /// Classical Runge-Kutta, in as many steps as needed.
    #[default]
    Rk4,
    /// One Taylor step of second order over the whole time, `x + f T + A f T²/2`, with the transition `I + A T`
    /// (Ning and Ma 2010, eqs 5, 9, 10): what the paper's extended Kalman filter does. Its error grows with
    /// the cube of the time.
    Taylor,
}

impl OrbitModel {
    /// # Errors
    /// `Parameter` where the density is negative or the step not positive.
    pub fn new(force: ForceModel, accel_psd: f64, max_step: f64) -> Result<Self> {
        if !(accel_psd.is_finite() && accel_psd >= 0.0) {
            let need = "must be finite and not negative";
            return Err(Error::Parameter { field: "accel_psd", value: accel_psd, need });
        }
        if !(max_step.is_finite() && max_step > 0.0) {
            return Err(Error::Parameter { field: "max_step", value: max_step, need: "must be finite and positive" });
        }
        Ok(Self { force, accel_psd, max_step, scheme: Scheme::Rk4 })
    }

    /// How many RK4 steps a step takes, and how long they are.
    #[inline(always)]
    fn division<T: Real>(&self, dt: T) -> (usize, T) {
        let mut longest = 0.0f64;
        for i in 0..T::LANES {
            longest = longest.max(dt.lane(i).abs());
        }
        // a step that is a multiple of the longest one to rounding is cut as if it were exact
        let steps = (longest / self.max_step - 1e-9).ceil().max(1.0);
        (steps as usize, dt * (1.0 / steps))
    }

    /// A step as steps that the forces take.
    #[inline(always)]
    fn divided<T: Real>(&self, x: &[T; 6], t: T, dt: T) -> Steps<'_, T> {
        let (steps, h) = match self.scheme {
            Scheme::Rk4 => self.division(dt),
            Scheme::Taylor => (1, dt),
        };
        Steps { force: &self.force, x: *x, t, h, steps }
    }

    /// The state after a step and the transition to it.
    #[inline(always)]
    fn both<T: Real>(&self, x: &[T; 6], t: T, dt: T) -> ([T; 6], Matrix<T, 6, 6>) {
        let all = self.divided(x, t, dt);
        if self.scheme == Scheme::Taylor {
            return all.taylor();
        }
        let Some(j2) = self.force.closed() else { return all.with_transition() };
        oblate::with_transition(&j2, x, all.h, all.steps)
    }

    #[inline(always)]
    fn added<T: Real>(&self, dt: T) -> Matrix<T, 6, 6> {
        let mut q = zeros();
        let (one, two) = (dt * self.accel_psd, dt * dt * (0.5 * self.accel_psd));
        let three = dt * dt * dt * (self.accel_psd / 3.0);
        for i in 0..3 {
            q[(i, i)] = three;
            (q[(i, i + 3)], q[(i + 3, i)]) = (two, two);
            q[(i + 3, i + 3)] = one;
        }
        q
    }
}

impl Dynamics<6> for OrbitModel {
    type Space = Euclidean<6>;
    type Input = Nothing;

    #[inline(always)]
    fn step<T: Real>(&self, x: &[T; 6], (): &(), t: T, dt: T) -> [T; 6] {
        let all = self.divided(x, t, dt);
        if self.scheme == Scheme::Taylor {
            return all.taylor().0;
        }
        match self.force.closed() {
            Some(j2) => oblate::after(&j2, x, all.h, all.steps),
            None => all.after(),
        }
    }

    #[inline(always)]
    fn noise<T: Real>(&self, _: &[T; 6], (): &(), _: T, dt: T) -> Matrix<T, 6, 6> {
        self.added(dt)
    }

    /// Of each axis by itself: the lower factor of `q [dt³/3, dt²/2; dt²/2, dt]`.
    #[inline(always)]
    fn noise_factor<T: Real>(&self, _: &[T; 6], (): &(), _: T, dt: T) -> Matrix<T, 6, 6> {
        let velocity = (dt * (0.25 * self.accel_psd)).sqrt();
        let position = velocity * dt * (2.0 / 3.0f64.sqrt());
        let mut root = zeros();
        for i in 0..3 {
            root[(i, i)] = position;
            root[(i + 3, i)] = velocity * 3.0f64.sqrt();
            root[(i + 3, i + 3)] = velocity;
        }
        root
    }

    #[inline(always)]
    fn transition<T: Real>(&self, x: &[T; 6], (): &(), t: T, dt: T) -> Matrix<T, 6, 6> {
        self.both(x, t, dt).1
    }

    #[inline(always)]
    fn propagate<T: Real>(&self, x: &[T; 6], p: &Matrix<T, 6, 6>, (): &(), t: T, dt: T) -> ([T; 6], Matrix<T, 6, 6>) {
        let (after, f) = self.both(x, t, dt);
        (after, add(&congruence(&f, p), &self.added(dt)))
    }

    #[inline(always)]
    fn carry<T: Real>(
        &self,
        x: &[T; 6],
        root: &Matrix<T, 6, 6>,
        (): &(),
        t: T,
        dt: T,
    ) -> ([T; 6], Matrix<T, 6, 6>, Matrix<T, 6, 6>) {
        let (after, f) = self.both(x, t, dt);
        (after, mul(&f, root), self.added(dt))
    }
}

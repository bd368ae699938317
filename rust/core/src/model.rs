//! What a system consists of: dynamics, and measurements of any size.

use crate::linalg::{Matrix, Vector, add, cholesky_semidefinite, congruence, ldl, mul, mul_t, zeros};
use crate::manifold::{Family, Manifold};
use crate::scalar::Real;

/// State of dynamics `D` over the scalar `T`.
pub type State<D, T, const N: usize> = <<D as Dynamics<N>>::Space as Family>::Of<T>;
/// Input of dynamics `D` over the scalar `T`.
pub type Input<D, T, const N: usize> = <<D as Dynamics<N>>::Input as Family>::Of<T>;

/// How a state moves from `t` to `t + dt` under an input that is constant over the step.
///
/// Steps do not return a `Result`, since they also run on lanes: what has no answer becomes not a
/// number, which the filters find and report.
pub trait Dynamics<const N: usize> {
    /// Where the state lives.
    type Space: Manifold<N>;
    /// What drives the step (a gyro rate, or nothing).
    type Input: Family;

    /// State after the step.
    fn step<T: Real>(&self, x: &State<Self, T, N>, u: &Input<Self, T, N>, t: T, dt: T) -> State<Self, T, N>;

    /// How many of the last error states pass the step unchanged: a bias that stays where it is.
    const STILL: usize = 0;

    /// Error state after the step of one before it, `local(step(x), step(x ⊞ d))`, with `image = step(x)` at hand.
    /// Override it where that is shorter than the states themselves.
    #[inline(always)]
    fn displaced<T: Real>(
        &self,
        (x, image): (&State<Self, T, N>, &State<Self, T, N>),
        d: &Vector<T, N>,
        u: &Input<Self, T, N>,
        t: T,
        dt: T,
    ) -> Vector<T, N> {
        Self::Space::local(image, &self.step(&Self::Space::retract(x, d), u, t, dt))
    }

    /// Covariance that the step adds, in the error state after the step.
    fn noise<T: Real>(&self, x: &State<Self, T, N>, u: &Input<Self, T, N>, t: T, dt: T) -> Matrix<T, N, N>;

    /// Derivative of the error state after the step to the one before; by central differences unless
    /// overridden.
    #[inline(always)]
    fn transition<T: Real>(&self, x: &State<Self, T, N>, u: &Input<Self, T, N>, t: T, dt: T) -> Matrix<T, N, N> {
        let origin = self.step(x, u, t, dt);
        let mut f = zeros();
        for j in 0..N {
            let h = Self::Space::difference_step(j);
            let image = |h: f64| {
                let mut d = [T::zero(); N];
                d[j] = T::splat(h);
                Self::Space::local(&origin, &self.step(&Self::Space::retract(x, &d), u, t, dt))
            };
            let (plus, minus) = (image(h), image(-h));
            for i in 0..N {
                f[(i, j)] = (plus[i] - minus[i]) * (0.5 / h);
            }
        }
        f
    }

    /// State and covariance together. Override it to use structure or to share work with `step`.
    #[inline(always)]
    fn propagate<T: Real>(
        &self,
        x: &State<Self, T, N>,
        p: &Matrix<T, N, N>,
        u: &Input<Self, T, N>,
        t: T,
        dt: T,
    ) -> (State<Self, T, N>, Matrix<T, N, N>) {
        let p = congruence(&self.transition(x, u, t, dt), p);
        (self.step(x, u, t, dt), add(&p, &self.noise(x, u, t, dt)))
    }

    /// State after the step, what the step makes of a square root of the covariance, `F L`, and its noise.
    /// Override it to use structure or to share work.
    #[inline(always)]
    fn carry<T: Real>(
        &self,
        x: &State<Self, T, N>,
        root: &Matrix<T, N, N>,
        u: &Input<Self, T, N>,
        t: T,
        dt: T,
    ) -> (State<Self, T, N>, Matrix<T, N, N>, Matrix<T, N, N>) {
        (self.step(x, u, t, dt), mul(&self.transition(x, u, t, dt), root), self.noise(x, u, t, dt))
    }

    /// A square root of `noise`.
    #[inline(always)]
    fn noise_factor<T: Real>(&self, x: &State<Self, T, N>, u: &Input<Self, T, N>, t: T, dt: T) -> Matrix<T, N, N> {
        cholesky_semidefinite(&self.noise(x, u, t, dt))
    }
}

/// State that measurement `H` sees, over the scalar `T`.
pub type Seen<H, T, const N: usize, const M: usize> = <<H as Measurement<N, M>>::Space as Family>::Of<T>;
/// What is known of one sample of `H` beforehand.
pub type Given<H, T, const N: usize, const M: usize> = <<H as Measurement<N, M>>::Given as Family>::Of<T>;
/// Value of measurement `H` over the scalar `T`.
pub type Value<H, T, const N: usize, const M: usize> = <<H as Measurement<N, M>>::Value as Family>::Of<T>;

/// A measurement with an `M`-dimensional residual.
pub trait Measurement<const N: usize, const M: usize> {
    /// Where the state lives.
    type Space: Manifold<N>;
    /// What is known of a sample beforehand: its noise, a reference direction.
    type Given: Family;
    /// What is measured; may itself be a quaternion.
    type Value: Family;

    /// Whether the residual is that of the first `M` error states themselves: `H = [I 0]`.
    const DIRECT: bool = false;

    /// Value expected in state `x`.
    fn predict<T: Real>(&self, x: &Seen<Self, T, N, M>, given: &Given<Self, T, N, M>) -> Value<Self, T, N, M>;

    /// `z − zhat`, wrapped and by the shortest way.
    fn residual<T: Real>(&self, z: &Value<Self, T, N, M>, zhat: &Value<Self, T, N, M>) -> Vector<T, M>;

    /// Covariance of the sample's noise.
    fn noise<T: Real>(&self, given: &Given<Self, T, N, M>) -> Matrix<T, M, M>;

    /// Derivative of the residual's prediction to the error state; by central differences unless
    /// overridden.
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &Seen<Self, T, N, M>, given: &Given<Self, T, N, M>) -> Matrix<T, M, N> {
        let origin = self.predict(x, given);
        let mut jacobian = zeros();
        for j in 0..N {
            let h = Self::Space::difference_step(j);
            let image = |h: f64| {
                let mut d = [T::zero(); N];
                d[j] = T::splat(h);
                self.residual(&self.predict(&Self::Space::retract(x, &d), given), &origin)
            };
            let (plus, minus) = (image(h), image(-h));
            for i in 0..M {
                jacobian[(i, j)] = (plus[i] - minus[i]) * (0.5 / h);
            }
        }
        jacobian
    }

    /// Whether the residual is linear in the error state, `residual(predict(x ⊞ d), predict(x)) = H d` to rounding,
    /// for all `d` with `dᵀ P⁻¹ d ≤ c`. Sigma points then say what `H P Hᵀ` says at once.
    #[inline(always)]
    fn linear<T: Real>(&self, _p: &Matrix<T, N, N>, _c: f64) -> bool {
        false
    }

    /// `a Hᵀ`, with the Jacobian `H` at hand. Override it where `H` only selects: a Jacobian that is
    /// not looked at costs nothing.
    #[inline(always)]
    fn project<T: Real, const R: usize>(&self, h: &Matrix<T, M, N>, a: &Matrix<T, R, N>) -> Matrix<T, R, M> {
        mul_t(a, h)
    }

    /// Posterior mean and variance of the signal of a scalar measurement (`M = 1`): normal about zero with the
    /// variance `s` before, then seen as `y` with the noise of this sensor; of normal noise unless overridden
    /// ([`crate::moments`] has others).
    #[inline(always)]
    fn posterior<T: Real>(&self, y: T, s: T, given: &Given<Self, T, N, M>) -> (T, T) {
        let noise = self.noise(given)[(0, 0)];
        let gain = s / (s + noise);
        (y * gain, noise * gain)
    }

    /// Logarithm of the probability density of `z` in state `x`; of normal noise unless overridden.
    fn log_likelihood(
        &self,
        x: &Seen<Self, f64, N, M>,
        given: &Given<Self, f64, N, M>,
        z: &Value<Self, f64, N, M>,
    ) -> f64 {
        let f = ldl(&self.noise(given));
        if !f.ok {
            return f64::NAN;
        }
        let mut y = self.residual(z, &self.predict(x, given));
        let mut sum = M as f64 * std::f64::consts::TAU.ln();
        for i in 0..M {
            for k in 0..i {
                y[i] -= f.l[(i, k)] * y[k];
            }
            sum += y[i] * y[i] * f.inverses[i] + f.pivots[i].ln();
        }
        -0.5 * sum
    }
}

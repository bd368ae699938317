//! The air's density as a part of the state.

use super::refraction::{RefractionAngle, RefractionGiven, RefractionGivens};
use crate::linalg::{Matrix, Vector, from_fn, zeros};
use crate::manifold::Euclidean;
use crate::model::{Dynamics, Input, Measurement};
use crate::scalar::Real;

/// Dynamics of an orbit with the relative error of the air's density as the seventh number: it forgets itself over
/// `memory` and comes back to `sigma` (Gauss and Markov's process of first order).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithDensity<D> {
    /// Position and velocity.
    pub orbit: D,
    /// Standard deviation of the density's relative error.
    pub sigma: f64,
    /// Time over which the error decays by e, s; infinite for a constant.
    pub memory: f64,
}

impl<D> WithDensity<D> {
    #[inline(always)]
    fn decay<T: Real>(&self, dt: T) -> T {
        (dt * (-1.0 / self.memory)).map(f64::exp)
    }
}

#[inline(always)]
fn first<T: Real>(x: &[T; 7]) -> [T; 6] {
    [x[0], x[1], x[2], x[3], x[4], x[5]]
}

impl<D: Dynamics<6, Space = Euclidean<6>>> Dynamics<7> for WithDensity<D> {
    type Space = Euclidean<7>;
    type Input = D::Input;

    #[inline(always)]
    fn step<T: Real>(&self, x: &[T; 7], u: &Input<D, T, 6>, t: T, dt: T) -> [T; 7] {
        let y = self.orbit.step(&first(x), u, t, dt);
        [y[0], y[1], y[2], y[3], y[4], y[5], x[6] * self.decay(dt)]
    }

    #[inline(always)]
    fn noise<T: Real>(&self, x: &[T; 7], u: &Input<D, T, 6>, t: T, dt: T) -> Matrix<T, 7, 7> {
        let orbit = self.orbit.noise(&first(x), u, t, dt);
        let kept = self.decay(dt);
        let drawn = (T::one() - kept * kept) * (self.sigma * self.sigma);
        beside(&orbit, drawn)
    }

    #[inline(always)]
    fn transition<T: Real>(&self, x: &[T; 7], u: &Input<D, T, 6>, t: T, dt: T) -> Matrix<T, 7, 7> {
        beside(&self.orbit.transition(&first(x), u, t, dt), self.decay(dt))
    }
}

/// A block of six and one number on the diagonal.
#[inline(always)]
fn beside<T: Real>(block: &Matrix<T, 6, 6>, last: T) -> Matrix<T, 7, 7> {
    from_fn(
        #[inline(always)]
        |i, j| match (i, j) {
            (6, 6) => last,
            (6, _) | (_, 6) => T::zero(),
            _ => block[(i, j)],
        },
    )
}

/// Refraction through air of unknown density: the seventh number is its relative error.
#[derive(Clone, Debug)]
pub struct UnknownDensity(pub RefractionAngle);

impl Measurement<7, 1> for UnknownDensity {
    type Space = Euclidean<7>;
    type Given = RefractionGivens;
    type Value = Euclidean<1>;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &[T; 7], given: &RefractionGiven<T>) -> [T; 1] {
        [self.0.ray(&[x[0], x[1], x[2]], &given.star, x[6] + T::one()).angle]
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> Vector<T, 1> {
        [z[0] - zhat[0]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &RefractionGiven<T>) -> Matrix<T, 1, 1> {
        self.0.noise(given)
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &[T; 7], given: &RefractionGiven<T>) -> Matrix<T, 1, 7> {
        let scale = x[6] + T::one();
        let ray = self.0.ray(&[x[0], x[1], x[2]], &given.star, scale);
        let mut h = zeros();
        for j in 0..3 {
            h[(0, j)] = ray.by_position[j];
        }
        h[(0, 6)] = ray.by_density * scale.recip();
        h
    }
}

/// A measurement of position and velocity that the air's density is nothing to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Airless<H>(pub H);

impl<H: Measurement<6, M, Space = Euclidean<6>>, const M: usize> Measurement<7, M> for Airless<H> {
    type Space = Euclidean<7>;
    type Given = H::Given;
    type Value = H::Value;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &[T; 7], given: &Of<H::Given, T>) -> Of<H::Value, T> {
        self.0.predict(&first(x), given)
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &Of<H::Value, T>, zhat: &Of<H::Value, T>) -> Vector<T, M> {
        self.0.residual(z, zhat)
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &Of<H::Given, T>) -> Matrix<T, M, M> {
        self.0.noise(given)
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &[T; 7], given: &Of<H::Given, T>) -> Matrix<T, M, 7> {
        let h = self.0.jacobian(&first(x), given);
        from_fn(|i, j| if j < 6 { h[(i, j)] } else { T::zero() })
    }
}

type Of<F, T> = <F as crate::manifold::Family>::Of<T>;

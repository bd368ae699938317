//! The attitude error on the inertial side: the state space of the right-invariant filter.

use super::gyro::{GyroInput, GyroInputs, GyroModel};
use super::sensors::{Direction, Reference, References, StarQuaternion, Symmetric3};
use super::state::{Attitude, AttitudeBias, UnitQuaternion, Vector3};
use super::system::System;
use crate::filter::Filter;
use crate::linalg::{Matrix, Vector, block, congruence, from_fn, identity, mul, mul_t, set_block, transpose};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Measurement};
use crate::quaternion::{conjugate, difference, exp, left_jacobian, multiply, norm_squared, renormalise, to_matrix};
use crate::replay::{MAX_DOF, Report};
use crate::scalar::Real;

/// The space of [`Attitude`] with the error on the left: `(ξ, δb)`, `q = exp(ξ/2) ⊗ q̂`, `ξ` a rotation
/// vector in the inertial frame, `b = b̂ + δb` in the body frame.
///
/// Source: Barrau, Bonnabel, *The invariant extended Kalman filter as a stable observer*, 2017; with a
/// bias beside the group the filter is the "imperfect" one of their later work.
pub struct InertialError;

impl Family for InertialError {
    type Of<T: Real> = Attitude<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &Attitude<A>, b: &Attitude<B>, f: impl FnMut(A, B) -> C) -> Attitude<C> {
        AttitudeBias::zip(a, b, f)
    }
}

impl Manifold<6> for InertialError {
    #[inline(always)]
    fn retract<T: Real>(x: &Attitude<T>, d: &Vector<T, 6>) -> Attitude<T> {
        let turn = exp(&[d[0], d[1], d[2]]);
        Attitude { q: multiply(&turn, &x.q), bias: [x.bias[0] + d[3], x.bias[1] + d[4], x.bias[2] + d[5]] }
    }
    #[inline(always)]
    fn local<T: Real>(x: &Attitude<T>, y: &Attitude<T>) -> Vector<T, 6> {
        // log(y ⊗ x*) = log((x*)* ⊗ … ) by the same function, on conjugates
        let turn = difference(&conjugate(&y.q), &conjugate(&x.q));
        [turn[0], turn[1], turn[2], y.bias[0] - x.bias[0], y.bias[1] - x.bias[1], y.bias[2] - x.bias[2]]
    }
    #[inline(always)]
    fn normalise<T: Real>(x: &Attitude<T>) -> Attitude<T> {
        Attitude { q: renormalise(&x.q), bias: x.bias }
    }
    #[inline(always)]
    fn valid<T: Real>(x: &Attitude<T>) -> T::Mask {
        norm_squared(&x.q).gt(T::splat(0.5))
    }
    #[inline(always)]
    fn reset<T: Real>(_: &Attitude<T>, d: &Vector<T, 6>) -> Matrix<T, 6, 6> {
        let mut j = identity();
        set_block(&mut j, 0, 0, &left_jacobian(&[d[0], d[1], d[2]]));
        j
    }
}

/// [`GyroModel`] with the error on the inertial side: the transition does not depend on the attitude
/// estimate but through the bias.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Invariant(pub GyroModel);

impl Dynamics<6> for Invariant {
    type Space = InertialError;
    type Input = GyroInputs;

    #[inline(always)]
    fn step<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Attitude<T> {
        self.0.step(x, u, t, dt)
    }
    #[inline(always)]
    fn transition<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Matrix<T, 6, 6> {
        let after = to_matrix(&self.0.step(x, u, t, dt).q);
        let mut f = identity();
        set_block(&mut f, 0, 3, &mul(&after, &self.0.blocks(x, u, dt).coupling()));
        f
    }
    #[inline(always)]
    fn noise<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Matrix<T, 6, 6> {
        let turn = beside_bias(&to_matrix(&self.0.step(x, u, t, dt).q));
        congruence(&turn, &self.0.noise(x, u, t, dt))
    }
}

/// A rotation of the attitude error that leaves the bias.
#[inline(always)]
fn beside_bias<T: Real>(r: &Matrix<T, 3, 3>) -> Matrix<T, 6, 6> {
    let mut m = identity();
    set_block(&mut m, 0, 0, r);
    m
}

/// A measurement of the attitude, seen from [`InertialError`].
struct Left<H>(H);

impl<H: Measurement<6, M, Space = AttitudeBias>, const M: usize> Measurement<6, M> for Left<H> {
    type Space = InertialError;
    type Given = H::Given;
    type Value = H::Value;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Attitude<T>, given: &<H::Given as Family>::Of<T>) -> <H::Value as Family>::Of<T> {
        self.0.predict(x, given)
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &<H::Value as Family>::Of<T>, zhat: &<H::Value as Family>::Of<T>) -> Vector<T, M> {
        self.0.residual(z, zhat)
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &<H::Given as Family>::Of<T>) -> Matrix<T, M, M> {
        self.0.noise(given)
    }
    /// The body sees `δθ = Rᵀ ξ`.
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &Attitude<T>, given: &<H::Given as Family>::Of<T>) -> Matrix<T, M, 6> {
        let h = self.0.jacobian(x, given);
        let turned: Matrix<T, M, 3> = mul_t(&block::<T, M, 6, M, 3>(&h, 0, 0), &to_matrix(&x.q));
        from_fn(|i, j| if j < 3 { turned[(i, j)] } else { h[(i, j)] })
    }
}

impl System<6> for Invariant {
    fn start(&self, x: &Attitude<f64>, p: &Matrix<f64, 6, 6>) -> (Attitude<f64>, Matrix<f64, 6, 6>) {
        (*x, congruence(&beside_bias(&to_matrix(&x.q)), p))
    }
    #[inline(always)]
    fn attitude<T: Real>(&self, x: &Attitude<T>) -> Attitude<T> {
        *x
    }
    #[inline(always)]
    fn covariance<T: Real>(&self, x: &Attitude<T>, p: &Matrix<T, 6, 6>) -> Matrix<T, 6, 6> {
        congruence(&beside_bias(&transpose(&to_matrix(&x.q))), p)
    }
    #[inline(always)]
    fn star<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<InertialError, T, 6>,
        _: usize,
        (q, noise): (&[f64; 4], &[f64; 6]),
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (Symmetric3::map(noise, T::splat), UnitQuaternion::map(q, T::splat));
        filter.update::<_, T, 6, 3>(belief, &Left(StarQuaternion), &given, &z, T::splat(gates[2])).into()
    }
    #[inline(always)]
    fn direction<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<InertialError, T, 6>,
        body: &[f64; 3],
        reference: &Reference<f64>,
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (References::map(reference, T::splat), Vector3::map(body, T::splat));
        filter.update::<_, T, 6, 2>(belief, &Left(Direction), &given, &z, T::splat(gates[1])).into()
    }
}

//! The error-quaternion state of Wang and Jiang (2020), as printed but for three repairs.
//!
//! 1. Eq. 13 as printed lacks the term `−½ Δq₀ Δb` of the error quaternion's rate; without it the bias is
//!    never estimated. It stands in [`error_rate`].
//! 2. Eq. 14 as printed, `q_star ⊗ q_g⁻¹`, is an error on the inertial side, while eq. 9 defines one on
//!    the body side: the measurement here is `q_g⁻¹ ⊗ q_star` ([`ErrorQuaternion::residual`]).
//! 3. The 7×7 covariance of a unit error quaternion is singular along `Δq₀`: it starts with `(s/2)²`
//!    there, `s` the standard deviation of the attitude, and the quaternion is normalised after each
//!    step ([`LiteralSpace::normalise`]).

use super::gyro::{GyroInput, GyroInputs, GyroModel};
use super::sensors::{Reference, Symmetric3};
use super::state::{Attitude, UnitQuaternion, Vector3};
use super::system::System;
use crate::belief::Outcome;
use crate::filter::Filter;
use crate::linalg::{Matrix, Vector, from_fn, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Measurement};
use crate::quaternion::{
    Quaternion, conjugate, cross, dot3, integrate, multiply, norm_squared, normalise, renormalise,
};
use crate::replay::{MAX_DOF, Report};
use crate::scalar::Real;

/// A reference attitude and bias, and the error of both: `q = q̂ ⊗ Δq`, `b = b̂ + Δb` (eqs 9 and 11).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Literal<T> {
    /// `q̂`, the attitude that the gyro has carried on.
    pub q: Quaternion<T>,
    /// `b̂`, rad/s.
    pub bias: [T; 3],
    /// `Δq`, near `(1, 0, 0, 0)`; not normalised between the points of one step.
    pub dq: Quaternion<T>,
    /// `Δb`, rad/s.
    pub db: [T; 3],
}

/// The space of [`Literal`], with the plain differences of `(Δq₀, Δq₁, Δq₂, Δq₃, Δb)` as error state.
pub struct LiteralSpace;

impl Family for LiteralSpace {
    type Of<T: Real> = Literal<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &Literal<A>, b: &Literal<B>, mut f: impl FnMut(A, B) -> C) -> Literal<C> {
        Literal {
            q: UnitQuaternion::zip(&a.q, &b.q, &mut f),
            bias: Vector3::zip(&a.bias, &b.bias, &mut f),
            dq: UnitQuaternion::zip(&a.dq, &b.dq, &mut f),
            db: Vector3::zip(&a.db, &b.db, &mut f),
        }
    }
}

impl Manifold<7> for LiteralSpace {
    #[inline(always)]
    fn retract<T: Real>(x: &Literal<T>, d: &Vector<T, 7>) -> Literal<T> {
        Literal {
            dq: [x.dq[0] + d[0], x.dq[1] + d[1], x.dq[2] + d[2], x.dq[3] + d[3]],
            db: [x.db[0] + d[4], x.db[1] + d[5], x.db[2] + d[6]],
            ..*x
        }
    }
    /// Between states of the same reference the plain difference; else that of the states as seen from
    /// the first one's reference.
    #[inline(always)]
    fn local<T: Real>(x: &Literal<T>, y: &Literal<T>) -> Vector<T, 7> {
        let other = multiply(&multiply(&conjugate(&x.q), &y.q), &y.dq);
        let bias = |i: usize| (y.bias[i] - x.bias[i]) + (y.db[i] - x.db[i]);
        let dq = |i: usize| other[i] - x.dq[i];
        [dq(0), dq(1), dq(2), dq(3), bias(0), bias(1), bias(2)]
    }
    /// Moves the error into the reference, as the paper does after each step.
    #[inline(always)]
    fn normalise<T: Real>(x: &Literal<T>) -> Literal<T> {
        let (zero, one) = (T::zero(), T::one());
        Literal {
            q: renormalise(&multiply(&x.q, &normalise(&x.dq))),
            bias: [x.bias[0] + x.db[0], x.bias[1] + x.db[1], x.bias[2] + x.db[2]],
            dq: [one, zero, zero, zero],
            db: [zero; 3],
        }
    }
    #[inline(always)]
    fn valid<T: Real>(x: &Literal<T>) -> T::Mask {
        norm_squared(&x.q).gt(T::splat(0.5))
    }
    #[inline(always)]
    fn transport<T: Real>(_: &Literal<T>, _: &Vector<T, 7>, p: &Matrix<T, 7, 7>) -> Matrix<T, 7, 7> {
        *p
    }
    #[inline(always)]
    fn transport_factor<T: Real>(_: &Literal<T>, _: &Vector<T, 7>, l: &Matrix<T, 7, 7>) -> Matrix<T, 7, 7> {
        *l
    }
    #[inline(always)]
    fn transport_back<T: Real>(_: &Literal<T>, _: &Vector<T, 7>, p: &Matrix<T, 7, 7>) -> Matrix<T, 7, 7> {
        *p
    }
}

/// Eq. 13 with its missing term: the rate of the error quaternion at corrected rate `rate` and bias error
/// `db`.
#[inline(always)]
fn error_rate<T: Real>(dq: &Quaternion<T>, rate: &[T; 3], db: &[T; 3]) -> Quaternion<T> {
    let v = [dq[1], dq[2], dq[3]];
    let (turn, mixed) = (cross(rate, &v), cross(&v, db));
    let vector = |i: usize| -turn[i] - (dq[0] * db[i] + mixed[i]) * 0.5;
    [dot3(&v, db) * 0.5, vector(0), vector(1), vector(2)]
}

/// The kinematics of [`Literal`]: the reference by the gyro, the error by Runge-Kutta on eq. 13.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiteralModel(pub GyroModel);

impl Dynamics<7> for LiteralModel {
    type Space = LiteralSpace;
    type Input = GyroInputs;

    #[inline(always)]
    fn step<T: Real>(&self, x: &Literal<T>, u: &GyroInput<T>, _t: T, dt: T) -> Literal<T> {
        let rate = [u.rate[0] - x.bias[0], u.rate[1] - x.bias[1], u.rate[2] - x.bias[2]];
        let along = |k: &Quaternion<T>, h: T| {
            let mut o = x.dq;
            for i in 0..4 {
                o[i] = k[i].mul_add(h, x.dq[i]);
            }
            o
        };
        let k1 = error_rate(&x.dq, &rate, &x.db);
        let k2 = error_rate(&along(&k1, dt * 0.5), &rate, &x.db);
        let k3 = error_rate(&along(&k2, dt * 0.5), &rate, &x.db);
        let k4 = error_rate(&along(&k3, dt), &rate, &x.db);
        let mut k = k1;
        for i in 0..4 {
            k[i] = k1[i] + (k2[i] + k3[i]) * 2.0 + k4[i];
        }
        Literal { q: integrate(&x.q, &rate, dt, self.0.integrator), dq: along(&k, dt * (1.0 / 6.0)), ..*x }
    }

    /// Noise of the vector part is half that of the angle; none along `Δq₀`, to first order.
    #[inline(always)]
    fn noise<T: Real>(&self, x: &Literal<T>, u: &GyroInput<T>, t: T, dt: T) -> Matrix<T, 7, 7> {
        let six = self.0.noise(&Attitude { q: x.q, bias: x.bias }, u, t, dt);
        let scale = |i: usize| if i < 4 { 0.5 } else { 1.0 };
        from_fn(|i, j| if i == 0 || j == 0 { T::zero() } else { six[(i - 1, j - 1)] * (scale(i) * scale(j)) })
    }
}

/// Eqs 14 and 15: the star camera measures `Δq`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ErrorQuaternion;

impl Measurement<7, 4> for ErrorQuaternion {
    type Space = LiteralSpace;
    /// Covariance of the attitude error in the body frame, rad².
    type Given = Symmetric3;
    type Value = UnitQuaternion;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Literal<T>, _: &[T; 6]) -> Quaternion<T> {
        multiply(&x.q, &x.dq)
    }
    /// `ẑ⁻¹ ⊗ z − 1`, by the shorter way.
    #[inline(always)]
    fn residual<T: Real>(&self, z: &Quaternion<T>, zhat: &Quaternion<T>) -> Vector<T, 4> {
        let d = multiply(&conjugate(zhat), z);
        let sign = T::one().copysign(d[0]);
        [sign * d[0] - T::one(), sign * d[1], sign * d[2], sign * d[3]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 4, 4> {
        let at = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        let mean = (r[0] + r[3] + r[5]) * (1.0 / 3.0);
        from_fn(|i, j| match (i, j) {
            (0, 0) => mean * 0.25,
            (0, _) | (_, 0) => T::zero(),
            _ => r[at[i - 1][j - 1]] * 0.25,
        })
    }
}

impl System<7> for LiteralModel {
    fn start(&self, x: &Attitude<f64>, p: &Matrix<f64, 6, 6>) -> (Literal<f64>, Matrix<f64, 7, 7>) {
        let scale = |i: usize| if i < 4 { 0.5 } else { 1.0 };
        let mut seven = from_fn(|i, j| if i == 0 || j == 0 { 0.0 } else { p[(i - 1, j - 1)] * scale(i) * scale(j) });
        seven[(0, 0)] = 0.25 * (p[(0, 0)] + p[(1, 1)] + p[(2, 2)]) / 3.0;
        (Literal { q: x.q, bias: x.bias, dq: [1.0, 0.0, 0.0, 0.0], db: [0.0; 3] }, seven)
    }
    #[inline(always)]
    fn attitude<T: Real>(&self, x: &Literal<T>) -> Attitude<T> {
        let x = LiteralSpace::normalise(x);
        Attitude { q: x.q, bias: x.bias }
    }
    #[inline(always)]
    fn covariance<T: Real>(&self, _: &Literal<T>, p: &Matrix<T, 7, 7>) -> Matrix<T, 6, 6> {
        let scale = |i: usize| if i < 3 { 2.0 } else { 1.0 };
        from_fn(|i, j| p[(i + 1, j + 1)] * (scale(i) * scale(j)))
    }
    #[inline(always)]
    fn star<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<LiteralSpace, T, 7>,
        _: usize,
        (q, noise): (&[f64; 4], &[f64; 6]),
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (Symmetric3::map(noise, T::splat), UnitQuaternion::map(q, T::splat));
        let four = filter.update::<_, T, 7, 4>(belief, &ErrorQuaternion, &given, &z, T::splat(gates[2]));
        in_angles(&four)
    }
    /// The paper knows no directions: they are not used.
    #[inline(always)]
    fn direction<F: Filter, T: Real<Mask = bool>>(
        &self,
        _: &F,
        _: &mut F::Belief<LiteralSpace, T, 7>,
        _: &[f64; 3],
        _: &Reference<f64>,
        _: &[f64; MAX_DOF],
    ) -> Report {
        let nothing: Outcome<T, 2> =
            Outcome { ok: true, accepted: false, innovation: [T::zero(); 2], covariance: zeros(), nis: T::zero() };
        nothing.into()
    }
}

/// The vector part as a rotation vector; the scalar part says nothing.
#[inline(always)]
fn in_angles<T: Real<Mask = bool>>(o: &Outcome<T, 4>) -> Report {
    let innovation = [o.innovation[1] * 2.0, o.innovation[2] * 2.0, o.innovation[3] * 2.0];
    let covariance = from_fn(|i, j| o.covariance[(i + 1, j + 1)] * 4.0);
    Outcome::<T, 3> { ok: o.ok, accepted: o.accepted, innovation, covariance, nis: o.nis }.into()
}

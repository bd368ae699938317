//! Attitude without a gyro: kinematics of a body whose angular jerk is white noise.

use super::state::{UnitQuaternion, Vector3};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, Vector, congruence, identity, mul, set_block, skew, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::Dynamics;
use crate::orbit::Nothing;
use crate::quaternion::{self, Quaternion, Turn, cross, multiply, renormalise, right_jacobian, right_jacobian_inverse};
use crate::scalar::Real;

/// Attitude of the body in a frame `f`, `q_fb`, its rate and its angular acceleration with respect to that frame, in body
/// axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pointing<T> {
    /// Unit quaternion, scalar first, body to frame.
    pub q: Quaternion<T>,
    /// Rate, rad/s.
    pub rate: [T; 3],
    /// Angular acceleration, rad/s².
    pub acceleration: [T; 3],
}

/// The space of [`Pointing`]. Error state: `δθ` (rad, body frame, `q = q̂ ⊗ exp(δθ/2)`), `δω` (rad/s), `δα` (rad/s²).
pub struct PointingSpace;

impl Family for PointingSpace {
    type Of<T: Real> = Pointing<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &Pointing<A>, b: &Pointing<B>, mut f: impl FnMut(A, B) -> C) -> Pointing<C> {
        Pointing {
            q: UnitQuaternion::zip(&a.q, &b.q, &mut f),
            rate: Vector3::zip(&a.rate, &b.rate, &mut f),
            acceleration: Vector3::zip(&a.acceleration, &b.acceleration, &mut f),
        }
    }
}

impl Manifold<9> for PointingSpace {
    const RESETS: usize = 3;

    #[inline(always)]
    fn retract<T: Real>(x: &Pointing<T>, d: &Vector<T, 9>) -> Pointing<T> {
        let (w, a) = (&x.rate, &x.acceleration);
        Pointing {
            q: multiply(&x.q, &quaternion::exp(&[d[0], d[1], d[2]])),
            rate: [w[0] + d[3], w[1] + d[4], w[2] + d[5]],
            acceleration: [a[0] + d[6], a[1] + d[7], a[2] + d[8]],
        }
    }
    #[inline(always)]
    fn local<T: Real>(x: &Pointing<T>, y: &Pointing<T>) -> Vector<T, 9> {
        let turn = quaternion::difference(&x.q, &y.q);
        let (w, v) = (&x.rate, &y.rate);
        let (a, b) = (&x.acceleration, &y.acceleration);
        [turn[0], turn[1], turn[2], v[0] - w[0], v[1] - w[1], v[2] - w[2], b[0] - a[0], b[1] - a[1], b[2] - a[2]]
    }
    #[inline(always)]
    fn normalise<T: Real>(x: &Pointing<T>) -> Pointing<T> {
        Pointing { q: renormalise(&x.q), ..*x }
    }
    #[inline(always)]
    fn valid<T: Real>(x: &Pointing<T>) -> T::Mask {
        quaternion::norm_squared(&x.q).gt(T::splat(0.5))
    }
    #[inline(always)]
    fn reset<T: Real>(_: &Pointing<T>, d: &Vector<T, 9>) -> Matrix<T, 9, 9> {
        let mut j = identity();
        set_block(&mut j, 0, 0, &right_jacobian(&[d[0], d[1], d[2]]));
        j
    }
    #[inline(always)]
    fn transport_back<T: Real>(_: &Pointing<T>, d: &Vector<T, 9>, p: &Matrix<T, 9, 9>) -> Matrix<T, 9, 9> {
        let mut back = identity();
        set_block(&mut back, 0, 0, &right_jacobian_inverse(&[d[0], d[1], d[2]]));
        congruence(&back, p)
    }
    #[inline(always)]
    fn difference_step(i: usize) -> f64 {
        if i < 3 { 1e-5 } else { 1e-7 }
    }
}

/// A body whose angular acceleration walks at random: angular jerk is white noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointingModel {
    /// Power spectral density of the angular jerk per axis, rad²/s⁵.
    pub jerk_psd: f64,
}

impl PointingModel {
    /// # Errors
    /// `Parameter` where the density is negative or not finite.
    pub fn new(jerk_psd: f64) -> Result<Self> {
        if !(jerk_psd.is_finite() && jerk_psd >= 0.0) {
            let need = "must be finite and not negative";
            return Err(Error::Parameter { field: "jerk_psd", value: jerk_psd, need });
        }
        Ok(Self { jerk_psd })
    }

    /// Rotation vector of a step under a constant angular acceleration, by the first two terms of Magnus' series:
    /// `ω T + α T²/2 + T³/12 ω × α`. What is left out is of the order of T⁵.
    #[inline(always)]
    fn rotation<T: Real>(x: &Pointing<T>, dt: T) -> Vector<T, 3> {
        let (w, a) = (&x.rate, &x.acceleration);
        let c = cross(w, a);
        let (half, twelfth) = (dt * dt * 0.5, dt * dt * dt * (1.0 / 12.0));
        let term = |i: usize| w[i] * dt + a[i] * half + c[i] * twelfth;
        [term(0), term(1), term(2)]
    }

    #[inline(always)]
    fn after<T: Real>(x: &Pointing<T>, turn: &Quaternion<T>, dt: T) -> Pointing<T> {
        let (w, a) = (&x.rate, &x.acceleration);
        Pointing {
            q: renormalise(&multiply(&x.q, turn)),
            rate: [w[0] + a[0] * dt, w[1] + a[1] * dt, w[2] + a[2] * dt],
            acceleration: *a,
        }
    }
}

impl Dynamics<9> for PointingModel {
    type Space = PointingSpace;
    type Input = Nothing;
    /// The acceleration.
    const STILL: usize = 3;

    #[inline(always)]
    fn step<T: Real>(&self, x: &Pointing<T>, (): &(), _: T, dt: T) -> Pointing<T> {
        Self::after(x, &quaternion::exp(&Self::rotation(x, dt)), dt)
    }

    /// `q [T⁵/20, T⁴/8, T³/6; ·, T³/3, T²/2; ·, ·, T]` per axis; the turn of the body within the step is left out.
    #[inline(always)]
    fn noise<T: Real>(&self, _: &Pointing<T>, (): &(), _: T, dt: T) -> Matrix<T, 9, 9> {
        let one = dt * self.jerk_psd;
        let (two, three) = (one * dt, one * dt * dt);
        let (four, five) = (three * dt, three * dt * dt);
        let entries = [
            (0, 0, five * (1.0 / 20.0)),
            (0, 3, four * (1.0 / 8.0)),
            (0, 6, three * (1.0 / 6.0)),
            (3, 3, three * (1.0 / 3.0)),
            (3, 6, two * 0.5),
            (6, 6, one),
        ];
        let mut q = zeros();
        for (row, column, value) in entries {
            for i in 0..3 {
                q[(row + i, column + i)] = value;
                q[(column + i, row + i)] = value;
            }
        }
        q
    }

    /// The exact derivative of the step.
    #[inline(always)]
    fn transition<T: Real>(&self, x: &Pointing<T>, (): &(), _: T, dt: T) -> Matrix<T, 9, 9> {
        let rotation = Self::rotation(x, dt);
        let turn = Turn::new(&rotation);
        let [c1, ..] = turn.coefficients;
        let back = turn.skew.matrix(T::one(), -turn.sinc, c1);
        let jacobian = right_jacobian(&rotation);
        let (half, twelfth) = (dt * dt * 0.5, dt * dt * dt * (1.0 / 12.0));
        let (spin, push) = (skew(&x.rate), skew(&x.acceleration));
        let mut by_rate: Matrix<T, 3, 3> = zeros();
        let mut by_acceleration: Matrix<T, 3, 3> = zeros();
        for j in 0..3 {
            for i in 0..3 {
                by_rate[(i, j)] = -(push[(i, j)] * twelfth);
                by_acceleration[(i, j)] = spin[(i, j)] * twelfth;
            }
            by_rate[(j, j)] += dt;
            by_acceleration[(j, j)] += half;
        }
        let mut f: Matrix<T, 9, 9> = identity();
        set_block(&mut f, 0, 0, &back);
        set_block(&mut f, 0, 3, &mul(&jacobian, &by_rate));
        set_block(&mut f, 0, 6, &mul(&jacobian, &by_acceleration));
        for i in 3..6 {
            f[(i, i + 3)] = dt;
        }
        f
    }
}

//! Attitude and gyro bias.

use crate::linalg::{Matrix, Vector, block, dot, identity, mul, set_block, symmetric};
use crate::manifold::{Family, Manifold};
use crate::packed::Packed;
use crate::quaternion::{self, Quaternion, right_jacobian, right_jacobian_inverse};
use crate::scalar::Real;

/// Attitude `q_ib` (body to inertial) and gyro bias in the body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude<T> {
    /// Unit quaternion, scalar first, body to inertial.
    pub q: Quaternion<T>,
    /// Gyro bias, rad/s.
    pub bias: [T; 3],
}

/// The space of [`Attitude`]. Error state: `(δθ_x, δθ_y, δθ_z, δb_x, δb_y, δb_z)` in rad and rad/s, with
/// `q = q̂ ⊗ exp(δθ/2)`, `b = b̂ + δb`.
pub struct AttitudeBias;

impl Family for AttitudeBias {
    type Of<T: Real> = Attitude<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &Attitude<A>, b: &Attitude<B>, mut f: impl FnMut(A, B) -> C) -> Attitude<C> {
        Attitude { q: UnitQuaternion::zip(&a.q, &b.q, &mut f), bias: Vector3::zip(&a.bias, &b.bias, &mut f) }
    }
}

impl Manifold<6> for AttitudeBias {
    /// The attitude error.
    const RESETS: usize = 3;

    #[inline(always)]
    fn retract<T: Real>(x: &Attitude<T>, d: &Vector<T, 6>) -> Attitude<T> {
        let turn = quaternion::exp(&[d[0], d[1], d[2]]);
        Attitude { q: quaternion::multiply(&x.q, &turn), bias: [x.bias[0] + d[3], x.bias[1] + d[4], x.bias[2] + d[5]] }
    }
    #[inline(always)]
    fn local<T: Real>(x: &Attitude<T>, y: &Attitude<T>) -> Vector<T, 6> {
        let turn = quaternion::difference(&x.q, &y.q);
        [turn[0], turn[1], turn[2], y.bias[0] - x.bias[0], y.bias[1] - x.bias[1], y.bias[2] - x.bias[2]]
    }
    #[inline(always)]
    fn normalise<T: Real>(x: &Attitude<T>) -> Attitude<T> {
        Attitude { q: quaternion::renormalise(&x.q), bias: x.bias }
    }
    #[inline(always)]
    fn valid<T: Real>(x: &Attitude<T>) -> T::Mask {
        quaternion::norm_squared(&x.q).gt(T::splat(0.5))
    }
    #[inline(always)]
    fn reset<T: Real>(_: &Attitude<T>, d: &Vector<T, 6>) -> Matrix<T, 6, 6> {
        let turn = right_jacobian(&[d[0], d[1], d[2]]);
        let mut j = identity();
        set_block(&mut j, 0, 0, &turn);
        j
    }
    #[inline(always)]
    fn transport<T: Real>(_: &Attitude<T>, d: &Vector<T, 6>, p: &Matrix<T, 6, 6>) -> Matrix<T, 6, 6> {
        carried(&right_jacobian(&[d[0], d[1], d[2]]), p)
    }
    #[inline(always)]
    fn transport_back<T: Real>(_: &Attitude<T>, d: &Vector<T, 6>, p: &Matrix<T, 6, 6>) -> Matrix<T, 6, 6> {
        carried(&right_jacobian_inverse(&[d[0], d[1], d[2]]), p)
    }
    #[inline(always)]
    fn carry_columns<T: Real>(_: &Attitude<T>, d: &Vector<T, 6>, columns: &mut [Vector<T::Pack, 6>]) {
        let turn = right_jacobian(&[d[0], d[1], d[2]]);
        for column in columns {
            let old = *column;
            for i in 0..3 {
                column[i] = dot::<T::Pack, 3>(|k| turn[(i, k)].stack(), |k| old[k]);
            }
        }
    }
    #[inline(always)]
    fn transport_factor<T: Real>(_: &Attitude<T>, d: &Vector<T, 6>, l: &Matrix<T, 6, 6>) -> Matrix<T, 6, 6> {
        let turn = right_jacobian(&[d[0], d[1], d[2]]);
        let top: Matrix<T, 3, 6> = mul(&turn, &block::<T, 6, 6, 3, 6>(l, 0, 0));
        let mut out = *l;
        set_block(&mut out, 0, 0, &top);
        out
    }
}

/// A covariance after a linear map of the attitude error.
#[inline(always)]
fn carried<T: Real>(turn: &Matrix<T, 3, 3>, p: &Matrix<T, 6, 6>) -> Matrix<T, 6, 6> {
    let packed = Packed::new(turn);
    let top = Packed::<T, 3, 6>::product::<3>(&packed, |k, j| p[(k, j)]);
    let attitude = Packed::<T, 3, 3>::product::<3>(&top.block(0), |k, j| turn[(j, k)]);
    of_blocks(&attitude, &top.block(3), |i, j| p[(i + 3, j + 3)])
}

/// A covariance by its blocks: those of the attitude error, by its lower triangle, of attitude error and bias, and of
/// the bias, by its lower triangle.
#[inline(always)]
pub(super) fn of_blocks<T: Real>(
    attitude: &Packed<T, 3, 3>,
    cross: &Packed<T, 3, 3>,
    bias: impl Fn(usize, usize) -> T,
) -> Matrix<T, 6, 6> {
    symmetric(
        #[inline(always)]
        |i, j| match (i < 3, j < 3) {
            (true, _) => attitude.at(i, j),
            (false, true) => cross.at(j, i - 3),
            (false, false) => bias(i - 3, j - 3),
        },
    )
}

/// Unit quaternions as measured values.
pub struct UnitQuaternion;

impl Family for UnitQuaternion {
    type Of<T: Real> = Quaternion<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &Quaternion<A>,
        b: &Quaternion<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> Quaternion<C> {
        [f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])]
    }
}

/// Vectors of three components as inputs and measured values.
pub struct Vector3;

impl Family for Vector3 {
    type Of<T: Real> = [T; 3];
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &[A; 3], b: &[B; 3], mut f: impl FnMut(A, B) -> C) -> [C; 3] {
        [f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2])]
    }
}

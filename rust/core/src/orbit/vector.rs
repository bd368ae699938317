//! Vectors of three components over any scalar.

use crate::linalg::{Matrix, from_fn};
pub(super) use crate::quaternion::{cross, dot3};
use crate::scalar::Real;

#[inline(always)]
pub(super) fn sub3<T: Real>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn add3<T: Real>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(super) fn scale<T: Real>(a: &[T; 3], s: T) -> [T; 3] {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `m a` for a matrix given by its rows.
#[inline(always)]
pub(super) fn rotate<T: Real>(m: &[[T; 3]; 3], a: &[T; 3]) -> [T; 3] {
    [dot3(&m[0], a), dot3(&m[1], a), dot3(&m[2], a)]
}

/// `mᵀ a` for a matrix given by its rows.
#[inline(always)]
pub(super) fn rotate_back<T: Real>(m: &[[T; 3]; 3], a: &[T; 3]) -> [T; 3] {
    let column = |j: usize| m[2][j].mul_add(a[2], m[1][j].mul_add(a[1], m[0][j] * a[0]));
    [column(0), column(1), column(2)]
}

/// `c (n r rᵀ − I)`
#[inline(always)]
pub(super) fn point_mass_gradient<T: Real>(r: &[T; 3], c: T, n: T) -> Matrix<T, 3, 3> {
    from_fn(
        #[inline(always)]
        |i, j| {
            let outer = r[i] * r[j] * n;
            c * if i == j { outer - T::one() } else { outer }
        },
    )
}

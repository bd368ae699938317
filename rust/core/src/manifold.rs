//! Where states live: a manifold with an `N`-dimensional error state.

use crate::linalg::{Matrix, Vector, congruence, identity, mul, solve_near_identity, symmetric, transpose};
use crate::scalar::{Mask, Real};

/// A record of scalars that exists over every [`Real`]: `Of<f64>`, `Of<Lanes>`, …
pub trait Family: 'static {
    /// The record over one scalar type.
    type Of<T: Real>: Copy;
    /// Combines two records component by component.
    fn zip<A: Real, B: Real, C: Real>(a: &Self::Of<A>, b: &Self::Of<B>, f: impl FnMut(A, B) -> C) -> Self::Of<C>;

    /// Changes each component.
    #[inline(always)]
    fn map<A: Real, B: Real>(a: &Self::Of<A>, mut f: impl FnMut(A) -> B) -> Self::Of<B> {
        Self::zip(a, a, |x, _| f(x))
    }
    /// One record where the mask is true, the other elsewhere.
    #[inline(always)]
    fn select<T: Real>(mask: T::Mask, yes: &Self::Of<T>, no: &Self::Of<T>) -> Self::Of<T> {
        Self::zip(yes, no, |a, b| T::select(mask, a, b))
    }
    /// Zero if every component is finite, not a number otherwise.
    #[inline(always)]
    fn finite<T: Real>(a: &Self::Of<T>) -> T {
        let mut sum = T::zero();
        Self::map(a, |x: T| {
            sum = x.mul_add(T::zero(), sum);
            x
        });
        sum
    }
}

/// A state space with retraction and its inverse. Laws, tested for every implementation:
/// `retract(x, 0) = x`; `local(x, retract(x, d)) = d`; `retract(x, local(x, y)) = y`;
/// `reset(x, d)` is the derivative of `e ↦ local(x ⊞ d, x ⊞ (d + e))` at `e = 0`.
pub trait Manifold<const N: usize>: Family {
    /// `x ⊞ d`
    fn retract<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>) -> Self::Of<T>;
    /// `y ⊟ x`, the error state that leads from `x` to `y`.
    fn local<T: Real>(x: &Self::Of<T>, y: &Self::Of<T>) -> Vector<T, N>;
    /// Removes rounding drift (of a quaternion's length) after a correction.
    #[inline(always)]
    fn normalise<T: Real>(x: &Self::Of<T>) -> Self::Of<T> {
        *x
    }
    /// Whether a finite state lies on the manifold (a quaternion has not shrunk to nothing).
    #[inline(always)]
    fn valid<T: Real>(_x: &Self::Of<T>) -> T::Mask {
        T::Mask::TRUE
    }
    /// How a small error about `x ⊞ d` follows from one about `x` at `d`.
    #[inline(always)]
    fn reset<T: Real>(_x: &Self::Of<T>, _d: &Vector<T, N>) -> Matrix<T, N, N> {
        identity()
    }
    /// Carries a covariance over a reset: `J P Jᵀ`. Override it to use structure.
    #[inline(always)]
    fn transport<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        congruence(&Self::reset(x, d), p)
    }
    /// Carries a square root of the covariance over a reset: `J L`. Override it to use structure.
    #[inline(always)]
    fn transport_factor<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, l: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        mul(&Self::reset(x, d), l)
    }
    /// Carries a covariance of errors about `x ⊞ d` back to errors about `x`: the inverse of
    /// [`Self::transport`].
    #[inline(always)]
    fn transport_back<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        let j = Self::reset(x, d);
        let once = solve_near_identity(&j, p);
        let twice = solve_near_identity(&j, &transpose(&once));
        symmetric(|i, k| twice[(i, k)])
    }
    /// Step of numerical differences along error component `i`.
    #[inline(always)]
    fn difference_step(_i: usize) -> f64 {
        1e-5
    }
}

/// A vector from its components. A loop: the closure of `std::array::from_fn`, or of an array's `map`, may be compiled on its
/// own, and that is for the baseline.
#[inline(always)]
pub(crate) fn components<T: Real, const N: usize>(mut component: impl FnMut(usize) -> T) -> Vector<T, N> {
    let mut v = [T::zero(); N];
    for i in 0..N {
        v[i] = component(i);
    }
    v
}

/// Plain vectors of `N` components.
pub struct Euclidean<const N: usize>;

impl<const N: usize> Family for Euclidean<N> {
    type Of<T: Real> = [T; N];
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &[A; N], b: &[B; N], mut f: impl FnMut(A, B) -> C) -> [C; N] {
        components(|i| f(a[i], b[i]))
    }
}

impl<const N: usize> Manifold<N> for Euclidean<N> {
    #[inline(always)]
    fn retract<T: Real>(x: &[T; N], d: &Vector<T, N>) -> [T; N] {
        Self::zip(x, d, |a, b| a + b)
    }
    #[inline(always)]
    fn local<T: Real>(x: &[T; N], y: &[T; N]) -> Vector<T, N> {
        Self::zip(y, x, |a, b| a - b)
    }
    #[inline(always)]
    fn transport<T: Real>(_: &[T; N], _: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        *p
    }
    #[inline(always)]
    fn transport_factor<T: Real>(_: &[T; N], _: &Vector<T, N>, l: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        *l
    }
    #[inline(always)]
    fn transport_back<T: Real>(_: &[T; N], _: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        *p
    }
}

/// `yes` where the mask is true, `no` elsewhere.
#[inline(always)]
pub(crate) fn select_matrix<T: Real, const R: usize, const C: usize>(
    mask: T::Mask,
    yes: &Matrix<T, R, C>,
    no: &Matrix<T, R, C>,
) -> Matrix<T, R, C> {
    if mask.all() {
        return *yes;
    }
    crate::linalg::from_fn(|i, j| T::select(mask, yes[(i, j)], no[(i, j)]))
}

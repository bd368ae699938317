//! Where states live: a manifold with an `N`-dimensional error state.

use crate::linalg::{Matrix, Vector, congruence, dot, identity, mul, solve_near_identity, symmetric, transpose};
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
    /// Becomes `new` where the mask is true.
    #[inline(always)]
    fn take<T: Real>(old: &mut Self::Of<T>, mask: T::Mask, new: &Self::Of<T>) {
        // branches, where all lanes agree: a store that waits for the mask holds up the next step
        if mask.all() {
            *old = *new;
        } else if mask.any() {
            *old = Self::zip(new, old, |a, b| T::select(mask, a, b));
        }
    }
    /// Zero if every component is finite, not a number otherwise.
    #[inline(always)]
    fn finite<T: Real>(a: &Self::Of<T>) -> T {
        let mut finite = Finite::new();
        Self::inspect(a, &mut finite);
        finite.nothing()
    }
    /// Looks at each component.
    #[inline(always)]
    fn inspect<T: Real>(a: &Self::Of<T>, finite: &mut Finite<T>) {
        Self::map(a, |x: T| {
            finite.look(x);
            x
        });
    }
}

/// Whether some numbers are all finite: zero times each, summed side by side, since one long sum would hold up what
/// waits for it.
pub struct Finite<T> {
    sums: [T; 4],
    seen: usize,
}

impl<T: Real> Finite<T> {
    /// Nothing has been looked at.
    #[inline(always)]
    pub fn new() -> Self {
        Self { sums: [T::zero(); 4], seen: 0 }
    }
    /// Looks at one more.
    #[inline(always)]
    pub fn look(&mut self, x: T) {
        let sum = &mut self.sums[self.seen % 4];
        *sum = x.mul_add(T::zero(), *sum);
        self.seen += 1;
    }
    /// Zero where all were, not a number elsewhere.
    #[inline(always)]
    pub fn nothing(&self) -> T {
        let [a, b, c, d] = self.sums;
        (a + b) + (c + d)
    }
    /// True where all were.
    #[inline(always)]
    pub fn all(&self) -> T::Mask {
        self.nothing().gt(T::splat(-1.0))
    }
}

impl<T: Real> Default for Finite<T> {
    fn default() -> Self {
        Self::new()
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
    /// How many of the first error states a reset mixes among themselves, if the others pass it unchanged: `J = [J₁ 0; 0 I]`.
    /// Zero says nothing.
    const RESETS: usize = 0;

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
    /// Carries some columns over a reset, side by side: `J a`. Override it to use structure.
    #[inline(always)]
    fn carry_columns<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, columns: &mut [Vector<T::Pack, N>]) {
        let j = Self::reset(x, d);
        for column in columns {
            let old = *column;
            for i in 0..N {
                column[i] = dot::<T::Pack, N>(|k| j[(i, k)].stack(), |k| old[k]);
            }
        }
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
    fn carry_columns<T: Real>(_: &[T; N], _: &Vector<T, N>, _: &mut [Vector<T::Pack, N>]) {}
    #[inline(always)]
    fn transport_back<T: Real>(_: &[T; N], _: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        *p
    }
}

/// Becomes `new` where the mask is true.
#[inline(always)]
pub(crate) fn take_matrix<T: Real, const R: usize, const C: usize>(
    old: &mut Matrix<T, R, C>,
    mask: T::Mask,
    new: &Matrix<T, R, C>,
) {
    // entry by entry: the new ones are in registers, and a copy of the whole would first put them into memory
    if mask.all() {
        for j in 0..C {
            for i in 0..R {
                old[(i, j)] = new[(i, j)];
            }
        }
    } else if mask.any() {
        // of a copy, for the sake of the way above: what a call or a loop reads by its address lies in memory on every way
        let copy = *new;
        take_some::<T, R, C>(old, mask, &copy);
    }
}

#[cold]
#[inline(never)]
fn take_some<T: Real, const R: usize, const C: usize>(old: &mut Matrix<T, R, C>, mask: T::Mask, new: &Matrix<T, R, C>) {
    for j in 0..C {
        for i in 0..R {
            old[(i, j)] = T::select(mask, new[(i, j)], old[(i, j)]);
        }
    }
}

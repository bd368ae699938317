//! What a filter knows, and what an update reports.

use crate::linalg::{Matrix, Vector, cholesky, diagonal, square};
use crate::manifold::{Family, Finite, Manifold, take_matrix};
use crate::scalar::{Mask, Real};

/// A state and its uncertainty.
pub trait Belief<S: Manifold<N>, T: Real, const N: usize>: Copy {
    /// From a state and the covariance of its error; false where that is not positive definite.
    fn new(mean: S::Of<T>, covariance: &Matrix<T, N, N>) -> (Self, T::Mask);
    /// The state.
    fn mean(&self) -> &S::Of<T>;
    /// Covariance of the error state.
    fn covariance(&self) -> Matrix<T, N, N>;
    /// Diagonal of the covariance.
    fn variance(&self) -> Vector<T, N>;
    /// Becomes `new` where the mask is true.
    fn take(&mut self, mask: T::Mask, new: &Self);
    /// True where the state and all variances are finite. Enough after a prediction, which cannot make
    /// a variance negative.
    #[inline(always)]
    fn finite(&self) -> T::Mask {
        finite::<S, T, N>(self.mean(), &self.variance())
    }
    /// True where state and covariance are finite and every variance is positive.
    #[inline(always)]
    fn healthy(&self) -> T::Mask {
        healthy::<S, T, N>(self.mean(), &self.variance())
    }
}

/// See [`Belief::finite`].
#[inline(always)]
pub(crate) fn finite<S: Manifold<N>, T: Real, const N: usize>(mean: &S::Of<T>, variance: &Vector<T, N>) -> T::Mask {
    let mut finite = Finite::new();
    S::inspect(mean, &mut finite);
    for i in 0..N {
        finite.look(variance[i]);
    }
    finite.all().and(S::valid(mean))
}

/// See [`Belief::healthy`].
#[inline(always)]
pub(crate) fn healthy<S: Manifold<N>, T: Real, const N: usize>(mean: &S::Of<T>, variance: &Vector<T, N>) -> T::Mask {
    let mut ok = finite::<S, T, N>(mean, variance);
    for i in 0..N {
        ok = ok.and(variance[i].gt(T::zero()));
    }
    ok
}

/// A state and the covariance of its error.
pub struct Gaussian<S: Family, T: Real, const N: usize> {
    /// The state.
    pub mean: S::Of<T>,
    /// Covariance of the error state.
    pub cov: Matrix<T, N, N>,
}

/// A state and a square root of the covariance of its error: `P = L Lᵀ`.
pub struct SqrtGaussian<S: Family, T: Real, const N: usize> {
    /// The state.
    pub mean: S::Of<T>,
    /// A square root of the covariance, not necessarily triangular.
    pub factor: Matrix<T, N, N>,
}

macro_rules! copy {
    ($($name:ident),*) => {$(
        impl<S: Family, T: Real, const N: usize> Clone for $name<S, T, N> {
            #[inline(always)]
            fn clone(&self) -> Self {
                *self
            }
        }
        impl<S: Family, T: Real, const N: usize> Copy for $name<S, T, N> {}
    )*};
}
copy!(Gaussian, SqrtGaussian);

impl<S: Manifold<N>, T: Real, const N: usize> Belief<S, T, N> for Gaussian<S, T, N> {
    #[inline(always)]
    fn new(mean: S::Of<T>, covariance: &Matrix<T, N, N>) -> (Self, T::Mask) {
        let (_, ok) = cholesky(covariance);
        let ok = ok.and(finite::<S, T, N>(&mean, &diagonal(covariance)));
        (Self { mean, cov: *covariance }, ok)
    }
    #[inline(always)]
    fn mean(&self) -> &S::Of<T> {
        &self.mean
    }
    #[inline(always)]
    fn covariance(&self) -> Matrix<T, N, N> {
        self.cov
    }
    #[inline(always)]
    fn variance(&self) -> Vector<T, N> {
        diagonal(&self.cov)
    }
    #[inline(always)]
    fn take(&mut self, mask: T::Mask, new: &Self) {
        S::take::<T>(&mut self.mean, mask, &new.mean);
        take_matrix::<T, N, N>(&mut self.cov, mask, &new.cov);
    }
}

impl<S: Manifold<N>, T: Real, const N: usize> Belief<S, T, N> for SqrtGaussian<S, T, N> {
    #[inline(always)]
    fn new(mean: S::Of<T>, covariance: &Matrix<T, N, N>) -> (Self, T::Mask) {
        let (factor, ok) = cholesky(covariance);
        let ok = ok.and(finite::<S, T, N>(&mean, &diagonal(covariance)));
        (Self { mean, factor }, ok)
    }
    #[inline(always)]
    fn mean(&self) -> &S::Of<T> {
        &self.mean
    }
    #[inline(always)]
    fn covariance(&self) -> Matrix<T, N, N> {
        square(&self.factor)
    }
    #[inline(always)]
    fn variance(&self) -> Vector<T, N> {
        let mut v = [T::zero(); N];
        for i in 0..N {
            for k in 0..N {
                v[i] = self.factor[(i, k)].mul_add(self.factor[(i, k)], v[i]);
            }
        }
        v
    }
    #[inline(always)]
    fn take(&mut self, mask: T::Mask, new: &Self) {
        S::take::<T>(&mut self.mean, mask, &new.mean);
        take_matrix::<T, N, N>(&mut self.factor, mask, &new.factor);
    }
}

/// What an update reports, per lane.
#[derive(Clone, Copy, Debug)]
pub struct Outcome<T: Real, const M: usize> {
    /// False: the innovation covariance was not positive definite, or the result not finite; the
    /// belief is as it was.
    pub ok: T::Mask,
    /// False: the measurement lay outside the gate, or `ok` is false; the belief is as it was.
    pub accepted: T::Mask,
    /// Measured minus predicted.
    pub innovation: Vector<T, M>,
    /// Covariance of the innovation.
    pub covariance: Matrix<T, M, M>,
    /// Normalised innovation squared, chi-square with `M` degrees of freedom.
    pub nis: T,
}

impl<T: Real, const M: usize> Outcome<T, M> {
    /// Another outcome's where the mask is true.
    #[inline(always)]
    pub fn take(&mut self, mask: T::Mask, other: &Self) {
        let both = |a: T::Mask, b: T::Mask| T::Mask::from_lanes(|i| if mask.lane(i) { a.lane(i) } else { b.lane(i) });
        self.ok = both(other.ok, self.ok);
        self.accepted = both(other.accepted, self.accepted);
        for i in 0..M {
            self.innovation[i] = T::select(mask, other.innovation[i], self.innovation[i]);
        }
        take_matrix::<T, M, M>(&mut self.covariance, mask, &other.covariance);
        self.nis = T::select(mask, other.nis, self.nis);
    }
}

/// A prediction together with what it has in common with the belief it came from, in factors:
/// `P = L Lᵀ` before, `P⁻ = A Aᵀ + W` after and `cov(x, x⁻) = L Aᵀ`. What a smoother needs.
pub struct Joint<S: Family, T: Real, const N: usize> {
    /// The predicted state.
    pub mean: S::Of<T>,
    /// Covariance of its error.
    pub cov: Matrix<T, N, N>,
    /// `L`, a square root of the covariance before.
    pub root: Matrix<T, N, N>,
    /// `A`, what the step makes of `L`.
    pub image: Matrix<T, N, N>,
    /// `W`, what the step adds.
    pub rest: Matrix<T, N, N>,
}

/// A normal distribution in the tangent space at a fixed point, whose mean need not be zero: what a
/// filter that has chosen where to linearise knows.
pub struct Tangent<S: Family, T: Real, const N: usize> {
    /// Where all is linearised.
    pub point: S::Of<T>,
    /// Mean error state about the point.
    pub offset: Vector<T, N>,
    /// Covariance of the error state about the point.
    pub cov: Matrix<T, N, N>,
}
copy!(Joint, Tangent);

impl<S: Manifold<N>, T: Real, const N: usize> Belief<S, T, N> for Tangent<S, T, N> {
    #[inline(always)]
    fn new(mean: S::Of<T>, covariance: &Matrix<T, N, N>) -> (Self, T::Mask) {
        let (_, ok) = cholesky(covariance);
        (Self { point: mean, offset: [T::zero(); N], cov: *covariance }, ok)
    }
    /// The point of linearisation.
    #[inline(always)]
    fn mean(&self) -> &S::Of<T> {
        &self.point
    }
    #[inline(always)]
    fn covariance(&self) -> Matrix<T, N, N> {
        self.cov
    }
    #[inline(always)]
    fn variance(&self) -> Vector<T, N> {
        diagonal(&self.cov)
    }
    #[inline(always)]
    fn take(&mut self, mask: T::Mask, new: &Self) {
        S::take::<T>(&mut self.point, mask, &new.point);
        for i in 0..N {
            self.offset[i] = T::select(mask, new.offset[i], self.offset[i]);
        }
        take_matrix::<T, N, N>(&mut self.cov, mask, &new.cov);
    }
}

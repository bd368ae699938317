//! What a satellite navigation receiver and star sensors measure, as filters see it.

use crate::attitude::{AttitudeBias, Pointing, PointingSpace, Symmetric3, UnitQuaternion, Vector3};
use crate::augmented::{Joined, JoinedSpace};
use crate::linalg::{Matrix, Vector, from_fn, set_block, zeros};
use crate::manifold::{Euclidean, Family, Manifold};
use crate::model::Measurement;
use crate::quaternion::{self, Quaternion, conjugate, difference, multiply, right_jacobian, to_matrix};
use crate::scalar::Real;
use std::marker::PhantomData;

/// A symmetric matrix from `(xx, xy, xz, yy, yz, zz)`.
#[inline(always)]
fn unpacked<T: Real>(r: &[T; 6]) -> Matrix<T, 3, 3> {
    let at = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
    from_fn(
        #[inline(always)]
        |i, j| r[at[i][j]],
    )
}

/// Position of an orbit, GCRS, m, with the first vector of the tail, if there is one, as the receiver's bias.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionFix;

/// State of an orbit and its tail.
pub type OrbitState<T, const K: usize> = Joined<[T; 6], T, K>;
/// The space of [`OrbitState`].
pub type OrbitSpace<const K: usize, const N: usize> = JoinedSpace<Euclidean<6>, 6, K, N>;

impl<const K: usize, const N: usize> Measurement<N, 3> for Seeing<PositionFix, K, N> {
    type Space = OrbitSpace<K, N>;
    type Given = Symmetric3;
    type Value = Vector3;
    const DIRECT: bool = K == 0;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &OrbitState<T, K>, _: &[T; 6]) -> [T; 3] {
        let mut r = [x.head[0], x.head[1], x.head[2]];
        if K > 0 {
            for i in 0..3 {
                r[i] += x.tail[0][i];
            }
        }
        r
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 3], zhat: &[T; 3]) -> Vector<T, 3> {
        [z[0] - zhat[0], z[1] - zhat[1], z[2] - zhat[2]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 3, 3> {
        unpacked(r)
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, _: &OrbitState<T, K>, _: &[T; 6]) -> Matrix<T, 3, N> {
        from_fn(
            #[inline(always)]
            |i, j| if j == i || K > 0 && j == 6 + i { T::one() } else { T::zero() },
        )
    }
    /// Positions add up.
    #[inline(always)]
    fn linear<T: Real>(&self, _: &Matrix<T, N, N>, _: f64) -> T::Mask {
        <T::Mask as crate::scalar::Mask>::TRUE
    }
}

/// Velocity of an orbit, GCRS, m/s.
#[derive(Clone, Copy, Debug, Default)]
pub struct VelocityFix;

impl<const K: usize, const N: usize> Measurement<N, 3> for Seeing<VelocityFix, K, N> {
    type Space = OrbitSpace<K, N>;
    type Given = Symmetric3;
    type Value = Vector3;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &OrbitState<T, K>, _: &[T; 6]) -> [T; 3] {
        [x.head[3], x.head[4], x.head[5]]
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 3], zhat: &[T; 3]) -> Vector<T, 3> {
        [z[0] - zhat[0], z[1] - zhat[1], z[2] - zhat[2]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 3, 3> {
        unpacked(r)
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, _: &OrbitState<T, K>, _: &[T; 6]) -> Matrix<T, 3, N> {
        from_fn(
            #[inline(always)]
            |i, j| if j == 3 + i { T::one() } else { T::zero() },
        )
    }
    #[inline(always)]
    fn linear<T: Real>(&self, _: &Matrix<T, N, N>, _: f64) -> T::Mask {
        <T::Mask as crate::scalar::Mask>::TRUE
    }
}

/// A measurement of a head with `K` vectors that ride along.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seeing<M, const K: usize, const N: usize>(PhantomData<M>);

impl<M, const K: usize, const N: usize> Seeing<M, K, N> {
    /// The measurement.
    pub fn new() -> Self {
        Self(PhantomData)
    }
}

/// States that hold an attitude as their first three error states.
pub trait Oriented: Family {
    /// The attitude.
    fn attitude<T: Real>(x: &Self::Of<T>) -> Quaternion<T>;
}

impl Oriented for AttitudeBias {
    #[inline(always)]
    fn attitude<T: Real>(x: &Self::Of<T>) -> Quaternion<T> {
        x.q
    }
}

impl Oriented for PointingSpace {
    #[inline(always)]
    fn attitude<T: Real>(x: &Pointing<T>) -> Quaternion<T> {
        x.q
    }
}

/// Attitude whose slow error is a sum of the tail's vectors with known weights: `q = q_true ⊗ exp((Σ w_k c_k + noise)/2)`.
#[derive(Clone, Copy, Debug, Default)]
pub struct AttitudeFix<S, const H: usize>(PhantomData<S>);

/// What is known of an attitude fix beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixGiven<T, const K: usize> {
    /// Covariance of its white error, body frame, rad²: `(xx, xy, xz, yy, yz, zz)`.
    pub noise: [T; 6],
    /// How much each vector of the tail adds to its error.
    pub weights: [T; K],
}

/// [`FixGiven`] over every scalar.
pub struct FixGivens<const K: usize>;

impl<const K: usize> Family for FixGivens<K> {
    type Of<T: Real> = FixGiven<T, K>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &FixGiven<A, K>,
        b: &FixGiven<B, K>,
        mut f: impl FnMut(A, B) -> C,
    ) -> FixGiven<C, K> {
        FixGiven {
            noise: Symmetric3::zip(&a.noise, &b.noise, &mut f),
            weights: Euclidean::<K>::zip(&a.weights, &b.weights, &mut f),
        }
    }
}

/// The slow error of a fix, a rotation vector in the body frame.
#[inline(always)]
fn slow<T: Real, const K: usize>(tail: &[[T; 3]; K], weights: &[T; K]) -> [T; 3] {
    let mut b = [T::zero(); 3];
    for k in 0..K {
        for i in 0..3 {
            b[i] = weights[k].mul_add(tail[k][i], b[i]);
        }
    }
    b
}

impl<S: Manifold<H> + Oriented, const H: usize, const K: usize, const N: usize> Measurement<N, 3>
    for Seeing<AttitudeFix<S, H>, K, N>
{
    type Space = JoinedSpace<S, H, K, N>;
    type Given = FixGivens<K>;
    type Value = UnitQuaternion;
    const DIRECT: bool = K == 0;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Joined<S::Of<T>, T, K>, given: &FixGiven<T, K>) -> Quaternion<T> {
        let q = S::attitude(&x.head);
        if K == 0 { q } else { multiply(&q, &quaternion::exp(&slow(&x.tail, &given.weights))) }
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &Quaternion<T>, zhat: &Quaternion<T>) -> Vector<T, 3> {
        difference(zhat, z)
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &FixGiven<T, K>) -> Matrix<T, 3, 3> {
        unpacked(&given.noise)
    }
    /// `exp(−b) exp(δθ) exp(b)` turns the attitude's error into the frame after the slow error `b`.
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &Joined<S::Of<T>, T, K>, given: &FixGiven<T, K>) -> Matrix<T, 3, N> {
        let mut h = zeros();
        let b = slow(&x.tail, &given.weights);
        set_block(&mut h, 0, 0, &to_matrix(&conjugate(&quaternion::exp(&b))));
        let jacobian = right_jacobian(&b);
        for k in 0..K {
            for j in 0..3 {
                for i in 0..3 {
                    h[(i, H + 3 * k + j)] = jacobian[(i, j)] * given.weights[k];
                }
            }
        }
        h
    }
}

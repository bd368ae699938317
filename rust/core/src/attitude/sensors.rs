//! Attitude sensors.

use super::state::{Attitude, AttitudeBias, UnitQuaternion, Vector3};
use crate::linalg::{Matrix, Vector, from_fn, skew, zeros};
use crate::manifold::Family;
use crate::model::Measurement;
use crate::quaternion::{Quaternion, conjugate, cross, difference, dot3, rotate, tangents};
use crate::scalar::{Mask, Real};

/// Star camera (or any sensor) that reports the whole attitude `q_ib`. The residual is the rotation
/// vector from the predicted to the measured attitude in the body frame, rad.
#[derive(Clone, Copy, Debug, Default)]
pub struct StarQuaternion;

/// A symmetric 3×3 matrix as `(xx, xy, xz, yy, yz, zz)`.
pub struct Symmetric3;

impl Family for Symmetric3 {
    type Of<T: Real> = [T; 6];
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &[A; 6], b: &[B; 6], mut f: impl FnMut(A, B) -> C) -> [C; 6] {
        [f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3]), f(a[4], b[4]), f(a[5], b[5])]
    }
}

impl Measurement<6, 3> for StarQuaternion {
    type Space = AttitudeBias;
    /// Covariance of the attitude error in the body frame, rad².
    type Given = Symmetric3;
    type Value = UnitQuaternion;
    const DIRECT: bool = true;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Attitude<T>, _: &[T; 6]) -> Quaternion<T> {
        x.q
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &Quaternion<T>, zhat: &Quaternion<T>) -> Vector<T, 3> {
        difference(zhat, z)
    }
    #[inline(always)]
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 3, 3> {
        let at = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        from_fn(|i, j| r[at[i][j]])
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, _: &Attitude<T>, _: &[T; 6]) -> Matrix<T, 3, 6> {
        from_fn(|i, j| if i == j { T::one() } else { T::zero() })
    }
    #[inline(always)]
    fn project<T: Real, const R: usize>(&self, _: &Matrix<T, 3, 6>, a: &Matrix<T, R, 6>) -> Matrix<T, R, 3> {
        from_fn(|i, j| a[(i, j)])
    }
    /// The residual of `q ⊗ exp(δθ)` is `δθ` itself, up to half a turn.
    #[inline(always)]
    fn linear<T: Real>(&self, p: &Matrix<T, 6, 6>, c: f64) -> bool {
        T::splat(9.0).gt((p[(0, 0)] + p[(1, 1)] + p[(2, 2)]) * c).all()
    }
}

/// Sensor of one direction known in the inertial frame: a star, the Sun, the magnetic field. Two
/// degrees of freedom: the residual is the arc from the predicted to the measured direction, in two
/// axes across the predicted one, rad.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direction;

/// What is known of a direction beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference<T> {
    /// Unit vector in the inertial frame.
    pub inertial: [T; 3],
    /// Standard deviation of the measured direction about each axis across it, rad.
    pub sigma: T,
}

/// [`Reference`] over every scalar.
pub struct References;

impl Family for References {
    type Of<T: Real> = Reference<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &Reference<A>,
        b: &Reference<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> Reference<C> {
        Reference { inertial: Vector3::zip(&a.inertial, &b.inertial, &mut f), sigma: f(a.sigma, b.sigma) }
    }
}

impl Measurement<6, 2> for Direction {
    type Space = AttitudeBias;
    type Given = References;
    /// Unit vector in the body frame.
    type Value = Vector3;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Attitude<T>, given: &Reference<T>) -> [T; 3] {
        rotate(&conjugate(&x.q), &given.inertial)
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 3], zhat: &[T; 3]) -> Vector<T, 2> {
        let [u, v] = tangents(zhat);
        let across = cross(zhat, z);
        let (sine2, cosine) = (dot3(&across, &across), dot3(zhat, z));
        let arc = arc_over_sine(sine2, cosine);
        // opposite directions are half a turn apart, by any way
        let opposite = T::splat(1e-16).gt(sine2).and(T::zero().gt(cosine));
        let first = dot3(&u, z) * arc;
        [T::select(opposite, T::splat(std::f64::consts::PI), first), dot3(&v, z) * arc]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &Reference<T>) -> Matrix<T, 2, 2> {
        let mut r = zeros();
        r[(0, 0)] = given.sigma * given.sigma;
        r[(1, 1)] = given.sigma * given.sigma;
        r
    }
    /// A small turn δθ of the body moves the direction by `b × δθ`.
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &Attitude<T>, given: &Reference<T>) -> Matrix<T, 2, 6> {
        let b = self.predict(x, given);
        let (s, axes) = (skew(&b), tangents(&b));
        from_fn(|i, j| {
            if j >= 3 {
                return T::zero();
            }
            dot3(&axes[i], &[s[(0, j)], s[(1, j)], s[(2, j)]])
        })
    }
    #[inline(always)]
    fn project<T: Real, const R: usize>(&self, h: &Matrix<T, 2, 6>, a: &Matrix<T, R, 6>) -> Matrix<T, R, 2> {
        from_fn(|i, j| dot3(&[a[(i, 0)], a[(i, 1)], a[(i, 2)]], &[h[(j, 0)], h[(j, 1)], h[(j, 2)]]))
    }
}

/// `θ / sin θ` of the angle with `sin² θ` and `cos θ` given.
#[inline(always)]
fn arc_over_sine<T: Real>(sine2: T, cosine: T) -> T {
    T::from_lanes(
        #[inline(always)]
        |i| {
            let (s, c) = (sine2.lane(i).sqrt(), cosine.lane(i));
            // the limit at zero
            if s < 1e-8 { 1.0 } else { s.atan2(c) / s }
        },
    )
}

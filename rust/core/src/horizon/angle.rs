//! Angles to the nadir, and the nadir direction, as measurements of a position.

use super::noise::Shape;
use crate::linalg::{Matrix, Vector, from_fn};
use crate::manifold::{Euclidean, Family};
use crate::model::Measurement;
use crate::quaternion::{cross, dot3};
use crate::scalar::Real;

/// Unit vector from the Earth's centre, and the reciprocal of its distance.
#[inline(always)]
fn zenith<T: Real>(x: &[T; 6]) -> (Vector<T, 3>, T) {
    let r = [x[0], x[1], x[2]];
    let inverse = dot3(&r, &r).sqrt().recip();
    ([r[0] * inverse, r[1] * inverse, r[2] * inverse], inverse)
}

/// Angle between a star and the nadir, or the part of it up to the Earth's limb, rad.
#[derive(Clone, Copy, Debug, Default)]
pub struct StarAngle {
    /// Distribution of its error.
    pub shape: Shape,
    /// Radius of the sphere whose limb angles end at, m; zero for angles to the nadir.
    pub limb: f64,
}

impl StarAngle {
    /// Angle between nadir and limb at a reciprocal distance, and its derivative to the distance. A sphere that
    /// reaches up to the satellite has its limb at a right angle.
    #[inline(always)]
    fn dip<T: Real>(&self, inverse: T) -> (T, T) {
        if self.limb == 0.0 {
            return (T::zero(), T::zero());
        }
        let sine = inverse * self.limb;
        let sine = T::select(sine.gt(T::one()), T::one(), sine);
        let cosine = (T::one() - sine * sine).sqrt();
        (sine.map(f64::asin), -(sine * inverse) * cosine.recip())
    }
}

/// What is known of an angle beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StarGiven<T> {
    /// Unit vector to the star, inertial frame.
    pub star: [T; 3],
    /// Standard deviation of the angle, rad.
    pub sigma: T,
}

/// [`StarGiven`] over every scalar.
pub struct StarGivens;

impl Family for StarGivens {
    type Of<T: Real> = StarGiven<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &StarGiven<A>,
        b: &StarGiven<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> StarGiven<C> {
        StarGiven { star: Euclidean::<3>::zip(&a.star, &b.star, &mut f), sigma: f(a.sigma, b.sigma) }
    }
}

impl Measurement<6, 1> for StarAngle {
    type Space = Euclidean<6>;
    type Given = StarGivens;
    type Value = Euclidean<1>;

    /// By sine and cosine: neither is precise for all angles.
    #[inline(always)]
    fn predict<T: Real>(&self, x: &[T; 6], given: &StarGiven<T>) -> [T; 1] {
        let (up, inverse) = zenith(x);
        let across = cross(&given.star, &up);
        let (sine, cosine) = (dot3(&across, &across).sqrt(), -dot3(&given.star, &up));
        let angle = T::from_lanes(
            #[inline(always)]
            |i| sine.lane(i).atan2(cosine.lane(i)),
        );
        [angle - self.dip(inverse).0]
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> Vector<T, 1> {
        [z[0] - zhat[0]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &StarGiven<T>) -> Matrix<T, 1, 1> {
        from_fn(|_, _| given.sigma * given.sigma)
    }
    #[inline(always)]
    fn posterior<T: Real>(&self, y: T, s: T, given: &StarGiven<T>) -> (T, T) {
        if self.shape == Shape::Normal {
            let noise = given.sigma * given.sigma;
            let gain = s / (s + noise);
            return (y * gain, noise * gain);
        }
        let mut each = [(0.0, 0.0); 8];
        for i in 0..T::LANES {
            each[i] = self.shape.posterior(y.lane(i), s.lane(i), given.sigma.lane(i));
        }
        (T::from_lanes(|i| each[i].0), T::from_lanes(|i| each[i].1))
    }
    /// `∂θ/∂r = (s − (s·u) u) / (|r| sin θ)`, with `u` the zenith. Not a number for a star at the zenith or
    /// the nadir, where the angle has no derivative.
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &[T; 6], given: &StarGiven<T>) -> Matrix<T, 1, 6> {
        let (up, inverse) = zenith(x);
        let along = dot3(&given.star, &up);
        let across = cross(&given.star, &up);
        let scale = inverse * dot3(&across, &across).sqrt().recip();
        let (_, outwards) = self.dip(inverse);
        from_fn(|_, j| {
            if j >= 3 {
                return T::zero();
            }
            (given.star[j] - along * up[j]) * scale - outwards * up[j]
        })
    }
}

/// Nadir direction, as its components along two axes across a direction near it.
#[derive(Clone, Copy, Debug, Default)]
pub struct NadirPlane;

/// The axes, and the covariance of the components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneGiven<T> {
    /// Two unit vectors, inertial frame.
    pub axes: AnglePlane<T>,
    /// Covariance `(aa, ab, bb)`, rad².
    pub noise: [T; 3],
}

/// Two axes across a direction.
pub type AnglePlane<T> = [[T; 3]; 2];

/// [`PlaneGiven`] over every scalar.
pub struct PlaneGivens;

impl Family for PlaneGivens {
    type Of<T: Real> = PlaneGiven<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &PlaneGiven<A>,
        b: &PlaneGiven<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> PlaneGiven<C> {
        let axes =
            [Euclidean::<3>::zip(&a.axes[0], &b.axes[0], &mut f), Euclidean::<3>::zip(&a.axes[1], &b.axes[1], &mut f)];
        PlaneGiven { axes, noise: Euclidean::<3>::zip(&a.noise, &b.noise, &mut f) }
    }
}

impl Measurement<6, 2> for NadirPlane {
    type Space = Euclidean<6>;
    type Given = PlaneGivens;
    type Value = Euclidean<2>;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &[T; 6], given: &PlaneGiven<T>) -> [T; 2] {
        let (up, _) = zenith(x);
        [-dot3(&given.axes[0], &up), -dot3(&given.axes[1], &up)]
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 2], zhat: &[T; 2]) -> Vector<T, 2> {
        [z[0] - zhat[0], z[1] - zhat[1]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &PlaneGiven<T>) -> Matrix<T, 2, 2> {
        from_fn(|i, j| given.noise[i + j])
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &[T; 6], given: &PlaneGiven<T>) -> Matrix<T, 2, 6> {
        let (up, inverse) = zenith(x);
        from_fn(|i, j| {
            if j >= 3 {
                return T::zero();
            }
            let axis = &given.axes[i];
            (dot3(axis, &up) * up[j] - axis[j]) * inverse
        })
    }
}

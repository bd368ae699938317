//! Normal equations of a nadir direction, and what they say of it.

use super::angle::PlaneGiven;
use super::noise::AngleNoise;
use crate::linalg::Matrix;
use crate::quaternion::dot3;
use crate::scalar::{Mask, Real};

/// A nadir direction that an epoch's angles have given.
#[derive(Clone, Copy, Debug)]
pub struct Fitted<T> {
    /// Axes across the place of linearisation, and the covariance of the direction's components along them.
    pub given: PlaneGiven<T>,
    /// The components.
    pub value: [T; 2],
    /// Angles that were used.
    pub used: usize,
    /// Directions that they fix: 2, or 1.
    pub rank: usize,
}

/// What a filter expects of the nadir.
#[derive(Clone, Copy, Debug)]
pub struct Expected<T: Real> {
    /// Unit vector.
    pub nadir: [T; 3],
    /// Covariance of the position over the squared distance, rad².
    pub spread: Matrix<T, 3, 3>,
}

/// Longest step, rad.
const LONGEST: f64 = 0.1;
/// What an axis that the angles do not fix is held to, relative to the one they do.
const FLOOR: f64 = 1e-9;
/// Below this ratio of the squared extents of an epoch's stars their second direction counts for nothing.
const FLAT: f64 = 1e-7;

/// Inverse of a symmetric matrix, each as `(aa, ab, bb)`.
#[inline(always)]
pub(super) fn inverse<T: Real>(aa: T, ab: T, bb: T) -> [T; 3] {
    let inverse = (aa * bb - ab * ab).recip();
    [bb * inverse, -ab * inverse, aa * inverse]
}

/// Normal equations of an epoch.
pub(super) struct Sums<T> {
    pub(super) axes: [[T; 3]; 2],
    /// Information about the components along the axes `(aa, ab, bb)`.
    pub(super) squares: [T; 3],
    pub(super) gradient: [T; 2],
    pub(super) used: usize,
}

impl<T: Real> Sums<T> {
    /// Step of Gauss and Newton towards the place where angles and expectation agree best, cut to a length that angles
    /// can follow.
    #[inline(always)]
    pub(super) fn step(&self, nadir: &[T; 3], expected: &Expected<T>, noise: &AngleNoise) -> [T; 2] {
        let away = [nadir[0] - expected.nadir[0], nadir[1] - expected.nadir[1], nadir[2] - expected.nadir[2]];
        let off = [dot3(&self.axes[0], &away), dot3(&self.axes[1], &away)];
        let p = &expected.spread;
        let spread = |a: &[T; 3], b: &[T; 3]| {
            let row = |i: usize| dot3(&[p[(i, 0)], p[(i, 1)], p[(i, 2)]], b);
            dot3(a, &[row(0), row(1), row(2)])
        };
        let shared = T::splat(noise.shared * noise.shared);
        let [u, v] = &self.axes;
        let [aa, ab, bb] = inverse(spread(u, u) + shared, spread(u, v), spread(v, v) + shared);
        let gradient = [self.gradient[0] - aa * off[0] - ab * off[1], self.gradient[1] - ab * off[0] - bb * off[1]];
        let [aa, ab, bb] = inverse(self.squares[0] + aa, self.squares[1] + ab, self.squares[2] + bb);
        let step = [aa * gradient[0] + ab * gradient[1], ab * gradient[0] + bb * gradient[1]];
        let square = step[0] * step[0] + step[1] * step[1];
        let long = square.gt(T::splat(LONGEST * LONGEST));
        let part = T::select(long, T::select(long, square, T::one()).sqrt().recip() * LONGEST, T::one());
        [step[0] * part, step[1] * part]
    }

    /// Inverse of the information. An axis that the stars do not fix is held, loosely enough not to count.
    #[inline(always)]
    fn inverse(&self) -> [T; 3] {
        let floor = (self.squares[0] + self.squares[2]) * FLOOR;
        inverse(self.squares[0] + floor, self.squares[1], self.squares[2] + floor)
    }

    /// Along axes of which the first one is the one that is fixed.
    #[inline(always)]
    fn along_principal(&self, shared: T) -> Fitted<T> {
        let [aa, ab, bb] = self.squares;
        let turn = |f: fn(f64) -> f64| {
            T::from_lanes(
                #[inline(always)]
                |i| f(0.5 * (ab.lane(i) * 2.0).atan2(aa.lane(i) - bb.lane(i))),
            )
        };
        let (sin, cos) = (turn(f64::sin), turn(f64::cos));
        let [u, v] = self.axes;
        let mut axes = [u, v];
        for i in 0..3 {
            axes[0][i] = cos * u[i] + sin * v[i];
            axes[1][i] = cos * v[i] - sin * u[i];
        }
        let own = (aa + bb).recip();
        let along = (cos * self.gradient[0] + sin * self.gradient[1]) * own;
        let noise = [own + shared, T::zero(), own * (1.0 / FLOOR)];
        Fitted { given: PlaneGiven { axes, noise }, value: [along, T::zero()], used: self.used, rank: 1 }
    }

    #[inline(always)]
    pub(super) fn fitted(&self, noise: &AngleNoise) -> Fitted<T> {
        let shared = T::splat(noise.shared * noise.shared);
        let trace = self.squares[0] + self.squares[2];
        let determinant = self.squares[0] * self.squares[2] - self.squares[1] * self.squares[1];
        let flat = (trace * trace * FLAT).gt(determinant).any();
        if flat {
            return self.along_principal(shared);
        }
        let [aa, ab, bb] = self.inverse();
        let [a, b] = self.gradient;
        let given = PlaneGiven { axes: self.axes, noise: [aa + shared, ab, bb + shared] };
        Fitted { given, value: [aa * a + ab * b, ab * a + bb * b], used: self.used, rank: 2 }
    }
}

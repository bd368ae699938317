//! The angles of a log, epoch by epoch, and what those of one epoch say together.
//!
//! Angles to known stars say nothing of the position but the direction of the nadir, two numbers however
//! many stars there are. So the angles of an epoch are fitted by a nadir direction, and the filters see
//! that: one small update instead of one for each star, with nothing lost.

use super::noise::AngleNoise;
use super::normal::{Expected, Fitted, Sums, inverse};
use super::sights::{Robust, Sight, SightPack};
use crate::error::{Error, Result};
use crate::manifold::components;
use crate::quaternion::{dot3, tangents};
use crate::scalar::{Mask, Real};

/// Angles between stars and the nadir: rows of the same time are one epoch.
#[derive(Clone, Copy, Debug)]
pub struct AngleSeries<'a> {
    /// Times, s, not decreasing.
    pub t: &'a [f64],
    /// Unit vectors to the stars, GCRS.
    pub star: &'a [[f64; 3]],
    /// Angles, rad.
    pub angle: &'a [f64],
}

/// Angles by epochs, ready for filters.
#[derive(Clone, Debug, Default)]
pub struct Epochs {
    t: Vec<f64>,
    /// First sight of each epoch, and the end.
    begin: Vec<usize>,
    sights: Vec<Sight>,
}

/// Gauss-Newton on two numbers.
const ITERATIONS: usize = 20;
/// A step below this part of an angle's own standard deviation ends the fit: what an angle bends over it, its square
/// over the star's distance from the zenith, is far below anything that could be seen.
const SMALL: f64 = 0.05;

impl Epochs {
    /// # Errors
    /// `Length`, `NotIncreasing`, or `Parameter` for what is no unit vector or no angle.
    pub fn new(series: &AngleSeries<'_>) -> Result<Self> {
        let mut out = Self::default();
        out.fill(series)?;
        Ok(out)
    }

    /// [`Self::new`] into memory that is there.
    ///
    /// # Errors
    /// See [`Self::new`].
    pub fn fill(&mut self, series: &AngleSeries<'_>) -> Result<()> {
        for (field, found) in [("horizon.star", series.star.len()), ("horizon.angle", series.angle.len())] {
            if found != series.t.len() {
                return Err(Error::Length { field, expected: series.t.len(), found });
            }
        }
        self.t.clear();
        self.begin.clear();
        self.sights.clear();
        for (row, ((t, star), angle)) in series.t.iter().zip(series.star).zip(series.angle).enumerate() {
            match self.t.last() {
                Some(last) if t == last => {}
                Some(last) if t.partial_cmp(last) != Some(std::cmp::Ordering::Greater) => {
                    return Err(Error::NotIncreasing { field: "horizon.t", row, previous: *last, value: *t });
                }
                _ if !t.is_finite() => {
                    return Err(Error::Parameter { field: "horizon.t", value: *t, need: "must be finite" });
                }
                _ => {
                    self.t.push(*t);
                    self.begin.push(row);
                }
            }
            let off = dot3(star, star) - 1.0;
            if off.is_nan() || off.abs() > 1e-6 {
                let need = "is the length of a star's vector, which must be a unit vector";
                return Err(Error::Parameter { field: "horizon.star", value: dot3(star, star).sqrt(), need });
            }
            if !(0.0..=std::f64::consts::PI).contains(angle) {
                let need = "must be an angle between 0 and pi rad";
                return Err(Error::Parameter { field: "horizon.angle", value: *angle, need });
            }
            let (sin, cos) = angle.sin_cos();
            self.sights.push(Sight { star: *star, cos, sin });
        }
        self.begin.push(self.sights.len());
        Ok(())
    }

    /// Times of the epochs, s.
    pub fn times(&self) -> &[f64] {
        &self.t
    }

    /// Rows of an epoch in the log.
    #[inline(always)]
    pub fn rows(&self, epoch: usize) -> std::ops::Range<usize> {
        self.begin[epoch]..self.begin[epoch + 1]
    }

    /// Star and angle of a row of the log.
    #[inline(always)]
    pub fn sight(&self, row: usize) -> ([f64; 3], f64) {
        let s = &self.sights[row];
        (s.star, s.sin.atan2(s.cos))
    }

    /// What the angles of an epoch say of the nadir direction, linearised where they and the expected direction
    /// agree best. None where no angle is left to use.
    ///
    /// The expected direction takes part in finding that place, by its own uncertainty: two stars nearly in
    /// one plane with the nadir fix its direction across that plane so badly that without it the fit would run to where
    /// angles bend the other way. What comes back is the angles' part alone.
    #[inline(always)]
    pub fn fit<T: Real>(
        &self,
        epoch: usize,
        noise: &AngleNoise,
        robust: Robust,
        expected: &Expected<T>,
    ) -> Option<Fitted<T>> {
        let tolerance = T::splat((SMALL * noise.own) * (SMALL * noise.own));
        let mut nadir = expected.nadir;
        let mut left = ITERATIONS;
        loop {
            let sums = self.sums(self.rows(epoch), noise, &nadir, (robust, expected));
            if sums.used == 0 {
                return None;
            }
            let step = sums.step(&nadir, expected, noise);
            let square = step[0] * step[0] + step[1] * step[1];
            if left == 0 || tolerance.gt(square).all() {
                return Some(sums.fitted(noise));
            }
            left -= 1;
            // of unit length again: the axes are at right angles to the direction and to each other
            let scale = (square + T::one()).sqrt().recip();
            for i in 0..3 {
                let moved = step[1].mul_add(sums.axes[1][i], step[0].mul_add(sums.axes[0][i], nadir[i]));
                nadir[i] = moved * scale;
            }
        }
    }

    /// Normal equations of the angles about a nadir direction, stars side by side.
    #[inline(always)]
    fn sums<T: Real>(
        &self,
        rows: std::ops::Range<usize>,
        noise: &AngleNoise,
        nadir: &[T; 3],
        (robust, expected): (Robust, &Expected<T>),
    ) -> Sums<T> {
        let axes = tangents(nadir);
        let lifted = |v: &[T; 3]| [v[0].stack(), v[1].stack(), v[2].stack()];
        let (down, across) = (lifted(nadir), [lifted(&axes[0]), lifted(&axes[1])]);
        let zero = T::Pack::zero();
        let (mut aa, mut ab, mut bb, mut ga, mut gb) = (zero, zero, zero, zero, zero);
        let mut used = 0;
        let own = 1.0 / (noise.own * noise.own);
        let mut first = rows.start;
        while first < rows.end {
            let pack = self.pack::<T>(first, rows.end);
            let (left, sine, inverse) = pack.left(&down);
            let e = [-dot3(&pack.star, &across[0]) * inverse, -dot3(&pack.star, &across[1]) * inverse];
            // a star at the nadir or the zenith has no derivative, and says nothing to first order
            let seen = sine.gt(T::Pack::splat(1e-9));
            let weight = T::Pack::select(seen, pack.filled * own, zero);
            let weight = weight * pack.trust::<T>(robust, expected, noise);
            let e = [T::Pack::select(seen, e[0], zero), T::Pack::select(seen, e[1], zero)];
            aa = (weight * e[0]).mul_add(e[0], aa);
            ab = (weight * e[0]).mul_add(e[1], ab);
            bb = (weight * e[1]).mul_add(e[1], bb);
            ga = (weight * e[0]).mul_add(left, ga);
            gb = (weight * e[1]).mul_add(left, gb);
            for slot in 0..T::WIDTH {
                used += usize::from(T::extract(weight, slot).lane(0) > 0.0);
            }
            first += T::WIDTH;
        }
        let squares = [T::total(aa), T::total(ab), T::total(bb)];
        Sums { axes, squares, gradient: [T::total(ga), T::total(gb)], used }
    }

    /// Sights from one on, side by side; slots beyond the end repeat the first one, with no weight.
    #[inline(always)]
    fn pack<T: Real>(&self, first: usize, end: usize) -> SightPack<T::Pack> {
        let at = |slot: usize| if first + slot < end { first + slot } else { first };
        let get = |f: fn(&Sight) -> f64| {
            T::gather(
                #[inline(always)]
                |slot| T::splat(f(&self.sights[at(slot)])),
            )
        };
        SightPack {
            star: [get(|s| s.star[0]), get(|s| s.star[1]), get(|s| s.star[2])],
            cos: get(|s| s.cos),
            sin: get(|s| s.sin),
            filled: T::gather(
                #[inline(always)]
                |slot| if first + slot < end { T::one() } else { T::zero() },
            ),
        }
    }

    /// Logarithm of the density of an epoch's angles at a nadir direction, but for a constant.
    ///
    /// What angles share, they share through one direction: the density is then that of the direction they give,
    /// linearised there and nowhere else. Linearised at the nadir in question, 72 arcsec away, stars close to the
    /// zenith would bend their 3 arcsec into knowledge that is not there.
    #[inline(always)]
    pub fn log_density<T: Real>(&self, epoch: usize, noise: &AngleNoise, nadir: &[T; 3]) -> T {
        if noise.shared == 0.0 {
            let mut sum = T::zero();
            for row in self.rows(epoch) {
                sum += noise.shape.log_density(self.left(row, nadir), noise.own);
            }
            return sum;
        }
        let Some(fitted) = self.direction(epoch, noise, &components(|i| nadir[i].lane(0))) else { return T::zero() };
        let axis = |k: usize| components(|i| T::splat(fitted.given.axes[k][i]));
        let axes = [axis(0), axis(1)];
        let off = |i: usize| T::splat(fitted.value[i]) - dot3(&axes[i], nadir);
        let (a, b) = (off(0), off(1));
        let [aa, ab, bb] = fitted.given.noise;
        let [aa, ab, bb] = inverse(aa, ab, bb);
        (a * a * aa + a * b * (2.0 * ab) + b * b * bb) * -0.5
    }

    /// The same of one angle alone.
    #[inline(always)]
    pub fn log_density_of<T: Real>(&self, row: usize, noise: &AngleNoise, nadir: &[T; 3]) -> T {
        let left = self.left(row, nadir);
        if noise.shared == 0.0 {
            noise.shape.log_density(left, noise.own)
        } else {
            left * left * (-0.5 / noise.variance())
        }
    }

    /// A measured angle less the one at a nadir direction.
    #[inline(always)]
    fn left<T: Real>(&self, row: usize, nadir: &[T; 3]) -> T {
        let sight = &self.sights[row];
        let one = SightPack::<T> {
            star: components(|i| T::splat(sight.star[i])),
            cos: T::splat(sight.cos),
            sin: T::splat(sight.sin),
            filled: T::one(),
        };
        one.left(nadir).0
    }

    /// The direction that an epoch's angles give near another one.
    #[inline(never)]
    fn direction(&self, epoch: usize, noise: &AngleNoise, near: &[f64; 3]) -> Option<Fitted<f64>> {
        let shared = noise.shared * noise.shared;
        let spread = crate::linalg::from_fn(|i, j| if i == j { shared } else { 0.0 });
        self.fit(epoch, noise, Robust::No, &Expected { nadir: *near, spread })
    }
}

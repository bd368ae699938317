//! Stars and their angles side by side, and how far each is to be trusted.

use super::noise::AngleNoise;
use super::normal::Expected;
use crate::quaternion::{cross, dot3};
use crate::scalar::{Mask, Real};

/// A star's direction and its measured angle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    pub(super) star: [f64; 3],
    pub(super) cos: f64,
    pub(super) sin: f64,
}

/// How angles that do not fit are treated; each is held against its own prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Robust {
    /// All are used.
    #[default]
    No,
    /// Those whose squared, normalised innovation is above the number are left out.
    Gate(f64),
    /// The variance of those whose normalised innovation is above the number grows in proportion to it
    /// (Huber, *Robust estimation of a location parameter*, 1964).
    Huber(f64),
}

/// Stars side by side.
pub(super) struct SightPack<P> {
    pub(super) star: [P; 3],
    pub(super) cos: P,
    pub(super) sin: P,
    pub(super) filled: P,
}

impl<P: Real> SightPack<P> {
    /// Measured angle less the one at a nadir direction, the sine of that, and the sine's reciprocal (not a number for a star
    /// at the nadir or the zenith).
    #[inline(always)]
    pub(super) fn left(&self, nadir: &[P; 3]) -> (P, P, P) {
        let across = cross(&self.star, nadir);
        let square = dot3(&across, &across);
        let sine = square.sqrt();
        let cosine = dot3(&self.star, nadir);
        let s = self.sin.mul_add(cosine, -(self.cos * sine));
        let c = self.cos.mul_add(cosine, self.sin * sine);
        // the division does not wait for the root
        (small_angle(s, c), sine, sine * square.recip())
    }

    /// How far each angle is trusted: from 0, not at all, to 1.
    #[inline(always)]
    pub(super) fn trust<T: Real<Pack = P>>(&self, robust: Robust, expected: &Expected<T>, noise: &AngleNoise) -> P {
        let one = P::one();
        let limit = match robust {
            Robust::No => return one,
            Robust::Gate(limit) | Robust::Huber(limit) => limit,
        };
        let down = expected.nadir;
        let down = [down[0].stack(), down[1].stack(), down[2].stack()];
        let (left, sine, _) = self.left(&down);
        let along = dot3(&self.star, &down);
        let inverse = P::select(sine.gt(P::splat(1e-9)), sine, one).recip();
        let mut gradient = [P::zero(); 3];
        for i in 0..3 {
            gradient[i] = (along * down[i] - self.star[i]) * inverse;
        }
        let mut variance = P::splat(noise.variance());
        for i in 0..3 {
            for j in 0..3 {
                variance = (gradient[i] * gradient[j]).mul_add(expected.spread[(i, j)].stack(), variance);
            }
        }
        let square = left * left * variance.recip();
        match robust {
            Robust::Gate(_) => P::select(square.gt(P::splat(limit)), P::zero(), one),
            _ => P::select(square.gt(P::splat(limit * limit)), square.sqrt().recip() * limit, one),
        }
    }
}

/// The angle of a sine and a cosine: a series while every lane is small.
#[inline(always)]
fn small_angle<T: Real>(sine: T, cosine: T) -> T {
    const ASIN: [f64; 5] = [35.0 / 1152.0, 5.0 / 112.0, 3.0 / 40.0, 1.0 / 6.0, 1.0];
    let square = sine * sine;
    let small = T::splat(1e-3).gt(square).and(cosine.gt(T::zero()));
    if small.all() {
        return sine * square.poly(ASIN);
    }
    T::from_lanes(
        #[inline(always)]
        |i| sine.lane(i).atan2(cosine.lane(i)),
    )
}

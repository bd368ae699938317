//! How much the air bends the light of a star that a satellite sees close to the Earth's limb.

use super::atmosphere::{Bending, Level, RADIUS};
use crate::linalg::{Matrix, Vector, from_fn, zeros};
use crate::manifold::{Euclidean, Family};
use crate::model::Measurement;
use crate::quaternion::dot3;
use crate::scalar::Real;
use std::sync::Arc;

/// The Earth's surface that heights of rays count from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid {
    /// Equatorial radius, m.
    pub radius: f64,
    /// Squared eccentricity over one less it; zero for a sphere.
    pub second_eccentricity2: f64,
    /// Unit vector to the north pole, inertial frame.
    pub pole: [f64; 3],
}

impl Ellipsoid {
    /// A sphere as large as the equator of WGS 84.
    pub const SPHERE: Self = Self { radius: RADIUS, second_eccentricity2: 0.0, pole: [0.0, 0.0, 1.0] };

    /// WGS 84, with its north pole along this unit vector of the inertial frame.
    #[must_use]
    pub fn wgs84(pole: [f64; 3]) -> Self {
        Self { radius: RADIUS, second_eccentricity2: 6.739_496_742_276_434e-3, pole }
    }
}

/// Refraction of a star's light by the atmosphere, rad: the angle between where the star is seen and where it is.
///
/// The satellite at `r` sees star `s` through the air below it. With `u = −r·s` and the distance of the straight line
/// from the Earth's centre `c = √(r² − u²)`, the ray's impact parameter is `b = c cos R + u sin R`, and the height `h` of
/// its lowest point follows from `b = n(h) (Re + h)` and `R = R(h)` (White, Thurman and Barnes, *Autonomous satellite
/// navigation using observations of starlight atmospheric refraction*, 1985). Over an ellipsoid the sphere is the one
/// that osculates it below the lowest point, in the direction of the ray.
#[derive(Clone, Debug)]
pub struct RefractionAngle {
    /// How much rays are bent.
    pub bending: Arc<Bending>,
    /// Surface that heights count from.
    pub earth: Ellipsoid,
}

/// What is known of a refraction beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefractionGiven<T> {
    /// Unit vector to the star, inertial frame, without refraction.
    pub star: [T; 3],
    /// Standard deviation of the angle's own error, rad.
    pub sigma: T,
    /// Standard deviation, rad, that the air's density adds: [`Ray::by_density`] times the density's relative one.
    pub density: T,
}

/// [`RefractionGiven`] over every scalar.
pub struct RefractionGivens;

impl Family for RefractionGivens {
    type Of<T: Real> = RefractionGiven<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &RefractionGiven<A>,
        b: &RefractionGiven<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> RefractionGiven<C> {
        let star = Euclidean::<3>::zip(&a.star, &b.star, &mut f);
        RefractionGiven { star, sigma: f(a.sigma, b.sigma), density: f(a.density, b.density) }
    }
}

/// A refracted ray from a star to the satellite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<T> {
    /// Refraction, rad; zero for a star that is not beyond the Earth.
    pub angle: T,
    /// Height of the lowest point, m.
    pub height: T,
    /// Derivative of the refraction to the satellite's position, rad/m.
    pub by_position: [T; 3],
    /// Derivative of the refraction to the logarithm of the density, rad: less than the refraction itself, since denser
    /// air shows a higher ray.
    pub by_density: T,
}

/// Straight line from the satellite to the star, as seen from the centre of the sphere that stands for the Earth.
struct Line<T> {
    /// Distance from the centre, m, and the satellite's distance beyond the point closest to it.
    distance: T,
    along: T,
    /// Unit vector from the centre to the closest point.
    foot: [T; 3],
    /// Radius of the sphere, m.
    radius: T,
}

/// Newton's method ends at a step, m, below this; so often at most.
const SMALL: f64 = 1e-5;
const ITERATIONS: usize = 40;
const LONGEST: f64 = 5e3;

impl RefractionAngle {
    /// Through the standard atmosphere.
    #[must_use]
    pub fn standard(earth: Ellipsoid) -> Self {
        Self { bending: Bending::standard(), earth }
    }

    /// The ray from a star (unit vector) to position `r`, m, through air of so many times its density.
    #[inline(always)]
    pub fn ray<T: Real>(&self, r: &[T; 3], star: &[T; 3], scale: T) -> Ray<T> {
        let line = self.line(r, star);
        // height, angle, and the angle's derivatives to distance, along and ln(scale)
        let mut solved = [[0.0; 5]; 8];
        for i in 0..T::LANES {
            let lane = [line.distance.lane(i), line.along.lane(i), line.radius.lane(i), scale.lane(i)];
            solved[i] = self.solve(lane);
        }
        let number = |k: usize| T::from_lanes(|i| solved[i][k]);
        let (by_distance, by_along) = (number(2), number(3));
        let by_position = [0, 1, 2].map(|i| by_distance * line.foot[i] - by_along * star[i]);
        Ray { angle: number(1), height: number(0), by_position, by_density: number(4) }
    }

    /// What is known of a star's refraction at a position, `[sigma, density]` being the 1-sigma of the angle's own error,
    /// rad, and the relative one of the density.
    #[inline(always)]
    pub fn given<T: Real>(&self, r: &[T; 3], star: &[T; 3], [sigma, density]: [f64; 2]) -> RefractionGiven<T> {
        let density = self.ray(r, star, T::one()).by_density * density;
        RefractionGiven { star: *star, sigma: T::splat(sigma), density }
    }

    /// The sphere that osculates the ellipsoid along the ray, and the line's place over it.
    ///
    /// The line touches an ellipsoid of the same shape where its normal is across the line; `1/M` and `1/N` with the
    /// azimuth there make `1/ρ = W/a (1 + e′² (s·k)²)` (Euler), with `W² = 1 − e² sin² φ`. Left out is that ellipsoid's
    /// distance from the one parallel to the ground: below 1 m of height.
    #[inline(always)]
    fn line<T: Real>(&self, r: &[T; 3], star: &[T; 3]) -> Line<T> {
        let e2 = self.earth.second_eccentricity2;
        let pole = self.earth.pole.map(T::splat);
        let (r_pole, star_pole) = (dot3(r, &pole), dot3(star, &pole));
        let stretch = (star_pole * star_pole).mul_add(T::splat(e2), T::one());
        let back = -(r_pole * star_pole).mul_add(T::splat(e2), dot3(r, star)) * stretch.recip();
        let touch = [0, 1, 2].map(|i| back.mul_add(star[i], r[i]));
        let lift = dot3(&touch, &pole) * e2;
        let up = [0, 1, 2].map(|i| lift.mul_add(pole[i], touch[i]));
        let shrink = dot3(&up, &up).sqrt().recip();
        let up = up.map(|c| c * shrink);
        let sine = dot3(&up, &pole);
        // first eccentricity, squared
        let first = e2 / (1.0 + e2);
        let w = (T::one() - sine * sine * first).sqrt();
        let prime = w.recip() * self.earth.radius;
        let radius = (w * stretch).recip() * self.earth.radius;
        let (out, down) = (radius - prime, prime * sine * first);
        // satellite from the sphere's centre
        let from = [0, 1, 2].map(|i| out.mul_add(up[i], down.mul_add(pole[i], r[i])));
        let along = -dot3(&from, star);
        let foot = [0, 1, 2].map(|i| along.mul_add(star[i], from[i]));
        let distance = dot3(&foot, &foot).sqrt();
        let inverse = distance.recip();
        Line { distance, along, foot: foot.map(|c| c * inverse), radius }
    }

    /// Newton's method for the height of the lowest point: one number a lane, since it looks things up.
    #[inline(never)]
    fn solve(&self, [distance, along, radius, scale]: [f64; 4]) -> [f64; 5] {
        if !(along > 0.0 && scale > 0.0) {
            let none = distance + along + scale;
            return if none.is_nan() { [none; 5] } else { [distance - radius, 0.0, 0.0, 0.0, 0.0] };
        }
        // bending goes with the root of the radius
        let bend = scale * (radius * (1.0 / RADIUS)).sqrt();
        let straight = distance - radius;
        let mut height = straight + self.guess(straight, along * bend);
        for _ in 0..ITERATIONS {
            let (miss, slope, _) = self.miss(height, [distance, along, radius], [bend, scale]);
            // the slope is positive and mostly close to constant: a long step would come from a jump in the air
            let step = (miss / slope).clamp(-LONGEST, LONGEST);
            height -= step;
            if step.abs() <= SMALL || step.is_nan() {
                break;
            }
        }
        let (_, slope, level) = self.miss(height, [distance, along, radius], [bend, scale]);
        let [angle, by_height] = level.angle.map(|a| a * bend);
        let (sine, cosine) = angle.sin_cos();
        let density = scale * level.refractivity[0] * (radius + height) + (distance * sine - along * cosine) * angle;
        [height, angle, by_height * cosine / slope, by_height * sine / slope, angle - by_height * density / slope]
    }

    /// By how much the ray's lowest point lies above the straight line, for a start: `y = u R(h₀ + y)` with an exponential
    /// `R` has Lambert's function for a solution.
    #[inline]
    fn guess(&self, straight: f64, along: f64) -> f64 {
        let [log, slope] = self.bending.log_angle(straight);
        let scale_height = (-slope).recip().clamp(4e3, 12e3);
        let one = log + (along / scale_height).ln();
        let lambert = if one < 1.0 {
            let ratio = one.exp();
            ratio / (1.0 + ratio * (1.0 - 0.21 * ratio.sqrt()))
        } else {
            let two = one.ln();
            one - two + two / one
        };
        scale_height * lambert
    }

    /// `n (Re + h) − c cos R − u sin R`, its derivative to the height `h`, and what it was made of.
    #[inline]
    fn miss(&self, height: f64, [distance, along, radius]: [f64; 3], [bend, scale]: [f64; 2]) -> (f64, f64, Level) {
        let level = self.bending.at(height);
        let [angle, by_height] = level.angle.map(|a| a * bend);
        let [n, n_slope] = level.refractivity.map(|n| n * scale);
        let (sine, cosine) = angle.sin_cos();
        // 1 − cos by the half angle: distance and radius nearly cancel
        let half = (0.5 * angle).sin();
        let miss = (height - (distance - radius)) + n * (radius + height) + 2.0 * distance * half * half - along * sine;
        let slope = 1.0 + n + n_slope * (radius + height) + (distance * sine - along * cosine) * by_height;
        (miss, slope, level)
    }
}

impl Measurement<6, 1> for RefractionAngle {
    type Space = Euclidean<6>;
    type Given = RefractionGivens;
    type Value = Euclidean<1>;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &[T; 6], given: &RefractionGiven<T>) -> [T; 1] {
        [self.ray(&[x[0], x[1], x[2]], &given.star, T::one()).angle]
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> Vector<T, 1> {
        [z[0] - zhat[0]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &RefractionGiven<T>) -> Matrix<T, 1, 1> {
        from_fn(|_, _| given.sigma.mul_add(given.sigma, given.density * given.density))
    }
    /// Without the few parts in a million by which the osculating sphere moves with the satellite.
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &[T; 6], given: &RefractionGiven<T>) -> Matrix<T, 1, 6> {
        let ray = self.ray(&[x[0], x[1], x[2]], &given.star, T::one());
        let mut h = zeros();
        for j in 0..3 {
            h[(0, j)] = ray.by_position[j];
        }
        h
    }
}

//! Pressure of sunlight on a sphere, with the Earth's conical shadow.

use super::EARTH_RADIUS;
use super::vector::{add3, cross, dot3, point_mass_gradient, scale, sub3};
use crate::linalg::{Matrix, from_fn};
use crate::scalar::{Mask, Real};
use std::f64::consts::PI;

/// One astronomical unit, m (IAU 2012).
const AU: f64 = 149_597_870_700.0;
/// Radius of the Sun, m (IAU 2015).
const SUN_RADIUS: f64 = 6.957e8;

/// Solar radiation pressure on a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolarPressure {
    /// Radiation pressure coefficient: 1 absorbs all, 2 reflects all.
    pub cr: f64,
    /// Cross section over mass, m²/kg.
    pub area_to_mass: f64,
    /// Pressure at one astronomical unit, N/m².
    pub pressure: f64,
}

impl SolarPressure {
    /// Acceleration, m/s² (Montenbruck and Gill 2000, eq. 3.75), and the light and its gradient.
    #[inline(always)]
    pub(super) fn acceleration<T: Real>(&self, sun: &[T; 3], r: &[T; 3]) -> [T; 3] {
        let e = sub3(r, sun);
        scale(&e, self.strength(&e) * light(sun, r))
    }

    /// Acceleration and its derivative to the position.
    #[inline(always)]
    pub(super) fn gradient<T: Real>(&self, sun: &[T; 3], r: &[T; 3]) -> ([T; 3], Matrix<T, 3, 3>) {
        let e = sub3(r, sun);
        let (strength, inverse) = (self.strength(&e), dot3(&e, &e).recip());
        let (nu, slope) = light_gradient(sun, r);
        let spread = point_mass_gradient(&e, -(strength * nu), inverse * 3.0);
        let g = from_fn(
            #[inline(always)]
            |i, j| e[i].mul_add(strength * slope[j], spread[(i, j)]),
        );
        (scale(&e, strength * nu), g)
    }

    /// Full acceleration over the distance, s⁻².
    #[inline(always)]
    fn strength<T: Real>(&self, e: &[T; 3]) -> T {
        let inverse = dot3(e, e).recip();
        inverse * inverse.sqrt() * (self.pressure * self.cr * self.area_to_mass * AU * AU)
    }
}

/// False where the satellite is surely in full sunlight: by day, or outside a cone about the shadow.
#[inline(always)]
fn may_be_dark<T: Real>(sun: &[T; 3], r: &[T; 3]) -> T::Mask {
    let along = dot3(r, sun) * dot3(sun, sun).sqrt().recip();
    let reach = along.mul_add(T::splat(-0.005), T::splat(EARTH_RADIUS));
    let inside = (reach * reach).gt(dot3(r, r) - along * along);
    inside.and(T::zero().gt(along))
}

#[inline(always)]
fn light<T: Real>(sun: &[T; 3], r: &[T; 3]) -> T {
    if !may_be_dark(sun, r).any() {
        return T::one();
    }
    T::from_lanes(|i| sunlight(&sun.map(|x| x.lane(i)), &r.map(|x| x.lane(i))).0)
}

#[inline(always)]
fn light_gradient<T: Real>(sun: &[T; 3], r: &[T; 3]) -> (T, [T; 3]) {
    if !may_be_dark(sun, r).any() {
        return (T::one(), [T::zero(); 3]);
    }
    let mut each = [(1.0, [0.0; 3]); 8];
    for i in 0..T::LANES {
        each[i] = sunlight(&sun.map(|x| x.lane(i)), &r.map(|x| x.lane(i)));
    }
    let slope = |j: usize| T::from_lanes(|i| each[i].1[j]);
    (T::from_lanes(|i| each[i].0), [slope(0), slope(1), slope(2)])
}

/// Share of the Sun's disc that is seen from `r`, and its derivative to `r`, 1/m.
///
/// Both discs are circles on the sky: the conical shadow of a spherical Earth without air (Montenbruck and
/// Gill 2000, section 3.4.2). The derivative follows from the lens between two circles: it grows by the
/// arcs with the radii and shrinks by the chord with the distance.
pub fn sunlight(sun: &[f64; 3], r: &[f64; 3]) -> (f64, [f64; 3]) {
    let to_sun = sub3(sun, r);
    let (distance, radius) = (dot3(&to_sun, &to_sun).sqrt(), dot3(r, r).sqrt());
    let (d, up) = (scale(&to_sun, 1.0 / distance), scale(r, 1.0 / radius));
    let normal = cross(&up, &d);
    let (cos, sin) = (dot3(&up, &d), dot3(&normal, &normal).sqrt());
    let a = (SUN_RADIUS / distance).asin();
    let b = (EARTH_RADIUS / radius).min(1.0).asin();
    let c = sin.atan2(-cos);
    if c >= a + b {
        return (1.0, [0.0; 3]);
    }
    if c <= b - a {
        return (0.0, [0.0; 3]);
    }
    let a_slope = scale(&d, SUN_RADIUS / (distance * distance * a.cos()));
    let b_slope = scale(&up, -EARTH_RADIUS / (radius * radius * b.cos()));
    let sun_area = PI * a * a;
    if c <= a - b {
        // the Earth before the Sun, whole: far beyond the Moon
        let slope = sub3(&scale(&a_slope, 2.0 * b * b / (a * a * a)), &scale(&b_slope, 2.0 * b / (a * a)));
        return (1.0 - b * b / (a * a), slope);
    }
    let x = (c * c + a * a - b * b) / (2.0 * c);
    let half_chord = (a * a - x * x).max(0.0).sqrt();
    let sun_arc = half_chord.atan2(x);
    let earth_arc = half_chord.atan2(c - x);
    let lens = a * a * sun_arc + b * b * earth_arc - c * half_chord;
    let toward = scale(&sub3(&d, &scale(&up, cos)), 1.0 / (radius * sin));
    let away = scale(&sub3(&up, &scale(&d, cos)), 1.0 / (distance * sin));
    let c_slope = sub3(&toward, &away);
    let da = (2.0 * lens / a - 2.0 * a * sun_arc) / sun_area;
    let slope = add3(
        &scale(&a_slope, da),
        &add3(&scale(&b_slope, -2.0 * b * earth_arc / sun_area), &scale(&c_slope, 2.0 * half_chord / sun_area)),
    );
    (1.0 - lens / sun_area, slope)
}

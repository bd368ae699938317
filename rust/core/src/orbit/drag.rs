//! Air drag with the Harris-Priester atmosphere.

use super::environment::Moment;
use super::vector::{dot3, rotate, scale, sub3};
use crate::linalg::{Matrix, from_fn, zeros};
use crate::scalar::Real;
use std::sync::LazyLock;

/// Air drag on a sphere in the Harris-Priester atmosphere that turns with the Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drag {
    /// Drag coefficient.
    pub cd: f64,
    /// Cross section over mass, m²/kg.
    pub area_to_mass: f64,
    /// How far the densest air lags the Sun, rad.
    pub lag: f64,
    /// Exponent of the cosine of half the angle to the densest air: 2 at low inclination to 6 at the poles.
    pub exponent: f64,
}

/// Rotation rate of the Earth, rad/s.
const EARTH_RATE: f64 = 7.292_115_146_706_979e-5;
/// WGS 84: equatorial radius, m, and squared eccentricity.
const RADIUS: f64 = 6_378_137.0;
const ECCENTRICITY2: f64 = 6.694_379_990_141_317e-3;

/// Heights, km, with the least and the greatest density, g/km³, at mean solar flux (Harris and Priester 1962 as
/// revised in Long et al. 1989; Montenbruck and Gill 2000, table 3.1).
const TABLE: [[f64; 3]; 50] = [
    [100.0, 497_400.0, 497_400.0],
    [120.0, 24_900.0, 24_900.0],
    [130.0, 8377.0, 8710.0],
    [140.0, 3899.0, 4059.0],
    [150.0, 2122.0, 2215.0],
    [160.0, 1263.0, 1344.0],
    [170.0, 800.8, 875.8],
    [180.0, 528.3, 601.0],
    [190.0, 361.7, 429.7],
    [200.0, 255.7, 316.2],
    [210.0, 183.9, 239.6],
    [220.0, 134.1, 185.3],
    [230.0, 99.49, 145.5],
    [240.0, 74.88, 115.7],
    [250.0, 57.09, 93.08],
    [260.0, 44.03, 75.55],
    [270.0, 34.3, 61.82],
    [280.0, 26.97, 50.95],
    [290.0, 21.39, 42.26],
    [300.0, 17.08, 35.26],
    [320.0, 10.99, 25.11],
    [340.0, 7.214, 18.19],
    [360.0, 4.824, 13.37],
    [380.0, 3.274, 9.955],
    [400.0, 2.249, 7.492],
    [420.0, 1.558, 5.684],
    [440.0, 1.091, 4.355],
    [460.0, 0.7701, 3.362],
    [480.0, 0.5474, 2.612],
    [500.0, 0.3916, 2.042],
    [520.0, 0.2819, 1.605],
    [540.0, 0.2042, 1.267],
    [560.0, 0.1488, 1.005],
    [580.0, 0.1092, 0.7997],
    [600.0, 0.0807, 0.639],
    [620.0, 0.06012, 0.5123],
    [640.0, 0.04519, 0.4121],
    [660.0, 0.0343, 0.3325],
    [680.0, 0.02632, 0.2691],
    [700.0, 0.02043, 0.2185],
    [720.0, 0.01607, 0.1779],
    [740.0, 0.01281, 0.1452],
    [760.0, 0.01036, 0.119],
    [780.0, 0.008496, 0.09776],
    [800.0, 0.007069, 0.08059],
    [840.0, 0.00468, 0.05741],
    [880.0, 0.0032, 0.0421],
    [920.0, 0.00221, 0.0313],
    [960.0, 0.00156, 0.0236],
    [1000.0, 0.00115, 0.0181],
];

/// A layer: its lower height, m; ln of least and greatest density there, kg/m³; and their slopes, 1/m.
type Layer = [f64; 5];

static LAYERS: LazyLock<[Layer; 49]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let ([h, low, high], [h1, low1, high1]) = (TABLE[i], TABLE[i + 1]);
        let depth = (h1 - h) * 1e3;
        let ln = |rho: f64| (rho * 1e-12).ln();
        [h * 1e3, ln(low), ln(high), (low1 / low).ln() / depth, (high1 / high).ln() / depth]
    })
});

/// Least and greatest density at a height, kg/m³, and their derivatives to the height.
///
/// Exponential between the rows of the table and below its 100 km; none above its 1000 km.
#[inline(always)]
pub fn harris_priester(height: f64) -> [f64; 4] {
    let km = height * 1e-3;
    if km.is_nan() || km >= 1000.0 {
        return [if km.is_nan() { km } else { 0.0 }; 4];
    }
    let layer = if km < 120.0 {
        0.0
    } else if km < 300.0 {
        1.0 + (km - 120.0) * 0.1
    } else if km < 800.0 {
        19.0 + (km - 300.0) * 0.05
    } else {
        44.0 + (km - 800.0) * 0.025
    };
    let [h, low, high, low_slope, high_slope] = LAYERS[(layer as usize).min(48)];
    let (low, high) = ((height - h).mul_add(low_slope, low).exp(), (height - h).mul_add(high_slope, high).exp());
    [low, high, low * low_slope, high * high_slope]
}

/// What the density depends on.
struct Air<T: Real> {
    density: T,
    /// Derivative of the density to the position, GCRS.
    slope: [T; 3],
    /// Velocity against the air, GCRS.
    wind: [T; 3],
}

impl Drag {
    /// Acceleration, m/s² (Montenbruck and Gill 2000, eq. 3.97).
    #[inline(always)]
    pub(super) fn acceleration<T: Real>(&self, at: &Moment<T>, r: &[T; 3], v: &[T; 3]) -> [T; 3] {
        let air = self.air(at, r, v);
        let speed = dot3(&air.wind, &air.wind).sqrt();
        scale(&air.wind, air.density * speed * self.factor())
    }

    /// Acceleration and its derivatives to position and velocity.
    #[inline(always)]
    pub(super) fn gradient<T: Real>(
        &self,
        at: &Moment<T>,
        r: &[T; 3],
        v: &[T; 3],
    ) -> ([T; 3], Matrix<T, 3, 3>, Matrix<T, 3, 3>) {
        let air = self.air(at, r, v);
        let w = &air.wind;
        let speed = dot3(w, w).sqrt();
        let k = speed * self.factor();
        let stretch = air.density * self.factor() * speed.recip();
        let by_velocity: Matrix<T, 3, 3> = from_fn(
            #[inline(always)]
            |i, j| {
                let outer = w[i] * w[j] * stretch;
                if i == j { k.mul_add(air.density, outer) } else { outer }
            },
        );
        // the air moves with −ω × r
        let mut turn: Matrix<T, 3, 3> = zeros();
        let a = scale(&at.axis, T::splat(-EARTH_RATE));
        (turn[(0, 1)], turn[(0, 2)], turn[(1, 2)]) = (-a[2], a[1], -a[0]);
        (turn[(1, 0)], turn[(2, 0)], turn[(2, 1)]) = (a[2], -a[1], a[0]);
        let moved = crate::linalg::mul(&by_velocity, &turn);
        let by_position = from_fn(
            #[inline(always)]
            |i, j| (w[i] * k).mul_add(air.slope[j], moved[(i, j)]),
        );
        (scale(w, air.density * k), by_position, by_velocity)
    }

    #[inline(always)]
    fn factor(&self) -> f64 {
        -0.5 * self.cd * self.area_to_mass
    }

    #[inline(always)]
    fn air<T: Real>(&self, at: &Moment<T>, r: &[T; 3], v: &[T; 3]) -> Air<T> {
        let mut each = [[0.0; 4]; 8];
        for i in 0..T::LANES {
            each[i] = self.density(&at.lane(i), &r.map(|x| x.lane(i)));
        }
        let column = |j: usize| T::from_lanes(|i| each[i][j]);
        let slope = [column(1), column(2), column(3)];
        Air { density: column(0), slope, wind: sub3(v, &scale(&at.spin(r), T::splat(EARTH_RATE))) }
    }

    /// Density, and its derivative to the position. Its exponentials gain nothing from wide instructions: one
    /// copy in the machine code is enough.
    #[inline(never)]
    fn density(&self, at: &Moment<f64>, r: &[f64; 3]) -> [f64; 4] {
        let (height, up) = geodetic(&rotate(&at.to_earth, r));
        let up = at.inertial(&up);
        let [low, high, low_slope, high_slope] = harris_priester(height);
        let radius = 1.0 / dot3(r, r).sqrt();
        let along = scale(r, radius);
        let sun = scale(&at.sun, 1.0 / dot3(&at.sun, &at.sun).sqrt());
        let apex = at.turned(&sun, self.lag.sin(), self.lag.cos());
        let cos = dot3(&along, &apex);
        let (power, power_slope) = self.power((cos + 1.0) * 0.5);
        let by_height = low_slope + (high_slope - low_slope) * power;
        let by_angle = (high - low) * power_slope * radius * 0.5;
        let slope = |i: usize| by_height * up[i] + by_angle * (apex[i] - cos * along[i]);
        [low + (high - low) * power, slope(0), slope(1), slope(2)]
    }

    /// `share^(n/2)` and its derivative.
    #[inline(always)]
    fn power(&self, share: f64) -> (f64, f64) {
        let half = self.exponent * 0.5;
        let below = if half == 3.0 {
            share * share
        } else if half == 2.0 {
            share
        } else {
            share.max(0.0).powf(half - 1.0)
        };
        (below * share, below * half)
    }
}

/// Height above the WGS 84 ellipsoid, m, and the direction up (Bowring 1985, one step: below 1 µm up to 2000 km).
#[inline(always)]
fn geodetic<T: Real>(r: &[T; 3]) -> (T, [T; 3]) {
    let flat = (1.0 - ECCENTRICITY2).sqrt();
    let p2 = r[0].mul_add(r[0], r[1] * r[1]);
    let p = p2.sqrt();
    // reduced latitude by the parallax of the ellipse, times its common length
    let radius = r[2].mul_add(r[2], p2).sqrt();
    let correction = radius.recip() * (ECCENTRICITY2 * RADIUS / flat);
    let tangent = r[2] * flat * (correction + T::one());
    let length = tangent.mul_add(tangent, p2).sqrt().recip();
    let (sin, cos) = (tangent * length, p * length);
    let polar = (sin * sin * sin).mul_add(T::splat(ECCENTRICITY2 / (1.0 - ECCENTRICITY2) * RADIUS * flat), r[2]);
    // the equatorial part over p, so that the poles need no care
    let shrink = T::one() - cos * cos * length * (ECCENTRICITY2 * RADIUS);
    let equatorial = shrink * p;
    let unit = polar.mul_add(polar, equatorial * equatorial).sqrt().recip();
    let (sin, cos) = (polar * unit, equatorial * unit);
    let ground = (T::one() - sin * sin * ECCENTRICITY2).sqrt() * RADIUS;
    (p * cos + r[2] * sin - ground, [r[0] * shrink * unit, r[1] * shrink * unit, sin])
}

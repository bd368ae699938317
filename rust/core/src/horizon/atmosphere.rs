//! Air density over height, and how much it bends a ray that grazes the Earth.

use crate::error::{Error, Result};
use std::sync::{Arc, OnceLock};

/// Refractivity `n − 1` of air of density 1 kg/m³, in visible light.
pub const REFRACTIVITY: f64 = 2.26e-4;
/// Radius, m, of the sphere that rays are traced over.
pub(super) const RADIUS: f64 = 6_378_137.0;

/// US Standard Atmosphere 1976: the radius that geopotential heights are defined with, m; molar mass times standard gravity
/// over the gas constant, K/m; gas constant over molar mass, J/(kg K).
const GEOPOTENTIAL: f64 = 6_356_766.0;
const HYDROSTATIC: f64 = 9.80665 * 28.9644 / 8314.32;
const GAS: f64 = 8314.32 / 28.9644;
/// Lower geopotential height of a layer, m, and its temperature gradient, K/m (US Standard Atmosphere 1976, table 4).
const LAYERS: [[f64; 2]; 7] =
    [[0.0, -6.5e-3], [11e3, 0.0], [20e3, 1e-3], [32e3, 2.8e-3], [47e3, 0.0], [51e3, -2.8e-3], [71e3, -2e-3]];
/// Where the standard's table of layers ends, m; from there on the density falls as an exponential.
const TOP: f64 = 86e3;
/// Rays are traced up to here, m.
const SPACE: f64 = 200e3;

/// Density of the air over height above the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct Atmosphere {
    /// Heights where the density's derivative may jump, m.
    knots: Vec<f64>,
    profile: Profile,
}

#[derive(Clone, Debug, PartialEq)]
enum Profile {
    /// Temperature and logarithm of the pressure at the foot of each layer.
    Standard([[f64; 2]; 7]),
    /// Logarithm of the density at the knots and its slopes.
    Table(Vec<[f64; 2]>),
}

impl Atmosphere {
    /// US Standard Atmosphere 1976 up to 86 km (sections 1.2 and 1.3, eqs 23, 33 and 42), a smooth exponential above.
    #[must_use]
    pub fn standard() -> Self {
        let mut feet = [[288.15, 101_325f64.ln()]; 7];
        for i in 1..7 {
            let ([from, lapse], [to, _]) = (LAYERS[i - 1], LAYERS[i]);
            let [t, p] = feet[i - 1];
            feet[i] = [t + lapse * (to - from), p + pressure(t, lapse, to - from)];
        }
        let geometric = |h: f64| GEOPOTENTIAL * h / (GEOPOTENTIAL - h);
        let mut knots: Vec<f64> = LAYERS[1..].iter().map(|l| geometric(l[0])).collect();
        knots.push(TOP);
        Self { knots, profile: Profile::Standard(feet) }
    }

    /// A smooth curve (cubic spline of the logarithm) through densities, kg/m³, at heights, m; exponential beyond
    /// both ends.
    ///
    /// # Errors
    /// `Length`; `Parameter` for fewer than three rows, heights that do not increase or are not within −5 to 150 km, and
    /// densities that do not fall with height or do not lie within 0 to 2 kg/m³.
    pub fn table(height: &[f64], density: &[f64]) -> Result<Self> {
        if density.len() != height.len() {
            return Err(Error::Length { field: "density", expected: height.len(), found: density.len() });
        }
        if height.len() < 3 {
            let need = "at least three heights are needed";
            return Err(Error::Parameter { field: "height", value: height.len() as f64, need });
        }
        for (i, (h, rho)) in height.iter().zip(density).enumerate() {
            if !(-5e3..=150e3).contains(h) || i > 0 && *h <= height[i - 1] {
                let need = "heights must increase, in metres from -5e3 to 150e3";
                return Err(Error::Parameter { field: "height", value: *h, need });
            }
            if !(*rho > 0.0 && *rho <= 2.0) || i > 0 && *rho >= density[i - 1] {
                let need = "densities must fall with the height, from at most 2 kg/m3, and stay positive";
                return Err(Error::Parameter { field: "density", value: *rho, need });
            }
        }
        let log: Vec<f64> = density.iter().map(|rho| rho.ln()).collect();
        let slopes = spline(height, &log);
        let rows = log.iter().zip(slopes).map(|(y, m)| [*y, m]).collect();
        Ok(Self { knots: height.to_vec(), profile: Profile::Table(rows) })
    }

    /// Logarithm of the density, kg/m³, at a height, m, and its derivative.
    fn log_density(&self, height: f64) -> [f64; 2] {
        match &self.profile {
            Profile::Standard(feet) => {
                let beyond = (height - TOP).max(0.0);
                let [log, slope] = standard(feet, height - beyond);
                [slope.mul_add(beyond, log), slope]
            }
            Profile::Table(rows) => {
                let last = self.knots.len() - 1;
                let inside = height.clamp(self.knots[0], self.knots[last]);
                let i = self.knots.partition_point(|h| *h <= inside).clamp(1, last) - 1;
                let width = self.knots[i + 1] - self.knots[i];
                let [log, slope] = hermite(rows[i], rows[i + 1], (inside - self.knots[i]) / width, width);
                [slope.mul_add(height - inside, log), slope]
            }
        }
    }

    /// Density, kg/m³, at a height, m.
    #[must_use]
    pub fn density(&self, height: f64) -> f64 {
        self.log_density(height)[0].exp()
    }

    /// Refractivity `n − 1` at a height, m, and its derivative.
    fn refractivity(&self, height: f64) -> [f64; 2] {
        let [log, slope] = self.log_density(height);
        let n = REFRACTIVITY * log.exp();
        [n, n * slope]
    }

    /// Angle, rad, by which the air bends a ray that comes from outside, is at its lowest at this height, m, and leaves again:
    /// `2 ∫ b (−n′/n) / √(n² r² − b²) dr` from the lowest point on, with `b = n r` there (Bouguer's rule).
    #[must_use]
    pub fn bending(&self, height: f64, radius: f64) -> f64 {
        let lowest = radius + height;
        let n0 = self.refractivity(height)[0];
        let b = (1.0 + n0) * lowest;
        // over w = √(r − r_lowest) the integrand is smooth: n r − b goes like w²
        let integrand = |w: f64| {
            let rise = w * w;
            let [n, slope] = self.refractivity(height + rise);
            let above = rise.mul_add(1.0 + n, (n - n0) * lowest);
            let below = (1.0 + n) * (lowest + rise) + b;
            -2.0 * slope / (1.0 + n) * b * w / (above * below).sqrt()
        };
        let knots = self.knots.iter().copied().filter(|h| *h > height && *h < SPACE);
        let mut from = 0.0;
        let mut sum = 0.0;
        for knot in knots.chain([SPACE.max(height + 50e3)]) {
            let to = (knot - height).sqrt();
            let panels = ((to - from) / PANEL).ceil().max(1.0);
            let width = (to - from) / panels;
            for k in 0..panels as usize {
                sum += gauss(&integrand, width.mul_add(k as f64, from), width);
            }
            from = to;
        }
        2.0 * sum
    }
}

/// Width, √m, of a panel of the integral: ten points in it are enough for nine digits.
const PANEL: f64 = 60.0;

/// Logarithm of a pressure over that at the foot of a layer.
fn pressure(foot: f64, lapse: f64, rise: f64) -> f64 {
    if lapse == 0.0 { -HYDROSTATIC * rise / foot } else { -HYDROSTATIC / lapse * (lapse * rise / foot).ln_1p() }
}

/// Logarithm of the standard's density at a height, m, and its derivative.
fn standard(feet: &[[f64; 2]; 7], height: f64) -> [f64; 2] {
    let stretch = GEOPOTENTIAL / (GEOPOTENTIAL + height);
    let geopotential = height * stretch;
    let i = LAYERS.partition_point(|l| l[0] <= geopotential).max(1) - 1;
    let ([from, lapse], [foot, log]) = (LAYERS[i], feet[i]);
    let rise = geopotential - from;
    let temperature = foot + lapse * rise;
    let slope = -(HYDROSTATIC + lapse) / temperature * stretch * stretch;
    [log + pressure(foot, lapse, rise) - (GAS * temperature).ln(), slope]
}

/// Gauss and Legendre's rule with ten points.
fn gauss(f: &impl Fn(f64) -> f64, from: f64, width: f64) -> f64 {
    const RULE: [[f64; 2]; 5] = [
        [0.148_874_338_981_631_22, 0.295_524_224_714_752_87],
        [0.433_395_394_129_247_2, 0.269_266_719_309_996_35],
        [0.679_409_568_299_024_4, 0.219_086_362_515_982_04],
        [0.865_063_366_688_984_5, 0.149_451_349_150_580_6],
        [0.973_906_528_517_171_7, 0.066_671_344_308_688_14],
    ];
    let (half, middle) = (0.5 * width, from + 0.5 * width);
    half * RULE.iter().map(|[x, weight]| weight * (f(middle - half * x) + f(middle + half * x))).sum::<f64>()
}

/// Slopes at the knots of the natural cubic spline.
fn spline(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    let rise = |i: usize| (y[i + 1] - y[i]) / (x[i + 1] - x[i]);
    let width = |i: usize| x[i + 1] - x[i];
    // (lower, diagonal, upper, right side) of each row
    let row = |i: usize| match i {
        0 => (0.0, 2.0, 1.0, 3.0 * rise(0)),
        i if i == n - 1 => (1.0, 2.0, 0.0, 3.0 * rise(n - 2)),
        i => {
            let (before, after) = (width(i - 1), width(i));
            (after, 2.0 * (before + after), before, 3.0 * (after * rise(i - 1) + before * rise(i)))
        }
    };
    let (mut upper, mut slopes) = (vec![0.0; n], vec![0.0; n]);
    for i in 0..n {
        let (low, diagonal, up, right) = row(i);
        let (u, s) = if i == 0 { (0.0, 0.0) } else { (upper[i - 1], slopes[i - 1]) };
        let pivot = diagonal - low * u;
        (upper[i], slopes[i]) = (up / pivot, (right - low * s) / pivot);
    }
    for i in (0..n - 1).rev() {
        slopes[i] -= upper[i] * slopes[i + 1];
    }
    slopes
}

/// Values that fall: just below 11 km the standard's air bends a lower ray less, so that light takes several ways; the
/// table goes straight through.
fn falling(mut y: Vec<f64>) -> Vec<f64> {
    for i in 1..y.len() - 2 {
        if y[i + 1] >= y[i] {
            let (from, third) = (y[i - 1], (y[i + 2] - y[i - 1]) / 3.0);
            (y[i], y[i + 1]) = (from + third, from + 2.0 * third);
        }
    }
    y
}

/// Slopes limited so that the curve falls everywhere (Hyman 1983, with 2.5 for his 3): the standard's jumps would make a
/// spline swing.
fn monotone(y: &[f64], mut slopes: Vec<f64>) -> Vec<f64> {
    for (i, slope) in slopes.iter_mut().enumerate() {
        let before = if i > 0 { y[i] - y[i - 1] } else { f64::NEG_INFINITY };
        let after = if i + 1 < y.len() { y[i + 1] - y[i] } else { f64::NEG_INFINITY };
        *slope = slope.clamp((2.5 * before.max(after) / STEP).min(0.0), 0.0);
    }
    slopes
}

/// Value and derivative at `s` from 0 to 1 of the cubic through two values and slopes.
#[inline(always)]
fn hermite([y0, m0]: [f64; 2], [y1, m1]: [f64; 2], s: f64, width: f64) -> [f64; 2] {
    let (rise, m0, m1) = (y1 - y0, m0 * width, m1 * width);
    let (c2, c3) = (3.0 * rise - 2.0 * m0 - m1, m0 + m1 - 2.0 * rise);
    [((c3 * s + c2) * s + m0) * s + y0, ((3.0 * c3 * s + 2.0 * c2) * s + m0) / width]
}

/// Ray-traced bending over the height of a ray's lowest point, for quick use: the integral to 3e-5, and to 1e-3 within
/// half a kilometre of heights where the standard's temperature gradient jumps (1e-2 at 11 km).
#[derive(Clone, Debug)]
pub struct Bending {
    atmosphere: Atmosphere,
    /// Logarithms of bending and refractivity at equally spaced heights from 0 on, with slopes.
    rows: Vec<[[f64; 2]; 2]>,
}

/// What a ray's lowest point says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Bending, rad, and its derivative to the height.
    pub angle: [f64; 2],
    /// Refractivity `n − 1` and its derivative to the height.
    pub refractivity: [f64; 2],
}

/// Spacing and number of the rows: 0 to 120 km.
const STEP: f64 = 200.0;
const ROWS: usize = 601;

impl Bending {
    /// Traces rays through an atmosphere over a sphere of the equator's radius.
    #[must_use]
    pub fn new(atmosphere: Atmosphere) -> Self {
        let height: Vec<f64> = (0..ROWS).map(|i| i as f64 * STEP).collect();
        let log = falling(height.iter().map(|h| atmosphere.bending(*h, RADIUS).ln()).collect());
        let slopes = monotone(&log, spline(&height, &log));
        let air = |h: f64| {
            let [log, slope] = atmosphere.log_density(h);
            [log + REFRACTIVITY.ln(), slope]
        };
        let rows = (0..ROWS).map(|i| [[log[i], slopes[i]], air(height[i])]).collect();
        Self { atmosphere, rows }
    }

    /// That of the standard atmosphere, traced once.
    pub fn standard() -> Arc<Self> {
        static STANDARD: OnceLock<Arc<Bending>> = OnceLock::new();
        STANDARD.get_or_init(|| Arc::new(Self::new(Atmosphere::standard()))).clone()
    }

    /// The atmosphere that was traced.
    #[must_use]
    pub fn atmosphere(&self) -> &Atmosphere {
        &self.atmosphere
    }

    /// Bending and refractivity at a height, m. Above 120 km exponentials; below the ground, where only an estimate that is far
    /// off looks, an exponential for the bending and a straight line for the refractivity.
    #[inline]
    #[must_use]
    pub fn at(&self, height: f64) -> Level {
        let inside = height.clamp(0.0, (ROWS - 1) as f64 * STEP);
        let row = inside * (1.0 / STEP);
        let i = (row as usize).min(ROWS - 2);
        let (low, high) = (&self.rows[i], &self.rows[i + 1]);
        let beyond = height - inside;
        let log = |k: usize| hermite(low[k], high[k], row - i as f64, STEP);
        let ([bent, bent_slope], [air, air_slope]) = (log(0), log(1));
        let angle = bent_slope.mul_add(beyond, bent).exp();
        let n = air_slope.mul_add(beyond.max(0.0), air).exp();
        let slope = n * air_slope;
        Level { angle: [angle, angle * bent_slope], refractivity: [slope.mul_add(beyond.min(0.0), n), slope] }
    }

    /// Logarithm of the bending, rad, at a height, m, and its derivative: finite for any height.
    #[inline]
    pub(super) fn log_angle(&self, height: f64) -> [f64; 2] {
        let inside = height.clamp(0.0, (ROWS - 1) as f64 * STEP);
        let row = inside * (1.0 / STEP);
        let i = (row as usize).min(ROWS - 2);
        let [log, slope] = hermite(self.rows[i][0], self.rows[i + 1][0], row - i as f64, STEP);
        [slope.mul_add(height - inside, log), slope]
    }

    /// Height, m, that bends a ray by an angle, rad.
    #[must_use]
    pub fn height(&self, angle: f64) -> f64 {
        let log = angle.ln();
        let i = self.rows.partition_point(|row| row[0][0] > log).clamp(1, ROWS - 1) - 1;
        let [y, slope] = self.rows[i][0];
        let mut height = (log - y).mul_add(slope.recip(), i as f64 * STEP);
        for _ in 0..4 {
            let [at, by_height] = self.at(height).angle;
            height += (log - at.ln()) * at / by_height;
        }
        height
    }
}

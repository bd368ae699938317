//! What changes with time alone: the Earth's rotation, the Sun and the Moon, from tables of a run.

use super::vector::{rotate_back, scale};
use crate::error::{Error, Result};
use crate::scalar::Real;
use std::f64::consts::TAU;

/// Tables of a run; times are seconds since its epoch.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'a> {
    /// Uniform times of the Earth's tables, s.
    pub earth_t: &'a [f64],
    /// Celestial intermediate pole X, Y and origin locator s, rad.
    pub cip: &'a [[f64; 3]],
    /// Polar motion, rad.
    pub pole: &'a [[f64; 2]],
    /// Terrestrial origin locator s', rad.
    pub sp: &'a [f64],
    /// UT1 at time 0 as a Julian date in two parts.
    pub ut1: [f64; 2],
    /// (UT1 − TT) less its value at time 0, s.
    pub dut1: &'a [f64],
    /// Uniform times of the bodies' tables, s.
    pub body_t: &'a [f64],
    /// Geocentric Sun, GCRS, m.
    pub sun: &'a [[f64; 3]],
    /// Geocentric Moon, GCRS, m.
    pub moon: &'a [[f64; 3]],
}

/// Interpolates in the tables of a run.
#[derive(Clone, Debug)]
pub struct Environment {
    earth: Uniform,
    bodies: Uniform,
    /// X, Y, spin less ERA (s' − s + the drift of UT1), xp, yp.
    orientation: Vec<[f64; 5]>,
    positions: Vec<[f64; 6]>,
    /// Earth rotation angle at time 0, rad.
    era: f64,
}

/// Everything that the forces need of one moment.
#[derive(Clone, Copy, Debug)]
pub struct Moment<T> {
    /// Rows of the matrix GCRS to ITRS.
    pub to_earth: [[T; 3]; 3],
    /// Axis of rotation, GCRS.
    pub axis: [T; 3],
    /// Geocentric Sun, GCRS, m.
    pub sun: [T; 3],
    /// Geocentric Moon, GCRS, m.
    pub moon: [T; 3],
}

/// rad of Earth rotation per s of UT1 (IAU 2000, Capitaine et al. 2000).
const ERA_RATE: f64 = TAU * 1.002_737_811_911_354_5 / 86_400.0;

#[derive(Clone, Copy, Debug)]
struct Uniform {
    start: f64,
    step: f64,
    n: usize,
}

impl Uniform {
    fn new(field: &'static str, t: &[f64]) -> Result<Self> {
        if t.len() < 4 {
            return Err(Error::Length { field, expected: 4, found: t.len() });
        }
        let (start, end) = (t[0], t[t.len() - 1]);
        let step = (end - start) / (t.len() - 1) as f64;
        let even = |(k, x): (usize, &f64)| (x - (start + k as f64 * step)).abs() <= 1e-6 * step;
        if !(step > 0.0 && step.is_finite() && t.iter().enumerate().all(even)) {
            return Err(Error::Parameter { field, value: step, need: "the times of a table must be evenly spaced" });
        }
        Ok(Self { start, step, n: t.len() })
    }

    fn contains(&self, t: f64) -> bool {
        t >= self.start && t <= self.start + self.step * (self.n - 1) as f64
    }

    /// First of four rows about `t` and their weights (cubic Lagrange); NaN outside the table.
    #[inline(always)]
    fn weights(&self, t: f64) -> (usize, [f64; 4]) {
        let x = (t - self.start) / self.step;
        if !(x >= 0.0 && x <= (self.n - 1) as f64) {
            return (0, [f64::NAN; 4]);
        }
        let k = (x as usize).clamp(1, self.n - 3) - 1;
        let u = x - k as f64;
        let [a, b, c, d] = [u, u - 1.0, u - 2.0, u - 3.0];
        (k, [b * c * d / -6.0, a * c * d * 0.5, a * b * d * -0.5, a * b * c / 6.0])
    }
}

#[inline(always)]
fn interpolate<const K: usize>(rows: &[[f64; K]], grid: &Uniform, t: f64) -> [f64; K] {
    let (k, w) = grid.weights(t);
    let mut out = [0.0; K];
    if let Some(four) = rows.get(k..k + 4) {
        for j in 0..K {
            out[j] = (w[0] * four[0][j] + w[3] * four[3][j]) + (w[1] * four[1][j] + w[2] * four[2][j]);
        }
    }
    out
}

impl Environment {
    /// # Errors
    /// `Length` or `Parameter` where the tables do not fit each other or hold what is not finite.
    pub fn new(tables: &Tables<'_>) -> Result<Self> {
        let earth = Uniform::new("environment.earth_t", tables.earth_t)?;
        let bodies = Uniform::new("environment.body_t", tables.body_t)?;
        for (field, found, expected) in [
            ("environment.cip", tables.cip.len(), earth.n),
            ("environment.pole", tables.pole.len(), earth.n),
            ("environment.sp", tables.sp.len(), earth.n),
            ("environment.dut1", tables.dut1.len(), earth.n),
            ("environment.sun", tables.sun.len(), bodies.n),
            ("environment.moon", tables.moon.len(), bodies.n),
        ] {
            if found != expected {
                return Err(Error::Length { field, expected, found });
            }
        }
        let orientation: Vec<_> = (0..earth.n)
            .map(|k| {
                let [x, y, s] = tables.cip[k];
                let [xp, yp] = tables.pole[k];
                [x, y, tables.sp[k] - s + ERA_RATE * tables.dut1[k], xp, yp]
            })
            .collect();
        let positions: Vec<[f64; 6]> = (0..bodies.n)
            .map(|k| std::array::from_fn(|j| if j < 3 { tables.sun[k][j] } else { tables.moon[k][j - 3] }))
            .collect();
        let numbers = orientation.as_flattened().iter().chain(positions.as_flattened()).chain(&tables.ut1);
        if let Some(bad) = numbers.copied().find(|x| !x.is_finite()) {
            return Err(Error::Parameter { field: "environment", value: bad, need: "every number must be finite" });
        }
        Ok(Self { earth, bodies, orientation, positions, era: rotation_angle(tables.ut1) })
    }

    /// Whether the tables reach `t`.
    pub fn covers(&self, t: f64) -> bool {
        self.earth.contains(t) && self.bodies.contains(t)
    }

    /// Everything of one moment; not a number outside the tables. It gains nothing from wide instructions:
    /// one copy in the machine code is enough.
    #[inline(never)]
    pub fn at(&self, t: f64) -> Moment<f64> {
        let [x, y, spin, xp, yp] = interpolate(&self.orientation, &self.earth, t);
        let p = interpolate(&self.positions, &self.bodies, t);
        let (sin, cos) = (self.era + ERA_RATE * t + spin).sin_cos();
        // celestial to intermediate but for the turn by −s (IERS Conventions 2010, eq. 5.10)
        let a = 1.0 / (1.0 + (1.0 - x * x - y * y).sqrt());
        let c =
            [[1.0 - a * x * x, -a * x * y, -x], [-a * x * y, 1.0 - a * y * y, -y], [x, y, 1.0 - a * (x * x + y * y)]];
        let turn = |j: usize| [cos * c[0][j] + sin * c[1][j], cos * c[1][j] - sin * c[0][j], c[2][j]];
        let (columns, poles) = ([turn(0), turn(1), turn(2)], [small_sin_cos(xp), small_sin_cos(yp)]);
        let [(sx, cx), (sy, cy)] = poles;
        // R1(−yp) R2(−xp), eq. 5.3
        let wobble = |v: &[f64; 3]| {
            let (first, third) = (cx * v[0] + sx * v[2], cx * v[2] - sx * v[0]);
            [first, cy * v[1] - sy * third, cy * third + sy * v[1]]
        };
        let e = columns.map(|v| wobble(&v));
        Moment {
            to_earth: std::array::from_fn(|i| [e[0][i], e[1][i], e[2][i]]),
            axis: c[2],
            sun: [p[0], p[1], p[2]],
            moon: [p[3], p[4], p[5]],
        }
    }

    /// [`Self::at`] for the lanes of `t`, computed once where all lanes have the same time.
    #[inline(always)]
    pub fn lanes<T: Real>(&self, t: T) -> Moment<T> {
        let first = self.at(t.lane(0));
        let same = (1..T::LANES).all(|i| t.lane(i) == t.lane(0));
        if same {
            return first.map(
                #[inline(always)]
                |x| T::splat(x),
            );
        }
        let mut each = [first; 8];
        for i in 1..T::LANES {
            each[i] = self.at(t.lane(i));
        }
        Moment {
            to_earth: grid(|i, j| T::from_lanes(|k| each[k].to_earth[i][j])),
            axis: std::array::from_fn(|i| T::from_lanes(|k| each[k].axis[i])),
            sun: std::array::from_fn(|i| T::from_lanes(|k| each[k].sun[i])),
            moon: std::array::from_fn(|i| T::from_lanes(|k| each[k].moon[i])),
        }
    }
}

#[inline(always)]
fn grid<T: Copy>(mut entry: impl FnMut(usize, usize) -> T) -> [[T; 3]; 3] {
    let mut row = |i| [entry(i, 0), entry(i, 1), entry(i, 2)];
    [row(0), row(1), row(2)]
}

impl<T: Real> Moment<T> {
    /// A moment without tables: the Earth-fixed frame is the GCRS, Sun and Moon are not known.
    #[inline(always)]
    pub fn none() -> Self {
        let (zero, one, nan) = (T::zero(), T::one(), T::splat(f64::NAN));
        Self {
            to_earth: [[one, zero, zero], [zero, one, zero], [zero, zero, one]],
            axis: [zero, zero, one],
            sun: [nan; 3],
            moon: [nan; 3],
        }
    }

    #[inline(always)]
    fn map<U: Real>(&self, mut f: impl FnMut(T) -> U) -> Moment<U> {
        let mut three = |v: &[T; 3]| [f(v[0]), f(v[1]), f(v[2])];
        let [a, b, c] = &self.to_earth;
        Moment {
            to_earth: [three(a), three(b), three(c)],
            axis: three(&self.axis),
            sun: three(&self.sun),
            moon: three(&self.moon),
        }
    }

    /// One lane.
    #[inline(always)]
    pub(super) fn lane(&self, i: usize) -> Moment<f64> {
        self.map(
            #[inline(always)]
            |x| x.lane(i),
        )
    }

    /// Velocity of the air at `r` that turns with the Earth, GCRS, m/s per rad/s.
    #[inline(always)]
    pub(super) fn spin(&self, r: &[T; 3]) -> [T; 3] {
        super::vector::cross(&self.axis, r)
    }

    /// The up direction in the GCRS for one in the ITRS.
    #[inline(always)]
    pub(super) fn inertial(&self, v: &[T; 3]) -> [T; 3] {
        rotate_back(&self.to_earth, v)
    }

    /// A vector turned about the axis of rotation (Rodrigues' formula).
    #[inline(always)]
    pub(super) fn turned(&self, v: &[T; 3], sin: f64, cos: f64) -> [T; 3] {
        let across = super::vector::cross(&self.axis, v);
        let along = scale(&self.axis, super::vector::dot3(&self.axis, v) * (1.0 - cos));
        let mut out = along;
        for i in 0..3 {
            out[i] += v[i] * cos + across[i] * sin;
        }
        out
    }
}

/// Earth rotation angle of a two-part Julian date of UT1, rad (as IAU SOFA's `era00`).
fn rotation_angle(ut1: [f64; 2]) -> f64 {
    let (big, small) = if ut1[0].abs() >= ut1[1].abs() { (ut1[0], ut1[1]) } else { (ut1[1], ut1[0]) };
    let days = small + (big - 2_451_545.0);
    let fraction = big % 1.0 + small % 1.0;
    TAU * ((fraction + 0.779_057_273_264_0 + 0.002_737_811_911_354_48 * days) % 1.0)
}

/// Sine and cosine of the pole's angles, exact to rounding below 1e-3 rad.
#[inline(always)]
fn small_sin_cos(x: f64) -> (f64, f64) {
    let x2 = x * x;
    (x * (1.0 - x2 * (1.0 / 6.0 - x2 / 120.0)), 1.0 - x2 * (0.5 - x2 / 24.0))
}

//! Spherical harmonics of any degree up to [`MAX_DEGREE`], poles included.
//!
//! The potential is `μ/R Σ (C̄ V̄ + S̄ W̄)` over the fully normalised solid harmonics `V̄ + i W̄ =
//! (R/r)^{n+1} P̄ₙₘ(sin φ) e^{imλ}`, which recursions give without any angle (Cunningham 1970; Montenbruck and
//! Gill 2000, section 3.2.4). A derivative of a solid harmonic is a sum of harmonics of the next degree, so
//! each component of the acceleration and of its gradient is itself such a series: its coefficients are
//! made once, and the sums then share one run of the recursion.

use super::vector::dot3;
use crate::error::{Error, Result};
use crate::linalg::{Matrix, from_fn};
use crate::scalar::Real;

/// Highest degree and order.
pub const MAX_DEGREE: usize = 70;

/// Orders that the recursion takes side by side.
const COLUMNS: usize = 8;

/// A gravity field, ready for evaluation.
#[derive(Clone, Debug)]
pub struct Field {
    /// Gravitational parameter, m³/s².
    pub mu: f64,
    /// Radius that goes with the coefficients, m.
    pub radius: f64,
    /// Highest degree in use.
    pub degree: usize,
    /// Highest order in use.
    pub order: usize,
    pull: Series<3>,
    both: Series<8>,
}

impl Field {
    /// A field from fully normalised coefficients: row by row, `c[n (n + 1) / 2 + m]`.
    ///
    /// The term of degree 0 is one whatever the table says.
    ///
    /// # Errors
    /// `Parameter` or `Length` where the table is too small or a number cannot be used.
    pub fn new(mu: f64, radius: f64, degree: usize, order: usize, c: &[f64], s: &[f64]) -> Result<Self> {
        for (field, value) in [("mu", mu), ("radius", radius)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::Parameter { field, value, need: "must be finite and positive" });
            }
        }
        if degree > MAX_DEGREE {
            return Err(Error::Parameter { field: "degree", value: degree as f64, need: "must be at most 70" });
        }
        if order > degree {
            return Err(Error::Parameter { field: "order", value: order as f64, need: "must not exceed the degree" });
        }
        let size = (degree + 1) * (degree + 2) / 2;
        for (field, table) in [("c", c), ("s", s)] {
            if table.len() < size {
                return Err(Error::Length { field, expected: size, found: table.len() });
            }
            if let Some(bad) = table[..size].iter().find(|x| !x.is_finite()) {
                return Err(Error::Parameter { field, value: *bad, need: "must be finite" });
            }
        }
        let potential = Coefficients::truncated(degree, order, c, s);
        let [x, y, z] = [potential.along_x(), potential.along_y(), potential.along_z()];
        let second = [x.along_x(), x.along_y(), x.along_z(), y.along_z(), z.along_z()];
        let pull = Series::new([&x, &y, &z]);
        let both = Series::new([&x, &y, &z, &second[0], &second[1], &second[2], &second[3], &second[4]]);
        Ok(Self { mu, radius, degree, order, pull, both })
    }

    /// Acceleration in the Earth-fixed frame less that of the point mass, m/s².
    #[inline(always)]
    pub fn acceleration<T: Real>(&self, r: &[T; 3]) -> [T; 3] {
        let sums = self.pull.sums(r, self.radius);
        let scale = self.mu / (self.radius * self.radius);
        [sums[0] * scale, sums[1] * scale, sums[2] * scale]
    }

    /// Acceleration and its gradient in the Earth-fixed frame, less those of the point mass.
    #[inline(always)]
    pub fn gradient<T: Real>(&self, r: &[T; 3]) -> ([T; 3], Matrix<T, 3, 3>) {
        let sums = self.both.sums(r, self.radius);
        let scale = self.mu / (self.radius * self.radius);
        let [xx, xy, xz, yz, zz] = [sums[3], sums[4], sums[5], sums[6], sums[7]];
        let rows = [[xx, xy, xz], [xy, -(xx + zz), yz], [xz, yz, zz]];
        let second = scale / self.radius;
        let gradient = from_fn(
            #[inline(always)]
            |i, j| rows[i][j] * second,
        );
        ([sums[0] * scale, sums[1] * scale, sums[2] * scale], gradient)
    }
}

/// Normalised coefficients of a sum of solid harmonics, by degree and order.
#[derive(Clone, Debug)]
struct Coefficients {
    degree: usize,
    order: usize,
    c: Vec<f64>,
    s: Vec<f64>,
}

fn place(n: usize, m: usize) -> usize {
    n * (n + 1) / 2 + m
}

impl Coefficients {
    fn zeros(degree: usize, order: usize) -> Self {
        let size = place(degree + 1, 0);
        Self { degree, order, c: vec![0.0; size], s: vec![0.0; size] }
    }

    /// The given coefficients from degree 1 up; sine terms of order 0 mean nothing.
    fn truncated(degree: usize, order: usize, c: &[f64], s: &[f64]) -> Self {
        let mut out = Self::zeros(degree, order);
        for n in 1..=degree {
            for m in 0..=order.min(n) {
                out.c[place(n, m)] = c[place(n, m)];
                out.s[place(n, m)] = if m == 0 { 0.0 } else { s[place(n, m)] };
            }
        }
        out
    }

    fn at(&self, n: usize, m: usize) -> (f64, f64) {
        if n <= self.degree && m <= self.order.min(n) { (self.c[place(n, m)], self.s[place(n, m)]) } else { (0.0, 0.0) }
    }

    /// The derivative's coefficients: `put` adds the terms that one coefficient pair contributes.
    fn derived(&self, mut put: impl FnMut(usize, usize, (f64, f64), &mut dyn FnMut(usize, f64, f64))) -> Self {
        let mut out = Self::zeros(self.degree + 1, self.order + 1);
        for n in 0..=self.degree {
            for m in 0..=self.order.min(n) {
                put(n, m, self.at(n, m), &mut |order, c, s| {
                    let k = place(n + 1, order);
                    out.c[k] += c;
                    out.s[k] += if order == 0 { 0.0 } else { s };
                });
            }
        }
        out
    }

    /// Times the radius, `∂/∂x` (Montenbruck and Gill, eq. 3.33, normalised).
    fn along_x(&self) -> Self {
        self.derived(|n, m, (c, s), add| {
            let (up, down) = (raise(n, m), lower(n, m));
            add(m + 1, -up * c, -up * s);
            if m > 0 {
                add(m - 1, down * c, down * s);
            }
        })
    }

    /// Times the radius, `∂/∂y`.
    fn along_y(&self) -> Self {
        self.derived(|n, m, (c, s), add| {
            let (up, down) = (raise(n, m), lower(n, m));
            add(m + 1, up * s, -up * c);
            if m > 0 {
                add(m - 1, down * s, -down * c);
            }
        })
    }

    /// Times the radius, `∂/∂z`.
    fn along_z(&self) -> Self {
        self.derived(|n, m, (c, s), add| {
            let f = -(((n - m + 1) * (n + m + 1)) as f64 * growth(n)).sqrt();
            add(m, f * c, f * s);
        })
    }
}

fn growth(n: usize) -> f64 {
    (2 * n + 1) as f64 / (2 * n + 3) as f64
}

/// Weight of order `m + 1` in a derivative along x or y: half, or all for order 0.
fn raise(n: usize, m: usize) -> f64 {
    let root = (growth(n) * ((n + m + 1) * (n + m + 2)) as f64).sqrt();
    root * if m == 0 { 0.5f64.sqrt() } else { 0.5 }
}

/// Weight of order `m − 1`.
fn lower(n: usize, m: usize) -> f64 {
    let root = (growth(n) * ((n - m + 1) * (n - m + 2)) as f64).sqrt();
    root * if m == 1 { 0.5f64.sqrt() } else { 0.5 }
}

/// One step of the recursion in `COLUMNS` orders, each `k` degrees above its order.
#[derive(Clone, Debug)]
struct Row<const K: usize> {
    /// Factors of the two harmonics before.
    step: [[f64; COLUMNS]; 2],
    /// Cosine and sine coefficients of each sum.
    terms: [[[f64; COLUMNS]; 2]; K],
}

/// `COLUMNS` orders from a first one on.
#[derive(Clone, Debug)]
struct Block<const K: usize> {
    /// Factors from one sectorial harmonic to the next.
    sectorial: [f64; COLUMNS],
    rows: Vec<Row<K>>,
}

/// `K` sums over the same harmonics.
#[derive(Clone, Debug)]
struct Series<const K: usize> {
    blocks: Vec<Block<K>>,
}

impl<const K: usize> Series<K> {
    fn new(sums: [&Coefficients; K]) -> Self {
        let degree = sums.iter().map(|s| s.degree).max().unwrap_or(0);
        let order = sums.iter().map(|s| s.order).max().unwrap_or(0);
        let block = |first: usize| Block {
            sectorial: std::array::from_fn(|i| sectorial(first + i)),
            rows: (0..=degree - first).map(|k| Row::new(first, k, degree, &sums)).collect(),
        };
        Self { blocks: (0..=order).step_by(COLUMNS).map(block).collect() }
    }

    #[inline(always)]
    fn sums<T: Real>(&self, r: &[T; 3], radius: f64) -> [T; K] {
        let i2 = dot3(r, r).recip();
        let over = i2 * radius;
        let [x, y] = [r[0] * over, r[1] * over];
        let z = (r[2] * over).stack();
        let q = (over * radius).stack();
        let (mut sector_v, mut sector_w) = (i2.sqrt() * radius, T::zero());
        let mut sums = [T::Pack::zero(); K];
        for (b, block) in self.blocks.iter().enumerate() {
            let (mut v, mut w) = ([T::zero(); COLUMNS], [T::zero(); COLUMNS]);
            for i in 0..COLUMNS {
                if b + i > 0 {
                    let factor = block.sectorial[i];
                    let turned = (x * sector_v - y * sector_w) * factor;
                    sector_w = (x * sector_w + y * sector_v) * factor;
                    sector_v = turned;
                }
                (v[i], w[i]) = (sector_v, sector_w);
            }
            for first in (0..COLUMNS).step_by(T::WIDTH) {
                block.add(&v, &w, first, z, q, &mut sums);
            }
        }
        let mut totals = [T::zero(); K];
        for k in 0..K {
            totals[k] = T::total(sums[k]);
        }
        totals
    }
}

impl<const K: usize> Block<K> {
    /// Adds the terms of the orders that start from slot `first` to the sums.
    #[inline(always)]
    fn add<T: Real>(
        &self,
        v: &[T; COLUMNS],
        w: &[T; COLUMNS],
        first: usize,
        z: T::Pack,
        q: T::Pack,
        sums: &mut [T::Pack; K],
    ) {
        let mut v = T::gather(
            #[inline(always)]
            |slot| v[first + slot],
        );
        let mut w = T::gather(
            #[inline(always)]
            |slot| w[first + slot],
        );
        let (mut v_before, mut w_before) = (T::Pack::zero(), T::Pack::zero());
        let mut totals = *sums;
        for row in &self.rows {
            for k in 0..K {
                let [c, s] = &row.terms[k];
                totals[k] = v.mul_add(pick::<T>(c, first), totals[k]);
                totals[k] = w.mul_add(pick::<T>(s, first), totals[k]);
            }
            let up = pick::<T>(&row.step[0], first) * z;
            let down = pick::<T>(&row.step[1], first) * q;
            let next_v = up.mul_add(v, down * v_before);
            let next_w = up.mul_add(w, down * w_before);
            (v_before, w_before) = (v, w);
            (v, w) = (next_v, next_w);
        }
        *sums = totals;
    }
}

/// Entries of a table for the slots of a pack.
#[inline(always)]
fn pick<T: Real>(table: &[f64; COLUMNS], first: usize) -> T::Pack {
    T::gather(
        #[inline(always)]
        |slot| T::splat(table[first + slot]),
    )
}

impl<const K: usize> Row<K> {
    fn new(first: usize, k: usize, degree: usize, sums: &[&Coefficients; K]) -> Self {
        let mut row = Self { step: [[0.0; COLUMNS]; 2], terms: [[[0.0; COLUMNS]; 2]; K] };
        for i in 0..COLUMNS {
            let (n, m) = (first + i + k, first + i);
            if n > degree {
                continue;
            }
            for (term, sum) in row.terms.iter_mut().zip(sums) {
                (term[0][i], term[1][i]) = sum.at(n, m);
            }
            let (n, m) = ((n + 1) as f64, m as f64);
            let square = (2.0 * n + 1.0) / ((n - m) * (n + m));
            row.step[0][i] = (square * (2.0 * n - 1.0)).sqrt();
            if k > 0 {
                row.step[1][i] = -(square * (n + m - 1.0) * (n - m - 1.0) / (2.0 * n - 3.0)).sqrt();
            }
        }
        row
    }
}

/// Ratio of the normalised sectorial harmonic of order `m` to the one before.
fn sectorial(m: usize) -> f64 {
    match m {
        0 => 1.0,
        1 => 3f64.sqrt(),
        _ => (1.0 + 0.5 / m as f64).sqrt(),
    }
}

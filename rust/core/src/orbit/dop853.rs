//! Dormand and Prince's Runge-Kutta method of order 8 with a dense output of order 7 (Hairer, Nørsett and
//! Wanner, Solving Ordinary Differential Equations I, 1993, section II.5 and II.6).

use super::coefficients::{A, B, C, D, E3, E5};
use super::integrate::{Phase, Rhs};
use crate::error::{Error, Result};
use crate::scalar::Real;

/// Slopes of a step, those for the dense output included.
const STAGES: usize = 16;

const UNREACHED: &str = "cannot be reached: the step shrank to nothing; loosen it, or check the forces and the state";

/// An integration under way.
pub(super) struct Dop853<T, const N: usize> {
    t: f64,
    y: [T; N],
    h: f64,
    end: f64,
    sign: f64,
    rtol: f64,
    longest: f64,
    before: (f64, [T; N]),
    phase: Phase,
    /// A step that must end where the light changes, and the light after it.
    edge: Option<(f64, Phase)>,
    k: [[T; N]; STAGES],
    pub(super) evaluations: usize,
}

impl<T: Real<Mask = bool>, const N: usize> Dop853<T, N> {
    #[inline(always)]
    pub(super) fn new<R: Rhs<N>>(rhs: &R, t: &[f64], y: [T; N], rtol: f64, longest: f64) -> Self {
        let (first, end) = (t[0], t[t.len() - 1]);
        let slope = rhs.slope(&rhs.at(T::splat(first)), &y);
        let mut k = [[T::zero(); N]; STAGES];
        k[0] = slope;
        // an eighth-order method turns a few degrees of the orbit per step at 1e-12
        let (r, v) = (size(&y, 0), size(&y, 3));
        let h = (rtol.powf(0.125) * r / v.max((r * size(&slope, 3)).sqrt())).min(longest);
        let sign = if end < first { -1.0 } else { 1.0 };
        let phase = rhs.phase(&rhs.at(T::splat(first)), &y);
        let (before, edge) = ((first, y), None);
        Self { t: first, y, h, end, sign, rtol, longest, before, phase, edge, k, evaluations: 1 }
    }

    pub(super) fn time(&self) -> f64 {
        self.t
    }

    pub(super) fn state(&self) -> &[T; N] {
        &self.y
    }

    /// One accepted step.
    #[inline(always)]
    pub(super) fn step<R: Rhs<N>>(&mut self, rhs: &R) -> Result<()> {
        let mut rejected = false;
        loop {
            let remaining = (self.end - self.t).abs();
            let free = self.edge.map_or(self.h, |(h, _)| h);
            // neither a sliver at the end nor a step beyond it
            let h = if free * 1.01 >= remaining && self.edge.is_none() { remaining } else { free } * self.sign;
            if h.is_nan() || h.abs() <= 1e-13 * self.t.abs().max(1.0) {
                return Err(Error::Parameter { field: "rtol", value: self.rtol, need: UNREACHED });
            }
            self.stages::<R, 1, 12>(rhs, h);
            let next = self.combined(h, &B);
            self.evaluations += 11;
            let error = self.error(h, &next);
            if error < 1.0 {
                self.k[12] = rhs.slope(&rhs.at(T::splat(self.t + h)), &next);
                self.evaluations += 1;
                if self.edge.is_none() {
                    let factor = if error > 0.0 { 0.9 * error.powf(-0.125) } else { 6.0 };
                    self.h = (h.abs() * factor.clamp(0.333, if rejected { 1.0 } else { 6.0 })).min(self.longest);
                    self.edge = self.find_edge(rhs, h, &next);
                    if self.edge.is_some() {
                        continue;
                    }
                }
                if let Some((_, phase)) = self.edge.take() {
                    self.phase = phase;
                }
                self.before = (self.t, self.y);
                self.t = if h.abs() == remaining { self.end } else { self.t + h };
                self.y = next;
                return Ok(());
            }
            self.edge = None;
            let factor = if error.is_finite() { 0.9 * error.powf(-0.125) } else { 0.1 };
            self.h = h.abs() * factor.clamp(0.1, 0.9);
            rejected = true;
        }
    }

    /// Slopes `FROM..TO` of a step of `h` from the state before it.
    #[inline(always)]
    fn stages<R: Rhs<N>, const FROM: usize, const TO: usize>(&mut self, rhs: &R, h: f64) {
        let (t, y) = if FROM == 1 { (self.t, self.y) } else { self.before };
        for s in FROM..TO {
            let stage = combination(&y, h, A[s], &self.k);
            self.k[s] = rhs.slope(&rhs.at(T::splat(t + C[s] * h)), &stage);
        }
    }

    /// How far a step of `h` to `next` may go before the light changes, and the light beyond.
    ///
    /// The error estimate does not see the jump of sunlight at a shadow's edge, which passes between two
    /// slopes; a step that ends at the edge has none.
    #[inline(always)]
    fn find_edge<R: Rhs<N>>(&self, rhs: &R, h: f64, next: &[T; N]) -> Option<(f64, Phase)> {
        if !rhs.casts_shadow() {
            return None;
        }
        let phase = |x: f64| {
            let y = self.hermite(x, h, next);
            rhs.phase(&rhs.at(T::splat(self.t + x * h)), &y)
        };
        let probes = (h.abs() / 30.0).ceil().max(1.0);
        let (mut low, mut found) = (0.0, None);
        for k in 1..=probes as usize {
            let x = k as f64 / probes;
            let there = phase(x);
            if there != self.phase {
                found = Some((x, there));
                break;
            }
            low = x;
        }
        let (mut high, mut beyond) = found?;
        while (high - low) * h.abs() > 1e-4 {
            let middle = 0.5 * (low + high);
            let there = phase(middle);
            if there == self.phase {
                low = middle;
            } else {
                (high, beyond) = (middle, there);
            }
        }
        Some((high * h.abs(), beyond))
    }

    /// Cubic through both ends of a step, good to metres.
    #[inline(always)]
    fn hermite(&self, x: f64, h: f64, next: &[T; N]) -> [T; N] {
        let (a, b) = (x * x * (3.0 - 2.0 * x), x * (1.0 - x));
        let mut y = self.y;
        for i in 0..N {
            y[i] += (next[i] - self.y[i]) * a + (self.k[0][i] * (1.0 - x) - self.k[12][i] * x) * (b * h);
        }
        y
    }

    #[inline(always)]
    fn combined(&self, h: f64, weights: &[(usize, f64)]) -> [T; N] {
        combination(&self.y, h, weights, &self.k)
    }

    /// Error of the step over what is allowed, by |r| and |v|; the state transition follows the orbit's steps.
    #[inline(always)]
    fn error(&self, h: f64, next: &[T; N]) -> f64 {
        let zero = [T::zero(); N];
        let (e5, e3) = (combination(&zero, 1.0, &E5, &self.k), combination(&zero, 1.0, &E3, &self.k));
        let allowed = [0, 3].map(|part| self.rtol * size(&self.y, part).max(size(next, part)));
        let norm = |e: &[T; N]| {
            let [r, v] = [size(e, 0) / allowed[0], size(e, 3) / allowed[1]];
            r * r + v * v
        };
        let (five, three) = (norm(&e5), norm(&e3));
        if five == 0.0 {
            return 0.0;
        }
        h.abs() * five / ((five + 0.01 * three) * 2.0).sqrt()
    }

    /// Appends the asked-for states that the last step has passed.
    #[inline(always)]
    pub(super) fn outputs<R: Rhs<N>>(&mut self, rhs: &R, t: &[f64], rows: &mut Vec<[f64; N]>) {
        let (begin, _) = self.before;
        let passed = |x: f64, now: f64, sign: f64| (now - x) * sign >= 0.0;
        let inside = t[rows.len()..].iter().take_while(|x| passed(**x, self.t, self.sign)).count();
        if inside > 1 || (inside == 1 && t[rows.len()] != self.t) {
            let h = self.t - begin;
            self.stages::<R, 13, 16>(rhs, h);
            self.evaluations += 3;
            let f = self.interpolant(h);
            for &x in &t[rows.len()..rows.len() + inside] {
                rows.push(if x == self.t { self.y } else { self.between(&f, (x - begin) / h) }.map(|y| y.lane(0)));
            }
        } else if inside == 1 {
            rows.push(self.y.map(|y| y.lane(0)));
        }
        self.k[0] = self.k[12];
    }

    #[inline(always)]
    fn interpolant(&self, h: f64) -> [[T; N]; 7] {
        let mut f = [[T::zero(); N]; 7];
        for i in 0..N {
            let delta = self.y[i] - self.before.1[i];
            f[0][i] = delta;
            f[1][i] = self.k[0][i] * h - delta;
            f[2][i] = delta * 2.0 - (self.k[0][i] + self.k[12][i]) * h;
        }
        for j in 0..4 {
            f[3 + j] = combination(&[T::zero(); N], h, D[j], &self.k);
        }
        f
    }

    #[inline(always)]
    fn between(&self, f: &[[T; N]; 7], x: f64) -> [T; N] {
        let mut out = [T::zero(); N];
        for (i, part) in f.iter().rev().enumerate() {
            let factor = if i % 2 == 0 { x } else { 1.0 - x };
            for n in 0..N {
                out[n] = (out[n] + part[n]) * factor;
            }
        }
        for n in 0..N {
            out[n] += self.before.1[n];
        }
        out
    }
}

/// `y + h Σ w k`
#[inline(always)]
fn combination<T: Real, const N: usize>(y: &[T; N], h: f64, weights: &[(usize, f64)], k: &[[T; N]; STAGES]) -> [T; N] {
    let mut sum = [T::zero(); N];
    for &(s, w) in weights {
        let slope = &k[s.min(STAGES - 1)];
        for n in 0..N {
            sum[n] = slope[n].mul_add(T::splat(w), sum[n]);
        }
    }
    let mut out = *y;
    for n in 0..N {
        out[n] = sum[n].mul_add(T::splat(h), y[n]);
    }
    out
}

/// Length of the position (`part` 0) or velocity (`part` 3).
#[inline(always)]
fn size<T: Real, const N: usize>(y: &[T; N], part: usize) -> f64 {
    let [a, b, c] = [y[part].lane(0), y[part + 1].lane(0), y[part + 2].lane(0)];
    (a * a + b * b + c * c).sqrt()
}

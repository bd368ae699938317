//! Resampling of weighted particles: which particles live on, and how often.
//!
//! All four ways return indices in increasing order and are unbiased: particle `i` of weight `w_i` is
//! drawn `n w_i` times on average. They differ in the scatter about that number; it is least for
//! systematic and residual resampling.
//!
//! Source: Douc, Cappé, Moulines, *Comparison of resampling schemes for particle filtering*, 2005.

use crate::error::{Error, Result};
use crate::scalar::Lanes;
use crate::scalar::elementary::{exp, ln};

/// How to resample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resampling {
    /// One uniform number for all: points `(i + u) / n`.
    #[default]
    Systematic,
    /// One uniform number for each of `n` equal strata.
    Stratified,
    /// `⌊n w_i⌋` copies of each, the rest drawn systematically from what is left of the weights.
    Residual,
    /// Independent draws.
    Multinomial,
}

/// Weights of sum one from their logarithms, in place; the logarithm of their mean comes back. The
/// largest is taken out first, so that weights of any size survive.
///
/// # Errors
/// `Parameter` where all weights vanish or one is not a number: no particle explains the measurement.
pub fn normalise_logs(weights: &mut [f64]) -> Result<f64> {
    let need = "is the largest log-weight: all weights vanish, no particle explains the measurement";
    let largest = weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() || weights.iter().any(|w| w.is_nan()) {
        return Err(Error::Parameter { field: "weights", value: largest, need });
    }
    let mut sum = 0.0;
    for w in weights.iter_mut() {
        *w = (*w - largest).exp();
        sum += *w;
    }
    let inverse = 1.0 / sum;
    for w in weights.iter_mut() {
        *w *= inverse;
    }
    Ok(largest + (sum / weights.len() as f64).ln())
}

/// Effective number of particles, `1 / Σ w²` for weights of sum one: from 1 to their number.
pub fn effective_sample_size(weights: &[f64]) -> f64 {
    1.0 / weights.iter().map(|w| w * w).sum::<f64>()
}

/// Draws as many indices as `out` holds, by weights that need not sum to one. `uniform` gives numbers in
/// `[0, 1)`; how many are used depends on the way alone, not on the weights.
///
/// # Errors
/// `Parameter` where the weights' sum is not positive and finite, or one is negative; `Empty` where there
/// are none.
pub fn resample(way: Resampling, weights: &[f64], mut uniform: impl FnMut() -> f64, out: &mut [usize]) -> Result<()> {
    let shares = Shares::new(weights, out.len())?;
    match way {
        Resampling::Systematic => {
            let u = uniform();
            shares.copy(out, |reached, _| below(reached - u));
        }
        Resampling::Stratified => {
            let mut points = Strata::new(out.len(), uniform);
            shares.copy(out, |reached, _| points.below(reached));
            points.finish();
        }
        Resampling::Residual => shares.residual(uniform(), out),
        Resampling::Multinomial => shares.independent(&mut uniform, out),
    }
    Ok(())
}

/// Weights in units of one drawn index: they sum to the number of indices.
struct Shares<'a> {
    weights: &'a [f64],
    /// A power of two that keeps sums of the smallest weights from underflow.
    lift: f64,
    /// Indices for a lifted weight of one.
    scale: f64,
    /// The first and the last particle that has weight: rounding must not run past them.
    first: usize,
    last: usize,
}

/// Copies that are written whether wanted or not: most particles live on less often than that, and what comes after them
/// overwrites the rest. So the usual particle takes no branch that depends on its weight.
const RUN: usize = 4;

/// Uniform numbers that are drawn at a time.
const BLOCK: usize = 64;

impl<'a> Shares<'a> {
    fn new(weights: &'a [f64], count: usize) -> Result<Self> {
        if weights.is_empty() {
            return Err(Error::Empty { field: "weights" });
        }
        let (sum, least) = sum_and_least(weights);
        // a sum finds what is not a number, a comparison does not
        if least < 0.0 || sum.is_nan() {
            let bad = weights.iter().copied().find(|w| w.is_nan() || *w < 0.0);
            return Err(Error::Parameter { field: "weights", value: bad.unwrap_or(sum), need: "must not be negative" });
        }
        if !(sum > 0.0 && sum.is_finite()) {
            let need = "must have a positive, finite sum";
            return Err(Error::Parameter { field: "weights", value: sum, need });
        }
        let lift = if sum < 1e-200 { 2f64.powi(600) } else { 1.0 };
        let first = weights.iter().position(|w| *w > 0.0).unwrap_or(0);
        let last = weights.iter().rposition(|w| *w > 0.0).unwrap_or(0);
        Ok(Self { weights, lift, scale: count as f64 / (sum * lift), first, last })
    }

    /// Copies each particle until `end(reached, share)` indices are written in all: `share` is its weight, `reached` the sum of
    /// weights up to it.
    #[inline(always)]
    fn copy(&self, out: &mut [usize], mut end: impl FnMut(f64, f64) -> usize) {
        let (mut filled, mut sum) = (0, 0.0);
        for (k, w) in self.weights.iter().enumerate() {
            let lifted = w * self.lift;
            sum += lifted;
            let end = end(sum * self.scale, lifted * self.scale).min(out.len());
            match out.get_mut(filled..filled + RUN) {
                Some(run) => {
                    run.fill(k);
                    if end > filled + RUN {
                        out[filled + RUN..end].fill(k);
                    }
                }
                None => out[filled..end].fill(k),
            }
            filled = end;
        }
        out[filled..].fill(self.last);
    }

    fn residual(&self, u: f64, out: &mut [usize]) {
        let whole: f64 = self.weights.iter().map(|w| floor(w * self.lift * self.scale)).sum();
        let rest = (out.len() as f64 - whole).max(0.0) as usize;
        // what is left of the shares sums to `rest`: a point in each unit of it
        let (mut copies, mut left) = (0, 0.0);
        self.copy(out, |_, share| {
            let whole = floor(share);
            copies += whole as usize;
            left += share - whole;
            copies + below(left - u).min(rest)
        });
    }

    /// Independent draws, already in order: exponential gaps between the logarithms of sorted uniform numbers (Devroye, 1986,
    /// V.3). From the largest down: the largest of `i` uniform numbers is `u^(1/i)`.
    fn independent(&self, uniform: &mut impl FnMut() -> f64, out: &mut [usize]) {
        let share = |k: usize| self.weights[k] * self.lift * self.scale;
        let all = out.len() as f64;
        let (mut k, mut left, mut log) = (self.last, out.len(), 0.0);
        let mut below = all - share(k);
        let mut points = [1.0; BLOCK];
        while left > 0 {
            let count = left.min(points.len());
            for point in &mut points[..count] {
                *point = 1.0 - uniform();
            }
            each_eight(&mut points, ln);
            for (i, point) in points[..count].iter_mut().enumerate() {
                log += *point / (left - i) as f64;
                *point = log;
            }
            each_eight(&mut points, exp);
            for point in &points[..count] {
                while point * all < below && k > self.first {
                    k -= 1;
                    below -= share(k);
                }
                left -= 1;
                out[left] = k;
            }
        }
    }
}

/// Side by side, without fused multiply-add: the same on every processor.
#[inline(always)]
fn each_eight(x: &mut [f64; BLOCK], f: impl Fn(Lanes<false>) -> Lanes<false>) {
    for eight in x.as_chunks_mut::<8>().0 {
        *eight = f(Lanes(*eight)).0;
    }
}

/// Sum and smallest of some numbers, several at a time.
fn sum_and_least(x: &[f64]) -> (f64, f64) {
    let (mut sums, mut least) = ([0.0; 8], [f64::INFINITY; 8]);
    let (eights, rest) = x.as_chunks::<8>();
    let mut take = |i: usize, x: f64| {
        sums[i] += x;
        least[i] = if x < least[i] { x } else { least[i] };
    };
    for eight in eights {
        for i in 0..8 {
            take(i, eight[i]);
        }
    }
    for (i, x) in rest.iter().enumerate() {
        take(i, *x);
    }
    (sums.iter().sum(), least.iter().copied().fold(f64::INFINITY, f64::min))
}

/// Added to a number of less than 2⁵¹ and taken away again it rounds to the nearest whole number, on any processor in two
/// instructions.
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// How many of 0, 1, 2, … are below `x`, which is above −1: `⌈x⌉`.
#[inline(always)]
fn below(x: f64) -> usize {
    let shifted = x + WHOLE;
    // such sums follow each other bit by bit
    let nearest = shifted.to_bits().wrapping_sub(WHOLE.to_bits());
    nearest.wrapping_add(u64::from(x > shifted - WHOLE)) as usize
}

/// `⌊x⌋`
#[inline(always)]
fn floor(x: f64) -> f64 {
    let nearest = (x + WHOLE) - WHOLE;
    nearest - if nearest > x { 1.0 } else { 0.0 }
}

/// One point in each of `[0, 1)`, `[1, 2)`, …: their numbers are drawn in order, some at a time.
struct Strata<U> {
    uniform: U,
    count: usize,
    drawn: usize,
    /// Points of the last strata that were drawn, within each of them.
    block: [f64; BLOCK],
}

impl<U: FnMut() -> f64> Strata<U> {
    fn new(count: usize, uniform: U) -> Self {
        Self { uniform, count, drawn: 0, block: [0.0; BLOCK] }
    }

    /// How many points are below `x`, which does not decrease.
    #[inline(always)]
    fn below(&mut self, x: f64) -> usize {
        let stratum = floor(x);
        let i = stratum as usize;
        while i >= self.drawn {
            if i >= self.count {
                return self.count;
            }
            self.draw();
        }
        i + usize::from(self.block[i % BLOCK] < x - stratum)
    }

    fn draw(&mut self) {
        for point in self.block.iter_mut().take(self.count - self.drawn) {
            *point = (self.uniform)();
            self.drawn += 1;
        }
    }

    /// Draws those that are left, so that the weights do not change how many numbers are used.
    fn finish(&mut self) {
        while self.drawn < self.count {
            self.draw();
        }
    }
}

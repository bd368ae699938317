//! Resampling of weighted particles: which particles live on, and how often.
//!
//! All four ways return indices in increasing order and are unbiased: particle `i` of weight `w_i` is
//! drawn `n w_i` times on average. They differ in the scatter about that number; it is least for
//! systematic and residual resampling.
//!
//! Source: Douc, Cappé, Moulines, *Comparison of resampling schemes for particle filtering*, 2005.

use crate::error::{Error, Result};

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
    let sum: f64 = weights.iter().sum();
    if weights.is_empty() {
        return Err(Error::Empty { field: "weights" });
    }
    if let Some(value) = weights.iter().copied().find(|w| w.is_nan() || *w < 0.0) {
        return Err(Error::Parameter { field: "weights", value, need: "must not be negative" });
    }
    if !(sum > 0.0 && sum.is_finite()) {
        return Err(Error::Parameter { field: "weights", value: sum, need: "must have a positive, finite sum" });
    }
    let n = out.len() as f64;
    match way {
        Resampling::Systematic => {
            let u = uniform();
            merge(weights, sum, out, |i| (i as f64 + u) / n);
        }
        Resampling::Stratified => merge(weights, sum, out, |i| (i as f64 + uniform()) / n),
        Resampling::Residual => residual(weights, sum, uniform(), out),
        Resampling::Multinomial => sorted(weights, sum, &mut uniform, out),
    }
    Ok(())
}

/// Index of the particle in whose share of the sum each of some increasing points lies.
#[inline(always)]
fn merge(weights: &[f64], sum: f64, out: &mut [usize], mut point: impl FnMut(usize) -> f64) {
    let last = weights.iter().rposition(|w| *w > 0.0).unwrap_or(0);
    let (mut k, mut reached) = (0, weights[0]);
    for (i, chosen) in out.iter_mut().enumerate() {
        let p = point(i) * sum;
        // rounding must not run past the last particle that has weight
        while p >= reached && k < last {
            k += 1;
            reached += weights[k];
        }
        *chosen = k;
    }
}

fn residual(weights: &[f64], sum: f64, u: f64, out: &mut [usize]) {
    let n = out.len() as f64;
    let copies = |w: f64| (n * w / sum).floor();
    let whole: f64 = weights.iter().map(|w| copies(*w)).sum();
    let rest = (n - whole).max(0.0);
    // what is left of the weights sums to `rest`: a point in each unit of it
    let (mut filled, mut left, mut next) = (0, 0.0, u);
    let last = weights.iter().rposition(|w| *w > 0.0).unwrap_or(0);
    for (k, w) in weights.iter().enumerate() {
        let share = n * w / sum;
        left += share - copies(*w);
        let mut times = copies(*w) as usize;
        while next < left && next < rest {
            times += 1;
            next += 1.0;
        }
        let end = if k == last { out.len() } else { (filled + times).min(out.len()) };
        out[filled..end].fill(k);
        filled = end;
    }
}

/// Independent draws, already in order: exponential gaps between sorted uniform numbers (Devroye, 1986,
/// V.3).
fn sorted(weights: &[f64], sum: f64, uniform: &mut impl FnMut() -> f64, out: &mut [usize]) {
    let mut log = 0.0;
    let n = out.len();
    // from the largest down: max of i uniform numbers is u^(1/i)
    let mut k = weights.iter().rposition(|w| *w > 0.0).unwrap_or(0);
    let mut below = sum - weights[k];
    for i in (1..=n).rev() {
        log += (1.0 - uniform()).ln() / i as f64;
        let p = log.exp() * sum;
        while p < below && k > 0 {
            k -= 1;
            below -= weights[k];
        }
        out[i - 1] = k;
    }
}

//! Weights of particles, and which of them live on.

use super::Settings;
use crate::error::{Error, Result};
use crate::resample::resample;
use crate::scalar::Real;
use crate::scalar::elementary::exp;
use crate::simulate::rng::Stream;

/// Weights of sum one, and their logarithms.
#[derive(Clone, Debug)]
pub(super) struct Weights {
    /// Logarithms of the weights; add a measurement's log-likelihoods to them, then [`Self::normalise`].
    pub(super) logs: Vec<f64>,
    /// The weights.
    pub(super) values: Vec<f64>,
    /// After resampling: what each particle becomes.
    pub(super) chosen: Vec<usize>,
    /// Effective number of particles.
    effective: f64,
}

impl Weights {
    pub(super) fn new(count: usize) -> Self {
        let mut new = Self { logs: vec![0.0; count], values: vec![0.0; count], chosen: vec![0; count], effective: 0.0 };
        new.level();
        new
    }

    /// Makes all equal.
    #[inline(always)]
    pub(super) fn level(&mut self) {
        let count = self.logs.len() as f64;
        self.logs.fill(-count.ln());
        self.values.fill(1.0 / count);
        self.effective = count;
    }

    /// Weights of sum one from logarithms of any size; the logarithm of their sum before comes back. None
    /// where all vanish or one is not a number: then call [`Self::restore`].
    #[inline(always)]
    pub(super) fn normalise<T: Real>(&mut self) -> Option<f64> {
        let largest = self.largest().filter(|log| log.is_finite())?;
        let mut sum = T::Pack::zero();
        for (values, logs) in self.values.chunks_mut(8).zip(self.logs.chunks(8)) {
            let weight = exp(eight::<T::Pack>(logs, f64::NEG_INFINITY) - T::Pack::splat(largest));
            sum += weight;
            for (i, value) in values.iter_mut().enumerate() {
                *value = weight.lane(i);
            }
        }
        let sum = total(sum);
        let (log, inverse) = (largest + sum.ln(), 1.0 / sum);
        let mut squares = T::Pack::zero();
        for values in self.values.chunks_mut(8) {
            let weight = eight::<T::Pack>(values, 0.0) * inverse;
            squares = weight.mul_add(weight, squares);
            for (i, value) in values.iter_mut().enumerate() {
                *value = weight.lane(i);
            }
        }
        for l in &mut self.logs {
            *l -= log;
        }
        self.effective = 1.0 / total(squares);
        Some(log)
    }

    /// The largest logarithm; none where one is not a number.
    #[inline(always)]
    fn largest(&self) -> Option<f64> {
        // a sum finds what is not a number, a maximum does not
        let (mut largest, mut nothing) = ([f64::NEG_INFINITY; 8], [0.0; 8]);
        let mut take = |i: usize, log: f64| {
            largest[i] = if log > largest[i] { log } else { largest[i] };
            nothing[i] += if log.is_nan() { 1.0 } else { 0.0 };
        };
        let (eights, rest) = self.logs.as_chunks::<8>();
        for eight in eights {
            for i in 0..8 {
                take(i, eight[i]);
            }
        }
        for (i, log) in rest.iter().enumerate() {
            take(i, *log);
        }
        let none = nothing.iter().sum::<f64>() == 0.0;
        none.then(|| largest.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    }

    /// Of the weights, once they are normalised: from one to their number.
    #[inline(always)]
    pub(super) fn effective(&self) -> f64 {
        self.effective
    }

    /// Resampling waits until fewer than this number are effective.
    #[inline(always)]
    pub(super) fn fewest(&self, settings: &Settings) -> f64 {
        settings.threshold * self.values.len() as f64
    }

    /// Chooses who lives on if too few are effective, and makes the weights equal.
    #[inline(always)]
    pub(super) fn refresh(&mut self, settings: &Settings, effective: f64, stream: &mut Stream) -> Result<bool> {
        if effective >= self.fewest(settings) {
            return Ok(false);
        }
        resample(settings.resampling, &self.values, || stream.uniform(), &mut self.chosen)?;
        self.level();
        Ok(true)
    }

    /// The particle of the largest weight.
    #[inline(always)]
    pub(super) fn heaviest(&self) -> usize {
        let mut best = 0;
        for (i, w) in self.values.iter().enumerate() {
            best = if *w > self.values[best] { i } else { best };
        }
        best
    }

    /// Takes back what measurement `step` has added to the logarithms.
    ///
    /// # Errors
    /// `Vanished`, with what was added, unless the filter is to recover.
    #[cold]
    pub(super) fn restore(&mut self, recover: bool, step: usize, t: f64) -> Result<()> {
        let (mut largest, mut broken) = (f64::NEG_INFINITY, 0);
        for (log, value) in self.logs.iter_mut().zip(&self.values) {
            let before = value.ln();
            let added = if *value > 0.0 { *log - before } else { f64::NEG_INFINITY };
            largest = largest.max(added);
            broken += usize::from(added.is_nan());
            *log = before;
        }
        if recover {
            return Ok(());
        }
        Err(Error::Vanished { step, t, largest, broken, count: self.logs.len() })
    }
}

/// Eight numbers side by side; a filler where there are fewer.
#[inline(always)]
fn eight<P: Real>(x: &[f64], filler: f64) -> P {
    match <&[f64; 8]>::try_from(x) {
        Ok(all) => P::from_lanes(|i| all[i]),
        Err(_) => P::from_lanes(|i| x.get(i).copied().unwrap_or(filler)),
    }
}

/// Sum over the lanes.
#[inline(always)]
fn total<P: Real>(x: P) -> f64 {
    (0..P::LANES).map(|i| x.lane(i)).sum()
}

//! Weights of particles, and which of them live on.

use super::Settings;
use crate::error::{Error, Result};
use crate::resample::{effective_sample_size, resample};
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
}

impl Weights {
    pub(super) fn new(count: usize) -> Self {
        let mut new = Self { logs: vec![0.0; count], values: vec![0.0; count], chosen: vec![0; count] };
        new.level();
        new
    }

    /// Makes all equal.
    #[inline(always)]
    pub(super) fn level(&mut self) {
        let count = self.logs.len() as f64;
        self.logs.fill(-count.ln());
        self.values.fill(1.0 / count);
    }

    /// Weights of sum one from logarithms of any size; the logarithm of their sum before comes back. None
    /// where all vanish or one is not a number: then call [`Self::restore`].
    #[inline(always)]
    pub(super) fn normalise(&mut self) -> Option<f64> {
        // a sum finds what is not a number, a maximum does not
        let (mut largest, mut nothing) = (f64::NEG_INFINITY, 0.0);
        for log in &self.logs {
            largest = if *log > largest { *log } else { largest };
            nothing += if log.is_nan() { 1.0 } else { 0.0 };
        }
        if nothing > 0.0 || !largest.is_finite() {
            return None;
        }
        let mut sum = 0.0;
        for (value, log) in self.values.iter_mut().zip(&self.logs) {
            *value = (log - largest).exp();
            sum += *value;
        }
        let (log, inverse) = (largest + sum.ln(), 1.0 / sum);
        for (value, l) in self.values.iter_mut().zip(&mut self.logs) {
            *value *= inverse;
            *l -= log;
        }
        Some(log)
    }

    #[inline(always)]
    pub(super) fn effective(&self) -> f64 {
        effective_sample_size(&self.values)
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

//! Weighted particles on a manifold: the bootstrap filter's prediction, weighting and resampling.

use crate::error::{Error, Result};
use crate::linalg::{Matrix, Vector, apply, cholesky, zeros};
use crate::manifold::Manifold;
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::resample::{Resampling, effective_sample_size, normalise_logs, resample};
use crate::simulate::rng::Stream;

/// A distribution as states with weights of sum one. All memory is taken at the start; steps allocate
/// nothing.
///
/// Source: Gordon, Salmond, Smith, *Novel approach to nonlinear/non-Gaussian Bayesian state estimation*,
/// 1993.
pub struct Particles<S: Manifold<N>, const N: usize> {
    states: Vec<S::Of<f64>>,
    weights: Vec<f64>,
    logs: Vec<f64>,
    spare: Vec<S::Of<f64>>,
    chosen: Vec<usize>,
}

impl<S: Manifold<N>, const N: usize> Particles<S, N> {
    /// Draws `count` particles of equal weight from a normal distribution.
    ///
    /// # Errors
    /// `Parameter` for no particles, `NotPositiveDefinite` for a covariance that is none.
    pub fn new(mean: &S::Of<f64>, covariance: &Matrix<f64, N, N>, count: usize, stream: &mut Stream) -> Result<Self> {
        if count == 0 {
            return Err(Error::Parameter { field: "particles", value: 0.0, need: "must be at least 1" });
        }
        let (root, ok) = cholesky(covariance);
        if !ok {
            return Err(Error::NotPositiveDefinite { what: "covariance of the particles", step: 0, t: 0.0 });
        }
        let states: Vec<_> = (0..count).map(|_| moved::<S, N>(mean, &root, stream)).collect();
        let spare = states.clone();
        let weights = vec![1.0 / count as f64; count];
        Ok(Self { states, logs: weights.clone(), weights, spare, chosen: vec![0; count] })
    }

    /// The states.
    pub fn states(&self) -> &[S::Of<f64>] {
        &self.states
    }

    /// Their weights, of sum one.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Effective number of particles.
    pub fn effective_sample_size(&self) -> f64 {
        effective_sample_size(&self.weights)
    }

    /// Moves each particle by the dynamics and by noise of its own.
    pub fn predict<D: Dynamics<N, Space = S>>(
        &mut self,
        dynamics: &D,
        u: &Input<D, f64, N>,
        t: f64,
        dt: f64,
        stream: &mut Stream,
    ) {
        for x in &mut self.states {
            let root = dynamics.noise_factor(x, u, t, dt);
            *x = moved::<S, N>(&dynamics.step(x, u, t, dt), &root, stream);
        }
    }

    /// Weighs each particle by the likelihood of a measurement. The logarithm of the measurement's
    /// probability density, given those before it, comes back.
    ///
    /// # Errors
    /// `Parameter` where no particle explains the measurement; the weights are as they were.
    pub fn update<H: Measurement<N, M, Space = S>, const M: usize>(
        &mut self,
        sensor: &H,
        given: &Given<H, f64, N, M>,
        z: &Value<H, f64, N, M>,
    ) -> Result<f64> {
        for ((log, w), x) in self.logs.iter_mut().zip(&self.weights).zip(&self.states) {
            *log = w.ln() + sensor.log_likelihood(x, given, z);
        }
        let mean = normalise_logs(&mut self.logs)?;
        std::mem::swap(&mut self.weights, &mut self.logs);
        Ok(mean + (self.weights.len() as f64).ln())
    }

    /// Resamples if fewer than the part `threshold` of the particles are effective; whether it did.
    ///
    /// # Errors
    /// See [`resample`].
    pub fn refresh(&mut self, way: Resampling, threshold: f64, stream: &mut Stream) -> Result<bool> {
        let count = self.weights.len() as f64;
        if self.effective_sample_size() >= threshold * count {
            return Ok(false);
        }
        resample(way, &self.weights, || stream.uniform(), &mut self.chosen)?;
        for (to, from) in self.spare.iter_mut().zip(&self.chosen) {
            *to = self.states[*from];
        }
        std::mem::swap(&mut self.states, &mut self.spare);
        self.weights.fill(1.0 / count);
        Ok(true)
    }

    /// Mean and covariance: the mean is where the weighted errors about it cancel.
    pub fn moments(&self) -> (S::Of<f64>, Matrix<f64, N, N>) {
        let mut mean = self.states[0];
        for _ in 0..MEAN_ITERATIONS {
            let mut step = [0.0; N];
            for (w, x) in self.weights.iter().zip(&self.states) {
                let d = S::local(&mean, x);
                for i in 0..N {
                    step[i] += w * d[i];
                }
            }
            mean = S::normalise(&S::retract(&mean, &step));
        }
        let mut cov: Matrix<f64, N, N> = zeros();
        for (w, x) in self.weights.iter().zip(&self.states) {
            let d = S::local(&mean, x);
            for i in 0..N {
                for j in 0..N {
                    cov[(i, j)] += w * d[i] * d[j];
                }
            }
        }
        (mean, cov)
    }
}

/// On a flat space one is enough; on rotations the error shrinks with the cube of the spread.
const MEAN_ITERATIONS: usize = 5;

/// A state moved by normal noise with a square root of its covariance.
fn moved<S: Manifold<N>, const N: usize>(x: &S::Of<f64>, root: &Matrix<f64, N, N>, stream: &mut Stream) -> S::Of<f64> {
    let white: Vector<f64, N> = stream.normals();
    S::normalise(&S::retract(x, &apply(root, &white)))
}

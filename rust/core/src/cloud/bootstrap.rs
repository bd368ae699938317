//! The bootstrap filter: particles follow the dynamics and its noise, and are weighed by the likelihood.

use super::weights::Weights;
use super::{Cloud, Settings, Weighing, slot, stacked, white};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::filter::Ekf;
use crate::linalg::{Matrix, apply, cholesky, cholesky_semidefinite, from_fn, symmetric, zeros};
use crate::manifold::{Family, Manifold, components};
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::scalar::Real;
use crate::simulate::rng::Stream;
use std::ops::Range;

/// Bootstrap particle filter, eight particles at a time.
///
/// Resampled particles are copies of few, and only process noise parts them again: where that is small, as
/// on an orbit, they soon stand for less than is uncertain, and the filter is lost. With [`Settings::kernel`] they are
/// drawn from a smooth density instead: normal kernels about particles that are pulled to the mean, which leaves mean and covariance as they were. The kernels' width falls with
/// the number of particles. All memory is taken at the start.
///
/// Sources: Gordon, Salmond, Smith, *Novel approach to nonlinear/non-Gaussian Bayesian state estimation*,
/// 1993; for the kernels Liu, West, *Combined parameter and state estimation in simulation-based filtering*,
/// 2001, with Silverman's width.
pub struct Bootstrap<S: Manifold<N>, T: Real, const N: usize> {
    /// Slots beyond the last particle repeat others and carry no weight.
    states: Vec<S::Of<T::Pack>>,
    spare: Vec<S::Of<T::Pack>>,
    weights: Weights,
    /// A state near the mean: no result depends on it, but the nearer the sooner the mean is found.
    centre: S::Of<T>,
    /// The measurements of an epoch that are used.
    used: Vec<usize>,
    settings: Settings,
    stream: Stream,
}

impl<S: Manifold<N>, T: Real<Mask = bool>, const N: usize> Bootstrap<S, T, N> {
    /// Draws particles of equal weight from a normal distribution.
    ///
    /// # Errors
    /// See [`Settings::check`]; `NotPositiveDefinite` for a covariance that is none.
    pub fn new(
        mean: &S::Of<f64>,
        covariance: &Matrix<f64, N, N>,
        settings: Settings,
        mut stream: Stream,
    ) -> Result<Self> {
        settings.check(N)?;
        let (root, ok) = cholesky(covariance);
        if !ok {
            return Err(Error::NotPositiveDefinite { what: "initial covariance", step: 0, t: f64::NAN });
        }
        let root = from_fn(|i, j| T::Pack::splat(root[(i, j)]));
        let centre = S::map(mean, T::Pack::splat);
        let packs = settings.particles.div_ceil(T::WIDTH);
        let states: Vec<_> = (0..packs).map(|_| moved::<S, T, N>(&centre, &root, &mut stream)).collect();
        let spare = states.clone();
        let (centre, weights) = (S::map(mean, T::splat), Weights::new(settings.particles));
        Ok(Self { states, spare, weights, centre, used: Vec::new(), settings, stream })
    }

    /// One particle.
    pub fn state(&self, i: usize) -> S::Of<T> {
        slot::<S, T>(&self.states[i / T::WIDTH], i % T::WIDTH)
    }

    /// The weights, of sum one.
    pub fn weights(&self) -> &[f64] {
        &self.weights.values
    }

    /// Weights of pack `p`, nothing beyond the last one.
    #[inline(always)]
    fn pack(&self, p: usize) -> T::Pack {
        let values = &self.weights.values;
        T::gather(
            #[inline(always)]
            |k| T::splat(values.get(p * T::WIDTH + k).copied().unwrap_or(0.0)),
        )
    }

    /// Weighted mean and covariance of the particles' errors about a state.
    #[inline(always)]
    fn about(&self, centre: &S::Of<T>) -> ([T; N], Matrix<T, N, N>) {
        let origin = S::map(centre, T::stack);
        let (mut sum, mut outer) = ([T::Pack::zero(); N], zeros::<T::Pack, N, N>());
        for (p, x) in self.states.iter().enumerate() {
            let (d, w) = (S::local(&origin, x), self.pack(p));
            for i in 0..N {
                let weighted = d[i] * w;
                sum[i] += weighted;
                for j in 0..=i {
                    outer[(i, j)] = weighted.mul_add(d[j], outer[(i, j)]);
                }
            }
        }
        (components(|i| T::total(sum[i])), symmetric(|i, j| T::total(outer[(i, j)])))
    }

    #[inline(always)]
    fn gaussian(&self) -> Gaussian<S, T, N> {
        let mut mean = self.centre;
        // on a flat space one step is enough; on rotations the error shrinks with the cube of the spread
        let mut left = 5;
        loop {
            let (step, cov) = self.about(&mean);
            let new = S::normalise(&S::retract(&mean, &step));
            let small = (0..N).all(|i| (cov[(i, i)] * 1e-12 + T::splat(1e-300)).gt(step[i] * step[i]));
            left -= 1;
            if small || left == 0 {
                return Gaussian { mean: new, cov: S::transport(&mean, &step, &cov) };
            }
            mean = new;
        }
    }

    /// Adds the log-likelihoods of the measurements that are used to those of the weights.
    #[inline(always)]
    fn weigh<Q: Sensors<S, N>>(&mut self, sensors: &Q) {
        for (x, logs) in self.states.iter().zip(self.weights.logs.chunks_mut(T::WIDTH)) {
            let mut sum = T::Pack::zero();
            for i in &self.used {
                sum += sensors.log_likelihood::<T::Pack>(*i, x);
            }
            for (k, log) in logs.iter_mut().enumerate() {
                *log += T::extract(sum, k).lane(0);
            }
        }
    }

    /// Particles that live on, if too few are effective.
    #[inline(always)]
    fn resample(&mut self, effective: f64) -> Result<bool> {
        // what the kernels keep is the cloud as weighed, before the weights are made equal
        let wanted = self.settings.kernel && effective < self.weights.fewest(&self.settings);
        let smooth = wanted.then(|| Kernel::new(&self.gaussian(), self.settings.particles));
        if !self.weights.refresh(&self.settings, effective, &mut self.stream)? {
            return Ok(false);
        }
        let (states, chosen) = (&self.states, &self.weights.chosen);
        for (to, chosen) in self.spare.iter_mut().zip(chosen.chunks(T::WIDTH)) {
            *to = stacked::<S, T>(
                chosen.len(),
                #[inline(always)]
                |k| slot::<S, T>(&states[chosen[k] / T::WIDTH], chosen[k] % T::WIDTH),
            );
            if let Some(kernel) = &smooth {
                *to = kernel.draw(to, &mut self.stream);
            }
        }
        std::mem::swap(&mut self.states, &mut self.spare);
        Ok(true)
    }
}

impl<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize> Cloud<D, T, N> for Bootstrap<D::Space, T, N> {
    #[inline(always)]
    fn predict(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) -> bool {
        let centre = dynamics.step(&self.centre, u, t, dt);
        let (origin, input) = (D::Space::map(&centre, T::stack), D::Input::map(u, T::stack));
        let (t, dt) = (t.stack(), dt.stack());
        let (mut sum, mut nothing) = ([T::Pack::zero(); N], T::Pack::zero());
        for p in 0..self.states.len() {
            let x = &self.states[p];
            let root = dynamics.noise_factor(x, &input, t, dt);
            let after = dynamics.step(x, &input, t, dt);
            let new = moved::<D::Space, T, N>(&after, &root, &mut self.stream);
            nothing += D::Space::finite(&new);
            // the mean, on the way
            let (d, w) = (D::Space::local(&origin, &new), self.pack(p));
            for i in 0..N {
                sum[i] = d[i].mul_add(w, sum[i]);
            }
            self.states[p] = new;
        }
        let step = components(|i| T::total(sum[i]));
        self.centre = D::Space::normalise(&D::Space::retract(&centre, &step));
        T::total(nothing).gt(T::splat(-1.0))
    }

    #[inline(always)]
    fn update<Q: Sensors<D::Space, N>>(
        &mut self,
        sensors: &Q,
        epoch: Range<usize>,
        report: &mut impl FnMut(usize, &Report),
    ) -> Result<Weighing> {
        let before = self.gaussian();
        self.used.clear();
        for i in epoch.clone() {
            let mut kalman = before;
            let seen = sensors.update(i, &Ekf::default(), &mut kalman);
            report(i, &seen);
            if !seen.ok || seen.accepted {
                self.used.push(i);
            }
        }
        self.weigh(sensors);
        let Some(log_likelihood) = self.weights.normalise::<T>() else {
            self.weights.restore(self.settings.recover, epoch.start, sensors.time(epoch.start))?;
            return Ok(Weighing::unused(self.weights.effective(), true));
        };
        let effective = self.weights.effective();
        let resampled = self.resample(effective)?;
        Ok(Weighing { effective, log_likelihood, resampled, moved: f64::NAN, recovered: false })
    }

    #[inline(always)]
    fn moments(&self) -> Gaussian<D::Space, T, N> {
        self.gaussian()
    }
}

/// A normal density about each particle, in packs.
struct Kernel<S: Manifold<N>, T: Real, const N: usize> {
    mean: S::Of<T::Pack>,
    /// A square root of its covariance.
    root: Matrix<T::Pack, N, N>,
    /// How much of its distance from the mean a particle keeps.
    shrink: f64,
}

impl<S: Manifold<N>, T: Real, const N: usize> Kernel<S, T, N> {
    #[inline(always)]
    fn new(cloud: &Gaussian<S, T, N>, count: usize) -> Self {
        let n = N as f64;
        let width = (4.0 / ((n + 2.0) * count as f64)).powf(1.0 / (n + 4.0)).min(1.0);
        let root = cholesky_semidefinite(&cloud.cov);
        let root = from_fn(|i, j| (root[(i, j)] * width).stack());
        Self { mean: S::map(&cloud.mean, T::stack), root, shrink: (1.0 - width * width).sqrt() }
    }

    #[inline(always)]
    fn draw(&self, x: &S::Of<T::Pack>, stream: &mut Stream) -> S::Of<T::Pack> {
        let away = S::local(&self.mean, x);
        let kept = components(|i| away[i] * self.shrink);
        moved::<S, T, N>(&S::retract(&self.mean, &kept), &self.root, stream)
    }
}

/// States moved by normal noise with a square root of its covariance.
#[inline(always)]
fn moved<S: Manifold<N>, T: Real, const N: usize>(
    x: &S::Of<T::Pack>,
    root: &Matrix<T::Pack, N, N>,
    stream: &mut Stream,
) -> S::Of<T::Pack> {
    S::normalise(&S::retract(x, &apply(root, &white::<T, N>(stream))))
}

//! The bootstrap filter: particles follow the dynamics and its noise, and are weighed by the likelihood.

use super::weights::Weights;
use super::{Cloud, Settings, Weighing, put, slot};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::filter::Ekf;
use crate::linalg::{Matrix, apply, cholesky, cholesky_semidefinite, from_fn, symmetric, zeros};
use crate::manifold::{Family, Manifold};
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
        Ok(Self { states, spare, weights: Weights::new(settings.particles), settings, stream })
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
        (sum.map(T::total), symmetric(|i, j| T::total(outer[(i, j)])))
    }

    #[inline(always)]
    fn gaussian(&self) -> Gaussian<S, T, N> {
        let mut mean = self.state(0);
        // on a flat space one step is enough; on rotations the error shrinks with the cube of the spread
        for _ in 0..5 {
            let (step, cov) = self.about(&mean);
            mean = S::normalise(&S::retract(&mean, &step));
            let small = (0..N).all(|i| (cov[(i, i)] * 1e-12 + T::splat(1e-300)).gt(step[i] * step[i]));
            if small {
                break;
            }
        }
        Gaussian { mean, cov: self.about(&mean).1 }
    }

    #[inline(always)]
    fn resample(&mut self, effective: f64) -> Result<bool> {
        if effective >= self.settings.threshold * self.settings.particles as f64 {
            return Ok(false);
        }
        let before = self.gaussian();
        self.weights.refresh(&self.settings, effective, &mut self.stream)?;
        let smooth = self.settings.kernel.then(|| Kernel::new(&before, self.settings.particles));
        let count = self.weights.chosen.len();
        for (p, to) in self.spare.iter_mut().enumerate() {
            for k in 0..T::WIDTH {
                let from = self.weights.chosen[(p * T::WIDTH + k).min(count - 1)];
                *to = put::<S, T>(to, k, &self.states[from / T::WIDTH], from % T::WIDTH);
            }
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
        let input = D::Input::map(u, T::stack);
        let (t, dt) = (t.stack(), dt.stack());
        let mut nothing = T::Pack::zero();
        for x in &mut self.states {
            let root = dynamics.noise_factor(x, &input, t, dt);
            let after = dynamics.step(x, &input, t, dt);
            *x = moved::<D::Space, T, N>(&after, &root, &mut self.stream);
            nothing += D::Space::finite(x);
        }
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
        let count = self.weights.logs.len();
        for i in epoch.clone() {
            let mut kalman = before;
            let seen = sensors.update(i, &Ekf::default(), &mut kalman);
            report(i, &seen);
            if seen.ok && !seen.accepted {
                continue;
            }
            for (p, x) in self.states.iter().enumerate() {
                let log = sensors.log_likelihood::<T::Pack>(i, x);
                for k in 0..T::WIDTH.min(count - p * T::WIDTH) {
                    self.weights.logs[p * T::WIDTH + k] += T::extract(log, k).lane(0);
                }
            }
        }
        let Some(log_likelihood) = self.weights.normalise() else {
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
        let kept = S::local(&self.mean, x).map(|d| d * self.shrink);
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
    let white = std::array::from_fn(|_| T::gather(|_| T::splat(stream.normal())));
    S::normalise(&S::retract(x, &apply(root, &white)))
}

//! The unscented particle filter with one Kalman filter as its proposal.

use super::weights::Weights;
use super::{Cloud, Settings, Weighing};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::{Matrix, apply, cholesky, forward_solve, from_fn};
use crate::manifold::{Manifold, components};
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::scalar::{Mask, Real};
use crate::simulate::rng::Stream;
use std::ops::Range;

/// Unscented particle filter: the form to use.
///
/// One unscented Kalman filter predicts to `N(x⁻, P⁻)` and corrects to `N(x̄, P)`. Particles are drawn from the latter in
/// antithetic pairs `x̄ ± L n` and weighed by `p(z | x) N(x; x⁻, P⁻) / N(x; x̄, P)`: by the posterior over the proposal, whose mean
/// they give. The covariance is the Kalman filter's. Where the Kalman filter is right all weights are equal, and
/// the pairs give its mean to the last digit; what remains is the shape of the noise. With moves,
/// particles that were resampled walk by Metropolis steps in the posterior, and the mean is that of all they visit.
///
/// Sources: van der Merwe, Doucet, de Freitas, Wan, *The unscented particle filter*, 2000, with the
/// prediction of the whole filter in place of one particle's transition density, as in Kotecha, Djurić, *Gaussian
/// particle filtering*, 2003.
pub struct Proposal<S: Manifold<N>, T: Real, const N: usize> {
    belief: Gaussian<S, T, N>,
    points: Vec<Point<T, N>>,
    spare: Vec<Point<T, N>>,
    used: Vec<usize>,
    weights: Weights,
    settings: Settings,
    stream: Stream,
}

/// Eight particles.
#[derive(Clone, Copy)]
struct Point<T: Real, const N: usize> {
    /// Error state about the proposal's mean.
    offset: [T::Pack; N],
    /// Logarithm of the posterior.
    target: T::Pack,
}

/// A normal density in packs.
struct Normal<S: Manifold<N>, T: Real, const N: usize> {
    mean: S::Of<T::Pack>,
    root: Matrix<T::Pack, N, N>,
    /// Logarithm of the root's determinant.
    log: f64,
}

impl<S: Manifold<N>, T: Real, const N: usize> Normal<S, T, N> {
    #[inline(always)]
    fn new(belief: &Gaussian<S, T, N>) -> (Self, T::Mask) {
        let (root, ok) = cholesky(&belief.cov);
        let log = (0..N).map(|i| root[(i, i)].lane(0)).product::<f64>().ln();
        (Self { mean: S::map(&belief.mean, T::stack), root: from_fn(|i, j| root[(i, j)].stack()), log }, ok)
    }
}

impl<S: Manifold<N>, T: Real<Mask = bool>, const N: usize> Proposal<S, T, N> {
    /// Starts from a normal distribution.
    ///
    /// # Errors
    /// See [`Settings::check`]; `NotPositiveDefinite` for a covariance that is none.
    pub fn new(mean: &S::Of<f64>, covariance: &Matrix<f64, N, N>, settings: Settings, stream: Stream) -> Result<Self> {
        settings.check(N)?;
        let cov = from_fn(|i, j| T::splat(covariance[(i, j)]));
        let (belief, ok) = settings.ukf.belief::<S, T, N>(S::map(mean, T::splat), &cov);
        if !ok {
            return Err(Error::NotPositiveDefinite { what: "initial covariance", step: 0, t: f64::NAN });
        }
        let nothing = Point { offset: [T::Pack::zero(); N], target: T::Pack::zero() };
        let points = vec![nothing; settings.particles.div_ceil(T::WIDTH)];
        let (spare, weights) = (points.clone(), Weights::new(settings.particles));
        Ok(Self { belief, spare, points, used: Vec::new(), weights, settings, stream })
    }

    /// Draws from the proposal, in pairs; a last particle without partner is the mean itself.
    #[inline(always)]
    fn draw(&mut self, proposal: &Normal<S, T, N>) {
        let count = self.weights.logs.len();
        for p in 0..self.points.len() {
            let first = p * T::WIDTH;
            let mut white = [T::Pack::zero(); N];
            // eight numbers at most, two slots for each
            for pair in 0..T::WIDTH.div_ceil(2) {
                if first + 2 * pair + 1 >= count {
                    continue;
                }
                for w in &mut white {
                    let n = T::splat(self.stream.normal());
                    let old = *w;
                    *w = T::gather(
                        #[inline(always)]
                        |k| {
                            if k == 2 * pair {
                                n
                            } else if k == 2 * pair + 1 {
                                -n
                            } else {
                                T::extract(old, k)
                            }
                        },
                    );
                }
            }
            self.points[p].offset = apply(&proposal.root, &white);
            let square = dot(&white);
            for k in 0..T::WIDTH.min(count - first) {
                self.weights.logs[first + k] = 0.5 * T::extract(square, k).lane(0);
            }
        }
    }

    /// Logarithm of the posterior at offsets from the proposal's mean.
    #[inline(always)]
    fn target<Q: Sensors<S, N>>(
        used: &[usize],
        sensors: &Q,
        (prior, proposal): (&Normal<S, T, N>, &Normal<S, T, N>),
        offset: &[T::Pack; N],
    ) -> T::Pack {
        let x = S::normalise(&S::retract(&proposal.mean, offset));
        let y = forward_solve(&prior.root, &S::local(&prior.mean, &x));
        let mut log = dot(&y) * -0.5;
        for i in used {
            log += sensors.log_likelihood::<T::Pack>(*i, &x);
        }
        log
    }

    /// Weighs particles of the proposal and moves its mean to theirs.
    #[inline(always)]
    fn weigh<Q: Sensors<S, N>>(
        &mut self,
        sensors: &Q,
        (prior, proposal): (&Normal<S, T, N>, &Normal<S, T, N>),
    ) -> Result<Weighing> {
        self.draw(proposal);
        let count = self.weights.logs.len();
        for (p, point) in self.points.iter_mut().enumerate() {
            point.target = Self::target(&self.used, sensors, (prior, proposal), &point.offset);
            for k in 0..T::WIDTH.min(count - p * T::WIDTH) {
                self.weights.logs[p * T::WIDTH + k] += T::extract(point.target, k).lane(0);
            }
        }
        let Some(log) = self.weights.normalise::<T>() else {
            let first = self.used[0];
            // each draw begins with equal weights
            self.weights.values.fill(1.0);
            self.weights.restore(self.settings.recover, first, sensors.time(first))?;
            return Ok(Weighing::unused(0.0, true));
        };
        let log_likelihood = log - (count as f64).ln() + proposal.log - prior.log;
        let effective = self.weights.effective();
        let mut step = self.mean();
        let (mut resampled, mut moved) = (false, f64::NAN);
        if self.settings.moves > 0 && self.resample(effective)? {
            resampled = true;
            (step, moved) = self.walk(sensors, (prior, proposal));
        }
        self.belief.mean = S::normalise(&S::retract(&self.belief.mean, &step));
        Ok(Weighing { effective, log_likelihood, resampled, moved, recovered: false })
    }

    /// Weighted mean of the offsets.
    #[inline(always)]
    fn mean(&self) -> [T; N] {
        let mut sum = [T::Pack::zero(); N];
        let values = &self.weights.values;
        for (p, point) in self.points.iter().enumerate() {
            let w = T::gather(
                #[inline(always)]
                |k| T::splat(values.get(p * T::WIDTH + k).copied().unwrap_or(0.0)),
            );
            for i in 0..N {
                sum[i] = point.offset[i].mul_add(w, sum[i]);
            }
        }
        components(|i| T::total(sum[i]))
    }

    #[inline(always)]
    fn resample(&mut self, effective: f64) -> Result<bool> {
        if !self.weights.refresh(&self.settings, effective, &mut self.stream)? {
            return Ok(false);
        }
        let count = self.weights.chosen.len();
        for (p, to) in self.spare.iter_mut().enumerate() {
            let from = |k: usize| self.weights.chosen[(p * T::WIDTH + k).min(count - 1)];
            let one = |k: usize| &self.points[from(k) / T::WIDTH];
            to.target = T::gather(|k| T::extract(one(k).target, from(k) % T::WIDTH));
            to.offset = components(|i| T::gather(|k| T::extract(one(k).offset[i], from(k) % T::WIDTH)));
        }
        std::mem::swap(&mut self.points, &mut self.spare);
        Ok(true)
    }

    /// Metropolis steps with the proposal's covariance, scaled as is best for normal densities (Roberts,
    /// Gelman, Gilks, 1997). The mean of all particles after each step, and the part of steps taken.
    #[inline(always)]
    fn walk<Q: Sensors<S, N>>(
        &mut self,
        sensors: &Q,
        (prior, proposal): (&Normal<S, T, N>, &Normal<S, T, N>),
    ) -> ([T; N], f64) {
        let scale = 2.38 / (N as f64).sqrt();
        let (mut sum, mut taken) = ([T::zero(); N], 0usize);
        for _ in 0..self.settings.moves {
            for p in 0..self.points.len() {
                let point = self.points[p];
                let white = components(|_| T::gather(|_| T::splat(self.stream.normal() * scale)));
                let step = apply(&proposal.root, &white);
                let offset = components(|i| point.offset[i] + step[i]);
                let target = Self::target(&self.used, sensors, (prior, proposal), &offset);
                let height = T::gather(|_| T::splat((1.0 - self.stream.uniform()).ln()));
                let yes = target.gt(point.target + height);
                for k in 0..T::WIDTH.min(self.weights.logs.len() - p * T::WIDTH) {
                    taken += usize::from(yes.lane(k));
                }
                let select = |i: usize| T::Pack::select(yes, offset[i], point.offset[i]);
                self.points[p] =
                    Point { offset: components(select), target: T::Pack::select(yes, target, point.target) };
            }
            let mean = self.mean();
            for i in 0..N {
                sum[i] += mean[i];
            }
        }
        let moves = self.settings.moves;
        (components(|i| sum[i] * (1.0 / moves as f64)), taken as f64 / (moves * self.weights.logs.len()) as f64)
    }
}

impl<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize> Cloud<D, T, N> for Proposal<D::Space, T, N> {
    #[inline(always)]
    fn predict(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) -> bool {
        self.settings.ukf.predict(&mut self.belief, dynamics, u, t, dt)
    }

    #[inline(always)]
    fn update<Q: Sensors<D::Space, N>>(
        &mut self,
        sensors: &Q,
        epoch: Range<usize>,
        report: &mut impl FnMut(usize, &Report),
    ) -> Result<Weighing> {
        let before = self.belief;
        self.used.clear();
        for i in epoch.clone() {
            let seen = sensors.update(i, &self.settings.ukf, &mut self.belief);
            if !seen.ok {
                let t = sensors.time(i);
                return Err(Error::NotPositiveDefinite { what: "covariance in the update", step: i, t });
            }
            report(i, &seen);
            if seen.accepted {
                self.used.push(i);
            }
        }
        if self.used.is_empty() {
            return Ok(Weighing::unused(self.settings.particles as f64, false));
        }
        let (prior, one) = Normal::<D::Space, T, N>::new(&before);
        let (proposal, two) = Normal::<D::Space, T, N>::new(&self.belief);
        if !one.and(two) {
            let (step, t) = (epoch.start, sensors.time(epoch.start));
            return Err(Error::NotPositiveDefinite { what: "covariance in the update", step, t });
        }
        self.weigh(sensors, (&prior, &proposal))
    }

    #[inline(always)]
    fn moments(&self) -> Gaussian<D::Space, T, N> {
        self.belief
    }
}

/// `xᵀ x`
#[inline(always)]
fn dot<T: Real, const N: usize>(x: &[T; N]) -> T {
    crate::linalg::dot::<T, N>(|i| x[i], |i| x[i])
}

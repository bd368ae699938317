//! The unscented particle filter with one Kalman filter for each particle.

use super::bank::{members, mixture, predict};
use super::weights::Weights;
use super::{Cloud, Settings, Weighing, gathered, slot, stacked, white};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::linalg::{Matrix, apply, cholesky, dot, forward_solve, from_fn};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::scalar::{Mask, Real};
use crate::simulate::rng::Stream;
use std::ops::Range;

/// Unscented particle filter to the letter: an unscented Kalman filter for each particle, a sample of each, weights
/// `p(z | x) p(x | x_before) / N(x; x̄, P)`, resampling, and Metropolis moves of the resampled.
///
/// It is here to be seen, not to be used: each Kalman filter carries the uncertainty of all its past, while the transition
/// density knows the particle's past exactly and is as narrow as one step's process noise. Of samples from the former
/// hardly one lies in the latter, and one particle has all the weight. Mean and covariance are those of eqs 28 and 29:
/// the covariance is the scatter of the particles alone, nothing once they have collapsed.
///
/// Source: Ning, Ma, *Analysis of filtering methods for satellite celestial navigation*, 2010, section 3.3,
/// eqs 27 to 29; van der Merwe, Doucet, de Freitas, Wan, *The unscented particle filter*, 2000.
pub struct Literal<S: Manifold<N>, T: Real, const N: usize> {
    /// The particles, each with the covariance of its Kalman filter.
    beliefs: Vec<Gaussian<S, T, N>>,
    pasts: Vec<Past<S, T, N>>,
    spare: Vec<(Gaussian<S, T, N>, Past<S, T, N>)>,
    used: Vec<usize>,
    weights: Weights,
    settings: Settings,
    stream: Stream,
    /// Whether the particles were sampled after the last prediction.
    fresh: bool,
}

/// Where a particle comes from.
struct Past<S: Manifold<N>, T: Real, const N: usize> {
    /// The transition density: the particle before, moved, and the noise that has come in since.
    came: Gaussian<S, T, N>,
    /// The density that it was drawn from: mean, and covariance.
    drawn: Gaussian<S, T, N>,
    /// Logarithm of its weight's change.
    log: f64,
}

impl<S: Manifold<N>, T: Real, const N: usize> Clone for Past<S, T, N> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<S: Manifold<N>, T: Real, const N: usize> Copy for Past<S, T, N> {}

/// Some samples, and how they would change the weights.
struct Samples<S: Manifold<N>, T: Real, const N: usize> {
    states: S::Of<T::Pack>,
    logs: T::Pack,
    /// Where all densities have a width.
    ok: <T::Pack as Real>::Mask,
}

impl<S: Manifold<N>, T: Real<Mask = bool>, const N: usize> Literal<S, T, N> {
    /// Draws the particles from a normal distribution; each Kalman filter begins with the whole covariance
    /// (eq. 27).
    ///
    /// # Errors
    /// See [`Settings::check`]; `NotPositiveDefinite` for a covariance that is none.
    pub fn new(
        mean: &S::Of<f64>,
        covariance: &Matrix<f64, N, N>,
        settings: Settings,
        mut stream: Stream,
    ) -> Result<Self> {
        let beliefs = members::<S, T, N>(mean, covariance, &settings, &mut stream)?;
        // measurements at the start itself come before any transition: the start stands for one
        let came = |b: &Gaussian<S, T, N>| Gaussian { mean: S::map(mean, T::splat), cov: b.cov };
        let pasts: Vec<_> = beliefs.iter().map(|b| Past { came: came(b), drawn: *b, log: 0.0 }).collect();
        let spare = beliefs.iter().copied().zip(pasts.iter().copied()).collect();
        let weights = Weights::new(settings.particles);
        Ok(Self { beliefs, pasts, spare, used: Vec::new(), weights, settings, stream, fresh: false })
    }

    /// Draws particles from their proposals, eight at a time.
    #[inline(always)]
    fn sample<Q: Sensors<S, N>>(
        pasts: &[Past<S, T, N>],
        sensors: &Q,
        used: &[usize],
        stream: &mut Stream,
    ) -> Samples<S, T, N> {
        let count = pasts.len();
        let (root, one) = cholesky(&gathered(count, |k| &pasts[k].drawn.cov));
        let (narrow, two) = cholesky(&gathered(count, |k| &pasts[k].came.cov));
        let white = white::<T, N>(stream);
        let centre = stacked::<S, T>(
            count,
            #[inline(always)]
            |k| pasts[k].drawn.mean,
        );
        let states = S::normalise(&S::retract(&centre, &apply(&root, &white)));
        let y = forward_solve(
            &narrow,
            &S::local(
                &stacked::<S, T>(
                    count,
                    #[inline(always)]
                    |k| pasts[k].came.mean,
                ),
                &states,
            ),
        );
        let mut widths = T::Pack::one();
        for i in 0..N {
            widths = widths * (root[(i, i)] / narrow[(i, i)]);
        }
        let squares = dot::<_, N>(|i| white[i], |i| white[i]) - dot::<_, N>(|i| y[i], |i| y[i]);
        let mut logs = widths.map(f64::ln) + squares * 0.5;
        for i in used {
            logs += sensors.log_likelihood::<T::Pack>(*i, &states);
        }
        Samples { states, logs, ok: one.and(two) }
    }

    /// Kalman filters of all particles; which measurements were used by all of them.
    #[inline(always)]
    fn filter<Q: Sensors<S, N>>(
        &mut self,
        sensors: &Q,
        epoch: &Range<usize>,
        report: &mut impl FnMut(usize, &Report),
    ) -> Result<()> {
        let heaviest = self.weights.heaviest();
        self.used.clear();
        for i in epoch.clone() {
            let mut accepted = true;
            for (k, belief) in self.beliefs.iter_mut().enumerate() {
                let seen = sensors.update(i, &self.settings.ukf, belief);
                if !seen.ok {
                    return Err(failed("covariance in the update", i, sensors.time(i)));
                }
                accepted &= seen.accepted;
                if k == heaviest {
                    report(i, &seen);
                }
            }
            if accepted {
                self.used.push(i);
            }
        }
        Ok(())
    }

    /// Metropolis moves with each particle's own proposal (van der Merwe et al., section 4.3); the part
    /// accepted.
    #[inline(always)]
    fn walk<Q: Sensors<S, N>>(&mut self, sensors: &Q) -> f64 {
        let mut taken = 0usize;
        let groups = self.beliefs.chunks_mut(T::WIDTH).zip(self.pasts.chunks_mut(T::WIDTH));
        for (beliefs, pasts) in groups {
            for _ in 0..self.settings.moves {
                let new = Self::sample(pasts, sensors, &self.used, &mut self.stream);
                for (k, (belief, past)) in beliefs.iter_mut().zip(pasts.iter_mut()).enumerate() {
                    let log = T::extract(new.logs, k).lane(0);
                    if (1.0 - self.stream.uniform()).ln() < log - past.log {
                        (belief.mean, past.log) = (slot::<S, T>(&new.states, k), log);
                        taken += 1;
                    }
                }
            }
        }
        taken as f64 / (self.settings.moves * self.beliefs.len()) as f64
    }

    /// What the step makes of the transition densities.
    #[inline(always)]
    fn carry<D: Dynamics<N, Space = S>>(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) {
        let input = D::Input::map(u, T::stack);
        let (time, step) = (t.stack(), dt.stack());
        for (beliefs, pasts) in self.beliefs.chunks(T::WIDTH).zip(self.pasts.chunks_mut(T::WIDTH)) {
            let (mean, cov) = if self.fresh {
                let x = stacked::<S, T>(
                    beliefs.len(),
                    #[inline(always)]
                    |k| beliefs[k].mean,
                );
                (dynamics.step(&x, &input, time, step), dynamics.noise(&x, &input, time, step))
            } else {
                let x = stacked::<S, T>(
                    pasts.len(),
                    #[inline(always)]
                    |k| pasts[k].came.mean,
                );
                let p = gathered(pasts.len(), |k| &pasts[k].came.cov);
                dynamics.propagate(&x, &p, &input, time, step)
            };
            for (k, past) in pasts.iter_mut().enumerate() {
                past.came.mean = slot::<S, T>(&mean, k);
                past.came.cov = from_fn(|i, j| T::extract(cov[(i, j)], k));
            }
        }
        self.fresh = false;
    }

    /// Samples all particles from where their Kalman filters are; false where a density has no width.
    #[inline(always)]
    fn draw<Q: Sensors<S, N>>(&mut self, sensors: &Q) -> bool {
        let mut ok = true;
        let groups = self.beliefs.chunks_mut(T::WIDTH).zip(self.pasts.chunks_mut(T::WIDTH));
        for ((beliefs, pasts), logs) in groups.zip(self.weights.logs.chunks_mut(T::WIDTH)) {
            for (belief, past) in beliefs.iter().zip(pasts.iter_mut()) {
                past.drawn = *belief;
            }
            let new = Self::sample(pasts, sensors, &self.used, &mut self.stream);
            ok &= new.ok.all();
            for (k, (belief, past)) in beliefs.iter_mut().zip(pasts.iter_mut()).enumerate() {
                belief.mean = slot::<S, T>(&new.states, k);
                past.log = T::extract(new.logs, k).lane(0);
                logs[k] += past.log;
            }
        }
        self.fresh = true;
        ok
    }
}

impl<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize> Cloud<D, T, N> for Literal<D::Space, T, N> {
    #[inline(always)]
    fn predict(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) -> bool {
        self.carry(dynamics, u, t, dt);
        predict(&self.settings.ukf, &mut self.beliefs, dynamics, u, (t, dt))
    }

    #[inline(always)]
    fn update<Q: Sensors<D::Space, N>>(
        &mut self,
        sensors: &Q,
        epoch: Range<usize>,
        report: &mut impl FnMut(usize, &Report),
    ) -> Result<Weighing> {
        self.filter(sensors, &epoch, report)?;
        if self.used.is_empty() {
            return Ok(Weighing::unused(self.weights.effective(), false));
        }
        let (first, t) = (epoch.start, sensors.time(epoch.start));
        if !self.draw(sensors) {
            return Err(failed("process noise, whose density weighs the particles,", first, t));
        }
        let Some(log_likelihood) = self.weights.normalise() else {
            for (belief, past) in self.beliefs.iter_mut().zip(&self.pasts) {
                belief.mean = past.drawn.mean;
            }
            self.weights.restore(self.settings.recover, first, t)?;
            return Ok(Weighing::unused(self.weights.effective(), true));
        };
        let effective = self.weights.effective();
        let resampled = self.weights.refresh(&self.settings, effective, &mut self.stream)?;
        let mut moved = f64::NAN;
        if resampled {
            for (to, from) in self.spare.iter_mut().zip(&self.weights.chosen) {
                *to = (self.beliefs[*from], self.pasts[*from]);
            }
            for (i, from) in self.spare.iter().enumerate() {
                (self.beliefs[i], self.pasts[i]) = *from;
            }
            if self.settings.moves > 0 {
                moved = self.walk(sensors);
            }
        }
        Ok(Weighing { effective, log_likelihood, resampled, moved, recovered: false })
    }

    #[inline(always)]
    fn moments(&self) -> Gaussian<D::Space, T, N> {
        mixture(&self.weights.values, |k| &self.beliefs[k], false)
    }
}

fn failed(what: &'static str, step: usize, t: f64) -> Error {
    Error::NotPositiveDefinite { what, step, t }
}

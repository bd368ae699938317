//! The unscented particle filter with one Kalman filter for each particle.

use super::bank::{members, mixture, predict};
use super::weights::Weights;
use super::{Cloud, Settings, Weighing, gathered, side_by_side, slot, stacked, white};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::linalg::{Matrix, apply, cholesky, dot, forward_solve, from_fn};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::scalar::elementary::ln;
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
    spare: Vec<Gaussian<S, T, N>>,
    pasts: Vec<Past<S, T, N>>,
    spare_pasts: Vec<Past<S, T, N>>,
    used: Vec<usize>,
    weights: Weights,
    settings: Settings,
    stream: Stream,
    /// Whether the particles were sampled after the last prediction.
    fresh: bool,
}

/// Where the particles of a pack come from.
struct Past<S: Manifold<N>, T: Real, const N: usize> {
    /// The transition densities: the particles before, moved, and the noise that has come in since.
    came: Gaussian<S, T::Pack, N>,
    /// The densities that they were drawn from: mean, and covariance.
    drawn: Gaussian<S, T::Pack, N>,
    /// Logarithms of the changes of their weights.
    logs: T::Pack,
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
        let cov = from_fn(|i, j| T::Pack::splat(covariance[(i, j)]));
        let start = Gaussian { mean: S::map(mean, T::Pack::splat), cov };
        let past = Past { came: start, drawn: start, logs: T::Pack::zero() };
        let pasts = vec![past; settings.particles.div_ceil(T::WIDTH)];
        let (spare, spare_pasts) = (beliefs.clone(), pasts.clone());
        let (used, weights) = (Vec::new(), Weights::new(settings.particles));
        Ok(Self { beliefs, spare, pasts, spare_pasts, used, weights, settings, stream, fresh: false })
    }

    /// Draws eight particles from their proposals.
    #[inline(always)]
    fn sample<Q: Sensors<S, N>>(
        past: &Past<S, T, N>,
        sensors: &Q,
        used: &[usize],
        stream: &mut Stream,
    ) -> Samples<S, T, N> {
        let (root, one) = cholesky(&past.drawn.cov);
        let (narrow, two) = cholesky(&past.came.cov);
        let white = white::<T, N>(stream);
        let states = S::normalise(&S::retract(&past.drawn.mean, &apply(&root, &white)));
        let y = forward_solve(&narrow, &S::local(&past.came.mean, &states));
        let mut widths = T::Pack::one();
        for i in 0..N {
            widths = widths * (root[(i, i)] / narrow[(i, i)]);
        }
        let squares = dot::<_, N>(|i| white[i], |i| white[i]) - dot::<_, N>(|i| y[i], |i| y[i]);
        let mut logs = ln(widths) + squares * 0.5;
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
        for (beliefs, past) in self.beliefs.chunks_mut(T::WIDTH).zip(&mut self.pasts) {
            for _ in 0..self.settings.moves {
                let new = Self::sample(past, sensors, &self.used, &mut self.stream);
                let (mut old, logs) = ([0.0; 8], past.logs);
                for (k, belief) in beliefs.iter_mut().enumerate() {
                    let log = T::extract(new.logs, k).lane(0);
                    old[k] = T::extract(logs, k).lane(0);
                    if (1.0 - self.stream.uniform()).ln() < log - old[k] {
                        (belief.mean, old[k]) = (slot::<S, T>(&new.states, k), log);
                        taken += 1;
                    }
                }
                past.logs = T::gather(|k| T::splat(old[k]));
            }
        }
        taken as f64 / (self.settings.moves * self.beliefs.len()) as f64
    }

    /// What the step makes of the transition densities.
    #[inline(always)]
    fn carry<D: Dynamics<N, Space = S>>(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) {
        let input = D::Input::map(u, T::stack);
        let (time, step) = (t.stack(), dt.stack());
        for (beliefs, past) in self.beliefs.chunks(T::WIDTH).zip(&mut self.pasts) {
            let came = &mut past.came;
            if self.fresh {
                let x = stacked::<S, T>(
                    beliefs.len(),
                    #[inline(always)]
                    |k| beliefs[k].mean,
                );
                came.mean = dynamics.step(&x, &input, time, step);
                came.cov = dynamics.noise(&x, &input, time, step);
            } else {
                (came.mean, came.cov) = dynamics.propagate(&came.mean, &came.cov, &input, time, step);
            }
        }
        self.fresh = false;
    }

    /// Samples all particles from where their Kalman filters are; false where a density has no width.
    #[inline(always)]
    fn draw<Q: Sensors<S, N>>(&mut self, sensors: &Q) -> bool {
        let mut ok = true;
        let groups = self.beliefs.chunks_mut(T::WIDTH).zip(&mut self.pasts);
        for ((beliefs, past), logs) in groups.zip(self.weights.logs.chunks_mut(T::WIDTH)) {
            past.drawn = side_by_side::<S, T, N>(beliefs);
            let new = Self::sample(past, sensors, &self.used, &mut self.stream);
            ok &= new.ok.all();
            past.logs = new.logs;
            for (k, belief) in beliefs.iter_mut().enumerate() {
                belief.mean = slot::<S, T>(&new.states, k);
                logs[k] += T::extract(new.logs, k).lane(0);
            }
        }
        self.fresh = true;
        ok
    }

    /// Particles that live on, and their pasts, which only moves ask for.
    #[inline(always)]
    fn choose(&mut self) {
        let chosen = &self.weights.chosen;
        for (to, from) in self.spare.iter_mut().zip(chosen) {
            *to = self.beliefs[*from];
        }
        std::mem::swap(&mut self.beliefs, &mut self.spare);
        if self.settings.moves == 0 {
            return;
        }
        for (to, chosen) in self.spare_pasts.iter_mut().zip(chosen.chunks(T::WIDTH)) {
            to.came = picked::<S, T, N>(chosen, |p| &self.pasts[p].came);
            to.drawn = picked::<S, T, N>(chosen, |p| &self.pasts[p].drawn);
            let log = |i: usize| T::extract(self.pasts[i / T::WIDTH].logs, i % T::WIDTH);
            to.logs = T::gather(|k| log(chosen[k.min(chosen.len() - 1)]));
        }
        std::mem::swap(&mut self.pasts, &mut self.spare_pasts);
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
        let Some(log_likelihood) = self.weights.normalise::<T>() else {
            for (k, belief) in self.beliefs.iter_mut().enumerate() {
                belief.mean = slot::<D::Space, T>(&self.pasts[k / T::WIDTH].drawn.mean, k % T::WIDTH);
            }
            self.weights.restore(self.settings.recover, first, t)?;
            return Ok(Weighing::unused(self.weights.effective(), true));
        };
        let effective = self.weights.effective();
        let resampled = self.weights.refresh(&self.settings, effective, &mut self.stream)?;
        let mut moved = f64::NAN;
        if resampled {
            self.choose();
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

/// Densities of chosen particles out of packs of them, `of(p)` the p-th one.
#[inline(always)]
fn picked<'a, S: Manifold<N>, T: Real, const N: usize>(
    chosen: &[usize],
    of: impl Fn(usize) -> &'a Gaussian<S, T::Pack, N>,
) -> Gaussian<S, T::Pack, N> {
    let at = |k: usize| (of(chosen[k] / T::WIDTH), chosen[k] % T::WIDTH);
    let mean = |k: usize| {
        let (pack, k) = at(k);
        slot::<S, T>(&pack.mean, k)
    };
    let entry = |k: usize, i: usize, j: usize| {
        let (pack, k) = at(k);
        T::extract(pack.cov[(i, j)], k)
    };
    Gaussian { mean: stacked::<S, T>(chosen.len(), mean), cov: gathered::<T, N>(chosen.len(), entry) }
}

fn failed(what: &'static str, step: usize, t: f64) -> Error {
    Error::NotPositiveDefinite { what, step, t }
}

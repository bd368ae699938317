//! The unscented particle filter with one Kalman filter for each particle.

use super::bank::{members, mixture};
use super::weights::Weights;
use super::{Cloud, Settings, Weighing};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::{Matrix, Vector, apply, cholesky, dot, forward_solve};
use crate::manifold::Manifold;
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::scalar::Real;
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
    members: Vec<Member<S, T, N>>,
    spare: Vec<Member<S, T, N>>,
    used: Vec<usize>,
    weights: Weights,
    settings: Settings,
    stream: Stream,
    /// Whether the particles were sampled after the last prediction.
    fresh: bool,
}

/// A particle and where it comes from.
struct Member<S: Manifold<N>, T: Real, const N: usize> {
    /// The particle, with the covariance of its Kalman filter.
    belief: Gaussian<S, T, N>,
    /// The transition density: the particle before, moved, and the noise that has come in since.
    came: Gaussian<S, T, N>,
    /// The density that it was drawn from.
    centre: S::Of<T>,
    root: Matrix<T, N, N>,
    /// Logarithm of its weight's change.
    log: f64,
}

impl<S: Manifold<N>, T: Real, const N: usize> Clone for Member<S, T, N> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<S: Manifold<N>, T: Real, const N: usize> Copy for Member<S, T, N> {}

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
        let member = |belief: Gaussian<S, T, N>| Member {
            came: came(&belief),
            centre: belief.mean,
            root: belief.cov,
            log: 0.0,
            belief,
        };
        let members: Vec<_> = beliefs.into_iter().map(member).collect();
        let (spare, weights) = (members.clone(), Weights::new(settings.particles));
        Ok(Self { members, spare, used: Vec::new(), weights, settings, stream, fresh: false })
    }

    /// Draws a particle from its proposal, and says how its weight changes; None where a density has no
    /// width.
    #[inline(always)]
    fn sample<Q: Sensors<S, N>>(
        member: &Member<S, T, N>,
        sensors: &Q,
        used: &[usize],
        stream: &mut Stream,
    ) -> Option<(S::Of<T>, f64)> {
        let white: Vector<T, N> = stream.normals().map(T::splat);
        let x = S::normalise(&S::retract(&member.centre, &apply(&member.root, &white)));
        let (narrow, ok) = cholesky(&member.came.cov);
        if !ok {
            return None;
        }
        let y = forward_solve(&narrow, &S::local(&member.came.mean, &x));
        let widths = (0..N).map(|i| (member.root[(i, i)] / narrow[(i, i)]).lane(0)).product::<f64>();
        let squares = dot::<T, N>(|i| white[i], |i| white[i]) - dot::<T, N>(|i| y[i], |i| y[i]);
        let mut log = widths.ln() + 0.5 * squares.lane(0);
        for i in used {
            log += sensors.log_likelihood::<T>(*i, &x).lane(0);
        }
        Some((x, log))
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
            for (k, member) in self.members.iter_mut().enumerate() {
                let seen = sensors.update(i, &self.settings.ukf, &mut member.belief);
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
        for member in &mut self.members {
            for _ in 0..self.settings.moves {
                let Some((x, log)) = Self::sample(member, sensors, &self.used, &mut self.stream) else { continue };
                if (1.0 - self.stream.uniform()).ln() < log - member.log {
                    (member.belief.mean, member.log) = (x, log);
                    taken += 1;
                }
            }
        }
        taken as f64 / (self.settings.moves * self.members.len()) as f64
    }
}

impl<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize> Cloud<D, T, N> for Literal<D::Space, T, N> {
    #[inline(always)]
    fn predict(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) -> bool {
        let mut ok = true;
        for member in &mut self.members {
            if self.fresh {
                let x = &member.belief.mean;
                member.came = Gaussian { mean: dynamics.step(x, u, t, dt), cov: dynamics.noise(x, u, t, dt) };
            } else {
                let (mean, cov) = dynamics.propagate(&member.came.mean, &member.came.cov, u, t, dt);
                member.came = Gaussian { mean, cov };
            }
            ok &= self.settings.ukf.predict(&mut member.belief, dynamics, u, t, dt);
        }
        self.fresh = false;
        ok
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
        for (k, member) in self.members.iter_mut().enumerate() {
            let (root, ok) = cholesky(&member.belief.cov);
            (member.centre, member.root) = (member.belief.mean, root);
            let sample = Self::sample(member, sensors, &self.used, &mut self.stream);
            let (true, Some((x, log))) = (ok, sample) else {
                return Err(failed("process noise, whose density weighs the particles,", first, t));
            };
            (member.belief.mean, member.log) = (x, log);
            self.weights.logs[k] += log;
        }
        self.fresh = true;
        let Some(log_likelihood) = self.weights.normalise() else {
            for member in &mut self.members {
                member.belief.mean = member.centre;
            }
            self.weights.restore(self.settings.recover, first, t)?;
            return Ok(Weighing::unused(self.weights.effective(), true));
        };
        let effective = self.weights.effective();
        let resampled = self.weights.refresh(&self.settings, effective, &mut self.stream)?;
        let mut moved = f64::NAN;
        if resampled {
            for (to, from) in self.spare.iter_mut().zip(&self.weights.chosen) {
                *to = self.members[*from];
            }
            std::mem::swap(&mut self.members, &mut self.spare);
            if self.settings.moves > 0 {
                moved = self.walk(sensors);
            }
        }
        Ok(Weighing { effective, log_likelihood, resampled, moved, recovered: false })
    }

    #[inline(always)]
    fn moments(&self) -> Gaussian<D::Space, T, N> {
        mixture(&self.weights.values, |k| &self.members[k].belief, false)
    }
}

fn failed(what: &'static str, step: usize, t: f64) -> Error {
    Error::NotPositiveDefinite { what, step, t }
}

//! A bank of unscented Kalman filters.

use super::weights::Weights;
use super::{Cloud, Settings, Weighing, side_by_side, slot};
use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::filter::{Filter, Ukf};
use crate::linalg::{Matrix, apply, cholesky, from_fn, symmetric, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::scalar::{Mask, Real};
use crate::simulate::rng::Stream;
use std::ops::Range;

/// Unscented Kalman filters from different starts, weighed by how well each predicts the measurements; mean
/// and covariance are those of the mixture. As all of them see the same measurements they soon agree, and the bank
/// is one unscented Kalman filter that costs as much as all.
///
/// Source: one reading of the unscented particle filter of Ning, Ma, *Analysis of filtering methods for
/// satellite celestial navigation*, 2010, section 3.3; for weights by innovations, Sorenson, Alspach, *Recursive
/// Bayesian estimation using Gaussian sums*, 1971.
pub struct Bank<S: Manifold<N>, T: Real, const N: usize> {
    members: Vec<Gaussian<S, T, N>>,
    spare: Vec<Gaussian<S, T, N>>,
    weights: Weights,
    settings: Settings,
    stream: Stream,
}

/// Members about a start that is itself drawn for each of them.
pub(super) fn members<S: Manifold<N>, T: Real<Mask = bool>, const N: usize>(
    mean: &S::Of<f64>,
    covariance: &Matrix<f64, N, N>,
    settings: &Settings,
    stream: &mut Stream,
) -> Result<Vec<Gaussian<S, T, N>>> {
    settings.check(N)?;
    let (root, ok) = cholesky(covariance);
    if !ok {
        return Err(Error::NotPositiveDefinite { what: "initial covariance", step: 0, t: f64::NAN });
    }
    let cov = from_fn(|i, j| T::splat(covariance[(i, j)]));
    let one = |_| {
        let x = S::normalise(&S::retract(mean, &apply(&root, &stream.normals())));
        Gaussian { mean: S::map(&x, T::splat), cov }
    };
    Ok((0..settings.particles).map(one).collect())
}

/// Predicts all, eight at a time.
#[inline(always)]
pub(super) fn predict<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize>(
    ukf: &Ukf,
    members: &mut [Gaussian<D::Space, T, N>],
    dynamics: &D,
    u: &Input<D, T, N>,
    (t, dt): (T, T),
) -> bool {
    let input = D::Input::map(u, T::stack);
    let mut ok = true;
    for group in members.chunks_mut(T::WIDTH) {
        let mut pack = side_by_side::<D::Space, T, N>(group);
        ok &= ukf.predict(&mut pack, dynamics, &input, t.stack(), dt.stack()).all();
        for (k, member) in group.iter_mut().enumerate() {
            member.mean = slot::<D::Space, T>(&pack.mean, k);
            member.cov = symmetric(|i, j| T::extract(pack.cov[(i, j)], k));
        }
    }
    ok
}

/// Mean and covariance of a mixture; without the parts' own covariance unless `own`.
#[inline(always)]
pub(super) fn mixture<'a, S: Manifold<N>, T: Real<Mask = bool>, const N: usize>(
    weights: &[f64],
    part: impl Fn(usize) -> &'a Gaussian<S, T, N>,
    own: bool,
) -> Gaussian<S, T, N> {
    let mut mean = part(0).mean;
    // on a flat space one step is enough
    for _ in 0..3 {
        let mut step = [T::zero(); N];
        for (k, w) in weights.iter().enumerate() {
            let d = S::local(&mean, &part(k).mean);
            for i in 0..N {
                step[i] += d[i] * *w;
            }
        }
        mean = S::normalise(&S::retract(&mean, &step));
    }
    let mut cov = zeros::<T, N, N>();
    for (k, w) in weights.iter().enumerate() {
        let d = S::local(&mean, &part(k).mean);
        let within = if own { S::transport_back(&mean, &d, &part(k).cov) } else { zeros() };
        for i in 0..N {
            for j in 0..N {
                cov[(i, j)] += d[i].mul_add(d[j], within[(i, j)]) * *w;
            }
        }
    }
    Gaussian { mean, cov }
}

impl<S: Manifold<N>, T: Real<Mask = bool>, const N: usize> Bank<S, T, N> {
    /// Draws the starts from a normal distribution; each filter begins with the whole covariance.
    ///
    /// # Errors
    /// See [`Settings::check`]; `NotPositiveDefinite` for a covariance that is none.
    pub fn new(
        mean: &S::Of<f64>,
        covariance: &Matrix<f64, N, N>,
        settings: Settings,
        mut stream: Stream,
    ) -> Result<Self> {
        let members = members(mean, covariance, &settings, &mut stream)?;
        let spare = members.clone();
        Ok(Self { members, spare, weights: Weights::new(settings.particles), settings, stream })
    }
}

impl<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize> Cloud<D, T, N> for Bank<D::Space, T, N> {
    #[inline(always)]
    fn predict(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) -> bool {
        predict(&self.settings.ukf, &mut self.members, dynamics, u, (t, dt))
    }

    #[inline(always)]
    fn update<Q: Sensors<D::Space, N>>(
        &mut self,
        sensors: &Q,
        epoch: Range<usize>,
        report: &mut impl FnMut(usize, &Report),
    ) -> Result<Weighing> {
        let heaviest = self.weights.heaviest();
        let mut used = false;
        for i in epoch.clone() {
            for (k, member) in self.members.iter_mut().enumerate() {
                let seen = sensors.update(i, &self.settings.ukf, member);
                if !seen.ok {
                    let t = sensors.time(i);
                    return Err(Error::NotPositiveDefinite { what: "covariance in the update", step: i, t });
                }
                if k == heaviest {
                    report(i, &seen);
                }
                if seen.accepted {
                    used = true;
                    let numbers = seen.dof as f64 * std::f64::consts::TAU.ln();
                    self.weights.logs[k] -= 0.5 * (seen.nis + seen.determinant().ln() + numbers);
                }
            }
        }
        if !used {
            return Ok(Weighing::unused(self.weights.effective(), false));
        }
        let Some(log_likelihood) = self.weights.normalise::<T>() else {
            self.weights.restore(self.settings.recover, epoch.start, sensors.time(epoch.start))?;
            return Ok(Weighing::unused(self.weights.effective(), true));
        };
        let effective = self.weights.effective();
        let resampled = self.weights.refresh(&self.settings, effective, &mut self.stream)?;
        if resampled {
            for (to, from) in self.spare.iter_mut().zip(&self.weights.chosen) {
                *to = self.members[*from];
            }
            std::mem::swap(&mut self.members, &mut self.spare);
        }
        Ok(Weighing { effective, log_likelihood, resampled, moved: f64::NAN, recovered: false })
    }

    #[inline(always)]
    fn moments(&self) -> Gaussian<D::Space, T, N> {
        mixture(&self.weights.values, |k| &self.members[k], true)
    }
}

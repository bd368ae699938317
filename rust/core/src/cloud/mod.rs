//! Particle filters: what is known of a state, carried by samples of it.
//!
//! [`Proposal`] is the unscented particle filter to use: one unscented Kalman filter says where to sample, the weights
//! say what the Kalman filter got wrong. [`Literal`] and [`Bank`] are the two other readings of the same name,
//! [`Bootstrap`] is the plain filter that samples the dynamics. They are replayed by [`crate::replay::Sampled`].
//!
//! Weights are logarithms throughout, so that a measurement far from every particle still tells them
//! apart. Where all likelihoods are zero or one is not a number there is nothing to tell: with
//! [`Settings::recover`] the measurements of that time are then used as the Kalman filter would
//! ([`Proposal`], [`Literal`]) or left out ([`Bootstrap`]; for [`Bank`] it cannot happen), and
//! [`Weighing::recovered`] says so; without it that is an error which names the measurement.

mod bank;
mod bootstrap;
mod literal;
mod proposal;
mod weights;

pub use bank::Bank;
pub use bootstrap::Bootstrap;
pub use literal::Literal;
pub use proposal::Proposal;

use crate::belief::Gaussian;
use crate::error::{Error, Result};
use crate::filter::Ukf;
use crate::linalg::{Matrix, Vector, symmetric};
use crate::manifold::{Family, components};
use crate::model::{Dynamics, Input};
use crate::replay::{Report, Sensors};
use crate::resample::Resampling;
use crate::scalar::Real;
use crate::simulate::rng::Stream;
use std::ops::Range;

/// A particle filter at work. The scalar is that of one particle; eight of them run in its pack.
pub trait Cloud<D: Dynamics<N>, T: Real<Mask = bool>, const N: usize> {
    /// Moves all from `t` to `t + dt`; false where that fails.
    fn predict(&mut self, dynamics: &D, u: &Input<D, T, N>, t: T, dt: T) -> bool;

    /// Corrects by the measurements `epoch`, all of one time. `report` gets what a Kalman filter would say of
    /// each of them, before it is used.
    ///
    /// # Errors
    /// `Vanished` and `NotPositiveDefinite`, with the number of the measurement and its time.
    fn update<Q: Sensors<D::Space, N>>(
        &mut self,
        sensors: &Q,
        epoch: Range<usize>,
        report: &mut impl FnMut(usize, &Report),
    ) -> Result<Weighing>;

    /// Mean, and covariance of the error.
    fn moments(&self) -> Gaussian<D::Space, T, N>;
}

/// How the weights came out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighing {
    /// Effective number of particles before resampling.
    pub effective: f64,
    /// Logarithm of the probability density of the measurements, given those before them, up to a constant.
    pub log_likelihood: f64,
    /// Whether they were resampled.
    pub resampled: bool,
    /// Part of the Metropolis moves that were accepted; not a number without moves.
    pub moved: f64,
    /// Whether the weights vanished, and the rule for that was used.
    pub recovered: bool,
}

impl Weighing {
    /// Of measurements that were not used, or whose weights vanished.
    #[inline(always)]
    fn unused(effective: f64, recovered: bool) -> Self {
        Self { effective, log_likelihood: 0.0, resampled: false, moved: f64::NAN, recovered }
    }
}

/// What all particle filters share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How many particles.
    pub particles: usize,
    /// How to resample.
    pub resampling: Resampling,
    /// Resample if fewer than this part of the particles are effective: 0 never, 1 nearly always.
    pub threshold: f64,
    /// Metropolis moves of each particle after resampling.
    pub moves: usize,
    /// Whether [`Bootstrap`] draws resampled particles from a smooth density.
    pub kernel: bool,
    /// The Kalman filters of the particles.
    pub ukf: Ukf,
    /// Whether to go on where all weights vanish.
    pub recover: bool,
}

impl Default for Settings {
    fn default() -> Self {
        let (resampling, ukf) = (Resampling::Systematic, Ukf::default());
        Self { particles: 20, resampling, threshold: 0.5, moves: 0, kernel: true, ukf, recover: true }
    }
}

impl Settings {
    /// # Errors
    /// `Parameter` for no particles, a threshold that is no part of one, or sigma points that do not exist
    /// for `n` error states.
    pub fn check(&self, n: usize) -> Result<()> {
        if self.particles == 0 {
            return Err(Error::Parameter { field: "particles", value: 0.0, need: "must be at least 1" });
        }
        if !(0.0..=1.0).contains(&self.threshold) {
            let need = "must be between 0 (never resample) and 1";
            return Err(Error::Parameter { field: "threshold", value: self.threshold, need });
        }
        self.ukf.weights.check(n)
    }
}

/// One number of each slot of a record of packs.
#[inline(always)]
fn slot<S: Family, T: Real>(pack: &S::Of<T::Pack>, slot: usize) -> S::Of<T> {
    S::map(pack, |c| T::extract(c, slot))
}

/// Writes slot `K` of a record of packs, if there is one.
#[inline(always)]
fn put<S: Family, T: Real, const K: usize>(pack: &S::Of<T::Pack>, one: &S::Of<T>) -> S::Of<T::Pack> {
    if K >= T::WIDTH {
        return *pack;
    }
    S::zip(pack, one, |a, b| {
        T::gather(
            #[inline(always)]
            |k| if k == K { b } else { T::extract(a, k) },
        )
    })
}

/// Records side by side in a pack, the last of them in the slots that are left.
#[inline(always)]
fn stacked<S: Family, T: Real>(count: usize, of: impl Fn(usize) -> S::Of<T>) -> S::Of<T::Pack> {
    let last = count - 1;
    // written out: to write a slot whose number is known takes one instruction
    let pack = S::map(&of(0), T::stack);
    let pack = put::<S, T, 1>(&pack, &of(last.min(1)));
    let pack = put::<S, T, 2>(&pack, &of(last.min(2)));
    let pack = put::<S, T, 3>(&pack, &of(last.min(3)));
    let pack = put::<S, T, 4>(&pack, &of(last.min(4)));
    let pack = put::<S, T, 5>(&pack, &of(last.min(5)));
    let pack = put::<S, T, 6>(&pack, &of(last.min(6)));
    put::<S, T, 7>(&pack, &of(last.min(7)))
}

/// Standard normal numbers, those of a component together.
#[inline(always)]
fn white<T: Real, const N: usize>(stream: &mut Stream) -> Vector<T::Pack, N> {
    components(|_| T::gather(|_| T::splat(stream.normal())))
}

/// Symmetric matrices side by side, likewise; `of` gives an entry of one of them.
#[inline(always)]
fn gathered<T: Real, const N: usize>(count: usize, of: impl Fn(usize, usize, usize) -> T) -> Matrix<T::Pack, N, N> {
    symmetric(|i, j| {
        T::gather(
            #[inline(always)]
            |k| of(k.min(count - 1), i, j),
        )
    })
}

/// Beliefs side by side, likewise.
#[inline(always)]
fn side_by_side<S: Family, T: Real, const N: usize>(group: &[Gaussian<S, T, N>]) -> Gaussian<S, T::Pack, N> {
    let mean = stacked::<S, T>(
        group.len(),
        #[inline(always)]
        |k| group[k].mean,
    );
    let cov = gathered::<T, N>(
        group.len(),
        #[inline(always)]
        |k, i, j| group[k].cov[(i, j)],
    );
    Gaussian { mean, cov }
}

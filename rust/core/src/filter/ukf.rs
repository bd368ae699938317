//! Unscented Kalman filter on a manifold.

use super::sigma::{Moments, Unscented, joint, packs, points};
use super::{Filter, cast};
use crate::belief::{Belief, Gaussian, Joint, Outcome};
use crate::linalg::{Matrix, add, apply, cholesky, dot, from_fn, gain, symmetric, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::scalar::{Mask, Real};

/// Unscented Kalman filter: sigma points of the error state go through the full model; points are
/// drawn anew for the update, so that it sees the process noise.
///
/// Sources: Julier, Uhlmann, 2004; Crassidis, Markley, *Unscented filtering for spacecraft attitude
/// estimation*, 2003; for the form on manifolds, Brossard et al., 2020.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ukf {
    /// Weights of the unscented transform.
    pub weights: Unscented,
}

impl Filter for Ukf {
    type Belief<S: Manifold<N>, T: Real, const N: usize> = Gaussian<S, T, N>;

    #[inline(always)]
    fn cast<S: Manifold<N>, A: Real, B: Real, const N: usize>(belief: &Gaussian<S, A, N>) -> Gaussian<S, B, N> {
        Gaussian { mean: S::map(&belief.mean, cast), cov: from_fn(|i, j| cast(belief.cov[(i, j)])) }
    }

    #[inline(always)]
    fn predict<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &mut Gaussian<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> T::Mask {
        let spread = self.weights.spread(N);
        let (root, factored) = cholesky(&belief.cov);
        let x = D::Space::map(&belief.mean, T::stack);
        let input = D::Input::map(u, T::stack);
        let (time, step) = (t.stack(), dt.stack());

        let mut centre = belief.mean;
        let mut origin = x;
        let mut moments = Moments::<T, N>::new();
        for p in 0..packs::<T, N>() {
            let point = D::Space::retract(&x, &points::<T, N>(&root, spread.sqrt(), p));
            let image = dynamics.step(&point, &input, time, step);
            if p == 0 {
                centre = D::Space::map(&image, |c| T::extract(c, 0));
                origin = D::Space::map(&centre, T::stack);
            }
            moments.add(&D::Space::local(&origin, &image));
        }
        let (mean, cov) = moments.finish(0.5 / spread, self.weights.mean_weight());
        let new = Gaussian {
            mean: D::Space::normalise(&D::Space::retract(&centre, &mean)),
            cov: add(&D::Space::transport(&centre, &mean, &cov), &dynamics.noise(&belief.mean, u, t, dt)),
        };
        let ok = factored.and(new.finite());
        *belief = Belief::select(ok, &new, belief);
        ok
    }

    #[inline(always)]
    fn joint<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &Gaussian<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> (Joint<D::Space, T, N>, T::Mask) {
        let (root, ok) = cholesky(&belief.cov);
        (joint(&self.weights, (&belief.mean, &root), dynamics, u, t, dt), ok)
    }

    #[inline(always)]
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut Gaussian<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        gate: T,
    ) -> Outcome<T, M> {
        let spread = self.weights.spread(N);
        let (root, factored) = cholesky(&belief.cov);
        let x = H::Space::map(&belief.mean, T::stack);
        let known = H::Given::map(given, T::stack);
        let centre = sensor.predict(&belief.mean, given);
        let origin = H::Value::map(&centre, T::stack);

        let mut moments = Moments::<T, M>::new();
        let mut cross: Matrix<T::Pack, N, M> = zeros();
        for p in 0..packs::<T, N>() {
            let d = points::<T, N>(&root, spread.sqrt(), p);
            let e = sensor.residual(&sensor.predict(&H::Space::retract(&x, &d), &known), &origin);
            moments.add(&e);
            for j in 0..M {
                for i in 0..N {
                    cross[(i, j)] = d[i].mul_add(e[j], cross[(i, j)]);
                }
            }
        }
        let weight = 0.5 / spread;
        let (bias, spread_of_images) = moments.finish(weight, self.weights.mean_weight());
        let covariance = add(&spread_of_images, &sensor.noise(given));
        let cross: Matrix<T, N, M> = from_fn(|i, j| T::total(cross[(i, j)]) * weight);

        let mut innovation = sensor.residual(z, &centre);
        for i in 0..M {
            innovation[i] -= bias[i];
        }
        let (gain, nis, solved) = gain(&cross, &covariance, &innovation);
        let step = apply(&gain, &innovation);
        let cov = symmetric(|i, j| belief.cov[(i, j)] - dot::<T, M>(|m| gain[(i, m)], |m| cross[(j, m)]));
        let new = Gaussian {
            mean: H::Space::normalise(&H::Space::retract(&belief.mean, &step)),
            cov: H::Space::transport(&belief.mean, &step, &cov),
        };
        let ok = factored.and(solved).and(new.healthy());
        let accepted = ok.and(gate.gt(nis));
        *belief = Belief::select(accepted, &new, belief);
        Outcome { ok, accepted, innovation, covariance, nis }
    }
}

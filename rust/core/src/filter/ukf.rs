//! Unscented Kalman filter on a manifold.

use super::sigma::{Images, Spread, Unscented, joint};
use super::{Ekf, Filter, cast};
use crate::belief::{Belief, Gaussian, Joint, Outcome};
use crate::linalg::{add, cholesky, from_fn, symmetric};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::packed::{Packed, gain};
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
        let (root, factored) = cholesky(&belief.cov);
        let moved = Spread::<D, T, N>::new(&self.weights, (&belief.mean, &root), dynamics, u, t, dt);
        let cov = moved.covariance(&self.weights, |i, j| belief.cov[(i, j)]);
        let new = Gaussian {
            mean: moved.state(),
            cov: add(&D::Space::transport(&moved.centre, &moved.mean, &cov), &dynamics.noise(&belief.mean, u, t, dt)),
        };
        let ok = factored.and(new.finite());
        belief.take(ok, &new);
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
        let linear = sensor.linear(&belief.cov, self.weights.spread(N));
        if linear.all() {
            return Ekf::default().update(belief, sensor, given, z, gate);
        }
        let mut other = *belief;
        let mut outcome = self.sampled(&mut other, sensor, given, z, gate);
        if linear.any() {
            // each lane by itself, whatever its neighbours are
            let straight = Ekf::default().update(belief, sensor, given, z, gate);
            outcome.take(linear, &straight);
            other.take(linear, belief);
        }
        *belief = other;
        outcome
    }
}

impl Ukf {
    /// The update by sigma points.
    #[inline(always)]
    fn sampled<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
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
        let images = Images::<T, N, M>::new(
            &root,
            spread.sqrt(),
            #[inline(always)]
            |d| sensor.residual(&sensor.predict(&H::Space::retract(&x, d), &known), &origin),
        );
        let (weight, of_mean) = (0.5 / spread, self.weights.mean_weight());
        let bias = images.mean(weight, 0);
        let noise = sensor.noise(given);
        let covariance =
            symmetric(|i, j| (bias[i] * of_mean).mul_add(bias[j], images.covariance(i, j, weight)) + noise[(i, j)]);
        let cross = images.cross(&root, spread.sqrt(), weight);

        let mut innovation = sensor.residual(z, &centre);
        for i in 0..M {
            innovation[i] -= bias[i];
        }
        let (gain, nis, solved) = gain(&cross, &covariance, &innovation);
        let step = gain.apply(&innovation);
        let cov = Packed::new(&belief.cov).minus(&gain, |m, j| cross[(j, m)]).symmetric();
        let new = Gaussian {
            mean: H::Space::normalise(&H::Space::retract(&belief.mean, &step)),
            cov: H::Space::transport(&belief.mean, &step, &cov),
        };
        let ok = factored.and(solved).and(new.healthy());
        let accepted = ok.and(gate.gt(nis));
        belief.take(accepted, &new);
        Outcome { ok, accepted, innovation, covariance, nis }
    }
}

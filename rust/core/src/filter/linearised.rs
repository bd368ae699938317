//! The linear Kalman filter in the tangent space at a point that stays.

use super::ekf::joseph;
use super::{Ekf, Filter, cast};
use crate::belief::{Belief, Gaussian, Joint, Outcome, Tangent};
use crate::linalg::{add, apply, from_fn, transpose};
use crate::manifold::Manifold;
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::packed::gain;
use crate::scalar::{Mask, Real};

/// Kalman filter linearised about a given trajectory instead of its own estimates: the step inside
/// every Gauss-Newton iteration. Measurements are used whatever the gate says: whoever chose the
/// trajectory has chosen them, too.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Linearised;

impl Filter for Linearised {
    type Belief<S: Manifold<N>, T: Real, const N: usize> = Tangent<S, T, N>;

    #[inline(always)]
    fn cast<S: Manifold<N>, A: Real, B: Real, const N: usize>(b: &Tangent<S, A, N>) -> Tangent<S, B, N> {
        Tangent { point: S::map(&b.point, cast), offset: b.offset.map(cast), cov: from_fn(|i, j| cast(b.cov[(i, j)])) }
    }

    #[inline(always)]
    fn predict<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &mut Tangent<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> T::Mask {
        let offset = apply(&dynamics.transition(&belief.point, u, t, dt), &belief.offset);
        let (point, cov) = dynamics.propagate(&belief.point, &belief.cov, u, t, dt);
        let new = Tangent { point, offset, cov };
        let ok = new.finite();
        belief.take(ok, &new);
        ok
    }

    #[inline(always)]
    fn joint<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &Tangent<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> (Joint<D::Space, T, N>, T::Mask) {
        let about_the_point = Gaussian { mean: belief.point, cov: belief.cov };
        Ekf::default().joint(&about_the_point, dynamics, u, t, dt)
    }

    #[inline(always)]
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut Tangent<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        _gate: T,
    ) -> Outcome<T, M> {
        let x = &belief.point;
        let h = sensor.jacobian(x, given);
        let noise = sensor.noise(given);
        let pht = sensor.project::<T, N>(&h, &belief.cov);
        let hpht = sensor.project::<T, M>(&h, &transpose(&pht));
        let expected = apply(&h, &belief.offset);
        let mut innovation = sensor.residual(z, &sensor.predict(x, given));
        for i in 0..M {
            innovation[i] -= expected[i];
        }
        let covariance = add(&hpht, &noise);
        let (gain, nis, factored) = gain(&pht, &covariance, &innovation);
        let step = gain.apply(&innovation);
        let mut offset = belief.offset;
        for i in 0..N {
            offset[i] += step[i];
        }
        let new = Tangent { point: *x, offset, cov: joseph(&belief.cov, &gain, &pht, &hpht, &noise) };
        let ok = factored.and(new.healthy());
        belief.take(ok, &new);
        Outcome { ok, accepted: ok, innovation, covariance, nis }
    }
}

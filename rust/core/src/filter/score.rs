//! The score-function filter: a Kalman filter that knows the shape of the noise.

use super::ekf::joseph;
use super::{Ekf, Filter};
use crate::belief::{Belief, Gaussian, Joint, Outcome};
use crate::linalg::{Matrix, add, from_fn, transpose};
use crate::manifold::Manifold;
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::packed::gain;
use crate::scalar::{Mask, Real};

/// Score-function (Masreliez) filter: predicts as [`Ekf`]; a scalar measurement corrects by the exact
/// posterior moments of its signal under the noise it really has ([`Measurement::posterior`]), a larger
/// one, or one of normal noise, as [`Ekf`] does.
///
/// With the signal's variance `s = H P Hᵀ`, posterior mean `m` and variance `v`:
/// `x += P Hᵀ m / s`, `P ← (I − G H) P (I − G H)ᵀ + G v Gᵀ` with `G = P Hᵀ / s`.
///
/// Source: Masreliez, *Approximate non-Gaussian filtering with linear state and observation relations*,
/// 1975.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score;

impl Filter for Score {
    moves_as_ekf!();

    #[inline(always)]
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut Gaussian<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        gate: T,
    ) -> Outcome<T, M> {
        if M != 1 {
            return Ekf::default().update(belief, sensor, given, z, gate);
        }
        let (x, p) = (&belief.mean, &belief.cov);
        let h = sensor.jacobian(x, given);
        let innovation = sensor.residual(z, &sensor.predict(x, given));
        let pht = sensor.project::<T, N>(&h, p);
        let signal = sensor.project::<T, M>(&h, &transpose(&pht));
        let covariance = add(&signal, &sensor.noise(given));
        let (_, nis, known) = gain(&pht, &covariance, &innovation);

        // the gain that would follow the signal itself; what is left of its variance is put back
        let (follow, _, seen) = gain(&pht, &signal, &innovation);
        let (mean, variance) = sensor.posterior(innovation[0], signal[(0, 0)], given);
        let left: Matrix<T, M, M> = from_fn(|_, _| variance);
        let step = follow.apply(&[mean; M]);
        let cov = joseph(p, &follow, &pht, &signal, &left);
        let new = Gaussian {
            mean: H::Space::normalise(&H::Space::retract(x, &step)),
            cov: H::Space::transport(x, &step, &cov),
        };
        let ok = known.and(seen).and(variance.gt(T::zero())).and(new.healthy());
        let accepted = ok.and(gate.gt(nis));
        belief.take(accepted, &new);
        Outcome { ok, accepted, innovation, covariance, nis }
    }
}

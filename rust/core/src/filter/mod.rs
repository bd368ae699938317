//! Filters: values that work on any dynamics and any measurement.

/// What filters that know a state as [`Ekf`] does, and move it as that does, take over from it.
macro_rules! moves_as_ekf {
    () => {
        type Belief<S: Manifold<N>, T: Real, const N: usize> = Gaussian<S, T, N>;

        #[inline(always)]
        fn cast<S: Manifold<N>, A: Real, B: Real, const N: usize>(belief: &Gaussian<S, A, N>) -> Gaussian<S, B, N> {
            Ekf::cast::<S, A, B, N>(belief)
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
            Ekf::default().predict(belief, dynamics, u, t, dt)
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
            Ekf::default().joint(belief, dynamics, u, t, dt)
        }
    };
}

mod ekf;
mod iterated;
mod linearised;
mod score;
mod sigma;
mod srukf;
mod ukf;

pub use ekf::Ekf;
pub use iterated::Iterated;
pub use linearised::Linearised;
pub use score::Score;
pub use sigma::Unscented;
pub use srukf::SrUkf;
pub use ukf::Ukf;

use crate::belief::{Belief, Joint, Outcome};
use crate::linalg::Matrix;
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::replay::{Drive, Past, Report, Sensors, Window};
use crate::scalar::Real;

/// A recursive filter. Each step computes first and assigns last: where it fails (the mask it
/// returns is false) the belief is as it was.
pub trait Filter: Copy {
    /// How it represents what it knows.
    type Belief<S: Manifold<N>, T: Real, const N: usize>: Belief<S, T, N>;

    /// A belief from a state and the covariance of its error; false where that is not positive
    /// definite.
    #[inline(always)]
    fn belief<S: Manifold<N>, T: Real, const N: usize>(
        &self,
        mean: <S as Family>::Of<T>,
        covariance: &Matrix<T, N, N>,
    ) -> (Self::Belief<S, T, N>, T::Mask) {
        Self::Belief::<S, T, N>::new(mean, covariance)
    }

    /// The same belief over another scalar, from the first lane.
    fn cast<S: Manifold<N>, A: Real, B: Real, const N: usize>(belief: &Self::Belief<S, A, N>) -> Self::Belief<S, B, N>;

    /// Moves the belief from `t` to `t + dt`.
    fn predict<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &mut Self::Belief<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> T::Mask;

    /// The prediction of [`Self::predict`] together with its correlation with the belief, for smoothing;
    /// false where it fails.
    fn joint<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &Self::Belief<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> (Joint<D::Space, T, N>, T::Mask);

    /// Corrects the belief by a measurement, if its normalised innovation squared is below `gate`.
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut Self::Belief<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        gate: T,
    ) -> Outcome<T, M>;

    /// Corrects the belief by measurement `i` of a log, at time `t` in the interval after input sample `k`.
    /// Override it to go back over the log, as [`Iterated`] does.
    #[inline(always)]
    fn correct<D: Dynamics<N>, I: Drive<D, N>, Q: Sensors<D::Space, N>, T: Real<Mask = bool>, const N: usize>(
        &self,
        log: &Past<'_, D, I, Q>,
        _window: &mut Window<Self::Belief<D::Space, T, N>>,
        belief: &mut Self::Belief<D::Space, T, N>,
        (_t, _k, i): (f64, usize, usize),
    ) -> Report {
        log.sensors.update(i, self, belief)
    }
}

/// The same number over another scalar, from the first lane.
#[inline(always)]
fn cast<A: Real, B: Real>(x: A) -> B {
    B::splat(x.lane(0))
}

//! Filters: values that work on any dynamics and any measurement.

mod ekf;
mod sigma;
mod srukf;
mod ukf;

pub use ekf::Ekf;
pub use sigma::Unscented;
pub use srukf::SrUkf;
pub use ukf::Ukf;

use crate::belief::{Belief, Outcome};
use crate::linalg::Matrix;
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
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

    /// Corrects the belief by a measurement, if its normalised innovation squared is below `gate`.
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut Self::Belief<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        gate: T,
    ) -> Outcome<T, M>;
}

/// The same number over another scalar, from the first lane.
#[inline(always)]
fn cast<A: Real, B: Real>(x: A) -> B {
    B::splat(x.lane(0))
}

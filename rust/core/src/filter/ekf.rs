//! Extended Kalman filter on a manifold: for an attitude, the multiplicative EKF.

use super::{Filter, cast};
use crate::belief::{Gaussian, Joint, Outcome, finite, healthy};
use crate::linalg::{
    Matrix, Vector, add, block, cholesky, diagonal, dot, from_fn, identity, ldl, square, symmetric, transpose,
};
use crate::manifold::{Family, Manifold, take_matrix};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::packed::{Packed, gain};
use crate::scalar::{Mask, Real};

/// Extended Kalman filter: first-order propagation of the error-state covariance, Joseph's form in
/// the update, and the reset of the error state carried into the covariance.
///
/// Sources: Lefferts, Markley, Shuster, *Kalman filtering for spacecraft attitude estimation*, 1982;
/// Markley, *Attitude error representations for Kalman filtering*, 2003.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ekf {
    /// Whether the covariance is carried over the reset of the error state; classical filters, and the
    /// invariant filter, leave it as it is.
    pub reset: bool,
}

impl Default for Ekf {
    fn default() -> Self {
        Self { reset: true }
    }
}

impl Ekf {
    /// The reset after a correction. One by nothing changes nothing; to choose between two matrices would put both into
    /// memory.
    #[inline(always)]
    fn turned<T: Real, const N: usize>(&self, step: &Vector<T, N>) -> Vector<T, N> {
        let mut turned = *step;
        for d in &mut turned {
            *d = if self.reset { *d } else { T::zero() };
        }
        turned
    }
}

impl Filter for Ekf {
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
        let (mean, cov) = dynamics.propagate(&belief.mean, &belief.cov, u, t, dt);
        let ok = finite::<D::Space, T, N>(&mean, &diagonal(&cov));
        // part by part: a new belief would be one more copy of the matrix
        D::Space::take::<T>(&mut belief.mean, ok, &mean);
        take_matrix::<T, N, N>(&mut belief.cov, ok, &cov);
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
        let (mean, image, rest) = dynamics.carry(&belief.mean, &root, u, t, dt);
        let cov = add(&square(&image), &rest);
        (Joint { mean, cov, root, image, rest }, ok)
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
        let (x, p) = (&belief.mean, &belief.cov);
        let noise = sensor.noise(given);
        let innovation = sensor.residual(z, &sensor.predict(x, given));
        let Corrected { cov, step, covariance, nis, factored } = if H::DIRECT {
            direct::<H::Space, T, N, M>(self, x, p, &noise, &innovation)
        } else {
            let mut c = seen_through(sensor, &sensor.jacobian(x, given), p, &noise, &innovation);
            c.cov = H::Space::transport(x, &self.turned(&c.step), &c.cov);
            c
        };
        let mean = H::Space::normalise(&H::Space::retract(x, &step));
        let ok = factored.and(healthy::<H::Space, T, N>(&mean, &diagonal(&cov)));
        let accepted = ok.and(gate.gt(nis));
        H::Space::take::<T>(&mut belief.mean, accepted, &mean);
        take_matrix::<T, N, N>(&mut belief.cov, accepted, &cov);
        Outcome { ok, accepted, innovation, covariance, nis }
    }
}

/// What a measurement makes of a covariance, in [`direct`] after the reset.
struct Corrected<T: Real, const N: usize, const M: usize> {
    cov: Matrix<T, N, N>,
    /// The correction of the state.
    step: Vector<T, N>,
    /// Covariance of the innovation.
    covariance: Matrix<T, M, M>,
    nis: T,
    factored: T::Mask,
}

/// Correction by any measurement, in Joseph's form.
#[inline(always)]
fn seen_through<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
    sensor: &H,
    h: &Matrix<T, M, N>,
    p: &Matrix<T, N, N>,
    noise: &Matrix<T, M, M>,
    innovation: &Vector<T, M>,
) -> Corrected<T, N, M> {
    let pht = sensor.project::<T, N>(h, p);
    let hpht = sensor.project::<T, M>(h, &transpose(&pht));
    let covariance = add(&hpht, noise);
    let (gain, nis, factored) = gain(&pht, &covariance, innovation);
    let cov = joseph(p, &gain, &pht, &hpht, noise);
    Corrected { cov, step: gain.apply(innovation), covariance, nis, factored }
}

/// Correction by a measurement of the first `M` error states themselves. With `P = [A B; Bᵀ C]` and `S = A + R` what
/// is left of the rows it sees, `(I − K H) P`, is `R S⁻¹ [A B]`: a product, in which nothing cancels, however small `R` is
/// beside `A`. What is left of `C` is `C − Bᵀ S⁻¹ B`. A reset that mixes these states alone, by `J`, is one more factor of the
/// product, `J R S⁻¹ [A B]`, and of the columns of `A`.
#[inline(always)]
fn direct<S: Manifold<N>, T: Real, const N: usize, const M: usize>(
    filter: &Ekf,
    x: &S::Of<T>,
    p: &Matrix<T, N, N>,
    noise: &Matrix<T, M, M>,
    innovation: &Vector<T, M>,
) -> Corrected<T, N, M> {
    let covariance = symmetric::<T, M>(
        #[inline(always)]
        |i, j| p[(i, j)] + noise[(i, j)],
    );
    let factor = ldl(&covariance);
    let inverse = factor.inverse();
    let packed = Packed::new(&inverse);
    let weighed = packed.apply(innovation);
    let nis = dot::<T, M>(
        #[inline(always)]
        |i| innovation[i],
        #[inline(always)]
        |i| weighed[i],
    );
    let seen = Packed::<T, N, M>::from_fn(
        #[inline(always)]
        |i, j| p[(i, j)],
    );
    let step = seen.apply(&weighed);
    let solved = Packed::<T, M, N>::columns_of_product::<M>(
        M,
        &packed,
        #[inline(always)]
        |k, j| p[(k, j)],
    );
    let mut left = Packed::<T, M, M>::product::<M>(
        &Packed::new(noise),
        #[inline(always)]
        |k, j| inverse[(k, j)],
    );
    let reset: Matrix<T, M, M> =
        if S::RESETS == M { block(&S::reset(x, &filter.turned(&step)), 0, 0) } else { identity() };
    if S::RESETS == M {
        left = Packed::<T, M, M>::product::<M>(
            &Packed::new(&reset),
            #[inline(always)]
            |k, j| left.at(k, j),
        );
    }
    let top = Packed::<T, M, N>::product::<M>(
        &left,
        #[inline(always)]
        |k, j| p[(k, j)],
    );
    let mut own = top.block::<M>(0);
    if S::RESETS == M {
        own = Packed::<T, M, M>::product::<M>(
            &own,
            #[inline(always)]
            |k, j| reset[(j, k)],
        );
    }
    let mut cov = symmetric(
        #[inline(always)]
        |i, j| match (i < M, j < M) {
            (true, _) => own.at(i, j),
            (false, true) => top.at(j, i),
            (false, false) => {
                let mut rest = p[(i, j)];
                for k in 0..M {
                    rest = (-p[(i, k)]).mul_add(solved.at(k, j), rest);
                }
                rest
            }
        },
    );
    if S::RESETS != M {
        cov = S::transport(x, &filter.turned(&step), &cov);
    }
    Corrected { cov, step, covariance, nis, factored: factor.ok }
}

/// Joseph's form `(I − K H) P (I − K H)ᵀ + K R Kᵀ`, multiplied out one factor at a time. Signal and noise
/// part of the innovation covariance stay apart: their sum has lost a small R beside a large `H P Hᵀ`,
/// and with it the variance that is left.
#[inline(always)]
pub(super) fn joseph<T: Real, const N: usize, const M: usize>(
    p: &Matrix<T, N, N>,
    gain: &Packed<T, N, M>,
    pht: &Matrix<T, N, M>,
    hpht: &Matrix<T, M, M>,
    noise: &Matrix<T, M, M>,
) -> Matrix<T, N, N> {
    let signal = Packed::new(pht).minus(gain, |k, m| hpht[(k, m)]);
    let rest = signal.minus(gain, |k, m| noise[(k, m)]);
    let once = Packed::new(p).minus(gain, |m, j| pht[(j, m)]);
    once.minus(&rest, |m, j| gain.at(j, m)).symmetric()
}

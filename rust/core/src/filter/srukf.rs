//! Square-root unscented Kalman filter on a manifold.

use super::sigma::{Unscented, joint, packs, points, total};
use super::{Filter, cast};
use crate::belief::{Belief, Joint, Outcome, SqrtGaussian};
use crate::error::Result;
use crate::linalg::{Matrix, Vector, apply, cholesky, dot, forward_solve, from_fn, mul_t, symmetric, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::scalar::{Mask, Real};
use std::f64::consts::FRAC_1_SQRT_2;

/// Unscented Kalman filter that carries a square root of the covariance and never forms, subtracts
/// or factors the covariance itself: weighted deviations are absorbed into a triangular factor by
/// reflections, in the update together with those of the measurement (the array form of Kailath,
/// Sayed, Hassibi, *Linear Estimation*, 2000, §12.3). No downdate exists, as no weight is negative.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SrUkf {
    weights: Unscented,
}

impl SrUkf {
    /// # Errors
    /// `Parameter` where the weights would need a downdate (`β < α²`).
    pub fn new(weights: Unscented) -> Result<Self> {
        weights.check_non_negative()?;
        Ok(Self { weights })
    }
}

/// The reflection that moves a pack of columns, seen in one row, into that row's pivot.
struct Reflection<T: Real> {
    pivot: T,
    column: T::Pack,
    norm: T,
    inverse: T,
    ratio: T,
}

impl<T: Real> Reflection<T> {
    #[inline(always)]
    fn new(pivot: T, column: T::Pack) -> Self {
        let square = T::total(column * column);
        let norm = pivot.mul_add(pivot, square).sqrt();
        let some = norm.gt(T::zero());
        let inverse = T::select(some, T::select(some, norm, T::one()).recip(), T::zero());
        let moved = square.gt(T::zero());
        let ratio = T::select(moved, (pivot + norm) * inverse / T::select(moved, square, T::one()), T::zero());
        Self { pivot, column, norm, inverse, ratio }
    }
    /// Applies it to another row: its entry of the factor and its columns.
    #[inline(always)]
    fn apply(&self, entry: &mut T, columns: &mut T::Pack) {
        let inner = T::total(self.column * *columns);
        let w = self.ratio.mul_add(inner, -(*entry * self.inverse));
        *entry = self.pivot.mul_add(*entry, inner) * self.inverse;
        *columns = (-w.stack()).mul_add(self.column, *columns);
    }
}

/// Absorbs a pack of columns into a lower-triangular factor: `L Lᵀ + A Aᵀ` becomes `L Lᵀ`.
#[inline(always)]
fn absorb<T: Real, const N: usize>(factor: &mut Matrix<T, N, N>, columns: &Vector<T::Pack, N>) {
    let mut a = *columns;
    for j in 0..N {
        let reflection = Reflection::<T>::new(factor[(j, j)], a[j]);
        factor[(j, j)] = reflection.norm;
        for i in j + 1..N {
            reflection.apply(&mut factor[(i, j)], &mut a[i]);
        }
    }
}

#[inline(always)]
fn positive_pivots<T: Real, const N: usize>(factor: &Matrix<T, N, N>) -> T::Mask {
    let mut ok = T::Mask::TRUE;
    for i in 0..N {
        ok = ok.and(factor[(i, i)].gt(T::zero()));
    }
    ok
}

/// A vector in slot 0 of a pack of columns.
#[inline(always)]
fn column<T: Real, const N: usize>(v: &Vector<T, N>, scale: f64) -> Vector<T::Pack, N> {
    let mut o = [T::Pack::zero(); N];
    for i in 0..N {
        let x = v[i] * scale;
        o[i] = T::gather(
            #[inline(always)]
            |slot| if slot == 0 { x } else { T::zero() },
        );
    }
    o
}

#[inline(always)]
fn scaled<P: Real, const N: usize>(v: &Vector<P, N>, by: f64) -> Vector<P, N> {
    v.map(
        #[inline(always)]
        |x| x * by,
    )
}

/// Lower-triangular factor of the joint covariance of measurement and state, in blocks:
/// `[[root, 0], [gain, rest]]`.
struct Stacked<T: Real, const N: usize, const M: usize> {
    root: Matrix<T, M, M>,
    gain: Matrix<T, N, M>,
    rest: Matrix<T, N, N>,
}

impl<T: Real, const N: usize, const M: usize> Stacked<T, N, M> {
    #[inline(always)]
    fn absorb(&mut self, e: &Vector<T::Pack, M>, d: &Vector<T::Pack, N>) {
        let (mut e, mut d) = (*e, *d);
        for j in 0..M {
            let reflection = Reflection::<T>::new(self.root[(j, j)], e[j]);
            self.root[(j, j)] = reflection.norm;
            for i in j + 1..M {
                reflection.apply(&mut self.root[(i, j)], &mut e[i]);
            }
            for i in 0..N {
                reflection.apply(&mut self.gain[(i, j)], &mut d[i]);
            }
        }
        absorb(&mut self.rest, &d);
    }
}

impl Filter for SrUkf {
    type Belief<S: Manifold<N>, T: Real, const N: usize> = SqrtGaussian<S, T, N>;

    #[inline(always)]
    fn cast<S: Manifold<N>, A: Real, B: Real, const N: usize>(belief: &SqrtGaussian<S, A, N>) -> SqrtGaussian<S, B, N> {
        SqrtGaussian { mean: S::map(&belief.mean, cast), factor: from_fn(|i, j| cast(belief.factor[(i, j)])) }
    }

    #[inline(always)]
    fn predict<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &mut SqrtGaussian<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> T::Mask {
        let spread = self.weights.spread(N);
        let weight = 0.5 / spread;
        let x = D::Space::map(&belief.mean, T::stack);
        let input = D::Input::map(u, T::stack);
        let (time, step) = (t.stack(), dt.stack());

        let mut centre = belief.mean;
        let mut origin = x;
        let mut sum = [T::Pack::zero(); N];
        let mut factor: Matrix<T, N, N> = zeros();
        for p in 0..packs::<T, N>() {
            let point = D::Space::retract(&x, &points::<T, N>(&belief.factor, spread.sqrt(), p));
            let image = dynamics.step(&point, &input, time, step);
            if p == 0 {
                centre = D::Space::map(&image, |c| T::extract(c, 0));
                origin = D::Space::map(&centre, T::stack);
            }
            let d = D::Space::local(&origin, &image);
            for i in 0..N {
                sum[i] += d[i];
            }
            absorb(&mut factor, &scaled(&d, weight.sqrt()));
        }
        let mean = total::<T, N>(&sum, weight);
        absorb(&mut factor, &column::<T, N>(&mean, self.weights.mean_weight().sqrt()));

        // the reset of the small mean deviation, then the noise, both into a triangular factor
        let mut moved = dynamics.noise_factor(&belief.mean, u, t, dt);
        absorb_factor(&mut moved, &D::Space::transport_factor(&centre, &mean, &factor));
        let new = SqrtGaussian { mean: D::Space::normalise(&D::Space::retract(&centre, &mean)), factor: moved };
        let ok = positive_pivots(&new.factor).and(new.healthy());
        *belief = Belief::select(ok, &new, belief);
        ok
    }

    #[inline(always)]
    fn joint<D: Dynamics<N>, T: Real, const N: usize>(
        &self,
        belief: &SqrtGaussian<D::Space, T, N>,
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> (Joint<D::Space, T, N>, T::Mask) {
        let (root, ok) = (belief.factor, T::Mask::TRUE);
        (joint(&self.weights, (&belief.mean, &root), dynamics, u, t, dt), ok)
    }

    #[inline(always)]
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut SqrtGaussian<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        gate: T,
    ) -> Outcome<T, M> {
        let spread = self.weights.spread(N);
        let weight = 0.5 / spread;
        let x = H::Space::map(&belief.mean, T::stack);
        let known = H::Given::map(given, T::stack);
        let centre = sensor.predict(&belief.mean, given);
        let origin = H::Value::map(&centre, T::stack);

        let (root, factored) = cholesky(&sensor.noise(given));
        let mut stacked = Stacked::<T, N, M> { root, gain: zeros(), rest: zeros() };
        let mut sum = [T::Pack::zero(); M];
        for p in 0..packs::<T, N>() {
            let point = H::Space::retract(&x, &points::<T, N>(&belief.factor, spread.sqrt(), p));
            let e = sensor.residual(&sensor.predict(&point, &known), &origin);
            for i in 0..M {
                sum[i] += e[i];
            }
            // deviations of the state, weighted: √(1/2c) √c = 1/√2
            let d = points::<T, N>(&belief.factor, FRAC_1_SQRT_2, p);
            stacked.absorb(&scaled(&e, weight.sqrt()), &d);
        }
        let bias = total::<T, M>(&sum, weight);
        stacked.absorb(&column::<T, M>(&bias, self.weights.mean_weight().sqrt()), &[T::Pack::zero(); N]);

        let mut innovation = sensor.residual(z, &centre);
        for i in 0..M {
            innovation[i] -= bias[i];
        }
        let whitened = forward_solve(&stacked.root, &innovation);
        let nis = dot::<T, M>(|i| whitened[i], |i| whitened[i]);
        let s = mul_t(&stacked.root, &stacked.root);
        let covariance = symmetric(|i, j| s[(i, j)]);
        let step = apply(&stacked.gain, &whitened);
        let new = SqrtGaussian {
            mean: H::Space::normalise(&H::Space::retract(&belief.mean, &step)),
            factor: H::Space::transport_factor(&belief.mean, &step, &stacked.rest),
        };
        let ok = factored.and(positive_pivots(&stacked.rest)).and(new.healthy());
        let accepted = ok.and(gate.gt(nis));
        *belief = Belief::select(accepted, &new, belief);
        Outcome { ok, accepted, innovation, covariance, nis }
    }
}

/// Absorbs the columns of any square root into a lower-triangular factor.
#[inline(always)]
fn absorb_factor<T: Real, const N: usize>(factor: &mut Matrix<T, N, N>, root: &Matrix<T, N, N>) {
    for p in 0..N.div_ceil(T::WIDTH) {
        let mut a = [T::Pack::zero(); N];
        for i in 0..N {
            a[i] = T::gather(
                #[inline(always)]
                |slot| {
                    let k = p * T::WIDTH + slot;
                    if k < N { root[(i, k)] } else { T::zero() }
                },
            );
        }
        absorb(factor, &a);
    }
}

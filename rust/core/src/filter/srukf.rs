//! Square-root unscented Kalman filter on a manifold.

use super::sigma::{Images, Spread, Unscented, columns, joint, packs};
use super::{Filter, cast};
use crate::belief::{Belief, Joint, Outcome, SqrtGaussian};
use crate::error::Result;
use crate::linalg::{
    Matrix, Vector, apply, cholesky, dot, forward_solve, from_fn, mul_t, square, symmetric, transpose, zeros,
};
use crate::manifold::{Family, Manifold, components, take_matrix};
use crate::model::{Dynamics, Given, Input, Measurement, Value};
use crate::scalar::{Level, Mask, Real};

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

/// One row of an array of columns: `G` groups of columns side by side in packs, and one more.
struct Row<T: Real, const N: usize, const G: usize> {
    groups: [[T::Pack; N]; G],
    one: T,
}

impl<T: Real, const N: usize, const G: usize> Clone for Row<T, N, G> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<T: Real, const N: usize, const G: usize> Copy for Row<T, N, G> {}

impl<T: Real, const N: usize, const G: usize> Row<T, N, G> {
    #[inline(always)]
    fn zeros() -> Self {
        Self { groups: [[T::Pack::zero(); N]; G], one: T::zero() }
    }
    /// Sum over the columns of the products with another row.
    #[inline(always)]
    fn dot(&self, other: &Self) -> T {
        let mut sum = self.groups[0][0] * other.groups[0][0];
        for g in 0..G {
            for p in usize::from(g == 0)..packs::<T, N>() {
                sum = self.groups[g][p].mul_add(other.groups[g][p], sum);
            }
        }
        self.one.mul_add(other.one, T::total(sum))
    }
    /// Takes a multiple of another row off.
    #[inline(always)]
    fn subtract(&mut self, factor: T, other: &Self) {
        let minus = (-factor).stack();
        for g in 0..G {
            for p in 0..packs::<T, N>() {
                self.groups[g][p] = minus.mul_add(other.groups[g][p], self.groups[g][p]);
            }
        }
        self.one = (-factor).mul_add(other.one, self.one);
    }
}

/// The reflection that moves a row of columns into its pivot.
struct Reflection<T: Real> {
    pivot: T,
    norm: T,
    inverse: T,
    ratio: T,
}

impl<T: Real> Reflection<T> {
    /// For a row of this squared length.
    #[inline(always)]
    fn new(pivot: T, square: T) -> Self {
        let norm = pivot.mul_add(pivot, square).sqrt();
        let some = norm.gt(T::zero());
        let inverse = T::select(some, T::select(some, norm, T::one()).recip(), T::zero());
        // one division beside the other, not after it
        let under = norm * square;
        let moved = under.gt(T::zero());
        let ratio = T::select(moved, (pivot + norm) / T::select(moved, under, T::one()), T::zero());
        Self { pivot, norm, inverse, ratio }
    }
    /// Applies it to another row: its entry of the factor and its columns.
    #[inline(always)]
    fn apply<const N: usize, const G: usize>(&self, own: &Row<T, N, G>, entry: &mut T, row: &mut Row<T, N, G>) {
        let inner = own.dot(row);
        let w = self.ratio.mul_add(inner, -(*entry * self.inverse));
        *entry = self.pivot.mul_add(*entry, inner) * self.inverse;
        row.subtract(w, own);
    }
}

/// Calls a step for each row up to the last one. The first ones are steps of their own, by constants: rows then lie in
/// registers and on the stack as they are used, not as a table that is filled with zeros beforehand. At the baseline, where a
/// pack is an array, that would take minutes to compile.
macro_rules! each_row {
    ($rows:expr, $step:ident $arguments:tt, $($j:literal)*) => {
        let unrolled = if matches!(T::LEVEL, Level::Portable) { 0 } else { UNROLLED };
        $(if $j < unrolled && $j < $rows {
            $step!($j, $arguments);
        })*
        for j in unrolled..$rows {
            $step!(j, $arguments);
        }
    };
}

/// Rows that [`each_row`] takes one by one.
const UNROLLED: usize = 6;

macro_rules! absorb_one {
    ($j:expr, ($factor:ident, $rows:ident)) => {
        let own = $rows[$j];
        let reflection = Reflection::new($factor[($j, $j)], own.dot(&own));
        $factor[($j, $j)] = reflection.norm;
        for i in 0..R {
            if i > $j {
                reflection.apply(&own, &mut $factor[(i, $j)], &mut $rows[i]);
            }
        }
    };
}

/// Absorbs columns into a lower-triangular factor: `L Lᵀ + A Aᵀ` becomes `L Lᵀ`.
#[inline(always)]
fn absorb<T: Real, const R: usize, const N: usize, const G: usize>(
    factor: &mut Matrix<T, R, R>,
    rows: &mut [Row<T, N, G>; R],
) {
    each_row!(R, absorb_one(factor, rows), 0 1 2 3 4 5);
}

#[inline(always)]
fn positive_pivots<T: Real, const N: usize>(factor: &Matrix<T, N, N>) -> T::Mask {
    let mut ok = T::Mask::TRUE;
    for i in 0..N {
        ok = ok.and(factor[(i, i)].gt(T::zero()));
    }
    ok
}

/// Lower-triangular factor of the joint covariance of measurement and state, in blocks:
/// `[[root, 0], [gain, rest]]`.
struct Stacked<T: Real, const N: usize, const M: usize> {
    root: Matrix<T, M, M>,
    gain: Matrix<T, N, M>,
    rest: Matrix<T, N, N>,
}

impl<T: Real, const N: usize, const M: usize> Stacked<T, N, M> {
    /// From a root of the measurement's noise and columns of signal over state.
    #[inline(always)]
    fn new<const G: usize>(root: Matrix<T, M, M>, mut e: [Row<T, N, G>; M], mut d: [Row<T, N, G>; N]) -> Self {
        let mut new = Self { root, gain: zeros(), rest: zeros() };
        macro_rules! observe {
            ($j:expr, ($e:ident, $d:ident)) => {
                let own = $e[$j];
                let reflection = Reflection::new(new.root[($j, $j)], own.dot(&own));
                new.root[($j, $j)] = reflection.norm;
                for i in 0..M {
                    if i > $j {
                        reflection.apply(&own, &mut new.root[(i, $j)], &mut $e[i]);
                    }
                }
                for i in 0..N {
                    reflection.apply(&own, &mut new.gain[(i, $j)], &mut $d[i]);
                }
            };
        }
        each_row!(M, observe(e, d), 0 1 2 3 4 5);
        absorb(&mut new.rest, &mut d);
        new
    }
    /// Another one where the mask is true.
    #[inline(always)]
    fn take(&mut self, mask: T::Mask, other: &Self) {
        take_matrix::<T, M, M>(&mut self.root, mask, &other.root);
        take_matrix::<T, N, M>(&mut self.gain, mask, &other.gain);
        take_matrix::<T, N, N>(&mut self.rest, mask, &other.rest);
    }
}

impl SrUkf {
    /// The joint factor where the residual is linear: the columns of the factor, and what the sensor sees of them.
    #[inline(always)]
    fn seen<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        belief: &SqrtGaussian<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        root: Matrix<T, M, M>,
    ) -> Stacked<T, N, M> {
        let h = sensor.jacobian(&belief.mean, given);
        let signal = sensor.project::<T, N>(&h, &transpose(&belief.factor));
        let (mut e, mut d) = ([Row::<T, N, 1>::zeros(); M], [Row::<T, N, 1>::zeros(); N]);
        for p in 0..packs::<T, N>() {
            let column = columns::<T, N>(&belief.factor, 1.0, p);
            for i in 0..N {
                d[i].groups[0][p] = column[i];
            }
            for i in 0..M {
                e[i].groups[0][p] = T::gather(
                    #[inline(always)]
                    |slot| if p * T::WIDTH + slot < N { signal[(p * T::WIDTH + slot, i)] } else { T::zero() },
                );
            }
        }
        Stacked::new(root, e, d)
    }

    /// The joint factor by sigma points, and the bias of the predicted measurement. Points come in pairs: the odd
    /// parts of their images go with the state, the even ones do not.
    #[inline(always)]
    fn sampled<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &SqrtGaussian<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        root: Matrix<T, M, M>,
    ) -> (Stacked<T, N, M>, Vector<T, M>) {
        let spread = self.weights.spread(N);
        let x = H::Space::map(&belief.mean, T::stack);
        let known = H::Given::map(given, T::stack);
        let origin = H::Value::map(&sensor.predict(&belief.mean, given), T::stack);
        let images = Images::<T, N, M>::new(
            &belief.factor,
            spread.sqrt(),
            #[inline(always)]
            |d| sensor.residual(&sensor.predict(&H::Space::retract(&x, d), &known), &origin),
        );
        let bias = images.mean(0.5 / spread, 0);
        let (mut e, mut d) = ([Row::<T, N, 2>::zeros(); M], [Row::<T, N, 2>::zeros(); N]);
        let half = 0.5 / spread.sqrt();
        for p in 0..packs::<T, N>() {
            let column = columns::<T, N>(&belief.factor, 1.0, p);
            for i in 0..N {
                d[i].groups[0][p] = column[i];
            }
            for i in 0..M {
                let (plus, minus) = (images.plus[p][i], images.minus[p][i]);
                e[i].groups[0][p] = (plus - minus) * half;
                e[i].groups[1][p] = (plus + minus) * half;
            }
        }
        for i in 0..M {
            e[i].one = bias[i] * self.weights.mean_weight().sqrt();
        }
        (Stacked::new(root, e, d), bias)
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
        let mut moved = Spread::<D, T, N>::new(&self.weights, (&belief.mean, &belief.factor), dynamics, u, t, dt);
        let noise = dynamics.noise_factor(&belief.mean, u, t, dt);
        // images and mean, carried over the reset of the small mean deviation, beside a root of the noise
        let Images { plus, minus } = &mut moved.images;
        let mut mean = [components(|i| moved.mean[i].stack())];
        D::Space::carry_columns::<T>(&moved.centre, &moved.mean, &mut plus[..packs::<T, N>()]);
        D::Space::carry_columns::<T>(&moved.centre, &moved.mean, &mut minus[..packs::<T, N>()]);
        D::Space::carry_columns::<T>(&moved.centre, &moved.mean, &mut mean);
        let weight = (0.5 / self.weights.spread(N)).sqrt();
        let mut rows = [Row::<T, N, 3>::zeros(); N];
        for p in 0..packs::<T, N>() {
            let noise = columns::<T, N>(&noise, 1.0, p);
            for i in 0..N {
                rows[i].groups[0][p] = plus[p][i] * weight;
                rows[i].groups[1][p] = minus[p][i] * weight;
                rows[i].groups[2][p] = noise[i];
            }
        }
        for i in 0..N {
            rows[i].one = T::extract(mean[0][i], 0) * self.weights.mean_weight().sqrt();
        }
        let mut factor: Matrix<T, N, N> = zeros();
        absorb(&mut factor, &mut rows);
        let new = SqrtGaussian { mean: moved.state(), factor };
        let ok = positive_pivots(&new.factor).and(new.healthy());
        belief.take(ok, &new);
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
        let (root, factored) = cholesky(&sensor.noise(given));
        let mut innovation = sensor.residual(z, &sensor.predict(&belief.mean, given));
        let linear = sensor.linear(&square(&belief.factor), self.weights.spread(N));
        let stacked = if linear.all() {
            Self::seen(belief, sensor, given, root)
        } else {
            let (mut stacked, bias) = self.sampled(belief, sensor, given, root);
            if linear.any() {
                // each lane by itself, whatever its neighbours are
                stacked.take(linear, &Self::seen(belief, sensor, given, root));
            }
            for i in 0..M {
                innovation[i] -= T::select(linear, T::zero(), bias[i]);
            }
            stacked
        };
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
        belief.take(accepted, &new);
        Outcome { ok, accepted, innovation, covariance, nis }
    }
}

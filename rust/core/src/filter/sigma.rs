//! The unscented transform, written on deviations from the centre point's own image.
//!
//! With `c = α² (N + κ)`, points `0, ±√c columns of L` and deviations `d_i` of the images from the
//! image of the centre, the scaled transform's mean and covariance are exactly
//!
//! `m = Σ d_i / 2c`,  `P = Σ d_i d_iᵀ / 2c + (β − α²) m mᵀ`,
//!
//! sums over the 2N outer points. The centre's weight, negative for `N + κ < N`, has dropped out:
//! with `β ≥ α²` nothing is ever subtracted.

use crate::belief::Joint;
use crate::error::{Error, Result};
use crate::linalg::{Matrix, Vector, add, mul, square, subtract, symmetric, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input, State};
use crate::scalar::Real;

/// Weights of the scaled unscented transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unscented {
    alpha: f64,
    beta: f64,
    kappa: Option<f64>,
}

impl Default for Unscented {
    /// `α = 1`, `β = 2`, `N + κ = 3`.
    fn default() -> Self {
        Self { alpha: 1.0, beta: 2.0, kappa: None }
    }
}

impl Unscented {
    /// Weights of Wan and van der Merwe, 2000. `kappa: None` is the papers' choice `N + κ = 3`.
    pub fn new(alpha: f64, beta: f64, kappa: Option<f64>) -> Result<Self> {
        let checked = |field, value: f64, need, good: bool| {
            if good && value.is_finite() { Ok(()) } else { Err(Error::Parameter { field, value, need }) }
        };
        checked("alpha", alpha, "must be in (0, 1]", alpha > 0.0 && alpha <= 1.0)?;
        checked("beta", beta, "must be finite and not negative (2 is best for normal errors)", beta >= 0.0)?;
        if let Some(k) = kappa {
            checked("kappa", k, "must be finite", true)?;
        }
        Ok(Self { alpha, beta, kappa })
    }

    /// Checks that points for `n` error states exist: `N + κ > 0`.
    pub fn check(&self, n: usize) -> Result<()> {
        if self.spread(n) > 0.0 {
            return Ok(());
        }
        let value = self.kappa.unwrap_or(f64::NAN);
        Err(Error::Parameter { field: "kappa", value, need: "must be larger than minus the number of error states" })
    }

    /// Checks that no weight is negative, `β ≥ α²`, as a square-root filter needs.
    pub fn check_non_negative(&self) -> Result<()> {
        if self.mean_weight() >= 0.0 {
            return Ok(());
        }
        let need = "must be at least alpha squared for the square-root filter, so that no weight is negative";
        Err(Error::Parameter { field: "beta", value: self.beta, need })
    }

    /// `c = α² (N + κ)`, the squared distance of the points from the centre in units of sigma.
    #[inline(always)]
    pub(crate) fn spread(&self, n: usize) -> f64 {
        self.alpha * self.alpha * self.kappa.map_or(3.0, |k| n as f64 + k)
    }

    /// `β − α²`, the weight of `m mᵀ`.
    #[inline(always)]
    pub(crate) fn mean_weight(&self) -> f64 {
        self.beta - self.alpha * self.alpha
    }
}

/// Number of packs that hold the columns of a square root.
#[inline(always)]
pub(crate) const fn packs<T: Real, const N: usize>() -> usize {
    N.div_ceil(T::WIDTH)
}

/// Pack `p` of the columns of a square root, `scale` times; zero in the slots beyond the last.
#[inline(always)]
pub(crate) fn columns<T: Real, const N: usize>(root: &Matrix<T, N, N>, scale: f64, p: usize) -> Vector<T::Pack, N> {
    let mut d = [T::Pack::zero(); N];
    for i in 0..N {
        d[i] = T::gather(
            #[inline(always)]
            |slot| {
                let k = p * T::WIDTH + slot;
                if k < N { root[(i, k)] * scale } else { T::zero() }
            },
        );
    }
    d
}

/// Where a map takes the outer points: deviations of their images from the image of the centre, `K` numbers for
/// each of the `2N` points. The points come in pairs about the centre, `+` and `−` a column.
pub(crate) struct Images<T: Real, const N: usize, const K: usize> {
    /// Of the points at plus the columns; the first [`packs`] are in use.
    pub(crate) plus: [Vector<T::Pack, K>; N],
    /// Of those at minus the columns.
    pub(crate) minus: [Vector<T::Pack, K>; N],
}

impl<T: Real, const N: usize, const K: usize> Images<T, N, K> {
    /// By a map from error states to deviations.
    #[inline(always)]
    pub(crate) fn new(
        root: &Matrix<T, N, N>,
        scale: f64,
        map: impl Fn(&Vector<T::Pack, N>) -> Vector<T::Pack, K>,
    ) -> Self {
        let nothing = [[T::Pack::zero(); K]; N];
        let mut new = Self { plus: nothing, minus: nothing };
        for p in 0..packs::<T, N>() {
            let mut d = columns::<T, N>(root, scale, p);
            new.plus[p] = map(&d);
            for x in &mut d {
                *x = -*x;
            }
            new.minus[p] = map(&d);
        }
        new
    }

    /// Mean, for `weight` on each point; the last `still` numbers are those of the points and have none.
    #[inline(always)]
    pub(crate) fn mean(&self, weight: f64, still: usize) -> Vector<T, K> {
        let mut mean = [T::zero(); K];
        for i in 0..K - still {
            let mut sum = self.plus[0][i] + self.minus[0][i];
            for p in 1..packs::<T, N>() {
                sum += self.plus[p][i] + self.minus[p][i];
            }
            mean[i] = T::total(sum) * weight;
        }
        mean
    }

    /// Entry of the covariance, without the part of the mean.
    #[inline(always)]
    pub(crate) fn covariance(&self, i: usize, j: usize, weight: f64) -> T {
        let mut sum = self.plus[0][i] * self.plus[0][j];
        sum = self.minus[0][i].mul_add(self.minus[0][j], sum);
        for p in 1..packs::<T, N>() {
            sum = self.plus[p][i].mul_add(self.plus[p][j], sum);
            sum = self.minus[p][i].mul_add(self.minus[p][j], sum);
        }
        T::total(sum) * weight
    }

    /// Covariance with the points themselves.
    #[inline(always)]
    pub(crate) fn cross(&self, root: &Matrix<T, N, N>, scale: f64, weight: f64) -> Matrix<T, N, K> {
        let mut sums: Matrix<T::Pack, N, K> = zeros();
        for p in 0..packs::<T, N>() {
            let d = columns::<T, N>(root, scale, p);
            for j in 0..K {
                let odd = self.plus[p][j] - self.minus[p][j];
                for i in 0..N {
                    sums[(i, j)] = d[i].mul_add(odd, sums[(i, j)]);
                }
            }
        }
        crate::linalg::from_fn(|i, j| T::total(sums[(i, j)]) * weight)
    }
}

/// What the unscented transform makes of a belief: the image of the centre, where it puts the mean, and the
/// covariance before the step's noise.
pub(crate) struct Spread<D: Dynamics<N>, T: Real, const N: usize> {
    /// Image of the centre.
    pub(crate) centre: State<D, T, N>,
    /// Images of the points about it.
    pub(crate) images: Images<T, N, N>,
    /// Mean of all about it.
    pub(crate) mean: Vector<T, N>,
}

impl<D: Dynamics<N>, T: Real, const N: usize> Spread<D, T, N> {
    /// Steps the points of a square root.
    #[inline(always)]
    pub(crate) fn new(
        weights: &Unscented,
        (mean, root): (&State<D, T, N>, &Matrix<T, N, N>),
        dynamics: &D,
        u: &Input<D, T, N>,
        t: T,
        dt: T,
    ) -> Self {
        let spread = weights.spread(N);
        let centre = dynamics.step(mean, u, t, dt);
        let (x, origin) = (D::Space::map(mean, T::stack), D::Space::map(&centre, T::stack));
        let input = D::Input::map(u, T::stack);
        let (time, step) = (t.stack(), dt.stack());
        let images = Images::new(
            root,
            spread.sqrt(),
            #[inline(always)]
            |d| dynamics.displaced((&x, &origin), d, &input, time, step),
        );
        let mean = images.mean(0.5 / spread, D::STILL);
        Self { centre, images, mean }
    }

    /// Covariance about the mean, in the tangent space at the centre's image; `before` is that of the belief, which
    /// the last error states keep where the step leaves them as they are.
    #[inline(always)]
    pub(crate) fn covariance(&self, weights: &Unscented, before: impl Fn(usize, usize) -> T) -> Matrix<T, N, N> {
        let (weight, of_mean) = (0.5 / weights.spread(N), weights.mean_weight());
        symmetric(
            #[inline(always)]
            |i, j| {
                if j >= N - D::STILL {
                    return before(i, j);
                }
                (self.mean[i] * of_mean).mul_add(self.mean[j], self.images.covariance(i, j, weight))
            },
        )
    }

    /// The predicted state.
    #[inline(always)]
    pub(crate) fn state(&self) -> State<D, T, N> {
        D::Space::normalise(&D::Space::retract(&self.centre, &self.mean))
    }
}

/// An unscented prediction with its correlation: the odd part of the images of the points, column by
/// column, is what the step makes of the square root.
#[inline(always)]
pub(crate) fn joint<D: Dynamics<N>, T: Real, const N: usize>(
    weights: &Unscented,
    (mean, root): (&State<D, T, N>, &Matrix<T, N, N>),
    dynamics: &D,
    u: &Input<D, T, N>,
    t: T,
    dt: T,
) -> Joint<D::Space, T, N> {
    let moved = Spread::<D, T, N>::new(weights, (mean, root), dynamics, u, t, dt);
    let half = 0.5 / weights.spread(N).sqrt();
    let mut image: Matrix<T, N, N> = zeros();
    for k in 0..N {
        let (p, slot) = (k / T::WIDTH, k % T::WIDTH);
        for i in 0..N {
            image[(i, k)] = T::extract(moved.images.plus[p][i] - moved.images.minus[p][i], slot) * half;
        }
    }
    let before = square(root);
    let cov = moved.covariance(weights, |i, j| before[(i, j)]);
    let reset = D::Space::reset(&moved.centre, &moved.mean);
    let cov = add(&D::Space::transport(&moved.centre, &moved.mean, &cov), &dynamics.noise(mean, u, t, dt));
    let image = mul(&reset, &image);
    Joint { mean: moved.state(), cov, root: *root, image, rest: subtract(&cov, &square(&image)) }
}

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

/// Number of packs that hold the centre and the 2N outer points.
#[inline(always)]
pub(crate) const fn packs<T: Real, const N: usize>() -> usize {
    (2 * N + 1).div_ceil(T::WIDTH)
}

/// Pack `p` of the points `0, +columns, −columns` of a square root, `scale` times. Slots beyond the
/// last point repeat the centre, whose deviation is zero.
#[inline(always)]
pub(crate) fn points<T: Real, const N: usize>(root: &Matrix<T, N, N>, scale: f64, p: usize) -> Vector<T::Pack, N> {
    let mut d = [T::Pack::zero(); N];
    for i in 0..N {
        d[i] = T::gather(
            #[inline(always)]
            |slot| {
                let k = p * T::WIDTH + slot;
                if k >= 1 && k <= N {
                    root[(i, k - 1)] * scale
                } else if k > N && k <= 2 * N {
                    root[(i, k - 1 - N)] * -scale
                } else {
                    T::zero()
                }
            },
        );
    }
    d
}

/// `Σ d` and the lower triangle of `Σ d dᵀ`, gathered pack by pack.
pub(crate) struct Moments<T: Real, const N: usize> {
    sum: Vector<T::Pack, N>,
    outer: Matrix<T::Pack, N, N>,
}

impl<T: Real, const N: usize> Moments<T, N> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { sum: [T::Pack::zero(); N], outer: zeros() }
    }
    #[inline(always)]
    pub(crate) fn add(&mut self, d: &Vector<T::Pack, N>) {
        for i in 0..N {
            self.sum[i] += d[i];
            for j in 0..=i {
                self.outer[(i, j)] = d[i].mul_add(d[j], self.outer[(i, j)]);
            }
        }
    }
    /// Mean and covariance, for `weight` on each outer point and `mean_weight` on `m mᵀ`.
    #[inline(always)]
    pub(crate) fn finish(&self, weight: f64, mean_weight: f64) -> (Vector<T, N>, Matrix<T, N, N>) {
        let mean = total::<T, N>(&self.sum, weight);
        let cov = symmetric(|i, j| (mean[i] * mean_weight).mul_add(mean[j], T::total(self.outer[(i, j)]) * weight));
        (mean, cov)
    }
}

/// `weight Σ d` over all slots.
#[inline(always)]
pub(crate) fn total<T: Real, const N: usize>(sum: &Vector<T::Pack, N>, weight: f64) -> Vector<T, N> {
    let mut m = [T::zero(); N];
    for i in 0..N {
        m[i] = T::total(sum[i]) * weight;
    }
    m
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
    let spread = weights.spread(N);
    let x = D::Space::map(mean, T::stack);
    let input = D::Input::map(u, T::stack);
    let (time, step) = (t.stack(), dt.stack());
    let half = 0.5 / spread.sqrt();

    let mut centre = *mean;
    let mut origin = x;
    let mut moments = Moments::<T, N>::new();
    let mut image: Matrix<T, N, N> = zeros();
    for p in 0..packs::<T, N>() {
        let point = D::Space::retract(&x, &points::<T, N>(root, spread.sqrt(), p));
        let moved = dynamics.step(&point, &input, time, step);
        if p == 0 {
            centre = D::Space::map(&moved, |c| T::extract(c, 0));
            origin = D::Space::map(&centre, T::stack);
        }
        let d = D::Space::local(&origin, &moved);
        moments.add(&d);
        for slot in 0..T::WIDTH {
            let k = p * T::WIDTH + slot;
            if k == 0 || k > 2 * N {
                continue;
            }
            let (column, sign) = if k <= N { (k - 1, half) } else { (k - 1 - N, -half) };
            for i in 0..N {
                image[(i, column)] += T::extract(d[i], slot) * sign;
            }
        }
    }
    let (shift, cov) = moments.finish(0.5 / spread, weights.mean_weight());
    let reset = D::Space::reset(&centre, &shift);
    let cov = add(&D::Space::transport(&centre, &shift, &cov), &dynamics.noise(mean, u, t, dt));
    let image = mul(&reset, &image);
    Joint {
        mean: D::Space::normalise(&D::Space::retract(&centre, &shift)),
        cov,
        root: *root,
        image,
        rest: subtract(&cov, &square(&image)),
    }
}

//! Matrices of fixed size (nalgebra's storage) and the few kernels the filters need, over any
//! [`Real`].

use crate::scalar::{Mask, Real};

/// Matrix of `R` rows and `C` columns, column-major.
pub type Matrix<T, const R: usize, const C: usize> = nalgebra::SMatrix<T, R, C>;
/// Vector of `N` components.
pub type Vector<T, const N: usize> = [T; N];

/// Matrix of zeros.
#[inline(always)]
pub fn zeros<T: Real, const R: usize, const C: usize>() -> Matrix<T, R, C> {
    Matrix::from_array_storage(nalgebra::ArrayStorage([[T::zero(); R]; C]))
}

/// Matrix from its entries.
#[inline(always)]
pub fn from_fn<T: Real, const R: usize, const C: usize>(mut entry: impl FnMut(usize, usize) -> T) -> Matrix<T, R, C> {
    let mut m = zeros();
    for j in 0..C {
        for i in 0..R {
            m[(i, j)] = entry(i, j);
        }
    }
    m
}

/// Symmetric matrix from its lower triangle.
#[inline(always)]
pub fn symmetric<T: Real, const N: usize>(mut entry: impl FnMut(usize, usize) -> T) -> Matrix<T, N, N> {
    let mut m = zeros();
    for i in 0..N {
        // over the whole row: a loop whose end depends on another is not always unrolled
        for j in 0..N {
            if j <= i {
                let e = entry(i, j);
                m[(i, j)] = e;
                m[(j, i)] = e;
            }
        }
    }
    m
}

/// Identity.
#[inline(always)]
pub fn identity<T: Real, const N: usize>() -> Matrix<T, N, N> {
    from_fn(|i, j| if i == j { T::one() } else { T::zero() })
}

/// `sum_k a(k) b(k)` for `k` in `0..K`.
#[inline(always)]
pub fn dot<T: Real, const K: usize>(a: impl Fn(usize) -> T, b: impl Fn(usize) -> T) -> T {
    let mut s = a(0) * b(0);
    for k in 1..K {
        s = a(k).mul_add(b(k), s);
    }
    s
}

/// `a b`
#[inline(always)]
pub fn mul<T: Real, const R: usize, const K: usize, const C: usize>(
    a: &Matrix<T, R, K>,
    b: &Matrix<T, K, C>,
) -> Matrix<T, R, C> {
    from_fn(|i, j| dot::<T, K>(|k| a[(i, k)], |k| b[(k, j)]))
}

/// `a bᵀ`
#[inline(always)]
pub fn mul_t<T: Real, const R: usize, const K: usize, const C: usize>(
    a: &Matrix<T, R, K>,
    b: &Matrix<T, C, K>,
) -> Matrix<T, R, C> {
    from_fn(|i, j| dot::<T, K>(|k| a[(i, k)], |k| b[(j, k)]))
}

/// `a aᵀ`
#[inline(always)]
pub fn square<T: Real, const R: usize, const K: usize>(a: &Matrix<T, R, K>) -> Matrix<T, R, R> {
    symmetric(|i, j| dot::<T, K>(|k| a[(i, k)], |k| a[(j, k)]))
}

/// `a b aᵀ` for symmetric `b`.
#[inline(always)]
pub fn congruence<T: Real, const R: usize, const K: usize>(
    a: &Matrix<T, R, K>,
    b: &Matrix<T, K, K>,
) -> Matrix<T, R, R> {
    let ab = mul(a, b);
    symmetric(|i, j| dot::<T, K>(|k| ab[(i, k)], |k| a[(j, k)]))
}

/// `a + b`
#[inline(always)]
pub fn add<T: Real, const R: usize, const C: usize>(a: &Matrix<T, R, C>, b: &Matrix<T, R, C>) -> Matrix<T, R, C> {
    from_fn(|i, j| a[(i, j)] + b[(i, j)])
}

/// The diagonal of a matrix.
#[inline(always)]
pub fn diagonal<T: Real, const N: usize>(a: &Matrix<T, N, N>) -> Vector<T, N> {
    let mut v = [T::zero(); N];
    for i in 0..N {
        v[i] = a[(i, i)];
    }
    v
}

/// `a x`
#[inline(always)]
pub fn apply<T: Real, const R: usize, const C: usize>(a: &Matrix<T, R, C>, x: &Vector<T, C>) -> Vector<T, R> {
    let mut y = [T::zero(); R];
    for i in 0..R {
        y[i] = dot::<T, C>(|k| a[(i, k)], |k| x[k]);
    }
    y
}

/// The block of `R` by `C` whose first entry is `(i0, j0)`.
#[inline(always)]
pub fn block<T: Real, const N: usize, const M: usize, const R: usize, const C: usize>(
    p: &Matrix<T, N, M>,
    i0: usize,
    j0: usize,
) -> Matrix<T, R, C> {
    from_fn(|i, j| p[(i0 + i, j0 + j)])
}

/// Writes a block whose first entry comes to `(i0, j0)`.
#[inline(always)]
pub fn set_block<T: Real, const N: usize, const M: usize, const R: usize, const C: usize>(
    m: &mut Matrix<T, N, M>,
    i0: usize,
    j0: usize,
    b: &Matrix<T, R, C>,
) {
    for j in 0..C {
        for i in 0..R {
            m[(i0 + i, j0 + j)] = b[(i, j)];
        }
    }
}

/// Transpose.
#[inline(always)]
pub fn transpose<T: Real, const R: usize, const C: usize>(a: &Matrix<T, R, C>) -> Matrix<T, C, R> {
    from_fn(|i, j| a[(j, i)])
}

/// `[v]×`, the matrix with `[v]× u = v × u`.
#[inline(always)]
pub fn skew<T: Real>(v: &Vector<T, 3>) -> Matrix<T, 3, 3> {
    let mut m = zeros();
    m[(0, 1)] = -v[2];
    m[(0, 2)] = v[1];
    m[(1, 0)] = v[2];
    m[(1, 2)] = -v[0];
    m[(2, 0)] = -v[1];
    m[(2, 1)] = v[0];
    m
}

/// `P = L D Lᵀ`: unit lower-triangular `L`, `D` and `D⁻¹`, and in which lanes all pivots are positive.
/// A failed pivot is replaced by one, so that a bad lane stays finite and does not disturb the others.
///
/// No square root stands on the path from pivot to pivot.
#[inline(always)]
pub fn ldl<T: Real, const N: usize>(p: &Matrix<T, N, N>) -> Ldl<T, N> {
    if N == 3 {
        return ldl_of_three(p);
    }
    // u = L D, the columns before their division by the pivot
    let (mut l, mut u) = (zeros::<T, N, N>(), zeros::<T, N, N>());
    let (mut pivots, mut inverses) = ([T::one(); N], [T::one(); N]);
    let mut ok = T::Mask::TRUE;
    for j in 0..N {
        let mut d = p[(j, j)];
        for k in 0..j {
            d = (-l[(j, k)]).mul_add(u[(j, k)], d);
        }
        let good = d.gt(T::zero());
        ok = ok.and(good);
        pivots[j] = T::select(good, d, T::one());
        inverses[j] = pivots[j].recip();
        for i in j + 1..N {
            let mut t = p[(i, j)];
            for k in 0..j {
                t = (-u[(i, k)]).mul_add(l[(j, k)], t);
            }
            u[(i, j)] = t;
            l[(i, j)] = t * inverses[j];
        }
    }
    Ldl { l, pivots, inverses, ok }
}

/// [`ldl`] of three rows: the last pivot's reciprocal is `d₁ / (d₁ d₂)`, and `d₁ d₂` needs no division, so that the divisions
/// by the second and the last pivot go side by side.
#[inline(always)]
fn ldl_of_three<T: Real, const N: usize>(p: &Matrix<T, N, N>) -> Ldl<T, N> {
    let good = p[(0, 0)].gt(T::zero());
    let first = T::select(good, p[(0, 0)], T::one());
    let mut ok = good;
    let inverse = first.recip();
    let (l1, l2) = (p[(1, 0)] * inverse, p[(2, 0)] * inverse);
    let d = (-l1).mul_add(p[(1, 0)], p[(1, 1)]);
    let u = (-l1).mul_add(p[(2, 0)], p[(2, 1)]);
    let rest = (-l2).mul_add(p[(2, 0)], p[(2, 2)]);
    let good = d.gt(T::zero());
    ok = ok.and(good);
    let second = T::select(good, d, T::one());
    let product = second.mul_add(rest, -(u * u));
    let good = product.gt(T::zero());
    ok = ok.and(good);
    let (product, second_inverse) = (T::select(good, product, T::one()), second.recip());
    let mut l = zeros();
    (l[(1, 0)], l[(2, 0)], l[(2, 1)]) = (l1, l2, u * second_inverse);
    let (mut pivots, mut inverses) = ([T::one(); N], [T::one(); N]);
    (pivots[0], pivots[1], pivots[2]) = (first, second, product * second_inverse);
    (inverses[0], inverses[1], inverses[2]) = (inverse, second_inverse, second / product);
    Ldl { l, pivots, inverses, ok }
}

/// What [`ldl`] returns.
pub struct Ldl<T: Real, const N: usize> {
    /// Strictly lower triangle of the unit lower-triangular factor.
    pub l: Matrix<T, N, N>,
    /// Diagonal of `D`.
    pub pivots: Vector<T, N>,
    /// Reciprocals of the pivots.
    pub inverses: Vector<T, N>,
    /// True where all pivots are positive.
    pub ok: T::Mask,
}

impl<T: Real, const N: usize> Ldl<T, N> {
    /// The inverse `L⁻ᵀ D⁻¹ L⁻¹`: for matrices of a few rows that multiply others.
    #[inline(always)]
    pub fn inverse(&self) -> Matrix<T, N, N> {
        // below the diagonal of L⁻¹, by columns
        let mut m = zeros::<T, N, N>();
        for j in 0..N {
            for i in 0..N {
                if i > j {
                    let mut sum = -self.l[(i, j)];
                    for k in 0..N {
                        if k > j && k < i {
                            sum = (-self.l[(i, k)]).mul_add(m[(k, j)], sum);
                        }
                    }
                    m[(i, j)] = sum;
                }
            }
        }
        symmetric(
            #[inline(always)]
            |i, j| {
                // j ≤ i, and the diagonal of L⁻¹ is one
                let mut sum = if i == j { self.inverses[i] } else { self.inverses[i] * m[(i, j)] };
                for k in 0..N {
                    if k > i {
                        sum = (m[(k, i)] * self.inverses[k]).mul_add(m[(k, j)], sum);
                    }
                }
                sum
            },
        )
    }

    /// `rᵀ P⁻¹ r`, by substitution.
    #[inline(always)]
    pub fn quadratic(&self, r: &Vector<T, N>) -> T {
        let mut y = *r;
        let mut square = T::zero();
        for i in 0..N {
            for k in 0..i {
                y[i] = (-self.l[(i, k)]).mul_add(y[k], y[i]);
            }
            square = (y[i] * self.inverses[i]).mul_add(y[i], square);
        }
        square
    }
}

/// Lower Cholesky factor, and in which lanes it exists (see [`ldl`]).
#[inline(always)]
pub fn cholesky<T: Real, const N: usize>(p: &Matrix<T, N, N>) -> (Matrix<T, N, N>, T::Mask) {
    let mut f = ldl(p);
    for j in 0..N {
        let root = f.pivots[j].sqrt();
        f.l[(j, j)] = root;
        for i in j + 1..N {
            f.l[(i, j)] = f.l[(i, j)] * root;
        }
    }
    (f.l, f.ok)
}

/// Lower Cholesky factor of a positive *semi*definite matrix: a pivot that is zero to rounding gives a
/// column of zeros. For noise that does not reach every state.
#[inline(always)]
pub fn cholesky_semidefinite<T: Real, const N: usize>(p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
    let mut l = zeros::<T, N, N>();
    for j in 0..N {
        let mut d = p[(j, j)];
        for k in 0..j {
            d = (-l[(j, k)]).mul_add(l[(j, k)], d);
        }
        let good = d.gt(p[(j, j)] * (N as f64 * f64::EPSILON));
        let root = T::select(good, d, T::one()).sqrt();
        let inverse = T::select(good, root.recip(), T::zero());
        l[(j, j)] = T::select(good, root, T::zero());
        for i in j + 1..N {
            let mut t = p[(i, j)];
            for k in 0..j {
                t = (-l[(i, k)]).mul_add(l[(j, k)], t);
            }
            l[(i, j)] = t * inverse;
        }
    }
    l
}

/// `l⁻¹ b` for lower-triangular `l`.
#[inline(always)]
pub fn forward_solve<T: Real, const M: usize>(l: &Matrix<T, M, M>, b: &Vector<T, M>) -> Vector<T, M> {
    let mut y = *b;
    for i in 0..M {
        for k in 0..i {
            y[i] = (-l[(i, k)]).mul_add(y[k], y[i]);
        }
        y[i] = y[i] / l[(i, i)];
    }
    y
}

/// `a⁻¹ b` for a matrix near the identity, by elimination without pivoting: what carries errors over a
/// reset is that near.
#[inline(always)]
pub fn solve_near_identity<T: Real, const N: usize, const M: usize>(
    a: &Matrix<T, N, N>,
    b: &Matrix<T, N, M>,
) -> Matrix<T, N, M> {
    let (mut a, mut x) = (*a, *b);
    for k in 0..N {
        let inverse = a[(k, k)].recip();
        for i in k + 1..N {
            let factor = -(a[(i, k)] * inverse);
            for j in k + 1..N {
                a[(i, j)] = factor.mul_add(a[(k, j)], a[(i, j)]);
            }
            for j in 0..M {
                x[(i, j)] = factor.mul_add(x[(k, j)], x[(i, j)]);
            }
        }
    }
    for j in 0..M {
        for i in (0..N).rev() {
            let mut t = x[(i, j)];
            for k in i + 1..N {
                t = (-a[(i, k)]).mul_add(x[(k, j)], t);
            }
            x[(i, j)] = t * a[(i, i)].recip();
        }
    }
    x
}

/// `a − b`
#[inline(always)]
pub fn subtract<T: Real, const R: usize, const C: usize>(a: &Matrix<T, R, C>, b: &Matrix<T, R, C>) -> Matrix<T, R, C> {
    from_fn(|i, j| a[(i, j)] - b[(i, j)])
}

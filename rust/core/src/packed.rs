//! Small matrices whose columns lie in registers, rows side by side.
//!
//! A product is a sum of columns times single numbers, `(A B)_j = Σ_k A_k B_kj`, which needs no sum across a
//! register. For a one-lane scalar four rows are one register; for a batch, whose lanes are taken already, this
//! is plain arithmetic on rows.

use crate::linalg::{Ldl, Matrix, Vector, from_fn, ldl, symmetric};
use crate::scalar::{Real, Rows};

/// A matrix of `R` rows and `C` columns; of each column the first `R / WIDTH` registers, rounded up, are in use.
pub(crate) struct Packed<T: Real, const R: usize, const C: usize>([[T::Rows; R]; C]);

impl<T: Real, const R: usize, const C: usize> Clone for Packed<T, R, C> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<T: Real, const R: usize, const C: usize> Copy for Packed<T, R, C> {}

impl<T: Real, const R: usize, const C: usize> Packed<T, R, C> {
    const REGISTERS: usize = R.div_ceil(T::Rows::WIDTH);

    #[inline(always)]
    fn zeros() -> Self {
        Self([[T::Rows::gather(|_| T::zero()); R]; C])
    }

    /// From its entries.
    #[inline(always)]
    pub(crate) fn from_fn(mut entry: impl FnMut(usize, usize) -> T) -> Self {
        let mut new = Self::zeros();
        for j in 0..C {
            for p in 0..Self::REGISTERS {
                new.0[j][p] = T::Rows::gather(
                    #[inline(always)]
                    |row| {
                        let i = p * T::Rows::WIDTH + row;
                        if i < R { entry(i, j) } else { T::zero() }
                    },
                );
            }
        }
        new
    }

    /// Packs a matrix.
    #[inline(always)]
    pub(crate) fn new(a: &Matrix<T, R, C>) -> Self {
        Self::from_fn(
            #[inline(always)]
            |i, j| a[(i, j)],
        )
    }

    /// One entry.
    #[inline(always)]
    pub(crate) fn at(&self, i: usize, j: usize) -> T {
        self.0[j][i / T::Rows::WIDTH].row(i % T::Rows::WIDTH)
    }

    /// As a matrix.
    #[inline(always)]
    pub(crate) fn matrix(&self) -> Matrix<T, R, C> {
        from_fn(
            #[inline(always)]
            |i, j| self.at(i, j),
        )
    }

    /// Some of the columns, from one on.
    #[inline(always)]
    pub(crate) fn block<const K: usize>(&self, first: usize) -> Packed<T, R, K> {
        let mut new = Packed::zeros();
        for j in 0..K {
            for p in 0..Self::REGISTERS {
                new.0[j][p] = self.0[first + j][p];
            }
        }
        new
    }

    /// `a b`
    #[inline(always)]
    pub(crate) fn product<const K: usize>(a: &Packed<T, R, K>, b: impl Fn(usize, usize) -> T) -> Self {
        Self::columns_of_product::<K>(0, a, b)
    }

    /// The columns of `a b` from one on; zero before it.
    #[inline(always)]
    pub(crate) fn columns_of_product<const K: usize>(
        from: usize,
        a: &Packed<T, R, K>,
        b: impl Fn(usize, usize) -> T,
    ) -> Self {
        let mut new = Self::zeros();
        for j in from..C {
            for p in 0..Self::REGISTERS {
                let mut sum = a.0[0][p].times(b(0, j));
                for k in 1..K {
                    sum = a.0[k][p].times_plus(b(k, j), sum);
                }
                new.0[j][p] = sum;
            }
        }
        new
    }

    /// `a b + c d`, a column at a time: two products one after the other would put the first into memory.
    #[inline(always)]
    pub(crate) fn two_products<const K: usize>(
        (a, b): (&Packed<T, R, K>, impl Fn(usize, usize) -> T),
        (c, d): (&Packed<T, R, K>, impl Fn(usize, usize) -> T),
    ) -> Self {
        let mut new = Self::zeros();
        for j in 0..C {
            for p in 0..Self::REGISTERS {
                let mut sum = a.0[0][p].times(b(0, j));
                for k in 1..K {
                    sum = a.0[k][p].times_plus(b(k, j), sum);
                }
                for k in 0..K {
                    sum = c.0[k][p].times_plus(d(k, j), sum);
                }
                new.0[j][p] = sum;
            }
        }
        new
    }

    /// `self − a b`
    #[inline(always)]
    pub(crate) fn minus<const K: usize>(self, a: &Packed<T, R, K>, b: impl Fn(usize, usize) -> T) -> Self {
        self.add_product::<K>(
            a,
            #[inline(always)]
            |k, j| -b(k, j),
        )
    }

    #[inline(always)]
    fn add_product<const K: usize>(mut self, a: &Packed<T, R, K>, b: impl Fn(usize, usize) -> T) -> Self {
        for j in 0..C {
            for p in 0..Self::REGISTERS {
                let mut sum = self.0[j][p];
                for k in 0..K {
                    sum = a.0[k][p].times_plus(b(k, j), sum);
                }
                self.0[j][p] = sum;
            }
        }
        self
    }

    /// `self + a`
    #[inline(always)]
    pub(crate) fn add(mut self, a: &Self) -> Self {
        for j in 0..C {
            for p in 0..Self::REGISTERS {
                self.0[j][p] = self.0[j][p].plus(a.0[j][p]);
            }
        }
        self
    }

    /// `self x`
    #[inline(always)]
    pub(crate) fn apply(&self, x: &Vector<T, C>) -> Vector<T, R> {
        let y = Packed::<T, R, 1>::product::<C>(
            self,
            #[inline(always)]
            |k, _| x[k],
        );
        let mut out = [T::zero(); R];
        for i in 0..R {
            out[i] = y.at(i, 0);
        }
        out
    }

    /// `self S⁻¹` for `S = L D Lᵀ`, by substitution.
    #[inline(always)]
    fn over(mut self, f: &Ldl<T, C>) -> Self {
        for i in 0..C {
            for k in 0..i {
                self.add_column(i, k, -f.l[(i, k)]);
            }
        }
        for i in (0..C).rev() {
            for p in 0..Self::REGISTERS {
                self.0[i][p] = self.0[i][p].times(f.inverses[i]);
            }
            for k in i + 1..C {
                self.add_column(i, k, -f.l[(k, i)]);
            }
        }
        self
    }

    #[inline(always)]
    fn add_column(&mut self, to: usize, from: usize, factor: T) {
        for p in 0..Self::REGISTERS {
            self.0[to][p] = self.0[from][p].times_plus(factor, self.0[to][p]);
        }
    }
}

impl<T: Real, const N: usize> Packed<T, N, N> {
    /// The symmetric matrix of its lower triangle.
    #[inline(always)]
    pub(crate) fn symmetric(&self) -> Matrix<T, N, N> {
        symmetric(
            #[inline(always)]
            |i, j| self.at(i, j),
        )
    }
}

/// The gain `b S⁻¹` and the quadratic form `rᵀ S⁻¹ r`, both by substitution, and in which lanes `S` is
/// positive definite.
#[inline(always)]
pub(crate) fn gain<T: Real, const N: usize, const M: usize>(
    b: &Matrix<T, N, M>,
    s: &Matrix<T, M, M>,
    r: &Vector<T, M>,
) -> (Packed<T, N, M>, T, T::Mask) {
    let f = ldl(s);
    (Packed::new(b).over(&f), f.quadratic(r), f.ok)
}

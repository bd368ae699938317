//! A system with more states that ride along: constants, or errors that fade.
//!
//! The state of any dynamics, its head, is joined by a tail of `K` vectors of three, which move by themselves. What they
//! mean is a matter of the measurements: coefficients of a periodic error, a bias of a receiver. The error state is the
//! head's `H` components and then the tail's, vector by vector: `N = H + 3 K`.

use crate::linalg::{Matrix, Vector, block, congruence, identity, set_block, solve_near_identity, zeros};
use crate::manifold::{Family, Manifold, components};
use crate::model::{Dynamics, Input};
use crate::scalar::Real;
use std::marker::PhantomData;

/// A state and the vectors that ride along.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joined<X, T, const K: usize> {
    /// The state.
    pub head: X,
    /// The vectors.
    pub tail: [[T; 3]; K],
}

/// The space of [`Joined`].
pub struct JoinedSpace<S, const H: usize, const K: usize, const N: usize>(PhantomData<S>);

impl<S: Family, const H: usize, const K: usize, const N: usize> Family for JoinedSpace<S, H, K, N> {
    type Of<T: Real> = Joined<S::Of<T>, T, K>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &Joined<S::Of<A>, A, K>,
        b: &Joined<S::Of<B>, B, K>,
        mut f: impl FnMut(A, B) -> C,
    ) -> Joined<S::Of<C>, C, K> {
        let head = S::zip(&a.head, &b.head, &mut f);
        let mut tail = [[C::zero(); 3]; K];
        for k in 0..K {
            for i in 0..3 {
                tail[k][i] = f(a.tail[k][i], b.tail[k][i]);
            }
        }
        Joined { head, tail }
    }
}

/// The head's part of an error state.
#[inline(always)]
fn first<T: Real, const H: usize, const N: usize>(d: &Vector<T, N>) -> Vector<T, H> {
    components(
        #[inline(always)]
        |i| d[i],
    )
}

/// Applies a linear map of the head's errors to the head's rows of a matrix.
#[inline(always)]
fn on_head<T: Real, const H: usize, const N: usize>(map: &Matrix<T, H, H>, m: &mut Matrix<T, N, N>) {
    for j in 0..N {
        let mut column = [T::zero(); H];
        for i in 0..H {
            let mut sum = map[(i, 0)] * m[(0, j)];
            for k in 1..H {
                sum = map[(i, k)].mul_add(m[(k, j)], sum);
            }
            column[i] = sum;
        }
        for i in 0..H {
            m[(i, j)] = column[i];
        }
    }
}

/// Copies the head's rows beside its own block over to its columns, so that the matrix is symmetric again.
#[inline(always)]
fn mirror<T: Real, const H: usize, const N: usize>(m: &mut Matrix<T, N, N>) {
    for i in 0..H {
        for j in H..N {
            m[(j, i)] = m[(i, j)];
        }
    }
}

impl<S: Manifold<H>, const H: usize, const K: usize, const N: usize> Manifold<N> for JoinedSpace<S, H, K, N> {
    const RESETS: usize = S::RESETS;

    #[inline(always)]
    fn retract<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>) -> Self::Of<T> {
        let mut out = Joined { head: S::retract(&x.head, &first(d)), tail: x.tail };
        for k in 0..K {
            for i in 0..3 {
                out.tail[k][i] += d[H + 3 * k + i];
            }
        }
        out
    }
    #[inline(always)]
    fn local<T: Real>(x: &Self::Of<T>, y: &Self::Of<T>) -> Vector<T, N> {
        let head = S::local(&x.head, &y.head);
        components(
            #[inline(always)]
            |i| {
                if i < H {
                    return head[i];
                }
                let (k, j) = ((i - H) / 3, (i - H) % 3);
                y.tail[k][j] - x.tail[k][j]
            },
        )
    }
    #[inline(always)]
    fn normalise<T: Real>(x: &Self::Of<T>) -> Self::Of<T> {
        Joined { head: S::normalise(&x.head), tail: x.tail }
    }
    #[inline(always)]
    fn valid<T: Real>(x: &Self::Of<T>) -> T::Mask {
        S::valid(&x.head)
    }
    #[inline(always)]
    fn reset<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>) -> Matrix<T, N, N> {
        let mut j = identity();
        set_block(&mut j, 0, 0, &S::reset(&x.head, &first(d)));
        j
    }
    #[inline(always)]
    fn transport<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        let d = first(d);
        let mut out = *p;
        on_head(&S::reset(&x.head, &d), &mut out);
        set_block(&mut out, 0, 0, &S::transport(&x.head, &d, &block(p, 0, 0)));
        mirror::<T, H, N>(&mut out);
        out
    }
    #[inline(always)]
    fn transport_factor<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, l: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        let mut out = *l;
        on_head(&S::reset(&x.head, &first(d)), &mut out);
        out
    }
    #[inline(always)]
    fn carry_columns<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, columns: &mut [Vector<T::Pack, N>]) {
        let d = first(d);
        for column in columns {
            let mut head = [first(column)];
            S::carry_columns(&x.head, &d, &mut head);
            column[..H].copy_from_slice(&head[0]);
        }
    }
    #[inline(always)]
    fn transport_back<T: Real>(x: &Self::Of<T>, d: &Vector<T, N>, p: &Matrix<T, N, N>) -> Matrix<T, N, N> {
        let d = first(d);
        let mut out = *p;
        set_block(&mut out, 0, 0, &S::transport_back(&x.head, &d, &block(p, 0, 0)));
        let map = S::reset(&x.head, &d);
        for j in H..N {
            let column: Matrix<T, H, 1> = block(p, 0, j);
            set_block(&mut out, 0, j, &solve_near_identity(&map, &column));
        }
        mirror::<T, H, N>(&mut out);
        out
    }
    #[inline(always)]
    fn difference_step(i: usize) -> f64 {
        if i < H { S::difference_step(i) } else { 1e-5 }
    }
}

/// How a vector of the tail moves: it fades at a rate towards zero, and noise keeps its stationary standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fading {
    /// One over the correlation time, 1/s; zero for a constant.
    pub rate: f64,
    /// Stationary standard deviation per axis; of no effect for a constant.
    pub sigma: f64,
}

impl Fading {
    /// What is left of it after a step, and the variance that the step adds.
    #[inline(always)]
    fn after<T: Real>(&self, dt: T) -> (T, T) {
        if self.rate == 0.0 {
            return (T::one(), T::zero());
        }
        let left = (dt * -self.rate).map(f64::exp);
        (left, (dt * (-2.0 * self.rate)).map(|x| -x.exp_m1()) * (self.sigma * self.sigma))
    }
}

/// Dynamics of a head and its tail.
#[derive(Clone, Debug)]
pub struct Augmented<D, const H: usize, const K: usize, const N: usize> {
    head: D,
    tail: [Fading; K],
}

impl<D: Dynamics<H>, const H: usize, const K: usize, const N: usize> Augmented<D, H, K, N> {
    const FITS: () = assert!(N == H + 3 * K, "N must be H + 3 K");

    /// Dynamics of the head, and how each vector of the tail moves.
    pub fn new(head: D, tail: [Fading; K]) -> Self {
        let () = Self::FITS;
        Self { head, tail }
    }

    /// What is left of the tail's vectors after a step, and the variances that it adds.
    #[inline(always)]
    fn fades<T: Real>(&self, dt: T) -> [(T, T); K] {
        let mut out = [(T::one(), T::zero()); K];
        for k in 0..K {
            out[k] = self.tail[k].after(dt);
        }
        out
    }

    /// The tail after a step.
    #[inline(always)]
    fn faded<T: Real>(tail: &[[T; 3]; K], fades: &[(T, T); K]) -> [[T; 3]; K] {
        let mut out = *tail;
        for k in 0..K {
            for i in 0..3 {
                out[k][i] = out[k][i] * fades[k].0;
            }
        }
        out
    }
}

impl<D: Dynamics<H>, const H: usize, const K: usize, const N: usize> Dynamics<N> for Augmented<D, H, K, N> {
    type Space = JoinedSpace<D::Space, H, K, N>;
    type Input = D::Input;

    #[inline(always)]
    fn step<T: Real>(
        &self,
        x: &<Self::Space as Family>::Of<T>,
        u: &Input<D, T, H>,
        t: T,
        dt: T,
    ) -> <Self::Space as Family>::Of<T> {
        Joined { head: self.head.step(&x.head, u, t, dt), tail: Self::faded(&x.tail, &self.fades(dt)) }
    }

    #[inline(always)]
    fn noise<T: Real>(&self, x: &<Self::Space as Family>::Of<T>, u: &Input<D, T, H>, t: T, dt: T) -> Matrix<T, N, N> {
        joined(&self.head.noise(&x.head, u, t, dt), &self.fades(dt), |f| f.1)
    }

    #[inline(always)]
    fn transition<T: Real>(
        &self,
        x: &<Self::Space as Family>::Of<T>,
        u: &Input<D, T, H>,
        t: T,
        dt: T,
    ) -> Matrix<T, N, N> {
        joined(&self.head.transition(&x.head, u, t, dt), &self.fades(dt), |f| f.0)
    }

    /// `F P Fᵀ + Q` by blocks: the tail's part of F is diagonal.
    #[inline(always)]
    fn propagate<T: Real>(
        &self,
        x: &<Self::Space as Family>::Of<T>,
        p: &Matrix<T, N, N>,
        u: &Input<D, T, H>,
        t: T,
        dt: T,
    ) -> (<Self::Space as Family>::Of<T>, Matrix<T, N, N>) {
        let (head, f, q) = self.head.carry(&x.head, &identity(), u, t, dt);
        let fades = self.fades(dt);
        let mut out = *p;
        on_head(&f, &mut out);
        let own: Matrix<T, H, H> = congruence(&f, &block(p, 0, 0));
        for j in 0..H {
            for i in 0..H {
                out[(i, j)] = own[(i, j)] + q[(i, j)];
            }
        }
        for k in 0..K {
            for i in 0..3 {
                let at = H + 3 * k + i;
                for row in 0..N {
                    out[(row, at)] = out[(row, at)] * fades[k].0;
                }
                for column in H..N {
                    out[(at, column)] = out[(at, column)] * fades[k].0;
                }
                out[(at, at)] += fades[k].1;
            }
        }
        mirror::<T, H, N>(&mut out);
        (Joined { head, tail: Self::faded(&x.tail, &fades) }, out)
    }

    #[inline(always)]
    fn carry<T: Real>(
        &self,
        x: &<Self::Space as Family>::Of<T>,
        root: &Matrix<T, N, N>,
        u: &Input<D, T, H>,
        t: T,
        dt: T,
    ) -> (<Self::Space as Family>::Of<T>, Matrix<T, N, N>, Matrix<T, N, N>) {
        let (head, f, q) = self.head.carry(&x.head, &identity(), u, t, dt);
        let fades = self.fades(dt);
        let mut image = *root;
        on_head(&f, &mut image);
        for k in 0..K {
            for i in 0..3 {
                for column in 0..N {
                    image[(H + 3 * k + i, column)] = image[(H + 3 * k + i, column)] * fades[k].0;
                }
            }
        }
        (Joined { head, tail: Self::faded(&x.tail, &fades) }, image, joined(&q, &fades, |f| f.1))
    }

    /// The head's own root, and the tail's diagonal.
    #[inline(always)]
    fn noise_factor<T: Real>(
        &self,
        x: &<Self::Space as Family>::Of<T>,
        u: &Input<D, T, H>,
        t: T,
        dt: T,
    ) -> Matrix<T, N, N> {
        joined(&self.head.noise_factor(&x.head, u, t, dt), &self.fades(dt), |f| f.1.sqrt())
    }
}

/// A matrix of the head's block and of one number on the diagonal for each vector of the tail.
#[inline(always)]
fn joined<T: Real, const H: usize, const K: usize, const N: usize>(
    head: &Matrix<T, H, H>,
    fades: &[(T, T); K],
    number: impl Fn(&(T, T)) -> T,
) -> Matrix<T, N, N> {
    let mut out = zeros();
    set_block(&mut out, 0, 0, head);
    for k in 0..K {
        for i in 0..3 {
            out[(H + 3 * k + i, H + 3 * k + i)] = number(&fades[k]);
        }
    }
    out
}

//! Rauch-Tung-Striebel smoothing on manifolds, for every filter that gives a joint prediction.

use super::{Drive, End, Sink};
use crate::belief::{Belief, Gaussian};
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::{Matrix, add, congruence, from_fn, mul, mul_t, square, subtract, symmetric};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Input};
use crate::packed::gain;
use crate::scalar::Real;

/// One step of the smoother: what is known of the state before a step of the dynamics once the state
/// after it is known as `after`. None where a covariance is not positive definite.
///
/// Source: Rauch, Tung, Striebel, 1965; for sigma points Särkkä, *Unscented Rauch-Tung-Striebel
/// smoother*, 2008. On a manifold: differences are taken by `⊟` at the prediction, covariances are
/// carried between tangent spaces. Written as a sum of positive parts, nothing is subtracted:
/// `(L − G A)(L − G A)ᵀ + G (W + Pˢ) Gᵀ`, in the factors of [`crate::belief::Joint`].
#[inline(always)]
pub fn step_back<F: Filter, D: Dynamics<N>, T: Real<Mask = bool>, const N: usize>(
    filter: &F,
    dynamics: &D,
    belief: &F::Belief<D::Space, T, N>,
    (u, t, dt): (&Input<D, T, N>, T, T),
    after: &Gaussian<D::Space, T, N>,
) -> Option<Gaussian<D::Space, T, N>> {
    let (joint, good) = filter.joint(belief, dynamics, u, t, dt);
    let news = D::Space::local(&joint.mean, &after.mean);
    let then = D::Space::transport_back(&joint.mean, &news, &after.cov);
    let (smoother, _, solved) = gain(&mul_t(&joint.root, &joint.image), &joint.cov, &news);
    let step = smoother.apply(&news);
    let smoother = smoother.matrix();
    let left = subtract(&joint.root, &mul(&smoother, &joint.image));
    let cov = add(&square(&left), &congruence(&smoother, &add(&joint.rest, &then)));
    let x = belief.mean();
    let smoothed =
        Gaussian { mean: D::Space::normalise(&D::Space::retract(x, &step)), cov: D::Space::transport(x, &step, &cov) };
    (good && solved && smoothed.healthy()).then_some(smoothed)
}

/// A belief that the forward pass has left. Its covariance is stored apart.
struct Node<S: Family> {
    /// Its time, and where the step from it ends, s.
    t: f64,
    to: f64,
    /// Input sample after which the step lies.
    k: usize,
    mean: S::Of<f64>,
}

/// An output row: after how many nodes it stands, its time and its input sample.
struct Row {
    node: usize,
    t: f64,
    k: usize,
}

/// A forward pass as [`smooth`] goes back over it. A node costs a state, half a covariance and three
/// numbers.
pub struct Recorder<S: Manifold<N>, const N: usize> {
    nodes: Vec<Node<S>>,
    /// Lower triangles of the covariances, row by row.
    packed: Vec<f64>,
    rows: Vec<Row>,
}

impl<S: Manifold<N>, const N: usize> Recorder<S, N> {
    /// With room for so many nodes and rows.
    pub fn new(nodes: usize, rows: usize) -> Self {
        let packed = Vec::with_capacity(nodes * (N * (N + 1) / 2));
        Self { nodes: Vec::with_capacity(nodes), packed, rows: Vec::with_capacity(rows) }
    }

    /// Remembers that an output row is due here.
    #[inline(always)]
    pub fn row(&mut self, t: f64, k: usize) {
        self.rows.push(Row { node: self.nodes.len(), t, k });
    }

    /// Remembers a belief that is about to move on: see [`Sink::leaving`].
    #[inline(always)]
    pub fn node<T: Real, B: Belief<S, T, N>>(&mut self, t: f64, to: f64, k: usize, belief: &B) {
        self.nodes.push(Node { t, to, k, mean: S::map(belief.mean(), |x: T| x.lane(0)) });
        let p = belief.covariance();
        for i in 0..N {
            for j in 0..=i {
                self.packed.push(p[(i, j)].lane(0));
            }
        }
    }

    fn covariance(&self, node: usize) -> Matrix<f64, N, N> {
        let size = N * (N + 1) / 2;
        let packed = &self.packed[node * size..(node + 1) * size];
        symmetric(|i, j| packed[i * (i + 1) / 2 + j])
    }
}

/// Steps back between two calls of `poll`.
const CHUNK: usize = 4096;

/// Goes back over a recorded pass from its end. Output rows, last one first, go to a sink as states. `poll` is called with the number of the input sample every few thousand steps.
///
/// # Errors
/// A covariance that is not positive definite, and what `poll` returns.
#[inline(always)]
pub fn smooth<F: Filter, D: Dynamics<N>, I: Drive<D, N>, K: Sink<D::Space, N>, T: Real<Mask = bool>, const N: usize>(
    (filter, dynamics, drive): (&F, &D, &I),
    mut recorder: Recorder<D::Space, N>,
    end: &End<D::Space, N>,
    sink: &mut K,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<()> {
    let lift = |m: &Matrix<f64, N, N>| -> Matrix<T, N, N> { from_fn(|i, j| T::splat(m[(i, j)])) };
    let mut smoothed =
        Gaussian::<D::Space, T, N> { mean: D::Space::map(&end.mean, T::splat), cov: lift(&end.covariance) };
    let mut node = recorder.nodes.len();
    loop {
        while recorder.rows.last().is_some_and(|row| row.node == node) {
            if let Some(row) = recorder.rows.pop() {
                sink.state(row.t, row.k, &smoothed);
            }
        }
        if node == 0 {
            return Ok(());
        }
        node -= 1;
        let n = &recorder.nodes[node];
        if node.is_multiple_of(CHUNK) {
            poll(n.k)?;
        }
        let (belief, _) =
            filter.belief::<D::Space, T, N>(D::Space::map(&n.mean, T::splat), &lift(&recorder.covariance(node)));
        let step = (&drive.input::<T>(n.k), T::splat(n.t), T::splat(n.to - n.t));
        smoothed = step_back(filter, dynamics, &belief, step, &smoothed).ok_or(Error::NotPositiveDefinite {
            what: "smoothed covariance",
            step: n.k,
            t: n.t,
        })?;
    }
}

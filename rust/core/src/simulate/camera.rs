//! Star fixes with noise.

use super::rng::Stream;
use crate::linalg::{Matrix, apply};
use crate::quaternion::{Quaternion, exp, multiply, renormalise};

/// A star camera whose fixes are the truth turned by normal noise, `q_ic ⊗ exp(e/2)`.
#[derive(Clone, Debug)]
pub struct StarNoise<'a> {
    /// Times of the fixes, s.
    pub t: &'a [f64],
    /// True attitudes `q_ib` then.
    pub q: &'a [Quaternion<f64>],
    /// Camera frame to body, `q_bc`.
    pub mounting: Option<Quaternion<f64>>,
    /// A root of the covariance of `e` in the camera frame, `R = root rootᵀ`, rad.
    pub root: Matrix<f64, 3, 3>,
}

impl StarNoise<'_> {
    /// The fixes `q_ic` of one trial.
    pub fn simulate(&self, stream: &mut Stream, out: &mut Vec<Quaternion<f64>>) {
        out.clear();
        out.extend(self.q.iter().map(|q| {
            let camera = self.mounting.map_or(*q, |m| multiply(q, &m));
            renormalise(&multiply(&camera, &exp(&apply(&self.root, &stream.normals()))))
        }));
    }
}

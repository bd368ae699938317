//! Star fixes with noise, or from stars.

use super::rng::{Stream, channel};
use crate::attitude::camera::{CHUNK, Camera, Catalogue, Scratch, View};
use crate::error::Result;
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

/// A physical star camera: stars in view, centroid noise, and the attitude that follows from them.
#[derive(Clone, Debug)]
pub struct StarField<'a> {
    /// Times of the frames, s.
    pub t: &'a [f64],
    /// True attitudes `q_ib` then.
    pub q: &'a [Quaternion<f64>],
    /// Camera frame to body, `q_bc`.
    pub mounting: Option<Quaternion<f64>>,
    /// The stars of each frame.
    pub view: View,
}

/// A star camera.
#[derive(Clone, Debug)]
pub enum StarSource<'a> {
    /// Noise on the attitude.
    Noise(StarNoise<'a>),
    /// Stars.
    Field(StarField<'a>),
}

/// Fixes of one camera in one trial. Memory is reused.
#[derive(Clone, Debug, Default)]
pub struct Fixes {
    /// Fixes `q_ic`.
    pub q: Vec<Quaternion<f64>>,
    /// Covariance of each in the camera frame, rad²; empty for a camera without noise of its own.
    pub covariance: Vec<Matrix<f64, 3, 3>>,
    /// The frame of each, where some frames give none; empty otherwise.
    pub frame: Vec<usize>,
    /// Times and true attitudes `q_ib`, likewise.
    t: Vec<f64>,
    truth: Vec<Quaternion<f64>>,
    scratch: Scratch,
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

impl<'a> StarField<'a> {
    /// Finds the stars of each frame. `keep_on` is called now and then and may end it.
    ///
    /// # Errors
    /// What `keep_on` returns.
    pub fn new<E>(
        (t, q): (&'a [f64], &'a [Quaternion<f64>]),
        mounting: Option<Quaternion<f64>>,
        camera: Camera,
        catalogue: &Catalogue,
        keep_on: impl FnMut() -> std::result::Result<(), E>,
    ) -> std::result::Result<Self, E> {
        let attitudes = q.iter().map(|q| mounting.map_or(*q, |m| multiply(q, &m)));
        Ok(Self { t, q, mounting, view: View::new(camera, catalogue, attitudes, keep_on)? })
    }

    fn simulate(&self, stream: &mut Stream, out: &mut Fixes, keep_on: &mut dyn FnMut() -> Result<()>) -> Result<()> {
        for k in 0..self.view.len() {
            if k % CHUNK == 0 {
                keep_on()?;
            }
            // fewer than two stars, or all on one line: no fix
            let Ok(fix) = self.view.fix(k, stream, &mut out.scratch) else { continue };
            out.q.push(fix.q);
            out.covariance.push(fix.covariance);
            out.frame.push(k);
            out.t.push(self.t[k]);
            out.truth.push(self.q[k]);
        }
        Ok(())
    }
}

impl StarSource<'_> {
    /// The fixes of one trial, of the camera at this place among all of them.
    pub(super) fn simulate(
        &self,
        (seed, trial, place): (u64, u64, u8),
        out: &mut Fixes,
        keep_on: &mut dyn FnMut() -> Result<()>,
    ) -> Result<()> {
        out.covariance.clear();
        out.frame.clear();
        out.t.clear();
        out.truth.clear();
        match self {
            Self::Noise(camera) => camera.simulate(&mut Stream::new(seed, trial, channel::STAR + place), &mut out.q),
            Self::Field(camera) => {
                out.q.clear();
                camera.simulate(&mut Stream::new(seed, trial, channel::FRAME + place), out, keep_on)?;
            }
        }
        Ok(())
    }

    /// Times of the fixes of a trial, and true attitudes then.
    pub(super) fn known<'a>(&'a self, fixes: &'a Fixes) -> (&'a [f64], &'a [Quaternion<f64>]) {
        match self {
            Self::Noise(camera) => (camera.t, camera.q),
            Self::Field(_) => (&fixes.t, &fixes.truth),
        }
    }

    /// Times of the frames, true attitudes then.
    pub(super) fn frames(&self) -> (&[f64], &[Quaternion<f64>]) {
        match self {
            Self::Noise(camera) => (camera.t, camera.q),
            Self::Field(camera) => (camera.t, camera.q),
        }
    }
}

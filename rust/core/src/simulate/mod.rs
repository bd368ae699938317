//! Seeded simulation of a gyro and star cameras, and campaigns of many trials.

mod camera;
mod campaign;
mod gyro;
mod parallel;
pub mod rng;
mod score;

pub use camera::{Fixes, StarField, StarNoise, StarSource};
pub use campaign::{Begin, Campaign, Estimator, KnownCamera, Scored, monte_carlo};
pub use gyro::GyroErrors;
pub use parallel::{keep_on, over_threads};
pub use rng::{MAX_TRIAL, Stream, channel};
pub use score::Score;

use crate::error::Result;
use crate::quaternion::Quaternion;

/// An attitude history.
#[derive(Clone, Copy, Debug)]
pub struct Truth<'a> {
    /// Times, s, increasing.
    pub t: &'a [f64],
    /// Attitudes `q_ib` then.
    pub q: &'a [Quaternion<f64>],
    /// Mean rates, rad/s, body frame, from each time to the next; what would hold after the last.
    pub rate: &'a [[f64; 3]],
}

/// What is flown, with which sensors.
#[derive(Clone, Debug)]
pub struct Scenario<'a> {
    /// The attitude.
    pub truth: Truth<'a>,
    /// The gyro's errors.
    pub gyro: GyroErrors,
    /// The star cameras.
    pub cameras: Vec<StarSource<'a>>,
}

/// What the sensors of one trial report. Memory is reused from trial to trial.
#[derive(Clone, Debug, Default)]
pub struct Readings {
    /// Rates, gyro frame, rad/s, one for each time of the truth; each holds from its time to the next.
    pub rate: Vec<[f64; 3]>,
    /// Biases, body frame, rad/s: bias and drift at each time.
    pub bias: Vec<[f64; 3]>,
    /// Fixes of each camera.
    pub fixes: Vec<Fixes>,
}

impl Scenario<'_> {
    /// One trial: the same bits for the same seed and trial, in any order and on any thread. `keep_on` is
    /// called now and then.
    ///
    /// # Errors
    /// What `keep_on` returns.
    pub fn simulate(
        &self,
        seed: u64,
        trial: u64,
        out: &mut Readings,
        keep_on: &mut dyn FnMut() -> Result<()>,
    ) -> Result<()> {
        self.gyro.simulate(&self.truth, seed, trial, &mut out.rate, &mut out.bias);
        out.fixes.resize_with(self.cameras.len(), Fixes::default);
        for (place, (camera, fixes)) in self.cameras.iter().zip(&mut out.fixes).enumerate() {
            camera.simulate((seed, trial, place as u8), fixes, keep_on)?;
        }
        Ok(())
    }
}

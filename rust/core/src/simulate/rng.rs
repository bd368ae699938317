//! Random numbers: one stream for each trial and each source of noise.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

/// Trials of one seed: from 0 up to, not including, this number.
pub const MAX_TRIAL: u64 = 1 << 56;

/// Sources of noise. What one of them draws does not depend on which others there are.
pub mod channel {
    /// White noise of the gyro.
    pub const WHITE: u8 = 0;
    /// Walk of the gyro's bias.
    pub const WALK: u8 = 1;
    /// Markov drift of the gyro.
    pub const DRIFT: u8 = 2;
    /// Bias and drift of the gyro at the start.
    pub const BIAS: u8 = 3;
    /// Error that an estimator starts with.
    pub const START: u8 = 4;
    /// Samples of a particle filter.
    pub const PARTICLES: u8 = 5;
    /// Own errors of refraction angles.
    pub const REFRACTION: u8 = 9;
    /// Density of the air that starlight passes.
    pub const DENSITY: u8 = 10;
    /// Each star angle's own error.
    pub const ANGLES: u8 = 6;
    /// Error of the horizon sensor's nadir direction.
    pub const NADIR: u8 = 7;
    /// Which star angles are outliers.
    pub const OUTLIERS: u8 = 8;
    /// First star camera; the next ones follow.
    pub const STAR: u8 = 16;
    /// Centroids of the first physical star camera; those of the next ones follow.
    pub const FRAME: u8 = 80;
    /// How many star cameras there may be.
    pub const STARS: usize = 64;
}

/// Standard normal numbers of one channel of one trial.
///
/// The generator is ChaCha with 8 rounds, a counter under a key (the seed): the stream's number selects
/// independent numbers without running through others (Bernstein, 2008; Salmon et al., SC 2011, for
/// counters in simulation). Normal numbers by the ziggurat of `rand_distr`.
#[derive(Clone, Debug)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of `channel` in `trial`, which is below [`MAX_TRIAL`].
    pub fn new(seed: u64, trial: u64, channel: u8) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((trial << 8) | u64::from(channel));
        Self(rng)
    }

    /// One number of mean zero and variance one.
    #[inline]
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// One number from 0 up to, not including, 1.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        // 53 bits, as many as fit
        (self.0.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Several normal numbers.
    #[inline]
    pub fn normals<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.normal())
    }
}

//! What a filter may go back over while a log is replayed.

/// A log's dynamics, inputs and measurements.
pub struct Past<'a, D, I, Q> {
    /// The dynamics.
    pub dynamics: &'a D,
    /// What drives them.
    pub drive: &'a I,
    /// The measurements.
    pub sensors: &'a Q,
}

/// The interval between the two latest epochs of measurements.
pub struct Window<B> {
    /// Belief after the measurements of the epoch before.
    pub anchor: Epoch<B>,
    /// Belief after the measurements of the latest epoch so far.
    pub latest: Epoch<B>,
    /// Measurements used in the latest epoch.
    pub used: Vec<usize>,
}

/// A belief, its time and the interval of the input samples that it lies in.
#[derive(Clone, Copy)]
pub struct Epoch<B> {
    /// The belief.
    pub belief: B,
    /// Its time, s.
    pub t: f64,
    /// Input sample before it.
    pub k: usize,
}

impl<B: Copy> Window<B> {
    /// Before the first measurement.
    pub fn new(belief: B, t: f64, k: usize) -> Self {
        let start = Epoch { belief, t, k };
        Self { anchor: start, latest: start, used: Vec::new() }
    }
}

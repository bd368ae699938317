//! A gyro with errors.

use super::Truth;
use super::rng::{Stream, channel};
use crate::linalg::{Matrix, apply};
use crate::quaternion::{Quaternion, conjugate, rotate};

/// Errors of a gyro with three axes; all in its own frame.
///
/// Reading `k` is the mean from `t_k` to `t_{k+1}` of `(I + M) ω + b + d + n`: `n` is white, the bias
/// `b` is a random walk, and the drift `d` a first-order Markov process. The integrals of `b` and `d`
/// over the step and their values at its end are drawn together, so that nothing depends on the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroErrors {
    /// Angle random walk, rad/√s.
    pub arw: [f64; 3],
    /// Rate random walk of the bias, rad/s/√s.
    pub rrw: [f64; 3],
    /// Mean of the bias at the start, rad/s.
    pub bias: [f64; 3],
    /// Standard deviation of the bias at the start, rad/s.
    pub bias_sigma: [f64; 3],
    /// Standard deviation of the drift, rad/s.
    pub markov_sigma: [f64; 3],
    /// Correlation time of the drift, s; infinite for a constant one.
    pub markov_time: f64,
    /// `I + M`: one, scale factors on the diagonal, misalignments beside it.
    pub response: Matrix<f64, 3, 3>,
    /// Smallest step of an angle that the gyro reports, rad; 0 for none.
    pub quantisation: f64,
    /// Gyro frame to body, `q_bg`.
    pub mounting: Option<Quaternion<f64>>,
}

/// How two correlated numbers over a step come from standard normal ones.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    /// What is left of the drift at the end.
    decay: f64,
    /// Integral of the drift, for each unit at the start.
    carried: f64,
    /// Noise of the value at the end.
    end: f64,
    /// Noise of the integral that goes with that of the end.
    shared: f64,
    /// Noise of the integral on its own.
    own: f64,
}

impl Step {
    /// Random walk of density one: variances `h` and `h³/3`, covariance `h²/2` (Farrenkopf, 1978).
    fn walk(h: f64) -> Self {
        let end = h.sqrt();
        Self { decay: 1.0, carried: h, end, shared: 0.5 * h * end, own: h * end / 12f64.sqrt() }
    }

    /// Markov process of variance one and correlation time `tau`: with `x = h/τ` and `a = e⁻ˣ` the value's
    /// variance is `1 − a²`, the integral's `τ² (2x − 3 + 4a − a²)`, their covariance `τ (1 − a)²`
    /// (Gillespie, Phys. Rev. E 54, 1996, eqs. 2.10-2.15).
    fn markov(h: f64, tau: f64) -> Self {
        let x = h / tau;
        if x == 0.0 {
            return Self { decay: 1.0, carried: h, ..Self::default() };
        }
        let (gone, end2) = (-(-x).exp_m1(), -(-2.0 * x).exp_m1());
        let end = end2.sqrt();
        let shared = tau * gone * gone / end;
        let left = tau * tau * integral_variance(x) - shared * shared;
        Self { decay: 1.0 - gone, carried: tau * gone, end, shared, own: left.max(0.0).sqrt() }
    }

    /// Moves the value over the step; returns its integral.
    #[inline]
    fn advance(&self, value: &mut f64, sigma: f64, z: [f64; 2]) -> f64 {
        let integral = self.carried * *value + sigma * (self.shared * z[0] + self.own * z[1]);
        *value = self.decay * *value + sigma * self.end * z[0];
        integral
    }
}

/// `2x − 3 + 4 e⁻ˣ − e⁻²ˣ`; its terms cancel to the third order for small `x`.
fn integral_variance(x: f64) -> f64 {
    if x > 0.5 {
        return 2.0 * x - 3.0 + 4.0 * (-x).exp() - (-2.0 * x).exp();
    }
    // Σ (−x)ⁿ (4 − 2ⁿ) / n! from n = 3
    let (mut power, mut two, mut sum) = (0.5 * x * x, 4.0, 0.0);
    for n in 3..24 {
        power *= -x / f64::from(n);
        two *= 2.0;
        sum += power * (4.0 - two);
    }
    sum
}

/// Angles as whole numbers of a smallest step; the rest is carried on to the next reading.
fn quantise(angle: f64, step: f64, carry: &mut f64) -> f64 {
    let total = angle + *carry;
    let told = step * (total / step).round();
    *carry = total - told;
    told
}

impl GyroErrors {
    /// The readings of one trial, in the gyro's frame, and bias and drift in the body frame, at each time of
    /// the truth.
    pub fn simulate(
        &self,
        truth: &Truth<'_>,
        seed: u64,
        trial: u64,
        rate: &mut Vec<[f64; 3]>,
        bias: &mut Vec<[f64; 3]>,
    ) {
        let stream = |c| Stream::new(seed, trial, c);
        let (mut white, mut walk, mut markov) = (stream(channel::WHITE), stream(channel::WALK), stream(channel::DRIFT));
        let (mut b, mut d) = self.at_start(&mut stream(channel::BIAS));
        let walks = self.rrw != [0.0; 3];
        let drifts = self.markov_sigma != [0.0; 3];
        let (mut last, mut root, mut of_walk, mut of_drift) = (f64::NAN, 0.0, Step::default(), Step::default());
        let mut carry = [0.0; 3];
        rate.clear();
        bias.clear();
        for k in 0..truth.t.len() {
            let h = step_after(truth.t, k);
            if h != last {
                (last, root, of_walk) = (h, h.sqrt(), Step::walk(h));
                of_drift = Step::markov(h, self.markov_time);
            }
            bias.push(self.in_body([b[0] + d[0], b[1] + d[1], b[2] + d[2]]));
            let mut angle = self.response_to(&truth.rate[k]).map(|w| w * h);
            let noise: [f64; 3] = white.normals();
            for i in 0..3 {
                angle[i] += self.arw[i] * root * noise[i];
                let z = if walks { walk.normals() } else { [0.0; 2] };
                angle[i] += of_walk.advance(&mut b[i], self.rrw[i], z);
                if drifts {
                    angle[i] += of_drift.advance(&mut d[i], self.markov_sigma[i], markov.normals());
                }
                if self.quantisation > 0.0 {
                    angle[i] = quantise(angle[i], self.quantisation, &mut carry[i]);
                }
            }
            rate.push(angle.map(|a| a / h));
        }
    }

    /// Bias and drift at the start.
    fn at_start(&self, stream: &mut Stream) -> ([f64; 3], [f64; 3]) {
        let z: [f64; 6] = stream.normals();
        let bias = std::array::from_fn(|i| self.bias[i] + self.bias_sigma[i] * z[i]);
        (bias, std::array::from_fn(|i| self.markov_sigma[i] * z[i + 3]))
    }

    fn in_body(&self, v: [f64; 3]) -> [f64; 3] {
        self.mounting.map_or(v, |m| rotate(&m, &v))
    }

    #[inline]
    fn response_to(&self, rate: &[f64; 3]) -> [f64; 3] {
        let own = self.mounting.map_or(*rate, |m| rotate(&conjugate(&m), rate));
        apply(&self.response, &own)
    }
}

/// Length of the step after time `k`; after the last one, that of the one before.
fn step_after(t: &[f64], k: usize) -> f64 {
    let k = k.min(t.len().saturating_sub(2));
    t.get(k + 1).map_or(1.0, |next| next - t[k])
}

//! How far a measurement is believed: a gate, weights for the doubtful, and noise that is found as the filter runs.

use crate::consistency::{chi2_cdf, chi2_quantile};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, apply, from_fn, ldl, mul};
use crate::replay::{MAX_DOF, Report};
use std::cell::Cell;

/// What a measurement that does not fit counts.
///
/// A weight `w` is that of the correction: the covariance `S` of the innovation counts as `S / w`, the gain as `w K`, and
/// `w K S Kᵀ` is what the covariance loses. With `d²` the normalised innovation squared, Huber's is `min(1, k / d)`: beyond
/// `k` standard deviations a measurement moves the state no farther. Student's is `min(1, (ν + m) / (ν + d²))`, the score of a
/// t-distributed innovation of `m` degrees of freedom (Masreliez 1975): beyond some it moves the state less and less.
///
/// Sources: Masreliez, *Approximate non-Gaussian filtering with linear state and observation relations*, 1975; Huber,
/// *Robust estimation of a location parameter*, 1964; Chang, *Robust Kalman filtering based on Mahalanobis distance as
/// outlier judging criterion*, 2014, who puts the covariance of the innovation in place of the noise alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Robust {
    /// All of it.
    #[default]
    Full,
    /// Huber's weight beyond so many standard deviations of a scalar; for more degrees of freedom the distance that
    /// as many good measurements stay within.
    Huber(f64),
    /// That of Student's distribution with so many degrees of freedom.
    StudentT(f64),
}

/// How measurements are believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trust {
    /// Probability with which a good measurement is accepted; 1 accepts all.
    pub gate: f64,
    /// Weights within the gate.
    pub robust: Robust,
    /// Noise is found as the filter runs, as a factor of each sensor's own, from about so many measurements.
    pub memory: Option<f64>,
}

impl From<f64> for Trust {
    fn from(gate: f64) -> Self {
        Self { gate, robust: Robust::Full, memory: None }
    }
}

/// Share of good measurements that the search for the noise takes as they are; others count as the last of these, so that an
/// outlier cannot pass for noise.
const FAIR: f64 = 0.99;

/// A [`Trust`] in numbers, by degrees of freedom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trusted {
    gates: [f64; MAX_DOF],
    robust: Robust,
    /// Huber's distances.
    limits: [f64; MAX_DOF],
    /// By how much one measurement moves the logarithm of the noise; none does if it is 0.
    gain: f64,
    /// Where the search for the noise cuts off, and what it then finds of good measurements on average, instead of 1.
    cut: [f64; MAX_DOF],
    mean: [f64; MAX_DOF],
}

/// Behind it nothing is accepted.
const CLOSED: [f64; MAX_DOF] = [f64::NEG_INFINITY; MAX_DOF];
const OPEN: [f64; MAX_DOF] = [f64::INFINITY; MAX_DOF];

impl Trusted {
    /// # Errors
    /// A probability outside (0, 1], a Huber distance, degrees of freedom or a memory that is not positive.
    pub(super) fn new(trust: Trust) -> Result<Self> {
        let positive = |field, value: f64, need| {
            if value > 0.0 && value.is_finite() { Ok(()) } else { Err(Error::Parameter { field, value, need }) }
        };
        match trust.robust {
            Robust::Full => {}
            Robust::Huber(k) => positive("huber", k, "must be positive, in standard deviations")?,
            Robust::StudentT(nu) => positive("student_t", nu, "must be positive, in degrees of freedom")?,
        }
        if let Some(n) = trust.memory {
            positive("adaptive", n, "must be positive, in measurements")?;
        }
        let mut limits = [f64::INFINITY; MAX_DOF];
        if let Robust::Huber(k) = trust.robust {
            let share = chi2_cdf(k * k, 1.0);
            limits = by_dof(|m| Ok(if m == 1.0 { k } else { chi2_quantile(share, m)?.sqrt() }))?;
        }
        let cut = by_dof(|m| chi2_quantile(FAIR, m))?;
        let mut mean = [1.0; MAX_DOF];
        for (i, mean) in mean.iter_mut().enumerate() {
            // of a chi-square variable cut off at c: m F(c; m + 2) + c (1 - F(c; m)), over m
            let (c, m) = (cut[i], (i + 1) as f64);
            *mean = chi2_cdf(c, m + 2.0) + c * (1.0 - chi2_cdf(c, m)) / m;
        }
        let gain = trust.memory.map_or(0.0, |n| 1.0 / n);
        Ok(Self { gates: gates(trust.gate)?, robust: trust.robust, limits, gain, cut, mean })
    }

    /// Gates for one to [`MAX_DOF`] degrees of freedom.
    pub(super) fn gates(&self) -> &[f64; MAX_DOF] {
        &self.gates
    }

    /// Whether there is a gate and nothing else.
    #[inline(always)]
    pub(super) fn is_plain(&self) -> bool {
        self.robust == Robust::Full && self.gain == 0.0
    }

    /// Weight of a measurement.
    fn weight(&self, report: &Report) -> f64 {
        match self.robust {
            Robust::Full => 1.0,
            Robust::Huber(_) => (self.limits[report.dof - 1] / report.nis.sqrt()).min(1.0),
            Robust::StudentT(nu) => ((nu + report.dof as f64) / (nu + report.nis)).min(1.0),
        }
    }

    /// Corrects by a measurement with this noise (packed; of fewer degrees of freedom the first ones), multiplied by the
    /// `scale` of its sensor. `update` is given the noise to compute with and gates. The report is that of the measurement as
    /// it came.
    #[inline(always)]
    pub(super) fn correct(
        &self,
        noise: &[f64; 6],
        scale: Option<&Cell<f64>>,
        mut update: impl FnMut(&[f64; 6], &[f64; MAX_DOF]) -> Report,
    ) -> Report {
        let plain = self.is_plain();
        let (mut counted, mut gates, mut seen) = (*noise, &self.gates, None);
        if !plain {
            let scale = scale.map_or(1.0, Cell::get);
            counted = noise.map(|r| r * scale);
            gates = if self.robust == Robust::Full { gates } else { &CLOSED };
        }
        let mut report;
        // One call of `update` in the code, though it may run twice: it is compiled into the filter's loop. And one report,
        // written where it is returned: most logs are plain, and have nothing to pay for what they do not ask for.
        loop {
            report = update(&counted, gates);
            if plain || seen.is_some() || self.robust == Robust::Full || !report.ok {
                break;
            }
            if self.gates[report.dof - 1] <= report.nis {
                break; // outside the gate it stays as it was refused behind the closed one
            }
            let more = 1.0 / self.weight(&report) - 1.0;
            for (r, (i, j)) in counted.iter_mut().zip(PACKED) {
                if more > 0.0 && i.max(j) < report.dof {
                    *r += more * report.covariance[i][j];
                }
            }
            seen = Some((report.nis, report.innovation, report.covariance));
            gates = &OPEN;
        }
        if let Some((nis, innovation, covariance)) = seen {
            (report.nis, report.innovation, report.covariance) = (nis, innovation, covariance);
        }
        if let Some(scale) = scale.filter(|_| self.gain > 0.0 && report.ok && report.nis > 0.0) {
            scale.set(self.adapted(&report, noise, scale.get()));
        }
        report
    }

    /// The noise's scale after a measurement: a step up the slope of the logarithm of its likelihood,
    /// `½ (νᵀ S⁻¹ R S⁻¹ ν − tr S⁻¹ R)` for the logarithm of the scale of `R`.
    fn adapted(&self, report: &Report, noise: &[f64; 6], scale: f64) -> f64 {
        let m = report.dof;
        let pad = |i: usize, j: usize| if i == j { 1.0 } else { 0.0 };
        let inside = |i: usize, j: usize| i.max(j) < m;
        let s: Matrix<f64, 3, 3> = from_fn(|i, j| if inside(i, j) { report.covariance[i][j] } else { pad(i, j) });
        let at = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        let r: Matrix<f64, 3, 3> = from_fn(|i, j| if inside(i, j) { noise[at[i][j]] * scale } else { 0.0 });
        let inverse = ldl(&s).inverse();
        let innovation = std::array::from_fn(|i| if i < m { report.innovation[i] } else { 0.0 });
        let weighed = apply(&inverse, &innovation);
        let through = apply(&r, &weighed);
        let seen: f64 = weighed.iter().zip(&through).map(|(a, b)| a * b).sum();
        let share = mul(&inverse, &r);
        let expected = share[(0, 0)] + share[(1, 1)] + share[(2, 2)];
        let cut = (self.cut[m - 1] / report.nis).min(1.0);
        let step = self.gain * (seen * cut / self.mean[m - 1] - expected) / m as f64;
        if !step.is_finite() {
            return scale; // a covariance beyond all bounds tells nothing
        }
        // a step of more than a factor of two would be a guess
        scale * step.clamp(-std::f64::consts::LN_2, std::f64::consts::LN_2).exp()
    }
}

/// Rows and columns of a packed symmetric matrix's entries.
const PACKED: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// The variance of a noise of equal axes that is no smaller than a given one of two degrees of freedom.
pub(super) fn largest(noise: &[f64; 6]) -> f64 {
    let [a, b, _, c, ..] = *noise;
    0.5 * (a + c) + (0.25 * (a - c) * (a - c) + b * b).sqrt()
}

fn by_dof(mut value: impl FnMut(f64) -> Result<f64>) -> Result<[f64; MAX_DOF]> {
    let mut out = [0.0; MAX_DOF];
    for (i, out) in out.iter_mut().enumerate() {
        *out = value((i + 1) as f64)?;
    }
    Ok(out)
}

/// Gates for one to [`MAX_DOF`] degrees of freedom.
fn gates(probability: f64) -> Result<[f64; MAX_DOF]> {
    if probability == 0.0 {
        return Err(Error::Parameter { field: "gate", value: 0.0, need: "must be a probability above 0, up to 1" });
    }
    by_dof(|m| chi2_quantile(probability, m))
}

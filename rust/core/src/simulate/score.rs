//! How far an estimate was from the truth.

use super::Truth;
use crate::attitude::{Attitude, AttitudeBias, Buffers};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, cholesky, forward_solve, from_fn};
use crate::manifold::Manifold;
use crate::quaternion::{Quaternion, difference, exp, multiply};
use crate::replay::End;

/// Errors of one trial, body frame; means over the window of time that is scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Root mean square attitude error about each axis, rad, at the fixes, after they are used.
    pub rms: [f64; 3],
    /// The same at every gyro sample.
    pub rms_all: [f64; 3],
    /// The same at the fixes, before they are used.
    pub rms_before: [f64; 3],
    /// Root mean square bias error, rad/s, at every gyro sample.
    pub rms_bias: [f64; 3],
    /// Mean normalised squared error of the attitude at the fixes; 3 for a consistent estimate.
    pub nees_attitude: f64,
    /// Mean normalised squared error of attitude and bias; 6 for a consistent estimate.
    pub nees: f64,
    /// Mean normalised innovation squared of the measurements used; 3 for a consistent filter.
    pub nis: f64,
    /// Share of the measurements that the gate let through.
    pub accepted: f64,
    /// Error at the end: attitude, rad, and bias, rad/s.
    pub final_error: [f64; 6],
    /// Time that the estimator took, s.
    pub seconds: f64,
}

/// What was flown in one trial, and what is scored of it.
pub(super) struct Flown<'a> {
    pub(super) truth: &'a Truth<'a>,
    /// Bias at the times of the truth, body frame.
    pub(super) bias: &'a [[f64; 3]],
    /// Whether there is a fix at the time, or since the one before.
    pub(super) fixed: &'a [bool],
    /// True attitudes at the fixes of each camera.
    pub(super) true_fixes: Vec<&'a [Quaternion<f64>]>,
    /// Fixes of each camera as the estimator takes them, body to inertial.
    pub(super) fixes: Vec<&'a [Quaternion<f64>]>,
    /// First and last time that count, s.
    pub(super) window: [f64; 2],
}

/// Sums over rows.
struct Sums<const N: usize> {
    sum: [f64; N],
    rows: usize,
}

impl<const N: usize> Sums<N> {
    fn new() -> Self {
        Self { sum: [0.0; N], rows: 0 }
    }
    #[inline]
    fn add(&mut self, values: [f64; N]) {
        for (s, v) in self.sum.iter_mut().zip(values) {
            *s += v;
        }
        self.rows += 1;
    }
    fn mean(&self) -> [f64; N] {
        self.sum.map(|s| s / self.rows as f64)
    }
    fn rms(&self) -> [f64; N] {
        self.mean().map(f64::sqrt)
    }
}

fn squares(v: [f64; 3]) -> [f64; 3] {
    v.map(|x| x * x)
}

impl Flown<'_> {
    fn counts(&self, t: f64) -> bool {
        t >= self.window[0] && t <= self.window[1]
    }

    /// The score of what an estimator wrote.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub(super) fn score(&self, out: &Buffers, end: &End<AttitudeBias, 6>, seconds: f64) -> Result<Score> {
        let (mut fixed, mut all, mut bias) = (Sums::<3>::new(), Sums::<3>::new(), Sums::<3>::new());
        let mut nees = Sums::<2>::new();
        // the first row is the start, which may lie between two samples
        let first = self.truth.t.partition_point(|s| out.t.first().is_some_and(|t| s < t));
        let skip = usize::from(self.truth.t.get(first) != out.t.first());
        let first = first.saturating_sub(skip);
        for row in skip..out.t.len() {
            let k = first + row;
            if !self.counts(out.t[row]) {
                continue;
            }
            let e = error(&out.q[row], &out.bias[row], &self.truth.q[k], &self.bias[k]);
            let turned = squares([e[0], e[1], e[2]]);
            all.add(turned);
            bias.add(squares([e[3], e[4], e[5]]));
            if self.fixed[k] {
                fixed.add(turned);
                nees.add(normalised(&e, &out.covariance[row], k, out.t[row])?);
            }
        }
        let (before, [nis, accepted]) = self.innovations(out);
        let [nees_attitude, nees] = nees.mean();
        let last = self.truth.t.len() - 1;
        Ok(Score {
            rms: fixed.rms(),
            rms_all: all.rms(),
            rms_before: before,
            rms_bias: bias.rms(),
            nees_attitude,
            nees,
            nis,
            accepted,
            final_error: error(&end.mean.q, &end.mean.bias, &self.truth.q[last], &self.bias[last]),
            seconds,
        })
    }

    /// Error before the fixes, mean NIS and the share of fixes used. The prediction is the fix turned
    /// back by the innovation.
    fn innovations(&self, out: &Buffers) -> ([f64; 3], [f64; 2]) {
        let (mut before, mut nis, mut accepted) = (Sums::<3>::new(), Sums::<1>::new(), Sums::<1>::new());
        for m in 0..out.measured_t.len() {
            if !self.counts(out.measured_t[m]) {
                continue;
            }
            let (camera, row) = (out.source[0][m] as usize, out.source[1][m] as usize);
            let predicted = multiply(&self.fixes[camera][row], &exp(&out.innovation[m].map(|v| -v)));
            before.add(squares(difference(&predicted, &self.true_fixes[camera][row])));
            accepted.add([f64::from(u8::from(out.accepted[m]))]);
            if out.accepted[m] {
                nis.add([out.nis[m]]);
            }
        }
        (before.rms(), [nis.mean()[0], accepted.mean()[0]])
    }
}

/// Truth less estimate.
fn error(q: &Quaternion<f64>, bias: &[f64; 3], truth: &Quaternion<f64>, true_bias: &[f64; 3]) -> [f64; 6] {
    AttitudeBias::local(&Attitude { q: *q, bias: *bias }, &Attitude { q: *truth, bias: *true_bias })
}

/// Normalised squared errors of the attitude, and of attitude and bias: with `P = L Lᵀ` the first three
/// components of `L⁻¹ e` are those of the attitude alone.
fn normalised(e: &[f64; 6], p: &[[f64; 6]; 6], step: usize, t: f64) -> Result<[f64; 2]> {
    let p: Matrix<f64, 6, 6> = from_fn(|i, j| p[i][j]);
    let (l, ok) = cholesky(&p);
    if !ok {
        return Err(Error::NotPositiveDefinite { what: "covariance", step, t });
    }
    let y = forward_solve(&l, e);
    let attitude = y[0] * y[0] + y[1] * y[1] + y[2] * y[2];
    Ok([attitude, attitude + y[3] * y[3] + y[4] * y[4] + y[5] * y[5]])
}

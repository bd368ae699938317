//! A start from the first star fixes.

use super::gyro::GyroModel;
use super::series::{AttitudeSensor, AttitudeSensors, GyroSeries};
use super::state::{Attitude, AttitudeBias};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, zeros};
use crate::quaternion::{Quaternion, conjugate, difference, dot3, exp, multiply, unit};
use crate::replay::Start;

/// Fixes that are compared with each other.
const CANDIDATES: usize = 7;
/// Chi-square, 3 degrees of freedom, that a good difference exceeds once in a million times.
const AGREEMENT: f64 = 30.7;
/// Chi-square that the fix to start from does not exceed: 99 of 100 good ones.
const START: f64 = 11.3;

struct Fix {
    measurement: usize,
    t: f64,
    q: Quaternion<f64>,
    noise: [f64; 6],
    /// Rotation since the first candidate by the gyro alone.
    turned: Quaternion<f64>,
}

/// Starts from the first star fix that most of the next few agree with, carried to each other by the
/// gyro: one bad first fix does not matter. The bias starts at `bias` with standard deviation
/// `bias_sigma` per axis (rad/s); the attitude's covariance is the fix's own.
///
/// Fixes agree when one constant bias explains what the gyro misses between them, to their own noise:
/// every pair of fixes proposes a bias, the best supported proposal is fitted to all that support it,
/// and the first fix that lies well within its own noise of that fit is taken. Where no pair convinces
/// most of the others, agreement to the uncertainty of the bias is enough, and failing that the first
/// fix is all there is.
///
/// # Errors
/// `NoStart` where no star fix lies within the gyro's time span.
pub fn first_fix(
    gyro: &GyroSeries<'_>,
    sensors: &AttitudeSensors<'_>,
    model: &GyroModel,
    bias: [f64; 3],
    bias_sigma: [f64; 3],
) -> Result<Start<AttitudeBias, 6>> {
    let fixes = candidates(gyro, sensors, &bias);
    let slack = bias_sigma.iter().fold(0.0, |m: f64, s| m.max(s * s));
    let close = |a: &&Fix| 2 * fixes.iter().filter(|b| a.near(b, slack)).count() > fixes.len();
    let fix = best_supported(&fixes, model.arw, slack)
        .or_else(|| fixes.iter().find(close))
        .or(fixes.first())
        .ok_or(Error::NoStart { sensor: "star camera" })?;
    Ok(Start {
        t: fix.t,
        mean: Attitude { q: fix.q, bias },
        covariance: covariance(&fix.noise, &bias_sigma),
        used: Some(fix.measurement),
    })
}

impl Fix {
    /// Rotation vector from this fix, carried to the other's time by the gyro, to the other.
    fn missed(&self, other: &Fix) -> [f64; 3] {
        difference(&multiply(&self.q, &multiply(&conjugate(&self.turned), &other.turned)), &other.q)
    }
    /// Whether the two agree to the uncertainty of the bias.
    fn near(&self, other: &Fix, slack: f64) -> bool {
        let (v, dt) = (self.missed(other), other.t - self.t);
        dot3(&v, &v) <= AGREEMENT * (variance(&self.noise) + variance(&other.noise) + slack * dt * dt)
    }
}

/// The fix to start from, if some bias explains more than half of the fixes and at least two beside
/// the one it is counted from.
fn best_supported(fixes: &[Fix], arw: f64, slack: f64) -> Option<&Fix> {
    let mut best: (usize, Option<&Fix>) = (fixes.len().max(3) / 2, None);
    // a short pair says too little of the bias to carry it far
    let span = fixes.last().zip(fixes.first()).map_or(0.0, |(b, a)| b.t - a.t);
    for (i, a) in fixes.iter().enumerate() {
        for b in fixes.iter().skip(i + 1).filter(|b| b.t > a.t && b.t - a.t >= 0.5 * span) {
            let of_pair = pair_variance(a, b, arw);
            let rate = a.missed(b).map(|v| v / (b.t - a.t));
            if dot3(&rate, &rate) > AGREEMENT * (slack + of_pair) {
                continue;
            }
            let explained: Vec<&Fix> = fixes
                .iter()
                .filter(|c| {
                    let (v, dt) = (a.missed(c), c.t - a.t);
                    let left: [f64; 3] = std::array::from_fn(|k| v[k] - rate[k] * dt);
                    let own = variance(&a.noise) + variance(&c.noise) + arw * arw * dt.abs();
                    dot3(&left, &left) <= AGREEMENT * (own + of_pair * dt * dt)
                })
                .collect();
            if explained.len() > best.0 {
                best = (explained.len(), well_within(a, &explained));
            }
        }
    }
    best.1
}

/// The first of some fixes that lies within its noise of a straight line through all of them.
fn well_within<'a>(origin: &Fix, fixes: &[&'a Fix]) -> Option<&'a Fix> {
    let n = fixes.len() as f64;
    let middle = fixes.iter().map(|c| c.t - origin.t).sum::<f64>() / n;
    let points: Vec<(f64, [f64; 3])> = fixes.iter().map(|c| (c.t - origin.t - middle, origin.missed(c))).collect();
    let spread = points.iter().map(|(t, _)| t * t).sum::<f64>();
    let line: [(f64, f64); 3] = std::array::from_fn(|k| {
        let mean = points.iter().map(|(_, v)| v[k]).sum::<f64>() / n;
        (mean, points.iter().map(|(t, v)| t * v[k]).sum::<f64>() / spread)
    });
    let inside = |(c, (t, v)): &(&&'a Fix, &(f64, [f64; 3]))| {
        let left: [f64; 3] = std::array::from_fn(|k| v[k] - line[k].0 - line[k].1 * t);
        dot3(&left, &left) <= START * variance(&c.noise)
    };
    fixes.iter().zip(&points).find(inside).map(|(c, _)| *c)
}

/// Variance per axis of the bias that a pair proposes, (rad/s)².
fn pair_variance(a: &Fix, b: &Fix, arw: f64) -> f64 {
    let dt = b.t - a.t;
    (variance(&a.noise) + variance(&b.noise) + arw * arw * dt) / (dt * dt)
}

fn candidates(gyro: &GyroSeries<'_>, sensors: &AttitudeSensors<'_>, bias: &[f64; 3]) -> Vec<Fix> {
    let mut fixes: Vec<Fix> = Vec::new();
    let (Some(begin), Some(end)) = (gyro.t.first(), gyro.t.last()) else { return fixes };
    let mut turned = unit();
    for measurement in 0..sensors.len() {
        let t = sensors.time(measurement);
        if t < *begin {
            continue;
        }
        if t > *end || fixes.len() == CANDIDATES {
            break;
        }
        let (sensor, row) = sensors.source(measurement);
        let AttitudeSensor::Star(star) = &sensors.sensors()[sensor] else { continue };
        if let Some(last) = fixes.last() {
            turned = multiply(&turned, &turn(gyro, last.t, t, bias));
        }
        let (q, noise) = star.fix(row);
        fixes.push(Fix { measurement, t, q, noise, turned });
    }
    fixes
}

/// Rotation from `from` to `to` by the gyro.
fn turn(gyro: &GyroSeries<'_>, from: f64, to: f64, bias: &[f64; 3]) -> Quaternion<f64> {
    let mut q = unit();
    let mut t = from;
    let mut k = gyro.t.partition_point(|s| *s <= from).saturating_sub(1);
    while t < to && k + 1 < gyro.t.len() {
        let end = gyro.t[k + 1].min(to);
        let u = gyro.between(k);
        q = multiply(&q, &exp(&std::array::from_fn(|i| (u.rate[i] - bias[i]) * (end - t))));
        t = end;
        k += 1;
    }
    q
}

/// Variance about the worst axis.
fn variance(noise: &[f64; 6]) -> f64 {
    noise[0].max(noise[3]).max(noise[5])
}

fn covariance(noise: &[f64; 6], bias_sigma: &[f64; 3]) -> Matrix<f64, 6, 6> {
    let at = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
    let mut p = zeros();
    for i in 0..3 {
        for j in 0..3 {
            p[(i, j)] = noise[at[i][j]];
        }
        p[(i + 3, i + 3)] = bias_sigma[i] * bias_sigma[i];
    }
    p
}

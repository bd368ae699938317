//! A start from the first star fixes.

use super::series::{AttitudeSensor, AttitudeSensors, GyroSeries};
use super::state::{Attitude, AttitudeBias};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, zeros};
use crate::quaternion::{Quaternion, angle_between, conjugate, exp, multiply, unit};
use crate::replay::{Drive, Sensors, Start};

/// Fixes that are compared with each other.
const CANDIDATES: usize = 7;
/// How many standard deviations two fixes may differ by.
const AGREEMENT: f64 = 6.0;

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
/// # Errors
/// `NoStart` where no star fix lies within the gyro's time span.
pub fn first_fix(
    gyro: &GyroSeries<'_>,
    sensors: &AttitudeSensors<'_>,
    bias: [f64; 3],
    bias_sigma: [f64; 3],
) -> Result<Start<AttitudeBias, 6>> {
    let fixes = candidates(gyro, sensors, &bias);
    let slack = bias_sigma.iter().map(|s| s * s).sum::<f64>();
    let agree = |a: &Fix, b: &Fix| {
        let carried = multiply(&a.q, &multiply(&conjugate(&a.turned), &b.turned));
        let dt = b.t - a.t;
        let variance = trace(&a.noise) + trace(&b.noise) + slack * dt * dt;
        angle_between(&carried, &b.q) <= AGREEMENT * variance.sqrt()
    };
    let supported = |a: &&Fix| 2 * fixes.iter().filter(|b| agree(a, b)).count() > fixes.len();
    let fix = fixes.iter().find(supported).or(fixes.first()).ok_or(Error::NoStart { sensor: "star camera" })?;
    Ok(Start {
        t: fix.t,
        mean: Attitude { q: fix.q, bias },
        covariance: covariance(&fix.noise, &bias_sigma),
        used: Some(fix.measurement),
    })
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
        fixes.push(Fix { measurement, t, q: star.q[row], noise: star.noise[row], turned });
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
        let u = gyro.input::<f64>(k);
        q = multiply(&q, &exp(&std::array::from_fn(|i| (u.rate[i] - bias[i]) * (end - t))));
        t = end;
        k += 1;
    }
    q
}

fn trace(noise: &[f64; 6]) -> f64 {
    noise[0] + noise[3] + noise[5]
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

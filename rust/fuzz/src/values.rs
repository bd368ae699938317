//! Numbers, most of them such as logs hold.

use arbitrary::{Result, Unstructured};
use celestcore_core::attitude::{AnyFilter, Attitude, GyroModel, GyroTiming, Robust, Sampling, Trust};
use celestcore_core::filter::{Ekf, Iterated, SrUkf, Ukf, Unscented};
use celestcore_core::linalg::Matrix;
use celestcore_core::quaternion::Integrator;

/// What logs should not hold.
const ODD: [f64; 12] = [
    0.0,
    -0.0,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::MIN_POSITIVE,
    5e-324,
    f64::MAX,
    1e300,
    -1e160,
    1e-160,
    f64::EPSILON,
];

/// A number of that size, of any bits, or an odd one.
pub(crate) fn value(u: &mut Unstructured<'_>, size: f64) -> Result<f64> {
    match u.int_in_range(0..=63)? {
        0 => Ok(f64::from_bits(u.arbitrary()?)),
        1 => Ok(*u.choose(&ODD)?),
        _ => Ok(size * f64::from(u.arbitrary::<i16>()?) / 32768.0),
    }
}

/// Arrays of such numbers.
pub(crate) struct Given;

impl Given {
    pub(crate) fn many<const N: usize>(
        u: &mut Unstructured<'_>,
        mut one: impl FnMut(&mut Unstructured<'_>) -> Result<f64>,
    ) -> Result<[f64; N]> {
        let mut out = [0.0; N];
        for x in &mut out {
            *x = one(u)?;
        }
        Ok(out)
    }
}

/// Times, most of them increasing.
pub(crate) fn times(u: &mut Unstructured<'_>, most: usize) -> Result<Vec<f64>> {
    let n = u.int_in_range(0..=most)?;
    let mut t = value(u, 1.0)?;
    let mut out = Vec::with_capacity(n);
    for _ in 0..n {
        out.push(t);
        let step = value(u, 0.2)?;
        t += if u.ratio(1, 100)? { step } else { step.abs() };
    }
    Ok(out)
}

pub(crate) fn rate(u: &mut Unstructured<'_>) -> Result<[f64; 3]> {
    Given::many(u, |u| value(u, 0.1))
}

pub(crate) fn vector(u: &mut Unstructured<'_>) -> Result<[f64; 3]> {
    let x: [f64; 3] = Given::many(u, |u| value(u, 1.0))?;
    let norm = x.iter().map(|v| v * v).sum::<f64>().sqrt();
    Ok(if u.ratio(1, 50)? { x } else { x.map(|v| v / norm) })
}

pub(crate) fn quaternion(u: &mut Unstructured<'_>) -> Result<[f64; 4]> {
    let q: [f64; 4] = Given::many(u, |u| value(u, 1.0))?;
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let q = q.map(|v| v / norm);
    // the square of a small number may be none: what is finite is of unit length, others' makers see to that
    let length = q.iter().map(|v| v * v).sum::<f64>();
    Ok(if (length - 1.0).abs() < 1e-12 || !length.is_finite() { q } else { [0.0, 0.0, 0.0, 1.0] })
}

pub(crate) fn noise(u: &mut Unstructured<'_>) -> Result<[f64; 6]> {
    // A fix without noise along an axis is refused where sensors are described. Axes a million times as sharp as others are
    // too much for the invariant filter: what it tells along the body's axes is turned there from the inertial ones, and
    // rounding may leave a variance below zero, of which sigma is no number.
    let s: [f64; 3] = Given::many(u, |u| Ok(value(u, 1e-3)?.abs().max(1e-6)))?;
    let off = if u.ratio(1, 8)? { value(u, 1e-7)? } else { 0.0 };
    Ok([s[0] * s[0], off, 0.0, s[1] * s[1], 0.0, s[2] * s[2]])
}

pub(crate) fn attitude(u: &mut Unstructured<'_>) -> Result<Attitude<f64>> {
    // a state is of unit length: its makers see to that
    let q = quaternion(u)?;
    let unit = (q.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-9;
    let q = if unit { q } else { [1.0, 0.0, 0.0, 0.0] };
    let bias = rate(u)?;
    Ok(Attitude { q, bias: if bias.iter().all(|b| b.is_finite()) { bias } else { [0.0; 3] } })
}

pub(crate) fn covariance(u: &mut Unstructured<'_>) -> Result<Matrix<f64, 6, 6>> {
    let mut root = Matrix::<f64, 6, 6>::zeros();
    for i in 0..6 {
        for j in 0..=i {
            let size = if i < 3 { 1e-2 } else { 1e-3 };
            let entry = value(u, if i == j { size } else { 0.3 * size })?;
            // whether a singular one passes for positive definite is up to rounding
            root[(i, j)] = if i == j { entry.abs().max(1e-3 * size) } else { entry };
        }
    }
    Ok(root * root.transpose())
}

pub(crate) fn model(u: &mut Unstructured<'_>) -> Result<Option<GyroModel>> {
    let way = if u.arbitrary()? { Integrator::Exponential } else { Integrator::Rk4 };
    Ok(GyroModel::new(value(u, 1e-3)?.abs(), value(u, 1e-5)?.abs(), way).ok())
}

pub(crate) fn timing(u: &mut Unstructured<'_>) -> Result<GyroTiming> {
    let sampling = *u.choose(&[Sampling::Hold, Sampling::Integrated, Sampling::Average])?;
    Ok(GyroTiming { sampling, max_gap: value(u, 0.5)?.abs(), gap_rate_sigma: value(u, 1e-2)?.abs() })
}

pub(crate) fn trust(u: &mut Unstructured<'_>) -> Result<Trust> {
    let gate = if u.arbitrary()? { 1.0 } else { value(u, 1.0)? };
    let robust = match u.int_in_range(0..=2)? {
        0 => Robust::Full,
        1 => Robust::Huber(value(u, 3.0)?.abs()),
        _ => Robust::StudentT(value(u, 9.0)?.abs()),
    };
    let memory = if u.arbitrary()? { Some(value(u, 100.0)?.abs()) } else { None };
    Ok(Trust { gate, robust, memory })
}

pub(crate) fn filter(u: &mut Unstructured<'_>) -> Result<Option<AnyFilter>> {
    let kappa = if u.arbitrary()? { Some(value(u, 3.0)?) } else { None };
    let weights = Unscented::new(value(u, 1.0)?, value(u, 2.0)?, kappa);
    let ukf = Ukf { weights: weights.clone().unwrap_or_default() };
    Ok(match u.int_in_range(0..=6)? {
        0 => Some(AnyFilter::Ekf(Ekf { reset: u.arbitrary()? })),
        1 => weights.is_ok().then_some(AnyFilter::Ukf(ukf)),
        2 => weights.and_then(SrUkf::new).ok().map(AnyFilter::SrUkf),
        3 => Some(AnyFilter::Iterated(Iterated { iterations: u.int_in_range(0..=9)?, tolerance: value(u, 1e-2)? })),
        4 => Some(AnyFilter::Invariant),
        5 => weights.is_ok().then_some(AnyFilter::Literal(ukf)),
        _ => Some(AnyFilter::Ukf(Ukf::default())),
    })
}

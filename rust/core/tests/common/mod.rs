//! A made log with known truth, and differences.
#![allow(dead_code, unreachable_pub)]

use celestcore_core::attitude::{Attitude, AttitudeBias};
use celestcore_core::linalg::{Matrix, zeros};
use celestcore_core::quaternion::{exp, multiply};
use celestcore_core::replay::Start;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

pub const DT: f64 = 0.1;
pub const ARW: f64 = 2.5e-5;
pub const RRW: f64 = 3.0e-6;
pub const SIGMA: f64 = 2.5e-5;

pub struct Made {
    pub t: Vec<f64>,
    pub rate: Vec<[f64; 3]>,
    pub star_t: Vec<f64>,
    pub star_q: Vec<[f64; 4]>,
    pub noise: Vec<[f64; 6]>,
    pub truth: Vec<[f64; 4]>,
}

pub fn normals(seed: u64) -> impl FnMut() -> f64 {
    let mut rng = StdRng::seed_from_u64(seed);
    move || rng.sample(StandardNormal)
}

/// Gyro held between samples, a star fix every second sample.
pub fn made(n: usize, seed: u64) -> Made {
    let mut normal = normals(seed);
    let (mut q, mut bias) = ([1.0, 0.0, 0.0, 0.0], [1e-4, -2e-4, 1.5e-4]);
    let mut log = Made { t: vec![], rate: vec![], star_t: vec![], star_q: vec![], noise: vec![], truth: vec![] };
    for k in 0..n {
        let t = k as f64 * DT;
        let truth = [0.02 * (0.1 * t).sin(), 0.02 * (0.13 * t).cos(), 0.01 * (0.07 * t).sin() + 0.01];
        if k % 2 == 0 {
            log.star_t.push(t);
            log.star_q.push(multiply(&q, &exp(&std::array::from_fn(|_| SIGMA * normal()))));
            log.noise.push([SIGMA * SIGMA, 0.0, 0.0, SIGMA * SIGMA, 0.0, SIGMA * SIGMA]);
        }
        log.truth.push(q);
        for b in &mut bias {
            *b += RRW * DT.sqrt() * normal();
        }
        log.t.push(t);
        log.rate.push(std::array::from_fn(|i| truth[i] + bias[i] + ARW / DT.sqrt() * normal()));
        q = multiply(&q, &exp(&truth.map(|w| w * DT)));
    }
    log
}

pub fn start(log: &Made) -> Start<AttitudeBias, 6> {
    let mut covariance = zeros();
    for i in 0..3 {
        covariance[(i, i)] = SIGMA * SIGMA;
        covariance[(i + 3, i + 3)] = 1e-6;
    }
    Start { t: 0.0, mean: Attitude { q: log.star_q[0], bias: [0.0; 3] }, covariance, used: Some(0) }
}

/// Random positive definite matrix, not diagonal.
pub fn spd<const N: usize>(normal: &mut impl FnMut() -> f64, scale: f64) -> Matrix<f64, N, N> {
    let a = Matrix::<f64, N, N>::from_fn(|_, _| normal());
    (a * a.transpose() + Matrix::<f64, N, N>::identity()) * scale
}

pub fn attitude(normal: &mut impl FnMut() -> f64) -> Attitude<f64> {
    let v = std::array::from_fn(|_| 2.0 * normal());
    Attitude { q: exp(&v), bias: std::array::from_fn(|_| 0.1 * normal()) }
}

pub fn close<const R: usize, const C: usize>(a: &Matrix<f64, R, C>, b: &Matrix<f64, R, C>, tolerance: f64) {
    let off = (a - b).abs().max();
    assert!(off <= tolerance, "off by {off:e} > {tolerance:e}\n{a}\n{b}");
}

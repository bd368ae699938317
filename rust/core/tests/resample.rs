//! Resampling: unbiased, of the scatter that theory gives, and exact at the edges.
#![allow(clippy::unwrap_used)]

use celestcore_core::Error;
use celestcore_core::resample::{Resampling, effective_sample_size, normalise_logs, resample};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

const WAYS: [Resampling; 4] =
    [Resampling::Systematic, Resampling::Stratified, Resampling::Residual, Resampling::Multinomial];

fn draw(way: Resampling, weights: &[f64], n: usize, rng: &mut StdRng) -> Vec<usize> {
    let mut out = vec![usize::MAX; n];
    resample(way, weights, || rng.random::<f64>(), &mut out).unwrap();
    out
}

fn weights(n: usize, rng: &mut StdRng) -> Vec<f64> {
    (0..n).map(|_| rng.random::<f64>().powi(4) * 3.0).collect()
}

#[test]
fn every_way_is_unbiased_and_in_order() {
    let mut rng = StdRng::seed_from_u64(1);
    for way in WAYS {
        for (n, m) in [(7, 7), (20, 50), (50, 13), (1, 5)] {
            let w = weights(n, &mut rng);
            let sum: f64 = w.iter().sum();
            let mut counts = vec![0.0; n];
            let rounds = 4000;
            for _ in 0..rounds {
                let out = draw(way, &w, m, &mut rng);
                assert!(out.windows(2).all(|p| p[0] <= p[1]), "{way:?}");
                for i in out {
                    counts[i] += 1.0;
                }
            }
            for (count, w) in counts.iter().zip(&w) {
                let expected = m as f64 * w / sum;
                // the scatter of independent draws is the largest of all
                let sd = (expected * (1.0 - w / sum) / f64::from(rounds)).sqrt();
                assert!((count / f64::from(rounds) - expected).abs() < 5.0 * sd + 1e-12, "{way:?} {count} {expected}");
            }
        }
    }
}

#[test]
fn copies_scatter_as_little_as_each_way_promises() {
    let mut rng = StdRng::seed_from_u64(2);
    for _ in 0..200 {
        let w = weights(30, &mut rng);
        let sum: f64 = w.iter().sum();
        for way in [Resampling::Systematic, Resampling::Residual] {
            let out = draw(way, &w, 30, &mut rng);
            for (i, w) in w.iter().enumerate() {
                let expected = 30.0 * w / sum;
                let count = out.iter().filter(|k| **k == i).count() as f64;
                let slack = if way == Resampling::Residual { 1.0 } else { 0.0 };
                assert!(count >= expected.floor() && count <= expected.ceil() + slack, "{way:?} {count} {expected}");
            }
        }
    }
    // independent draws: variance n w (1 − w)
    let (w, n, rounds) = ([0.3, 0.7], 40, 20_000);
    let counts: Vec<f64> = (0..rounds)
        .map(|_| draw(Resampling::Multinomial, &w, n, &mut rng).iter().filter(|i| **i == 0).count() as f64)
        .collect();
    let mean = counts.iter().sum::<f64>() / f64::from(rounds);
    let variance = counts.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / f64::from(rounds);
    assert!((variance / (40.0 * 0.3 * 0.7) - 1.0).abs() < 0.05, "{variance}");
}

#[test]
fn particles_without_weight_are_never_drawn() {
    let mut rng = StdRng::seed_from_u64(3);
    for way in WAYS {
        for _ in 0..500 {
            let out = draw(way, &[0.0, 1e-300, 0.0, 2e-300, 0.0], 9, &mut rng);
            assert!(out.iter().all(|i| *i == 1 || *i == 3), "{way:?} {out:?}");
        }
        let mut out = [0; 4];
        // the largest number that a generator gives
        resample(way, &[0.5, 0.5, 0.0], || 1.0 - f64::EPSILON / 2.0, &mut out).unwrap();
        assert!(out.iter().all(|i| *i < 2));
    }
}

#[test]
fn weights_without_meaning_are_refused() {
    for way in WAYS {
        for bad in [vec![], vec![0.0, 0.0], vec![1.0, -1.0], vec![1.0, f64::NAN], vec![f64::INFINITY, 1.0]] {
            assert!(resample(way, &bad, || 0.5, &mut [0; 3]).is_err(), "{way:?} {bad:?}");
        }
    }
    assert!(matches!(normalise_logs(&mut [f64::NEG_INFINITY; 3]), Err(Error::Parameter { .. })));
    assert!(normalise_logs(&mut [0.0, f64::NAN]).is_err());
}

#[test]
fn logs_of_any_size_are_normalised() {
    let mut w = [-5000.0, -5000.0 + 2.0_f64.ln(), f64::NEG_INFINITY];
    let mean = normalise_logs(&mut w).unwrap();
    assert!((w[0] - 1.0 / 3.0).abs() < 1e-12 && (w[1] - 2.0 / 3.0).abs() < 1e-12 && w[2] == 0.0);
    assert!((mean + 5000.0).abs() < 1e-12);
    assert!((effective_sample_size(&w) - 9.0 / 5.0).abs() < 1e-12);
    assert!((effective_sample_size(&[0.25; 4]) - 4.0).abs() < 1e-12);
}

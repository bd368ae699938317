//! Resampling beside the plain way to do it: points along the sum of the weights, one after the other.
#![allow(clippy::unwrap_used)]

use celestcore_core::resample::{Resampling, resample};
use proptest::prelude::*;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Weights without pattern, of any range, with gaps, with one that has nearly all, equal ones.
fn weights() -> impl Strategy<Value = Vec<f64>> {
    let one = prop_oneof![
        4 => 0.0..1.0f64,
        2 => (-60.0..0.0f64).prop_map(f64::exp),
        2 => Just(0.0),
        1 => Just(1.0),
        1 => 5.0..100.0f64,
    ];
    let shape = prop_oneof![
        4 => prop::collection::vec(one, 1..300),
        1 => (1usize..300).prop_map(|n| vec![1.0; n]),
        1 => (1usize..300, 0usize..300).prop_map(|(n, k)| (0..n).map(|i| if i == k % n { 1.0 } else { 1e-18 }).collect()),
        1 => (1usize..300, 0usize..300).prop_map(|(n, k)| (0..n).map(|i| f64::from(u8::from(i == k % n))).collect()),
    ];
    let scale = prop_oneof![Just(1.0), Just(1e-300), Just(5e-324), Just(1e300), 0.1..10.0f64];
    (shape, scale)
        .prop_map(|(w, s)| w.iter().map(|w| w * s).collect::<Vec<_>>())
        .prop_filter("some weight", |w| w.iter().any(|w| *w > 0.0))
}

/// Uniform numbers: those of a generator, or all the same, which may be the smallest or the largest there is.
fn uniform(seed: u64) -> impl FnMut() -> f64 {
    let mut rng = StdRng::seed_from_u64(seed);
    move || match seed % 5 {
        0 => 0.0,
        1 => 0.5,
        2 => 1.0 - f64::EPSILON / 2.0,
        _ => rng.random(),
    }
}

/// Points from 0 to 1 that each way draws from, in order.
fn points(way: Resampling, n: usize, uniform: &mut impl FnMut() -> f64) -> Vec<f64> {
    match way {
        Resampling::Systematic => {
            let u = uniform();
            (0..n).map(|i| (i as f64 + u) / n as f64).collect()
        }
        Resampling::Stratified => (0..n).map(|i| (i as f64 + uniform()) / n as f64).collect(),
        _ => {
            let mut log = 0.0;
            let mut points = vec![0.0; n];
            for i in (1..=n).rev() {
                log += (1.0 - uniform()).ln() / i as f64;
                points[i - 1] = log.exp();
            }
            points
        }
    }
}

/// Sums of the weights up to each of them, as parts of the whole sum.
fn reached(weights: &[f64]) -> Vec<f64> {
    // no sum of the smallest numbers is lost
    let largest = weights.iter().copied().fold(0.0, f64::max);
    let parts: Vec<f64> = weights.iter().map(|w| w / largest).collect();
    let sum: f64 = parts.iter().sum();
    let mut reached = 0.0;
    parts
        .iter()
        .map(|w| {
            reached += w;
            reached / sum
        })
        .collect()
}

fn drawn(way: Resampling, weights: &[f64], n: usize, seed: u64) -> (Vec<usize>, usize) {
    let (mut out, mut uniform, mut used) = (vec![usize::MAX; n], uniform(seed), 0);
    let count = || {
        used += 1;
        uniform()
    };
    resample(way, weights, count, &mut out).unwrap();
    (out, used)
}

/// Whether index `k` has the point `p`, but for rounding.
fn holds(reached: &[f64], weights: &[f64], k: usize, p: f64) -> bool {
    let rounding = 4.0 * f64::EPSILON * (reached.len() as f64 + 8.0);
    let from = if k == 0 { 0.0 } else { reached[k - 1] };
    weights[k] > 0.0 && p >= from - rounding && p <= reached[k] + rounding
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn every_index_holds_its_point(w in weights(), n in 0usize..400, seed in any::<u64>()) {
        let ends = reached(&w);
        for way in [Resampling::Systematic, Resampling::Stratified, Resampling::Multinomial] {
            let points = points(way, n, &mut uniform(seed));
            let (out, used) = drawn(way, &w, n, seed);
            for (i, (k, p)) in out.iter().zip(&points).enumerate() {
                prop_assert!(holds(&ends, &w, *k, *p), "{way:?} {i} {k} {p}");
            }
            prop_assert!(out.is_sorted());
            prop_assert_eq!(used, if way == Resampling::Systematic { 1 } else { n });
        }
    }

    #[test]
    fn residuals_are_whole_copies_and_points_in_the_rest(w in weights(), n in 0usize..400, seed in any::<u64>()) {
        let (out, used) = drawn(Resampling::Residual, &w, n, seed);
        prop_assert_eq!(used, 1);
        prop_assert!(out.is_sorted());
        let (u, ends) = (uniform(seed)(), reached(&w));
        let mut counts = vec![0usize; w.len()];
        for k in &out {
            counts[*k] += 1;
        }
        let (mut left, mut written) = (0.0, 0.0);
        for k in 0..w.len() {
            prop_assert!(w[k] > 0.0 || counts[k] == 0);
            let share = n as f64 * (ends[k] - if k == 0 { 0.0 } else { ends[k - 1] });
            let rounding = 1e-12 * (n as f64 + 1.0) * (w.len() as f64);
            // a share that is whole to rounding may fall on either side
            if (share - share.round()).abs() < rounding {
                return Ok(());
            }
            left += share - share.floor();
            written += counts[k] as f64 - share.floor();
            prop_assert!(counts[k] as f64 >= share.floor());
            // points u, u + 1, … below what is left so far
            prop_assert!((written - left + u).abs() < 1.0 + rounding, "{k} {written} {left} {u}");
        }
    }
}

/// As many as a filter has: beside points in exact whole numbers, on boundaries too.
#[test]
fn weights_that_are_whole_numbers_are_drawn_exactly() {
    let mut rng = StdRng::seed_from_u64(5);
    for n in [1, 7, 4096, 65_536] {
        for _ in 0..20 {
            let mut w: Vec<u64> = (0..n).map(|_| rng.random_range(0..4) * rng.random_range(0..5u64)).collect();
            w[n - 1] += 1;
            // a sum that is a power of two, so that all is exact
            let sum: u64 = w.iter().sum();
            let whole = sum.next_power_of_two();
            w[n / 2] += whole - sum;
            let weights: Vec<f64> = w.iter().map(|w| *w as f64).collect();
            for u in [0.0, 0.25, 0.5] {
                let mut out = vec![0; 2048];
                resample(Resampling::Systematic, &weights, || u, &mut out).unwrap();
                let (mut k, mut reached) = (0, w[0]);
                for (i, found) in out.iter().enumerate() {
                    while (4 * i as u64 + (4.0 * u) as u64) * whole >= reached * 4 * 2048 {
                        k += 1;
                        reached += w[k];
                    }
                    assert_eq!(*found, k, "{n} {i}");
                }
            }
        }
    }
}

//! Laws that every manifold obeys.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{Attitude, AttitudeBias};
use celestcore_core::linalg::congruence;
use celestcore_core::manifold::{Euclidean, Manifold};
use common::{attitude, close, normals, spd};
use nalgebra::SMatrix;

/// Largest turn in the tests: the retraction is one to one below half a turn.
const REACH: f64 = 3.0;

fn laws<S, const N: usize>(
    mut state: impl FnMut() -> S::Of<f64>,
    mut tangent: impl FnMut(f64) -> [f64; N],
    gap: impl Fn(&S::Of<f64>, &S::Of<f64>) -> f64,
    flat: bool,
) where
    S: Manifold<N>,
{
    let mut normal = normals(7);
    for round in 0..500 {
        let reach = if round % 2 == 0 { REACH } else { 1e-3 };
        let (x, d) = (state(), tangent(reach));
        assert!(gap(&S::retract(&x, &[0.0; N]), &x) < 1e-14, "retract by nothing");
        let y = S::retract(&x, &d);
        for (a, b) in S::local(&x, &y).iter().zip(&d) {
            assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()), "local undoes retract: {a} {b}");
        }
        let z = state();
        assert!(gap(&S::retract(&x, &S::local(&x, &z)), &z) < 1e-13, "retract undoes local");

        // the reset is the derivative of e -> local(x + d, x + (d + e))
        let j = S::reset(&x, &d);
        let h = 1e-6;
        let difference = SMatrix::<f64, N, N>::from_fn(|i, k| {
            let image = |e: f64| {
                let mut moved = d;
                moved[k] += e;
                S::local(&y, &S::retract(&x, &moved))[i]
            };
            (image(h) - image(-h)) / (2.0 * h)
        });
        close(&j, &difference, 1e-8);
        if flat {
            assert_eq!(j, SMatrix::<f64, N, N>::identity());
        }
        let p = spd::<N>(&mut normal, 1.0);
        close(&S::transport(&x, &d, &p), &congruence(&j, &p), 1e-12);
        close(&S::transport_factor(&x, &d, &p), &(j * p), 1e-12);
    }
}

fn ball<const N: usize>(normal: &mut impl FnMut() -> f64, reach: f64) -> [f64; N] {
    let v: [f64; N] = std::array::from_fn(|_| normal());
    let n = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let r = reach * (0.5 + 0.5 * (normal() * 3.0).sin());
    v.map(|x| x / n * r)
}

#[test]
fn attitude_and_bias_obey_the_laws() {
    let (mut a, mut b) = (normals(1), normals(2));
    let gap = |x: &Attitude<f64>, y: &Attitude<f64>| {
        let dot: f64 = x.q.iter().zip(&y.q).map(|(a, b)| a * b).sum();
        let turn = (1.0 - dot.abs()).abs();
        x.bias.iter().zip(&y.bias).map(|(a, b)| (a - b).abs()).fold(turn, f64::max)
    };
    laws::<AttitudeBias, 6>(|| attitude(&mut a), |reach| ball(&mut b, reach), gap, false);
}

#[test]
fn vectors_obey_the_laws() {
    let (mut a, mut b) = (normals(3), normals(4));
    let gap = |x: &[f64; 4], y: &[f64; 4]| x.iter().zip(y).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    laws::<Euclidean<4>, 4>(|| std::array::from_fn(|_| a()), |reach| ball(&mut b, reach), gap, true);
}

//! Laws that every manifold obeys.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{
    Attitude, AttitudeBias, Calibrated, CalibratedSpace, InertialError, Literal, LiteralSpace,
};
use celestcore_core::linalg::congruence;
use celestcore_core::manifold::{Euclidean, Manifold};
use celestcore_core::quaternion::{exp, multiply};
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
        for i in 0..N {
            for k in 0..N {
                if S::RESETS > 0 && (i >= S::RESETS || k >= S::RESETS) {
                    assert_eq!(
                        j[(i, k)],
                        if i == k { 1.0 } else { 0.0 },
                        "a reset leaves the other error states alone"
                    );
                }
            }
        }
        if flat {
            assert_eq!(j, SMatrix::<f64, N, N>::identity());
        }
        let p = spd::<N>(&mut normal, 1.0);
        close(&S::transport(&x, &d, &p), &congruence(&j, &p), 1e-12);
        close(&S::transport_factor(&x, &d, &p), &(j * p), 1e-12);
        // and back again
        let back = S::transport_back(&x, &d, &S::transport(&x, &d, &p));
        close(&back, &p, 1e-11 * p.abs().max());
        assert_eq!(back, back.transpose());
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

/// A turn between two attitudes, from 0 to 1: 1 less the cosine of half its angle.
fn turn(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    (1.0 - dot.abs()).abs()
}

fn apart<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn inertial_errors_obey_the_laws() {
    let (mut a, mut b) = (normals(5), normals(6));
    let gap = |x: &Attitude<f64>, y: &Attitude<f64>| turn(&x.q, &y.q).max(apart(&x.bias, &y.bias));
    laws::<InertialError, 6>(|| attitude(&mut a), |reach| ball(&mut b, reach), gap, false);
    // it is the error on the left
    let x = attitude(&mut a);
    let d = [0.3, -0.2, 0.5, 0.0, 0.0, 0.0];
    let y = InertialError::retract(&x, &d);
    assert!(turn(&y.q, &multiply(&exp(&[0.3, -0.2, 0.5]), &x.q)) < 1e-15);
}

#[test]
fn calibrated_states_obey_the_laws() {
    let (mut a, mut b) = (normals(8), normals(9));
    let state = || {
        let (one, two) = (attitude(&mut a), attitude(&mut a));
        Calibrated { q: one.q, bias: one.bias, gyro: std::array::from_fn(|_| 0.01 * a()), alignment: two.q }
    };
    let gap = |x: &Calibrated<f64>, y: &Calibrated<f64>| {
        let turns = turn(&x.q, &y.q).max(turn(&x.alignment, &y.alignment));
        turns.max(apart(&x.bias, &y.bias)).max(apart(&x.gyro, &y.gyro))
    };
    laws::<CalibratedSpace, 18>(state, |reach| ball(&mut b, reach), gap, false);
}

/// Between states of one reference the literal state of the paper is a plain vector.
#[test]
fn literal_states_of_one_reference_obey_the_laws() {
    let (mut a, mut b) = (normals(10), normals(11));
    let reference = attitude(&mut a);
    let state = || Literal {
        q: reference.q,
        bias: reference.bias,
        dq: std::array::from_fn(|_| a()),
        db: std::array::from_fn(|_| a()),
    };
    let gap = |x: &Literal<f64>, y: &Literal<f64>| {
        assert_eq!((x.q, x.bias), (y.q, y.bias));
        apart(&x.dq, &y.dq).max(apart(&x.db, &y.db))
    };
    laws::<LiteralSpace, 7>(state, |reach| ball(&mut b, reach), gap, true);
}

/// Moving the error into the reference moves no attitude and no bias, and leaves no error.
#[test]
fn normalising_a_literal_state_keeps_what_it_says() {
    let mut a = normals(12);
    for _ in 0..200 {
        let (at, off) = (attitude(&mut a), attitude(&mut a));
        let size = 1.0 + 0.1 * a();
        let x = Literal { q: at.q, bias: at.bias, dq: off.q.map(|c| c * size), db: off.bias };
        let y = LiteralSpace::normalise(&x);
        assert_eq!((y.dq, y.db), ([1.0, 0.0, 0.0, 0.0], [0.0; 3]));
        assert!(turn(&y.q, &multiply(&at.q, &off.q)) < 1e-14);
        assert!(apart(&y.bias, &std::array::from_fn(|i| at.bias[i] + off.bias[i])) < 1e-16);
        let length: f64 = y.q.iter().map(|c| c * c).sum();
        assert!((length - 1.0).abs() < 1e-14);
        // seen from the old reference nothing has moved but the length of the quaternion
        let moved = LiteralSpace::local(&x, &y);
        let along: [f64; 4] = std::array::from_fn(|i| moved[i] + x.dq[i] * (1.0 - 1.0 / size));
        assert!(
            apart(&along, &[0.0; 4]) < 1e-13
                && apart(&moved, &[moved[0], moved[1], moved[2], moved[3], 0.0, 0.0, 0.0]) < 1e-15
        );
    }
}

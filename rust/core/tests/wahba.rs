//! Wahba's problem: exact data, half turns, agreement of the methods, degenerate geometry.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::wahba::{Method, Vectors, solve};
use celestcore_core::quaternion::{angle_between, conjugate, cross, dot3, exp, normalise, rotate};
use common::normals;

const METHODS: [Method; 3] = [Method::Svd, Method::Davenport, Method::Quest];

fn frame<'a>(body: &'a [[f64; 3]], inertial: &'a [[f64; 3]]) -> Vectors<'a> {
    Vectors { body, inertial, sigma: None, weights: None }
}

fn seen(q: &[f64; 4], inertial: &[[f64; 3]]) -> Vec<[f64; 3]> {
    inertial.iter().map(|r| rotate(&conjugate(q), r)).collect()
}

#[test]
fn exact_vectors_give_the_exact_attitude() {
    let mut normal = normals(1);
    for k in 2..30 {
        for _ in 0..50 {
            let q = normalise(&std::array::from_fn(|_| normal()));
            let inertial: Vec<[f64; 3]> = (0..k).map(|_| std::array::from_fn(|_| normal())).collect();
            let body = seen(&q, &inertial);
            for method in METHODS {
                let fix = solve(&frame(&body, &inertial), method).unwrap();
                assert!(angle_between(&fix.q, &q) < 1e-9, "{method:?} {k}");
                assert!(fix.loss < 1e-17 && fix.vectors == k);
                assert!(fix.covariance.iter().all(|c| c.is_nan()));
            }
        }
    }
}

#[test]
fn half_turns_are_no_trouble() {
    let inertial = [[1.0, 0.0, 0.0], [0.3, 0.9, 0.0], [0.2, -0.4, 0.8]];
    let mut normal = normals(2);
    let mut axes = vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]];
    axes.extend((0..200).map(|_| std::array::from_fn(|_| normal())));
    for axis in axes {
        let n = dot3(&axis, &axis).sqrt();
        for short in [0.0, 1e-12, 1e-8, 1e-4] {
            let q = exp(&axis.map(|c| c / n * (std::f64::consts::PI - short)));
            let body = seen(&q, &inertial);
            for method in METHODS {
                let fix = solve(&frame(&body, &inertial), method).unwrap();
                assert!(angle_between(&fix.q, &q) < 2e-14, "{method:?} {axis:?} {short}");
            }
        }
    }
}

#[test]
fn one_line_leaves_the_turn_about_it() {
    let mut normal = normals(3);
    for _ in 0..200 {
        let q = normalise(&std::array::from_fn(|_| normal()));
        let r: [f64; 3] = std::array::from_fn(|_| normal());
        let inertial = [r, r.map(|c| -2.0 * c), r.map(|c| 0.5 * c)];
        let body = seen(&q, &inertial);
        for (k, method) in [1, 2, 3].into_iter().flat_map(|k| METHODS.map(|m| (k, m))) {
            let error = solve(&frame(&body[..k], &inertial[..k]), method).unwrap_err();
            let (axis, b) = (error.axis.unwrap(), body[0]);
            assert!((dot3(&axis, &axis) - 1.0).abs() < 1e-12);
            let across = cross(&axis, &b);
            assert!(dot3(&across, &across) < 1e-20 * dot3(&b, &b), "{method:?} {axis:?} {b:?}");
            assert_eq!(error.vectors, k);
        }
    }
    let error = solve(&frame(&[], &[]), Method::Svd).unwrap_err();
    assert_eq!((error.vectors, error.axis), (0, None));
}

#[test]
fn a_mirror_image_is_not_an_attitude() {
    // all three reversed: every half turn fits as well as any other
    let inertial = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let body = inertial.map(|r| r.map(|c| -c));
    for method in METHODS {
        assert!(solve(&frame(&body, &inertial), method).is_err(), "{method:?}");
    }
}

#[test]
fn methods_agree_on_noisy_vectors_of_unequal_accuracy() {
    let mut normal = normals(4);
    for round in 0..2000 {
        let q = normalise(&std::array::from_fn(|_| normal()));
        let inertial: Vec<[f64; 3]> = (0..4).map(|_| std::array::from_fn(|_| normal())).collect();
        // from equal accuracies to a factor of 3e4
        let spread = 1.5 * f64::from(round % 4);
        let sigma: Vec<f64> = (0..4).map(|k| 1e-6 * 10f64.powf(spread * f64::from(k) / 3.0)).collect();
        let body: Vec<[f64; 3]> = seen(&q, &inertial)
            .iter()
            .zip(&sigma)
            .map(|(b, s)| rotate(&exp(&std::array::from_fn(|_| s * normal())), b))
            .collect();
        let given = Vectors { sigma: Some(&sigma), ..frame(&body, &inertial) };
        let [svd, davenport, quest] = METHODS.map(|m| solve(&given, m).unwrap());
        // rounding in the profile matrix, divided by the information about the weakest axis
        let weakest = 3e-15 * svd.covariance.trace() / 1e-12;
        assert!(angle_between(&svd.q, &davenport.q) < weakest.max(1e-14), "{round}");
        assert!(angle_between(&svd.q, &quest.q) < weakest.max(1.1e-8), "{round}");
        assert_eq!(svd.covariance, davenport.covariance);
    }
}

//! QUEST by itself: `solve` would hide its failures behind Davenport's method.

use super::*;
use crate::quaternion::{angle_between, conjugate, exp, rotate};
use std::f64::consts::PI;

const TRIAD: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.28, 0.96, 0.0], [0.0, 0.6, 0.8]];

fn profile(q: &Quaternion<f64>, inertial: &[[f64; 3]], weights: &[f64]) -> Matrix3 {
    let body: Vec<[f64; 3]> = inertial.iter().map(|r| rotate(&conjugate(q), r)).collect();
    let vectors = Vectors { body: &body, inertial, sigma: None, weights: Some(weights) };
    Rows::new(&vectors).profile()
}

#[test]
fn quest_needs_no_help_at_any_attitude() {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.48, 0.6, 0.64]];
    for axis in axes {
        for angle in [0.0, 1e-9, 0.1, 1.0, 0.5 * PI, 3.0, PI - 1e-3, PI - 1e-8, PI] {
            let q = exp(&axis.map(|c| c * angle));
            let found = quest(&profile(&q, &TRIAD, &[1.0; 3]), 3.0).unwrap();
            assert!(angle_between(&found, &q) < 1e-13, "{axis:?} {angle}: {found:?}");
        }
    }
}

#[test]
fn quest_is_replaced_where_its_equation_fails() {
    // accuracies that differ by 1e4: information about the weakest axis 1e-8 of the strongest
    let weights = [1.0, 1e-8, 1e-8];
    let mut worst: f64 = 0.0;
    for k in 0..100 {
        let q = exp(&[0.03 * f64::from(k), 0.7, -0.4]);
        let b = profile(&q, &TRIAD, &weights);
        worst = worst.max(quest(&b, weights.iter().sum()).map_or(PI, |found| angle_between(&found, &q)));
        let body = TRIAD.map(|r| rotate(&conjugate(&q), &r));
        let vectors = Vectors { body: &body, inertial: &TRIAD, sigma: None, weights: Some(&weights) };
        let fix = solve(&vectors, Method::Quest).unwrap();
        assert!(angle_between(&fix.q, &q) < 1e-6);
    }
    assert!(worst > 1e-3, "{worst}");
}

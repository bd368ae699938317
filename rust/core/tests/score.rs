//! Posterior moments under noise that is not normal, and the filter that uses them.
#![allow(clippy::unwrap_used, clippy::excessive_precision, clippy::unreadable_literal)]

mod common;

use celestcore_core::belief::Gaussian;
use celestcore_core::filter::{Ekf, Filter, Score};
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::manifold::Euclidean;
use celestcore_core::model::Measurement;
use celestcore_core::moments::{Posterior, soft_uniform, student_t};
use celestcore_core::scalar::{Lanes, Mask, Real};
use common::{close, normals, spd};

/// `[y, s, dof, scale]`, mean and variance by scipy 1.17's adaptive quadrature over the signal itself.
const STUDENT: [([f64; 4], f64, f64); 17] = [
    ([0.0, 1.0, 3.0, 1.0], 0.0, 0.5223956255954487),
    ([1.0, 1.0, 3.0, 1.0], 0.46213260221700525, 0.5691537314809947),
    ([5.0, 1.0, 3.0, 1.0], 0.8312206303419227, 1.1475614361960051),
    ([50.0, 1.0, 3.0, 1.0], 0.08006397326340806, 1.0016038372804668),
    ([50.0, 100.0, 3.0, 1.0], 17.91682098734047, 320.5940802374902),
    ([3.0, 0.0001, 3.0, 1.0], 0.00010000166663193214, 0.0001000016666527602),
    ([3.0, 10000.0, 3.0, 1.0], 2.9991243430489485, 2.9188798228125075),
    ([300.0, 10000.0, 3.0, 1.0], 299.9047717979111, 4.314656995547473),
    ([2000.0, 10000.0, 3.0, 1.0], 20.2571256830759, 10103.931082174115),
    ([1000.0, 0.01, 3.0, 1.0], 3.999988200033428e-05, 0.010000000399996458),
    ([2.0, 1.0, 1.0, 0.5], 1.063535358149245, 0.803961656223061),
    ([4.0, 2.0, 30.0, 1.3], 2.081447912331176, 1.028669320393666),
    ([12.0, 1.0, 30.0, 1.0], 2.4410425338161104, 1.143240856445961),
    ([3.0, 2.0, 500.0, 1.0], 1.997330404119822, 0.6702348176102347),
    ([-5.0, 1.0, 4.0, 2.0], -0.6064824092772152, 1.0019627288104365),
    ([0.00047, 1e-09, 3.0, 0.0002], 5.5265097955335355e-06, 1.0033177843324367e-09),
    ([7.0, 1000000.0, 2.1, 1.0], 6.999931483440275, 9.7880982688029),
];

/// `[y, s, half, edge]`, likewise.
const UNIFORM: [([f64; 4], f64, f64); 14] = [
    ([0.0, 1.0, 1.0, 0.05], 0.0, 0.32340866303102356),
    ([0.5, 1.0, 1.0, 0.05], 0.3405025045655155, 0.31034532224577094),
    ([3.0, 1.0, 1.0, 0.05], 2.313806068996494, 0.11561075179773296),
    ([20.0, 1.0, 1.0, 0.05], 18.965354356132856, 0.004264699836325312),
    ([0.0, 0.0001, 1.0, 0.05], 0.0, 9.999999999999999e-05),
    ([1.0, 0.0001, 1.0, 0.05], 0.00015494379047438544, 9.807177100654758e-05),
    ([1.3, 0.0001, 1.0, 0.05], 0.011538461538461548, 9.615384615384622e-05),
    ([50.0, 1000000.0, 1.0, 0.05], 49.999981125031105, 0.37749937778007403),
    ([5000.0, 1000000.0, 1.0, 0.05], 4999.998112506651, 0.377497253025257),
    ([1.2, 0.01, 1.0, 0.3], 0.02010927163253895, 0.00902708105277577),
    ([-6.0, 4.0, 0.5, 0.01], -5.874522006530504, 0.07760889387370826),
    ([30.0, 0.5, 1.0, 1.0], 9.666666666666668, 0.33333333333333515),
    ([0.0008, 1e-08, 0.0006, 3e-05], 0.00019748350665453997, 1.8119101346424244e-09),
    ([1.0, 1.0, 0.001, 0.0001], 0.9999995735319118, 4.2646801704495647e-07),
];

fn agree(what: &[f64; 4], got: Posterior, mean: f64, variance: f64, tolerance: f64) {
    let off = ((got.mean - mean) / variance.sqrt().min(mean.abs().max(1e-300))).abs();
    assert!(
        off < tolerance || (got.mean - mean).abs() < tolerance * 1e-3 * variance.sqrt(),
        "{what:?} {got:?} {off:e}"
    );
    let off = (got.variance / variance - 1.0).abs();
    assert!(off < tolerance, "{what:?} {got:?} {off:e}");
}

#[test]
fn moments_are_those_of_adaptive_quadrature() {
    for (p, mean, variance) in &STUDENT {
        agree(p, student_t(p[0], p[1], p[2], p[3]), *mean, *variance, 1e-9);
        let mirrored = student_t(-p[0], p[1], p[2], p[3]);
        agree(p, mirrored, -mean, *variance, 1e-9);
    }
    for (p, mean, variance) in &UNIFORM {
        agree(p, soft_uniform(p[0], p[1], p[2], p[3]), *mean, *variance, 1e-10);
        agree(p, soft_uniform(-p[0], p[1], p[2], p[3]), -mean, *variance, 1e-10);
    }
}

/// The variance is the prior one times one minus the derivative of the mean: a law of every noise.
#[test]
fn variance_follows_from_the_mean() {
    let kinds: [fn(f64, f64) -> Posterior; 4] = [
        |y, s| student_t(y, s, 3.0, 0.6),
        |y, s| student_t(y, s, 40.0, 1.0),
        |y, s| soft_uniform(y, s, 1.7, 0.085),
        |y, s| soft_uniform(y, s, 1.7, 2.0),
    ];
    for moments in kinds {
        for s in [1e-2, 0.3, 1.0, 7.0, 200.0] {
            for k in 0..60 {
                let (y, h) = (0.21 * f64::from(k), 3e-4);
                let m = |j: f64| moments(y + j * h, s).mean;
                let slope = (8.0 * (m(1.0) - m(-1.0)) - (m(2.0) - m(-2.0))) / (12.0 * h);
                let (got, expected) = (moments(y, s).variance, s * (1.0 - slope));
                assert!((got - expected).abs() < 1e-6 * (s + got), "{s} {y} {got} {expected}");
            }
        }
    }
}

#[test]
fn limits_are_the_known_ones() {
    // many degrees of freedom, or an edge without a flat part: normal noise
    let (y, s, r) = (1.3, 2.0, 0.7);
    let normal = Posterior { mean: y * s / (s + r), variance: s * r / (s + r) };
    agree(&[y, s, r, 0.0], student_t(y, s, 1e9, r.sqrt()), normal.mean, normal.variance, 1e-7);
    agree(&[y, s, r, 0.0], soft_uniform(y, s, 1e-12, r.sqrt()), normal.mean, normal.variance, 1e-10);
    // known far better than the flat part is wide: nothing is learnt
    assert_eq!(soft_uniform(0.3, 1e-4, 1.0, 0.05), Posterior { mean: 0.0, variance: 1e-4 });
    // wild values still give numbers
    for y in [0.0, 1.0, 1e3, 1e8] {
        for s in [1e-18, 1e-6, 1.0, 1e12] {
            for p in [student_t(y, s, 3.0, 1.0), student_t(y, s, 200.0, 1.0), soft_uniform(y, s, 1.0, 0.05)] {
                assert!(p.mean.is_finite() && p.variance > 0.0 && p.variance.is_finite(), "{y} {s} {p:?}");
                assert!(p.mean >= 0.0 && p.mean <= y * (1.0 + 1e-12), "{y} {s} {p:?}");
            }
        }
    }
    for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
        assert!(
            student_t(1.0, bad, 3.0, 1.0).mean.is_nan() && (bad > 0.0 || student_t(1.0, 1.0, bad, 1.0).mean.is_nan())
        );
        assert!(student_t(1.0, 1.0, 3.0, bad).mean.is_nan() && soft_uniform(1.0, bad, 1.0, 1.0).mean.is_nan());
        assert!(soft_uniform(1.0, 1.0, bad, 1.0).mean.is_nan() && soft_uniform(1.0, 1.0, 1.0, bad).mean.is_nan());
    }
}

/// A combination of two numbers, with noise of one shape or another.
#[derive(Clone, Copy)]
enum Shape {
    Normal,
    Student,
    Broken,
}
struct Fix(Shape);
const SCALE: f64 = 0.5;
impl Measurement<2, 1> for Fix {
    type Space = Euclidean<2>;
    type Given = Euclidean<1>;
    type Value = Euclidean<1>;
    fn predict<T: Real>(&self, x: &[T; 2], _: &[T; 1]) -> [T; 1] {
        [x[0] + x[1] * 0.4]
    }
    fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> [T; 1] {
        [z[0] - zhat[0]]
    }
    fn noise<T: Real>(&self, _: &[T; 1]) -> Matrix<T, 1, 1> {
        from_fn(|_, _| T::splat(3.0 * SCALE * SCALE))
    }
    fn posterior<T: Real>(&self, y: T, s: T, given: &[T; 1]) -> (T, T) {
        let each = |i: usize| student_t(y.lane(i), s.lane(i), 3.0, SCALE);
        match self.0 {
            Shape::Normal => {
                let gain = s / (s + self.noise(given)[(0, 0)]);
                (y * gain, s - s * gain)
            }
            Shape::Student => (T::from_lanes(|i| each(i).mean), T::from_lanes(|i| each(i).variance)),
            Shape::Broken => (y, T::zero()),
        }
    }
}

#[test]
fn with_normal_noise_it_is_the_kalman_filter() {
    let mut normal = normals(3);
    for _ in 0..50 {
        let p: Matrix<f64, 2, 2> = spd(&mut normal, 0.3);
        let start = Gaussian::<Euclidean<2>, f64, 2> { mean: [normal(), normal()], cov: p };
        let (mut a, mut b) = (start, start);
        let z = [normal()];
        let one = Ekf::default().update::<_, f64, 2, 1>(&mut a, &Fix(Shape::Normal), &[0.0], &z, f64::INFINITY);
        let two = Score.update::<_, f64, 2, 1>(&mut b, &Fix(Shape::Normal), &[0.0], &z, f64::INFINITY);
        close(&a.cov, &b.cov, 1e-13);
        assert!((0..2).all(|i| (a.mean[i] - b.mean[i]).abs() < 1e-13));
        assert!((one.nis - two.nis).abs() < 1e-12 && two.accepted);
        // outside the gate, or without a positive variance, nothing moves
        let mut c = start;
        assert!(!Score.update::<_, f64, 2, 1>(&mut c, &Fix(Shape::Normal), &[0.0], &z, 0.0).accepted);
        let broken = Score.update::<_, f64, 2, 1>(&mut c, &Fix(Shape::Broken), &[0.0], &z, f64::INFINITY);
        assert!(!broken.ok && !broken.accepted && c.mean == start.mean && c.cov == start.cov);
    }
}

/// Mean and covariance after one measurement, beside the posterior on a grid of both numbers.
#[test]
fn under_student_noise_both_moments_are_exact() {
    let mut normal = normals(5);
    for z in [-9.0, -1.0, 0.3, 4.0, 30.0] {
        let p: Matrix<f64, 2, 2> = spd(&mut normal, 0.4);
        let mut belief = Gaussian::<Euclidean<2>, f64, 2> { mean: [0.2, -0.1], cov: p };
        Score.update::<_, f64, 2, 1>(&mut belief, &Fix(Shape::Student), &[0.0], &[z], f64::INFINITY);

        let l = p.cholesky().unwrap().l();
        let (mut mass, mut mean, mut second) = (0.0, [0.0; 2], [[0.0; 2]; 2]);
        let grid = |k: i32| f64::from(k) * 0.04;
        for a in -250..=250 {
            for b in -250..=250 {
                let (u, v) = (grid(a), grid(b));
                let d = [l[(0, 0)] * u, l[(1, 0)] * u + l[(1, 1)] * v];
                let left = (z - (0.2 + d[0]) - 0.4 * (d[1] - 0.1)) / SCALE;
                let w = (-0.5 * (u * u + v * v)).exp() * (1.0 + left * left / 3.0).powi(-2);
                mass += w;
                for i in 0..2 {
                    mean[i] += w * d[i];
                    for j in 0..2 {
                        second[i][j] += w * d[i] * d[j];
                    }
                }
            }
        }
        let mean = mean.map(|m| m / mass);
        let cov: Matrix<f64, 2, 2> = from_fn(|i, j| second[i][j] / mass - mean[i] * mean[j]);
        close(&belief.cov, &cov, 1e-8);
        assert!((belief.mean[0] - 0.2 - mean[0]).abs() < 1e-8 && (belief.mean[1] + 0.1 - mean[1]).abs() < 1e-8);
    }
}

#[test]
fn lanes_are_filters_of_their_own() {
    type Pack = Lanes<false>;
    let p: Matrix<f64, 2, 2> = from_fn(|i, j| if i == j { 1.0 } else { 0.3 });
    let zs: [f64; 8] = std::array::from_fn(|i| i as f64 - 2.0);
    let mut lanes =
        Gaussian::<Euclidean<2>, Pack, 2> { mean: [Pack::zero(); 2], cov: from_fn(|i, j| Pack::splat(p[(i, j)])) };
    let report = Score.update::<_, Pack, 2, 1>(
        &mut lanes,
        &Fix(Shape::Student),
        &[Pack::zero()],
        &[Pack::from_lanes(|i| zs[i])],
        Pack::splat(8.0),
    );
    for (i, z) in zs.iter().enumerate() {
        let mut one = Gaussian::<Euclidean<2>, f64, 2> { mean: [0.0; 2], cov: p };
        let alone = Score.update::<_, f64, 2, 1>(&mut one, &Fix(Shape::Student), &[0.0], &[*z], 8.0);
        assert_eq!(one.mean[0], lanes.mean[0].lane(i));
        assert_eq!(one.cov[(0, 1)], lanes.cov[(0, 1)].lane(i));
        assert_eq!(alone.accepted, report.accepted.lane(i));
    }
    assert!(report.accepted.any() && !report.accepted.all());
}

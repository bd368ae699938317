//! Functions for lanes beside those of the library.

use celestcore_core::scalar::elementary::{exp, ln};
use celestcore_core::scalar::{Lanes, Level, Real, Run};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Numbers, and both functions of each: an instruction set's own code for each lane.
struct Job<'a>(&'a [f64], fn(f64) -> f64, bool);
impl Run for Job<'_> {
    type Output = f64;
    /// Largest error in units of the last place.
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> f64 {
        let mut worst = 0.0f64;
        for eight in self.0.chunks_exact(8) {
            let x = T::Pack::from_lanes(|i| eight[i]);
            let y = if self.2 { exp(x) } else { ln(x) };
            for i in 0..8 {
                let expected = self.1(eight[i]);
                let unit = (expected.abs().next_up() - expected.abs()).max(f64::MIN_POSITIVE * f64::EPSILON);
                worst = worst.max((y.lane(i) - expected).abs() / unit);
                let one = if self.2 { exp(T::splat(eight[i])) } else { ln(T::splat(eight[i])) };
                assert_eq!(one.lane(0), y.lane(i));
            }
        }
        worst
    }
}

#[test]
fn exponentials_are_those_of_the_library() {
    let mut rng = StdRng::seed_from_u64(1);
    for scale in [1e-9, 1e-3, 0.5, 5.0, 100.0, 708.0] {
        let x: Vec<f64> = (0..40_000).map(|_| scale * (2.0 * rng.random::<f64>() - 1.0)).collect();
        for level in [Level::Portable, Level::best()] {
            let worst = level.run(Job(&x, f64::exp, true));
            assert!(worst <= 1.0, "{level:?} {scale} {worst}");
        }
    }
}

#[test]
fn exponentials_at_the_edges() {
    let x = Lanes::<false>([0.0, f64::NEG_INFINITY, -1e6, -708.5, f64::INFINITY, 710.0, f64::NAN, -0.0]);
    let y = exp(x).0;
    assert_eq!(y[..6], [1.0, 0.0, 0.0, 0.0, f64::INFINITY, f64::INFINITY]);
    assert!(y[6].is_nan() && y[7] == 1.0);
}

#[test]
fn logarithms_are_those_of_the_library() {
    let mut rng = StdRng::seed_from_u64(2);
    let near_one = (0..40_000).map(|_| 1.0 + 1e-3 * (rng.random::<f64>() - 0.5)).collect::<Vec<_>>();
    let uniform = (0..40_000).map(|_| 1.0 - rng.random::<f64>()).collect::<Vec<_>>();
    let wide = (0..40_000).map(|_| 10f64.powf(600.0 * (rng.random::<f64>() - 0.5))).collect::<Vec<_>>();
    let edges = [1.0, f64::MIN_POSITIVE, f64::MAX, 2.0, 0.5, 0.5f64.sqrt(), 2f64.sqrt(), f64::EPSILON].to_vec();
    for x in [near_one, uniform, wide, edges] {
        for level in [Level::Portable, Level::best()] {
            let worst = level.run(Job(&x, f64::ln, false));
            assert!(worst <= 1.0, "{level:?} {worst}");
        }
    }
}

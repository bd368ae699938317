//! The star camera: its field of view, its order of stars, and its random numbers.

use celestcore_core::attitude::camera::{Camera, Catalogue, Frames, Observer, Outline, isotropic};
use celestcore_core::attitude::wahba::Method;
use celestcore_core::quaternion::{angle_between, dot3, exp, unit};

const CAMERA: Camera =
    Camera { outline: Outline::Circle, half_angle: 0.2, magnitude_limit: 5.0, brightest: 8, sigma: 1e-5 };

fn frames(catalogue: &Catalogue, seed: u64, stream: u64) -> Frames {
    let mut observer = Observer::new(CAMERA, catalogue, Method::Svd, seed, stream);
    let mut frames = Frames::default();
    for k in 0..50 {
        observer.observe(&exp(&[0.1 * f64::from(k), 0.3, -0.2]), &mut frames);
    }
    frames
}

#[test]
fn edges_of_the_field() {
    let square = Camera { outline: Outline::Square, ..CAMERA };
    let at = |x: f64, y: f64| [x.tan(), y.tan(), 1.0].map(|c| c / (x.tan().powi(2) + y.tan().powi(2) + 1.0).sqrt());
    for (x, y, circle, corner) in [
        (0.0, 0.0, true, true),
        (0.199, 0.0, true, true),
        (0.0, -0.201, false, false),
        (0.199, -0.199, false, true),
        (0.199, 0.201, false, false),
    ] {
        assert_eq!((CAMERA.sees(&at(x, y)), square.sees(&at(x, y))), (circle, corner), "{x} {y}");
        assert!(!CAMERA.sees(&at(x, y).map(|c| -c)) && !square.sees(&at(x, y).map(|c| -c)));
    }
}

#[test]
fn frames_hold_the_brightest_stars_and_the_attitude() {
    let directions = isotropic(4000, 1);
    assert!(directions.iter().all(|d| (dot3(d, d) - 1.0).abs() < 1e-15));
    let magnitudes: Vec<f64> = (0..4000).map(|k| f64::from((k * 2917) % 4000) * 0.0015).collect();
    let catalogue = Catalogue::new(&directions, &magnitudes);
    let seen = frames(&catalogue, 3, 7);
    let mut first = 0;
    for (k, (count, fix)) in seen.counts.iter().zip(&seen.fixes).enumerate() {
        let rows = &seen.rows[first..first + count];
        assert!(*count <= 8 && rows.windows(2).all(|r| magnitudes[r[0]] <= magnitudes[r[1]]));
        assert!(rows.iter().all(|r| magnitudes[*r] <= 5.0));
        if let Ok(fix) = fix {
            let truth = exp(&[0.1 * k as f64, 0.3, -0.2]);
            assert!(angle_between(&fix.q, &truth) < 6.0 * fix.covariance.trace().sqrt());
        }
        first += count;
    }
    assert_eq!(first, seen.vectors.len());
    assert!(seen.fixes.iter().filter(|f| f.is_ok()).count() > 45);
}

#[test]
fn numbers_belong_to_seed_and_stream() {
    let catalogue = Catalogue::new(&isotropic(4000, 1), &vec![1.0; 4000]);
    let base = frames(&catalogue, 3, 7).vectors;
    assert_eq!(base, frames(&catalogue, 3, 7).vectors);
    assert_ne!(base, frames(&catalogue, 4, 7).vectors);
    assert_ne!(base, frames(&catalogue, 3, 8).vectors);
    assert_ne!(isotropic(5, 1), isotropic(5, 2));
}

#[test]
fn nothing_to_see_is_no_attitude() {
    let catalogue = Catalogue::new(&[[0.0, 0.0, 1.0]], &[1.0]);
    let mut seen = Frames::default();
    let mut observer = Observer::new(CAMERA, &catalogue, Method::Quest, 0, 0);
    observer.observe(&unit(), &mut seen);
    observer.observe(&exp(&[1.0, 0.0, 0.0]), &mut seen);
    assert_eq!(seen.counts, [1, 0]);
    let axes: Vec<_> = seen.fixes.iter().map(|f| f.err().map(|e| (e.vectors, e.axis.is_some()))).collect();
    assert_eq!(axes, [Some((1, true)), Some((0, false))]);
}

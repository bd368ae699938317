//! Skies and star angles: against searches of the whole catalogue, and the laws of their errors.
#![allow(clippy::unwrap_used)]

use celestcore_core::Error;
use celestcore_core::celestial::{AngleScene, Blunders, SkyField};
use celestcore_core::horizon::{AngleNoise, Shape};
use celestcore_core::quaternion::{cross, dot3, tangents, unit_vector};
use celestcore_core::simulate::{Stream, over_threads};
use std::sync::atomic::{AtomicBool, Ordering};

type Vec3 = [f64; 3];

fn random_stars(n: usize, seed: u64) -> Vec<Vec3> {
    let mut stream = Stream::new(seed, 0, 200);
    (0..n).map(|_| unit_vector(&stream.normals())).collect()
}

/// A circular orbit about a tilted axis.
fn orbit(n: usize, radius: f64, step: f64) -> (Vec<Vec3>, Vec<Vec3>) {
    let (a, b) = ([1.0, 0.0, 0.0], unit_vector(&[0.0, 0.6, 0.8]));
    let at = |k: usize| (k as f64 * step).sin_cos();
    let r = (0..n).map(|k| std::array::from_fn(|i| radius * (at(k).1 * a[i] + at(k).0 * b[i])));
    let v = (0..n).map(|k| std::array::from_fn(|i| 7.5e3 * (at(k).1 * b[i] - at(k).0 * a[i])));
    (r.collect(), v.collect())
}

fn scale(v: &Vec3, s: f64) -> Vec3 {
    v.map(|x| s * x)
}

/// All stars, one angle after the other.
fn expected(field: &SkyField, stars: &[Vec3], r: &Vec3, v: &Vec3) -> Vec<usize> {
    let z = scale(&unit_vector(r), -1.0);
    let y = scale(&unit_vector(&cross(r, v)), -1.0);
    let x = cross(&y, &z);
    let to_inertial = |u: &Vec3| -> Vec3 {
        if field.inertial { *u } else { std::array::from_fn(|i| u[0] * x[i] + u[1] * y[i] + u[2] * z[i]) }
    };
    let (boresight, along) = (to_inertial(&field.boresight), to_inertial(&field.along));
    let across = cross(&boresight, &along);
    let half = field.tangents.map(f64::atan);
    let earth = (field.opaque / dot3(r, r).sqrt()).min(1.0).asin();
    let seen = |s: &Vec3| {
        let depth = dot3(s, &boresight);
        dot3(s, &along).atan2(depth).abs() <= half[0]
            && dot3(s, &across).atan2(depth).abs() <= half[1]
            && dot3(s, &z).clamp(-1.0, 1.0).acos() > earth
    };
    (0..stars.len()).filter(|k| seen(&stars[*k])).take(field.brightest).collect()
}

#[test]
fn a_field_holds_what_a_search_of_all_stars_finds() {
    let stars = random_stars(3000, 1);
    let (r, v) = orbit(400, 7.1e6, 0.02);
    let turned = |boresight: Vec3, along: Vec3, inertial, tangents| SkyField {
        boresight: unit_vector(&boresight),
        along: unit_vector(&along),
        inertial,
        tangents,
        brightest: 6,
        opaque: 6.478e6,
    };
    let fields = [
        turned([0.0, 0.0, -1.0], [1.0, 0.0, 0.0], false, [0.0875, 0.0875]),
        turned([-1.0, 0.0, 0.45], [0.0, 1.0, 0.0], false, [0.3, 0.05]),
        turned([0.0, -1.0, 0.0], [1.0, 0.0, 1.0], false, [2.0, 1.0]),
        turned([0.3, 0.5, 0.8], [0.5, -0.3, 0.0], true, [0.2, 0.4]),
    ];
    for mut field in fields {
        for brightest in [1, 6, usize::MAX] {
            field.brightest = brightest;
            let seen = field.look(&stars, &r, &v).unwrap();
            let wanted: Vec<_> = r.iter().zip(&v).map(|(r, v)| expected(&field, &stars, r, v)).collect();
            assert_eq!(seen.counts, wanted.iter().map(Vec::len).collect::<Vec<_>>());
            assert_eq!(seen.rows, wanted.concat());
        }
    }
    // the field that points down the limb is dark for parts of its stars
    let mut open = fields[1];
    open.brightest = usize::MAX;
    let hidden = open.look(&stars, &r, &v).unwrap().rows.len();
    open.opaque = 0.0;
    assert!(open.look(&stars, &r, &v).unwrap().rows.len() > hidden + 1000);
}

/// Epochs with three stars each, one of them without any.
fn scene(noise: AngleNoise, blunders: Option<Blunders>) -> (AngleScene, Vec<Vec3>, Vec<Vec3>) {
    let (r, _) = orbit(4000, 7e6, 0.001);
    let star: Vec<Vec3> = random_stars(3, 5).into_iter().cycle().take(3 * (r.len() - 1)).collect();
    let mut counts = vec![3; r.len()];
    counts[7] = 0;
    (AngleScene::new(&r, (&counts, &star), noise, blunders).unwrap(), r, star)
}

fn errors(scene: &AngleScene, seed: u64, trial: u64) -> Vec<f64> {
    let mut out = Vec::new();
    scene.simulate(seed, trial, &mut out);
    out.iter().zip(scene.exact()).map(|(a, b)| a - b).collect()
}

fn mean(x: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    x.for_each(|x| {
        sum += x;
        n += 1.0;
    });
    sum / n
}

#[test]
fn true_angles_are_those_to_the_earths_centre() {
    let (scene, r, star) = scene(AngleNoise::new(1e-5, 0.0, Shape::Normal).unwrap(), None);
    assert_eq!(scene.len(), 3 * 3999);
    for (row, angle) in scene.exact().iter().enumerate() {
        let epoch = if row < 21 { row / 3 } else { row / 3 + 1 };
        let cosine = -dot3(&unit_vector(&r[epoch]), &star[row]);
        assert!((angle.cos() - cosine).abs() < 1e-15);
    }
}

#[test]
fn own_errors_have_their_distribution() {
    let n = 11_997.0f64;
    for (shape, fourth) in
        [(Shape::Normal, 3.0), (Shape::StudentT { dof: 9.0 }, 4.2), (Shape::Uniform { edge: 0.05 }, 1.8)]
    {
        let (scene, ..) = scene(AngleNoise::new(1e-3, 0.0, shape).unwrap(), None);
        let x: Vec<f64> = (0..20).flat_map(|trial| errors(&scene, 3, trial)).map(|e| e / 1e-3).collect();
        let tolerance = 5.0 / (20.0 * n).sqrt();
        assert!(mean(x.iter().copied()).abs() < tolerance, "{shape:?}");
        assert!((mean(x.iter().map(|x| x * x)) - 1.0).abs() < 2.0 * tolerance, "{shape:?}");
        // the eighth moment of t with 9 degrees of freedom is 200 times that of a normal number's
        let kurtosis = mean(x.iter().map(|x| x.powi(4)));
        assert!((kurtosis - fourth).abs() < 0.1 * fourth, "{shape:?} {kurtosis}");
    }
    let (scene, ..) = scene(AngleNoise::new(1e-3, 0.0, Shape::Uniform { edge: 0.05 }).unwrap(), None);
    let largest = errors(&scene, 3, 0).iter().fold(0.0, |m: f64, e| m.max(e.abs()));
    assert!((1.729e-3..=3f64.sqrt() * 1e-3 + 1e-15).contains(&largest));
}

/// Three degrees of freedom, as in the paper's table 2: the distribution function at some places.
#[test]
fn heavy_tails_are_those_of_students_t() {
    let (scene, ..) = scene(AngleNoise::new(1e-3, 0.0, Shape::StudentT { dof: 3.0 }).unwrap(), None);
    let x: Vec<f64> = (0..20).flat_map(|trial| errors(&scene, 9, trial)).map(|e| e / 1e-3 * 3f64.sqrt()).collect();
    let cdf = |t: f64| {
        let u = t / 3f64.sqrt();
        0.5 + (u / (1.0 + u * u) + u.atan()) / std::f64::consts::PI
    };
    for t in [-20.0, -5.0, -1.0, 0.0, 0.5, 3.0, 12.0] {
        let share = mean(x.iter().map(|x| f64::from(u8::from(*x <= t))));
        let p = cdf(t);
        assert!((share - p).abs() < 5.0 * (p * (1.0 - p) / x.len() as f64).sqrt(), "{t} {share} {p}");
    }
}

#[test]
fn angles_of_an_epoch_share_the_nadirs_error() {
    let (own, shared) = (2e-5, 3e-4);
    let (scene, r, star) = scene(AngleNoise::new(own, shared, Shape::Normal).unwrap(), None);
    let trials = 2000;
    let all: Vec<Vec<f64>> = (0..trials).map(|k| errors(&scene, 11, k)).collect();
    for epoch in [0, 3, 3000] {
        let first = if epoch < 7 { 3 * epoch } else { 3 * (epoch - 1) };
        let nadir = scale(&unit_vector(&r[epoch]), -1.0);
        let axes = tangents(&nadir);
        // derivative of the angle to the nadir's two numbers
        let e = |k: usize| -> [f64; 2] {
            let s = &star[first + k];
            let sine = (1.0 - dot3(s, &nadir).powi(2)).sqrt();
            std::array::from_fn(|a| -dot3(s, &axes[a]) / sine)
        };
        for i in 0..3 {
            for j in 0..3 {
                let (a, b) = (e(i), e(j));
                let diagonal = if i == j { own * own } else { 0.0 };
                let wanted = diagonal + shared * shared * (a[0] * b[0] + a[1] * b[1]);
                let found = mean(all.iter().map(|x| x[first + i] * x[first + j]));
                let variance = shared * shared + own * own;
                assert!((found - wanted).abs() < 5.0 * variance * (2.0 / trials as f64).sqrt(), "{epoch} {i} {j}");
            }
        }
    }
}

#[test]
fn sources_of_errors_do_not_disturb_each_other() {
    let normal = |shared| AngleNoise::new(1e-4, shared, Shape::Normal).unwrap();
    let plain = errors(&scene(normal(0.0), None).0, 5, 3);
    assert_eq!(plain, errors(&scene(normal(0.0), None).0, 5, 3));
    assert_ne!(plain, errors(&scene(normal(0.0), None).0, 5, 4));
    assert_ne!(plain, errors(&scene(normal(0.0), None).0, 6, 3));
    let blunders = Some(Blunders { probability: 0.05, sigmas: 50.0 });
    let wrong = errors(&scene(normal(0.0), blunders).0, 5, 3);
    let by: Vec<f64> = plain.iter().zip(&wrong).map(|(a, b)| b - a).collect();
    let moved: Vec<f64> = by.into_iter().filter(|d| d.abs() > 1e-12).collect();
    assert!(moved.iter().all(|d| (d.abs() - 50.0 * 1e-4).abs() < 1e-12));
    assert!((moved.len() as f64 - 0.05 * 11_997.0).abs() < 5.0 * (0.05f64 * 0.95 * 11_997.0).sqrt());
    assert!((mean(moved.iter().map(|d| d.signum()))).abs() < 0.25);
    // own errors are the same beside a shared one, which is what is left
    let both = errors(&scene(normal(3e-4), None).0, 5, 3);
    let left: f64 = mean(both.iter().zip(&plain).map(|(a, b)| (a - b) * (a - b)));
    assert!((left.sqrt() - 3e-4).abs() < 0.1 * 3e-4);
}

#[test]
fn an_angle_stays_an_angle() {
    let r = vec![[7e6, 0.0, 0.0]; 2000];
    let zenith = vec![[1.0, 0.0, 0.0]; 2000];
    let noise = AngleNoise::new(1e-3, 1e-3, Shape::Normal).unwrap();
    let scene = AngleScene::new(&r, (&vec![1; 2000], &zenith), noise, None).unwrap();
    let mut out = Vec::new();
    scene.simulate(1, 0, &mut out);
    assert!(out.iter().all(|a| (0.0..=std::f64::consts::PI).contains(a)));
    assert!(mean(out.iter().map(|a| std::f64::consts::PI - a)) > 1e-3);
}

#[test]
fn scenes_and_blunders_that_do_not_fit_are_refused() {
    let noise = AngleNoise::new(1e-3, 0.0, Shape::Normal).unwrap();
    let one = [[7e6, 0.0, 0.0]];
    let star = [[0.0, 1.0, 0.0]];
    let refused = |counts: &[usize], blunders| AngleScene::new(&one, (counts, &star), noise, blunders).unwrap_err();
    assert!(matches!(refused(&[1, 1], None), Error::Length { field: "stars.counts", .. }));
    assert!(matches!(refused(&[2], None), Error::Length { field: "stars.star", .. }));
    for (probability, sigmas) in [(-0.1, 1.0), (1.1, 1.0), (f64::NAN, 1.0), (0.1, -1.0), (0.1, f64::INFINITY)] {
        let error = refused(&[1], Some(Blunders { probability, sigmas }));
        assert!(matches!(error, Error::Parameter { field: "outliers", .. }));
    }
}

#[test]
fn trials_come_back_in_order_for_any_number_of_threads() {
    for threads in [1, 2, 7] {
        let stop = AtomicBool::new(false);
        let work = (
            || 0u64,
            |seen: &mut u64, k: u64| {
                *seen += 1;
                Ok(k * k)
            },
        );
        let out = over_threads(5..105, threads, &stop, work, &mut |_| Ok(())).unwrap();
        assert_eq!(out, (5..105).map(|k| k * k).collect::<Vec<_>>());
        assert!(stop.load(Ordering::Relaxed));
    }
    let none = over_threads(3..3, 4, &AtomicBool::new(false), (|| (), |(): &mut (), k| Ok(k)), &mut |_| Ok(()));
    assert_eq!(none.unwrap(), Vec::<u64>::new());
}

#[test]
fn an_error_or_a_wish_to_stop_ends_the_trials() {
    let stop = AtomicBool::new(false);
    let fails = |(): &mut (), k: u64| if k == 40 { Err(Error::Empty { field: "here" }) } else { Ok(k) };
    let ended = over_threads(0..1_000_000, 3, &stop, (|| (), fails), &mut |_| Ok(()));
    assert_eq!(ended, Err(Error::Empty { field: "here" }));
    let stop = AtomicBool::new(false);
    let mut poll = |done| if done >= 10 { Err(Error::Interrupted) } else { Ok(()) };
    let ended = over_threads(0..1_000_000, 2, &stop, (|| (), |(): &mut (), k| Ok(k)), &mut poll);
    assert_eq!(ended, Err(Error::Interrupted));
}

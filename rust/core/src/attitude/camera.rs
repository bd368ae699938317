//! A star camera as an instrument: which stars of a catalogue it sees, with which centroid noise, and the
//! attitude that follows from them.
//!
//! Camera frame `c`: z along the boresight, x and y along the sides of the detector.

use super::wahba::{Fix, Method, Unobservable, Vectors, solve};
use crate::linalg::Vector;
use crate::quaternion::{Quaternion, conjugate, dot3, rotate, tangents};
use crate::simulate::rng::Stream;

/// Outline of the field of view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outline {
    /// A cone about the boresight.
    #[default]
    Circle,
    /// A square detector behind a pinhole.
    Square,
}

/// What a camera sees, and how well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Outline of the field of view.
    pub outline: Outline,
    /// From the boresight to the edge, in a square to the middle of a side; rad, below a quarter turn.
    pub half_angle: f64,
    /// Faintest magnitude it detects.
    pub magnitude_limit: f64,
    /// So many stars at most, the brightest ones.
    pub brightest: usize,
    /// 1-sigma centroid noise about each of the two axes across a star's direction, rad.
    pub sigma: f64,
}

impl Camera {
    /// Whether a unit vector of the camera frame lies in the field of view.
    pub fn sees(&self, v: &Vector<f64, 3>) -> bool {
        match self.outline {
            Outline::Circle => v[2] >= self.half_angle.cos(),
            Outline::Square => v[2] > 0.0 && v[0].abs().max(v[1].abs()) <= v[2] * self.half_angle.tan(),
        }
    }
    /// Cosine of the angle from the boresight beyond which it sees nothing.
    fn reach(&self) -> f64 {
        match self.outline {
            Outline::Circle => self.half_angle.cos(),
            Outline::Square => 1.0 / (2.0 * self.half_angle.tan().powi(2) + 1.0).sqrt(),
        }
    }
}

/// Stars, the brightest first.
#[derive(Clone, Debug)]
pub struct Catalogue {
    directions: Vec<Vector<f64, 3>>,
    magnitudes: Vec<f64>,
    rows: Vec<usize>,
}

impl Catalogue {
    /// Unit vectors in the inertial frame and magnitudes; stars of equal magnitude keep their order.
    pub fn new(directions: &[Vector<f64, 3>], magnitudes: &[f64]) -> Self {
        let mut rows: Vec<usize> = (0..directions.len()).collect();
        rows.sort_by(|a, b| magnitudes[*a].total_cmp(&magnitudes[*b]));
        Self {
            directions: rows.iter().map(|k| directions[*k]).collect(),
            magnitudes: rows.iter().map(|k| magnitudes[*k]).collect(),
            rows,
        }
    }
}

/// Directions spread evenly over the sphere, the same for each seed: normal numbers in three axes have no
/// preferred direction.
pub fn isotropic(n: usize, seed: u64) -> Vec<Vector<f64, 3>> {
    const CATALOGUE: u8 = 255;
    let mut stream = Stream::new(seed, 0, CATALOGUE);
    (0..n).map(|_| unit(&std::array::from_fn(|_| stream.normal()))).collect()
}

/// Frames of one camera, one after the other.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    /// Number of stars in each frame.
    pub counts: Vec<usize>,
    /// Rows of the catalogue as it was given, frame after frame, the brightest first.
    pub rows: Vec<usize>,
    /// Measured unit vectors in the camera frame, likewise.
    pub vectors: Vec<Vector<f64, 3>>,
    /// Attitude of each frame: `q_ic`, and the covariance in the camera frame.
    pub fixes: Vec<Result<Fix, Unobservable>>,
}

/// A camera that looks at a catalogue.
pub struct Observer<'a> {
    camera: Camera,
    method: Method,
    catalogue: &'a Catalogue,
    stream: Stream,
    sigma: Vec<f64>,
    inertial: Vec<Vector<f64, 3>>,
}

impl<'a> Observer<'a> {
    /// Noise comes from stream number `stream`, `(trial << 8) | channel`, of the `seed`.
    pub fn new(camera: Camera, catalogue: &'a Catalogue, method: Method, seed: u64, stream: u64) -> Self {
        let stream = Stream::new(seed, stream >> 8, (stream & 0xff) as u8);
        Self { camera, method, catalogue, stream, sigma: Vec::new(), inertial: Vec::new() }
    }
    /// Takes a frame at attitude `q_ic` and adds it.
    pub fn observe(&mut self, q_ic: &Quaternion<f64>, frames: &mut Frames) {
        let first = frames.vectors.len();
        self.inertial.clear();
        let boresight = rotate(q_ic, &[0.0, 0.0, 1.0]);
        // a little more than the field, for rounding: `sees` decides
        let reach = self.camera.reach() - 1e-12;
        let (back, stars) = (conjugate(q_ic), self.catalogue);
        let bright = stars.magnitudes.partition_point(|m| *m <= self.camera.magnitude_limit);
        for k in 0..bright {
            if self.inertial.len() == self.camera.brightest {
                break;
            }
            if dot3(&boresight, &stars.directions[k]) < reach {
                continue;
            }
            let exact = rotate(&back, &stars.directions[k]);
            if self.camera.sees(&exact) {
                self.inertial.push(stars.directions[k]);
                frames.rows.push(stars.rows[k]);
                frames.vectors.push(blurred(&mut self.stream, &exact, self.camera.sigma));
            }
        }
        self.sigma.resize(self.inertial.len(), self.camera.sigma);
        frames.counts.push(self.inertial.len());
        let body = &frames.vectors[first..];
        let seen = Vectors { body, inertial: &self.inertial, sigma: Some(&self.sigma), weights: None };
        frames.fixes.push(solve(&seen, self.method));
    }
}

fn unit(v: &Vector<f64, 3>) -> Vector<f64, 3> {
    let n = dot3(v, v).sqrt();
    v.map(|c| c / n)
}

/// A unit vector moved by noise of `sigma` in each of the two directions across it.
fn blurred(stream: &mut Stream, v: &Vector<f64, 3>, sigma: f64) -> Vector<f64, 3> {
    let [a, b] = tangents(v);
    let (x, y) = (sigma * stream.normal(), sigma * stream.normal());
    unit(&std::array::from_fn(|i| v[i] + x * a[i] + y * b[i]))
}

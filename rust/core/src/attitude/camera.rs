//! A star camera as an instrument: which stars of a catalogue it sees, with which centroid noise, and the
//! attitude that follows from them.
//!
//! Camera frame `c`: z along the boresight, x and y along the sides of the detector.

use super::wahba::{Fix, Method, Unobservable, Vectors, solve};
use crate::linalg::Vector;
use crate::quaternion::{Quaternion, conjugate, dot3, rotate, tangents, unit_vector};
use crate::simulate::rng::Stream;

/// Frames between looks at whether to go on.
pub const CHUNK: usize = 1024;

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
    (0..n).map(|_| unit_vector(&std::array::from_fn(|_| stream.normal()))).collect()
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

/// Which stars a camera sees at attitudes that follow each other.
struct Sight<'a> {
    camera: Camera,
    catalogue: &'a Catalogue,
    /// Stars bright enough.
    bright: usize,
    /// A direction, and the stars that may be seen while the boresight is near it.
    anchor: Option<Vector<f64, 3>>,
    near: Vec<u32>,
}

impl<'a> Sight<'a> {
    fn new(camera: Camera, catalogue: &'a Catalogue) -> Self {
        let bright = catalogue.magnitudes.partition_point(|m| *m <= camera.magnitude_limit);
        Self { camera, catalogue, bright, anchor: None, near: Vec::new() }
    }
    /// Calls `found` with the number in order of brightness, and the unit vector in the camera frame, of
    /// each star seen at attitude `q_ic`.
    fn look(&mut self, q_ic: &Quaternion<f64>, mut found: impl FnMut(u32, Vector<f64, 3>)) {
        let boresight = rotate(q_ic, &[0.0, 0.0, 1.0]);
        self.gather(&boresight);
        // a little more than the field, for rounding: `sees` decides
        let reach = self.camera.reach() - 1e-12;
        let back = conjugate(q_ic);
        let mut seen = 0;
        for k in &self.near {
            if seen == self.camera.brightest {
                break;
            }
            let star = &self.catalogue.directions[*k as usize];
            if dot3(&boresight, star) < reach {
                continue;
            }
            let exact = rotate(&back, star);
            if self.camera.sees(&exact) {
                found(*k, exact);
                seen += 1;
            }
        }
    }
    /// Most frames see the sky of the frame before: the whole catalogue is searched when the boresight has
    /// moved by half a field.
    fn gather(&mut self, boresight: &Vector<f64, 3>) {
        let reach = self.camera.reach().clamp(-1.0, 1.0).acos();
        if self.anchor.is_some_and(|a| dot3(&a, boresight) >= (0.5 * reach).cos()) {
            return;
        }
        self.anchor = Some(*boresight);
        // wider by a margin for rounding, which is large against it for fields of any use
        let least = (1.5 * reach + 1e-6).min(std::f64::consts::PI).cos() - 1e-12;
        let bright = self.catalogue.directions[..self.bright].iter().enumerate();
        self.near.clear();
        self.near.extend(bright.filter(|(_, d)| dot3(boresight, d) >= least).map(|(k, _)| k as u32));
    }
}

/// A camera that looks at a catalogue.
pub struct Observer<'a> {
    sight: Sight<'a>,
    method: Method,
    stream: Stream,
    sigma: Vec<f64>,
    inertial: Vec<Vector<f64, 3>>,
}

impl<'a> Observer<'a> {
    /// Noise comes from stream number `stream`, `(trial << 8) | channel`, of the `seed`.
    pub fn new(camera: Camera, catalogue: &'a Catalogue, method: Method, seed: u64, stream: u64) -> Self {
        let stream = Stream::new(seed, stream >> 8, (stream & 0xff) as u8);
        Self { sight: Sight::new(camera, catalogue), method, stream, sigma: Vec::new(), inertial: Vec::new() }
    }
    /// Takes a frame at attitude `q_ic` and adds it.
    pub fn observe(&mut self, q_ic: &Quaternion<f64>, frames: &mut Frames) {
        let (first, sigma) = (frames.vectors.len(), self.sight.camera.sigma);
        let (stream, inertial, stars) = (&mut self.stream, &mut self.inertial, self.sight.catalogue);
        inertial.clear();
        self.sight.look(q_ic, |k, exact| {
            inertial.push(stars.directions[k as usize]);
            frames.rows.push(stars.rows[k as usize]);
            frames.vectors.push(blurred(stream, &exact, sigma));
        });
        self.sigma.resize(self.inertial.len(), sigma);
        frames.counts.push(self.inertial.len());
        let body = &frames.vectors[first..];
        let seen = Vectors { body, inertial: &self.inertial, sigma: Some(&self.sigma), weights: None };
        frames.fixes.push(solve(&seen, self.method));
    }
}

/// The stars of many frames at known attitudes: what is the same whatever the noise.
#[derive(Clone, Debug, Default)]
pub struct View {
    sigma: f64,
    directions: Vec<Vector<f64, 3>>,
    stars: Vec<u32>,
    /// Attitude `q_ic` of each frame, and where its stars end.
    frames: Vec<(Quaternion<f64>, usize)>,
}

/// Memory that is used frame after frame.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    body: Vec<Vector<f64, 3>>,
    inertial: Vec<Vector<f64, 3>>,
    sigma: Vec<f64>,
}

impl View {
    /// Frames at attitudes `q_ic`, as [`Observer::observe`] takes them. `keep_on` is called now and then.
    ///
    /// # Errors
    /// What `keep_on` returns.
    pub fn new<E>(
        camera: Camera,
        catalogue: &Catalogue,
        attitudes: impl Iterator<Item = Quaternion<f64>>,
        mut keep_on: impl FnMut() -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut sight = Sight::new(camera, catalogue);
        let directions = catalogue.directions[..sight.bright].to_vec();
        let mut view = Self { sigma: camera.sigma, directions, ..Self::default() };
        for (k, q_ic) in attitudes.enumerate() {
            if k % CHUNK == 0 {
                keep_on()?;
            }
            sight.look(&q_ic, |k, _| view.stars.push(k));
            view.frames.push((q_ic, view.stars.len()));
        }
        Ok(view)
    }
    /// How many frames there are.
    pub fn len(&self) -> usize {
        self.frames.len()
    }
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }
    /// Most stars in one frame.
    pub fn most(&self) -> usize {
        (0..self.len()).map(|k| self.stars_of(k).len()).max().unwrap_or(0)
    }
    fn stars_of(&self, frame: usize) -> &[u32] {
        let begin = frame.checked_sub(1).map_or(0, |k| self.frames[k].1);
        &self.stars[begin..self.frames[frame].1]
    }
    /// The fix of a frame, with noise from the stream: the same as an observer's, if frames come in order.
    ///
    /// # Errors
    /// [`Unobservable`] with fewer than two stars, or all on one line.
    pub fn fix(&self, frame: usize, stream: &mut Stream, scratch: &mut Scratch) -> Result<Fix, Unobservable> {
        let back = conjugate(&self.frames[frame].0);
        let Scratch { body, inertial, sigma } = scratch;
        body.clear();
        inertial.clear();
        for k in self.stars_of(frame) {
            let star = &self.directions[*k as usize];
            inertial.push(*star);
            body.push(blurred(stream, &rotate(&back, star), self.sigma));
        }
        sigma.clear();
        sigma.resize(body.len(), self.sigma);
        solve(&Vectors { body, inertial, sigma: Some(sigma), weights: None }, Method::default())
    }
}

/// A unit vector moved by noise of `sigma` in each of the two directions across it.
fn blurred(stream: &mut Stream, v: &Vector<f64, 3>, sigma: f64) -> Vector<f64, 3> {
    let [a, b] = tangents(v);
    let (x, y) = (sigma * stream.normal(), sigma * stream.normal());
    unit_vector(&std::array::from_fn(|i| v[i] + x * a[i] + y * b[i]))
}

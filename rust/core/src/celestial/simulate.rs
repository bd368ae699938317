//! Seeded simulation of angles between stars and the nadir.

use crate::error::{Error, Result};
use crate::horizon::{AngleNoise, Shape};
use crate::quaternion::{cross, dot3, tangents, unit_vector};
use crate::simulate::rng::{Stream, channel};
use std::f64::consts::{PI, TAU};

/// A direction or position.
type Vec3 = [f64; 3];

/// Now and then an angle is far off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blunders {
    /// How often, from 0 to 1.
    pub probability: f64,
    /// By how many standard deviations of an angle, to either side.
    pub sigmas: f64,
}

impl Blunders {
    fn check(&self) -> Result<()> {
        let Self { probability, sigmas } = *self;
        if !(0.0..=1.0).contains(&probability) {
            let need = "must be a probability, from 0 to 1";
            return Err(Error::Parameter { field: "outliers", value: probability, need });
        }
        if !(sigmas.is_finite() && sigmas >= 0.0) {
            let need = "the size must be finite and not negative";
            return Err(Error::Parameter { field: "outliers", value: sigmas, need });
        }
        Ok(())
    }
}

/// Which stars are seen when, and how well the angles between them and the nadir are measured.
#[derive(Clone, Debug)]
pub struct AngleScene {
    /// Directions to the Earth's centre, one for each epoch.
    nadir: Vec<Vec3>,
    /// Stars at each epoch.
    counts: Vec<usize>,
    /// Apparent directions of the stars, epoch after epoch.
    star: Vec<Vec3>,
    /// Their true angles, rad.
    angle: Vec<f64>,
    /// What lies between nadir and limb at each epoch, rad; zero for angles to the nadir.
    dip: Vec<f64>,
    noise: AngleNoise,
    blunders: Option<Blunders>,
}

impl AngleScene {
    /// For positions `r` (m) at the epochs, the number of stars at each of them, and unit vectors to the
    /// stars where they appear, one epoch after the other.
    ///
    /// # Errors
    /// `Length`; `Parameter` for blunders out of range.
    pub fn new(
        r: &[Vec3],
        (counts, star): (&[usize], &[Vec3]),
        noise: AngleNoise,
        blunders: Option<Blunders>,
    ) -> Result<Self> {
        let same = |field, found, expected| {
            if found == expected { Ok(()) } else { Err(Error::Length { field, expected, found }) }
        };
        same("stars.counts", counts.len(), r.len())?;
        same("stars.star", star.len(), counts.iter().sum())?;
        blunders.as_ref().map_or(Ok(()), Blunders::check)?;
        let nadir: Vec<Vec3> = r.iter().map(|r| unit_vector(r).map(|x| -x)).collect();
        let mut angle = Vec::with_capacity(star.len());
        let dip: Vec<f64> = r.iter().map(|r| (noise.limb / dot3(r, r).sqrt()).min(1.0).asin()).collect();
        measured_from((&nadir, &dip), (counts, star), &mut angle);
        Ok(Self { nadir, counts: counts.to_vec(), star: star.to_vec(), angle, dip, noise, blunders })
    }

    /// How many angles there are.
    pub fn len(&self) -> usize {
        self.star.len()
    }

    /// Whether no star is ever seen.
    pub fn is_empty(&self) -> bool {
        self.star.is_empty()
    }

    /// The angles without errors, rad.
    pub fn exact(&self) -> &[f64] {
        &self.angle
    }

    /// The angles of one trial, rad, in place of what `out` held: the same bits for the same seed and
    /// trial. Each source of errors draws from a channel of its own.
    ///
    /// The horizon sensor's error turns the true nadir, by normal angles about two axes across it, and the
    /// angles of the epoch are measured from there, exactly. Own errors and blunders are added; what goes
    /// beyond 0 or π is folded back.
    pub fn simulate(&self, seed: u64, trial: u64, out: &mut Vec<f64>) {
        out.clear();
        if self.noise.shared > 0.0 {
            let mut stream = Stream::new(seed, trial, channel::NADIR);
            let erroneous = |n: &Vec3| turned(n, stream.normals().map(|x: f64| self.noise.shared * x));
            let nadir: Vec<Vec3> = self.nadir.iter().map(erroneous).collect();
            measured_from((&nadir, &self.dip), (&self.counts, &self.star), out);
        } else {
            out.extend_from_slice(&self.angle);
        }
        let mut stream = Stream::new(seed, trial, channel::ANGLES);
        let scale = self.noise.own * self.noise.shape.scale();
        match self.noise.shape {
            Shape::Normal => out.iter_mut().for_each(|a| *a += scale * stream.normal()),
            Shape::StudentT { dof } => out.iter_mut().for_each(|a| *a += scale * student_t(&mut stream, dof)),
            Shape::Uniform { .. } => out.iter_mut().for_each(|a| *a += scale * symmetric(&mut stream)),
        }
        if let Some(blunders) = &self.blunders {
            let mut stream = Stream::new(seed, trial, channel::OUTLIERS);
            let size = blunders.sigmas * self.noise.variance().sqrt();
            for a in out.iter_mut() {
                let (which, side) = (stream.uniform(), symmetric(&mut stream));
                if which < blunders.probability {
                    *a += size.copysign(side);
                }
            }
        }
        out.iter_mut().for_each(|a| *a = folded(*a));
    }
}

/// The angle between directions that a sum of angles stands for, from 0 to π.
fn folded(a: f64) -> f64 {
    let inside = (0.0..=PI).contains(&a);
    if inside { a } else { PI - (a.rem_euclid(TAU) - PI).abs() }
}

/// Angles between the stars of each epoch and a direction of its own, less its dip, added to `out`.
fn measured_from((nadir, dip): (&[Vec3], &[f64]), (counts, star): (&[usize], &[Vec3]), out: &mut Vec<f64>) {
    let mut stars = star.iter();
    for ((n, dip), count) in nadir.iter().zip(dip).zip(counts) {
        out.extend(stars.by_ref().take(*count).map(|s| angle(s, n) - dip));
    }
}

/// A unit vector turned towards its two tangents by small angles.
fn turned(n: &Vec3, by: [f64; 2]) -> Vec3 {
    let size = by[0].hypot(by[1]);
    if size == 0.0 {
        return *n;
    }
    let [a, b] = tangents(n);
    let (sine, cosine) = size.sin_cos();
    std::array::from_fn(|i| cosine * n[i] + sine * (by[0] * a[i] + by[1] * b[i]) / size)
}

/// Angle between unit vectors, precise everywhere.
fn angle(a: &Vec3, b: &Vec3) -> f64 {
    let across = cross(a, b);
    dot3(&across, &across).sqrt().atan2(dot3(a, b))
}

/// A number spread evenly from −1 up to 1.
fn symmetric(stream: &mut Stream) -> f64 {
    2.0 * stream.uniform() - 1.0
}

/// A number by Student's t distribution, by the polar method (Bailey, *Polar generation of random variates
/// with the t-distribution*, Math. Comp. 62, 1994).
fn student_t(stream: &mut Stream, dof: f64) -> f64 {
    loop {
        let (u, v) = (symmetric(stream), symmetric(stream));
        let w = u * u + v * v;
        if w > 0.0 && w <= 1.0 {
            return u * (dof * (w.powf(-2.0 / dof) - 1.0) / w).sqrt();
        }
    }
}

//! Which stars a satellite sees through the air over the Earth's limb, and what it measures of them.

use super::refraction::RefractionAngle;
use crate::error::{Error, Result};
use crate::quaternion::{cross, dot3, unit_vector};
use crate::simulate::rng::{Stream, channel};

/// A rectangular field of view that looks at the limb.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimbField {
    /// Azimuth of the boresight, rad: 0 forward, a quarter turn to the right of the flight.
    pub azimuth: f64,
    /// Tangents of the half angles along the limb and across it.
    pub tangents: [f64; 2],
}

/// Where refracted stars are looked for.
#[derive(Clone, Debug)]
pub struct Limb<'a> {
    /// Air and Earth.
    pub sensor: &'a RefractionAngle,
    /// Lowest and greatest height of a ray that is used, m.
    pub band: [f64; 2],
    /// Fields of view; none: everywhere along the limb.
    pub fields: &'a [LimbField],
}

/// A refracted star at an epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Number of the epoch.
    pub epoch: usize,
    /// Number of the star.
    pub star: usize,
    /// Refraction, rad, and the height of the ray's lowest point, m.
    pub angle: f64,
    /// Height of the ray's lowest point, m.
    pub height: f64,
    /// Number of the pass of a star through the band, counted over all azimuths.
    pub pass: usize,
    /// Number of the first field that sees it; of none, the number of fields.
    pub field: usize,
}

/// A sight that is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passed {
    /// The satellite's position, m.
    pub r: [f64; 3],
    /// Unit vector to the star.
    pub star: [f64; 3],
    /// Its place among the sights of all azimuths, and the number of its pass.
    pub place: [usize; 2],
}

/// Errors of a refraction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimbNoise {
    /// Standard deviation of the angle's own error, rad.
    pub sigma: f64,
    /// Relative standard deviation of the density, drawn for each pass.
    pub density: f64,
    /// Relative error of the density in all passes.
    pub bias: f64,
}

/// Epochs between two calls of `poll`.
const CHUNK: usize = 256;

impl Limb<'_> {
    /// All stars whose light passes within the band, epoch after epoch, whether a field sees them or not. `poll` is called
    /// now and then and may end it.
    ///
    /// # Errors
    /// `Parameter` for a band that is upside down; what `poll` returns.
    pub fn sights(
        &self,
        states: &[[f64; 6]],
        stars: &[[f64; 3]],
        mut poll: impl FnMut(usize) -> Result<()>,
    ) -> Result<Vec<Sight>> {
        let [low, high] = self.band;
        if !(low >= 0.0 && high > low && high <= 120e3) {
            let need = "must be two heights, the lower one first, within 0 to 120e3 m";
            return Err(Error::Parameter { field: "band", value: low, need });
        }
        let mut found = Vec::new();
        let (mut last, mut passes) = (vec![(usize::MAX, 0); stars.len()], 0);
        for (epoch, x) in states.iter().enumerate() {
            if epoch.is_multiple_of(CHUNK) {
                poll(epoch)?;
            }
            let r = [x[0], x[1], x[2]];
            let range = self.range(&r);
            let axes = self.axes(x);
            for (i, star) in stars.iter().enumerate() {
                let along = dot3(&r, star);
                let off = dot3(&r, &r) - along * along;
                if along >= 0.0 || off < range[0] || off > range[1] {
                    continue;
                }
                let ray = self.sensor.ray(&r, star, 1.0);
                if !(low..=high).contains(&ray.height) {
                    continue;
                }
                let (before, pass) = &mut last[i];
                if before.wrapping_add(1) != epoch || epoch == 0 {
                    *pass = passes;
                    passes += 1;
                }
                *before = epoch;
                let field = self.field(&axes, star);
                found.push(Sight { epoch, star: i, angle: ray.angle, height: ray.height, pass: *pass, field });
            }
        }
        Ok(found)
    }

    /// Squared distances of a straight line from the Earth's centre that a ray in the band may have.
    fn range(&self, r: &[f64; 3]) -> [f64; 2] {
        let equator = self.sensor.earth.radius;
        let polar = equator / (1.0 + self.sensor.earth.second_eccentricity2).sqrt();
        let lifted = dot3(r, r).sqrt() * self.sensor.bending.at(self.band[0]).angle[0];
        [polar + self.band[0] - lifted, equator + self.band[1]].map(|d| d * d)
    }

    /// Boresight, direction along the limb and the third axis of each field.
    fn axes(&self, x: &[f64; 6]) -> Vec<[[f64; 3]; 3]> {
        let (r, v) = ([x[0], x[1], x[2]], [x[3], x[4], x[5]]);
        let down = unit_vector(&r).map(|c| -c);
        let right = unit_vector(&cross(&v, &r));
        let forward = cross(&right, &down);
        // the middle of the band stands in the middle of the field
        let aim = self.sensor.earth.radius + 0.5 * (self.band[0] + self.band[1]);
        let cosine = (aim / dot3(&r, &r).sqrt()).min(1.0);
        let sine = (1.0 - cosine * cosine).sqrt();
        let axes = |field: &LimbField| {
            let (s, c) = field.azimuth.sin_cos();
            let level: [f64; 3] = std::array::from_fn(|i| c * forward[i] + s * right[i]);
            let along = std::array::from_fn(|i| c * right[i] - s * forward[i]);
            let boresight = std::array::from_fn(|i| cosine * level[i] + sine * down[i]);
            [boresight, along, cross(&boresight, &along)]
        };
        self.fields.iter().map(axes).collect()
    }

    fn field(&self, axes: &[[[f64; 3]; 3]], star: &[f64; 3]) -> usize {
        let sees = |(field, [boresight, along, across]): (&LimbField, &[[f64; 3]; 3])| {
            let depth = dot3(boresight, star);
            let inside = |axis: &[f64; 3], tangent: f64| dot3(axis, star).abs() <= tangent * depth;
            inside(along, field.tangents[0]) && inside(across, field.tangents[1])
        };
        self.fields.iter().zip(axes).position(sees).unwrap_or(self.fields.len())
    }
}

impl RefractionAngle {
    /// Measured refractions, rad, of one trial. A pass has air of one density; the numbers drawn belong to passes and sights
    /// among those of all azimuths, so that a sight's error does not depend on which others there are.
    pub fn simulate(&self, sights: &[Passed], noise: &LimbNoise, (seed, trial): (u64, u64)) -> Vec<f64> {
        let most = |k: usize| sights.iter().map(|s| s.place[k] + 1).max().unwrap_or(0);
        let draw = |channel, n| {
            let mut stream = Stream::new(seed, trial, channel);
            (0..n).map(|_| stream.normal()).collect::<Vec<f64>>()
        };
        let (own, air) = (draw(channel::REFRACTION, most(0)), draw(channel::DENSITY, most(1)));
        let angle = |s: &Passed| {
            let scale = (1.0 + noise.bias + noise.density * air[s.place[1]]).max(0.01);
            self.ray(&s.r, &s.star, scale).angle + noise.sigma * own[s.place[0]]
        };
        sights.iter().map(angle).collect()
    }
}

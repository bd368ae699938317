//! Which stars of a catalogue a camera sees from an orbit.

use crate::error::{Error, Result};
use crate::quaternion::{cross, dot3, unit_vector};

/// A direction or position.
type Vec3 = [f64; 3];

/// A rectangular field of view, and what hides stars.
#[derive(Clone, Copy, Debug)]
pub struct SkyField {
    /// Middle of the field, a unit vector; in the orbital frame, or in the inertial one.
    pub boresight: Vec3,
    /// A unit vector across the boresight, along the first side of the field; in the same frame.
    pub along: Vec3,
    /// Whether the field stands still among the stars.
    pub inertial: bool,
    /// Tangents of half the field's sides.
    pub tangents: [f64; 2],
    /// So many stars at most, the brightest ones.
    pub brightest: usize,
    /// Radius of the sphere that hides stars, m.
    pub opaque: f64,
}

/// Stars seen at many epochs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// How many at each epoch.
    pub counts: Vec<usize>,
    /// Their places in the catalogue, epoch after epoch, in the catalogue's order.
    pub rows: Vec<usize>,
}

/// Columns of the orbital frame: z to the Earth's centre, y against the orbit's normal, x = y × z.
fn orbital(r: &Vec3, v: &Vec3) -> [Vec3; 3] {
    let z = unit_vector(r).map(|x| -x);
    let y = unit_vector(&cross(r, v)).map(|x| -x);
    [cross(&y, &z), y, z]
}

/// One camera at one epoch.
struct Sight {
    /// Inertial directions of the two sides and of the boresight.
    axes: [Vec3; 3],
    nadir: Vec3,
    /// Cosine of the angle from the nadir within which nothing is seen.
    hidden: f64,
}

impl SkyField {
    fn at(&self, r: &Vec3, v: &Vec3) -> Sight {
        let turn = |u: &Vec3| -> Vec3 {
            if self.inertial {
                return *u;
            }
            let [x, y, z] = orbital(r, v);
            std::array::from_fn(|i| u[0] * x[i] + u[1] * y[i] + u[2] * z[i])
        };
        let (first, boresight) = (turn(&self.along), turn(&self.boresight));
        let sine = (self.opaque / dot3(r, r).sqrt()).min(1.0);
        let hidden = ((1.0 - sine) * (1.0 + sine)).sqrt();
        let axes = [first, cross(&boresight, &first), boresight];
        Sight { axes, nadir: unit_vector(r).map(|x| -x), hidden }
    }

    /// Largest angle from the boresight, rad.
    fn reach(&self) -> f64 {
        self.tangents[0].hypot(self.tangents[1]).atan()
    }

    fn sees(&self, sight: &Sight, star: &Vec3) -> bool {
        let depth = dot3(&sight.axes[2], star);
        depth > 0.0
            && dot3(&sight.axes[0], star).abs() <= depth * self.tangents[0]
            && dot3(&sight.axes[1], star).abs() <= depth * self.tangents[1]
            && dot3(&sight.nadir, star) < sight.hidden
    }

    /// The stars, given as unit vectors with the brightest first, that are seen from positions `r` (m) at
    /// velocities `v` (m/s).
    ///
    /// # Errors
    /// `Length`.
    pub fn look(&self, stars: &[Vec3], r: &[Vec3], v: &[Vec3]) -> Result<Seen> {
        if r.len() != v.len() {
            return Err(Error::Length { field: "v", expected: r.len(), found: v.len() });
        }
        let (mut seen, mut near) = (Seen::default(), Near::default());
        for (r, v) in r.iter().zip(v) {
            let sight = self.at(r, v);
            near.gather(stars, &sight.axes[2], self.reach());
            let before = seen.rows.len();
            let found = near.stars.iter().filter(|k| self.sees(&sight, &stars[**k]));
            seen.rows.extend(found.take(self.brightest).copied());
            seen.counts.push(seen.rows.len() - before);
        }
        Ok(seen)
    }
}

/// The stars about a direction: most epochs see the sky of the one before.
#[derive(Default)]
struct Near {
    anchor: Option<Vec3>,
    stars: Vec<usize>,
}

impl Near {
    /// Searches the catalogue again when the boresight has moved by half the reach.
    fn gather(&mut self, stars: &[Vec3], boresight: &Vec3, reach: f64) {
        if self.anchor.is_some_and(|a| dot3(&a, boresight) >= (0.5 * reach).cos()) {
            return;
        }
        self.anchor = Some(*boresight);
        // wider by a margin for rounding
        let least = (1.5 * reach + 1e-6).min(std::f64::consts::PI).cos() - 1e-12;
        self.stars.clear();
        self.stars.extend(stars.iter().enumerate().filter(|(_, s)| dot3(boresight, s) >= least).map(|(k, _)| k));
    }
}

//! The measurements of a satellite's log as filters see them.

use crate::belief::Belief;
use crate::consistency::chi2_quantile;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::horizon::{
    AngleNoise, Epochs, Expected, NadirPlane, RefractionAngle, RefractionGiven, Robust, StarAngle, StarGiven,
};
use crate::linalg::{Matrix, from_fn};
use crate::manifold::{Euclidean, components};
use crate::model::Measurement;
use crate::quaternion::dot3;
use crate::replay::{MAX_DOF, Report, Sensors};
use crate::scalar::Real;

/// How the angles of an epoch are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// All at once, as the nadir direction that they give.
    Together,
    /// One after the other, by the distribution of their errors where the filter knows it.
    OneByOne,
}

/// Angles between stars and the nadir, and how to use them.
#[derive(Clone, Copy, Debug)]
pub struct Horizon<'a> {
    /// The angles.
    pub epochs: &'a Epochs,
    /// Their errors.
    pub noise: AngleNoise,
    /// How they are used.
    pub how: Use,
}

/// A sensor's table.
#[derive(Clone, Copy, Debug)]
pub enum Source<'a> {
    /// Angles between stars and the nadir.
    Horizon(Horizon<'a>),
    /// Refractions of stars' light.
    Refraction(Refraction<'a>),
}

/// Refraction angles of stars seen through the air.
#[derive(Clone, Copy, Debug)]
pub struct Refraction<'a> {
    /// Times, s, not decreasing.
    pub t: &'a [f64],
    /// Unit vectors to the stars, GCRS, without refraction.
    pub star: &'a [[f64; 3]],
    /// Refractions, rad.
    pub angle: &'a [f64],
    /// The air.
    pub model: &'a RefractionAngle,
    /// Standard deviation of each angle's own error, rad.
    pub sigma: f64,
    /// Relative standard deviation of the air's density.
    pub density_sigma: f64,
}

impl Refraction<'_> {
    /// What is known of row `place` when the satellite is expected at `r`.
    #[inline(always)]
    fn given<T: Real>(&self, place: usize, r: &[T; 3]) -> RefractionGiven<T> {
        let star = components(|i| T::splat(self.star[place][i]));
        let density = self.model.ray(r, &star, T::one()).by_density * self.density_sigma;
        RefractionGiven { star, sigma: T::splat(self.sigma), density }
    }
}

/// A measurement of a log: its sensor, and its place there.
#[derive(Clone, Copy, Debug)]
struct Item {
    t: f64,
    sensor: usize,
    /// An epoch's number where its angles are used together, otherwise the row in the table.
    place: usize,
}

/// All measurements of a log in order of time.
#[derive(Clone, Debug)]
pub struct CelestialSensors<'a> {
    sources: Vec<Source<'a>>,
    order: Vec<Item>,
    robust: Robust,
    /// Largest normalised innovation squared by its degrees of freedom.
    gates: [f64; MAX_DOF],
}

/// What is done about measurements that do not fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Outliers {
    /// Nothing.
    #[default]
    Keep,
    /// A good angle passes the gate with this probability.
    Gate(f64),
    /// Huber's weights: linear beyond so many standard deviations.
    Huber(f64),
}

impl<'a> CelestialSensors<'a> {
    /// # Errors
    /// `Parameter` for a probability out of range, `Length` for columns of different lengths.
    pub fn new(sources: &[Source<'a>], outliers: Outliers) -> Result<Self> {
        let mut order = Vec::new();
        for (sensor, source) in sources.iter().enumerate() {
            match source {
                Source::Horizon(horizon) => {
                    if horizon.noise.limb > 0.0 && horizon.how == Use::Together {
                        let need = "says something of the distance: such angles are used one by one";
                        return Err(Error::Parameter { field: "limb", value: horizon.noise.limb, need });
                    }
                    for (epoch, t) in horizon.epochs.times().iter().enumerate() {
                        let item = |place| Item { t: *t, sensor, place };
                        match horizon.how {
                            Use::Together => order.push(item(epoch)),
                            Use::OneByOne => order.extend(horizon.epochs.rows(epoch).map(item)),
                        }
                    }
                }
                Source::Refraction(table) => {
                    let expected = table.t.len();
                    for (field, found) in
                        [("refraction.star", table.star.len()), ("refraction.angle", table.angle.len())]
                    {
                        if found != expected {
                            return Err(Error::Length { field, expected, found });
                        }
                    }
                    let item = |(place, t): (usize, &f64)| Item { t: *t, sensor, place };
                    order.extend(table.t.iter().enumerate().map(item));
                }
            }
        }
        order.sort_by(|a, b| a.t.total_cmp(&b.t));
        let mut gates = [f64::INFINITY; MAX_DOF];
        let robust = match outliers {
            Outliers::Keep => Robust::No,
            Outliers::Huber(limit) => Robust::Huber(limit),
            Outliers::Gate(probability) => {
                for (i, gate) in gates.iter_mut().enumerate() {
                    *gate = chi2_quantile(probability, (i + 1) as f64)?;
                }
                Robust::Gate(gates[0])
            }
        };
        Ok(Self { sources: sources.to_vec(), order, robust, gates })
    }

    /// No measurements at all.
    pub fn none() -> Self {
        Self { sources: Vec::new(), order: Vec::new(), robust: Robust::No, gates: [f64::INFINITY; MAX_DOF] }
    }

    /// How many measurements there are.
    pub fn count(&self) -> usize {
        self.order.len()
    }

    /// Time of measurement `i`, s.
    pub fn at(&self, i: usize) -> f64 {
        self.order[i].t
    }

    /// Number of the sensor and the first row of measurement `i` in its table.
    pub fn source(&self, i: usize) -> (usize, usize) {
        let Item { sensor, place, .. } = self.order[i];
        let row = match &self.sources[sensor] {
            Source::Horizon(h) if h.how == Use::Together => h.epochs.rows(place).start,
            Source::Horizon(_) | Source::Refraction(_) => place,
        };
        (sensor, row)
    }

    /// An epoch's angles as one direction.
    #[inline(always)]
    fn together<F: Filter, T: Real<Mask = bool>>(
        &self,
        horizon: &Horizon<'_>,
        epoch: usize,
        filter: &F,
        belief: &mut F::Belief<Euclidean<6>, T, 6>,
    ) -> Report {
        let x = belief.mean();
        let r = [x[0], x[1], x[2]];
        let inverse = dot3(&r, &r).sqrt().recip();
        let nadir = components(|i| -(r[i] * inverse));
        let p = belief.covariance();
        let spread: Matrix<T, 3, 3> = from_fn(|i, j| p[(i, j)] * (inverse * inverse));
        let seen = horizon.epochs.rows(epoch).len();
        let expected = Expected { nadir, spread };
        let fitted = horizon.epochs.fit(epoch, &horizon.noise, self.robust, &expected);
        let Some(fitted) = fitted else {
            return Report { rows: [seen, 0], ..nothing() };
        };
        let infinite = T::splat(f64::INFINITY);
        let outcome = filter.update::<_, T, 6, 2>(belief, &NadirPlane, &fitted.given, &fitted.value, infinite);
        let report = Report::from(outcome);
        Report { dof: fitted.rank, rows: [seen, if report.accepted { fitted.used } else { 0 }], ..report }
    }
}

/// A report on an epoch of which no angle could be used.
fn nothing() -> Report {
    let innovation = [f64::NAN; MAX_DOF];
    let covariance = [[f64::NAN; MAX_DOF]; MAX_DOF];
    Report { ok: true, accepted: false, dof: 2, nis: f64::NAN, innovation, covariance, rows: [0, 0] }
}

impl Sensors<Euclidean<6>, 6> for CelestialSensors<'_> {
    #[inline(always)]
    fn len(&self) -> usize {
        self.order.len()
    }

    #[inline(always)]
    fn time(&self, i: usize) -> f64 {
        self.order[i].t
    }

    #[inline(always)]
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<Euclidean<6>, T, 6>,
    ) -> Report {
        let Item { sensor, place, .. } = self.order[i];
        match &self.sources[sensor] {
            Source::Horizon(h) if h.how == Use::Together => self.together::<F, T>(h, place, filter, belief),
            Source::Horizon(h) => {
                let (star, angle) = h.epochs.sight(place);
                let given =
                    StarGiven { star: components(|i| T::splat(star[i])), sigma: T::splat(h.noise.variance().sqrt()) };
                let sensor = StarAngle { shape: h.noise.shape, limb: h.noise.limb };
                filter.update::<_, T, 6, 1>(belief, &sensor, &given, &[T::splat(angle)], T::splat(self.gates[0])).into()
            }
            Source::Refraction(table) => {
                let x = belief.mean();
                let given = table.given(place, &[x[0], x[1], x[2]]);
                let (z, gate) = ([T::splat(table.angle[place])], T::splat(self.gates[0]));
                filter.update::<_, T, 6, 1>(belief, table.model, &given, &z, gate).into()
            }
        }
    }

    #[inline(always)]
    fn log_likelihood<T: Real>(&self, i: usize, x: &[T; 6]) -> T {
        let r = [x[0], x[1], x[2]];
        let inverse = dot3(&r, &r).sqrt().recip();
        let nadir = components(|i| -(r[i] * inverse));
        let Item { sensor, place, .. } = self.order[i];
        match &self.sources[sensor] {
            Source::Horizon(h) => {
                if h.noise.limb > 0.0 {
                    let (star, angle) = h.epochs.sight(place);
                    let given = StarGiven { star: components(|i| T::splat(star[i])), sigma: T::splat(h.noise.own) };
                    let sensor = StarAngle { shape: h.noise.shape, limb: h.noise.limb };
                    let left = T::splat(angle) - sensor.predict(x, &given)[0];
                    return h.noise.shape.log_density(left, h.noise.own);
                }
                match h.how {
                    Use::Together => h.epochs.log_density(place, &h.noise, &nadir),
                    Use::OneByOne => h.epochs.log_density_of(place, &h.noise, &nadir),
                }
            }
            Source::Refraction(table) => {
                let given = table.given(place, &r);
                let left = T::splat(table.angle[place]) - table.model.predict(x, &given)[0];
                let variance = table.model.noise(&given)[(0, 0)];
                (left * left / variance + variance.map(f64::ln)) * -0.5
            }
        }
    }
}

//! A log's columns as what drives and corrects a replay.

use super::gyro::{GyroInput, GyroInputs, GyroModel, GyroTiming};
use super::sensors::{Direction, Reference, References, StarQuaternion, Symmetric3};
use super::state::{AttitudeBias, UnitQuaternion, Vector3};
use crate::consistency::chi2_quantile;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::manifold::Family;
use crate::replay::{Drive, MAX_DOF, Report, Sensors};
use crate::scalar::Real;

/// Gyro samples.
#[derive(Clone, Copy, Debug)]
pub struct GyroSeries<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Measured rates in the body frame, rad/s.
    pub rate: &'a [[f64; 3]],
    /// What a sample says of the time between samples.
    pub timing: GyroTiming,
}

impl Drive<GyroModel, 6> for GyroSeries<'_> {
    #[inline(always)]
    fn times(&self) -> &[f64] {
        self.t
    }
    #[inline(always)]
    fn input<T: Real>(&self, k: usize) -> GyroInput<T> {
        let next = (k + 1).min(self.t.len() - 1);
        let u = self.timing.between(&self.rate[k], &self.rate[next], self.t[next] - self.t[k]);
        GyroInputs::map(&u, T::splat)
    }
}

/// Fixes of one star camera.
#[derive(Clone, Copy, Debug)]
pub struct StarSeries<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Measured attitudes `q_ib`, unit quaternions of either sign.
    pub q: &'a [[f64; 4]],
    /// Covariance of each in the body frame, rad²: `(xx, xy, xz, yy, yz, zz)`.
    pub noise: &'a [[f64; 6]],
}

/// Directions seen by one sensor.
#[derive(Clone, Copy, Debug)]
pub struct DirectionSeries<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Measured unit vectors, body frame.
    pub body: &'a [[f64; 3]],
    /// Reference unit vectors, inertial frame.
    pub inertial: &'a [[f64; 3]],
    /// Standard deviations, rad.
    pub sigma: &'a [f64],
}

/// One sensor's samples.
#[derive(Clone, Copy, Debug)]
pub enum AttitudeSensor<'a> {
    /// A star camera.
    Star(StarSeries<'a>),
    /// A direction sensor.
    Direction(DirectionSeries<'a>),
}

impl AttitudeSensor<'_> {
    /// Times of the samples, s.
    pub fn times(&self) -> &[f64] {
        match self {
            Self::Star(s) => s.t,
            Self::Direction(s) => s.t,
        }
    }

    fn check(&self) -> Result<()> {
        let same = |field, found, expected| {
            if found == expected { Ok(()) } else { Err(Error::Length { field, expected, found }) }
        };
        let n = self.times().len();
        match self {
            Self::Star(s) => {
                same("star quaternions", s.q.len(), n)?;
                same("star noise", s.noise.len(), n)?;
            }
            Self::Direction(s) => {
                same("body vectors", s.body.len(), n)?;
                same("inertial vectors", s.inertial.len(), n)?;
                same("vector sigma", s.sigma.len(), n)?;
            }
        }
        for (row, pair) in self.times().windows(2).enumerate() {
            if pair[1].partial_cmp(&pair[0]) != Some(std::cmp::Ordering::Greater) {
                let (previous, value) = (pair[0], pair[1]);
                return Err(Error::NotIncreasing { field: "measurement time", row: row + 1, previous, value });
            }
        }
        Ok(())
    }
}

/// Several sensors merged by time. At equal times they come in the order given.
#[derive(Clone, Debug)]
pub struct AttitudeSensors<'a> {
    sensors: &'a [AttitudeSensor<'a>],
    order: Vec<(u32, u32)>,
    gates: [f64; MAX_DOF],
}

impl<'a> AttitudeSensors<'a> {
    /// Merges the sensors. `gate` is the probability with which a good measurement is accepted; 1 accepts
    /// all.
    ///
    /// # Errors
    /// Columns of different length, times that do not increase, a probability outside (0, 1].
    pub fn new(sensors: &'a [AttitudeSensor<'a>], gate: f64) -> Result<Self> {
        let rows: usize = sensors.iter().map(|s| s.times().len()).sum();
        let mut order = Vec::with_capacity(rows);
        for (i, sensor) in sensors.iter().enumerate() {
            sensor.check()?;
            order.extend((0..sensor.times().len()).map(|row| (i as u32, row as u32)));
        }
        // stable: at equal times the order of the sensors stands; merging sorted runs is fast
        order.sort_by(|a: &(u32, u32), b| {
            let time = |(i, row): &(u32, u32)| sensors[*i as usize].times()[*row as usize];
            time(a).total_cmp(&time(b))
        });
        Ok(Self { sensors, order, gates: gates(gate)? })
    }

    /// Sensor and row of the i-th measurement in order of time.
    pub fn source(&self, i: usize) -> (usize, usize) {
        let (sensor, row) = self.order[i];
        (sensor as usize, row as usize)
    }

    /// The sensors.
    pub fn sensors(&self) -> &[AttitudeSensor<'a>] {
        self.sensors
    }
}

/// Gates for one to [`MAX_DOF`] degrees of freedom.
pub(super) fn gates(probability: f64) -> Result<[f64; MAX_DOF]> {
    if probability == 0.0 {
        return Err(Error::Parameter { field: "gate", value: 0.0, need: "must be a probability above 0, up to 1" });
    }
    let mut gates = [f64::INFINITY; MAX_DOF];
    for (i, gate) in gates.iter_mut().enumerate() {
        *gate = chi2_quantile(probability, (i + 1) as f64)?;
    }
    Ok(gates)
}

/// Corrects a belief by a star fix.
#[inline(always)]
pub(super) fn update_star<F: Filter, T: Real<Mask = bool>>(
    filter: &F,
    belief: &mut F::Belief<AttitudeBias, T, 6>,
    q: &[f64; 4],
    noise: &[f64; 6],
    gates: &[f64; MAX_DOF],
) -> Report {
    let (given, z) = (Symmetric3::map(noise, T::splat), UnitQuaternion::map(q, T::splat));
    filter.update::<_, T, 6, 3>(belief, &StarQuaternion, &given, &z, T::splat(gates[2])).into()
}

/// Corrects a belief by a direction.
#[inline(always)]
pub(super) fn update_direction<F: Filter, T: Real<Mask = bool>>(
    filter: &F,
    belief: &mut F::Belief<AttitudeBias, T, 6>,
    body: &[f64; 3],
    reference: &Reference<f64>,
    gates: &[f64; MAX_DOF],
) -> Report {
    let (given, z) = (References::map(reference, T::splat), Vector3::map(body, T::splat));
    filter.update::<_, T, 6, 2>(belief, &Direction, &given, &z, T::splat(gates[1])).into()
}

impl Sensors<AttitudeBias, 6> for AttitudeSensors<'_> {
    #[inline(always)]
    fn len(&self) -> usize {
        self.order.len()
    }
    #[inline(always)]
    fn time(&self, i: usize) -> f64 {
        let (sensor, row) = self.source(i);
        self.sensors[sensor].times()[row]
    }
    #[inline(always)]
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<AttitudeBias, T, 6>,
    ) -> Report {
        let (sensor, row) = self.source(i);
        match &self.sensors[sensor] {
            AttitudeSensor::Star(s) => update_star(filter, belief, &s.q[row], &s.noise[row], &self.gates),
            AttitudeSensor::Direction(s) => {
                let reference = Reference { inertial: s.inertial[row], sigma: s.sigma[row] };
                update_direction(filter, belief, &s.body[row], &reference, &self.gates)
            }
        }
    }
}

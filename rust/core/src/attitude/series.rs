//! A log's columns as what drives and corrects a replay.

use super::gyro::{GyroInput, GyroInputs, GyroTiming};
use crate::consistency::chi2_quantile;
use crate::error::{Error, Result};
use crate::manifold::Family;
use crate::model::Dynamics;
use crate::replay::{Drive, MAX_DOF};
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

impl GyroSeries<'_> {
    /// Input between samples `k` and `k + 1`.
    #[inline(always)]
    pub fn between(&self, k: usize) -> GyroInput<f64> {
        let next = (k + 1).min(self.t.len() - 1);
        self.timing.between(&self.rate[k], &self.rate[next], self.t[next] - self.t[k])
    }
}

impl<D: Dynamics<N, Input = GyroInputs>, const N: usize> Drive<D, N> for GyroSeries<'_> {
    #[inline(always)]
    fn times(&self) -> &[f64] {
        self.t
    }
    #[inline(always)]
    fn input<T: Real>(&self, k: usize) -> GyroInput<T> {
        GyroInputs::map(&self.between(k), T::splat)
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

    /// The same without the fixes of one sensor; numbers of sensors stay.
    pub fn without(&self, sensor: Option<usize>) -> Self {
        let mut other = self.clone();
        other.order.retain(|(i, _)| Some(*i as usize) != sensor);
        other
    }

    /// Which measurement is this row of this sensor.
    pub fn find(&self, (sensor, row): (usize, usize)) -> Option<usize> {
        self.order.iter().position(|(i, k)| (*i as usize, *k as usize) == (sensor, row))
    }

    /// Sensor and row of the i-th measurement in order of time.
    pub fn source(&self, i: usize) -> (usize, usize) {
        let (sensor, row) = self.order[i];
        (sensor as usize, row as usize)
    }

    /// How many measurements there are.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Time of the i-th measurement, s.
    #[inline(always)]
    pub fn time(&self, i: usize) -> f64 {
        let (sensor, row) = self.source(i);
        self.sensors[sensor].times()[row]
    }

    /// Gates for one to [`MAX_DOF`] degrees of freedom.
    pub(super) fn gates(&self) -> &[f64; MAX_DOF] {
        &self.gates
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

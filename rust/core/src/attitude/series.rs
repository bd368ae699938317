//! A log's columns as what drives and corrects a replay.

use super::gyro::{GyroInput, GyroInputs, GyroTiming};
use super::merge::Order;
use super::sensors::Reference;
use super::trust::{Trust, Trusted};
use crate::error::{Error, Result};
use crate::manifold::Family;
use crate::model::Dynamics;
use crate::quaternion::{Quaternion, conjugate, multiply, to_matrix};
use crate::replay::Drive;
use crate::scalar::Real;

/// Gyro samples.
#[derive(Clone, Copy, Debug)]
pub struct GyroSeries<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Measured rates, rad/s.
    pub rate: &'a [[f64; 3]],
    /// From measured rates to rates of the body, row by row; by default they are rates of the body.
    pub turn: Option<[f64; 9]>,
    /// What a sample says of the time between samples.
    pub timing: GyroTiming,
}

/// A matrix, row by row, times a vector: term by term, to the same bits wherever it is compiled.
#[inline(always)]
pub fn turned(m: &[f64; 9], v: &[f64; 3]) -> [f64; 3] {
    let row = |i: usize| m[3 * i] * v[0] + m[3 * i + 1] * v[1] + m[3 * i + 2] * v[2];
    [row(0), row(1), row(2)]
}

impl GyroSeries<'_> {
    /// Rate of sample `k` in the body frame.
    #[inline(always)]
    pub fn at(&self, k: usize) -> [f64; 3] {
        match &self.turn {
            None => self.rate[k],
            Some(turn) => turned(turn, &self.rate[k]),
        }
    }

    /// Input between samples `k` and `k + 1`.
    #[inline(always)]
    pub fn between(&self, k: usize) -> GyroInput<f64> {
        let next = (k + 1).min(self.t.len() - 1);
        self.timing.input(
            #[inline(always)]
            || self.at(k),
            #[inline(always)]
            || self.at(next),
            self.t[next] - self.t[k],
        )
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

/// Covariance of the error of a camera's fixes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FixNoise<'a> {
    /// The same for all, in the body frame, rad²: `(xx, xy, xz, yy, yz, zz)`.
    Same([f64; 6]),
    /// One for each, in the body frame, rad².
    Each(&'a [[f64; 6]]),
    /// Standard deviations of each about the camera's axes, rad.
    Sigma(&'a [[f64; 3]]),
    /// Covariance of each in the camera's frame, rad².
    Covariance(&'a [[[f64; 3]; 3]]),
}

impl<'a> From<&'a [[f64; 6]]> for FixNoise<'a> {
    fn from(each: &'a [[f64; 6]]) -> Self {
        Self::Each(each)
    }
}

/// Fixes of one star camera.
#[derive(Clone, Copy, Debug)]
pub struct StarSeries<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Measured attitudes, unit quaternions of either sign: camera to inertial.
    pub q: &'a [[f64; 4]],
    /// Their noise.
    pub noise: FixNoise<'a>,
    /// Camera to body, `q_bc`; by default the camera's frame is the body's.
    pub mounting: Option<Quaternion<f64>>,
}

impl StarSeries<'_> {
    /// Attitude `q_ib` of a fix and the covariance of its error in the body frame.
    #[inline(always)]
    pub fn fix(&self, row: usize) -> ([f64; 4], [f64; 6]) {
        let q = self.mounting.map_or(self.q[row], |m| multiply(&self.q[row], &conjugate(&m)));
        let noise = match self.noise {
            FixNoise::Same(noise) => noise,
            FixNoise::Each(noise) => noise[row],
            FixNoise::Sigma(sigma) => {
                let v = sigma[row].map(|s| s * s);
                self.of_body(&[v[0], 0.0, 0.0, 0.0, v[1], 0.0, 0.0, 0.0, v[2]])
            }
            FixNoise::Covariance(c) => {
                let c = &c[row];
                self.of_body(&[c[0][0], c[0][1], c[0][2], c[1][0], c[1][1], c[1][2], c[2][0], c[2][1], c[2][2]])
            }
        };
        (q, noise)
    }

    /// `R C Rᵀ`, packed: a sum over the nine entries of `C`, in their order.
    #[inline(always)]
    fn of_body(&self, c: &[f64; 9]) -> [f64; 6] {
        let Some(m) = &self.mounting else { return [c[0], c[1], c[2], c[4], c[5], c[8]] };
        let turn = to_matrix(m);
        [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(
            #[inline(always)]
            |(i, j)| {
                let mut sum = 0.0;
                for k in 0..9 {
                    sum += c[k] * (turn[(i, k / 3)] * turn[(j, k % 3)]);
                }
                sum
            },
        )
    }

    fn noise_rows(&self) -> usize {
        match self.noise {
            FixNoise::Same(_) => self.t.len(),
            FixNoise::Each(x) => x.len(),
            FixNoise::Sigma(x) => x.len(),
            FixNoise::Covariance(x) => x.len(),
        }
    }
}

/// Directions seen by one sensor.
#[derive(Clone, Copy, Debug)]
pub struct DirectionSeries<'a> {
    /// Times, s.
    pub t: &'a [f64],
    /// Measured unit vectors, sensor frame.
    pub body: &'a [[f64; 3]],
    /// Reference unit vectors, inertial frame.
    pub inertial: &'a [[f64; 3]],
    /// Standard deviations, rad: one for each, or one for all.
    pub sigma: &'a [f64],
    /// Sensor to body, row by row, and the result scaled to a unit vector; by default nothing is done.
    pub turn: Option<[f64; 9]>,
}

impl DirectionSeries<'_> {
    /// A unit vector of the body frame, and what is known of it beforehand.
    #[inline(always)]
    pub fn sight(&self, row: usize) -> ([f64; 3], Reference<f64>) {
        let body = match &self.turn {
            None => self.body[row],
            Some(turn) => {
                let v = turned(turn, &self.body[row]);
                let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
                v.map(|c| c / norm)
            }
        };
        let sigma = if let [sigma] = self.sigma { *sigma } else { self.sigma[row] };
        (body, Reference { inertial: self.inertial[row], sigma })
    }
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
                same("star noise", s.noise_rows(), n)?;
            }
            Self::Direction(s) => {
                same("body vectors", s.body.len(), n)?;
                same("inertial vectors", s.inertial.len(), n)?;
                same("vector sigma", if s.sigma.len() == 1 { n } else { s.sigma.len() }, n)?;
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
    order: Order,
    left_out: Option<usize>,
    trust: Trusted,
}

impl<'a> AttitudeSensors<'a> {
    /// Merges the sensors. `trust` is how far measurements are believed; a number alone is the gate: the probability with
    /// which a good measurement is accepted; 1 accepts all.
    ///
    /// # Errors
    /// Columns of different length, times that do not increase, a probability outside (0, 1].
    pub fn new(sensors: &'a [AttitudeSensor<'a>], trust: impl Into<Trust>) -> Result<Self> {
        for sensor in sensors {
            sensor.check()?;
        }
        Ok(Self { sensors, order: order(sensors, None)?, left_out: None, trust: Trusted::new(trust.into())? })
    }

    /// The same without the fixes of one sensor; numbers of sensors stay.
    ///
    /// # Errors
    /// Too many sensors.
    pub fn without(&self, sensor: Option<usize>) -> Result<Self> {
        Ok(Self { order: order(self.sensors, sensor)?, left_out: sensor, ..*self })
    }

    /// Which measurement is this row of this sensor.
    pub fn find(&self, (sensor, row): (usize, usize)) -> Option<usize> {
        let t = *self.sensors.get(sensor)?.times().get(row)?;
        // those of one time come together, one of each sensor
        let (mut low, mut high) = (0, self.len());
        while low < high {
            let middle = low.midpoint(high);
            if self.time(middle) < t { low = middle + 1 } else { high = middle }
        }
        (low..self.len()).take_while(|i| self.time(*i) == t).find(|i| self.source(*i) == (sensor, row))
    }

    /// How many measurements lie between two times, both included.
    pub fn count(&self, from: f64, to: f64) -> usize {
        let kept = |s: &usize| Some(*s) != self.left_out;
        let inside = |s: usize| {
            let times = self.sensors[s].times();
            times.partition_point(|t| *t <= to).saturating_sub(times.partition_point(|t| *t < from))
        };
        (0..self.sensors.len()).filter(kept).map(inside).sum()
    }

    /// Sensor and row of the i-th measurement in order of time.
    #[inline(always)]
    pub fn source(&self, i: usize) -> (usize, usize) {
        self.order.source(i)
    }

    /// How many measurements there are.
    #[inline(always)]
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of the i-th measurement, s.
    #[inline(always)]
    pub fn time(&self, i: usize) -> f64 {
        let (sensor, row) = self.source(i);
        self.sensors[sensor].times()[row]
    }

    /// How far measurements are believed.
    #[inline(always)]
    pub(super) fn trust(&self) -> &Trusted {
        &self.trust
    }

    /// The sensors.
    pub fn sensors(&self) -> &[AttitudeSensor<'a>] {
        self.sensors
    }
}

/// The order of all sensors but one.
fn order(sensors: &[AttitudeSensor<'_>], without: Option<usize>) -> Result<Order> {
    let times: Vec<Option<&[f64]>> =
        sensors.iter().enumerate().map(|(i, s)| (Some(i) != without).then(|| s.times())).collect();
    Order::new(&times)
}

//! An orbit estimated epoch by epoch, as angles come in.

use super::results::Results;
use super::run::{AnyFilter, Log, Options, run};
use super::sensors::CelestialSensors;
use crate::error::{Error, Result};
use crate::linalg::Matrix;
use crate::orbit::OrbitModel;
use crate::replay::{MAX_DOF, Report, Start};
use crate::scalar::Level;

/// A filter that is fed epoch by epoch: each step is a run over a log of one epoch. A step that fails
/// leaves everything as it was.
#[derive(Clone, Debug)]
pub struct OrbitStream {
    filter: AnyFilter,
    dynamics: OrbitModel,
    t: f64,
    mean: [f64; 6],
    covariance: Matrix<f64, 6, 6>,
}

impl OrbitStream {
    /// # Errors
    /// `NotStreaming` for a filter that replays whole logs only, `NotPositiveDefinite`.
    pub fn new(
        filter: AnyFilter,
        dynamics: OrbitModel,
        t: f64,
        mean: [f64; 6],
        covariance: Matrix<f64, 6, 6>,
    ) -> Result<Self> {
        if matches!(filter, AnyFilter::Iterated(_) | AnyFilter::Cloud(..)) {
            return Err(Error::NotStreaming);
        }
        let mut out = Self { filter, dynamics, t, mean, covariance };
        out.step(&[t], &CelestialSensors::none())?;
        Ok(out)
    }

    /// Time, s.
    pub fn time(&self) -> f64 {
        self.t
    }
    /// Position and velocity, GCRS, m and m/s.
    pub fn mean(&self) -> &[f64; 6] {
        &self.mean
    }
    /// Their covariance.
    pub fn covariance(&self) -> &Matrix<f64, 6, 6> {
        &self.covariance
    }

    /// Moves on to time `t`.
    ///
    /// # Errors
    /// `OutOfOrder` for a time before the state's own, `NotPositiveDefinite`.
    pub fn predict(&mut self, t: f64) -> Result<()> {
        if t.is_nan() || t < self.t {
            return Err(Error::OutOfOrder { field: "t", t, now: self.t });
        }
        if t > self.t {
            self.step(&[self.t, t], &CelestialSensors::none())?;
        }
        Ok(())
    }

    /// Corrects the state by one epoch of a sensor, whose times are the state's. What angles say one by one
    /// is summed up: degrees of freedom, normalised innovation squared, rows.
    ///
    /// # Errors
    /// `NotPositiveDefinite`.
    pub fn update(&mut self, sensors: &CelestialSensors<'_>) -> Result<Report> {
        let results = self.step(&[self.t], sensors)?;
        Ok(report(&results))
    }

    fn step(&mut self, times: &[f64], sensors: &CelestialSensors<'_>) -> Result<Results> {
        let log = Log { dynamics: &self.dynamics, times, sensors };
        let start = Start { t: self.t, mean: self.mean, covariance: self.covariance, used: None };
        let options = Options { every: usize::MAX, level: Level::best(), random: (0, 0) };
        let mut results = Results::default();
        let end = run(&self.filter, log, &start, &options, &mut results, &mut |_| Ok(()))?;
        (self.t, self.mean, self.covariance) = (end.t, end.mean, end.covariance);
        Ok(results)
    }
}

/// All measurements of a run as one report; innovations of several have no place in it.
fn report(results: &Results) -> Report {
    let [_, _, dof, seen, used] = &results.source;
    let sum = |column: &[i32]| column.iter().sum::<i32>() as usize;
    let (mut innovation, mut covariance) = ([f64::NAN; MAX_DOF], [[f64::NAN; MAX_DOF]; MAX_DOF]);
    if let ([one], [sigma]) = (results.innovation.as_slice(), results.innovation_sigma.as_slice()) {
        innovation = *one;
        for i in 0..MAX_DOF {
            covariance[i][i] = sigma[i] * sigma[i];
        }
    }
    let accepted = results.accepted.iter().any(|a| *a);
    let nis = results.nis.iter().sum();
    Report { ok: true, accepted, dof: sum(dof), nis, innovation, covariance, rows: [sum(seen), sum(used)] }
}

//! An orbit estimated epoch by epoch, as angles come in.

use super::run::AnyFilter;
use super::sensors::CelestialSensors;
use crate::belief::Belief;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::{Matrix, from_fn};
use crate::orbit::OrbitModel;
use crate::replay::{MAX_DOF, Report, Sensors};
use crate::scalar::{Level, Real, Run};

/// A filter that is fed epoch by epoch. A step that fails leaves everything as it was.
#[derive(Clone, Debug)]
pub struct OrbitStream {
    filter: AnyFilter,
    dynamics: OrbitModel,
    level: Level,
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
        if !matches!(filter, AnyFilter::Ekf(_) | AnyFilter::Ukf(_) | AnyFilter::SrUkf(_) | AnyFilter::Score(_)) {
            return Err(Error::NotStreaming);
        }
        let mut out = Self { filter, dynamics, level: Level::best(), t, mean, covariance };
        out.step(Step::Nothing, "initial covariance")?;
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
            self.step(Step::Predict(t), "predicted covariance")?;
            self.t = t;
        }
        Ok(())
    }

    /// Corrects the state by one epoch of a sensor, at the state's time whatever time stands there.
    /// What the angles of an epoch say one by one is summed up: degrees of freedom, normalised innovation
    /// squared, rows.
    ///
    /// # Errors
    /// As [`CelestialSensors::new`]; `NotPositiveDefinite`.
    pub fn update(&mut self, sensors: &CelestialSensors<'_>) -> Result<Report> {
        self.step(Step::Update(sensors), "covariance in the update")
    }

    fn step(&mut self, step: Step<'_>, what: &'static str) -> Result<Report> {
        let job = (&*self, step);
        let made = match &self.filter {
            AnyFilter::Ekf(f) => self.level.run(Job(job, f)),
            AnyFilter::Ukf(f) => self.level.run(Job(job, f)),
            AnyFilter::SrUkf(f) => self.level.run(Job(job, f)),
            AnyFilter::Score(f) => self.level.run(Job(job, f)),
            AnyFilter::Iterated(_) | AnyFilter::Cloud(..) => return Err(Error::NotStreaming),
        };
        let (report, mean, covariance) = made.ok_or(Error::NotPositiveDefinite { what, step: 0, t: self.t })?;
        (self.mean, self.covariance) = (mean, covariance);
        Ok(report)
    }
}

#[derive(Clone, Copy)]
enum Step<'a> {
    Nothing,
    Predict(f64),
    Update(&'a CelestialSensors<'a>),
}

struct Job<'a, F>((&'a OrbitStream, Step<'a>), &'a F);

impl<F: Filter> Run for Job<'_, F> {
    type Output = Option<(Report, [f64; 6], Matrix<f64, 6, 6>)>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> Self::Output {
        let Job((from, step), filter) = self;
        let p = from_fn(|i, j| T::splat(from.covariance[(i, j)]));
        let (mut belief, ok) = filter.belief(from.mean.map(T::splat), &p);
        if !ok {
            return None;
        }
        let mut report = silence();
        match step {
            Step::Nothing => {}
            Step::Predict(t) => {
                let (now, dt) = (T::splat(from.t), T::splat(t - from.t));
                if !filter.predict(&mut belief, &from.dynamics, &(), now, dt) {
                    return None;
                }
            }
            Step::Update(sensors) => {
                for i in 0..sensors.count() {
                    let one = sensors.update(i, filter, &mut belief);
                    if !one.ok {
                        return None;
                    }
                    report = if i == 0 { one } else { joined(&report, &one) };
                }
            }
        }
        let p = belief.covariance();
        Some((report, belief.mean().map(|x| x.lane(0)), from_fn(|i, j| p[(i, j)].lane(0))))
    }
}

fn silence() -> Report {
    let (innovation, covariance) = ([f64::NAN; MAX_DOF], [[f64::NAN; MAX_DOF]; MAX_DOF]);
    Report { ok: true, accepted: false, dof: 0, nis: 0.0, innovation, covariance, rows: [0, 0] }
}

/// Two reports as one: innovations of several angles have no place in it.
fn joined(a: &Report, b: &Report) -> Report {
    Report {
        accepted: a.accepted || b.accepted,
        dof: a.dof + b.dof,
        nis: a.nis + b.nis,
        rows: [a.rows[0] + b.rows[0], a.rows[1] + b.rows[1]],
        ..silence()
    }
}

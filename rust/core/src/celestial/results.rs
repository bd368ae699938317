//! What a run finds, column by column.

use super::sensors::CelestialSensors;
use crate::belief::Belief;
use crate::cloud::Weighing;
use crate::manifold::Euclidean;
use crate::replay::{MAX_DOF, Recorder, Report, Sink};
use crate::scalar::Real;

/// Columns over the output times and over the measurements. Memory is kept from run to run.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// Output times, s.
    pub t: Vec<f64>,
    /// Positions and velocities, GCRS, m and m/s.
    pub state: Vec<[f64; 6]>,
    /// Their standard deviations.
    pub sigma: Vec<[f64; 6]>,
    /// Their covariances; no rows if they are not wanted.
    pub covariance: Vec<[[f64; 6]; 6]>,
    /// Whether covariances are wanted.
    pub with_covariance: bool,
    /// Times of the measurements, s.
    pub measured_t: Vec<f64>,
    /// Sensor, first row in its table, degrees of freedom, rows, rows used.
    pub source: [Vec<i32>; 5],
    /// Normalised innovation squared.
    pub nis: Vec<f64>,
    /// Whether the measurement was used.
    pub accepted: Vec<bool>,
    /// Innovations, rad.
    pub innovation: Vec<[f64; MAX_DOF]>,
    /// Their standard deviations, rad.
    pub innovation_sigma: Vec<[f64; MAX_DOF]>,
    /// Effective number of particles at the measurement, not a number where all weights vanished and the filter
    /// recovered; no rows for other filters.
    pub effective: Vec<f64>,
}

impl Results {
    /// Forgets the last run but keeps its memory.
    pub fn clear(&mut self) {
        self.t.clear();
        self.state.clear();
        self.sigma.clear();
        self.covariance.clear();
        self.measured_t.clear();
        self.source.iter_mut().for_each(Vec::clear);
        self.nis.clear();
        self.accepted.clear();
        self.innovation.clear();
        self.innovation_sigma.clear();
        self.effective.clear();
    }

    /// Turns the output rows round: a smoother writes them from the end.
    pub(super) fn reverse(&mut self) {
        self.t.reverse();
        self.state.reverse();
        self.sigma.reverse();
        self.covariance.reverse();
    }

    #[inline(always)]
    fn state<T: Real, B: Belief<Euclidean<6>, T, 6>>(&mut self, t: f64, belief: &B) {
        self.t.push(t);
        self.state.push(belief.mean().map(|x| x.lane(0)));
        self.sigma.push(belief.variance().map(|x| x.lane(0).sqrt()));
        if self.with_covariance {
            let p = belief.covariance();
            self.covariance.push(std::array::from_fn(|i| std::array::from_fn(|j| p[(i, j)].lane(0))));
        }
    }

    fn measured(&mut self, t: f64, (sensor, row): (usize, usize), report: &Report) {
        self.measured_t.push(t);
        let numbers = [sensor, row, report.dof, report.rows[0], report.rows[1]];
        for (column, number) in self.source.iter_mut().zip(numbers) {
            column.push(number as i32);
        }
        self.nis.push(report.nis);
        self.accepted.push(report.accepted);
        self.innovation.push(report.innovation);
        self.innovation_sigma.push(std::array::from_fn(|i| report.covariance[i][i].sqrt()));
    }
}

/// Where a pass over a log reports to: straight to the results, or to a recorder that a smoother reads.
pub(super) struct Pass<'a> {
    pub(super) results: &'a mut Results,
    pub(super) sensors: &'a CelestialSensors<'a>,
    pub(super) recorder: Option<Recorder<Euclidean<6>, 6>>,
}

impl Sink<Euclidean<6>, 6> for Pass<'_> {
    #[inline(always)]
    fn state<T: Real, B: Belief<Euclidean<6>, T, 6>>(&mut self, t: f64, k: usize, belief: &B) {
        match &mut self.recorder {
            Some(recorder) => recorder.row(t, k),
            None => self.results.state(t, belief),
        }
    }
    #[inline(always)]
    fn measured(&mut self, i: usize, report: &Report) {
        self.results.measured(self.sensors.at(i), self.sensors.source(i), report);
    }
    #[inline(always)]
    fn weighed(&mut self, _: usize, weighing: &Weighing) {
        // where the weights vanished there are none to count
        self.results.effective.push(if weighing.recovered { f64::NAN } else { weighing.effective });
    }
    #[inline(always)]
    fn leaving<T: Real, B: Belief<Euclidean<6>, T, 6>>(&mut self, t: f64, to: f64, k: usize, belief: &B) {
        if let Some(recorder) = &mut self.recorder {
            recorder.node(t, to, k, belief);
        }
    }
}

//! Many trials over threads, each run through several estimators.

use super::results::Results;
use super::run::{AnyFilter, Log, Options, run, smooth};
use super::sensors::{CelestialSensors, Horizon, Outliers, Source, Use};
use super::simulate::AngleScene;
use crate::error::{Error, Result};
use crate::horizon::{AngleNoise, AngleSeries, Epochs};
use crate::linalg::{Matrix, cholesky, forward_solve, from_fn};
use crate::manifold::Euclidean;
use crate::orbit::OrbitModel;
use crate::replay::{End, Start};
use crate::scalar::Level;
use crate::simulate::rng::{Stream, channel};
use crate::simulate::{keep_on, over_threads};
use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// A filter or smoother, and what it knows of dynamics and sensors.
#[derive(Clone, Debug)]
pub struct Estimator {
    /// The filter.
    pub filter: AnyFilter,
    /// How it takes the orbit to move.
    pub dynamics: OrbitModel,
    /// The errors that it takes star angles to have, and how it uses them; None: it does not use them.
    pub horizon: Option<(AngleNoise, Use)>,
    /// What it does about measurements that do not fit.
    pub outliers: Outliers,
    /// Whether to smooth.
    pub smooth: bool,
}

/// What is flown, and what is measured on the way.
#[derive(Clone, Debug)]
pub struct Flight<'a> {
    /// Times of the epochs, s, increasing.
    pub t: &'a [f64],
    /// True positions and velocities then, GCRS, m and m/s.
    pub state: &'a [[f64; 6]],
    /// Time of each star angle: an epoch's.
    pub star_t: &'a [f64],
    /// Directions to the stars as the log gives them.
    pub star: &'a [[f64; 3]],
    /// What makes the angles.
    pub scene: AngleScene,
    /// Standard deviations of the error that estimators start with.
    pub start_sigma: [f64; 6],
}

/// What a campaign runs.
#[derive(Clone, Debug)]
pub struct Campaign<'a> {
    /// What is flown.
    pub flight: Flight<'a>,
    /// What estimates it.
    pub estimators: Vec<Estimator>,
    /// Key of all random numbers.
    pub seed: u64,
    /// Numbers of the trials.
    pub trials: Range<u64>,
    /// Time at the start that is left out of the scores, s.
    pub skip: f64,
    /// Instruction set of the filters.
    pub level: Level,
}

/// Lengths of error vectors over the epochs that are scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
    /// Root mean square.
    pub rms: f64,
}

/// How far an estimate was from the truth, over the epochs that are scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Position error, m.
    pub position: Spread,
    /// Velocity error, m/s.
    pub velocity: Spread,
    /// Mean normalised squared error; 6 for a consistent estimate.
    pub nees: f64,
    /// Normalised innovations squared over their degrees of freedom, of the measurements used; 1 for a
    /// consistent filter. Not a number without measurements.
    pub nis: f64,
    /// Share of the angles that were used.
    pub accepted: f64,
    /// Mean effective number of particles; not a number for other filters.
    pub effective: f64,
    /// Estimate less truth at the end, m and m/s.
    pub final_error: [f64; 6],
    /// Time that the estimator took, s.
    pub seconds: f64,
}

/// One estimator's result in one trial; an error if it broke down.
pub type Scored = Result<Score>;

impl Flight<'_> {
    fn check(&self) -> Result<()> {
        if self.t.is_empty() {
            return Err(Error::Empty { field: "truth" });
        }
        let same = |field, found, expected| {
            if found == expected { Ok(()) } else { Err(Error::Length { field, expected, found }) }
        };
        same("truth.state", self.state.len(), self.t.len())?;
        same("stars.t", self.star_t.len(), self.scene.len())?;
        same("stars.star", self.star.len(), self.scene.len())
    }

    /// The state that estimators start from in a trial: the truth and a normal error.
    pub fn start(&self, seed: u64, trial: u64) -> Result<[f64; 6]> {
        let truth = self.state.first().ok_or(Error::Empty { field: "truth" })?;
        let error: [f64; 6] = Stream::new(seed, trial, channel::START).normals();
        Ok(std::array::from_fn(|i| truth[i] + self.start_sigma[i] * error[i]))
    }
}

/// Runs all trials, by number of the trial and then of the estimator. The same bits for any number of
/// threads. `poll` is called on the calling thread, at least 20 times a second, with the number of
/// trials done, and may end the campaign.
///
/// # Errors
/// What `poll` returns; input that no estimator can run on. A filter that breaks down in a trial is a
/// result, not an error.
pub fn monte_carlo(
    campaign: &Campaign<'_>,
    threads: usize,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<Vec<Scored>>> {
    campaign.flight.check()?;
    let stop = AtomicBool::new(false);
    let work = (|| Worker::new(campaign, &stop), |worker: &mut Worker<'_>, number| worker.trial(number));
    over_threads(campaign.trials.clone(), threads, &stop, work, poll)
}

/// One thread's memory.
struct Worker<'a> {
    campaign: &'a Campaign<'a>,
    stop: &'a AtomicBool,
    angle: Vec<f64>,
    epochs: Epochs,
    results: Results,
}

impl<'a> Worker<'a> {
    fn new(campaign: &'a Campaign<'a>, stop: &'a AtomicBool) -> Self {
        let results = Results { with_covariance: true, ..Results::default() };
        Self { campaign, stop, angle: Vec::new(), epochs: Epochs::default(), results }
    }

    fn trial(&mut self, trial: u64) -> Result<Vec<Scored>> {
        let campaign = self.campaign;
        let flight = &campaign.flight;
        flight.scene.simulate(campaign.seed, trial, &mut self.angle);
        self.epochs.fill(&AngleSeries { t: flight.star_t, star: flight.star, angle: &self.angle })?;
        let mean = flight.start(campaign.seed, trial)?;
        let mut out = Vec::with_capacity(campaign.estimators.len());
        for estimator in &campaign.estimators {
            keep_on(self.stop)?;
            out.push(match self.estimate(estimator, &mean, trial) {
                // what breaks down in one trial says something of the estimator
                Err(error @ (Error::NotPositiveDefinite { .. } | Error::Impact { .. } | Error::Vanished { .. })) => {
                    Err(error)
                }
                other => Ok(other?),
            });
        }
        Ok(out)
    }

    /// Runs one estimator on the angles and scores it.
    fn estimate(&mut self, e: &Estimator, mean: &[f64; 6], trial: u64) -> Result<Score> {
        let (campaign, stop) = (self.campaign, self.stop);
        let flight = &campaign.flight;
        let horizon = e.horizon.map(|(noise, how)| Source::Horizon(Horizon { epochs: &self.epochs, noise, how }));
        let sources: Vec<Source<'_>> = horizon.into_iter().collect();
        let sensors = CelestialSensors::new(&sources, e.outliers)?;
        let log = Log { dynamics: &e.dynamics, times: flight.t, sensors: &sensors };
        let sigma = flight.start_sigma;
        let covariance = from_fn(|i, j| if i == j { sigma[i] * sigma[i] } else { 0.0 });
        let start = Start { t: flight.t[0], mean: *mean, covariance, used: None };
        let options = Options { every: 1, level: campaign.level, random: (campaign.seed, trial) };
        let call = if e.smooth { smooth } else { run };
        let began = Instant::now();
        let end = call(&e.filter, log, &start, &options, &mut self.results, &mut |_| keep_on(stop))?;
        let seconds = began.elapsed().as_secs_f64();
        score(flight, &self.results, (campaign.skip, seconds), &end)
    }
}

/// Lengths of vectors, one after the other.
#[derive(Default)]
struct Lengths {
    sum: f64,
    squares: f64,
    max: f64,
    rows: usize,
}

impl Lengths {
    fn add(&mut self, v: &[f64]) {
        let square: f64 = v.iter().map(|x| x * x).sum();
        self.sum += square.sqrt();
        self.squares += square;
        self.max = self.max.max(square.sqrt());
        self.rows += 1;
    }
    fn spread(&self) -> Spread {
        let n = self.rows as f64;
        Spread { mean: self.sum / n, max: self.max, rms: (self.squares / n).sqrt() }
    }
}

/// Of the rows from `skip` after the first time on.
fn score(flight: &Flight<'_>, out: &Results, (skip, seconds): (f64, f64), end: &End<Euclidean<6>, 6>) -> Result<Score> {
    let from = flight.t[0] + skip;
    let (mut position, mut velocity) = (Lengths::default(), Lengths::default());
    let mut nees = 0.0;
    for (((t, state), covariance), truth) in out.t.iter().zip(&out.state).zip(&out.covariance).zip(flight.state) {
        if *t < from {
            continue;
        }
        let error: [f64; 6] = std::array::from_fn(|i| state[i] - truth[i]);
        position.add(&error[..3]);
        velocity.add(&error[3..]);
        nees += normalised(&error, covariance);
    }
    let (nis, accepted) = measured(out, from);
    let counted: Vec<f64> = out.effective.iter().copied().filter(|e| !e.is_nan()).collect();
    let effective = counted.iter().sum::<f64>() / counted.len() as f64;
    let last = flight.state[flight.state.len() - 1];
    Ok(Score {
        nees: nees / position.rows as f64,
        position: position.spread(),
        velocity: velocity.spread(),
        nis,
        accepted,
        effective,
        final_error: std::array::from_fn(|i| end.mean[i] - last[i]),
        seconds,
    })
}

/// Squares of the innovations by degree of freedom, and the share of the angles used.
fn measured(out: &Results, from: f64) -> (f64, f64) {
    let [_, _, dof, seen, used] = &out.source;
    let (mut nis, mut dofs, mut all, mut taken) = (0.0, 0, 0, 0);
    for m in 0..out.measured_t.len() {
        if out.measured_t[m] < from {
            continue;
        }
        all += seen[m];
        taken += used[m];
        if out.accepted[m] {
            nis += out.nis[m];
            dofs += dof[m];
        }
    }
    (nis / f64::from(dofs), f64::from(taken) / f64::from(all))
}

fn normalised(e: &[f64; 6], p: &[[f64; 6]; 6]) -> f64 {
    let p: Matrix<f64, 6, 6> = from_fn(|i, j| p[i][j]);
    let (l, ok) = cholesky(&p);
    // particles that have all become one claim to know the state
    if ok { forward_solve(&l, e).iter().map(|y| y * y).sum() } else { f64::INFINITY }
}

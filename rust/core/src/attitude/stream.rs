//! The same filters, one sample at a time.

use super::gyro::{GyroInput, GyroInputs, GyroModel, GyroTiming};
use super::history::{Back, History, PastStep, SmoothedState};
use super::run::AnyFilter;
use super::sensors::Reference;
use super::series::gates;
use super::state::{Attitude, AttitudeBias};
use super::system::System;
use crate::belief::{Belief, Gaussian, SqrtGaussian};
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, SrUkf, Ukf};
use crate::linalg::{Matrix, from_fn};
use crate::manifold::Family;
use crate::replay::{MAX_DOF, Report};
use crate::scalar::{Level, Real, Run};

/// A filter that runs, with its belief.
#[derive(Clone, Copy)]
enum Running {
    Ekf(Ekf, Gaussian<AttitudeBias, f64, 6>),
    Ukf(Ukf, Gaussian<AttitudeBias, f64, 6>),
    SrUkf(SrUkf, SqrtGaussian<AttitudeBias, f64, 6>),
}

impl Running {
    fn new(filter: AnyFilter, mean: Attitude<f64>, p: &Matrix<f64, 6, 6>) -> Result<(Self, bool)> {
        Ok(match filter {
            AnyFilter::Ekf(f) => {
                let (b, ok) = f.belief::<AttitudeBias, f64, 6>(mean, p);
                (Self::Ekf(f, b), ok)
            }
            AnyFilter::Ukf(f) => {
                let (b, ok) = f.belief::<AttitudeBias, f64, 6>(mean, p);
                (Self::Ukf(f, b), ok)
            }
            AnyFilter::SrUkf(f) => {
                let (b, ok) = f.belief::<AttitudeBias, f64, 6>(mean, p);
                (Self::SrUkf(f, b), ok)
            }
            AnyFilter::Iterated(_) | AnyFilter::Invariant | AnyFilter::Literal(_) => return Err(Error::NotStreaming),
        })
    }
    /// State and matrix as they are carried from step to step.
    fn parts(&self) -> (Attitude<f64>, Matrix<f64, 6, 6>) {
        match self {
            Self::Ekf(_, b) | Self::Ukf(_, b) => (b.mean, b.cov),
            Self::SrUkf(_, b) => (b.mean, b.factor),
        }
    }
}

fn gaussian(s: &PastStep) -> Gaussian<AttitudeBias, f64, 6> {
    Gaussian { mean: s.mean, cov: s.matrix }
}

fn square_root(s: &PastStep) -> SqrtGaussian<AttitudeBias, f64, 6> {
    SqrtGaussian { mean: s.mean, factor: s.matrix }
}

/// Attitude filter for use inside another program: `predict` with each gyro sample, `update` with each
/// measurement, in order of time. Gives what a replay of the same samples gives.
#[derive(Clone)]
pub struct Stream {
    running: Running,
    model: GyroModel,
    timing: GyroTiming,
    gates: [f64; MAX_DOF],
    level: Level,
    t: f64,
    /// The latest gyro sample and its time.
    last: Option<(f64, [f64; 3])>,
    steps: usize,
    history: Option<History>,
}

/// What a [`Stream`] carries from step to step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    /// Time of the state, s.
    pub t: f64,
    /// The state.
    pub mean: Attitude<f64>,
    /// Covariance of its error, or the square root that a square-root filter carries.
    pub matrix: Matrix<f64, 6, 6>,
    /// The latest gyro sample and its time.
    pub last: Option<(f64, [f64; 3])>,
    /// Steps made.
    pub steps: usize,
}

impl Stream {
    /// Starts at time `t` from a state and the covariance of its error.
    ///
    /// # Errors
    /// A covariance that is not positive definite, a gate outside (0, 1].
    pub fn new(
        filter: AnyFilter,
        model: GyroModel,
        timing: GyroTiming,
        gate: f64,
        t: f64,
        mean: Attitude<f64>,
        covariance: &Matrix<f64, 6, 6>,
    ) -> Result<Self> {
        let (running, ok) = Running::new(filter, mean, covariance)?;
        if !ok {
            return Err(Error::NotPositiveDefinite { what: "initial covariance", step: 0, t });
        }
        Ok(Self {
            running,
            model,
            timing,
            gates: gates(gate)?,
            level: Level::best(),
            t,
            last: None,
            steps: 0,
            history: None,
        })
    }

    /// Everything that changes as the filter runs; with [`Self::restore`] it goes on to the same bits.
    pub fn snapshot(&self) -> Snapshot {
        let (mean, matrix) = self.running.parts();
        Snapshot { t: self.t, mean, matrix, last: self.last, steps: self.steps }
    }

    /// Goes on from a snapshot of a stream of the same filter.
    pub fn restore(&mut self, from: &Snapshot) {
        match &mut self.running {
            Running::Ekf(_, b) | Running::Ukf(_, b) => *b = Gaussian { mean: from.mean, cov: from.matrix },
            Running::SrUkf(_, b) => *b = SqrtGaussian { mean: from.mean, factor: from.matrix },
        }
        (self.t, self.last, self.steps) = (from.t, from.last, from.steps);
    }

    /// Remembers steps from now on, so that [`Self::smoothed`] can go back by `lag` seconds.
    ///
    /// # Errors
    /// A lag that is not positive.
    pub fn keep(&mut self, lag: f64) -> Result<()> {
        if !(lag > 0.0 && lag.is_finite()) {
            return Err(Error::Parameter { field: "lag", value: lag, need: "must be positive and finite, in s" });
        }
        self.history = Some(History::new(lag));
        Ok(())
    }

    /// The steps that are remembered, oldest first.
    pub fn history(&self) -> impl Iterator<Item = &PastStep> {
        self.history.iter().flat_map(|h| h.steps.iter())
    }

    /// Replaces the steps that are remembered by those of a stream that is gone on from.
    pub fn recall(&mut self, steps: impl IntoIterator<Item = PastStep>) {
        if let Some(history) = &mut self.history {
            history.steps = steps.into_iter().collect();
        }
    }

    /// The states since the latest one that is at least the lag old, each knowing all measurements up to
    /// now; oldest first, the present last.
    ///
    /// # Errors
    /// No lag was asked for; a covariance that is not positive definite.
    pub fn smoothed(&self) -> Result<Vec<SmoothedState>> {
        let need = "nothing is remembered; start with a lag";
        let history = self.history.as_ref().ok_or(Error::Parameter { field: "lag", value: 0.0, need })?;
        let (now, model, steps) = (self.t, &self.model, &history.steps);
        let out = match &self.running {
            Running::Ekf(filter, belief) => {
                self.level.run(Back { filter, model, now, belief, steps, recall: gaussian })
            }
            Running::Ukf(filter, belief) => {
                self.level.run(Back { filter, model, now, belief, steps, recall: gaussian })
            }
            Running::SrUkf(filter, belief) => {
                self.level.run(Back { filter, model, now, belief, steps, recall: square_root })
            }
        };
        out.ok_or(Error::NotPositiveDefinite { what: "smoothed covariance", step: self.steps, t: now })
    }

    /// Time of the state, s.
    pub fn time(&self) -> f64 {
        self.t
    }

    /// State and covariance of its error.
    pub fn state(&self) -> (Attitude<f64>, Matrix<f64, 6, 6>) {
        match &self.running {
            Running::Ekf(_, b) | Running::Ukf(_, b) => (b.mean, b.cov),
            Running::SrUkf(_, b) => (b.mean, self.level.run(Square(b))),
        }
    }

    /// Moves to time `t` with the gyro sample `rate` taken then (body frame, rad/s).
    ///
    /// # Errors
    /// A time before the state's, a result that is not positive definite; the state is as it was.
    pub fn predict(&mut self, t: f64, rate: &[f64; 3]) -> Result<()> {
        self.in_order("predict", t)?;
        if let Some(value) = rate.iter().find(|w| !w.is_finite()) {
            let need = "must be finite; leave out a gyro sample that is missing";
            return Err(Error::Parameter { field: "rate", value: *value, need });
        }
        let input = match &self.last {
            Some((before, old)) => self.timing.between(old, rate, t - before),
            // the first sample is all there is to know of the time before it
            None => GyroInput { rate: *rate, extra: 0.0 },
        };
        self.advance(t, &input)?;
        self.forget();
        self.last = Some((t, *rate));
        Ok(())
    }

    /// Corrects by a star fix at time `t`: `q_ib` and the covariance of its error in the body frame.
    ///
    /// # Errors
    /// See [`Self::predict`]; also a fix after the state's time before there was any gyro sample.
    pub fn update_star(&mut self, t: f64, q: &[f64; 4], noise: &[f64; 6]) -> Result<Report> {
        self.update(t, Fix::Star(q, noise))
    }

    /// Corrects by a direction at time `t`: a unit vector in the body frame.
    ///
    /// # Errors
    /// See [`Self::update_star`].
    pub fn update_direction(&mut self, t: f64, body: &[f64; 3], reference: &Reference<f64>) -> Result<Report> {
        self.update(t, Fix::Direction(body, reference))
    }

    fn update(&mut self, t: f64, fix: Fix<'_>) -> Result<Report> {
        self.in_order("update", t)?;
        let before = (self.running, self.t, self.steps);
        if t > self.t {
            let (since, rate) = self.last.ok_or(Error::Parameter {
                field: "t",
                value: t,
                need: "lies after the state's time, and no gyro sample has told the rate yet; call predict first",
            })?;
            let input = self.timing.between(&rate, &rate, t - since);
            self.advance(t, &input)?;
        }
        let report = self.apply(&Step::Update(fix, &self.gates));
        match report {
            Some((running, report)) => {
                self.running = running;
                self.forget();
                Ok(report)
            }
            None => {
                if let Some(history) = self.history.as_mut().filter(|_| self.t > before.1) {
                    history.steps.pop_back();
                }
                (self.running, self.t, self.steps) = before;
                Err(Error::NotPositiveDefinite { what: "covariance in the update", step: self.steps, t })
            }
        }
    }

    fn forget(&mut self) {
        if let Some(history) = &mut self.history {
            history.trim(self.t);
        }
    }

    fn in_order(&self, field: &'static str, t: f64) -> Result<()> {
        if !t.is_finite() {
            return Err(Error::Parameter { field: "t", value: t, need: "must be finite" });
        }
        if t >= self.t { Ok(()) } else { Err(Error::OutOfOrder { field, t, now: self.t }) }
    }

    fn advance(&mut self, t: f64, input: &GyroInput<f64>) -> Result<()> {
        if t > self.t {
            let (running, _) = self
                .apply(&Step::Predict(input, self.t, t - self.t))
                .ok_or(Error::NotPositiveDefinite { what: "predicted covariance", step: self.steps, t })?;
            if let Some(history) = &mut self.history {
                let (mean, matrix) = self.running.parts();
                history.push(PastStep { t: self.t, to: t, input: *input, mean, matrix });
            }
            self.running = running;
            self.t = t;
            self.steps += 1;
        }
        Ok(())
    }

    fn apply(&self, step: &Step<'_>) -> Option<(Running, Report)> {
        match &self.running {
            Running::Ekf(f, b) => self.level.run(Job(f, &self.model, b, step)).map(|(b, r)| (Running::Ekf(*f, b), r)),
            Running::Ukf(f, b) => self.level.run(Job(f, &self.model, b, step)).map(|(b, r)| (Running::Ukf(*f, b), r)),
            Running::SrUkf(f, b) => {
                self.level.run(Job(f, &self.model, b, step)).map(|(b, r)| (Running::SrUkf(*f, b), r))
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Fix<'a> {
    Star(&'a [f64; 4], &'a [f64; 6]),
    Direction(&'a [f64; 3], &'a Reference<f64>),
}

enum Step<'a> {
    Predict(&'a GyroInput<f64>, f64, f64),
    Update(Fix<'a>, &'a [f64; MAX_DOF]),
}

const NOTHING: Report = Report {
    ok: true,
    accepted: true,
    dof: 0,
    nis: 0.0,
    innovation: [f64::NAN; MAX_DOF],
    covariance: [[f64::NAN; MAX_DOF]; MAX_DOF],
    rows: [0, 0],
};

#[inline(always)]
fn step<F: Filter, T: Real<Mask = bool>>(
    filter: &F,
    model: &GyroModel,
    belief: &mut F::Belief<AttitudeBias, T, 6>,
    step: &Step<'_>,
) -> Option<Report> {
    let report = match step {
        Step::Predict(input, t, dt) => {
            let u = GyroInputs::map(*input, T::splat);
            let ok = filter.predict(belief, model, &u, T::splat(*t), T::splat(*dt));
            Report { ok, ..NOTHING }
        }
        Step::Update(Fix::Star(q, noise), gates) => model.star::<F, T>(filter, belief, 0, (q, noise), gates),
        Step::Update(Fix::Direction(body, reference), gates) => {
            model.direction::<F, T>(filter, belief, body, reference, gates)
        }
    };
    report.ok.then_some(report)
}

/// One step of one filter, at any instruction set.
struct Job<'a, F: Filter>(&'a F, &'a GyroModel, &'a F::Belief<AttitudeBias, f64, 6>, &'a Step<'a>);

impl<F: Filter> Run for Job<'_, F> {
    type Output = Option<(F::Belief<AttitudeBias, f64, 6>, Report)>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> Self::Output {
        let mut belief = F::cast::<AttitudeBias, f64, T, 6>(self.2);
        let report = step(self.0, self.1, &mut belief, self.3)?;
        Some((F::cast::<AttitudeBias, T, f64, 6>(&belief), report))
    }
}

/// The covariance of a square-root belief, computed as a replay does.
struct Square<'a>(&'a SqrtGaussian<AttitudeBias, f64, 6>);

impl Run for Square<'_> {
    type Output = Matrix<f64, 6, 6>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> Self::Output {
        let covariance = SrUkf::cast::<AttitudeBias, f64, T, 6>(self.0).covariance();
        from_fn(|i, j| covariance[(i, j)].lane(0))
    }
}

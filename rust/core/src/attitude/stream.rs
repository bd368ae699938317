//! The same filters, one sample at a time.

use super::block::{Course, Feed, Listening, Parts, Samples, Times, check_one, in_order};
use super::columns::Columns;
use super::gyro::{GyroModel, GyroTiming};
use super::history::{Back, History, PastStep, SmoothedState};
use super::run::AnyFilter;
use super::sensors::Reference;
use super::state::{Attitude, AttitudeBias};
use super::system::{believe_direction, believe_star};
use super::trust::{Trust, Trusted};
use crate::belief::{Belief, Gaussian, SqrtGaussian};
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, SrUkf, Ukf};
use crate::linalg::{Matrix, from_fn};
use crate::replay::Report;
use crate::scalar::{Level, Real, Run};
use std::cell::Cell;

/// Sensors whose noise a stream can find apart.
pub const STREAM_SENSORS: usize = 16;

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
    fn parts(&self) -> Parts {
        match self {
            Self::Ekf(_, b) | Self::Ukf(_, b) => of_gaussian(b),
            Self::SrUkf(_, b) => of_square_root(b),
        }
    }
}

fn of_gaussian(b: &Gaussian<AttitudeBias, f64, 6>) -> Parts {
    (b.mean, b.cov)
}

fn of_square_root(b: &SqrtGaussian<AttitudeBias, f64, 6>) -> Parts {
    (b.mean, b.factor)
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
    trust: Trusted,
    /// What each sensor's noise is multiplied by.
    scale: [f64; STREAM_SENSORS],
    level: Level,
    course: Course,
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
    /// What each sensor's noise is multiplied by.
    pub scale: [f64; STREAM_SENSORS],
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
        trust: impl Into<Trust>,
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
            trust: Trusted::new(trust.into())?,
            scale: [1.0; STREAM_SENSORS],
            level: Level::best(),
            course: Course { t, last: None, steps: 0, history: None },
        })
    }

    /// Everything that changes as the filter runs; with [`Self::restore`] it goes on to the same bits.
    pub fn snapshot(&self) -> Snapshot {
        let (mean, matrix) = self.running.parts();
        Snapshot { t: self.course.t, mean, matrix, last: self.course.last, steps: self.course.steps, scale: self.scale }
    }

    /// Goes on from a snapshot of a stream of the same filter.
    pub fn restore(&mut self, from: &Snapshot) {
        match &mut self.running {
            Running::Ekf(_, b) | Running::Ukf(_, b) => *b = Gaussian { mean: from.mean, cov: from.matrix },
            Running::SrUkf(_, b) => *b = SqrtGaussian { mean: from.mean, factor: from.matrix },
        }
        (self.course.t, self.course.last, self.course.steps) = (from.t, from.last, from.steps);
        self.scale = from.scale;
    }

    /// Remembers steps from now on, so that [`Self::smoothed`] can go back by `lag` seconds.
    ///
    /// # Errors
    /// A lag that is not positive.
    pub fn keep(&mut self, lag: f64) -> Result<()> {
        if !(lag > 0.0 && lag.is_finite()) {
            return Err(Error::Parameter { field: "lag", value: lag, need: "must be positive and finite, in s" });
        }
        self.course.history = Some(History::new(lag));
        Ok(())
    }

    /// The steps that are remembered, oldest first.
    pub fn history(&self) -> impl Iterator<Item = &PastStep> {
        self.course.history.iter().flat_map(|h| h.steps.iter())
    }

    /// Replaces the steps that are remembered by those of a stream that is gone on from.
    pub fn recall(&mut self, steps: impl IntoIterator<Item = PastStep>) {
        if let Some(history) = &mut self.course.history {
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
        let history = self.course.history.as_ref().ok_or(Error::Parameter { field: "lag", value: 0.0, need })?;
        let (now, model, steps) = (self.course.t, &self.model, &history.steps);
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
        out.ok_or(Error::NotPositiveDefinite { what: "smoothed covariance", step: self.course.steps, t: now })
    }

    /// Time of the state, s.
    pub fn time(&self) -> f64 {
        self.course.t
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
        check_one(t, rate, self.course.t)?;
        self.one(t, rate)?;
        self.forget();
        Ok(())
    }

    /// Moves on with one gyro sample after the other, to the bits of [`Self::predict`] with each of them,
    /// and writes the state after every n-th one into `columns`, which have a row for each. `poll` is called
    /// with the number of samples every thousand of them and may end it.
    ///
    /// # Errors
    /// Bad samples, of which the row is told, a result that is not positive definite, and what `poll` returns.
    /// The state is then as it was before the first sample.
    pub fn process(
        &mut self,
        samples: &Samples<'_>,
        every: usize,
        columns: Columns<'_>,
        poll: &mut dyn FnMut(usize) -> Result<()>,
    ) -> Result<()> {
        samples.check(self.course.t)?;
        if every == 0 {
            return Err(Error::Parameter { field: "every", value: 0.0, need: "must be at least 1" });
        }
        let expected = samples.rate.len() / every;
        for found in [columns.t.len(), columns.q.len(), columns.rate.len(), columns.bias.len(), columns.sigma.len()] {
            if found != expected {
                return Err(Error::Length { field: "output column", expected, found });
            }
        }
        // the steps to remember are joined at the end: what a long block forgets meanwhile cannot be undone
        let fresh = self.course.history.as_ref().map(|h| History::new(h.lag));
        let mut ahead = Self { course: Course { history: fresh, ..self.course }, ..*self };
        ahead.feed(samples, Some(&mut Listening { every, columns, poll }))?;
        let before = self.course.history.take();
        *self = ahead;
        if let (Some(mut all), Some(new)) = (before, self.course.history.take()) {
            all.steps.extend(new.steps);
            all.trim(self.course.t);
            self.course.history = Some(all);
        }
        Ok(())
    }

    /// Corrects by a star fix of sensor number `sensor` at time `t`: `q_ib` and the covariance of its error in the body frame.
    /// Sensors count from 0 to [`STREAM_SENSORS`], directions among them.
    ///
    /// # Errors
    /// See [`Self::predict`]; also a fix after the state's time before there was any gyro sample.
    pub fn update_star(&mut self, t: f64, sensor: usize, q: &[f64; 4], noise: &[f64; 6]) -> Result<Report> {
        self.update(t, sensor, Fix::Star(q, noise))
    }

    /// Corrects by a direction at time `t`: a unit vector in the body frame.
    ///
    /// # Errors
    /// See [`Self::update_star`].
    pub fn update_direction(
        &mut self,
        t: f64,
        sensor: usize,
        body: &[f64; 3],
        reference: &Reference<f64>,
    ) -> Result<Report> {
        self.update(t, sensor, Fix::Direction(body, reference))
    }

    /// What each sensor's noise is multiplied by.
    pub fn noise_scale(&self) -> &[f64; STREAM_SENSORS] {
        &self.scale
    }

    fn update(&mut self, t: f64, sensor: usize, fix: Fix<'_>) -> Result<Report> {
        if sensor >= STREAM_SENSORS {
            return Err(Error::Parameter { field: "sensor", value: sensor as f64, need: "must be below 16" });
        }
        in_order("update", t, self.course.t)?;
        let (running, time, steps) = (self.running, self.course.t, self.course.steps);
        if t > time {
            let last = self.course.last.ok_or(Error::Parameter {
                field: "t",
                value: t,
                need: "lies after the state's time, and no gyro sample has told the rate yet; call predict first",
            })?;
            // the latest rate is held, and remains the latest
            self.one(t, &last.1)?;
            self.course.last = Some(last);
        }
        if let Some(report) = self.apply(sensor, &fix) {
            self.forget();
            return Ok(report);
        }
        if let Some(history) = self.course.history.as_mut().filter(|_| t > time) {
            history.steps.pop_back();
        }
        (self.running, self.course.t, self.course.steps) = (running, time, steps);
        Err(Error::NotPositiveDefinite { what: "covariance in the update", step: steps, t })
    }

    fn forget(&mut self) {
        if let Some(history) = &mut self.course.history {
            history.trim(self.course.t);
        }
    }

    fn one(&mut self, t: f64, rate: &[f64; 3]) -> Result<()> {
        let times = Times::At(std::slice::from_ref(&t));
        self.feed(&Samples { times, rate: std::slice::from_ref(rate), turn: None }, None)
    }

    fn feed(&mut self, samples: &Samples<'_>, listening: Option<&mut Listening<'_, '_>>) -> Result<()> {
        let Self { running, model, timing, course, .. } = self;
        match running {
            Running::Ekf(filter, belief) => {
                self.level.run(Feed { filter, model, timing, belief, parts: of_gaussian, course, samples, listening })
            }
            Running::Ukf(filter, belief) => {
                self.level.run(Feed { filter, model, timing, belief, parts: of_gaussian, course, samples, listening })
            }
            Running::SrUkf(filter, belief) => {
                let parts = of_square_root;
                self.level.run(Feed { filter, model, timing, belief, parts, course, samples, listening })
            }
        }
    }

    fn apply(&mut self, sensor: usize, fix: &Fix<'_>) -> Option<Report> {
        let model = &self.model;
        let scale = Cell::from_mut(&mut self.scale[sensor]);
        let trust = (&self.trust, Some(scale));
        match &mut self.running {
            Running::Ekf(f, b) => self.level.run(Correct(f, model, b, fix, trust)),
            Running::Ukf(f, b) => self.level.run(Correct(f, model, b, fix, trust)),
            Running::SrUkf(f, b) => self.level.run(Correct(f, model, b, fix, trust)),
        }
    }
}

#[derive(Clone, Copy)]
enum Fix<'a> {
    Star(&'a [f64; 4], &'a [f64; 6]),
    Direction(&'a [f64; 3], &'a Reference<f64>),
}

/// One update of one filter, at any instruction set. Where it fails the belief is as it was.
struct Correct<'a, F: Filter>(
    &'a F,
    &'a GyroModel,
    &'a mut F::Belief<AttitudeBias, f64, 6>,
    &'a Fix<'a>,
    (&'a Trusted, Option<&'a Cell<f64>>),
);

impl<F: Filter> Run for Correct<'_, F> {
    type Output = Option<Report>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> Option<Report> {
        let Self(filter, model, given, fix, trust) = self;
        let mut belief = F::cast::<AttitudeBias, f64, T, 6>(given);
        let report = match fix {
            Fix::Star(q, noise) => believe_star::<GyroModel, F, T, 6>(model, filter, &mut belief, (0, q, noise), trust),
            Fix::Direction(body, reference) => {
                believe_direction::<GyroModel, F, T, 6>(model, filter, &mut belief, (body, reference), trust)
            }
        };
        *given = F::cast::<AttitudeBias, T, f64, 6>(&belief);
        report.ok.then_some(report)
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

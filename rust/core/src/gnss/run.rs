//! Whole logs in one call: an orbit from fixes of a receiver, an attitude from star fixes with or without a gyro.

use super::fixes::{AttitudeFix, FixGiven, FixGivens, OrbitSpace, Oriented, PositionFix, Seeing, VelocityFix};
use super::history::{History, Pass};
use crate::attitude::{
    Attitude, AttitudeBias, GyroInput, GyroInputs, GyroModel, Pointing, PointingModel, PointingSpace, Symmetric3,
    UnitQuaternion, Vector3,
};
use crate::augmented::{Augmented, Fading, Joined, JoinedSpace};
use crate::consistency::chi2_quantile;
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter, Ukf};
use crate::linalg::{Matrix, from_fn};
use crate::manifold::{Family, Manifold};
use crate::model::Dynamics;
use crate::orbit::{Nothing, OrbitModel};
use crate::replay::{Drive, Output, Recorder, Replay, Report, Sensors, Start, smooth as back};
use crate::scalar::{Baseline, Level, Real, Run, Runner};

/// Times at which a run stops, and what drives it.
#[derive(Clone, Copy, Debug)]
pub struct Stops<'a> {
    /// Times, s, increasing; the last one ends the run.
    pub t: &'a [f64],
    /// Which of them are written.
    pub wanted: &'a [bool],
    /// Mean rate of a gyro from each to the next, rad/s, and the density of a further angle noise, rad²/s.
    pub gyro: &'a [[f64; 4]],
}

impl<D: Dynamics<N, Input = Nothing>, const N: usize> Drive<D, N> for Still<'_> {
    fn times(&self) -> &[f64] {
        self.0.t
    }
    #[inline(always)]
    fn input<T: Real>(&self, _: usize) -> <Nothing as Family>::Of<T> {}
}

/// Stops without inputs between them.
struct Still<'a>(Stops<'a>);

/// Stops with a gyro's rates between them.
struct Turning<'a>(Stops<'a>);

impl<D: Dynamics<N, Input = GyroInputs>, const N: usize> Drive<D, N> for Turning<'_> {
    fn times(&self) -> &[f64] {
        self.0.t
    }
    #[inline(always)]
    fn input<T: Real>(&self, k: usize) -> GyroInput<T> {
        let [x, y, z, extra] = self.0.gyro[k.min(self.0.gyro.len() - 1)];
        GyroInput { rate: [T::splat(x), T::splat(y), T::splat(z)], extra: T::splat(extra) }
    }
}

/// Fixes of a receiver in order of time: positions and velocities, GCRS, with their covariances.
#[derive(Clone, Copy, Debug)]
pub struct OrbitFixes<'a> {
    /// Times, s, not decreasing.
    pub t: &'a [f64],
    /// Whether a row is a velocity, m/s, and not a position, m.
    pub velocity: &'a [bool],
    /// What was measured.
    pub value: &'a [[f64; 3]],
    /// Covariances `(xx, xy, xz, yy, yz, zz)`.
    pub noise: &'a [[f64; 6]],
}

/// Attitude fixes in order of time.
#[derive(Clone, Copy, Debug)]
pub struct AttitudeFixes<'a> {
    /// Times, s, not decreasing.
    pub t: &'a [f64],
    /// Measured attitudes of the body, unit quaternions of either sign.
    pub q: &'a [[f64; 4]],
    /// Covariances in the body frame, rad²: `(xx, xy, xz, yy, yz, zz)`.
    pub noise: &'a [[f64; 6]],
    /// How much each vector of the tail adds to the error, row by row.
    pub weights: &'a [f64],
}

/// How to compute.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// A good fix passes the gate with this probability; 1: all do.
    pub gate: f64,
    /// Whether to go back over the log, too.
    pub back: bool,
    /// Instruction set.
    pub level: Level,
}

/// What a run ends with.
#[derive(Clone, Debug, Default)]
pub struct Ended {
    /// Time, s.
    pub t: f64,
    /// State, component by component.
    pub state: Vec<f64>,
    /// Covariance of the error state, row by row.
    pub covariance: Vec<f64>,
    /// Fixes before the start or after the end.
    pub outside: usize,
    /// Logarithm of the probability density of the fixes that were used.
    pub log_likelihood: f64,
}

/// Filters of orbits from fixes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OrbitFilter {
    /// Extended Kalman filter.
    Ekf(Ekf),
    /// Unscented Kalman filter.
    Ukf(Ukf),
}

/// Attitude and what moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AttitudeModel {
    /// A gyro; state: quaternion and bias.
    Gyro(GyroModel),
    /// None: rate and acceleration are estimated with the attitude.
    Kinematic(PointingModel),
}

struct Positions<'a> {
    fixes: OrbitFixes<'a>,
    gate: f64,
}

impl<const K: usize, const N: usize> Sensors<OrbitSpace<K, N>, N> for Positions<'_> {
    #[inline(always)]
    fn len(&self) -> usize {
        self.fixes.t.len()
    }
    #[inline(always)]
    fn time(&self, i: usize) -> f64 {
        self.fixes.t[i]
    }
    #[inline(always)]
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<OrbitSpace<K, N>, T, N>,
    ) -> Report {
        let given = Symmetric3::map(&self.fixes.noise[i], T::splat);
        let z = Vector3::map(&self.fixes.value[i], T::splat);
        let gate = T::splat(self.gate);
        if self.fixes.velocity[i] {
            return filter.update::<_, T, N, 3>(belief, &Seeing::<VelocityFix, K, N>::new(), &given, &z, gate).into();
        }
        filter.update::<_, T, N, 3>(belief, &Seeing::<PositionFix, K, N>::new(), &given, &z, gate).into()
    }
}

struct Attitudes<'a, const H: usize, const K: usize> {
    fixes: AttitudeFixes<'a>,
    gate: f64,
}

impl<S: Manifold<H> + Oriented, const H: usize, const K: usize, const N: usize> Sensors<JoinedSpace<S, H, K, N>, N>
    for Attitudes<'_, H, K>
{
    #[inline(always)]
    fn len(&self) -> usize {
        self.fixes.t.len()
    }
    #[inline(always)]
    fn time(&self, i: usize) -> f64 {
        self.fixes.t[i]
    }
    #[inline(always)]
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<JoinedSpace<S, H, K, N>, T, N>,
    ) -> Report {
        let mut weights = [0.0; K];
        weights.copy_from_slice(&self.fixes.weights[K * i..K * (i + 1)]);
        let given = FixGivens::<K>::map(&FixGiven { noise: self.fixes.noise[i], weights }, T::splat);
        let z = UnitQuaternion::map(&self.fixes.q[i], T::splat);
        let sensor = Seeing::<AttitudeFix<S, H>, K, N>::new();
        filter.update::<_, T, N, 3>(belief, &sensor, &given, &z, T::splat(self.gate)).into()
    }
}

/// What an orbit filter works on.
#[derive(Clone, Copy)]
pub struct OrbitJob<'a> {
    /// Filter.
    pub filter: OrbitFilter,
    /// Dynamics.
    pub dynamics: &'a OrbitModel,
    /// How the receiver's bias fades, if it is estimated.
    pub bias: Option<Fading>,
    /// Stops.
    pub stops: Stops<'a>,
    /// Fixes.
    pub fixes: OrbitFixes<'a>,
    /// How.
    pub options: Options,
}

/// What an attitude filter works on.
#[derive(Clone, Copy)]
pub struct AttitudeJob<'a> {
    /// Dynamics.
    pub model: AttitudeModel,
    /// How the vectors of the star sensor's slow error move.
    pub tail: &'a [Fading],
    /// Stops.
    pub stops: Stops<'a>,
    /// Fixes.
    pub fixes: AttitudeFixes<'a>,
    /// How.
    pub options: Options,
}

/// A start: time, state component by component, covariance of the error state row by row.
pub type Begin<'a> = (f64, &'a [f64], &'a [f64]);

type Poll<'a> = &'a mut dyn FnMut(usize) -> Result<()>;

/// Estimates an orbit, and the receiver's bias, from fixes.
///
/// # Errors
/// Columns of different lengths, a start of the wrong size, and those of [`Replay::run`].
pub fn orbit(job: OrbitJob<'_>, start: Begin<'_>, history: &mut History, poll: Poll<'_>) -> Result<Ended> {
    let OrbitFixes { t, velocity, value, noise } = job.fixes;
    lengths(t.len(), [("gnss.velocity", velocity.len()), ("gnss.value", value.len()), ("gnss.noise", noise.len())])?;
    checked(&job.stops)?;
    match job.bias {
        None => job.with::<0, 6>([], start, history, poll),
        Some(bias) => job.with::<1, 9>([bias], start, history, poll),
    }
}

impl OrbitJob<'_> {
    fn with<const K: usize, const N: usize>(
        self,
        tail: [Fading; K],
        start: Begin<'_>,
        history: &mut History,
        poll: Poll<'_>,
    ) -> Result<Ended> {
        let dynamics = Augmented::<_, 6, K, N>::new(self.dynamics.clone(), tail);
        let head = |x: &[f64]| from_slice::<6>(x);
        let start = begin::<OrbitSpace<K, N>, 6, K, N>(start, 6, head)?;
        let sensors = Positions { fixes: self.fixes, gate: limit(self.options.gate)? };
        let drive = Still(self.stops);
        let level = self.options.level;
        macro_rules! go {
            ($f:expr) => {
                go(
                    level,
                    Parts { filter: $f, dynamics: &dynamics, drive: &drive, sensors: &sensors },
                    &start,
                    &self.options,
                    self.stops,
                    history,
                    poll,
                )
            };
        }
        match self.filter {
            OrbitFilter::Ekf(f) => go!(&f),
            OrbitFilter::Ukf(f) => go!(&f),
        }
    }
}

/// Estimates an attitude, and the star sensor's slow error, from fixes.
///
/// # Errors
/// Columns of different lengths, a start of the wrong size, more vectors than there are filters for, and those of
/// [`Replay::run`].
pub fn attitude(job: AttitudeJob<'_>, start: Begin<'_>, history: &mut History, poll: Poll<'_>) -> Result<Ended> {
    let AttitudeFixes { t, q, noise, weights } = job.fixes;
    lengths(t.len(), [("star.q", q.len()), ("star.noise", noise.len())])?;
    checked(&job.stops)?;
    if matches!(job.model, AttitudeModel::Gyro(_)) {
        lengths(job.stops.t.len(), [("gyro.rate", job.stops.gyro.len())])?;
    }
    if job.tail.len() > TAILS[TAILS.len() - 1] {
        return Err(too_many(job.tail.len()));
    }
    let (tail, weights) = (padded(job.tail), widened(weights, job.tail.len(), t.len())?);
    let job = AttitudeJob { fixes: AttitudeFixes { weights: &weights, ..job.fixes }, ..job };
    let (head, error) = job.model.sizes();
    let (state, covariance) = padded_start((start.1, start.2), (head, error), job.tail.len())?;
    let whole = (start.0, &state[..], &covariance[..]);
    let mut ended = match (job.model, &tail[..]) {
        (AttitudeModel::Kinematic(m), []) => job.kinematic::<0, 9>(m, [], whole, history, poll),
        (AttitudeModel::Kinematic(m), &[a, b]) => job.kinematic::<2, 15>(m, [a, b], whole, history, poll),
        (AttitudeModel::Kinematic(m), &[a, b, c, d]) => job.kinematic::<4, 21>(m, [a, b, c, d], whole, history, poll),
        (AttitudeModel::Kinematic(m), &[a, b, c, d, e]) => {
            job.kinematic::<5, 24>(m, [a, b, c, d, e], whole, history, poll)
        }
        (AttitudeModel::Gyro(m), []) => job.gyro::<0, 6>(m, [], whole, history, poll),
        (AttitudeModel::Gyro(m), &[a, b]) => job.gyro::<2, 12>(m, [a, b], whole, history, poll),
        (AttitudeModel::Gyro(m), &[a, b, c, d]) => job.gyro::<4, 18>(m, [a, b, c, d], whole, history, poll),
        (AttitudeModel::Gyro(m), &[a, b, c, d, e]) => job.gyro::<5, 21>(m, [a, b, c, d, e], whole, history, poll),
        _ => Err(too_many(job.tail.len())),
    }?;
    let (vectors, all) = (job.tail.len(), tail.len());
    let narrow = |column: &mut Vec<f64>, head: usize| *column = leading(column, head + 3 * all, head + 3 * vectors);
    narrow(&mut history.state, head);
    narrow(&mut history.sigma, error);
    history.covariance = square(&history.covariance, error + 3 * all, error + 3 * vectors);
    narrow(&mut ended.state, head);
    ended.covariance = square(&ended.covariance, error + 3 * all, error + 3 * vectors);
    Ok(ended)
}

fn too_many(vectors: usize) -> Error {
    let need = "at most two harmonics and a Gauss-Markov error are estimated";
    Error::Parameter { field: "vectors of the slow error", value: vectors as f64, need }
}

/// Numbers of vectors that there are filters for: a tail in between is filled up with vectors that no fix sees. Each
/// is a filter to compile.
const TAILS: [usize; 4] = [0, 2, 4, 5];

/// A tail filled up.
fn padded(tail: &[Fading]) -> Vec<Fading> {
    let size = TAILS.into_iter().find(|k| *k >= tail.len()).unwrap_or(tail.len());
    let mut out = tail.to_vec();
    out.resize(size, Fading::default());
    out
}

/// Weights for a tail that is filled up: fixes do not see what fills it.
fn widened(weights: &[f64], vectors: usize, rows: usize) -> Result<Vec<f64>> {
    lengths(rows * vectors, [("star.weights", weights.len())])?;
    let all = padded(&vec![Fading::default(); vectors]).len();
    let mut out = vec![0.0; rows * all];
    for row in 0..rows {
        out[row * all..row * all + vectors].copy_from_slice(&weights[row * vectors..(row + 1) * vectors]);
    }
    Ok(out)
}

/// A start for a tail that is filled up, with zeros of unit variance.
fn padded_start(
    (state, covariance): (&[f64], &[f64]),
    (head, error): (usize, usize),
    vectors: usize,
) -> Result<(Vec<f64>, Vec<f64>)> {
    let (own, all) = (error + 3 * vectors, error + 3 * padded(&vec![Fading::default(); vectors]).len());
    lengths(head + 3 * vectors, [("start.state", state.len())])?;
    lengths(own * own, [("start.covariance", covariance.len())])?;
    let mut x = state.to_vec();
    x.resize(head + all - error, 0.0);
    let mut p = vec![0.0; all * all];
    for i in 0..all {
        if i < own {
            p[all * i..all * i + own].copy_from_slice(&covariance[own * i..own * (i + 1)]);
        } else {
            p[all * i + i] = 1.0;
        }
    }
    Ok((x, p))
}

/// The first `keep` of each `width` numbers.
fn leading(column: &[f64], width: usize, keep: usize) -> Vec<f64> {
    column.chunks_exact(width).flat_map(|row| &row[..keep]).copied().collect()
}

/// The first `keep` rows and columns of each matrix of `width` rows and columns.
fn square(column: &[f64], width: usize, keep: usize) -> Vec<f64> {
    let matrices = column.chunks_exact(width * width);
    matrices.flat_map(|m| m.chunks_exact(width).take(keep).flat_map(|row| &row[..keep])).copied().collect()
}

impl AttitudeModel {
    /// Sizes of the head's state and of its error.
    fn sizes(&self) -> (usize, usize) {
        match self {
            Self::Gyro(_) => (7, 6),
            Self::Kinematic(_) => (10, 9),
        }
    }
}

impl AttitudeJob<'_> {
    fn kinematic<const K: usize, const N: usize>(
        self,
        model: PointingModel,
        tail: [Fading; K],
        start: Begin<'_>,
        history: &mut History,
        poll: Poll<'_>,
    ) -> Result<Ended> {
        let dynamics = Augmented::<_, 9, K, N>::new(model, tail);
        let head = |x: &[f64]| Pointing {
            q: from_slice(&x[..4]),
            rate: from_slice(&x[4..7]),
            acceleration: from_slice(&x[7..10]),
        };
        let start = begin::<JoinedSpace<PointingSpace, 9, K, N>, 10, K, N>(start, 10, head)?;
        self.go::<_, _, PointingSpace, 9, K, N>(&dynamics, &Still(self.stops), &start, history, poll)
    }

    fn gyro<const K: usize, const N: usize>(
        self,
        model: GyroModel,
        tail: [Fading; K],
        start: Begin<'_>,
        history: &mut History,
        poll: Poll<'_>,
    ) -> Result<Ended> {
        let dynamics = Augmented::<_, 6, K, N>::new(model, tail);
        let head = |x: &[f64]| Attitude { q: from_slice(&x[..4]), bias: from_slice(&x[4..7]) };
        let start = begin::<JoinedSpace<AttitudeBias, 6, K, N>, 7, K, N>(start, 7, head)?;
        self.go::<_, _, AttitudeBias, 6, K, N>(&dynamics, &Turning(self.stops), &start, history, poll)
    }

    fn go<D, I, S, const H: usize, const K: usize, const N: usize>(
        self,
        dynamics: &D,
        drive: &I,
        start: &Start<D::Space, N>,
        history: &mut History,
        poll: Poll<'_>,
    ) -> Result<Ended>
    where
        S: Manifold<H> + Oriented,
        D: Dynamics<N, Space = JoinedSpace<S, H, K, N>>,
        I: Drive<D, N>,
    {
        let sensors = Attitudes::<H, K> { fixes: self.fixes, gate: limit(self.options.gate)? };
        let parts = Parts { filter: &Ekf::default(), dynamics, drive, sensors: &sensors };
        // for one instruction set alone: each is one more copy of every filter to compile
        go(Baseline, parts, start, &self.options, self.stops, history, poll)
    }
}

fn lengths<const C: usize>(expected: usize, columns: [(&'static str, usize); C]) -> Result<()> {
    for (field, found) in columns {
        if found != expected {
            return Err(Error::Length { field, expected, found });
        }
    }
    Ok(())
}

fn checked(stops: &Stops<'_>) -> Result<()> {
    lengths(stops.t.len(), [("stops.wanted", stops.wanted.len())])
}

/// Largest normalised innovation squared of three degrees of freedom.
fn limit(probability: f64) -> Result<f64> {
    if probability == 1.0 { Ok(f64::INFINITY) } else { chi2_quantile(probability, 3.0) }
}

fn from_slice<const C: usize>(x: &[f64]) -> [f64; C] {
    std::array::from_fn(|i| x[i])
}

/// A start from plain numbers, the first `size` of which are the head's.
fn begin<S, const C: usize, const K: usize, const N: usize>(
    (t, state, covariance): Begin<'_>,
    size: usize,
    head: impl Fn(&[f64]) -> HeadOf<S>,
) -> Result<Start<S, N>>
where
    S: Assembled<K> + Family,
{
    lengths(size + 3 * K, [("start.state", state.len())])?;
    lengths(N * N, [("start.covariance", covariance.len())])?;
    let tail = std::array::from_fn(|k| from_slice(&state[size + 3 * k..]));
    let mean = S::assemble(head(state), tail);
    let covariance: Matrix<f64, N, N> = from_fn(|i, j| covariance[N * i + j]);
    Ok(Start { t, mean, covariance, used: None })
}

/// The head of a joined space over plain numbers.
type HeadOf<S> = <S as Head>::Head;

trait Head {
    type Head;
}

/// Joined spaces, by their parts.
trait Assembled<const K: usize>: Head + Family {
    fn assemble(head: Self::Head, tail: [[f64; 3]; K]) -> Self::Of<f64>;
}

impl<S: Family, const H: usize, const K: usize, const N: usize> Head for JoinedSpace<S, H, K, N> {
    type Head = S::Of<f64>;
}

impl<S: Family, const H: usize, const K: usize, const N: usize> Assembled<K> for JoinedSpace<S, H, K, N> {
    fn assemble(head: S::Of<f64>, tail: [[f64; 3]; K]) -> Joined<S::Of<f64>, f64, K> {
        Joined { head, tail }
    }
}

/// What a pass consists of.
pub(super) struct Parts<'a, F, D, I, Q> {
    pub(super) filter: &'a F,
    pub(super) dynamics: &'a D,
    pub(super) drive: &'a I,
    pub(super) sensors: &'a Q,
}

/// One pass, and the way back if it is wanted.
pub(super) fn go<F: Filter, D: Dynamics<N>, I: Drive<D, N>, Q: Sensors<D::Space, N>, const N: usize>(
    runner: impl Runner,
    parts: Parts<'_, F, D, I, Q>,
    start: &Start<D::Space, N>,
    options: &Options,
    stops: Stops<'_>,
    history: &mut History,
    poll: Poll<'_>,
) -> Result<Ended> {
    let Parts { filter, dynamics, drive, sensors } = parts;
    let replay = Replay { filter, dynamics, drive, sensors, output: Output::Every(1) };
    let recorder = options.back.then(|| Recorder::new(stops.t.len() + sensors.len(), stops.t.len()));
    let pass = Pass { history, wanted: stops.wanted, recorder };
    runner.run(Job { replay, start, pass, poll })
}

struct Job<'a, 'c, F, D: Dynamics<N>, I, Q, const N: usize> {
    replay: Replay<'c, F, D, I, Q>,
    start: &'c Start<D::Space, N>,
    pass: Pass<'a, D::Space, N>,
    poll: Poll<'c>,
}

impl<F: Filter, D: Dynamics<N>, I: Drive<D, N>, Q: Sensors<D::Space, N>, const N: usize> Run
    for Job<'_, '_, F, D, I, Q, N>
{
    type Output = Result<Ended>;
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(mut self) -> Result<Ended> {
        let end = self.replay.run::<T, _, N>(self.start, &mut self.pass, self.poll)?;
        if let Some(recorder) = self.pass.recorder.take() {
            let (stops, poll) = (self.replay.drive.times().len(), self.poll);
            let parts = (self.replay.filter, self.replay.dynamics, self.replay.drive);
            back::<F, D, I, _, T, N>(parts, recorder, &end, &mut self.pass, &mut |k| poll(2 * stops - k))?;
            self.pass.turn_round();
        }
        let mut state = Vec::new();
        D::Space::map(&end.mean, |x: f64| {
            state.push(x);
            x
        });
        let covariance = (0..N * N).map(|i| end.covariance[(i / N, i % N)]).collect();
        Ok(Ended { t: end.t, state, covariance, outside: end.outside, log_likelihood: end.log_likelihood })
    }
}

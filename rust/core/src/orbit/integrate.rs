//! Orbits over a span of time: fixed-step RK4, adaptive DOP853, state transition by the variational
//! equations.

use super::EARTH_RADIUS;
use super::dop853::Dop853;
use super::environment::Moment;
use super::force::{ForceModel, Gradient};
use super::gravity::J2;
use super::radiation::sunlight;
use crate::error::{Error, Result};
use crate::scalar::{Level, Real, Run};

/// Right-hand side of `y' = f(t, y)`; what depends on the time alone is computed apart and shared.
pub(super) trait Rhs<const N: usize> {
    /// What the right-hand side needs of a time.
    type At<T: Real>: Copy;
    /// Computes it.
    fn at<T: Real>(&self, t: T) -> Self::At<T>;
    /// `f(t, y)`
    fn slope<T: Real>(&self, at: &Self::At<T>, y: &[T; N]) -> [T; N];
    /// Whether the light can change.
    #[inline(always)]
    fn casts_shadow(&self) -> bool {
        false
    }
    /// How much of the Sun is seen, of the first lane.
    #[inline(always)]
    fn phase<T: Real>(&self, _: &Self::At<T>, _: &[T; N]) -> Phase {
        Phase::Light
    }
}

/// How much of the Sun is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// All.
    Light,
    /// Some.
    Penumbra,
    /// None.
    Umbra,
}

impl ForceModel {
    #[inline(always)]
    fn light_phase<T: Real>(&self, at: &Moment<T>, r: &[T]) -> Phase {
        if !self.has_pressure() {
            return Phase::Light;
        }
        let (light, _) = sunlight(&at.sun.map(|x| x.lane(0)), &[r[0].lane(0), r[1].lane(0), r[2].lane(0)]);
        if light >= 1.0 {
            Phase::Light
        } else if light > 0.0 {
            Phase::Penumbra
        } else {
            Phase::Umbra
        }
    }
}

/// Position and velocity under closed-form gravity.
impl Rhs<6> for J2 {
    type At<T: Real> = ();
    #[inline(always)]
    fn at<T: Real>(&self, _: T) {}
    #[inline(always)]
    fn slope<T: Real>(&self, (): &(), y: &[T; 6]) -> [T; 6] {
        let a = self.acceleration(&[y[0], y[1], y[2]]);
        [y[3], y[4], y[5], a[0], a[1], a[2]]
    }
}

/// Position and velocity.
impl Rhs<6> for ForceModel {
    type At<T: Real> = Moment<T>;
    #[inline(always)]
    fn at<T: Real>(&self, t: T) -> Moment<T> {
        self.moment(t)
    }
    #[inline(always)]
    fn slope<T: Real>(&self, at: &Moment<T>, y: &[T; 6]) -> [T; 6] {
        let a = self.acceleration(at, &[y[0], y[1], y[2]], &[y[3], y[4], y[5]]);
        [y[3], y[4], y[5], a[0], a[1], a[2]]
    }
    #[inline(always)]
    fn casts_shadow(&self) -> bool {
        self.has_pressure()
    }
    #[inline(always)]
    fn phase<T: Real>(&self, at: &Moment<T>, y: &[T; 6]) -> Phase {
        self.light_phase(at, y)
    }
}

/// Position and velocity, then the state transition matrix by rows.
pub(super) struct Variational<'a>(pub(super) &'a ForceModel);

impl Rhs<42> for Variational<'_> {
    type At<T: Real> = Moment<T>;
    #[inline(always)]
    fn at<T: Real>(&self, t: T) -> Moment<T> {
        self.0.moment(t)
    }
    #[inline(always)]
    fn slope<T: Real>(&self, at: &Moment<T>, y: &[T; 42]) -> [T; 42] {
        let g = self.0.gradient(at, &[y[0], y[1], y[2]], &[y[3], y[4], y[5]]);
        variation(&g, y)
    }
    #[inline(always)]
    fn casts_shadow(&self) -> bool {
        self.0.has_pressure()
    }
    #[inline(always)]
    fn phase<T: Real>(&self, at: &Moment<T>, y: &[T; 42]) -> Phase {
        self.0.light_phase(at, y)
    }
}

/// Derivative of position, velocity and transition under an acceleration and its gradient.
#[inline(always)]
fn variation<T: Real>(g: &Gradient<T>, y: &[T; 42]) -> [T; 42] {
    let mut out = [T::zero(); 42];
    out[..3].copy_from_slice(&y[3..6]);
    out[3..6].copy_from_slice(&g.acceleration);
    for j in 0..6 {
        for i in 0..3 {
            out[6 + 6 * i + j] = y[24 + 6 * i + j];
            let mut s = T::zero();
            for k in 0..3 {
                s = g.by_position[(i, k)].mul_add(y[6 + 6 * k + j], s);
            }
            if let Some(d) = &g.by_velocity {
                for k in 0..3 {
                    s = d[(i, k)].mul_add(y[24 + 6 * k + j], s);
                }
            }
            out[24 + 6 * i + j] = s;
        }
    }
    out
}

/// The state with an identity for the state transition matrix.
#[inline(always)]
pub(super) fn with_identity<T: Real>(y: &[T; 6]) -> [T; 42] {
    let mut out = [T::zero(); 42];
    out[..6].copy_from_slice(y);
    for i in 0..6 {
        out[6 + 7 * i] = T::one();
    }
    out
}

/// `a + b h`
#[inline(always)]
fn advanced<T: Real, const N: usize>(a: &[T; N], b: &[T; N], h: T) -> [T; N] {
    let mut out = *a;
    for i in 0..N {
        out[i] = b[i].mul_add(h, a[i]);
    }
    out
}

/// `steps` classical Runge-Kutta steps of `h`.
#[inline(always)]
pub(super) fn rk4<T: Real, R: Rhs<N>, const N: usize>(rhs: &R, t: T, y: &[T; N], h: T, steps: usize) -> [T; N] {
    let mut y = *y;
    let mut now = rhs.at(t);
    for k in 0..steps {
        let begin = h.mul_add(T::splat(k as f64), t);
        let middle = rhs.at(h.mul_add(T::splat(0.5), begin));
        let end = rhs.at(begin + h);
        let mut sum = [T::zero(); N];
        let mut stage = y;
        // one copy of the right-hand side in the machine code, not four
        for (at, weight, reach) in
            [(&now, 1.0 / 6.0, 0.5), (&middle, 1.0 / 3.0, 0.5), (&middle, 1.0 / 3.0, 1.0), (&end, 1.0 / 6.0, 0.0)]
        {
            let slope = rhs.slope(at, &stage);
            sum = advanced(&sum, &slope, T::splat(weight));
            stage = advanced(&y, &slope, h * reach);
        }
        y = advanced(&y, &sum, h);
        now = end;
    }
    y
}

/// How to integrate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Classical Runge-Kutta: equal steps of at most `step` seconds between output times.
    Rk4 {
        /// Longest step, s.
        step: f64,
    },
    /// Dormand and Prince's method of order 8 with dense output; steps by the error estimate.
    Dop853 {
        /// Error of a step relative to |r| and |v|.
        rtol: f64,
        /// Longest step, s.
        step: f64,
    },
}

/// States at the asked times, and how many evaluations they took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Position and velocity, m and m/s.
    pub state: Vec<[f64; 6]>,
    /// State transition matrices from the first time, by rows; empty if not asked for.
    pub stm: Vec<[[f64; 6]; 6]>,
    /// Evaluations of the right-hand side.
    pub evaluations: usize,
}

/// Integrates from the state at `t[0]` through all of `t`, forwards or backwards.
///
/// # Errors
/// `Parameter` for a step or tolerance that cannot be used, a time outside the tables or an orbit that
/// enters the Earth; `Empty`, `NotIncreasing`; `Interrupted` by `poll`.
pub fn propagate(
    force: &ForceModel,
    start: &[f64; 6],
    t: &[f64],
    method: Method,
    stm: bool,
    poll: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<Trajectory> {
    check(force, start, t, method)?;
    let level = Level::best();
    if stm {
        let rhs = Variational(force);
        let (rows, evaluations) = level.run(Job { rhs: &rhs, start: with_identity(start), t, method, poll })?;
        let state = rows.iter().map(|y| std::array::from_fn(|i| y[i])).collect();
        let stm = rows.iter().map(|y| std::array::from_fn(|i| std::array::from_fn(|j| y[6 + 6 * i + j]))).collect();
        return Ok(Trajectory { state, stm, evaluations });
    }
    let (state, evaluations) = match force.closed() {
        Some(j2) => level.run(Job { rhs: &j2, start: *start, t, method, poll })?,
        None => level.run(Job { rhs: force, start: *start, t, method, poll })?,
    };
    Ok(Trajectory { state, stm: vec![], evaluations })
}

fn check(force: &ForceModel, start: &[f64; 6], t: &[f64], method: Method) -> Result<()> {
    let (Some(first), Some(last)) = (t.first().copied(), t.last().copied()) else {
        return Err(Error::Empty { field: "t" });
    };
    let sign = if last < first { -1.0 } else { 1.0 };
    for (row, pair) in t.windows(2).enumerate() {
        let ahead = (pair[1] - pair[0]) * sign;
        if ahead.is_nan() || ahead <= 0.0 {
            return Err(Error::NotIncreasing { field: "t", row: row + 1, previous: pair[0], value: pair[1] });
        }
    }
    if let Some(bad) = start.iter().chain([&first, &last]).copied().find(|x| !x.is_finite()) {
        return Err(Error::Parameter { field: "start", value: bad, need: "state and times must be finite" });
    }
    let radius = start[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
    if radius < EARTH_RADIUS * 0.99 {
        return Err(Error::Parameter {
            field: "|r|",
            value: radius,
            need: "starts inside the Earth; positions are in m",
        });
    }
    if force.needs_environment()
        && let Some(environment) = force.environment()
    {
        for value in [first, last] {
            if !environment.covers(value) {
                return Err(Error::Parameter { field: "t", value, need: "lies outside the environment's tables" });
            }
        }
    }
    let (step, rtol) = match method {
        Method::Rk4 { step } => (step, 1e-12),
        Method::Dop853 { rtol, step } => (step, rtol),
    };
    if step.is_nan() || step <= 0.0 {
        return Err(Error::Parameter { field: "step", value: step, need: "must be greater than 0" });
    }
    if !(1e-15..=1e-3).contains(&rtol) {
        return Err(Error::Parameter { field: "rtol", value: rtol, need: "must be from 1e-15 to 1e-3" });
    }
    Ok(())
}

/// Finite, and above the ground.
#[inline(always)]
pub(super) fn above_ground<T: Real, const N: usize>(t: f64, y: &[T; N]) -> Result<()> {
    let r: [f64; 3] = std::array::from_fn(|i| y[i].lane(0));
    let radius = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sqrt();
    if radius > EARTH_RADIUS * 0.99 && radius.is_finite() {
        return Ok(());
    }
    Err(Error::Impact { t, radius })
}

struct Job<'a, R, const N: usize> {
    rhs: &'a R,
    start: [f64; N],
    t: &'a [f64],
    method: Method,
    poll: &'a mut dyn FnMut(f64) -> Result<()>,
}

impl<R: Rhs<N>, const N: usize> Run for Job<'_, R, N> {
    type Output = Result<(Vec<[f64; N]>, usize)>;

    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> Self::Output {
        let start = self.start.map(T::splat);
        let mut rows = Vec::with_capacity(self.t.len());
        rows.push(self.start);
        match self.method {
            Method::Rk4 { step } => {
                let (mut y, mut evaluations) = (start, 0);
                for pair in self.t.windows(2) {
                    let span = pair[1] - pair[0];
                    let steps = (span.abs() / step).ceil().max(1.0) as usize;
                    let h = span / steps as f64;
                    // looked at often enough not to pass through the Earth unseen
                    let chunk = (300.0 / h.abs()).max(1.0) as usize;
                    for first in (0..steps).step_by(chunk) {
                        let t = pair[0] + first as f64 * h;
                        y = rk4(self.rhs, T::splat(t), &y, T::splat(h), chunk.min(steps - first));
                        above_ground(t, &y)?;
                    }
                    (self.poll)(pair[1])?;
                    rows.push(y.map(|x| x.lane(0)));
                    evaluations += 4 * steps;
                }
                Ok((rows, evaluations))
            }
            Method::Dop853 { rtol, step } => {
                let mut solver = Dop853::new(self.rhs, self.t, start, rtol, step);
                while rows.len() < self.t.len() {
                    solver.step(self.rhs)?;
                    above_ground(solver.time(), solver.state())?;
                    (self.poll)(solver.time())?;
                    solver.outputs(self.rhs, self.t, &mut rows);
                }
                Ok((rows, solver.evaluations))
            }
        }
    }
}

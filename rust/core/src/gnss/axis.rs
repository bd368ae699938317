//! One coordinate with its rate and acceleration: the classical filter of a single axis.

use super::history::History;
use super::run::{Ended, Options, Stops};
use crate::error::{Error, Result};
use crate::filter::{Ekf, Filter};
use crate::linalg::{Matrix, Vector, from_fn, zeros};
use crate::manifold::Euclidean;
use crate::model::{Dynamics, Measurement};
use crate::orbit::Nothing;
use crate::replay::{Drive, Report, Sensors};
use crate::scalar::Real;

/// A coordinate whose acceleration walks at random: its third derivative is white noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisModel {
    /// Power spectral density of the third derivative.
    pub jerk_psd: f64,
}

impl Dynamics<3> for AxisModel {
    type Space = Euclidean<3>;
    type Input = Nothing;

    #[inline(always)]
    fn step<T: Real>(&self, x: &[T; 3], (): &(), _: T, dt: T) -> [T; 3] {
        [x[0] + x[1] * dt + x[2] * (dt * dt * 0.5), x[1] + x[2] * dt, x[2]]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, _: &[T; 3], (): &(), _: T, dt: T) -> Matrix<T, 3, 3> {
        let q =
            [self.jerk_psd / 20.0, self.jerk_psd / 8.0, self.jerk_psd / 6.0, self.jerk_psd / 3.0, self.jerk_psd / 2.0];
        let (two, three) = (dt * dt, dt * dt * dt);
        let entries = [
            [two * three * q[0], two * two * q[1], three * q[2]],
            [two * two * q[1], three * q[3], two * q[4]],
            [three * q[2], two * q[4], dt * self.jerk_psd],
        ];
        from_fn(|i, j| entries[i][j])
    }
    #[inline(always)]
    fn transition<T: Real>(&self, _: &[T; 3], (): &(), _: T, dt: T) -> Matrix<T, 3, 3> {
        let mut f = crate::linalg::identity();
        f[(0, 1)] = dt;
        f[(1, 2)] = dt;
        f[(0, 2)] = dt * dt * 0.5;
        f
    }
}

/// A measured coordinate, an angle or not, or its rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Whether differences are taken by the shorter way round the circle, rad.
    pub wraps: bool,
    /// Whether it is the rate.
    pub rate: bool,
}

impl Measurement<3, 1> for Axis {
    type Space = Euclidean<3>;
    /// Variance.
    type Given = Euclidean<1>;
    type Value = Euclidean<1>;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &[T; 3], _: &[T; 1]) -> [T; 1] {
        [x[usize::from(self.rate)]]
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 1], zhat: &[T; 1]) -> Vector<T, 1> {
        let d = z[0] - zhat[0];
        let whole = |x: f64| x - (x / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        [if self.wraps { d.map(whole) } else { d }]
    }
    #[inline(always)]
    fn noise<T: Real>(&self, r: &[T; 1]) -> Matrix<T, 1, 1> {
        from_fn(|_, _| r[0])
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, _: &[T; 3], _: &[T; 1]) -> Matrix<T, 1, 3> {
        let mut h = zeros();
        h[(0, usize::from(self.rate))] = T::one();
        h
    }
}

/// What is measured of a coordinate, in order of time.
#[derive(Clone, Copy, Debug)]
pub struct AxisFixes<'a> {
    /// Times, s, not decreasing.
    pub t: &'a [f64],
    /// Whether a row is the rate.
    pub rate: &'a [bool],
    /// What was measured.
    pub value: &'a [f64],
    /// Variances.
    pub variance: &'a [f64],
    /// Whether the coordinate is an angle.
    pub wraps: bool,
}

struct Seen<'a>(AxisFixes<'a>);

impl Sensors<Euclidean<3>, 3> for Seen<'_> {
    #[inline(always)]
    fn len(&self) -> usize {
        self.0.t.len()
    }
    #[inline(always)]
    fn time(&self, i: usize) -> f64 {
        self.0.t[i]
    }
    #[inline(always)]
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<Euclidean<3>, T, 3>,
    ) -> Report {
        let sensor = Axis { wraps: self.0.wraps, rate: self.0.rate[i] };
        let (given, z) = ([T::splat(self.0.variance[i])], [T::splat(self.0.value[i])]);
        filter.update::<_, T, 3, 1>(belief, &sensor, &given, &z, T::splat(f64::INFINITY)).into()
    }
}

struct Still<'a>(&'a [f64]);

impl Drive<AxisModel, 3> for Still<'_> {
    fn times(&self) -> &[f64] {
        self.0
    }
    #[inline(always)]
    fn input<T: Real>(&self, _: usize) {}
}

/// Estimates a coordinate, its rate and its acceleration; the gate of the options is not used.
///
/// # Errors
/// `Length` for columns of different lengths, and those of [`crate::replay::Replay::run`].
pub fn axis(
    jerk_psd: f64,
    (t, state, covariance): (f64, [f64; 3], Matrix<f64, 3, 3>),
    stops: Stops<'_>,
    fixes: AxisFixes<'_>,
    options: &Options,
    history: &mut History,
) -> Result<Ended> {
    let expected = fixes.t.len();
    for (field, found) in
        [("axis.rate", fixes.rate.len()), ("axis.value", fixes.value.len()), ("axis.variance", fixes.variance.len())]
    {
        if found != expected {
            return Err(Error::Length { field, expected, found });
        }
    }
    let start = crate::replay::Start { t, mean: state, covariance, used: None };
    let parts = super::run::Parts {
        filter: &Ekf::default(),
        dynamics: &AxisModel { jerk_psd },
        drive: &Still(stops.t),
        sensors: &Seen(fixes),
    };
    super::run::go(crate::scalar::Baseline, parts, &start, options, stops, history, &mut |_| Ok(()))
}

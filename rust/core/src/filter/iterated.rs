//! Iterated extended Kalman filter.

use super::{Ekf, Filter, Linearised};
use crate::belief::{Belief, Gaussian, Joint, Outcome, Tangent};
use crate::linalg::{Matrix, Vector, apply, identity, mul, mul_t, solve_near_identity};
use crate::manifold::Manifold;
use crate::model::{Dynamics, Given, Input, Measurement, State, Value};
use crate::packed::gain;
use crate::replay::{Drive, Epoch, Past, Report, Sensors, Window};
use crate::scalar::Real;

/// Extended Kalman filter that re-linearises the last interval: the belief after the previous
/// measurements, the step since, and all measurements of the epoch are linearised about their joint
/// estimate again and again until it stays (Gauss-Newton on the two ends of the interval).
///
/// Between measurements it is the [`Ekf`]; a replay does the iterations, since they need the inputs
/// since the previous measurements.
///
/// Sources: Jazwinski, *Stochastic Processes and Filtering Theory*, 1970, §8.3 (iterated linear
/// filter-smoother); Bell, Cathey, *The iterated Kalman filter update as a Gauss-Newton method*, 1993.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iterated {
    /// Largest number of iterations per epoch.
    pub iterations: usize,
    /// The estimate stays when it moves by less than so many standard deviations.
    pub tolerance: f64,
}

impl Default for Iterated {
    fn default() -> Self {
        Self { iterations: 50, tolerance: 1e-3 }
    }
}

impl Filter for Iterated {
    moves_as_ekf!();

    #[inline(always)]
    fn update<H: Measurement<N, M>, T: Real, const N: usize, const M: usize>(
        &self,
        belief: &mut Gaussian<H::Space, T, N>,
        sensor: &H,
        given: &Given<H, T, N, M>,
        z: &Value<H, T, N, M>,
        gate: T,
    ) -> Outcome<T, M> {
        Ekf::default().update(belief, sensor, given, z, gate)
    }

    /// First as the extended filter does, then by iterations over the interval since the epoch before. The
    /// report is that of the first step.
    #[inline(always)]
    fn correct<D: Dynamics<N>, I: Drive<D, N>, Q: Sensors<D::Space, N>, T: Real<Mask = bool>, const N: usize>(
        &self,
        log: &Past<'_, D, I, Q>,
        window: &mut Window<Gaussian<D::Space, T, N>>,
        belief: &mut Gaussian<D::Space, T, N>,
        (t, k, i): (f64, usize, usize),
    ) -> Report {
        if t > window.latest.t {
            window.anchor = window.latest;
            window.used.clear();
        }
        let report = log.sensors.update(i, self, belief);
        if report.ok && report.accepted {
            window.used.push(i);
            if let Some(better) = self.iterate(log, window, &belief.mean, t) {
                *belief = better;
            }
            // an epoch whose measurements are all rejected is none: the interval goes on
            window.latest = Epoch { belief: *belief, t, k };
        }
        report
    }
}

/// The end of the interval, linearised about a trajectory from its beginning.
struct Linear<S: Manifold<N>, T: Real, const N: usize> {
    /// Mean and covariance about the beginning's point.
    offset: Vector<T, N>,
    cov: Matrix<T, N, N>,
    /// The end by the dynamics alone.
    end: Tangent<S, T, N>,
    /// Derivative of the end to the beginning.
    transition: Matrix<T, N, N>,
}

impl Iterated {
    /// Gauss-Newton on the two ends of the interval, from a first guess of its end. None where it
    /// does not come to rest: the guess then stands.
    #[inline(always)]
    fn iterate<D: Dynamics<N>, I: Drive<D, N>, Q: Sensors<D::Space, N>, T: Real<Mask = bool>, const N: usize>(
        &self,
        log: &Past<'_, D, I, Q>,
        window: &Window<Gaussian<D::Space, T, N>>,
        guess: &State<D, T, N>,
        t: f64,
    ) -> Option<Gaussian<D::Space, T, N>> {
        let mut begin = window.anchor.belief.mean;
        let mut end = *guess;
        for iteration in 0..self.iterations {
            let linear = linearise::<D, I, Q, T, N>(log, &window.anchor, &begin, t)?;
            let to_end = D::Space::local(&linear.end.point, &end);
            let reset = D::Space::reset(&linear.end.point, &to_end);
            let mut from_end = linear.end.offset;
            for i in 0..N {
                from_end[i] -= to_end[i];
            }
            let mut about = Tangent::<D::Space, T, N> {
                point: end,
                offset: apply(&reset, &from_end),
                cov: D::Space::transport(&linear.end.point, &to_end, &linear.end.cov),
            };
            for i in &window.used {
                if !log.sensors.update::<Linearised, T>(*i, &Linearised, &mut about).ok {
                    return None;
                }
            }
            // back to the beginning, by how far the end lies from what the beginning predicts
            let column = Matrix::<T, N, 1>::from_fn(|i, _| about.offset[i]);
            let moved = solve_near_identity(&reset, &column);
            let mut surprise = to_end;
            for i in 0..N {
                surprise[i] += moved[(i, 0)] - linear.end.offset[i];
            }
            let (smoother, _, ok) = gain(&mul_t(&linear.cov, &linear.transition), &linear.end.cov, &surprise);
            if !ok {
                return None;
            }
            let mut back = smoother.apply(&surprise);
            for i in 0..N {
                back[i] += linear.offset[i];
            }
            begin = D::Space::normalise(&D::Space::retract(&begin, &back));
            // the first iteration is the extended filter again: only the second one tells
            if iteration > 0 && small(&about.offset, &about.cov, self.tolerance) {
                let mean = D::Space::normalise(&D::Space::retract(&end, &about.offset));
                let cov = D::Space::transport(&end, &about.offset, &about.cov);
                let found = Gaussian { mean, cov };
                return found.healthy().then_some(found);
            }
            end = D::Space::normalise(&D::Space::retract(&end, &about.offset));
        }
        None
    }
}

/// The interval from the anchor to time `t`, about the trajectory that begins at `begin`.
#[inline(always)]
fn linearise<D: Dynamics<N>, I: Drive<D, N>, Q, T: Real<Mask = bool>, const N: usize>(
    log: &Past<'_, D, I, Q>,
    anchor: &Epoch<Gaussian<D::Space, T, N>>,
    begin: &State<D, T, N>,
    t: f64,
) -> Option<Linear<D::Space, T, N>> {
    let known = &anchor.belief.mean;
    let away = D::Space::local(known, begin);
    let cov = D::Space::transport(known, &away, &anchor.belief.cov);
    let offset = apply(&D::Space::reset(known, &away), &away).map(|x| -x);
    let mut end = Tangent::<D::Space, T, N> { point: *begin, offset, cov };
    let mut transition = identity();
    let (times, mut now, mut k) = (log.drive.times(), anchor.t, anchor.k);
    while now < t {
        let to = times.get(k + 1).map_or(t, |next| next.min(t));
        if to > now {
            let u = log.drive.input::<T>(k);
            let (at, dt) = (T::splat(now), T::splat(to - now));
            transition = mul(&log.dynamics.transition(&end.point, &u, at, dt), &transition);
            if !Linearised.predict(&mut end, log.dynamics, &u, at, dt) {
                return None;
            }
        }
        now = to;
        k += 1;
    }
    Some(Linear { offset, cov, end, transition })
}

/// Whether a step is short beside the standard deviations.
#[inline(always)]
fn small<T: Real<Mask = bool>, const N: usize>(step: &Vector<T, N>, cov: &Matrix<T, N, N>, tolerance: f64) -> bool {
    (0..N).all(|i| (cov[(i, i)] * (tolerance * tolerance)).gt(step[i] * step[i]))
}

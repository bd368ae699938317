//! What the attitude filters have in common whatever their state is made of.

use super::gyro::GyroModel;
use super::sensors::{Direction, Reference, References, StarQuaternion, Symmetric3};
use super::series::{AttitudeSensor, AttitudeSensors};
use super::state::{Attitude, UnitQuaternion, Vector3};
use super::trust::{Trusted, largest};
use crate::belief::Belief;
use crate::filter::Filter;
use crate::linalg::{Matrix, Vector, diagonal};
use crate::manifold::Family;
use crate::model::{Dynamics, State};
use crate::replay::{MAX_DOF, Report, Sensors};
use crate::scalar::Real;
use std::cell::Cell;

/// A state driven by a gyro that holds an attitude and a gyro bias, and what the sensors make of it. Its start
/// and its results are those of [`super::AttitudeBias`]: an error in the body frame, and a bias.
pub trait System<const N: usize>: Dynamics<N> {
    /// The state for an attitude and a bias, and its covariance from theirs.
    fn start(&self, x: &Attitude<f64>, p: &Matrix<f64, 6, 6>) -> (State<Self, f64, N>, Matrix<f64, N, N>);
    /// The attitude and bias of a state.
    fn attitude<T: Real>(&self, x: &State<Self, T, N>) -> Attitude<T>;
    /// Covariance of the attitude error in the body frame and of the bias.
    fn covariance<T: Real>(&self, x: &State<Self, T, N>, p: &Matrix<T, N, N>) -> Matrix<T, 6, 6>;
    /// Its diagonal.
    #[inline(always)]
    fn variance<T: Real, B: Belief<Self::Space, T, N>>(&self, belief: &B) -> Vector<T, 6> {
        diagonal(&self.covariance(belief.mean(), &belief.covariance()))
    }
    /// Corrects a belief by a fix of star camera number `sensor`.
    fn star<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<Self::Space, T, N>,
        sensor: usize,
        fix: (&[f64; 4], &[f64; 6]),
        gates: &[f64; MAX_DOF],
    ) -> Report;
    /// Corrects a belief by a direction.
    fn direction<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<Self::Space, T, N>,
        body: &[f64; 3],
        reference: &Reference<f64>,
        gates: &[f64; MAX_DOF],
    ) -> Report;
}

impl System<6> for GyroModel {
    fn start(&self, x: &Attitude<f64>, p: &Matrix<f64, 6, 6>) -> (Attitude<f64>, Matrix<f64, 6, 6>) {
        (*x, *p)
    }
    #[inline(always)]
    fn attitude<T: Real>(&self, x: &Attitude<T>) -> Attitude<T> {
        *x
    }
    #[inline(always)]
    fn covariance<T: Real>(&self, _: &Attitude<T>, p: &Matrix<T, 6, 6>) -> Matrix<T, 6, 6> {
        *p
    }
    #[inline(always)]
    fn variance<T: Real, B: Belief<Self::Space, T, 6>>(&self, belief: &B) -> Vector<T, 6> {
        belief.variance()
    }
    #[inline(always)]
    fn star<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<Self::Space, T, 6>,
        _: usize,
        (q, noise): (&[f64; 4], &[f64; 6]),
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (Symmetric3::map(noise, T::splat), UnitQuaternion::map(q, T::splat));
        filter.update::<_, T, 6, 3>(belief, &StarQuaternion, &given, &z, T::splat(gates[2])).into()
    }
    #[inline(always)]
    fn direction<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<Self::Space, T, 6>,
        body: &[f64; 3],
        reference: &Reference<f64>,
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (References::map(reference, T::splat), Vector3::map(body, T::splat));
        filter.update::<_, T, 6, 2>(belief, &Direction, &given, &z, T::splat(gates[1])).into()
    }
}

/// A log's measurements as one system sees them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen<'a, Y> {
    pub(super) sensors: &'a AttitudeSensors<'a>,
    pub(super) system: &'a Y,
    /// What each sensor's noise is multiplied by; none where it stays.
    pub(super) scale: &'a [Cell<f64>],
}

/// Corrects a belief by a star fix as far as it is trusted.
#[inline(always)]
pub(super) fn believe_star<Y: System<N>, F: Filter, T: Real<Mask = bool>, const N: usize>(
    system: &Y,
    filter: &F,
    belief: &mut F::Belief<Y::Space, T, N>,
    (sensor, q, noise): (usize, &[f64; 4], &[f64; 6]),
    (trust, scale): (&Trusted, Option<&Cell<f64>>),
) -> Report {
    trust.correct(
        noise,
        scale,
        #[inline(always)]
        |noise, gates| system.star::<F, T>(filter, belief, sensor, (q, noise), gates),
    )
}

/// Corrects a belief by a direction as far as it is trusted.
#[inline(always)]
pub(super) fn believe_direction<Y: System<N>, F: Filter, T: Real<Mask = bool>, const N: usize>(
    system: &Y,
    filter: &F,
    belief: &mut F::Belief<Y::Space, T, N>,
    (body, reference): (&[f64; 3], &Reference<f64>),
    (trust, scale): (&Trusted, Option<&Cell<f64>>),
) -> Report {
    let variance = reference.sigma * reference.sigma;
    trust.correct(
        &[variance, 0.0, 0.0, variance, 0.0, 0.0],
        scale,
        #[inline(always)]
        |noise, gates| {
            // its own to the last bit, unless it counts otherwise
            let own = noise[0] == variance && noise[3] == variance && noise[1] == 0.0;
            let sigma = if own { reference.sigma } else { largest(noise).sqrt() };
            system.direction::<F, T>(filter, belief, body, &Reference { sigma, ..*reference }, gates)
        },
    )
}

impl<Y: System<N>, const N: usize> Sensors<Y::Space, N> for Seen<'_, Y> {
    #[inline(always)]
    fn len(&self) -> usize {
        self.sensors.len()
    }
    #[inline(always)]
    fn time(&self, i: usize) -> f64 {
        self.sensors.time(i)
    }
    #[inline(always)]
    fn update<F: Filter, T: Real<Mask = bool>>(
        &self,
        i: usize,
        filter: &F,
        belief: &mut F::Belief<Y::Space, T, N>,
    ) -> Report {
        let (sensor, row) = self.sensors.source(i);
        let trust = (self.sensors.trust(), self.scale.get(sensor));
        match &self.sensors.sensors()[sensor] {
            AttitudeSensor::Star(s) => {
                let (q, noise) = s.fix(row);
                believe_star::<Y, F, T, N>(self.system, filter, belief, (sensor, &q, &noise), trust)
            }
            AttitudeSensor::Direction(s) => {
                let (body, reference) = s.sight(row);
                believe_direction::<Y, F, T, N>(self.system, filter, belief, (&body, &reference), trust)
            }
        }
    }
}

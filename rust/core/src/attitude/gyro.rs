//! Attitude kinematics driven by a rate gyro.

use super::state::{Attitude, AttitudeBias};
use crate::error::{Error, Result};
use crate::linalg::{
    Matrix, Vector, add, block, congruence, dot, from_fn, identity, mul, set_block, symmetric, transpose, zeros,
};
use crate::manifold::Family;
use crate::model::Dynamics;
use crate::quaternion::{InSkew, Integrator, angle_coefficients, conjugate, exp, integrate, to_matrix};
use crate::scalar::Real;

/// Rate gyro `ω_measured = ω + b + white noise`, `db/dt = white noise`, and the attitude it drives.
///
/// The transition and the process noise are exact for a rate that is constant over the step, cross
/// terms and rotation included (the small-angle form of Farrenkopf, 1978, is their limit for slow
/// rotation).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroModel {
    /// Angle random walk, rad/√s.
    pub arw: f64,
    /// Rate random walk, rad/s/√s.
    pub rrw: f64,
    /// Integrator of the attitude.
    pub integrator: Integrator,
}

/// Gyro reading over one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroInput<T> {
    /// Mean measured rate over the step, body frame, rad/s.
    pub rate: [T; 3],
    /// Power spectral density of an additional angle noise, rad²/s: what is not known of the rate in a gap.
    pub extra: T,
}

/// [`GyroInput`] over every scalar.
pub struct GyroInputs;

impl Family for GyroInputs {
    type Of<T: Real> = GyroInput<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &GyroInput<A>,
        b: &GyroInput<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> GyroInput<C> {
        GyroInput {
            rate: [f(a.rate[0], b.rate[0]), f(a.rate[1], b.rate[1]), f(a.rate[2], b.rate[2])],
            extra: f(a.extra, b.extra),
        }
    }
}

/// Blocks of the exact discretisation over one step of rotation vector `φ = ω dt`.
pub(super) struct Blocks<T: Real> {
    /// `exp(−[φ]×)`: attitude error to attitude error.
    rotation: Matrix<T, 3, 3>,
    /// `−dt J_r(φ)`: bias error to attitude error.
    pub(super) coupling: Matrix<T, 3, 3>,
    noise_attitude: Matrix<T, 3, 3>,
    noise_cross: Matrix<T, 3, 3>,
    noise_bias: T,
}

impl<T: Real> Blocks<T> {
    #[inline(always)]
    fn noise(&self) -> Matrix<T, 6, 6> {
        let mut q = zeros();
        set_block(&mut q, 0, 0, &self.noise_attitude);
        set_block(&mut q, 0, 3, &self.noise_cross);
        set_block(&mut q, 3, 0, &transpose(&self.noise_cross));
        for i in 3..6 {
            q[(i, i)] = self.noise_bias;
        }
        q
    }
}

impl GyroModel {
    /// # Errors
    /// `Parameter` where a density is negative or not finite.
    pub fn new(arw: f64, rrw: f64, integrator: Integrator) -> Result<Self> {
        for (field, value) in [("arw", arw), ("rrw", rrw)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::Parameter { field, value, need: "must be finite and not negative" });
            }
        }
        Ok(Self { arw, rrw, integrator })
    }

    #[inline(always)]
    pub(super) fn blocks<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, dt: T) -> Blocks<T> {
        let phi = rotation_vector(x, u, dt);
        let skew = InSkew::new(&phi);
        let [c1, c2, c3, c4] = angle_coefficients(skew.theta2());
        let (arw2, rrw2) = (self.arw * self.arw, self.rrw * self.rrw);
        let (w2, w3) = (dt * dt * rrw2, dt * dt * dt * rrw2);
        Blocks {
            rotation: to_matrix(&conjugate(&exp(&phi))),
            coupling: skew.matrix(-dt, dt * c1, -(dt * c2)),
            noise_attitude: skew.even(w3.mul_add(T::splat(1.0 / 3.0), dt * (u.extra + T::splat(arw2))), w3 * c4),
            noise_cross: skew.matrix(w2 * -0.5, w2 * c2, -(w2 * c3)),
            noise_bias: dt * rrw2,
        }
    }
}

#[inline(always)]
fn rotation_vector<T: Real>(x: &Attitude<T>, u: &GyroInput<T>, dt: T) -> Vector<T, 3> {
    corrected_rate(x, u).map(
        #[inline(always)]
        |w| w * dt,
    )
}

/// Measured rate less the bias.
#[inline(always)]
fn corrected_rate<T: Real>(x: &Attitude<T>, u: &GyroInput<T>) -> Vector<T, 3> {
    [u.rate[0] - x.bias[0], u.rate[1] - x.bias[1], u.rate[2] - x.bias[2]]
}

impl Dynamics<6> for GyroModel {
    type Space = AttitudeBias;
    type Input = GyroInputs;

    #[inline(always)]
    fn step<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, _t: T, dt: T) -> Attitude<T> {
        Attitude { q: integrate(&x.q, &corrected_rate(x, u), dt, self.integrator), bias: x.bias }
    }

    #[inline(always)]
    fn transition<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, _t: T, dt: T) -> Matrix<T, 6, 6> {
        let b = self.blocks(x, u, dt);
        let mut f = identity();
        set_block(&mut f, 0, 0, &b.rotation);
        set_block(&mut f, 0, 3, &b.coupling);
        f
    }

    #[inline(always)]
    fn noise<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, _t: T, dt: T) -> Matrix<T, 6, 6> {
        self.blocks(x, u, dt).noise()
    }

    /// `F L` in 3×3 blocks; all three share the blocks of the step.
    #[inline(always)]
    fn carry<T: Real>(
        &self,
        x: &Attitude<T>,
        root: &Matrix<T, 6, 6>,
        u: &GyroInput<T>,
        t: T,
        dt: T,
    ) -> (Attitude<T>, Matrix<T, 6, 6>, Matrix<T, 6, 6>) {
        let b = self.blocks(x, u, dt);
        let turned: Matrix<T, 3, 6> = mul(&b.rotation, &block::<T, 6, 6, 3, 6>(root, 0, 0));
        let coupled: Matrix<T, 3, 6> = mul(&b.coupling, &block::<T, 6, 6, 3, 6>(root, 3, 0));
        let mut image = *root;
        set_block(&mut image, 0, 0, &add(&turned, &coupled));
        (self.step(x, u, t, dt), image, b.noise())
    }

    /// `F P Fᵀ + Q` in 3×3 blocks; the rotation of the step serves mean and covariance.
    #[inline(always)]
    fn propagate<T: Real>(
        &self,
        x: &Attitude<T>,
        p: &Matrix<T, 6, 6>,
        u: &GyroInput<T>,
        t: T,
        dt: T,
    ) -> (Attitude<T>, Matrix<T, 6, 6>) {
        let b = self.blocks(x, u, dt);
        let attitude = congruence(&b.rotation, &block(p, 0, 0));
        let bias: Matrix<T, 3, 3> = block(p, 3, 3);
        let rotated: Matrix<T, 3, 3> = mul(&b.rotation, &block::<T, 6, 6, 3, 3>(p, 0, 3));
        let coupled: Matrix<T, 3, 3> = mul(&b.coupling, &bias);
        // G C Gᵀ + R B Gᵀ + G Bᵀ Rᵀ, halved so that the sum is symmetric to the last bit
        let half: Matrix<T, 3, 3> = from_fn(|i, j| coupled[(i, j)].mul_add(T::splat(0.5), rotated[(i, j)]));
        let attitude = symmetric::<T, 3>(|i, j| {
            let added = dot::<T, 3>(|k| half[(i, k)], |k| b.coupling[(j, k)])
                + dot::<T, 3>(|k| half[(j, k)], |k| b.coupling[(i, k)]);
            attitude[(i, j)] + b.noise_attitude[(i, j)] + added
        });
        let cross: Matrix<T, 3, 3> = from_fn(|i, j| rotated[(i, j)] + coupled[(i, j)] + b.noise_cross[(i, j)]);
        let mut cov = *p;
        set_block(&mut cov, 0, 0, &attitude);
        set_block(&mut cov, 0, 3, &cross);
        set_block(&mut cov, 3, 0, &transpose(&cross));
        for i in 3..6 {
            cov[(i, i)] += b.noise_bias;
        }
        (self.step(x, u, t, dt), cov)
    }
}

/// What a gyro sample says of the rate between samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sampling {
    /// Sample `k` holds from `t_k` to `t_{k+1}`.
    #[default]
    Hold,
    /// Sample `k` is the mean rate over `(t_{k−1}, t_k]`, as of a rate-integrating gyro.
    Integrated,
    /// The rate between two samples is the mean of both.
    Average,
}

/// How gyro samples become the inputs of steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroTiming {
    /// What a sample says of the rate between samples.
    pub sampling: Sampling,
    /// Longest step, in s, over which a sample is believed; beyond it there is a gap.
    pub max_gap: f64,
    /// Standard deviation of the mean rate in a gap, rad/s, about the mean of the rates at its ends.
    pub gap_rate_sigma: f64,
}

impl GyroTiming {
    /// Input between two samples that are `dt` apart.
    #[inline(always)]
    pub fn between(&self, before: &[f64; 3], after: &[f64; 3], dt: f64) -> GyroInput<f64> {
        let mean = [0.5 * (before[0] + after[0]), 0.5 * (before[1] + after[1]), 0.5 * (before[2] + after[2])];
        if dt > self.max_gap {
            // as a density, so that fixes inside the gap may divide it: (σ dt)² at its end
            return GyroInput { rate: mean, extra: self.gap_rate_sigma * self.gap_rate_sigma * dt };
        }
        let rate = match self.sampling {
            Sampling::Hold => *before,
            Sampling::Integrated => *after,
            Sampling::Average => mean,
        };
        GyroInput { rate, extra: 0.0 }
    }
}

//! Attitude kinematics driven by a rate gyro.

use super::state::{Attitude, AttitudeBias, of_blocks};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, Vector, add, block, identity, mul, set_block, transpose, zeros};
use crate::manifold::Family;
use crate::model::Dynamics;
use crate::packed::Packed;
use crate::quaternion::{self, Integrator, Quaternion, Turn, conjugate, multiply, renormalise};
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

/// Blocks of the exact discretisation over one step of rotation vector `φ = ω dt`; each is made where it is asked for,
/// since all of them together do not fit into registers.
pub(super) struct Blocks<T: Real> {
    /// Rotation of the body, by the integrator.
    turn: Quaternion<T>,
    of: Turn<T>,
    dt: T,
    /// Density of the angle noise.
    angle: T,
    /// Density of the rate noise.
    rate: f64,
}

impl<T: Real> Blocks<T> {
    /// `exp(−[φ]×)`: attitude error to attitude error.
    #[inline(always)]
    fn rotation(&self) -> Matrix<T, 3, 3> {
        self.of.skew.matrix(T::one(), -self.of.sinc, self.of.coefficients[0])
    }
    /// `−dt J_r(φ)`: bias error to attitude error.
    #[inline(always)]
    pub(super) fn coupling(&self) -> Matrix<T, 3, 3> {
        let [c1, c2, _, _] = self.of.coefficients;
        self.of.skew.matrix(-self.dt, self.dt * c1, -(self.dt * c2))
    }
    #[inline(always)]
    fn noise_attitude(&self) -> Matrix<T, 3, 3> {
        let w3 = self.dt * self.dt * self.dt * self.rate;
        self.of.skew.even(w3.mul_add(T::splat(1.0 / 3.0), self.dt * self.angle), w3 * self.of.coefficients[3])
    }
    #[inline(always)]
    fn noise_cross(&self) -> Matrix<T, 3, 3> {
        let (w2, [_, c2, c3, _]) = (self.dt * self.dt * self.rate, self.of.coefficients);
        self.of.skew.matrix(w2 * -0.5, w2 * c2, -(w2 * c3))
    }
    #[inline(always)]
    fn noise_bias(&self) -> T {
        self.dt * self.rate
    }
    #[inline(always)]
    fn noise(&self) -> Matrix<T, 6, 6> {
        let cross = self.noise_cross();
        let mut q = zeros();
        set_block(&mut q, 0, 0, &self.noise_attitude());
        set_block(&mut q, 0, 3, &cross);
        set_block(&mut q, 3, 0, &transpose(&cross));
        for i in 3..6 {
            q[(i, i)] = self.noise_bias();
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
        let rotation = rotation_vector(x, u, dt);
        let turn = Turn::new(&rotation);
        Blocks {
            turn: match self.integrator {
                Integrator::Exponential => turn.q,
                other @ Integrator::Rk4 => quaternion::turn(&rotation, other),
            },
            of: turn,
            dt,
            angle: u.extra + T::splat(self.arw * self.arw),
            rate: self.rrw * self.rrw,
        }
    }
}

/// Angle that the body turns by in a step, as a vector.
#[inline(always)]
fn rotation_vector<T: Real>(x: &Attitude<T>, u: &GyroInput<T>, dt: T) -> Vector<T, 3> {
    [(u.rate[0] - x.bias[0]) * dt, (u.rate[1] - x.bias[1]) * dt, (u.rate[2] - x.bias[2]) * dt]
}

/// The state after a turn of the body.
#[inline(always)]
fn turned<T: Real>(x: &Attitude<T>, turn: &Quaternion<T>) -> Attitude<T> {
    Attitude { q: renormalise(&multiply(&x.q, turn)), bias: x.bias }
}

impl Dynamics<6> for GyroModel {
    type Space = AttitudeBias;
    type Input = GyroInputs;
    /// The bias.
    const STILL: usize = 3;

    #[inline(always)]
    fn step<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, _t: T, dt: T) -> Attitude<T> {
        turned(x, &quaternion::turn(&rotation_vector(x, u, dt), self.integrator))
    }

    /// `log(p* ⊗ exp(δθ) ⊗ p')`, with the turns `p` of the state and `p'` of the displaced one: the attitude itself
    /// drops out.
    #[inline(always)]
    fn displaced<T: Real>(
        &self,
        (x, image): (&Attitude<T>, &Attitude<T>),
        d: &Vector<T, 6>,
        u: &GyroInput<T>,
        _t: T,
        dt: T,
    ) -> Vector<T, 6> {
        let back = multiply(&conjugate(&image.q), &x.q);
        let rate = rotation_vector(x, u, dt);
        let rotation = [rate[0] - d[3] * dt, rate[1] - d[4] * dt, rate[2] - d[5] * dt];
        let turn = quaternion::turn(&rotation, self.integrator);
        let e = quaternion::log(&multiply(&multiply(&back, &quaternion::exp(&[d[0], d[1], d[2]])), &turn));
        [e[0], e[1], e[2], d[3], d[4], d[5]]
    }

    #[inline(always)]
    fn transition<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, _t: T, dt: T) -> Matrix<T, 6, 6> {
        let b = self.blocks(x, u, dt);
        let mut f = identity();
        set_block(&mut f, 0, 0, &b.rotation());
        set_block(&mut f, 0, 3, &b.coupling());
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
        _t: T,
        dt: T,
    ) -> (Attitude<T>, Matrix<T, 6, 6>, Matrix<T, 6, 6>) {
        let b = self.blocks(x, u, dt);
        let turned_rows: Matrix<T, 3, 6> = mul(&b.rotation(), &block::<T, 6, 6, 3, 6>(root, 0, 0));
        let coupled: Matrix<T, 3, 6> = mul(&b.coupling(), &block::<T, 6, 6, 3, 6>(root, 3, 0));
        let mut image = *root;
        set_block(&mut image, 0, 0, &add(&turned_rows, &coupled));
        (turned(x, &b.turn), image, b.noise())
    }

    /// `[[√S, X], [0, √r I]]` with `r` the noise of the bias, `X` that of both over `√r`, and `S` what is left of that of the
    /// attitude. All blocks are polynomials of one skew matrix and commute, so that `S = α I + γ [φ]×²` is
    /// known without a subtraction, and its symmetric root by two square roots.
    #[inline(always)]
    fn noise_factor<T: Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, _t: T, dt: T) -> Matrix<T, 6, 6> {
        let b = self.blocks(x, u, dt);
        let (theta2, [_, c2, c3, c4]) = (b.of.skew.theta2(), b.of.coefficients);
        let w3 = dt * dt * dt * b.rate;
        let alpha = w3.mul_add(T::splat(1.0 / 12.0), dt * b.angle);
        let gamma = w3 * (c2.mul_add(c2, c3 * c3 * theta2) + (c4 - c3));
        let across = alpha - gamma * theta2;
        let across = T::select(across.gt(T::zero()), across, T::zero()).sqrt();
        let along = alpha.sqrt();
        let some = along.gt(T::zero());
        let bend = T::select(some, gamma / (across + T::select(some, along, T::one())), T::zero());
        let bias = b.noise_bias().sqrt();
        let cross = bias * dt;
        let mut root = zeros();
        set_block(&mut root, 0, 0, &b.of.skew.even(along, bend));
        set_block(&mut root, 0, 3, &b.of.skew.matrix(cross * -0.5, cross * c2, -(cross * c3)));
        for i in 3..6 {
            root[(i, i)] = bias;
        }
        root
    }

    /// `F P Fᵀ + Q` in 3×3 blocks.
    #[inline(always)]
    fn propagate<T: Real>(
        &self,
        x: &Attitude<T>,
        p: &Matrix<T, 6, 6>,
        u: &GyroInput<T>,
        _t: T,
        dt: T,
    ) -> (Attitude<T>, Matrix<T, 6, 6>) {
        let b = self.blocks(x, u, dt);
        let (rotation, coupling) = (b.rotation(), b.coupling());
        let (r, c) = (Packed::new(&rotation), Packed::new(&coupling));
        // the upper half of F P: rows of the attitude, columns of attitude and bias
        let left = Packed::<T, 3, 3>::two_products::<3>(
            (
                &r,
                #[inline(always)]
                |k, j| p[(k, j)],
            ),
            (
                &c,
                #[inline(always)]
                |k, j| p[(k + 3, j)],
            ),
        );
        let right = Packed::<T, 3, 3>::two_products::<3>(
            (
                &r,
                #[inline(always)]
                |k, j| p[(k, j + 3)],
            ),
            (
                &c,
                #[inline(always)]
                |k, j| p[(k + 3, j + 3)],
            ),
        );
        let attitude = Packed::<T, 3, 3>::two_products::<3>(
            (
                &left,
                #[inline(always)]
                |k, j| rotation[(j, k)],
            ),
            (
                &right,
                #[inline(always)]
                |k, j| coupling[(j, k)],
            ),
        );
        let attitude = attitude.add(&Packed::new(&b.noise_attitude()));
        let cross = right.add(&Packed::new(&b.noise_cross()));
        let noise = b.noise_bias();
        let cov = of_blocks(
            &attitude,
            &cross,
            #[inline(always)]
            |i, j| {
                let old = p[(i + 3, j + 3)];
                if i == j { old + noise } else { old }
            },
        );
        (turned(x, &b.turn), cov)
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
        self.input(
            #[inline(always)]
            || *before,
            #[inline(always)]
            || *after,
            dt,
        )
    }

    /// [`Self::between`] of samples that are looked up only if they are needed.
    #[inline(always)]
    pub(super) fn input(&self, before: impl Fn() -> [f64; 3], after: impl Fn() -> [f64; 3], dt: f64) -> GyroInput<f64> {
        if dt > self.max_gap {
            // as a density, so that fixes inside the gap may divide it: (σ dt)² at its end
            let extra = self.gap_rate_sigma * self.gap_rate_sigma * dt;
            return GyroInput { rate: middle(&before(), &after()), extra };
        }
        let rate = match self.sampling {
            Sampling::Hold => before(),
            Sampling::Integrated => after(),
            Sampling::Average => middle(&before(), &after()),
        };
        GyroInput { rate, extra: 0.0 }
    }
}

#[inline(always)]
fn middle(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])]
}

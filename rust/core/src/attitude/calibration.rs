//! A state that also holds the gyro's scale factors and misalignments and the alignment of a second
//! camera.
//!
//! What a scale factor does is in proportion to the true rate. The measured one stands for it badly: its
//! noise is also in the attitude that it has driven, so that noise would pass for a scale factor
//! (errors in variables). The step therefore brings a second rate, from the smoothed attitude: given all
//! measurements its error is not correlated with the gyro noise that is left over.

use super::gyro::{GyroInput, GyroInputs, GyroModel};
use super::sensors::{Direction, Reference, References, StarQuaternion, Symmetric3};
use super::series::GyroSeries;
use super::state::{Attitude, UnitQuaternion, Vector3};
use super::system::System;
use crate::filter::Filter;
use crate::linalg::{Matrix, Vector, apply, block, identity, mul, set_block, transpose, zeros};
use crate::manifold::{Family, Manifold};
use crate::model::{Dynamics, Measurement};
use crate::quaternion::{
    Quaternion, difference, exp, integrate, multiply, norm_squared, renormalise, right_jacobian, to_matrix,
};
use crate::replay::{Drive, MAX_DOF, Report};
use crate::scalar::Real;

/// Number of error states.
pub const CALIBRATED: usize = 18;
/// Entries of the gyro matrix, in the order of the error state: scale factors, then misalignments.
const ENTRIES: [(usize, usize); 9] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)];

/// Attitude, gyro bias, and what was left over by the calibration on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibrated<T> {
    /// Attitude `q_ib` of the reference camera's body frame.
    pub q: Quaternion<T>,
    /// Gyro bias, rad/s.
    pub bias: [T; 3],
    /// Gyro errors `M` in `ω_measured = (I + M) ω + b`: scale factors `xx, yy, zz`, misalignments `xy, xz, yx,
    /// yz, zx, zy`.
    pub gyro: [T; 9],
    /// Rotation from the body frame as the other camera has it to the body frame: its fixes are
    /// `q ⊗ alignment`.
    pub alignment: Quaternion<T>,
}

impl Calibrated<f64> {
    /// A measured rate without the gyro errors; its bias stays, in other axes.
    pub fn corrected(&self, rate: &[f64; 3]) -> [f64; 3] {
        apply(&Calibration::correction(self), rate)
    }
}

/// The space of [`Calibrated`]. Error state: attitude (3), bias (3), gyro matrix (9, in the order of
/// [`Calibrated::gyro`]), alignment (3, a rotation vector on the right).
pub struct CalibratedSpace;

/// Nine numbers.
struct Nine;

impl Family for Nine {
    type Of<T: Real> = [T; 9];
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(a: &[A; 9], b: &[B; 9], mut f: impl FnMut(A, B) -> C) -> [C; 9] {
        std::array::from_fn(
            #[inline(always)]
            |i| f(a[i], b[i]),
        )
    }
}

impl Family for CalibratedSpace {
    type Of<T: Real> = Calibrated<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &Calibrated<A>,
        b: &Calibrated<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> Calibrated<C> {
        Calibrated {
            q: UnitQuaternion::zip(&a.q, &b.q, &mut f),
            bias: Vector3::zip(&a.bias, &b.bias, &mut f),
            gyro: Nine::zip(&a.gyro, &b.gyro, &mut f),
            alignment: UnitQuaternion::zip(&a.alignment, &b.alignment, &mut f),
        }
    }
}

impl Manifold<CALIBRATED> for CalibratedSpace {
    #[inline(always)]
    fn retract<T: Real>(x: &Calibrated<T>, d: &Vector<T, CALIBRATED>) -> Calibrated<T> {
        let mut gyro = x.gyro;
        for i in 0..9 {
            gyro[i] += d[6 + i];
        }
        Calibrated {
            q: multiply(&x.q, &exp(&[d[0], d[1], d[2]])),
            bias: [x.bias[0] + d[3], x.bias[1] + d[4], x.bias[2] + d[5]],
            gyro,
            alignment: multiply(&x.alignment, &exp(&[d[15], d[16], d[17]])),
        }
    }
    #[inline(always)]
    fn local<T: Real>(x: &Calibrated<T>, y: &Calibrated<T>) -> Vector<T, CALIBRATED> {
        let (turn, alignment) = (difference(&x.q, &y.q), difference(&x.alignment, &y.alignment));
        let mut d = [T::zero(); CALIBRATED];
        for i in 0..3 {
            d[i] = turn[i];
            d[3 + i] = y.bias[i] - x.bias[i];
            d[15 + i] = alignment[i];
        }
        for i in 0..9 {
            d[6 + i] = y.gyro[i] - x.gyro[i];
        }
        d
    }
    #[inline(always)]
    fn normalise<T: Real>(x: &Calibrated<T>) -> Calibrated<T> {
        Calibrated { q: renormalise(&x.q), alignment: renormalise(&x.alignment), ..*x }
    }
    #[inline(always)]
    fn valid<T: Real>(x: &Calibrated<T>) -> T::Mask {
        norm_squared(&x.q).gt(T::splat(0.5))
    }
    #[inline(always)]
    fn reset<T: Real>(_: &Calibrated<T>, d: &Vector<T, CALIBRATED>) -> Matrix<T, CALIBRATED, CALIBRATED> {
        let mut j = identity();
        set_block(&mut j, 0, 0, &right_jacobian(&[d[0], d[1], d[2]]));
        set_block(&mut j, 15, 15, &right_jacobian(&[d[15], d[16], d[17]]));
        j
    }
}

/// Gyro and cameras whose leftover errors are estimated. They do not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// The gyro's noise.
    pub model: GyroModel,
    /// Number of the sensor whose alignment is estimated; all others define the body frame.
    pub aligned: Option<usize>,
    /// 1-sigma of the scale factors, of the misalignments (rad) and of the alignment (rad) beforehand.
    pub prior: [f64; 3],
}

impl Calibration {
    /// 1-sigma of the twelve parameters beforehand.
    pub fn prior_sigma(&self) -> [f64; 12] {
        let [scale, misalignment, alignment] = self.prior;
        std::array::from_fn(|i| match i {
            0..3 => scale,
            3..9 => misalignment,
            _ => alignment,
        })
    }

    /// `(I + M)⁻¹`
    #[inline(always)]
    fn correction<T: Real>(x: &Calibrated<T>) -> Matrix<T, 3, 3> {
        let mut m = identity::<T, 3>();
        for (value, at) in x.gyro.iter().zip(ENTRIES) {
            m[at] += *value;
        }
        crate::linalg::solve_near_identity(&m, &identity::<T, 3>())
    }

    /// The corrected rate, and the correction.
    #[inline(always)]
    fn rate<T: Real>(x: &Calibrated<T>, u: &GyroInput<T>) -> (Vector<T, 3>, Matrix<T, 3, 3>) {
        let correction = Self::correction(x);
        let less = [u.rate[0] - x.bias[0], u.rate[1] - x.bias[1], u.rate[2] - x.bias[2]];
        (apply(&correction, &less), correction)
    }
}

/// Gyro reading over one step, and the rate that its errors are in proportion to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuidedInput<T> {
    /// The reading.
    pub gyro: GyroInput<T>,
    /// Rate from the smoothed attitude, body frame, rad/s.
    pub guide: [T; 3],
}

/// [`GuidedInput`] over every scalar.
pub struct GuidedInputs;

impl Family for GuidedInputs {
    type Of<T: Real> = GuidedInput<T>;
    #[inline(always)]
    fn zip<A: Real, B: Real, C: Real>(
        a: &GuidedInput<A>,
        b: &GuidedInput<B>,
        mut f: impl FnMut(A, B) -> C,
    ) -> GuidedInput<C> {
        GuidedInput { gyro: GyroInputs::zip(&a.gyro, &b.gyro, &mut f), guide: Vector3::zip(&a.guide, &b.guide, &mut f) }
    }
}

/// Gyro samples with the rates of a smoothed attitude.
#[derive(Clone, Copy, Debug)]
pub struct GuidedSeries<'a> {
    /// The samples.
    pub gyro: &'a GyroSeries<'a>,
    /// Rate between each sample and the next, rad/s.
    pub guide: &'a [[f64; 3]],
}

impl Drive<Calibration, CALIBRATED> for GuidedSeries<'_> {
    #[inline(always)]
    fn times(&self) -> &[f64] {
        self.gyro.t
    }
    #[inline(always)]
    fn input<T: Real>(&self, k: usize) -> GuidedInput<T> {
        GuidedInputs::map(&GuidedInput { gyro: self.gyro.between(k), guide: self.guide[k] }, T::splat)
    }
}

/// Rates between samples from attitudes at the samples, of which the first is that at the start, within
/// the interval after sample `first`; before it the measured ones.
pub(super) fn guide(gyro: &GyroSeries<'_>, first: usize, t: &[f64], q: &[[f64; 4]]) -> Vec<[f64; 3]> {
    let mut rates: Vec<[f64; 3]> = (0..gyro.t.len()).map(|k| gyro.between(k).rate).collect();
    for (j, pair) in q.windows(2).enumerate() {
        let dt = t[j + 1] - t[j];
        rates[first + j] = difference(&pair[0], &pair[1]).map(|v| v / dt);
    }
    if let [.., before, last] = rates.as_mut_slice() {
        *last = *before;
    }
    rates
}

/// The plain attitude filter's view of the corrected rate.
#[inline(always)]
fn plain<T: Real>(x: &Calibrated<T>, rate: &Vector<T, 3>, u: &GyroInput<T>) -> (Attitude<T>, GyroInput<T>) {
    (Attitude { q: x.q, bias: [T::zero(); 3] }, GyroInput { rate: *rate, extra: u.extra })
}

impl Dynamics<CALIBRATED> for Calibration {
    type Space = CalibratedSpace;
    type Input = GuidedInputs;

    #[inline(always)]
    fn step<T: Real>(&self, x: &Calibrated<T>, u: &GuidedInput<T>, _t: T, dt: T) -> Calibrated<T> {
        let (rate, _) = Self::rate(x, &u.gyro);
        Calibrated { q: integrate(&x.q, &rate, dt, self.model.integrator), ..*x }
    }

    #[inline(always)]
    fn transition<T: Real>(
        &self,
        x: &Calibrated<T>,
        u: &GuidedInput<T>,
        t: T,
        dt: T,
    ) -> Matrix<T, CALIBRATED, CALIBRATED> {
        let (rate, correction) = Self::rate(x, &u.gyro);
        let (attitude, input) = plain(x, &rate, &u.gyro);
        let six = self.model.transition(&attitude, &input, t, dt);
        let coupling: Matrix<T, 3, 3> = mul(&block::<T, 6, 6, 3, 3>(&six, 0, 3), &correction);
        let mut f = identity();
        set_block(&mut f, 0, 0, &block::<T, 6, 6, 3, 3>(&six, 0, 0));
        set_block(&mut f, 0, 3, &coupling);
        // an error of entry (r, c) acts as a bias of ω_c on axis r; by the guide, see above
        for (k, (r, c)) in ENTRIES.into_iter().enumerate() {
            for i in 0..3 {
                f[(i, 6 + k)] = coupling[(i, r)] * u.guide[c];
            }
        }
        f
    }

    #[inline(always)]
    fn noise<T: Real>(&self, x: &Calibrated<T>, u: &GuidedInput<T>, t: T, dt: T) -> Matrix<T, CALIBRATED, CALIBRATED> {
        let (rate, _) = Self::rate(x, &u.gyro);
        let (attitude, input) = plain(x, &rate, &u.gyro);
        let mut q = zeros();
        set_block(&mut q, 0, 0, &self.model.noise(&attitude, &input, t, dt));
        q
    }
}

/// A star camera that may be turned against the body frame by the alignment.
struct AlignedStar {
    turned: bool,
}

impl Measurement<CALIBRATED, 3> for AlignedStar {
    type Space = CalibratedSpace;
    type Given = Symmetric3;
    type Value = UnitQuaternion;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Calibrated<T>, _: &[T; 6]) -> Quaternion<T> {
        if self.turned { multiply(&x.q, &x.alignment) } else { x.q }
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &Quaternion<T>, zhat: &Quaternion<T>) -> Vector<T, 3> {
        StarQuaternion.residual(z, zhat)
    }
    #[inline(always)]
    fn noise<T: Real>(&self, r: &[T; 6]) -> Matrix<T, 3, 3> {
        StarQuaternion.noise(r)
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &Calibrated<T>, _: &[T; 6]) -> Matrix<T, 3, CALIBRATED> {
        let mut h = zeros();
        if self.turned {
            set_block(&mut h, 0, 0, &transpose(&to_matrix(&x.alignment)));
            set_block(&mut h, 0, 15, &identity::<T, 3>());
        } else {
            set_block(&mut h, 0, 0, &identity::<T, 3>());
        }
        h
    }
}

/// A direction sensor in the body frame.
struct PlainDirection;

impl Measurement<CALIBRATED, 2> for PlainDirection {
    type Space = CalibratedSpace;
    type Given = References;
    type Value = Vector3;

    #[inline(always)]
    fn predict<T: Real>(&self, x: &Calibrated<T>, given: &Reference<T>) -> [T; 3] {
        Direction.predict(&Attitude { q: x.q, bias: x.bias }, given)
    }
    #[inline(always)]
    fn residual<T: Real>(&self, z: &[T; 3], zhat: &[T; 3]) -> Vector<T, 2> {
        Direction.residual(z, zhat)
    }
    #[inline(always)]
    fn noise<T: Real>(&self, given: &Reference<T>) -> Matrix<T, 2, 2> {
        Direction.noise(given)
    }
    #[inline(always)]
    fn jacobian<T: Real>(&self, x: &Calibrated<T>, given: &Reference<T>) -> Matrix<T, 2, CALIBRATED> {
        let mut h = zeros();
        set_block(&mut h, 0, 0, &Direction.jacobian(&Attitude { q: x.q, bias: x.bias }, given));
        h
    }
}

impl System<CALIBRATED> for Calibration {
    fn start(
        &self,
        x: &Attitude<f64>,
        p: &Matrix<f64, 6, 6>,
    ) -> (Calibrated<f64>, Matrix<f64, CALIBRATED, CALIBRATED>) {
        let mut all = zeros();
        set_block(&mut all, 0, 0, p);
        for (i, sigma) in self.prior_sigma().into_iter().enumerate() {
            all[(6 + i, 6 + i)] = sigma * sigma;
        }
        let nominal = Calibrated { q: x.q, bias: x.bias, gyro: [0.0; 9], alignment: [1.0, 0.0, 0.0, 0.0] };
        (nominal, all)
    }
    #[inline(always)]
    fn attitude<T: Real>(&self, x: &Calibrated<T>) -> Attitude<T> {
        Attitude { q: x.q, bias: x.bias }
    }
    #[inline(always)]
    fn covariance<T: Real>(&self, _: &Calibrated<T>, p: &Matrix<T, CALIBRATED, CALIBRATED>) -> Matrix<T, 6, 6> {
        block(p, 0, 0)
    }
    #[inline(always)]
    fn star<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<CalibratedSpace, T, CALIBRATED>,
        sensor: usize,
        (q, noise): (&[f64; 4], &[f64; 6]),
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (Symmetric3::map(noise, T::splat), UnitQuaternion::map(q, T::splat));
        let star = AlignedStar { turned: self.aligned == Some(sensor) };
        filter.update::<_, T, CALIBRATED, 3>(belief, &star, &given, &z, T::splat(gates[2])).into()
    }
    #[inline(always)]
    fn direction<F: Filter, T: Real<Mask = bool>>(
        &self,
        filter: &F,
        belief: &mut F::Belief<CalibratedSpace, T, CALIBRATED>,
        body: &[f64; 3],
        reference: &Reference<f64>,
        gates: &[f64; MAX_DOF],
    ) -> Report {
        let (given, z) = (References::map(reference, T::splat), Vector3::map(body, T::splat));
        filter.update::<_, T, CALIBRATED, 2>(belief, &PlainDirection, &given, &z, T::splat(gates[1])).into()
    }
}

//! The Earth's gravity: a point, an oblate body, or a field of spherical harmonics.

use super::field::Field;
use super::vector::{dot3, point_mass_gradient};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, symmetric};
use crate::scalar::Real;
use std::sync::Arc;

/// The Earth's gravity.
#[derive(Clone, Debug)]
pub enum Gravity {
    /// A point mass of gravitational parameter `mu`, m³/s².
    TwoBody {
        /// Gravitational parameter, m³/s².
        mu: f64,
    },
    /// A point mass and the second zonal harmonic about the z axis of the GCRS.
    J2(J2),
    /// Spherical harmonics in the Earth-fixed frame.
    Field(Arc<Field>),
}

impl Gravity {
    /// Gravitational parameter, m³/s².
    #[inline(always)]
    pub fn mu(&self) -> f64 {
        match self {
            Self::TwoBody { mu } => *mu,
            Self::J2(j2) => j2.mu,
            Self::Field(field) => field.mu,
        }
    }
}

/// A point mass and its second zonal harmonic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct J2 {
    /// Gravitational parameter, m³/s².
    pub mu: f64,
    /// Equatorial radius that goes with `j2`, m.
    pub radius: f64,
    /// Second zonal harmonic, `−√5 C̄20`.
    pub j2: f64,
}

impl J2 {
    /// # Errors
    /// `Parameter` where a number is not finite, or `mu` or `radius` not positive.
    pub fn new(mu: f64, radius: f64, j2: f64) -> Result<Self> {
        for (field, value) in [("mu", mu), ("radius", radius)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::Parameter { field, value, need: "must be finite and positive" });
            }
        }
        if !j2.is_finite() {
            return Err(Error::Parameter { field: "j2", value: j2, need: "must be finite" });
        }
        Ok(Self { mu, radius, j2 })
    }

    /// Acceleration, m/s² (Ning and Ma 2010, eq. 1, with `(Re/r)²` where the print has `Re/r`).
    #[inline(always)]
    pub fn acceleration<T: Real>(&self, r: &[T; 3]) -> [T; 3] {
        let (i2, i3) = inverse_powers(r);
        let central = i3 * -self.mu;
        let k = i2 * (1.5 * self.j2 * self.radius * self.radius);
        let s5 = r[2] * r[2] * i2 * 5.0;
        let across = central * k.mul_add(T::one() - s5, T::one());
        let along = central * k.mul_add(T::splat(3.0) - s5, T::one());
        [across * r[0], across * r[1], along * r[2]]
    }

    /// Derivative of the acceleration to the position, s⁻².
    #[inline(always)]
    pub fn gradient<T: Real>(&self, r: &[T; 3]) -> Matrix<T, 3, 3> {
        let (i2, i3) = inverse_powers(r);
        let central = i3 * self.mu;
        let a = central * i2 * (1.5 * self.j2 * self.radius * self.radius);
        let s = r[2] * r[2] * i2;
        // multiples of r rᵀ, of the rows and columns of z in it, of the identity and of ẑ ẑᵀ
        let outer = i2 * central.mul_add(T::splat(3.0), a * (T::splat(5.0) - s * 35.0));
        let polar = i2 * a * 10.0;
        let diagonal = a.mul_add(s * 5.0 - T::one(), -central);
        symmetric(
            #[inline(always)]
            |i, j| {
                let part = match (i, j) {
                    (2, 2) => outer + polar + polar,
                    (2, _) => outer + polar,
                    _ => outer,
                };
                match (i, j) {
                    (2, 2) => (r[2] * r[2]).mul_add(part, a.mul_add(T::splat(-2.0), diagonal)),
                    _ if i == j => (r[i] * r[i]).mul_add(part, diagonal),
                    _ => r[i] * r[j] * part,
                }
            },
        )
    }
}

/// `|r|⁻²` and `|r|⁻³`; the root does not wait for the division.
#[inline(always)]
fn inverse_powers<T: Real>(r: &[T; 3]) -> (T, T) {
    let square = dot3(r, r);
    let i2 = square.recip();
    (i2, i2 * i2 * square.sqrt())
}

/// Acceleration of a point mass, m/s².
#[inline(always)]
pub(super) fn two_body<T: Real>(mu: f64, r: &[T; 3]) -> [T; 3] {
    let c = inverse_powers(r).1 * -mu;
    [c * r[0], c * r[1], c * r[2]]
}

/// Its gradient, s⁻².
#[inline(always)]
pub(super) fn two_body_gradient<T: Real>(mu: f64, r: &[T; 3]) -> Matrix<T, 3, 3> {
    let (i2, i3) = inverse_powers(r);
    point_mass_gradient(r, i3 * mu, i2 * 3.0)
}

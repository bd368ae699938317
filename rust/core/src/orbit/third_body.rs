//! The pull of Sun and Moon, less their pull on the Earth.

use super::vector::{dot3, point_mass_gradient, sub3};
use crate::linalg::Matrix;
use crate::scalar::Real;

/// Gravitational parameter of the Sun, m³/s² (JPL DE440, TDB-compatible).
pub const SUN_MU: f64 = 1.327_124_400_412_794e20;
/// Gravitational parameter of the Moon, m³/s² (JPL DE440).
pub const MOON_MU: f64 = 4.902_800_118_457_551e12;

/// Tidal acceleration by a point mass at geocentric position `s`, m/s² (Montenbruck and Gill 2000, eq. 3.37).
#[inline(always)]
pub fn third_body<T: Real>(mu: f64, s: &[T; 3], r: &[T; 3]) -> [T; 3] {
    let d = sub3(s, r);
    let (d2, s2) = (dot3(&d, &d).recip(), dot3(s, s).recip());
    let (near, far) = (d2 * d2.sqrt() * mu, s2 * s2.sqrt() * -mu);
    [d[0].mul_add(near, s[0] * far), d[1].mul_add(near, s[1] * far), d[2].mul_add(near, s[2] * far)]
}

/// Its derivative to the position, s⁻².
#[inline(always)]
pub(super) fn third_body_gradient<T: Real>(mu: f64, s: &[T; 3], r: &[T; 3]) -> Matrix<T, 3, 3> {
    let d = sub3(r, s);
    let d2 = dot3(&d, &d).recip();
    point_mass_gradient(&d, d2 * d2.sqrt() * mu, d2 * 3.0)
}

//! Accelerations composed as a value.

use super::drag::Drag;
use super::environment::{Environment, Moment};
use super::gravity::{Gravity, J2, two_body, two_body_gradient};
use super::radiation::SolarPressure;
use super::third_body::{MOON_MU, SUN_MU, third_body, third_body_gradient};
use super::vector::{add3, rotate, rotate_back};
use crate::error::{Error, Result};
use crate::linalg::{Matrix, add, congruence, from_fn};
use crate::scalar::Real;
use std::sync::Arc;

/// All that accelerates a satellite.
#[derive(Clone, Debug)]
pub struct ForceModel {
    gravity: Gravity,
    sun: bool,
    moon: bool,
    srp: Option<SolarPressure>,
    drag: Option<Drag>,
    environment: Option<Arc<Environment>>,
}

/// Acceleration with its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Gradient<T: Real> {
    /// Acceleration, m/s².
    pub acceleration: [T; 3],
    /// Its derivative to the position, s⁻².
    pub by_position: Matrix<T, 3, 3>,
    /// Its derivative to the velocity, s⁻¹; none without drag.
    pub by_velocity: Option<Matrix<T, 3, 3>>,
}

impl ForceModel {
    /// # Errors
    /// `Parameter` where a coefficient cannot be used or a force needs an environment that is not given.
    pub fn new(
        gravity: Gravity,
        [sun, moon]: [bool; 2],
        srp: Option<SolarPressure>,
        drag: Option<Drag>,
        environment: Option<Arc<Environment>>,
    ) -> Result<Self> {
        let mut numbers = vec![];
        if let Some(s) = srp {
            numbers.extend([("srp.cr", s.cr), ("srp.area_to_mass", s.area_to_mass), ("srp.pressure", s.pressure)]);
        }
        if let Some(d) = drag {
            numbers.extend([("drag.cd", d.cd), ("drag.area_to_mass", d.area_to_mass)]);
            if !d.lag.is_finite() {
                return Err(Error::Parameter { field: "drag.lag", value: d.lag, need: "must be finite" });
            }
            if !(2.0..=6.0).contains(&d.exponent) {
                return Err(Error::Parameter {
                    field: "drag.exponent",
                    value: d.exponent,
                    need: "must be from 2 to 6",
                });
            }
        }
        for (field, value) in numbers {
            if !(value.is_finite() && value >= 0.0) {
                return Err(Error::Parameter { field, value, need: "must be finite and not negative" });
            }
        }
        let model = Self { gravity, sun, moon, srp, drag, environment };
        if model.environment.is_none() && model.needs_environment() {
            return Err(Error::Empty { field: "environment" });
        }
        Ok(model)
    }

    /// Gravity alone.
    ///
    /// # Errors
    /// `Empty` for a field of harmonics, which needs an environment.
    pub fn gravity(gravity: Gravity) -> Result<Self> {
        Self::new(gravity, [false; 2], None, None, None)
    }

    /// Whether a force depends on the Earth's rotation, the Sun or the Moon.
    pub fn needs_environment(&self) -> bool {
        let field = matches!(self.gravity, Gravity::Field(_));
        field || self.sun || self.moon || self.srp.is_some() || self.drag.is_some()
    }

    /// The tables.
    pub fn environment(&self) -> Option<&Environment> {
        self.environment.as_deref()
    }

    /// Whether the acceleration depends on the velocity.
    #[inline(always)]
    pub fn has_drag(&self) -> bool {
        self.drag.is_some()
    }

    /// Whether sunlight pushes.
    #[inline(always)]
    pub fn has_pressure(&self) -> bool {
        self.srp.is_some()
    }

    /// The closed form, where gravity is all there is and needs no table.
    #[inline(always)]
    pub fn closed(&self) -> Option<J2> {
        if self.sun || self.moon || self.srp.is_some() || self.drag.is_some() {
            return None;
        }
        match &self.gravity {
            Gravity::TwoBody { mu } => Some(J2 { mu: *mu, radius: 1.0, j2: 0.0 }),
            Gravity::J2(j2) => Some(*j2),
            Gravity::Field(_) => None,
        }
    }

    /// What the forces need of the time `t`.
    #[inline(always)]
    pub fn moment<T: Real>(&self, t: T) -> Moment<T> {
        match &self.environment {
            Some(environment) => environment.lanes(t),
            None => Moment::none(),
        }
    }

    /// Acceleration in the GCRS, m/s².
    #[inline(always)]
    pub fn acceleration<T: Real>(&self, at: &Moment<T>, r: &[T; 3], v: &[T; 3]) -> [T; 3] {
        let mut a = match &self.gravity {
            Gravity::TwoBody { mu } => two_body(*mu, r),
            Gravity::J2(j2) => j2.acceleration(r),
            Gravity::Field(field) => {
                let fixed = field.acceleration(&rotate(&at.to_earth, r));
                add3(&rotate_back(&at.to_earth, &fixed), &two_body(field.mu, r))
            }
        };
        if self.sun {
            a = add3(&a, &third_body(SUN_MU, &at.sun, r));
        }
        if self.moon {
            a = add3(&a, &third_body(MOON_MU, &at.moon, r));
        }
        if let Some(srp) = &self.srp {
            a = add3(&a, &srp.acceleration(&at.sun, r));
        }
        if let Some(drag) = &self.drag {
            a = add3(&a, &drag.acceleration(at, r, v));
        }
        a
    }

    /// Acceleration with its derivatives.
    #[inline(always)]
    pub fn gradient<T: Real>(&self, at: &Moment<T>, r: &[T; 3], v: &[T; 3]) -> Gradient<T> {
        let (mut a, mut g) = match &self.gravity {
            Gravity::TwoBody { mu } => (two_body(*mu, r), two_body_gradient(*mu, r)),
            Gravity::J2(j2) => (j2.acceleration(r), j2.gradient(r)),
            Gravity::Field(field) => {
                let (fixed, gradient) = field.gradient(&rotate(&at.to_earth, r));
                let a = add3(&rotate_back(&at.to_earth, &fixed), &two_body(field.mu, r));
                (a, add(&turned(&at.to_earth, &gradient), &two_body_gradient(field.mu, r)))
            }
        };
        for (on, mu, body) in [(self.sun, SUN_MU, &at.sun), (self.moon, MOON_MU, &at.moon)] {
            if on {
                a = add3(&a, &third_body(mu, body, r));
                g = add(&g, &third_body_gradient(mu, body, r));
            }
        }
        if let Some(srp) = &self.srp {
            let (push, gradient) = srp.gradient(&at.sun, r);
            (a, g) = (add3(&a, &push), add(&g, &gradient));
        }
        let mut by_velocity = None;
        if let Some(drag) = &self.drag {
            let (push, gradient, damping) = drag.gradient(at, r, v);
            (a, g) = (add3(&a, &push), add(&g, &gradient));
            by_velocity = Some(damping);
        }
        Gradient { acceleration: a, by_position: g, by_velocity }
    }
}

/// `Rᵀ G R` for a symmetric `G`.
#[inline(always)]
fn turned<T: Real>(rotation: &[[T; 3]; 3], g: &Matrix<T, 3, 3>) -> Matrix<T, 3, 3> {
    let r: Matrix<T, 3, 3> = from_fn(
        #[inline(always)]
        |i, j| rotation[j][i],
    );
    congruence(&r, g)
}

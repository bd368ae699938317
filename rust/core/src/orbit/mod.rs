//! Orbits: the forces on a satellite, their gradients, and how they move it.
//!
//! Positions and velocities are geocentric, in the GCRS, in m and m/s; times are seconds since the run's
//! epoch. What depends on the Earth's rotation, the Sun or the Moon reads tables ([`Environment`]) that
//! are made once per run.

mod coefficients;
mod dop853;
mod drag;
mod environment;
mod field;
mod force;
mod gravity;
mod integrate;
mod model;
mod oblate;
mod radiation;
mod step;
mod third_body;
mod vector;

pub use drag::{Drag, harris_priester};
pub use environment::{Environment, Moment, Tables};
pub use field::{Field, MAX_DEGREE};
pub use force::{ForceModel, Gradient};
pub use gravity::{Gravity, J2};
pub use integrate::{Method, Trajectory, propagate};
pub use model::{Nothing, OrbitModel, Scheme};
pub use radiation::{SolarPressure, sunlight};
pub use third_body::{MOON_MU, SUN_MU, third_body};

/// Equatorial radius of the Earth in the shadow and as the ground, m (WGS 84).
pub const EARTH_RADIUS: f64 = 6_378_137.0;

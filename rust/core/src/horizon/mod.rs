//! What a satellite sees of stars and the Earth's centre.
//!
//! The state is position and velocity in the inertial frame, six numbers in a row. An angle between a
//! star and the nadir is one number; the angles of an epoch are first combined into a nadir direction,
//! which is all that they say of the position.
//!
//! Air bends the light of a star close to the limb: how much depends on the height at which the light passes, and so says
//! where the satellite is without a horizon sensor.
//!
//! Source: Ning, Ma, *Analysis of filtering methods for satellite celestial navigation*, 2010, eqs 2 to 4.

mod angle;
mod atmosphere;
mod density;
mod epochs;
mod limb;
mod noise;
mod normal;
mod refraction;
mod sights;

pub use angle::{AnglePlane, NadirPlane, PlaneGiven, PlaneGivens, StarAngle, StarGiven, StarGivens};
pub use atmosphere::{Atmosphere, Bending, Level, REFRACTIVITY};
pub use density::{Airless, UnknownDensity, WithDensity};
pub use epochs::{AngleSeries, Epochs};
pub use limb::{Limb, LimbField, LimbNoise, Passed, Sight};
pub use noise::{AngleNoise, Shape};
pub use normal::{Expected, Fitted};
pub use refraction::{Ellipsoid, Ray, RefractionAngle, RefractionGiven, RefractionGivens};
pub use sights::Robust;

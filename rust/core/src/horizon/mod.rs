//! What a satellite sees of stars and the Earth's centre.
//!
//! The state is position and velocity in the inertial frame, six numbers in a row. An angle between a
//! star and the nadir is one number of a loop of small updates; angles that share the error of one
//! horizon sensor are first combined into a nadir direction, which is all that they say of the position.
//!
//! Source: Ning, Ma, *Analysis of filtering methods for satellite celestial navigation*, 2010, eqs 2 to 4.

mod angle;
mod epochs;
mod noise;

pub use angle::{AnglePlane, NadirPlane, PlaneGiven, PlaneGivens, StarAngle, StarGiven, StarGivens};
pub use epochs::{AngleSeries, Epochs, Expected, Fitted, Robust};
pub use noise::{AngleNoise, Shape};

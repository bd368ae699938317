//! Generic filters on manifolds, and the spacecraft models that run on them.
//!
//! Conventions (the same everywhere): SI units and radians; quaternions by Hamilton, scalar first,
//! `q_ib` takes body vectors to inertial ones; attitude errors on the right, in the body frame,
//! `q = q̂ ⊗ exp(δθ/2)`.
//!
//! `filter`, `replay` and `belief` name no sensor and no attitude; `attitude` names no filter but where it
//! puts a whole system together.

pub mod attitude;
pub mod augmented;
pub mod belief;
pub mod celestial;
pub mod cloud;
pub mod consistency;
pub mod error;
pub mod filter;
pub mod gnss;
pub mod horizon;
pub mod linalg;
pub mod manifold;
pub mod model;
pub mod moments;
pub mod orbit;
mod packed;
pub mod quaternion;
pub mod replay;
pub mod resample;
pub mod scalar;
pub mod simulate;

pub use error::{Error, Result};

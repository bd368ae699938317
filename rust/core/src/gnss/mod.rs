//! Where a satellite is and how it is turned, from a satellite navigation receiver and a star sensor.

mod axis;
mod fixes;
mod history;
mod run;

pub use axis::{Axis, AxisFixes, AxisModel, axis};
pub use fixes::{AttitudeFix, FixGiven, FixGivens, OrbitSpace, OrbitState, Oriented, PositionFix, Seeing, VelocityFix};
pub use history::History;
pub use run::{
    AttitudeFixes, AttitudeJob, AttitudeModel, Begin, Ended, Options, OrbitFilter, OrbitFixes, OrbitJob, Stops,
    attitude, orbit,
};

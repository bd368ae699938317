//! Attitude from a gyro and star cameras or direction sensors.

mod batch;
mod block;
mod calibration;
pub mod camera;
mod columns;
mod gaps;
mod gyro;
mod history;
mod invariant;
mod literal;
mod merge;
mod run;
mod sensors;
mod series;
mod start;
mod state;
mod stream;
mod system;
pub mod wahba;
mod writer;

pub use batch::{Flight, LANES, in_lanes, run_all, run_many};
pub use block::{Samples, Times};
pub use calibration::{CALIBRATED, Calibrated, CalibratedSpace, Calibration, GuidedInput, GuidedInputs, GuidedSeries};
pub use columns::{Buffers, Columns, Measured, Rows, Tally, rows};
pub use gaps::{gap_limit, gaps};
pub use gyro::{GyroInput, GyroInputs, GyroModel, GyroTiming, Sampling};
pub use history::{PastStep, SmoothedState};
pub use invariant::{InertialError, Invariant};
pub use literal::{ErrorQuaternion, Literal, LiteralModel, LiteralSpace};
pub use run::{AnyFilter, CALIBRATION_PASSES, Log, Options, calibrate, run, smooth};
pub use sensors::{Direction, Reference, References, StarQuaternion, Symmetric3};
pub use series::{AttitudeSensor, AttitudeSensors, DirectionSeries, FixNoise, GyroSeries, StarSeries, turned};
pub use start::first_fix;
pub use state::{Attitude, AttitudeBias, UnitQuaternion, Vector3};
pub use stream::{Snapshot, Stream};
pub use system::System;

//! Attitude from a gyro and star cameras or direction sensors.

pub mod camera;
mod gyro;
mod run;
mod sensors;
mod series;
mod start;
mod state;
mod stream;
pub mod wahba;

pub use gyro::{GyroInput, GyroInputs, GyroModel, GyroTiming, Sampling};
pub use run::{AnyFilter, Buffers, Columns, Log, Measured, Options, Rows, rows, run};
pub use sensors::{Direction, Reference, References, StarQuaternion, Symmetric3};
pub use series::{AttitudeSensor, AttitudeSensors, DirectionSeries, GyroSeries, StarSeries};
pub use start::first_fix;
pub use state::{Attitude, AttitudeBias, UnitQuaternion, Vector3};
pub use stream::{Snapshot, Stream};

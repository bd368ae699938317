//! Where a satellite of the Earth is, from what it sees of stars and the Earth.

mod results;
mod run;
mod sensors;
mod stream;

pub use results::Results;
pub use run::{AnyFilter, Log, Options, run, smooth};
pub use sensors::{CelestialSensors, Horizon, Outliers, Source, Use};
pub use stream::OrbitStream;

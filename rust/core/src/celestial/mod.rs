//! Where a satellite of the Earth is, from what it sees of stars and the Earth.

mod campaign;
mod results;
mod run;
mod sensors;
mod simulate;
mod sky;
mod stream;

pub use campaign::{Campaign, Estimator, Flight, Score, Scored, Spread, monte_carlo};
pub use results::Results;
pub use run::{AnyFilter, Form, Log, Options, run, smooth};
pub use sensors::{CelestialSensors, Horizon, Outliers, Refraction, Source, Use};
pub use simulate::{AngleScene, Blunders};
pub use sky::{Seen, SkyField};
pub use stream::OrbitStream;

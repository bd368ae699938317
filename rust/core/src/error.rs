//! One error type; each variant carries the numbers that explain it.

use thiserror::Error;

/// Result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong, where, and with which value.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Error {
    /// Two columns of one table differ in length.
    #[error("{field} has {found} rows, but {expected} are needed: all columns of one table have the same length")]
    Length {
        /// Name of the column.
        field: &'static str,
        /// Rows it should have.
        expected: usize,
        /// Rows it has.
        found: usize,
    },
    /// A table without rows where at least one is needed.
    #[error("{field} is empty: at least one row is needed")]
    Empty {
        /// Name of the table.
        field: &'static str,
    },
    /// Times that go back or repeat.
    #[error(
        "{field} row {row}: time {value:?} s does not come after {previous} s; sort the rows and drop the repeated ones"
    )]
    NotIncreasing {
        /// Name of the column.
        field: &'static str,
        /// Row of the offending time.
        row: usize,
        /// The time in the row before.
        previous: f64,
        /// The offending time.
        value: f64,
    },
    /// A parameter outside its range.
    #[error("{field} = {value:?}: {need}")]
    Parameter {
        /// Name of the parameter.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What is needed instead.
        need: &'static str,
    },
    /// A value in a column that cannot be right.
    #[error("{field} row {row} = {value:?}: {need}")]
    Row {
        /// Name of the column.
        field: &'static str,
        /// Its row.
        row: usize,
        /// The value.
        value: f64,
        /// What is needed instead.
        need: &'static str,
    },
    /// A covariance that is not (or no longer) positive definite, or a state that is not finite.
    #[error(
        "{what} is not positive definite or not finite at step {step}, t = {t} s; check the noise parameters, or use the square-root filter"
    )]
    NotPositiveDefinite {
        /// Which matrix.
        what: &'static str,
        /// Number of the step (sample or measurement row).
        step: usize,
        /// Its time in seconds.
        t: f64,
    },
    /// No measurement that a filter could start from.
    #[error(
        "no {sensor} measurement to start from lies inside the gyro's time span; give the initial attitude (q0), or a log with star fixes"
    )]
    NoStart {
        /// Kind of the sensor.
        sensor: &'static str,
    },
    /// A time before the state's own.
    #[error("{field}: time {t} s lies before the state's time {now} s; samples must come in order of time")]
    OutOfOrder {
        /// Name of the argument.
        field: &'static str,
        /// The time given.
        t: f64,
        /// The state's time.
        now: f64,
    },
    /// A filter that only replays whole logs.
    #[error("filter: this one replays whole logs only; sample by sample run EKF, UKF or SRUKF")]
    NotStreaming,
    /// A filter that weighs every measurement alike.
    #[error("filter: IteratedEKF weighs all fixes alike; huber, student_t and adaptive go with EKF, UKF or SRUKF")]
    NotRobust,
    /// An orbit that enters the Earth, or is not finite any more.
    #[error("the orbit at t = {t} s is {radius} m from the Earth's centre, which is inside the Earth or not finite")]
    Impact {
        /// Time, s.
        t: f64,
        /// Distance from the Earth's centre, m.
        radius: f64,
    },
    /// A measurement that no particle explains.
    #[error(
        "the weights of all {count} particles vanish at measurement {step}, t = {t} s: their largest log-likelihood is {largest}, {broken} are not a number; give the noise wider tails or soft edges, more particles, or let the filter recover"
    )]
    Vanished {
        /// Number of the measurement.
        step: usize,
        /// Its time in seconds.
        t: f64,
        /// Largest log-likelihood of a particle.
        largest: f64,
        /// Particles whose likelihood is not a number.
        broken: usize,
        /// Particles.
        count: usize,
    },
    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}

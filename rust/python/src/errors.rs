//! The one place where errors of the core become Python exceptions (`celestcore.errors`).

use celestcore_core::Error;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The exception for an error of the core, with the numbers that explain it as attributes.
pub(crate) fn raise(py: Python<'_>, error: Error) -> PyErr {
    let details = PyDict::new(py);
    let made = described(&error, &details)
        .and_then(|(class, message)| py.import("celestcore.errors")?.getattr(class)?.call((message,), Some(&details)));
    made.map_or_else(|failed| failed, PyErr::from_value)
}

/// Class and message; the class puts the details in front of the message.
fn described(error: &Error, details: &Bound<'_, PyDict>) -> PyResult<(&'static str, String)> {
    let message = match *error {
        Error::Length { field, expected, found } => {
            details.set_item("field", field)?;
            format!("has {found} rows, but {expected} are needed: columns of one table have the same length")
        }
        Error::Empty { field } => {
            details.set_item("field", field)?;
            "is empty: at least one row is needed".to_owned()
        }
        Error::NotIncreasing { field, row, previous, value } => {
            details.set_item("field", field)?;
            details.set_item("row", row)?;
            details.set_item("value", value)?;
            format!("does not come after {previous:?} s; sort the rows and drop the repeated ones")
        }
        Error::Row { field, row, value, need } => {
            details.set_item("field", field)?;
            details.set_item("row", row)?;
            details.set_item("value", value)?;
            need.to_owned()
        }
        Error::Parameter { field, value, need } => {
            details.set_item("field", field)?;
            details.set_item("value", value)?;
            need.to_owned()
        }
        Error::OutOfOrder { field, t, now } => {
            details.set_item("field", field)?;
            details.set_item("value", t)?;
            format!("lies before the state's time, {now:?} s; samples must come in order of time")
        }
        Error::NotPositiveDefinite { what, step, t } => {
            details.set_item("step", step)?;
            details.set_item("time", t)?;
            let advice = "check the noise parameters, or use the square-root filter";
            return Ok(("NumericalError", format!("{what} is not positive definite or not finite; {advice}")));
        }
        Error::Impact { t, radius } => {
            details.set_item("time", t)?;
            let advice = "check the start, its units (m and m/s) and the drag";
            let message =
                format!("the orbit is {radius:?} m from the Earth's centre, inside it or not finite; {advice}");
            return Ok(("NumericalError", message));
        }
        Error::Vanished { step, t, .. } => {
            details.set_item("step", step)?;
            details.set_item("time", t)?;
            return Ok(("NumericalError", error.to_string()));
        }
        Error::NoStart { .. } | Error::NotStreaming | Error::NotRobust => error.to_string(),
        Error::Interrupted => return Ok(("CelestcoreError", error.to_string())),
    };
    Ok(("InputError", message))
}

/// An `InputError` with a message of its own.
pub(crate) fn input(py: Python<'_>, message: &str) -> PyErr {
    let made = py.import("celestcore.errors").and_then(|m| m.getattr("InputError")?.call1((message,)));
    made.map_or_else(|failed| failed, PyErr::from_value)
}

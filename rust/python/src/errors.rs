//! The one place where errors of the core become Python exceptions (`celestcore.errors`).

use celestcore_core::Error;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// The exception for an error of the core.
pub(crate) fn raise(py: Python<'_>, error: Error) -> PyErr {
    let class = match &error {
        Error::NotPositiveDefinite { .. } => "NumericalError",
        Error::Interrupted => return PyRuntimeError::new_err("interrupted"),
        _ => "InputError",
    };
    named(py, class, &error.to_string())
}

/// An `InputError` with a message of its own.
pub(crate) fn input(py: Python<'_>, message: &str) -> PyErr {
    named(py, "InputError", message)
}

fn named(py: Python<'_>, class: &str, message: &str) -> PyErr {
    let made = py.import("celestcore.errors").and_then(|m| m.getattr(class)).and_then(|c| c.call1((message,)));
    match made {
        Ok(exception) => PyErr::from_value(exception),
        Err(failed) => failed,
    }
}

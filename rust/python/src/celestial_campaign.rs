//! Simulated skies and angles, and many trials of them in one call.

use crate::convert::{Array, rows};
use crate::errors::raise;
use celestcore_core::celestial::SkyField;
use numpy::PyArray1;
use pyo3::prelude::*;

/// A camera's field as the Python package describes it.
#[derive(FromPyObject)]
struct Field {
    #[pyo3(item)]
    boresight: [f64; 3],
    #[pyo3(item)]
    along: [f64; 3],
    #[pyo3(item)]
    inertial: bool,
    #[pyo3(item)]
    tangents: [f64; 2],
    #[pyo3(item)]
    brightest: usize,
    #[pyo3(item)]
    opaque: f64,
}

/// How many stars are seen at each epoch, and their rows; stars are given with the brightest first.
type Sighted<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>);

/// Stars (unit vectors, the brightest first) that a field holds along an orbit.
#[pyfunction]
fn sky_visible<'py>(
    py: Python<'py>,
    field: Field,
    stars: Array<'py>,
    r: Array<'py>,
    v: Array<'py>,
) -> PyResult<Sighted<'py>> {
    let Field { boresight, along, inertial, tangents, brightest, opaque } = field;
    let field = SkyField { boresight, along, inertial, tangents, brightest, opaque };
    let (stars, r, v) = (rows::<3>(&stars, "stars")?, rows::<3>(&r, "r")?, rows::<3>(&v, "v")?);
    let seen = py.detach(|| field.look(stars, r, v)).map_err(|e| raise(py, e))?;
    let numbers = |values: Vec<usize>| PyArray1::from_iter(py, values.into_iter().map(|k| k as i64));
    Ok((numbers(seen.counts), numbers(seen.rows)))
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(sky_visible, m)?)
}

//! The star camera as an instrument; checks and padding are done by the Python package.

use crate::convert::{Array, flat, matrices, rows, table};
use crate::errors::input;
use crate::wahba::method;
use celestcore_core::attitude::camera::{CHUNK, Camera, Catalogue, Frames, Observer, Outline, isotropic};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Half angle, magnitude limit, sigma, largest number of stars.
pub(crate) type Optics = (f64, f64, f64, usize);

/// A camera as the Python package describes it.
pub(crate) fn camera(py: Python<'_>, optics: Optics, shape: &str) -> PyResult<Camera> {
    let (half_angle, magnitude_limit, sigma, brightest) = optics;
    Ok(Camera { outline: outline(py, shape)?, half_angle, magnitude_limit, brightest, sigma })
}

/// Stars as the Python package describes them.
pub(crate) fn catalogue(directions: &Array<'_>, magnitudes: &Array<'_>) -> PyResult<Catalogue> {
    let (py, magnitudes) = (directions.py(), flat(magnitudes, "magnitudes")?);
    let directions = rows::<3>(directions, "directions")?;
    if directions.len() != magnitudes.len() {
        let (n, m) = (directions.len(), magnitudes.len());
        return Err(input(py, &format!("{n} directions and {m} magnitudes do not go together")));
    }
    Ok(py.detach(|| Catalogue::new(directions, magnitudes)))
}

fn outline(py: Python<'_>, name: &str) -> PyResult<Outline> {
    match name {
        "circle" => Ok(Outline::Circle),
        "square" => Ok(Outline::Square),
        _ => Err(input(py, &format!("shape = {name:?}: must be 'circle' or 'square'"))),
    }
}

/// Directions `(n, 3)` spread evenly over the sphere.
#[pyfunction]
fn camera_isotropic(py: Python<'_>, n: usize, seed: u64) -> PyResult<Bound<'_, PyAny>> {
    table(py, isotropic(n, seed))
}

/// Frames at attitudes `q_ic (n, 4)`: stars one frame after the other, and the fixes of the frames that have
/// one. `(half_angle, magnitude_limit, sigma, brightest)` is the camera, `(seed, stream)` its noise.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
fn camera_observe<'py>(
    py: Python<'py>,
    q: Array<'py>,
    directions: Array<'py>,
    magnitudes: Array<'py>,
    camera: Optics,
    shape: &str,
    random: (u64, u64),
    name: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let q = rows::<4>(&q, "q")?;
    let catalogue = catalogue(&directions, &magnitudes)?;
    let camera = self::camera(py, camera, shape)?;
    let mut observer = Observer::new(camera, &catalogue, method(py, name)?, random.0, random.1);
    let mut frames = Frames::default();
    for chunk in q.chunks(CHUNK) {
        py.detach(|| chunk.iter().for_each(|q| observer.observe(q, &mut frames)));
        py.check_signals()?;
    }
    columns(py, frames)
}

fn columns(py: Python<'_>, frames: Frames) -> PyResult<Bound<'_, PyDict>> {
    let out = PyDict::new(py);
    let fixes = || frames.fixes.iter().filter_map(|f| f.as_ref().ok());
    let known = frames.fixes.iter().enumerate().filter(|(_, f)| f.is_ok()).map(|(i, _)| i as i64);
    out.set_item("frame", PyArray1::from_iter(py, known))?;
    out.set_item("q", table(py, fixes().map(|f| f.q).collect())?)?;
    let p = fixes().map(|f| std::array::from_fn(|i| std::array::from_fn(|j| f.covariance[(i, j)])));
    out.set_item("covariance", matrices::<3, 3>(py, p.collect())?)?;
    out.set_item("loss", PyArray1::from_iter(py, fixes().map(|f| f.loss)))?;
    out.set_item("counts", PyArray1::from_iter(py, frames.counts.iter().map(|c| *c as i64)))?;
    out.set_item("rows", PyArray1::from_iter(py, frames.rows.iter().map(|r| *r as i64)))?;
    out.set_item("vectors", table(py, frames.vectors)?)?;
    Ok(out)
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(camera_isotropic, m)?)?;
    m.add_function(wrap_pyfunction!(camera_observe, m)?)
}

//! Wahba's problem on stacks of frames; broadcasting and messages are done by the Python package.

use crate::convert::{Array, flat, matrices, rows, table};
use crate::errors::input;
use celestcore_core::attitude::wahba::{Fix, Method, Unobservable, Vectors, solve};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

pub(crate) fn method(py: Python<'_>, name: &str) -> PyResult<Method> {
    match name {
        "svd" => Ok(Method::Svd),
        "davenport" => Ok(Method::Davenport),
        "quest" => Ok(Method::Quest),
        _ => Err(input(py, &format!("method = {name:?}: must be 'svd', 'davenport' or 'quest'"))),
    }
}

/// Attitudes of `n` frames of `k` vectors each: `body`, `inertial` `(n, k, 3)`, `sigma`, `weights` `(n, k)`.
///
/// `failed` lists `(frame, vectors, axis or None)` of the frames without an attitude, whose rows are NaN.
#[pyfunction]
fn wahba_solve<'py>(
    py: Python<'py>,
    body: Array<'py>,
    inertial: Array<'py>,
    sigma: Option<Array<'py>>,
    weights: Option<Array<'py>>,
    frames: usize,
    name: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let (body, inertial) = (rows::<3>(&body, "body")?, rows::<3>(&inertial, "inertial")?);
    let sigma = sigma.as_ref().map(|a| flat(a, "sigma")).transpose()?;
    let weights = weights.as_ref().map(|a| flat(a, "weights")).transpose()?;
    let method = method(py, name)?;
    let k = body.len().checked_div(frames).unwrap_or(0);
    let lengths = [inertial.len(), sigma.map_or(k * frames, <[f64]>::len), weights.map_or(k * frames, <[f64]>::len)];
    if body.len() != k * frames || lengths != [k * frames; 3] {
        return Err(input(py, &format!("{} and {lengths:?} rows are not {frames} frames of {k}", body.len())));
    }
    let fixes: Vec<_> = py.detach(|| {
        let frame = |i: usize| {
            let r = i * k..(i + 1) * k;
            let (sigma, weights) = (sigma.map(|s| &s[r.clone()]), weights.map(|w| &w[r.clone()]));
            solve(&Vectors { body: &body[r.clone()], inertial: &inertial[r], sigma, weights }, method)
        };
        (0..frames).map(frame).collect()
    });
    columns(py, &fixes)
}

fn columns<'py>(py: Python<'py>, fixes: &[Result<Fix, Unobservable>]) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let fix = |f: &Result<Fix, Unobservable>| f.ok();
    let p = |f: &Fix| std::array::from_fn(|i| std::array::from_fn(|j| f.covariance[(i, j)]));
    let count = |f: &Result<Fix, Unobservable>| f.map_or_else(|e| e.vectors, |f| f.vectors);
    out.set_item("q", table(py, fixes.iter().map(|f| fix(f).map_or([f64::NAN; 4], |f| f.q)).collect())?)?;
    out.set_item(
        "covariance",
        matrices(py, fixes.iter().map(|f| fix(f).map_or([[f64::NAN; 3]; 3], |f| p(&f))).collect())?,
    )?;
    out.set_item("loss", PyArray1::from_iter(py, fixes.iter().map(|f| fix(f).map_or(f64::NAN, |f| f.loss))))?;
    out.set_item("vectors", PyArray1::from_iter(py, fixes.iter().map(|f| count(f) as i64)))?;
    let failed: Vec<_> =
        fixes.iter().enumerate().filter_map(|(i, f)| f.err().map(|e| (i, e.vectors, e.axis))).collect();
    out.set_item("failed", failed)?;
    Ok(out)
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(wahba_solve, m)?)
}

//! Arrays to slices and back. The Python package hands over C-contiguous float64 arrays.

use crate::errors::input;
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// A C-contiguous float64 array of any shape.
pub(crate) type Array<'py> = PyReadonlyArrayDyn<'py, f64>;

/// All numbers of an array.
pub(crate) fn flat<'a>(a: &'a Array<'_>, name: &str) -> PyResult<&'a [f64]> {
    a.as_slice().map_err(|_| input(a.py(), &format!("{name} must be a C-contiguous float64 array")))
}

/// The rows of an array whose last axis has `K` entries.
pub(crate) fn rows<'a, const K: usize>(a: &'a Array<'_>, name: &str) -> PyResult<&'a [[f64; K]]> {
    let (rows, rest) = flat(a, name)?.as_chunks::<K>();
    if rest.is_empty() && a.shape().last() == Some(&K) {
        return Ok(rows);
    }
    let shape = a.shape();
    Err(input(a.py(), &format!("{name} has shape {shape:?}, but its last axis must have {K} entries")))
}

/// The 3×3 matrices of an array.
pub(crate) fn matrix_rows<'a>(a: &'a Array<'_>, name: &str) -> PyResult<&'a [[[f64; 3]; 3]]> {
    let (matrices, rest) = rows::<3>(a, name)?.as_chunks::<3>();
    if rest.is_empty() && a.shape()[..a.shape().len() - 1].last() == Some(&3) {
        return Ok(matrices);
    }
    let shape = a.shape();
    Err(input(a.py(), &format!("{name} has shape {shape:?}, but its last two axes must have 3 entries")))
}

/// A fresh array of shape `(n, K)` that takes over the memory.
pub(crate) fn table<const K: usize>(py: Python<'_>, rows: Vec<[f64; K]>) -> PyResult<Bound<'_, PyAny>> {
    let n = rows.len();
    Ok(PyArray1::from_vec(py, rows.into_flattened()).reshape([n, K])?.into_any())
}

/// A fresh array of shape `(n, K, L)` that takes over the memory.
pub(crate) fn matrices<const K: usize, const L: usize>(
    py: Python<'_>,
    rows: Vec<[[f64; L]; K]>,
) -> PyResult<Bound<'_, PyAny>> {
    let n = rows.len();
    let flat = rows.into_flattened().into_flattened();
    Ok(PyArray1::from_vec(py, flat).reshape([n, K, L])?.into_any())
}

/// A 6×6 matrix from the rows of an array.
pub(crate) fn matrix6(a: &Array<'_>, name: &str) -> PyResult<celestcore_core::linalg::Matrix<f64, 6, 6>> {
    let m = rows::<6>(a, name)?;
    if m.len() != 6 {
        let shape = a.shape();
        return Err(input(a.py(), &format!("{name} has shape {shape:?}, but (6, 6) is needed")));
    }
    Ok(celestcore_core::linalg::from_fn(|i, j| m[i][j]))
}

/// A matrix as rows.
pub(crate) fn as_rows<const N: usize>(m: &celestcore_core::linalg::Matrix<f64, N, N>) -> Vec<[f64; N]> {
    (0..N).map(|i| std::array::from_fn(|j| m[(i, j)])).collect()
}

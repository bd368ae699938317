//! Quaternion functions on stacks of rows; broadcasting is done by the Python package.

use crate::convert::{Array, flat, matrices, rows, table};
use crate::errors::input;
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::quaternion::{self as quat, Integrator};
use numpy::PyArray1;
use pyo3::prelude::*;

fn same_length(py: Python<'_>, a: usize, b: usize) -> PyResult<()> {
    if a == b { Ok(()) } else { Err(input(py, &format!("stacks of {a} and {b} rows do not go together"))) }
}

macro_rules! unary {
    ($name:ident, $from:literal -> table, $f:expr) => {
        #[pyfunction]
        fn $name<'py>(py: Python<'py>, a: Array<'py>) -> PyResult<Bound<'py, PyAny>> {
            table(py, rows::<$from>(&a, "argument")?.iter().map($f).collect())
        }
    };
    ($name:ident, $from:literal -> matrices, $f:expr) => {
        #[pyfunction]
        fn $name<'py>(py: Python<'py>, a: Array<'py>) -> PyResult<Bound<'py, PyAny>> {
            let f = $f;
            matrices(py, rows::<$from>(&a, "argument")?.iter().map(|x| as_array(&f(x))).collect())
        }
    };
}

macro_rules! binary {
    ($name:ident, $first:literal, $second:literal, $f:expr) => {
        #[pyfunction]
        fn $name<'py>(py: Python<'py>, a: Array<'py>, b: Array<'py>) -> PyResult<Bound<'py, PyAny>> {
            let (a, b) = (rows::<$first>(&a, "first argument")?, rows::<$second>(&b, "second argument")?);
            same_length(py, a.len(), b.len())?;
            table(py, a.iter().zip(b).map(|(a, b)| $f(a, b)).collect())
        }
    };
}

fn as_array(m: &Matrix<f64, 3, 3>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

unary!(quat_exp, 3 -> table, quat::exp::<f64>);
unary!(quat_log, 4 -> table, quat::log::<f64>);
unary!(quat_conjugate, 4 -> table, quat::conjugate::<f64>);
unary!(quat_to_matrix, 4 -> matrices, quat::to_matrix::<f64>);
unary!(quat_right_jacobian, 3 -> matrices, quat::right_jacobian::<f64>);
unary!(quat_right_jacobian_inverse, 3 -> matrices, quat::right_jacobian_inverse);
unary!(quat_from_matrix, 9 -> table, |m: &[f64; 9]| quat::from_matrix(&from_fn(|i, j| m[3 * i + j])));
binary!(quat_multiply, 4, 4, quat::multiply::<f64>);
binary!(quat_rotate, 4, 3, quat::rotate::<f64>);
binary!(quat_shortest_rotation, 3, 3, quat::shortest_rotation);

#[pyfunction]
fn quat_angle_between<'py>(py: Python<'py>, a: Array<'py>, b: Array<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (a, b) = (rows::<4>(&a, "first argument")?, rows::<4>(&b, "second argument")?);
    same_length(py, a.len(), b.len())?;
    Ok(PyArray1::from_vec(py, a.iter().zip(b).map(|(a, b)| quat::angle_between(a, b)).collect()))
}

#[pyfunction]
fn quat_slerp<'py>(py: Python<'py>, a: Array<'py>, b: Array<'py>, s: Array<'py>) -> PyResult<Bound<'py, PyAny>> {
    let (a, b, s) = (rows::<4>(&a, "first argument")?, rows::<4>(&b, "second argument")?, flat(&s, "fraction")?);
    same_length(py, a.len(), b.len())?;
    same_length(py, a.len(), s.len())?;
    table(py, a.iter().zip(b).zip(s).map(|((a, b), s)| quat::slerp(a, b, *s)).collect())
}

/// Signs chosen so that successive rows of each stack of `length` rows are on the same side.
#[pyfunction]
fn quat_continuous(py: Python<'_>, q: Array<'_>, length: usize) -> PyResult<Py<PyAny>> {
    let mut out = rows::<4>(&q, "q")?.to_vec();
    for stack in out.chunks_mut(length.max(1)) {
        for k in 1..stack.len() {
            let dot: f64 = (0..4).map(|i| stack[k - 1][i] * stack[k][i]).sum();
            if dot < 0.0 {
                stack[k] = stack[k].map(|c| -c);
            }
        }
    }
    Ok(table(py, out)?.unbind())
}

pub(crate) fn integrator(py: Python<'_>, name: &str) -> PyResult<Integrator> {
    match name {
        "exponential" => Ok(Integrator::Exponential),
        "rk4" => Ok(Integrator::Rk4),
        _ => Err(input(py, &format!("integrator = {name:?}: must be 'exponential' or 'rk4'"))),
    }
}

/// Attitude histories: `q0 (m, 4)`, `rates (m, n, 3)`, `dt` of one or n entries; returns `(m (n + 1), 4)`.
#[pyfunction]
fn quat_propagate(py: Python<'_>, q0: Array<'_>, rates: Array<'_>, dt: Array<'_>, method: &str) -> PyResult<Py<PyAny>> {
    let (q0, rates, dt) = (rows::<4>(&q0, "q0")?, rows::<3>(&rates, "rates")?, flat(&dt, "dt")?);
    let method = integrator(py, method)?;
    let n = if q0.is_empty() { 0 } else { rates.len() / q0.len() };
    same_length(py, rates.len(), n * q0.len())?;
    if dt.len() != 1 {
        same_length(py, dt.len(), n)?;
    }
    let out = py.detach(|| {
        let mut out = vec![[0.0; 4]; (n + 1) * q0.len()];
        for (i, (q, history)) in q0.iter().zip(out.chunks_mut(n + 1)).enumerate() {
            quat::propagate(q, &rates[i * n..(i + 1) * n], dt, method, history);
        }
        out
    });
    Ok(table(py, out)?.unbind())
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(quat_exp, m)?)?;
    m.add_function(wrap_pyfunction!(quat_log, m)?)?;
    m.add_function(wrap_pyfunction!(quat_conjugate, m)?)?;
    m.add_function(wrap_pyfunction!(quat_to_matrix, m)?)?;
    m.add_function(wrap_pyfunction!(quat_from_matrix, m)?)?;
    m.add_function(wrap_pyfunction!(quat_right_jacobian, m)?)?;
    m.add_function(wrap_pyfunction!(quat_right_jacobian_inverse, m)?)?;
    m.add_function(wrap_pyfunction!(quat_multiply, m)?)?;
    m.add_function(wrap_pyfunction!(quat_rotate, m)?)?;
    m.add_function(wrap_pyfunction!(quat_shortest_rotation, m)?)?;
    m.add_function(wrap_pyfunction!(quat_angle_between, m)?)?;
    m.add_function(wrap_pyfunction!(quat_slerp, m)?)?;
    m.add_function(wrap_pyfunction!(quat_continuous, m)?)?;
    m.add_function(wrap_pyfunction!(quat_propagate, m)?)
}

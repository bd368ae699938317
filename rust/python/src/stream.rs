//! The attitude filter, one sample at a time.

use crate::convert::{Array, as_rows, matrix6, table};
use crate::errors::{input, raise};
use crate::replay::Setup;
use celestcore_core::attitude::{Attitude, Reference, Snapshot, Stream};
use celestcore_core::replay::Report;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;

/// What an update did.
#[pyclass(frozen, module = "celestcore._core")]
struct Update {
    report: Report,
}

#[pymethods]
impl Update {
    #[getter]
    fn accepted(&self) -> bool {
        self.report.accepted
    }
    #[getter]
    fn nis(&self) -> f64 {
        self.report.nis
    }
    #[getter]
    fn dof(&self) -> usize {
        self.report.dof
    }
    #[getter]
    fn innovation<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.report.innovation[..self.report.dof])
    }
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.report.dof;
        let flat: Vec<f64> = self.report.covariance[..n].iter().flat_map(|row| row[..n].to_vec()).collect();
        Ok(PyArray1::from_vec(py, flat).reshape([n, n])?.into_any())
    }
    fn __repr__(&self) -> String {
        let accepted = if self.report.accepted { "True" } else { "False" };
        format!("Update(accepted={accepted}, nis={:.6}, dof={})", self.report.nis, self.report.dof)
    }
}

/// Filter state of one spacecraft; the Python package's `StarGyroState` adds sensors and checks.
#[pyclass(subclass, module = "celestcore._core")]
#[derive(Clone)]
struct AttitudeStream {
    stream: Stream,
    /// Measured rates to rates of the body, a matrix row by row.
    to_body: Option<[f64; 9]>,
}

#[pymethods]
impl AttitudeStream {
    #[new]
    #[pyo3(signature = (setup, to_body, t, q, bias, covariance))]
    fn new(
        py: Python<'_>,
        setup: Setup,
        to_body: Option<[f64; 9]>,
        t: f64,
        q: [f64; 4],
        bias: [f64; 3],
        covariance: Array<'_>,
    ) -> PyResult<Self> {
        let (filter, model, timing) = (setup.filter(py)?, setup.model(py)?, setup.timing(py)?);
        let p = matrix6(&covariance, "initial covariance")?;
        let stream = Stream::new(filter, model, timing, setup.gate, t, Attitude { q, bias }, &p);
        Ok(Self { stream: stream.map_err(|e| raise(py, e))?, to_body })
    }

    /// Moves to time `t` with the gyro sample `rate` taken then.
    fn predict(&mut self, py: Python<'_>, t: f64, rate: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut rate = three(rate)?;
        if let Some(m) = &self.to_body {
            let row = |i: usize| m[3 * i] * rate[0] + m[3 * i + 1] * rate[1] + m[3 * i + 2] * rate[2];
            rate = [row(0), row(1), row(2)];
        }
        self.stream.predict(t, &rate).map_err(|e| raise(py, e))
    }

    fn update_star(&mut self, py: Python<'_>, t: f64, q: [f64; 4], noise: [f64; 6]) -> PyResult<Update> {
        let report = self.stream.update_star(t, &q, &noise).map_err(|e| raise(py, e))?;
        Ok(Update { report })
    }

    fn update_vector(
        &mut self,
        py: Python<'_>,
        t: f64,
        body: [f64; 3],
        inertial: [f64; 3],
        sigma: f64,
    ) -> PyResult<Update> {
        let report =
            self.stream.update_direction(t, &body, &Reference { inertial, sigma }).map_err(|e| raise(py, e))?;
        Ok(Update { report })
    }

    #[getter]
    fn t(&self) -> f64 {
        self.stream.time()
    }
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.stream.state().0.q)
    }
    #[getter]
    fn bias<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.stream.state().0.bias)
    }
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        table(py, as_rows(&self.stream.state().1))
    }

    /// Everything that changes as the filter runs, for `copy` and `pickle`.
    fn _snapshot<'py>(&self, py: Python<'py>) -> PyResult<Parts<'py>> {
        let s = self.stream.snapshot();
        Ok((s.t, s.mean.q, s.mean.bias, table(py, as_rows(&s.matrix))?, s.last, s.steps))
    }

    fn _restore(&mut self, parts: (f64, [f64; 4], [f64; 3], Array<'_>, Option<Sample>, usize)) -> PyResult<()> {
        let (t, q, bias, matrix, last, steps) = parts;
        let matrix = matrix6(&matrix, "matrix")?;
        self.stream.restore(&Snapshot { t, mean: Attitude { q, bias }, matrix, last, steps });
        Ok(())
    }
}

type Sample = (f64, [f64; 3]);
type Parts<'py> = (f64, [f64; 4], [f64; 3], Bound<'py, PyAny>, Option<Sample>, usize);

/// Three numbers: fast from a float64 array, else from any sequence.
fn three(x: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    if let Ok(array) = x.cast::<PyArray1<f64>>() {
        let array = array.try_readonly()?;
        let view = array.as_array();
        if view.len() == 3 {
            return Ok([view[0], view[1], view[2]]);
        }
    }
    x.extract::<[f64; 3]>().map_err(|_| {
        let shown = x.repr().map_or_else(|_| x.get_type().to_string(), |r| r.to_string());
        input(x.py(), &format!("rate must be three numbers in rad/s, got {shown}"))
    })
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<Update>()?;
    m.add_class::<AttitudeStream>()
}

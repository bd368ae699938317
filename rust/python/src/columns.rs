//! The columns of a solution in numpy's own memory: the core writes where Python will read.

use celestcore_core::attitude::{Columns, Measured, Rows};
use celestcore_core::replay::MAX_DOF;
use numpy::{Element, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Arrays for one run.
pub(crate) struct Arrays<'py> {
    t: Bound<'py, PyArray1<f64>>,
    q: Bound<'py, PyArray2<f64>>,
    rate: Bound<'py, PyArray2<f64>>,
    bias: Bound<'py, PyArray2<f64>>,
    sigma: Bound<'py, PyArray2<f64>>,
    covariance: Bound<'py, PyArray3<f64>>,
    measurement_t: Bound<'py, PyArray1<f64>>,
    sensor: Bound<'py, PyArray1<i32>>,
    row: Bound<'py, PyArray1<i32>>,
    dof: Bound<'py, PyArray1<i32>>,
    nis: Bound<'py, PyArray1<f64>>,
    accepted: Bound<'py, PyArray1<bool>>,
    innovation: Bound<'py, PyArray2<f64>>,
    innovation_sigma: Bound<'py, PyArray2<f64>>,
}

impl<'py> Arrays<'py> {
    pub(crate) fn new(py: Python<'py>, rows: Rows, covariance: bool) -> Self {
        let (n, m) = (rows.output, rows.measured);
        Self {
            t: column(py, n),
            q: table(py, n, 4),
            rate: table(py, n, 3),
            bias: table(py, n, 3),
            sigma: table(py, n, 6),
            covariance: PyArray3::zeros(py, [if covariance { n } else { 0 }, 6, 6], false),
            measurement_t: column(py, m),
            sensor: column(py, m),
            row: column(py, m),
            dof: column(py, m),
            nis: column(py, m),
            accepted: column(py, m),
            innovation: table(py, m, MAX_DOF),
            innovation_sigma: table(py, m, MAX_DOF),
        }
    }

    /// Calls `job` with the arrays' memory.
    pub(crate) fn write<R>(&self, job: impl FnOnce(Columns<'_>, Measured<'_>) -> R) -> PyResult<R> {
        let (mut t, mut q, mut rate) = (self.t.try_readwrite()?, self.q.try_readwrite()?, self.rate.try_readwrite()?);
        let (mut bias, mut sigma) = (self.bias.try_readwrite()?, self.sigma.try_readwrite()?);
        let mut covariance = self.covariance.try_readwrite()?;
        let (mut measurement_t, mut nis) = (self.measurement_t.try_readwrite()?, self.nis.try_readwrite()?);
        let (mut sensor, mut row) = (self.sensor.try_readwrite()?, self.row.try_readwrite()?);
        let (mut dof, mut accepted) = (self.dof.try_readwrite()?, self.accepted.try_readwrite()?);
        let mut innovation = self.innovation.try_readwrite()?;
        let mut innovation_sigma = self.innovation_sigma.try_readwrite()?;
        let columns = Columns {
            t: t.as_slice_mut()?,
            q: q.as_slice_mut()?.as_chunks_mut().0,
            rate: rate.as_slice_mut()?.as_chunks_mut().0,
            bias: bias.as_slice_mut()?.as_chunks_mut().0,
            sigma: sigma.as_slice_mut()?.as_chunks_mut().0,
            covariance: covariance.as_slice_mut()?.as_chunks_mut().0.as_chunks_mut().0,
        };
        let measured = Measured {
            t: measurement_t.as_slice_mut()?,
            sensor: sensor.as_slice_mut()?,
            row: row.as_slice_mut()?,
            dof: dof.as_slice_mut()?,
            nis: nis.as_slice_mut()?,
            accepted: accepted.as_slice_mut()?,
            innovation: innovation.as_slice_mut()?.as_chunks_mut().0,
            innovation_sigma: innovation_sigma.as_slice_mut()?.as_chunks_mut().0,
        };
        Ok(job(columns, measured))
    }

    /// The arrays by name.
    pub(crate) fn into_dict(self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        out.set_item("t", self.t)?;
        out.set_item("q", self.q)?;
        out.set_item("rate", self.rate)?;
        out.set_item("bias", self.bias)?;
        out.set_item("sigma", self.sigma)?;
        out.set_item("covariance", self.covariance)?;
        out.set_item("measurement_t", self.measurement_t)?;
        out.set_item("sensor", self.sensor)?;
        out.set_item("row", self.row)?;
        out.set_item("dof", self.dof)?;
        out.set_item("nis", self.nis)?;
        out.set_item("accepted", self.accepted)?;
        out.set_item("innovation", self.innovation)?;
        out.set_item("innovation_sigma", self.innovation_sigma)?;
        Ok(out)
    }
}

fn column<T: Element>(py: Python<'_>, n: usize) -> Bound<'_, PyArray1<T>> {
    PyArray1::zeros(py, n, false)
}

fn table(py: Python<'_>, n: usize, width: usize) -> Bound<'_, PyArray2<f64>> {
    PyArray2::zeros(py, [n, width], false)
}

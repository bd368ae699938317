//! The columns of a solution in numpy's own memory: the core writes where Python will read.

use celestcore_core::attitude::{Columns, Measured, Tally};
use celestcore_core::replay::MAX_DOF;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::PyTypeCheck;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Arrays over the output times.
pub(crate) struct States<'py> {
    t: Bound<'py, PyArray1<f64>>,
    q: Bound<'py, PyArray2<f64>>,
    rate: Bound<'py, PyArray2<f64>>,
    bias: Bound<'py, PyArray2<f64>>,
    sigma: Bound<'py, PyArray2<f64>>,
    covariance: Bound<'py, PyArray3<f64>>,
}

impl<'py> States<'py> {
    /// # Errors
    /// `MemoryError` where there is not enough.
    pub(crate) fn new(py: Python<'py>, rows: usize, covariance: bool) -> PyResult<Self> {
        let zeros = Zeros::new(py)?;
        Ok(Self {
            t: zeros.column(rows)?,
            q: zeros.table(rows, 4)?,
            rate: zeros.table(rows, 3)?,
            bias: zeros.table(rows, 3)?,
            sigma: zeros.table(rows, 6)?,
            covariance: zeros.make((if covariance { rows } else { 0 }, 6, 6), "f8")?,
        })
    }

    /// Calls `job` with the arrays' memory.
    pub(crate) fn write<R>(&self, job: impl FnOnce(Columns<'_>) -> R) -> PyResult<R> {
        let (mut t, mut q, mut rate) = (self.t.try_readwrite()?, self.q.try_readwrite()?, self.rate.try_readwrite()?);
        let (mut bias, mut sigma) = (self.bias.try_readwrite()?, self.sigma.try_readwrite()?);
        let mut covariance = self.covariance.try_readwrite()?;
        Ok(job(Columns {
            t: t.as_slice_mut()?,
            q: q.as_slice_mut()?.as_chunks_mut().0,
            rate: rate.as_slice_mut()?.as_chunks_mut().0,
            bias: bias.as_slice_mut()?.as_chunks_mut().0,
            sigma: sigma.as_slice_mut()?.as_chunks_mut().0,
            covariance: covariance.as_slice_mut()?.as_chunks_mut().0.as_chunks_mut().0,
        }))
    }

    /// Adds the arrays by name.
    pub(crate) fn into_dict(self, out: &Bound<'py, PyDict>) -> PyResult<()> {
        out.set_item("t", self.t)?;
        out.set_item("q", self.q)?;
        out.set_item("rate", self.rate)?;
        out.set_item("bias", self.bias)?;
        out.set_item("sigma", self.sigma)?;
        out.set_item("covariance", self.covariance)
    }
}

/// Arrays over the measurements.
pub(crate) struct Reports<'py> {
    t: Bound<'py, PyArray1<f64>>,
    sensor: Bound<'py, PyArray1<i32>>,
    dof: Bound<'py, PyArray1<i32>>,
    nis: Bound<'py, PyArray1<f64>>,
    accepted: Bound<'py, PyArray1<bool>>,
    innovation: Bound<'py, PyArray2<f64>>,
    innovation_sigma: Bound<'py, PyArray2<f64>>,
}

impl<'py> Reports<'py> {
    /// For so many reports, and for so many innovations with their sigma: none of what is not kept.
    ///
    /// # Errors
    /// `MemoryError` where there is not enough.
    pub(crate) fn new(py: Python<'py>, reports: usize, innovations: usize) -> PyResult<Self> {
        let zeros = Zeros::new(py)?;
        Ok(Self {
            t: zeros.column(reports)?,
            sensor: zeros.make(reports, "i4")?,
            dof: zeros.make(reports, "i4")?,
            nis: zeros.column(reports)?,
            accepted: zeros.make(reports, "?")?,
            innovation: zeros.table(innovations, MAX_DOF)?,
            innovation_sigma: zeros.table(innovations, MAX_DOF)?,
        })
    }

    /// Calls `job` with the arrays' memory, and a tally to keep.
    pub(crate) fn write<R>(&self, job: impl FnOnce(Measured<'_>) -> R) -> PyResult<(R, Tally)> {
        let (mut t, mut nis) = (self.t.try_readwrite()?, self.nis.try_readwrite()?);
        let (mut sensor, mut dof) = (self.sensor.try_readwrite()?, self.dof.try_readwrite()?);
        let mut accepted = self.accepted.try_readwrite()?;
        let mut innovation = self.innovation.try_readwrite()?;
        let mut innovation_sigma = self.innovation_sigma.try_readwrite()?;
        let mut tally = Tally::default();
        let done = job(Measured {
            t: t.as_slice_mut()?,
            sensor: sensor.as_slice_mut()?,
            row: &mut [],
            dof: dof.as_slice_mut()?,
            nis: nis.as_slice_mut()?,
            accepted: accepted.as_slice_mut()?,
            innovation: innovation.as_slice_mut()?.as_chunks_mut().0,
            innovation_sigma: innovation_sigma.as_slice_mut()?.as_chunks_mut().0,
            tally: Some(&mut tally),
            scale: &mut [],
        });
        Ok((done, tally))
    }

    /// Adds the arrays by name.
    pub(crate) fn into_dict(self, out: &Bound<'py, PyDict>) -> PyResult<()> {
        out.set_item("measurement_t", self.t)?;
        out.set_item("sensor", self.sensor)?;
        out.set_item("dof", self.dof)?;
        out.set_item("nis", self.nis)?;
        out.set_item("accepted", self.accepted)?;
        out.set_item("innovation", self.innovation)?;
        out.set_item("innovation_sigma", self.innovation_sigma)
    }
}

/// numpy's own `zeros`, which raises where memory runs out (the crate's panics).
struct Zeros<'py>(Bound<'py, PyAny>);

impl<'py> Zeros<'py> {
    fn new(py: Python<'py>) -> PyResult<Self> {
        Ok(Self(py.import("numpy")?.getattr("zeros")?))
    }
    fn make<S, A>(&self, shape: S, dtype: &str) -> PyResult<Bound<'py, A>>
    where
        S: IntoPyObject<'py>,
        A: PyTypeCheck,
    {
        Ok(self.0.call1((shape, dtype))?.cast_into::<A>()?)
    }
    fn column(&self, n: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.make(n, "f8")
    }
    fn table(&self, n: usize, width: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.make((n, width), "f8")
    }
}

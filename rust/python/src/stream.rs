//! The attitude filter, one sample at a time.

use crate::columns::States;
use crate::convert::{Array, as_rows, flat, matrices, matrix6, rows, table};
use crate::errors::{input, raise};
use crate::listener::Listener;
use crate::replay::Setup;
use celestcore_core::attitude::{
    Attitude, Columns, GyroInput, PastStep, Reference, STREAM_SENSORS, Samples, Snapshot, Stream, Times, turned,
};
use celestcore_core::linalg::Matrix;
use celestcore_core::replay::{MAX_DOF, Report};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Samples from which on other Python threads may run while a block is worked on: some 0.1 ms.
const LARGE: usize = 512;

/// What an update did.
#[pyclass(frozen, module = "celestcore._core")]
pub(crate) struct Update {
    pub(crate) report: Report,
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
        PyArray1::from_slice(py, &self.report.innovation[..self.report.dof.min(MAX_DOF)])
    }
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.report.dof.min(MAX_DOF);
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
    #[pyo3(signature = (setup, to_body, t, q, bias, covariance, lag))]
    #[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
    fn new(
        py: Python<'_>,
        setup: Setup,
        to_body: Option<[f64; 9]>,
        t: f64,
        q: [f64; 4],
        bias: [f64; 3],
        covariance: Array<'_>,
        lag: Option<f64>,
    ) -> PyResult<Self> {
        let (filter, model, timing) = (setup.filter(py)?, setup.model(py)?, setup.timing(py)?);
        let p = matrix6(&covariance, "initial covariance")?;
        let stream = Stream::new(filter, model, timing, setup.trust(py)?, t, Attitude { q, bias }, &p);
        let mut stream = stream.map_err(|e| raise(py, e))?;
        if let Some(lag) = lag {
            stream.keep(lag).map_err(|e| raise(py, e))?;
        }
        Ok(Self { stream, to_body })
    }

    /// Moves to time `t` with the gyro sample `rate` taken then.
    fn predict(&mut self, py: Python<'_>, t: f64, rate: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut rate = three(rate)?;
        if let Some(m) = &self.to_body {
            rate = turned(m, &rate);
        }
        self.stream.predict(t, &rate).map_err(|e| raise(py, e))
    }

    /// Feeds a block of gyro samples taken at times `t`, or `dt` after each other, or all one `step`; returns
    /// the columns after every n-th.
    #[pyo3(signature = (rates, t, dt, step, every, covariance))]
    #[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
    fn _process<'py>(
        &mut self,
        py: Python<'py>,
        rates: Array<'py>,
        t: Option<Array<'py>>,
        dt: Option<Array<'py>>,
        step: f64,
        every: Option<usize>,
        covariance: bool,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let times = match (&t, &dt) {
            (Some(t), _) => Times::At(flat(t, "t")?),
            (None, Some(dt)) => Times::After(flat(dt, "dt")?),
            (None, None) => Times::Every(step),
        };
        let samples = Samples { times, rate: rows(&rates, "rates")?, turn: self.to_body };
        let Some(every) = every else {
            self.feed(py, &samples, usize::MAX, Columns::default())?;
            return Ok(None);
        };
        let states = States::new(py, samples.rate.len() / every.max(1), covariance)?;
        states.write(|columns| self.feed(py, &samples, every, columns))??;
        let out = PyDict::new(py);
        states.into_dict(&out)?;
        Ok(Some(out))
    }

    #[pyo3(signature = (t, q, noise, sensor = 0))]
    fn update_star(&mut self, py: Python<'_>, t: f64, q: [f64; 4], noise: [f64; 6], sensor: usize) -> PyResult<Update> {
        let report = self.stream.update_star(t, sensor, &q, &noise).map_err(|e| raise(py, e))?;
        Ok(Update { report })
    }

    #[pyo3(signature = (t, body, inertial, sigma, sensor = 0))]
    fn update_vector(
        &mut self,
        py: Python<'_>,
        t: f64,
        body: [f64; 3],
        inertial: [f64; 3],
        sigma: f64,
        sensor: usize,
    ) -> PyResult<Update> {
        let reference = Reference { inertial, sigma };
        let report = self.stream.update_direction(t, sensor, &body, &reference).map_err(|e| raise(py, e))?;
        Ok(Update { report })
    }

    /// Times, attitudes, biases and covariances since the lag, all measurements used.
    fn _smoothed<'py>(&self, py: Python<'py>) -> PyResult<Window<'py>> {
        let states = self.stream.smoothed().map_err(|e| raise(py, e))?;
        let t = PyArray1::from_iter(py, states.iter().map(|s| s.0));
        let q = table(py, states.iter().map(|s| s.1.q).collect())?;
        let bias = table(py, states.iter().map(|s| s.1.bias).collect())?;
        let rows =
            |m: &Matrix<f64, 6, 6>| -> [[f64; 6]; 6] { std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)])) };
        let covariance = matrices(py, states.iter().map(|s| rows(&s.2)).collect())?;
        Ok((t, q, bias, covariance))
    }

    /// What each sensor's noise is multiplied by.
    fn _noise_scale(&self) -> Scales {
        *self.stream.noise_scale()
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
        let past = table(py, self.stream.history().map(packed).collect())?;
        Ok((s.t, s.mean.q, s.mean.bias, table(py, as_rows(&s.matrix))?, s.last, s.steps, past, s.scale))
    }

    fn _restore(&mut self, parts: Given<'_>) -> PyResult<()> {
        let (t, q, bias, matrix, last, steps, past, scale) = parts;
        let matrix = matrix6(&matrix, "matrix")?;
        self.stream.recall(rows::<PAST>(&past, "past steps")?.iter().map(unpacked));
        self.stream.restore(&Snapshot { t, mean: Attitude { q, bias }, matrix, last, steps, scale });
        Ok(())
    }
}

impl AttitudeStream {
    fn feed(&mut self, py: Python<'_>, samples: &Samples<'_>, every: usize, columns: Columns<'_>) -> PyResult<()> {
        let (n, stream) = (samples.rate.len(), &mut self.stream);
        let mut listener = Listener::new(None, n + 1);
        let job = || stream.process(samples, every, columns, &mut |k| listener.poll(k));
        let done = if n < LARGE { job() } else { py.detach(job) };
        listener.finish()?;
        done.map_err(|e| raise(py, e))
    }
}

type Sample = (f64, [f64; 3]);
type Parts<'py> = (f64, [f64; 4], [f64; 3], Bound<'py, PyAny>, Option<Sample>, usize, Bound<'py, PyAny>, Scales);
type Given<'py> = (f64, [f64; 4], [f64; 3], Array<'py>, Option<Sample>, usize, Array<'py>, Scales);
type Scales = [f64; STREAM_SENSORS];
type Window<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// Numbers in a past step.
const PAST: usize = 49;

/// A past step as a row: times, input, state, matrix.
fn packed(s: &PastStep) -> [f64; PAST] {
    let head = [s.t, s.to, s.input.rate[0], s.input.rate[1], s.input.rate[2], s.input.extra];
    let parts = head.iter().chain(&s.mean.q).chain(&s.mean.bias).chain(s.matrix.as_slice());
    let mut row = [0.0; PAST];
    for (to, from) in row.iter_mut().zip(parts) {
        *to = *from;
    }
    row
}

fn unpacked(row: &[f64; PAST]) -> PastStep {
    PastStep {
        t: row[0],
        to: row[1],
        input: GyroInput { rate: [row[2], row[3], row[4]], extra: row[5] },
        mean: Attitude { q: [row[6], row[7], row[8], row[9]], bias: [row[10], row[11], row[12]] },
        matrix: Matrix::from_column_slice(&row[13..]),
    }
}

/// Three numbers: fast from a float64 array, else from any sequence.
fn three(x: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    if let Ok(array) = x.cast::<PyArray1<f64>>()
        && let (Some(x), Some(y), Some(z), None) = {
            // one by one: to borrow the array would cost more than all the rest
            let at = |i: usize| array.get_owned(i);
            (at(0), at(1), at(2), at(3))
        }
    {
        return Ok([x, y, z]);
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

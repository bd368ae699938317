//! A whole log in one call.

use crate::columns::Arrays;
use crate::convert::{Array, as_rows, flat, matrix6, rows, table};
use crate::errors::{input, raise};
use crate::quaternions::integrator;
use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, Attitude, AttitudeSensor, AttitudeSensors, DirectionSeries, GyroModel, GyroSeries, GyroTiming, Log,
    Options, Sampling, StarSeries, first_fix, rows as rows_of, run,
};
use celestcore_core::filter::{Ekf, SrUkf, Ukf, Unscented};
use celestcore_core::replay::{Output, Start};
use celestcore_core::scalar::Level;
use numpy::PyArray1;
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::time::{Duration, Instant};

/// Filter and gyro as the Python package describes them.
#[derive(FromPyObject)]
pub(crate) struct Setup {
    #[pyo3(item)]
    filter: String,
    #[pyo3(item)]
    alpha: f64,
    #[pyo3(item)]
    beta: f64,
    #[pyo3(item)]
    kappa: Option<f64>,
    #[pyo3(item)]
    integrator: String,
    #[pyo3(item)]
    arw: f64,
    #[pyo3(item)]
    rrw: f64,
    #[pyo3(item)]
    sampling: String,
    #[pyo3(item)]
    max_gap: f64,
    #[pyo3(item)]
    gap_rate_sigma: f64,
    #[pyo3(item)]
    pub(crate) gate: f64,
}

impl Setup {
    pub(crate) fn filter(&self, py: Python<'_>) -> PyResult<AnyFilter> {
        let weights = || {
            let w = Unscented::new(self.alpha, self.beta, self.kappa)?;
            w.check(6)?;
            Ok::<_, Error>(w)
        };
        match self.filter.as_str() {
            "ekf" => Ok(AnyFilter::Ekf(Ekf)),
            "ukf" => Ok(AnyFilter::Ukf(Ukf { weights: weights().map_err(|e| raise(py, e))? })),
            "srukf" => Ok(AnyFilter::SrUkf(weights().and_then(SrUkf::new).map_err(|e| raise(py, e))?)),
            other => Err(input(py, &format!("filter = {other:?}: must be 'ekf', 'ukf' or 'srukf'"))),
        }
    }
    pub(crate) fn model(&self, py: Python<'_>) -> PyResult<GyroModel> {
        GyroModel::new(self.arw, self.rrw, integrator(py, &self.integrator)?).map_err(|e| raise(py, e))
    }
    pub(crate) fn timing(&self, py: Python<'_>) -> PyResult<GyroTiming> {
        let sampling = match self.sampling.as_str() {
            "hold" => Sampling::Hold,
            "integrated" => Sampling::Integrated,
            "average" => Sampling::Average,
            other => {
                let message = format!("sampling = {other:?}: must be 'hold', 'integrated' or 'average'");
                return Err(input(py, &message));
            }
        };
        Ok(GyroTiming { sampling, max_gap: self.max_gap, gap_rate_sigma: self.gap_rate_sigma })
    }
}

/// One sensor's arrays, borrowed from Python for the time of a run.
enum Sensor<'py> {
    Star(Array<'py>, Array<'py>, Array<'py>),
    Direction(Array<'py>, Array<'py>, Array<'py>, Array<'py>),
}

impl<'py> Sensor<'py> {
    fn new(item: &Bound<'py, PyTuple>) -> PyResult<Self> {
        let kind: String = item.get_item(0)?.extract()?;
        let array = |i: usize| item.get_item(i)?.extract::<Array<'py>>();
        match kind.as_str() {
            "star" => Ok(Self::Star(array(1)?, array(2)?, array(3)?)),
            "vector" => Ok(Self::Direction(array(1)?, array(2)?, array(3)?, array(4)?)),
            other => Err(input(item.py(), &format!("unknown kind of sensor {other:?}"))),
        }
    }
    fn series(&self) -> PyResult<AttitudeSensor<'_>> {
        Ok(match self {
            Self::Star(t, q, noise) => AttitudeSensor::Star(StarSeries {
                t: flat(t, "star time")?,
                q: rows(q, "star quaternions")?,
                noise: rows(noise, "star noise")?,
            }),
            Self::Direction(t, body, inertial, sigma) => AttitudeSensor::Direction(DirectionSeries {
                t: flat(t, "vector time")?,
                body: rows(body, "body vectors")?,
                inertial: rows(inertial, "inertial vectors")?,
                sigma: flat(sigma, "vector sigma")?,
            }),
        })
    }
}

/// How often Python hears of a run: often enough for Ctrl-C, seldom enough not to wait for other threads.
const POLL: Duration = Duration::from_millis(50);

#[pyfunction]
#[pyo3(signature = (gyro_t, gyro_rate, sensors, setup, start, bias0, bias_sigma, every, period, covariance, portable, progress))]
#[expect(clippy::too_many_arguments, reason = "called by the Python package alone, by keyword")]
fn replay<'py>(
    py: Python<'py>,
    gyro_t: Array<'py>,
    gyro_rate: Array<'py>,
    sensors: Vec<Bound<'py, PyTuple>>,
    setup: Setup,
    start: Option<(f64, [f64; 4], Array<'py>)>,
    bias0: [f64; 3],
    bias_sigma: [f64; 3],
    every: usize,
    period: Option<f64>,
    covariance: bool,
    portable: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (filter, model) = (setup.filter(py)?, setup.model(py)?);
    let gyro =
        GyroSeries { t: flat(&gyro_t, "gyro time")?, rate: rows(&gyro_rate, "gyro rates")?, timing: setup.timing(py)? };
    let borrowed = sensors.iter().map(Sensor::new).collect::<PyResult<Vec<_>>>()?;
    let series = borrowed.iter().map(Sensor::series).collect::<PyResult<Vec<_>>>()?;
    let given = match &start {
        Some((t, q, p)) => Some(Start {
            t: *t,
            mean: Attitude { q: *q, bias: bias0 },
            covariance: matrix6(p, "initial covariance")?,
            used: None,
        }),
        None => None,
    };
    let level = if portable { Level::Portable } else { Level::best() };
    let options = Options { output: period.map_or(Output::Every(every), Output::Period), level };
    let sensors = AttitudeSensors::new(&series, setup.gate).map_err(|e| raise(py, e))?;
    let start = match given {
        Some(start) => Ok(start),
        None => first_fix(&gyro, &sensors, &model, bias0, bias_sigma),
    }
    .map_err(|e| raise(py, e))?;
    let rows = rows_of(&gyro, &sensors, &start, options.output).map_err(|e| raise(py, e))?;

    let arrays = Arrays::new(py, rows, covariance).map_err(|e| {
        if !e.is_instance_of::<PyMemoryError>(py) {
            return e;
        }
        input(py, &format!("{} output rows do not fit into memory: ask for fewer, by every or period", rows.output))
    })?;
    let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
    let mut listener = Listener { progress, total: gyro.t.len(), heard: Instant::now(), stopped: None };
    let (end, elapsed) = arrays.write(|columns, measured| {
        let listener = &mut listener;
        py.detach(|| {
            let began = Instant::now();
            let mut poll = |k: usize| listener.poll(k);
            let end = run(&filter, log, &start, &options, columns, measured, &mut poll);
            (end, began.elapsed().as_secs_f64())
        })
    })?;
    if let Some(error) = listener.stopped {
        return Err(error);
    }
    let end = end.map_err(|e| raise(py, e))?;
    let out = arrays.into_dict(py)?;
    out.set_item("outside", end.outside)?;
    out.set_item("final_t", end.t)?;
    out.set_item("final_q", PyArray1::from_slice(py, &end.mean.q))?;
    out.set_item("final_bias", PyArray1::from_slice(py, &end.mean.bias))?;
    out.set_item("final_covariance", table(py, as_rows(&end.covariance))?)?;
    out.set_item("start_fix", start.used.map(|i| sensors.source(i)))?;
    out.set_item("elapsed_s", elapsed)?;
    Ok(out)
}

/// Lets Python handle Ctrl-C and hear of the progress while a run goes on without it.
struct Listener {
    progress: Option<Py<PyAny>>,
    total: usize,
    heard: Instant,
    stopped: Option<PyErr>,
}

impl Listener {
    fn poll(&mut self, done: usize) -> celestcore_core::Result<()> {
        if self.heard.elapsed() < POLL {
            return Ok(());
        }
        self.heard = Instant::now();
        let heard = Python::attach(|py| {
            py.check_signals()?;
            match &self.progress {
                Some(call) => call.call1(py, (done, self.total)).map(|_| ()),
                None => Ok(()),
            }
        });
        heard.map_err(|error| {
            self.stopped = Some(error);
            Error::Interrupted
        })
    }
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(replay, m)?)
}

//! A whole log in one call.

use crate::convert::{Array, as_rows, flat, matrix6, rows, table};
use crate::errors::{input, raise};
use crate::quaternions::integrator;
use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, Attitude, AttitudeSensor, AttitudeSensors, Columns, DirectionSeries, GyroModel, GyroSeries, GyroTiming,
    Log, Measured, Options, Sampling, StarSeries, first_fix, rows as rows_of, run,
};
use celestcore_core::filter::{Ekf, SrUkf, Ukf, Unscented};
use celestcore_core::replay::{MAX_DOF, Output, Start};
use celestcore_core::scalar::Level;
use numpy::{Element, PyArray1, PyArray2, PyArray3, PyArrayMethods};
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
    let arrays = sensors.iter().map(Sensor::new).collect::<PyResult<Vec<_>>>()?;
    let series = arrays.iter().map(Sensor::series).collect::<PyResult<Vec<_>>>()?;
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
        None => first_fix(&gyro, &sensors, bias0, bias_sigma),
    }
    .map_err(|e| raise(py, e))?;
    let rows = rows_of(&gyro, &sensors, &start, options.output).map_err(|e| raise(py, e))?;

    // numpy's own memory: the core writes where Python will read
    let [t, measurement_t, nis] = [rows.output, rows.measured, rows.measured].map(|n| column::<f64>(py, n));
    let [sensor, row, dof] = [(); 3].map(|()| column::<i32>(py, rows.measured));
    let accepted = column::<bool>(py, rows.measured);
    let [q, rate, bias, sigma] = [4, 3, 3, 6].map(|width| table_of(py, rows.output, width));
    let [innovation, innovation_sigma] = [(); 2].map(|()| table_of(py, rows.measured, MAX_DOF));
    let cov = PyArray3::<f64>::zeros(py, [if covariance { rows.output } else { 0 }, 6, 6], false);

    let total = gyro.t.len();
    let mut stopped: Option<PyErr> = None;
    let (end, elapsed) = {
        let (mut t, mut q, mut rate) = (t.try_readwrite()?, q.try_readwrite()?, rate.try_readwrite()?);
        let (mut bias, mut sigma, mut cov) = (bias.try_readwrite()?, sigma.try_readwrite()?, cov.try_readwrite()?);
        let columns = Columns {
            t: t.as_slice_mut()?,
            q: q.as_slice_mut()?.as_chunks_mut().0,
            rate: rate.as_slice_mut()?.as_chunks_mut().0,
            bias: bias.as_slice_mut()?.as_chunks_mut().0,
            sigma: sigma.as_slice_mut()?.as_chunks_mut().0,
            covariance: cov.as_slice_mut()?.as_chunks_mut().0.as_chunks_mut().0,
        };
        let (mut mt, mut ms, mut mr) = (measurement_t.try_readwrite()?, sensor.try_readwrite()?, row.try_readwrite()?);
        let (mut md, mut mn, mut ma) = (dof.try_readwrite()?, nis.try_readwrite()?, accepted.try_readwrite()?);
        let (mut mi, mut mis) = (innovation.try_readwrite()?, innovation_sigma.try_readwrite()?);
        let measured = Measured {
            t: mt.as_slice_mut()?,
            sensor: ms.as_slice_mut()?,
            row: mr.as_slice_mut()?,
            dof: md.as_slice_mut()?,
            nis: mn.as_slice_mut()?,
            accepted: ma.as_slice_mut()?,
            innovation: mi.as_slice_mut()?.as_chunks_mut().0,
            innovation_sigma: mis.as_slice_mut()?.as_chunks_mut().0,
        };
        let result = py.detach(|| {
            let began = Instant::now();
            let mut heard = began;
            let mut poll = |k: usize| {
                if heard.elapsed() < POLL {
                    return Ok(());
                }
                heard = Instant::now();
                tell(progress.as_ref(), k, total).map_err(|e| {
                    stopped = Some(e);
                    Error::Interrupted
                })
            };
            let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
            run(&filter, log, &start, &options, columns, measured, &mut poll)
                .map(|end| (end, began.elapsed().as_secs_f64()))
        });
        if let Some(error) = stopped {
            return Err(error);
        }
        result.map_err(|e| raise(py, e))?
    };

    let out = PyDict::new(py);
    out.set_item("t", t)?;
    out.set_item("q", q)?;
    out.set_item("rate", rate)?;
    out.set_item("bias", bias)?;
    out.set_item("sigma", sigma)?;
    out.set_item("covariance", cov)?;
    out.set_item("measurement_t", measurement_t)?;
    out.set_item("sensor", sensor)?;
    out.set_item("row", row)?;
    out.set_item("dof", dof)?;
    out.set_item("nis", nis)?;
    out.set_item("accepted", accepted)?;
    out.set_item("innovation", innovation)?;
    out.set_item("innovation_sigma", innovation_sigma)?;
    out.set_item("outside", end.outside)?;
    out.set_item("final_t", end.t)?;
    out.set_item("final_q", PyArray1::from_slice(py, &end.mean.q))?;
    out.set_item("final_bias", PyArray1::from_slice(py, &end.mean.bias))?;
    out.set_item("final_covariance", table(py, as_rows(&end.covariance))?)?;
    out.set_item("start_fix", start.used.map(|i| sensors.source(i)))?;
    out.set_item("elapsed_s", elapsed)?;
    Ok(out)
}

/// Lets Python handle Ctrl-C and hear of the progress.
fn tell(progress: Option<&Py<PyAny>>, done: usize, total: usize) -> PyResult<()> {
    Python::attach(|py| {
        py.check_signals()?;
        match progress {
            Some(call) => call.call1(py, (done, total)).map(|_| ()),
            None => Ok(()),
        }
    })
}

fn column<T: Element>(py: Python<'_>, n: usize) -> Bound<'_, PyArray1<T>> {
    PyArray1::zeros(py, n, false)
}

fn table_of(py: Python<'_>, n: usize, width: usize) -> Bound<'_, PyArray2<f64>> {
    PyArray2::zeros(py, [n, width], false)
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(replay, m)?)
}

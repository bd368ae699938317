//! A whole log in one call.

use crate::columns::{Reports, States};
use crate::convert::{Array, as_rows, flat, matrix_rows, matrix6, rows, table};
use crate::errors::{input, raise};
use crate::listener::Listener;
use crate::quaternions::integrator;
use celestcore_core::Error;
use celestcore_core::attitude::{
    AnyFilter, Attitude, AttitudeBias, AttitudeSensor, AttitudeSensors, CALIBRATION_PASSES, Calibration, Columns,
    DirectionSeries, FixNoise, GyroModel, GyroSeries, GyroTiming, Log, Measured, Options, Robust, Rows, Sampling,
    StarSeries, Trust, calibrate as run_calibration, first_fix, gap_limit, gaps, rows as rows_of, run, smooth,
};
use celestcore_core::filter::{Ekf, Iterated, SrUkf, Ukf, Unscented};
use celestcore_core::replay::{Output, Start};
use celestcore_core::scalar::Level;
use numpy::{PyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::time::Instant;

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
    reset: bool,
    #[pyo3(item)]
    iterations: usize,
    #[pyo3(item)]
    tolerance: f64,
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
    gate: f64,
    /// Kind and number: ("full", 0), ("huber", standard deviations), ("student_t", degrees of freedom).
    #[pyo3(item)]
    robust: (String, f64),
    /// How many measurements the noise is found from, if it is.
    #[pyo3(item)]
    adaptive: Option<f64>,
}

impl Setup {
    pub(crate) fn filter(&self, py: Python<'_>) -> PyResult<AnyFilter> {
        let weights = || {
            let w = Unscented::new(self.alpha, self.beta, self.kappa)?;
            w.check(6)?;
            Ok::<_, Error>(w)
        };
        match self.filter.as_str() {
            "ekf" => Ok(AnyFilter::Ekf(Ekf { reset: self.reset })),
            "ukf" => Ok(AnyFilter::Ukf(Ukf { weights: weights().map_err(|e| raise(py, e))? })),
            "srukf" => Ok(AnyFilter::SrUkf(weights().and_then(SrUkf::new).map_err(|e| raise(py, e))?)),
            "iterated" => Ok(AnyFilter::Iterated(Iterated { iterations: self.iterations, tolerance: self.tolerance })),
            "invariant" => Ok(AnyFilter::Invariant),
            "literal" => Ok(AnyFilter::Literal(Ukf { weights: weights().map_err(|e| raise(py, e))? })),
            other => Err(input(py, &format!("filter = {other:?}: is not known"))),
        }
    }
    pub(crate) fn trust(&self, py: Python<'_>) -> PyResult<Trust> {
        let robust = match self.robust.0.as_str() {
            "full" => Robust::Full,
            "huber" => Robust::Huber(self.robust.1),
            "student_t" => Robust::StudentT(self.robust.1),
            other => return Err(input(py, &format!("robust = {other:?}: is not known"))),
        };
        Ok(Trust { gate: self.gate, robust, memory: self.adaptive })
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

/// One sensor's arrays, borrowed from Python for the time of a run, and how it is mounted.
pub(crate) enum Sensor<'py> {
    Star(Array<'py>, Array<'py>, Array<'py>, Option<[f64; 4]>),
    Direction(Array<'py>, Array<'py>, Array<'py>, Array<'py>, Option<[f64; 9]>),
}

impl<'py> Sensor<'py> {
    pub(crate) fn new(item: &Bound<'py, PyTuple>) -> PyResult<Self> {
        let kind: String = item.get_item(0)?.extract()?;
        let array = |i: usize| item.get_item(i)?.extract::<Array<'py>>();
        match kind.as_str() {
            "star" => Ok(Self::Star(array(1)?, array(2)?, array(3)?, item.get_item(4)?.extract()?)),
            "vector" => Ok(Self::Direction(array(1)?, array(2)?, array(3)?, array(4)?, item.get_item(5)?.extract()?)),
            other => Err(input(item.py(), &format!("unknown kind of sensor {other:?}"))),
        }
    }
    pub(crate) fn series(&self) -> PyResult<AttitudeSensor<'_>> {
        Ok(match self {
            Self::Star(t, q, noise, mounting) => AttitudeSensor::Star(StarSeries {
                t: flat(t, "star time")?,
                q: rows(q, "star quaternions")?,
                noise: fix_noise(noise)?,
                mounting: *mounting,
            }),
            Self::Direction(t, body, inertial, sigma, turn) => AttitudeSensor::Direction(DirectionSeries {
                t: flat(t, "vector time")?,
                body: rows(body, "body vectors")?,
                inertial: rows(inertial, "inertial vectors")?,
                sigma: flat(sigma, "vector sigma")?,
                turn: *turn,
            }),
        })
    }
}

/// Noise by its shape: (6,) for all fixes in the body frame; (n, 3) or (n, 3, 3) for each in the camera's.
fn fix_noise<'a>(a: &'a Array<'_>) -> PyResult<FixNoise<'a>> {
    match a.shape().len() {
        1 => match rows::<6>(a, "star noise")? {
            [same] => Ok(FixNoise::Same(*same)),
            _ => Err(input(a.py(), "star noise that is the same for all fixes needs 6 entries")),
        },
        2 => Ok(FixNoise::Sigma(rows(a, "star sigma")?)),
        _ => Ok(FixNoise::Covariance(matrix_rows(a, "star covariance")?)),
    }
}

/// What a run starts from as Python gives it.
type Given<'py> = Option<(f64, [f64; 4], Array<'py>)>;

/// A log and how to start on it.
#[derive(FromPyObject)]
pub(crate) struct Replayed<'py> {
    #[pyo3(item)]
    pub(crate) gyro_t: Array<'py>,
    #[pyo3(item)]
    pub(crate) gyro_rate: Array<'py>,
    #[pyo3(item)]
    gyro_turn: Option<[f64; 9]>,
    #[pyo3(item)]
    pub(crate) sensors: Vec<Bound<'py, PyTuple>>,
    #[pyo3(item)]
    pub(crate) setup: Setup,
    #[pyo3(item)]
    start: Given<'py>,
    #[pyo3(item)]
    bias0: [f64; 3],
    #[pyo3(item)]
    bias_sigma: [f64; 3],
    #[pyo3(item)]
    every: usize,
    #[pyo3(item)]
    period: Option<f64>,
    #[pyo3(item)]
    pub(crate) covariance: bool,
    #[pyo3(item)]
    pub(crate) innovations: String,
    #[pyo3(item)]
    portable: bool,
    /// What each sensor's noise is multiplied by at the start.
    #[pyo3(item)]
    pub(crate) noise_scale: Vec<f64>,
    #[pyo3(item)]
    pub(crate) progress: Option<Py<PyAny>>,
}

impl<'py> Replayed<'py> {
    pub(crate) fn options(&self) -> Options {
        let level = if self.portable { Level::Portable } else { Level::best() };
        Options { output: self.period.map_or(Output::Every(self.every), Output::Period), level }
    }

    pub(crate) fn gyro(&self, timing: GyroTiming) -> PyResult<GyroSeries<'_>> {
        let (t, rate) = (flat(&self.gyro_t, "gyro time")?, rows(&self.gyro_rate, "gyro rates")?);
        Ok(GyroSeries { t, rate, turn: self.gyro_turn, timing })
    }

    /// Memory for the rows, of what is to be kept.
    fn arrays(&self, py: Python<'py>, rows: Rows) -> PyResult<(States<'py>, Reports<'py>)> {
        let (reports, innovations) = match self.innovations.as_str() {
            "full" => (rows.measured, rows.measured),
            "nis" => (rows.measured, 0),
            _ => (0, 0),
        };
        let both = |rows: Rows| {
            let states = States::new(py, rows.output, self.covariance)?;
            Ok((states, Reports::new(py, reports, innovations)?))
        };
        both(rows).map_err(|e: PyErr| {
            if !e.is_instance_of::<PyMemoryError>(py) {
                return e;
            }
            let message = "output rows do not fit into memory: ask for fewer, by every or period";
            input(py, &format!("{} {message}", rows.output))
        })
    }

    /// Calls `job` with all that it needs while other Python threads run, and returns what it has written
    /// and computed.
    fn call<R: Send>(
        &self,
        py: Python<'py>,
        passes: usize,
        aligned: Option<usize>,
        job: impl Send + FnOnce(Log<'_>, &Begin, &Options, Columns<'_>, Measured<'_>, Poll<'_>) -> Result<R, Error>,
    ) -> PyResult<(Bound<'py, PyDict>, R)> {
        let model = self.setup.model(py)?;
        let gyro = self.gyro(self.setup.timing(py)?)?;
        let borrowed = self.sensors.iter().map(Sensor::new).collect::<PyResult<Vec<_>>>()?;
        let series = borrowed.iter().map(Sensor::series).collect::<PyResult<Vec<_>>>()?;
        let sensors = AttitudeSensors::new(&series, self.setup.trust(py)?).map_err(|e| raise(py, e))?;
        let start = self.begin(py, &gyro, &sensors, &model, aligned)?;
        let options = self.options();
        let rows = rows_of(&gyro, &sensors, &start, options.output).map_err(|e| raise(py, e))?;
        let (states, reports) = self.arrays(py, rows)?;
        let log = Log { model: &model, gyro: &gyro, sensors: &sensors };
        let progress = self.progress.as_ref().map(|p| p.clone_ref(py));
        let mut listener = Listener::new(progress, passes * gyro.t.len());
        let mut scale = self.noise_scale.clone();
        let written = states.write(|columns| {
            reports.write(|measured| {
                let measured = Measured { scale: &mut scale, ..measured };
                let listener = &mut listener;
                py.detach(|| {
                    let began = Instant::now();
                    let mut poll = |k: usize| listener.poll(k);
                    let end = job(log, &start, &options, columns, measured, &mut poll);
                    (end, began.elapsed().as_secs_f64())
                })
            })
        })?;
        let ((end, elapsed), tally) = written?;
        listener.finish()?;
        let end = end.map_err(|e| raise(py, e))?;
        let out = PyDict::new(py);
        states.into_dict(&out)?;
        reports.into_dict(&out)?;
        out.set_item("tally", (tally.accepted, tally.rejected, tally.unused))?;
        out.set_item("gaps", table(py, gaps(gyro.t, gyro.timing.max_gap))?)?;
        out.set_item("start_fix", start.used.map(|i| sensors.source(i)))?;
        out.set_item("noise_scale", scale)?;
        out.set_item("elapsed_s", elapsed)?;
        Ok((out, end))
    }

    pub(crate) fn begin(
        &self,
        py: Python<'py>,
        gyro: &GyroSeries<'_>,
        sensors: &AttitudeSensors<'_>,
        model: &GyroModel,
        aligned: Option<usize>,
    ) -> PyResult<Begin> {
        let start = match &self.start {
            Some((t, q, p)) => Start {
                t: *t,
                mean: Attitude { q: *q, bias: self.bias0 },
                covariance: matrix6(p, "initial covariance")?,
                used: None,
            },
            None => {
                // a camera whose alignment is not known tells no attitude to start from
                let known = sensors.without(aligned).map_err(|e| raise(py, e))?;
                let mut start =
                    first_fix(gyro, &known, model, self.bias0, self.bias_sigma).map_err(|e| raise(py, e))?;
                start.used = start.used.and_then(|i| sensors.find(known.source(i)));
                start
            }
        };
        Ok(start)
    }
}

pub(crate) type Begin = Start<AttitudeBias, 6>;
type Poll<'a> = &'a mut dyn FnMut(usize) -> Result<(), Error>;

/// A whole log, forward, or forward and back.
#[pyfunction]
fn replay<'py>(py: Python<'py>, log: Replayed<'py>, smoothed: bool) -> PyResult<Bound<'py, PyDict>> {
    let filter = log.setup.filter(py)?;
    let (out, end) =
        log.call(py, 1 + usize::from(smoothed), None, |log, start, options, columns, measured, poll| {
            let call = if smoothed { smooth } else { run };
            call(&filter, log, start, options, columns, measured, poll)
        })?;
    finish(py, &out, (end.t, end.outside, end.log_likelihood), &end.mean)?;
    out.set_item("final_covariance", table(py, as_rows(&end.covariance))?)?;
    Ok(out)
}

/// A whole log by the filter that also estimates the gyro's and a camera's calibration. `aligned` is the
/// number of that camera, `prior` the 1-sigma of scale factors, misalignments and alignment.
#[pyfunction]
fn calibrate<'py>(
    py: Python<'py>,
    log: Replayed<'py>,
    aligned: Option<usize>,
    prior: [f64; 3],
) -> PyResult<Bound<'py, PyDict>> {
    let calibration = Calibration { model: log.setup.model(py)?, aligned, prior };
    let (out, end) = log.call(py, CALIBRATION_PASSES, aligned, |log, start, options, columns, measured, poll| {
        run_calibration(&calibration, log, start, options, columns, measured, poll)
    })?;
    let mean = Attitude { q: end.mean.q, bias: end.mean.bias };
    finish(py, &out, (end.t, end.outside, end.log_likelihood), &mean)?;
    let attitude = end.covariance.fixed_view::<6, 6>(0, 0).into_owned();
    out.set_item("final_covariance", table(py, as_rows(&attitude))?)?;
    out.set_item("full_covariance", table(py, as_rows(&end.covariance))?)?;
    out.set_item("gyro_errors", PyArray1::from_slice(py, &end.mean.gyro))?;
    out.set_item("alignment", PyArray1::from_slice(py, &end.mean.alignment))?;
    out.set_item("prior_sigma", PyArray1::from_slice(py, &calibration.prior_sigma()))?;
    Ok(out)
}

pub(crate) fn finish(
    py: Python<'_>,
    out: &Bound<'_, PyDict>,
    (t, outside, log_likelihood): (f64, usize, f64),
    mean: &Attitude<f64>,
) -> PyResult<()> {
    out.set_item("outside", outside)?;
    out.set_item("log_likelihood", log_likelihood)?;
    out.set_item("final_t", t)?;
    out.set_item("final_q", PyArray1::from_slice(py, &mean.q))?;
    out.set_item("final_bias", PyArray1::from_slice(py, &mean.bias))
}

/// Longest step between times that is no gap: so many median steps; infinity where none is longer.
#[pyfunction]
fn longest_step(t: Array<'_>, medians: f64) -> PyResult<f64> {
    Ok(gap_limit(flat(&t, "time")?, medians))
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(replay, m)?)?;
    m.add_function(wrap_pyfunction!(longest_step, m)?)?;
    m.add_function(wrap_pyfunction!(calibrate, m)?)
}

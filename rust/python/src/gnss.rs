//! Orbits from a receiver's fixes and attitudes from star fixes.

use crate::convert::{Array, flat, rows, table};
use crate::errors::{input, raise};
use crate::listener::Listener;
use crate::orbit::force;
use celestcore_core::Error;
use celestcore_core::attitude::{GyroModel, PointingModel};
use celestcore_core::augmented::Fading;
use celestcore_core::filter::{Ekf, Ukf, Unscented};
use celestcore_core::gnss::{
    AttitudeFixes, AttitudeJob, AttitudeModel, AxisFixes, Ended, History, Options, OrbitFilter, OrbitFixes, OrbitJob,
    Stops, attitude, axis, orbit,
};
use celestcore_core::linalg::from_fn;
use celestcore_core::orbit::OrbitModel;
use celestcore_core::quaternion::Integrator;
use celestcore_core::scalar::Level;
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

type Flags<'py> = PyReadonlyArray1<'py, bool>;
/// Times at which a run stops, which of them are written, and a gyro's rates between them.
type StopColumns<'py> = (Array<'py>, Flags<'py>, Option<Array<'py>>);
/// Time, state and covariance, each as plain numbers.
type Begin<'py> = (f64, Array<'py>, Array<'py>);

fn flags<'a>(a: &'a Flags<'_>, name: &str) -> PyResult<&'a [bool]> {
    a.as_slice().map_err(|_| input(a.py(), &format!("{name} must be contiguous")))
}

fn stops<'a>(columns: &'a StopColumns<'_>) -> PyResult<Stops<'a>> {
    let gyro = columns.2.as_ref().map_or(Ok(&[][..]), |g| rows::<4>(g, "gyro"))?;
    Ok(Stops { t: flat(&columns.0, "t")?, wanted: flags(&columns.1, "wanted")?, gyro })
}

fn options(gate: f64, back: bool, portable: bool) -> Options {
    Options { gate, back, level: if portable { Level::Portable } else { Level::best() } }
}

/// Runs without Python's lock, listens to Python now and then, and returns the columns by name.
fn ran<'py>(
    py: Python<'py>,
    covariance: bool,
    mut listener: Listener,
    job: impl FnOnce(&mut History, &mut dyn FnMut(usize) -> celestcore_core::Result<()>) -> celestcore_core::Result<Ended>
    + Send,
) -> PyResult<Bound<'py, PyDict>> {
    let mut history = History { with_covariance: covariance, ..History::default() };
    let began = Instant::now();
    let end = py.detach(|| job(&mut history, &mut |k| listener.poll(k)));
    let elapsed = began.elapsed().as_secs_f64();
    listener.finish()?;
    let end = end.map_err(|e| raise(py, e))?;
    let out = PyDict::new(py);
    let n = history.t.len();
    let wide = |column: Vec<f64>| -> PyResult<Bound<'py, PyAny>> {
        let width = column.len().checked_div(n).unwrap_or(0);
        Ok(PyArray1::from_vec(py, column).reshape([n, width])?.into_any())
    };
    out.set_item("t", PyArray1::from_vec(py, history.t))?;
    out.set_item("state", wide(history.state)?)?;
    out.set_item("sigma", wide(history.sigma)?)?;
    if covariance {
        out.set_item("covariance", wide(history.covariance)?)?;
    }
    out.set_item("row", PyArray1::from_vec(py, history.row))?;
    out.set_item("nis", PyArray1::from_vec(py, history.nis))?;
    out.set_item("accepted", PyArray1::from_vec(py, history.accepted))?;
    out.set_item("innovation", table(py, history.innovation)?)?;
    out.set_item("innovation_sigma", table(py, history.innovation_sigma)?)?;
    out.set_item("outside", end.outside)?;
    out.set_item("log_likelihood", end.log_likelihood)?;
    out.set_item("final_t", end.t)?;
    out.set_item("final_state", PyArray1::from_vec(py, end.state))?;
    out.set_item("final_covariance", PyArray1::from_vec(py, end.covariance))?;
    out.set_item("elapsed_s", elapsed)?;
    Ok(out)
}

/// A filter of orbits: made once, so that what it reads of the Earth is, too.
#[pyclass(module = "celestcore._core", frozen)]
struct GnssOrbit {
    filter: OrbitFilter,
    dynamics: OrbitModel,
    bias: Option<Fading>,
}

#[pymethods]
impl GnssOrbit {
    /// `weights` is alpha, beta and kappa of sigma points; `bias` the sigma [m] and the correlation time [s] of the
    /// receiver's bias.
    #[new]
    #[pyo3(signature = (filter, weights, forces, tables, accel_psd, max_step, bias))]
    #[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
    fn new(
        py: Python<'_>,
        filter: &str,
        weights: (f64, f64, Option<f64>),
        forces: &Bound<'_, PyDict>,
        tables: Option<&Bound<'_, PyDict>>,
        accel_psd: f64,
        max_step: f64,
        bias: Option<(f64, f64)>,
    ) -> PyResult<Self> {
        let bias = bias.map(|(sigma, tau)| Fading { rate: 1.0 / tau, sigma });
        let points = || {
            let w = Unscented::new(weights.0, weights.1, weights.2)?;
            w.check(if bias.is_some() { 9 } else { 6 })?;
            Ok::<_, Error>(w)
        };
        let filter = match filter {
            "ekf" => Ok(OrbitFilter::Ekf(Ekf::default())),
            "ukf" => points().map(|weights| OrbitFilter::Ukf(Ukf { weights })),
            other => return Err(input(py, &format!("filter = {other:?}: does not estimate orbits from fixes"))),
        }
        .map_err(|e| raise(py, e))?;
        let forces = force(forces, tables)?;
        let dynamics = OrbitModel::new(forces, accel_psd, max_step).map_err(|e| raise(py, e))?;
        Ok(Self { filter, dynamics, bias })
    }

    /// Orbit over a log; `fixes` is times, whether each is a velocity, values and covariances.
    #[pyo3(signature = (stop, fixes, start, gate, back, covariance, portable, progress))]
    #[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
    fn run<'py>(
        &self,
        py: Python<'py>,
        stop: StopColumns<'py>,
        fixes: (Array<'py>, Flags<'py>, Array<'py>, Array<'py>),
        start: Begin<'py>,
        gate: f64,
        back: bool,
        covariance: bool,
        portable: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let stops = stops(&stop)?;
        let job = OrbitJob {
            filter: self.filter,
            dynamics: &self.dynamics,
            bias: self.bias,
            stops,
            fixes: OrbitFixes {
                t: flat(&fixes.0, "gnss.t")?,
                velocity: flags(&fixes.1, "gnss.velocity")?,
                value: rows(&fixes.2, "gnss.value")?,
                noise: rows(&fixes.3, "gnss.noise")?,
            },
            options: options(gate, back, portable),
        };
        let start = (start.0, flat(&start.1, "start.state")?, flat(&start.2, "start.covariance")?);
        let listener = Listener::new(progress, stops.t.len() * if back { 2 } else { 1 });
        ran(py, covariance, listener, |history, poll| orbit(job, start, history, poll))
    }
}

/// A filter of attitudes with the slow error of a star sensor.
#[pyclass(module = "celestcore._core", frozen)]
struct GnssAttitude {
    model: AttitudeModel,
    tail: Vec<Fading>,
}

#[pymethods]
impl GnssAttitude {
    /// Either `jerk_psd`, or `gyro`: ARW, RRW and whether RK4 turns the quaternion. `tail` is the sigma [rad] and the
    /// rate [1/s] at which each vector of the slow error fades.
    #[new]
    #[pyo3(signature = (jerk_psd, gyro, tail))]
    fn new(
        py: Python<'_>,
        jerk_psd: Option<f64>,
        gyro: Option<(f64, f64, bool)>,
        tail: Vec<(f64, f64)>,
    ) -> PyResult<Self> {
        let model = match (jerk_psd, gyro) {
            (Some(q), None) => PointingModel::new(q).map(AttitudeModel::Kinematic),
            (None, Some((arw, rrw, rk4))) => {
                let integrator = if rk4 { Integrator::Rk4 } else { Integrator::Exponential };
                GyroModel::new(arw, rrw, integrator).map(AttitudeModel::Gyro)
            }
            _ => return Err(input(py, "either jerk_psd or gyro")),
        };
        let tail = tail.into_iter().map(|(sigma, rate)| Fading { rate, sigma }).collect();
        Ok(Self { model: model.map_err(|e| raise(py, e))?, tail })
    }

    /// Attitude over a log; `fixes` is times, quaternions, covariances and weights.
    #[pyo3(signature = (stop, fixes, start, gate, back, covariance, portable, progress))]
    #[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
    fn run<'py>(
        &self,
        py: Python<'py>,
        stop: StopColumns<'py>,
        fixes: (Array<'py>, Array<'py>, Array<'py>, Array<'py>),
        start: Begin<'py>,
        gate: f64,
        back: bool,
        covariance: bool,
        portable: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let stops = stops(&stop)?;
        let job = AttitudeJob {
            model: self.model,
            tail: &self.tail,
            stops,
            fixes: AttitudeFixes {
                t: flat(&fixes.0, "star.t")?,
                q: rows(&fixes.1, "star.q")?,
                noise: rows(&fixes.2, "star.noise")?,
                weights: flat(&fixes.3, "star.weights")?,
            },
            options: options(gate, back, portable),
        };
        let start = (start.0, flat(&start.1, "start.state")?, flat(&start.2, "start.covariance")?);
        let listener = Listener::new(progress, stops.t.len() * if back { 2 } else { 1 });
        ran(py, covariance, listener, |history, poll| attitude(job, start, history, poll))
    }
}

/// A coordinate with its rate and acceleration; `fixes` is times, whether each is the rate, values and variances.
#[pyfunction]
#[pyo3(signature = (jerk_psd, stop, fixes, start, wraps, back))]
fn gnss_axis<'py>(
    py: Python<'py>,
    jerk_psd: f64,
    stop: StopColumns<'py>,
    fixes: (Array<'py>, Flags<'py>, Array<'py>, Array<'py>),
    start: (f64, [f64; 3], [[f64; 3]; 3]),
    wraps: bool,
    back: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let stops = stops(&stop)?;
    let columns = AxisFixes {
        t: flat(&fixes.0, "axis.t")?,
        rate: flags(&fixes.1, "axis.rate")?,
        value: flat(&fixes.2, "axis.value")?,
        variance: flat(&fixes.3, "axis.variance")?,
        wraps,
    };
    let begin = (start.0, start.1, from_fn(|i, j| start.2[i][j]));
    let how = options(1.0, back, false);
    ran(py, false, Listener::new(None, stops.t.len()), |history, _| {
        axis(jerk_psd, begin, stops, columns, &how, history)
    })
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<GnssOrbit>()?;
    m.add_class::<GnssAttitude>()?;
    m.add_function(wrap_pyfunction!(gnss_axis, m)?)
}

//! Many trials in one call.

use crate::convert::{Array, matrix6, table};
use crate::errors::raise;
use crate::listener::Listener;
use crate::replay::Setup;
use crate::simulate::{Flight, check_trials, matrix};
use celestcore_core::scalar::Level;
use celestcore_core::simulate::{Begin, Campaign, Estimator, KnownCamera, Score, Scored, monte_carlo as run};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// An estimator as the Python package describes it.
#[derive(FromPyObject)]
struct Described<'py> {
    #[pyo3(item)]
    setup: Setup,
    #[pyo3(item)]
    gyro_turn: Option<[[f64; 3]; 3]>,
    #[pyo3(item)]
    cameras: Vec<(Option<[f64; 4]>, [f64; 6])>,
    #[pyo3(item)]
    covariance0: Option<Array<'py>>,
    #[pyo3(item)]
    bias_sigma: [f64; 3],
    #[pyo3(item)]
    smooth: bool,
}

impl Described<'_> {
    fn estimator(&self, py: Python<'_>) -> PyResult<Estimator> {
        let begin = match &self.covariance0 {
            Some(p) => Begin::Drawn(Box::new(matrix6(p, "initial covariance")?)),
            None => Begin::FirstFix(self.bias_sigma),
        };
        Ok(Estimator {
            filter: self.setup.filter(py)?,
            model: self.setup.model(py)?,
            timing: self.setup.timing(py)?,
            trust: self.setup.trust(py)?,
            gyro_turn: self.gyro_turn.as_ref().map(matrix),
            cameras: self
                .cameras
                .iter()
                .map(|(mounting, noise)| KnownCamera { mounting: *mounting, noise: *noise })
                .collect(),
            begin,
            smooth: self.smooth,
        })
    }
}

/// Scores of trials `first`, `first + 1` … for each estimator.
#[pyfunction]
#[pyo3(signature = (flight, estimators, seed, first, count, skip, threads, portable, progress))]
#[expect(clippy::too_many_arguments, reason = "called by the Python package alone, by keyword")]
fn monte_carlo<'py>(
    py: Python<'py>,
    flight: Flight<'py>,
    estimators: Vec<Described<'py>>,
    seed: u64,
    first: u64,
    count: u64,
    skip: f64,
    threads: usize,
    portable: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    check_trials(py, first, count)?;
    let estimators = estimators.iter().map(|e| e.estimator(py)).collect::<PyResult<Vec<_>>>()?;
    let level = if portable { Level::Portable } else { Level::best() };
    let campaign =
        Campaign { scenario: flight.scenario()?, estimators, seed, trials: first..first + count, skip, level };
    let mut listener = Listener::new(progress, count as usize);
    let done = py.detach(|| run(&campaign, threads, &mut |done| listener.poll(done)));
    listener.finish()?;
    let done = done.map_err(|e| raise(py, e))?;
    (0..campaign.estimators.len()).map(|e| columns(py, done.iter().map(|trial| &trial[e]))).collect()
}

/// A part of a score by name.
type Named<T> = (&'static str, fn(&Score) -> T);

/// One estimator's scores as arrays with the trial first; not a number where the filter broke down.
fn columns<'py, 'a>(py: Python<'py>, scored: impl Iterator<Item = &'a Scored>) -> PyResult<Bound<'py, PyDict>> {
    let scored: Vec<&Scored> = scored.collect();
    let out = PyDict::new(py);
    let vectors: [Named<[f64; 3]>; 4] = [
        ("rms", |s| s.rms),
        ("rms_all", |s| s.rms_all),
        ("rms_before", |s| s.rms_before),
        ("rms_bias", |s| s.rms_bias),
    ];
    for (name, get) in vectors {
        let rows = scored.iter().map(|s| s.as_ref().map_or([f64::NAN; 3], get)).collect();
        out.set_item(name, table(py, rows)?)?;
    }
    let numbers: [Named<f64>; 5] = [
        ("nees_attitude", |s| s.nees_attitude),
        ("nees", |s| s.nees),
        ("nis", |s| s.nis),
        ("accepted", |s| s.accepted),
        ("seconds", |s| s.seconds),
    ];
    for (name, get) in numbers {
        let values = scored.iter().map(|s| s.as_ref().map_or(f64::NAN, get));
        out.set_item(name, PyArray1::from_iter(py, values))?;
    }
    let last = scored.iter().map(|s| s.as_ref().map_or([f64::NAN; 6], |s| s.final_error)).collect();
    out.set_item("final_error", table(py, last)?)?;
    let failed: Vec<(usize, String)> =
        scored.iter().enumerate().filter_map(|(i, s)| s.as_ref().err().map(|e| (i, e.to_string()))).collect();
    out.set_item("failures", failed)?;
    Ok(out)
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(monte_carlo, m)?)
}

//! Simulated readings of one trial.

use crate::convert::{Array, flat, rows, table};
use crate::errors::input;
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::simulate::{GyroErrors, MAX_TRIAL, Readings, Scenario, StarNoise, Truth, channel};
use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;

/// A gyro's errors as the Python package describes them.
#[derive(FromPyObject)]
struct Errors {
    #[pyo3(item)]
    arw: [f64; 3],
    #[pyo3(item)]
    rrw: [f64; 3],
    #[pyo3(item)]
    bias: [f64; 3],
    #[pyo3(item)]
    bias_sigma: [f64; 3],
    #[pyo3(item)]
    markov_sigma: [f64; 3],
    #[pyo3(item)]
    markov_time: f64,
    #[pyo3(item)]
    response: [[f64; 3]; 3],
    #[pyo3(item)]
    quantisation: f64,
    #[pyo3(item)]
    mounting: Option<[f64; 4]>,
}

/// A star camera: times, true attitudes, mounting, root of the covariance.
type Camera<'py> = (Array<'py>, Array<'py>, Option<[f64; 4]>, [[f64; 3]; 3]);

/// A scenario's arrays, borrowed from Python.
#[derive(FromPyObject)]
pub(crate) struct Flight<'py> {
    #[pyo3(item)]
    t: Array<'py>,
    #[pyo3(item)]
    q: Array<'py>,
    #[pyo3(item)]
    rate: Array<'py>,
    #[pyo3(item)]
    gyro: Errors,
    #[pyo3(item)]
    cameras: Vec<Camera<'py>>,
}

pub(crate) fn matrix(m: &[[f64; 3]; 3]) -> Matrix<f64, 3, 3> {
    from_fn(|i, j| m[i][j])
}

impl Flight<'_> {
    pub(crate) fn scenario(&self) -> PyResult<Scenario<'_>> {
        let g = &self.gyro;
        let t = flat(&self.t, "truth.t")?;
        let truth = Truth { t, q: rows(&self.q, "truth.q")?, rate: rows(&self.rate, "truth.rate")? };
        let same = |name: &str, found: usize, needed: usize| {
            let message = || format!("{name} has {found} rows, but {needed} are needed");
            if found == needed { Ok(()) } else { Err(input(self.t.py(), &message())) }
        };
        same("truth.q", truth.q.len(), t.len())?;
        same("truth.rate", truth.rate.len(), t.len())?;
        let gyro = GyroErrors {
            arw: g.arw,
            rrw: g.rrw,
            bias: g.bias,
            bias_sigma: g.bias_sigma,
            markov_sigma: g.markov_sigma,
            markov_time: g.markov_time,
            response: matrix(&g.response),
            quantisation: g.quantisation,
            mounting: g.mounting,
        };
        if self.cameras.len() > channel::STARS {
            let message = format!("{} star cameras are too many: {} at most", self.cameras.len(), channel::STARS);
            return Err(input(self.t.py(), &message));
        }
        let mut cameras = Vec::with_capacity(self.cameras.len());
        for (t, q, mounting, root) in &self.cameras {
            same("star.q", q.len() / 4, t.len())?;
            let (t, q) = (flat(t, "star.t")?, rows(q, "star.q")?);
            cameras.push(StarNoise { t, q, mounting: *mounting, root: matrix(root) });
        }
        Ok(Scenario { truth, gyro, cameras })
    }
}

/// Numbers of trials that have random numbers of their own.
pub(crate) fn check_trials(py: Python<'_>, first: u64, count: u64) -> PyResult<()> {
    if first.checked_add(count).is_some_and(|end| end <= MAX_TRIAL) {
        return Ok(());
    }
    Err(input(py, &format!("trials {first} to {first} + {count}: there are 2**56, counted from 0")))
}

/// Rates, biases, and the fixes of each camera.
type Made<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Vec<Bound<'py, PyAny>>);

/// Readings of one trial: rates, biases and the fixes of each camera.
#[pyfunction]
fn simulate<'py>(py: Python<'py>, flight: Flight<'py>, seed: u64, trial: u64) -> PyResult<Made<'py>> {
    check_trials(py, trial, 1)?;
    let scenario = flight.scenario()?;
    let mut out = Readings::default();
    py.detach(|| scenario.simulate(seed, trial, &mut out));
    let fixes = out.fixes.into_iter().map(|q| table(py, q)).collect::<PyResult<_>>()?;
    Ok((table(py, out.rate)?, table(py, out.bias)?, fixes))
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(simulate, m)?)
}

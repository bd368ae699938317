//! Simulated readings of one trial.

use crate::camera::{Optics, camera, catalogue};
use crate::convert::{Array, flat, matrices, rows, table};
use crate::errors::{input, raise};
use crate::listener::Listener;
use celestcore_core::attitude::camera::Catalogue;
use celestcore_core::linalg::{Matrix, from_fn};
use celestcore_core::simulate::{
    Fixes, GyroErrors, MAX_TRIAL, Readings, Scenario, StarField, StarNoise, StarSource, Truth, channel,
};
use numpy::{PyArray1, PyUntypedArrayMethods};
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

/// What makes the fixes of a star camera.
#[derive(FromPyObject)]
enum Source<'py> {
    /// Noise: a root of its covariance.
    Noise([[f64; 3]; 3]),
    /// Stars: directions, magnitudes, the camera and its outline, and its name.
    Field(Array<'py>, Array<'py>, Optics, String, String),
}

/// A star camera: times, true attitudes, mounting, what makes the fixes.
type Camera<'py> = (Array<'py>, Array<'py>, Option<[f64; 4]>, Source<'py>);

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
        for (t, q, mounting, source) in &self.cameras {
            same("star.q", q.len() / 4, t.len())?;
            let (t, q, mounting) = (flat(t, "star.t")?, rows(q, "star.q")?, *mounting);
            cameras.push(match source {
                Source::Noise(root) => StarSource::Noise(StarNoise { t, q, mounting, root: matrix(root) }),
                Source::Field(directions, magnitudes, optics, shape, name) => {
                    let stars = catalogue(directions, magnitudes)?;
                    StarSource::Field(field(self.t.py(), (t, q), mounting, &stars, (*optics, shape, name))?)
                }
            });
        }
        Ok(Scenario { truth, gyro, cameras })
    }
}

/// The frames of a physical camera. Finding the stars may take seconds: Ctrl-C is heard.
fn field<'a>(
    py: Python<'_>,
    frames: (&'a [f64], &'a [[f64; 4]]),
    mounting: Option<[f64; 4]>,
    stars: &Catalogue,
    (optics, shape, name): (Optics, &str, &str),
) -> PyResult<StarField<'a>> {
    let camera = camera(py, optics, shape)?;
    let look = || Python::attach(|py| py.check_signals());
    let field = py.detach(|| StarField::new(frames, mounting, camera, stars, look))?;
    if field.view.most() < 2 {
        let message = format!(
            "{name}: the camera sees fewer than two stars in all of its {} frames, so it has no fix; a wider \
             field, fainter stars or another boresight may help",
            field.view.len()
        );
        return Err(input(py, &message));
    }
    Ok(field)
}

/// Numbers of trials that have random numbers of their own.
pub(crate) fn check_trials(py: Python<'_>, first: u64, count: u64) -> PyResult<()> {
    if first.checked_add(count).is_some_and(|end| end <= MAX_TRIAL) {
        return Ok(());
    }
    Err(input(py, &format!("trials {first} to {first} + {count}: there are 2**56, counted from 0")))
}

/// Fixes of a camera; of a physical one also their frames and covariances in the camera frame.
type Fixed<'py> = (Bound<'py, PyAny>, Option<(Bound<'py, PyAny>, Bound<'py, PyAny>)>);
/// Rates, biases, and the fixes of each camera.
type Made<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Vec<Fixed<'py>>);

fn fixed<'py>(py: Python<'py>, source: &StarSource<'_>, fixes: Fixes) -> PyResult<Fixed<'py>> {
    let own = match source {
        StarSource::Noise(_) => None,
        StarSource::Field(_) => {
            let frame = PyArray1::from_iter(py, fixes.frame.iter().map(|k| *k as i64)).into_any();
            let p = fixes.covariance.iter().map(|p| std::array::from_fn(|i| std::array::from_fn(|j| p[(i, j)])));
            Some((frame, matrices::<3, 3>(py, p.collect())?))
        }
    };
    Ok((table(py, fixes.q)?, own))
}

/// Readings of one trial: rates, biases and the fixes of each camera.
#[pyfunction]
fn simulate<'py>(py: Python<'py>, flight: Flight<'py>, seed: u64, trial: u64) -> PyResult<Made<'py>> {
    check_trials(py, trial, 1)?;
    let scenario = flight.scenario()?;
    let mut out = Readings::default();
    let mut listener = Listener::new(None, 1);
    let done = py.detach(|| scenario.simulate(seed, trial, &mut out, &mut || listener.poll(0)));
    listener.finish()?;
    done.map_err(|e| raise(py, e))?;
    let cameras = scenario.cameras.iter().zip(out.fixes);
    let fixes = cameras.map(|(source, fixes)| fixed(py, source, fixes)).collect::<PyResult<_>>()?;
    Ok((table(py, out.rate)?, table(py, out.bias)?, fixes))
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(simulate, m)?)
}

//! Simulated skies and angles, and many trials of them in one call.

use crate::celestial::{Setup, angle_noise};
use crate::convert::{Array, flat, rows, table};
use crate::errors::{input, raise};
use crate::listener::Listener;
use crate::simulate::check_trials;
use celestcore_core::celestial::{
    AngleScene, Blunders, Campaign, Estimator, Flight, Score, Scored, SkyField, monte_carlo as run,
};
use celestcore_core::scalar::Level;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A camera's field as the Python package describes it.
#[derive(FromPyObject)]
struct Field {
    #[pyo3(item)]
    boresight: [f64; 3],
    #[pyo3(item)]
    along: [f64; 3],
    #[pyo3(item)]
    inertial: bool,
    #[pyo3(item)]
    tangents: [f64; 2],
    #[pyo3(item)]
    brightest: usize,
    #[pyo3(item)]
    opaque: f64,
}

/// How many stars are seen at each epoch, and their rows; stars are given with the brightest first.
type Sighted<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>);

/// Stars (unit vectors, the brightest first) that a field holds along an orbit.
#[pyfunction]
fn sky_visible<'py>(
    py: Python<'py>,
    field: Field,
    stars: Array<'py>,
    r: Array<'py>,
    v: Array<'py>,
) -> PyResult<Sighted<'py>> {
    let Field { boresight, along, inertial, tangents, brightest, opaque } = field;
    let field = SkyField { boresight, along, inertial, tangents, brightest, opaque };
    let (stars, r, v) = (rows::<3>(&stars, "stars")?, rows::<3>(&r, "r")?, rows::<3>(&v, "v")?);
    let seen = py.detach(|| field.look(stars, r, v)).map_err(|e| raise(py, e))?;
    let numbers = |values: Vec<usize>| PyArray1::from_iter(py, values.into_iter().map(|k| k as i64));
    Ok((numbers(seen.counts), numbers(seen.rows)))
}

/// A scenario as the Python package describes it.
#[derive(FromPyObject)]
struct Described<'py> {
    #[pyo3(item)]
    t: Array<'py>,
    /// Positions and velocities.
    #[pyo3(item)]
    state: Array<'py>,
    /// Time of each star angle, which is that of an epoch.
    #[pyo3(item)]
    star_t: Array<'py>,
    /// Directions to the stars as the log gives them, and where they appear.
    #[pyo3(item)]
    star: Array<'py>,
    #[pyo3(item)]
    apparent: Array<'py>,
    /// Own and shared sigma, distribution and its number.
    #[pyo3(item)]
    noise: (f64, f64, String, f64, f64),
    /// Probability and size in standard deviations.
    #[pyo3(item)]
    outliers: Option<(f64, f64)>,
    #[pyo3(item)]
    start_sigma: [f64; 6],
}

impl Described<'_> {
    fn flight(&self) -> PyResult<Flight<'_>> {
        let py = self.t.py();
        let (t, star_t) = (flat(&self.t, "truth.t")?, flat(&self.star_t, "stars.t")?);
        let state = rows::<6>(&self.state, "truth.state")?;
        let (own, shared, shape, number, limb) = &self.noise;
        let noise = angle_noise(py, (*own, *shared, shape, *number, *limb))?;
        let blunders = self.outliers.map(|(probability, sigmas)| Blunders { probability, sigmas });
        let r: Vec<[f64; 3]> = state.iter().map(|x| [x[0], x[1], x[2]]).collect();
        let stars = (counts(py, t, star_t)?, rows::<3>(&self.apparent, "stars.apparent")?);
        let scene = AngleScene::new(&r, (&stars.0, stars.1), noise, blunders).map_err(|e| raise(py, e))?;
        let star = rows::<3>(&self.star, "stars.star")?;
        Ok(Flight { t, state, star_t, star, scene, start_sigma: self.start_sigma })
    }
}

/// How many of the stars' times are those of each epoch.
fn counts(py: Python<'_>, t: &[f64], star_t: &[f64]) -> PyResult<Vec<usize>> {
    let mut left = star_t;
    let mut out = Vec::with_capacity(t.len());
    for now in t {
        let n = left.iter().take_while(|s| *s == now).count();
        out.push(n);
        left = &left[n..];
    }
    match left.first() {
        None => Ok(out),
        Some(t) => Err(input(py, &format!("stars.t: {t} s is no epoch, or not in order"))),
    }
}

/// Angles of one trial, and the state that estimators start from.
#[pyfunction]
fn celestial_simulate<'py>(
    py: Python<'py>,
    flight: Described<'py>,
    seed: u64,
    trial: u64,
) -> PyResult<(Bound<'py, PyArray1<f64>>, [f64; 6])> {
    check_trials(py, trial, 1)?;
    let flight = flight.flight()?;
    let mut angle = Vec::new();
    py.detach(|| flight.scene.simulate(seed, trial, &mut angle));
    let start = flight.start(seed, trial).map_err(|e| raise(py, e))?;
    Ok((PyArray1::from_vec(py, angle), start))
}

/// An estimator as the Python package describes it.
#[derive(FromPyObject)]
struct Estimated<'py> {
    #[pyo3(item)]
    setup: Setup<'py>,
    #[pyo3(item)]
    smooth: bool,
}

/// Scores of trials `first`, `first + 1` … for each estimator.
#[pyfunction]
#[pyo3(signature = (flight, estimators, seed, first, count, skip, threads, portable, progress))]
#[expect(clippy::too_many_arguments, reason = "called by the Python package alone, by keyword")]
fn celestial_monte_carlo<'py>(
    py: Python<'py>,
    flight: Described<'py>,
    estimators: Vec<Estimated<'py>>,
    seed: u64,
    first: u64,
    count: u64,
    skip: f64,
    threads: usize,
    portable: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    check_trials(py, first, count)?;
    let made = |Estimated { setup, smooth }: &Estimated<'_>| {
        let (filter, dynamics) = (setup.filter(py)?, setup.dynamics(py)?);
        let (horizon, outliers) = (setup.horizon(py)?, setup.outliers());
        Ok(Estimator { filter, dynamics, horizon, outliers, smooth: *smooth })
    };
    let estimators = estimators.iter().map(made).collect::<PyResult<Vec<_>>>()?;
    let level = if portable { Level::Portable } else { Level::best() };
    let campaign = Campaign { flight: flight.flight()?, estimators, seed, trials: first..first + count, skip, level };
    let mut listener = Listener::new(progress, count as usize);
    let done = py.detach(|| run(&campaign, threads, &mut |done| listener.poll(done)));
    listener.finish()?;
    let done = done.map_err(|e| raise(py, e))?;
    (0..campaign.estimators.len()).map(|e| columns(py, done.iter().map(|trial| &trial[e]))).collect()
}

/// A part of a score by name.
type Named = (&'static str, fn(&Score) -> f64);

const NUMBERS: [Named; 11] = [
    ("mean_position", |s| s.position.mean),
    ("max_position", |s| s.position.max),
    ("rms_position", |s| s.position.rms),
    ("mean_velocity", |s| s.velocity.mean),
    ("max_velocity", |s| s.velocity.max),
    ("rms_velocity", |s| s.velocity.rms),
    ("nees", |s| s.nees),
    ("nis", |s| s.nis),
    ("accepted", |s| s.accepted),
    ("ess", |s| s.effective),
    ("seconds", |s| s.seconds),
];

/// One estimator's scores as arrays with the trial first; not a number where the filter broke down.
fn columns<'py, 'a>(py: Python<'py>, scored: impl Iterator<Item = &'a Scored>) -> PyResult<Bound<'py, PyDict>> {
    let scored: Vec<&Scored> = scored.collect();
    let out = PyDict::new(py);
    for (name, get) in NUMBERS {
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
    m.add_function(wrap_pyfunction!(sky_visible, m)?)?;
    m.add_function(wrap_pyfunction!(celestial_simulate, m)?)?;
    m.add_function(wrap_pyfunction!(celestial_monte_carlo, m)?)
}

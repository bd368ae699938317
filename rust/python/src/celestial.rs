//! Orbits from star angles: a whole log in one call.

use crate::convert::{Array, as_rows, flat, matrices, matrix6, rows, table};
use crate::errors::{input, raise};
use crate::listener::Listener;
use crate::orbit::force;
use crate::refraction::{RefractionTable, earth};
use crate::stream::Update;
use celestcore_core::Error;
use celestcore_core::celestial::{
    AnyFilter, CelestialSensors, Form, Horizon, Log, Options, OrbitStream as Stream, Outliers, Refraction, Results,
    Source, Use, run, smooth,
};
use celestcore_core::cloud::Settings;
use celestcore_core::filter::{Ekf, Iterated, Score, SrUkf, Ukf, Unscented};
use celestcore_core::horizon::{AngleNoise, AngleSeries, Epochs, RefractionAngle, Shape};
use celestcore_core::orbit::{OrbitModel, Scheme};
use celestcore_core::replay::Start;
use celestcore_core::resample::Resampling;
use celestcore_core::scalar::Level;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

/// Own sigma, relative sigma of the density, for an oblate Earth its pole, and the air.
type Refractions = (f64, f64, Option<[f64; 3]>, Py<RefractionTable>);

/// Filter, dynamics and sensors as `CelestialNavigator._described` gives them.
#[derive(FromPyObject)]
pub(crate) struct Setup<'py> {
    #[pyo3(item)]
    filter: String,
    #[pyo3(item)]
    alpha: f64,
    #[pyo3(item)]
    beta: f64,
    #[pyo3(item)]
    kappa: Option<f64>,
    #[pyo3(item)]
    reset: bool,
    #[pyo3(item)]
    iterations: usize,
    #[pyo3(item)]
    tolerance: f64,
    /// How many, how resampled, below which effective part, moves, whether to recover, and by kernels.
    #[pyo3(item)]
    particles: Option<(usize, String, f64, usize, bool, bool)>,
    /// Seed and trial of a particle filter.
    #[pyo3(item)]
    random: (u64, u64),
    #[pyo3(item)]
    forces: Bound<'py, PyDict>,
    #[pyo3(item)]
    tables: Option<Bound<'py, PyDict>>,
    #[pyo3(item)]
    accel_psd: f64,
    #[pyo3(item)]
    max_step: f64,
    #[pyo3(item)]
    scheme: String,
    /// Kind and number: ("keep", 0), ("gate", probability), ("huber", standard deviations).
    #[pyo3(item)]
    outliers: (String, f64),
    /// Own and shared sigma, distribution and its number, radius of the limb, whether an epoch's angles are used
    /// together.
    #[pyo3(item)]
    horizon: Option<(f64, f64, String, f64, f64, bool)>,
    /// How starlight refraction is measured.
    #[pyo3(item)]
    refraction: Option<Refractions>,
}

impl Setup<'_> {
    pub(crate) fn filter(&self, py: Python<'_>) -> PyResult<AnyFilter> {
        let weights = || {
            let w = Unscented::new(self.alpha, self.beta, self.kappa)?;
            w.check(6)?;
            Ok::<_, Error>(w)
        };
        match self.filter.as_str() {
            "ekf" => Ok(AnyFilter::Ekf(Ekf { reset: self.reset })),
            "ukf" => weights().map(|weights| AnyFilter::Ukf(Ukf { weights })).map_err(|e| raise(py, e)),
            "srukf" => weights().and_then(SrUkf::new).map(AnyFilter::SrUkf).map_err(|e| raise(py, e)),
            "proposal" | "literal" | "bank" | "bootstrap" => self.cloud(py),
            "score" => Ok(AnyFilter::Score(Score)),
            "iterated" => Ok(AnyFilter::Iterated(Iterated { iterations: self.iterations, tolerance: self.tolerance })),
            other => Err(input(py, &format!("filter = {other:?}: does not estimate orbits"))),
        }
    }

    fn cloud(&self, py: Python<'_>) -> PyResult<AnyFilter> {
        let Some((particles, resampling, threshold, moves, recover, kernel)) = &self.particles else {
            return Err(input(py, "a particle filter without particles"));
        };
        let resampling = match resampling.as_str() {
            "stratified" => Resampling::Stratified,
            "residual" => Resampling::Residual,
            "multinomial" => Resampling::Multinomial,
            _ => Resampling::Systematic,
        };
        let form = match self.filter.as_str() {
            "literal" => Form::Literal,
            "bank" => Form::Bank,
            "bootstrap" => Form::Bootstrap,
            _ => Form::Proposal,
        };
        let weights = Unscented::new(self.alpha, self.beta, self.kappa).map_err(|e| raise(py, e))?;
        let settings = Settings {
            particles: *particles,
            resampling,
            threshold: *threshold,
            moves: *moves,
            kernel: *kernel,
            ukf: Ukf { weights },
            recover: *recover,
        };
        settings.check(6).map_err(|e| raise(py, e))?;
        Ok(AnyFilter::Cloud(form, settings))
    }

    pub(crate) fn dynamics(&self, py: Python<'_>) -> PyResult<OrbitModel> {
        let forces = force(&self.forces, self.tables.as_ref())?;
        let model = OrbitModel::new(forces, self.accel_psd, self.max_step).map_err(|e| raise(py, e))?;
        let scheme = if self.scheme == "taylor" { Scheme::Taylor } else { Scheme::Rk4 };
        Ok(OrbitModel { scheme, ..model })
    }

    pub(crate) fn outliers(&self) -> Outliers {
        match self.outliers.0.as_str() {
            "gate" => Outliers::Gate(self.outliers.1),
            "huber" => Outliers::Huber(self.outliers.1),
            _ => Outliers::Keep,
        }
    }

    /// The air, and the noise of refractions: own, and relative of the density.
    pub(crate) fn refraction(&self) -> Option<(RefractionAngle, f64, f64)> {
        let (sigma, density_sigma, pole, air) = self.refraction.as_ref()?;
        let model = RefractionAngle { bending: air.get().bending.clone(), earth: earth(*pole) };
        Some((model, *sigma, *density_sigma))
    }

    /// Noise of the angles and how they are used.
    pub(crate) fn horizon(&self, py: Python<'_>) -> PyResult<Option<(AngleNoise, Use)>> {
        let Some((own, shared, shape, number, limb, together)) = &self.horizon else { return Ok(None) };
        let noise = angle_noise(py, (*own, *shared, shape, *number, *limb))?;
        Ok(Some((noise, if *together { Use::Together } else { Use::OneByOne })))
    }
}

/// Own and shared sigma, distribution and its number, radius of the limb.
pub(crate) fn angle_noise(
    py: Python<'_>,
    (own, shared, shape, number, limb): (f64, f64, &str, f64, f64),
) -> PyResult<AngleNoise> {
    let shape = match shape {
        "student_t" => Shape::StudentT { dof: number },
        "uniform" => Shape::Uniform { edge: number },
        _ => Shape::Normal,
    };
    AngleNoise::new(own, shared, shape).and_then(|n| n.to_limb(limb)).map_err(|e| raise(py, e))
}

/// Orbit over a log; see `CelestialNavigator.run`. `horizon` is times, stars and angles of equal length.
#[pyfunction]
#[pyo3(signature = (setup, times, horizon, refraction, start, every, covariance, back, portable, progress))]
#[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
fn celestial_run<'py>(
    py: Python<'py>,
    setup: Setup<'py>,
    times: Array<'py>,
    horizon: Option<(Array<'py>, Array<'py>, Array<'py>)>,
    refraction: Option<(Array<'py>, Array<'py>, Array<'py>)>,
    start: (f64, [f64; 6], Array<'py>),
    every: usize,
    covariance: bool,
    back: bool,
    portable: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (filter, dynamics) = (setup.filter(py)?, setup.dynamics(py)?);
    let times = flat(&times, "times")?;
    let (t, mean, p0) = (start.0, start.1, matrix6(&start.2, "covariance0")?);
    let mut epochs = Epochs::default();
    if let Some((t, star, angle)) = &horizon {
        let series = AngleSeries {
            t: flat(t, "horizon.t")?,
            star: rows(star, "horizon.star")?,
            angle: flat(angle, "horizon.angle")?,
        };
        epochs.fill(&series).map_err(|e| raise(py, e))?;
    }
    let (horizon_noise, air) = (setup.horizon(py)?, setup.refraction());
    let mut sources = Vec::new();
    if let (Some((noise, how)), Some(_)) = (horizon_noise, &horizon) {
        sources.push(Source::Horizon(Horizon { epochs: &epochs, noise, how }));
    }
    if let (Some((model, sigma, density_sigma)), Some((t, star, angle))) = (&air, &refraction) {
        sources.push(Source::Refraction(Refraction {
            t: flat(t, "refraction.t")?,
            star: rows(star, "refraction.star")?,
            angle: flat(angle, "refraction.angle")?,
            model,
            sigma: *sigma,
            density_sigma: *density_sigma,
        }));
    }
    let sensors = CelestialSensors::new(&sources, setup.outliers()).map_err(|e| raise(py, e))?;
    let start = Start { t, mean, covariance: p0, used: None };
    let level = if portable { Level::Portable } else { Level::best() };
    let options = Options { every, level, random: setup.random };
    let mut results = Results { with_covariance: covariance, ..Results::default() };
    let mut listener = Listener::new(progress, times.len() * if back { 2 } else { 1 });
    let began = Instant::now();
    let end = py.detach(|| {
        let log = Log { dynamics: &dynamics, times, sensors: &sensors };
        let mut poll = |k| listener.poll(k);
        let call = if back { smooth } else { run };
        call(&filter, log, &start, &options, &mut results, &mut poll)
    });
    let elapsed = began.elapsed().as_secs_f64();
    listener.finish()?;
    let end = end.map_err(|e| raise(py, e))?;
    let out = columns(py, results)?;
    out.set_item("outside", end.outside)?;
    out.set_item("log_likelihood", end.log_likelihood)?;
    out.set_item("final_t", end.t)?;
    out.set_item("final_state", PyArray1::from_slice(py, &end.mean))?;
    out.set_item("final_covariance", table(py, as_rows(&end.covariance))?)?;
    out.set_item("elapsed_s", elapsed)?;
    Ok(out)
}

/// The results by name; numpy takes over their memory.
fn columns(py: Python<'_>, results: Results) -> PyResult<Bound<'_, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("t", PyArray1::from_vec(py, results.t))?;
    out.set_item("state", table(py, results.state)?)?;
    out.set_item("sigma", table(py, results.sigma)?)?;
    if results.with_covariance {
        out.set_item("covariance", matrices(py, results.covariance)?)?;
    }
    out.set_item("measurement_t", PyArray1::from_vec(py, results.measured_t))?;
    for (name, column) in ["sensor", "row", "dof", "stars", "used"].into_iter().zip(results.source) {
        out.set_item(name, PyArray1::from_vec(py, column))?;
    }
    out.set_item("nis", PyArray1::from_vec(py, results.nis))?;
    out.set_item("accepted", PyArray1::from_vec(py, results.accepted))?;
    out.set_item("innovation", table(py, results.innovation)?)?;
    out.set_item("innovation_sigma", table(py, results.innovation_sigma)?)?;
    out.set_item("effective", PyArray1::from_vec(py, results.effective))?;
    Ok(out)
}

/// An orbit that is estimated epoch by epoch; the Python package's `CelestialState` adds checks.
#[pyclass(subclass, module = "celestcore._core")]
struct OrbitStream {
    stream: Stream,
    horizon: Option<(AngleNoise, Use)>,
    refraction: Option<(RefractionAngle, f64, f64)>,
    outliers: Outliers,
}

#[pymethods]
impl OrbitStream {
    #[new]
    fn new(py: Python<'_>, setup: Setup<'_>, t: f64, state: [f64; 6], covariance: Array<'_>) -> PyResult<Self> {
        let p = matrix6(&covariance, "covariance0")?;
        let stream = Stream::new(setup.filter(py)?, setup.dynamics(py)?, t, state, p).map_err(|e| raise(py, e))?;
        Ok(Self { stream, horizon: setup.horizon(py)?, refraction: setup.refraction(), outliers: setup.outliers() })
    }
    #[getter]
    fn t(&self) -> f64 {
        self.stream.time()
    }
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.stream.mean())
    }
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        table(py, as_rows(self.stream.covariance()))
    }
    fn predict(&mut self, py: Python<'_>, t: f64) -> PyResult<()> {
        self.stream.predict(t).map_err(|e| raise(py, e))
    }
    fn update_horizon(&mut self, py: Python<'_>, star: Array<'_>, angle: Array<'_>) -> PyResult<Update> {
        let Some((noise, how)) = self.horizon else {
            return Err(input(py, "the navigator has no StarHorizon to tell the noise of these angles"));
        };
        let (star, angle) = (rows(&star, "star")?, flat(&angle, "angle")?);
        let t = vec![self.stream.time(); angle.len()];
        let epochs = Epochs::new(&AngleSeries { t: &t, star, angle }).map_err(|e| raise(py, e))?;
        update(py, &mut self.stream, Source::Horizon(Horizon { epochs: &epochs, noise, how }), self.outliers)
    }
    fn update_refraction(&mut self, py: Python<'_>, star: Array<'_>, angle: Array<'_>) -> PyResult<Update> {
        let Some((model, sigma, density_sigma)) = &self.refraction else {
            return Err(input(py, "the navigator has no StarRefraction to tell the noise of these angles"));
        };
        let (star, angle) = (rows(&star, "star")?, flat(&angle, "angle")?);
        let t = vec![self.stream.time(); angle.len()];
        let table = Refraction { t: &t, star, angle, model, sigma: *sigma, density_sigma: *density_sigma };
        update(py, &mut self.stream, Source::Refraction(table), self.outliers)
    }
}

fn update(py: Python<'_>, stream: &mut Stream, source: Source<'_>, outliers: Outliers) -> PyResult<Update> {
    let sensors = CelestialSensors::new(&[source], outliers).map_err(|e| raise(py, e))?;
    let report = stream.update(&sensors).map_err(|e| raise(py, e))?;
    Ok(Update { report })
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<OrbitStream>()?;
    m.add_function(wrap_pyfunction!(celestial_run, m)?)
}

//! Times of kernels of the core that no public call shows alone; for `celestcore bench`, private.
//!
//! Each runs the same work some times and gives the shortest, in ns per item, with its result.

use crate::convert::{Array, flat, rows, table};
use crate::errors::{input, raise};
use crate::orbit::force;
use celestcore_core::Error;
use celestcore_core::orbit::ForceModel;
use celestcore_core::quaternion::{Integrator, propagate};
use celestcore_core::resample::{Resampling, resample};
use celestcore_core::scalar::{Level, Real, Run};
use celestcore_core::simulate::rng::{Stream, channel};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::hint::black_box;
use std::time::Instant;

type Timed<'py> = (f64, Bound<'py, PyAny>);

/// Shortest run [ns] of some, shared among `items`.
fn shortest(repeats: usize, items: usize, mut work: impl FnMut() -> Result<(), Error>) -> Result<f64, Error> {
    let mut best = f64::INFINITY;
    for _ in 0..repeats.max(1) {
        let began = Instant::now();
        work()?;
        best = best.min(began.elapsed().as_secs_f64());
    }
    Ok(best * 1e9 / items.max(1) as f64)
}

/// The instruction set that runs choose on this machine.
#[pyfunction]
fn _bench_level() -> String {
    format!("{:?}", Level::best()).to_lowercase()
}

/// Attitudes by the closed form into memory that is there already.
#[pyfunction]
fn _bench_propagate<'py>(
    py: Python<'py>,
    q0: [f64; 4],
    rates: Array<'py>,
    dt: f64,
    repeats: usize,
) -> PyResult<Timed<'py>> {
    let rates = rows::<3>(&rates, "rates")?;
    let mut out = vec![[0.0; 4]; rates.len() + 1];
    let work = || {
        propagate(&q0, black_box(rates), &[dt], Integrator::Exponential, black_box(&mut out));
        Ok(())
    };
    let ns = shortest(repeats, rates.len(), work).map_err(|e| raise(py, e))?;
    Ok((ns, table(py, out)?))
}

/// Indices that resampling chooses; the random numbers are those of the particle filters.
#[pyfunction]
fn _bench_resample<'py>(
    py: Python<'py>,
    way: &str,
    weights: Array<'py>,
    seed: u64,
    repeats: usize,
) -> PyResult<Timed<'py>> {
    let way = match way {
        "systematic" => Resampling::Systematic,
        "stratified" => Resampling::Stratified,
        "residual" => Resampling::Residual,
        "multinomial" => Resampling::Multinomial,
        _ => return Err(input(py, &format!("way = {way:?}: is no way to resample"))),
    };
    let weights = flat(&weights, "weights")?;
    let mut stream = Stream::new(seed, 0, channel::PARTICLES);
    let mut out = vec![0; weights.len()];
    let work = || resample(way, black_box(weights), || stream.uniform(), black_box(&mut out));
    let ns = shortest(repeats, weights.len(), work).map_err(|e| raise(py, e))?;
    Ok((ns, PyArray1::from_vec(py, out).into_any()))
}

/// Accelerations, with what they need to know of the Earth's rotation at each time.
struct Accelerations<'a> {
    model: &'a ForceModel,
    t: &'a [f64],
    state: &'a [[f64; 6]],
    out: &'a mut [[f64; 3]],
}

impl Run for Accelerations<'_> {
    type Output = ();
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) {
        for ((t, x), out) in self.t.iter().zip(self.state).zip(self.out) {
            let x = x.map(T::splat);
            let at = self.model.moment(T::splat(*t));
            let a = self.model.acceleration(&at, &[x[0], x[1], x[2]], &[x[3], x[4], x[5]]);
            *out = a.map(|c| c.lane(0));
        }
    }
}

/// Accelerations at times and states.
#[pyfunction]
fn _bench_acceleration<'py>(
    py: Python<'py>,
    forces: &Bound<'py, PyDict>,
    tables: Option<&Bound<'py, PyDict>>,
    t: Array<'py>,
    state: Array<'py>,
    repeats: usize,
) -> PyResult<Timed<'py>> {
    let model = force(forces, tables)?;
    let (t, state) = (flat(&t, "t")?, rows::<6>(&state, "state")?);
    let mut out = vec![[0.0; 3]; t.len().min(state.len())];
    let level = Level::best();
    let work = || {
        level.run(Accelerations { model: black_box(&model), t, state, out: black_box(&mut out) });
        Ok(())
    };
    let ns = shortest(repeats, t.len(), work).map_err(|e| raise(py, e))?;
    Ok((ns, table(py, out)?))
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(_bench_level, m)?)?;
    m.add_function(wrap_pyfunction!(_bench_propagate, m)?)?;
    m.add_function(wrap_pyfunction!(_bench_resample, m)?)?;
    m.add_function(wrap_pyfunction!(_bench_acceleration, m)?)
}

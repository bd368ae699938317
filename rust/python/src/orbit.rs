//! Orbit propagation: dicts of plain numbers and tables become the core's forces.

use crate::convert::{Array, flat, matrices, rows, table};
use crate::errors::{input, raise};
use celestcore_core::orbit::{
    Drag, Environment, Field, ForceModel, Gravity, J2, Method, SolarPressure, Tables, Trajectory, propagate,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

fn needed<'py, T>(d: &Bound<'py, PyDict>, name: &str) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    match d.get_item(name)? {
        Some(value) => value.extract::<T>().map_err(|_| input(d.py(), &format!("{name} has the wrong type"))),
        None => Err(input(d.py(), &format!("{name} is missing"))),
    }
}

/// The tables of `celestcore.frames.environment`.
pub(crate) fn environment(d: &Bound<'_, PyDict>) -> PyResult<Arc<Environment>> {
    let get = |name| needed::<Array<'_>>(d, name);
    let (earth_t, cip, pole, sp) = (get("earth_t")?, get("cip")?, get("pole")?, get("sp")?);
    let (ut1, dut1) = (get("ut1")?, get("dut1")?);
    let (body_t, sun, moon) = (get("body_t")?, get("sun")?, get("moon")?);
    let [ut1] = *rows::<2>(&ut1, "environment.ut1")? else {
        return Err(input(d.py(), "environment.ut1 must be two numbers"));
    };
    let tables = Tables {
        earth_t: flat(&earth_t, "environment.earth_t")?,
        cip: rows(&cip, "environment.cip")?,
        pole: rows(&pole, "environment.pole")?,
        sp: flat(&sp, "environment.sp")?,
        ut1,
        dut1: flat(&dut1, "environment.dut1")?,
        body_t: flat(&body_t, "environment.body_t")?,
        sun: rows(&sun, "environment.sun")?,
        moon: rows(&moon, "environment.moon")?,
    };
    Environment::new(&tables).map(Arc::new).map_err(|e| raise(d.py(), e))
}

fn gravity(force: &Bound<'_, PyDict>) -> PyResult<Gravity> {
    let py = force.py();
    let (mu, radius) = (needed::<f64>(force, "mu")?, needed::<f64>(force, "radius")?);
    let kind = needed::<String>(force, "gravity")?;
    match kind.as_str() {
        "two-body" => J2::new(mu, radius, 0.0).map(|j2| Gravity::TwoBody { mu: j2.mu }),
        "j2" => J2::new(mu, radius, needed(force, "j2")?).map(Gravity::J2),
        "field" => {
            let (c, s) = (needed::<Array<'_>>(force, "c")?, needed::<Array<'_>>(force, "s")?);
            let (degree, order) = (needed(force, "degree")?, needed(force, "order")?);
            Field::new(mu, radius, degree, order, flat(&c, "c")?, flat(&s, "s")?).map(|f| Gravity::Field(Arc::new(f)))
        }
        _ => return Err(input(py, &format!("gravity = {kind:?}: must be 'two-body', 'j2' or 'field'"))),
    }
    .map_err(|e| raise(py, e))
}

/// A force model from its description (`celestcore.orbit.ForceModel._described`) and its tables.
pub(crate) fn force(
    description: &Bound<'_, PyDict>,
    environment_tables: Option<&Bound<'_, PyDict>>,
) -> PyResult<ForceModel> {
    let srp = needed::<Option<[f64; 3]>>(description, "srp")?.map(|[cr, area_to_mass, pressure]| SolarPressure {
        cr,
        area_to_mass,
        pressure,
    });
    let drag = needed::<Option<[f64; 4]>>(description, "drag")?.map(|[cd, area_to_mass, lag, exponent]| Drag {
        cd,
        area_to_mass,
        lag,
        exponent,
    });
    let bodies = [needed(description, "sun")?, needed(description, "moon")?];
    let tables = environment_tables.map(environment).transpose()?;
    ForceModel::new(gravity(description)?, bodies, srp, drag, tables).map_err(|e| raise(description.py(), e))
}

/// States `(n, 6)`, transition matrices `(n, 6, 6)` or None, and evaluations, from the state at `t[0]`.
#[pyfunction]
#[pyo3(signature = (forces, tables, start, t, method, rtol, step, stm))]
#[allow(clippy::too_many_arguments)]
fn orbit_propagate<'py>(
    py: Python<'py>,
    forces: &Bound<'py, PyDict>,
    tables: Option<&Bound<'py, PyDict>>,
    start: [f64; 6],
    t: Array<'py>,
    method: &str,
    rtol: f64,
    step: f64,
    stm: bool,
) -> PyResult<(Bound<'py, PyAny>, Option<Bound<'py, PyAny>>, usize)> {
    let method = match method {
        "rk4" => Method::Rk4 { step },
        "dop853" => Method::Dop853 { rtol, step },
        _ => return Err(input(py, &format!("method = {method:?}: must be 'dop853' or 'rk4'"))),
    };
    let model = force(forces, tables)?;
    let t = flat(&t, "t")?;
    let made = py.detach(|| {
        let mut calls = 0u32;
        propagate(&model, &start, t, method, stm, &mut |_| {
            calls = calls.wrapping_add(1);
            if calls.is_multiple_of(4096) && Python::attach(|py| py.check_signals()).is_err() {
                return Err(celestcore_core::Error::Interrupted);
            }
            Ok(())
        })
    });
    let Trajectory { state, stm: transition, evaluations } = match made {
        Ok(trajectory) => trajectory,
        Err(celestcore_core::Error::Interrupted) => {
            return Err(pyo3::exceptions::PyKeyboardInterrupt::new_err("propagation interrupted"));
        }
        Err(error) => return Err(raise(py, error)),
    };
    let transition = if stm { Some(matrices(py, transition)?) } else { None };
    Ok((table(py, state)?, transition, evaluations))
}

/// Accelerations `(n, 3)` at the times and states, with the derivatives to position and velocity.
#[pyfunction]
fn orbit_acceleration<'py>(
    py: Python<'py>,
    forces: &Bound<'py, PyDict>,
    tables: Option<&Bound<'py, PyDict>>,
    t: Array<'py>,
    state: Array<'py>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let model = force(forces, tables)?;
    let (t, state) = (flat(&t, "t")?, rows::<6>(&state, "state")?);
    if t.len() != state.len() {
        return Err(input(py, &format!("{} times do not go with {} states", t.len(), state.len())));
    }
    let (mut a, mut by_position, mut by_velocity) = (vec![], vec![], vec![]);
    for (t, x) in t.iter().zip(state) {
        let at = model.moment(*t);
        let (r, v) = ([x[0], x[1], x[2]], [x[3], x[4], x[5]]);
        let g = model.gradient(&at, &r, &v);
        a.push(model.acceleration(&at, &r, &v));
        by_position.push(std::array::from_fn(|i| std::array::from_fn(|j| g.by_position[(i, j)])));
        by_velocity.push(std::array::from_fn(|i| std::array::from_fn(|j| g.by_velocity.map_or(0.0, |d| d[(i, j)]))));
    }
    Ok((table(py, a)?, matrices::<3, 3>(py, by_position)?, matrices::<3, 3>(py, by_velocity)?))
}

/// GCRS to ITRS matrices `(n, 3, 3)` that the forces use, with the Sun and the Moon `(n, 3)`.
#[pyfunction]
fn orbit_moments<'py>(
    py: Python<'py>,
    tables: &Bound<'py, PyDict>,
    t: Array<'py>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let environment = environment(tables)?;
    let moments: Vec<_> = flat(&t, "t")?.iter().map(|t| environment.at(*t)).collect();
    let rotation = moments.iter().map(|m| m.to_earth).collect();
    let sun = table(py, moments.iter().map(|m| m.sun).collect())?;
    Ok((matrices(py, rotation)?, sun, table(py, moments.iter().map(|m| m.moon).collect())?))
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(orbit_propagate, m)?)?;
    m.add_function(wrap_pyfunction!(orbit_acceleration, m)?)?;
    m.add_function(wrap_pyfunction!(orbit_moments, m)?)
}

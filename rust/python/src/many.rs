//! Several logs in one call.

use crate::convert::{as_rows, matrices, table};
use crate::errors::raise;
use crate::listener::Listener;
use crate::replay::{Begin, Replayed, Sensor, finish};
use celestcore_core::attitude::{AttitudeBias, AttitudeSensors, Buffers, Flight, Log, Rows, gaps, rows, run_all};
use celestcore_core::replay::End;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

/// Logs of one task.
const TASK: usize = 8;

/// Several logs through one navigator, eight side by side, over threads. A log whose filter breaks down has the reason in
/// place of its results.
#[pyfunction]
fn replay_many<'py>(py: Python<'py>, logs: Vec<Replayed<'py>>, threads: usize) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let Some(first) = logs.first() else { return Ok(Vec::new()) };
    let (filter, model, options) = (first.setup.filter(py)?, first.setup.model(py)?, first.options());
    let gyros = logs.iter().map(|l| l.gyro(l.setup.timing(py)?)).collect::<PyResult<Vec<_>>>()?;
    let borrowed = logs
        .iter()
        .map(|l| l.sensors.iter().map(Sensor::new).collect::<PyResult<Vec<_>>>())
        .collect::<PyResult<Vec<_>>>()?;
    let series = borrowed
        .iter()
        .map(|b| b.iter().map(Sensor::series).collect::<PyResult<Vec<_>>>())
        .collect::<PyResult<Vec<_>>>()?;
    let (mut sensors, mut starts, mut buffers) = (Vec::new(), Vec::new(), Vec::new());
    for (i, log) in logs.iter().enumerate() {
        // the same error, with the number of the log
        let named = |e: PyErr| match e.value(py).call_method1("located", (format!("log {i}"),)) {
            Ok(located) => PyErr::from_value(located),
            Err(_) => e,
        };
        let merged = AttitudeSensors::new(&series[i], log.setup.trust(py)?).map_err(|e| named(raise(py, e)))?;
        let start = log.begin(py, &gyros[i], &merged, &model, None).map_err(named)?;
        let needed = rows(&gyros[i], &merged, &start, options.output).map_err(|e| named(raise(py, e)))?;
        buffers.push(memory(log, needed));
        sensors.push(merged);
        starts.push(start);
    }
    let used: Vec<_> = starts.iter().zip(&sensors).map(|(s, m)| s.used.map(|i| m.source(i))).collect();
    let flights = (starts.into_iter().zip(&mut buffers).enumerate())
        .map(|(i, (start, buffers)): (usize, (Begin, &mut Buffers))| {
            let (columns, measured) = buffers.columns();
            Flight { log: Log { model: &model, gyro: &gyros[i], sensors: &sensors[i] }, start, columns, measured }
        })
        .collect();
    let total = logs.len();
    let mut listener = Listener::new(first.progress.as_ref().map(|p| p.clone_ref(py)), total);
    let (ends, elapsed) = py.detach(|| {
        let began = Instant::now();
        // tasks end in any order: logs in proportion
        let mut poll = |done: usize| listener.poll(done * total / total.div_ceil(TASK));
        (run_all(&filter, flights, &options, threads, &mut poll), began.elapsed().as_secs_f64())
    });
    listener.finish()?;
    let ends = ends.map_err(|e| raise(py, e))?;
    let mut found = Vec::with_capacity(total);
    for (i, (end, buffers)) in ends.into_iter().zip(buffers).enumerate() {
        let Ok(end) = end.as_ref() else {
            let reason = end.err().map_or_else(String::new, |e| e.to_string());
            found.push(reason.into_pyobject(py)?.into_any());
            continue;
        };
        let out = results(py, end, buffers)?;
        out.set_item("gaps", table(py, gaps(gyros[i].t, gyros[i].timing.max_gap))?)?;
        out.set_item("start_fix", used[i])?;
        out.set_item("elapsed_s", elapsed)?;
        found.push(out.into_any());
    }
    Ok(found)
}

/// Memory for a log's results, of what is to be kept.
fn memory(log: &Replayed<'_>, needed: Rows) -> Buffers {
    let measured = if log.innovations == "none" { 0 } else { needed.measured };
    let mut buffers = Buffers::new(Rows { measured, ..needed }, log.covariance);
    if log.innovations == "nis" {
        buffers.innovation = Vec::new();
        buffers.innovation_sigma = Vec::new();
    }
    buffers.scale.clone_from(&log.noise_scale);
    buffers
}

/// A log's results by name, as a single run's.
fn results<'py>(py: Python<'py>, end: &End<AttitudeBias, 6>, b: Buffers) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let [sensor, _, dof] = b.source;
    out.set_item("t", PyArray1::from_vec(py, b.t))?;
    out.set_item("q", table(py, b.q)?)?;
    out.set_item("rate", table(py, b.rate)?)?;
    out.set_item("bias", table(py, b.bias)?)?;
    out.set_item("sigma", table(py, b.sigma)?)?;
    out.set_item("covariance", matrices(py, b.covariance)?)?;
    out.set_item("measurement_t", PyArray1::from_vec(py, b.measured_t))?;
    out.set_item("sensor", PyArray1::from_vec(py, sensor))?;
    out.set_item("dof", PyArray1::from_vec(py, dof))?;
    out.set_item("nis", PyArray1::from_vec(py, b.nis))?;
    out.set_item("accepted", PyArray1::from_vec(py, b.accepted))?;
    out.set_item("innovation", table(py, b.innovation)?)?;
    out.set_item("innovation_sigma", table(py, b.innovation_sigma)?)?;
    out.set_item("noise_scale", b.scale)?;
    out.set_item("tally", (b.tally.accepted, b.tally.rejected, b.tally.unused))?;
    finish(py, &out, (end.t, end.outside, end.log_likelihood), &end.mean)?;
    out.set_item("final_covariance", table(py, as_rows(&end.covariance))?)?;
    Ok(out)
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(replay_many, m)?)
}

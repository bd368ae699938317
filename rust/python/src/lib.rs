//! `celestcore._core`: numpy arrays in, numpy arrays out. Everything is computed in
//! `celestcore-core`; documentation for users stands in the Python package.

mod bench;
mod camera;
mod campaign;
mod celestial;
mod celestial_campaign;
mod columns;
mod convert;
mod errors;
mod gnss;
mod listener;
mod many;
mod orbit;
mod quaternions;
mod refraction;
mod replay;
mod simulate;
mod stream;
mod wahba;

use pyo3::prelude::*;

/// Value that a chi-square variable with `dof` degrees of freedom stays below with probability `p`.
#[pyfunction]
fn chi2_quantile(py: Python<'_>, p: f64, dof: f64) -> PyResult<f64> {
    celestcore_core::consistency::chi2_quantile(p, dof).map_err(|e| errors::raise(py, e))
}

/// Probability that a chi-square variable with `dof` degrees of freedom is below `x`.
#[pyfunction]
fn chi2_cdf(x: f64, dof: f64) -> f64 {
    celestcore_core::consistency::chi2_cdf(x, dof)
}

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("release_build", !cfg!(debug_assertions))?;
    m.add_function(wrap_pyfunction!(chi2_quantile, m)?)?;
    m.add_function(wrap_pyfunction!(chi2_cdf, m)?)?;
    bench::register(m)?;
    quaternions::register(m)?;
    refraction::register(m)?;
    many::register(m)?;
    replay::register(m)?;
    camera::register(m)?;
    wahba::register(m)?;
    simulate::register(m)?;
    campaign::register(m)?;
    orbit::register(m)?;
    celestial::register(m)?;
    gnss::register(m)?;
    celestial_campaign::register(m)?;
    stream::register(m)
}

//! Starlight refraction: the atmosphere's table, rays, and which stars are refracted when.

use crate::convert::{Array, flat, rows, table};
use crate::errors::{input, raise};
use celestcore_core::Error;
use celestcore_core::horizon::{
    Atmosphere, Bending, Ellipsoid, Limb, LimbField, LimbNoise, Passed, Ray, RefractionAngle,
};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::sync::Arc;

/// How an atmosphere bends rays; the Python package's `Atmosphere` adds checks.
#[pyclass(frozen, module = "celestcore._core")]
pub(crate) struct RefractionTable {
    pub(crate) bending: Arc<Bending>,
    /// What it was made of.
    air: Option<(Vec<f64>, Vec<f64>)>,
}

/// The surface that heights count from: a sphere, or WGS 84 with its pole in the inertial frame.
pub(crate) fn earth(pole: Option<[f64; 3]>) -> Ellipsoid {
    pole.map_or(Ellipsoid::SPHERE, Ellipsoid::wgs84)
}

#[pymethods]
impl RefractionTable {
    /// The standard atmosphere, or one of densities at heights.
    #[new]
    fn new(py: Python<'_>, air: Option<(Array<'_>, Array<'_>)>) -> PyResult<Self> {
        let Some((height, density)) = air else {
            return Ok(Self { bending: py.detach(Bending::standard), air: None });
        };
        let (height, density) = (flat(&height, "height")?, flat(&density, "density")?);
        let made = py.detach(|| Atmosphere::table(height, density).map(Bending::new));
        let air = Some((height.to_vec(), density.to_vec()));
        made.map(|bending| Self { bending: Arc::new(bending), air }).map_err(|e| raise(py, e))
    }

    /// For processes of a pool: traced anew there.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let py = slf.py();
        let column = |x: &[f64]| PyArray1::from_slice(py, x);
        let air = slf.get().air.as_ref().map(|(height, density)| (column(height), column(density)));
        Ok((slf.get_type().into_any(), (air,).into_pyobject(py)?))
    }

    fn density<'py>(&self, py: Python<'py>, height: Array<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let air = self.bending.atmosphere();
        Ok(PyArray1::from_iter(py, flat(&height, "height")?.iter().map(|h| air.density(*h))))
    }

    fn bending<'py>(&self, py: Python<'py>, height: Array<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(PyArray1::from_iter(py, flat(&height, "height")?.iter().map(|h| self.bending.at(*h).angle[0])))
    }

    fn height<'py>(&self, py: Python<'py>, angle: Array<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(PyArray1::from_iter(py, flat(&angle, "angle")?.iter().map(|a| self.bending.height(*a))))
    }

    /// Angle, height, derivatives to position and ln(density) of rays from stars (m, 3) to positions (m, 3).
    fn rays<'py>(
        &self,
        py: Python<'py>,
        r: Array<'py>,
        star: Array<'py>,
        pole: Option<[f64; 3]>,
        scale: f64,
    ) -> PyResult<[Bound<'py, PyAny>; 4]> {
        let (r, star) = (rows::<3>(&r, "r")?, rows::<3>(&star, "star")?);
        let sensor = RefractionAngle { bending: self.bending.clone(), earth: earth(pole) };
        let rays: Vec<Ray<f64>> = r.iter().zip(star).map(|(r, s)| sensor.ray(r, s, scale)).collect();
        let column = |f: fn(&Ray<f64>) -> f64| PyArray1::from_iter(py, rays.iter().map(f)).into_any();
        let by_position = table(py, rays.iter().map(|ray| ray.by_position).collect())?;
        Ok([column(|ray| ray.angle), column(|ray| ray.height), by_position, column(|ray| ray.by_density)])
    }

    /// Sights of stars (n, 3) within the band from states (m, 6), as columns. Fields are
    /// `(azimuth, tangent along the limb, across)`.
    fn sights<'py>(
        &self,
        py: Python<'py>,
        states: Array<'py>,
        stars: Array<'py>,
        pole: Option<[f64; 3]>,
        band: [f64; 2],
        fields: Vec<[f64; 3]>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (states, stars) = (rows::<6>(&states, "states")?, rows::<3>(&stars, "stars")?);
        let sensor = RefractionAngle { bending: self.bending.clone(), earth: earth(pole) };
        let fields: Vec<LimbField> =
            fields.iter().map(|[azimuth, a, b]| LimbField { azimuth: *azimuth, tangents: [*a, *b] }).collect();
        let limb = Limb { sensor: &sensor, band, fields: &fields };
        let poll = |_| Python::attach(|py| py.check_signals()).map_err(|_| Error::Interrupted);
        let sights = match py.detach(|| limb.sights(states, stars, poll)) {
            Ok(sights) => sights,
            Err(Error::Interrupted) => return Err(pyo3::exceptions::PyKeyboardInterrupt::new_err("interrupted")),
            Err(error) => return Err(raise(py, error)),
        };
        let out = PyDict::new(py);
        out.set_item("epoch", PyArray1::from_iter(py, sights.iter().map(|s| s.epoch as i64)))?;
        out.set_item("row", PyArray1::from_iter(py, sights.iter().map(|s| s.star as i64)))?;
        out.set_item("angle", PyArray1::from_iter(py, sights.iter().map(|s| s.angle)))?;
        out.set_item("height", PyArray1::from_iter(py, sights.iter().map(|s| s.height)))?;
        out.set_item("occultation", PyArray1::from_iter(py, sights.iter().map(|s| s.pass as i64)))?;
        out.set_item("field", PyArray1::from_iter(py, sights.iter().map(|s| s.field as i64)))?;
        Ok(out)
    }

    /// Measured angles (m,) of sights at positions (m, 3); `place` holds their numbers among those of all azimuths and
    /// the numbers of their passes, `noise` sigma, relative sigma and bias of the density.
    #[expect(clippy::too_many_arguments, reason = "called by the Python package alone")]
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        r: Array<'py>,
        star: Array<'py>,
        place: Vec<[usize; 2]>,
        pole: Option<[f64; 3]>,
        noise: [f64; 3],
        random: (u64, u64),
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let (r, star) = (rows::<3>(&r, "r")?, rows::<3>(&star, "star")?);
        if r.len() != star.len() || r.len() != place.len() {
            return Err(input(py, "positions, stars and places do not go together"));
        }
        let sensor = RefractionAngle { bending: self.bending.clone(), earth: earth(pole) };
        let each = r.iter().zip(star).zip(place);
        let sights: Vec<Passed> = each.map(|((r, star), place)| Passed { r: *r, star: *star, place }).collect();
        let [sigma, density, bias] = noise;
        let noise = LimbNoise { sigma, density, bias };
        Ok(PyArray1::from_vec(py, py.detach(|| sensor.simulate(&sights, &noise, random))))
    }
}

pub(crate) fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<RefractionTable>()
}

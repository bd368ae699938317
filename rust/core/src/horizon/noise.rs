//! Errors of angles between stars and the nadir.

use crate::error::{Error, Result};
use crate::moments::{soft_uniform, student_t};
use crate::scalar::Real;

/// Distribution of an error, scaled to its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Shape {
    /// Normal.
    #[default]
    Normal,
    /// Student's t.
    StudentT {
        /// Degrees of freedom, above 2.
        dof: f64,
    },
    /// Uniform between plus and minus `√3` standard deviations.
    Uniform {
        /// Softness of the edges: beyond the half-width `b` the density falls as that of a normal
        /// distribution of standard deviation `edge b` about the edge. Without it one angle a little
        /// outside would rule out every state.
        edge: f64,
    },
}

impl Shape {
    /// Half-width of the uniform distribution, or scale of Student's t, for a standard deviation of one.
    #[inline(always)]
    pub fn scale(&self) -> f64 {
        match self {
            Self::Normal => 1.0,
            Self::StudentT { dof } => ((dof - 2.0) / dof).sqrt(),
            Self::Uniform { .. } => 3.0f64.sqrt(),
        }
    }

    /// Posterior mean and variance of a signal that was normal about zero with variance `s`, once it is seen as
    /// `y` with this error of standard deviation `sigma`.
    pub fn posterior(&self, y: f64, s: f64, sigma: f64) -> (f64, f64) {
        let scale = sigma * self.scale();
        match self {
            Self::Normal => {
                let gain = s / (s + sigma * sigma);
                (y * gain, sigma * sigma * gain)
            }
            Self::StudentT { dof } => {
                let posterior = student_t(y, s, *dof, scale);
                (posterior.mean, posterior.variance)
            }
            Self::Uniform { edge } => {
                let posterior = soft_uniform(y, s, scale, edge * scale);
                (posterior.mean, posterior.variance)
            }
        }
    }

    /// Logarithm of the density at `error` for standard deviation `sigma`, but for a constant.
    #[inline(always)]
    pub fn log_density<T: Real>(&self, error: T, sigma: f64) -> T {
        let x = error * (1.0 / (sigma * self.scale()));
        match self {
            Self::Normal => x * x * -0.5,
            Self::StudentT { dof } => {
                let square = (x * x).mul_add(T::splat(1.0 / dof), T::one());
                square.map(f64::ln) * (-0.5 * (dof + 1.0))
            }
            Self::Uniform { edge } => {
                let size = x.copysign(T::one());
                let beyond = (size - T::one()) * (1.0 / edge);
                T::select(beyond.gt(T::zero()), beyond * beyond * -0.5, beyond * 0.0)
            }
        }
    }
}

/// What the angles of one epoch are measured to, and their errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleNoise {
    /// Standard deviation of each angle's own error, rad.
    pub own: f64,
    /// Standard deviation of the horizon sensor's nadir direction about each of two axes, which all angles
    /// share, rad.
    pub shared: f64,
    /// Distribution of the own errors.
    pub shape: Shape,
    /// Radius of the sphere whose limb they end at, m; zero for angles to the nadir.
    pub limb: f64,
}

impl AngleNoise {
    /// # Errors
    /// `Parameter` for numbers out of range, and for own errors that are not normal beside a shared one,
    /// whose joint density has no closed form.
    pub fn new(own: f64, shared: f64, shape: Shape) -> Result<Self> {
        if !(own.is_finite() && own > 0.0) {
            return Err(Error::Parameter { field: "own sigma", value: own, need: "must be finite and positive" });
        }
        if !(shared.is_finite() && shared >= 0.0) {
            let need = "must be finite and not negative";
            return Err(Error::Parameter { field: "shared sigma", value: shared, need });
        }
        match shape {
            Shape::StudentT { dof } if !(dof > 2.0 && dof.is_finite()) => {
                let need = "must be above 2, or there is no standard deviation";
                return Err(Error::Parameter { field: "dof", value: dof, need });
            }
            Shape::Uniform { edge } if !(edge > 0.0 && edge.is_finite()) => {
                return Err(Error::Parameter { field: "edge", value: edge, need: "must be finite and positive" });
            }
            _ => {}
        }
        if shape != Shape::Normal && shared > 0.0 {
            let need = "must be 0 where the angles' own errors are not normal";
            return Err(Error::Parameter { field: "shared sigma", value: shared, need });
        }
        Ok(Self { own, shared, shape, limb: 0.0 })
    }

    /// The same for angles that end at the limb of a sphere of radius `limb`, m, seen from above it.
    ///
    /// # Errors
    /// `Parameter` for a radius that is none, or beside a shared error: that of a limb is not that of a nadir.
    pub fn to_limb(self, limb: f64) -> Result<Self> {
        if !(limb.is_finite() && limb >= 0.0) {
            return Err(Error::Parameter { field: "limb", value: limb, need: "must be finite and not negative" });
        }
        if limb > 0.0 && self.shared > 0.0 {
            let need = "must be 0 for angles that end at the limb";
            return Err(Error::Parameter { field: "shared sigma", value: self.shared, need });
        }
        Ok(Self { limb, ..self })
    }

    /// Variance of one angle, rad².
    #[inline(always)]
    pub fn variance(&self) -> f64 {
        self.own * self.own + self.shared * self.shared
    }
}

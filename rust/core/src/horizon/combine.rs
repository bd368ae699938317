//! Angles of one epoch that share the error of one horizon sensor, combined into a nadir direction.

use crate::error::{Error, Result};
use crate::quaternion::{cross, dot3, tangents, unit_vector};

/// A nadir direction that angles to stars have given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nadir {
    /// Unit vector, inertial frame.
    pub direction: [f64; 3],
    /// Two axes across it.
    pub axes: [[f64; 3]; 2],
    /// Covariance of the direction's components along the axes `(aa, ab, bb)`, rad².
    pub noise: [f64; 3],
}

/// Gauss-Newton on two numbers from a start within degrees: it mostly ends after three or four.
const ITERATIONS: usize = 50;
/// Longest step, rad, and how often one may be halved.
const LONGEST: f64 = 0.1;
const HALVINGS: usize = 30;
/// A step below this, rad, is rounding.
const SMALL: f64 = 1e-14;

/// The nadir direction from angles (rad) to stars (unit vectors, inertial frame), from a first guess
/// within some degrees. Each angle has an error of `star_sigma` of its own; `nadir_sigma` is the error of
/// the horizon sensor's nadir direction along each of two axes, which all angles share: with the
/// derivatives `E` of the angles to the direction their covariance is `σ_star² I + σ_nadir² E Eᵀ`, and the
/// direction's is `σ_nadir² I + σ_star² (Eᵀ E)⁻¹`. Nothing is lost: angles to known stars say nothing of the
/// position but this direction. Two stars also fit the direction's mirror image in their plane: the
/// guess must be nearer to the one than to the other.
///
/// # Errors
/// `Length`; `Parameter` for fewer than two stars, stars that are all in one plane with the nadir, or a
/// guess from which no direction fits.
pub fn combine(
    stars: &[[f64; 3]],
    angles: &[f64],
    star_sigma: f64,
    nadir_sigma: f64,
    guess: &[f64; 3],
) -> Result<Nadir> {
    if stars.len() != angles.len() {
        return Err(Error::Length { field: "angles", expected: stars.len(), found: angles.len() });
    }
    let mut direction = unit_vector(guess);
    for _ in 0..ITERATIONS {
        let axes = tangents(&direction);
        let (squares, gradient) = normal_equations(stars, angles, &direction, &axes);
        let inverse = inverse(&squares, stars.len())?;
        let step =
            [inverse[0] * gradient[0] + inverse[1] * gradient[1], inverse[1] * gradient[0] + inverse[2] * gradient[1]];
        direction = descend(stars, angles, &direction, &axes, step);
        if step[0].hypot(step[1]) < SMALL {
            break;
        }
    }
    let axes = tangents(&direction);
    let (squares, _) = normal_equations(stars, angles, &direction, &axes);
    let own = inverse(&squares, stars.len())?.map(|c| c * star_sigma * star_sigma);
    let shared = nadir_sigma * nadir_sigma;
    Ok(Nadir { direction, axes, noise: [own[0] + shared, own[1], own[2] + shared] })
}

/// The step, or as much of it as makes the angles fit better: near the zenith, where angles bend, a whole
/// step may lead astray.
fn descend(stars: &[[f64; 3]], angles: &[f64], from: &[f64; 3], axes: &[[f64; 3]; 2], step: [f64; 2]) -> [f64; 3] {
    let misfit = |d: &[f64; 3]| -> f64 {
        let left = |(s, a): (&[f64; 3], &f64)| a - angle(s, d);
        stars.iter().zip(angles).map(left).map(|x| x * x).sum()
    };
    let before = misfit(from);
    let length = step[0].hypot(step[1]);
    let mut part = (LONGEST / length).min(1.0);
    for _ in 0..HALVINGS {
        let [a, b] = step.map(|s| s * part);
        let to = unit_vector(&std::array::from_fn(|i| from[i] + a * axes[0][i] + b * axes[1][i]));
        if misfit(&to) <= before || length < 1e-9 {
            return to;
        }
        part *= 0.5;
    }
    *from
}

/// Angle between unit vectors, precise everywhere.
fn angle(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let across = cross(a, b);
    dot3(&across, &across).sqrt().atan2(dot3(a, b))
}

/// `Eᵀ E` as `(aa, ab, bb)` and `Eᵀ` times the angles less the predicted ones.
fn normal_equations(
    stars: &[[f64; 3]],
    angles: &[f64],
    direction: &[f64; 3],
    axes: &[[f64; 3]; 2],
) -> ([f64; 3], [f64; 2]) {
    let (mut squares, mut gradient) = ([0.0; 3], [0.0; 2]);
    for (star, measured) in stars.iter().zip(angles) {
        let across = cross(star, direction);
        let sine = dot3(&across, &across).sqrt();
        // a star at the nadir or the zenith has no derivative, and says nothing to first order
        if sine < 1e-9 {
            continue;
        }
        let e = [-dot3(star, &axes[0]) / sine, -dot3(star, &axes[1]) / sine];
        let left = measured - angle(star, direction);
        squares[0] += e[0] * e[0];
        squares[1] += e[0] * e[1];
        squares[2] += e[1] * e[1];
        gradient[0] += e[0] * left;
        gradient[1] += e[1] * left;
    }
    (squares, gradient)
}

fn inverse(m: &[f64; 3], stars: usize) -> Result<[f64; 3]> {
    let determinant = m[0] * m[2] - m[1] * m[1];
    let trace = m[0] + m[2];
    if determinant > 1e-12 * trace * trace {
        return Ok([m[2] / determinant, -m[1] / determinant, m[0] / determinant]);
    }
    let need = "stars do not fix a nadir direction: at least two are needed, not all in one plane with the nadir";
    Err(Error::Parameter { field: "stars", value: stars as f64, need })
}

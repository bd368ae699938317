//! Attitude from directions: Wahba's problem, minimise `½ Σ wᵢ |rᵢ − R bᵢ|²` over rotations `R`.
//!
//! Sources: Wahba, SIAM Review 7(3), 1965, problem 65-1; Shuster and Oh, *Three-axis attitude determination
//! from vector observations*, JGCD 4(1), 1981; Markley, *Attitude determination using vector observations
//! and the singular value decomposition*, J. Astronautical Sciences 36(3), 1988; Markley and Mortari,
//! *Quaternion attitude estimation using vector observations*, J. Astronautical Sciences 48(2-3), 2000.
//! They write the attitude matrix `A` from inertial to body; here `R = Aᵀ`, body to inertial.

use crate::linalg::{Matrix, Vector, from_fn, mul, symmetric, transpose, zeros};
use crate::quaternion::{Quaternion, cross, dot3, from_matrix, multiply, norm_squared, normalise, tangents, to_matrix};
use nalgebra::SymmetricEigen;
use thiserror::Error;

type Matrix3 = Matrix<f64, 3, 3>;

/// Least information about the weakest axis, relative to the strongest one. Below it, rounding alone
/// turns the answer by more than 1e-4 rad about that axis: two equally good directions closer than 2e-6 rad.
pub const LEAST_INFORMATION: f64 = 1e-12;

/// How far from the optimum a result of QUEST may be, rad.
const QUEST_TOLERANCE: f64 = 1e-8;

/// How the optimum is found. All lead to the same attitude, to rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Singular value decomposition of the attitude profile matrix (Markley 1988).
    #[default]
    Svd,
    /// Davenport's q method: the eigenvector of the largest eigenvalue of his 4×4 matrix.
    Davenport,
    /// QUEST: that eigenvalue by Newton's method on the characteristic equation (Shuster and Oh 1981), with
    /// the method of sequential rotations. The equation loses digits where the field is narrow or the vectors'
    /// accuracies are unequal; a result further than 1e-8 rad from the optimum is replaced by Davenport's.
    Quest,
}

/// The vectors of one frame. A row with a number that is not finite, or without length or weight, is left out.
#[derive(Clone, Copy, Debug)]
pub struct Vectors<'a> {
    /// Directions in the body frame, of any length.
    pub body: &'a [[f64; 3]],
    /// The same directions in the inertial frame.
    pub inertial: &'a [[f64; 3]],
    /// 1-sigma noise of each vector about any axis across it, rad.
    pub sigma: Option<&'a [f64]>,
    /// Weights; without them `1/σ²`, or one.
    pub weights: Option<&'a [f64]>,
}

/// The attitude of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// `q_ib`, `w ≥ 0`.
    pub q: Quaternion<f64>,
    /// Covariance of the attitude error in the body frame, rad²; NaN without `sigma`.
    pub covariance: Matrix3,
    /// Wahba's loss, `½ Σ wᵢ |rᵢ − R bᵢ|²`.
    pub loss: f64,
    /// Number of vectors used.
    pub vectors: usize,
}

/// Vectors that do not determine the attitude.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("{vectors} vectors leave the turn about the body axis {axis:?} unobservable")]
pub struct Unobservable {
    /// Number of vectors used.
    pub vectors: usize,
    /// Unit vector in the body frame about which any turn fits; `None` without any vector.
    pub axis: Option<Vector<f64, 3>>,
}

/// The optimal attitude of one frame.
///
/// # Errors
/// [`Unobservable`] without vectors, with one, with vectors on one line (or within rounding of it), and with
/// vectors that contradict each other so that two attitudes fit equally well.
pub fn solve(frame: &Vectors<'_>, method: Method) -> Result<Fix, Unobservable> {
    let rows = Rows::new(frame);
    let profile = rows.profile();
    let vectors = rows.count();
    if vectors == 0 {
        return Err(Unobservable { vectors, axis: None });
    }
    let optimum = match method {
        Method::Svd => Optimum::new(&profile, svd(&profile)),
        Method::Davenport => Optimum::new(&profile, davenport(&profile)),
        Method::Quest => quest(&profile, rows.used().map(|r| r.weight).sum())
            .map(|q| Optimum::new(&profile, q))
            .filter(|o| o.observable() && o.distance() < QUEST_TOLERANCE)
            .unwrap_or_else(|| Optimum::new(&profile, davenport(&profile))),
    };
    let unobservable = Unobservable { vectors, axis: Some(optimum.axis) };
    if !optimum.observable() {
        return Err(unobservable);
    }
    let covariance = rows.covariance().ok_or(unobservable)?;
    Ok(Fix { q: optimum.q, covariance, loss: rows.loss(&optimum.q), vectors })
}

/// One vector pair of unit length.
struct Row {
    body: Vector<f64, 3>,
    inertial: Vector<f64, 3>,
    /// In units of the largest weight.
    weight: f64,
    sigma: f64,
}

struct Rows<'a> {
    frame: &'a Vectors<'a>,
    /// Smallest sigma and largest weight: the numbers between are near one, whatever their units.
    sigma: f64,
    weight: f64,
}

impl<'a> Rows<'a> {
    fn new(frame: &'a Vectors<'a>) -> Self {
        let mut rows = Self { frame, sigma: 1.0, weight: 1.0 };
        let smallest = rows.used().map(|r| r.sigma).fold(f64::INFINITY, f64::min);
        rows.sigma = if smallest.is_finite() { smallest } else { 1.0 };
        let largest = rows.used().map(|r| r.weight).fold(0.0, f64::max);
        rows.weight = if largest > 0.0 { largest } else { 1.0 };
        rows
    }
    fn used(&self) -> impl Iterator<Item = Row> + '_ {
        (0..self.frame.body.len()).filter_map(|k| self.row(k))
    }
    fn row(&self, k: usize) -> Option<Row> {
        let f = self.frame;
        let (body, inertial) = (direction(&f.body[k])?, direction(&f.inertial[k])?);
        let sigma = f.sigma.map_or(1.0, |s| s[k] / self.sigma);
        let weight = f.weights.map_or(1.0 / (sigma * sigma), |w| w[k]) / self.weight;
        (weight > 0.0 && sigma > 0.0).then_some(Row { body, inertial, weight, sigma })
    }
    fn count(&self) -> usize {
        self.used().count()
    }
    /// Attitude profile matrix `Σ w r bᵀ` (Shuster and Oh's `Bᵀ`).
    fn profile(&self) -> Matrix3 {
        self.used().fold(zeros(), |m, r| from_fn(|i, j| (r.weight * r.inertial[i]).mul_add(r.body[j], m[(i, j)])))
    }
    /// `½ Σ w |r − R b|²`, from the residuals: a difference of sums would lose half of the digits.
    fn loss(&self, q: &Quaternion<f64>) -> f64 {
        let turn = to_matrix(q);
        let squares = |r: &Row| -> f64 {
            (0..3).map(|i| r.inertial[i] - (0..3).map(|j| turn[(i, j)] * r.body[j]).sum::<f64>()).map(|d| d * d).sum()
        };
        let unit = if self.frame.weights.is_some() { self.weight } else { self.weight / (self.sigma * self.sigma) };
        0.5 * unit * self.used().map(|r| r.weight * squares(&r)).sum::<f64>()
    }
    /// `[Σ (I − b bᵀ)/σ²]⁻¹` (Shuster and Oh's measurement model); with weights of another
    /// kind `H⁻¹ [Σ w² σ² (I − b bᵀ)] H⁻¹`, `H = Σ w (I − b bᵀ)`, the same to first order. NaN without
    /// sigma, `None` if there is no inverse.
    fn covariance(&self) -> Option<Matrix3> {
        if self.frame.sigma.is_none() {
            return Some(from_fn(|_, _| f64::NAN));
        }
        let inverse = self.information(|r| r.weight).cholesky()?.inverse();
        let p = if self.frame.weights.is_none() {
            inverse / self.weight
        } else {
            inverse * self.information(|r| (r.weight * r.sigma).powi(2)) * inverse
        };
        let unit = self.sigma * self.sigma;
        Some(symmetric(|i, j| unit * 0.5 * (p[(i, j)] + p[(j, i)])))
    }
    /// `Σ c (I − b bᵀ)`, written so that the diagonal has no differences.
    fn information(&self, c: impl Fn(&Row) -> f64) -> Matrix3 {
        self.used().fold(zeros(), |m, r| {
            let (c, b) = (c(&r), r.body);
            m + symmetric(|i, j| {
                let [k, l] = [(i + 1) % 3, (i + 2) % 3];
                c * if i == j { b[k] * b[k] + b[l] * b[l] } else { -b[i] * b[j] }
            })
        })
    }
}

/// Unit vector; `None` if a component is not finite or all are zero.
fn direction(v: &[f64; 3]) -> Option<Vector<f64, 3>> {
    let largest = v.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
    if !(v.iter().all(|c| c.is_finite()) && largest > 0.0) {
        return None;
    }
    let scaled = v.map(|c| c / largest);
    let norm = dot3(&scaled, &scaled).sqrt();
    Some(scaled.map(|c| c / norm))
}

/// A stationary point of the loss and its curvature in the body frame.
struct Optimum {
    q: Quaternion<f64>,
    gradient: Vector<f64, 3>,
    /// Eigenvalues and eigenvectors of the second derivative.
    curvature: SymmetricEigen<f64, nalgebra::U3>,
    /// Axis of least curvature.
    axis: Vector<f64, 3>,
}

impl Optimum {
    /// With `M = Rᵀ B`: gradient of the gain `Σ w b × Rᵀ r`, second derivative of the loss
    /// `H = tr(M) I − (M + Mᵀ)/2`, both for `q ⊗ exp(δθ/2)`.
    fn new(profile: &Matrix3, q: Quaternion<f64>) -> Self {
        let q = if q[0] < 0.0 { q.map(|c| -c) } else { q };
        let m = mul(&transpose(&to_matrix(&q)), profile);
        let trace = m[(0, 0)] + m[(1, 1)] + m[(2, 2)];
        let h: Matrix3 = symmetric(|i, j| if i == j { trace - m[(i, i)] } else { -0.5 * (m[(i, j)] + m[(j, i)]) });
        let curvature = SymmetricEigen::new(h);
        let least = curvature.eigenvalues.imin();
        let axis = std::array::from_fn(|i| curvature.eigenvectors[(i, least)]);
        Self { q, gradient: axial(&m), curvature, axis: towards_positive(axis) }
    }
    fn observable(&self) -> bool {
        let e = &self.curvature.eigenvalues;
        e.min() > LEAST_INFORMATION * e.max()
    }
    /// Length of Newton's step from here to the optimum, rad.
    fn distance(&self) -> f64 {
        let c = &self.curvature;
        let step = |k: usize| (0..3).map(|i| c.eigenvectors[(i, k)] * self.gradient[i]).sum::<f64>() / c.eigenvalues[k];
        (0..3).map(|k| step(k).powi(2)).sum::<f64>().sqrt()
    }
}

/// Of the two signs of an axis, the one whose largest component is positive.
fn towards_positive(axis: Vector<f64, 3>) -> Vector<f64, 3> {
    let largest = axis.iter().fold(0.0, |m: f64, c| if c.abs() > m.abs() { *c } else { m });
    if largest < 0.0 { axis.map(|c| -c) } else { axis }
}

/// `Σ b × r` of `Σ r bᵀ`.
fn axial(m: &Matrix3) -> Vector<f64, 3> {
    [m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]]
}

/// `R = U diag(1, 1, det U det V) Vᵀ` (Markley 1988) from the two largest singular values alone: the
/// third directions are cross products, so both bases are right-handed and the determinant is one.
fn svd(profile: &Matrix3) -> Quaternion<f64> {
    let (u, v) = singular_vectors(profile);
    let (u3, v3) = (cross(&u[0], &u[1]), cross(&v[0], &v[1]));
    from_matrix(&from_fn(|i, j| u[0][i] * v[0][j] + u[1][i] * v[1][j] + u3[i] * v3[j]))
}

/// Left and right singular vectors of the two largest singular values, by one-sided Jacobi rotations: small
/// singular values come out to full relative precision (Demmel and Veselić, SIAM J. Matrix Anal. 13(4), 1992).
fn singular_vectors(m: &Matrix3) -> ([Vector<f64, 3>; 2], [Vector<f64, 3>; 2]) {
    let column = |j: usize| [m[(0, j)], m[(1, j)], m[(2, j)]];
    let mut w = [column(0), column(1), column(2)];
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..30 {
        let turned = [(0, 1), (0, 2), (1, 2)].map(|(p, q)| orthogonalise(&mut w, &mut v, p, q));
        if turned == [false; 3] {
            break;
        }
    }
    let size = w.map(|c| dot3(&c, &c));
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| size[*b].total_cmp(&size[*a]));
    let [first, second, _] = order;
    let unit = |k: usize| w[k].map(|c| c / size[k].sqrt());
    let u1 = unit(first);
    if size[second] <= size[first] * f64::EPSILON.powi(2) {
        // one direction only: any second one will do, it is found unobservable later
        return ([u1, tangents(&u1)[0]], [v[first], tangents(&v[first])[0]]);
    }
    ([u1, unit(second)], [v[first], v[second]])
}

/// Makes columns `p` and `q` of `w` orthogonal by a rotation that `v` keeps; whether one was needed.
fn orthogonalise(w: &mut [Vector<f64, 3>; 3], v: &mut [Vector<f64, 3>; 3], p: usize, q: usize) -> bool {
    let (a, b, c) = (dot3(&w[p], &w[p]), dot3(&w[q], &w[q]), dot3(&w[p], &w[q]));
    if c.abs() <= f64::EPSILON * (a * b).sqrt() {
        return false;
    }
    let zeta = (b - a) / (2.0 * c);
    let t = 1.0_f64.copysign(zeta) / (zeta.abs() + zeta.hypot(1.0));
    let cos = 1.0 / t.hypot(1.0);
    let sin = cos * t;
    for m in [w, v] {
        let (x, y) = (m[p], m[q]);
        m[p] = std::array::from_fn(|i| cos * x[i] - sin * y[i]);
        m[q] = std::array::from_fn(|i| sin * x[i] + cos * y[i]);
    }
    true
}

/// Davenport's matrix: the loss is `Σ w − qᵀ K q`.
fn davenport_matrix(profile: &Matrix3) -> Matrix<f64, 4, 4> {
    let z = axial(profile);
    let trace = profile[(0, 0)] + profile[(1, 1)] + profile[(2, 2)];
    symmetric(|i, j| match (i, j) {
        (0, 0) => trace,
        (i, 0) => z[i - 1],
        (i, j) if i == j => 2.0 * profile[(i - 1, i - 1)] - trace,
        (i, j) => profile[(i - 1, j - 1)] + profile[(j - 1, i - 1)],
    })
}

fn davenport(profile: &Matrix3) -> Quaternion<f64> {
    let eigen = SymmetricEigen::new(davenport_matrix(profile));
    let largest = eigen.eigenvalues.imax();
    normalise(&std::array::from_fn(|i| eigen.eigenvectors[(i, largest)]))
}

/// QUEST from `λ₀ = Σ w` (Shuster and Oh 1981); `None` where it breaks down.
fn quest(profile: &Matrix3, total: f64) -> Option<Quaternion<f64>> {
    let b = profile / total;
    let k = davenport_matrix(&b);
    let lambda = largest_root(&b);
    // sequential rotations: half a turn of the body about one axis beforehand, so that the scalar part,
    // by which QUEST divides, is not small; the diagonal tells which one to try first
    let mut order = [0, 1, 2, 3];
    order.sort_by(|i, j| k[(*j, *j)].total_cmp(&k[(*i, *i)]));
    let mut best: Option<(f64, Quaternion<f64>)> = None;
    for axis in order {
        let turned = from_fn(|i, j| if axis == 0 || j + 1 == axis { b[(i, j)] } else { -b[(i, j)] });
        let q = quest_quaternion(&turned, lambda);
        let n = norm_squared(&q);
        let scalar = q[0] * q[0] / n;
        if !(scalar.is_finite() && n > 0.0) {
            continue;
        }
        let mut back = [0.0; 4];
        back[axis] = 1.0;
        if best.is_none_or(|(s, _)| scalar > s) {
            best = Some((scalar, normalise(&multiply(&q, &back))));
        }
        if scalar > 0.2 {
            break; // one of the four has at least a quarter
        }
    }
    best.map(|(_, q)| q)
}

/// Symmetric part `S = B + Bᵀ`, its adjoint's trace and its determinant.
fn quest_invariants(b: &Matrix3) -> (Matrix3, f64, f64) {
    let s = b + transpose(b);
    let kappa = s[(1, 1)] * s[(2, 2)] - s[(1, 2)] * s[(2, 1)] + s[(0, 0)] * s[(2, 2)] - s[(0, 2)] * s[(2, 0)]
        + s[(0, 0)] * s[(1, 1)]
        - s[(0, 1)] * s[(1, 0)];
    (s, kappa, s.determinant())
}

/// Largest root of `λ⁴ − (a + b) λ² − c λ + (a b + c σ − d)` by Newton's method from one, from above.
fn largest_root(profile: &Matrix3) -> f64 {
    let (s, kappa, delta) = quest_invariants(profile);
    let sigma = 0.5 * s.trace();
    let z = nalgebra::Vector3::from(axial(profile));
    let sz = s * z;
    let (a, b) = (sigma * sigma - kappa, sigma * sigma + z.norm_squared());
    let (c, d) = (delta + z.dot(&sz), sz.norm_squared());
    let mut lambda: f64 = 1.0;
    for _ in 0..20 {
        let value = lambda.mul_add(lambda * (lambda * lambda - a - b) - c, a * b + c * sigma - d);
        let slope = lambda.mul_add(4.0 * lambda * lambda - 2.0 * (a + b), -c);
        let step = value / slope;
        if !(step.is_finite() && step > f64::EPSILON) {
            break; // from above all steps go down, until rounding rules
        }
        lambda -= step;
    }
    lambda
}

/// Quaternion of the eigenvalue, not normalised: `((λ + σ) α − Δ, (α I + (λ − σ) S + S²) z)`.
fn quest_quaternion(profile: &Matrix3, lambda: f64) -> Quaternion<f64> {
    let (s, kappa, delta) = quest_invariants(profile);
    let sigma = 0.5 * s.trace();
    let z = nalgebra::Vector3::from(axial(profile));
    let alpha = lambda * lambda - sigma * sigma + kappa;
    let sz = s * z;
    let x = z * alpha + sz * (lambda - sigma) + s * sz;
    [(lambda + sigma) * alpha - delta, x[0], x[1], x[2]]
}

#[cfg(test)]
#[path = "wahba_tests.rs"]
mod tests;

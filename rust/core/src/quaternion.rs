//! Unit quaternions: Hamilton's product, scalar first `(w, x, y, z)`.
//!
//! `q_ab` takes `b` components to `a` components, `v_a = q_ab ⊗ v_b ⊗ q_ab*`; a rotation vector is in
//! radians and acts on the right, `q ⊗ exp(δθ/2)`. Formulas: Solà, *Quaternion kinematics for the
//! error-state Kalman filter*, 2017 (arXiv:1711.02508), equation numbers below.

use crate::linalg::{Matrix, Vector, zeros};
use crate::scalar::{Level, Mask, Real, Run};

/// A quaternion `(w, x, y, z)`.
pub type Quaternion<T> = [T; 4];

/// No rotation.
#[inline(always)]
pub fn unit<T: Real>() -> Quaternion<T> {
    [T::one(), T::zero(), T::zero(), T::zero()]
}

/// Product `a ⊗ b` (Solà eq. 12).
#[inline(always)]
pub fn multiply<T: Real>(a: &Quaternion<T>, b: &Quaternion<T>) -> Quaternion<T> {
    [
        (-a[3]).mul_add(b[3], (-a[2]).mul_add(b[2], (-a[1]).mul_add(b[1], a[0] * b[0]))),
        (-a[3]).mul_add(b[2], a[2].mul_add(b[3], a[1].mul_add(b[0], a[0] * b[1]))),
        a[3].mul_add(b[1], a[2].mul_add(b[0], (-a[1]).mul_add(b[3], a[0] * b[2]))),
        a[3].mul_add(b[0], (-a[2]).mul_add(b[1], a[1].mul_add(b[2], a[0] * b[3]))),
    ]
}

/// Conjugate: the inverse rotation of a unit quaternion.
#[inline(always)]
pub fn conjugate<T: Real>(q: &Quaternion<T>) -> Quaternion<T> {
    [q[0], -q[1], -q[2], -q[3]]
}

/// Squared norm.
#[inline(always)]
pub fn norm_squared<T: Real>(q: &Quaternion<T>) -> T {
    q[0].mul_add(q[0], q[1].mul_add(q[1], q[2].mul_add(q[2], q[3] * q[3])))
}

/// The same direction at length one.
#[inline(always)]
pub fn normalise<T: Real>(q: &Quaternion<T>) -> Quaternion<T> {
    let s = norm_squared(q).sqrt().recip();
    [q[0] * s, q[1] * s, q[2] * s, q[3] * s]
}

/// Removes rounding drift from an almost-unit quaternion: one Newton step for `1/|q|`, without a
/// square root or a division. The error of the norm is squared at each call.
#[inline(always)]
pub fn renormalise<T: Real>(q: &Quaternion<T>) -> Quaternion<T> {
    let s = norm_squared(q).mul_add(T::splat(-0.5), T::splat(1.5));
    [q[0] * s, q[1] * s, q[2] * s, q[3] * s]
}

/// Rotates a vector: `q ⊗ v ⊗ q*`.
#[inline(always)]
pub fn rotate<T: Real>(q: &Quaternion<T>, v: &Vector<T, 3>) -> Vector<T, 3> {
    // v + 2 w (u × v) + 2 u × (u × v), u the vector part
    let u = [q[1], q[2], q[3]];
    let t = cross(&u, v);
    let t = [t[0] + t[0], t[1] + t[1], t[2] + t[2]];
    let s = cross(&u, &t);
    [q[0].mul_add(t[0], v[0] + s[0]), q[0].mul_add(t[1], v[1] + s[1]), q[0].mul_add(t[2], v[2] + s[2])]
}

/// `a × b`
#[inline(always)]
pub fn cross<T: Real>(a: &Vector<T, 3>, b: &Vector<T, 3>) -> Vector<T, 3> {
    [a[1].mul_add(b[2], -(a[2] * b[1])), a[2].mul_add(b[0], -(a[0] * b[2])), a[0].mul_add(b[1], -(a[1] * b[0]))]
}

/// `a · b`
#[inline(always)]
pub fn dot3<T: Real>(a: &Vector<T, 3>, b: &Vector<T, 3>) -> T {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

// series in the squared half angle, to double precision up to half a radian of the angle
const SINC: [f64; 6] = [-1.0 / 39_916_800.0, 1.0 / 362_880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0];
const COS: [f64; 7] = [1.0 / 479_001_600.0, -1.0 / 3_628_800.0, 1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5, 1.0];

/// `[cos(θ/2), sin(θ/2)/θ]` of a squared angle: series while every lane is below half a radian, library functions
/// beyond.
#[inline(always)]
fn half_angle<T: Real>(theta2: T) -> [T; 2] {
    let h2 = theta2 * 0.25;
    let series = [h2.series(COS), h2.series(SINC) * 0.5];
    if T::splat(0.25).gt(theta2).all() { series } else { half_angle_large(theta2, series) }
}

/// Lane by lane: what a lane gets does not depend on the others.
#[cold]
#[inline(never)]
fn half_angle_large<T: Real>(theta2: T, series: [T; 2]) -> [T; 2] {
    let small = T::splat(0.25).gt(theta2);
    let angle = theta2.sqrt();
    let closed = [angle.map(|a| (0.5 * a).cos()), angle.map(|a| (0.5 * a).sin() / a)];
    [T::select(small, series[0], closed[0]), T::select(small, series[1], closed[1])]
}

/// Quaternion of a rotation vector (Solà eq. 101).
#[inline(always)]
pub fn exp<T: Real>(v: &Vector<T, 3>) -> Quaternion<T> {
    let [c, s] = half_angle(dot3(v, v));
    [c, s * v[0], s * v[1], s * v[2]]
}

/// Rotation vector of a unit quaternion, the shortest one (Solà eq. 105).
#[inline(always)]
pub fn log<T: Real>(q: &Quaternion<T>) -> Vector<T, 3> {
    // 2 asin(s) / s in powers of s²
    const ASINC: [f64; 8] = [
        2.0 * 0.013_964_843_75,
        2.0 * 0.017_352_764_423_076_924,
        2.0 * 0.022_372_159_090_909_092,
        2.0 * 0.030_381_944_444_444_444,
        2.0 * 0.044_642_857_142_857_144,
        2.0 * 0.075,
        2.0 / 6.0,
        2.0,
    ];
    let s2 = q[1].mul_add(q[1], q[2].mul_add(q[2], q[3] * q[3]));
    let series = s2.series(ASINC).copysign(q[0]);
    let k = if T::splat(0.01).gt(s2).all() { series } else { log_large(q, s2, series) };
    [k * q[1], k * q[2], k * q[3]]
}

#[cold]
#[inline(never)]
fn log_large<T: Real>(q: &Quaternion<T>, s2: T, series: T) -> T {
    let n = s2.sqrt();
    let closed = T::from_lanes(|i| {
        let (n, w) = (n.lane(i), q[0].lane(i));
        (2.0 * n.atan2(w.abs()) / n).copysign(w)
    });
    T::select(T::splat(0.01).gt(s2), series, closed)
}

/// Rotation vector that leads from `a` to `b` in the frame of the right-hand side: `log(a* ⊗ b)`.
#[inline(always)]
pub fn difference<T: Real>(a: &Quaternion<T>, b: &Quaternion<T>) -> Vector<T, 3> {
    log(&multiply(&conjugate(a), b))
}

/// Angle of the rotation between two attitudes, in `[0, π]`.
#[inline(always)]
pub fn angle_between(a: &Quaternion<f64>, b: &Quaternion<f64>) -> f64 {
    let d = multiply(&conjugate(a), b);
    2.0 * dot3(&[d[1], d[2], d[3]], &[d[1], d[2], d[3]]).sqrt().atan2(d[0].abs())
}

/// Rotation matrix (Solà eq. 115): `v_a = R v_b`.
#[inline(always)]
pub fn to_matrix<T: Real>(q: &Quaternion<T>) -> Matrix<T, 3, 3> {
    let [w, x, y, z] = *q;
    let one = T::one();
    let mut r = zeros();
    r[(0, 0)] = one - (y * y + z * z) * 2.0;
    r[(0, 1)] = (x * y - w * z) * 2.0;
    r[(0, 2)] = (x * z + w * y) * 2.0;
    r[(1, 0)] = (x * y + w * z) * 2.0;
    r[(1, 1)] = one - (x * x + z * z) * 2.0;
    r[(1, 2)] = (y * z - w * x) * 2.0;
    r[(2, 0)] = (x * z - w * y) * 2.0;
    r[(2, 1)] = (y * z + w * x) * 2.0;
    r[(2, 2)] = one - (x * x + y * y) * 2.0;
    r
}

/// Quaternion of a rotation matrix by Shepperd's method: the branch with the largest component, so
/// that no square root is taken of a small difference. `w ≥ 0`.
pub fn from_matrix(r: &Matrix<f64, 3, 3>) -> Quaternion<f64> {
    let m = |i: usize, j: usize| r[(i, j)];
    let trace = m(0, 0) + m(1, 1) + m(2, 2);
    let largest = m(0, 0).max(m(1, 1)).max(m(2, 2)).max(trace);
    let q = if largest == trace {
        [1.0 + trace, m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)]
    } else if largest == m(0, 0) {
        [m(2, 1) - m(1, 2), 1.0 + m(0, 0) - m(1, 1) - m(2, 2), m(0, 1) + m(1, 0), m(0, 2) + m(2, 0)]
    } else if largest == m(1, 1) {
        [m(0, 2) - m(2, 0), m(0, 1) + m(1, 0), 1.0 - m(0, 0) + m(1, 1) - m(2, 2), m(1, 2) + m(2, 1)]
    } else {
        [m(1, 0) - m(0, 1), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1), 1.0 - m(0, 0) - m(1, 1) + m(2, 2)]
    };
    let q = normalise(&q);
    if q[0] < 0.0 { q.map(|c| -c) } else { q }
}

/// Spherical linear interpolation from `a` (`s = 0`) to `b` (`s = 1`) along the shorter arc.
pub fn slerp(a: &Quaternion<f64>, b: &Quaternion<f64>, s: f64) -> Quaternion<f64> {
    multiply(a, &exp(&difference(a, b).map(|c| c * s)))
}

/// The shortest rotation that takes direction `a` to direction `b`; half a turn about some
/// perpendicular axis when they are opposite. Neither needs unit length.
pub fn shortest_rotation(a: &Vector<f64, 3>, b: &Vector<f64, 3>) -> Quaternion<f64> {
    let (a, b) = (unit_vector(a), unit_vector(b));
    if dot3(&a, &b) >= 0.0 {
        return through_the_middle(&a, &b);
    }
    // more than a quarter turn: half a turn about an axis across both, after the small rotation from −a
    let mut axis = cross(&a, &b);
    if dot3(&axis, &axis) < 1e-30 {
        axis = tangents(&a)[0];
    }
    for _ in 0..2 {
        // twice is enough to make it perpendicular to the last digit, however short it was
        axis = unit_vector(&axis);
        let along = dot3(&a, &axis);
        axis = std::array::from_fn(|i| axis[i] - a[i] * along);
    }
    let axis = unit_vector(&axis);
    multiply(&through_the_middle(&a.map(|c| -c), &b), &[0.0, axis[0], axis[1], axis[2]])
}

/// The unit vector along `v`.
pub fn unit_vector(v: &Vector<f64, 3>) -> Vector<f64, 3> {
    let n = dot3(v, v).sqrt();
    v.map(|c| c / n)
}

/// Shortest rotation between unit vectors at most a quarter turn apart: twice that to half-way.
fn through_the_middle(a: &Vector<f64, 3>, b: &Vector<f64, 3>) -> Quaternion<f64> {
    let half = unit_vector(&[a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
    let axis = cross(a, &half);
    normalise(&[dot3(a, &half), axis[0], axis[1], axis[2]])
}

/// Two unit vectors that make an orthonormal frame with the unit vector `n`, without a branch
/// (Duff et al., *Building an orthonormal basis, revisited*, JCGT 6(1), 2017).
#[inline(always)]
pub fn tangents<T: Real>(n: &Vector<T, 3>) -> [Vector<T, 3>; 2] {
    let sign = T::one().copysign(n[2]);
    let a = -(sign + n[2]).recip();
    let b = n[0] * n[1] * a;
    [[T::one() + sign * n[0] * n[0] * a, sign * b, -(sign * n[0])], [b, sign + n[1] * n[1] * a, -n[1]]]
}

// series of the four coefficients below, to double precision up to half a radian
const C1: [f64; 7] =
    [1.0 / 87_178_291_200.0, -1.0 / 479_001_600.0, 1.0 / 3_628_800.0, -1.0 / 40_320.0, 1.0 / 720.0, -1.0 / 24.0, 0.5];
const C2: [f64; 7] = [
    1.0 / 1_307_674_368_000.0,
    -1.0 / 6_227_020_800.0,
    1.0 / 39_916_800.0,
    -1.0 / 362_880.0,
    1.0 / 5040.0,
    -1.0 / 120.0,
    1.0 / 6.0,
];
// these two weigh corrections of process noise: nine digits of them are plenty
const C3: [f64; 4] = [-1.0 / 3_628_800.0, 1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0];
const C4: [f64; 4] = [-2.0 / 39_916_800.0, 2.0 / 362_880.0, -2.0 / 5040.0, 2.0 / 120.0];

/// What Jacobians and process noise need of a rotation vector of squared length `θ²`:
/// `[(1 − cos θ)/θ², (θ − sin θ)/θ³, (½ − (1 − cos θ)/θ²)/θ², (⅓ − 2 (θ − sin θ)/θ³)/θ²]`.
#[inline(always)]
fn angle_coefficients<T: Real>(theta2: T) -> [T; 4] {
    let series = [theta2.series(C1), theta2.series(C2), theta2.series(C3), theta2.series(C4)];
    if T::splat(0.25).gt(theta2).all() { series } else { angle_coefficients_large(theta2, series) }
}

/// A rotation vector with all that a step of the kinematics needs of it, computed together.
pub(crate) struct Turn<T: Real> {
    /// Matrices of the vector.
    pub(crate) skew: InSkew<T>,
    /// The rotation.
    pub(crate) q: Quaternion<T>,
    /// `sin θ / θ`
    pub(crate) sinc: T,
    /// See [`angle_coefficients`].
    pub(crate) coefficients: [T; 4],
}

impl<T: Real> Turn<T> {
    #[inline(always)]
    pub(crate) fn new(v: &Vector<T, 3>) -> Self {
        let skew = InSkew::new(v);
        let theta2 = skew.theta2();
        let h2 = theta2 * 0.25;
        let mut half = [h2.series(COS), h2.series(SINC) * 0.5];
        let mut others = [T::zero(), theta2.series(C2), theta2.series(C3), theta2.series(C4)];
        if !T::splat(0.25).gt(theta2).all() {
            half = half_angle_large(theta2, half);
            others = angle_coefficients_large(theta2, others);
        }
        let ([cos, s], [_, c2, c3, c4]) = (half, others);
        // sin θ = 2 sin(θ/2) cos(θ/2), 1 − cos θ = 2 sin²(θ/2)
        let sinc = s * cos * 2.0;
        Self { skew, q: [cos, s * v[0], s * v[1], s * v[2]], sinc, coefficients: [s * s * 2.0, c2, c3, c4] }
    }
}

/// Lane by lane: the series where it holds, the closed form elsewhere.
#[cold]
#[inline(never)]
fn angle_coefficients_large<T: Real>(theta2: T, series: [T; 4]) -> [T; 4] {
    fn c1(t2: f64) -> f64 {
        let s = (0.5 * t2.sqrt()).sin();
        2.0 * s * s / t2
    }
    fn c2(t2: f64) -> f64 {
        let t = t2.sqrt();
        (t - t.sin()) / (t2 * t)
    }
    let small = T::splat(0.25).gt(theta2);
    let closed = [
        theta2.map(c1),
        theta2.map(c2),
        theta2.map(|t2| (0.5 - c1(t2)) / t2),
        theta2.map(|t2| (1.0 / 3.0 - 2.0 * c2(t2)) / t2),
    ];
    std::array::from_fn(|i| T::select(small, series[i], closed[i]))
}

/// Right Jacobian of the rotation group: `exp(v + d) ≈ exp(v) ⊗ exp(J d)` (Solà eq. 183).
#[inline(always)]
pub fn right_jacobian<T: Real>(v: &Vector<T, 3>) -> Matrix<T, 3, 3> {
    let skew = InSkew::new(v);
    let [c1, c2, _, _] = angle_coefficients(skew.theta2());
    skew.matrix(T::one(), -c1, c2)
}

/// Left Jacobian of the rotation group: `exp(v + d) ≈ exp(J d) ⊗ exp(v)` (Solà eq. 145), the transpose of
/// the right one.
#[inline(always)]
pub fn left_jacobian<T: Real>(v: &Vector<T, 3>) -> Matrix<T, 3, 3> {
    let skew = InSkew::new(v);
    let [c1, c2, _, _] = angle_coefficients(skew.theta2());
    skew.matrix(T::one(), c1, c2)
}

/// Of `1/θ² − cot(θ/2) / (2θ)`.
const INVERSE: [f64; 4] = [1.0 / 1_209_600.0, 1.0 / 30_240.0, 1.0 / 720.0, 1.0 / 12.0];

/// Inverse of the right Jacobian (Solà eq. 184), for `|v| < 2π`.
#[inline(always)]
pub fn right_jacobian_inverse<T: Real>(v: &Vector<T, 3>) -> Matrix<T, 3, 3> {
    let skew = InSkew::new(v);
    let theta2 = skew.theta2();
    let series = theta2.series(INVERSE);
    let k = if T::splat(1e-2).gt(theta2).all() { series } else { inverse_coefficient(theta2, series) };
    skew.matrix(T::one(), T::splat(0.5), k)
}

/// `1/θ² − cot(θ/2) / (2θ)`, which stays finite at π.
#[cold]
#[inline(never)]
fn inverse_coefficient<T: Real>(theta2: T, series: T) -> T {
    let closed = theta2.map(|theta2| {
        let t = theta2.sqrt();
        (1.0 - 0.5 * t * (0.5 * t).cos() / (0.5 * t).sin()) / theta2
    });
    T::select(T::splat(1e-2).gt(theta2), series, closed)
}

/// Matrices `a I + b [v]× + c [v]×²` of one vector, with `[v]×² = v vᵀ − θ² I`: products are shared.
pub(crate) struct InSkew<T: Real> {
    v: Vector<T, 3>,
    theta2: T,
    /// `v vᵀ` as `(xx, xy, xz, yy, yz, zz)`.
    outer: [T; 6],
}

impl<T: Real> InSkew<T> {
    #[inline(always)]
    pub(crate) fn new(v: &Vector<T, 3>) -> Self {
        let outer = [v[0] * v[0], v[0] * v[1], v[0] * v[2], v[1] * v[1], v[1] * v[2], v[2] * v[2]];
        Self { v: *v, theta2: outer[0] + outer[3] + outer[5], outer }
    }
    /// Squared length of the vector.
    #[inline(always)]
    pub(crate) fn theta2(&self) -> T {
        self.theta2
    }
    /// `a I + c [v]×²`
    #[inline(always)]
    pub(crate) fn even(&self, a: T, c: T) -> Matrix<T, 3, 3> {
        let diagonal = (-c).mul_add(self.theta2, a);
        let [xx, xy, xz, yy, yz, zz] = self.outer;
        let (xy, xz, yz) = (c * xy, c * xz, c * yz);
        let mut m = zeros();
        m[(0, 0)] = c.mul_add(xx, diagonal);
        m[(1, 1)] = c.mul_add(yy, diagonal);
        m[(2, 2)] = c.mul_add(zz, diagonal);
        (m[(0, 1)], m[(1, 0)]) = (xy, xy);
        (m[(0, 2)], m[(2, 0)]) = (xz, xz);
        (m[(1, 2)], m[(2, 1)]) = (yz, yz);
        m
    }
    /// `a I + b [v]× + c [v]×²`
    #[inline(always)]
    pub(crate) fn matrix(&self, a: T, b: T, c: T) -> Matrix<T, 3, 3> {
        let mut m = self.even(a, c);
        let [x, y, z] = [b * self.v[0], b * self.v[1], b * self.v[2]];
        m[(0, 1)] -= z;
        m[(1, 0)] += z;
        m[(0, 2)] += y;
        m[(2, 0)] -= y;
        m[(1, 2)] -= x;
        m[(2, 1)] += x;
        m
    }
}

/// Integrator of the attitude kinematics over one step of constant body rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Integrator {
    /// Closed form: `q ⊗ exp(ω dt)`, exact for a constant rate.
    #[default]
    Exponential,
    /// Classical fourth-order Runge-Kutta on `dq/dt = ½ q ⊗ (0, ω)`, as in the papers.
    Rk4,
}

/// One step of the kinematics `dq/dt = ½ q ⊗ (0, ω_b)` at constant body rate `rate` (rad/s).
#[inline(always)]
pub fn integrate<T: Real>(q: &Quaternion<T>, rate: &Vector<T, 3>, dt: T, integrator: Integrator) -> Quaternion<T> {
    renormalise(&multiply(q, &turn(&[rate[0] * dt, rate[1] * dt, rate[2] * dt], integrator)))
}

/// The rotation that one step of an integrator makes of a constant rate, `rotation = ω dt`.
///
/// Runge and Kutta's four stages on a linear equation are the exponential series up to the fourth power, here
/// with `(0, ω dt/2)² = −s`: multiplied out, the same step for a quarter of the work.
#[inline(always)]
pub(crate) fn turn<T: Real>(rotation: &Vector<T, 3>, integrator: Integrator) -> Quaternion<T> {
    match integrator {
        Integrator::Exponential => exp(rotation),
        Integrator::Rk4 => {
            let s = dot3(rotation, rotation) * 0.25;
            let w = s.series([1.0 / 24.0, -0.5, 1.0]);
            let v = s.series([-1.0 / 12.0, 0.5]);
            // 1/|p|, with |p|² = 1 − s³/72 + s⁴/576
            let short = s * s * s * s.series([1.0 / 576.0, -1.0 / 72.0]);
            let series = short.mul_add(T::splat(-0.5), T::one());
            let small = T::splat(0.01).gt(s);
            let scale = if small.all() { series } else { T::select(small, series, (T::one() + short).sqrt().recip()) };
            let v = v * scale;
            [w * scale, v * rotation[0], v * rotation[1], v * rotation[2]]
        }
    }
}

/// Attitude history under a sequence of body rates: row `k` of the result is the attitude after the
/// first `k` rates, each held for its step; row 0 is `q0`.
///
/// `dt` is one step for all rates, or one for each. `out` has one row more than `rates`.
pub fn propagate(q0: &Quaternion<f64>, rates: &[[f64; 3]], dt: &[f64], integrator: Integrator, out: &mut [[f64; 4]]) {
    let Some((first, rows)) = out.split_first_mut() else { return };
    *first = normalise(q0);
    Level::best().run(Propagation { q0: *first, rates, dt, integrator, rows });
}

/// Steps between two corrections of the length of what is multiplied on, which would wait for each other: rounding moves it by
/// about one unit in the last place a step. A row's own correction delays nothing.
const NORMALISE_EVERY: usize = 16;

/// The loop of [`propagate`], at any instruction set.
struct Propagation<'a> {
    q0: Quaternion<f64>,
    rates: &'a [[f64; 3]],
    dt: &'a [f64],
    integrator: Integrator,
    rows: &'a mut [[f64; 4]],
}

impl Run for Propagation<'_> {
    type Output = ();
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) {
        // one loop for each case: what does not change is not asked for at every step
        match (self.integrator, self.dt) {
            (Integrator::Exponential, [dt]) => self.steps::<T>(
                Integrator::Exponential,
                #[inline(always)]
                |_| *dt,
            ),
            (Integrator::Exponential, dt) => self.steps::<T>(
                Integrator::Exponential,
                #[inline(always)]
                |k| dt[k],
            ),
            (Integrator::Rk4, dt) => self.steps::<T>(
                Integrator::Rk4,
                #[inline(always)]
                |k| if let [dt] = dt { *dt } else { dt[k] },
            ),
        }
    }
}

impl Propagation<'_> {
    #[inline(always)]
    fn steps<T: Real<Mask = bool>>(self, integrator: Integrator, dt: impl Fn(usize) -> f64) {
        let [w, x, y, z] = self.q0;
        let mut q = [T::splat(w), T::splat(x), T::splat(y), T::splat(z)];
        let rates = self.rates.chunks(NORMALISE_EVERY);
        for (chunk, (rates, rows)) in rates.zip(self.rows.chunks_mut(NORMALISE_EVERY)).enumerate() {
            q = renormalise(&q);
            for (k, (rate, row)) in rates.iter().zip(rows).enumerate() {
                let dt = T::splat(dt(chunk * NORMALISE_EVERY + k));
                let [x, y, z] = *rate;
                let rotation = [T::splat(x) * dt, T::splat(y) * dt, T::splat(z) * dt];
                q = multiply(&q, &turn(&rotation, integrator));
                let [w, x, y, z] = renormalise(&q);
                *row = [w.lane(0), x.lane(0), y.lane(0), z.lane(0)];
            }
        }
    }
}

//! Every analytic derivative against differences, the process noise against its definition.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{
    Attitude, AttitudeBias, Calibrated, CalibratedSpace, Calibration, Direction, GuidedInput, GuidedInputs, GyroInput,
    GyroInputs, GyroModel, InertialError, Invariant, Literal, LiteralModel, LiteralSpace, Reference, StarQuaternion,
};
use celestcore_core::linalg::{Matrix, congruence, zeros};
use celestcore_core::manifold::Manifold;
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::quaternion::{Integrator, difference, exp, multiply, right_jacobian, rotate, to_matrix};
use common::{attitude, close, normals, spd};

/// The same models without their analytic derivatives: the traits' differences.
struct Plain<M>(M);
impl Dynamics<6> for Plain<GyroModel> {
    type Space = AttitudeBias;
    type Input = celestcore_core::attitude::GyroInputs;
    fn step<T: celestcore_core::scalar::Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Attitude<T> {
        self.0.step(x, u, t, dt)
    }
    fn noise<T: celestcore_core::scalar::Real>(
        &self,
        x: &Attitude<T>,
        u: &GyroInput<T>,
        t: T,
        dt: T,
    ) -> Matrix<T, 6, 6> {
        self.0.noise(x, u, t, dt)
    }
}
impl Dynamics<6> for Plain<Invariant> {
    type Space = InertialError;
    type Input = GyroInputs;
    fn step<T: celestcore_core::scalar::Real>(&self, x: &Attitude<T>, u: &GyroInput<T>, t: T, dt: T) -> Attitude<T> {
        self.0.step(x, u, t, dt)
    }
    fn noise<T: celestcore_core::scalar::Real>(
        &self,
        x: &Attitude<T>,
        u: &GyroInput<T>,
        t: T,
        dt: T,
    ) -> Matrix<T, 6, 6> {
        self.0.noise(x, u, t, dt)
    }
}
impl Dynamics<18> for Plain<Calibration> {
    type Space = CalibratedSpace;
    type Input = GuidedInputs;
    fn step<T: celestcore_core::scalar::Real>(
        &self,
        x: &Calibrated<T>,
        u: &GuidedInput<T>,
        t: T,
        dt: T,
    ) -> Calibrated<T> {
        self.0.step(x, u, t, dt)
    }
    fn noise<T: celestcore_core::scalar::Real>(
        &self,
        x: &Calibrated<T>,
        u: &GuidedInput<T>,
        t: T,
        dt: T,
    ) -> Matrix<T, 18, 18> {
        self.0.noise(x, u, t, dt)
    }
}
impl Measurement<6, 2> for Plain<Direction> {
    type Space = AttitudeBias;
    type Given = <Direction as Measurement<6, 2>>::Given;
    type Value = <Direction as Measurement<6, 2>>::Value;
    fn predict<T: celestcore_core::scalar::Real>(&self, x: &Attitude<T>, g: &Reference<T>) -> [T; 3] {
        self.0.predict(x, g)
    }
    fn residual<T: celestcore_core::scalar::Real>(&self, z: &[T; 3], zhat: &[T; 3]) -> [T; 2] {
        self.0.residual(z, zhat)
    }
    fn noise<T: celestcore_core::scalar::Real>(&self, g: &Reference<T>) -> Matrix<T, 2, 2> {
        self.0.noise(g)
    }
}
impl Measurement<6, 3> for Plain<StarQuaternion> {
    type Space = AttitudeBias;
    type Given = <StarQuaternion as Measurement<6, 3>>::Given;
    type Value = <StarQuaternion as Measurement<6, 3>>::Value;
    fn predict<T: celestcore_core::scalar::Real>(&self, x: &Attitude<T>, g: &[T; 6]) -> [T; 4] {
        self.0.predict(x, g)
    }
    fn residual<T: celestcore_core::scalar::Real>(&self, z: &[T; 4], zhat: &[T; 4]) -> [T; 3] {
        self.0.residual(z, zhat)
    }
    fn noise<T: celestcore_core::scalar::Real>(&self, g: &[T; 6]) -> Matrix<T, 3, 3> {
        self.0.noise(g)
    }
}

fn models() -> impl Iterator<Item = (GyroModel, Attitude<f64>, GyroInput<f64>, f64)> {
    let mut normal = normals(11);
    // slow and fast rotation, on both sides of the series' limit of half a radian
    (0..60).map(move |round| {
        let turn = [1e-6, 1e-3, 0.3, 0.6, 2.0][round % 5];
        let (x, dt) = (attitude(&mut normal), 0.5);
        let axis: [f64; 3] = std::array::from_fn(|_| normal());
        let length = axis.iter().map(|c| c * c).sum::<f64>().sqrt();
        let rate = std::array::from_fn(|i| x.bias[i] + axis[i] / length * turn / dt);
        let model = GyroModel::new(1e-3, 2e-3, Integrator::Exponential).unwrap();
        (model, x, GyroInput { rate, extra: 1e-7 }, dt)
    })
}

#[test]
fn gyro_transition_is_the_derivative_of_its_step() {
    for (model, x, u, dt) in models() {
        close(&model.transition(&x, &u, 0.0, dt), &Plain(model).transition(&x, &u, 0.0, dt), 1e-9);
    }
}

#[test]
fn gyro_propagation_in_blocks_is_the_dense_one() {
    let mut normal = normals(5);
    for (model, x, u, dt) in models() {
        let p = spd::<6>(&mut normal, 1.0);
        let f = model.transition(&x, &u, 0.0, dt);
        let dense = congruence(&f, &p) + model.noise(&x, &u, 0.0, dt);
        let (y, blocks) = model.propagate(&x, &p, &u, 0.0, dt);
        close(&blocks, &dense, 1e-13 * dense.abs().max());
        assert_eq!(blocks, blocks.transpose());
        assert_eq!(y, model.step(&x, &u, 0.0, dt));
        // also where one of the noises is missing, or both
        for (arw, rrw) in [(model.arw, model.rrw), (model.arw, 0.0), (0.0, model.rrw), (0.0, 0.0)] {
            let (model, u) =
                (GyroModel { arw, rrw, ..model }, GyroInput { extra: if arw > 0.0 { u.extra } else { 0.0 }, ..u });
            let factor = model.noise_factor(&x, &u, 0.0, dt);
            close(&(factor * factor.transpose()), &model.noise(&x, &u, 0.0, dt), 1e-18);
        }
    }
}

/// Exact noise of a step is that of its n parts, each carried to the end: true for every n, and for
/// n to infinity the definition.
#[test]
fn gyro_noise_of_a_step_is_that_of_its_parts() {
    for (model, x, u, dt) in models() {
        let n = 4000;
        let part = dt / f64::from(n);
        let mut q: Matrix<f64, 6, 6> = zeros();
        let mut state = x;
        for _ in 0..n {
            // the plainest form of white noise over a part, so that this is independent of the closed form
            let f = model.transition(&state, &u, 0.0, part);
            let mut white: Matrix<f64, 6, 6> = zeros();
            for i in 0..3 {
                white[(i, i)] = (model.arw * model.arw + u.extra) * part;
                white[(i + 3, i + 3)] = model.rrw * model.rrw * part;
            }
            q = congruence(&f, &q) + white;
            state = model.step(&state, &u, 0.0, part);
        }
        let exact = model.noise(&x, &u, 0.0, dt);
        close(&exact, &q, 3e-4 * exact.abs().max());
        // and exactly so for two halves
        let half = 0.5 * dt;
        let middle = model.step(&x, &u, 0.0, half);
        let f = model.transition(&middle, &u, half, half);
        let two = congruence(&f, &model.noise(&x, &u, 0.0, half)) + model.noise(&middle, &u, half, half);
        close(&exact, &two, 1e-9 * exact.abs().max());
    }
}

#[test]
fn measurements_have_the_derivatives_they_say() {
    let mut normal = normals(17);
    for _ in 0..300 {
        let x = attitude(&mut normal);
        let v: [f64; 3] = std::array::from_fn(|_| normal());
        let n = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let reference = Reference { inertial: v.map(|c| c / n), sigma: 1e-3 };
        close(&Direction.jacobian(&x, &reference), &Plain(Direction).jacobian(&x, &reference), 1e-9);
        let r = [1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6];
        close(&StarQuaternion.jacobian(&x, &r), &Plain(StarQuaternion).jacobian(&x, &r), 1e-9);

        let p = spd::<6>(&mut normal, 1.0);
        let h = Direction.jacobian(&x, &reference);
        close(&Direction.project::<f64, 6>(&h, &p), &(p * h.transpose()), 1e-12);
        let h = StarQuaternion.jacobian(&x, &r);
        close(&StarQuaternion.project::<f64, 6>(&h, &p), &(p * h.transpose()), 1e-12);
    }
}

#[test]
fn direction_residual_is_the_arc() {
    let mut normal = normals(19);
    for angle in [0.0, 1e-9, 1e-3, 0.5, 1.5, 3.0] {
        let x = attitude(&mut normal);
        let zhat = rotate(&x.q, &[0.6, 0.0, 0.8]);
        let z = rotate(&multiply(&x.q, &exp(&[0.0, angle, 0.0])), &[0.6, 0.0, 0.8]);
        let r = Direction.residual(&z, &zhat);
        assert!((r[0].hypot(r[1]) - angle).abs() < 1e-13, "{r:?} {angle}");
    }
}

#[test]
fn right_jacobian_is_the_derivative_of_exp() {
    let mut normal = normals(23);
    for length in [0.0, 1e-8, 1e-3, 0.49, 0.51, 2.0, 3.1] {
        let v: [f64; 3] = std::array::from_fn(|_| normal());
        let n = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let v = v.map(|c| c / n * length);
        let h = 1e-6;
        let difference = Matrix::<f64, 3, 3>::from_fn(|i, k| {
            let image = |e: f64| {
                let mut moved = v;
                moved[k] += e;
                celestcore_core::quaternion::difference(&exp(&v), &exp(&moved))[i]
            };
            (image(h) - image(-h)) / (2.0 * h)
        });
        close(&right_jacobian(&v), &difference, 1e-9);
        let product = right_jacobian(&v) * celestcore_core::quaternion::right_jacobian_inverse(&v);
        close(&product, &Matrix::<f64, 3, 3>::identity(), 1e-13);
    }
    let x = attitude(&mut normal);
    assert_eq!(AttitudeBias::reset(&x, &[0.0; 6]), Matrix::<f64, 6, 6>::identity());
}

#[test]
fn invariant_transition_is_the_derivative_of_its_step() {
    for (model, x, u, dt) in models() {
        let (model, other) = (Invariant(model), Plain(Invariant(model)));
        close(&model.transition(&x, &u, 0.0, dt), &other.transition(&x, &u, 0.0, dt), 1e-9);
        // errors in inertial axes do not turn with the body
        assert_eq!(model.transition(&x, &u, 0.0, dt).fixed_view::<3, 3>(0, 0), Matrix::<f64, 3, 3>::identity());
    }
}

/// The same error, written in inertial axes at either end of the step.
#[test]
fn invariant_step_is_the_gyros_in_turned_axes() {
    let beside_bias = |q: &[f64; 4]| {
        let mut m = Matrix::<f64, 6, 6>::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&to_matrix(q));
        m
    };
    for (model, x, u, dt) in models() {
        let y = model.step(&x, &u, 0.0, dt);
        let invariant = Invariant(model);
        assert_eq!(invariant.step(&x, &u, 0.0, dt), y);
        let (before, after) = (beside_bias(&x.q), beside_bias(&y.q));
        let f = after * model.transition(&x, &u, 0.0, dt) * before.transpose();
        close(&invariant.transition(&x, &u, 0.0, dt), &f, 1e-12);
        let q = after * model.noise(&x, &u, 0.0, dt) * after.transpose();
        close(&invariant.noise(&x, &u, 0.0, dt), &q, 1e-18);
    }
}

/// Where the error quaternion goes: the true attitude turns at the true rate, the reference at the
/// estimated one. Runge-Kutta on eq. 13 must find it; without its missing term it is off by the bias
/// error times the step.
#[test]
fn literal_step_is_that_of_truth_and_reference() {
    let mut normal = normals(29);
    for (model, at, u, _) in models() {
        let (db, dt): ([f64; 3], f64) = (std::array::from_fn(|_| 0.05 * normal()), 1e-3);
        let x = Literal { q: at.q, bias: at.bias, dq: exp(&std::array::from_fn(|_| 0.1 * normal())), db };
        let y = LiteralModel(model).step(&x, &u, 0.0, dt);
        let truth = Attitude { q: multiply(&x.q, &x.dq), bias: std::array::from_fn(|i| at.bias[i] + db[i]) };
        let moved = model.step(&truth, &u, 0.0, dt);
        let off = difference(&moved.q, &multiply(&y.q, &y.dq));
        assert!(off.iter().all(|c| c.abs() < 1e-12), "{off:?}");
        assert_eq!((y.bias, y.db), (x.bias, x.db));
        let carried = difference(&model.step(&at, &u, 0.0, dt).q, &y.q);
        assert!(carried.iter().all(|c| c.abs() < 1e-15));
    }
}

/// An error quaternion is half the rotation vector, to first order; its noise a quarter.
#[test]
fn literal_noise_is_the_gyros_on_half_angles() {
    for (model, at, u, dt) in models() {
        let x = Literal { q: at.q, bias: at.bias, dq: [1.0, 0.0, 0.0, 0.0], db: [0.0; 3] };
        let h = 1e-6;
        let spread = Matrix::<f64, 7, 6>::from_fn(|i, j| {
            let image = |e: f64| {
                let mut d = [0.0; 6];
                d[j] = e;
                let moved = AttitudeBias::retract(&at, &d);
                LiteralSpace::local(&x, &Literal { q: moved.q, bias: moved.bias, ..x })[i]
            };
            (image(h) - image(-h)) / (2.0 * h)
        });
        let expected = spread * model.noise(&at, &u, 0.0, dt) * spread.transpose();
        close(&LiteralModel(model).noise(&x, &u, 0.0, dt), &expected, 1e-9 * expected.abs().max());
    }
}

/// The rate for which the gyro reads `u`.
fn corrected(x: &Calibrated<f64>, u: &GyroInput<f64>) -> [f64; 3] {
    let g = &x.gyro;
    let m = Matrix::<f64, 3, 3>::new(1.0 + g[0], g[3], g[4], g[5], 1.0 + g[1], g[6], g[7], g[8], 1.0 + g[2]);
    let rate = m.lu().solve(&Matrix::<f64, 3, 1>::from_fn(|i, _| u.rate[i] - x.bias[i])).unwrap();
    [rate[0], rate[1], rate[2]]
}

/// The rate that guides is the corrected one here: then the transition is a derivative.
fn calibrated() -> impl Iterator<Item = (Calibration, Calibrated<f64>, GuidedInput<f64>, f64)> {
    let mut normal = normals(31);
    models().map(move |(model, x, u, dt)| {
        let gyro = std::array::from_fn(|_| 0.02 * normal());
        let alignment = exp(&std::array::from_fn(|_| 0.5 * normal()));
        let calibration = Calibration { model, aligned: Some(1), prior: [0.01, 0.01, 0.01] };
        let x = Calibrated { q: x.q, bias: x.bias, gyro, alignment };
        (calibration, x, GuidedInput { gyro: u, guide: corrected(&x, &u) }, dt)
    })
}

#[test]
fn calibration_transition_is_the_derivative_of_its_step() {
    for (model, x, u, dt) in calibrated() {
        close(&model.transition(&x, &u, 0.0, dt), &Plain(model).transition(&x, &u, 0.0, dt), 2e-9);
    }
}

/// `(I + M) ω + b` is what the gyro reads, entry by entry.
#[test]
fn calibration_turns_at_the_corrected_rate() {
    for (calibration, x, u, dt) in calibrated() {
        let plain = Attitude { q: x.q, bias: [0.0; 3] };
        let input = GyroInput { rate: corrected(&x, &u.gyro), extra: u.gyro.extra };
        let (y, expected) = (calibration.step(&x, &u, 0.0, dt), calibration.model.step(&plain, &input, 0.0, dt));
        let off = difference(&expected.q, &y.q);
        assert!(off.iter().all(|c| c.abs() < 1e-13), "{off:?}");
        assert_eq!(Calibrated { q: x.q, ..y }, x);
        let noise = calibration.noise(&x, &u, 0.0, dt);
        close(&noise.fixed_view::<6, 6>(0, 0).into_owned(), &calibration.model.noise(&plain, &input, 0.0, dt), 1e-15);
        assert_eq!(
            noise.iter().filter(|v| **v != 0.0).count(),
            noise.fixed_view::<6, 6>(0, 0).iter().filter(|v| **v != 0.0).count()
        );
    }
}

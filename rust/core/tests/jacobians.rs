//! Every analytic derivative against differences, the process noise against its definition.
#![allow(clippy::unwrap_used)]

mod common;

use celestcore_core::attitude::{Attitude, AttitudeBias, Direction, GyroInput, GyroModel, Reference, StarQuaternion};
use celestcore_core::linalg::{Matrix, congruence, zeros};
use celestcore_core::manifold::Manifold;
use celestcore_core::model::{Dynamics, Measurement};
use celestcore_core::quaternion::{Integrator, exp, multiply, right_jacobian, rotate};
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
        let factor = model.noise_factor(&x, &u, 0.0, dt);
        close(&(factor * factor.transpose()), &model.noise(&x, &u, 0.0, dt), 1e-18);
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

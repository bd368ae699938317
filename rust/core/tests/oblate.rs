//! Steps under closed-form gravity beside those of the general integrator, and the noise's root beside the noise.
#![allow(clippy::unwrap_used)]

use celestcore_core::linalg::{identity, square};
use celestcore_core::model::Dynamics;
use celestcore_core::orbit::{ForceModel, Gravity, J2, Method, OrbitModel, propagate};

const START: [f64; 6] = [5.1e6, -3.2e6, 3.4e6, 3.9e3, 6.1e3, 0.7e3];

fn forces() -> [ForceModel; 2] {
    let j2 = J2::new(3.986_004_415e14, 6_378_136.3, 1.082_636e-3).unwrap();
    [Gravity::J2(j2), Gravity::TwoBody { mu: 3.986_004_415e14 }].map(|g| ForceModel::gravity(g).unwrap())
}

#[test]
fn state_and_transition_are_those_of_the_variational_equations() {
    for force in forces() {
        let model = OrbitModel::new(force.clone(), 4e-7, 30.0).unwrap();
        // within one step, of one step, and of several
        for span in [1.0, 30.0, 90.0, 600.0] {
            let method = Method::Rk4 { step: 30.0 };
            let expected = propagate(&force, &START, &[0.0, span], method, true, &mut |_| Ok(())).unwrap();
            let (x, f, _) = model.carry(&START, &identity(), &(), 0.0, span);
            assert_eq!(x, model.step(&START, &(), 0.0, span));
            for i in 0..6 {
                let size = if i < 3 { 7e6 } else { 7e3 };
                assert!((x[i] - expected.state[1][i]).abs() < 1e-14 * size * (1.0 + span / 30.0), "{span} {i}");
                for j in 0..6 {
                    let scale = match (i < 3, j < 3) {
                        (true, false) => span,
                        (false, true) => 1.2e-6 * span,
                        _ => 1.0,
                    };
                    let off = (f[(i, j)] - expected.stm[1][i][j]).abs();
                    assert!(off < 1e-14 * scale * (1.0 + span / 30.0), "{span} {i} {j} {off}");
                }
            }
        }
    }
}

#[test]
fn the_root_of_the_noise_is_one() {
    let [force, _] = forces();
    for (psd, span) in [(4e-7, 10.0), (1e-3, 0.1), (0.0, 5.0)] {
        let model = OrbitModel::new(force.clone(), psd, 30.0).unwrap();
        let root = square(&model.noise_factor(&START, &(), 0.0, span));
        let noise = model.noise(&START, &(), 0.0, span);
        assert!((root - noise).iter().zip(noise.iter()).all(|(off, q)| off.abs() <= 1e-15 * q.abs()), "{psd} {span}");
    }
}

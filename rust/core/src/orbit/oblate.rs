//! RK4 steps under closed-form gravity, and their transition.
//!
//! Where the acceleration depends on the position alone, a step of the classical method needs no slopes of six numbers: with
//! the accelerations `aₖ` at the positions of its four stages it is
//!
//! `r' = r + h v + h²/6 (a₁ + a₂ + a₃)`,  `v' = v + h/6 (a₁ + 2 a₂ + 2 a₃ + a₄)`
//!
//! (Hairer, Nørsett, Wanner, *Solving ordinary differential equations I*, 1993, II.14). With the gradients `Gₖ` at these
//! positions its derivative follows block by block, and of all the products of gradients two are left.

use super::gravity::J2;
use crate::linalg::{Matrix, add, from_fn, mul};
use crate::manifold::components;
use crate::scalar::Real;

/// Position and velocity.
type State<T> = [T; 6];

/// A step: what it leads to, and the positions of its four stages.
struct Step<T> {
    after: State<T>,
    stages: [[T; 3]; 4],
}

#[inline(always)]
fn step<T: Real>(j2: &J2, x: &State<T>, h: T) -> Step<T> {
    let (half, sixth) = (h * 0.5, h * (1.0 / 6.0));
    let (r, v) = ([x[0], x[1], x[2]], [x[3], x[4], x[5]]);
    let a1 = j2.acceleration(&r);
    let r2 = components(|i| half.mul_add(v[i], r[i]));
    let a2 = j2.acceleration(&r2);
    let r3 = components(|i| half.mul_add(half.mul_add(a1[i], v[i]), r[i]));
    let a3 = j2.acceleration(&r3);
    let r4 = components(|i| h.mul_add(half.mul_add(a2[i], v[i]), r[i]));
    let a4 = j2.acceleration(&r4);
    let mut after = *x;
    for i in 0..3 {
        let middle = a2[i] + a3[i];
        after[i] = h.mul_add(sixth.mul_add(a1[i] + middle, v[i]), r[i]);
        after[3 + i] = sixth.mul_add((a1[i] + a4[i]) + (middle + middle), v[i]);
    }
    Step { after, stages: [r, r2, r3, r4] }
}

/// The state after some steps of `h`.
#[inline(always)]
pub(super) fn after<T: Real>(j2: &J2, x: &State<T>, h: T, steps: usize) -> State<T> {
    let mut x = *x;
    for _ in 0..steps {
        x = step(j2, &x, h).after;
    }
    x
}

/// The same, and the transition to it.
#[inline(always)]
pub(super) fn with_transition<T: Real>(j2: &J2, x: &State<T>, h: T, steps: usize) -> (State<T>, Matrix<T, 6, 6>) {
    let first = step(j2, x, h);
    let (mut x, mut transition) = (first.after, derivative(j2, &first.stages, h));
    for _ in 1..steps {
        let next = step(j2, &x, h);
        transition = mul(&derivative(j2, &next.stages, h), &transition);
        x = next.after;
    }
    (x, transition)
}

/// Derivative of a step to the state before it.
#[inline(always)]
fn derivative<T: Real>(j2: &J2, [r1, r2, r3, r4]: &[[T; 3]; 4], h: T) -> Matrix<T, 6, 6> {
    let (g1, g2, g3, g4) = (j2.gradient(r1), j2.gradient(r2), j2.gradient(r3), j2.gradient(r4));
    let (g31, g42) = (mul(&g3, &g1), mul(&g4, &g2));
    let middle = add(&g2, &g3);
    let square = h * h;
    let (sixth, quarter) = (square * (1.0 / 6.0), square * 0.25);
    from_fn(
        #[inline(always)]
        |row, column| {
            let (i, j) = (row % 3, column % 3);
            let one = if i == j { T::one() } else { T::zero() };
            let m = middle[(i, j)];
            match (row < 3, column < 3) {
                (true, true) => sixth.mul_add(quarter.mul_add(g31[(i, j)], g1[(i, j)] + m), one),
                (true, false) => h * (square * (1.0 / 12.0)).mul_add(m, one),
                (false, true) => {
                    let products = g31[(i, j)] + g42[(i, j)];
                    h * (1.0 / 6.0) * (square * 0.5).mul_add(products, (g1[(i, j)] + g4[(i, j)]) + (m + m))
                }
                (false, false) => sixth.mul_add(quarter.mul_add(g42[(i, j)], m + g4[(i, j)]), one),
            }
        },
    )
}

//! Steps of an orbit under any forces.
//!
//! The forces are much code, and every filter steps the orbit in several places: here it is compiled
//! once for each instruction set, and a filter calls it, one orbit or eight at a time.

use super::force::ForceModel;
use super::integrate::{Variational, rk4, with_identity};
use super::vector::dot3;
use crate::linalg::{Matrix, from_fn, identity};
use crate::scalar::{Real, Run};

/// Some RK4 steps of equal length.
#[derive(Clone, Copy)]
pub(super) struct Steps<'a, T> {
    pub(super) force: &'a ForceModel,
    pub(super) x: [T; 6],
    pub(super) t: T,
    pub(super) h: T,
    pub(super) steps: usize,
}

/// Eight orbits side by side.
type Eight = [f64; 8];

/// The state after the steps.
pub(super) struct After<'a>(Steps<'a, f64>);

impl Run for After<'_> {
    type Output = [f64; 6];
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> [f64; 6] {
        let Steps { force, x, t, h, steps } = self.0;
        rk4(force, T::splat(t), &x.map(T::splat), T::splat(h), steps).map(|c| c.lane(0))
    }
}

/// The states of eight orbits after the steps.
pub(super) struct AfterEight<'a>(Steps<'a, Eight>);

impl Run for AfterEight<'_> {
    type Output = [Eight; 6];
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> [Eight; 6] {
        let Steps { force, x, t, h, steps } = self.0;
        let pack = |a: &Eight| T::Pack::from_lanes(|i| a[i]);
        let x = [pack(&x[0]), pack(&x[1]), pack(&x[2]), pack(&x[3]), pack(&x[4]), pack(&x[5])];
        let y = rk4(force, pack(&t), &x, pack(&h), steps);
        y.map(|c| std::array::from_fn(|i| c.lane(i)))
    }
}

/// The state after the steps and the transition to it.
pub(super) struct WithTransition<'a>(Steps<'a, f64>);

impl Run for WithTransition<'_> {
    type Output = [f64; 42];
    #[inline(always)]
    fn run<T: Real<Mask = bool>>(self) -> [f64; 42] {
        let Steps { force, x, t, h, steps } = self.0;
        let y = rk4(&Variational(force), T::splat(t), &with_identity(&x.map(T::splat)), T::splat(h), steps);
        y.map(|c| c.lane(0))
    }
}

impl<T: Real> Steps<'_, T> {
    fn lane(&self, i: usize) -> Steps<'_, f64> {
        let Steps { force, x, t, h, steps } = *self;
        Steps { force, x: x.map(|c| c.lane(i)), t: t.lane(i), h: h.lane(i), steps }
    }

    /// The state after the steps.
    #[inline(always)]
    pub(super) fn after(&self) -> [T; 6] {
        if T::LANES == 1 {
            return T::LEVEL.run(After(self.lane(0))).map(T::splat);
        }
        let eight = |c: T| -> Eight { std::array::from_fn(|i| c.lane(i)) };
        let Steps { force, x, t, h, steps } = *self;
        let y = T::LEVEL.run(AfterEight(Steps { force, x: x.map(eight), t: eight(t), h: eight(h), steps }));
        y.map(|c| T::from_lanes(|i| c[i]))
    }

    /// The state after the steps and the transition to it.
    #[inline(always)]
    pub(super) fn with_transition(&self) -> ([T; 6], Matrix<T, 6, 6>) {
        self.each(|one| T::LEVEL.run(WithTransition(one)))
    }

    /// One step of the Taylor series over all the time: see [`super::Scheme::Taylor`].
    #[inline(always)]
    pub(super) fn taylor(&self) -> ([T; 6], Matrix<T, 6, 6>) {
        self.each(|one| taylor(&one))
    }

    #[inline(always)]
    fn each(&self, one: impl Fn(Steps<'_, f64>) -> [f64; 42]) -> ([T; 6], Matrix<T, 6, 6>) {
        let mut out = [[0.0; 42]; 8];
        for i in 0..T::LANES {
            out[i] = one(self.lane(i));
        }
        let get = |k: usize| T::from_lanes(|i| out[i][k]);
        ([get(0), get(1), get(2), get(3), get(4), get(5)], from_fn(|i, j| get(6 + 6 * i + j)))
    }
}

#[inline(never)]
fn taylor(step: &Steps<'_, f64>) -> [f64; 42] {
    let Steps { force, x, t, h: dt, .. } = *step;
    let (r, v) = ([x[0], x[1], x[2]], [x[3], x[4], x[5]]);
    let g = force.gradient(&force.moment(t), &r, &v);
    let a = &g.acceleration;
    let half = 0.5 * dt * dt;
    let mut after = x;
    let mut transition: Matrix<f64, 6, 6> = identity();
    for i in 0..3 {
        let mut jerk = dot3(&[g.by_position[(i, 0)], g.by_position[(i, 1)], g.by_position[(i, 2)]], &v);
        if let Some(d) = &g.by_velocity {
            jerk += dot3(&[d[(i, 0)], d[(i, 1)], d[(i, 2)]], a);
        }
        after[i] += v[i] * dt + a[i] * half;
        after[3 + i] += a[i] * dt + jerk * half;
        transition[(i, 3 + i)] = dt;
        for j in 0..3 {
            transition[(3 + i, j)] = g.by_position[(i, j)] * dt;
            if let Some(d) = &g.by_velocity {
                transition[(3 + i, 3 + j)] += d[(i, j)] * dt;
            }
        }
    }
    let mut out = [0.0; 42];
    out[..6].copy_from_slice(&after);
    for i in 0..6 {
        for j in 0..6 {
            out[6 + 6 * i + j] = transition[(i, j)];
        }
    }
    out
}

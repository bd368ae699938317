//! The scalar that every model is written over: one `f64`, or a pack of eight lanes.
//!
//! Models and filters are generic over [`Real`] and read like plain `f64` code. A single filter runs
//! on one-lane scalars and stacks its sigma points into packs of eight; a batch of eight filters
//! runs on packs directly. Code for lanes selects instead of branching.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod dispatch;
pub mod elementary;
mod lanes;
mod one;

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

#[cfg(target_arch = "x86_64")]
pub use avx2::{Wide, WideMask};
#[cfg(target_arch = "x86_64")]
pub use avx512::{Mask512, Wide512};
pub(crate) use dispatch::{Baseline, Runner};
pub use dispatch::{Level, Run, RunWide};
pub use lanes::{Lanes, Mask8};
#[cfg(target_arch = "x86_64")]
pub use one::Fused;

/// Result of a comparison, one truth value per lane.
pub trait Mask: Copy + Debug {
    /// True in every lane.
    const TRUE: Self;
    /// From the lanes' truth values.
    fn from_lanes(lane: impl FnMut(usize) -> bool) -> Self;
    /// Lane-wise conjunction.
    fn and(self, other: Self) -> Self;
    /// True if every lane is true.
    fn all(self) -> bool;
    /// True if some lane is true.
    fn any(self) -> bool;
    /// One lane's value.
    fn lane(self, i: usize) -> bool;
}

/// A real number, or eight of them side by side.
pub trait Real:
    Copy
    + Debug
    + PartialEq
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + Mul<f64, Output = Self>
{
    /// Independent numbers held.
    const LANES: usize;
    /// Instruction set of the code that computes with it.
    const LEVEL: Level;
    /// Truth value of a comparison.
    type Mask: Mask;

    /// What sigma points are stacked in: eight slots for a one-lane scalar; a batch has its lanes
    /// taken already and is its own pack of one slot.
    type Pack: Real<Pack = Self::Pack>;
    /// Slots in a pack.
    const WIDTH: usize;
    /// What rows of a small matrix are put side by side in: see [`Rows`].
    type Rows: Rows<Self>;
    /// The same number in every slot.
    fn stack(self) -> Self::Pack;
    /// A pack from its slots.
    fn gather(slot: impl FnMut(usize) -> Self) -> Self::Pack;
    /// One slot of a pack.
    fn extract(pack: Self::Pack, slot: usize) -> Self;
    /// Sum over the slots of a pack, in one fixed order.
    fn total(pack: Self::Pack) -> Self;
    /// Sum over the lanes, in one fixed order.
    fn lane_sum(self) -> f64;

    /// The same number in every lane.
    fn splat(x: f64) -> Self;
    /// A number from its lanes.
    fn from_lanes(lane: impl FnMut(usize) -> f64) -> Self;
    /// One lane.
    fn lane(self, i: usize) -> f64;
    /// `self * b + c`, fused where the type says so.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Reciprocal.
    fn recip(self) -> Self;
    /// Magnitude of `self` with the sign of `sign`.
    fn copysign(self, sign: Self) -> Self;
    /// Any function, lane by lane: the slow path of the elementary functions.
    fn map(self, f: impl FnMut(f64) -> f64) -> Self;
    /// `self > b`; false where either is not a number.
    fn gt(self, b: Self) -> Self::Mask;
    /// `yes` where the mask is true, `no` elsewhere.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }
    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
    /// Polynomial by Horner's rule, highest coefficient first.
    #[inline(always)]
    fn poly<const K: usize>(self, c: [f64; K]) -> Self {
        let mut p = Self::splat(c[0]);
        for k in 1..K {
            p = p.mul_add(self, Self::splat(c[k]));
        }
        p
    }
    /// [`Self::poly`] in whatever order is fastest: to rounding the same, but not to the bit the same alone and in lanes.
    #[inline(always)]
    fn series<const K: usize>(self, c: [f64; K]) -> Self {
        self.poly(c)
    }
}

/// Rows of a column side by side: four of a one-lane scalar, or one where the lanes are taken already.
pub trait Rows<T>: Copy {
    /// How many.
    const WIDTH: usize;
    /// From the rows.
    fn gather(row: impl FnMut(usize) -> T) -> Self;
    /// One row.
    fn row(self, i: usize) -> T;
    /// Sum with another column.
    fn plus(self, other: Self) -> Self;
    /// Multiple of the column.
    fn times(self, factor: T) -> Self;
    /// `self * factor + sum`, as the scalar's [`Real::mul_add`].
    fn times_plus(self, factor: T, sum: Self) -> Self;
}

/// Lanes that are taken already hold one row.
impl<T: Real<Pack = T>> Rows<T> for T {
    const WIDTH: usize = 1;
    #[inline(always)]
    fn gather(mut row: impl FnMut(usize) -> T) -> T {
        row(0)
    }
    #[inline(always)]
    fn row(self, _: usize) -> T {
        self
    }
    #[inline(always)]
    fn plus(self, other: T) -> T {
        self + other
    }
    #[inline(always)]
    fn times(self, factor: T) -> T {
        self * factor
    }
    #[inline(always)]
    fn times_plus(self, factor: T, sum: T) -> T {
        self.mul_add(factor, sum)
    }
}

#[inline(always)]
fn mul_add<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

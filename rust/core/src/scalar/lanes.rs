//! Eight lanes as a plain array: each operation is one loop over the lanes, which the compiler turns
//! into vector instructions of whatever instruction set the calling function is compiled for.

use super::{Level, Mask, Real, Rows, mul_add};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// An array of an expression in each of the eight lanes, written out: the optimiser unrolls a loop of eight all the
/// same, but with some ten thousand of them in one inlined filter that alone takes it minutes.
macro_rules! lanes {
    (|$i:ident| $e:expr) => {
        [
            lanes!(0, $i, $e),
            lanes!(1, $i, $e),
            lanes!(2, $i, $e),
            lanes!(3, $i, $e),
            lanes!(4, $i, $e),
            lanes!(5, $i, $e),
            lanes!(6, $i, $e),
            lanes!(7, $i, $e),
        ]
    };
    ($n:literal, $i:ident, $e:expr) => {{
        let $i: usize = $n;
        $e
    }};
}

/// All-ones or all-zeros per lane, so that a select is three bit operations on any processor.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Mask8(pub [u64; 8]);

impl Mask for Mask8 {
    const TRUE: Self = Mask8([!0; 8]);
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        Mask8(lanes!(|i| self.0[i] & other.0[i]))
    }
    #[inline(always)]
    fn all(self) -> bool {
        let m = self.0;
        (m[0] & m[1] & m[2] & m[3]) & (m[4] & m[5] & m[6] & m[7]) == !0
    }
    #[inline(always)]
    fn any(self) -> bool {
        let m = self.0;
        (m[0] | m[1] | m[2] | m[3]) | (m[4] | m[5] | m[6] | m[7]) != 0
    }
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> bool) -> Self {
        Mask8(lanes!(|i| if lane(i) { !0 } else { 0 }))
    }
    #[inline(always)]
    fn lane(self, i: usize) -> bool {
        self.0[i] != 0
    }
}

/// Eight `f64`; `FMA` chooses fused multiply-add.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Lanes<const FMA: bool>(pub [f64; 8]);

impl<const FMA: bool> Lanes<FMA> {
    #[inline(always)]
    fn zip(self, b: Self, f: impl Fn(f64, f64) -> f64 + Copy) -> Self {
        Lanes(lanes!(|i| f(self.0[i], b.0[i])))
    }
}

macro_rules! binary {
    ($($trait:ident $method:ident $op:tt),*) => {$(
        impl<const F: bool> $trait for Lanes<F> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                self.zip(b, |x, y| x $op y)
            }
        }
    )*};
}
binary!(Add add +, Sub sub -, Mul mul *, Div div /);

impl<const F: bool> Mul<f64> for Lanes<F> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: f64) -> Self {
        self.zip(self, |x, _| x * b)
    }
}
impl<const F: bool> Neg for Lanes<F> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.zip(self, |x, _| -x)
    }
}
impl<const F: bool> AddAssign for Lanes<F> {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}
impl<const F: bool> SubAssign for Lanes<F> {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

impl<const FMA: bool> Real for Lanes<FMA> {
    const LANES: usize = 8;
    const LEVEL: Level = Level::Portable;
    type Mask = Mask8;
    type Pack = Self;
    type Rows = Self;
    const WIDTH: usize = 1;
    #[inline(always)]
    fn stack(self) -> Self {
        self
    }
    #[inline(always)]
    fn gather(mut slot: impl FnMut(usize) -> Self) -> Self {
        slot(0)
    }
    #[inline(always)]
    fn extract(pack: Self, _: usize) -> Self {
        pack
    }
    #[inline(always)]
    fn total(pack: Self) -> Self {
        pack
    }
    #[inline(always)]
    fn lane_sum(self) -> f64 {
        let a = self.0;
        ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
    }
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Lanes([x; 8])
    }
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> f64) -> Self {
        // a loop, so that a large closure has one place to be inlined at
        let mut o = [0.0; 8];
        for i in 0..8 {
            o[i] = lane(i);
        }
        Lanes(o)
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        self.0[i]
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Lanes(lanes!(|i| mul_add::<FMA>(self.0[i], b.0[i], c.0[i])))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.zip(self, |x, _| x.sqrt())
    }
    #[inline(always)]
    fn recip(self) -> Self {
        self.zip(self, |x, _| 1.0 / x)
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        self.zip(sign, f64::copysign)
    }
    #[inline(always)]
    fn map(self, mut f: impl FnMut(f64) -> f64) -> Self {
        let mut o = [0.0; 8];
        for i in 0..8 {
            o[i] = f(self.0[i]);
        }
        Lanes(o)
    }
    #[inline(always)]
    fn gt(self, b: Self) -> Mask8 {
        Mask8(lanes!(|i| if self.0[i] > b.0[i] { !0 } else { 0 }))
    }
    #[inline(always)]
    fn select(mask: Mask8, yes: Self, no: Self) -> Self {
        let one = |i: usize| (yes.0[i].to_bits() & mask.0[i]) | (no.0[i].to_bits() & !mask.0[i]);
        Lanes(lanes!(|i| f64::from_bits(one(i))))
    }
}

/// Four rows of a plain `f64`.
#[derive(Clone, Copy, Debug)]
pub struct Four([f64; 4]);

impl Four {
    #[inline(always)]
    fn zip(self, b: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let (a, b) = (self.0, b.0);
        Self([f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2]), f(a[3], b[3])])
    }
}

impl Rows<f64> for Four {
    const WIDTH: usize = 4;
    #[inline(always)]
    fn gather(mut row: impl FnMut(usize) -> f64) -> Self {
        Self([row(0), row(1), row(2), row(3)])
    }
    #[inline(always)]
    fn row(self, i: usize) -> f64 {
        self.0[i]
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self.zip(other, |x, y| x + y)
    }
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        self.zip(self, |x, _| x * factor)
    }
    #[inline(always)]
    fn times_plus(self, factor: f64, sum: Self) -> Self {
        self.zip(sum, |x, y| x * factor + y)
    }
}

//! One-lane scalars: `f64`, and [`Fused`] for code compiled with fused multiply-add.

use super::{Lanes, Level, Mask, Real, mul_add};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

impl Mask for bool {
    const TRUE: Self = true;
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self & other
    }
    #[inline(always)]
    fn all(self) -> bool {
        self
    }
    #[inline(always)]
    fn any(self) -> bool {
        self
    }
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> bool) -> Self {
        lane(0)
    }
    #[inline(always)]
    fn lane(self, _: usize) -> bool {
        self
    }
}

/// An `f64` whose multiply-add is fused. A machine instruction only inside code compiled for a
/// processor that has it, so it is named by the dispatcher alone.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub struct Fused(pub f64);

macro_rules! binary {
    ($($trait:ident $method:ident $op:tt),*) => {$(
        impl $trait for Fused {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                Fused(self.0 $op b.0)
            }
        }
    )*};
}
binary!(Add add +, Sub sub -, Mul mul *, Div div /);

impl Mul<f64> for Fused {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: f64) -> Self {
        Fused(self.0 * b)
    }
}
impl Neg for Fused {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Fused(-self.0)
    }
}
impl AddAssign for Fused {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        self.0 += b.0;
    }
}
impl SubAssign for Fused {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        self.0 -= b.0;
    }
}

macro_rules! one_lane {
    ($type:ty, pack: $pack:ty, rows: $rows:ty, level: $level:ident, fma: $fma:literal, |$s:ident| $get:expr, $new:expr) => {
        impl Real for $type {
            const LANES: usize = 1;
            const LEVEL: Level = Level::$level;
            type Mask = bool;
            type Pack = $pack;
            type Rows = $rows;
            const WIDTH: usize = 8;
            #[inline(always)]
            fn stack(self) -> Self::Pack {
                <$pack>::splat(self.lane(0))
            }
            #[inline(always)]
            fn gather(mut slot: impl FnMut(usize) -> Self) -> Self::Pack {
                <$pack>::from_lanes(|i| slot(i).lane(0))
            }
            #[inline(always)]
            fn extract(pack: Self::Pack, slot: usize) -> Self {
                $new(pack.lane(slot))
            }
            #[inline(always)]
            fn total(pack: Self::Pack) -> Self {
                $new(pack.lane_sum())
            }
            #[inline(always)]
            fn lane_sum(self) -> f64 {
                self.lane(0)
            }
            #[inline(always)]
            fn splat(x: f64) -> Self {
                $new(x)
            }
            #[inline(always)]
            fn from_lanes(mut lane: impl FnMut(usize) -> f64) -> Self {
                $new(lane(0))
            }
            #[inline(always)]
            fn lane(self, _: usize) -> f64 {
                let $s = self;
                $get
            }
            #[inline(always)]
            fn mul_add(self, b: Self, c: Self) -> Self {
                $new(mul_add::<$fma>(self.lane(0), b.lane(0), c.lane(0)))
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $new(f64::sqrt(self.lane(0)))
            }
            #[inline(always)]
            fn recip(self) -> Self {
                $new(1.0 / self.lane(0))
            }
            #[inline(always)]
            fn copysign(self, sign: Self) -> Self {
                $new(f64::copysign(self.lane(0), sign.lane(0)))
            }
            #[inline(always)]
            fn map(self, mut f: impl FnMut(f64) -> f64) -> Self {
                $new(f(self.lane(0)))
            }
            /// By Estrin's scheme: one number alone waits for each step of Horner's, eight side by side do not.
            #[inline(always)]
            fn series<const K: usize>(self, c: [f64; K]) -> Self {
                let mut terms = [0.0; K];
                for i in 0..K {
                    terms[i] = c[K - 1 - i];
                }
                let (mut x, mut count) = (self.lane(0), K);
                // three halvings are enough for eight coefficients; the few that longer ones leave are summed
                for _ in 0..3 {
                    for i in 0..K {
                        if 2 * i + 1 < count {
                            terms[i] = mul_add::<$fma>(terms[2 * i + 1], x, terms[2 * i]);
                        } else if 2 * i < count {
                            terms[i] = terms[2 * i];
                        }
                    }
                    count = count.div_ceil(2);
                    x *= x;
                }
                let mut power = x;
                for i in 1..K {
                    if i < count {
                        terms[0] = mul_add::<$fma>(terms[i], power, terms[0]);
                        power *= x;
                    }
                }
                $new(terms[0])
            }
            #[inline(always)]
            fn gt(self, b: Self) -> bool {
                self.lane(0) > b.lane(0)
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }
        }
    };
}
one_lane!(f64, pack: Lanes<false>, rows: super::lanes::Four, level: Portable, fma: false, |x| x, std::convert::identity);
#[cfg(target_arch = "x86_64")]
one_lane!(Fused, pack: super::Wide, rows: super::avx2::Register, level: Avx2, fma: true, |x| x.0, Fused);

//! Eight lanes in one AVX-512 register, one intrinsic an operation.
//!
//! The same operations in the same order as those of [`super::Wide`], lane by lane, so to the same bits. As there, the types are
//! named by the dispatcher alone, inside a function compiled for AVX-512 that it enters after it has checked the
//! processor: that is why each call below is sound.
#![allow(unsafe_code)]

use super::{Level, Mask, Real};
use std::arch::x86_64::*;
use std::mem::transmute;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Eight `f64` with fused multiply-add, in one register.
#[derive(Clone, Copy, Debug)]
pub struct Wide512(__m512d);

/// A bit for each lane of a [`Wide512`].
#[derive(Clone, Copy, Debug)]
pub struct Mask512(u8);

impl Wide512 {
    #[inline(always)]
    fn new(lanes: [f64; 8]) -> Self {
        // SAFETY: the same 64 bytes; every pattern of bits is a number.
        unsafe { Self(transmute::<[f64; 8], __m512d>(lanes)) }
    }
    #[inline(always)]
    fn lanes(self) -> [f64; 8] {
        // SAFETY: the same 64 bytes; every pattern of bits is a number.
        unsafe { transmute::<__m512d, [f64; 8]>(self.0) }
    }
}

impl PartialEq for Wide512 {
    fn eq(&self, other: &Self) -> bool {
        self.lanes() == other.lanes()
    }
}

macro_rules! binary {
    ($($trait:ident $method:ident $intrinsic:ident),*) => {$(
        impl $trait for Wide512 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                // SAFETY: the processor has AVX-512, see the module's comment.
                unsafe { Self($intrinsic(self.0, b.0)) }
            }
        }
    )*};
}
binary!(Add add _mm512_add_pd, Sub sub _mm512_sub_pd, Mul mul _mm512_mul_pd, Div div _mm512_div_pd);

impl Mul<f64> for Wide512 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: f64) -> Self {
        self * Self::splat(b)
    }
}
impl Neg for Wide512 {
    type Output = Self;
    /// As a difference, which the compiler knows for a change of sign and folds into multiply-adds.
    #[inline(always)]
    fn neg(self) -> Self {
        Self::splat(-0.0) - self
    }
}
impl AddAssign for Wide512 {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}
impl SubAssign for Wide512 {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

impl Mask for Mask512 {
    const TRUE: Self = Self(0xff);
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> bool) -> Self {
        let mut bits = 0;
        for i in 0..8 {
            bits |= u8::from(lane(i)) << i;
        }
        Self(bits)
    }
    #[inline(always)]
    fn and(self, b: Self) -> Self {
        Self(self.0 & b.0)
    }
    #[inline(always)]
    fn all(self) -> bool {
        self.0 == 0xff
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.0 != 0
    }
    #[inline(always)]
    fn lane(self, i: usize) -> bool {
        self.0 >> i & 1 != 0
    }
}

impl Real for Wide512 {
    const LANES: usize = 8;
    const LEVEL: Level = Level::Avx512;
    type Mask = Mask512;
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
        let x = self.lanes();
        ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]))
    }
    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: the processor has AVX-512, see the module's comment.
        unsafe { Self(_mm512_set1_pd(x)) }
    }
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> f64) -> Self {
        let mut o = [0.0; 8];
        for (i, o) in o.iter_mut().enumerate() {
            *o = lane(i);
        }
        Self::new(o)
    }
    #[inline(always)]
    fn lane(self, i: usize) -> f64 {
        self.lanes()[i]
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        // SAFETY: the processor has AVX-512, see the module's comment.
        unsafe { Self(_mm512_fmadd_pd(self.0, b.0, c.0)) }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: the processor has AVX-512, see the module's comment.
        unsafe { Self(_mm512_sqrt_pd(self.0)) }
    }
    #[inline(always)]
    fn recip(self) -> Self {
        Self::splat(1.0) / self
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        // SAFETY: the processor has AVX-512 with its instructions on double words, see the module's comment.
        unsafe {
            let bit = _mm512_set1_pd(-0.0);
            Self(_mm512_or_pd(_mm512_andnot_pd(bit, self.0), _mm512_and_pd(bit, sign.0)))
        }
    }
    #[inline(always)]
    fn map(self, mut f: impl FnMut(f64) -> f64) -> Self {
        let mut lanes = self.lanes();
        for x in &mut lanes {
            *x = f(*x);
        }
        Self::new(lanes)
    }
    #[inline(always)]
    fn gt(self, b: Self) -> Mask512 {
        // SAFETY: the processor has AVX-512, see the module's comment.
        unsafe { Mask512(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(self.0, b.0)) }
    }
    #[inline(always)]
    fn select(mask: Mask512, yes: Self, no: Self) -> Self {
        // SAFETY: the processor has AVX-512, see the module's comment.
        unsafe { Self(_mm512_mask_blend_pd(mask.0, no.0, yes.0)) }
    }
}

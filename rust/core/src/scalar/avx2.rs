//! Eight lanes in two AVX2 registers, one intrinsic an operation.
//!
//! The array type [`super::Lanes`] computes the same and needs no `unsafe`, but leaves it to the optimiser to
//! find the vectors, which costs it minutes and finds them not everywhere. These types are named by
//! the dispatcher alone, inside functions compiled for AVX2 and FMA that it enters after it has checked the
//! processor: that is why each call below is sound.
#![allow(unsafe_code)]

use super::{Fused, Level, Mask, Real, Rows};
use std::arch::x86_64::*;
use std::mem::transmute;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Eight `f64` with fused multiply-add.
#[derive(Clone, Copy, Debug)]
pub struct Wide([__m256d; 2]);

/// All-ones or all-zeros per lane of a [`Wide`].
#[derive(Clone, Copy, Debug)]
pub struct WideMask([__m256d; 2]);

impl Wide {
    #[inline(always)]
    fn new(lanes: [f64; 8]) -> Self {
        // SAFETY: the same 64 bytes; every pattern of bits is a number.
        unsafe { Self(transmute::<[f64; 8], [__m256d; 2]>(lanes)) }
    }
    #[inline(always)]
    fn lanes(self) -> [f64; 8] {
        // SAFETY: the same 64 bytes; every pattern of bits is a number.
        unsafe { transmute::<[__m256d; 2], [f64; 8]>(self.0) }
    }
}

impl PartialEq for Wide {
    fn eq(&self, other: &Self) -> bool {
        self.lanes() == other.lanes()
    }
}

macro_rules! binary {
    ($($trait:ident $method:ident $intrinsic:ident),*) => {$(
        impl $trait for Wide {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                // SAFETY: the processor has AVX2, see the module's comment.
                unsafe { Self([$intrinsic(self.0[0], b.0[0]), $intrinsic(self.0[1], b.0[1])]) }
            }
        }
    )*};
}
binary!(Add add _mm256_add_pd, Sub sub _mm256_sub_pd, Mul mul _mm256_mul_pd, Div div _mm256_div_pd);

impl Mul<f64> for Wide {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: f64) -> Self {
        self * Self::splat(b)
    }
}
impl Neg for Wide {
    type Output = Self;
    /// As a difference, which the compiler knows for a change of sign and folds into multiply-adds.
    #[inline(always)]
    fn neg(self) -> Self {
        Self::splat(-0.0) - self
    }
}
impl AddAssign for Wide {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}
impl SubAssign for Wide {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

impl WideMask {
    /// One bit per lane.
    #[inline(always)]
    fn bits(self) -> i32 {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe { _mm256_movemask_pd(self.0[0]) | _mm256_movemask_pd(self.0[1]) << 4 }
    }
}

impl Mask for WideMask {
    const TRUE: Self = {
        // SAFETY: the same 64 bytes; every pattern of bits is a number.
        unsafe { Self(transmute::<[u64; 8], [__m256d; 2]>([!0; 8])) }
    };
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> bool) -> Self {
        let mut bits = [0u64; 8];
        for (i, bits) in bits.iter_mut().enumerate() {
            *bits = if lane(i) { !0 } else { 0 };
        }
        // SAFETY: the same 64 bytes; every pattern of bits is a number.
        unsafe { Self(transmute::<[u64; 8], [__m256d; 2]>(bits)) }
    }
    #[inline(always)]
    fn and(self, b: Self) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe { Self([_mm256_and_pd(self.0[0], b.0[0]), _mm256_and_pd(self.0[1], b.0[1])]) }
    }
    #[inline(always)]
    fn all(self) -> bool {
        self.bits() == 0xff
    }
    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
    #[inline(always)]
    fn lane(self, i: usize) -> bool {
        self.bits() >> i & 1 != 0
    }
}

impl Real for Wide {
    const LANES: usize = 8;
    const LEVEL: Level = Level::Avx2;
    type Mask = WideMask;
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
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe {
            let four = _mm256_add_pd(self.0[0], self.0[1]);
            let two = _mm_add_pd(_mm256_castpd256_pd128(four), _mm256_extractf128_pd::<1>(four));
            _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
        }
    }
    #[inline(always)]
    fn splat(x: f64) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe { Self([_mm256_set1_pd(x); 2]) }
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
        // SAFETY: the processor has AVX2 and FMA, see the module's comment.
        unsafe { Self([_mm256_fmadd_pd(self.0[0], b.0[0], c.0[0]), _mm256_fmadd_pd(self.0[1], b.0[1], c.0[1])]) }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe { Self([_mm256_sqrt_pd(self.0[0]), _mm256_sqrt_pd(self.0[1])]) }
    }
    #[inline(always)]
    fn recip(self) -> Self {
        Self::splat(1.0) / self
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe {
            let bit = _mm256_set1_pd(-0.0);
            let one = |x, s| _mm256_or_pd(_mm256_andnot_pd(bit, x), _mm256_and_pd(bit, s));
            Self([one(self.0[0], sign.0[0]), one(self.0[1], sign.0[1])])
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
    fn gt(self, b: Self) -> WideMask {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe {
            let one = |x, y| _mm256_cmp_pd::<_CMP_GT_OQ>(x, y);
            WideMask([one(self.0[0], b.0[0]), one(self.0[1], b.0[1])])
        }
    }
    #[inline(always)]
    fn select(mask: WideMask, yes: Self, no: Self) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe {
            let one = |i: usize| _mm256_blendv_pd(no.0[i], yes.0[i], mask.0[i]);
            Self([one(0), one(1)])
        }
    }
}

/// Four rows in one register.
#[derive(Clone, Copy, Debug)]
pub struct Register(__m256d);

impl Rows<Fused> for Register {
    const WIDTH: usize = 4;
    #[inline(always)]
    fn gather(mut row: impl FnMut(usize) -> Fused) -> Self {
        let rows = [row(0).0, row(1).0, row(2).0, row(3).0];
        // SAFETY: the same 32 bytes; every pattern of bits is a number.
        unsafe { Self(transmute::<[f64; 4], __m256d>(rows)) }
    }
    #[inline(always)]
    fn row(self, i: usize) -> Fused {
        // SAFETY: the same 32 bytes; every pattern of bits is a number.
        Fused(unsafe { transmute::<__m256d, [f64; 4]>(self.0) }[i])
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe { Self(_mm256_add_pd(self.0, other.0)) }
    }
    #[inline(always)]
    fn times(self, factor: Fused) -> Self {
        // SAFETY: the processor has AVX2, see the module's comment.
        unsafe { Self(_mm256_mul_pd(self.0, _mm256_set1_pd(factor.0))) }
    }
    #[inline(always)]
    fn times_plus(self, factor: Fused, sum: Self) -> Self {
        // SAFETY: the processor has AVX2 and FMA, see the module's comment.
        unsafe { Self(_mm256_fmadd_pd(self.0, _mm256_set1_pd(factor.0), sum.0)) }
    }
}

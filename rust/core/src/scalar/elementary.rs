//! Exponential and logarithm without a branch, for lanes: a library function would be called lane by lane.

use super::Real;

/// Added to a number of less than 2⁵¹ and taken away again it rounds to the nearest whole number, whose last bits are then the
/// last bits of the sum.
const WHOLE: f64 = 6_755_399_441_055_744.0;
/// The same with the bias of exponents: those bits are then an exponent.
const EXPONENT: f64 = WHOLE + 1023.0;
/// ln 2 in two parts; multiples of the first one by exponents are exact.
const LN2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];

/// Coefficients of `(eʳ − 1 − r) / r²`, highest first: enough for `|r| ≤ ln 2 / 2`.
const EXP: [f64; 12] = [
    1.0 / 6_227_020_800.0,
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    1.0 / 2.0,
];

/// `eˣ` to an error of one unit in the last place: nothing below −708, infinite above 709.
#[inline(always)]
pub fn exp<T: Real>(x: T) -> T {
    let shifted = x.mul_add(T::splat(std::f64::consts::LOG2_E), T::splat(EXPONENT));
    let k = shifted - T::splat(EXPONENT);
    let r = k.mul_add(T::splat(-LN2[1]), k.mul_add(T::splat(-LN2[0]), x));
    let power = shifted.map(|s| f64::from_bits(s.to_bits() << 52));
    let y = ((r * r).mul_add(r.poly(EXP), r) + T::one()) * power;
    let y = T::select(T::splat(-708.0).gt(x), T::zero(), y);
    T::select(x.gt(T::splat(709.0)), T::splat(f64::INFINITY), y)
}

/// Coefficients of `(ln(1 + s) − ln(1 − s) − 2 s) / s³` in powers of s², highest first (Sun's fdlibm, e_log.c).
const LN: [f64; 7] = [
    1.479_819_860_511_658_6e-1,
    1.531_383_769_920_937_3e-1,
    1.818_357_216_161_805e-1,
    2.222_219_843_214_978_4e-1,
    2.857_142_874_366_239e-1,
    3.999_999_999_940_942e-1,
    6.666_666_666_666_735e-1,
];

/// `ln x` of a positive, normal number to an error of one unit in the last place; infinity and what is not a number stay as
/// they are.
///
/// Source: Sun Microsystems, fdlibm, e_log.c.
#[inline(always)]
pub fn ln<T: Real>(x: T) -> T {
    // x = m 2ᵏ with m from √½ to √2
    const ROOT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
    const ONE: u64 = 0x3ff0_0000_0000_0000;
    const TWO_52: u64 = 0x4330_0000_0000_0000;
    let k = x.map(|x| f64::from_bits((x.to_bits() + (ONE - ROOT_HALF)) >> 52 | TWO_52));
    let k = k - T::splat(f64::from_bits(TWO_52) + 1023.0);
    let f = x.map(|x| f64::from_bits(((x.to_bits() + (ONE - ROOT_HALF)) & 0x000f_ffff_ffff_ffff) + ROOT_HALF));
    let f = f - T::one();
    let s = f / (f + T::splat(2.0));
    let square = s * s;
    let half = f * f * 0.5;
    let rest = s * (square.mul_add(square.poly(LN), half));
    let y = k.mul_add(T::splat(LN2[0]), f - (half - k.mul_add(T::splat(LN2[1]), rest)));
    // adds nothing, or what is not a number
    T::select(x.gt(T::splat(f64::MAX)), x, x.mul_add(T::zero(), y))
}

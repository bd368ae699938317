//! The chi-square distribution, for gates and for bounds of NIS and NEES.

use crate::error::{Error, Result};

/// Probability that a chi-square variable with `dof` degrees of freedom is below `x`.
pub fn chi2_cdf(x: f64, dof: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    lower_gamma(0.5 * dof, 0.5 * x)
}

/// Value that a chi-square variable with `dof` degrees of freedom stays below with probability `p`.
///
/// # Errors
/// `Parameter` unless `0 ≤ p ≤ 1` (1 gives infinity) and `dof > 0`.
pub fn chi2_quantile(p: f64, dof: f64) -> Result<f64> {
    if !(0.0..=1.0).contains(&p) {
        return Err(Error::Parameter { field: "probability", value: p, need: "must be between 0 and 1" });
    }
    if !(dof > 0.0 && dof.is_finite()) {
        return Err(Error::Parameter { field: "degrees of freedom", value: dof, need: "must be positive and finite" });
    }
    if p == 0.0 {
        return Ok(0.0);
    }
    if p == 1.0 {
        return Ok(f64::INFINITY);
    }
    let (mut low, mut high) = (0.0, dof.max(1.0));
    while chi2_cdf(high, dof) < p {
        low = high;
        high *= 2.0;
        if high > 1e300 {
            return Ok(f64::INFINITY);
        }
    }
    // bisection to the last bit: this runs once per run, not per sample
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return Ok(middle);
        }
        if chi2_cdf(middle, dof) < p {
            low = middle;
        } else {
            high = middle;
        }
    }
}

/// Regularised lower incomplete gamma function `P(a, x)`: series below `a + 1`, continued fraction
/// (modified Lentz) above. Abramowitz and Stegun 6.5.29, 6.5.31.
fn lower_gamma(a: f64, x: f64) -> f64 {
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..100_000 {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < sum * 1e-17 {
                break;
            }
        }
        return (scale * sum).min(1.0);
    }
    let tiny = 1e-300;
    let mut b = x + 1.0 - a;
    let mut c = 1.0 / tiny;
    let mut d = 1.0 / b;
    let mut h = d;
    for i in 1..100_000 {
        let i = f64::from(i);
        let an = -i * (i - a);
        b += 2.0;
        d = 1.0 / nonzero(an * d + b, tiny);
        c = nonzero(b + an / c, tiny);
        h *= d * c;
        if (d * c - 1.0).abs() < 1e-16 {
            break;
        }
    }
    (1.0 - scale * h).max(0.0)
}

fn nonzero(x: f64, tiny: f64) -> f64 {
    if x.abs() < tiny { tiny } else { x }
}

/// Logarithm of the gamma function for positive arguments (Lanczos, g = 7, n = 9).
fn ln_gamma(x: f64) -> f64 {
    const C: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    let x = x - 1.0;
    let t = x + 7.5;
    let mut sum = C[0];
    for (i, c) in C.iter().enumerate().skip(1) {
        sum += c / (x + i as f64);
    }
    0.5 * (2.0 * std::f64::consts::PI).ln() + (x + 0.5) * t.ln() - t + sum.ln()
}

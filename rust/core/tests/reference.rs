//! Numbers known from elsewhere.
#![allow(clippy::unwrap_used)]

use celestcore_core::consistency::{chi2_cdf, chi2_quantile};

#[test]
fn chi_square_tables() {
    // Abramowitz and Stegun, table 26.8
    for (p, dof, value) in [
        (0.95, 1.0, 3.841_458_820_694_124),
        (0.99, 3.0, 11.344_866_730_144_373),
        (0.5, 10.0, 9.341_817_765_591_97),
        (0.001, 6.0, 0.381_066_755_136_806_4),
        (0.999, 100.0, 149.449_252_779_038_86),
    ] {
        let q = chi2_quantile(p, dof).unwrap();
        assert!((q / value - 1.0).abs() < 1e-8, "{p} {dof}: {q}");
        assert!((chi2_cdf(q, dof) - p).abs() < 1e-13);
    }
    // two degrees of freedom have a closed form
    for p in [1e-6, 0.1, 0.9, 0.999_999] {
        let exact = -2.0 * f64::ln_1p(-p);
        // a probability near one carries fewer digits of its complement
        let tolerance = 1e-13 + 1e-16 / (1.0 - p);
        assert!((chi2_quantile(p, 2.0).unwrap() / exact - 1.0).abs() < tolerance);
    }
    assert_eq!(chi2_quantile(1.0, 3.0).unwrap(), f64::INFINITY);
    assert_eq!(chi2_quantile(0.0, 3.0).unwrap(), 0.0);
    for (p, dof) in [(-0.1, 3.0), (1.1, 3.0), (f64::NAN, 3.0), (0.5, 0.0), (0.5, f64::INFINITY)] {
        assert!(chi2_quantile(p, dof).is_err());
    }
}

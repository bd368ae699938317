//! What a measurement with noise that is not normal says of a normal signal.
//!
//! A scalar signal `u ~ N(0, s)` is seen as `y = u + noise`. Its posterior mean and variance are what a
//! filter needs of the noise's shape: they are the score function of `y` in other words.
//!
//! Source: Masreliez, *Approximate non-Gaussian filtering with linear state and observation relations*,
//! 1975.

/// Posterior mean and variance of a signal that was normal about zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posterior {
    /// Mean.
    pub mean: f64,
    /// Variance. Under noise with heavy tails it may be larger than the prior one.
    pub variance: f64,
}

const NOTHING: Posterior = Posterior { mean: f64::NAN, variance: f64::NAN };

/// From so many degrees of freedom on, noise is normal.
const NORMAL: f64 = 1e8;

/// What is left out of a sum, as a logarithm: `exp(-25)` is 1e-11.
const CUT: f64 = 25.0;

/// Under Student's t noise of `dof` degrees of freedom and the given scale (not standard deviation).
///
/// The noise is normal with the variance `scale² / λ`, and `λ` follows a gamma distribution. Given `λ`, all is a Kalman
/// filter; what remains is a sum over `ln λ`, where the integrand is smooth and falls off exponentially at
/// both ends, so that equal steps converge as fast as anything can. Good to 1e-9 from `s ≪ scale²` to
/// `s ≫ scale²` and far out in the tails. Not a number where an argument makes no sense.
pub fn student_t(y: f64, s: f64, dof: f64, scale: f64) -> Posterior {
    let c2 = scale * scale;
    if !(s > 0.0 && scale > 0.0 && dof > 0.0 && y.is_finite() && s.is_finite() && c2.is_finite()) {
        return NOTHING;
    }
    let (square, dof) = (y * y, dof.min(NORMAL));
    let shape = 0.5 * (dof + 1.0);
    let exponent = |z: f64, lambda: f64, v: f64| 0.5 * (dof * (z - lambda) - square / v);
    // where the measurement would have the variance, and where the prior has it
    let outlier = (2.0 * shape * c2 / (square + c2)).ln().min(0.0);
    let height = |z: f64| exponent(z, z.exp(), s + c2 * (-z).exp());
    let reference = height(0.0).max(height(outlier));

    let step = (std::f64::consts::TAU / (60.0 * shape).sqrt() / 1.3).min(0.32);
    // the variance falls off one power more slowly than the mass, but not below where the prior has it all
    let fall = |power: f64| (CUT / power).max((2.0 * CUT / power).sqrt() * 1.2);
    let variance = if shape > 1.5 { outlier - fall(shape - 1.0) } else { f64::NEG_INFINITY };
    let lowest = variance.max(outlier.min((c2 / s).ln()) - fall(shape));
    let highest = (1.0 + 2.0 * CUT / dof + (8.0 * CUT / dof).sqrt()).ln();
    let count = ((highest - lowest) / step).ceil() as usize;

    // the gain s/V where it is small, one minus the gain where that is: no difference of near numbers
    let small = s < c2;
    let (mut z, mut lambda, growth) = (lowest, lowest.exp(), step.exp());
    let [mut mass, mut first, mut second, mut within] = [0.0; 4];
    for _ in 0..=count {
        let noise = c2 / lambda;
        let v = s + noise;
        let w = (exponent(z, lambda, v) - reference).exp() / v.sqrt();
        let part = if small { s } else { noise } / v;
        mass += w;
        first += w * part;
        second += w * part * part;
        within += w * part * if small { noise } else { s };
        z += step;
        lambda *= growth;
    }
    let part = first / mass;
    let spread = (second / mass - part * part).max(0.0);
    Posterior { mean: y * if small { part } else { 1.0 - part }, variance: within / mass + square * spread }
}

/// Under noise that is uniform within `±half` and falls off beyond as one half of a normal density of
/// standard deviation `edge`.
///
/// Three pieces, each a truncated normal density; those without weight cost nothing, nor does a signal
/// that is known well enough to lie inside. Good to 1e-10, far in the tails too. Not a number where an
/// argument makes no sense.
pub fn soft_uniform(y: f64, s: f64, half: f64, edge: f64) -> Posterior {
    if !(s > 0.0 && half > 0.0 && edge > 0.0 && y.is_finite() && s.is_finite() && half.is_finite() && edge.is_finite())
    {
        return NOTHING;
    }
    let (low, high) = (y - half, y + half);
    let w2 = edge * edge;
    let (gain, v) = (s / (s + w2), s * w2 / (s + w2));
    let pieces = [
        Piece::new(0.0, s, low, high, 0.0),
        Piece::new(low * gain, v, f64::NEG_INFINITY, low, -0.5 * low * low / (s + w2)),
        Piece::new(high * gain, v, high, f64::INFINITY, -0.5 * high * high / (s + w2)),
    ];
    let top = pieces.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p.height));
    let mut parts = [(0.0, Posterior { mean: 0.0, variance: 0.0 }); 3];
    let (mut mass, mut mean) = (0.0, 0.0);
    for (part, piece) in parts.iter_mut().zip(&pieces) {
        if top - piece.height < 2.0 * CUT {
            *part = piece.moments(top);
            mass += part.0;
            mean += part.0 * part.1.mean;
        }
    }
    mean /= mass;
    let spread = |(m, p): &(f64, Posterior)| m * (p.variance + (p.mean - mean) * (p.mean - mean));
    Posterior { mean, variance: parts.iter().map(spread).sum::<f64>() / mass }
}

/// A normal density on an interval.
struct Piece {
    mean: f64,
    sigma: f64,
    /// The interval in standard deviations from the mean, and the point of it that is nearest to it.
    from: f64,
    to: f64,
    nearest: f64,
    /// Logarithm of the largest value.
    height: f64,
}

impl Piece {
    fn new(mean: f64, variance: f64, low: f64, high: f64, log: f64) -> Self {
        let sigma = variance.sqrt();
        let (from, to) = ((low - mean) / sigma, (high - mean) / sigma);
        let nearest = if from > 0.0 { from } else { to.min(0.0) };
        Self { mean, sigma, from, to, nearest, height: log - 0.5 * nearest * nearest }
    }

    /// Mass, in units of `exp(top)`, and the moments: by Gauss-Legendre over what is not negligible,
    /// measured from the highest point, so that nothing cancels far from the mean.
    fn moments(&self, top: f64) -> (f64, Posterior) {
        let scale = (self.height - top).exp() * self.sigma;
        if self.from < -REACH && self.to > REACH {
            let whole = Posterior { mean: self.mean, variance: self.sigma * self.sigma };
            return (scale * std::f64::consts::TAU.sqrt(), whole);
        }
        // density exp(-n t - t²/2) at t from the nearest point n
        let n = self.nearest;
        let reach = (n * n + REACH * REACH).sqrt();
        let (from, to) = (self.from.max(-reach) - n, self.to.min(reach) - n);
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let [mut mass, mut first, mut second] = [0.0; 3];
        for (x, weight) in NODES {
            for d in [-half * x, half * x] {
                let t = middle + d;
                let w = weight * (-t * (n + 0.5 * t)).exp();
                mass += w;
                first += w * d;
                second += w * d * d;
            }
        }
        let offset = first / mass;
        let variance = (second / mass - offset * offset).max(0.0);
        let mean = self.mean + self.sigma * (n + middle + offset);
        (scale * half * mass, Posterior { mean, variance: self.sigma * self.sigma * variance })
    }
}

/// Standard deviations beyond which a normal density is nothing.
const REACH: f64 = 7.5;

/// Upper half of the 32 Gauss-Legendre nodes, and their weights.
const NODES: [(f64, f64); 16] = [
    (0.048_307_665_687_738_32, 0.096_540_088_514_727_8),
    (0.144_471_961_582_796_5, 0.095_638_720_079_274_86),
    (0.239_287_362_252_137_07, 0.093_844_399_080_804_57),
    (0.331_868_602_282_127_65, 0.091_173_878_695_763_88),
    (0.421_351_276_130_635_35, 0.087_652_093_004_403_81),
    (0.506_899_908_932_229_4, 0.083_311_924_226_946_76),
    (0.587_715_757_240_762_3, 0.078_193_895_787_070_31),
    (0.663_044_266_930_215_2, 0.072_345_794_108_848_5),
    (0.732_182_118_740_289_7, 0.065_822_222_776_361_85),
    (0.794_483_795_967_942_4, 0.058_684_093_478_535_55),
    (0.849_367_613_732_57, 0.050_998_059_262_376_18),
    (0.896_321_155_766_052_1, 0.042_835_898_022_226_68),
    (0.934_906_075_937_739_7, 0.034_273_862_913_021_43),
    (0.964_762_255_587_506_4, 0.025_392_065_309_262_06),
    (0.985_611_511_545_268_4, 0.016_274_394_730_905_67),
    (0.997_263_861_849_481_6, 0.007_018_610_009_470_097),
];

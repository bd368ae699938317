//! Gaps between samples: steps far longer than most.

/// Bits that one pass over the steps tells of their median.
const DIGIT: u32 = 16;

/// Longest step between increasing times that is no gap: `factor` (at least 1) times the median step, or
/// infinity where no step is longer than that. Takes no memory that grows with the times.
pub fn gap_limit(t: &[f64], factor: f64) -> f64 {
    if t.len() < 2 {
        return f64::INFINITY;
    }
    let (mut shortest, mut longest) = (f64::INFINITY, 0.0_f64);
    for dt in steps(t) {
        shortest = shortest.min(dt);
        longest = longest.max(dt);
    }
    // regular samples: the median is at least the shortest
    if longest <= factor * shortest { f64::INFINITY } else { factor * median(t) }
}

/// The steps longer than `limit`: sample before and after each, s.
pub fn gaps(t: &[f64], limit: f64) -> Vec<[f64; 2]> {
    t.windows(2).filter(|pair| pair[1] - pair[0] > limit).map(|pair| [pair[0], pair[1]]).collect()
}

fn steps(t: &[f64]) -> impl Iterator<Item = f64> {
    t.windows(2).map(|pair| pair[1] - pair[0])
}

/// Median step, of an even number the mean of the middle two.
fn median(t: &[f64]) -> f64 {
    let count = t.len() - 1;
    let (low, below) = kth(t, (count - 1) / 2);
    if count % 2 == 1 {
        return low;
    }
    let next = steps(t).filter(|dt| *dt > low).fold(f64::INFINITY, f64::min);
    let high = if below > count / 2 { low } else { next };
    0.5 * (low + high)
}

/// The step that `k` others come before in order of size, and how many are not longer. Positive numbers are
/// in the order of their bits: the first digits are those of the bin that holds it, and so on.
fn kth(t: &[f64], k: usize) -> (f64, usize) {
    let (mut prefix, mut before, mut bins) = (0_u64, 0, vec![0_usize; 1 << DIGIT]);
    let mut known = 0;
    while known < u64::BITS {
        bins.fill(0);
        let shift = u64::BITS - known - DIGIT;
        for bits in steps(t).map(f64::to_bits) {
            if known == 0 || bits >> (shift + DIGIT) == prefix {
                bins[(bits >> shift) as usize & ((1 << DIGIT) - 1)] += 1;
            }
        }
        let mut digit = 0;
        while digit + 1 < bins.len() && before + bins[digit] <= k {
            before += bins[digit];
            digit += 1;
        }
        prefix = prefix << DIGIT | digit as u64;
        known += DIGIT;
    }
    (f64::from_bits(prefix), before + bins[prefix as usize & ((1 << DIGIT) - 1)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_sorting(t: &[f64]) -> f64 {
        let mut all: Vec<f64> = steps(t).collect();
        all.sort_by(f64::total_cmp);
        let n = all.len();
        if n % 2 == 1 { all[n / 2] } else { 0.5 * (all[n / 2 - 1] + all[n / 2]) }
    }

    #[test]
    fn median_is_that_of_sorted_steps() {
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for n in 2..60 {
            for kinds in [1.0, 2.0, 3.0, 1e9] {
                let mut t = vec![0.0];
                for _ in 1..n {
                    let step = 0.01 + (random() * kinds).floor() * 10_f64.powf(3.0 * random());
                    t.push(t[t.len() - 1] + step);
                }
                assert_eq!(median(&t), by_sorting(&t), "{t:?}");
            }
        }
    }

    #[test]
    fn limit_is_some_medians_or_none() {
        let regular: Vec<f64> = (0..1000).map(|k| f64::from(k) * 0.1).collect();
        assert_eq!(gap_limit(&regular, 3.0), f64::INFINITY);
        assert_eq!(gap_limit(&[], 3.0), f64::INFINITY);
        assert_eq!(gap_limit(&[1.0], 3.0), f64::INFINITY);
        let mut holes = regular;
        holes.drain(100..150);
        let limit = gap_limit(&holes, 3.0);
        assert_eq!(limit, 3.0 * by_sorting(&holes));
        assert_eq!(gaps(&holes, limit), [[holes[99], holes[100]]]);
    }
}

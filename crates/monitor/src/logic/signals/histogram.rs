//! Frequencies of values: bins of equal ratio, so that one late tick in a million still has its own.

/// Bins for each factor of ten.
const PER_DECADE: f64 = 10.0;
/// Factors of ten above the least value that is told apart.
const DECADES: usize = 5;
/// Bins of a histogram.
pub const BINS: usize = DECADES * 10;

/// Counts of values from `least` to 10⁵ times that; what is below or above goes into the first or last bin.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    least: f64,
    counts: [u64; BINS],
    total: u64,
    max: f64,
}

impl Histogram {
    /// Nothing counted; values below `least`, which must be above 0, are not told apart.
    pub fn new(least: f64) -> Self {
        Self { least, counts: [0; BINS], total: 0, max: f64::NAN }
    }

    /// Counts a value; one that is not finite is none.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the bins")]
        let bin = ((value / self.least).max(1.0).log10() * PER_DECADE).min((BINS - 1) as f64) as usize;
        self.counts[bin] += 1;
        self.total += 1;
        self.max = self.max.max(value);
    }

    /// Values counted.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Greatest value, NaN if there is none.
    pub fn max(&self) -> f64 {
        self.max
    }

    /// Lower edge, upper edge and count of every bin.
    pub fn bins(&self) -> impl Iterator<Item = (f64, f64, u64)> {
        self.counts.iter().enumerate().map(|(bin, count)| (self.edge(bin), self.edge(bin + 1), *count))
    }

    /// The least bin edge that at least the share `part` of all values does not exceed, never above the greatest
    /// value; NaN if there is none.
    pub fn quantile(&self, part: f64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
        let wanted = part * self.total as f64;
        let mut seen = 0;
        for (bin, count) in self.counts.iter().enumerate() {
            seen += count;
            #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
            if *count > 0 && seen as f64 >= wanted {
                return self.edge(bin + 1).min(self.max);
            }
        }
        f64::NAN
    }

    #[expect(clippy::cast_precision_loss, reason = "a few dozen bins")]
    fn edge(&self, bin: usize) -> f64 {
        self.least * 10f64.powf(bin as f64 / PER_DECADE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_within_a_bin_and_never_too_small() {
        let mut histogram = Histogram::new(1.0);
        (1..=1000).for_each(|i| histogram.add(f64::from(i)));
        for (part, exact) in [(0.5, 500.0), (0.99, 990.0), (0.999, 999.0), (1.0, 1000.0)] {
            let found = histogram.quantile(part);
            assert!(found >= exact && found <= exact * 1.26, "{part}: {found}");
        }
        assert!((histogram.max() - 1000.0).abs() < 1e-9);
    }

    #[test]
    fn one_outlier_in_a_million_is_counted_and_nothing_is_lost() {
        let mut histogram = Histogram::new(1.0);
        (0..1_000_000).for_each(|_| histogram.add(30.0));
        for value in [5000.0, 1e12, -3.0, 0.0] {
            histogram.add(value);
        }
        histogram.add(f64::NAN);
        assert_eq!(histogram.total(), 1_000_004);
        assert_eq!(histogram.bins().map(|(_, _, count)| count).sum::<u64>(), 1_000_004);
        assert_eq!(histogram.bins().filter(|(_, _, count)| *count == 1).count(), 2);
        assert!(histogram.bins().next().unwrap().2 == 2, "what is too small is in the first bin");
    }

    #[test]
    fn an_empty_one_says_so() {
        let histogram = Histogram::new(1.0);
        assert!(histogram.quantile(0.5).is_nan() && histogram.max().is_nan());
    }
}

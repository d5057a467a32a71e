//! Numbers that are random enough for a test.

/// Numbers from −1 to 1, the same on every machine: Knuth's linear congruential generator, the high bits.
///
/// ```
/// let (mut one, mut other) = (moca_wbc::testing::Numbers::from_seed(7), moca_wbc::testing::Numbers::from_seed(7));
/// let [x, y]: [f64; 2] = one.array(3.0);
/// assert_eq!([x, y], other.array(3.0));
/// assert!(x.abs() <= 3.0 && x.to_bits() != y.to_bits());
/// ```
#[derive(Clone, Debug)]
pub struct Numbers(u64);

impl Numbers {
    /// Another seed, other numbers.
    pub const fn from_seed(seed: u64) -> Self {
        Self(seed)
    }

    /// The next number from −1 to 1.
    pub fn next_number(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[expect(clippy::cast_precision_loss, reason = "31 bits")]
        let high = (self.0 >> 33) as f64;
        high / f64::from(1_u32 << 30) - 1.0
    }

    /// Numbers from −`most` to `most`.
    pub fn array<const D: usize>(&mut self, most: f64) -> [f64; D] {
        core::array::from_fn(|_| most * self.next_number())
    }
}

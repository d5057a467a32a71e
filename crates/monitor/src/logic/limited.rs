//! Values held between two bounds without a panic: rounding may put a computed upper bound below the lower one.
//!
//! ```
//! use moca_monitor::logic::limited::Limited;
//! assert_eq!(5.0_f64.limited(0.0, 3.0), 3.0);
//! assert_eq!(5.0_f64.limited(2.0, 1.0), 2.0);
//! assert_eq!(f64::NAN.limited(2.0, 3.0), 2.0);
//! ```

/// A number that can be held between two bounds.
pub trait Limited {
    /// Returns the nearest value from `low` to `high`. Crossed bounds and NaN give `low`.
    #[must_use]
    fn limited(self, low: Self, high: Self) -> Self;
}

impl Limited for f32 {
    fn limited(self, low: Self, high: Self) -> Self {
        self.max(low).min(high.max(low))
    }
}

impl Limited for f64 {
    fn limited(self, low: Self, high: Self) -> Self {
        self.max(low).min(high.max(low))
    }
}

//! Count of the arm's states that were lost.
//!
//! ```
//! use moca_franka::count::Count;
//!
//! let mut count = Count::default();
//! for of_state in [7, 8, 11, 2, 3] {
//!     count.take(of_state);
//! }
//! assert_eq!(count.lost(), 2, "9 and 10; then the arm began anew");
//! ```

/// The count of the last state, and how many were lost before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    last: Option<u64>,
    lost: u64,
}

impl Count {
    /// A state came with this count of the arm's; one that is smaller than the last is of an arm that began anew.
    pub fn take(&mut self, count: u64) {
        if let Some(last) = self.last.replace(count) {
            self.lost += count.saturating_sub(last.saturating_add(1));
        }
    }

    /// The next state may have any count: nobody read meanwhile.
    pub const fn interrupt(&mut self) {
        self.last = None;
    }

    /// Lost so far.
    pub const fn lost(&self) -> u64 {
        self.lost
    }
}

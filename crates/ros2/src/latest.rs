//! The newest value, from one thread to another, without a lock: the writer never waits, and the reader keeps what it had
//! when it meets the writer in the middle.
//!
//! ```
//! use moca_ros2::latest::Latest;
//!
//! let slot = Latest::<2>::default();
//! assert_eq!(slot.read(), None, "nothing yet");
//! slot.write([1.0, 2.0]);
//! slot.write([3.0, 4.0]);
//! assert_eq!(slot.read(), Some((2, [3.0, 4.0])), "the second value");
//! ```

use std::sync::atomic::{AtomicU64, Ordering, fence};

/// `N` numbers that belong together. One thread writes, any may read.
#[derive(Debug)]
pub struct Latest<const N: usize> {
    /// Odd while the writer is inside; twice the count of values otherwise.
    sequence: AtomicU64,
    bits: [AtomicU64; N],
}

impl<const N: usize> Default for Latest<N> {
    fn default() -> Self {
        Self { sequence: AtomicU64::new(0), bits: [const { AtomicU64::new(0) }; N] }
    }
}

impl<const N: usize> Latest<N> {
    /// Replaces the value.
    pub fn write(&self, values: [f64; N]) {
        let sequence = self.sequence.load(Ordering::Relaxed);
        self.sequence.store(sequence + 1, Ordering::Relaxed);
        fence(Ordering::Release);
        for (bits, value) in self.bits.iter().zip(values) {
            bits.store(value.to_bits(), Ordering::Relaxed);
        }
        self.sequence.store(sequence + 2, Ordering::Release);
    }

    /// The newest value and how many there have been; `None` before the first, and while one is being written.
    pub fn read(&self) -> Option<(u64, [f64; N])> {
        let before = self.sequence.load(Ordering::Acquire);
        let mut values = [0.0; N];
        for (value, bits) in values.iter_mut().zip(&self.bits) {
            *value = f64::from_bits(bits.load(Ordering::Relaxed));
        }
        fence(Ordering::Acquire);
        let whole = before == self.sequence.load(Ordering::Relaxed);
        (whole && before > 0 && before % 2 == 0).then_some((before / 2, values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_sees_whole_values_only_and_none_goes_back() {
        let slot = Latest::<8>::default();
        std::thread::scope(|scope| {
            scope.spawn(|| (1..=200_000).for_each(|i| slot.write([f64::from(i); 8])));
            let mut last = 0;
            while last < 200_000 {
                let Some((count, values)) = slot.read() else { continue };
                assert!(count >= last);
                #[expect(clippy::cast_precision_loss, reason = "small counts")]
                let expected = [count as f64; 8];
                assert_eq!(values.map(f64::to_bits), expected.map(f64::to_bits));
                last = count;
            }
        });
    }
}

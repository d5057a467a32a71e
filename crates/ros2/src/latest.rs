//! The newest value, from one thread to another, without a lock: the writer never waits, and the reader keeps what it had
//! when it meets the writer in the middle.
//!
//! ```
//! use moca_ros2::latest::Latest;
//!
//! let slot = Latest::<2>::default();
//! assert_eq!(slot.read(), None, "nothing yet");
//! slot.write([1, 2]);
//! slot.write([3, 4]);
//! assert_eq!(slot.read(), Some((2, [3, 4])), "the second value");
//! ```

use std::sync::atomic::{AtomicU64, Ordering, fence};

/// `N` words that belong together. One thread writes, any may read.
#[derive(Debug)]
pub struct Latest<const N: usize> {
    /// Odd while the writer is inside; twice the count of values otherwise.
    sequence: AtomicU64,
    words: [AtomicU64; N],
}

impl<const N: usize> Default for Latest<N> {
    fn default() -> Self {
        Self { sequence: AtomicU64::new(0), words: [const { AtomicU64::new(0) }; N] }
    }
}

impl<const N: usize> Latest<N> {
    /// Replaces the value.
    pub fn write(&self, values: [u64; N]) {
        let sequence = self.sequence.load(Ordering::Relaxed);
        self.sequence.store(sequence + 1, Ordering::Relaxed);
        fence(Ordering::Release);
        for (word, value) in self.words.iter().zip(values) {
            word.store(value, Ordering::Relaxed);
        }
        self.sequence.store(sequence + 2, Ordering::Release);
    }

    /// The newest value and how many there have been; `None` before the first, and while one is being written.
    pub fn read(&self) -> Option<(u64, [u64; N])> {
        let before = self.sequence.load(Ordering::Acquire);
        let mut values = [0; N];
        for (value, word) in values.iter_mut().zip(&self.words) {
            *value = word.load(Ordering::Relaxed);
        }
        fence(Ordering::Acquire);
        let whole = before == self.sequence.load(Ordering::Relaxed);
        (whole && before > 0 && before.is_multiple_of(2)).then_some((before / 2, values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_sees_whole_values_only_and_none_goes_back() {
        let slot = Latest::<8>::default();
        std::thread::scope(|scope| {
            scope.spawn(|| (1..=200_000).for_each(|i| slot.write([i; 8])));
            let mut last = 0;
            while last < 200_000 {
                let Some((count, values)) = slot.read() else { continue };
                assert!(count >= last);
                assert_eq!(values, [count; 8]);
                last = count;
            }
        });
    }
}

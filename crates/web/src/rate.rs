//! Bounds on how often something may happen. Time is an argument.

use std::{collections::HashMap, hash::Hash, time::Instant};

/// A bound: so many at once, then so many a second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rate {
    pub(crate) burst: f64,
    pub(crate) per_s: f64,
}

/// The rest of a [`Rate`].
#[derive(Debug)]
pub(crate) struct Bucket {
    left: f64,
    at: Instant,
}

impl Bucket {
    pub(crate) fn full(rate: Rate, now: Instant) -> Self {
        Self { left: rate.burst, at: now }
    }

    /// Takes one; `false` if there is none left.
    pub(crate) fn take(&mut self, rate: Rate, now: Instant) -> bool {
        let since_s = now.saturating_duration_since(self.at).as_secs_f64();
        self.left = (self.left + since_s * rate.per_s).min(rate.burst);
        self.at = now;
        let takes = self.left >= 1.0;
        if takes {
            self.left -= 1.0;
        }
        takes
    }

    fn is_full(&self, rate: Rate, now: Instant) -> bool {
        let since_s = now.saturating_duration_since(self.at).as_secs_f64();
        self.left + since_s * rate.per_s >= rate.burst
    }
}

/// A bound for each of many; beyond `most` of them all others share what the last one has.
#[derive(Debug)]
pub(crate) struct Rates<K> {
    rate: Rate,
    most: usize,
    buckets: HashMap<K, Bucket>,
    shared: Bucket,
}

impl<K: Eq + Hash> Rates<K> {
    pub(crate) fn new(rate: Rate, most: usize, now: Instant) -> Self {
        Self { rate, most, buckets: HashMap::new(), shared: Bucket::full(rate, now) }
    }

    /// Takes one of `key`'s; `false` if there is none left.
    pub(crate) fn take(&mut self, key: K, now: Instant) -> bool {
        let rate = self.rate;
        if !self.buckets.contains_key(&key) && self.buckets.len() >= self.most {
            self.buckets.retain(|_, bucket| !bucket.is_full(rate, now));
            if self.buckets.len() >= self.most {
                return self.shared.take(rate, now);
            }
        }
        self.buckets.entry(key).or_insert_with(|| Bucket::full(rate, now)).take(rate, now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const RATE: Rate = Rate { burst: 3.0, per_s: 2.0 };

    #[test]
    fn bucket_gives_its_burst_then_its_rate() {
        let start = Instant::now();
        let mut bucket = Bucket::full(RATE, start);
        assert_eq!((0..5).filter(|_| bucket.take(RATE, start)).count(), 3);
        let later = start + Duration::from_secs(1);
        assert_eq!((0..5).filter(|_| bucket.take(RATE, later)).count(), 2);
        let much_later = start + Duration::from_secs(60);
        assert_eq!((0..5).filter(|_| bucket.take(RATE, much_later)).count(), 3);
    }

    #[test]
    fn rates_beyond_the_bound_share_one_bucket() {
        let start = Instant::now();
        let mut rates = Rates::new(RATE, 10, start);
        let taken = (0..1000).filter(|key| rates.take(*key, start)).count();
        assert_eq!(taken, 10 + 3, "ten of their own and the burst of the shared one");
        assert!(rates.buckets.len() <= 10);
    }
}

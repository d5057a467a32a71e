//! Orders to the base that it has not carried out yet.

use crate::scalar::{Scalar, of};

/// Places of the ring; one place holds several steps where a delay is longer than as many steps.
const SLOTS: usize = 64;

/// Displacement that was ordered over a short time.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Slot<T> {
    /// Axes of B, m, m, rad.
    way: [T; 3],
    /// s.
    lasted: T,
}

/// The orders of the last delay: a ring of fixed size. Before the first order the base was told to stand.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Orders<T> {
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    slots: [Slot<T>; SLOTS],
    head: usize,
    /// The order in force until the next one, axes of B, m/s, m/s, rad/s.
    last: [T; 3],
}

impl<T: Scalar> Orders<T> {
    pub(super) fn new() -> Self {
        let empty = Slot { way: [T::zero(); 3], lasted: T::zero() };
        Self { slots: [empty; SLOTS], head: 0, last: [T::zero(); 3] }
    }

    /// Takes an order.
    pub(super) fn send(&mut self, velocity: &[T; 3]) {
        self.last = *velocity;
    }

    /// Order in force, axes of B, m/s, m/s, rad/s.
    pub(super) const fn last(&self) -> &[T; 3] {
        &self.last
    }

    /// The last order has been in force for `dt_s`. A place is full once it holds its share of `delay_s`.
    pub(super) fn advance(&mut self, dt_s: T, delay_s: T) {
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        let full_s = delay_s / of((SLOTS - 2) as f64) - of::<T>(1e-3) * dt_s;
        let held_s = self.slots[self.head].lasted;
        if held_s > T::zero() && held_s > full_s {
            self.head = (self.head + 1) % SLOTS;
            self.slots[self.head] = Slot { way: [T::zero(); 3], lasted: T::zero() };
        }
        let slot = &mut self.slots[self.head];
        slot.lasted += dt_s;
        for (way, velocity) in slot.way.iter_mut().zip(self.last) {
            *way += velocity * dt_s;
        }
    }

    /// Displacement that the orders of the last `delay_s` still have to go, axes of B, m, m, rad.
    pub(super) fn owed(&self, delay_s: T) -> [T; 3] {
        let (mut owed, mut left_s) = ([T::zero(); 3], delay_s);
        let newest_first =
            self.slots[..=self.head].iter().rev().chain(self.slots[self.head + 1..].iter().rev());
        for slot in newest_first {
            if slot.lasted > left_s {
                let share = left_s / slot.lasted;
                for (owed, way) in owed.iter_mut().zip(slot.way) {
                    *owed += share * way;
                }
                break;
            }
            for (owed, way) in owed.iter_mut().zip(slot.way) {
                *owed += way;
            }
            left_s -= slot.lasted;
        }
        owed
    }
}

#[cfg(test)]
#[expect(clippy::cast_precision_loss, reason = "some thousand steps")]
mod tests {
    use super::*;

    /// The orders of `delay_s`, added one by one.
    fn added(orders: &[f64], dt_s: f64, delay_s: f64) -> f64 {
        let (mut sum, mut left_s) = (0.0, delay_s);
        for order in orders.iter().rev() {
            let part_s = dt_s.min(left_s).max(0.0);
            sum += order * part_s;
            left_s -= part_s;
        }
        sum
    }

    #[test]
    fn owed_way_is_sum_of_orders_of_the_delay() {
        for (rate_hz, delay_s, most_m) in [
            (1000.0, 0.02, 1e-12),
            (1000.0, 0.05, 1e-12),
            // places of more than one step: an order that falls by 3 m/s² within one is taken as even
            (1000.0, 0.1, 4e-6),
            (1000.0, 0.3, 4e-5),
            (100.0, 0.1, 1e-12),
            (4000.0, 0.1, 4e-6),
        ] {
            let dt_s = 1.0 / rate_hz;
            let mut ring = Orders::<f64>::new();
            let mut sent = [0.0; 3000];
            for step in 0..sent.len() {
                // falls and rises at 3 m/s²
                let time_s = step as f64 * dt_s;
                let order = (3.0 * (time_s % 0.2) - 0.3).abs();
                ring.send(&[order, -order, 2.0 * order]);
                ring.advance(dt_s, delay_s);
                sent[step] = order;
                let owed = ring.owed(delay_s);
                let expected = added(&sent[..=step], dt_s, delay_s);
                assert!(
                    (owed[0] - expected).abs() <= most_m,
                    "{rate_hz} Hz, {delay_s} s: {owed:?} {expected}"
                );
                assert!((owed[1] + owed[0]).abs() < 1e-12 && (owed[2] - 2.0 * owed[0]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn nothing_is_owed_without_delay_or_orders() {
        let nothing = |owed: [f64; 3]| owed.iter().all(|way| way.abs() < f64::MIN_POSITIVE);
        let mut ring = Orders::<f64>::new();
        assert!(nothing(ring.owed(0.1)));
        ring.send(&[0.1, 0.2, 0.3]);
        assert!(nothing(ring.owed(0.1)), "not sent for any time yet");
        ring.advance(1e-3, 0.1);
        assert!(nothing(ring.owed(0.0)));
        let owed = ring.owed(0.1);
        assert!((owed[1] - 2e-4).abs() < 1e-15, "{owed:?}");
    }
}

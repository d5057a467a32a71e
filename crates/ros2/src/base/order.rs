//! Orders to a base: the loop's newest one at a steady rate, and zero when the loop is silent.
//!
//! ```
//! use moca_ros2::base::order::OrderWatch;
//!
//! let mut orders = OrderWatch::new(10_000_000, 50_000_000);
//! assert_eq!(orders.due(0), None, "nobody has ordered anything: the base is left alone");
//! orders.order(1_000_000, [0.2, 0.0, 0.0]);
//! assert_eq!(orders.due(1_000_000), Some([0.2, 0.0, 0.0]));
//! assert_eq!(orders.due(60_000_000), Some([0.0; 3]), "the loop hangs");
//! ```

/// Orders on their way to a base. Times are ns of one clock.
#[derive(Clone, Copy, Debug)]
pub struct OrderWatch {
    period_ns: u64,
    silence_ns: u64,
    next_ns: u64,
    ordered_ns: Option<u64>,
    velocity_body: [f64; 3],
    silences: u64,
    refused: u64,
}

impl OrderWatch {
    /// Sends every `period_ns`; zero once the last order is older than `silence_ns`.
    pub const fn new(period_ns: u64, silence_ns: u64) -> Self {
        Self {
            period_ns,
            silence_ns,
            next_ns: 0,
            ordered_ns: None,
            velocity_body: [0.0; 3],
            silences: 0,
            refused: 0,
        }
    }

    /// The loop orders a velocity in the axes of B: m/s, m/s, rad/s. One that is not finite counts as zero.
    pub fn order(&mut self, now_ns: u64, velocity_body: [f64; 3]) {
        let finite = velocity_body.iter().all(|v| v.is_finite());
        self.refused += u64::from(!finite);
        self.velocity_body = if finite { velocity_body } else { [0.0; 3] };
        self.ordered_ns = Some(now_ns);
    }

    /// Returns the order to send now, if it is time.
    pub fn due(&mut self, now_ns: u64) -> Option<[f64; 3]> {
        let ordered_ns = self.ordered_ns?;
        if now_ns.saturating_sub(ordered_ns) > self.silence_ns
            && self.velocity_body.iter().any(|v| v.abs() > 0.0)
        {
            self.velocity_body = [0.0; 3];
            self.silences += 1;
        }
        if now_ns < self.next_ns {
            return None;
        }
        // Slots that were slept through are not sent later in a bunch.
        self.next_ns = (self.next_ns + self.period_ns).max(now_ns + self.period_ns / 2);
        Some(self.velocity_body)
    }

    /// When there is something to do next, ns.
    pub const fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// Returns how often a moving base was stopped because the loop was silent.
    pub const fn silences(&self) -> u64 {
        self.silences
    }

    /// Orders that were not finite.
    pub const fn refused(&self) -> u64 {
        self.refused
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are handed on unchanged, and zero")]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn watch() -> OrderWatch {
        OrderWatch::new(10 * MS, 50 * MS)
    }

    #[test]
    fn orders_leave_at_100_hz_and_newest_counts() {
        let mut orders = watch();
        let mut sent = Vec::new();
        for ms in 0..1000_u32 {
            let now_ns = u64::from(ms) * MS;
            orders.order(now_ns, [f64::from(ms), 0.0, 0.0]);
            sent.extend(orders.due(now_ns).map(|velocity| (ms, velocity[0])));
        }
        assert_eq!(sent.len(), 100);
        assert!(sent.iter().all(|(ms, velocity)| f64::from(*ms).to_bits() == velocity.to_bits()));
    }

    #[test]
    fn silent_loop_stops_base_and_it_stays_stopped() {
        let mut orders = watch();
        orders.order(0, [0.5, -0.1, 0.2]);
        let sent: Vec<(u64, [f64; 3])> =
            (0..1000).filter_map(|ms| Some((ms, orders.due(ms * MS)?))).collect();
        for (ms, velocity) in sent {
            assert_eq!(velocity == [0.0; 3], ms > 50, "{ms} ms: {velocity:?}");
        }
        assert_eq!(orders.silences(), 1, "told once, not in every slot");
        orders.order(2000 * MS, [0.1, 0.0, 0.0]);
        assert_eq!(orders.due(2000 * MS), Some([0.1, 0.0, 0.0]), "an order is an order again");
    }

    #[test]
    fn slots_slept_through_are_not_made_up_for() {
        let mut orders = watch();
        orders.order(0, [0.1, 0.0, 0.0]);
        assert!(orders.due(0).is_some());
        orders.order(95 * MS, [0.2, 0.0, 0.0]);
        let burst = (0..4).filter(|i| orders.due(95 * MS + i * 100_000).is_some()).count();
        assert_eq!(burst, 1);
    }

    #[test]
    fn what_is_not_a_number_is_sent_as_zero() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for axis in 0..3 {
                let mut orders = watch();
                let mut velocity = [0.3; 3];
                velocity[axis] = bad;
                orders.order(0, velocity);
                assert_eq!((orders.due(0), orders.refused()), (Some([0.0; 3]), 1));
            }
        }
    }
}

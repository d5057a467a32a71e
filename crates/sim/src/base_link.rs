//! The way between a controller and its base: orders that arrive late, and odometry that is late or wrong.

use crate::error::{SimError, within};
use crate::sensor::Noise;
use moca_msgs::TrueBase;
use std::collections::VecDeque;

/// Stream of jitter and odometry noise: apart from that of a board with the same seed.
const STREAM: u64 = 0x6c61_7465;

/// An order on its way.
#[derive(Clone, Copy, Debug)]
struct Order {
    arrives_at: u64,
    velocity_body: [f64; 3],
}

/// Pose and velocity of the base in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    pub(crate) pose: [f64; 3],
    pub(crate) velocity: [f64; 3],
}

/// Orders and odometry of one base, control period by control period. Nothing is allocated after the start.
#[derive(Debug)]
pub(crate) struct BaseLink {
    truth: TrueBase,
    period_s: f64,
    noise: Noise,
    /// Control periods so far.
    now: u64,
    orders: VecDeque<Order>,
    next_order_at: u64,
    last_arrival: u64,
    in_force: [f64; 3],
    odometry: Odometry,
    /// Orders arrive in the control period that sends them, and no odometry shares the noise with their jitter.
    is_direct: bool,
}

impl BaseLink {
    pub(crate) fn new(truth: &TrueBase, period_s: f64, seed: u64) -> Self {
        let longest_ms = truth.order_delay_ms + truth.order_jitter_ms;
        let odometry = Odometry::new(truth, period_s);
        Self {
            truth: *truth,
            period_s,
            noise: Noise::new(STREAM.wrapping_add(seed)),
            now: 0,
            orders: VecDeque::with_capacity(ticks(longest_ms, period_s) + 2),
            next_order_at: 0,
            last_arrival: 0,
            in_force: [0.0; 3],
            is_direct: longest_ms <= 0.0 && truth.order_period_ms <= 0.0 && odometry.is_exact,
            odometry,
        }
    }

    /// Checks every number.
    pub(crate) fn check(truth: &TrueBase) -> Result<(), SimError> {
        let ms =
            [truth.order_delay_ms, truth.order_jitter_ms, truth.order_period_ms, truth.odometry_delay_ms];
        within("true.base delays", "ms", &ms, 0.0, 1000.0)?;
        within("true.base.deceleration", "m/s²", &[truth.deceleration_m_s2], 0.0, 1e4)?;
        within("true.base.odometry_scale", "", &[truth.odometry_scale], 0.5, 2.0)?;
        within("true.base.odometry_noise", "m/s", &[truth.odometry_noise_m_s], 0.0, 1.0)?;
        within("true.base.odometry_rate", "Hz", &[truth.odometry_rate_hz], 0.0, 1e4)
    }

    /// Sends an order, and returns the one that the servo follows in this control period.
    pub(crate) fn order(&mut self, velocity_body: [f64; 3]) -> [f64; 3] {
        if self.is_direct {
            return velocity_body;
        }
        if self.now >= self.next_order_at {
            self.next_order_at = self.now + ticks(self.truth.order_period_ms, self.period_s).max(1) as u64;
            let jitter_ms = self.truth.order_jitter_ms * (2.0 * self.noise.uniform() - 1.0);
            let delay = ticks(self.truth.order_delay_ms + jitter_ms, self.period_s) as u64;
            self.last_arrival = self.last_arrival.max(self.now + delay);
            self.orders.push_back(Order { arrives_at: self.last_arrival, velocity_body });
        }
        while let Some(order) = self.orders.pop_front_if(|order| order.arrives_at <= self.now) {
            self.in_force = order.velocity_body;
        }
        self.now += 1;
        self.in_force
    }

    /// The base has moved for a control period.
    pub(crate) fn moved(&mut self, motion: Motion) {
        self.odometry.moved(motion, &mut self.noise);
    }

    /// The base is put to another place: odometry begins there.
    pub(crate) fn put(&mut self, motion: Motion) {
        self.odometry.put(motion);
    }

    /// Returns the reported motion of a base that really moves as `motion`.
    pub(crate) fn reported(&self, motion: Motion) -> Motion {
        if self.odometry.is_exact { motion } else { self.odometry.reported }
    }
}

/// Odometry on its way to the controller.
#[derive(Debug)]
struct Odometry {
    is_exact: bool,
    scale: f64,
    noise_m_s: f64,
    delay: usize,
    every: u64,
    since: u64,
    start: Motion,
    late: VecDeque<Motion>,
    reported: Motion,
}

impl Odometry {
    fn new(truth: &TrueBase, period_s: f64) -> Self {
        let is_exact = truth.odometry_scale.total_cmp(&1.0).is_eq()
            && truth.odometry_delay_ms <= 0.0
            && truth.odometry_noise_m_s <= 0.0
            && truth.odometry_rate_hz <= 0.0;
        let delay = ticks(truth.odometry_delay_ms, period_s);
        let every_ms = if truth.odometry_rate_hz > 0.0 { 1e3 / truth.odometry_rate_hz } else { 0.0 };
        let nowhere = Motion { pose: [0.0; 3], velocity: [0.0; 3] };
        Self {
            is_exact,
            scale: truth.odometry_scale,
            noise_m_s: truth.odometry_noise_m_s,
            delay,
            every: ticks(every_ms, period_s).max(1) as u64,
            since: 0,
            start: nowhere,
            late: VecDeque::with_capacity(delay + 2),
            reported: nowhere,
        }
    }

    fn put(&mut self, motion: Motion) {
        self.late.clear();
        (self.start, self.reported, self.since) = (motion, motion, 0);
    }

    fn moved(&mut self, motion: Motion, noise: &mut Noise) {
        if self.is_exact {
            return;
        }
        self.late.push_back(motion);
        let seen = if self.late.len() > self.delay { self.late.pop_front() } else { None };
        self.since += 1;
        let Some(seen) = seen.filter(|_| self.since >= self.every) else { return };
        self.since = 0;
        for i in 0..3 {
            self.reported.pose[i] = self.start.pose[i] + self.scale * (seen.pose[i] - self.start.pose[i]);
            self.reported.velocity[i] = self.scale * seen.velocity[i];
            if self.noise_m_s > 0.0 {
                self.reported.velocity[i] += self.noise_m_s * noise.standard_normal();
            }
        }
    }
}

/// Nearest number of control periods, 0 for a negative time.
pub(crate) fn ticks(ms: f64, period_s: f64) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates; a second at most"
    )]
    let ticks = (1e-3 * ms / period_s).round() as usize;
    ticks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Control period, s.
    const PERIOD_S: f64 = 1e-3;

    fn link(change: impl Fn(&mut TrueBase)) -> BaseLink {
        let mut truth = TrueBase::AS_DESCRIBED;
        change(&mut truth);
        BaseLink::new(&truth, PERIOD_S, 1)
    }

    /// Orders in force when a step is sent in tick 100, tick by tick.
    fn step(link: &mut BaseLink) -> Vec<f64> {
        (0..400).map(|tick| link.order([if tick < 100 { 0.0 } else { 1.0 }, 0.0, 0.0])[0]).collect()
    }

    fn arrival(in_force: &[f64]) -> usize {
        in_force.iter().position(|v| *v > 0.0).unwrap()
    }

    #[test]
    fn order_arrives_after_its_delay_to_the_tick() {
        assert_eq!(arrival(&step(&mut link(|_| ()))), 100);
        assert_eq!(arrival(&step(&mut link(|t| t.order_delay_ms = 50.0))), 150);
        let mut slow = link(|t| t.order_period_ms = 30.0);
        assert_eq!(arrival(&step(&mut slow)), 120, "the next multiple of 30 ms");
    }

    #[test]
    fn jittered_orders_stay_in_sequence_and_within_bounds() {
        let mut late = link(|t| (t.order_delay_ms, t.order_jitter_ms, t.order_period_ms) = (30.0, 10.0, 5.0));
        let mut sent_at = Vec::new();
        let mut last = 0.0;
        for tick in 0..4000_u32 {
            let in_force = late.order([f64::from(tick), 0.0, 0.0])[0];
            assert!(in_force >= last, "overtaken in tick {tick}");
            last = in_force;
            if tick > 100 {
                sent_at.push(f64::from(tick) - in_force);
            }
        }
        let (least, most) =
            sent_at.iter().fold((f64::INFINITY, 0.0_f64), |(l, m), age| (l.min(*age), m.max(*age)));
        assert!((20.0..25.0).contains(&least), "{least} ms");
        assert!(most > 35.0 && most <= 40.0 + 4.0, "{most} ms: an order stays in force until the next one");
    }

    #[test]
    fn odometry_is_late_scaled_and_held_as_asked() {
        let at =
            |tick: u32| Motion { pose: [1.0 + 1e-3 * f64::from(tick), 0.0, 0.0], velocity: [1.0, 0.0, 0.0] };
        let drive = |link: &mut BaseLink| {
            link.put(at(0));
            (1..=200).for_each(|tick| link.moved(at(tick)));
            link.reported(at(200))
        };
        let near =
            |value: f64, expected: f64| assert!((value - expected).abs() < 1e-12, "{value} {expected}");
        near(drive(&mut link(|_| ())).pose[0], 1.2);
        near(drive(&mut link(|t| t.odometry_delay_ms = 20.0)).pose[0], 1.18);
        let scaled = drive(&mut link(|t| t.odometry_scale = 0.9));
        near(scaled.pose[0], 1.18);
        near(scaled.velocity[0], 0.9);
        near(drive(&mut link(|t| t.odometry_rate_hz = 1000.0 / 30.0)).pose[0], 1.18);
        let noisy = drive(&mut link(|t| t.odometry_noise_m_s = 0.01));
        let off = (noisy.velocity[0] - 1.0).abs();
        assert!(off > 0.0 && off < 0.05, "{off} m/s");
    }
}

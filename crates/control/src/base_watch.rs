//! Watch on the base: whether it goes further than a base as late as the measured one could under its orders. Pure.
//!
//! The speed limit counts on the stopping distance that was measured. A base that has become later since (another network, a worn
//! drive, a load) would press deeper than the limit allows. So its way is compared with an envelope of its orders, which rises at once
//! with an order and falls like the latest base that the measurement allows. The way beyond it, less a drift that noise explains, is
//! summed up. Beyond [`ALARM_M`] the base is later than measured, by that way over the speed from which it fell. The speed limit falls
//! at once for a base that much later, and never rises again by itself. If the way is longer than the limit in force allowed for, with
//! [`RESERVE_M`], the robot stops.
//!
//! A base that makes room for somebody may be faster than the fastest stop that was measured. Nothing is known of such a stop, so the
//! watch waits until the base must be at rest.
//!
//! The watch does not see a way below the alarm. [`RESERVE_M`] stands in the speed limit for it.

use crate::approach::{RESERVE_M, Stopping, WORST_CREDIBLE};
use crate::barrier;
use crate::config::Config;
use crate::robot::JOINTS;
use moca_msgs::{Fault, RobotState};
use serde::{Deserialize, Serialize};

/// Way beyond the envelope from which on a base is later than measured, m: just more than the reserve.
pub const ALARM_M: f64 = 1.04e-3;
/// Speed beyond the envelope that noise and the scale of odometry explain, m/s, and as a share of the envelope.
const DRIFT_M_S: f64 = 1e-3;
const DRIFT_SHARE: f64 = 0.05;
/// Largest lateness that is told from another, s: no speed is left to a base that is later.
const LATEST_S: f64 = 10.0;
/// Parts of the longest delay for each of which the largest order is kept.
const PARTS: usize = 16;
#[expect(clippy::cast_precision_loss, reason = "a small count")]
const PARTS_F: f64 = PARTS as f64;
/// Forward, back, left, right, and the cover's rim either way round.
const WAYS: usize = 6;
/// First way of the rim.
const RIM: usize = 4;

/// Envelope of the base's orders, and the way beyond it.
#[derive(Clone, Debug)]
pub struct BaseWatch {
    stopping: Stopping,
    /// The longest delay, from any speed.
    delay_s: f64,
    servo_s: f64,
    /// Decelerations of the base and of the rim.
    deceleration_m_s2: [f64; 2],
    /// Distance of the cover's rim from the middle of the base, m.
    rim_m: f64,
    state: BaseWatchState,
}

/// Memory of a [`BaseWatch`] between ticks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct BaseWatchState {
    /// Pose of the base in the last tick, m, m, rad.
    pose_world: Option<[f64; 3]>,
    /// Largest order of each way in the last parts of the longest delay, the running one first, m/s.
    orders_m_s: [[f64; WAYS]; PARTS + 1],
    /// Time since the running part began, s.
    part_s: f64,
    ways: [Way; WAYS],
    /// Lateness beyond the measured one, s.
    late_s: f64,
}

/// Envelope of one way.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Way {
    /// Largest speed of a base as late as measured, m/s.
    envelope_m_s: f64,
    /// Way that the envelope, noise and scale explain since odometry was new last, m.
    explained_m: f64,
    /// Way beyond it, m.
    beyond_m: f64,
    /// When the envelope began to fall: its speed and the speed limit, m/s, and the lateness known then, s.
    from_m_s: f64,
    limit_m_s: f64,
    late_s: f64,
    /// Time for which the base may still come down from an order at which no stop was measured, s.
    unmeasured_s: f64,
}

impl BaseWatch {
    /// As configured; `None` for a base whose stopping distance is not believed: a simulated one as described.
    pub fn new(config: &Config) -> Option<Self> {
        let stopping = Stopping::of(config).filter(|_| config.plant.parts.has_cover())?;
        let (base, p) = (&config.robot.base, &config.protection);
        let believed = Stopping::Assumed {
            delay_s: 1e-3 * (p.order_delay_ms + p.order_delay_error_ms),
            servo_s: base.servo_time_constant_s,
            deceleration_m_s2: base.acceleration_max_m_s2,
        };
        let latest = if stopping == WORST_CREDIBLE { &WORST_CREDIBLE } else { &believed };
        let &Stopping::Assumed { delay_s, servo_s, deceleration_m_s2 } = latest else { return None };
        let [length_m, width_m, _] = base.size_m;
        let state = BaseWatchState {
            pose_world: None,
            orders_m_s: [[0.0; WAYS]; PARTS + 1],
            part_s: 0.0,
            ways: [Way::default(); WAYS],
            late_s: 0.0,
        };
        let rim_m = 0.5 * length_m.hypot(width_m);
        let of_rim_m_s2 = deceleration_m_s2.min(rim_m * base.yaw_acceleration_max_rad_s2);
        Some(Self {
            stopping,
            delay_s,
            servo_s,
            deceleration_m_s2: [deceleration_m_s2, of_rim_m_s2],
            rim_m,
            state,
        })
    }

    /// Returns its memory.
    pub const fn state(&self) -> BaseWatchState {
        self.state
    }

    /// Goes on from where `state` was taken.
    pub const fn restore(&mut self, state: &BaseWatchState) {
        self.state = *state;
    }

    /// Lateness of the base beyond the measured one, s.
    pub const fn late_s(&self) -> f64 {
        self.state.late_s
    }

    /// Takes in the measured pose of the base, `dt_s` after the last one, and the speed limit in force.
    ///
    /// # Errors
    /// [`Fault::BaseLate`]: the base went further than the limit allowed for.
    pub fn travelled(&mut self, robot: &RobotState<JOINTS>, limit_m_s: f64, dt_s: f64) -> Result<(), Fault> {
        let newest = self.newest(dt_s);
        let aside_m = self.aside_m_s() * dt_s;
        for way in &mut self.state.ways[..RIM] {
            way.explained_m += aside_m;
        }
        let falls: [bool; WAYS] = std::array::from_fn(|i| self.follow(i, newest[i], limit_m_s, dt_s));
        let pose = robot.base_pose_world;
        let last = self.state.pose_world.unwrap_or(pose);
        let [dx_world, dy_world, turned_rad] = [0, 1, 2].map(|axis| pose[axis] - last[axis]);
        self.state.pose_world = Some(pose);
        #[expect(
            clippy::float_cmp,
            reason = "the same numbers again: odometry has nothing new, or the base stands"
        )]
        if pose == last {
            return Ok(());
        }
        let turned_rad = turned_rad.sin().atan2(turned_rad.cos());
        let [dx_body, dy_body] = barrier::to_body([dx_world, dy_world], robot);
        let gone_m = self.ways_of([dx_body, dy_body, turned_rad]);
        let mut too_far = Ok(());
        for (i, gone_m) in gone_m.into_iter().enumerate() {
            let way = &mut self.state.ways[i];
            let beyond_m = way.beyond_m + gone_m - std::mem::take(&mut way.explained_m);
            // A base that falls sooner and longer than the envelope may come as far as it. One that is faster than its order is not
            // later.
            way.beyond_m = if falls[i] { beyond_m } else { beyond_m.clamp(0.0, way.beyond_m.max(0.0)) };
            if falls[i] && beyond_m > ALARM_M {
                let late_s = way.late_s + beyond_m / way.from_m_s.max(DRIFT_M_S);
                self.state.late_s = self.state.late_s.max(late_s.min(LATEST_S));
                if self.is_beyond_the_limit(i) {
                    too_far = Err(Fault::BaseLate);
                }
            }
        }
        too_far
    }

    /// Takes in the order that the base is given from now on, axes of B, m/s and rad/s.
    pub fn ordered(&mut self, velocity_body: &[f64; 3]) {
        let ways = self.ways_of(*velocity_body);
        for (most, order) in self.state.orders_m_s[0].iter_mut().zip(ways) {
            *most = most.max(order);
        }
    }

    /// The largest order of each way that the latest base may still carry out, `dt_s` later.
    fn newest(&mut self, dt_s: f64) -> [f64; WAYS] {
        let part_s = (self.delay_s + self.state.late_s) / PARTS_F;
        let newest = std::array::from_fn(|i| {
            let longest_s = self.delay_from_s(self.state.ways[i].from_m_s) + self.state.late_s;
            let mut youngest_s = 0.0;
            let mut most_m_s: f64 = 0.0;
            for (part, orders_m_s) in self.state.orders_m_s.iter().enumerate() {
                if youngest_s > longest_s {
                    break;
                }
                most_m_s = most_m_s.max(orders_m_s[i]);
                youngest_s += if part == 0 { self.state.part_s } else { part_s };
            }
            most_m_s
        });
        self.state.part_s += dt_s;
        if self.state.part_s >= part_s {
            self.state.part_s = 0.0;
            self.state.orders_m_s.rotate_right(1);
            self.state.orders_m_s[0] = [0.0; WAYS];
        }
        newest
    }

    /// Delay with which a base that stops from `speed_m_s` goes as far as was measured, s.
    fn delay_from_s(&self, speed_m_s: f64) -> f64 {
        let Stopping::Measured(_) = &self.stopping else { return self.delay_s };
        let speed_m_s = speed_m_s.max(DRIFT_M_S);
        let brakes_s = self.servo_s + 0.5 * speed_m_s / self.deceleration_m_s2[0];
        (self.stopping.distance_m(speed_m_s) / speed_m_s - brakes_s).clamp(0.0, self.delay_s)
    }

    /// Speed at which a base that drives and turns may seem to go aside, m/s: it still goes as it was ordered to in axes that have
    /// turned since.
    fn aside_m_s(&self) -> f64 {
        let fastest_m_s = |way: usize| {
            let [there, back] = [way, way + 1].map(|i| self.state.ways[i].envelope_m_s);
            there.max(back)
        };
        let turned_rad = fastest_m_s(RIM) / self.rim_m * (self.delay_s + self.servo_s + self.state.late_s);
        fastest_m_s(0).hypot(fastest_m_s(2)) * turned_rad
    }

    /// Moves the envelope of way `i` on towards `order_m_s`; true while it falls.
    fn follow(&mut self, i: usize, order_m_s: f64, limit_m_s: f64, dt_s: f64) -> bool {
        let (way, late_s) = (&mut self.state.ways[i], self.state.late_s);
        way.explained_m += (way.envelope_m_s * (1.0 + DRIFT_SHARE) + DRIFT_M_S) * dt_s;
        way.unmeasured_s = (way.unmeasured_s - dt_s).max(self.stopping.rests_within_s(order_m_s));
        if way.unmeasured_s > 0.0 {
            (way.envelope_m_s, way.beyond_m) = (order_m_s, 0.0);
        }
        if order_m_s >= way.envelope_m_s {
            way.envelope_m_s = order_m_s;
            if way.beyond_m > 0.0 {
                // a base that has not come down yet is still measured by that fall
                (way.from_m_s, way.limit_m_s) = (way.from_m_s.max(order_m_s), way.limit_m_s.max(limit_m_s));
            } else {
                (way.from_m_s, way.limit_m_s, way.late_s) = (order_m_s, limit_m_s.max(order_m_s), late_s);
            }
            return false;
        }
        // a lag that falls no faster than the exact one
        let towards_m_s = (order_m_s - way.envelope_m_s) * dt_s / (self.servo_s + dt_s);
        way.envelope_m_s += towards_m_s.max(-self.deceleration_m_s2[usize::from(i >= RIM)] * dt_s);
        true
    }

    /// True if the way that the base fell with is longer than the speed limit allowed for.
    fn is_beyond_the_limit(&self, i: usize) -> bool {
        let Way { beyond_m, from_m_s, limit_m_s, late_s, .. } = self.state.ways[i];
        let distance_m = |speed_m_s: f64| self.stopping.distance_m(speed_m_s) + speed_m_s * late_s;
        distance_m(from_m_s) + beyond_m > distance_m(limit_m_s) + RESERVE_M
    }

    /// The parts of a motion each way.
    fn ways_of(&self, [x, y, yaw]: [f64; 3]) -> [f64; WAYS] {
        let rim = self.rim_m * yaw;
        [x, -x, y, -y, rim, -rim]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stopping::{Ladder, believe};
    use std::collections::VecDeque;

    const TICK_S: f64 = 1e-3;
    /// No limit that a base could pass.
    const UNLIMITED_M_S: f64 = 3.0;

    /// Numbers that repeat themselves from run to run.
    struct Random(u64);

    impl Random {
        fn between(&mut self, least: f64, most: f64) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            #[expect(clippy::cast_precision_loss, reason = "a random number")]
            let share = (self.0 >> 11) as f64 / (1_u64 << 53) as f64;
            least + (most - least) * share
        }
    }

    /// A base of first order behind a line: delay and its jitter, s, time constant, s, deceleration, m/s².
    #[derive(Clone, Copy)]
    struct Base {
        delay_s: f64,
        jitter_s: f64,
        servo_s: f64,
        deceleration_m_s2: f64,
    }

    const AS_MEASURED: Base = Base { delay_s: 0.05, jitter_s: 0.01, servo_s: 0.03, deceleration_m_s2: 2.0 };

    /// The base in one direction, and its odometry.
    struct Plant {
        random: Random,
        orders_m_s: VecDeque<f64>,
        speed_m_s: f64,
        place_m: f64,
        /// Place that odometry reports every 20 ms.
        shown_m: f64,
        ms: u64,
    }

    impl Plant {
        fn new(seed: u64) -> Self {
            let orders_m_s = VecDeque::new();
            Self { random: Random(seed), orders_m_s, speed_m_s: 0.0, place_m: 0.0, shown_m: 0.0, ms: 0 }
        }

        /// The next millisecond, under an order.
        fn step(&mut self, base: &Base, order_m_s: f64) {
            self.orders_m_s.push_back(order_m_s);
            let late_s = base.delay_s + self.random.between(-base.jitter_s, base.jitter_s);
            #[expect(clippy::cast_precision_loss, reason = "some orders")]
            let waits_s = |orders: &VecDeque<f64>| orders.len() as f64 * TICK_S;
            while self.orders_m_s.len() > 1 && waits_s(&self.orders_m_s) > late_s {
                self.orders_m_s.pop_front();
            }
            let towards_m_s = (self.orders_m_s[0] - self.speed_m_s) * (1.0 - (-TICK_S / base.servo_s).exp());
            let most_m_s = base.deceleration_m_s2 * TICK_S;
            self.speed_m_s += towards_m_s.clamp(-most_m_s, most_m_s);
            self.place_m += self.speed_m_s * TICK_S;
            self.ms += 1;
            if self.ms.is_multiple_of(20) {
                self.shown_m = self.place_m + self.random.between(-5e-5, 5e-5);
            }
        }
    }

    /// A base that is driven and watched in one direction.
    struct Drive {
        watch: BaseWatch,
        robot: RobotState<JOINTS>,
        plant: Plant,
        order_m_s: f64,
        axis: usize,
        /// Yaw of the base, and whether it drives backward.
        yaw_rad: f64,
        forward: f64,
    }

    impl Drive {
        fn new(axis: usize, seed: u64) -> Self {
            #[expect(clippy::cast_precision_loss, reason = "a small number")]
            let yaw_rad = 0.7 * seed as f64;
            Self {
                watch: BaseWatch::new(&measured()).unwrap(),
                robot: RobotState::at_rest([0.0; JOINTS]),
                plant: Plant::new(seed),
                order_m_s: 0.0,
                axis,
                yaw_rad,
                forward: if seed.is_multiple_of(2) { 1.0 } else { -1.0 },
            }
        }

        /// The next millisecond towards `wanted_m_s`.
        fn step(&mut self, base: &Base, wanted_m_s: f64, limit_m_s: f64) -> Result<(), Fault> {
            let scale = self.forward / if self.axis == 2 { self.watch.rim_m } else { 1.0 };
            let mut way_body = [0.0; 3];
            way_body[self.axis] = scale * self.plant.shown_m;
            let (sin, cos) = self.yaw_rad.sin_cos();
            let [x, y, turned_rad] = way_body;
            self.robot.base_pose_world = [cos * x - sin * y, sin * x + cos * y, self.yaw_rad + turned_rad];
            self.watch.travelled(&self.robot, limit_m_s, TICK_S)?;
            self.order_m_s += (wanted_m_s - self.order_m_s).clamp(-3.0 * TICK_S, 3.0 * TICK_S);
            let mut order = [0.0; 3];
            order[self.axis] = scale * self.order_m_s;
            self.watch.ordered(&order);
            self.plant.step(base, self.order_m_s);
            Ok(())
        }

        /// Random orders for `seconds`, each held for 0.4 to 2 s; returns how many of them fell before the base was found late.
        fn random(&mut self, base: &Base, fastest_m_s: f64, seconds: u64) -> u32 {
            let (until, mut falls, mut wanted_m_s) = (self.plant.ms + 1000 * seconds, 0, 0.0_f64);
            while self.plant.ms < until {
                let stops = wanted_m_s > 0.0 && self.plant.random.between(0.0, 1.0) < 0.5;
                let next_m_s = if stops { 0.0 } else { self.plant.random.between(0.0, fastest_m_s) };
                falls += u32::from(next_m_s < wanted_m_s && self.watch.late_s() == 0.0);
                wanted_m_s = next_m_s;
                let (mut ms, end) = (0.0, self.plant.random.between(400.0, 2000.0));
                while ms < end {
                    self.step(base, wanted_m_s, UNLIMITED_M_S).expect("no limit is passed");
                    ms += 1.0;
                }
            }
            falls
        }
    }

    /// The belief that the ladder gives of [`AS_MEASURED`].
    fn measured() -> Config {
        measured_of(&AS_MEASURED)
    }

    fn measured_of(base: &Base) -> Config {
        let mut config = Config::default();
        config.robot.base.servo_time_constant_s = 0.03;
        config.robot.base.acceleration_max_m_s2 = 2.0;
        let (mut ladder, mut plant) = (Ladder::new(3.0, TICK_S), Plant::new(1));
        while let Some(order_m_s) = ladder.tick(plant.shown_m).unwrap() {
            plant.step(base, order_m_s);
        }
        let stops: Vec<_> = ladder.stops().collect();
        believe(&mut config, &stops, "a test".into());
        config
    }

    #[test]
    fn simulated_base_as_described_is_not_watched() {
        assert!(BaseWatch::new(&Config::default()).is_none());
        let mut real = Config::default();
        real.plant.kind = crate::robot::PlantKind::Robot;
        assert!((BaseWatch::new(&real).unwrap().delay_s - 0.1).abs() < 1e-12, "the worst credible base");
    }

    #[test]
    fn base_as_measured_raises_no_alarm_in_an_hour() {
        for (axis, seed) in [(0, 2), (1, 3), (2, 4)] {
            let mut drive = Drive::new(axis, seed);
            let falls = drive.random(&AS_MEASURED, 0.08, 1200);
            let most_m = drive.watch.state.ways.iter().fold(0.0, |most: f64, way| most.max(way.beyond_m));
            println!("axis {axis}: {falls} falls, {most_m}");
            assert!(falls > 300, "{falls} falls");
            assert!(drive.watch.late_s() < 1e-12, "axis {axis}");
        }
    }

    /// Weaker brakes show their length only above the speeds of the ladder, at which a base makes room for somebody.
    #[test]
    fn stop_from_a_speed_that_was_not_measured_raises_no_alarm() {
        let weak = Base { deceleration_m_s2: 0.5, ..AS_MEASURED };
        let config = measured_of(&weak);
        for (axis, seed) in [(0, 2), (1, 3), (2, 4)] {
            let mut drive = Drive { watch: BaseWatch::new(&config).unwrap(), ..Drive::new(axis, seed) };
            let falls = drive.random(&weak, 0.3, 600);
            assert!(falls > 150 && drive.watch.late_s() < 1e-12, "axis {axis}: {} s", drive.watch.late_s());
            // a base that became later since is still found by its slower stops
            let later = Base { delay_s: 0.2, ..weak };
            drive.random(&later, 0.3, 60);
            assert!((0.03..0.3).contains(&drive.watch.late_s()), "axis {axis}: {} s", drive.watch.late_s());
        }
    }

    /// It goes where it was ordered to 0.07 s ago, when its axes were others.
    #[test]
    fn base_that_turns_may_seem_to_go_aside() {
        for (turn_rad_s, turned_rad, is_late) in [(0.2, 0.014, false), (0.0, 0.014, true), (0.2, 0.06, true)]
        {
            let mut watch = BaseWatch::new(&measured()).unwrap();
            let mut robot = RobotState::at_rest([0.0; JOINTS]);
            for tick in 0..8000 {
                let [x, y, yaw] = robot.base_pose_world;
                let (sin, cos) = (yaw - turned_rad).sin_cos();
                robot.base_pose_world =
                    [x + 0.1 * sin * TICK_S, y - 0.1 * cos * TICK_S, yaw + turn_rad_s * TICK_S];
                watch.travelled(&robot, UNLIMITED_M_S, TICK_S).unwrap();
                watch.ordered(&[if tick == 0 { -1e-3 } else { 0.0 }, -0.1, turn_rad_s]);
            }
            assert_eq!(watch.late_s() > 0.0, is_late, "{} s", watch.late_s());
            watch.state.late_s = 0.02;
            let aside_m_s = 0.1 * turn_rad_s * (watch.delay_s + 0.03 + 0.02);
            assert!((watch.aside_m_s() - aside_m_s).abs() < 1e-9, "{} m/s", watch.aside_m_s());
        }
    }

    #[test]
    fn later_base_is_found_after_a_few_falls_of_the_order() {
        let delayed = |delay_s: f64| Base { delay_s, ..AS_MEASURED };
        let slower = |servo_s: f64| Base { servo_s, ..AS_MEASURED };
        for (base, most_falls, late_s) in [
            (delayed(0.1), 15, 0.02..0.055),
            (delayed(0.15), 3, 0.06..0.11),
            (slower(0.1), 15, 0.02..0.08),
            (slower(0.2), 3, 0.05..0.2),
            (Base { deceleration_m_s2: 0.5, ..AS_MEASURED }, 60, 0.01..0.1),
        ] {
            for seed in 0..6 {
                let mut drive = Drive::new(usize::try_from(seed).unwrap() % 3, seed + 10);
                let falls = drive.random(&base, 0.08, 120);
                let found_s = drive.watch.late_s();
                println!("{falls} falls, {found_s:.3} s later");
                assert!(falls <= most_falls && late_s.contains(&found_s), "{falls} falls, {found_s} s");
            }
        }
    }

    /// From the limit's speed the way is longer than what the limit allows for; from a third of it, it is not.
    #[test]
    fn base_that_falls_from_the_limit_stops_the_robot() {
        let late = Base { delay_s: 0.2, jitter_s: 0.0, ..AS_MEASURED };
        for (speed_m_s, stops) in [(0.045, true), (0.015, false)] {
            let mut drive = Drive::new(0, 1);
            let mut stopped = Ok(());
            for ms in 0..2500 {
                let wanted_m_s = if ms < 1000 { speed_m_s } else { 0.0 };
                stopped = drive.step(&late, wanted_m_s, 0.045);
                if stopped.is_err() {
                    break;
                }
            }
            assert!(drive.watch.late_s() > 0.02, "{}", drive.watch.late_s());
            assert_eq!(stopped == Err(Fault::BaseLate), stops, "{speed_m_s} m/s");
        }
    }

    /// Goes `towards` speeds for times, m/s and ms.
    fn through(drive: &mut Drive, base: &Base, limit_m_s: f64, speeds: &[(f64, u32)]) -> Result<(), Fault> {
        for &(speed_m_s, ms) in speeds {
            for _ in 0..ms {
                drive.step(base, speed_m_s, limit_m_s)?;
            }
        }
        Ok(())
    }

    /// The lateness that is known already lengthens what the limit allows for, and what the base is measured by.
    #[test]
    fn base_below_the_limit_may_be_later_by_what_the_limit_leaves() {
        for (delay_s, stops) in [(0.31, false), (0.45, true)] {
            let late = Base { delay_s: 0.18, jitter_s: 0.0, ..AS_MEASURED };
            let mut drive = Drive::new(1, 6);
            through(&mut drive, &late, UNLIMITED_M_S, &[(0.05, 1000), (0.0, 1500)]).unwrap();
            let known_s = drive.watch.late_s();
            assert!((0.08..0.12).contains(&known_s), "{known_s}");
            let later = Base { delay_s, ..late };
            let stopped = through(&mut drive, &later, 0.05, &[(0.03, 2000), (0.0, 1500)]);
            assert!(drive.watch.late_s() > known_s + 0.03, "{}", drive.watch.late_s());
            assert_eq!(stopped == Err(Fault::BaseLate), stops, "{delay_s} s");
        }
    }

    /// An order that rises a little while the base comes down does not make it later than it is.
    #[test]
    fn base_that_comes_down_is_measured_by_the_speed_it_fell_from() {
        let late = Base { delay_s: 0.35, jitter_s: 0.0, ..AS_MEASURED };
        let mut drive = Drive::new(0, 3);
        through(&mut drive, &late, UNLIMITED_M_S, &[(0.08, 1000), (0.0, 250), (0.015, 600), (0.0, 1000)])
            .unwrap();
        let late_s = drive.watch.late_s();
        assert!((0.05..0.29).contains(&late_s), "{late_s}");
    }

    #[test]
    fn envelope_waits_for_the_delay_and_brakes_like_the_base() {
        for (axis, deceleration_m_s2) in [(0, 2.0), (2, 1.5)] {
            let mut config = measured();
            let mut watch = BaseWatch::new(&config).unwrap();
            config.robot.base.yaw_acceleration_max_rad_s2 = 1.5 / watch.rim_m;
            watch = BaseWatch::new(&config).unwrap();
            let scale = if axis == 2 { 1.0 / watch.rim_m } else { 1.0 };
            let robot = RobotState::at_rest([0.0; JOINTS]);
            let mut step = |order_m_s: f64| {
                watch.travelled(&robot, UNLIMITED_M_S, TICK_S).unwrap();
                let mut order = [0.0; 3];
                order[axis] = scale * order_m_s;
                watch.ordered(&order);
                watch.state.ways[2 * axis].envelope_m_s
            };
            (0..400).for_each(|_| _ = step(0.12));
            let mut last_m_s = step(0.0);
            let (mut waited, mut fastest_m_s) = (0, 0.0_f64);
            for _ in 0..600 {
                let envelope_m_s = step(0.0);
                waited += u32::from(envelope_m_s > 0.12 - 1e-12);
                fastest_m_s = fastest_m_s.max(last_m_s - envelope_m_s);
                last_m_s = envelope_m_s;
            }
            let delay_ms = 1e3 * watch.delay_from_s(0.12);
            let most_ms = delay_ms + 1e3 * watch.delay_s / PARTS_F + 2.0;
            assert!((delay_ms - 1.0..most_ms).contains(&f64::from(waited)), "{waited} of {delay_ms} ms");
            assert!((fastest_m_s - deceleration_m_s2 * TICK_S).abs() < 1e-9, "{fastest_m_s}");
            assert!(last_m_s < 1e-6, "it ends at the order: {last_m_s}");
        }
    }

    #[test]
    fn lateness_is_kept_and_restored() {
        let mut drive = Drive::new(0, 5);
        drive.random(&Base { delay_s: 0.15, ..AS_MEASURED }, 0.08, 60);
        let (late_s, state) = (drive.watch.late_s(), drive.watch.state());
        assert!(late_s > 0.05);
        drive.random(&AS_MEASURED, 0.08, 60);
        assert!(drive.watch.late_s() >= late_s, "never lower by itself");
        let mut other = BaseWatch::new(&measured()).unwrap();
        other.restore(&state);
        assert!((other.late_s() - late_s).abs() < 1e-12);
    }
}

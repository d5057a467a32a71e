//! Protection of the people around the base: how fast it may go for the board it has, and what it does when a contact
//! crosses a limit of the user's. Pure but for the file of limits ([`crate::config::contact_limits`]); no allocation in a tick.
//!
//! v = (F_max − F_threshold)/(k(T + τ)): a reading that is T late lets a base of servo lag τ press v(T + τ) further than the
//! controller knows, against the stiffness k of cover and body; what the cover does not feel comes on top. It bounds the
//! impact, not what a law goes on pushing with: that is the contact limits' part.
//!
//! The limit holds for the fastest point of the cover, a corner once the base turns: whoever is touched is touched
//! there. The arm and what it carries are not covered by it.

use crate::approach::{Approach, Frames, Stopping, WORST_CREDIBLE};
use crate::barrier;
use crate::config::contact_limits::ContactLimits;
use crate::config::{Config, ProtectionConfig};
use crate::contacts::ContactTracker;
use crate::cover::CoverState;
use crate::robot::{JOINTS, TAXELS};
use moca_msgs::protection::MAX_CONTACT_EVENTS;
use moca_msgs::{
    ContactEvent, ContactReaction, ContactRow, Limits, ParameterError, SpeedLimit, SpeedLimitReason, seconds,
};
use moca_tactile::Firmware;
use moca_tactile::board::SILENT_AFTER_NS;
use moca_wbc::BaseGuard;
use moca_wbc::contact_stability::{Contact, largest_speed, speed_for_stopping};
use moca_wbc::guard::CoverOutline;
use serde::{Deserialize, Serialize};

/// Frames before the delay of a board is known.
const FRAMES: u32 = 16;
/// Standard deviation of a frame that a tare of a stock board finds, counts.
const NOMINAL_DEVIATION_COUNTS: f64 = 0.757;
/// The worst delay of at least this long counts, ns: 20 frames of a stock board.
const WINDOW_NS: u64 = 500_000_000;

/// Protection in one tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Protected {
    /// For the controller.
    pub guard: BaseGuard<TAXELS>,
    /// Speed limit in force.
    pub speed_limit: SpeedLimit,
    /// Reaction in force.
    pub reaction: Option<ContactReaction>,
    /// Contact events.
    pub events: heapless::Vec<ContactEvent, MAX_CONTACT_EVENTS>,
}

impl Default for Protected {
    /// Nothing is known: the base stands.
    fn default() -> Self {
        Self {
            guard: BaseGuard { speed_m_s: Some(0.0), ..BaseGuard::NONE },
            speed_limit: SpeedLimit::default(),
            reaction: None,
            events: heapless::Vec::new(),
        }
    }
}

/// Speed limit, contacts and reactions from tick to tick.
#[derive(Debug)]
pub struct Protection {
    settings: ProtectionConfig,
    /// The contact whose delay is measured.
    contact: Contact,
    /// Ways that a base under a contact barrier has to stop in, m: on a seam, and in the middle of a taxel.
    barrier_travel_m: Option<[f64; 2]>,
    /// The limit by a measured or assumed stopping distance, where there is one, and its last answer: for these frames, in the
    /// middle of a taxel and on a seam.
    approach: Option<Approach>,
    answer: Option<(Frames, [f64; 2])>,
    /// Deceleration of the base's servo, m/s².
    base_acceleration_m_s2: f64,
    /// Lateness of the base beyond its stopping distance, s.
    late_s: f64,
    tick_s: f64,
    outline: CoverOutline<TAXELS, f64>,
    state: ProtectionState,
}

/// Memory of the protection between ticks.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ProtectionState {
    delay: ReadingDelay,
    tracker: ContactTracker,
    /// Way that the running retreat has been ordered to go, m.
    retreated_m: f64,
    last_ns: u64,
}

impl Protection {
    /// As configured and checked, with `limits` from the user's file.
    ///
    /// # Errors
    /// A taxel's place out of range.
    pub fn new(config: &Config, limits: [ContactLimits; TAXELS]) -> Result<Self, ParameterError> {
        let settings = config.protection.clone();
        let outline = CoverOutline::new(&config.robot.cover.placements())?;
        let sharing = if config.robot.cover.count() > 1 { 2 } else { 1 };
        Ok(Self {
            contact: Contact {
                stiffness_n_m: settings.contact_stiffness_n_m,
                damping_n_s_m: 0.0,
                delay_s: 0.0,
                servo_s: config.robot.base.servo_time_constant_s,
            },
            barrier_travel_m: barrier::travel_m(config, sharing)
                .zip(barrier::travel_m(config, 1))
                .map(<[f64; 2]>::from),
            approach: Approach::of(config),
            answer: None,
            base_acceleration_m_s2: config.robot.base.acceleration_max_m_s2,
            late_s: 0.0,
            tick_s: 1.0 / f64::from(config.control_loop.rate_hz.max(1)),
            outline,
            state: ProtectionState {
                delay: ReadingDelay::default(),
                tracker: ContactTracker::new(config.robot.cover.count(), limits, settings.reaction),
                retreated_m: 0.0,
                last_ns: 0,
            },
            settings,
        })
    }

    /// Returns its memory.
    pub const fn state(&self) -> &ProtectionState {
        &self.state
    }

    /// Goes on from where `state` was taken.
    pub fn restore(&mut self, state: &ProtectionState) {
        self.state.clone_from(state);
    }

    /// The tick at `now_ns`; `moving` if a law moves the robot in it, within `limits`. Everything in `protected` is of this
    /// tick then. Returns true if any taxel is in contact.
    pub fn update(
        &mut self,
        now_ns: u64,
        cover: &CoverState,
        limits: &Limits<JOINTS>,
        moving: bool,
        protected: &mut Protected,
    ) -> bool {
        let dt_s = seconds(now_ns.saturating_sub(self.state.last_ns)).min(10.0 * self.tick_s);
        self.state.last_ns = now_ns;
        let felt = self.state.tracker.update(now_ns, &cover.poll.reading.taxels);
        let limit = self.speed_limit(now_ns, cover, felt, limits);
        let Protected { guard, speed_limit, reaction, events } = &mut *protected;
        (*speed_limit, *reaction) = (limit, None);
        let BaseGuard { speed_m_s, blocked, outward_m_s, one_body, bounds_body, room_body, instead_body } =
            guard;
        *speed_m_s = Some(limit.m_s);
        // Data that is not confirmed yet only keeps the base from driving into whoever it feels; no law uses it.
        *blocked = cover.poll.early.touched;
        (*outward_m_s, *one_body, *bounds_body, *room_body, *instead_body) = (None, false, None, None, None);
        self.state.tracker.take(events);
        let crossed = if felt && moving { self.state.tracker.crossed() } else { None };
        match crossed {
            Some(crossed) => self.react(&crossed, dt_s, protected),
            None => self.state.retreated_m = 0.0,
        }
        felt
    }

    /// Takes in how much later the base is than its stopping distance says, s: as if each reading were so much older.
    pub const fn set_late(&mut self, late_s: f64) {
        self.late_s = late_s;
    }

    /// Hears what the contact barrier could not keep at `now_ns`.
    pub fn squeezed(&mut self, now_ns: u64, rows: &[ContactRow]) {
        self.state.tracker.squeezed(now_ns, rows);
    }

    /// Speed of the fastest point of the cover at the base's measured velocity, axes of B, m/s.
    pub fn cover_speed_m_s(&self, velocity_body: &[f64; 3]) -> f64 {
        self.outline.fastest(velocity_body)
    }

    /// Speed limit for a reading that is `delay_s` late, m/s: F/(k(T + τ)) for the part F of the force limit that the
    /// cover feels, and slow enough to stop within what cover and body yield meanwhile. Under a contact barrier, whose
    /// loop does not go through k, only the latter, and of the foam alone: the body may be rigid. Whoever is met next may
    /// stand before a seam; while somebody is `felt`, the base has to be able to give way, as fast as a middle allows.
    fn speed_m_s(&self, delay_s: f64, felt: bool, limits: &Limits<JOINTS>) -> f64 {
        let contact = Contact { delay_s, ..self.contact };
        let felt_n = self.settings.force_limit_n - self.settings.threshold_force_n;
        let deceleration =
            limits.base_acceleration[0].min(limits.base_acceleration[1]).min(self.base_acceleration_m_s2);
        if let Some([seam_m, middle_m]) = self.barrier_travel_m {
            let travel_m = if felt { middle_m } else { seam_m };
            return speed_for_stopping(travel_m, deceleration, &contact).unwrap_or(0.0);
        }
        // out of range is a delay of more than 10 s
        largest_speed(felt_n, self.settings.contact_travel_m, deceleration, &contact).unwrap_or(0.0)
    }

    /// Speed limit for frames as they came, m/s; the base has to be able to give way to who is `felt`.
    fn approach_m_s(&mut self, frames: Frames, felt: bool) -> Option<f64> {
        let approach = self.approach.as_ref()?;
        let speeds = match self.answer {
            Some((known, speeds)) if known == frames => speeds,
            _ => [false, true].map(|seam| approach.speed_m_s(&frames, seam)),
        };
        self.answer = Some((frames, speeds));
        Some(if felt || self.outline.map().taxels() < 2 { speeds[0] } else { speeds[1] })
    }

    fn speed_limit(
        &mut self,
        now_ns: u64,
        cover: &CoverState,
        felt: bool,
        limits: &Limits<JOINTS>,
    ) -> SpeedLimit {
        let sampled_at_ns = cover.poll.early.sampled_at_ns;
        self.state.delay.update(now_ns, sampled_at_ns);
        let own_m_s = self.settings.override_speed_limit_m_s;
        if own_m_s > 0.0 {
            return SpeedLimit { m_s: own_m_s, reason: SpeedLimitReason::Overridden };
        }
        let Some(explained_s) = self.state.delay.worst_s(self.tick_s) else { return SpeedLimit::default() };
        let age_s = sampled_at_ns.map_or(f64::INFINITY, |t| seconds(now_ns.saturating_sub(t)));
        let longer_s = (age_s - explained_s - self.tick_s).max(0.0) + self.late_s;
        let frames = Frames {
            period_s: self.state.delay.period_s(),
            age_s: self.state.delay.arrival_s() + self.tick_s + longer_s,
            deviation_counts: cover.deviation_counts,
        };
        let m_s = self
            .approach_m_s(frames, felt)
            .unwrap_or_else(|| self.speed_m_s(explained_s.max(age_s) + self.late_s, felt, limits));
        let configured_m_s = self.outline.fastest(&limits.base_velocity);
        if age_s > explained_s + self.tick_s {
            SpeedLimit { m_s: m_s.min(configured_m_s), reason: SpeedLimitReason::Stale }
        } else if m_s < configured_m_s {
            let reason =
                if self.late_s > 0.0 { SpeedLimitReason::BaseLate } else { SpeedLimitReason::BoardRate };
            SpeedLimit { m_s, reason }
        } else {
            SpeedLimit { m_s: configured_m_s, reason: SpeedLimitReason::Configured }
        }
    }

    fn react(&mut self, crossed: &[bool; TAXELS], dt_s: f64, protected: &mut Protected) {
        protected.reaction = Some(self.settings.reaction);
        match self.settings.reaction {
            ContactReaction::Slow => {
                if self.settings.slow_m_s < protected.speed_limit.m_s {
                    protected.speed_limit =
                        SpeedLimit { m_s: self.settings.slow_m_s, reason: SpeedLimitReason::Contact };
                    protected.guard.speed_m_s = Some(self.settings.slow_m_s);
                }
            }
            ContactReaction::StopDirection => block(&mut protected.guard, crossed),
            ContactReaction::Retreat => {
                // away from the one, but not into another who touches as well
                block(&mut protected.guard, &self.state.tracker.touched());
                if self.state.retreated_m < self.settings.retreat_m {
                    let speed_m_s = self.settings.retreat_m_s.min(protected.speed_limit.m_s);
                    protected.guard.instead_body = Some(self.outline.away_from(crossed, speed_m_s));
                    self.state.retreated_m += speed_m_s * dt_s;
                }
            }
        }
    }
}

fn block(guard: &mut BaseGuard<TAXELS>, taxels: &[bool; TAXELS]) {
    for (blocked, taxel) in guard.blocked.iter_mut().zip(taxels) {
        *blocked |= taxel;
    }
}

/// Oldest age of a reading, just before the next one replaces it: its age on arrival and the interval to the next together,
/// measured frame by frame. Frames that show the same refresh of the chip have one sample time and count once.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct ReadingDelay {
    sampled_at_ns: Option<u64>,
    frames: u32,
    /// Worst of the running window and of the one before, s: that age, the time between two samples, and the age on arrival.
    worst_s: [f64; 2],
    period_s: [f64; 2],
    arrival_s: [f64; 2],
    window_since_ns: u64,
}

impl ReadingDelay {
    fn update(&mut self, now_ns: u64, sampled_at_ns: Option<u64>) {
        if sampled_at_ns == self.sampled_at_ns {
            return;
        }
        let last = std::mem::replace(&mut self.sampled_at_ns, sampled_at_ns);
        let same_board = last.zip(sampled_at_ns).filter(|(l, s)| s.saturating_sub(*l) <= SILENT_AFTER_NS);
        let Some((last_ns, sampled_ns)) = same_board else {
            // none, another board, or the same after a pause: measure anew
            *self = Self { sampled_at_ns, window_since_ns: now_ns, ..Self::default() };
            return;
        };
        if now_ns.saturating_sub(self.window_since_ns) > WINDOW_NS {
            self.window_since_ns = now_ns;
            for worst_s in [&mut self.worst_s, &mut self.period_s, &mut self.arrival_s] {
                *worst_s = [0.0, worst_s[0]];
            }
        }
        self.worst_s[0] = self.worst_s[0].max(seconds(now_ns.saturating_sub(last_ns)));
        self.period_s[0] = self.period_s[0].max(seconds(sampled_ns.saturating_sub(last_ns)));
        self.arrival_s[0] = self.arrival_s[0].max(seconds(now_ns.saturating_sub(sampled_ns)));
        self.frames = self.frames.saturating_add(1);
    }

    /// Longest time between two samples in the last frames, s.
    const fn period_s(&self) -> f64 {
        self.period_s[0].max(self.period_s[1])
    }

    /// Largest age on arrival in the last frames, s.
    const fn arrival_s(&self) -> f64 {
        self.arrival_s[0].max(self.arrival_s[1])
    }

    /// Delay of a reading in the worst of the last frames, s: the age that it had one tick before the next came. `None`
    /// before there were enough.
    fn worst_s(&self, tick_s: f64) -> Option<f64> {
        (self.frames >= FRAMES).then(|| (self.worst_s[0].max(self.worst_s[1]) - tick_s).max(0.0))
    }
}

/// Returns the text for the user at the start.
pub fn introduction(config: &Config) -> String {
    let p = &config.protection;
    if p.override_speed_limit_m_s > 0.0 {
        return format!(
            "SPEED LIMIT OVERRIDDEN: {} m/s whatever the board's rate; stated: {}",
            p.override_speed_limit_m_s, p.override_statement
        );
    }
    format!(
        "cover no faster than {} N in an impact allow for the board's measured rate and age: {}; contact limits {}{}",
        p.force_limit_n,
        Firmware::ALL
            .into_iter()
            .filter(|firmware| *firmware != Firmware::PiCap)
            .map(|firmware| format!("{} {:.3} m/s", firmware.name(), nominal_speed_m_s(config, firmware)))
            .collect::<Vec<_>>()
            .join(", "),
        if p.thresholds.is_empty() { "none" } else { &p.thresholds },
        stopping_said(config)
    )
}

/// Returns the source of the stopping distance, where the speed limit follows from one.
fn stopping_said(config: &Config) -> String {
    if Approach::of(config).is_none() {
        return String::new();
    }
    if !config.protection.stopping_speed_m_s.is_empty() {
        return format!("; stopping distance measured: {}", config.protection.stopping_measured);
    }
    if Stopping::of(config) == Some(WORST_CREDIBLE) {
        return "; stopping distance NOT MEASURED: the base is taken for one that is 100 ms late, lags by 100 ms and brakes at 1 m/s²"
            .into();
    }
    "; stopping distance as configured".into()
}

/// Speed limit of the cover's fastest point, while nobody is felt, for a board with this firmware by its timing, m/s.
pub fn nominal_speed_m_s(config: &Config, firmware: Firmware) -> f64 {
    let tick_s = 1.0 / f64::from(config.control_loop.rate_hz.max(1));
    if let Some(approach) = Approach::of(config) {
        let period_ns = firmware.frame_period_ns();
        let frames = Frames {
            period_s: seconds(period_ns),
            age_s: seconds(firmware.worst_hold_ns() - period_ns) + tick_s,
            deviation_counts: NOMINAL_DEVIATION_COUNTS,
        };
        return approach.speed_m_s(&frames, config.robot.cover.count() > 1);
    }
    speed_for_delay_m_s(config, config.protection.force_limit_n, seconds(firmware.worst_hold_ns()) - tick_s)
}

/// Speed limit of the cover's fastest point, while nobody is felt, for a reading that is `delay_s` late and an impact of
/// `force_limit_n`, m/s.
pub fn speed_for_delay_m_s(config: &Config, force_limit_n: f64, delay_s: f64) -> f64 {
    let mut config = config.clone();
    config.protection.force_limit_n = force_limit_n;
    // taxels without a finite place: nothing may move
    let Ok(protection) = Protection::new(&config, [ContactLimits::default(); TAXELS]) else { return 0.0 };
    let limits = config.parameters().limits;
    protection.speed_m_s(delay_s, false, &limits).min(protection.outline.fastest(&limits.base_velocity))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::BarrierReadings;
    use crate::robot::{FoamKind, PlantKind};
    use moca_msgs::RobotState;
    use moca_msgs::protection::ContactPhase;

    const MS: u64 = 1_000_000;
    /// On the left side.
    const LEFT: usize = 2;
    /// In front.
    const FRONT: usize = 5;
    const NO_LIMITS: [ContactLimits; TAXELS] =
        [ContactLimits { transient_n: None, quasi_static_n: None }; TAXELS];

    /// A protection, and the loop round it: a tick a millisecond, a frame every 25 ms that is 10 ms old when it comes.
    struct Loop {
        protection: Protection,
        limits: Limits<JOINTS>,
        cover: CoverState,
        ms: u64,
    }

    impl Loop {
        fn new(config: &Config, limits: [ContactLimits; TAXELS]) -> Self {
            let protection = Protection::new(config, limits).unwrap();
            Self { protection, limits: config.parameters().limits, cover: CoverState::NONE, ms: 0 }
        }

        /// On until the frame that was sampled at `frame` times 25 ms has come.
        fn until_frame(&mut self, frame: u64) -> Protected {
            while self.ms + 1 < 25 * frame + 10 {
                self.tick(true);
            }
            self.tick(true)
        }

        fn tick(&mut self, moving: bool) -> Protected {
            self.ms += 1;
            self.cover.poll.early.sampled_at_ns = self.ms.checked_sub(10).map(|seen| seen / 25 * 25 * MS);
            self.silent_tick(moving)
        }

        /// One in which nothing new has come.
        fn silent_tick(&mut self, moving: bool) -> Protected {
            let mut protected = Protected::default();
            self.protection.update(self.ms * MS, &self.cover, &self.limits, moving, &mut protected);
            protected
        }

        fn press(&mut self, taxel: usize, force_n: f64) {
            self.cover.poll.reading.taxels[taxel].force_n = force_n;
        }
    }

    /// A reaction at 10 N on any taxel, at a speed that no board's rate decides.
    fn reacting(reaction: ContactReaction, change: impl Fn(&mut ProtectionConfig)) -> Loop {
        let mut config = Config::default();
        config.protection.reaction = reaction;
        config.protection.override_speed_limit_m_s = 0.4;
        change(&mut config.protection);
        Loop::new(&config, [ContactLimits { transient_n: Some(10.0), quasi_static_n: Some(10.0) }; TAXELS])
    }

    fn taxels(which: &[usize]) -> [bool; TAXELS] {
        std::array::from_fn(|i| which.contains(&i))
    }

    #[test]
    fn speed_limit_follows_from_delay_and_force_limit() {
        let mut config = Config::default();
        config.protection.contact_travel_m = 0.1; // stopping is no matter
        let servo_s = config.robot.base.servo_time_constant_s;
        for (force_limit_n, felt_n) in [(25.0, 19.8), (65.0, 59.8)] {
            for delay_s in [0.05, 0.2] {
                let speed_m_s = speed_for_delay_m_s(&config, force_limit_n, delay_s);
                let pressed_n = 7783.0 * speed_m_s * (delay_s + servo_s);
                assert!((pressed_n - felt_n).abs() < 1e-9, "{pressed_n} N of {felt_n} N after {delay_s} s");
            }
        }
    }

    #[test]
    fn barrier_limit_is_lower_before_seam_than_in_contact() {
        let mut config = Config::default();
        config.protection.contact_barrier = BarrierReadings::Foam;
        let mut run = Loop::new(&config, NO_LIMITS);
        let contact = Contact { delay_s: 0.034, ..run.protection.contact };
        let for_travel = |sharing| {
            let travel_m = barrier::travel_m(&config, sharing).unwrap();
            speed_for_stopping(travel_m, config.robot.base.acceleration_max_m_s2, &contact).unwrap()
        };
        let near = |limit: SpeedLimit, m_s: f64| (limit.m_s - m_s).abs() < 1e-12;
        let free = run.until_frame(16).speed_limit;
        assert!(near(free, for_travel(2)) && free.m_s < 0.9 * for_travel(1), "{free:?}");
        assert!(near(free, speed_for_delay_m_s(&config, 25.0, 0.034)));
        assert!(
            speed_for_delay_m_s(&config, 65.0, 0.034) > 1.2 * free.m_s,
            "a barrier has its own way for each force"
        );
        run.press(LEFT, 0.1);
        let felt = run.tick(true).speed_limit;
        assert!(near(felt, for_travel(1)), "{felt:?}");
        run.press(LEFT, 0.0);
        assert!(near(run.tick(true).speed_limit, for_travel(2)));

        let mut one_taxel = config.clone();
        one_taxel.robot.cover.x_m.truncate(1);
        let mut alone = Loop::new(&one_taxel, NO_LIMITS);
        assert!(near(alone.until_frame(16).speed_limit, for_travel(1)), "one taxel has no seam");
    }

    #[test]
    fn speed_limit_is_zero_until_board_is_known() {
        let config = Config::default();
        let for_delay = |delay_s| speed_for_delay_m_s(&config, config.protection.force_limit_n, delay_s);
        let near = |limit: SpeedLimit, delay_s: f64| (limit.m_s - for_delay(delay_s)).abs() < 1e-12;
        let mut run = Loop::new(&config, NO_LIMITS);
        let unknown = run.until_frame(15);
        assert_eq!((unknown.speed_limit, unknown.guard.speed_m_s), (SpeedLimit::default(), Some(0.0)));
        // Sampled 25 ms apart and 10 ms old when they come: one is 34 ms old in the tick before the next.
        let known = run.until_frame(16);
        assert_eq!(known.speed_limit.reason, SpeedLimitReason::BoardRate);
        assert_eq!(known.guard.speed_m_s, Some(known.speed_limit.m_s));
        assert!(near(known.speed_limit, 0.034), "{known:?}");
        // The next one does not come.
        for _ in 0..26 {
            run.ms += 1;
            let late = run.silent_tick(true).speed_limit;
            let age_ms = run.ms - 400;
            let reason = if age_ms > 35 { SpeedLimitReason::Stale } else { SpeedLimitReason::BoardRate };
            #[expect(clippy::cast_precision_loss, reason = "some ms")]
            let delay_s = 1e-3 * age_ms.max(34) as f64;
            assert_eq!(late.reason, reason, "{age_ms} ms");
            assert!(near(late, delay_s), "{age_ms} ms: {late:?}");
        }
        // After a silence nothing is known of the board that comes.
        run.ms += seconds_in_ms(SILENT_AFTER_NS) + 25;
        assert_eq!(run.tick(true).speed_limit, SpeedLimit::default());

        let mut run = Loop::new(&config, NO_LIMITS);
        run.limits.base_velocity = [0.003, 0.004, 0.0];
        let limit = run.until_frame(16).speed_limit;
        assert_eq!(limit.reason, SpeedLimitReason::Configured);
        assert!((limit.m_s - 0.005).abs() < 1e-12, "{limit:?}");

        let mut own = config.clone();
        own.protection.override_speed_limit_m_s = 0.4;
        let overridden = SpeedLimit { m_s: 0.4, reason: SpeedLimitReason::Overridden };
        assert_eq!(Loop::new(&own, NO_LIMITS).tick(true).speed_limit, overridden);
    }

    #[test]
    fn late_base_takes_its_lateness_off_the_speed_limit() {
        let mut config = Config::default();
        let mut run = Loop::new(&config, NO_LIMITS);
        run.until_frame(16);
        run.protection.set_late(0.02);
        let limit = run.tick(true).speed_limit;
        assert_eq!(limit.reason, SpeedLimitReason::BaseLate);
        let expected = speed_for_delay_m_s(&config, config.protection.force_limit_n, 0.034 + 0.02);
        assert!((limit.m_s - expected).abs() < 1e-12, "{limit:?}");

        config.robot.cover.foam = FoamKind::Hyperbolic;
        config.protection.contact_barrier = BarrierReadings::Foam;
        config.protection.order_delay_ms = 50.0;
        let approach = Approach::of(&config).unwrap();
        let mut run = Loop::new(&config, NO_LIMITS);
        run.cover.deviation_counts = 0.684;
        // of a frame that is 10 ms old when it comes, with a tick of 1 ms
        let near = |limit: SpeedLimit, more_s: f64| {
            let frames = Frames { period_s: 0.025, age_s: 0.011 + more_s, deviation_counts: 0.684 };
            (limit.m_s - approach.speed_m_s(&frames, true)).abs() < 1e-9
        };
        let known = run.until_frame(16).speed_limit;
        assert!(known.reason == SpeedLimitReason::BoardRate && near(known, 0.0), "{known:?}");
        run.protection.set_late(0.02);
        let late = run.tick(true).speed_limit;
        assert!(late.reason == SpeedLimitReason::BaseLate && near(late, 0.02), "{late:?}");
        // the next frame does not come: a reading may be 34 ms old, and a tick more
        run.ms = 400 + 45;
        let stale = run.silent_tick(true).speed_limit;
        assert!(stale.reason == SpeedLimitReason::Stale && near(stale, 0.02 + 0.010), "{stale:?}");
    }

    const fn seconds_in_ms(ns: u64) -> u64 {
        ns / MS
    }

    #[test]
    fn late_frame_slows_base_for_half_to_one_second() {
        let mut delay = ReadingDelay::default();
        let mut now_ms = 10_000;
        let mut frame = |delay: &mut ReadingDelay, after_ms: u64| {
            now_ms += after_ms;
            delay.update(now_ms * MS, Some(now_ms * MS));
            (delay.worst_s(0.0).unwrap_or(0.0) * 1e3).round()
        };
        (0..30).for_each(|_| assert!(frame(&mut delay, 7) <= 7.0));
        assert!((frame(&mut delay, 60) - 60.0).abs() < 1e-9);
        (1..72).for_each(|i| assert!((frame(&mut delay, 7) - 60.0).abs() < 1e-9, "{} ms after", 7 * i));
        let after = (0..75).map(|_| frame(&mut delay, 7)).last();
        assert_eq!(after, Some(7.0), "more than a second after");
    }

    #[test]
    fn crossed_limit_stops_directions_of_all_contacts() {
        let mut run = reacting(ContactReaction::StopDirection, |_| {});
        run.cover.poll.early.touched[FRONT] = true;
        run.press(LEFT, 10.0);
        let below = run.tick(true);
        assert_eq!((below.reaction, below.guard.blocked), (None, taxels(&[FRONT])));
        run.press(LEFT, 10.1);
        let standing = run.tick(false);
        assert_eq!((standing.reaction, standing.guard.blocked), (None, taxels(&[FRONT])), "nothing moves");
        let crossed = run.tick(true);
        assert_eq!(crossed.reaction, Some(ContactReaction::StopDirection));
        assert_eq!((crossed.guard.blocked, crossed.guard.instead_body), (taxels(&[LEFT, FRONT]), None));
        // what the barrier cannot keep is among the next tick's events
        run.protection
            .squeezed(run.ms * MS, &[ContactRow { taxel: 2, excess_m_s: 0.3, ..ContactRow::default() }]);
        let events = run.tick(true).events;
        assert!(events.iter().any(|event| event.phase == ContactPhase::NoRoom), "{events:?}");
    }

    #[test]
    fn slow_is_the_slower_of_both() {
        let slowed = |own_m_s: f64| {
            let mut run = reacting(ContactReaction::Slow, |p| p.override_speed_limit_m_s = own_m_s);
            run.press(LEFT, 20.0);
            let protected = run.tick(true);
            assert_eq!(protected.guard.speed_m_s, Some(protected.speed_limit.m_s));
            assert_eq!(protected.reaction, Some(ContactReaction::Slow));
            protected.speed_limit
        };
        assert_eq!(slowed(0.4), SpeedLimit { m_s: 0.01, reason: SpeedLimitReason::Contact });
        assert_eq!(slowed(0.005), SpeedLimit { m_s: 0.005, reason: SpeedLimitReason::Overridden });
    }

    #[test]
    fn retreat_goes_stated_distance_and_into_nobody() {
        let mut run = reacting(ContactReaction::Retreat, |p| p.retreat_m = 0.02);
        run.tick(true);
        for _ in 0..2 {
            run.press(LEFT, 20.0);
            run.press(FRONT, 5.0);
            let mut way_m = 0.0;
            for tick in 0..1000 {
                let protected = run.tick(true);
                assert_eq!(protected.guard.blocked, taxels(&[LEFT, FRONT]));
                let Some([x, y, yaw]) = protected.guard.instead_body else { continue };
                assert!(x.abs() < 1e-12 && (y + 0.05).abs() < 1e-12 && yaw.abs() < 1e-12, "to the right");
                way_m -= y * 1e-3;
                // a tick that comes late is not way that was gone
                run.ms += if tick == 100 { 2000 } else { 0 };
            }
            // the late one counts as ten
            assert!((way_m - 0.02 + 9.0 * 5e-5).abs() < 1.01 * 5e-5, "{way_m} m");
            run.press(LEFT, 0.0);
            run.tick(true);
        }
        let mut run = reacting(ContactReaction::Retreat, |p| p.retreat_m = 0.0);
        run.press(LEFT, 20.0);
        assert_eq!(run.tick(true).guard.instead_body, None, "no way is none");
    }

    #[test]
    fn who_goes_on_from_a_state_protects_as_before() {
        let config = Config::default();
        let mut run = Loop::new(&config, NO_LIMITS);
        run.until_frame(20);
        let mut other = Loop { ms: run.ms, cover: run.cover, ..Loop::new(&config, NO_LIMITS) };
        other.protection.restore(run.protection.state());
        let next = run.tick(true);
        assert_eq!(next.speed_limit.reason, SpeedLimitReason::BoardRate);
        assert_eq!(other.tick(true), next);
    }

    #[test]
    fn the_start_says_what_each_board_allows_and_shouts_an_override() {
        let mut config = Config::default();
        let said = introduction(&config);
        for firmware in [Firmware::Moca, Firmware::Stock2018, Firmware::Stock2015] {
            let delay_s = seconds(firmware.worst_hold_ns()) - 1e-3;
            let speed_m_s = speed_for_delay_m_s(&config, 25.0, delay_s);
            let line = format!("{} {speed_m_s:.3} m/s", firmware.name());
            assert!(speed_m_s > 0.02 && said.contains(&line), "{line} | {said}");
        }
        assert!(!said.contains("stopping distance"), "{said}");
        config.protection.contact_barrier = BarrierReadings::PuLd30;
        config.plant.kind = PlantKind::Robot;
        let said = introduction(&config);
        assert!(said.contains("stopping distance NOT MEASURED"), "{said}");
        config.protection.override_speed_limit_m_s = 0.4;
        assert!(introduction(&config).starts_with("SPEED LIMIT OVERRIDDEN: 0.4 m/s"));
    }

    #[test]
    fn cover_speed_is_that_of_fastest_corner_at_any_yaw() {
        let protection = Protection::new(&Config::default(), [ContactLimits::default(); TAXELS]).unwrap();
        let corner_m = 0.489f64.hypot(0.388);
        for (velocity_world, yaw_rad, expected) in [
            ([0.3, 0.4, 0.0], 0.7, 0.5),
            ([0.0, 0.0, -1.0], 2.0, corner_m),
            // Along its own x axis: the corners of its right side add the whole turn.
            ([0.0, 1.0, 1.0], std::f64::consts::FRAC_PI_2, 1.388f64.hypot(0.489)),
        ] {
            let robot = RobotState {
                base_pose_world: [0.0, 0.0, yaw_rad],
                base_velocity_world: velocity_world,
                ..RobotState::at_rest([0.0; JOINTS])
            };
            let speed_m_s = protection.cover_speed_m_s(&barrier::BaseMotion::of(&robot).velocity_body);
            assert!((speed_m_s - expected).abs() < 1e-9, "{velocity_world:?}: {speed_m_s}");
        }
    }
}

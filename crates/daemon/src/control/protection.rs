//! Protection of the people around the base: how fast it may go for the board it has, and what it does when a contact
//! crosses a limit of the user's. Pure but for the file of limits ([`crate::config::contact_limits`]); no allocation in a tick.
//!
//! v = (F_max − F_threshold)/(k(T + τ)): a reading that is T late lets a base of servo lag τ press v(T + τ) further than the
//! controller knows, against the stiffness k of cover and body; what the cover does not feel comes on top. It bounds the
//! impact, not what a law goes on pushing with: that is the contact limits' part.
//!
//! The limit holds for the fastest point of the cover, a corner once the base turns: whoever is touched is touched
//! there. The arm and what it carries are not covered by it.

use crate::config::contact_limits::ContactLimits;
use crate::config::{Config, ProtectionConfig};
use crate::control::barrier;
use crate::control::contacts::ContactTracker;
use crate::control::cover::CoverState;
use crate::robot::{JOINTS, TAXELS};
use moca_msgs::protection::MAX_CONTACT_EVENTS;
use moca_msgs::{
    ContactEvent, ContactReaction, ContactRow, Limits, ParameterError, RobotState, SpeedLimit,
    SpeedLimitReason, seconds,
};
use moca_tactile::Firmware;
use moca_tactile::board::SILENT_AFTER_NS;
use moca_wbc::BaseGuard;
use moca_wbc::contact_stability::{Contact, largest_speed, speed_for_stopping};
use moca_wbc::guard::CoverOutline;
use serde::{Deserialize, Serialize};

/// Frames before the delay of a board is known.
const FRAMES: u32 = 16;
/// The worst delay of at least this long counts, ns: 20 frames of a stock board.
const WINDOW_NS: u64 = 500_000_000;

/// What protects in one tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Protected {
    /// For the controller.
    pub guard: BaseGuard<TAXELS>,
    /// Speed limit in force.
    pub speed_limit: SpeedLimit,
    /// Reaction in force.
    pub reaction: Option<ContactReaction>,
    /// What happened to contacts.
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
    /// Way that a base under a contact barrier has to stop in, m.
    barrier_travel_m: Option<f64>,
    /// What the base's servo can brake with, m/s².
    base_acceleration_m_s2: f64,
    tick_s: f64,
    outline: CoverOutline<TAXELS, f64>,
    state: ProtectionState,
}

/// What the protection remembers from tick to tick.
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
        Ok(Self {
            contact: Contact {
                stiffness_n_m: settings.contact_stiffness_n_m,
                damping_n_s_m: 0.0,
                delay_s: 0.0,
                servo_s: config.robot.base.servo_time_constant_s,
            },
            barrier_travel_m: barrier::travel_m(config),
            base_acceleration_m_s2: config.robot.base.acceleration_max_m_s2,
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

    /// What it remembers.
    pub const fn state(&self) -> &ProtectionState {
        &self.state
    }

    /// Goes on from where `state` was taken.
    pub fn restore(&mut self, state: &ProtectionState) {
        self.state.clone_from(state);
    }

    /// The tick at `now_ns`; `moving` if a law moves the robot in it, within `limits`.
    pub fn update(
        &mut self,
        now_ns: u64,
        cover: &CoverState,
        limits: &Limits<JOINTS>,
        moving: bool,
    ) -> Protected {
        let dt_s = seconds(now_ns.saturating_sub(self.state.last_ns)).min(10.0 * self.tick_s);
        self.state.last_ns = now_ns;
        self.state.tracker.update(now_ns, &cover.reading.taxels);
        let speed_limit = self.speed_limit(now_ns, cover.early.sampled_at_ns, limits);
        let mut protected = Protected {
            // Data that is not confirmed yet only keeps the base from driving into whoever it feels; no law uses it.
            guard: BaseGuard {
                speed_m_s: Some(speed_limit.m_s),
                blocked: cover.early.touched,
                ..BaseGuard::NONE
            },
            speed_limit,
            reaction: None,
            events: self.state.tracker.take(),
        };
        match self.state.tracker.crossed().filter(|_| moving) {
            Some(crossed) => self.react(&crossed, dt_s, &mut protected),
            None => self.state.retreated_m = 0.0,
        }
        protected
    }

    /// Hears what the contact barrier could not keep at `now_ns`.
    pub fn squeezed(&mut self, now_ns: u64, rows: &[ContactRow]) {
        self.state.tracker.squeezed(now_ns, rows);
    }

    /// Speed of the fastest point of the cover at the base's measured velocity, m/s.
    pub fn cover_speed_m_s(&self, robot: &RobotState<JOINTS>) -> f64 {
        let [vx, vy, yaw] = robot.base_velocity_world;
        let (sin, cos) = robot.base_pose_world[2].sin_cos();
        self.outline.fastest(&[cos * vx + sin * vy, cos * vy - sin * vx, yaw])
    }

    /// Speed limit for a reading that is `delay_s` late, m/s: F/(k(T + τ)) for the part F of the force limit that the
    /// cover feels, and slow enough to stop within what cover and body yield meanwhile. Under a contact barrier, whose
    /// loop does not go through k, only the latter, and of the foam alone: the body may be rigid.
    fn speed_m_s(&self, delay_s: f64, limits: &Limits<JOINTS>) -> f64 {
        let contact = Contact { delay_s, ..self.contact };
        let felt_n = self.settings.force_limit_n - self.settings.threshold_force_n;
        let deceleration =
            limits.base_acceleration[0].min(limits.base_acceleration[1]).min(self.base_acceleration_m_s2);
        if let Some(travel_m) = self.barrier_travel_m {
            return speed_for_stopping(travel_m, deceleration, &contact).unwrap_or(0.0);
        }
        // out of range is a delay of more than 10 s
        largest_speed(felt_n, self.settings.contact_travel_m, deceleration, &contact).unwrap_or(0.0)
    }

    fn speed_limit(
        &mut self,
        now_ns: u64,
        sampled_at_ns: Option<u64>,
        limits: &Limits<JOINTS>,
    ) -> SpeedLimit {
        self.state.delay.update(now_ns, sampled_at_ns);
        let own_m_s = self.settings.override_speed_limit_m_s;
        if own_m_s > 0.0 {
            return SpeedLimit { m_s: own_m_s, reason: SpeedLimitReason::Overridden };
        }
        let Some(explained_s) = self.state.delay.worst_s(self.tick_s) else { return SpeedLimit::default() };
        let age_s = sampled_at_ns.map_or(f64::INFINITY, |t| seconds(now_ns.saturating_sub(t)));
        let m_s = self.speed_m_s(explained_s.max(age_s), limits);
        let configured_m_s = self.outline.fastest(&limits.base_velocity);
        if age_s > explained_s + self.tick_s {
            SpeedLimit { m_s: m_s.min(configured_m_s), reason: SpeedLimitReason::Stale }
        } else if m_s < configured_m_s {
            SpeedLimit { m_s, reason: SpeedLimitReason::BoardRate }
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

/// How old a reading gets before the next one replaces it: its age when it came and the interval to the next together,
/// measured frame by frame. Frames that show the same refresh of the chip have one sample time and count once.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct ReadingDelay {
    sampled_at_ns: Option<u64>,
    frames: u32,
    /// Worst of the running window and of the one before, s.
    worst_s: [f64; 2],
    window_since_ns: u64,
}

impl ReadingDelay {
    fn update(&mut self, now_ns: u64, sampled_at_ns: Option<u64>) {
        if sampled_at_ns == self.sampled_at_ns {
            return;
        }
        let last = std::mem::replace(&mut self.sampled_at_ns, sampled_at_ns);
        let same_board = last.zip(sampled_at_ns).filter(|(l, s)| s.saturating_sub(*l) <= SILENT_AFTER_NS);
        let Some((last_ns, _)) = same_board else {
            // none, another board, or the same after a pause: measure anew
            *self = Self { sampled_at_ns, window_since_ns: now_ns, ..Self::default() };
            return;
        };
        if now_ns.saturating_sub(self.window_since_ns) > WINDOW_NS {
            self.window_since_ns = now_ns;
            self.worst_s = [0.0, self.worst_s[0]];
        }
        self.worst_s[0] = self.worst_s[0].max(seconds(now_ns.saturating_sub(last_ns)));
        self.frames = self.frames.saturating_add(1);
    }

    /// Delay of a reading in the worst of the last frames, s: the age that it had one tick before the next came. `None`
    /// before there were enough.
    fn worst_s(&self, tick_s: f64) -> Option<f64> {
        (self.frames >= FRAMES).then(|| (self.worst_s[0].max(self.worst_s[1]) - tick_s).max(0.0))
    }
}

/// What a user reads at the start.
pub fn introduction(config: &Config) -> String {
    let p = &config.protection;
    if p.override_speed_limit_m_s > 0.0 {
        return format!(
            "SPEED LIMIT OVERRIDDEN: {} m/s whatever the board's rate; stated: {}",
            p.override_speed_limit_m_s, p.override_statement
        );
    }
    format!(
        "cover no faster than {} N in an impact allow for the board's measured rate and age: {}; contact limits {}",
        p.force_limit_n,
        Firmware::ALL
            .into_iter()
            .filter(|firmware| *firmware != Firmware::PiCap)
            .map(|firmware| format!("{} {:.3} m/s", firmware.name(), nominal_speed_m_s(config, firmware)))
            .collect::<Vec<_>>()
            .join(", "),
        if p.thresholds.is_empty() { "none" } else { &p.thresholds }
    )
}

/// Speed limit for a board with this firmware by its timing, m/s.
fn nominal_speed_m_s(config: &Config, firmware: Firmware) -> f64 {
    let tick_s = 1.0 / f64::from(config.control_loop.rate_hz.max(1));
    speed_for_delay_m_s(config, config.protection.force_limit_n, seconds(firmware.worst_hold_ns()) - tick_s)
}

/// Speed limit of the cover's fastest point for a reading that is `delay_s` late and an impact of `force_limit_n`, m/s.
pub fn speed_for_delay_m_s(config: &Config, force_limit_n: f64, delay_s: f64) -> f64 {
    // taxels without a finite place: nothing may move
    let Ok(mut protection) = Protection::new(config, [ContactLimits::default(); TAXELS]) else { return 0.0 };
    protection.settings.force_limit_n = force_limit_n;
    let limits = config.parameters().limits;
    protection.speed_m_s(delay_s, &limits).min(protection.outline.fastest(&limits.base_velocity))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_of_the_cover_is_that_of_its_fastest_corner_wherever_the_base_looks() {
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
            let speed_m_s = protection.cover_speed_m_s(&robot);
            assert!((speed_m_s - expected).abs() < 1e-9, "{velocity_world:?}: {speed_m_s}");
        }
    }
}

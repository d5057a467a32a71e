//! The contact barrier in the loop: from the cover's readings and their age to what the base may still do.

use crate::config::{BarrierReadings, Config};
use crate::cover::CoverState;
use crate::robot::{CoverTable, FoamKind, JOINTS, TAXELS};
use moca_msgs::protection::MAX_CONTACT_ROWS;
use moca_msgs::robot::resized;
use moca_msgs::{ContactRow, ParameterError, RobotState, TaxelStatus};
use moca_tactile::model::{FoamMemory, TaxelModel};
use moca_wbc::contact_barrier::{
    BarrierInput, BarrierSettings, BarrierState, CURVE_POINTS, ContactBarrier, ContactLimits, FoamCurve,
    STOP_SHARE, TOUCH_N, TaxelSample,
};
use moca_wbc::reach::ArmReach;
use moca_wbc::rotation::Heading;
use moca_wbc::{ArmModel, ControlError, FlangePose};
use serde::{Deserialize, Serialize};

/// The barrier with what a tick tells it piece by piece.
#[derive(Clone, Debug)]
pub struct Barrier {
    contacts: ContactBarrier<TAXELS>,
    samples: [Option<TaxelSample>; TAXELS],
    light: [bool; TAXELS],
    /// Those of them that may be a false alarm.
    doubtful: [bool; TAXELS],
    /// Readings count from the first alarm on, also below the counts at which a contact begins: a late base has no time to wait for
    /// them.
    counts_light: bool,
    haste: Haste,
    /// Deceleration of the base's servo, m/s², m/s², rad/s².
    deceleration: [f64; 3],
    /// Flange from the base in the last tick, axes of B, m.
    flange_body_m: Option<[f64; 2]>,
    rows: heapless::Vec<ContactRow, MAX_CONTACT_ROWS>,
}

/// Room for touches that may be false alarms. Somebody may stand on the other side: the base goes no further back than it may
/// drive in the same time, and [`Self::way_m`] beyond that.
#[derive(Clone, Debug)]
struct Haste {
    /// Fastest that the base may drive, m/s.
    drives_m_s: f64,
    /// Way that the base itself may press a foam, m.
    way_m: f64,
    /// Share of the deceleration that is counted on.
    braking_share: f64,
    /// Way back of each taxel beyond what the base may drive, m.
    gone_m: [f64; TAXELS],
}

impl Haste {
    fn new(settings: &BarrierSettings, plates: f64) -> Self {
        Self {
            drives_m_s: 0.0,
            way_m: settings.foam.depth_m(STOP_SHARE * settings.force_limit_n / plates),
            braking_share: settings.braking_share,
            gone_m: [0.0; TAXELS],
        }
    }

    /// Lets an order back count for `dt_s`, and returns the fastest that a doubtful taxel may make room, m/s. It can still be taken
    /// back within the way that is left, by a base that brakes with `deceleration_m_s2`.
    fn fastest_m_s(&mut self, i: usize, back_m_s: f64, deceleration_m_s2: f64, dt_s: f64) -> f64 {
        let gone_m = &mut self.gone_m[i];
        *gone_m = (*gone_m + (back_m_s - self.drives_m_s) * dt_s).max(0.0);
        let left_m = (self.way_m - *gone_m).max(0.0);
        self.drives_m_s + (2.0 * self.braking_share * deceleration_m_s2 * left_m).sqrt()
    }

    /// Lets `dt_s` pass without a doubtful touch.
    fn forget(&mut self, i: usize, dt_s: f64) {
        let gone_m = &mut self.gone_m[i];
        *gone_m = (*gone_m - self.drives_m_s * dt_s).max(0.0);
    }
}

/// Memory of a [`Barrier`] between ticks.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BarrierMemory {
    contacts: BarrierState<TAXELS>,
    flange_body_m: Option<[f64; 2]>,
    rows: heapless::Vec<ContactRow, MAX_CONTACT_ROWS>,
}

/// Way back of each taxel for touches that were doubtful, beyond what the base may drive, m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DoubtfulWay(#[serde(with = "serde_big_array::BigArray")] [f64; TAXELS]);

impl Barrier {
    /// As configured; `None` where there is none.
    ///
    /// # Errors
    /// A foam, a force limit or a taxel's place out of range.
    pub fn new<const N: usize>(
        config: &Config,
        arm: Option<&ArmModel<N, f64>>,
    ) -> Result<Option<Self>, ParameterError> {
        let Some(mut settings) = settings(config)? else { return Ok(None) };
        let base = &config.robot.base;
        settings.reach = arm.zip(config.arm().table::<N>()).map(|(model, table)| {
            let posture_rad = resized(&config.parameters().gains.posture_rad);
            ArmReach::new(&table, model, &posture_rad, settings.retreat_m_s)
        });
        Ok(Some(Self {
            contacts: ContactBarrier::new(&config.robot.cover.placements(), &settings)?,
            samples: [None; TAXELS],
            light: [false; TAXELS],
            doubtful: [false; TAXELS],
            counts_light: settings.order_delay_s > 0.0,
            haste: Haste::new(&settings, f64::from(config.protection.plates.max(1))),
            deceleration: [
                base.acceleration_max_m_s2,
                base.acceleration_max_m_s2,
                base.yaw_acceleration_max_rad_s2,
            ],
            flange_body_m: None,
            rows: heapless::Vec::new(),
        }))
    }

    /// Returns its memory.
    pub fn state(&self) -> BarrierMemory {
        BarrierMemory {
            contacts: self.contacts.state().clone(),
            flange_body_m: self.flange_body_m,
            rows: self.rows.clone(),
        }
    }

    /// Returns what has been gone back for doubtful touches; `None` for nothing.
    pub fn doubtful_way(&self) -> Option<DoubtfulWay> {
        let gone_m = self.haste.gone_m;
        gone_m.iter().any(|gone_m| *gone_m > 0.0).then_some(DoubtfulWay(gone_m))
    }

    /// Goes on from where `state` and `way` were taken.
    pub fn restore(&mut self, state: &BarrierMemory, way: Option<&DoubtfulWay>) {
        self.contacts.restore(&state.contacts);
        self.haste.gone_m = way.map_or([0.0; TAXELS], |way| way.0);
        self.flange_body_m = state.flange_body_m;
        self.rows.clone_from(&state.rows);
    }

    /// Takes in what the cover says in the tick at `now_ns`, in which the speed limit is `limit_m_s`.
    pub fn take_cover(&mut self, now_ns: u64, cover: &CoverState, limit_m_s: f64) {
        self.haste.drives_m_s = limit_m_s;
        let early = &cover.poll.early;
        self.light = early.light;
        self.doubtful = std::array::from_fn(|i| self.counts_light && early.light[i] && !early.certain[i]);
        if self.counts_light {
            self.pair_up(cover);
        }
        let age_s = cover.poll.reading.age_s(now_ns);
        for (i, (sample, taxel)) in self.samples.iter_mut().zip(&cover.poll.reading.taxels).enumerate() {
            let valid = taxel.status == TaxelStatus::Ok;
            let counts = self.counts_light && self.light[i];
            let force_n = if counts { early.light_n[i].max(TOUCH_N) } else { taxel.force_n };
            *sample = age_s.filter(|_| valid).map(|age_s| TaxelSample { force_n, age_s });
        }
    }

    /// Believes a body of whom a plate shows an alarm and the one beside it half of one: noise does so far less often than it reaches
    /// a certain alarm. A body on a seam so counts on both plates, and the base turns the right way from the first alarm on.
    fn pair_up(&mut self, cover: &CoverState) {
        let early = &cover.poll.early;
        let taxels = self.contacts.outline().map().taxels();
        let is_felt = |i: &usize| early.light[*i] || cover.poll.reading.taxels[*i].force_n > 0.0;
        for i in (0..taxels).filter(is_felt) {
            let shown = (0..taxels).filter(|j| *j != i && (early.light[*j] || early.halfway[*j]));
            for j in shown.filter(|j| self.contacts.is_beside(i, *j)) {
                self.light[j] = true;
                (self.doubtful[i], self.doubtful[j]) = (false, false);
            }
        }
    }

    /// Computes the bounds of the contacts for this tick, the base going at `velocity_body` (m/s, m/s, rad/s); it brakes within `limit`
    /// (m/s², m/s², rad/s²) and its own ability. `holds_place`: the flange stays where it is in the world.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn update(
        &mut self,
        velocity_body: [f64; 3],
        limit: [f64; 3],
        holds_place: bool,
        dt_s: f64,
    ) -> Result<ContactLimits<TAXELS>, ControlError> {
        let deceleration = std::array::from_fn(|i| limit[i].min(self.deceleration[i]));
        let mut input = BarrierInput::new(self.samples, velocity_body, deceleration, dt_s);
        input.light = self.light;
        input.tool_base_m = self.flange_body_m.filter(|_| holds_place);
        let mut limits = self.contacts.update(&input)?;
        if let Some(order) = self.contacts.order_in_force() {
            let outline = self.contacts.outline();
            for (i, (most, doubtful)) in limits.outward_m_s.iter_mut().zip(self.doubtful).enumerate() {
                if doubtful {
                    let (back_m_s, braking) =
                        (-outline.outward(i, order), outline.deceleration(i, &deceleration));
                    *most = most.max(-self.haste.fastest_m_s(i, back_m_s, braking, dt_s));
                } else {
                    self.haste.forget(i, dt_s);
                }
            }
        }
        self.rows.clear();
        let bounded = (0_u8..).zip(limits.outward_m_s).filter(|(_, allowed_m_s)| allowed_m_s.is_finite());
        for (taxel, allowed_m_s) in bounded.take(MAX_CONTACT_ROWS) {
            let i = usize::from(taxel);
            // as many as there is room for
            let _ = self.rows.push(ContactRow {
                taxel,
                depth_m: limits.depth_m[i],
                person_m_s: limits.person_m_s[i],
                allowed_m_s,
                outward_m_s: self.contacts.outline().outward(i, &input.velocity_body),
                excess_m_s: 0.0,
            });
        }
        Ok(limits)
    }

    /// Takes the order to the base, axes of B: m/s, m/s, rad/s. One that is not finite is never carried out.
    pub fn ordered(&mut self, velocity_body: &[f64; 3]) {
        if self.contacts.ordered(velocity_body).is_err() {
            self.contacts.forget_orders();
        }
        for row in &mut self.rows {
            let outward_m_s = self.contacts.outline().outward(usize::from(row.taxel), velocity_body);
            row.excess_m_s = (outward_m_s - row.allowed_m_s).max(0.0);
        }
    }

    /// The base is told to stand: nothing that was ordered before counts.
    pub fn leave(&mut self) {
        self.contacts.forget_orders();
    }

    /// Returns the rows of the last tick, taxel by taxel.
    pub fn rows(&self) -> &heapless::Vec<ContactRow, MAX_CONTACT_ROWS> {
        &self.rows
    }

    /// Stores the flange's pose of this tick.
    pub fn remember(&mut self, flange: &FlangePose, robot: &RobotState<JOINTS>) {
        let [x, y, _] = flange.position_world;
        let [base_x, base_y, _] = robot.base_pose_world;
        self.flange_body_m = Some(to_body([x - base_x, y - base_y], robot));
    }
}

/// From axes of W to those of B.
pub(super) fn to_body([x, y]: [f64; 2], robot: &RobotState<JOINTS>) -> [f64; 2] {
    turned_back(robot.base_pose_world[2].sin_cos(), [x, y])
}

/// From axes of W to those of a base whose yaw has this sine and cosine.
const fn turned_back((sin, cos): (f64, f64), [x, y]: [f64; 2]) -> [f64; 2] {
    [cos * x + sin * y, cos * y - sin * x]
}

/// Measured motion of the base, once a tick for all who ask: a sine is not cheap.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BaseMotion {
    /// Sine and cosine of the yaw.
    pub(super) turn: (f64, f64),
    /// Velocity in axes of B, m/s, m/s, rad/s.
    pub(super) velocity_body: [f64; 3],
}

impl BaseMotion {
    /// Takes it from a state.
    pub(super) fn of(robot: &RobotState<JOINTS>) -> Self {
        let turn = Heading::at(robot.base_pose_world[2]).sin_cos();
        let [vx_world, vy_world, yaw_rate] = robot.base_velocity_world;
        let [vx, vy] = turned_back(turn, [vx_world, vy_world]);
        Self { turn, velocity_body: [vx, vy, yaw_rate] }
    }
}

/// From axes of B to those of W.
pub(super) fn to_world([x, y]: [f64; 2], robot: &RobotState<JOINTS>) -> [f64; 2] {
    let (sin, cos) = robot.base_pose_world[2].sin_cos();
    [cos * x - sin * y, cos * y + sin * x]
}

/// Readings of a PU LD30 that is not calibrated: how close the plates are when [`TaxelModel::PU_LD30`] says a force. What the
/// foam remembers is in that model, and not in the plates' distance, so no law of the foam leads back from one to the other.
fn read_as_pu_ld30() -> FoamCurve {
    let memory = &mut FoamMemory::default();
    let depth_m = READ_AT.map(|counts| {
        let nearer = counts / (IDLE_COUNTS - counts) / SENSITIVITY;
        GAP_M * nearer / (1.0 + nearer)
    });
    FoamCurve::Points {
        depth_m,
        force_n: READ_AT.map(|counts| TaxelModel::PU_LD30.force_n(memory, counts, 0.0)),
    }
}

/// Error of the slope of the depth as read for a foam that is twice as stiff as believed, at the least depth that counts.
const SLOPE_ERROR_MAX: f64 = 0.9;
/// Counts at which it is looked up: where readings matter closer together than the model's knots, between which the plates' distance
/// bends.
const READ_AT: [f64; CURVE_POINTS] = [2.0, 4.0, 6.0, 8.0, 12.0, 17.0, 29.0, 45.0, 68.0, 85.0];
/// Counts of an untouched taxel, its plates' distance, m, and what is not fringe and wire of its capacitance: the paper's
/// Table I, with which [`TaxelModel::PU_LD30`] was fitted.
const IDLE_COUNTS: f64 = 720.0;
pub(crate) const GAP_M: f64 = 0.015;
pub(crate) const SENSITIVITY: f64 = 0.041_71;

/// Readings of a cover that is calibrated, by loading and unloading pooled: those of PU LD30 are like its own. Where hysteresis is
/// compensated for it is taken for up to a third deeper than it is, and by a straight line for a seventh less.
fn read_as(cover: &CoverTable) -> FoamCurve {
    if cover.foam == FoamKind::PuLd30 { read_as_pu_ld30() } else { pressed(cover) }
}

/// Returns the curve of a foam that is pressed for some seconds.
pub const fn pressed(cover: &CoverTable) -> FoamCurve {
    match cover.foam {
        FoamKind::PuLd30 => power(0.0114, 1.586),
        FoamKind::Cc => power(0.0114, 0.774),
        FoamKind::Pe5 => power(0.0030, 1.0),
        FoamKind::Pe3 => power(0.0029, 1.0),
        FoamKind::Hyperbolic => hyperbolic(cover),
    }
}

/// Returns the curve of a foam in an impact, before it relaxes: less compression.
pub const fn struck(cover: &CoverTable) -> FoamCurve {
    match cover.foam {
        FoamKind::PuLd30 => power(0.010_309, 1.586),
        FoamKind::Cc => power(0.007_131, 0.774),
        FoamKind::Pe5 => power(0.002_600, 1.0),
        FoamKind::Pe3 => power(0.002_518, 1.0),
        FoamKind::Hyperbolic => hyperbolic(cover),
    }
}

const fn power(depth_at_100n_m: f64, exponent: f64) -> FoamCurve {
    FoamCurve::Power { depth_at_100n_m, exponent }
}

const fn hyperbolic(cover: &CoverTable) -> FoamCurve {
    FoamCurve::Hyperbolic { stiffness_n_m: cover.foam_stiffness_n_m, thickness_m: cover.foam_thickness_m }
}

/// Returns the curve that forces are read by, and the foam's curve in an impact; `None` without a barrier.
pub fn curves(config: &Config) -> Option<(FoamCurve, FoamCurve)> {
    let cover = &config.robot.cover;
    let calibrated = !config.board.calibration.is_empty();
    let reading = match config.protection.contact_barrier {
        BarrierReadings::Auto => calibrated.then(|| read_as(cover))?,
        BarrierReadings::Off => return None,
        BarrierReadings::Foam => pressed(cover),
        BarrierReadings::PuLd30 => read_as_pu_ld30(),
    };
    Some((reading, struck(cover)))
}

fn settings(config: &Config) -> Result<Option<BarrierSettings>, ParameterError> {
    let servo_s = config.robot.base.servo_time_constant_s;
    let protection = &config.protection;
    let Some((reading, foam)) = curves(config) else { return Ok(None) };
    let limit_n = protection.force_limit_n / protection.foam_scale();
    let settings = BarrierSettings::new(reading, foam, limit_n, servo_s)?.with_late_orders(
        1e-3 * protection.order_delay_ms,
        1e-3 * protection.order_delay_error_ms,
        (protection.foam_scale() - 1.0).min(SLOPE_ERROR_MAX),
    )?;
    let (hidden_n, shared_plates) = (protection.threshold_force_n, protection.plates > 1);
    Ok(Some(BarrierSettings { hidden_n, shared_plates, ..settings }))
}

/// Forces of pushes so slow that the foam follows, at the depth where the base stops pressing and `noise_m` before the
/// one from which on it makes room, N. `None` without a barrier.
///
/// # Errors
/// As for [`Barrier::new`].
pub fn slow_pushes_n(config: &Config, noise_m: f64) -> Result<Option<[f64; 2]>, ParameterError> {
    let slow = pressed(&config.robot.cover);
    Ok(settings(config)?
        .map(|settings| [settings.stop_m, settings.yield_m - noise_m].map(|depth_m| slow.force_n(depth_m))))
}

/// Way that the foam alone yields between what the cover hides and the force limit, m: what a base under a barrier has
/// to stop in before a body whose force `sharing` taxels feel equal parts of, so that each one's threshold hides it. `None`
/// without a barrier.
pub fn travel_m(config: &Config, sharing: u8) -> Option<f64> {
    let p = &config.protection;
    let (reading, foam) = curves(config)?;
    let hidden_n = f64::from(sharing) * foam.force_n(reading.depth_m(p.threshold_force_n));
    Some((foam.depth_m(p.force_limit_n) - foam.depth_m(hidden_n)).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_tactile::cover::EarlyContact;

    #[test]
    fn barrier_default_is_on_for_calibrated_cover() {
        let barrier = |calibration: &str, readings: Option<&str>| {
            let mut config = Config::default();
            config.board.calibration = calibration.into();
            if let Some(readings) = readings {
                config.set("protection.contact_barrier", &readings.into()).unwrap();
            }
            let barrier = Barrier::new::<7>(&config, None).unwrap();
            assert_eq!(
                barrier.is_some(),
                travel_m(&config, 2).is_some(),
                "and the speed limit that goes with it"
            );
            barrier.is_some()
        };
        assert!(barrier("cover.toml", None) && !barrier("", None));
        assert!(!barrier("cover.toml", Some("off")));
        for readings in ["foam", "pu-ld30"] {
            assert!(barrier("", Some(readings)), "{readings}");
        }
    }

    /// Compression at which the base itself may press, m.
    fn may_press_m() -> f64 {
        struck(&Config::default().robot.cover).depth_m(0.3165 * 25.0)
    }

    #[test]
    fn false_alarms_move_late_base_by_bounded_way() {
        const FRONT: usize = 5;
        const LIMIT_M_S: f64 = 0.01;
        let mut config = Config::default();
        config.set("protection.contact_barrier", &"pu-ld30".into()).unwrap();
        config.protection.order_delay_ms = 100.0;
        let mut barrier = Barrier::new::<7>(&config, None).unwrap().unwrap();
        let mut cover = CoverState::NONE;
        cover.poll.early.light_n[FRONT] = 3.0;
        let (mut order_m_s, mut back_m, mut beyond_m) = (0.0_f64, 0.0, [0.0; 3]);
        for ms in 0..1500_u64 {
            // two alarms of which none becomes certain, and a time between them
            cover.poll.early.light[FRONT] = !(400..500).contains(&ms);
            cover.poll.reading.sampled_at_ns = Some(ms / 10 * 10_000_000);
            barrier.take_cover(1_000_000 * ms, &cover, LIMIT_M_S);
            if ms == 50 {
                let gone = barrier.doubtful_way();
                let mut restored = Barrier::new::<7>(&config, None).unwrap().unwrap();
                assert!(gone.is_some() && restored.doubtful_way().is_none(), "{gone:?}");
                restored.restore(&barrier.state(), gone.as_ref());
                assert_eq!(restored.doubtful_way(), gone);
            }
            let limits = barrier.update([0.0; 3], [3.0; 3], false, 1e-3).unwrap();
            // as far back as the base is let, within its acceleration
            let wanted_m_s = limits.outward_m_s[FRONT].clamp(-0.3, 0.0);
            order_m_s = wanted_m_s.clamp(order_m_s - 3e-3, order_m_s + 3e-3);
            barrier.ordered(&[order_m_s, 0.0, 0.0]);
            back_m -= 1e-3 * order_m_s;
            #[expect(clippy::cast_precision_loss, reason = "a small count")]
            let gone_m = back_m - 1e-3 * LIMIT_M_S * (ms + 1) as f64;
            for (end_ms, beyond_m) in [50, 400, 1500].into_iter().zip(&mut beyond_m) {
                *beyond_m = if ms < end_ms { gone_m.max(*beyond_m) } else { *beyond_m };
            }
        }
        let [soon_m, first_m, both_m] = beyond_m.map(|beyond_m| beyond_m / may_press_m());
        assert!(soon_m > 0.5, "{soon_m}");
        assert!(first_m > 0.9 && both_m < 1.02, "{first_m} {both_m}");
    }

    const LIMIT_M_S: f64 = 0.02;

    /// Speeds outward that are left after three frames of a base that stands.
    fn left_m_s(order_delay_ms: f64, early: EarlyContact<TAXELS>) -> [f64; TAXELS] {
        let mut config = Config::default();
        config.set("protection.contact_barrier", &"pu-ld30".into()).unwrap();
        config.protection.order_delay_ms = order_delay_ms;
        let mut barrier = Barrier::new::<7>(&config, None).unwrap().unwrap();
        let mut cover = CoverState::NONE;
        cover.poll.early = early;
        let mut left = [0.0; TAXELS];
        for ms in 1..=30_u64 {
            cover.poll.reading.sampled_at_ns = Some((ms - 1) / 10 * 10_000_000);
            barrier.take_cover(1_000_000 * ms, &cover, LIMIT_M_S);
            left = barrier.update([0.0; 3], [3.0; 3], false, 1e-3).unwrap().outward_m_s;
        }
        left
    }

    #[test]
    fn late_base_makes_room_from_the_first_alarm_on() {
        const FRONT: usize = 5;
        // of a taxel in front that is touched lightly
        let left_m_s = |order_delay_ms: f64, light_n: f64, is_light: bool, certain: bool| {
            let mut early = EarlyContact::NONE;
            (early.light[FRONT], early.light_n[FRONT], early.certain[FRONT]) = (is_light, light_n, certain);
            left_m_s(order_delay_ms, early)[FRONT]
        };
        assert!(left_m_s(0.0, 3.0, true, true) >= 0.0, "a base that obeys at once waits for a reading");
        let room_m_s = left_m_s(100.0, 3.0, true, false);
        let hasty_m_s = (2.0 * 0.7 * 3.0 * may_press_m()).sqrt();
        assert!(
            (room_m_s + LIMIT_M_S + hasty_m_s).abs() < 1e-12,
            "a doubtful one, no faster than can be taken back: {room_m_s}"
        );
        assert!(left_m_s(100.0, 3.0, true, true) < room_m_s, "as much as it needs, once it is certain");
        assert!(left_m_s(100.0, 0.0, true, false) < 0.0, "a frame below zero does not end the alarm");
        assert!(left_m_s(100.0, 3.0, false, false) > 1.0, "without an alarm a light force is none");
    }

    /// T6 and T7 are beside each other in front, T11 round the corner.
    #[test]
    fn alarm_beside_half_of_one_shows_one_body() {
        // speeds outward that T6 and another one are left: T6 alarms, and what the other one shows
        let left_m_s = |order_delay_ms: f64, other: usize, is_halfway: bool, is_light: bool| {
            let mut early = EarlyContact::NONE;
            early.light[5] = true;
            (early.light[other], early.halfway[other]) = (is_light, is_halfway);
            (early.light_n[5], early.light_n[other]) = (3.0, 3.0);
            let left_m_s = left_m_s(order_delay_ms, early);
            [left_m_s[5], left_m_s[other]]
        };
        let [doubted_m_s, other_m_s] = left_m_s(100.0, 6, false, false);
        assert!(other_m_s >= 0.0, "nothing there: {other_m_s}");
        let [first_m_s, second_m_s] = left_m_s(100.0, 6, true, false);
        assert!(first_m_s < doubted_m_s && second_m_s < doubted_m_s, "{first_m_s} {second_m_s}");
        let [both_m_s, second_m_s] = left_m_s(100.0, 6, false, true);
        assert!(both_m_s < doubted_m_s && second_m_s < doubted_m_s, "{both_m_s} {second_m_s}");
        let [alone_m_s, other_m_s] = left_m_s(100.0, 10, true, false);
        assert!((alone_m_s - doubted_m_s).abs() < 1e-12 && other_m_s > 1.0, "{alone_m_s} {other_m_s}");
        let [prompt_m_s, other_m_s] = left_m_s(0.0, 6, true, false);
        assert!(prompt_m_s >= 0.0 && other_m_s >= 0.0, "a base that obeys at once waits for a reading");
    }

    #[test]
    fn two_thresholds_hide_a_body_on_a_seam() {
        let mut config = Config::default();
        config.set("protection.contact_barrier", &"pu-ld30".into()).unwrap();
        let (reading, foam) = curves(&config).unwrap();
        let one_n = foam.force_n(reading.depth_m(config.protection.threshold_force_n));
        for sharing in [1, 2] {
            let hidden_n = foam.force_n(foam.depth_m(25.0) - travel_m(&config, sharing).unwrap());
            assert!((hidden_n - f64::from(sharing) * one_n).abs() < 1e-9, "{hidden_n} N");
        }
        config.protection.force_limit_n = 1.5 * one_n;
        assert!(travel_m(&config, 1).unwrap() > 0.0);
        assert_eq!(travel_m(&config, 2), Some(0.0), "nothing is left: the base stands");
    }
}

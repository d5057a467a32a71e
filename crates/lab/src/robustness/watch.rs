//! Invariants that every tick must keep, whatever somebody does to the robot.

use super::cover_speed::{CoverSpeed, Pushes};
use anyhow::{Context, Result};
use moca_control::config::Config;
use moca_control::supervisor::EDGES;
use moca_experiments::JOINTS;
use moca_msgs::robot::resized;
use moca_msgs::target::TargetPhase;
use moca_msgs::{Mode, Request, Sample};
use moca_wbc::limits::JointSpeeds;
use serde::Serialize;
use std::collections::BTreeMap;

/// Longest list of violations that is worth reading.
const VIOLATIONS_MAX: usize = 10;
/// A stop is obeyed within this, ticks.
pub(super) const STOP_TICKS: u64 = 50;
/// The base rests so long after the last touch or target at the latest, ticks, at no more than this speed, m/s.
const REST_TICKS: u64 = 2000;
const REST_M_S: f64 = 0.005;
/// Share of the limit by which the robot's own inertia is found too small: its mass matrix is a physics step old.
pub(super) const INERTIA_ROUNDED: f64 = 1e-4;
/// A reading of less is no touch any more, N.
const TOUCH_N: f64 = 0.1;

/// The largest of everything that is limited, as a share of its limit, and what went wrong.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Findings {
    pub(super) stops: BTreeMap<&'static str, u64>,
    pub(super) ticks_in_mode: BTreeMap<&'static str, u64>,
    pub(super) largest_base_speed_m_s: f64,
    /// Largest kinetic energy of the base, J, its mass at the configured speed limit being what is allowed.
    pub(super) largest_base_energy_j: f64,
    pub(super) largest_torque_used: f64,
    pub(super) largest_torque_rate_used: f64,
    pub(super) largest_base_acceleration_used: f64,
    pub(super) largest_joint_speed_used: f64,
    /// Largest measured speed of the cover, of the speed limit on the same sample.
    pub(super) largest_cover_speed_of_limit: f64,
    /// Largest measured speed of the cover, of what [`CoverSpeed`] allows with that limit.
    pub(super) largest_cover_speed_used: f64,
    /// Largest commanded speed of the cover, of that limit once the base has braked to it.
    pub(super) largest_cover_command_used: f64,
    /// Most ticks from a request to stop until no law moves the robot.
    pub(super) slowest_stop_ticks: u64,
    pub(super) stops_asked: u64,
    /// Fastest base over two seconds after the last touch, m/s.
    pub(super) restless_m_s: f64,
    /// Ticks in which it was faster than rest allows.
    pub(super) restless: Vec<String>,
    pub(super) violations: Vec<String>,
    /// Violations beyond those that are listed count too.
    pub(super) violation_count: u64,
}

impl Findings {
    pub(super) fn violation(&mut self, text: String) {
        self.violation_count += 1;
        if self.violations.len() < VIOLATIONS_MAX {
            self.violations.push(text);
        }
    }
}

/// Checks every tick.
pub(super) struct Watch {
    pub(super) last: Option<Sample>,
    pub(super) findings: Findings,
    torque_nm: [f64; JOINTS],
    torque_step_nm: f64,
    base_velocity: [f64; 3],
    base_step: [f64; 3],
    base_mass_kg: f64,
    speeds: JointSpeeds<JOINTS, f64>,
    cover_speed: CoverSpeed,
    stop_asked: Option<u64>,
    /// Last tick in which somebody touched or led the robot, or something stopped it.
    disturbed: u64,
    /// The base moves although it should rest.
    moves: bool,
}

impl Watch {
    /// # Errors
    /// The arm has not seven joints.
    pub(super) fn new(config: &Config) -> Result<Self> {
        let limits = config.parameters().limits;
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        Ok(Self {
            last: None,
            findings: Findings::default(),
            torque_nm: resized(&limits.torque_nm),
            torque_step_nm: limits.torque_rate_nm_s * period_s,
            base_velocity: limits.base_velocity,
            base_step: limits.base_acceleration.map(|a| a * period_s),
            base_mass_kg: config.robot.base.mass_kg,
            speeds: JointSpeeds::new(&config.arm().table().context("an arm of seven joints")?),
            cover_speed: CoverSpeed::new(config)?,
            stop_asked: None,
            disturbed: 0,
            moves: false,
        })
    }

    /// Another robot, from its power-up.
    pub(super) fn begin_again(&mut self) {
        (self.last, self.stop_asked, self.disturbed, self.moves) = (None, None, 0, false);
        self.cover_speed.begin_again();
    }

    /// Looks at one tick in which `request` was made and somebody `touches`, and at all `pushes` of the period after it.
    pub(super) fn look(
        &mut self,
        sample: &Sample,
        request: Option<Request>,
        touches: bool,
        pushes: &Pushes<'_>,
    ) {
        *self.findings.ticks_in_mode.entry(sample.mode.name()).or_default() += 1;
        let mut wrong = self.limits(sample);
        wrong.extend(self.cover(sample, pushes));
        wrong.extend(self.changes(sample));
        wrong.extend(self.stop(sample, request));
        self.rest(sample, touches);
        if !finite(sample) {
            wrong.push("a value is not finite".into());
        }
        for text in wrong {
            self.findings.violation(format!("tick {}: {text}", sample.tick));
        }
        self.last = Some(sample.clone());
    }

    fn limits(&mut self, sample: &Sample) -> Vec<String> {
        let found = &mut self.findings;
        let [vx, vy, _] = sample.base_velocity_world;
        let speed_m_s = vx.hypot(vy);
        found.largest_base_speed_m_s = found.largest_base_speed_m_s.max(speed_m_s);
        let energy_j = 0.5 * self.base_mass_kg * speed_m_s * speed_m_s;
        found.largest_base_energy_j = found.largest_base_energy_j.max(energy_j);
        let mut wrong = Vec::new();
        for (velocity, limit) in sample.base_velocity_command_body.iter().zip(self.base_velocity) {
            wrong
                .extend((velocity.abs() > limit).then(|| format!("base velocity {velocity} beyond {limit}")));
        }
        let mut share = 0.0_f64;
        for (torque, limit) in sample.arm_torque_nm.iter().zip(self.torque_nm) {
            share = share.max(torque.abs() / limit);
        }
        found.largest_torque_used = found.largest_torque_used.max(share);
        wrong.extend((share.is_nan() || share > 1.0).then(|| format!("torque at {share} of its limit")));
        let (q_rad, dq_rad_s) = (resized_or_zero(&sample.q_rad), resized_or_zero(&sample.dq_rad_s));
        let share = self.speeds.share(&q_rad, &dq_rad_s);
        found.largest_joint_speed_used = found.largest_joint_speed_used.max(share);
        wrong.extend((share > 1.0).then(|| format!("joint speed at {share:.3} of its limit")));
        wrong
    }

    /// Measured and commanded speed of the cover against the speed limit.
    fn cover(&mut self, sample: &Sample, pushes: &Pushes<'_>) -> Vec<String> {
        let limit_m_s = sample.speed_limit.m_s;
        if !sample.mode.moves() || limit_m_s <= 0.0 {
            self.cover_speed.begin_again();
            return Vec::new();
        }
        let found = &mut self.findings;
        let allowed = self.cover_speed.allowed_m_s(limit_m_s, pushes);
        let commanded = self.cover_speed.commanded(&sample.base_velocity_command_body);
        let of_limit = sample.cover_speed_m_s / limit_m_s;
        found.largest_cover_speed_of_limit = found.largest_cover_speed_of_limit.max(of_limit);
        let used = sample.cover_speed_m_s / allowed;
        found.largest_cover_speed_used = found.largest_cover_speed_used.max(used);
        found.largest_cover_command_used = found.largest_cover_command_used.max(commanded);
        let beyond = |share: f64| share.is_nan() || share > 1.0 + 1e-9;
        let mut wrong = Vec::new();
        wrong.extend(
            beyond(used - INERTIA_ROUNDED).then(|| format!("cover at {used:.4} of what its limit allows")),
        );
        wrong.extend(beyond(commanded).then(|| format!("cover commanded to {commanded:.4} of its limit")));
        wrong
    }

    fn changes(&mut self, sample: &Sample) -> Vec<String> {
        let (Some(last), found) = (&self.last, &mut self.findings) else { return Vec::new() };
        let mut wrong = Vec::new();
        if last.mode != sample.mode {
            if !EDGES.contains(&(last.mode, sample.mode)) {
                let (from, to) = (last.mode, sample.mode);
                wrong.push(format!("from {from:?} to {to:?}, which no row of the table allows"));
            }
            if let (Mode::ProtectiveStop | Mode::Fault, Some(fault)) = (sample.mode, sample.fault) {
                *found.stops.entry(fault.code()).or_default() += 1;
            }
            wrong.extend((sample.mode == Mode::Fault).then(|| format!("fault {:?}", sample.fault)));
        }
        let ticks = f64::from(u32::try_from(sample.tick - last.tick).unwrap_or(u32::MAX));
        for (i, commanded) in sample.base_velocity_command_body.iter().enumerate() {
            let used = (commanded - last.base_velocity_command_body[i]).abs() / (self.base_step[i] * ticks);
            found.largest_base_acceleration_used = found.largest_base_acceleration_used.max(used);
            wrong.extend((used > 1.0 + 1e-9).then(|| format!("base acceleration at {used} of its limit")));
        }
        for (now, before) in sample.arm_torque_nm.iter().zip(&last.arm_torque_nm) {
            let used = (now - before).abs() / (self.torque_step_nm * ticks);
            found.largest_torque_rate_used = found.largest_torque_rate_used.max(used);
            wrong.extend((used > 1.0 + 1e-9).then(|| format!("torque rate at {used} of its limit")));
        }
        wrong
    }

    /// Counts the ticks from a request to stop until no law moves the robot.
    fn stop(&mut self, sample: &Sample, request: Option<Request>) -> Option<String> {
        if matches!(request, Some(Request::Stop | Request::OperatorLost)) {
            self.findings.stops_asked += 1;
            self.stop_asked.get_or_insert(sample.tick);
        }
        let asked = self.stop_asked?;
        if sample.mode.moves() {
            return (sample.tick == asked + STOP_TICKS).then(|| "a stop was not obeyed for 50 ms".into());
        }
        self.stop_asked = None;
        self.findings.slowest_stop_ticks = self.findings.slowest_stop_ticks.max(sample.tick - asked);
        None
    }

    /// Notes a base that moves although nobody touches or leads it, once for each time.
    fn rest(&mut self, sample: &Sample, touches: bool) {
        let felt = sample.taxels.iter().any(|taxel| taxel.force_n > TOUCH_N);
        let led = sample.target.is_some_and(|target| target.phase == TargetPhase::Moving);
        let recentres = sample.posture.is_some_and(|posture| posture.recentring);
        if touches || felt || led || recentres || !sample.mode.moves() {
            (self.disturbed, self.moves) = (sample.tick, false);
        }
        if sample.tick - self.disturbed < REST_TICKS {
            return;
        }
        let (speed_m_s, found) = (sample.cover_speed_m_s, &mut self.findings);
        found.restless_m_s = found.restless_m_s.max(speed_m_s);
        let before = std::mem::replace(&mut self.moves, speed_m_s > REST_M_S);
        if self.moves && !before && found.restless.len() < VIOLATIONS_MAX {
            let tick = sample.tick;
            found.restless.push(format!("tick {tick}: {speed_m_s:.3} m/s 2 s after the last touch"));
        }
    }
}

/// Joint values of a sample; 0 where it has none.
fn resized_or_zero(values: &[f64]) -> [f64; JOINTS] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

fn finite(sample: &Sample) -> bool {
    let all = |values: &[f64]| values.iter().all(|value| value.is_finite());
    all(&sample.q_rad)
        && all(&sample.dq_rad_s)
        && all(&sample.arm_torque_nm)
        && all(&sample.base_pose_world)
        && all(&sample.base_velocity_world)
        && all(&sample.base_velocity_command_body)
        && all(&sample.flange_position_world)
        && all(&sample.flange_quaternion_world)
        && all(&sample.flange_desired_position_world)
        && all(&sample.cover_wrench_base)
        && sample.taxels.iter().all(|taxel| taxel.force_n.is_finite())
        && sample.cover_speed_m_s.is_finite()
}

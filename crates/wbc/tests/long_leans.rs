//! A minute of leaning on one taxel: the base stops giving way before the arm has used a limit up.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{DT_S, Loop, Push, near};
use moca_wbc::limits::JointSpeeds;
use moca_wbc::reference_generator::ReferenceBounds;
use moca_wbc::robot::PANDA;
use moca_wbc::{
    BaseGuard, ControlLaw, ControlOutput, Corrections, Exceeded, ImpedanceGains, Parameters, RobotState,
    Target, TwistAxes,
};

/// A posture whose elbow is straight: shoulder, elbow and wrist on one line.
const STRETCHED: [f64; 7] = [0.0, 0.5, 0.0, -0.45, 0.0, 1.2, 0.785];
/// Joint 4 stands 0.12 rad before the end of its range.
const NEAR_AN_END: [f64; 7] = [0.0, -1.2, 0.0, -2.95, 0.0, 1.75, 0.785];

/// Largest share of each limit that a lean uses, up to a stop.
#[derive(Debug, Default)]
struct Used {
    range: f64,
    joint_speed: f64,
    torque: f64,
    pose_error: f64,
    exceeded: Option<Exceeded>,
}

impl Used {
    fn most(&self) -> f64 {
        self.range.max(self.joint_speed).max(self.torque).max(self.pose_error)
    }

    fn see(&mut self, robot: &RobotState<7>, output: &ControlOutput<7>, parameters: &Parameters<7>) {
        let speeds = JointSpeeds::<7, f64>::new(&PANDA);
        for i in 0..7 {
            let (q, dq) = (robot.q_rad[i], robot.dq_rad_s[i]);
            let (low, high) = (PANDA.q_min_rad[i], PANDA.q_max_rad[i]);
            self.range = self.range.max((2.0 * q - low - high).abs() / (high - low));
            self.joint_speed = self.joint_speed.max(dq.abs() / speeds.largest(i, q, dq));
            let torque = output.command.arm_torque_nm[i].abs() / parameters.limits.torque_nm[i];
            self.torque = self.torque.max(torque);
        }
        let (a, b) = (output.flange.quaternion_world, output.flange_desired.quaternion_world);
        let cosine = (0..4).map(|i| a[i] * b[i]).sum::<f64>().abs().min(1.0);
        let error_m = common::flange_error(output) / parameters.limits.pose_error_m;
        let error_rad = 2.0 * cosine.acos() / parameters.limits.pose_error_rad;
        self.pose_error = self.pose_error.max(error_m).max(error_rad);
        self.exceeded = self.exceeded.or(output.exceeded);
    }
}

/// Leans on `taxel` (1 is T1) for `seconds` with the corrections and the speed limit that ship, and 0.3 s on after a stop.
fn lean(
    law: ControlLaw,
    posture_rad: [f64; 7],
    taxel: usize,
    force_n: f64,
    seconds: f64,
) -> (Used, [f64; 3]) {
    lean_after(false, law, posture_rad, taxel, force_n, seconds)
}

/// [`lean`] on a robot whose tool was led and has come to rest, if `led_before`.
fn lean_after(
    led_before: bool,
    law: ControlLaw,
    posture_rad: [f64; 7],
    taxel: usize,
    force_n: f64,
    seconds: f64,
) -> (Used, [f64; 3]) {
    let corrections = Corrections { null_space_damping: true, base_coupling: true, ..Corrections::LITERAL };
    let gains = ImpedanceGains { posture_rad, ..ImpedanceGains::PAPER };
    let parameters = Parameters { gains, corrections, ..Parameters::PAPER };
    let robot = RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(posture_rad) };
    let mut plant = Loop::starting(law, &parameters, robot, DT_S);
    if led_before {
        let still = Target::Twist { axes: TwistAxes::World, twist: [0.0; 6] };
        plant.state.lead(&still, &robot, &ReferenceBounds::DEFAULT, None).unwrap();
        plant.state.lead(&Target::Hold, &robot, &ReferenceBounds::DEFAULT, None).unwrap();
    }
    plant.guard = BaseGuard { speed_m_s: Some(0.083), ..BaseGuard::NONE };
    let push = Push::taxels(&[taxel], force_n);
    let mut used = Used::default();
    let mut end_s = seconds;
    while plant.time_s < end_s {
        let output = plant.step(&push.scaled((plant.time_s / 0.5).min(1.0)));
        used.see(&plant.robot, &output, &parameters);
        if output.exceeded.is_some() {
            end_s = plant.time_s + 0.3;
        }
    }
    (used, plant.robot.base_pose_world)
}

#[test]
fn long_lean_at_home_ends_before_any_limit() {
    for (taxel, force_n) in
        [(1, 100.0), (2, 100.0), (3, 40.0), (4, 100.0), (5, 100.0), (7, 100.0), (11, 80.0)]
    {
        let (used, base) = lean(ControlLaw::Impedance, PANDA.home_rad, taxel, force_n, 62.0);
        assert_eq!(used.exceeded, None, "T{taxel}, {force_n} N: {used:?}");
        assert!(used.most() < 0.95, "T{taxel}, {force_n} N: {used:?}, base at {base:?}");
        assert!(base[0].hypot(base[1]) > 0.2, "T{taxel}, {force_n} N: the base gives way, {base:?}");
    }
}

/// A tool that rests at the end of a lead stands like one that nobody has ever led.
#[test]
fn lean_after_a_lead_ends_before_any_limit() {
    for (taxel, force_n, stops) in
        [(1, 100.0, false), (3, 40.0, false), (5, 100.0, false), (4, 100.0, true), (11, 150.0, true)]
    {
        let (used, base) = lean_after(true, ControlLaw::Impedance, PANDA.home_rad, taxel, force_n, 62.0);
        assert!(used.most() < 0.95, "T{taxel}: {used:?}, {base:?}");
        let stretched = matches!(used.exceeded, Some(Exceeded::Stretched(_))) && used.joint_speed < 0.5;
        assert!(used.exceeded.is_none() || (stops && stretched), "T{taxel}: {used:?}");
        assert!(base[0].hypot(base[1]) > 0.2, "T{taxel}: the base gives way, {base:?}");
    }
}

#[test]
fn long_lean_near_an_end_ends_before_any_limit() {
    for (taxel, force_n) in [(1, 40.0), (5, 100.0), (10, 40.0)] {
        let (used, base) = lean(ControlLaw::Impedance, NEAR_AN_END, taxel, force_n, 62.0);
        assert!(used.exceeded.is_none() && used.most() < 0.95, "T{taxel}, {force_n} N: {used:?}, {base:?}");
    }
}

#[test]
fn long_lean_on_a_stretched_arm_ends_before_any_limit() {
    for (taxel, force_n) in [(1, 40.0), (3, 100.0), (5, 40.0), (10, 40.0)] {
        let (used, base) = lean(ControlLaw::Impedance, STRETCHED, taxel, force_n, 62.0);
        let most_speed = match used.exceeded {
            None => 0.95,
            Some(Exceeded::Stretched(_)) => 0.5,
            Some(other) => panic!("T{taxel}, {force_n} N: {other:?}"),
        };
        let fits = used.most() < 0.95 && used.joint_speed < most_speed;
        assert!(fits, "T{taxel}, {force_n} N: {used:?}, {base:?}");
    }
}

#[test]
fn runaway_of_a_stretched_arm_stops_below_half_speed() {
    for taxel in [1, 8] {
        let (used, _) = lean(ControlLaw::FollowMe, STRETCHED, taxel, 10.0, 30.0);
        assert!(matches!(used.exceeded, Some(Exceeded::Stretched(_))), "T{taxel}: {used:?}");
        assert!(used.joint_speed < 0.5, "T{taxel}: {used:?}");
    }
}

/// One start shows little: the last digits of it decide how a stretched arm swings.
#[test]
fn runaway_from_sixty_starts_stops_below_a_third_of_speed() {
    let mut runaways = 0;
    for taxel in [1, 8] {
        for start in 0..30 {
            let (used, _) = lean(ControlLaw::FollowMe, near(STRETCHED, start), taxel, 10.0, 30.0);
            assert!(used.joint_speed < 1.0 / 3.0, "T{taxel}, start {start}: {used:?}");
            match used.exceeded {
                Some(Exceeded::Stretched(_)) => runaways += 1,
                other => assert_eq!(other, None, "T{taxel}, start {start}"),
            }
        }
    }
    assert!(runaways >= 54, "{runaways} of 60 run away");
}

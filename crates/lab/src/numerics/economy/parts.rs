//! The control tasks of a scene without an arm, and of one without a base: the laws of `moca_wbc` that such a robot
//! needs, and none of the others.

use crate::rig::cpu_time;
use anyhow::{Context, Result};
use moca_daemon::config::{Config, JOINTS, TAXELS};
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_msgs::{ImpedanceGains, Payload, RobotState};
use moca_wbc::cover::Cover;
use moca_wbc::guard::{BaseGuard, CoverOutline};
use moca_wbc::limits::OutputLimits;
use moca_wbc::opspace::TaskDynamics;
use moca_wbc::rotation::Heading;
use moca_wbc::{ArmModel, ControlInput, ControlLaw, Controller, LimitsHit, admittance, impedance};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use std::hint::black_box;

/// CPU time of one control step, µs.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct ControlCost {
    whole_body_us: f64,
    base_alone_us: f64,
    arm_alone_us: f64,
}

impl std::fmt::Display for ControlCost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "control: whole-body impedance {:.2} us; base-only needs the admittance, {:.2} us; arm-only the arm's \
             impedance, {:.2} us",
            self.whole_body_us, self.base_alone_us, self.arm_alone_us
        )
    }
}

/// eqs. (2) and (4): how the base gives way to its cover.
struct BaseAlone {
    cover: Cover<TAXELS, f64>,
    outline: CoverOutline<TAXELS, f64>,
    gains: ImpedanceGains<JOINTS>,
    limits: OutputLimits<JOINTS, f64>,
}

impl BaseAlone {
    fn new(config: &Config) -> Result<Self> {
        let parameters = config.parameters();
        Ok(Self {
            cover: Cover::new(&PAPER_COVER)?,
            outline: CoverOutline::new(&PAPER_COVER),
            gains: parameters.gains,
            limits: OutputLimits::from(&parameters.limits),
        })
    }

    /// Next velocity from the last one, both commanded, axes of B.
    fn step(&self, velocity_body: &[f64; 3], yaw: f64, taxel_force_n: &[f64; TAXELS], dt_s: f64) -> [f64; 3] {
        let (gains, mut hit) = (&self.gains, LimitsHit::default());
        let forces = self.limits.taxel_forces(taxel_force_n, &mut hit);
        let heading = Heading::at(yaw);
        let push_world = heading.to_world(self.cover.wrench(&forces));
        let now = heading.to_world(*velocity_body);
        let next = std::array::from_fn(|i| {
            let force = gains.reactivity * push_world[i];
            admittance::step(now[i], force, gains.virtual_mass[i], gains.virtual_damping[i], dt_s)
        });
        let wanted = heading.to_base(next);
        let guard = BaseGuard::NONE;
        self.limits.guarded_base_velocity(&self.outline, &guard, &wanted, velocity_body, dt_s, &mut hit)
    }
}

/// eqs. (10), (11) and (15): the arm keeps its flange where it is, on a base that stands.
struct ArmAlone {
    model: ArmModel<JOINTS, f64>,
    gains: ImpedanceGains<JOINTS>,
    limits: OutputLimits<JOINTS, f64>,
    /// Flange relative to B.
    desired: (Vector3<f64>, Matrix3<f64>),
}

impl ArmAlone {
    fn new(config: &Config, q_rad: &[f64; JOINTS]) -> Result<Self> {
        let parameters = config.parameters();
        let model = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
        let start = model.kinematics(0.0, q_rad);
        Ok(Self {
            model,
            gains: parameters.gains,
            limits: OutputLimits::from(&parameters.limits),
            desired: (start.tool_from_base(), start.tool_rotation),
        })
    }

    /// Joint torques from the state and the last torques, N·m.
    fn step(
        &self,
        q: &[f64; JOINTS],
        dq: &[f64; JOINTS],
        last_nm: &[f64; JOINTS],
        dt_s: f64,
    ) -> Result<[f64; JOINTS]> {
        let gains = &self.gains;
        let kinematics = self.model.kinematics(0.0, q);
        let inertias = self.model.link_inertias(&kinematics);
        let mass = kinematics.mass_matrix(&inertias).arm;
        let (base, arm) = (kinematics.base_jacobian(), kinematics.arm_jacobian());
        let task = TaskDynamics::new(base, arm, gains.virtual_mass, &mass)?;
        let damping = impedance::damping(&task.arm_mobility(), &gains.stiffness, gains.damping_ratio)?;
        let actual = (&kinematics.tool_from_base(), &kinematics.tool_rotation);
        let error = impedance::pose_error(actual, (&self.desired.0, &self.desired.1));
        let rate = moca_wbc::linalg::times(&arm, dq).map(|v| -v);
        let wrench = impedance::wrench(&gains.stiffness, &damping, &error, &rate);
        let (stiffness, damping) = (&gains.posture_stiffness, &gains.posture_damping);
        let posture = impedance::posture_torque(stiffness, damping, &gains.posture_rad, q, dq);
        let torque = task.arm_torque(&wrench, &posture)?;
        let bias = kinematics.bias(&inertias, dq);
        let wanted = std::array::from_fn(|i| torque[i] + bias[i]);
        Ok(self.limits.torque(&wanted, last_nm, dt_s, &mut LimitsHit::default()))
    }
}

/// The robot in its home posture, a hand on T6.
fn input() -> ControlInput<JOINTS, TAXELS> {
    let mut taxel_force_n = [0.0; TAXELS];
    taxel_force_n[5] = 10.0;
    ControlInput {
        robot: RobotState {
            base_pose_world: [0.0, 0.0, 0.3],
            base_velocity_world: [0.0; 3],
            q_rad: PANDA.home_rad,
            dq_rad_s: [0.0; JOINTS],
            torque_measured_nm: [0.0; JOINTS],
            flange_wrench_world: None,
        },
        taxel_force_n,
        flange_wrench_world: None,
        dt_s: 1e-3,
    }
}

pub(super) fn measure(config: &Config) -> Result<ControlCost> {
    let input = input();
    let controller = Controller::<JOINTS, TAXELS>::new(
        &PANDA,
        &MOCA_MOUNT,
        &Payload::NONE,
        &PAPER_COVER,
        &config.parameters(),
    )?;
    let mut state = controller.enter(ControlLaw::Impedance, &input.robot)?;
    let (base, arm) = (BaseAlone::new(config)?, ArmAlone::new(config, &PANDA.home_rad)?);
    let (mut velocity, mut torque_nm) = ([0.0; 3], [0.0; JOINTS]);
    Ok(ControlCost {
        whole_body_us: fastest_us(|| {
            controller.step(ControlLaw::Impedance, &mut state, black_box(&input)).context("whole body")?;
            Ok(())
        })?,
        base_alone_us: fastest_us(|| {
            velocity = base.step(&velocity, 0.3, black_box(&input.taxel_force_n), 1e-3);
            Ok(())
        })?,
        arm_alone_us: fastest_us(|| {
            let robot = black_box(&input.robot);
            torque_nm = arm.step(&robot.q_rad, &robot.dq_rad_s, &torque_nm, 1e-3)?;
            Ok(())
        })?,
    })
}

/// CPU time of one call, µs: the least over stretches of 100.
fn fastest_us(mut call: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut best = f64::INFINITY;
    for _ in 0..200 {
        let (done, cpu_s) = cpu_time::timed(|| (0..100).try_for_each(|_| call()));
        done?;
        best = best.min(cpu_s / 100.0);
    }
    Ok(1e6 * best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::ParameterError;

    fn controller(config: &Config) -> Result<Controller<JOINTS, TAXELS>, ParameterError> {
        Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &config.parameters())
    }

    /// With nobody at the flange the base of the follow-me law feels its cover alone.
    #[test]
    fn the_base_alone_moves_as_under_the_whole_body_law_to_the_bit() {
        let config = Config::default();
        let (controller, base) = (controller(&config).unwrap(), BaseAlone::new(&config).unwrap());
        let mut input = ControlInput { flange_wrench_world: Some([0.0; 6]), ..input() };
        let mut state = controller.enter(ControlLaw::FollowMe, &input.robot).unwrap();
        let mut velocity = [0.0; 3];
        for tick in 0..2000_u32 {
            let t = 1e-3 * f64::from(tick);
            input.robot.base_pose_world[2] = 0.5 * t;
            input.taxel_force_n = [0.0; TAXELS];
            input.taxel_force_n[usize::try_from(tick / 200).unwrap()] = 15.0 * (7.0 * t).sin().abs();
            let whole = controller.step(ControlLaw::FollowMe, &mut state, &input).unwrap();
            velocity = base.step(&velocity, 0.5 * t, &input.taxel_force_n, 1e-3);
            let bits = |v: [f64; 3]| v.map(f64::to_bits);
            assert_eq!(bits(velocity), bits(whole.command.base_velocity_body), "tick {tick}");
        }
        assert!(velocity.iter().any(|v| v.abs() > 1e-3), "it moved: {velocity:?}");
    }

    /// The follow-me law holds the flange on the base by the arm alone.
    #[test]
    fn the_arm_alone_is_driven_as_under_the_whole_body_law() {
        let config = Config::default();
        let (controller, mut input) = (controller(&config).unwrap(), input());
        input.taxel_force_n = [0.0; TAXELS];
        input.flange_wrench_world = Some([0.0; 6]);
        input.robot.base_pose_world = [0.0; 3];
        input.robot.q_rad = config.parameters().gains.posture_rad;
        let start = input.robot.q_rad;
        let arm = ArmAlone::new(&config, &start).unwrap();
        let mut state = controller.enter(ControlLaw::FollowMe, &input.robot).unwrap();
        let mut torque = None;
        for tick in 0..500_u32 {
            let t = 1e-3 * f64::from(tick);
            input.robot.q_rad = start.map(|q| q + 0.01 * (1.0 - (3.0 * t).cos()));
            input.robot.dq_rad_s = [0.03 * (3.0 * t).sin(); JOINTS];
            let whole =
                controller.step(ControlLaw::FollowMe, &mut state, &input).unwrap().command.arm_torque_nm;
            let last = torque.unwrap_or(whole);
            let alone = arm.step(&input.robot.q_rad, &input.robot.dq_rad_s, &last, 1e-3).unwrap();
            for i in 0..JOINTS {
                assert!(
                    (alone[i] - whole[i]).abs() < 1e-9,
                    "tick {tick}, joint {i}: {} {}",
                    alone[i],
                    whole[i]
                );
            }
            torque = Some(alone);
        }
    }
}

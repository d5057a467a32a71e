//! A Franka arm over FCI as the loop's plant and clock: on a stand, or on a base that is simulated.

use crate::config::Config;
use crate::control::plant::{Datagram, Plant, PlantClock, SourceAge};
use crate::devices::stand_in_base::StandInBase;
use crate::robot::{BaseDriver, Believed, JOINTS};
use anyhow::{Context, Result, anyhow, ensure};
use moca_franka::{ArmState, Carried, Fci, Model, Settings};
use moca_msgs::robot::resized;
use moca_msgs::{Actuation, ArmLink, Fault, Outcome, Refusal, RobotState};
use moca_wbc::nalgebra::Matrix3;
use moca_wbc::rotation::{self, Heading};
use std::time::Duration;

/// The arm's thread runs above the loop: where the loop does not answer in time, it does.
const ABOVE_LOOP: u8 = 1;

/// Longest wait for an arm's report on its payload.
const CARRIES_WITHIN: Duration = Duration::from_secs(10);

/// Arm and base.
pub struct FrankaArm {
    arm: Fci,
    /// `None` on a stand, and on a base that has a driver of its own.
    base: Option<StandInBase>,
    /// Axes of the arm's base in B, if the arm's own estimate of what pushes it is believed.
    mounted: Option<Matrix3<f64>>,
    /// Gravity torques of the last order, N·m: left out for an arm that does not compensate gravity.
    gravity_nm: [f64; JOINTS],
}

impl FrankaArm {
    /// Begins to reach the arm; `say` hears in words what happens to the connection.
    ///
    /// # Errors
    /// An arm that Franka does not make, or a thread that cannot be started.
    pub fn connect(config: &Config, say: impl FnMut(&str) + Send + 'static) -> Result<Self> {
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let stands_in = config.plant.parts.has_cover() && config.plant.base.driver == BaseDriver::Simulated;
        let base = stands_in.then(|| StandInBase::new(&config.robot.base, period_s));
        let believed = config.plant.arm.external_wrench == Believed::Arm;
        let mounted = believed.then(|| rotation::from_rpy(config.robot.mount.rpy_rad));
        let arm = Fci::spawn(settings(config)?, say).context("the arm's thread")?;
        Ok(Self { arm, base, mounted, gravity_nm: [0.0; JOINTS] })
    }
}

/// The robot as the laws see it, of what the arm says; see the fields of [`FrankaArm`].
fn robot_state(
    state: &ArmState,
    (base_pose_world, base_velocity_world): ([f64; 3], [f64; 3]),
    mounted: Option<&Matrix3<f64>>,
    gravity_nm: &[f64; JOINTS],
) -> RobotState<JOINTS> {
    let mut torque_measured_nm: [f64; JOINTS] = resized(&state.torque_nm);
    if !state.feels_gravity {
        torque_measured_nm.iter_mut().zip(gravity_nm).for_each(|(torque, gravity)| *torque += gravity);
    }
    RobotState {
        base_pose_world,
        base_velocity_world,
        q_rad: resized(&state.q_rad),
        dq_rad_s: resized(&state.dq_rad_s),
        torque_measured_nm,
        flange_wrench_world: mounted.map(|mounted| {
            let axes_world = Heading::at(base_pose_world[2]).matrix() * mounted;
            rotation::turned(&axes_world, &state.wrench_base)
        }),
    }
}

/// Returns the address and settings of the configured arm.
///
/// # Errors
/// An arm that Franka does not make, or a rate that is not FCI's.
pub(crate) fn settings(config: &Config) -> Result<Settings> {
    let (arm, joints) = (&config.plant.arm, config.arm().joints);
    ensure!(
        joints == moca_franka::JOINTS,
        "plant.arm.driver = \"fci\" drives 7 joints; robot.arm has {joints}"
    );
    ensure!(
        config.control_loop.rate_hz == 1000,
        "loop.rate_hz: the datagrams of plant.arm.driver = \"fci\" come at 1000 Hz"
    );
    Ok(Settings {
        host: arm.host.clone(),
        model: Model::of_key(&config.robot.arm.source),
        priority: config.realtime.priority + ABOVE_LOOP,
        collision: (arm.collision_torque_nm, arm.collision_wrench),
        answer_within: Duration::from_secs_f64(arm.answer_s),
        carries_kg: config.robot.payload().inertial.mass_kg,
    })
}

/// Takes tool and load from the arm's own state, where the configuration says so. Waits for the arm.
///
/// # Errors
/// It cannot be reached, or what it says is no body.
pub(crate) fn ask_for_payload(config: &mut Config) -> Result<()> {
    if config.plant.arm.payload == Believed::Ours {
        return Ok(());
    }
    let host = config.plant.arm.host.clone();
    let answer = moca_franka::carried(&host, CARRIES_WITHIN);
    let Carried { tool, load } = answer.map_err(|why| anyhow!("plant.arm.payload = \"arm\": {why}"))?;
    let robot = &mut config.robot;
    (robot.tool.mass_kg, robot.tool.com_m, robot.tool.inertia_com) =
        (tool.mass_kg, tool.com_m, tool.inertia_com);
    (robot.load.mass_kg, robot.load.com_m, robot.load.inertia_com) =
        (load.mass_kg, load.com_m, load.inertia_com);
    let mut mistakes = Vec::new();
    config.check(|_, mistake| mistakes.push(mistake));
    ensure!(mistakes.is_empty(), "plant.arm.payload = \"arm\", which carries:\n{}", mistakes.join("\n"));
    Ok(())
}

impl Plant for FrankaArm {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        if let Some(fault) = self.arm.link().mode.hindrance() {
            return Err(fault);
        }
        let state = self.arm.state().ok_or(Fault::ArmStale)?;
        let base = self.base.map_or(([0.0; 3], [0.0; 3]), |base| base.state_world());
        Ok(robot_state(state, base, self.mounted.as_ref(), &self.gravity_nm))
    }

    fn age(&self) -> SourceAge {
        SourceAge { arm_s: self.arm.age_s(), base_s: 0.0 }
    }

    fn link(&self) -> Option<ArmLink> {
        Some(self.arm.link())
    }

    fn recover(&mut self) -> Outcome {
        self.arm.recover();
        Err(Refusal::Recovering)
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
        let mut base_velocity_body = [0.0; 3];
        match actuation {
            Actuation::Drive(command) => {
                let (torque_nm, gravity_nm) = (&command.arm_torque_nm, &command.arm_gravity_nm);
                self.arm.drive(&std::array::from_fn(|i| torque_nm[i] - gravity_nm[i]));
                self.gravity_nm = *gravity_nm;
                base_velocity_body = command.base_velocity_body;
            }
            Actuation::Brake => self.arm.brake(),
        }
        if let Some(base) = &mut self.base {
            base.follow(base_velocity_body, ticks);
        }
        Ok(())
    }
}

impl PlantClock for FrankaArm {
    fn receive(&mut self, timeout: Duration) -> Datagram {
        self.arm.receive(timeout).map_or(Datagram::Missing, Datagram::Count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_franka::mode::Said;
    use std::f64::consts::FRAC_PI_2;
    use std::time::Instant;

    fn pushed() -> ArmState {
        ArmState {
            count: 1,
            q_rad: [0.1; moca_franka::JOINTS],
            dq_rad_s: [0.2; moca_franka::JOINTS],
            torque_nm: [3.0; moca_franka::JOINTS],
            feels_gravity: true,
            wrench_base: [10.0, 0.0, 0.0, 0.0, 2.0, 0.0],
            said: Said::Moves,
            carries_kg: 0.0,
            success_rate: 1.0,
            received: Instant::now(),
        }
    }

    #[test]
    fn push_on_tilted_arm_has_right_direction() {
        // Its x axis points up: a push along it lifts the robot, whichever way the base looks.
        let mounted = rotation::from_rpy([0.0, -FRAC_PI_2, 0.0]);
        for (yaw_rad, expected) in
            [(0.0, [0.0, 0.0, 10.0, 0.0, 2.0, 0.0]), (FRAC_PI_2, [0.0, 0.0, 10.0, -2.0, 0.0, 0.0])]
        {
            let base = ([1.0, 2.0, yaw_rad], [0.0; 3]);
            let robot = robot_state(&pushed(), base, Some(&mounted), &[0.0; JOINTS]);
            let wrench = robot.flange_wrench_world.unwrap();
            for (found, expected) in wrench.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{wrench:?}");
            }
        }
    }

    #[test]
    fn arm_estimate_is_ignored_with_our_observer() {
        let robot = robot_state(&pushed(), ([0.0; 3], [0.0; 3]), None, &[0.0; JOINTS]);
        assert_eq!(robot.flange_wrench_world, None);
    }

    #[test]
    fn gravity_is_added_for_arm_without_compensation() {
        let torques = |feels_gravity| {
            let state = ArmState { feels_gravity, ..pushed() };
            robot_state(&state, ([0.0; 3], [0.0; 3]), None, &[4.0; JOINTS]).torque_measured_nm[0]
        };
        assert_eq!((torques(true), torques(false)), (3.0, 7.0));
    }
}

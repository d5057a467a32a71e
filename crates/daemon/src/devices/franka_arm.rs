//! A Franka arm over FCI as the loop's plant and clock: on a stand, or on a base that is simulated.

use crate::config::Config;
use crate::control::plant::{Datagram, Plant, PlantClock, SourceAge};
use crate::devices::stand_in_base::StandInBase;
use crate::robot::{BaseDriver, JOINTS};
use anyhow::{Context, Result, ensure};
use moca_franka::{ArmState, Fci, Settings};
use moca_msgs::robot::resized;
use moca_msgs::{Actuation, ArmLink, Fault, Outcome, Refusal, RobotState};
use std::time::Duration;

/// The arm's thread runs above the loop: where the loop does not answer in time, it does.
const ABOVE_LOOP: u8 = 1;

/// Arm and base.
pub struct FrankaArm {
    arm: Fci,
    /// `None` on a stand, and on a base that has a driver of its own.
    base: Option<StandInBase>,
    /// Of the last order, N·m: what an arm that does not know where down is leaves out of its torques.
    gravity_nm: [f64; JOINTS],
}

impl FrankaArm {
    /// Begins to reach the arm; `say` hears in words what happens to the connection.
    ///
    /// # Errors
    /// An arm that is none of Franka's, or a thread that cannot be started.
    pub fn connect(config: &Config, say: impl FnMut(&str) + Send + 'static) -> Result<Self> {
        let (arm, joints) = (&config.plant.arm, config.arm().joints);
        ensure!(
            joints == moca_franka::JOINTS,
            "plant.arm.driver = \"fci\" drives 7 joints; robot.arm has {joints}"
        );
        ensure!(
            config.control_loop.rate_hz == 1000,
            "loop.rate_hz: the datagrams of plant.arm.driver = \"fci\" come at 1000 Hz"
        );
        let settings = Settings {
            host: arm.host.clone(),
            priority: config.realtime.priority + ABOVE_LOOP,
            collision: (arm.collision_torque_nm, arm.collision_wrench),
            answer_within: Duration::from_secs_f64(arm.answer_s),
            carries_kg: config.robot.payload().inertial.mass_kg,
        };
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let stands_in = config.plant.parts.has_cover() && config.plant.base.driver == BaseDriver::Simulated;
        let base = stands_in.then(|| StandInBase::new(&config.robot.base, period_s));
        let arm = Fci::spawn(settings, say).context("the arm's thread")?;
        Ok(Self { arm, base, gravity_nm: [0.0; JOINTS] })
    }

    fn torque_measured_nm(&self, state: &ArmState) -> [f64; JOINTS] {
        let mut torque_nm: [f64; JOINTS] = resized(&state.torque_nm);
        if !state.feels_gravity {
            torque_nm.iter_mut().zip(self.gravity_nm).for_each(|(torque, gravity)| *torque += gravity);
        }
        torque_nm
    }
}

impl Plant for FrankaArm {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        if let Some(fault) = self.arm.link().mode.hindrance() {
            return Err(fault);
        }
        let state = self.arm.state().ok_or(Fault::ArmStale)?;
        let (base_pose_world, base_velocity_world) =
            self.base.map_or(([0.0; 3], [0.0; 3]), |base| base.state_world());
        Ok(RobotState {
            base_pose_world,
            base_velocity_world,
            q_rad: resized(&state.q_rad),
            dq_rad_s: resized(&state.dq_rad_s),
            torque_measured_nm: self.torque_measured_nm(state),
            // The arm's own estimate takes a base that accelerates for a push: our observer knows it.
            flange_wrench_world: None,
        })
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

//! A robot of your own behind the loop: implement [`Plant`], run it. Two seconds of an arm that stands still, with telemetry
//! and flight recorder as `mocad` has them.
//!
//! `cargo run --example own_robot`

use moca_control::config::Config;
use moca_control::plant::{Plant, SourceAge};
use moca_control::robot::{JOINTS, Parts, PlantKind};
use moca_daemon::runtime::live::Shared;
use moca_daemon::runtime::notice::Silent;
use moca_daemon::runtime::options::Options;
use moca_daemon::runtime::run::with_plant;
use moca_daemon::runtime::tick_source::Timer;
use moca_msgs::{Actuation, Fault, RobotState};
use std::sync::Arc;
use std::time::Duration;

/// Your driver: what it measured last, and where its orders go.
struct MyRobot(RobotState<JOINTS>);

impl Plant for MyRobot {
    /// Newest state. It never waits: a thread of the driver's own talks to the robot.
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        Ok(self.0)
    }

    /// Returns the age of the state: the loop stops when a part is older than `deadline_s` in `[plant.arm]` and `[plant.base]`.
    fn age(&self) -> SourceAge {
        SourceAge { arm_s: 0.000_5, base_s: 0.010 }
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        match actuation {
            Actuation::Drive(command) => self.0.torque_measured_nm = command.arm_torque_nm,
            Actuation::Brake => {} // base to standstill, arm to its own controller or brake
        }
        Ok(())
    }
}

fn main() -> anyhow::Result<()> {
    let mut config = Config::default();
    config.plant.kind = PlantKind::Robot;
    config.plant.parts = Parts::Arm; // this one has no base and no cover
    let state = RobotState::at_rest(config.control.gains.posture_rad);
    let options = Options { config, duration: Some(Duration::from_secs(2)), ..Options::default() };
    let run =
        with_plant(&options, |_| Ok(MyRobot(state)), Timer::new, &Arc::new(Shared::default()), &mut Silent)?;
    eprintln!("{} ticks, {} slots missed", run.report.ticks, run.report.overruns);
    Ok(())
}

//! A robot of your own behind the loop: implement [`Plant`], run it. Two seconds of an arm that stands still.
//!
//! `cargo run --example own_robot`

use moca_daemon::config::Config;
use moca_daemon::control::plant::{Plant, SourceAge};
use moca_daemon::control::tick::ControlLoop;
use moca_daemon::devices::touch_board::ByteCover;
use moca_daemon::robot::{JOINTS, Parts};
use moca_daemon::runtime::assemble::{motion, supervisor};
use moca_daemon::runtime::clients::rings;
use moca_daemon::runtime::clock::Clock;
use moca_daemon::runtime::live::{self, Shared};
use moca_daemon::runtime::tick_source::Timer;
use moca_daemon::runtime::timing::Timing;
use moca_msgs::{Actuation, Fault, RobotState};
use std::time::Duration;

/// Your driver: what it measured last, and where its orders go.
struct MyRobot(RobotState<JOINTS>);

impl Plant for MyRobot {
    /// Newest state. It never waits: a thread of the driver's own talks to the robot.
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        Ok(self.0)
    }

    /// How old it is: the loop stops when the arm's part is over 10 ms old, the base's over 100 ms.
    fn age(&self) -> SourceAge {
        SourceAge { arm_s: 0.000_5, base_s: 0.010 }
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        match actuation {
            Actuation::Drive(command) => self.0.torque_measured_nm = command.arm_torque_nm,
            Actuation::Brake => {} // base to standstill, arm to its own brake
        }
        Ok(())
    }
}

fn main() -> anyhow::Result<()> {
    let mut config = Config::default();
    config.plant.parts = Parts::Arm; // this one has no base and no cover
    let state = RobotState::at_rest(config.control.gains.posture_rad);
    let cover: Option<ByteCover> = None;
    let mut control = ControlLoop::new(MyRobot(state), cover, supervisor(&config), motion(&config)?, 1e-3);
    let (clock, shared, mut timing) = (Clock::start()?, Shared::default(), Timing::new()?);
    let (mut rings, _samples, _requests) = rings(&shared);
    let (mut ticks, length) = (Timer::new(clock, 1_000_000), Some(Duration::from_secs(2)));
    let report = live::run(&mut control, &mut ticks, &mut timing, length, &mut rings, &shared);
    eprintln!("{} ticks, {} slots missed", report.ticks, report.overruns);
    Ok(())
}

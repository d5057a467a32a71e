//! A gripper of your own behind the loop: implement [`Gripper`], put it on a robot. Five seconds in which `mocad gripper`
//! moves it: `cargo run --example own_gripper`, then `mocad gripper move 0.02` in another terminal.

use moca_control::config::Config;
use moca_control::plant::NoRobot;
use moca_control::robot::{Parts, PlantKind};
use moca_daemon::devices::gripper::{Gripper, GripperThread, WithGripper};
use moca_daemon::runtime::{
    live::Shared, notice::Silent, options::Options, run::with_plant, tick_source::Timer,
};
use moca_msgs::gripper::{FRANKA_HAND, GripperTable};
use moca_msgs::{GripperRequest, GripperState};
use std::{sync::Arc, time::Duration};

/// Your driver: here one whose fingers are at once where they are told to be, and never hold anything.
struct MyGripper(f64);

impl Gripper for MyGripper {
    fn table(&self) -> GripperTable {
        GripperTable { width_max_m: 0.1, force_n: [5.0, 120.0], ..FRANKA_HAND }
    }

    fn begin(&mut self, request: &GripperRequest) {
        self.0 = match *request {
            GripperRequest::Move { width_m, .. } => width_m,
            GripperRequest::Grasp { .. } => 0.0,
            GripperRequest::Home | GripperRequest::Release => self.table().width_max_m,
            GripperRequest::Stop => self.0,
        };
    }

    fn read(&mut self) -> Option<GripperState> {
        Some(GripperState {
            width_m: self.0,
            width_max_m: self.table().width_max_m,
            ..GripperState::default()
        })
    }
}

fn main() -> anyhow::Result<()> {
    let mut config = Config::default();
    (config.plant.kind, config.plant.parts) = (PlantKind::Robot, Parts::Arm);
    let arm = NoRobot::at(config.control.gains.posture_rad);
    let options = Options { config, duration: Some(Duration::from_secs(5)), ..Options::default() };
    let connect = |_: &_| Ok(WithGripper::new(arm, Some(GripperThread::spawn(MyGripper(0.1))?)));
    with_plant(&options, connect, Timer::new, &Arc::new(Shared::default()), &mut Silent)?;
    Ok(())
}

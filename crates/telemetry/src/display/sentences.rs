//! Events, in sentences for a viewer's log panel.

use super::markers::Log;
use crate::RobotDescription;
use crate::ros::messages::Time;
use moca_msgs::{ContactEvent, Fault, Mode, Reaction};

const INFO: u8 = 20;
const WARNING: u8 = 30;
const ERROR: u8 = 40;

fn sentence(at: &Time, level: u8, name: &str, msg: String) -> Log {
    Log { stamp: at.clone(), level, name: name.into(), msg, ..Log::default() }
}

pub(super) fn mode(at: &Time, mode: Mode) -> Log {
    let level = match mode {
        Mode::Fault => ERROR,
        Mode::ProtectiveStop => WARNING,
        _ => INFO,
    };
    sentence(at, level, "mode", format!("The mode is {}.", mode.name()))
}

pub(super) fn fault(at: &Time, robot: &RobotDescription, fault: Option<Fault>) -> Log {
    let Some(fault) = fault else { return sentence(at, INFO, "fault", "No fault any more.".into()) };
    let level = if fault.reaction() == Reaction::Fault { ERROR } else { WARNING };
    sentence(at, level, "fault", format!("{}: {}", fault.code(), robot.fault_text(fault)))
}

pub(super) fn contact(at: &Time, event: &ContactEvent) -> Log {
    let level = if event.phase.is_warning() { WARNING } else { INFO };
    sentence(at, level, "contact", format!("{event}."))
}

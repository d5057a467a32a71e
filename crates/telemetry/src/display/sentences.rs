//! Events, in sentences for a viewer's log panel.

use super::markers::Log;
use crate::ros::messages::Time;
use moca_msgs::protection::ContactPhase;
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

pub(super) fn fault(at: &Time, fault: Option<Fault>, board: Option<u8>) -> Log {
    let Some(fault) = fault else { return sentence(at, INFO, "fault", "No fault any more.".into()) };
    let level = if fault.reaction() == Reaction::Fault { ERROR } else { WARNING };
    let board = board.map(|board| format!(" (board {})", u16::from(board) + 1)).unwrap_or_default();
    sentence(at, level, "fault", format!("{}{board}: {fault}", fault.code()))
}

pub(super) fn contact(at: &Time, event: &ContactEvent) -> Log {
    let (taxel, peak_n) = (u16::from(event.taxel) + 1, event.peak_n);
    let (level, what) = match event.phase {
        ContactPhase::Started => (INFO, "is touched".into()),
        ContactPhase::LimitCrossed => {
            let limit = event.crossed_n.map(|limit| format!(" of {limit:.0} N")).unwrap_or_default();
            (WARNING, format!("crossed its limit{limit} with {peak_n:.1} N"))
        }
        ContactPhase::Finished => {
            (INFO, format!("was released after {:.2} s, at most {peak_n:.1} N", event.duration_s))
        }
        ContactPhase::Lost => (WARNING, "became unusable while it was touched".into()),
        ContactPhase::NoRoom => (WARNING, "finds no room to give way".into()),
    };
    sentence(at, level, "contact", format!("T{taxel} {what}."))
}

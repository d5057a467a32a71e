//! Numbers and states as text.

use moca_msgs::{
    ArmLink, ContactEvent, SpeedLimitReason, arm_errors,
    board::{Diagnosis, OpenFailure},
};

/// A number with `decimals` digits after the point, without "-0.0"; a dash for what is not known.
pub fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.'));
    if is_zero { text.trim_start_matches('-').to_owned() } else { text.replace('-', "−") }
}

/// A taxel (0 is T1) by its name.
pub fn taxel_name(taxel: impl Into<usize>) -> String {
    format!("T{}", taxel.into() + 1)
}

/// Describes the state of the board at `port`, as the configuration names it.
pub fn board_text(board: Diagnosis, port: Option<&str>) -> String {
    match (board, port) {
        (Diagnosis::NotOpen(OpenFailure::NotFound), Some(path)) if path.starts_with('/') => format!(
            "The board's port {path} does not exist: check cable, power switch and board.port in the configuration."
        ),
        _ => board.text().to_owned(),
    }
}

/// Why the speed limit is what it is.
pub fn speed_limit(reason: SpeedLimitReason) -> &'static str {
    match reason {
        SpeedLimitReason::Configured => "as configured in limits.base_velocity",
        SpeedLimitReason::BoardRate => "the board's rate and age allow no more",
        SpeedLimitReason::Stale => "the board's rate is unknown or its data is old",
        SpeedLimitReason::Overridden => "the configuration overrides what the board allows",
        SpeedLimitReason::Contact => "a contact crossed a limit",
        SpeedLimitReason::BaseLate => "the base stops later than was measured",
    }
}

/// Describes the arm's report on itself and on its orders.
pub fn arm_link(arm: &ArmLink) -> String {
    let ArmLink { mode, success_rate, lost, repeated, errors } = *arm;
    let rate = number(success_rate, 2);
    let mut text = format!("Arm {}: success rate {rate}, {lost} lost, {repeated} repeated", mode.name());
    for error in arm_errors::set_in(errors) {
        text += "; ";
        text += error.name;
    }
    text
}

/// A contact that crossed a limit.
pub fn contact_text(contact: &ContactEvent) -> String {
    let taxel = taxel_name(contact.taxel);
    let limit = contact.crossed_n.map_or(String::new(), |n| format!(" over {} N", number(n, 0)));
    let reaction = contact.reaction.map_or(String::new(), |r| format!(", {}", r.name()));
    format!("{taxel}: {} contact{limit}, {} N{reaction}", contact.kind.name(), number(contact.peak_n, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(number(-0.04, 1), "0.0");
        assert_eq!(number(-1.25, 2), "−1.25");
        assert_eq!(number(12.0, 0), "12");
        assert_eq!(number(f64::NAN, 1), "–");
    }
}

//! Numbers and states as text.

use moca_msgs::SpeedLimitReason;

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

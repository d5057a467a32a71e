//! The scripted hand of the simulated robot: presses taxels in turn, as a function of time alone.

use moca_control::config::HandConfig;

/// Ramps at both ends of a press, s, as in the paper's experiments.
const RAMP_S: f64 = 0.3;

/// Force of one press, N, `t_s` after its start: ramp, hold, ramp.
fn press_profile(t_s: f64, hold_s: f64, force_n: f64) -> f64 {
    let rise = t_s / RAMP_S;
    let fall = (RAMP_S + hold_s + RAMP_S - t_s) / RAMP_S;
    force_n * rise.min(fall).clamp(0.0, 1.0)
}

/// Which taxel (0 is T1) the scripted hand presses at `t_s`, and how hard, N.
pub(crate) fn scripted_press(hand: &HandConfig, t_s: f64) -> Option<(usize, f64)> {
    // The first press comes after half an interval: time to tare and to be seen standing still.
    let since_first_s = t_s - 0.5 * hand.every_s;
    if hand.taxels.is_empty() || since_first_s < 0.0 {
        return None;
    }
    let press = (since_first_s / hand.every_s).floor();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small whole number, checked ≥ 0"
    )]
    let taxel = hand.taxels[press as usize % hand.taxels.len()].checked_sub(1)?;
    let force_n = press_profile(since_first_s - press * hand.every_s, hand.hold_s, hand.force_n);
    (force_n > 0.0).then_some((taxel, force_n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presses_ramp_hold_and_let_go_in_turn() {
        let hand = HandConfig { taxels: vec![6, 2], force_n: 20.0, every_s: 6.0, hold_s: 2.0 };
        assert_eq!(scripted_press(&hand, 2.9), None);
        let (taxel, force_n) = scripted_press(&hand, 3.15).unwrap();
        assert!(taxel == 5 && (force_n - 10.0).abs() < 1e-9);
        assert_eq!(scripted_press(&hand, 4.0), Some((5, 20.0)));
        assert_eq!(scripted_press(&hand, 5.7), None);
        assert_eq!(scripted_press(&hand, 10.0), Some((1, 20.0)));
        assert_eq!(scripted_press(&HandConfig::none(), 10.0), None);
    }
}

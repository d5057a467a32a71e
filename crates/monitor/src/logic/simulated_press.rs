//! A hand that presses a simulated taxel slowly, as a calibration asks for.

/// Force at the deepest point of a press, N.
pub const PEAK_N: f64 = 80.0;
/// From one press to the next, s.
pub const PERIOD_S: f64 = 6.0;

/// Force of the hand `t_s` after it began, N: rises and falls without a corner, in steps of 1 N so that a request is
/// sent only when it changes.
pub fn slow_press_n(t_s: f64) -> f64 {
    let phase = (t_s.max(0.0) / PERIOD_S).fract() * std::f64::consts::TAU;
    (PEAK_N * 0.5 * (1.0 - phase.cos())).round()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_presses_slowly_and_lets_go() {
        for (t_s, force_n) in [(-1.0, 0.0), (0.0, 0.0), (3.0, 80.0), (6.0, 0.0), (9.0, 80.0)] {
            assert!((slow_press_n(t_s) - force_n).abs() < 1e-9, "{t_s}");
        }
        let steepest = (0..6000).map(|ms| f64::from(ms) * 1e-3);
        let steepest = steepest.map(|t| (slow_press_n(t + 0.1) - slow_press_n(t)).abs()).fold(0.0, f64::max);
        assert!(steepest < 6.0, "{steepest} N in 0.1 s");
    }
}

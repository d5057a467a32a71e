//! The axis of time that every plot shares: rolling or held, and how much of it is shown.

use crate::logic::limited::Limited;
use std::ops::Range;

/// Shortest and longest stretch that can be shown, s.
pub const SPAN_S: Range<f64> = 0.01..60.0;

/// Which stretch of loop time is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeAxis {
    span_s: f64,
    /// End of the stretch while it is held, s of loop time; `None` follows the newest sample.
    held_at_s: Option<f64>,
}

impl Default for TimeAxis {
    fn default() -> Self {
        Self { span_s: 10.0, held_at_s: None }
    }
}

impl TimeAxis {
    /// Length of the stretch, s.
    pub fn span_s(&self) -> f64 {
        self.span_s
    }

    /// End of the stretch, s of loop time; `newest_s` is that of the newest sample.
    pub fn end_s(&self, newest_s: f64) -> f64 {
        self.held_at_s.unwrap_or(newest_s)
    }

    /// The stretch, s of loop time.
    pub fn window_s(&self, newest_s: f64) -> Range<f64> {
        self.end_s(newest_s) - self.span_s..self.end_s(newest_s)
    }

    /// Returns true if it stands still.
    pub fn held(&self) -> bool {
        self.held_at_s.is_some()
    }

    /// Shows the last `span_s`, or as much before the held end.
    pub fn show(&mut self, span_s: f64) {
        if span_s.is_finite() {
            self.span_s = span_s.limited(SPAN_S.start, SPAN_S.end);
        }
    }

    /// Stands still at `at_s`.
    pub fn hold(&mut self, at_s: f64) {
        self.held_at_s = Some(at_s);
    }

    /// Follows the newest sample.
    pub fn follow(&mut self) {
        self.held_at_s = None;
    }

    /// Shows `factor` times as much. Held, the instant `about_s` stays where it is; rolling, the newest end does.
    pub fn zoom(&mut self, factor: f64, about_s: f64) {
        let before_s = self.span_s;
        self.show(before_s * factor);
        if let Some(end_s) = &mut self.held_at_s {
            *end_s = about_s + (*end_s - about_s) * self.span_s / before_s;
        }
    }

    /// Moves by `by_s` and stands still there, inside what is kept (`kept_s`).
    pub fn pan(&mut self, by_s: f64, kept_s: Range<f64>) {
        let end_s = self.end_s(kept_s.end) + by_s;
        self.held_at_s = Some(end_s.limited(kept_s.start.min(kept_s.end), kept_s.end));
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values are copied or exact in binary")]
mod tests {
    use super::*;

    #[test]
    fn it_rolls_until_it_is_held_and_follows_again() {
        let mut axis = TimeAxis::default();
        assert_eq!(axis.window_s(30.0), 20.0..30.0);
        axis.hold(30.0);
        assert_eq!(axis.window_s(40.0), 20.0..30.0);
        axis.follow();
        assert_eq!(axis.window_s(40.0), 30.0..40.0);
    }

    #[test]
    fn zooming_keeps_the_instant_under_the_mouse_and_stays_in_range() {
        let mut axis = TimeAxis::default();
        axis.hold(30.0);
        axis.zoom(0.5, 22.0);
        assert_eq!(axis.window_s(99.0), 21.0..26.0, "22 s was a fifth from the left and still is");
        axis.zoom(1e9, 22.0);
        assert_eq!(axis.span_s(), SPAN_S.end);
        axis.zoom(0.0, 22.0);
        assert_eq!(axis.span_s(), SPAN_S.start);
        axis.zoom(f64::NAN, 22.0);
        assert_eq!(axis.span_s(), SPAN_S.start);
    }

    #[test]
    fn a_rolling_axis_zooms_to_its_newest_end() {
        let mut axis = TimeAxis::default();
        axis.zoom(0.5, 3.0);
        assert_eq!(axis.window_s(30.0), 25.0..30.0);
    }

    #[test]
    fn panning_holds_and_never_leaves_what_is_kept() {
        let mut axis = TimeAxis::default();
        axis.pan(-2.0, 5.0..30.0);
        assert_eq!(axis.end_s(99.0), 28.0);
        axis.pan(-1e6, 5.0..30.0);
        assert_eq!(axis.end_s(99.0), 5.0);
        axis.pan(1e6, 5.0..30.0);
        assert_eq!(axis.end_s(99.0), 30.0);
    }
}

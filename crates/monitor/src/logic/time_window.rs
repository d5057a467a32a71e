//! The part of a log that the strip shows: a stretch of time inside the whole log, whatever rounding does.

use super::limited::Limited;
use std::ops::Range;

/// Shortest stretch that the strip shows, s: the plots show what is shorter.
pub const SHORTEST_S: f64 = 60.0;
/// Shortest log, s: a stretch without length has no scale.
const LEAST_S: f64 = 1e-3;
/// Share of the log from which on all of it is shown.
const ALL: f64 = 0.999;

/// Returns the whole log from its first and last instant, s, with a length above zero.
pub fn whole(first_s: f64, last_s: f64) -> Range<f64> {
    // A late instant is so coarse that a millisecond may round to nothing.
    let least_s = LEAST_S.max(first_s.abs() * 4.0 * f64::EPSILON);
    first_s..last_s.max(first_s + least_s)
}

/// Returns what is shown after a zoom by `factor` (above 1: more) about the instant `about_s`; `None` is the whole log.
pub fn zoomed(shown: &Range<f64>, whole: &Range<f64>, about_s: f64, factor: f64) -> Option<Range<f64>> {
    let (length_s, all_s) = (shown.end - shown.start, whole.end - whole.start);
    let wanted_s = (length_s * factor).limited(SHORTEST_S.min(all_s), all_s);
    let start = about_s - (about_s - shown.start) * wanted_s / length_s;
    let start = start.limited(whole.start, whole.end - wanted_s);
    (wanted_s < ALL * all_s).then(|| start..(start + wanted_s).min(whole.end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Any instant of loop time that a log can hold, s.
    fn instant() -> impl Strategy<Value = f64> {
        (any::<u64>(), 0_u32..64).prop_map(|(ns, shift)| moca_msgs::seconds(ns >> shift))
    }

    proptest! {
        #[test]
        fn any_zoom_of_any_log_stays_inside_it(
            ends in (instant(), instant()),
            part in (0.0..=1.0_f64, 0.0..=1.0_f64, -2.0..=3.0_f64),
            factor in prop_oneof![1e-6..1e6_f64, Just(f64::NAN), Just(f64::INFINITY), Just(0.0)],
        ) {
            let all = whole(ends.0.min(ends.1), ends.0.max(ends.1));
            let length_s = all.end - all.start;
            prop_assert!(length_s > 0.0);
            let shown = all.start + part.0 * part.1 * length_s..all.start + part.0.max(part.1) * length_s;
            let shown = if shown.end > shown.start { shown } else { all.clone() };
            if let Some(next) = zoomed(&shown, &all, all.start + part.2 * length_s, factor) {
                prop_assert!(next.start >= all.start && next.end <= all.end, "{next:?} of {all:?}");
                prop_assert!(next.end > next.start, "{next:?} of {all:?}");
            }
        }
    }

    /// Regression test: `end − (end − start)` below `start` was the upper bound of a clamp, and the window died.
    #[test]
    fn bounds_that_rounding_crosses_give_the_whole_log() {
        let crossed = (1..10_000_u64)
            .map(|i| whole(moca_msgs::seconds(i * 123_456_789), moca_msgs::seconds(i * 987_654_321)));
        let crossed: Vec<_> = crossed.filter(|all| all.end - (all.end - all.start) < all.start).collect();
        assert!(crossed.len() > 100, "{}", crossed.len());
        for all in crossed {
            assert_eq!(zoomed(&all, &all, all.start, 1.0), None);
        }
    }
}

//! Bounds of the online trajectory generator, for any targets at any time.
#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "tests")]

use moca_wbc::online_trajectory::{Axis, AxisBounds};
use proptest::prelude::*;

const DT_S: f64 = 1e-3;

fn any_bounds() -> impl Strategy<Value = AxisBounds> {
    (0.05..2.0, 0.2..10.0, 2.0..500.0).prop_map(|(velocity, acceleration, jerk): (f64, f64, f64)| {
        // an acceleration that a step of jerk reaches at once bounds nothing
        AxisBounds { velocity, acceleration: acceleration.max(2.0 * jerk * DT_S), jerk }
    })
}

/// Checks one step; what is above a bound is rounding.
fn held(before: &Axis, after: &Axis, bounds: &AxisBounds) {
    let jerk = (after.acceleration - before.acceleration) / DT_S;
    assert!(jerk.abs() <= bounds.jerk * (1.0 + 1e-9), "jerk {jerk} of {}", bounds.jerk);
    assert!(after.acceleration.abs() <= bounds.acceleration * (1.0 + 1e-12), "{after:?}");
    assert!(after.velocity.abs() <= bounds.velocity * (1.0 + 1e-12), "{after:?} of {}", bounds.velocity);
    assert!((after.position - before.position - after.velocity * DT_S).abs() < 1e-12);
}

proptest! {
    #[test]
    fn no_bound_is_passed_whatever_is_asked_and_whenever(
        bounds in any_bounds(),
        targets in prop::collection::vec((any::<bool>(), -1.0..1.0, 1..300_usize), 1..40),
    ) {
        let mut axis = Axis::at_rest(0.0);
        for (to_position, target, steps) in targets {
            for _ in 0..steps {
                let before = axis;
                if to_position {
                    axis.step_to_position(target - axis.position, &bounds, DT_S);
                } else {
                    axis.step_to_velocity(3.0 * target * bounds.velocity, &bounds, DT_S);
                }
                held(&before, &axis, &bounds);
            }
        }
    }

    #[test]
    fn from_any_motion_it_ends_at_the_target_and_from_rest_never_beyond(
        bounds in any_bounds(),
        first in -1.0..1.0,
        steps in 0..600_usize,
        target in -1.0..1.0,
    ) {
        let mut axis = Axis::at_rest(0.0);
        (0..steps).for_each(|_| axis.step_to_position(first - axis.position, &bounds, DT_S));
        let from_rest = steps == 0;
        // the longest way, there and back, at half the speed and with room to speed up
        let longest = 8.0 / bounds.velocity + 8.0 * (bounds.velocity / bounds.acceleration + bounds.acceleration / bounds.jerk);
        let mut left = (longest / DT_S) as usize;
        let mut beyond = 0.0_f64;
        while !axis.rests_at(target) {
            axis.step_to_position(target - axis.position, &bounds, DT_S);
            beyond = beyond.max((axis.position - target) * target.signum());
            left = left.checked_sub(1).expect("it never arrives");
        }
        if from_rest {
            prop_assert!(beyond <= 1e-6 + bounds.acceleration * DT_S * DT_S, "{beyond} m beyond");
        }
    }

    #[test]
    fn a_velocity_is_reached_without_overshoot_and_kept(bounds in any_bounds(), wanted in -1.0..1.0) {
        let wanted: f64 = wanted * bounds.velocity;
        let mut axis = Axis::at_rest(0.0);
        let quickest_s = wanted.abs() / bounds.acceleration + bounds.acceleration / bounds.jerk;
        for step in 0.. {
            axis.step_to_velocity(wanted, &bounds, DT_S);
            prop_assert!(axis.velocity.abs() <= wanted.abs() * (1.0 + 1e-12));
            if axis.velocity == wanted { break; }
            prop_assert!(f64::from(step) * DT_S <= quickest_s + 3.0 * DT_S, "slow");
        }
        (0..10).for_each(|_| axis.step_to_velocity(wanted, &bounds, DT_S));
        prop_assert_eq!(axis.velocity, wanted);
    }
}

#[test]
fn a_stop_takes_the_way_that_was_said() {
    let bounds = AxisBounds { velocity: 0.5, acceleration: 1.0, jerk: 20.0 };
    for steps in [10, 60, 200, 700] {
        let mut axis = Axis::at_rest(0.0);
        (0..steps).for_each(|_| axis.step_to_velocity(0.5, &bounds, DT_S));
        let said = axis.position + axis.stopping_way(&bounds);
        while !axis.rests() {
            axis.step_to_velocity(0.0, &bounds, DT_S);
        }
        // said for continuous time; in steps it is shorter by a step at most
        let shorter = said - axis.position;
        assert!((0.0..=0.5 * DT_S + 1e-12).contains(&shorter), "{} where {said} was said", axis.position);
    }
}

//! Bounds of the online trajectory generator, for any targets at any time.
#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "tests")]

use moca_wbc::online_trajectory::{Axis, AxisBounds};
use moca_wbc::reference_generator::{Goal, PoseGenerator, ReferenceBounds, Workspace};
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{
    ControlInput, ControlLaw, ImpedanceGains, Parameters, Payload, RobotState, Target, TwistAxes,
    WholeBodyController, rotation,
};
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
    fn trajectory_ends_at_target_and_never_overshoots(
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
        let mut left_s = longest;
        let mut beyond = 0.0_f64;
        while !axis.rests_at(target) {
            axis.step_to_position(target - axis.position, &bounds, DT_S);
            beyond = beyond.max((axis.position - target) * target.signum());
            left_s -= DT_S;
            assert!(left_s > 0.0, "it never arrives");
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

fn any_goal() -> impl Strategy<Value = (bool, [f64; 6], [f64; 4])> {
    let numbers = prop::array::uniform6(-1.0..1.0);
    (any::<bool>(), numbers, prop::array::uniform4(-1.0..1.0_f64))
        .prop_filter("no rotation", |(_, _, q)| q.iter().map(|q| q * q).sum::<f64>() > 0.01)
}

fn goal((pose, numbers, q): (bool, [f64; 6], [f64; 4])) -> Goal {
    let [x, y, z, ..] = numbers;
    if pose {
        let norm = q.iter().map(|q| q * q).sum::<f64>().sqrt();
        Goal::pose([x, y, z], q.map(|q| q / norm)).unwrap()
    } else {
        Goal::twist(numbers).unwrap()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Poses and twists, 10 to 100 a second, on R³ and on SO(3).
    #[test]
    fn a_pose_keeps_its_bounds_and_ends_at_the_last_target(
        goals in prop::collection::vec((any_goal(), 10..100_usize), 1..30),
        last in any_goal(),
    ) {
        let bounds = ReferenceBounds::DEFAULT;
        let mut generator = PoseGenerator::at_rest([0.0; 3], [0.0, 0.0, 0.0, 1.0]).unwrap();
        let mut acceleration = [0.0; 6];
        let mut step = |generator: &mut PoseGenerator, goal: &Goal| {
            let before = *generator;
            generator.step(goal, &bounds, DT_S);
            let (was, is) = (before.twist(), generator.twist());
            for i in 0..6 {
                let bounds = if i < 3 { &bounds.linear } else { &bounds.angular };
                let now = (is[i] - was[i]) / DT_S;
                assert!(is[i].abs() <= bounds.velocity * (1.0 + 1e-9));
                assert!(now.abs() <= bounds.acceleration * (1.0 + 1e-9));
                assert!((now - acceleration[i]).abs() <= bounds.jerk * DT_S * (1.0 + 1e-6));
                acceleration[i] = now;
            }
            let turned = rotation::error(before.rotation(), generator.rotation()) / DT_S;
            assert!((0..3).all(|i| (turned[i] - is[i + 3]).abs() < 1e-9), "the rotation turns as its twist says");
        };
        for (numbers, steps) in goals {
            let goal = goal(numbers);
            (0..steps).for_each(|_| step(&mut generator, &goal));
        }
        let last = goal((true, last.1, last.2));
        let mut left = 40_000;
        while !generator.has_reached(&last) {
            step(&mut generator, &last);
            left -= 1;
            prop_assert!(left > 0, "it never arrives: {generator:?}");
        }
        let r = generator.rotation();
        prop_assert!((r * r.transpose() - nalgebra::Matrix3::identity()).amax() < 1e-12);
    }
}

#[test]
fn what_is_no_number_or_no_rotation_is_no_goal() {
    assert!(Goal::<f64>::twist([0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0]).is_err());
    assert!(Goal::<f64>::pose([f64::INFINITY, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).is_err());
    assert!(Goal::<f64>::pose([0.0; 3], [0.0, 0.0, 0.0, 0.9]).is_err());
    assert!(PoseGenerator::<f64>::at_rest([0.0; 3], [0.0; 4]).is_err());
}

fn of(parameters: &Parameters<7>) -> WholeBodyController<7, 11> {
    WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, parameters).unwrap()
}

#[test]
fn law_is_led_on_a_leash_within_its_workspace() {
    let stiff = Parameters::<7>::PAPER;
    let controller: WholeBodyController<7, 11> = of(&stiff);
    let soft = ImpedanceGains { stiffness: stiff.gains.stiffness.map(|k| 0.01 * k), ..stiff.gains };
    let soft: WholeBodyController<7, 11> = of(&Parameters { gains: soft, ..stiff });
    let robot = RobotState::at_rest(PANDA.home_rad);
    let mut input = ControlInput::new(robot, [0.0; 11], DT_S);
    input.flange_wrench_world = Some([0.0; 6]);
    let bounds = ReferenceBounds::DEFAULT;
    let lead = |controller: &WholeBodyController<7, 11>,
                law: ControlLaw,
                target: &Target<7>,
                workspace: Option<&Workspace>| {
        let mut state = controller.enter(law, &robot).unwrap();
        state.lead(target, &robot, &bounds, workspace).unwrap();
        let mut output = controller.step(law, &mut state, &input).unwrap();
        let start = output.flange.position_world;
        for _ in 0..3000 {
            output = controller.step(law, &mut state, &input).unwrap();
        }
        let wanted = output.flange_desired.position_world;
        [0, 1, 2].map(|i| wanted[i] - start[i])
    };
    let up = Target::Twist { axes: TwistAxes::World, twist: [0.0, 0.0, 0.1, 0.0, 0.0, 0.0] };
    for law in [ControlLaw::Impedance, ControlLaw::FollowMe] {
        // the arm of this test does not move: the reference waits at the end of its leash
        let [_, _, z] = lead(&soft, law, &up, None);
        assert!((0.9 * bounds.leash_m..=bounds.leash_m + 1e-9).contains(&z), "{law:?}: {z}");
        // or sooner, where the law's spring would bring it there faster than joints are led
        let [_, _, stiff] = lead(&controller, law, &up, None);
        assert!((0.5 * z..0.9 * z).contains(&stiff), "{law:?}: {stiff}");
        let state = controller.enter(law, &robot).unwrap();
        let at = controller.step(law, &mut state.clone(), &input).unwrap().flange.position_world;
        let reach_m = Workspace { shoulder_base_m: [at[0], at[1], 0.0], reach_m: 0.0, base_size_m: [0.1; 3] };
        let workspace = Workspace { reach_m: reach_m.distance(&at) + 0.02, ..reach_m };
        let [_, _, z] = lead(&controller, law, &up, Some(&workspace));
        assert!((0.015..=0.02 + 1e-9).contains(&z), "{law:?}: {z}");
    }
    let mut state = controller.enter(ControlLaw::Impedance, &robot).unwrap();
    let bad = Target::Twist { axes: TwistAxes::World, twist: [f64::NAN; 6] };
    let before = state;
    assert!(state.lead(&bad, &robot, &bounds, None).is_err());
    assert!(state.lead_base([f64::NAN, 0.0, 0.0]).is_err());
    assert_eq!(state, before, "a refused target leaves no trace");

    let mut state = controller.enter(ControlLaw::FollowMe, &robot).unwrap();
    state.lead_base([0.2, 0.0, 0.0]).unwrap();
    let mut velocity = [0.0; 3];
    for _ in 0..1000 {
        velocity =
            controller.step(ControlLaw::FollowMe, &mut state, &input).unwrap().command.base_velocity_body;
    }
    assert!((velocity[0] - 0.2).abs() < 1e-9, "{velocity:?}");
    // a hand in front: what the admittance would do alone is added
    input.taxel_force_n[5] = 8.0;
    for _ in 0..2000 {
        velocity =
            controller.step(ControlLaw::FollowMe, &mut state, &input).unwrap().command.base_velocity_body;
    }
    let alone =
        8.0 * Parameters::<7>::PAPER.gains.reactivity / Parameters::<7>::PAPER.gains.virtual_damping[0];
    assert!((velocity[0] - (0.2 - alone)).abs() < 1e-3, "{velocity:?} and {alone}");
}

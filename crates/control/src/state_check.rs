//! The check of the robot's state: nothing that is old, not a number or not possible reaches a controller.

use crate::plant::SourceAge;
use crate::robot::JOINTS;
use core::f64::consts::{PI, TAU};
use moca_msgs::{Fault, RobotState};
use serde::{Deserialize, Serialize};

/// No joint turns faster, rad/s (a Panda's fastest joint: 2.61), and no jump below the second number is one, rad.
const JOINT_RATE_MAX: (f64, f64) = (20.0, 0.05);
/// No base drives faster, m/s, m.
const BASE_SPEED_MAX: (f64, f64) = (5.0, 0.05);
/// Nor turns faster, rad/s, rad.
const BASE_RATE_MAX: (f64, f64) = (10.0, 0.1);

/// Remembers the last state let in.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct StateCheck {
    last: Option<RobotState<JOINTS>>,
    /// The base's part of `last` is one that was held.
    base_held: bool,
}

/// A state that may be commanded with, or none; and what is wrong.
#[derive(Debug, PartialEq)]
pub struct Checked<'a> {
    /// Whatever it is, nothing in it is old, not a number or impossible. With [`Fault::BaseStale`] the base's part is the
    /// last known, at rest: the arm can be held with it, the base must not be driven.
    pub state: Option<&'a mut RobotState<JOINTS>>,
    /// Fault for the supervisor.
    pub fault: Option<Fault>,
}

impl Checked<'_> {
    /// No state, for this reason.
    pub const fn none(fault: Fault) -> Self {
        Self { state: None, fault: Some(fault) }
    }
}

impl StateCheck {
    /// Lets `state` in, measured `dt_s` after the last one; it stays where it is, because it is large. What comes after a
    /// stale one is compared with nothing: the robot may have been moved meanwhile, and a law starts from where it is.
    /// [`Fault::ArmStale`] and [`Fault::BaseStale`] are beyond `deadlines`, [`Fault::StateInvalid`] is a value that is not
    /// finite or a jump that no robot makes.
    pub fn check<'a>(
        &mut self,
        state: &'a mut RobotState<JOINTS>,
        age: SourceAge,
        deadlines: SourceAge,
        dt_s: f64,
    ) -> Checked<'a> {
        let fresh = |age_s: f64, deadline_s: f64| age_s <= deadline_s; // an age that is not a number is none
        if !fresh(age.arm_s, deadlines.arm_s) {
            self.last = None;
            return Checked::none(Fault::ArmStale);
        }
        let base_held = !fresh(age.base_s, deadlines.base_s);
        if base_held {
            state.base_pose_world = self.last.as_ref().map_or([0.0; 3], |last| last.base_pose_world);
            state.base_velocity_world = [0.0; 3];
        }
        let jumped = |last: &RobotState<JOINTS>| {
            let same_source = self.base_held == base_held;
            joints_jumped(last, state, dt_s) || same_source && base_jumped(last, state, dt_s)
        };
        if !finite(state) || self.last.as_ref().is_some_and(jumped) {
            return Checked::none(Fault::StateInvalid);
        }
        (self.last, self.base_held) = (Some(*state), base_held);
        Checked { state: Some(state), fault: base_held.then_some(Fault::BaseStale) }
    }
}

fn finite(state: &RobotState<JOINTS>) -> bool {
    // no early return: several at once
    let all = |values: &[f64]| values.iter().fold(true, |finite, value| finite & value.is_finite());
    all(&state.base_pose_world)
        && all(&state.base_velocity_world)
        && all(&state.q_rad)
        && all(&state.dq_rad_s)
        && all(&state.torque_measured_nm)
        && state.flange_wrench_world.as_ref().is_none_or(|wrench| all(wrench))
}

fn beyond(moved: f64, (rate, jump): (f64, f64), dt_s: f64) -> bool {
    moved.abs() > rate * dt_s + jump
}

fn joints_jumped(last: &RobotState<JOINTS>, now: &RobotState<JOINTS>, dt_s: f64) -> bool {
    let joints = now.q_rad.iter().zip(&last.q_rad);
    joints.fold(false, |jumped, (now, last)| jumped | beyond(now - last, JOINT_RATE_MAX, dt_s))
}

fn base_jumped(last: &RobotState<JOINTS>, now: &RobotState<JOINTS>, dt_s: f64) -> bool {
    let [x, y, yaw] = core::array::from_fn(|i| now.base_pose_world[i] - last.base_pose_world[i]);
    // A full turn between two states is the same pose.
    let turned = if yaw.abs() <= PI { yaw } else { (yaw + PI).rem_euclid(TAU) - PI };
    beyond((x * x + y * y).sqrt(), BASE_SPEED_MAX, dt_s) || beyond(turned, BASE_RATE_MAX, dt_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRESH: SourceAge = SourceAge { arm_s: 0.0, base_s: 0.0 };
    const DEADLINES: SourceAge = SourceAge { arm_s: 0.01, base_s: 0.1 };

    impl StateCheck {
        /// The state that may be commanded with, where nothing is wrong with it.
        fn good(
            &mut self,
            mut state: RobotState<JOINTS>,
            age: SourceAge,
            dt_s: f64,
        ) -> Result<RobotState<JOINTS>, Fault> {
            let checked = self.check(&mut state, age, DEADLINES, dt_s);
            assert_eq!(checked.state.is_none(), !matches!(checked.fault, None | Some(Fault::BaseStale)));
            checked.fault.map_or(Ok(state), Err)
        }
    }

    fn state() -> RobotState<JOINTS> {
        RobotState::at_rest([0.0; JOINTS])
    }

    #[test]
    fn motion_passes_and_jumps_do_not() {
        let mut states = StateCheck::default();
        states.good(state(), FRESH, 1e-3).unwrap();
        let mut moved = state();
        moved.q_rad[3] = 0.04;
        moved.base_pose_world = [0.03, 0.03, TAU + 0.05];
        states.good(moved, FRESH, 1e-3).unwrap();
        moved.q_rad[3] = 0.14;
        assert_eq!(states.good(moved, FRESH, 1e-3), Err(Fault::StateInvalid));
        assert!(states.good(moved, FRESH, 0.1).is_ok(), "the same way in a longer time is a motion");
        moved.base_pose_world[0] += 0.2;
        assert_eq!(states.good(moved, FRESH, 1e-3), Err(Fault::StateInvalid));
    }

    #[test]
    fn a_jump_is_measured_from_where_the_robot_was() {
        let mut states = StateCheck::default();
        let far = RobotState { base_pose_world: [5.0, -4.0, 2.0], q_rad: [1.5; JOINTS], ..state() };
        states.good(far, FRESH, 1e-3).unwrap();
        assert!(states.good(far, FRESH, 1e-3).is_ok(), "it stands still");
        let back = RobotState { q_rad: [-1.5; JOINTS], ..far };
        assert_eq!(states.good(back, FRESH, 1e-3), Err(Fault::StateInvalid));
        let back = RobotState { base_pose_world: [-5.0, 4.0, -2.0], ..far };
        assert_eq!(states.good(back, FRESH, 1e-3), Err(Fault::StateInvalid));
    }

    #[test]
    fn what_stands_at_a_bound_is_still_let_in() {
        let mut states = StateCheck::default();
        assert!(states.good(state(), DEADLINES, 1e-3).is_ok());
        let mut moved = state();
        moved.q_rad[0] = JOINT_RATE_MAX.1;
        assert!(
            states.good(moved, FRESH, 0.0).is_ok(),
            "no more than that is no jump, however short the time"
        );
        moved.q_rad[0] *= 2.001;
        assert_eq!(states.good(moved, FRESH, 0.0), Err(Fault::StateInvalid));
    }

    #[test]
    fn robot_moved_while_stale_is_taken_where_it_is() {
        let mut states = StateCheck::default();
        states.good(state(), FRESH, 1e-3).unwrap();
        assert_eq!(states.good(state(), SourceAge { arm_s: 0.0, base_s: 0.2 }, 1e-3), Err(Fault::BaseStale));
        let mut moved = state();
        moved.base_pose_world = [1.0, -2.0, 0.7];
        states.good(moved, FRESH, 1e-3).unwrap();
        assert_eq!(states.good(moved, SourceAge { arm_s: 0.2, base_s: 0.0 }, 1e-3), Err(Fault::ArmStale));
        (moved.base_pose_world[0], moved.q_rad[2]) = (2.0, 0.4);
        assert!(states.good(moved, FRESH, 1e-3).is_ok(), "no restart for that");
        moved.base_pose_world[0] += 0.2;
        assert_eq!(
            states.good(moved, FRESH, 1e-3),
            Err(Fault::StateInvalid),
            "from there on jumps are jumps"
        );
    }

    #[test]
    fn what_is_not_a_number_or_too_old_is_named() {
        let mut states = StateCheck::default();
        let arm = SourceAge { arm_s: 2.0 * DEADLINES.arm_s, base_s: 0.0 };
        assert_eq!(states.good(state(), arm, 1e-3), Err(Fault::ArmStale));
        let base = SourceAge { arm_s: 0.0, base_s: 2.0 * DEADLINES.base_s };
        assert_eq!(states.good(state(), base, 1e-3), Err(Fault::BaseStale));
        let (arm, base) =
            (SourceAge { arm_s: f64::NAN, base_s: 0.0 }, SourceAge { arm_s: 0.0, base_s: f64::NAN });
        assert_eq!(states.good(state(), arm, 1e-3), Err(Fault::ArmStale));
        assert_eq!(states.good(state(), base, 1e-3), Err(Fault::BaseStale));
        let mut wrong = state();
        wrong.flange_wrench_world = Some([f64::NAN; 6]);
        assert_eq!(states.good(wrong, FRESH, 1e-3), Err(Fault::StateInvalid));
    }

    #[test]
    fn arm_is_held_at_last_known_pose_of_stale_base() {
        let mut states = StateCheck::default();
        let mut moving = state();
        (moving.base_pose_world, moving.base_velocity_world) = ([1.0, 2.0, 0.3], [0.4, 0.0, 0.1]);
        states.good(moving, FRESH, 1e-3).unwrap();
        let old = SourceAge { arm_s: 0.0, base_s: f64::INFINITY };
        moving.q_rad[1] = 0.02;
        moving.base_pose_world = [f64::NAN; 3];
        let mut measured = moving;
        let held = states.check(&mut measured, old, DEADLINES, 1e-3);
        assert_eq!(held.fault, Some(Fault::BaseStale));
        let held = held.state.unwrap();
        assert_eq!((held.base_pose_world, held.base_velocity_world), ([1.0, 2.0, 0.3], [0.0; 3]));
        assert_eq!((held.q_rad, held.dq_rad_s), (moving.q_rad, moving.dq_rad_s), "the arm's part is of now");
        moving.q_rad[1] = 0.5;
        assert_eq!(states.check(&mut { moving }, old, DEADLINES, 1e-3), Checked::none(Fault::StateInvalid));
        moving.q_rad[1] = 0.02;
        let unknown = StateCheck::default().check(&mut moving, old, DEADLINES, 1e-3).state.unwrap();
        assert_eq!(
            (unknown.base_pose_world, unknown.base_velocity_world),
            ([0.0; 3], [0.0; 3]),
            "it was never known"
        );
    }
}

//! The check of the robot's state: nothing that is old, not a number or not possible reaches a controller.

use crate::control::plant::SourceAge;
use crate::robot::JOINTS;
use core::f64::consts::{PI, TAU};
use moca_msgs::{Fault, RobotState};
use serde::{Deserialize, Serialize};

/// Oldest arm state that is controlled with, s: 10 periods of an arm's 1 kHz datagrams.
pub const ARM_DEADLINE_S: f64 = 0.010;
/// Oldest base state, s: five periods of 50 Hz odometry.
pub const BASE_DEADLINE_S: f64 = 0.100;
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
}

impl StateCheck {
    /// Lets `state` in, measured `dt_s` after the last one. What comes after a stale one is compared with nothing: the
    /// robot may have been moved meanwhile, and a law starts from where it is.
    ///
    /// # Errors
    /// [`Fault::ArmStale`] and [`Fault::BaseStale`] beyond their deadlines, [`Fault::StateInvalid`] for a value that is
    /// not finite or a jump that no robot makes.
    pub fn check(
        &mut self,
        state: RobotState<JOINTS>,
        age: SourceAge,
        dt_s: f64,
    ) -> Result<RobotState<JOINTS>, Fault> {
        let fresh = |age_s: f64, deadline_s: f64| age_s <= deadline_s; // an age that is not a number is none
        let stale = match (fresh(age.arm_s, ARM_DEADLINE_S), fresh(age.base_s, BASE_DEADLINE_S)) {
            (false, _) => Some(Fault::ArmStale),
            (true, false) => Some(Fault::BaseStale),
            (true, true) => None,
        };
        if let Some(fault) = stale {
            self.last = None;
            return Err(fault);
        }
        if !finite(&state) || self.last.is_some_and(|last| jumped(&last, &state, dt_s)) {
            return Err(Fault::StateInvalid);
        }
        self.last = Some(state);
        Ok(state)
    }
}

fn finite(state: &RobotState<JOINTS>) -> bool {
    let base = state.base_pose_world.iter().chain(&state.base_velocity_world);
    let arm = state.q_rad.iter().chain(&state.dq_rad_s).chain(&state.torque_measured_nm);
    let wrench = state.flange_wrench_world.iter().flatten();
    base.chain(arm).chain(wrench).all(|value| value.is_finite())
}

fn jumped(last: &RobotState<JOINTS>, now: &RobotState<JOINTS>, dt_s: f64) -> bool {
    let beyond = |moved: f64, (rate, jump): (f64, f64)| moved.abs() > rate * dt_s + jump;
    let [x, y, yaw] = core::array::from_fn(|i| now.base_pose_world[i] - last.base_pose_world[i]);
    // A full turn between two states is the same pose.
    let turned = (yaw + PI).rem_euclid(TAU) - PI;
    let joints = now.q_rad.iter().zip(last.q_rad).any(|(now, last)| beyond(now - last, JOINT_RATE_MAX));
    joints || beyond(x.hypot(y), BASE_SPEED_MAX) || beyond(turned, BASE_RATE_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRESH: SourceAge = SourceAge { arm_s: 0.0, base_s: 0.0 };

    fn state() -> RobotState<JOINTS> {
        RobotState {
            base_pose_world: [0.0; 3],
            base_velocity_world: [0.0; 3],
            q_rad: [0.0; JOINTS],
            dq_rad_s: [0.0; JOINTS],
            torque_measured_nm: [0.0; JOINTS],
            flange_wrench_world: None,
        }
    }

    #[test]
    fn motion_passes_and_jumps_do_not() {
        let mut states = StateCheck::default();
        states.check(state(), FRESH, 1e-3).unwrap();
        let mut moved = state();
        moved.q_rad[3] = 0.04;
        moved.base_pose_world = [0.03, 0.03, TAU + 0.05];
        states.check(moved, FRESH, 1e-3).unwrap();
        moved.q_rad[3] = 0.14;
        assert_eq!(states.check(moved, FRESH, 1e-3), Err(Fault::StateInvalid));
        assert!(states.check(moved, FRESH, 0.1).is_ok(), "the same way in a longer time is a motion");
        moved.base_pose_world[0] += 0.2;
        assert_eq!(states.check(moved, FRESH, 1e-3), Err(Fault::StateInvalid));
    }

    #[test]
    fn a_jump_is_measured_from_where_the_robot_was() {
        let mut states = StateCheck::default();
        let far = RobotState { base_pose_world: [5.0, -4.0, 2.0], q_rad: [1.5; JOINTS], ..state() };
        states.check(far, FRESH, 1e-3).unwrap();
        assert!(states.check(far, FRESH, 1e-3).is_ok(), "it stands still");
        let back = RobotState { q_rad: [-1.5; JOINTS], ..far };
        assert_eq!(states.check(back, FRESH, 1e-3), Err(Fault::StateInvalid));
        let back = RobotState { base_pose_world: [-5.0, 4.0, -2.0], ..far };
        assert_eq!(states.check(back, FRESH, 1e-3), Err(Fault::StateInvalid));
    }

    #[test]
    fn what_stands_at_a_bound_is_still_let_in() {
        let mut states = StateCheck::default();
        let oldest = SourceAge { arm_s: ARM_DEADLINE_S, base_s: BASE_DEADLINE_S };
        assert!(states.check(state(), oldest, 1e-3).is_ok());
        let mut moved = state();
        moved.q_rad[0] = JOINT_RATE_MAX.1;
        assert!(
            states.check(moved, oldest, 0.0).is_ok(),
            "less than that is no jump, however short the time"
        );
        moved.q_rad[0] *= 2.001;
        assert_eq!(states.check(moved, oldest, 0.0), Err(Fault::StateInvalid));
    }

    #[test]
    fn a_robot_that_was_moved_while_its_state_was_stale_is_taken_where_it_is() {
        let mut states = StateCheck::default();
        states.check(state(), FRESH, 1e-3).unwrap();
        assert_eq!(states.check(state(), SourceAge { arm_s: 0.0, base_s: 0.2 }, 1e-3), Err(Fault::BaseStale));
        let mut moved = state();
        (moved.base_pose_world, moved.q_rad[2]) = ([1.0, -2.0, 0.7], 0.4);
        assert!(states.check(moved, FRESH, 1e-3).is_ok(), "no restart for that");
        moved.base_pose_world[0] += 0.2;
        assert_eq!(
            states.check(moved, FRESH, 1e-3),
            Err(Fault::StateInvalid),
            "from there on jumps are jumps"
        );
    }

    #[test]
    fn what_is_not_a_number_or_too_old_is_named() {
        let mut states = StateCheck::default();
        let arm = SourceAge { arm_s: 2.0 * ARM_DEADLINE_S, base_s: 0.0 };
        assert_eq!(states.check(state(), arm, 1e-3), Err(Fault::ArmStale));
        let base = SourceAge { arm_s: 0.0, base_s: 2.0 * BASE_DEADLINE_S };
        assert_eq!(states.check(state(), base, 1e-3), Err(Fault::BaseStale));
        let (arm, base) =
            (SourceAge { arm_s: f64::NAN, base_s: 0.0 }, SourceAge { arm_s: 0.0, base_s: f64::NAN });
        assert_eq!(states.check(state(), arm, 1e-3), Err(Fault::ArmStale));
        assert_eq!(states.check(state(), base, 1e-3), Err(Fault::BaseStale));
        let mut wrong = state();
        wrong.flange_wrench_world = Some([f64::NAN; 6]);
        assert_eq!(states.check(wrong, FRESH, 1e-3), Err(Fault::StateInvalid));
    }
}

//! The error flags of an arm that speaks FCI, each with a sentence and what to do: bit 0 is the first.
//!
//! Names and order are those of `research_interface::robot::Error` (libfranka); sentences and remedies are ours.
//!
//! ```
//! use moca_msgs::arm_errors::set_in;
//!
//! let [error] = set_in(1 << 25).collect::<Vec<_>>()[..] else { panic!() };
//! assert_eq!(error.name, "communication_constraints_violation");
//! println!("{} {}", error.text, error.remedy);
//! ```

/// One error flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmError {
    /// The manufacturer's name of it.
    pub name: &'static str,
    /// One sentence for the person in front of the robot.
    pub text: &'static str,
    /// Remedy before the arm is recovered.
    pub remedy: &'static str,
}

/// Cause of an error about a motion that this program never asks for.
const NOT_OURS: &str = "This program asks for torques only: end the other program that controls the arm.";
const GUIDE_BACK: &str = "Guide the arm away from its limit with its guiding buttons.";
const FREE: &str = "Free anyone caught; see the collision thresholds in [plant.arm].";
const SLOWER: &str = "Lower the gains, or the speed with which the arm is led.";
const LINE: &str = "Check the network and this PC's real-time rights (`mocad doctor`).";
const MOUNT: &str = "Fix the arm's stand and check its orientation in Desk; restart its controller.";

macro_rules! errors {
    ($($name:literal, $text:literal, $remedy:expr;)*) => {
        /// Every flag, in the order of their bits.
        pub const ARM_ERRORS: &[ArmError] =
            &[$(ArmError { name: $name, text: $text, remedy: $remedy }),*];
    };
}

errors! {
    "joint_position_limits_violation", "A joint is beyond its range.", GUIDE_BACK;
    "cartesian_position_limits_violation", "The hand is beyond the workspace set in Desk.", GUIDE_BACK;
    "self_collision_avoidance_violation", "The arm is about to touch itself.", GUIDE_BACK;
    "joint_velocity_violation", "A joint moves too fast.", SLOWER;
    "cartesian_velocity_violation", "The hand is too fast.", SLOWER;
    "force_control_safety_violation", "The force controller left its safe range.", NOT_OURS;
    "joint_reflex", "A joint met more torque than its collision threshold.", FREE;
    "cartesian_reflex", "The hand met more force than its collision threshold.", FREE;
    "max_goal_pose_deviation_violation", "The hand is too far from the goal of a motion.", NOT_OURS;
    "max_path_pose_deviation_violation", "The hand is too far from the path of a motion.", NOT_OURS;
    "cartesian_velocity_profile_safety_violation", "The speed of a Cartesian motion left its safe range.", NOT_OURS;
    "joint_position_motion_generator_start_pose_invalid", "A joint motion did not begin where the arm is.", NOT_OURS;
    "joint_motion_generator_position_limits_violation", "A joint motion left the joints' range.", NOT_OURS;
    "joint_motion_generator_velocity_limits_violation", "A joint motion was too fast.", NOT_OURS;
    "joint_motion_generator_velocity_discontinuity", "The speed of a joint motion jumped.", NOT_OURS;
    "joint_motion_generator_acceleration_discontinuity", "The acceleration of a joint motion jumped.", NOT_OURS;
    "cartesian_position_motion_generator_start_pose_invalid", "A Cartesian motion did not begin where the hand is.",
        NOT_OURS;
    "cartesian_motion_generator_elbow_limit_violation", "A Cartesian motion moved the elbow beyond its range.", NOT_OURS;
    "cartesian_motion_generator_velocity_limits_violation", "A Cartesian motion was too fast.", NOT_OURS;
    "cartesian_motion_generator_velocity_discontinuity", "The speed of a Cartesian motion jumped.", NOT_OURS;
    "cartesian_motion_generator_acceleration_discontinuity", "The acceleration of a Cartesian motion jumped.", NOT_OURS;
    "cartesian_motion_generator_elbow_sign_inconsistent", "A Cartesian motion turned the elbow over.", NOT_OURS;
    "cartesian_motion_generator_start_elbow_invalid", "A Cartesian motion did not begin where the elbow is.", NOT_OURS;
    "force_controller_desired_force_tolerance_violation", "The force controller did not reach its force.", NOT_OURS;
    "start_elbow_sign_inconsistent", "A motion began with the elbow turned over.", NOT_OURS;
    "communication_constraints_violation", "Too many of our torques came late or not at all.", LINE;
    "power_limit_violation", "The arm used more power than it may.", SLOWER;
    "cartesian_motion_generator_joint_position_limits_violation", "A Cartesian motion led a joint beyond its range.",
        NOT_OURS;
    "cartesian_motion_generator_joint_velocity_limits_violation", "A Cartesian motion made a joint too fast.", NOT_OURS;
    "cartesian_motion_generator_joint_velocity_discontinuity", "A Cartesian motion made a joint's speed jump.", NOT_OURS;
    "cartesian_motion_generator_joint_acceleration_discontinuity",
        "A Cartesian motion made a joint's acceleration jump.", NOT_OURS;
    "cartesian_position_motion_generator_invalid_frame_flag", "A Cartesian motion gave an invalid pose.", NOT_OURS;
    "controller_torque_discontinuity", "Our torque jumped from one millisecond to the next.",
        "Report it with the log: the torque's rate is limited before it leaves this PC.";
    "joint_p2p_insufficient_torque_for_planning", "A planned joint motion needs more torque than there is.", NOT_OURS;
    "tau_J_range_violation", "A measured joint torque is beyond its range.", FREE;
    "instability_detected", "The arm found itself unstable.", SLOWER;
    "joint_move_in_wrong_direction", "A joint moved the other way than it was guided.", GUIDE_BACK;
    "cartesian_spline_motion_generator_violation", "A Cartesian spline left its limits.", NOT_OURS;
    "joint_via_motion_generator_planning_joint_limit_violation", "A planned joint motion leaves the joints' range.",
        NOT_OURS;
    "base_acceleration_initialization_timeout", "The arm did not find out how it is mounted.", MOUNT;
    "base_acceleration_invalid_reading", "The arm's sense of how it is mounted fails.", MOUNT;
}

/// The errors whose bits are set in `flags`; a bit beyond the last one is none.
pub fn set_in(flags: u64) -> impl Iterator<Item = &'static ArmError> {
    ARM_ERRORS.iter().enumerate().filter(move |(bit, _)| flags >> bit & 1 == 1).map(|(_, error)| error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_has_a_name_of_its_own_a_sentence_and_a_remedy() {
        assert_eq!(ARM_ERRORS.len(), 41);
        for (i, error) in ARM_ERRORS.iter().enumerate() {
            assert!(ARM_ERRORS[..i].iter().all(|other| other.name != error.name && other.text != error.text));
            for sentence in [error.text, error.remedy] {
                assert!(sentence.ends_with('.') && sentence.len() > 20, "{}: {sentence:?}", error.name);
            }
            let mut found = set_in(1 << i);
            assert_eq!((found.next(), found.next()), (Some(error), None));
        }
        assert_eq!(set_in(!0).count(), 41);
        assert_eq!(set_in(1 << 41).count() + set_in(0).count(), 0);
    }
}

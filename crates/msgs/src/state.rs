//! State that a plant measures, and commands to it.
//!
//! ```
//! use moca_msgs::robot::PANDA;
//! use moca_msgs::{Actuation, RobotCommand, RobotState};
//!
//! let measured = RobotState::at_rest(PANDA.home_rad);
//! let base_velocity_body = [0.1, 0.0, 0.0];
//! let command = RobotCommand { base_velocity_body, arm_torque_nm: [0.0; 7], arm_gravity_nm: [0.0; 7] };
//! // nothing is ordered on a state that is not a number
//! let fine = measured.q_rad.iter().all(|q| q.is_finite());
//! let order = if fine { Actuation::Drive(command) } else { Actuation::Brake };
//! assert_ne!(order, Actuation::Brake);
//! ```

use crate::robot::resized;

/// Measured state of base and arm at one instant. `T` is the scalar, `N` the number of arm joints.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(serialize = "T: serde::Serialize", deserialize = "T: serde::Deserialize<'de>"))
)]
pub struct RobotState<const N: usize, T = f64> {
    /// Pose of B in W: x m, y m, yaw rad.
    pub base_pose_world: [T; 3],
    /// Rate of `base_pose_world`: m/s, m/s, rad/s, world axes.
    pub base_velocity_world: [T; 3],
    /// Arm joint angles, rad.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub q_rad: [T; N],
    /// Arm joint rates, rad/s.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub dq_rad_s: [T; N],
    /// Joint torques the arm measures, gravity included, N·m.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub torque_measured_nm: [T; N],
    /// The robot's own estimate of the external wrench **on the robot** about the flange origin, world axes
    /// \[f N; m N·m\]; `None` where the robot gives none.
    pub flange_wrench_world: Option<[T; 6]>,
}

impl<const N: usize> RobotState<N> {
    /// A robot that stands at the origin of W with joint angles `q_rad`; nothing is known of torques and wrench.
    pub const fn at_rest(q_rad: [f64; N]) -> Self {
        Self {
            base_pose_world: [0.0; 3],
            base_velocity_world: [0.0; 3],
            q_rad,
            dq_rad_s: [0.0; N],
            torque_measured_nm: [0.0; N],
            flange_wrench_world: None,
        }
    }

    /// Every number rounded to the nearest that single precision has, 6e-8 of its size, and to a multiple of 2⁻²⁰, about a
    /// millionth of its unit: what is finer is noise of any sensor, and near zero single precision has no end of it.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "to the nearest single; what is too large becomes infinite"
    )]
    pub fn in_single_precision(&self) -> Self {
        const STEPS: f32 = 1_048_576.0;
        /// From here on singles are about as coarse.
        const COARSE: f32 = 4.0;
        fn single<const M: usize>(values: [f64; M]) -> [f64; M] {
            values.map(|value| {
                let single = value as f32;
                // Adding zero leaves no negative one.
                f64::from(if single.abs() < COARSE { nearest(single * STEPS) / STEPS + 0.0 } else { single })
            })
        }
        /// The nearest whole number to what is at most 2²², by adding what leaves no room for fractions: `no_std` has no `round`.
        fn nearest(value: f32) -> f32 {
            const WHOLE: f32 = 12_582_912.0;
            (value + WHOLE) - WHOLE
        }
        Self {
            base_pose_world: single(self.base_pose_world),
            base_velocity_world: single(self.base_velocity_world),
            q_rad: single(self.q_rad),
            dq_rad_s: single(self.dq_rad_s),
            torque_measured_nm: single(self.torque_measured_nm),
            flange_wrench_world: self.flange_wrench_world.map(single),
        }
    }
}

impl<const N: usize> RobotState<N> {
    /// Returns the state with room for another number of joints: cut or filled with zeros.
    pub const fn resized<const M: usize>(&self) -> RobotState<M> {
        RobotState {
            base_pose_world: self.base_pose_world,
            base_velocity_world: self.base_velocity_world,
            q_rad: resized(&self.q_rad),
            dq_rad_s: resized(&self.dq_rad_s),
            torque_measured_nm: resized(&self.torque_measured_nm),
            flange_wrench_world: self.flange_wrench_world,
        }
    }
}

impl<const N: usize> RobotCommand<N> {
    /// Returns the command with room for another number of joints: cut or filled with zeros.
    pub const fn resized<const M: usize>(&self) -> RobotCommand<M> {
        RobotCommand {
            base_velocity_body: self.base_velocity_body,
            arm_torque_nm: resized(&self.arm_torque_nm),
            arm_gravity_nm: resized(&self.arm_gravity_nm),
        }
    }
}

/// Commands of the controllers to the plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotCommand<const N: usize, T = f64> {
    /// Base velocity in the axes of B (a `cmd_vel`): m/s, m/s, rad/s.
    pub base_velocity_body: [T; 3],
    /// Joint torques **including** Coriolis and gravity terms, N·m.
    pub arm_torque_nm: [T; N],
    /// Share of gravity in them, N·m, but for that of an object in the hand: the back end of a robot that compensates gravity by itself
    /// subtracts it.
    pub arm_gravity_nm: [T; N],
}

/// One tick's order to a plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actuation<const N: usize, T = f64> {
    /// Follow this command.
    Drive(RobotCommand<N, T>),
    /// No command can be trusted: the base stops and the arm uses its own brake or reflex.
    Brake,
}

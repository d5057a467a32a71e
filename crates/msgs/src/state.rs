//! What a plant measures and what it is told.

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
}

/// What the controllers tell the plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotCommand<const N: usize, T = f64> {
    /// Base velocity in the axes of B (a `cmd_vel`): m/s, m/s, rad/s.
    pub base_velocity_body: [T; 3],
    /// Joint torques **including** Coriolis and gravity terms, N·m. A robot that compensates gravity by itself
    /// subtracts it in its back end.
    pub arm_torque_nm: [T; N],
}

/// One tick's order to a plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actuation<const N: usize, T = f64> {
    /// Follow this command.
    Drive(RobotCommand<N, T>),
    /// No command can be trusted: the base stops and the arm uses its own brake or reflex.
    Brake,
}

//! What a client must know once: who the robot is, its geometry, its limits.
//!
//! ```
//! use moca_telemetry::RobotDescription;
//! let robot = RobotDescription::paper("lab", true);
//! assert_eq!((robot.arm.joint_origin.len(), robot.taxels.len()), (7, 11));
//! assert_eq!(robot.taxels[5].position_base_m, [0.489, 0.0]); // T6, the middle of the front
//! ```

use crate::ParameterDescription;
use moca_msgs::{ArmTable, BaseTable, Limits, Mount, ParameterValues, TaxelPlacement};
use serde::{Deserialize, Serialize};

/// A robot as a client needs it: enough to draw base, arm and cover from a [`moca_msgs::Sample`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RobotDescription {
    /// Name of this robot, chosen by its owner.
    pub name: String,
    /// Whether the plant is a simulation, which can be pressed by request.
    pub simulated: bool,
    /// Period of the loop, s.
    pub period_s: f64,
    /// Length (x), width (y), height (z) of the base, m.
    pub base_size_m: [f64; 3],
    /// The arm.
    pub arm: ArmDescription,
    /// The taxels, T1 first.
    pub taxels: Vec<TaxelPlacement>,
    /// Oldest cover data the supervisor accepts, s.
    pub frame_deadline_s: f64,
    /// Largest force believed from one taxel, N.
    pub taxel_force_max_n: f64,
    /// Base speed limit along each axis of B: m/s, m/s, rad/s.
    pub base_velocity_max: [f64; 3],
    /// The schema of parameters with present values; a parameter's place here is its number in
    /// [`moca_msgs::Request::SetParameter`]. The controllers' come first, in the order of
    /// [`moca_msgs::params::CONTROLLER`].
    #[serde(default)]
    pub parameters: Vec<ParameterDescription>,
    /// Why the speed limit that the board's rate sets is overridden, in its owner's words; empty if it is not.
    #[serde(default)]
    pub speed_override: String,
    /// What a force is worth on a cover that has not been calibrated, in one sentence; empty if it has been.
    #[serde(default)]
    pub uncalibrated: String,
    /// The robot as a URDF; empty where nobody wrote one.
    #[serde(default)]
    pub urdf: String,
}

/// A serial arm of revolute joints about their own z axes. Frames: x, y, z m; roll, pitch, yaw rad (R = Rz·Ry·Rx).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ArmDescription {
    /// Name shown to users.
    pub name: String,
    /// Arm base (A) in the mobile base (B).
    pub mount: [f64; 6],
    /// Each joint's frame in its parent link.
    pub joint_origin: Vec<[f64; 6]>,
    /// Flange in the last link.
    pub flange_origin: [f64; 6],
}

impl RobotDescription {
    /// Notes the present value of the parameter with this number; one that does not exist is left out.
    pub fn note_parameter(&mut self, number: usize, values: &ParameterValues) {
        if let Some(parameter) = self.parameters.get_mut(number) {
            parameter.value = crate::ParameterValue::Numbers(values.as_slice().to_vec());
        }
    }

    /// Gathers the tables a robot is made of. The frame deadline is in s, the loop period in s.
    #[expect(clippy::too_many_arguments, reason = "one argument for each table; called once, by the daemon")]
    pub fn new<const N: usize>(
        name: &str,
        simulated: bool,
        period_s: f64,
        base: &BaseTable,
        mount: &Mount,
        arm: &ArmTable<N>,
        cover: &[TaxelPlacement],
        limits: &Limits<N>,
        frame_deadline_s: f64,
    ) -> Self {
        let [x, y, z] = mount.position_base_m;
        let [roll, pitch, yaw] = mount.rpy_rad;
        Self {
            name: name.to_owned(),
            simulated,
            period_s,
            base_size_m: base.size_m,
            arm: ArmDescription {
                name: arm.name.to_owned(),
                mount: [x, y, z, roll, pitch, yaw],
                joint_origin: arm.joint_origin.to_vec(),
                flange_origin: arm.flange_origin,
            },
            taxels: cover.to_vec(),
            frame_deadline_s,
            taxel_force_max_n: limits.taxel_force_n,
            base_velocity_max: limits.base_velocity,
            parameters: Vec::new(),
            speed_override: String::new(),
            uncalibrated: String::new(),
            urdf: String::new(),
        }
    }

    /// MOCA-S as in the paper, at 1 kHz: a Panda on a SUMMIT-XL with 11 taxels.
    pub fn paper(name: &str, simulated: bool) -> Self {
        use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
        let limits = Limits::for_arm(&PANDA);
        Self::new(name, simulated, 1e-3, &SUMMIT_XL, &MOCA_MOUNT, &PANDA, &PAPER_COVER, &limits, 0.12)
    }
}

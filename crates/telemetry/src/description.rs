//! Description of the robot that a client receives once: name, geometry, limits.
//!
//! ```
//! use moca_telemetry::RobotDescription;
//! let robot = RobotDescription::paper("lab", true);
//! assert_eq!((robot.arm.joints, robot.taxels.len()), (7, 11));
//! assert_eq!(robot.taxels[5].position_base_m, [0.489, 0.0]); // T6, the middle of the front
//! ```

use crate::ParameterDescription;
use moca_msgs::robot::{AnyArm, PANDA, PAPER_COVER};
use moca_msgs::{BaseTable, Limits, Mount, ParameterValues, TaxelPlacement};
use serde::{Deserialize, Serialize};

/// A robot as a client needs it: enough to draw base, arm and cover from a [`moca_msgs::Sample`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RobotDescription {
    /// Name of this robot, chosen by its owner.
    pub name: String,
    /// True if the plant is a simulation, which can be pressed by request.
    pub simulated: bool,
    /// Period of the loop, s.
    pub period_s: f64,
    /// Length (x), width (y), height (z) of the base, m.
    pub base_size_m: [f64; 3],
    /// Name of the arm; empty without one.
    #[serde(default)]
    pub arm_name: String,
    /// The arm; one without joints is none.
    #[serde(default)]
    pub arm: AnyArm,
    /// Place of the arm on the base.
    #[serde(default)]
    pub mount: Mount,
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
    /// Accuracy of forces on an uncalibrated cover, in one sentence; empty if it is calibrated.
    #[serde(default)]
    pub uncalibrated: String,
    /// The robot as a URDF; empty where nobody wrote one.
    #[serde(default)]
    pub urdf: String,
}

impl RobotDescription {
    /// Notes the present value of the parameter with this number; one that does not exist is left out.
    pub fn note_parameter(&mut self, number: usize, values: &ParameterValues) {
        if let Some(parameter) = self.parameters.get_mut(number) {
            parameter.value = crate::ParameterValue::Numbers(values.as_slice().to_vec());
        }
    }

    /// MOCA-S as in the paper, at 1 kHz: a Panda on a SUMMIT-XL with 11 taxels.
    pub fn paper(name: &str, simulated: bool) -> Self {
        let limits = Limits::for_arm(&PANDA);
        Self {
            name: name.to_owned(),
            simulated,
            period_s: 1e-3,
            base_size_m: BaseTable::default().size_m,
            arm_name: "Franka Emika Panda".to_owned(),
            arm: AnyArm::of(&PANDA),
            mount: Mount::default(),
            taxels: PAPER_COVER.to_vec(),
            frame_deadline_s: 0.12,
            taxel_force_max_n: limits.taxel_force_n,
            base_velocity_max: limits.base_velocity,
            ..Self::default()
        }
    }
}

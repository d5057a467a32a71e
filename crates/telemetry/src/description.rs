//! Description of the robot that a client receives once: name, geometry, limits.
//!
//! ```
//! use moca_telemetry::RobotDescription;
//! let robot = RobotDescription::paper("lab", true);
//! assert_eq!((robot.arm.joints, robot.taxels.len()), (7, 11));
//! assert_eq!(robot.taxels[5].position_base_m, [0.489, 0.0]); // T6, the middle of the front
//! ```

use crate::{ParameterDescription, ParameterValue};
use moca_msgs::board::{Diagnosis, OpenFailure};
use moca_msgs::robot::{AnyArm, PANDA, PAPER_COVER};
use moca_msgs::{BaseTable, Fault, Limits, Mount, ParameterValues, TaxelPlacement};
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
            parameter.value = ParameterValue::Numbers(values.as_slice().to_vec());
        }
    }

    fn value(&self, parameter: &str) -> Option<&ParameterValue> {
        self.parameters.iter().find(|described| described.name == parameter).map(|described| &described.value)
    }

    /// Value of a parameter that is text, such as `board.port`.
    pub fn text(&self, parameter: &str) -> Option<&str> {
        match self.value(parameter)? {
            ParameterValue::Text(text) => Some(text),
            ParameterValue::Numbers(_) => None,
        }
    }

    /// Value of a parameter that is one number.
    pub fn number(&self, parameter: &str) -> Option<f64> {
        self.numbers(parameter)?.first().copied()
    }

    /// Value of a parameter that is a list of numbers.
    pub fn numbers(&self, parameter: &str) -> Option<&[f64]> {
        match self.value(parameter)? {
            ParameterValue::Numbers(numbers) => Some(numbers),
            ParameterValue::Text(_) => None,
        }
    }

    /// Returns true if there is a base or an arm: a daemon may read a cover alone.
    pub fn has_robot(&self) -> bool {
        self.text("plant.kind") != Some("none")
    }

    /// Returns true if there is an arm.
    pub fn has_arm(&self) -> bool {
        self.has_robot() && self.text("plant.parts") != Some("base") && self.arm.joints > 0
    }

    /// Returns true if there is a base that moves.
    pub fn has_base(&self) -> bool {
        self.has_robot() && self.has_cover()
    }

    /// Returns true if there is a cover.
    pub const fn has_cover(&self) -> bool {
        !self.taxels.is_empty()
    }

    /// A fault with its remedy and, where there are several boards, its board with port and taxels.
    pub fn fault_text(&self, fault: Fault) -> String {
        let board = fault.board().and_then(|board| self.board_name(board));
        board.map_or_else(|| fault.to_string(), |board| format!("{fault} {board}."))
    }

    /// State of the board and its remedy, with the port where that does not exist.
    pub fn board_text(&self, board: Diagnosis) -> String {
        match (board, self.text("board.port")) {
            (Diagnosis::NotOpen(OpenFailure::NotFound), Some(path)) if path.starts_with('/') => format!(
                "The board's port {path} does not exist: check cable, power switch and board.port in the configuration."
            ),
            _ => board.text().to_owned(),
        }
    }

    fn board_name(&self, board: u8) -> Option<String> {
        let port = self.text("board.port")?.split(", ").nth(usize::from(board))?;
        let of_taxel = self.numbers("robot.cover.board")?;
        let number = u16::from(board) + 1;
        let own = of_taxel.iter().zip(1..).filter(|(of, _)| (**of - f64::from(number)).abs() < 0.5);
        let taxels: Vec<String> = own.map(|(_, taxel)| format!("T{taxel}")).collect();
        // Without a list there is one board, and nothing to tell it from.
        (!taxels.is_empty()).then(|| format!("Board {number} ({port}) with {}", taxels.join(" ")))
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

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::BoardFault;

    #[test]
    fn fault_names_its_board_where_there_are_two() {
        let mut robot = RobotDescription::paper("test", true);
        let parameter =
            |name: &str, value| ParameterDescription { name: name.into(), value, ..Default::default() };
        let port = |text: &str| parameter("board.port", ParameterValue::Text(text.into()));
        let of_taxel =
            |numbers: &[f64]| parameter("robot.cover.board", ParameterValue::Numbers(numbers.into()));
        robot.parameters = vec![port("name:left, name:right"), of_taxel(&[1.0, 2.0, 2.0])];
        let [first, second] = [0, 1].map(|board| BoardFault::Lost.of(board));
        assert_eq!(robot.fault_text(second), format!("{second} Board 2 (name:right) with T2 T3."));
        assert_eq!(robot.fault_text(Fault::ZeroInvalid), Fault::ZeroInvalid.to_string());
        robot.parameters = vec![port("auto"), of_taxel(&[])];
        assert_eq!(robot.fault_text(first), first.to_string());
    }
}

//! Which parts a robot has, and what else its parameters say about it.

use moca_telemetry::{ParameterValue, RobotDescription};

/// The value of a parameter that is text, such as `board.port`.
pub fn text_parameter<'a>(robot: &'a RobotDescription, name: &str) -> Option<&'a str> {
    match &robot.parameters.iter().find(|parameter| parameter.name == name)?.value {
        ParameterValue::Text(text) => Some(text),
        ParameterValue::Numbers(_) => None,
    }
}

/// The value of a parameter that is one number.
pub fn number_parameter(robot: &RobotDescription, name: &str) -> Option<f64> {
    match &robot.parameters.iter().find(|parameter| parameter.name == name)?.value {
        ParameterValue::Numbers(numbers) => numbers.first().copied(),
        ParameterValue::Text(_) => None,
    }
}

/// Whether there is a base or an arm at all: a daemon may read a cover alone.
pub fn has_robot(robot: &RobotDescription) -> bool {
    text_parameter(robot, "plant.kind") != Some("none")
}

/// Whether there is an arm.
pub fn has_arm(robot: &RobotDescription) -> bool {
    let parts = text_parameter(robot, "plant.parts");
    has_robot(robot) && parts != Some("base") && !robot.arm.joint_origin.is_empty()
}

/// Whether there is a base that moves.
pub fn has_base(robot: &RobotDescription) -> bool {
    has_robot(robot) && has_cover(robot)
}

/// Whether there is a cover.
pub fn has_cover(robot: &RobotDescription) -> bool {
    !robot.taxels.is_empty()
}

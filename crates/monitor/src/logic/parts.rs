//! Which parts a robot has, and what else its parameters say about it.

use super::format::taxel_name;
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

/// Returns the name of a board (0 is the first) with its taxels, where there are several.
pub fn board_name(robot: &RobotDescription, board: u8) -> Option<String> {
    let port = text_parameter(robot, "board.port")?.split(", ").nth(usize::from(board))?;
    let of_taxel = robot.parameters.iter().find(|parameter| parameter.name == "robot.cover.board")?;
    let ParameterValue::Numbers(numbers) = &of_taxel.value else { return None };
    let own =
        numbers.iter().zip(0_usize..).filter(|(number, _)| (**number - f64::from(board) - 1.0).abs() < 0.5);
    let taxels: Vec<String> = own.map(|(_, taxel)| taxel_name(taxel)).collect();
    // Without a list there is one board, and nothing to tell it from.
    (!taxels.is_empty()).then(|| format!("Board {} ({port}) with {}", board + 1, taxels.join(" ")))
}

/// Returns true if there is a base or an arm: a daemon may read a cover alone.
pub fn has_robot(robot: &RobotDescription) -> bool {
    text_parameter(robot, "plant.kind") != Some("none")
}

/// Returns true if there is an arm.
pub fn has_arm(robot: &RobotDescription) -> bool {
    let parts = text_parameter(robot, "plant.parts");
    has_robot(robot) && parts != Some("base") && robot.arm.joints > 0
}

/// Returns true if there is a base that moves.
pub fn has_base(robot: &RobotDescription) -> bool {
    has_robot(robot) && has_cover(robot)
}

/// Returns true if there is a cover.
pub fn has_cover(robot: &RobotDescription) -> bool {
    !robot.taxels.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_telemetry::ParameterDescription;

    #[test]
    fn a_board_is_named_with_its_taxels_where_there_are_two() {
        let mut robot = RobotDescription::paper("test", true);
        let parameter =
            |name: &str, value| ParameterDescription { name: name.into(), value, ..Default::default() };
        let port = |text: &str| parameter("board.port", ParameterValue::Text(text.into()));
        let of_taxel =
            |numbers: &[f64]| parameter("robot.cover.board", ParameterValue::Numbers(numbers.into()));
        robot.parameters = vec![port("name:left, name:right"), of_taxel(&[1.0, 2.0, 2.0])];
        assert_eq!(board_name(&robot, 1).as_deref(), Some("Board 2 (name:right) with T2 T3"));
        robot.parameters = vec![port("auto"), of_taxel(&[])];
        assert_eq!(board_name(&robot, 0), None);
    }
}

//! Parameters as a user tunes them: names of elements, differences from the defaults, and these as a configuration file.

use super::format::taxel_name;
use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue, RobotDescription};
use std::fmt::Write as _;

/// Returns the name of a vector's element: an axis of a twist or of a planar motion, a joint, a taxel.
pub fn element_name(parameter: &ParameterDescription, element: usize) -> String {
    let ParameterValue::Numbers(values) = &parameter.value else { return String::new() };
    let one_unit = parameter.units.len() <= 1;
    let axes: &[&str] = match values.len() {
        1 => return String::new(),
        3 if one_unit => &["x", "y", "z"],
        3 => &["x", "y", "yaw"],
        6 if !one_unit => &["x", "y", "z", "roll", "pitch", "yaw"],
        _ if parameter.name.contains("taxel") => return taxel_name(element),
        _ => return format!("joint {}", element + 1),
    };
    axes.get(element).map_or_else(String::new, |axis| (*axis).to_owned())
}

/// Returns true if the parameter has another value than its default.
pub fn is_changed(parameter: &ParameterDescription) -> bool {
    parameter.value != parameter.default
}

/// Every value that differs from its default as a configuration file that `mocad --config` takes, and how many they
/// are; `None` if there is none.
pub fn changed_as_toml(robot: &RobotDescription) -> Option<(String, usize)> {
    let mut table = toml::Table::new();
    let changed: Vec<_> = robot.parameters.iter().filter(|parameter| is_changed(parameter)).collect();
    for parameter in &changed {
        insert(&mut table, &parameter.name, value(parameter));
    }
    let mut text = format!("# What differs from the defaults on {:?}, as a dashboard saw it.\n", robot.name);
    // Writing to a string does not fail.
    let _ = write!(text, "{table}");
    (!changed.is_empty()).then_some((text, changed.len()))
}

fn insert(table: &mut toml::Table, name: &str, value: toml::Value) {
    match name.split_once('.') {
        None => {
            table.insert(name.into(), value);
        }
        Some((section, rest)) => {
            let section = table.entry(section).or_insert_with(|| toml::Table::new().into());
            if let Some(section) = section.as_table_mut() {
                insert(section, rest, value);
            }
        }
    }
}

fn value(parameter: &ParameterDescription) -> toml::Value {
    let number = |value: &f64| match parameter.form {
        ParameterForm::Flag => (*value > 0.5).into(),
        #[expect(clippy::cast_possible_truncation, reason = "a whole number within the parameter's range")]
        ParameterForm::Integer => (*value as i64).into(),
        _ => (*value).into(),
    };
    match (&parameter.value, &parameter.default) {
        (ParameterValue::Text(text), _) => text.as_str().into(),
        // One number is a list of one where the default has another length.
        (ParameterValue::Numbers(values), ParameterValue::Numbers(default)) if default.len() == 1 => {
            values.first().map_or_else(|| toml::Value::Array(Vec::new()), number)
        }
        (ParameterValue::Numbers(values), _) => values.iter().map(number).collect::<Vec<_>>().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(name: &str, form: ParameterForm, default: &[f64], value: &[f64]) -> ParameterDescription {
        let [default, value] = [default, value].map(|v| ParameterValue::Numbers(v.to_vec()));
        ParameterDescription { name: name.into(), form, default, value, ..ParameterDescription::default() }
    }

    #[test]
    fn what_differs_from_the_defaults_is_a_configuration_file() {
        let mut kind = parameter("plant.kind", ParameterForm::Choice(vec![]), &[], &[]);
        kind.default = ParameterValue::Text("simulated".into());
        kind.value = ParameterValue::Text("none".into());
        let robot = RobotDescription {
            name: "lab \"1\"\nx = 3".into(),
            parameters: vec![
                parameter(
                    "control.gains.virtual_damping",
                    ParameterForm::Number,
                    &[80.0; 3],
                    &[80.0, 120.5, 60.0],
                ),
                parameter("control.gains.damping_ratio", ParameterForm::Number, &[0.9], &[1.0]),
                parameter("control.gains.reactivity", ParameterForm::Number, &[1.0], &[1.0]),
                parameter("control.corrections.base_coupling", ParameterForm::Flag, &[1.0], &[0.0]),
                parameter("board.masked", ParameterForm::Integer, &[], &[3.0]),
                parameter("loop.rate_hz", ParameterForm::Integer, &[1000.0], &[500.0]),
                kind,
            ],
            ..RobotDescription::paper("", true)
        };
        let (text, count) = changed_as_toml(&robot).unwrap();
        let expected = "[control.gains]\nvirtual_damping = [80.0, 120.5, 60.0]\ndamping_ratio = 1.0\n\
                        [control.corrections]\nbase_coupling = false\n[board]\nmasked = [3]\n\
                        [loop]\nrate_hz = 500\n[plant]\nkind = \"none\"\n";
        assert_eq!(toml::from_str::<toml::Table>(&text).unwrap(), toml::from_str(expected).unwrap());
        assert_eq!(count, 6);
        assert_eq!(changed_as_toml(&RobotDescription::paper("new", true)), None);
    }

    #[test]
    fn elements_are_called_after_their_axes_and_joints() {
        let names = |units: &[&str], count: usize| -> Vec<String> {
            let mut vector = parameter("control.gains.some", ParameterForm::Number, &[], &vec![0.0; count]);
            vector.units = units.iter().map(|unit| (*unit).into()).collect();
            (0..count).map(|element| element_name(&vector, element)).collect()
        };
        assert_eq!(names(&["kg", "kg", "kg·m²"], 3), ["x", "y", "yaw"]);
        assert_eq!(names(&["m"], 3), ["x", "y", "z"]);
        let stiffness = ["N/m", "N/m", "N/m", "N·m/rad", "N·m/rad", "N·m/rad"];
        assert_eq!(names(&stiffness, 6), ["x", "y", "z", "roll", "pitch", "yaw"]);
        assert_eq!(names(&["rad"], 7)[6], "joint 7");
        assert_eq!(names(&["rad"], 6)[5], "joint 6", "an arm of six joints is no twist");
        assert_eq!(names(&[], 1), [""]);
    }
}

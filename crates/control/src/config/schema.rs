//! The schema of everything that can be configured, for clients and as JSON schema.

use crate::config::load::{find, written};
use crate::config::{Config, default_gains};
use moca_msgs::table::{ParameterKind, ParameterSpec, Size};
use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue};
use serde_json::{Map, Value, json};

/// The schema with defaults and the values of `config`, as clients are given it.
pub fn describe(config: &Config) -> Vec<ParameterDescription> {
    let mut defaults = Config::with_arm(config.robot.arm.clone());
    defaults.control.gains = default_gains::defaults(config).control.gains;
    let defaults = defaults.to_toml();
    let (mut all, joints) = (Vec::new(), config.arm().joints);
    config.clone().each(&mut |spec, field| {
        all.push(ParameterDescription {
            name: spec.name.into(),
            form: match spec.kind {
                ParameterKind::Number => ParameterForm::Number,
                ParameterKind::Integer => ParameterForm::Integer,
                ParameterKind::Flag => ParameterForm::Flag,
                ParameterKind::Text => ParameterForm::Text,
                ParameterKind::Choice(words) => {
                    ParameterForm::Choice(words.iter().map(|word| (*word).into()).collect())
                }
            },
            units: spec.units.iter().map(|unit| (*unit).into()).collect(),
            min: spec.min,
            max: spec.max,
            live: spec.live,
            description: spec.description.into(),
            default: find(&defaults, spec.name).and_then(value).unwrap_or_default(),
            value: value(&written(spec, field, joints)).unwrap_or_default(),
        });
    });
    all
}

/// JSON schema (draft 2020-12) of the configuration file. `unit` and `live` are annotations of ours.
pub fn json_schema() -> Value {
    let mut root = section();
    let (mut defaults, joints) = (Config::default(), Config::default().arm().joints);
    defaults.each(&mut |spec, field| {
        let default = serde_json::to_value(written(spec, field, joints));
        let mut parts: Vec<&str> = spec.name.split('.').collect();
        let key = parts.pop().unwrap_or_default();
        let mut at = &mut root;
        for part in parts {
            at = &mut at["properties"];
            if at.get(part).is_none() {
                at[part] = section();
            }
            at = &mut at[part];
        }
        at["properties"][key] = property(spec, default.unwrap_or_default());
    });
    root["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
    root["title"] = "Configuration of mocad".into();
    root
}

fn section() -> Value {
    json!({ "type": "object", "additionalProperties": false, "properties": {} })
}

fn property(spec: &ParameterSpec, default: Value) -> Value {
    let mut one = Map::new();
    let kind = match spec.kind {
        ParameterKind::Number => "number",
        ParameterKind::Integer => "integer",
        ParameterKind::Flag => "boolean",
        ParameterKind::Text | ParameterKind::Choice(_) => "string",
    };
    one.insert("type".into(), kind.into());
    match spec.kind {
        ParameterKind::Number | ParameterKind::Integer => {
            one.insert("minimum".into(), spec.min.into());
            one.insert("maximum".into(), spec.max.into());
        }
        ParameterKind::Choice(words) => {
            one.insert("enum".into(), words.into());
        }
        ParameterKind::Flag | ParameterKind::Text => {}
    }
    let mut whole = match spec.size {
        Size::One => one,
        // A single text stands for a list of one.
        Size::AtMost(most) if spec.kind == ParameterKind::Text => {
            let list = json!({ "type": "array", "items": one, "minItems": 1, "maxItems": most });
            Map::from_iter([("anyOf".to_owned(), json!([one, list]))])
        }
        size => {
            let mut list = Map::new();
            list.insert("type".into(), "array".into());
            list.insert("items".into(), one.into());
            let (least, most) = match size {
                Size::Exactly(count) => (count, count),
                Size::AtMost(count) => (0, count),
                Size::One | Size::Joints => (1, moca_msgs::MAX_JOINTS),
            };
            list.insert("minItems".into(), least.into());
            list.insert("maxItems".into(), most.into());
            list
        }
    };
    whole.insert("default".into(), default);
    whole.insert("description".into(), spec.description.into());
    if !spec.units.is_empty() {
        whole.insert("unit".into(), spec.units.into());
    }
    whole.insert("live".into(), spec.live.into());
    whole.into()
}

/// Numbers and flags as numbers, anything else as text.
pub fn value(value: &toml::Value) -> Option<ParameterValue> {
    #[expect(clippy::cast_precision_loss, reason = "shown, and compared with bounds far below 2^53")]
    let number = |value: &toml::Value| match value {
        toml::Value::Float(number) => Some(*number),
        toml::Value::Integer(number) => Some(*number as f64),
        toml::Value::Boolean(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    };
    Some(match value {
        toml::Value::String(text) => ParameterValue::Text(text.clone()),
        toml::Value::Array(values) if values.iter().any(toml::Value::is_str) => {
            let texts: Vec<&str> = values.iter().filter_map(toml::Value::as_str).collect();
            ParameterValue::Text(texts.join(", "))
        }
        toml::Value::Array(values) => {
            ParameterValue::Numbers(values.iter().map(number).collect::<Option<_>>()?)
        }
        one => ParameterValue::Numbers(vec![number(one)?]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DEFAULT_TOML;

    /// A comment "a to b" in the documented file is the range that is enforced.
    #[test]
    fn the_documented_file_gives_the_ranges_of_the_table() {
        let (mut section, mut compared) = (String::new(), 0);
        for line in DEFAULT_TOML.lines() {
            if let Some(name) = line.strip_prefix('[') {
                section = format!("{}.", name.split(']').next().unwrap());
            }
            let (Some((key, _)), Some((_, comment))) = (line.split_once(" = "), line.rsplit_once('#')) else {
                continue;
            };
            let words: Vec<&str> = comment.split_whitespace().collect();
            let number = |word: &str| word.trim_end_matches([',', ';']).parse::<f64>().ok();
            let range = words.windows(3).find_map(|w| match w {
                [low, "to", high] => Some((number(low)?, number(high)?)),
                _ => None,
            });
            let name = format!("{section}{key}");
            let mut row = None;
            Config::default().each(&mut |spec, _| row = row.or((spec.name == name).then_some(spec)));
            let spec = row.unwrap_or_else(|| panic!("{name} has no row"));
            let ranged = !matches!(spec.kind, ParameterKind::Text | ParameterKind::Choice(_));
            if let Some((min, max)) = range.filter(|_| ranged) {
                assert_eq!((spec.min, spec.max), (min, max), "{name}");
                compared += 1;
            }
        }
        assert!(compared >= 20, "only {compared} comments give a range: the comparison shows little");
    }

    #[test]
    fn value_out_of_range_is_named_with_unit_and_range() {
        Config::default().check(|_, error| panic!("{error}"));
        let mut config = Config::default();
        config.control.gains.stiffness[4] = 2e5;
        config.limits.base_velocity[2] = f64::NAN;
        config.board.masked = vec![99];
        let mut errors = Vec::new();
        config.check(|_, error| errors.push(error));
        assert_eq!(
            errors[..3],
            [
                "control.gains.stiffness = 200000 N·m/rad is outside 0 to 100000 N·m/rad",
                "limits.base_velocity = NaN rad/s is outside 0 to 3 rad/s",
                "board.masked = 99 (taxel number) is outside 1 to 48 (taxel number)",
            ]
        );
    }

    #[test]
    fn the_first_numbers_are_those_of_the_controllers() {
        let described = describe(&Config::default());
        for (row, spec) in described.iter().zip(&moca_msgs::params::CONTROLLER) {
            assert_eq!((row.name.as_str(), row.live), (spec.name, spec.live));
        }
        assert!(described.iter().skip(moca_msgs::params::CONTROLLER.len()).all(|row| !row.live));
        assert!(described.iter().all(|row| row.value == row.default && row.description.ends_with('.')));
    }

    #[test]
    fn the_json_schema_describes_the_default_configuration() {
        let schema = json_schema();
        let stiffness = &schema["properties"]["control"]["properties"]["gains"]["properties"]["stiffness"];
        assert_eq!(stiffness["type"], "array");
        assert_eq!((&stiffness["items"]["maximum"], &stiffness["minItems"]), (&json!(1e5), &json!(6)));
        assert_eq!((&stiffness["unit"][3], &stiffness["live"]), (&json!("N·m/rad"), &json!(true)));
        let law = &schema["properties"]["startup"]["properties"]["law"];
        assert_eq!(law["enum"], json!(["impedance", "follow-me"]));
        assert_eq!((&law["default"], &law["live"]), (&json!("impedance"), &json!(false)));
    }
}

//! The schema of everything that can be configured: type, unit, range, default, description, live or not. One table
//! checks configuration files, describes the robot to observers, and is exported as JSON schema.

use crate::config::{Config, TAXELS};
use crate::control::protection::OVERRIDE_MAX_M_S;
use moca_msgs::params::{CONTROLLER, ParameterKind, ParameterSpec};
use moca_msgs::{ParameterError, request::PRESS_FORCE_MAX_N};
use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue};
use serde_json::{Map, Value, json};

#[expect(clippy::cast_precision_loss, reason = "a small count")]
const LAST_TAXEL: f64 = TAXELS as f64;

/// What can be configured besides the controllers' parameters; read at the start.
pub const SETTINGS: &[ParameterSpec] = {
    use ParameterKind::{Choice, Flag, Integer, Number, Text};
    const ANY: (f64, f64) = (0.0, 0.0);
    const EITHER: (f64, f64) = (0.0, 1.0);
    const TAXEL: (f64, f64) = (1.0, LAST_TAXEL);
    const fn row(
        name: &'static str,
        kind: ParameterKind,
        units: &'static [&'static str],
        range: (f64, f64),
        description: &'static str,
    ) -> ParameterSpec {
        ParameterSpec::new(name, kind, units, range, description)
    }
    &[
        row("robot", Text, &[], ANY, "Name of this robot, shown by observers and written into logs."),
        row("loop.rate_hz", Integer, &["Hz"], (100.0, 10_000.0), "Control rate."),
        row(
            "realtime.priority",
            Integer,
            &[],
            (0.0, 98.0),
            "SCHED_FIFO priority of the loop thread; 0 is normal scheduling.",
        ),
        row("realtime.lock_memory", Flag, &[], EITHER, "Keep the process's pages in memory (mlockall)."),
        row("realtime.cpu", Integer, &[], (-1.0, 1023.0), "Core the loop is pinned to; -1 for any."),
        row("realtime.dma_latency", Flag, &[], EITHER, "Keep the processors out of deep sleep."),
        row("plant.kind", Choice(&["simulated", "none"]), &[], ANY, "Which robot is driven."),
        row("plant.parts", Choice(&["whole", "base", "arm"]), &[], ANY, "Which parts the robot has."),
        row("geometry.arm", Choice(&["panda", "fr3"]), &[], ANY, "Which arm stands on the base."),
        row("geometry.arm_position_m", Number, &["m"], (-5.0, 5.0), "Arm base in the base's frame B."),
        row("geometry.arm_rpy_rad", Number, &["rad"], (-7.0, 7.0), "Its axes in B: roll, pitch, yaw."),
        row(
            "geometry.taxel_x_m",
            Number,
            &["m"],
            (-5.0, 5.0),
            "Centre of each taxel in B, T1 first: forward.",
        ),
        row("geometry.taxel_y_m", Number, &["m"], (-5.0, 5.0), "Centre of each taxel in B, T1 first: left."),
        row(
            "geometry.taxel_inward_rad",
            Number,
            &["rad"],
            (-7.0, 7.0),
            "Direction in which a press on each taxel pushes, angle from B's x axis.",
        ),
        row("board.port", Text, &[], ANY, "\"virtual\", \"auto\" (by USB id), or a path."),
        row(
            "board.firmware",
            Choice(&["moca", "stock-2018", "stock-2015"]),
            &[],
            ANY,
            "What runs on the virtual board; a real one is recognised.",
        ),
        row("board.name", Text, &[], ANY, "The board's name in its calibration file."),
        row("board.calibration", Text, &[], ANY, "File that `mocad calibrate` wrote; empty for none."),
        row("board.masked", Integer, &["(taxel number)"], TAXEL, "Taxels out of use."),
        row("board.mask_policy", Choice(&["stop", "unfelt"]), &[], ANY, "What a masked taxel means."),
        row("board.gauge", Text, &[], ANY, "Port of a force gauge for calibrations; empty for none."),
        row("board.gauge_baud", Integer, &["baud"], (300.0, 4e6), "Speed of the gauge's port."),
        row("startup.law", Choice(&["impedance", "follow-me"]), &[], ANY, "What arming starts."),
        row("startup.tare", Flag, &[], EITHER, "Measure the cover's zero when the first frames arrive."),
        row("startup.arm", Flag, &[], EITHER, "Arm by itself after that tare (simulation only)."),
        row(
            "protection.force_limit_n",
            Number,
            &["N"],
            (1.0, 500.0),
            "Force of an impact that limits the speed of the cover's fastest point.",
        ),
        row(
            "protection.assessed_forces_n",
            Number,
            &["N"],
            (6.0, 1000.0),
            "Forces of your own risk assessment: `moca-lab latency` prints the speed for each.",
        ),
        row("protection.unfelt_force_n", Number, &["N"], (0.0, 100.0), "Force that the cover does not feel."),
        row(
            "protection.contact_stiffness_n_m",
            Number,
            &["N/m"],
            (100.0, 1e6),
            "Stiffness of cover and body in series at the force limit.",
        ),
        row(
            "protection.contact_travel_m",
            Number,
            &["m"],
            (1e-4, 0.1),
            "Way that cover and body yield from the unfelt force to the force limit.",
        ),
        row(
            "protection.override_speed_limit_m_s",
            Number,
            &["m/s"],
            (0.0, OVERRIDE_MAX_M_S),
            "Another speed limit, whatever the board's rate; 0 is no override.",
        ),
        row("protection.override_statement", Text, &[], ANY, "Why the limit is overridden; logged."),
        row("protection.thresholds", Text, &[], ANY, "File of contact limits; empty for none."),
        row(
            "protection.reaction",
            Choice(&["slow", "stop-direction", "retreat"]),
            &[],
            ANY,
            "Reaction to a crossed contact limit, until that contact ends.",
        ),
        row("protection.slow_m_s", Number, &["m/s"], (0.0, 1.0), "Speed limit of \"slow\"."),
        row("protection.retreat_m_s", Number, &["m/s"], (0.001, 1.0), "Speed of \"retreat\"."),
        row("protection.retreat_m", Number, &["m"], (0.0, 1.0), "Longest way of a retreat."),
        row("telemetry.listen", Text, &[], ANY, "Loopback address for dashboards; empty for none."),
        row("flight_recorder.folder", Text, &[], ANY, "Where the last 10 s before a fault are written."),
        row("simulation.seed", Integer, &[], (0.0, 9e15), "Seed of the sensor's noise."),
        row("simulation.hand.taxels", Integer, &["(taxel number)"], TAXEL, "Taxels pressed in turn."),
        row("simulation.hand.force_n", Number, &["N"], (0.0, PRESS_FORCE_MAX_N), "Force of a press."),
        row("simulation.hand.every_s", Number, &["s"], (1.0, 3600.0), "From one press to the next."),
        row("simulation.hand.hold_s", Number, &["s"], (0.1, 3600.0), "How long a press lasts."),
    ]
};

/// The whole schema: the controllers' rows first, so that their numbers are those of [`CONTROLLER`].
pub fn schema() -> impl Iterator<Item = &'static ParameterSpec> {
    CONTROLLER.iter().chain(SETTINGS)
}

/// Reports every value of `config` outside its range to `report`.
pub fn check(config: &Config, mut report: impl FnMut(ParameterError)) {
    let Ok(table) = toml::Table::try_from(config) else { return };
    for spec in schema() {
        if let Some(ParameterValue::Numbers(values)) = find(&table, spec.name).and_then(value)
            && let Err(error) = spec.check(&values)
        {
            report(error);
        }
    }
}

/// The schema with defaults and the values of `config`, as observers are given it.
pub fn describe(config: &Config) -> Vec<ParameterDescription> {
    let table = |config: &Config| toml::Table::try_from(config).unwrap_or_default();
    let (defaults, configured) = (table(&Config::default()), table(config));
    let of = |table: &toml::Table, name| find(table, name).and_then(value).unwrap_or_default();
    schema()
        .map(|spec| ParameterDescription {
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
            default: of(&defaults, spec.name),
            value: of(&configured, spec.name),
        })
        .collect()
}

/// JSON schema (draft 2020-12) of the configuration file. `unit` and `live` are annotations of ours.
pub fn json_schema() -> Value {
    let mut root = section();
    let defaults = toml::Table::try_from(Config::default()).unwrap_or_default();
    for spec in schema() {
        let default = find(&defaults, spec.name).and_then(|value| serde_json::to_value(value).ok());
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
    }
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
    let mut whole = match &default {
        Value::Array(elements) => {
            let mut list = Map::new();
            list.insert("type".into(), "array".into());
            list.insert("items".into(), one.into());
            if ["control.", "limits.", "geometry."].iter().any(|start| spec.name.starts_with(start)) {
                list.insert("minItems".into(), elements.len().into());
                list.insert("maxItems".into(), elements.len().into());
            }
            list
        }
        _ => one,
    };
    whole.insert("default".into(), default);
    whole.insert("description".into(), spec.description.into());
    if !spec.units.is_empty() {
        whole.insert("unit".into(), spec.units.into());
    }
    whole.insert("live".into(), spec.live.into());
    whole.into()
}

fn find<'a>(table: &'a toml::Table, path: &str) -> Option<&'a toml::Value> {
    match path.split_once('.') {
        None => table.get(path),
        Some((first, rest)) => find(table.get(first)?.as_table()?, rest),
    }
}

/// Numbers and flags as numbers, anything else as text.
pub(crate) fn value(value: &toml::Value) -> Option<ParameterValue> {
    #[expect(clippy::cast_precision_loss, reason = "shown, and compared with bounds far below 2^53")]
    let number = |value: &toml::Value| match value {
        toml::Value::Float(number) => Some(*number),
        toml::Value::Integer(number) => Some(*number as f64),
        toml::Value::Boolean(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    };
    Some(match value {
        toml::Value::String(text) => ParameterValue::Text(text.clone()),
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
    use std::collections::BTreeSet;

    fn keys(table: &toml::Table, path: &str, out: &mut BTreeSet<String>) {
        for (key, value) in table {
            match value {
                toml::Value::Table(sub) => keys(sub, &format!("{path}{key}."), out),
                _ => drop(out.insert(format!("{path}{key}"))),
            }
        }
    }

    #[test]
    fn every_key_of_the_configuration_has_its_row() {
        let (mut known, rows) = (BTreeSet::new(), schema().map(|spec| spec.name.to_owned()).collect());
        keys(&toml::Table::try_from(Config::default()).unwrap(), "", &mut known);
        assert_eq!(known, rows);
    }

    /// Where a comment of the documented file says "a to b", it is the range that is enforced.
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
            let spec = schema().find(|spec| spec.name == name);
            let spec = spec.unwrap_or_else(|| panic!("{name} has no row"));
            if let Some((min, max)) = range {
                assert_eq!((spec.min, spec.max), (min, max), "{name}");
                compared += 1;
            }
        }
        assert!(compared >= 20, "only {compared} comments give a range: the comparison shows little");
    }

    #[test]
    fn defaults_are_in_range_and_whatever_is_not_is_named_with_value_unit_and_range() {
        check(&Config::default(), |error| panic!("{error}"));
        let mut config = Config::default();
        config.control.gains.stiffness[4] = 2e5;
        config.limits.base_velocity[2] = f64::NAN;
        config.board.masked = vec![12];
        let mut errors = Vec::new();
        check(&config, |error| errors.push(error.to_string()));
        assert_eq!(
            errors,
            [
                "control.gains.stiffness = 200000 N·m/rad is outside 0 to 100000 N·m/rad",
                "limits.base_velocity = NaN rad/s is outside 0 to 3 rad/s",
                "board.masked = 12 (taxel number) is outside 1 to 11 (taxel number)",
            ]
        );
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

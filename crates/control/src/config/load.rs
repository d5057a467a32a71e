//! Configuration files: read, checked, written. One pass reports every mistake, each with its line and its key.

use super::{Config, ConfigError, OwnArm};
use crate::robot::{Arm, JOINTS, OWN_ARM};
use moca_msgs::table::{Field, FieldValue, ParameterKind, ParameterSpec, Size};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Keys of earlier versions, and what they are called now.
const RENAMED: &[(&str, &str)] = &[
    ("geometry.arm", "robot.arm"),
    ("geometry.arm_position_m", "robot.mount.position_base_m"),
    ("geometry.arm_rpy_rad", "robot.mount.rpy_rad"),
    ("geometry.taxel_x_m", "robot.cover.x_m"),
    ("geometry.taxel_y_m", "robot.cover.y_m"),
    ("geometry.taxel_inward_rad", "robot.cover.inward_rad"),
    ("control.corrections.flange_feed", "control.corrections.flange_wrench_feedforward"),
    ("protection.foam_stiffness_n_m", "robot.cover.foam_stiffness_n_m"),
    ("protection.foam_thickness_m", "robot.cover.foam_thickness_m"),
    ("protection.unfelt_force_n", "protection.threshold_force_n"),
];

/// Distance for which an arm's shapes are needed.
const SELF_COLLISION: &str = "control.self_collision.distance_m";
/// Names the arm.
const ARM: &str = "robot.arm";
/// Which taxels the scripted hand presses.
const HAND: &str = "simulation.hand.taxels";

/// Choices of earlier versions: key, what was written there, and what it is called now.
const RENAMED_CHOICES: &[(&str, &str, &str)] = &[("board.mask_policy", "unfelt", "ignore")];

/// A file with more mistakes than this is not the file that was meant: the rest is not looked for.
const MISTAKES_MAX: usize = 100;
/// Longest name that is shown to people, bytes; a board's may be its path below `/dev/serial/by-path`.
pub(super) const NAME_MAX: usize = 128;
/// Longest text of any other setting, bytes: a path of Linux.
const TEXT_MAX: usize = 4096;
/// Settings that are names.
const NAMES: &[&str] = &["robot.name", "robot.base_name", "board.name", "arm.name"];

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// Every mistake in it, or why it could not be read.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse_in(&read_text(path)?, path.parent().unwrap_or(Path::new("")))
    }

    /// Parses and checks a configuration; what it does not name keeps its default. A URDF is looked for in the working
    /// directory.
    ///
    /// # Errors
    /// Every mistake in it, each with its line.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        Self::parse_in(text, Path::new(""))
    }

    fn parse_in(text: &str, folder: &Path) -> Result<Self, ConfigError> {
        let (root, mut values) = syntax(text)?;
        let mut mistakes = Mistakes::new(text, root);
        let mut known = toml::Table::new();
        Self::default().each(&mut |row, _| insert(&mut known, row.name, toml::Value::Boolean(true)));
        mistakes.unknown_keys(&known);
        let Some(arm) = arm(&values, folder, &mut mistakes) else {
            without_arm(&values, &mut mistakes);
            return mistakes.or(Self::default());
        };
        let mut config = Self::with_arm(arm);
        values.remove("arm");
        let joints = config.arm().joints;
        config.each(&mut |row, field| {
            if let Some(value) = find(&values, row.name)
                && let Err(message) = take(row, field, value, joints)
            {
                mistakes.add(row.name, &message);
            }
        });
        if find(&values, HAND).is_none() {
            config.simulation.hand.taxels = config.simulation.hand.reachable(config.robot.cover.count());
        }
        config.check(|name, message| mistakes.add(name, &message));
        if mistakes.found.is_empty() {
            super::default_gains::settle(&mut config, |key| find(&values, key).is_some());
            super::check::stability(&config, &mut |name, message| mistakes.add(name, &message));
        }
        mistakes.or(config)
    }

    /// Reports every value outside its range, and values that do not go together, as (dotted path, message).
    pub fn check(&self, mut report: impl FnMut(&str, String)) {
        self.clone().each(&mut |row, field| {
            field.see(&mut |value| {
                if let FieldValue::Numbers(numbers) = value
                    && let Err(error) = row.check(numbers)
                {
                    report(row.name, error.to_string());
                }
            });
        });
        super::check::check(self, &mut report);
    }

    /// The whole configuration as a file that gives it back.
    pub fn to_toml(&self) -> toml::Table {
        let mut table = toml::Table::new();
        let joints = self.arm().joints;
        self.clone().each(&mut |row, field| insert(&mut table, row.name, written(row, field, joints)));
        table
    }

    /// Changes one setting; `value` is written as in a file.
    ///
    /// # Errors
    /// A value of the wrong kind, with what is expected. Its range is checked by [`Config::check`].
    pub fn set(&mut self, name: &str, value: &toml::Value) -> Result<(), String> {
        let joints = self.arm().joints;
        let mut result = Err(format!("no setting is called {name}"));
        self.each(&mut |row, field| {
            if row.name == name {
                result = take(row, field, value, joints);
            }
        });
        result
    }
}

/// The arm that a configuration names; `None` after a mistake in its own description, for without an arm no list that goes
/// joint by joint can be judged.
fn arm(values: &toml::Table, folder: &Path, mistakes: &mut Mistakes<'_>) -> Option<Arm> {
    let named = find(values, ARM).and_then(toml::Value::as_str);
    let mut own = OwnArm::default();
    let mut fine = true;
    own.each(&mut |row, field| {
        let taken = find(values, row.name).map_or(Ok(()), |value| take(row, field, value, 0));
        if let Err(message) = taken {
            mistakes.add(row.name, &message);
            fine = false;
        }
    });
    if named == Some(OWN_ARM) && fine {
        // shapes are read, and judged, where something is done with them
        let distance = find(values, SELF_COLLISION);
        let shaped = distance.is_some_and(|v| v.as_float().is_some_and(|v| v > 0.0));
        let arm = own.arm(folder, shaped);
        return arm.map_err(|found| found.iter().for_each(|(row, message)| mistakes.add(row, message))).ok();
    }
    if named != Some(OWN_ARM) && own != OwnArm::default() {
        mistakes.add("arm", "[arm] is read where robot.arm = \"own\", which this file does not say");
    }
    (named != Some(OWN_ARM)).then(|| named.and_then(Arm::built_in).unwrap_or_default())
}

/// Checks each value that needs no arm to be judged, after a mistake in the arm.
fn without_arm(values: &toml::Table, mistakes: &mut Mistakes<'_>) {
    Config::default().each(&mut |row, field| {
        // the name of an own arm is fine, what it describes is not, and that is said
        let judged = row.size != Size::Joints && row.name != ARM;
        let Some(value) = find(values, row.name).filter(|_| judged) else { return };
        let mut wrong = take(row, field, value, 0).err();
        field.see(&mut |value| {
            if let FieldValue::Numbers(numbers) = value
                && wrong.is_none()
            {
                wrong = row.check(numbers).err().map(|error| error.to_string());
            }
        });
        if let Some(message) = wrong {
            mistakes.add(row.name, &message);
        }
    });
}

/// The text of a file: a regular one, of at most a mebibyte, so that no pipe or device is waited for.
///
/// # Errors
/// Why it was not read.
pub fn read_text(path: &Path) -> Result<String, ConfigError> {
    moca_tactile::calibration::read_text(path)
        .map_err(|error| ConfigError { mistakes: vec![format!("{}: {error}", path.display())] })
}

/// Parses a text, with and without places; returns the place where it is not TOML.
pub(crate) fn syntax(text: &str) -> Result<(Spanned<DeTable<'_>>, toml::Table), ConfigError> {
    let broken = |span: Option<std::ops::Range<usize>>, message: &str| ConfigError {
        mistakes: vec![located(line(text, span.map(|span| span.start)), message)],
    };
    let root = DeTable::parse(text).map_err(|error| broken(error.span(), error.message()))?;
    let values = text.parse().map_err(|error: toml::de::Error| broken(error.span(), error.message()))?;
    Ok((root, values))
}

/// Mistakes of one file, with their lines.
pub(crate) struct Mistakes<'a> {
    text: &'a str,
    root: Spanned<DeTable<'a>>,
    found: Vec<(Option<usize>, String, String)>,
}

impl<'a> Mistakes<'a> {
    pub(crate) const fn new(text: &'a str, root: Spanned<DeTable<'a>>) -> Self {
        Self { text, root, found: Vec::new() }
    }

    /// Notes what is wrong with the value of a key; only its first mistake counts.
    pub(crate) fn add(&mut self, key: &str, message: &str) {
        if self.found.len() < MISTAKES_MAX && !self.found.iter().any(|(_, known, _)| known == key) {
            let line = line(self.text, position_of(self.root.get_ref(), key));
            self.found.push((line, key.into(), message.into()));
        }
    }

    /// Names every key that is not in `known`, with its new name if it had another one before.
    pub(crate) fn unknown_keys(&mut self, known: &toml::Table) {
        let (text, found) = (self.text, &mut self.found);
        unknown_keys(self.root.get_ref(), known, "", &mut |key, start, message| {
            found.push((line(text, Some(start)), key, message));
            found.len() < MISTAKES_MAX
        });
    }

    /// `value` if there is no mistake.
    pub(crate) fn or<T>(mut self, value: T) -> Result<T, ConfigError> {
        if self.found.is_empty() {
            return Ok(value);
        }
        // What has no line concerns the file as a whole and comes last.
        self.found.sort_by_key(|(line, ..)| line.unwrap_or(usize::MAX));
        let mut mistakes: Vec<String> = self.found.iter().map(|(line, _, m)| located(*line, m)).collect();
        if mistakes.len() >= MISTAKES_MAX {
            mistakes.push(format!("{MISTAKES_MAX} mistakes; the rest of the file was not checked"));
        }
        Err(ConfigError { mistakes })
    }
}

/// Reports every unknown key to `report`, which says whether to go on; returns whether it did.
fn unknown_keys(
    table: &DeTable<'_>,
    known: &toml::Table,
    path: &str,
    report: &mut dyn FnMut(String, usize, String) -> bool,
) -> bool {
    for (key, value) in table {
        let name = key.get_ref().as_ref();
        let (full, start) = (format!("{path}{}", cut(name)), key.span().start);
        let goes_on = match (known.get(name), value.get_ref()) {
            (Some(toml::Value::Table(inner)), DeValue::Table(sub)) => {
                unknown_keys(sub, inner, &format!("{full}."), report)
            }
            (Some(toml::Value::Table(_)), _) if full == "robot" => {
                report(full, start, "robot is a section now: the name is robot.name".into())
            }
            (Some(toml::Value::Table(inner)), _) => {
                let message = format!("{full} is a section; write [{full}] and below it {}", list(inner));
                report(full, start, message)
            }
            (None, DeValue::Table(sub)) if renamed(&format!("{full}.")).is_some() => {
                unknown_keys(sub, &toml::Table::new(), &format!("{full}."), report)
            }
            (None, _) => {
                let new = renamed(&full).map(|new| format!("{full} is called {new} now"));
                let message =
                    new.unwrap_or_else(|| format!("unknown key {full}; allowed here: {}", list(known)));
                report(full, start, message)
            }
            _ => true,
        };
        if !goes_on {
            return false;
        }
    }
    true
}

/// A name as it is shown, cut where it is longer than any of ours.
fn cut(name: &str) -> std::borrow::Cow<'_, str> {
    if name.chars().count() <= NAME_MAX {
        return name.into();
    }
    format!("{}…", name.chars().take(NAME_MAX).collect::<String>()).into()
}

/// The new name of an old key, or of the first one in an old section.
fn renamed(key: &str) -> Option<&'static str> {
    RENAMED.iter().find(|(old, _)| *old == key || key.ends_with('.') && old.starts_with(key)).map(|row| row.1)
}

fn list(known: &toml::Table) -> String {
    known.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
}

/// Gives a field its value, or says what is wrong with it.
pub(crate) fn take(
    row: &ParameterSpec,
    field: &mut dyn Field,
    value: &toml::Value,
    joints: usize,
) -> Result<(), String> {
    let wrong = || {
        let old =
            RENAMED_CHOICES.iter().find(|(key, old, _)| *key == row.name && value.as_str() == Some(old));
        let now = old.map(|(_, _, new)| format!(" (it is called {new:?} now)")).unwrap_or_default();
        Err(format!("{} = {}; expected {}{now}", row.name, shown(value), expected(row, joints)))
    };
    let most = if NAMES.contains(&row.name) { NAME_MAX } else { TEXT_MAX };
    let texts = value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice);
    if let Some(long) = texts.iter().filter_map(toml::Value::as_str).map(str::len).find(|len| *len > most) {
        return Err(format!("{} has {long} bytes; at most {most} are allowed", row.name));
    }
    match row.kind {
        ParameterKind::Text | ParameterKind::Choice(_) => match (value, row.size) {
            (toml::Value::String(text), _) if field.take(FieldValue::Text(text)) => Ok(()),
            (toml::Value::Array(list), Size::AtMost(most)) if list.len() <= most => {
                let texts: Option<Vec<&str>> = list.iter().map(toml::Value::as_str).collect();
                if texts.is_some_and(|texts| field.take(FieldValue::Texts(&texts))) {
                    Ok(())
                } else {
                    wrong()
                }
            }
            _ => wrong(),
        },
        ParameterKind::Number | ParameterKind::Integer | ParameterKind::Flag => {
            let Some(mut numbers) = numbers(row, value, joints) else { return wrong() };
            row.check(&numbers).map_err(|error| error.to_string())?;
            if row.size == Size::Joints {
                numbers.resize(JOINTS, 0.0);
            }
            if field.take(FieldValue::Numbers(&numbers)) { Ok(()) } else { wrong() }
        }
    }
}

fn numbers(row: &ParameterSpec, value: &toml::Value, joints: usize) -> Option<Vec<f64>> {
    let number = |value: &toml::Value| match (row.kind, value) {
        (ParameterKind::Number, toml::Value::Float(number)) => Some(*number),
        #[expect(clippy::cast_precision_loss, reason = "compared with bounds far below 2^53")]
        (ParameterKind::Number | ParameterKind::Integer, toml::Value::Integer(number)) => {
            Some(*number as f64)
        }
        (ParameterKind::Flag, toml::Value::Boolean(flag)) => Some(f64::from(u8::from(*flag))),
        _ => None,
    };
    let (least, most) = match (row.size, value) {
        (Size::One, one) => return Some(vec![number(one)?]),
        (Size::Exactly(count), _) => (count, count),
        (Size::Joints, _) => (joints, joints),
        (Size::AtMost(count), _) => (0, count),
    };
    let list = value.as_array().filter(|list| (least..=most).contains(&list.len()))?;
    list.iter().map(number).collect()
}

fn expected(row: &ParameterSpec, joints: usize) -> String {
    let (one, many) = match row.kind {
        ParameterKind::Number => ("a number", "numbers"),
        ParameterKind::Integer => ("a whole number", "whole numbers"),
        ParameterKind::Flag => ("true or false", "of true or false"),
        ParameterKind::Text => ("a text in quotes", "texts"),
        ParameterKind::Choice(words) => {
            let quoted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
            return quoted.join(" or ");
        }
    };
    match row.size {
        Size::One => one.into(),
        Size::Exactly(count) => format!("a list of {count} {many}"),
        Size::Joints => format!("a list of {joints} {many}, one for each joint"),
        Size::AtMost(count) if row.kind == ParameterKind::Text => {
            format!("{one}, or a list of 1 to {count} {many}")
        }
        Size::AtMost(count) => format!("a list of up to {count} {many}"),
    }
}

/// A value as a user knows it from the file, long ones cut.
fn shown(value: &toml::Value) -> String {
    match value {
        toml::Value::Array(list) => format!("a list of {}", list.len()),
        toml::Value::Table(_) => "a section".into(),
        toml::Value::String(text) if text.chars().count() > 40 => {
            format!("{:?}…", text.chars().take(40).collect::<String>())
        }
        one => one.to_string(),
    }
}

/// A field as it is written into a file.
pub(crate) fn written(row: &ParameterSpec, field: &dyn Field, joints: usize) -> toml::Value {
    let number = |number: &f64| match row.kind {
        #[expect(clippy::cast_possible_truncation, reason = "whole and below 2^53")]
        ParameterKind::Integer => toml::Value::Integer(*number as i64),
        ParameterKind::Flag => toml::Value::Boolean(*number > 0.5),
        _ => toml::Value::Float(*number),
    };
    let mut written = toml::Value::String(String::new());
    field.see(&mut |value| {
        written = match (value, row.size) {
            (FieldValue::Text(text) | FieldValue::Texts(&[text]), _) => toml::Value::String(text.into()),
            (FieldValue::Texts(texts), _) => texts.to_vec().into(),
            (FieldValue::Numbers([one]), Size::One) => number(one),
            (FieldValue::Numbers(many), size) => {
                let count = if size == Size::Joints { joints } else { many.len() };
                many.iter().take(count).map(number).collect::<Vec<_>>().into()
            }
        };
    });
    written
}

pub(crate) fn find<'a>(table: &'a toml::Table, path: &str) -> Option<&'a toml::Value> {
    match path.split_once('.') {
        None => table.get(path),
        Some((first, rest)) => find(table.get(first)?.as_table()?, rest),
    }
}

fn insert(table: &mut toml::Table, path: &str, value: toml::Value) {
    match path.split_once('.') {
        None => {
            table.insert(path.into(), value);
        }
        Some((first, rest)) => {
            let sub = table.entry(first).or_insert_with(|| toml::Table::new().into());
            if let Some(sub) = sub.as_table_mut() {
                insert(sub, rest, value);
            }
        }
    }
}

fn position_of(table: &DeTable<'_>, path: &str) -> Option<usize> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    let (key, value): (_, &Spanned<DeValue<'_>>) =
        table.iter().find(|(key, _)| key.get_ref().as_ref() == first)?;
    match (rest, value.get_ref()) {
        (Some(rest), DeValue::Table(sub)) => position_of(sub, rest),
        _ => Some(key.span().start),
    }
}

fn line(text: &str, position: Option<usize>) -> Option<usize> {
    Some(1 + text.bytes().take(position?).filter(|&byte| byte == b'\n').count())
}

fn located(line: Option<usize>, message: &str) -> String {
    line.map_or_else(|| message.to_owned(), |line| format!("line {line}: {message}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DEFAULT_TOML;

    fn keys(table: &toml::Table, path: &str, out: &mut Vec<String>) {
        for (key, value) in table {
            match value {
                toml::Value::Table(sub) => keys(sub, &format!("{path}{key}."), out),
                _ => out.push(format!("{path}{key}")),
            }
        }
    }

    fn mistakes(text: &str) -> Vec<String> {
        Config::parse(text).expect_err("it has mistakes").mistakes
    }

    #[test]
    fn the_documented_file_names_every_field_and_gives_the_defaults() {
        assert_eq!(Config::parse(DEFAULT_TOML), Ok(Config::default()));
        let (mut documented, mut known) = (Vec::new(), Vec::new());
        keys(&DEFAULT_TOML.parse().unwrap(), "", &mut documented);
        keys(&Config::default().to_toml(), "", &mut known);
        documented.sort();
        known.sort();
        assert_eq!(documented, known);
    }

    #[test]
    fn what_is_written_reads_back_to_the_same_bits() {
        let mut config = Config::default();
        config.control.gains.eta_arm = 1.0 / 3.0;
        config.simulation.seed = 9_000_000_000_000_000;
        config.board.masked = vec![3, 11];
        let text = toml::to_string(&config.to_toml()).unwrap();
        assert_eq!(Config::parse(&text), Ok(config));
    }

    #[test]
    fn mistakes_are_reported_in_one_pass_with_line_and_range() {
        let text = "[loop]\nrate_hz = 5\n[control.gains]\nvirtual_mass = [4.0, nan, 2.0]\neta_base = inf\n\
                    stiffness = [1, 2, 3, 4, 5, 6, 7]\nposture_rad = [0.0]\nreactivity = \"much\"\n\
                    [startup]\ntare = 1\nlaw = \"follow\"\n[realtime]\npriority = 10.5\ncpu = \"first\"\n[board]\n\
                    masked = [1, \"two\"]\nport = 3\nprot = 1\n[plant]\nkind = [\"none\"]\n";
        assert_eq!(
            mistakes(text),
            [
                "line 2: loop.rate_hz = 5 Hz is outside 100 to 10000 Hz",
                "line 4: control.gains.virtual_mass = NaN kg is outside 0.01 to 1000 kg",
                "line 5: control.gains.eta_base = inf is outside 0.001 to 1000",
                "line 6: control.gains.stiffness = a list of 7; expected a list of 6 numbers",
                "line 7: control.gains.posture_rad = a list of 1; expected a list of 7 numbers, one for each joint",
                "line 8: control.gains.reactivity = \"much\"; expected a number",
                "line 10: startup.tare = 1; expected true or false",
                "line 11: startup.law = \"follow\"; expected \"impedance\" or \"follow-me\"",
                "line 13: realtime.priority = 10.5; expected a whole number",
                "line 14: realtime.cpu = \"first\"; expected a whole number",
                "line 16: board.masked = a list of 2; expected a list of up to 48 whole numbers",
                "line 17: board.port = 3; expected a text in quotes, or a list of 1 to 2 texts",
                "line 18: unknown key board.prot; allowed here: calibration, firmware, gauge, gauge_baud, mask_policy, masked, \
                 model, name, port",
                "line 20: plant.kind = a list of 1; expected \"simulated\" or \"robot\" or \"none\"",
            ]
        );
    }

    #[test]
    fn unknown_keys_are_all_named_with_what_is_allowed() {
        let found = mistakes("[board]\nprot = \"x\"\n[loops]\n[limits]\ntorque_nm.x = 3\n");
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(
            found[0].starts_with("line 2: unknown key board.prot; allowed here: calibration"),
            "{found:?}"
        );
        assert!(found[1].contains("unknown key loops"), "{found:?}");
        assert!(
            found[2].starts_with("line 5: limits.torque_nm = a section; expected a list of 7"),
            "{found:?}"
        );
        assert!(mistakes("board = 3\n")[0].starts_with("line 1: board is a section; write [board]"));
    }

    #[test]
    fn the_way_to_a_base_is_one_and_an_address() {
        let found = |keys: &str| {
            mistakes(&format!("[plant.base]\ndriver = \"ros2\"\n[plant.base.ros2]\nsilence_s = 9.0\n{keys}"))
                .into_iter()
                .filter(|mistake| mistake.contains("ros2.router") || mistake.contains("ros2.interface"))
                .collect::<Vec<_>>()
        };
        for good in ["", "router = \"tcp/192.168.0.200:7447\"\n", "interface = \"192.168.0.10\"\n"] {
            assert_eq!(found(good), [""; 0], "{good}");
        }
        for router in ["192.168.0.200:7447", "tcp/:7447", "tcp/base", "tcp/base:70000", "udp/base:7447"] {
            let said = found(&format!("router = {router:?}\n"));
            assert!(said.len() == 1 && said[0].contains(&format!("router = {router:?}; allowed: such as")));
        }
        assert!(found("interface = \"eth0\"\n")[0].contains("\"eth0\" is no address of this PC"));
        let both = found("router = \"tcp/base:7447\"\ninterface = \"192.168.0.10\"\n");
        assert!(both.len() == 1 && both[0].contains("leave one empty"), "{both:?}");
    }

    #[test]
    fn a_base_stands_before_its_own_time_out_and_can_go_any_way() {
        let wrong = "plant.base.ros2.interface = \"eth0\"\n";
        let found = |keys: &str| mistakes(&format!("plant.base.driver = \"ros2\"\n{wrong}{keys}"));
        let timing = |silence: &str, rate: &str, timeout: &str| {
            found(&format!(
                "plant.base.ros2.silence_s = {silence}\nplant.base.ros2.order_rate_hz = {rate}\n\
                 robot.base.command_timeout_s = {timeout}\n"
            ))
            .into_iter()
            .filter(|mistake| mistake.contains("the base would stop by itself first"))
            .count()
        };
        assert_eq!(timing("0.05", "100.0", "0.25"), 0);
        assert_eq!(timing("0.2", "10.0", "0.25"), 1, "the zero may go out at 0.3 s");
        assert_eq!(timing("0.3", "100.0", "0.25"), 1);
        let differential = found("robot.base.drive = \"differential\"\n");
        assert!(
            differential.iter().any(|mistake| mistake.contains("cannot push it away")),
            "{differential:?}"
        );
    }

    #[test]
    fn a_key_that_was_renamed_is_refused_with_its_new_name() {
        assert_eq!(
            mistakes("robot = \"moca\"\n[geometry]\narm = \"fr3\"\ntaxel_x_m = []\n"),
            [
                "line 1: robot is a section now: the name is robot.name",
                "line 3: geometry.arm is called robot.arm now",
                "line 4: geometry.taxel_x_m is called robot.cover.x_m now",
            ]
        );
        let rows = Config::default().to_toml();
        for (old, new) in RENAMED {
            assert!(find(&rows, new).is_some() && find(&rows, old).is_none(), "{old} {new}");
        }
        for (key, old, new) in RENAMED_CHOICES {
            let (section, name) = key.split_once('.').unwrap();
            let file = |choice| format!("[{section}]\n{name} = {choice:?}\n");
            assert!(mistakes(&file(old))[0].ends_with(&format!("(it is called {new:?} now)")), "{key}");
            assert!(Config::parse(&file(new)).is_ok(), "{key}");
        }
    }

    #[test]
    fn file_of_mistakes_is_read_up_to_100_of_them() {
        let all_unknown: String = (0..20_000).map(|i| format!("key{i} = 1\n")).collect();
        let in_section = format!("[board]\n{all_unknown}");
        for text in [all_unknown, in_section] {
            let found = mistakes(&text);
            assert_eq!(found.len(), MISTAKES_MAX + 1);
            assert_eq!(found[MISTAKES_MAX], "100 mistakes; the rest of the file was not checked");
        }
        let long = mistakes(&format!("{} = 1\n", "k".repeat(100_000)));
        assert!(long[0].len() < 400, "{} bytes", long[0].len());
    }

    #[test]
    fn long_name_or_text_is_refused_with_its_length() {
        let text = |length: usize| "x".repeat(length);
        for (key, most) in [
            ("robot.name", NAME_MAX),
            ("board.name", NAME_MAX),
            ("board.calibration", TEXT_MAX),
            ("telemetry.listen", TEXT_MAX),
        ] {
            let said = format!("line 1: {key} has {} bytes; at most {most} are allowed", most + 1);
            assert_eq!(mistakes(&format!("{key} = {:?}\n", text(most + 1)))[0], said);
        }
        assert!(Config::parse(&format!("robot.name = {:?}\n", text(NAME_MAX))).is_ok());
        assert!(mistakes(&format!("board.port = [{:?}]\n", text(1 << 19)))[0].contains("has 524288 bytes"));
        for name in NAMES {
            let shown = find(&Config::default().to_toml(), name).is_some() || name.starts_with("arm.");
            assert!(shown, "{name} is no setting");
        }
    }

    #[test]
    fn broken_syntax_names_its_line() {
        assert!(mistakes("[loop\n")[0].starts_with("line 1:"));
        assert!(mistakes("[loop]\nrate_hz = 1000\nrate_hz = 500\n")[0].starts_with("line 3:"));
    }

    #[test]
    fn a_file_names_only_what_it_changes() {
        let config = Config::parse("[board]\nport = \"/dev/ttyACM0\"\n").unwrap();
        assert_eq!(config.board.port, "/dev/ttyACM0".into());
        assert_eq!(config.control, Config::default().control);
    }

    #[test]
    fn a_pipe_a_device_and_a_file_without_end_are_refused_at_once() {
        let why = |path: &str| read_text(Path::new(path)).unwrap_err().to_string();
        assert!(why("/dev/zero").starts_with("/dev/zero: not a regular file"));
        assert!(why("/").contains("not a regular file") && why("/nowhere").contains("No such file"));
        let pipe = std::env::temp_dir().join(format!("moca-pipe-{}", std::process::id()));
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        assert!(read_text(&pipe).unwrap_err().to_string().contains("not a regular file"));
        std::fs::remove_file(&pipe).unwrap();
        let large = std::env::temp_dir().join(format!("moca-large-{}", std::process::id()));
        std::fs::write(&large, vec![b'#'; 2 << 20]).unwrap();
        assert!(read_text(&large).unwrap_err().to_string().contains("longer than 1048576 bytes"));
        std::fs::remove_file(&large).unwrap();
    }

    #[test]
    fn contact_limits_of_uncalibrated_cover_need_statement() {
        let limited = mistakes("[protection]\nthresholds = \"limits.toml\"\n");
        assert!(limited.len() == 1 && limited[0].contains("may be 50 % off"), "{limited:?}");
        for good in [
            "[protection]\nuncalibrated_statement = \"who\"\n",
            "[board]\ncalibration = \"c.toml\"\n[protection]\n",
        ] {
            let text = format!("{good}thresholds = \"limits.toml\"\n");
            assert!(Config::parse(&text).is_ok(), "{text}: {:?}", Config::parse(&text));
        }
        let paper = Config::parse("[board]\nmodel = \"paper\"\n").unwrap();
        assert!(paper.uncalibrated().unwrap().contains("55 % off"));
        let all = |config: Config, model| config.cover().unwrap().models.iter().all(|one| *one == model);
        assert!(all(paper, moca_tactile::TaxelModel::PAPER));
        assert!(all(Config::default(), moca_tactile::TaxelModel::PU_LD30));
    }

    #[test]
    fn barrier_on_readings_of_another_curve_is_refused() {
        let barrier = "[protection]\ncontact_barrier = \"pu-ld30\"\n";
        assert!(Config::parse(barrier).is_ok());
        for board in ["model = \"paper\"", "calibration = \"cover.toml\""] {
            let found = mistakes(&format!("[board]\n{board}\n{barrier}"));
            assert!(
                found.iter().any(|m| m.starts_with("line 4: protection.contact_barrier = \"pu-ld30\"")),
                "{found:?}"
            );
        }
        assert!(
            Config::parse("[board]\nmodel = \"paper\"\n[protection]\ncontact_barrier = \"off\"\n").is_ok()
        );
    }

    #[test]
    fn known_friction_has_one_value_for_each_joint_or_none() {
        let friction = |values: &str| format!("[control.compensation]\nfriction_nm = [{values}]\n");
        for allowed in ["", "0.8, 0.8, 0.8, 0.8, 0.5, 0.5, 0.5"] {
            assert!(Config::parse(&friction(allowed)).is_ok(), "{allowed}");
        }
        for (values, part) in [
            ("0.8, 0.8", "friction_nm has 2 values; allowed: none, or one for each of 7 joints"),
            ("0.8, 0.8, 0.8, -0.8, 0.5, 0.5, 0.5", "0 to 20 N·m"),
        ] {
            let found = mistakes(&friction(values));
            assert!(
                found.len() == 1 && found[0].starts_with("line 2: ") && found[0].contains(part),
                "{found:?}"
            );
        }
    }

    #[test]
    fn flange_sensor_needs_its_arm_and_is_the_only_source() {
        let simulated = "[plant]\nflange_sensor = \"simulated\"\n";
        assert!(Config::parse(simulated).is_ok());
        let own = "[plant]\nkind = \"robot\"\nparts = \"arm\"\nflange_sensor = \"own\"\n";
        assert!(Config::parse(own).is_ok());
        for (toml, parts) in [
            (
                "[plant]\nflange_sensor = \"glued\"\n".to_owned(),
                ["plant.flange_sensor = \"glued\"", "\"own\""],
            ),
            (
                "[plant]\nparts = \"base\"\nflange_sensor = \"simulated\"\n".to_owned(),
                ["plant.flange_sensor = \"simulated\" needs an arm", "allowed without one: \"none\""],
            ),
            (
                "[plant]\nflange_sensor = \"own\"\n".to_owned(),
                ["plant.flange_sensor = \"own\"", "allowed with a simulated arm: \"none\", \"simulated\""],
            ),
            (
                own.replace("own", "simulated"),
                ["plant.flange_sensor = \"simulated\"", "allowed with a real arm: \"none\", \"own\""],
            ),
            (
                format!("{simulated}[plant.arm]\nexternal_wrench = \"arm\"\n"),
                ["plant.arm.external_wrench = \"arm\" both give", "\"ours\""],
            ),
            (
                format!("{simulated}[control.compensation]\ntime_s = 0.5\n"),
                [
                    "control.compensation.time_s = 0.5 s follows the momentum observer",
                    "or control.compensation.time_s to 0 s",
                ],
            ),
            (
                format!("{simulated}flange_sensor_deadline_s = 2.0\n"),
                ["flange_sensor_deadline_s = 2", "0.001 to 1 s"],
            ),
            (
                "[simulation.true.flange_sensor]\nnoise_n = -1.0\n".to_owned(),
                ["simulation.true.flange_sensor.noise_n = -1", "0.0001 to 50 N"],
            ),
        ] {
            let found = mistakes(&toml);
            let said = |one: &String| parts.iter().all(|part| one.contains(part));
            assert!(found.iter().any(said), "{toml}: {found:?}");
        }
    }

    #[test]
    fn geometry_without_sense_is_refused() {
        let cover = |key: &str, taxel: usize, value: f64| {
            let mut config = Config::default();
            match key {
                "x_m" => config.robot.cover.x_m[taxel] = value,
                _ => config.robot.cover.inward_rad[taxel] = value,
            }
            let mut found = Vec::new();
            config.check(|_, message| found.push(message));
            found
        };
        let away = cover("inward_rad", 5, 0.0);
        assert!(
            away.len() == 1
                && away[0].contains("T6 at (0.489 m, 0 m) would be pressed away from the base, 180°")
        );
        assert!(cover("inward_rad", 5, 1.5).len() == 1 && cover("inward_rad", 5, 2.0).is_empty());
        assert!(cover("x_m", 1, -0.367)[0].contains("T1 and T2 are"));
        let ignored = "[board]\nmasked = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]\nmask_policy = \"ignore\"\n";
        assert!(mistakes(ignored)[0].starts_with("line 2: board.masked: every taxel is masked"));
        assert!(Config::parse(&ignored.replace("ignore", "stop")).is_ok());
        let far = mistakes("[board]\nmasked = [12]\n[simulation.hand]\ntaxels = [20]\n");
        assert_eq!(far[0], "line 2: board.masked = 12: the cover's taxels are 1 to 11");
        assert_eq!(far[1], "line 4: simulation.hand.taxels = 20: the cover's taxels are 1 to 11");
        let own =
            "[robot]\narm = \"own\"\n[arm]\nurdf = \"none.urdf\"\n[loop]\nrate_hz = 7\n[board]\nport = 3\n";
        let at_once = mistakes(own);
        for words in ["line 4: arm.urdf", "line 6: loop.rate_hz = 7 Hz", "line 8: board.port"] {
            assert!(at_once.iter().any(|found| found.starts_with(words)), "{words}: {at_once:?}");
        }
        let short = mistakes("[robot.cover]\nx_m = [0.1]\n");
        assert!(
            short.contains(
                &"robot.cover.y_m has 11 elements; robot.cover.x_m has 1, one for each taxel".into()
            )
        );
    }

    #[test]
    fn default_hand_presses_taxels_that_a_smaller_cover_has() {
        let text = include_str!("../../../../examples/robots/base-4-taxels.toml");
        let hand = |text: &str| Config::parse(text).unwrap().simulation.hand.taxels;
        assert_eq!(hand(text), [2, 1, 4, 3], "what a file says stays");
        let without = text.split("[simulation.hand]").next().unwrap();
        assert_eq!(hand(without), [1, 2, 3]);
        assert_eq!(hand(""), [6, 2, 10]);
    }
}

//! The user's file of contact limits: every mistake at once, as in the configuration. No numbers are shipped: which part
//! of a body a taxel can touch, and what that part bears, is the user's risk assessment.

use crate::config::ConfigError;
use crate::config::load::{Mistakes, find, read_text, syntax};
use crate::robot::TAXELS;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The user's limits for one taxel, N; `None` never reacts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactLimits {
    /// For the first [`moca_msgs::protection::TRANSIENT_S`].
    pub transient_n: Option<f64>,
    /// From then on.
    pub quasi_static_n: Option<f64>,
}

/// Smallest and largest limit, N: below the first the cover feels nothing, above the second it believes nothing.
const RANGE_N: std::ops::RangeInclusive<f64> = 1.0..=1000.0;
const FIELDS: [&str; 2] = ["transient_n", "quasi_static_n"];

/// Reads a file for a cover of this many taxels; what it does not name has no limit.
///
/// # Errors
/// Every mistake in it, each with its line, or why it could not be read.
pub fn load(path: &Path, taxels: usize) -> Result<[ContactLimits; TAXELS], ConfigError> {
    let text = read_text(path)?;
    parse(&text, taxels).map_err(|error| ConfigError {
        mistakes: error.mistakes.iter().map(|mistake| format!("{}: {mistake}", path.display())).collect(),
    })
}

/// Parses a file's text.
///
/// # Errors
/// As for [`load`].
pub fn parse(text: &str, taxels: usize) -> Result<[ContactLimits; TAXELS], ConfigError> {
    let (root, values) = syntax(text)?;
    let mut mistakes = Mistakes::new(text, root);
    mistakes.unknown_keys(&known(taxels));
    let mut limits = [ContactLimits::default(); TAXELS];
    for (i, limit) in limits.iter_mut().enumerate().take(taxels) {
        let name = format!("T{}", i + 1);
        let mut number = |field: &str| {
            let key = format!("{name}.{field}");
            let value = find(&values, &key)?;
            let number = number(value);
            if !number.is_some_and(|n| RANGE_N.contains(&n)) {
                let shown = number.map_or("not a number".into(), |n| format!("{n} N"));
                let (min, max) = (RANGE_N.start(), RANGE_N.end());
                mistakes.add(&key, &format!("{key} = {shown} is outside {min} to {max} N"));
            }
            number
        };
        *limit = ContactLimits { transient_n: number(FIELDS[0]), quasi_static_n: number(FIELDS[1]) };
        if let (Some(transient_n), Some(quasi_static_n)) = (limit.transient_n, limit.quasi_static_n)
            && transient_n < quasi_static_n
        {
            mistakes.add(
                &format!("{name}.transient_n"),
                &format!(
                    "{name}.transient_n = {transient_n} N is below {name}.quasi_static_n = {quasi_static_n} N; what \
                     may press for long may press for a moment"
                ),
            );
        }
    }
    let stated = find(&values, "source").and_then(toml::Value::as_str).unwrap_or("");
    if limits != [ContactLimits::default(); TAXELS] && stated.trim().is_empty() {
        mistakes.add(
            "source",
            "source is missing: say where the limits come from, e.g. source = \"risk assessment of …\"",
        );
    }
    mistakes.or(limits)
}

/// Every key there may be.
fn known(taxels: usize) -> toml::Table {
    let fields: toml::Table =
        FIELDS.map(|field| (field.to_owned(), toml::Value::Float(0.0))).into_iter().collect();
    let taxels = (1..=taxels).map(|n| (format!("T{n}"), toml::Value::Table(fields.clone())));
    taxels.chain([("source".to_owned(), toml::Value::String(String::new()))]).collect()
}

fn number(value: &toml::Value) -> Option<f64> {
    match value {
        toml::Value::Float(number) => Some(*number),
        #[expect(clippy::cast_precision_loss, reason = "compared with bounds far below 2^53")]
        toml::Value::Integer(number) => Some(*number as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The documented empty file.
    const TEMPLATE_TOML: &str = include_str!("../../config/contact-limits.toml");

    #[test]
    fn the_template_is_valid_and_limits_nothing() {
        assert_eq!(parse(TEMPLATE_TOML, 11), Ok([ContactLimits::default(); TAXELS]));
        // what it shows as an example is valid too, once a number is written
        let uncommented = TEMPLATE_TOML
            .replace("# [T", "[T")
            .replace("# source", "source")
            .replace("# transient_n =", "transient_n = 1")
            .replace("# quasi_static_n =", "quasi_static_n = 1");
        assert_ne!(parse(&uncommented, 11), Ok([ContactLimits::default(); TAXELS]));
        parse(&uncommented, 11).unwrap();
    }

    #[test]
    fn limits_are_taken_taxel_by_taxel() {
        let limits = parse(
            "source = \"x\"\n[T2]\ntransient_n = 100\nquasi_static_n = 50.5\n[T11]\nquasi_static_n = 20\n",
            11,
        )
        .unwrap();
        assert_eq!(limits[1], ContactLimits { transient_n: Some(100.0), quasi_static_n: Some(50.5) });
        assert_eq!(limits[10], ContactLimits { transient_n: None, quasi_static_n: Some(20.0) });
        assert_eq!(limits[0], ContactLimits::default());
    }

    #[test]
    fn every_mistake_is_reported_with_line_value_and_range() {
        let text = "[T1]\ntransient_n = 0\nquasi_static_n = nan\n[T12]\n[T2]\ntransient = 3\n[T3]\ntransient_n = 10\nquasi_static_n = 20\n[T4]\ntransient_n = \"a\"\n";
        let error = parse(text, 11).unwrap_err().to_string();
        for part in [
            "line 2: T1.transient_n = 0 N is outside 1 to 1000 N",
            "line 3: T1.quasi_static_n = NaN N is outside 1 to 1000 N",
            "line 4: unknown key T12; allowed here: T1,",
            "line 6: unknown key T2.transient; allowed here: quasi_static_n, transient_n",
            "line 8: T3.transient_n = 10 N is below T3.quasi_static_n = 20 N",
            "line 11: T4.transient_n = not a number is outside 1 to 1000 N",
        ] {
            assert!(error.contains(part), "{part} not in:\n{error}");
        }
        assert!(parse("[T1]\ntransient_n = 10\n", 11).unwrap_err().to_string().contains("source is missing"));
        assert!(
            parse("T1 = 3\n", 11)
                .unwrap_err()
                .to_string()
                .contains("line 1: T1 is a section; write [T1] and below it")
        );
    }
}

//! Commands on a terminal besides the loop, and the report of a run.

#[cfg(feature = "tls")]
pub mod access;
pub mod calibrate;
mod configuration;
pub mod doctor;
pub mod gripper;
pub mod log;
mod log_story;
pub mod operate;
pub mod operator;
pub mod params;
pub mod payload;
pub mod remote;
pub mod report;
mod status;
pub mod target;
pub mod terminal;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use moca_msgs::table::{Field, FieldValue, ParameterKind, Typed};

/// Parser of an argument that is one word of a choice, as in a configuration.
fn word<T: Field + Typed + Default + Clone + Send + Sync + 'static>() -> impl TypedValueParser<Value = T> {
    let words = match T::KIND {
        ParameterKind::Choice(words) => words,
        _ => &[],
    };
    PossibleValuesParser::new(words).map(|word| {
        let mut value = T::default();
        value.take(FieldValue::Text(&word));
        value
    })
}

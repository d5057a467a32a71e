//! `mocad params`: the schema, the present values, and how to change them from the command line.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::remote::{DaemonArguments, Refused, ask, connect, settled};
use crate::config::Config;
use crate::config::schema;
use anyhow::{Context, Result, anyhow, bail};
use clap::{Args, Subcommand};
use moca_msgs::Request;
use moca_telemetry::{ParameterDescription, ParameterForm, RobotDescription};
use std::path::PathBuf;

/// Action on parameters.
#[derive(Subcommand)]
pub enum Command {
    /// List every parameter with value, unit, range and default, of a running daemon or of a configuration file.
    List(ListArguments),
    /// Change a live parameter of a running daemon: `set control.gains.stiffness "[800, 800, 800, 40, 40, 40]"`.
    Set(SetArguments),
    /// Print the JSON schema of the configuration file.
    Schema,
}

/// Parameters to list.
#[derive(Args)]
pub struct ListArguments {
    /// Only names that contain this.
    filter: Option<String>,
    /// Ask no daemon: list the defaults, or the configuration file.
    #[arg(long)]
    offline: bool,
    /// Configuration file to list instead of a running daemon's values.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    daemon: DaemonArguments,
}

/// Parameter to set.
#[derive(Args)]
pub struct SetArguments {
    /// Dotted name as in the configuration file; its last part is enough where it is unique.
    name: String,
    /// New value as in the configuration file: a number, true or false, or a list in brackets.
    #[arg(allow_hyphen_values = true)]
    value: String,
    #[command(flatten)]
    daemon: DaemonArguments,
}

/// Carries out one command.
///
/// # Errors
/// No daemon, a bad value (named with unit and range), or a refusal.
pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::List(arguments) => list(arguments),
        Command::Set(arguments) => set(arguments),
        Command::Schema => {
            println!("{:#}", schema::json_schema());
            Ok(())
        }
    }
}

fn list(arguments: &ListArguments) -> Result<()> {
    let parameters = match (&arguments.config, arguments.offline) {
        (Some(path), _) => {
            let config = Config::load(path).map_err(|error| anyhow!("{}:\n{error}", path.display()))?;
            schema::describe(&config)
        }
        (None, true) => schema::describe(&Config::default()),
        (None, false) => {
            let (connection, _) = connect(&arguments.daemon.address)
                .context("is a daemon running? `mocad params list --offline` lists the defaults")?;
            settled(&connection)?.0.parameters.clone()
        }
    };
    let filter = arguments.filter.as_deref().unwrap_or_default();
    for parameter in parameters.iter().filter(|parameter| parameter.name.contains(filter)) {
        println!("{}", shown(parameter));
    }
    Ok(())
}

fn shown(parameter: &ParameterDescription) -> String {
    let (value, default) = (parameter.shown(&parameter.value), parameter.shown(&parameter.default));
    let units =
        if parameter.units.is_empty() { String::new() } else { format!(" {}", parameter.units.join(", ")) };
    let range = match &parameter.form {
        ParameterForm::Number | ParameterForm::Integer => format!("{} to {}", parameter.min, parameter.max),
        ParameterForm::Flag => "true or false".into(),
        ParameterForm::Text => "text".into(),
        ParameterForm::Choice(words) => words.join(" or "),
    };
    let changed = if value == default { String::new() } else { format!("; default {default}") };
    let live = if parameter.live { "live" } else { "at start" };
    format!("{} = {value}{units}\n    {} ({live}; {range}{changed})", parameter.name, parameter.description)
}

fn set(arguments: &SetArguments) -> Result<()> {
    let values = numbers(&arguments.value)?;
    let (connection, robot) = connect(&arguments.daemon.address)?;
    let number = number_of(&robot, &arguments.name)?;
    let parameter = robot.parameters.get(number).context("the daemon's list of parameters is too short")?;
    let checked = parameter.checked(&values).map_err(Refused)?;
    let request = Request::SetParameter { parameter: u8::try_from(number)?, values: checked };
    let outcome = ask(&connection, request);
    // Leaving without giving the command back would stop a moving robot.
    connection.release();
    let (name, value) = (&parameter.name, &arguments.value);
    outcome?.map_err(|refusal| Refused(format!("{name} = {value}: {}", parameter.why(refusal))))?;
    println!("{name} = {value}");
    Ok(())
}

fn number_of(robot: &RobotDescription, name: &str) -> Result<usize> {
    let found = |parameter: &ParameterDescription| {
        parameter.name == name || parameter.name.rsplit('.').next() == Some(name)
    };
    let mut numbers = (0..).zip(&robot.parameters).filter(|(_, parameter)| found(parameter));
    match (numbers.next(), numbers.next()) {
        (Some((number, _)), None) => Ok(number),
        (None, _) => {
            bail!(Refused(format!("no parameter is called {name}: `mocad params list` names them all")))
        }
        (Some((_, one)), Some((_, other))) => {
            bail!("{name} may be {} or {}: say which", one.name, other.name)
        }
    }
}

/// The elements of a value written as in the configuration file.
fn numbers(text: &str) -> Result<Vec<f64>> {
    let table: toml::Table = format!("value = {text}").parse().map_err(|_| {
        anyhow!("{text:?} is no value; allowed: a number, true or false, or a list such as \"[1, 2, 3]\"")
    })?;
    match table.get("value").filter(|_| table.len() == 1).and_then(schema::value) {
        Some(moca_telemetry::ParameterValue::Numbers(numbers)) => Ok(numbers),
        _ => bail!("{text:?} is no number: only numbers and flags can be changed while the loop runs"),
    }
}

#[cfg(test)]
mod tests {
    use super::numbers;

    #[test]
    fn values_are_read_as_in_the_file() {
        assert_eq!(numbers("2.5").unwrap(), [2.5]);
        assert_eq!(numbers("-1").unwrap(), [-1.0]);
        assert_eq!(numbers("[1, 2.0, 3e2]").unwrap(), [1.0, 2.0, 300.0]);
        assert_eq!(numbers("true").unwrap(), [1.0]);
        for bad in ["", "fast", "\"text\"", "[1, \"a\"]", "1\nx = 2", "{}"] {
            assert!(numbers(bad).is_err(), "{bad:?}");
        }
    }
}

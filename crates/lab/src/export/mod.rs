//! `moca-lab export`: logs as tables for other programs, and as data sets to learn from.

mod frames;
mod lerobot;
mod parquet_file;
mod quantities;

use crate::export::parquet_file::{Column, Values};
use crate::export::quantities::Parts;
use anyhow::{Context, Result, ensure};
use moca_daemon::cli::progress::Progress;
use moca_msgs::Sample;
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogReader, Record};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Writes logs in forms that other programs read.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    form: Form,
}

#[derive(clap::Subcommand)]
enum Form {
    /// A LeRobot data set, version 3.0: each stretch of a log without a gap in which a law is in control is an episode.
    Lerobot(lerobot::Arguments),
    /// A table as text: a row for each instant that a viewer is shown, names with units.
    Csv(TableArguments),
    /// The table as a Parquet file.
    Parquet(TableArguments),
}

#[derive(clap::Args)]
struct TableArguments {
    /// A log; of one that was split, its parts in order.
    #[arg(required = true)]
    logs: Vec<PathBuf>,
    /// The file to write; it must not exist.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Writes what was asked for and says what is in it.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let told = match &arguments.form {
        Form::Lerobot(arguments) => lerobot::run(arguments)?,
        Form::Csv(table) => export(table, |path, columns| {
            std::fs::write(path, csv(columns)).with_context(|| format!("cannot write {}", path.display()))
        })?,
        Form::Parquet(table) => {
            export(table, |path, columns| parquet_file::write(path, columns, &[], &[columns[0].rows()]))?
        }
    };
    println!("{told}");
    Ok(())
}

/// A log as far as it is whole.
struct Run {
    description: RobotDescription,
    samples: Vec<Sample>,
}

/// Reads one log; what is missing of it is said on the terminal.
#[expect(clippy::print_stderr, reason = "a table does not say what it lacks")]
fn read(path: &Path) -> Result<Run> {
    let mut reader = LogReader::open(path)?;
    let mut progress = Progress::new(path.display().to_string());
    let mut samples = Vec::new();
    while let Some(record) = reader.next() {
        if let Record::Sample(sample) = record {
            samples.push(*sample);
        }
        progress.at(reader.part_read());
    }
    progress.end();
    if let Some(cut) = reader.cut() {
        eprintln!("{}: {cut}", path.display());
    }
    ensure!(!samples.is_empty(), "{} holds no samples", path.display());
    Ok(Run { description: reader.description().clone(), samples })
}

fn export(table: &TableArguments, write: impl Fn(&Path, &[Column]) -> Result<()>) -> Result<String> {
    let TableArguments { logs, out } = table;
    ensure!(!out.exists(), "{} exists", out.display());
    let mut samples = Vec::new();
    let mut description = RobotDescription::default();
    for log in logs {
        let run = read(log)?;
        description = run.description;
        samples.extend(run.samples);
    }
    quantities::join_quaternions(&mut samples);
    let columns = columns(Parts::of(&description, &samples), &samples);
    write(out, &columns)?;
    Ok(format!("{}: {} rows, {} columns", out.display(), samples.len(), columns.len()))
}

/// Every quantity of every sample.
fn columns(parts: Parts, samples: &[Sample]) -> Vec<Column> {
    let texts = |of: fn(&Sample) -> String| Values::Texts(samples.iter().map(of).collect());
    let mut columns = vec![
        Column::new(
            "time_s",
            Values::Doubles(samples.iter().map(|s| moca_msgs::seconds(s.time_ns)).collect()),
        ),
        Column::new("mode", texts(|s| s.mode.name().into())),
        Column::new("fault", texts(|s| s.fault.map_or("", moca_msgs::Fault::code).into())),
    ];
    for quantity in quantities::all(parts) {
        let values = samples.iter().map(|sample| quantity.of(sample)).collect();
        columns.push(Column::new(&quantity.name, Values::Doubles(values)));
    }
    columns
}

/// A heading, then a row for each sample; what is not finite is an empty field.
fn csv(columns: &[Column]) -> String {
    let mut text = columns.iter().map(|column| column.name.as_str()).collect::<Vec<_>>().join(",") + "\n";
    for row in 0..columns.first().map_or(0, Column::rows) {
        for (place, column) in columns.iter().enumerate() {
            if place > 0 {
                text.push(',');
            }
            // Writing into a String cannot fail.
            let _ = match &column.values {
                Values::Doubles(values) if values[row].is_finite() => write!(text, "{}", values[row]),
                Values::Texts(values) => write!(text, "{}", values[row]),
                _ => Ok(()),
            };
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests;

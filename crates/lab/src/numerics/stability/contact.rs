//! The loop in contact, one thing at a time: its rate, the age of what it feels, the foam; jitter and lost frames; mass,
//! foam and calibration other than described; a clamp, friction; two minutes of it; single precision.
//!
//! The physics take 0.5 ms by the leapfrog whatever the rate, and the ideal sensor is the mean of its physics steps over
//! 10 ms, shown after an age that is set: neither changes with the rate of the loop.

use super::{BOUNDED_N, Case, Special, Trial, single_precision, trial};
use crate::study::{self, Column};
use anyhow::Result;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use std::fmt::Write as _;

const RATES_HZ: [u32; 5] = [100, 200, 500, 1000, 2000];
const AGES_MS: [f64; 3] = [0.0, 10.0, 20.0];
const FOAMS: [f64; 3] = [0.5, 1.0, 2.0];
/// The ideal sensor and the physics, for every rate alike.
const UNCONFOUNDED: [&str; 5] =
    ["sensor.samples=steps", "sensor.period_ms=10", "engine=analytic", "integrator=leapfrog", "step_ms=0.5"];
/// Shipped settings on a calibrated cover with our firmware, led at 0.1 m/s into the leg before T6.
const SHIPPED: &[&str] = &[
    "sensor.firmware=moca",
    "law=barrier",
    "person.taxel=T6",
    "speed=0.1",
    "engine=analytic",
    "integrator=leapfrog",
    "step_ms=1",
];
/// A row of the second table.
struct Row {
    name: &'static str,
    set: &'static [&'static str],
    special: Special,
    /// Ratio of the cover's reading to the true force.
    reading: f64,
}

const fn shipped(name: &'static str, set: &'static [&'static str]) -> Row {
    Row { name, set, special: Special::None, reading: 1.0 }
}

const fn faulty(name: &'static str, fault: &'static str) -> Row {
    Row { special: Special::Fault(fault), ..shipped(name, &[]) }
}

const fn misread(name: &'static str, reading: f64) -> Row {
    Row { reading, ..shipped(name, &[]) }
}

const fn clamped(name: &'static str, set: &'static [&'static str]) -> Row {
    Row { special: Special::BothSides, ..shipped(name, set) }
}

/// Two minutes, nobody steps away; the run's first 20 s are not counted as drift.
const LONG: [Row; 5] = [
    shipped(
        "two minutes against a leg that is held",
        &["person.fixed=true", "duration=120", "person.steps_away_s=1000"],
    ),
    shipped("two minutes against a leg that stands free", &["duration=120", "person.steps_away_s=1000"]),
    shipped(
        "two minutes, 10 N leant on the standing robot",
        &[
            "duration=120",
            "person.steps_away_s=1000",
            "speed=0",
            "person.gap=0.002",
            "person.at_s=0.1",
            "person.lean=10",
        ],
    ),
    shipped(
        "two minutes, nobody there",
        &["duration=120", "person.steps_away_s=1000", "speed=0", "person.gap=2"],
    ),
    shipped(
        "two minutes against a leg that is held, 100 Hz mean",
        &["person.fixed=true", "duration=120", "person.steps_away_s=1000", "sensor=ideal", "barrier=foam"],
    ),
];

const ROWS: [Row; 20] = [
    shipped("as described", &[]),
    faulty("one period in contact missed", "missed-slot"),
    faulty("20 periods in contact missed", "missed-20-slots"),
    faulty("400 ms of frames in one burst", "host-stall"),
    faulty("every other frame missing", "slow-board"),
    faulty("a byte lost in one line of six", "byte-lost"),
    faulty("no bytes any more", "silent"),
    shipped("base 10 % lighter", &["base.mass=94.5"]),
    shipped("base 10 % heavier", &["base.mass=115.5"]),
    shipped("person 10 % lighter", &["person.mass=67.5"]),
    shipped("person 10 % heavier", &["person.mass=82.5"]),
    shipped("foam 10 % softer", &["foam.scale=0.9"]),
    shipped("foam 10 % stiffer", &["foam.scale=1.1"]),
    misread("cover reads 10 % less", 0.9),
    misread("cover reads 10 % more", 1.1),
    shipped("no friction", &["person.friction=0"]),
    shipped("friction 1", &["person.friction=1"]),
    clamped(
        "held between two, stock board, paper's law",
        &["law=paper", "sensor.firmware=stock-2018", "person.fixed=true", "person.taxel=T1"],
    ),
    clamped(
        "held between two, stock board, barrier",
        &["sensor.firmware=stock-2018", "person.fixed=true", "person.taxel=T1"],
    ),
    clamped("held between two, our firmware, barrier", &["person.fixed=true", "person.taxel=T1"]),
];

fn of_map(rate_hz: u32, age_ms: f64, foam: f64) -> Result<(String, Trial)> {
    let own =
        [format!("rate_hz={rate_hz}"), format!("sensor.delay_ms={age_ms}"), format!("foam.scale={foam}")];
    let set: Vec<String> = UNCONFOUNDED.iter().map(|s| (*s).to_owned()).chain(own).collect();
    Ok((format!("{rate_hz} Hz, {age_ms} ms older, foam × {foam}"), trial("ideal", &set)?))
}

fn of_row(row: &Row) -> Result<(String, Trial)> {
    let set: Vec<String> = SHIPPED.iter().chain(row.set).map(|s| (*s).to_owned()).collect();
    let mut trial = Trial { special: row.special, ..trial("stock", &set)? };
    trial.settings.true_reading = row.reading;
    Ok((row.name.to_owned(), trial))
}

/// Every trial in the order of the tables.
pub(crate) fn trials() -> Result<Vec<(String, Trial)>> {
    let map = FOAMS.iter().flat_map(|foam| AGES_MS.map(|age| (age, *foam)));
    let map = map.flat_map(|(age, foam)| RATES_HZ.map(|rate| of_map(rate, age, foam)));
    map.chain(ROWS.iter().chain(&LONG).map(of_row)).collect()
}

/// All of them, run.
pub(crate) fn cases() -> Result<Vec<Case>> {
    let trials = trials()?;
    parallel::run("contact", &trials, |(name, trial)| Ok(trial.run(name)))
}

/// A few of them, run: the slowest and the usual rate, a fault, two minutes.
#[cfg(test)]
pub(crate) fn few() -> Result<Vec<Case>> {
    let named = |name: &str| {
        let few = [
            "100 Hz, 0 ms older, foam × 1",
            "1000 Hz, 0 ms older, foam × 1",
            "20 periods in contact missed",
            "two minutes against a leg that is held, 100 Hz mean",
        ];
        few.contains(&name)
    };
    let trials: Vec<_> = trials()?.into_iter().filter(|(name, _)| named(name)).collect();
    parallel::run("contact", &trials, |(name, trial)| Ok(trial.run(name)))
}

/// Returns a case's result in a few words.
pub(crate) fn verdict(case: &Case) -> String {
    match &case.stopped {
        Some(why) => format!("{:.0} N, stops: {}", case.peak_n, why.split(':').next().unwrap_or(why)),
        None if !case.touched() => "nobody touched".into(),
        None if case.bounded => format!("{:.1} N", case.peak_n),
        None if case.peak_n < BOUNDED_N => format!("{:.0} N, **swings on**", case.peak_n),
        None => format!("**{:.0} N**", case.peak_n),
    }
}

/// The settings of the law in either scalar: those of the map at 1 kHz.
fn either_scalar(foam: f64) -> Result<Settings> {
    Ok(of_map(1000, 0.0, foam)?.1.settings)
}

/// Compares single precision on one foam: both peaks, the differences along the way, and the cost of both.
pub(crate) fn single_line(foam: f64) -> Result<(String, String)> {
    let settings = either_scalar(foam)?;
    let [(double, double_s), (single, single_s)] = single_precision::both(&settings)?;
    let [base_m, yaw_rad, flange_m, force_n] = double.off(&single);
    let [double_ms, single_ms] = [double_s, single_s].map(|cpu_s| 1e3 * cpu_s / settings.duration_s);
    let figures = format!(
        "| × {foam} | {:.2} N | {:.2} N | {base_m:.0e} m | {yaw_rad:.0e} rad | {flange_m:.0e} m | {force_n:.0e} N |",
        double.peak_n, single.peak_n
    );
    Ok((figures, format!(" {double_ms:.0} | {single_ms:.0} |")))
}

const SINGLE_HEAD: &str = "| the law in f64 and in f32, foam | peak, f64 | f32 | base apart | yaw | flange | force | CPU, ms a simulated second, f64 | f32 |\n|---|---|---|---|---|---|---|---|---|";

/// The law in either scalar, a line for each foam.
pub(super) fn single_table() -> Result<String> {
    let mut out = format!("{SINGLE_HEAD}\n");
    for foam in FOAMS {
        let (figures, times) = single_line(foam)?;
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{figures}{times}");
    }
    Ok(out)
}

const COLUMNS: &[Column<Case>] = &[
    ("in contact", |case| case.name.clone()),
    ("peak", verdict),
    ("energy given out", |case| format!("{:.2} J", case.energy_out_j)),
    ("base drifts", |case| case.drift_mm.map_or("–".into(), |mm| format!("{mm:.2} mm"))),
    ("CPU, ms a simulated second", |case| format!("{:.0}", cost_ms(case))),
];

/// A line of the second table without what it cost.
#[cfg(test)]
pub(crate) fn row(case: &Case) -> String {
    study::line(&COLUMNS[..COLUMNS.len() - 1], case).trim_end().into()
}

/// CPU time of a simulated second, ms.
fn cost_ms(case: &Case) -> f64 {
    1e3 * case.cpu_s / case.sim_s
}

/// The tables in Markdown: map, rows, single precision.
pub(crate) fn markdown() -> Result<String> {
    let cases = cases()?;
    let mut out = String::from("| foam | reading older by |");
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "{}\n|---|---|{}",
        RATES_HZ.map(|hz| format!(" {hz} Hz |")).concat(),
        "---|".repeat(RATES_HZ.len())
    );
    let (map, rows) = cases.split_at(FOAMS.len() * AGES_MS.len() * RATES_HZ.len());
    let places = FOAMS.iter().flat_map(|foam| AGES_MS.map(|age| (age, *foam)));
    for ((age_ms, foam), cells) in places.zip(map.chunks(RATES_HZ.len())) {
        let cells: String = cells.iter().map(|case| format!(" {} |", verdict(case))).collect();
        let _ = writeln!(out, "| × {foam} | {age_ms} ms |{cells}");
    }
    let dearest = (0..RATES_HZ.len()).map(|rate| {
        let of_rate = map.iter().skip(rate).step_by(RATES_HZ.len());
        format!(" {:.0} |", of_rate.map(cost_ms).fold(0.0, f64::max))
    });
    let _ = writeln!(out, "| CPU, ms a simulated second, at most | |{}", dearest.collect::<String>());
    let _ = write!(out, "\n{}\n{}", study::table(COLUMNS, rows), single_table()?);
    Ok(out)
}

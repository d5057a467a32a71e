//! `moca-lab attack`: what people, programs and clients can do to the robot for minutes, and what must hold meanwhile and
//! after. Each row states its seed and repeats by itself.
#![expect(clippy::print_stdout, reason = "this is what the command is for")]

mod network;
mod world;

use crate::robustness::watch::Findings;
use anyhow::{Result, ensure};
use moca_experiments::parallel;
use moca_msgs::Law;
use moca_tactile::Firmware;
use network::Crowd;
use serde::Serialize;

/// Robot time of a program and of a lean, s: those of the documents.
const PROGRAM_S: f64 = 1800.0;
const LEAN_S: f64 = 300.0;
/// Taxels (1 is T1) and forces of the leans, N.
const LEANS: [(usize, f64); 6] = [(1, 100.0), (3, 40.0), (4, 80.0), (5, 100.0), (7, 100.0), (11, 150.0)];

/// Long leans, random programs, request storms and hostile clients: no limit passed, every stop obeyed, a way out of every mode.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only the rows whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Robot time of each row, s; without it a lean lasts 300 s and a program 1800 s.
    #[arg(long)]
    seconds: Option<f64>,
    /// One JSON object a row instead of a table.
    #[arg(long)]
    json: bool,
}

/// Attack on the robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    /// A hand leans on one taxel all the time.
    Lean {
        /// 1 is T1.
        taxel: usize,
        force_n: f64,
    },
    /// Presses, requests, board faults, targets and live changes, all at random.
    Program,
    /// A request in every tick.
    Storm,
    /// Clients that crowd the server, while another one asks for a stop.
    Network(Crowd),
}

/// One row of the table.
#[derive(Clone, Copy, Debug, Serialize)]
struct Row {
    kind: Kind,
    law: Law,
    firmware: Firmware,
    seed: u64,
    seconds: f64,
}

impl Row {
    fn name(&self) -> String {
        let Self { law, firmware, seed, .. } = self;
        let law = match law {
            Law::Impedance => "impedance",
            Law::FollowMe => "follow-me",
        };
        let firmware = firmware.name();
        match self.kind {
            Kind::Lean { taxel, force_n } => format!("lean T{taxel} {force_n} N, {law}, {firmware}"),
            Kind::Program => format!("program, {law}, {firmware}, seed {seed}"),
            Kind::Storm => format!("storm, {law}, {firmware}, seed {seed}"),
            Kind::Network(crowd) => format!("network, {}", crowd.name()),
        }
    }

    fn run(&self) -> Result<Findings> {
        match self.kind {
            Kind::Network(crowd) => network::run(crowd),
            _ => world::run(self),
        }
    }
}

/// Every row, programs first: they take longest.
fn rows(seed: u64, seconds: Option<f64>) -> Vec<Row> {
    let mut rows = Vec::new();
    for law in [Law::Impedance, Law::FollowMe] {
        for firmware in [Firmware::Moca, Firmware::Stock2018] {
            let seconds = |default| seconds.unwrap_or(default);
            rows.push(Row { kind: Kind::Program, law, firmware, seed, seconds: seconds(PROGRAM_S) });
            rows.push(Row { kind: Kind::Storm, law, firmware, seed, seconds: seconds(LEAN_S) });
        }
        for (taxel, force_n) in LEANS {
            let (kind, firmware) = (Kind::Lean { taxel, force_n }, Firmware::Moca);
            rows.push(Row { kind, law, firmware, seed, seconds: seconds.unwrap_or(LEAN_S) });
        }
    }
    let of_network = |crowd| Row {
        kind: Kind::Network(crowd),
        law: Law::Impedance,
        firmware: Firmware::Moca,
        seed,
        seconds: 0.0,
    };
    rows.extend(Crowd::ALL.map(of_network));
    rows
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    if let Some(seconds) = arguments.seconds {
        ensure!((10.0..=36_000.0).contains(&seconds), "--seconds {seconds} s; allowed: 10 to 36000 s");
    }
    let mut rows = rows(arguments.seed, arguments.seconds);
    rows.retain(|row| row.name().contains(&arguments.only));
    ensure!(!rows.is_empty(), "--only {:?}: no row has that in its name", arguments.only);
    let found = outcomes(&rows)?;
    if arguments.json {
        for (row, found) in rows.iter().zip(&found) {
            println!("{}", serde_json::json!({ "row": row, "found": found }));
        }
    } else {
        print!("{}", table(&rows, &found));
    }
    let count: u64 = found.iter().map(|found| found.violation_count).sum();
    let restless = found.iter().filter(|found| !found.restless.is_empty()).count();
    ensure!(count == 0 && restless == 0, "{count} violations, no rest after a touch in {restless} rows");
    Ok(())
}

fn outcomes(rows: &[Row]) -> Result<Vec<Findings>> {
    // The network's rows need the processor for themselves.
    let (crowds, worlds): (Vec<Row>, Vec<Row>) =
        rows.iter().copied().partition(|row| matches!(row.kind, Kind::Network(_)));
    let mut found = parallel::run("attack", &worlds, Row::run)?;
    for crowd in &crowds {
        found.push(crowd.run()?);
    }
    Ok(found)
}

/// The table of all rows for the documents.
pub(crate) fn markdown() -> Result<String> {
    let mut rows = rows(1, None);
    // Of these only the wall clock would be shown.
    rows.retain(|row| !matches!(row.kind, Kind::Network(_)));
    let found = outcomes(&rows)?;
    Ok(table(&rows, &found))
}

fn table(rows: &[Row], found: &[Findings]) -> String {
    let mut text = "| attack | robot time, s | stops | slowest stop, ticks | joint speed | torque | cover commanded \
                    | cover measured | cover with pushes | base energy, J | 2 s after a touch, m/s | violations |\n\
                    |---|---|---|---|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let mut said = String::new();
    for (row, found) in rows.iter().zip(found) {
        text += &shown(row, found);
        for violation in found.violations.iter().chain(&found.restless) {
            said += &format!("\n- {}: {violation}", row.name());
        }
    }
    text + &said + if said.is_empty() { "" } else { "\n" }
}

/// The row of this name, found anew.
#[cfg(test)]
pub(crate) fn row_named(name: &str) -> Result<String> {
    let rows = rows(1, None);
    let row = rows.iter().find(|row| row.name() == name).expect("an attack of that name");
    Ok(shown(row, &row.run()?))
}

/// One row of the table.
fn shown(row: &Row, found: &Findings) -> String {
    let stops = found.stops.iter().map(|(code, count)| format!("{count} {code}")).collect::<Vec<_>>();
    let stops = if stops.is_empty() { "–".into() } else { stops.join(", ") };
    format!(
        "| {} | {:.0} | {stops} | {} of {} asked | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.2} | {:.4} | {} |\n",
        row.name(),
        row.seconds,
        found.slowest_stop_ticks,
        found.stops_asked,
        found.largest_joint_speed_used,
        found.largest_torque_used,
        found.largest_cover_command_used,
        found.largest_cover_speed_of_limit,
        found.largest_cover_speed_used,
        found.largest_base_energy_j,
        found.restless_m_s,
        found.violation_count
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robustness::watch::INERTIA_ROUNDED;

    /// Short version of the campaign: a minute of robot time in all.
    #[test]
    fn minute_of_every_attack_passes_no_limit() {
        let row = |kind, law, firmware, seconds| Row { kind, law, firmware, seed: 3, seconds };
        let lean = Kind::Lean { taxel: 6, force_n: 60.0 };
        let rows = [
            row(Kind::Program, Law::Impedance, Firmware::Moca, 20.0),
            row(Kind::Program, Law::FollowMe, Firmware::Stock2018, 20.0),
            row(Kind::Storm, Law::FollowMe, Firmware::Moca, 10.0),
            row(lean, Law::FollowMe, Firmware::Moca, 10.0),
        ];
        for (row, found) in rows.iter().zip(outcomes(&rows).unwrap()) {
            assert!(found.violations.is_empty(), "{}: {:#?}", row.name(), found.violations);
            assert!(found.restless.is_empty(), "{}: {:#?}", row.name(), found.restless);
            // By the definition of the limit, and next to the limit itself.
            assert!(found.largest_cover_speed_used < 1.0 + INERTIA_ROUNDED, "{}: {found:?}", row.name());
            assert!(found.largest_cover_speed_of_limit < 1.1, "{}: {found:?}", row.name());
            assert!(found.stops_asked > 0 && found.slowest_stop_ticks <= 1, "{}: {found:?}", row.name());
            let moved = found.largest_base_speed_m_s > 0.01;
            assert!(moved || row.kind == Kind::Storm, "{}: it never moved: {found:?}", row.name());
        }
    }

    /// The base reaches its speed limit, hands push it beyond it, gains and targets change meanwhile.
    #[test]
    fn cover_keeps_its_speed_limit_in_random_programs() {
        let mut rows = Vec::new();
        for (law, seed) in [(Law::Impedance, 1), (Law::FollowMe, 2)] {
            for firmware in [Firmware::Moca, Firmware::Stock2018] {
                rows.push(Row { kind: Kind::Program, law, firmware, seed, seconds: 120.0 });
            }
        }
        let mut largest: f64 = 0.0;
        for (row, found) in rows.iter().zip(outcomes(&rows).unwrap()) {
            assert!(found.violations.is_empty(), "{}: {:#?}", row.name(), found.violations);
            assert!(found.largest_cover_speed_used < 1.0 + INERTIA_ROUNDED, "{}: {found:?}", row.name());
            assert!(found.largest_cover_command_used < 1.0 + 1e-9, "{}: {found:?}", row.name());
            largest = largest.max(found.largest_cover_command_used);
        }
        assert!(largest > 0.99, "the limit was never met: {largest}");
    }

    #[test]
    fn row_repeats_from_its_name_and_seed() {
        let row = Row {
            kind: Kind::Program,
            law: Law::Impedance,
            firmware: Firmware::Moca,
            seed: 7,
            seconds: 10.0,
        };
        let once = || serde_json::to_string(&row.run().unwrap()).unwrap();
        assert_eq!(once(), once());
    }
}

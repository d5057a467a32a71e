//! `moca-lab attack`: what people, programs and clients can do to the robot for minutes, and what must hold meanwhile and
//! after. Each row states its seed and repeats by itself.

mod network;
mod world;

use crate::robustness::watch::Findings;
use crate::study::{self, Answer, Column};
use anyhow::{Result, ensure};
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
    #[command(flatten)]
    answer: Answer,
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
    let found = outcomes(rows)?;
    arguments.answer.print_cases(&found, || Ok(table(&found)))?;
    let count: u64 = found.iter().map(|(_, found)| found.violation_count).sum();
    let restless = found.iter().filter(|(_, found)| !found.restless.is_empty()).count();
    ensure!(count == 0 && restless == 0, "{count} violations, no rest after a touch in {restless} rows");
    Ok(())
}

fn outcomes(rows: Vec<Row>) -> Result<Vec<(Row, Findings)>> {
    // The network's rows need the processor for themselves.
    let (crowds, worlds): (Vec<Row>, Vec<Row>) =
        rows.into_iter().partition(|row| matches!(row.kind, Kind::Network(_)));
    let mut found = study::outcomes("attack", worlds, Row::run)?;
    for crowd in crowds {
        found.push((crowd, crowd.run()?));
    }
    Ok(found)
}

/// The table of all rows for the documents.
pub(crate) fn markdown() -> Result<String> {
    let mut rows = rows(1, None);
    // Of these only the wall clock would be shown.
    rows.retain(|row| !matches!(row.kind, Kind::Network(_)));
    Ok(table(&outcomes(rows)?))
}

const COLUMNS: &[Column<(Row, Findings)>] = &[
    ("attack", |(row, _)| row.name()),
    ("robot time, s", |(row, _)| format!("{:.0}", row.seconds)),
    ("stops", |(_, found)| {
        let stops: Vec<String> = found.stops.iter().map(|(code, count)| format!("{count} {code}")).collect();
        if stops.is_empty() { "–".into() } else { stops.join(", ") }
    }),
    ("slowest stop, ticks", |(_, found)| {
        format!("{} of {} asked", found.slowest_stop_ticks, found.stops_asked)
    }),
    ("joint speed", |(_, found)| format!("{:.3}", found.largest_joint_speed_used)),
    ("torque", |(_, found)| format!("{:.3}", found.largest_torque_used)),
    ("cover commanded", |(_, found)| format!("{:.3}", found.largest_cover_command_used)),
    ("cover measured", |(_, found)| format!("{:.3}", found.largest_cover_speed_of_limit)),
    ("cover with pushes", |(_, found)| format!("{:.3}", found.largest_cover_speed_used)),
    ("base energy, J", |(_, found)| format!("{:.2}", found.largest_base_energy_j)),
    ("2 s after a touch, m/s", |(_, found)| format!("{:.4}", found.restless_m_s)),
    ("violations", |(_, found)| found.violation_count.to_string()),
];

fn table(found: &[(Row, Findings)]) -> String {
    let mut text = study::table(COLUMNS, found);
    let mut said = String::new();
    for (row, found) in found {
        for violation in found.violations.iter().chain(&found.restless) {
            said += &format!("- {}: {violation}\n", row.name());
        }
    }
    if !said.is_empty() {
        text += &format!("\n{said}");
    }
    text
}

/// The row of this name, found anew.
#[cfg(test)]
pub(crate) fn row_named(name: &str) -> Result<String> {
    let rows = rows(1, None);
    let row = rows.iter().find(|row| row.name() == name).expect("an attack of that name");
    Ok(study::line(COLUMNS, &(*row, row.run()?)))
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
        let rows = vec![
            row(Kind::Program, Law::Impedance, Firmware::Moca, 20.0),
            row(Kind::Program, Law::FollowMe, Firmware::Stock2018, 20.0),
            row(Kind::Storm, Law::FollowMe, Firmware::Moca, 10.0),
            row(lean, Law::FollowMe, Firmware::Moca, 10.0),
        ];
        for (row, found) in outcomes(rows).unwrap() {
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
        for (row, found) in outcomes(rows).unwrap() {
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

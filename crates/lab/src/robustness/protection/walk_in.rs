//! People who walk into the front of the standing robot and walk on. The base can only give way backwards, where it has no
//! taxel.

use super::cell::{Cell, Law};
use anyhow::Result;
use moca_experiments::meeting::Meeting;
use moca_experiments::parallel;
use moca_tactile::Firmware;
use std::fmt::Write as _;

const BOARDS: [Firmware; 2] = [Firmware::Stock2018, Firmware::Moca];
const LAWS: [(Law, &str); 2] = [(Law::Barrier, "on"), (Law::SpeedLimit, "off")];
/// T5 to T7.
const FRONT: [usize; 3] = [4, 5, 6];
/// Phases of the sensor that are looked at.
const PHASES: u32 = 4;
const WALKS_M_S: [f64; 4] = [0.05, 0.1, 0.15, 0.2];

/// A row of the table.
#[derive(Clone, Copy, Debug)]
struct Walk {
    board: Firmware,
    law: (Law, &'static str),
    walk_m_s: f64,
}

impl Walk {
    fn all() -> Vec<Self> {
        let mut walks = Vec::new();
        for board in BOARDS {
            for law in LAWS {
                walks.extend(WALKS_M_S.map(|walk_m_s| Self { board, law, walk_m_s }));
            }
        }
        walks
    }

    fn line(&self) -> Result<String> {
        let &Self { board, law: (law, name), walk_m_s } = self;
        let mut bound_m_s = 0.0;
        let mut peaks = String::new();
        for taxel in FRONT {
            let cell = Cell::at_speed(taxel, Meeting::Walks, board, walk_m_s)?;
            bound_m_s = cell.bound_m_s()?;
            let outcome = cell.worst(law, PHASES)?;
            // Writing to a string cannot fail.
            let _ = write!(peaks, " {:.0} N |", outcome.peak_n);
        }
        Ok(format!("| {} | {name} | {walk_m_s} | {bound_m_s:.3} |{peaks}", board.name()))
    }
}

/// The table.
pub(super) fn markdown() -> Result<String> {
    let lines = parallel::run("walk-in", &Walk::all(), Walk::line)?;
    let mut out = String::from(
        "| board | barrier | walks, m/s | bound, m/s | T5 | T6 | T7 |\n|---|---|---|---|---|---|---|\n",
    );
    for line in lines {
        let _ = writeln!(out, "{line}");
    }
    Ok(out)
}

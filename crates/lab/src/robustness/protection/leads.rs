//! People whom the robot drives into at requested speeds, whatever physics allows: the robot as it ships, with the contact
//! barrier and, where the cover has no calibration, without.

use super::cell::{AROUND, Cell, Law, PHASES};
use super::table;
use anyhow::Result;
use moca_experiments::meeting::{Meeting, Outcome};
use moca_experiments::parallel;
use moca_tactile::Firmware;

const LAWS: [(Law, &str); 2] = [(Law::Barrier, "on"), (Law::Uncalibrated, "off")];
const BOARDS: [Firmware; 2] = [Firmware::Stock2018, Firmware::Moca];
const LEADS_M_S: [f64; 4] = [0.04, 0.1, 0.15, 0.25];
/// Distance of the base from the person at the start, m: it arrives however slow its limit makes it.
const GAP_M: f64 = 0.2;

/// A row of the table: a lead, all round the cover.
#[derive(Clone, Copy, Debug)]
struct Lead {
    board: Firmware,
    law: (Law, &'static str),
    meeting: Meeting,
    lead_m_s: f64,
}

/// A place and a phase of the sensor, and what came of it.
struct Run {
    place: usize,
    phase: u32,
    outcome: Outcome,
}

impl Lead {
    fn all() -> Vec<Self> {
        let mut leads = Vec::new();
        for board in BOARDS {
            for law in LAWS {
                for meeting in [Meeting::Led, Meeting::ByHand] {
                    leads.extend(LEADS_M_S.map(|lead_m_s| Self { board, law, meeting, lead_m_s }));
                }
            }
        }
        leads
    }

    fn run(&self, place: usize, phase: u32) -> Result<Run> {
        let cell = Cell::at_speed(place, self.meeting, self.board, self.lead_m_s)?;
        let mut settings = cell.settings(self.law.0, phase)?;
        settings.person.gap_m = GAP_M;
        Ok(Run { place, phase, outcome: cell.outcome(&settings)? })
    }

    fn line(&self) -> Result<String> {
        let mut runs = Vec::new();
        for place in AROUND {
            for phase in 0..PHASES {
                runs.push(self.run(place, phase)?);
            }
        }
        let met: Vec<&Run> = runs.iter().filter(|run| run.outcome.peak_n > 0.0).collect();
        let most = |value: fn(&Outcome) -> f64| met.iter().map(|run| value(&run.outcome)).fold(0.0, f64::max);
        let places = |counts: fn(&Outcome) -> bool| {
            AROUND
                .into_iter()
                .filter(|place| runs.iter().any(|run| run.place == *place && counts(&run.outcome)))
                .count()
        };
        let worst = met.iter().max_by(|a, b| a.outcome.peak_n.total_cmp(&b.outcome.peak_n));
        Ok(format!(
            "{} {:.3} | {:.1} N | {:.1} N | {} | {} of {} | {} |",
            self.head(),
            most(|outcome| outcome.approach_m_s),
            most(|outcome| outcome.first_touch_n),
            most(|outcome| outcome.impact_n),
            worst.map_or_else(|| "nobody met".to_owned(), |worst| worst.words()),
            places(|outcome| outcome.peak_n > table::limit_n()),
            places(|outcome| outcome.peak_n > 0.0),
            self.stops(&runs),
        ))
    }

    /// At how many places it stops, and why first.
    fn stops(&self, runs: &[Run]) -> String {
        let stopped =
            |place: &&usize| runs.iter().find(|run| run.place == **place && !run.outcome.stopped.is_empty());
        let why: Vec<&str> = AROUND
            .iter()
            .filter_map(|place| stopped(&place))
            .map(|run| run.outcome.stopped.as_str())
            .collect();
        why.first().map_or_else(|| "–".to_owned(), |first| format!("{} ({first})", why.len()))
    }

    fn head(&self) -> String {
        let Self { board, law: (_, law), meeting, lead_m_s } = self;
        format!("| {} | {law} | {} | {lead_m_s} |", board.name(), meeting.name())
    }
}

impl Run {
    /// The largest force, where, and in which phase of the sensor.
    fn words(&self) -> String {
        format!("{:.1} N at {}, phase {}", self.outcome.peak_n, Cell::place_name(self.place), self.phase)
    }
}

/// The table.
pub(crate) fn markdown() -> Result<String> {
    let lines = parallel::run("leads", &Lead::all(), Lead::line)?;
    let mut out = format!(
        "| board | barrier | who leads | leads at, m/s | met at, m/s | worst in 0.1 s | in 0.5 s | in 3 s | places above {:.0} N | stopped at |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
        table::limit_n()
    );
    for line in lines {
        out.push_str(&line);
        out.push('\n');
    }
    Ok(out)
}

/// All of them take minutes: the worst run of every fifth row is run again.
#[cfg(test)]
#[test]
fn the_worst_of_a_lead_comes_out_as_the_document_has_it() {
    let Some(shown) = crate::docs::shown("protection-leads") else { return };
    let leads = Lead::all();
    for lead in leads.iter().step_by(5) {
        let row = shown.lines().find(|line| line.starts_with(&lead.head())).unwrap();
        let worst = row.split('|').nth(8).unwrap().trim();
        if worst == "nobody met" {
            continue;
        }
        let (place, phase) = worst.split_once(" at ").unwrap().1.split_once(", phase ").unwrap();
        let place = AROUND.into_iter().find(|index| Cell::place_name(*index) == place).unwrap();
        assert_eq!(lead.run(place, phase.parse().unwrap()).unwrap().words(), worst, "{row}");
    }
    assert_eq!(shown.lines().filter(|line| line.starts_with("| ")).count(), 1 + leads.len());
}

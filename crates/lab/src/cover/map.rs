//! `moca-lab latency --map FOLDER`: how fast the base may meet a body, by physics, by the law, and in the simulation.
//! What was computed stands in a file there and is not computed again.

use crate::picture::{Picture as _, Width};
use anyhow::{Context, Result, bail, ensure};
use moca_control::config::{AssumedModel, BarrierReadings, Config};
use moca_control::protection::speed_for_delay_m_s;
use moca_experiments::bound::{Meeting, TO_THE_SEAM_M};
use moca_experiments::campaign::Campaign;
use moca_experiments::collision;
use moca_experiments::settings::{Sensor, Settings};
use moca_figures::{Colour, Drawing, Map};
use moca_msgs::Law;
use moca_msgs::seconds;
use moca_sim::foam::Foam;
use moca_tactile::Firmware;
use std::fmt::Write as _;
use std::path::Path;

const BOARDS: [Firmware; 3] = [Firmware::Stock2018, Firmware::Stock2015, Firmware::Moca];
const PERSONS: [(&str, f64); 2] = [("leg of 50 N/mm", 50e3), ("rigid", 1e7)];
const FOAMS: [f64; 3] = [0.5, 1.0, 2.0];
const DECELERATIONS: [f64; 2] = [3.0, 6.0];
/// Fastest that a flange is led, m/s: faster speeds are not simulated.
const FASTEST_M_S: f64 = 0.25;
const PHASES: u32 = 4;
/// The search begins between nothing and this many times the bound, and is halved so often: to 4 % of the bound.
const SEARCHED: f64 = 1.25;
const HALVINGS: u32 = 5;
/// Time for which the base is led before it meets the body, and for which the contact is watched, s.
const LEAD_S: f64 = 1.2;
const WATCHED_S: f64 = 1.0;

const HEADER: &str = "cell,board,limit_n,body,foam,deceleration_m_s2,bound_m_s,law_m_s,measured_m_s,or_more";

struct Cell {
    meeting: Meeting,
    scale: f64,
    person: &'static str,
}

struct Speeds {
    bound: f64,
    law: f64,
    measured: f64,
    /// It kept the limit at the fastest that was tried.
    or_more: bool,
}

impl Speeds {
    fn columns(&self) -> String {
        format!("{:.4},{:.4},{:.4},{}", self.bound, self.law, self.measured, self.or_more)
    }

    /// Returns true if the simulation withstands the law's speed.
    fn keeps(&self) -> bool {
        self.law <= self.measured || self.or_more
    }
}

/// Computes the map, prints it as a table and writes it as a figure.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(super) fn run(forces_n: &[f64], folder: &Path, width: Width) -> Result<()> {
    let cells = cells(forces_n);
    std::fs::create_dir_all(folder).with_context(|| format!("cannot use {}", folder.display()))?;
    let out = folder.join("safe-speed.csv");
    let row = |id: usize| Ok(format!("{id},{},{}", cells[id].name(), cells[id].speeds()?.columns()));
    let campaign = Campaign { out: &out, shard: (1, 1), rows: cells.len(), header: HEADER };
    println!("{}", campaign.run(row)?);
    let speeds = read(&out, &cells)?;
    let text = table(&cells, &speeds);
    print!("{text}");
    figure(&cells, &speeds, forces_n, width).write(&folder.join("safe-speed"))
}

/// Every board, limit, body, foam and deceleration.
fn cells(forces_n: &[f64]) -> Vec<Cell> {
    let servo_s = Config::default().robot.base.servo_time_constant_s;
    let mut cells = Vec::new();
    for board in BOARDS {
        for &limit_n in forces_n {
            for (person, tissue_n_m) in PERSONS {
                for scale in FOAMS {
                    cells.extend(DECELERATIONS.map(|deceleration_m_s2| {
                        let foam = Foam::COLLISION_ASSUMED.stiffened(scale);
                        let meeting = Meeting {
                            foam,
                            tissue_n_m,
                            limit_n,
                            deceleration_m_s2,
                            servo_s,
                            board,
                            sharing: 2.0,
                        };
                        Cell { meeting, scale, person }
                    }));
                }
            }
        }
    }
    cells
}

impl Cell {
    fn name(&self) -> String {
        let Meeting { board, limit_n, deceleration_m_s2, .. } = self.meeting;
        format!("{},{limit_n},{},{},{deceleration_m_s2}", board.name(), self.person, self.scale)
    }

    fn speeds(&self) -> Result<Speeds> {
        let config = self.settings(0.0, 0)?.config;
        let delay_s = seconds(self.meeting.board.worst_hold_ns()) - 1e-3;
        let (measured, or_more) = self.measured_m_s()?;
        let law = speed_for_delay_m_s(&config, self.meeting.limit_n, delay_s);
        Ok(Speeds { bound: self.meeting.bound_m_s()?, law, measured, or_more })
    }

    /// Largest speed at which the worst phase stays under the limit, led into a held body, m/s, and whether a faster one
    /// was not tried.
    fn measured_m_s(&self) -> Result<(f64, bool)> {
        let keeps = |speed: f64| -> Result<bool> {
            for phase in 0..PHASES {
                if collision::single(&self.settings(speed, phase)?)?.measures.peak_force_n
                    > self.meeting.limit_n
                {
                    return Ok(false);
                }
            }
            Ok(true)
        };
        let (mut low, mut high) = (0.0, FASTEST_M_S.min(SEARCHED * self.meeting.bound_m_s()?));
        if keeps(high)? {
            return Ok((high, true));
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if keeps(middle)? { low = middle } else { high = middle }
        }
        Ok((low, false))
    }

    fn settings(&self, speed_m_s: f64, phase: u32) -> Result<Settings> {
        let mut settings = Settings::paper(Law::Impedance);
        collision::defaults(&mut settings);
        let meeting = &self.meeting;
        settings.config.control.corrections.null_space_damping = true;
        settings.config.control.corrections.base_coupling = true;
        settings.config.board.model = AssumedModel::PuLd30;
        settings.config.protection.contact_barrier = BarrierReadings::PuLd30;
        settings.config.protection.force_limit_n = meeting.limit_n;
        settings.config.robot.cover.foam_stiffness_n_m *= self.scale;
        settings.config.robot.base.acceleration_max_m_s2 = meeting.deceleration_m_s2;
        for axis in &mut settings.config.limits.base_acceleration[..2] {
            *axis = meeting.deceleration_m_s2;
        }
        settings.sensor = Sensor::Stock;
        settings.firmware = meeting.board;
        settings.shift_phase(f64::from(phase) / f64::from(PHASES));
        settings.config.simulation.truth.foam.scale = self.scale;
        // where the touch is hidden for longest
        (settings.person.taxel, settings.person.offset_m) = (5, TO_THE_SEAM_M);
        settings.person.stiffness = Some(meeting.tissue_n_m);
        settings.person.fixed = true;
        settings.person.gap_m = LEAD_S * speed_m_s;
        settings.speed_m_s = speed_m_s;
        settings.duration_s = LEAD_S + WATCHED_S + 0.2;
        settings.check()?;
        Ok(settings)
    }
}

/// One cell in `step` at the law's speed: name, and one run a phase.
pub(crate) fn at_the_law_s_speed(step: usize) -> Result<Vec<(String, Vec<Settings>)>> {
    let at = |cell: &Cell| {
        let config = cell.settings(0.0, 0)?.config;
        let delay_s = seconds(cell.meeting.board.worst_hold_ns()) - 1e-3;
        let law_m_s = speed_for_delay_m_s(&config, cell.meeting.limit_n, delay_s).min(FASTEST_M_S);
        let phases = (0..PHASES).map(|phase| cell.settings(law_m_s, phase));
        Ok((cell.name().replace(',', ", "), phases.collect::<Result<_>>()?))
    };
    cells(&Config::default().protection.assessed_forces_n).iter().step_by(step).map(at).collect()
}

/// The speeds of all cells from their file, whatever the order of its rows.
fn read(path: &Path, cells: &[Cell]) -> Result<Vec<Speeds>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let lines = text.lines().skip(1).count();
    ensure!(lines == cells.len(), "{}: {lines} rows of {} cells", path.display(), cells.len());
    let speeds = cells.iter().map(|cell| {
        let name = format!(",{},", cell.name());
        let numbers = text.lines().find_map(|line| line.split_once(&name).map(|(_, numbers)| numbers));
        let numbers = numbers.with_context(|| format!("{}: no row of {}", path.display(), cell.name()))?;
        let [bound, law, measured, or_more] = numbers.split(',').collect::<Vec<_>>()[..] else {
            bail!("{}: the row of {} is torn", path.display(), cell.name());
        };
        let number = |text: &str| text.parse::<f64>().with_context(|| format!("'{text}' is not a number"));
        Ok(Speeds {
            bound: number(bound)?,
            law: number(law)?,
            measured: number(measured)?,
            or_more: or_more == "true",
        })
    });
    speeds.collect()
}

/// Bound, law and measured, and whether the law stays below what was measured.
fn table(cells: &[Cell], speeds: &[Speeds]) -> String {
    let mut out = String::from(
        "| board | limit | body | foam | deceleration | bound | law | measured |\n|---|---|---|---|---|---|---|---|\n",
    );
    for (cell, speed) in cells.iter().zip(speeds) {
        let Meeting { board, limit_n, deceleration_m_s2, .. } = cell.meeting;
        let least = if speed.or_more { "≥ " } else { "" };
        let beyond = if speed.keeps() { "" } else { " **law is faster**" };
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "| {} | {limit_n:.0} N | {} | × {} | {deceleration_m_s2:.0} m/s² | {:.3} | {:.3} | {least}{:.3} m/s{beyond} |",
            board.name(),
            cell.person,
            cell.scale,
            speed.bound,
            speed.law,
            speed.measured,
        );
    }
    out
}

/// One map a board: forces across; body, foam and deceleration down; the law's speed, green where the simulation bears it.
fn figure(cells: &[Cell], speeds: &[Speeds], forces_n: &[f64], width: Width) -> Drawing {
    const KEPT: Colour = [196, 230, 196];
    const BEYOND: Colour = [240, 190, 185];
    const CELL: [f64; 2] = [136.0, 22.0];
    let rows = PERSONS.len() * FOAMS.len() * DECELERATIONS.len();
    #[expect(clippy::cast_precision_loss, reason = "a few cells")]
    let of = |count: usize| count as f64;
    let fit_px = (width != Width::Screen).then(|| width.px() - 12.0);
    let mut maps = Vec::new();
    for (row, board) in BOARDS.into_iter().enumerate() {
        let start = row * rows * forces_n.len();
        let index = |force: usize, row: usize| start + force * rows + row;
        let names = (0..rows).map(|row| {
            let cell = &cells[index(0, row)];
            format!("{}, × {}, {:.0} m/s²", cell.person, cell.scale, cell.meeting.deceleration_m_s2)
        });
        let kept = |i: usize| speeds[i].keeps();
        let order = (0..rows).flat_map(|row| (0..forces_n.len()).map(move |force| index(force, row)));
        maps.push(Map {
            title: format!("{}: speed that the law allows, of what the simulation bears [m/s]", board.name()),
            x_label: "force limit [N]".into(),
            y_label: "body, foam, deceleration".into(),
            x: forces_n.iter().map(|force_n| format!("{force_n:.0}")).collect(),
            y: names.collect(),
            cells: order
                .clone()
                .map(|i| {
                    let (law, measured) = (speeds[i].law, speeds[i].measured);
                    // the search ends between this and one more halving
                    let open = FASTEST_M_S.min(SEARCHED * speeds[i].bound) / f64::from(1 << HALVINGS);
                    let shown = if speeds[i].or_more {
                        format!("{law:.3} of ≥ {measured:.3}")
                    } else {
                        format!("{law:.3} of {measured:.3}–{:.3}", measured + open)
                    };
                    let mark = if kept(i) { "" } else { " ×" };
                    (if kept(i) { KEPT } else { BEYOND }, shown + mark)
                })
                .collect(),
            sides: order.map(kept).collect(),
            legend: vec![
                (KEPT, "kept in the simulation (≥: faster not tried)"),
                (BEYOND, "× beyond the limit in the simulation"),
            ],
            fit_px,
        });
    }
    let whole = maps.iter().map(|map| map.width(CELL[0])).fold(0.0, f64::max);
    let whole = if width == Width::Screen { whole + 20.0 } else { width.px() };
    let height = maps.iter().map(|map| map.height(CELL)).fold(0.0, f64::max) + 14.0;
    let mut drawing = Drawing::new(whole, height * of(BOARDS.len()));
    for (row, map) in maps.iter().enumerate() {
        map.draw(&mut drawing, [6.0, height * of(row) + 4.0], CELL);
    }
    drawing
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of them take minutes: one is run, and has to come out as the document's map has it.
    #[test]
    fn every_mapped_speed_is_safe_in_simulation() {
        let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/safe-speed.csv"));
        let cells = cells(&Config::default().protection.assessed_forces_n);
        let shown = read(path, &cells).unwrap();
        assert_eq!(shown.len(), cells.len());
        for (cell, speeds) in cells.iter().zip(&shown) {
            assert!(speeds.keeps(), "{}", cell.name());
        }
        for width in [Width::Screen, Width::Single, Width::Double] {
            let drawing = figure(&cells, &shown, &Config::default().protection.assessed_forces_n, width);
            assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new(), "{width:?}");
            assert!(width == Width::Screen || (drawing.size()[0] - width.px()).abs() < 1e-9);
        }
        let one = cells.iter().position(|cell| cell.name() == "moca,25,leg of 50 N/mm,1,3").unwrap();
        let (fresh, shown) = (cells[one].speeds().unwrap(), &shown[one]);
        let halving = SEARCHED * fresh.bound / f64::from(1 << HALVINGS);
        assert!((fresh.bound - shown.bound).abs() < 1e-4 && (fresh.law - shown.law).abs() < 1e-4);
        assert!((fresh.measured - shown.measured).abs() < 1.1 * halving, "{}", fresh.measured);
    }
}

//! `moca-lab latency --map FOLDER`: how fast the base may meet a body, by physics, by the law, and in the simulation.
//! What was computed stands in a file there and is not computed again.

use crate::picture::{Picture as _, Width};
use crate::study::{self, Column};
use anyhow::{Context, Result, bail, ensure};
use moca_control::config::{AssumedModel, BarrierReadings, Config, ProtectionConfig};
use moca_control::protection::{nominal_speed_m_s, speed_for_delay_m_s};
use moca_experiments::bound::{Meeting, TO_THE_SEAM_M};
use moca_experiments::campaign::{Campaign, Table};
use moca_experiments::collision;
use moca_experiments::commissioning::commission;
use moca_experiments::settings::{Sensor, Settings};
use moca_figures::{Colour, Drawing, Map};
use moca_msgs::Law;
use moca_msgs::seconds;
use moca_sim::foam::Foam;
use moca_tactile::Firmware;
use std::path::Path;

const BOARDS: [Firmware; 3] = [Firmware::Stock2018, Firmware::Stock2015, Firmware::Moca];
const PERSONS: [(&str, f64); 2] = [("leg of 50 N/mm", 50e3), ("rigid", 1e7)];
const FOAMS: [f64; 3] = [0.5, 1.0, 2.0];
const DECELERATIONS: [f64; 2] = [3.0, 6.0];
/// Delays of the base's orders, ms.
const DELAYS_MS: [f64; 4] = [0.0, 20.0, 50.0, 100.0];
/// Fastest that a flange is led, m/s: faster speeds are not simulated.
const FASTEST_M_S: f64 = 0.25;
/// Runs on each seam, each with noise and a sensor phase of its own.
const SEEDS: u32 = 5;
/// Phases at which the cells of [`at_the_law_s_speed`] are run.
const PHASES: u32 = 4;
/// The search rises in such steps to the first speed that is not withstood, and halves the last of them so often: to 3 %.
const STEP: f64 = 1.2;
const HALVINGS: u32 = 3;
/// Time for which the base is led before it meets the body, and for which the contact is watched, s.
const LEAD_S: f64 = 1.2;
const WATCHED_S: f64 = 1.0;

const HEADER: &str =
    "cell,board,limit_n,body,foam,deceleration_m_s2,order_delay_ms,bound_m_s,law_m_s,measured_m_s,or_more";

struct Cell {
    /// The servo's time constant has the delay of the orders in it.
    meeting: Meeting,
    scale: f64,
    delay_ms: f64,
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

/// Table of the map: a row for each cell.
struct SafeSpeeds<'a>(&'a [Cell]);

impl Table for SafeSpeeds<'_> {
    fn rows(&self) -> usize {
        self.0.len()
    }

    fn header(&self) -> String {
        HEADER.into()
    }

    fn words(&self) -> Vec<&str> {
        vec!["board", "body", "or_more"]
    }

    fn row(&self, id: usize) -> Result<String> {
        let cell = &self.0[id];
        Ok(format!("{id},{},{}", cell.name(), cell.speeds()?.columns()))
    }
}

/// Computes the map, prints it as a table and writes it as a figure.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(super) fn run(forces_n: &[f64], folder: &Path, width: Width) -> Result<()> {
    let cells = cells(forces_n, &DELAYS_MS);
    let data = folder.join("data");
    std::fs::create_dir_all(&data).with_context(|| format!("cannot use {}", data.display()))?;
    let out = data.join("safe-speed.csv");
    println!("{}", Campaign { table: &SafeSpeeds(&cells), out: &out, shard: (1, 1) }.run()?);
    let speeds = read(&out, &cells)?;
    study::print(&table(&cells, &speeds));
    figures(&cells, &speeds, forces_n, width)
        .into_iter()
        .try_for_each(|(name, drawing)| drawing.write(&folder.join(name)))
}

/// Every board, limit, body, foam, deceleration and delay.
fn cells(forces_n: &[f64], delays_ms: &[f64]) -> Vec<Cell> {
    let servo_s = Config::default().robot.base.servo_time_constant_s;
    let mut cells = Vec::new();
    for board in BOARDS {
        for &limit_n in forces_n {
            for (person, tissue_n_m) in PERSONS {
                for scale in FOAMS {
                    for deceleration_m_s2 in DECELERATIONS {
                        cells.extend(delays_ms.iter().map(|&delay_ms| {
                            let meeting = Meeting {
                                foam: Foam::COLLISION_ASSUMED.stiffened(scale),
                                tissue_n_m,
                                limit_n,
                                deceleration_m_s2,
                                servo_s,
                                order_delay_s: 1e-3 * delay_ms,
                                board,
                                sharing: 2.0,
                            };
                            Cell { meeting, scale, delay_ms, person }
                        }));
                    }
                }
            }
        }
    }
    cells
}

impl Cell {
    fn name(&self) -> String {
        format!("{},{}", self.encounter(), self.delay_ms)
    }

    /// Board, limit, body, foam and deceleration.
    fn encounter(&self) -> String {
        let Meeting { board, limit_n, deceleration_m_s2, .. } = self.meeting;
        format!("{},{limit_n},{},{},{deceleration_m_s2}", board.name(), self.person, self.scale)
    }

    /// Bound, law and simulation; the law believes the stopping distance that commissioning measures of this base.
    fn speeds(&self) -> Result<Speeds> {
        let mut settings = self.settings(0.0, 0, PHASES)?;
        let scene = settings.free_scene();
        commission(&mut settings.config, &scene)?;
        let law = nominal_speed_m_s(&settings.config, self.meeting.board).min(FASTEST_M_S);
        let (measured, or_more) = self.measured_m_s(&settings.config.protection, law)?;
        Ok(Speeds { bound: self.meeting.bound_m_s()?, law, measured, or_more })
    }

    /// Largest speed, m/s, at which the worst of all seeds on both seams stays under the limit, led into a held body, and whether a
    /// faster one was not tried. Slower than the law's speed it is looked for between it and nothing.
    fn measured_m_s(&self, measured: &ProtectionConfig, law_m_s: f64) -> Result<(f64, bool)> {
        let keeps = |speed_m_s: f64| -> Result<bool> {
            for seed in 0..SEEDS {
                for side in [1.0, -1.0] {
                    let mut settings = self.settings(speed_m_s, seed, SEEDS)?;
                    settings.config.simulation.seed = u64::from(seed);
                    settings.person.offset_m = side * TO_THE_SEAM_M;
                    settings.config.protection.clone_from(measured);
                    if collision::single(&settings)?.measures.peak_force_n > self.meeting.limit_n {
                        return Ok(false);
                    }
                }
            }
            Ok(true)
        };
        let (mut low, mut high) = (0.0, law_m_s);
        while keeps(high)? {
            if high >= FASTEST_M_S {
                return Ok((high, true));
            }
            (low, high) = (high, FASTEST_M_S.min(STEP * high));
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if keeps(middle)? { low = middle } else { high = middle }
        }
        Ok((low, false))
    }

    /// A run of which the sensor's phase is `phase` of `phases`.
    fn settings(&self, speed_m_s: f64, phase: u32, phases: u32) -> Result<Settings> {
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
        settings.shift_phase(f64::from(phase) / f64::from(phases));
        settings.config.simulation.truth.foam.scale = self.scale;
        settings.config.simulation.truth.base.order_delay_ms = self.delay_ms;
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
        let config = cell.settings(0.0, 0, PHASES)?.config;
        let delay_s = seconds(cell.meeting.board.worst_hold_ns()) - 1e-3;
        let law_m_s = speed_for_delay_m_s(&config, cell.meeting.limit_n, delay_s).min(FASTEST_M_S);
        let phases = (0..PHASES).map(|phase| cell.settings(law_m_s, phase, PHASES));
        Ok((cell.encounter().replace(',', ", "), phases.collect::<Result<_>>()?))
    };
    cells(&Config::default().protection.assessed_forces_n, &[0.0]).iter().step_by(step).map(at).collect()
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
    let columns: [Column<(&Cell, &Speeds)>; 9] = [
        ("board", |(cell, _)| cell.meeting.board.name().into()),
        ("limit", |(cell, _)| format!("{:.0} N", cell.meeting.limit_n)),
        ("body", |(cell, _)| cell.person.into()),
        ("foam", |(cell, _)| format!("× {}", cell.scale)),
        ("deceleration", |(cell, _)| format!("{:.0} m/s²", cell.meeting.deceleration_m_s2)),
        ("late by", |(cell, _)| format!("{:.0} ms", cell.delay_ms)),
        ("bound", |(_, speeds)| format!("{:.3}", speeds.bound)),
        ("law", |(_, speeds)| format!("{:.3}", speeds.law)),
        ("measured", |(_, speeds)| {
            let (least, measured) = (if speeds.or_more { "≥ " } else { "" }, speeds.measured);
            format!("{least}{measured:.3} m/s{}", if speeds.keeps() { "" } else { " **law is faster**" })
        }),
    ];
    study::table(&columns, &cells.iter().zip(speeds).collect::<Vec<_>>())
}

/// Names and drawings: a map for each board, and in one column of a journal for each body too. The base's delay runs across; body,
/// foam and deceleration run down; a cell has the law's speed for the least force, green where the simulation withstands it.
fn figures(cells: &[Cell], speeds: &[Speeds], forces_n: &[f64], width: Width) -> Vec<(String, Drawing)> {
    const CELL: [f64; 2] = [150.0, 22.0];
    let force_n = forces_n.iter().copied().fold(f64::INFINITY, f64::min);
    let mut figures = Vec::new();
    for board in BOARDS {
        let of_board = |cell: &Cell| {
            #[expect(clippy::float_cmp, reason = "a copy")]
            let is_least = cell.meeting.limit_n == force_n;
            cell.meeting.board == board && is_least
        };
        let shown: Vec<_> = cells.iter().zip(speeds).filter(|(cell, _)| of_board(cell)).collect();
        let of_body = shown.len() / PERSONS.len();
        let parts = if width == Width::Single { of_body } else { shown.len() };
        for part in shown.chunks(parts.max(1)) {
            let Some((first, _)) = part.first() else { continue };
            let map = map(part, first, force_n, width);
            let whole = if width == Width::Screen { map.width(CELL[0]) + 20.0 } else { width.px() };
            let mut drawing = Drawing::new(whole, map.height(CELL) + 14.0);
            map.draw(&mut drawing, [6.0, 4.0], CELL);
            let body = first.person.split(' ').next().unwrap_or_default();
            let of_body = if width == Width::Single { format!("-{body}") } else { String::new() };
            figures.push((format!("safe-speed-{}{of_body}", board.name()), drawing));
        }
    }
    figures
}

/// The map of `part`, whose cells run through the delays before anything else.
fn map(part: &[(&Cell, &Speeds)], first: &Cell, force_n: f64, width: Width) -> Map {
    const KEPT: Colour = [196, 230, 196];
    const BEYOND: Colour = [240, 190, 185];
    let name = |cell: &Cell| {
        format!("{}, × {}, {:.0} m/s²", cell.person, cell.scale, cell.meeting.deceleration_m_s2)
    };
    let shown = |speed: &Speeds| {
        let least = if speed.or_more { "≥ " } else { "" };
        let mark = if speed.keeps() { "" } else { " ×" };
        let colour = if speed.keeps() { KEPT } else { BEYOND };
        (colour, format!("{:.3} of {least}{:.3}{mark}", speed.law, speed.measured))
    };
    let board = first.meeting.board.name();
    Map {
        title: format!(
            "{board}, {force_n:.0} N: speed that the law allows, of what the simulation withstands [m/s]"
        ),
        x_label: "delay of the base's orders [ms]".into(),
        y_label: "body, foam, deceleration".into(),
        x: DELAYS_MS.iter().map(|delay_ms| format!("{delay_ms:.0}")).collect(),
        y: part.iter().step_by(DELAYS_MS.len()).map(|(cell, _)| name(cell)).collect(),
        cells: part.iter().map(|(_, speed)| shown(speed)).collect(),
        sides: part.iter().map(|(_, speed)| speed.keeps()).collect(),
        legend: vec![
            (KEPT, "kept in the simulation (≥: faster not tried)"),
            (BEYOND, "× beyond the limit in the simulation"),
        ],
        fit_px: (width != Width::Screen).then(|| width.px() - 12.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of them take hours: one is run, and has to come out as the document's map has it.
    #[test]
    fn every_mapped_speed_is_safe_in_simulation() {
        let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/data/safe-speed.csv"));
        let forces_n = Config::default().protection.assessed_forces_n;
        let cells = cells(&forces_n, &DELAYS_MS);
        let shown = read(path, &cells).unwrap();
        assert_eq!(shown.len(), cells.len());
        for (cell, speeds) in cells.iter().zip(&shown) {
            assert!(speeds.keeps(), "{}", cell.name());
        }
        for (width, files) in [(Width::Screen, 3), (Width::Single, 6), (Width::Double, 3)] {
            let figures = figures(&cells, &shown, &forces_n, width);
            assert_eq!(figures.len(), files);
            for (name, drawing) in figures {
                assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new(), "{name}, {width:?}");
                let [wide, high] = drawing.size();
                assert!(width == Width::Screen || (wide - width.px()).abs() < 1e-9);
                assert!(high < 0.8 * PAGE_PX, "{name}, {width:?}: {high} px");
            }
        }
        let one = cells.iter().position(|cell| cell.name() == "moca,25,leg of 50 N/mm,1,3,50").unwrap();
        let (fresh, shown) = (cells[one].speeds().unwrap(), &shown[one]);
        assert!((fresh.bound - shown.bound).abs() < 1e-4 && (fresh.law - shown.law).abs() < 1e-4);
        let halving = (STEP - 1.0) * fresh.measured / f64::from(1 << HALVINGS);
        assert!((fresh.measured - shown.measured).abs() < 1.1 * halving, "{}", fresh.measured);
    }

    /// Height of an A4 page, px.
    const PAGE_PX: f64 = 297.0 * 96.0 / 25.4;
}

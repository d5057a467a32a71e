//! `moca-lab latency --map FOLDER`: how fast the base may meet a body, by physics, by the law, and in the simulation.

use crate::paper::collision;
use crate::rig::bound::Meeting;
use crate::rig::parallel;
use crate::rig::settings::{Sensor, Settings};
use anyhow::{Context, Result};
use moca_daemon::config::{AssumedModel, BarrierReadings, Config};
use moca_daemon::control::protection::speed_for_delay_m_s;
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
const HALVINGS: u32 = 6;

struct Cell {
    meeting: Meeting,
    scale: f64,
    person: &'static str,
}

struct Speeds {
    bound: f64,
    law: f64,
    measured: f64,
}

/// Computes the map, prints it as a table and writes it as a figure.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(super) fn run(forces_n: &[f64], folder: &Path) -> Result<()> {
    let servo_s = Config::default().robot.base.servo_time_constant_s;
    let mut cells = Vec::new();
    for board in BOARDS {
        for &limit_n in forces_n {
            for (person, tissue_n_m) in PERSONS {
                for scale in FOAMS {
                    cells.extend(DECELERATIONS.map(|deceleration_m_s2| {
                        let foam = Foam::COLLISION_ASSUMED.stiffened(scale);
                        let meeting =
                            Meeting { foam, tissue_n_m, limit_n, deceleration_m_s2, servo_s, board };
                        Cell { meeting, scale, person }
                    }));
                }
            }
        }
    }
    let speeds =
        parallel::run("map", &cells, Cell::speeds, |_| ()).into_iter().collect::<Result<Vec<_>>>()?;
    let text = table(&cells, &speeds);
    print!("{text}");
    std::fs::create_dir_all(folder).with_context(|| format!("cannot use {}", folder.display()))?;
    let path = folder.join("safe-speed.svg");
    std::fs::write(&path, figure(&cells, &speeds, forces_n).svg())
        .with_context(|| format!("cannot write {}", path.display()))
}

impl Cell {
    fn speeds(&self) -> Result<Speeds> {
        let config = self.settings(0.0, 0)?.config;
        let delay_s = seconds(self.meeting.board.worst_hold_ns()) - 1e-3;
        Ok(Speeds {
            bound: self.meeting.bound_m_s()?,
            law: speed_for_delay_m_s(&config, self.meeting.limit_n, delay_s),
            measured: self.measured_m_s()?,
        })
    }

    /// Largest speed at which the worst phase stays under the limit, led into a held body, m/s.
    fn measured_m_s(&self) -> Result<f64> {
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
        let (mut low, mut high) = (0.0, FASTEST_M_S);
        if keeps(high)? {
            return Ok(high);
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if keeps(middle)? { low = middle } else { high = middle }
        }
        Ok(low)
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
        settings.sensor_phase_ms = settings.period_ms() * f64::from(phase) / f64::from(PHASES);
        settings.foam.scale = self.scale;
        settings.person.taxel = 5;
        settings.person.stiffness = Some(meeting.tissue_n_m);
        settings.person.fixed = true;
        settings.person.gap_m = 2.0 * speed_m_s;
        settings.speed_m_s = speed_m_s;
        settings.duration_s = 4.0;
        settings.check()?;
        Ok(settings)
    }
}

/// Bound, law and measured, and whether the law stays below what was measured.
fn table(cells: &[Cell], speeds: &[Speeds]) -> String {
    let mut out = String::from(
        "| board | limit | body | foam | deceleration | bound | law | measured |\n|---|---|---|---|---|---|---|---|\n",
    );
    for (cell, speed) in cells.iter().zip(speeds) {
        let Meeting { board, limit_n, deceleration_m_s2, .. } = cell.meeting;
        let least = if speed.measured >= FASTEST_M_S { "≥ " } else { "" };
        let beyond = if speed.law > speed.measured && least.is_empty() { " **law is faster**" } else { "" };
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
fn figure(cells: &[Cell], speeds: &[Speeds], forces_n: &[f64]) -> Drawing {
    const KEPT: Colour = [196, 230, 196];
    const BEYOND: Colour = [240, 190, 185];
    const CELL: [f64; 2] = [84.0, 22.0];
    let rows = PERSONS.len() * FOAMS.len() * DECELERATIONS.len();
    #[expect(clippy::cast_precision_loss, reason = "a few cells")]
    let of = |count: usize| count as f64;
    let height = CELL[1] * of(rows) + 90.0;
    let width = CELL[0] * of(forces_n.len()) + 220.0;
    let mut drawing = Drawing::new(width, height * of(BOARDS.len()));
    for (row, board) in BOARDS.into_iter().enumerate() {
        let start = row * rows * forces_n.len();
        let index = |force: usize, row: usize| start + force * rows + row;
        let names = (0..rows).map(|row| {
            let cell = &cells[index(0, row)];
            format!("{}, × {}, {:.0} m/s²", cell.person, cell.scale, cell.meeting.deceleration_m_s2)
        });
        let kept = |i: usize| speeds[i].law <= speeds[i].measured || speeds[i].measured >= FASTEST_M_S;
        let order = (0..rows).flat_map(|row| (0..forces_n.len()).map(move |force| index(force, row)));
        let map = Map {
            title: format!("{}: speed under the contact barrier [m/s]", board.name()),
            x_label: "force limit [N]".into(),
            y_label: "body, foam, deceleration".into(),
            x: forces_n.iter().map(|force_n| format!("{force_n:.0}")).collect(),
            y: names.collect(),
            cells: order
                .clone()
                .map(|i| (if kept(i) { KEPT } else { BEYOND }, format!("{:.3}", speeds[i].law)))
                .collect(),
            sides: order.map(kept).collect(),
            legend: vec![(KEPT, "kept in the simulation"), (BEYOND, "beyond the limit in the simulation")],
        };
        map.draw(&mut drawing, [90.0, height * of(row)], CELL);
    }
    drawing
}

//! Somebody leans on the robot while its joints are far from their ends, near one, or stretched, with every
//! limit of arm and base kept by itself and with all of them in one quadratic programme.

use super::lean::Hand;
use crate::rig::parallel;
use crate::rig::settings::Settings;
use crate::rig::{JOINTS, TAXELS};
use anyhow::{Context, Result, ensure};
use moca_daemon::control::law::QpTally;
use moca_daemon::control::plant::Simulated;
use moca_daemon::runtime::lockstep::LockStep;
use moca_msgs::{ArmTable, Fault, Law, Limits, Sample};
use moca_wbc::limits::JointSpeeds;
use std::fmt::Write as _;

/// Ticks from power-up to a moving law at the latest.
const START_TICKS: u32 = 5000;
/// Where the arm begins, and where its null space wants it, rad: 0.12 rad before joint 4's end, and with the elbow so far
/// open that the tool is as far out as it gets but for 2 cm.
const POSTURES: [(&str, Option<[f64; JOINTS]>); 3] = [
    ("home", None),
    ("near an end", Some([0.0, -1.2, 0.0, -2.95, 0.0, 1.75, 0.785])),
    ("stretched", Some([0.0, 0.5, 0.0, -0.45, 0.0, 1.2, 0.785])),
];
/// What is leant with, N: together a row.
const FORCES_N: [&[f64]; 2] = [&[10.0, 20.0, 30.0, 40.0], &[100.0, 150.0]];

#[derive(Clone, Copy, Debug, PartialEq)]
struct Cell {
    posture: usize,
    law: Law,
    /// Of [`FORCES_N`].
    group: usize,
    force_n: f64,
    /// 1 is T1.
    taxel: usize,
    by_qp: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Furthest that the flange was from where it is wanted, m.
    flange_m: f64,
    /// Largest of a joint's way from the middle of its range, of its speed, its torque, and the step of that in a tick; of
    /// what is allowed.
    range: f64,
    speed: f64,
    torque: f64,
    torque_step: f64,
    stopped: Option<Fault>,
    ticks: u64,
    tally: QpTally,
}

fn cells() -> Vec<Cell> {
    let mut cells = Vec::new();
    for posture in 0..POSTURES.len() {
        for law in [Law::Impedance, Law::FollowMe] {
            for (group, forces) in FORCES_N.into_iter().enumerate() {
                for by_qp in [false, true] {
                    for &force_n in forces {
                        let of = |taxel| Cell { posture, law, group, force_n, taxel, by_qp };
                        cells.extend((1..=TAXELS).map(of));
                    }
                }
            }
        }
    }
    cells
}

/// The table of all of them.
pub(crate) fn markdown() -> Result<String> {
    table(&cells())
}

fn table(cells: &[Cell]) -> Result<String> {
    let outcomes = parallel::run("leans", cells, lean, |_| {});
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;
    let rows: Vec<(&Cell, &Outcome)> = cells.iter().zip(&outcomes).collect();
    let mut table = String::from(
        "| posture | law | N | limits | flange, mm | at | range, % | joint speed, % | torque, % | torque step, % | stopped \
         | programmes, % of ticks | iterations |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let same =
        |a: &Cell, b: &Cell| (a.posture, a.law, a.group, a.by_qp) == (b.posture, b.law, b.group, b.by_qp);
    for group in rows.chunk_by(|a, b| same(a.0, b.0)) {
        let most = |pick: fn(&Outcome) -> f64| group.iter().map(|(_, o)| pick(o)).fold(0.0, f64::max);
        let Some((at, worst)) = group.iter().max_by(|a, b| a.1.flange_m.total_cmp(&b.1.flange_m)) else {
            continue;
        };
        let forces = FORCES_N[at.group];
        let (steps, ticks) =
            group.iter().fold((0, 0), |(steps, ticks), (_, o)| (steps + o.tally.steps, ticks + o.ticks));
        let fell_back: u64 = group.iter().map(|(_, o)| o.tally.fell_back).sum();
        ensure!(fell_back == 0, "{fell_back} programmes failed");
        #[expect(clippy::cast_precision_loss, reason = "counts of ticks")]
        let share = 100.0 * steps as f64 / ticks as f64;
        let iterations = group.iter().map(|(_, o)| o.tally.most_iterations).max().unwrap_or_default();
        write!(
            table,
            "| {} | {} | {:.0} to {:.0} | {} | {:.2} | T{}, {:.0} N | {:.1} | {:.1} | {:.1} | {:.1} | {} of {} |",
            POSTURES[at.posture].0,
            moca_msgs::Mode::from(at.law).name(),
            forces[0],
            forces[forces.len() - 1],
            if at.by_qp { "together" } else { "one by one" },
            1e3 * worst.flange_m,
            at.taxel,
            at.force_n,
            100.0 * most(|o| o.range),
            100.0 * most(|o| o.speed),
            100.0 * most(|o| o.torque),
            100.0 * most(|o| o.torque_step),
            group.iter().filter(|(_, o)| o.stopped.is_some()).count(),
            group.len(),
        )?;
        if at.by_qp {
            writeln!(table, " {share:.1} | {iterations} |")?;
        } else {
            writeln!(table, " – | – |")?;
        }
    }
    Ok(table)
}

fn lean(cell: &Cell) -> Result<Outcome> {
    let mut settings = Settings::paper(cell.law);
    settings.set(if cell.by_qp { "law=qp" } else { "law=barrier" })?;
    if let (_, Some(posture_rad)) = POSTURES[cell.posture] {
        settings.config.control.gains.posture_rad[..JOINTS].copy_from_slice(&posture_rad);
    }
    settings.check().with_context(|| format!("{cell:?}"))?;
    let scene = settings.free_scene();
    let mut world = LockStep::with_board(&settings.config, &scene, settings.board(), None)?.untimed();
    if settings.by_qp {
        world.control.keep_limits_by_qp();
    }
    let mut tick = 0;
    while !world.step(None).0.mode.moves() {
        tick += 1;
        ensure!(tick < START_TICKS, "{cell:?}: the robot was not armed");
    }
    let table = settings.config.arm().table().context("an arm of seven joints")?;
    let limits = settings.config.parameters().resized().limits;
    let mut watch =
        Watch { speeds: JointSpeeds::new(&table), table, limits, last: None, worst: Outcome::default() };
    let dt_s = limits.period_s;
    let mut t_s = 0.0;
    while t_s < Hand::Held.duration_s() && watch.worst.stopped.is_none() {
        let force_n = cell.force_n * Hand::Held.share(t_s);
        ensure!(world.control.plant.press(cell.taxel - 1, force_n).is_ok(), "{cell:?}: cannot press");
        let (sample, _) = world.step(None);
        watch.see(&sample);
        t_s += dt_s;
    }
    watch.worst.tally = world.control.by_qp().unwrap_or_default();
    Ok(watch.worst)
}

/// What is measured tick by tick, up to a stop.
struct Watch {
    table: ArmTable<JOINTS>,
    limits: Limits<JOINTS>,
    speeds: JointSpeeds<JOINTS, f64>,
    last: Option<Sample>,
    worst: Outcome,
}

impl Watch {
    fn see(&mut self, sample: &Sample) {
        let Self { table, limits, speeds, last, worst } = self;
        worst.ticks += 1;
        worst.stopped = worst.stopped.or(sample.fault);
        if worst.stopped.is_some() || sample.q_rad.len() < JOINTS || sample.arm_torque_nm.len() < JOINTS {
            return;
        }
        let (at, wanted) = (sample.flange_position_world, sample.flange_desired_position_world);
        let error = (0..3).map(|i| (at[i] - wanted[i]).powi(2)).sum::<f64>().sqrt();
        worst.flange_m = worst.flange_m.max(error);
        for i in 0..JOINTS {
            let (q, dq, torque) = (sample.q_rad[i], sample.dq_rad_s[i], sample.arm_torque_nm[i]);
            let (low, high) = (table.q_min_rad[i], table.q_max_rad[i]);
            worst.range = worst.range.max((q - 0.5 * (low + high)).abs() / (0.5 * (high - low)));
            worst.speed = worst.speed.max(dq.abs() / speeds.largest(i, q, dq));
            worst.torque = worst.torque.max(torque.abs() / limits.torque_nm[i]);
            if let Some(last) = last {
                let step = (torque - last.arm_torque_nm[i]).abs();
                worst.torque_step = worst.torque_step.max(step / (limits.torque_rate_nm_s * limits.period_s));
            }
        }
        *last = Some(sample.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of them take minutes: each row of a few leans has to lie within the row of the document.
    #[test]
    fn leans_with_all_limits_together_come_out_as_the_table_has_them() {
        let Some(shown) = crate::docs::shown("together") else { return };
        let few = |cell: &Cell| [5, 6].contains(&cell.taxel) && [20.0, 100.0].contains(&cell.force_n);
        let short = table(&cells().into_iter().filter(few).collect::<Vec<_>>()).unwrap();
        let number = |text: &str| text.trim_end_matches(" |").parse::<f64>().unwrap();
        assert_eq!(short.lines().count(), 2 + 24);
        for row in short.lines().skip(2) {
            let columns: Vec<&str> = row.split(" | ").collect();
            let same = |line: &&str| line.split(" | ").take(4).eq(columns[..4].iter().copied());
            let of_all: Vec<&str> = shown.lines().find(same).unwrap().split(" | ").collect();
            for column in [4, 6, 7, 8, 9] {
                let (few, all) = (number(columns[column]), number(of_all[column]));
                assert!(few <= all, "`moca-lab docs --only together` writes it anew: {row}");
            }
            let stops =
                |columns: &[&str]| columns[10].split_once(" of ").unwrap().0.parse::<usize>().unwrap();
            assert!(stops(&columns) <= stops(&of_all), "{row}");
            if columns[3] == "together" {
                assert!(number(columns[12]) <= number(of_all[12]), "{row}");
                assert!(number(columns[7]) < 90.0, "joints are held to 80 % of their speeds: {row}");
            }
        }
    }
}

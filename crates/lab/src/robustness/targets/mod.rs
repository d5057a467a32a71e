//! `moca-lab targets`: whatever another program may ask of flange, arm and base, at random, and whether the robot ever
//! stops or passes a limit for it.
#![expect(clippy::print_stdout, reason = "this is what the command is for")]

mod client;

use anyhow::{Context, Result, ensure};
use client::Client;
use moca_control::config::{Config, HandConfig};
use moca_daemon::devices::ideal_cover::IdealCover;
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::runtime::lockstep::LockStep;
use moca_experiments::{JOINTS, parallel};
use moca_msgs::robot::{FR3, PANDA};
use moca_msgs::{ArmTable, Fault, Law, Limits, Mode, Sample};
use moca_wbc::limits::JointSpeeds;
use serde::Serialize;
use std::collections::BTreeMap;

/// The campaign of the documents: programs of each arm and law, and how long each asks, s.
const PROGRAMS: u64 = 10;
const SECONDS: f64 = 60.0;
/// Ticks from power-up to a moving law at the latest.
const START_TICKS: u32 = 5000;

/// Random poses, twists, postures, trajectories and nonsense from another program: no stop, and no limit passed.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Programs of each arm and law.
    #[arg(long, default_value_t = PROGRAMS)]
    programs: u64,
    /// Duration of each program, s.
    #[arg(long, default_value_t = SECONDS)]
    seconds: f64,
    /// One JSON object a program instead of a table.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Arm {
    Panda,
    Fr3,
}

impl Arm {
    const fn toml(self) -> &'static str {
        match self {
            Self::Panda => "robot.arm = \"panda\"\n",
            Self::Fr3 => "robot.arm = \"fr3\"\n",
        }
    }

    const fn table(self) -> &'static ArmTable<JOINTS> {
        match self {
            Self::Panda => &PANDA,
            Self::Fr3 => &FR3,
        }
    }
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Cell {
    arm: Arm,
    law: Law,
    seed: u64,
    seconds: f64,
}

/// Every quantity is of what is allowed: 1 is the limit.
#[derive(Clone, Debug, Default, Serialize)]
struct Outcome {
    joint_speed: f64,
    joint_range: f64,
    torque: f64,
    torque_step: f64,
    flange_speed: f64,
    pose_error: f64,
    base_speed: f64,
    /// Targets that were taken, by kind, and that were refused.
    taken: BTreeMap<&'static str, u64>,
    refused: u64,
    /// Number of accepted poses, postures and trajectories that ended where they led.
    reached: u64,
    /// Wrong answers to a program.
    wrong: Vec<String>,
    /// Why the robot stopped, if it did, and when, s.
    stopped: Option<(Fault, f64)>,
}

impl Outcome {
    /// The limits with their shares.
    fn shares(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("joint speed", self.joint_speed),
            ("joint range", self.joint_range),
            ("torque", self.torque),
            ("torque step", self.torque_step),
            ("flange speed", self.flange_speed),
            ("pose error", self.pose_error),
            ("base speed", self.base_speed),
        ]
    }

    fn passed(&self) -> bool {
        let inside = self.shares().iter().all(|(_, share)| *share <= 1.0 + 1e-9);
        inside && self.stopped.is_none() && self.wrong.is_empty()
    }
}

fn cells(programs: u64, seconds: f64) -> Vec<Cell> {
    let mut cells = Vec::new();
    for arm in [Arm::Panda, Arm::Fr3] {
        for law in [Law::Impedance, Law::FollowMe] {
            cells.extend((1..=programs).map(|seed| Cell { arm, law, seed, seconds }));
        }
    }
    cells
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        (1.0..=3600.0).contains(&arguments.seconds),
        "--seconds {}: allowed: 1 to 3600 s",
        arguments.seconds
    );
    let rows = outcomes(cells(arguments.programs, arguments.seconds))?;
    if arguments.json {
        for (cell, outcome) in &rows {
            println!("{}", serde_json::json!({ "cell": cell, "outcome": outcome }));
        }
    } else {
        print!("{}", table(&rows));
    }
    let failed: Vec<_> = rows.iter().filter(|(_, outcome)| !outcome.passed()).collect();
    ensure!(failed.is_empty(), "{} of {} programs: {:?}", failed.len(), rows.len(), failed.first());
    Ok(())
}

fn outcomes(cells: Vec<Cell>) -> Result<Vec<(Cell, Outcome)>> {
    let outcomes = parallel::run("targets", &cells, led, |_| {});
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;
    Ok(cells.into_iter().zip(outcomes).collect())
}

/// The default campaign, for the documents.
pub(crate) fn markdown() -> Result<String> {
    Ok(table(&outcomes(cells(PROGRAMS, SECONDS))?))
}

/// The worst of each arm and law.
fn table(rows: &[(Cell, Outcome)]) -> String {
    let mut groups: BTreeMap<(Arm, &str), Vec<&(Cell, Outcome)>> = BTreeMap::new();
    for row in rows {
        groups.entry((row.0.arm, Mode::from(row.0.law).name())).or_default().push(row);
    }
    let mut table = "| arm, law | hours | targets taken | refused | reached | stops |".to_owned();
    for (name, _) in Outcome::default().shares() {
        table += &format!(" {name}, % |");
    }
    table += &format!("\n{}|\n", "|---".repeat(13));
    for ((arm, law), rows) in groups {
        let sum = |of: &dyn Fn(&Outcome) -> u64| rows.iter().map(|(_, outcome)| of(outcome)).sum::<u64>();
        let hours = rows.iter().map(|(cell, _)| cell.seconds).sum::<f64>() / 3600.0;
        table += &format!(
            "| {}, {law} | {hours:.1} | {} | {} | {} | {} |",
            match arm {
                Arm::Panda => "Panda",
                Arm::Fr3 => "FR3",
            },
            sum(&|outcome| outcome.taken.values().sum()),
            sum(&|outcome| outcome.refused),
            sum(&|outcome| outcome.reached),
            sum(&|outcome| outcome.stopped.is_some().into()),
        );
        for number in 0..Outcome::default().shares().len() {
            let worst = rows.iter().map(|(_, outcome)| outcome.shares()[number].1).fold(0.0, f64::max);
            table += &format!(" {:.1} |", 100.0 * worst);
        }
        table += "\n";
    }
    table
}

/// One program that commands a robot.
fn led(cell: &Cell) -> Result<Outcome> {
    let mut config = Config::parse(cell.arm.toml())?;
    config.simulation.hand = HandConfig::none();
    config.startup.law = cell.law;
    let scene = free_scene(&config);
    let cover = IdealCover::new(1, 0);
    let mut world = LockStep::with_true_forces(&config, &scene, cover)?.untimed();
    let mut tick = 0;
    let mut sample = loop {
        let (sample, _) = world.step(None);
        if sample.mode.moves() {
            break sample;
        }
        tick += 1;
        ensure!(tick < START_TICKS, "{cell:?}: the robot was not armed: {:?}", sample.fault);
    };
    let mut client = Client::new(&config, cell.law, cell.arm.table(), cell.seed);
    let mut watch = Watch::new(&config, cell.arm.table(), &sample);
    let mut t_s = 0.0;
    while t_s < cell.seconds && watch.worst.stopped.is_none() {
        let request = client.ask(&sample);
        let (next, answer) = world.step(request);
        client.hear(request, answer, &next, &mut watch.worst);
        sample = next;
        watch.see(&sample, t_s).with_context(|| format!("{cell:?} at {t_s:.3} s"))?;
        t_s += watch.limits.period_s;
    }
    Ok(watch.worst)
}

/// Measures taken tick by tick.
struct Watch {
    arm: &'static ArmTable<JOINTS>,
    limits: Limits<JOINTS>,
    speeds: JointSpeeds<JOINTS, f64>,
    last: Sample,
    worst: Outcome,
}

impl Watch {
    fn new(config: &Config, arm: &'static ArmTable<JOINTS>, first: &Sample) -> Self {
        let limits = config.parameters().resized().limits;
        Self { arm, limits, speeds: JointSpeeds::new(arm), last: first.clone(), worst: Outcome::default() }
    }

    fn see(&mut self, sample: &Sample, t_s: f64) -> Result<()> {
        ensure!(sample.q_rad.len() == JOINTS, "the robot gave no state: {:?}", sample.fault);
        let Self { arm, limits, speeds, last, worst } = self;
        let raise = |worst: &mut f64, share: f64| *worst = worst.max(share);
        for i in 0..JOINTS {
            let (q, dq, torque) = (sample.q_rad[i], sample.dq_rad_s[i], sample.arm_torque_nm[i]);
            raise(&mut worst.joint_speed, dq.abs() / speeds.largest(i, q, dq));
            let (low, high) = (arm.q_min_rad[i], arm.q_max_rad[i]);
            raise(&mut worst.joint_range, (2.0 * q - low - high).abs() / (high - low));
            raise(&mut worst.torque, torque.abs() / limits.torque_nm[i]);
            let step = (torque - last.arm_torque_nm[i]).abs();
            raise(&mut worst.torque_step, step / (limits.torque_rate_nm_s * limits.period_s));
        }
        let (place, before) = (sample.flange_position_world, last.flange_position_world);
        raise(&mut worst.flange_speed, distance(place, before) / limits.period_s / limits.flange_speed_m_s);
        let error = distance(place, sample.flange_desired_position_world) / limits.pose_error_m;
        raise(&mut worst.pose_error, error);
        for (speed, most) in sample.base_velocity_command_body.iter().zip(limits.base_velocity) {
            raise(&mut worst.base_speed, speed.abs() / most);
        }
        if let (None, Some(fault)) = (worst.stopped, sample.fault) {
            worst.stopped = Some((fault, t_s));
        }
        *last = sample.clone();
        Ok(())
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The beginning of what the table of the document sums up: no worse, and as it says no stop and no limit passed.
    #[test]
    fn random_targets_pass_no_limit_and_cause_no_stop() {
        let rows = outcomes(cells(2, 20.0)).unwrap();
        for (cell, outcome) in &rows {
            assert!(outcome.passed(), "{cell:?}: {outcome:?}");
        }
        if let Some(shown) = crate::docs::shown("targets") {
            for line in table(&rows).lines().skip(2) {
                let numbers = |line: &str| -> Vec<f64> {
                    line.split('|').skip(6).filter_map(|cell| cell.trim().parse().ok()).collect()
                };
                let name = line.split('|').nth(1).unwrap();
                let long = shown.lines().find(|long| long.starts_with(&format!("|{name}|"))).unwrap();
                let (short, long) = (numbers(line), numbers(long));
                assert_eq!((short.len(), long.len()), (8, 8), "{line}");
                assert!(short.iter().zip(&long).all(|(short, long)| short <= long), "{line}: {long:?}");
                assert!(long[0] == 0.0 && long.iter().all(|share| *share <= 100.0), "{long:?}");
            }
        }
        // The robot was led about, up to near what it may do, and refused what it should.
        let most = |of: fn(&Outcome) -> f64| rows.iter().map(|(_, o)| of(o)).fold(0.0, f64::max);
        assert!(most(|o| o.joint_speed) > 0.4 && most(|o| o.flange_speed) > 0.3, "{rows:?}");
        let taken: u64 = rows.iter().flat_map(|(_, o)| o.taken.values()).sum();
        let refused: u64 = rows.iter().map(|(_, o)| o.refused).sum();
        assert!(rows.len() == 8 && taken > 400 && refused >= 10, "{taken} taken, {refused} refused");
        println!("{}", table(&rows));
    }
}

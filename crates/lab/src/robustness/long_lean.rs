//! `moca-lab long-lean`: somebody leans on one taxel for minutes and lets go, with the daemon's default protection and a
//! board's bytes. No limit of the robot may be used up, and the robot must not stop by itself.

use crate::study::{self, Answer, Column};
use anyhow::{Context, Result, ensure};
use moca_control::config::Config;
use moca_control::plant::Simulated;
use moca_experiments::closed_loop::armed;
use moca_experiments::{JOINTS, TAXELS, unattended};
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{ArmTable, Fault, Law, Limits, Mode, Sample};
use moca_sim::{Engine, VirtualBoardConfig};
use moca_wbc::limits::JointSpeeds;
use serde::Serialize;

/// Postures in which the arm begins, and to which its null space pulls it, rad: 0.12 rad before joint 4's end, and with the elbow
/// so far open that the tool is 2 cm short of its farthest place.
const POSTURES: [(&str, Option<[f64; JOINTS]>); 3] = [
    ("home", None),
    ("near an end", Some([0.0, -1.2, 0.0, -2.95, 0.0, 1.75, 0.785])),
    ("stretched", Some([0.0, 0.5, 0.0, -0.45, 0.0, 1.2, 0.785])),
];
/// Forces of the whole grid, N, and of the short one.
const FORCES_N: [f64; 6] = [10.0, 25.0, 40.0, 80.0, 100.0, 150.0];
const SHORT_FORCES_N: [f64; 2] = [40.0, 100.0];
/// Duration of a lean, s: of the whole grid, and of the short one, in which the base has come to its end.
const LEAN_S: f64 = 300.0;
const SHORT_LEAN_S: f64 = 60.0;
/// Rise and fall of the force, s.
const RAMP_S: f64 = 0.5;
/// Time that is watched after the hand has gone, s.
const AFTER_S: f64 = 10.0;
/// Largest share of a limit that a lean may use.
const MOST_SHARE: f64 = 0.95;
/// Largest share of a joint's speed in a protective stop, where the posture allows nothing else.
const MOST_SHARE_STOPPING: f64 = 1.0 / 3.0;
/// Time that is watched after a stop, s.
const STOPPING_S: f64 = 1.0;
/// A base that somebody lets go of rests within this time, s, and displacement, m.
const REST_S: f64 = 2.0;
const REST_M: f64 = 0.15;

/// Use of each limit in minutes of leaning on the cover: every taxel, law and starting posture.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Leans of a minute with two forces: minutes instead of an hour.
    #[arg(long)]
    short: bool,
    /// Only the leans whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    #[command(flatten)]
    answer: Answer,
}

/// One lean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Cell {
    posture: usize,
    law: Law,
    force_n: f64,
    /// 1 is T1.
    taxel: usize,
    lean_s: f64,
}

impl Cell {
    fn name(&self) -> String {
        let Self { posture, law, force_n, taxel, .. } = *self;
        format!("{}, {}, T{taxel} {force_n:.0} N", POSTURES[posture].0, Mode::from(law).name())
    }
}

/// Largest use of each limit, and the base's motion after the hand has gone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Outcome {
    /// Distance of a joint from the middle of its range, of half the range.
    range: f64,
    joint_speed: f64,
    torque: f64,
    /// The larger of position and orientation error, of the errors that stop the robot.
    pose_error: f64,
    flange_speed: f64,
    /// Speed of the base along an axis, of its largest.
    base_speed: f64,
    /// Measured speed of the cover's fastest point, of the speed limit in force.
    cover_speed: f64,
    /// Largest error of the flange's position while the hand leans, m.
    flange_m: f64,
    /// Displacement of the base while the hand leans, m, and its largest turn, rad.
    base_m: f64,
    turn_rad: f64,
    /// Displacement of the base after the hand has gone, m, and the time until it rests for good, s.
    after_m: f64,
    rests_after_s: f64,
    stopped: Option<Fault>,
}

impl Outcome {
    /// The limit that is used most, and how much of it.
    fn most(&self) -> (&'static str, f64) {
        let shares = [
            ("joint range", self.range),
            ("joint speed", self.joint_speed),
            ("torque", self.torque),
            ("pose error", self.pose_error),
            ("flange speed", self.flange_speed),
            ("base speed", self.base_speed),
        ];
        shares.into_iter().fold(("", 0.0), |most, share| if share.1 > most.1 { share } else { most })
    }

    /// No stop, no limit used up, and a base at rest after it; or a stop before a joint has a third of its speed.
    fn passed(&self) -> bool {
        match self.stopped {
            Some(fault) => {
                matches!(fault, Fault::ArmStretched { .. }) && self.joint_speed < MOST_SHARE_STOPPING
            }
            None => {
                let rests = self.rests_after_s <= REST_S && self.after_m <= REST_M;
                rests && self.most().1 <= MOST_SHARE
            }
        }
    }
}

/// The whole grid, or the short one.
pub(super) fn cells(short: bool) -> Vec<Cell> {
    let (forces, lean_s): (&[f64], f64) =
        if short { (&SHORT_FORCES_N, SHORT_LEAN_S) } else { (&FORCES_N, LEAN_S) };
    let mut cells = Vec::new();
    for posture in 0..POSTURES.len() {
        for law in [Law::Impedance, Law::FollowMe] {
            for &force_n in forces {
                cells.extend((1..=TAXELS).map(|taxel| Cell { posture, law, force_n, taxel, lean_s }));
            }
        }
    }
    cells
}

/// Leans, and prints what the worst of each group uses of the limits.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let mut cells = cells(arguments.short);
    cells.retain(|cell| cell.name().contains(&arguments.only));
    ensure!(!cells.is_empty(), "--only {:?}: no lean has that in its name", arguments.only);
    let rows = outcomes(cells)?;
    arguments.answer.print_cases(&rows, || Ok(table(&rows)))?;
    let failed: Vec<String> =
        rows.iter().filter(|(_, o)| !o.passed()).map(|lean| study::line(LEANS, lean)).collect();
    ensure!(
        failed.is_empty(),
        "{} of {} leans went beyond a limit:\n{}",
        failed.len(),
        rows.len(),
        failed.concat()
    );
    Ok(())
}

/// Leans of `cells`, each with its outcome.
pub(super) fn outcomes(cells: Vec<Cell>) -> Result<Vec<(Cell, Outcome)>> {
    study::outcomes("long leans", cells, lean)
}

/// The table of every lean, after one of each posture and law.
pub(crate) fn markdown() -> Result<String> {
    let rows = outcomes(cells(false))?;
    Ok(format!("{}\n{}", table(&rows), study::table(LEANS, &rows)))
}

/// The row of the lean of this name.
#[cfg(test)]
pub(crate) fn row_named(name: &str) -> Result<String> {
    let found = cells(false).into_iter().filter(|cell| cell.name() == name).collect();
    let rows = outcomes(found)?;
    Ok(study::line(LEANS, rows.first().context("no lean of that name")?))
}

const LEANS: &[Column<(Cell, Outcome)>] = &[
    ("lean", |(cell, _)| cell.name()),
    ("range, %", |(_, o)| format!("{:.1}", 100.0 * o.range)),
    ("joint speed, %", |(_, o)| format!("{:.1}", 100.0 * o.joint_speed)),
    ("torque, %", |(_, o)| format!("{:.1}", 100.0 * o.torque)),
    ("pose error, %", |(_, o)| format!("{:.1}", 100.0 * o.pose_error)),
    ("base speed, %", |(_, o)| format!("{:.1}", 100.0 * o.base_speed)),
    ("flange, mm", |(_, o)| format!("{:.1}", 1e3 * o.flange_m)),
    ("base, m", |(_, o)| format!("{:.2}", o.base_m)),
    ("turned, °", |(_, o)| format!("{:.0}", o.turn_rad.to_degrees())),
    ("stopped", |(_, o)| o.stopped.map_or("–", |fault| fault.code()).into()),
    ("after it, m", |(_, o)| format!("{:.3}", o.after_m)),
    ("rests after, s", |(_, o)| format!("{:.1}", o.rests_after_s)),
];

/// The leans of one posture and law; of a lean that ends in a stop only what it takes for that.
type Group = Vec<(Cell, Outcome)>;

const GROUPS: &[Column<Group>] = &[
    ("posture", |group| POSTURES[group[0].0.posture].0.into()),
    ("law", |group| Mode::from(group[0].0.law).name().into()),
    ("leans", |group| group.len().to_string()),
    ("range, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.range))),
    ("joint speed, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.joint_speed))),
    ("torque, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.torque))),
    ("pose error, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.pose_error))),
    ("base speed, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.base_speed))),
    ("flange, mm", |group| format!("{:.1}", 1e3 * most(group, |o| o.flange_m))),
    ("base, m", |group| format!("{:.2}", most(group, |o| o.base_m))),
    ("turned, °", |group| format!("{:.0}", most(group, |o| o.turn_rad).to_degrees())),
    ("after it, m", |group| format!("{:.3}", most(group, |o| o.after_m))),
    ("rests after, s", |group| format!("{:.1}", most(group, |o| o.rests_after_s))),
    ("stopped", |group| stopped(group, true).count().to_string()),
    ("joint speed there, %", |group| {
        format!("{:.1}", 100.0 * stopped(group, true).map(|o| o.joint_speed).fold(0.0, f64::max))
    }),
];

fn stopped(group: &Group, stopped: bool) -> impl Iterator<Item = &Outcome> {
    group.iter().map(|(_, outcome)| outcome).filter(move |outcome| outcome.stopped.is_some() == stopped)
}

/// The most of the leans that go on.
fn most(group: &Group, of: fn(&Outcome) -> f64) -> f64 {
    stopped(group, false).map(of).fold(0.0, f64::max)
}

fn table(rows: &[(Cell, Outcome)]) -> String {
    study::table(GROUPS, &study::groups(rows, |(cell, _)| (cell.posture, cell.law)))
}

/// One lean from power-up to some seconds after the hand has gone.
fn lean(cell: &Cell) -> Result<Outcome> {
    let mut config = unattended(cell.law);
    if let (_, Some(posture_rad)) = POSTURES[cell.posture] {
        config.control.gains.posture_rad[..JOINTS].copy_from_slice(&posture_rad);
    }
    let scene = moca_sim::Scene { engine: Engine::Analytic, ..free_scene(&config) };
    let mut world = LockStep::with_board(&config, &scene, VirtualBoardConfig::default(), None)?;
    armed(&mut world)?;
    let mut watch = Watch::new(&config)?;
    let hand_s = cell.lean_s + 2.0 * RAMP_S;
    let mut t_s = 0.0;
    let mut stopped_s = 0.0;
    while t_s < hand_s + AFTER_S && stopped_s < STOPPING_S {
        let share = (t_s / RAMP_S).min((hand_s - t_s) / RAMP_S).clamp(0.0, 1.0);
        let pressed = world.control.plant.press(cell.taxel - 1, cell.force_n * share);
        ensure!(pressed.is_ok(), "{cell:?}: cannot press");
        watch.see(&world.tick(None).sample, t_s - hand_s);
        t_s += watch.limits.period_s;
        stopped_s += watch.worst.stopped.map_or(0.0, |_| watch.limits.period_s);
    }
    Ok(watch.worst)
}

/// Measurements tick by tick; of tool and base up to a stop.
struct Watch {
    table: ArmTable<JOINTS>,
    limits: Limits<JOINTS>,
    speeds: JointSpeeds<JOINTS, f64>,
    start: Option<[f64; 3]>,
    let_go: Option<[f64; 3]>,
    flange: Option<[f64; 3]>,
    worst: Outcome,
}

/// Slower than this the base rests, m/s and rad/s, as in the campaign of attacks.
const RESTS: f64 = 5e-3;

impl Watch {
    fn new(config: &Config) -> Result<Self> {
        let table = config.arm().table().context("an arm of seven joints")?;
        let limits = config.parameters().resized().limits;
        let speeds = JointSpeeds::new(&table);
        Ok(Self { table, limits, speeds, start: None, let_go: None, flange: None, worst: Outcome::default() })
    }

    /// One tick, `after_s` after the hand has gone; negative while it leans.
    fn see(&mut self, sample: &Sample, after_s: f64) {
        let worst = &mut self.worst;
        worst.stopped = worst.stopped.or(sample.fault);
        if sample.q_rad.len() < JOINTS || sample.arm_torque_nm.len() < JOINTS {
            return;
        }
        self.joints(sample);
        if self.worst.stopped.is_some() {
            return;
        }
        self.tool(sample);
        let Self { limits, start, let_go, worst, .. } = self;
        let pose = sample.base_pose_world;
        let [x0, y0, yaw0] = *start.get_or_insert(pose);
        if after_s < 0.0 {
            worst.base_m = worst.base_m.max((pose[0] - x0).hypot(pose[1] - y0));
            worst.turn_rad = worst.turn_rad.max((pose[2] - yaw0).abs());
        } else {
            let [x1, y1, _] = *let_go.get_or_insert(pose);
            worst.after_m = worst.after_m.max((pose[0] - x1).hypot(pose[1] - y1));
            if sample.base_velocity_world.iter().any(|v| v.abs() > RESTS) {
                worst.rests_after_s = after_s;
            }
        }
        let (sin, cos) = pose[2].sin_cos();
        let [vx, vy, yaw_rate] = sample.base_velocity_world;
        let body = [cos * vx + sin * vy, cos * vy - sin * vx, yaw_rate];
        for (v, most) in body.iter().zip(limits.base_velocity) {
            worst.base_speed = worst.base_speed.max(v.abs() / most);
        }
        if sample.speed_limit.m_s > 0.0 {
            worst.cover_speed = worst.cover_speed.max(sample.cover_speed_m_s / sample.speed_limit.m_s);
        }
    }

    fn joints(&mut self, sample: &Sample) {
        let Self { table, limits, speeds, worst, .. } = self;
        for i in 0..JOINTS {
            let (q, dq, torque) = (sample.q_rad[i], sample.dq_rad_s[i], sample.arm_torque_nm[i]);
            let (low, high) = (table.q_min_rad[i], table.q_max_rad[i]);
            worst.range = worst.range.max((q - 0.5 * (low + high)).abs() / (0.5 * (high - low)));
            worst.joint_speed = worst.joint_speed.max(dq.abs() / speeds.largest(i, q, dq));
            worst.torque = worst.torque.max(torque.abs() / limits.torque_nm[i]);
        }
    }

    fn tool(&mut self, sample: &Sample) {
        let Self { limits, flange, worst, .. } = self;
        let (at, wanted) = (sample.flange_position_world, sample.flange_desired_position_world);
        let error = distance(at, wanted);
        worst.flange_m = worst.flange_m.max(error);
        let (a, b) = (sample.flange_quaternion_world, sample.flange_desired_quaternion_world);
        let cosine = (0..4).map(|i| a[i] * b[i]).sum::<f64>().abs().min(1.0);
        let angle = 2.0 * cosine.acos();
        worst.pose_error =
            worst.pose_error.max(error / limits.pose_error_m).max(angle / limits.pose_error_rad);
        if let Some(last) = flange.replace(at) {
            let speed = distance(at, last) / limits.period_s;
            worst.flange_speed = worst.flange_speed.max(speed / limits.flange_speed_m_s);
        }
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Leans of which each once ended beyond a limit, or moved the base on after the hand had gone: a turn that a guard left alone,
    /// an elbow drawn straight, one that is straight from the start, a foam that recovers.
    #[test]
    fn leans_of_a_minute_end_before_any_limit_and_the_base_rests() {
        let all = cells(true);
        let some = |law, posture: usize, taxel, force_n: f64| {
            let is = |cell: &&Cell| (cell.law, cell.posture, cell.taxel) == (law, posture, taxel);
            let found = all.iter().filter(is).find(|cell| (cell.force_n - force_n).abs() < 1.0);
            found.copied().unwrap()
        };
        let leans = [
            some(Law::Impedance, 1, 5, 100.0),
            some(Law::Impedance, 0, 9, 100.0),
            some(Law::Impedance, 2, 3, 100.0),
            some(Law::Impedance, 2, 5, 100.0),
            some(Law::FollowMe, 0, 10, 100.0),
            some(Law::FollowMe, 0, 2, 40.0),
        ];
        for (cell, outcome) in outcomes(leans.to_vec()).unwrap() {
            assert!(outcome.passed(), "{}: {outcome:?}", cell.name());
        }
    }

    /// A foam creeps: after some seconds of 150 N its taxel is at the end of its range, which is no fault of it.
    #[test]
    fn lean_beyond_a_taxels_range_does_not_stop_the_robot() {
        let cell = Cell { posture: 0, law: Law::FollowMe, force_n: 150.0, taxel: 1, lean_s: 25.0 };
        let [(_, outcome)] = outcomes(vec![cell]).unwrap().try_into().unwrap();
        assert!(outcome.passed() && outcome.base_m > 0.3, "{outcome:?}");
    }

    #[test]
    fn lean_passes_only_below_its_limits() {
        let calm = Outcome { torque: 0.5, joint_speed: 0.9, ..Outcome::default() };
        assert!(calm.passed() && !Outcome { range: 0.951, ..calm }.passed());
        assert!(
            !Outcome { rests_after_s: 2.1, ..calm }.passed() && !Outcome { after_m: 0.16, ..calm }.passed()
        );
        let stopped = |fault, joint_speed| Outcome { stopped: Some(fault), joint_speed, ..calm }.passed();
        let stretched = Fault::ArmStretched { joint: 3 };
        assert!(stopped(stretched, 0.33) && !stopped(stretched, 1.0 / 3.0));
        assert!(!stopped(Fault::PoseError, 0.1), "of a stretched arm alone");
    }
}

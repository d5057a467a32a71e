//! `moca-lab lean`: how far, how fast and how hard the arm moves when somebody leans on the cover or hits it, with the
//! daemon's default protection and a board's bytes.
//!
//! While a law moves the robot, the flange's place is in W (impedance) or on the base (follow-me), and until
//! [`BRAKED_S`] after a stop it stays so: what braking does to it counts. From then on the arm holds its posture on a
//! base that is told to stand, and the flange's place is the one it then has on that base. Who goes on leaning with 200 N
//! pushes a simulated base against its velocity servo at 2 mm/s, arm and all; that way is the person's and has a column
//! of its own.

use crate::study::{self, Answer, Column, outcomes};
use anyhow::{Context, Result, ensure};
use moca_control::config::Config;
use moca_control::plant::Simulated;
use moca_experiments::closed_loop::armed;
use moca_experiments::{JOINTS, TAXELS, unattended};
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{Fault, Law, Limits, Mode, Sample};
use moca_sim::VirtualBoardConfig;
use moca_wbc::guard::STANDSTILL;
use moca_wbc::limits::JointSpeeds;
use serde::Serialize;

/// Furthest that a lean may move the flange from its place, m.
const FLANGE_M: f64 = 0.010;
/// Time from a stop to the end of braking, s: 50 mm/s at 3 m/s² and five time constants of the base's servo.
const BRAKED_S: f64 = 0.1;

/// Effect of a strong lean or blow on the arm: every taxel, force, law, reactivity and correction.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The hardest cells only: seconds instead of minutes.
    #[arg(long)]
    short: bool,
    #[command(flatten)]
    answer: Answer,
}

/// Course of the hand's force.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Hand {
    /// Within half a second, for six.
    Held,
    /// Within 50 ms, for 200 ms.
    Struck,
}

impl Hand {
    /// Rise and fall, and the time between them, s.
    const fn times_s(self) -> (f64, f64) {
        match self {
            Self::Held => (0.5, 6.0),
            Self::Struck => (0.05, 0.2),
        }
    }

    /// Share of the force at `t_s` after the touch.
    pub(super) fn share(self, t_s: f64) -> f64 {
        let (ramp_s, hold_s) = self.times_s();
        (t_s / ramp_s).min((2.0 * ramp_s + hold_s - t_s) / ramp_s).clamp(0.0, 1.0)
    }

    /// With a second to come to rest, s.
    pub(super) fn duration_s(self) -> f64 {
        let (ramp_s, hold_s) = self.times_s();
        2.0 * ramp_s + hold_s + 1.0
    }
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Cell {
    law: Law,
    /// 1 is T1.
    taxel: usize,
    force_n: f64,
    hand: Hand,
    reactivity: f64,
    null_space_damping: bool,
    base_coupling: bool,
    flange_wrench_feedforward: bool,
}

#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Outcome {
    /// Furthest that the flange was from its place, m.
    flange_m: f64,
    /// Fastest of it, m/s.
    flange_m_s: f64,
    /// Way of the base, m.
    base_m: f64,
    /// Largest joint speed and largest change of a joint torque in a tick, of what is allowed.
    joint_speed_share: f64,
    torque_step_share: f64,
    /// Why the robot stopped, if it did.
    stopped: Option<Fault>,
    /// Displacement of the base after it had braked, m, and its fastest command meanwhile, m/s or rad/s.
    pushed_m: f64,
    told_m_s: f64,
}

impl Outcome {
    fn passed(&self) -> bool {
        let stands = self.told_m_s <= STANDSTILL;
        self.flange_m <= FLANGE_M
            && self.joint_speed_share <= 1.0
            && self.torque_step_share <= 1.0 + 1e-9
            && stands
    }
}

/// Every cell, or only those in which an arm that is not told what the base is refused would be thrown furthest.
fn cells(short: bool) -> Vec<Cell> {
    let taxels: &[usize] = if short { &[1, 6, 7] } else { &std::array::from_fn::<_, TAXELS, _>(|i| i + 1) };
    let forces: &[f64] = if short { &[60.0, 200.0] } else { &[20.0, 60.0, 100.0, 150.0, 200.0] };
    let reactivities: &[f64] = if short { &[1.0, 10.0] } else { &[0.1, 1.0, 3.0, 10.0] };
    let corrections: &[usize] = if short { &[0b000, 0b011] } else { &[0, 1, 2, 3, 4, 5, 6, 7] };
    let hands: &[Hand] = if short { &[Hand::Struck] } else { &[Hand::Held, Hand::Struck] };
    let mut cells = Vec::new();
    for law in [Law::Impedance, Law::FollowMe] {
        for &hand in hands {
            for &switched_on in corrections {
                for &reactivity in reactivities {
                    for &taxel in taxels {
                        cells.extend(forces.iter().map(|&force_n| Cell {
                            law,
                            taxel,
                            force_n,
                            hand,
                            reactivity,
                            null_space_damping: switched_on & 1 != 0,
                            base_coupling: switched_on & 2 != 0,
                            flange_wrench_feedforward: switched_on & 4 != 0,
                        }));
                    }
                }
            }
        }
    }
    // these two do not act in follow-me
    cells.retain(|c| c.law == Law::Impedance || !(c.null_space_damping || c.flange_wrench_feedforward));
    if short {
        let hardest = Cell { hand: Hand::Held, force_n: 200.0, reactivity: 10.0, ..cells[0] };
        for taxel in [1, 2, 4, 6, 7, 9, 11] {
            let held = Cell { taxel, ..hardest };
            cells.push(held);
            cells.push(Cell { null_space_damping: true, base_coupling: true, ..held });
        }
    }
    cells
}

/// Leans, and prints how far the worst of them went.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let rows = outcomes("lean", cells(arguments.short), lean)?;
    arguments.answer.print_cases(&rows, || Ok(table(&rows)))?;
    let failed: Vec<&(Cell, Outcome)> = rows.iter().filter(|(_, outcome)| !outcome.passed()).collect();
    ensure!(failed.is_empty(), "{} of {} leans went beyond a limit: {failed:?}", failed.len(), rows.len());
    Ok(())
}

/// The table of all cells for the documents.
pub(crate) fn markdown() -> Result<String> {
    Ok(table(&outcomes("lean", cells(false), lean)?))
}

impl Cell {
    /// Which one of its group it is.
    fn name(&self) -> String {
        let Self { taxel, reactivity, .. } = self;
        let on = [
            (self.null_space_damping, "damping"),
            (self.base_coupling, "coupling"),
            (self.flange_wrench_feedforward, "feedforward"),
        ];
        let on: Vec<&str> = on.into_iter().filter(|(on, _)| *on).map(|(_, name)| name).collect();
        let on = if on.is_empty() { "literal".into() } else { on.join(" + ") };
        format!("T{taxel}, reactivity {reactivity}, {on}")
    }
}

/// The leans of one law, hand and force, whatever the taxel, the reactivity and the corrections.
type Group = Vec<(Cell, Outcome)>;

const COLUMNS: &[Column<Group>] = &[
    ("law", |group| Mode::from(group[0].0.law).name().into()),
    ("hand", |group| format!("{:?}", group[0].0.hand).to_lowercase()),
    ("N", |group| format!("{:.0}", group[0].0.force_n)),
    ("leans", |group| group.len().to_string()),
    ("flange, mm", |group| format!("{:.2}", 1e3 * most(group, |o| o.flange_m))),
    ("at", |group| {
        let furthest = group.iter().max_by(|a, b| a.1.flange_m.total_cmp(&b.1.flange_m));
        furthest.map_or_else(String::new, |(cell, _)| cell.name())
    }),
    ("flange, m/s", |group| format!("{:.3}", most(group, |o| o.flange_m_s))),
    ("joint speed, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.joint_speed_share))),
    ("torque step, %", |group| format!("{:.1}", 100.0 * most(group, |o| o.torque_step_share))),
    ("stopped", |group| group.iter().filter(|(_, outcome)| outcome.stopped.is_some()).count().to_string()),
    ("pushed on, mm", |group| format!("{:.1}", 1e3 * most(group, |o| o.pushed_m))),
];

fn most(group: &Group, of: fn(&Outcome) -> f64) -> f64 {
    group.iter().map(|(_, outcome)| of(outcome)).fold(0.0, f64::max)
}

fn table(rows: &[(Cell, Outcome)]) -> String {
    study::table(COLUMNS, &study::groups(rows, |(cell, _)| (cell.law, cell.hand, cell.force_n)))
}

fn lean(cell: &Cell) -> Result<Outcome> {
    let mut config = unattended(cell.law);
    config.control.gains.reactivity = cell.reactivity;
    config.control.corrections.null_space_damping = cell.null_space_damping;
    config.control.corrections.base_coupling = cell.base_coupling;
    config.control.corrections.flange_wrench_feedforward = cell.flange_wrench_feedforward;
    let scene = free_scene(&config);
    let mut world = LockStep::with_board(&config, &scene, VirtualBoardConfig::default(), None)?;
    let first = armed(&mut world)?;
    let mut watch = Watch::new(cell.law, &config, &first)?;
    let ticks = (cell.hand.duration_s() / watch.dt_s).round();
    let mut t_s = 0.0;
    while t_s < ticks * watch.dt_s {
        let force_n = cell.force_n * cell.hand.share(t_s);
        let pressed = world.control.plant.press(cell.taxel - 1, force_n);
        ensure!(pressed.is_ok(), "{cell:?}: cannot press with {force_n} N");
        let (sample, _) = world.step(None);
        watch.see(&sample).with_context(|| format!("{cell:?}"))?;
        t_s += watch.dt_s;
    }
    Ok(watch.worst)
}

/// Measures taken tick by tick.
struct Watch {
    law: Law,
    dt_s: f64,
    limits: Limits<JOINTS>,
    speeds: JointSpeeds<JOINTS, f64>,
    first: Sample,
    last: Sample,
    /// Ticks since a stop.
    stopped: u32,
    /// The robot when it had braked.
    braked: Option<Sample>,
    worst: Outcome,
}

impl Watch {
    fn new(law: Law, config: &Config, first: &Sample) -> Result<Self> {
        ensure!(first.taxels.len() == TAXELS, "a cover of {} taxels", first.taxels.len());
        let limits = config.parameters().resized().limits;
        Ok(Self {
            law,
            dt_s: limits.period_s,
            limits,
            speeds: JointSpeeds::new(&config.arm().table().context("an arm of seven joints")?),
            first: first.clone(),
            last: first.clone(),
            stopped: 0,
            braked: None,
            worst: Outcome::default(),
        })
    }

    /// Returns the place of the flange: in W, or on the base.
    fn place(&self, sample: &Sample) -> [f64; 3] {
        let [x, y, z] = sample.flange_position_world;
        match self.law {
            Law::Impedance if self.braked.is_none() => [x, y, z],
            _ => {
                let [bx, by, yaw] = sample.base_pose_world;
                let (s, c) = yaw.sin_cos();
                let (dx, dy) = (x - bx, y - by);
                [c * dx + s * dy, c * dy - s * dx, z]
            }
        }
    }

    fn see(&mut self, sample: &Sample) -> Result<()> {
        ensure!(sample.q_rad.len() == 7, "the robot gave no state: {:?}", sample.fault);
        let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        self.stopped += u32::from(!sample.mode.moves());
        if self.braked.is_none() && f64::from(self.stopped) * self.dt_s > BRAKED_S {
            self.braked = Some(sample.clone());
        }
        let (now, before) = (self.place(sample), self.place(&self.last));
        let home = self.place(self.braked.as_ref().unwrap_or(&self.first));
        let worst = &mut self.worst;
        if let Some(braked) = &self.braked {
            let [x, y, _] = sample.base_pose_world;
            let [x0, y0, _] = braked.base_pose_world;
            worst.pushed_m = worst.pushed_m.max((x - x0).hypot(y - y0));
            worst.told_m_s =
                sample.base_velocity_command_body.iter().fold(worst.told_m_s, |most, v| most.max(v.abs()));
        }
        worst.stopped = worst.stopped.or(sample.fault);
        let [x, y, _] = sample.base_pose_world;
        let [x0, y0, _] = self.first.base_pose_world;
        worst.base_m = worst.base_m.max((x - x0).hypot(y - y0));
        for i in 0..7 {
            let (q, dq) = (sample.q_rad[i], sample.dq_rad_s[i]);
            worst.joint_speed_share = worst.joint_speed_share.max(dq.abs() / self.speeds.largest(i, q, dq));
        }
        if let (Some(_), Some(_)) = (sample.arm_torque_nm.first(), self.last.arm_torque_nm.first()) {
            let most = self.limits.torque_rate_nm_s * self.limits.period_s;
            for (now, before) in sample.arm_torque_nm.iter().zip(&self.last.arm_torque_nm) {
                worst.torque_step_share = worst.torque_step_share.max((now - before).abs() / most);
            }
        }
        self.worst.flange_m = self.worst.flange_m.max(distance(now, home));
        self.worst.flange_m_s = self.worst.flange_m_s.max(distance(now, before) / self.dt_s);
        self.last = sample.clone();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_who_leans_on_the_cover_throws_the_arm() {
        let rows = outcomes("lean", cells(true), lean).unwrap();
        for (cell, outcome) in &rows {
            assert!(outcome.passed(), "{cell:?}: {outcome:?}");
        }
        if let Some(shown) = crate::docs::shown("lean") {
            covers(&shown, &table(&rows));
        }
    }

    /// All cells take minutes: each row of the short table has to lie within the row of the document, which is of more
    /// leans.
    fn covers(shown: &str, short: &str) {
        for row in short.lines().skip(2) {
            let columns: Vec<&str> = row.split(" | ").collect();
            let same = |line: &&str| line.split(" | ").take(3).eq(columns[..3].iter().copied());
            let of_all: Vec<&str> = shown.lines().find(same).unwrap().split(" | ").collect();
            for column in [3, 4, 6, 7, 8, 9, 10] {
                let number = |text: &str| text.trim_end_matches(" |").parse::<f64>().unwrap();
                let (few, all) = (number(columns[column]), number(of_all[column]));
                assert!(few <= all, "`moca-lab docs --only lean` writes it anew: {row}");
            }
        }
        let leans: usize =
            shown.lines().filter_map(|line| line.split(" | ").nth(3)?.parse::<usize>().ok()).sum();
        assert_eq!(leans, cells(false).len());
    }
}

//! `moca-lab lean`: how far, how fast and how hard the arm moves when somebody leans on the cover or hits it, with the
//! daemon's default protection and a stock board's bytes.

use crate::rig::parallel;
use crate::rig::{JOINTS, TAXELS};
use anyhow::{Context, Result, ensure};
use moca_daemon::config::{Config, HandConfig};
use moca_daemon::control::plant::Simulated;
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::runtime::lockstep::LockStep;
use moca_msgs::{Fault, Law, Limits, Sample};
use moca_sim::VirtualBoardConfig;
use moca_wbc::limits::JointSpeeds;
use serde::Serialize;

/// Furthest that a lean may move the flange from its place, m.
const FLANGE_M: f64 = 0.010;
/// Ticks from power-up to a moving law at the latest.
const START_TICKS: u32 = 5000;

/// What a strong lean or blow on the cover does to the arm: every taxel, force, law, reactivity and correction.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The hardest cells only: seconds instead of an hour.
    #[arg(long)]
    short: bool,
    /// One JSON object a cell instead of a table.
    #[arg(long)]
    json: bool,
}

/// How the hand comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Hand {
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
    fn share(self, t_s: f64) -> f64 {
        let (ramp_s, hold_s) = self.times_s();
        (t_s / ramp_s).min((2.0 * ramp_s + hold_s - t_s) / ramp_s).clamp(0.0, 1.0)
    }

    /// With a second to come to rest, s.
    fn duration_s(self) -> f64 {
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
    /// Furthest that the flange was from its place: in W for the impedance law, on the base for follow-me, m.
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
}

impl Outcome {
    fn passed(&self) -> bool {
        self.flange_m <= FLANGE_M && self.joint_speed_share <= 1.0 && self.torque_step_share <= 1.0 + 1e-9
    }
}

/// Every cell of the claim, or the ones that the arm was thrown furthest in before it was told what the base was
/// refused.
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
        let held = Cell { hand: Hand::Held, taxel: 6, force_n: 150.0, reactivity: 1.0, ..cells[0] };
        cells.push(held);
        cells.push(Cell { null_space_damping: true, base_coupling: true, ..held });
    }
    cells
}

/// Leans, and prints how far the worst of them went.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let cells = cells(arguments.short);
    let outcomes = parallel::run("lean", &cells, lean, |_| {});
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;
    let rows: Vec<(Cell, Outcome)> = cells.into_iter().zip(outcomes).collect();
    if arguments.json {
        for (cell, outcome) in &rows {
            println!("{}", serde_json::json!({ "cell": cell, "outcome": outcome }));
        }
    } else {
        print(&rows);
    }
    let failed = rows.iter().filter(|(_, outcome)| !outcome.passed()).count();
    ensure!(failed == 0, "{failed} of {} leans went beyond a limit", rows.len());
    Ok(())
}

/// The worst cell of each law, hand and force, whatever the taxel, the reactivity and the corrections.
#[expect(clippy::print_stdout, reason = "the command's output")]
fn print(rows: &[(Cell, Outcome)]) {
    println!("worst over taxels, reactivities and corrections of {} leans", rows.len());
    println!(
        "law        hand    N      flange mm  m/s    base m  joint speed  torque step  stopped  worst flange at"
    );
    let mut groups: Vec<(Law, Hand, f64)> = Vec::new();
    for (cell, _) in rows {
        let group = (cell.law, cell.hand, cell.force_n);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    for (law, hand, force_n) in groups {
        let of = |(cell, _): &&(Cell, Outcome)| (cell.law, cell.hand, cell.force_n) == (law, hand, force_n);
        let most = |pick: fn(&Outcome) -> f64| {
            rows.iter().filter(of).map(|(_, outcome)| pick(outcome)).fold(0.0, f64::max)
        };
        let stopped = rows.iter().filter(of).filter(|(_, outcome)| outcome.stopped.is_some()).count();
        let worst = rows.iter().filter(of).max_by(|a, b| a.1.flange_m.total_cmp(&b.1.flange_m));
        let at = worst.map_or(String::new(), |(cell, _)| {
            let on = |name: &'static str, on: bool| if on { name } else { "" };
            format!(
                "T{} reactivity {} {}{}{}",
                cell.taxel,
                cell.reactivity,
                on("damping ", cell.null_space_damping),
                on("coupling ", cell.base_coupling),
                on("feedforward", cell.flange_wrench_feedforward)
            )
        });
        println!(
            "{:10} {:6} {force_n:5.0} {:10.2} {:6.3} {:7.3} {:11.1}% {:11.1}% {stopped:8}  {at}",
            format!("{law:?}").to_lowercase(),
            format!("{hand:?}").to_lowercase(),
            1e3 * most(|o| o.flange_m),
            most(|o| o.flange_m_s),
            most(|o| o.base_m),
            100.0 * most(|o| o.joint_speed_share),
            100.0 * most(|o| o.torque_step_share),
        );
    }
}

fn lean(cell: &Cell) -> Result<Outcome> {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.startup.law = cell.law;
    config.control.gains.reactivity = cell.reactivity;
    config.control.corrections.null_space_damping = cell.null_space_damping;
    config.control.corrections.base_coupling = cell.base_coupling;
    config.control.corrections.flange_wrench_feedforward = cell.flange_wrench_feedforward;
    let scene = free_scene(&config);
    let mut world = LockStep::with_board(&config, &scene, VirtualBoardConfig::default(), None)?.untimed();
    let mut tick = 0;
    let first = loop {
        let (sample, _) = world.step(None);
        if sample.mode.moves() {
            break sample;
        }
        tick += 1;
        ensure!(tick < START_TICKS, "{cell:?}: the robot was not armed: {:?}", sample.fault);
    };
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

/// What is measured tick by tick.
struct Watch {
    law: Law,
    dt_s: f64,
    limits: Limits<JOINTS>,
    speeds: JointSpeeds<JOINTS, f64>,
    first: Sample,
    last: Sample,
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
            worst: Outcome::default(),
        })
    }

    /// Where the flange is: in W, or on the base.
    fn place(&self, sample: &Sample) -> [f64; 3] {
        let [x, y, z] = sample.flange_position_world;
        match self.law {
            Law::Impedance => [x, y, z],
            Law::FollowMe => {
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
        let (now, before) = (self.place(sample), self.place(&self.last));
        let worst = &mut self.worst;
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
        let place = self.place(&self.first);
        self.worst.flange_m = self.worst.flange_m.max(distance(now, place));
        self.worst.flange_m_s = self.worst.flange_m_s.max(distance(now, before) / self.dt_s);
        self.last = sample.clone();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn nobody_who_leans_on_the_cover_throws_the_arm() {
        let cells = super::cells(true);
        for cell in &cells {
            let outcome = super::lean(cell).unwrap();
            assert!(outcome.passed(), "{cell:?}: {outcome:?}");
        }
    }
}

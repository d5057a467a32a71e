//! `moca-lab self-collision`: random targets, twists and pushes, and whether the arm ever meets itself, the base or the floor.

use crate::study::{self, Answer, Column, outcomes};
use anyhow::{Context, Result, ensure};
use moca_control::config::Config;
use moca_control::plant::Simulated;
use moca_control::targets::Targets;
use moca_experiments::closed_loop::armed;
use moca_experiments::{JOINTS, unattended};
use moca_lockstep::LockStep;
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::inject::Random;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::target::{SPEED_MAX_M_S, SPEED_MAX_RAD_S};
use moca_msgs::{
    ArmTable, Law, Mode, ParameterValues, Refusal, Request, Sample, Target, TargetRefusal, TimedTarget,
    TwistAxes,
};
use moca_wbc::limits::REPULSION_BAND_RAD;
use moca_wbc::reference_generator::Workspace;
use moca_wbc::self_collision::SelfCollision;
use moca_wbc::{ArmModel, rotation};
use serde::Serialize;
use std::collections::BTreeMap;

/// Draws of the campaign, and as many times fewer without the guard.
const DRAWS: u64 = 100_000;
const WITHOUT_GUARD: u64 = 50;
/// Draws of one run, and the length of each, s.
const RUN_DRAWS: u64 = 40;
const DRAW_S: f64 = 1.5;
/// Smallest distance that is allowed, m.
const LEAST_M: f64 = 0.02;
/// Largest push at the flange, N, its largest moment, N·m, and the largest on a taxel, N.
const PUSH_N: f64 = 30.0;
const PUSH_NM: f64 = 1.0;
const PRESS_N: f64 = 30.0;

/// Random targets, twists and pushes on an arm that keeps its distance: contacts in MuJoCo, nearest distance, cost in reach.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Targets, twists and pushes of both laws together; a fiftieth of them once more without the guard.
    #[arg(long, default_value_t = DRAWS)]
    draws: u64,
    #[command(flatten)]
    answer: Answer,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Cell {
    law: Law,
    guarded: bool,
    seed: u64,
}

#[derive(Clone, Debug, Default, Serialize)]
struct Outcome {
    draws: u64,
    taken: u64,
    /// Targets that would have led two parts too near to each other.
    refused_near: u64,
    refused: u64,
    /// Physics steps in which MuJoCo saw a contact.
    contacts: u64,
    /// Smallest distance of two parts, m.
    nearest_m: f64,
    stops: BTreeMap<String, u64>,
}

fn cells(draws: u64) -> Vec<Cell> {
    let mut cells = Vec::new();
    for guarded in [true, false] {
        let runs = (draws / 2 / if guarded { 1 } else { WITHOUT_GUARD }).div_ceil(RUN_DRAWS).max(1);
        for law in [Law::Impedance, Law::FollowMe] {
            cells.extend((1..=runs).map(|seed| Cell { law, guarded, seed }));
        }
    }
    cells
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        (1..=10_000_000).contains(&arguments.draws),
        "--draws {}: allowed: 1 to 10000000",
        arguments.draws
    );
    let rows = outcomes("self-collision", cells(arguments.draws), led)?;
    let groups = study::groups(&rows, |(cell, _)| (cell.guarded, cell.law));
    arguments
        .answer
        .print_cases(&rows, || Ok(format!("{}\n{}", study::table(COLUMNS, &groups), reach()?)))?;
    let touched = rows.iter().find(|(cell, outcome)| cell.guarded && outcome.contacts > 0);
    ensure!(touched.is_none(), "a guarded arm touched the robot: {touched:?}");
    Ok(())
}

/// The runs of a law, with or without the guard.
type Group = Vec<(Cell, Outcome)>;

const COLUMNS: &[Column<Group>] = &[
    ("law", |group| Mode::from(group[0].0.law).name().into()),
    ("guard", |group| if group[0].0.guarded { "on".into() } else { "off".into() }),
    ("draws", |group| sum(group, |run| run.draws)),
    ("targets taken", |group| sum(group, |run| run.taken)),
    ("refused: too near", |group| sum(group, |run| run.refused_near)),
    ("refused: other", |group| sum(group, |run| run.refused)),
    ("stops", |group| sum(group, |run| run.stops.values().sum())),
    ("steps with a contact", |group| sum(group, |run| run.contacts)),
    ("nearest, mm", |group| format!("{:.1}", nearest_mm(group)[0])),
    ("nearest of the middle run, mm", |group| format!("{:.1}", nearest_mm(group)[group.len() / 2])),
];

fn sum(group: &Group, of: fn(&Outcome) -> u64) -> String {
    group.iter().map(|(_, run)| of(run)).sum::<u64>().to_string()
}

/// Smallest distance in each run, mm, the smallest of all first.
fn nearest_mm(group: &Group) -> Vec<f64> {
    let mut nearest: Vec<f64> = group.iter().map(|(_, run)| 1e3 * run.nearest_m).collect();
    nearest.sort_by(f64::total_cmp);
    nearest
}

/// Postures between the ends of the joints' ranges that the guard takes away.
fn reach() -> Result<String> {
    const POSTURES: u32 = 100_000;
    let config = config(Law::Impedance, true)?;
    let (guard, model, arm) = (guard(&config)?, model(&config)?, arm(&config)?);
    let mut random = Random::new(7);
    let (mut near, mut meet) = (0_u32, 0_u32);
    for _ in 0..POSTURES {
        let q = std::array::from_fn(|i| {
            let share = 0.5 * (1.0 + share(&mut random));
            arm.q_min_rad[i] + share * (arm.q_max_rad[i] - arm.q_min_rad[i])
        });
        let distance_m =
            guard.nearest(&model.kinematics(0.0, &q)).map_or(f64::INFINITY, |nearest| nearest.distance);
        near += u32::from(distance_m < LEAST_M);
        meet += u32::from(distance_m < 0.0);
    }
    let percent = |count: u32| 100.0 * f64::from(count) / f64::from(POSTURES);
    Ok(format!(
        "\n| postures within the joints' ranges | % |\n|---|---|\n| parts meet | {:.1} |\n| parts nearer than {:.0} mm that do not meet: \
         the cost of the guard | {:.1} |\n",
        percent(meet),
        1e3 * LEAST_M,
        percent(near - meet)
    ))
}

fn config(law: Law, guarded: bool) -> Result<Config> {
    let mut config = unattended(law);
    config.control.self_collision.distance_m = if guarded { LEAST_M } else { 0.0 };
    Ok(config)
}

fn arm(config: &Config) -> Result<ArmTable<JOINTS>> {
    config.arm().table().context("an arm of another number of joints")
}

fn model(config: &Config) -> Result<ArmModel<JOINTS, f64>> {
    Ok(ArmModel::new(&arm(config)?, &config.robot.mount, &config.robot.payload())?)
}

fn guard(config: &Config) -> Result<SelfCollision<JOINTS, f64>> {
    let solids = config.solids();
    Ok(SelfCollision::new(&arm(config)?, &config.robot.mount, &solids, LEAST_M)?)
}

/// One robot under its draws; after a stop another one goes on.
fn led(cell: &Cell) -> Result<Outcome> {
    let config = config(cell.law, cell.guarded)?;
    let mut random = Random::new(cell.seed);
    let watch = Watch { guard: guard(&config)?, model: model(&config)? };
    let arm = arm(&config)?;
    let workspace = *Targets::new(&config).workspace();
    let draw = |random: &mut Random, sample: &Sample| Draw::new(random, sample, &arm, &workspace);
    let mut outcome = Outcome { nearest_m: f64::INFINITY, ..Outcome::default() };
    while outcome.draws < RUN_DRAWS {
        one_robot(&config, &watch, &mut random, draw, &mut outcome).with_context(|| format!("{cell:?}"))?;
    }
    Ok(outcome)
}

/// Parts of an arm and where they are.
struct Watch {
    guard: SelfCollision<JOINTS, f64>,
    model: ArmModel<JOINTS, f64>,
}

impl Watch {
    /// Distance of the two nearest parts, m, as far as anything is near.
    fn distance_m(&self, sample: &Sample) -> f64 {
        let q: [f64; JOINTS] = std::array::from_fn(|i| sample.q_rad.get(i).copied().unwrap_or(f64::NAN));
        self.guard.nearest(&self.model.kinematics(0.0, &q)).map_or(f64::INFINITY, |nearest| nearest.distance)
    }

    /// Scene in which MuJoCo compares what the guard compares.
    fn scene(&self, config: &Config) -> moca_sim::Scene {
        let links = 0..=config.arm().joints + 1;
        let apart = links.clone().flat_map(|a| (0..a).map(move |b| [b, a]));
        let apart = apart.filter(|[a, b]| !self.guard.compares(*a, *b)).collect();
        moca_sim::Scene { capsules: config.robot.arm.capsules.clone(), apart, ..free_scene(config) }
    }
}

fn one_robot(
    config: &Config,
    watch: &Watch,
    random: &mut Random,
    draw: impl Fn(&mut Random, &Sample) -> Draw,
    outcome: &mut Outcome,
) -> Result<()> {
    let mut world = LockStep::with_true_forces(config, &watch.scene(config), IdealCover::new(1, 0))?;
    let mut sample = armed(&mut world)?;
    let ticks = (DRAW_S * f64::from(config.control_loop.rate_hz)).round();
    while outcome.draws < RUN_DRAWS {
        outcome.draws += 1;
        let drawn = draw(random, &sample);
        let plant = &mut world.control.plant;
        plant.world.set_flange_wrench_world(drawn.push_world)?;
        for taxel in 0..config.robot.cover.count() {
            let force_n = if drawn.pressed == Some(taxel) { PRESS_N } else { 0.0 };
            ensure!(plant.press(taxel, force_n).is_ok(), "no taxel T{}", taxel + 1);
        }
        let mut request = drawn
            .target
            .map(|target| Request::Target(TimedTarget { age_limit_s: 2.0, ..TimedTarget::new(target) }));
        let mut tick = 0.0;
        while tick < ticks {
            let (next, answer) = world.step(request.take());
            match answer {
                Some(Ok(())) => outcome.taken += 1,
                Some(Err(Refusal::Target(TargetRefusal::TooNear { .. }))) => outcome.refused_near += 1,
                Some(Err(_)) => outcome.refused += 1,
                None => {}
            }
            sample = next;
            outcome.contacts += u64::from(world.control.plant.world.contacts() > 0);
            outcome.nearest_m = outcome.nearest_m.min(watch.distance_m(&sample));
            if let Some(fault) = sample.fault {
                *outcome.stops.entry(fault.code().to_string()).or_default() += 1;
                return Ok(());
            }
            tick += 1.0;
        }
    }
    Ok(())
}

/// One draw: a target, a push at the flange, a press on the cover.
struct Draw {
    target: Option<Target>,
    push_world: [f64; 6],
    pressed: Option<usize>,
}

impl Draw {
    fn new(random: &mut Random, sample: &Sample, arm: &ArmTable<JOINTS>, workspace: &Workspace) -> Self {
        let target = match random.below(8) {
            0..=2 => Some(pose(random, sample, workspace)),
            3 | 4 => Some(twist(random)),
            5 => Some(posture(random, arm)),
            _ => None,
        };
        let push_world = if target.is_none() || random.one_in(3) { push(random) } else { [0.0; 6] };
        let pressed = (target.is_none() && random.one_in(3)).then(|| random.below(sample.taxels.len()));
        Self { target, push_world, pressed }
    }
}

/// From -1 to 1.
#[expect(clippy::cast_precision_loss, reason = "a random number")]
pub(super) fn share(random: &mut Random) -> f64 {
    (random.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// Uniform in the unit ball.
pub(super) fn in_ball<const N: usize>(random: &mut Random) -> [f64; N] {
    loop {
        let v: [f64; N] = std::array::from_fn(|_| share(random));
        let squared: f64 = v.iter().map(|x| x * x).sum();
        if (1e-4..=1.0).contains(&squared) {
            return v;
        }
    }
}

/// Anywhere within reach, turned anyhow; half of them near the base.
fn pose(random: &mut Random, sample: &Sample, workspace: &Workspace) -> Target {
    let reach_m = workspace.reach_m * if random.one_in(2) { 0.5 } else { 1.0 };
    let ball: [f64; 3] = in_ball(random);
    let [fx, fy, fz]: [f64; 3] = std::array::from_fn(|i| workspace.shoulder_base_m[i] + reach_m * ball[i]);
    let [x, y, yaw] = sample.base_pose_world;
    let [fx, fy, fz] = rotation::Heading::at(yaw).to_world([fx, fy, fz]);
    let turn: [f64; 4] = in_ball(random);
    let length = turn.iter().map(|v| v * v).sum::<f64>().sqrt();
    Target::Pose { position_world: [x + fx, y + fy, fz], quaternion_world: turn.map(|v| v / length) }
}

/// As fast as is allowed along and about every axis, or anything below.
pub(super) fn twist(random: &mut Random) -> Target {
    let axes = [TwistAxes::World, TwistAxes::Base, TwistAxes::Flange][random.below(3)];
    let corner = random.one_in(2);
    let twist = std::array::from_fn(|i| {
        let most = if i < 3 { SPEED_MAX_M_S } else { SPEED_MAX_RAD_S };
        let share = share(random);
        most * if corner { share.signum() } else { share }
    });
    Target::Twist { axes, twist }
}

fn posture(random: &mut Random, arm: &ArmTable<JOINTS>) -> Target {
    let (low, high) = (arm.q_min_rad, arm.q_max_rad);
    let q: [f64; JOINTS] = std::array::from_fn(|i| {
        // Nearer to its end the range pushes back.
        0.5 * (low[i] + high[i] + share(random) * (high[i] - low[i] - 2.001 * REPULSION_BAND_RAD))
    });
    Target::Posture(ParameterValues::new(&q).unwrap_or_default())
}

/// A push at the flange, N and N·m.
fn push(random: &mut Random) -> [f64; 6] {
    let ([fx, fy, fz], [mx, my, mz]): ([f64; 3], [f64; 3]) = (in_ball(random), in_ball(random));
    [PUSH_N * fx, PUSH_N * fy, PUSH_N * fz, PUSH_NM * mx, PUSH_NM * my, PUSH_NM * mz]
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_lockstep::TrueForces;
    use moca_msgs::{TouchPolicy, Waypoint};

    /// The beginning of the campaign.
    #[test]
    fn guarded_arm_meets_nothing_in_mujoco() {
        let cells: Vec<_> = cells(1).into_iter().filter(|cell| cell.guarded).collect();
        for (cell, outcome) in outcomes("self-collision", cells, led).unwrap() {
            assert_eq!(outcome.contacts, 0, "{cell:?} {outcome:?}");
            assert!((0.015..0.1).contains(&outcome.nearest_m) && outcome.taken > 10, "{cell:?} {outcome:?}");
        }
    }

    #[test]
    fn mujoco_sees_what_the_guard_would_have_kept_apart() {
        let config = config(Law::Impedance, true).unwrap();
        let watch = Watch { guard: guard(&config).unwrap(), model: model(&config).unwrap() };
        let contacts = |q: [f64; JOINTS]| {
            let mut scene = watch.scene(&config);
            scene.arm_posture_rad[..JOINTS].copy_from_slice(&q);
            moca_sim::SimPlant::new(&scene).unwrap().contacts()
        };
        // the hand in the shoulder, below the top of the base, and in the floor
        let postures = [
            [0.0, -1.7, 0.0, -3.0, 0.0, 0.1, 0.0],
            [0.0, 1.7, 0.0, -1.2, 0.0, 1.9, 0.0],
            [0.0, 1.7, 0.0, -0.5, 0.0, 0.6, 0.0],
        ];
        for q in postures {
            let nearest = watch.guard.nearest(&watch.model.kinematics(0.0, &q)).unwrap();
            assert_eq!(contacts(q) > 0, nearest.distance < 0.0, "{q:?}: {nearest:?}");
        }
        assert!(contacts(postures[0]) > 0);
        assert_eq!(contacts(arm(&config).unwrap().home_rad), 0);
    }

    fn guarded(law: Law) -> (LockStep<IdealCover, TrueForces>, Sample) {
        let config = config(law, true).unwrap();
        let cover = IdealCover::new(1, 0);
        let mut world = LockStep::with_true_forces(&config, &free_scene(&config), cover).unwrap();
        let sample = armed(&mut world).unwrap();
        (world, sample)
    }

    #[test]
    fn target_that_leads_too_near_is_refused_with_both_parts() {
        for law in [Law::Impedance, Law::FollowMe] {
            let (mut world, sample) = guarded(law);
            let mut ask = |target| {
                let (sample, answer) = world.step(Some(Request::Target(TimedTarget::new(target))));
                (answer.unwrap().map_err(|refusal| refusal.to_string()), sample.target.is_some())
            };
            let folded =
                Target::Posture(ParameterValues::new(&[0.0, -1.2, 0.0, -2.9, 0.0, 0.2, 0.0]).unwrap());
            let said = "link 7 and link 2 would be 0.010 m apart, at least 0.020 m are allowed: choose a target further away from link 2";
            assert_eq!(ask(folded), (Err(said.into()), false), "and nothing begins");
            // the hand points down, a centimetre and a half above the base
            let position_world = [0.45, 0.0, 0.541];
            let quaternion_world = sample.flange_quaternion_world;
            let (answer, began) = ask(Target::Pose { position_world, quaternion_world });
            let why = answer.unwrap_err();
            assert!(why.contains("and the base would be") && !began, "{why}");
            let waypoint = Waypoint { time_s: 5.0, position_world, quaternion_world };
            let request = Request::Waypoint { index: 0, count: 1, waypoint, touch: TouchPolicy::TouchWins };
            let (sample_after, answer) = world.step(Some(request));
            assert!(
                matches!(answer, Some(Err(Refusal::Target(TargetRefusal::TooNear { .. })))),
                "{answer:?}"
            );
            assert_eq!(sample_after.target, None);
            let mut ask = |target| world.step(Some(Request::Target(TimedTarget::new(target)))).1.unwrap();
            let home = Target::Posture(
                ParameterValues::new(&arm(&config(law, true).unwrap()).unwrap().home_rad).unwrap(),
            );
            assert_eq!(ask(home), Ok(()));
            let [x, y, z] = sample.flange_position_world;
            let quaternion_world = sample.flange_quaternion_world;
            assert_eq!(ask(Target::Pose { position_world: [x, y, z - 0.1], quaternion_world }), Ok(()));
        }
    }
}

//! Robots of a batch, as `moca.SimBatch` holds them, next to bare steps of MuJoCo on the same scene.

use super::Row;
use crate::numerics::economy::Standing;
use crate::robustness::soak::in_use_kib;
use anyhow::Result;
use moca_control::config::{Config, HandConfig};
use moca_experiments::closed_loop::armed;
use moca_experiments::count;
use moca_experiments::cpu_time::timed;
use moca_experiments::timed::loop_tick;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::virtual_boards::board_config;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::Request;
use moca_sim::{Engine, Scene};

/// Ticks that each robot makes in its turn: a step of a learner.
const TICKS: usize = 20;
/// Fewest ticks of all robots in a turn.
const TICKS_MIN: usize = 2000;
/// Hand that presses every robot, N.
const HAND: Request = Request::PressTaxel { taxel: 5, force_n: 15.0 };

type Robot = Box<LockStep<ByteCover, MemoryBoards>>;

/// Memory and time that a robot takes.
pub(super) struct Cost {
    pub kilobytes: f64,
    pub build_ms: f64,
}

/// Name of the row for so many robots.
pub(super) fn name(robots: usize) -> String {
    format!("tick of a batch of {robots}")
}

fn built(seed: u64) -> Result<Robot> {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.simulation.seed = seed;
    let scene = free_scene(&config);
    let scene = Scene { engine: scene.needed_engine(), ..scene };
    Ok(Box::new(LockStep::with_board(&config, &scene, board_config(&config), None)?))
}

/// A robot whose law is in control and which somebody presses.
fn pressed(seed: u64) -> Result<Robot> {
    let mut robot = built(seed)?;
    armed(&mut robot)?;
    robot.tick(Some(HAND));
    Ok(robot)
}

/// Position of base and joints, m, rad.
fn place(robot: &Robot) -> Vec<f64> {
    let sample = &robot.control.ticked().sample;
    sample.base_pose_world.iter().chain(&sample.q_rad).copied().collect()
}

/// A row for each size of a batch. The error is that of its last robot to one that was stepped alone.
pub(super) fn rows(sizes: &[usize], turns: usize) -> Result<Vec<Row>> {
    sizes.iter().map(|size| row(*size, turns)).collect()
}

fn row(size: usize, turns: usize) -> Result<Row> {
    let mut row = Row::new(name(size), "bare `mj_step`".into(), "m, rad to a robot alone", 0.0);
    let mut bare = Standing::new(&Scene { engine: Engine::MuJoCo, ..free_scene(&Config::default()) })?;
    let seeds = 0..u64::try_from(size)?;
    let mut robots = seeds.clone().map(pressed).collect::<Result<Vec<_>>>()?;
    let mut alone = pressed(seeds.end - 1)?;
    let rounds = TICKS_MIN.div_ceil(TICKS * size);
    for _ in 0..turns {
        let before_s = bare.step_s()?;
        let ((), tick_s) = timed(|| {
            for robot in (0..rounds).flat_map(|_| 0..size) {
                for _ in 0..TICKS {
                    loop_tick(&mut robots[robot]);
                }
            }
        });
        let bare_s = 0.5 * (before_s + bare.step_s()?);
        row.ratios.push(bare_s * count(rounds * size * TICKS) / tick_s);
    }
    for _ in 0..turns * rounds * TICKS {
        alone.tick(None);
    }
    let last = robots.last().map(place).unwrap_or_default();
    for (a, b) in last.iter().zip(place(&alone)) {
        row.raise_error((a - b).abs());
    }
    Ok(row)
}

/// Memory that a robot holds and CPU time to build it, means over so many.
pub(super) fn cost(robots: u64) -> Result<Cost> {
    drop(built(0)?);
    let before_kib = in_use_kib();
    let (built, build_s) = timed(|| (0..robots).map(built).collect::<Result<Vec<_>>>());
    let held_kib = in_use_kib().saturating_sub(before_kib);
    let number = count(built?.len());
    #[expect(clippy::cast_precision_loss, reason = "far below 2^53")]
    let held = held_kib as f64;
    Ok(Cost { kilobytes: 1.024 * held / number, build_ms: 1e3 * build_s / number })
}

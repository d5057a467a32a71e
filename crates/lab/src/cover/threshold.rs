//! `moca-lab threshold`: what the contact threshold costs and what it buys: the smallest force that is felt, how late
//! it is felt, and how little an untouched robot creeps under the sensor's noise.

use crate::study::{self, Column};
use anyhow::{Context, Result, ensure};
use moca_experiments::closed_loop::armed;
use moca_experiments::parallel;
use moca_experiments::unattended;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::{Law, Request, Sample};
use moca_sim::VirtualBoardConfig;

/// The smallest force that is felt and its delay; how little an untouched robot creeps.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Time untouched for each seed, s, 1 to 3600.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Seeds of the sensor's noise.
    #[arg(long, value_delimiter = ',', default_value = "1,2,3")]
    seeds: Vec<u64>,
}

type World = LockStep<ByteCover, MemoryBoards>;

/// The front taxel; all taxels have the same foam and the same threshold.
const TAXEL: u8 = 5;
/// A force not felt in this time is not felt, ticks.
const PATIENCE_TICKS: u64 = 2000;
/// Resolution of the search, N.
const STEP_N: f64 = 0.25;

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        (1.0..=3600.0).contains(&arguments.seconds),
        "--seconds {} s is outside 1 to 3600 s",
        arguments.seconds
    );
    let row = |&seed: &u64| -> Result<Row> {
        let [late, soon] =
            [smallest_felt(seed)?, (20.0, felt_after(seed, 20.0)?.context("20 N were not felt")?)];
        Ok((seed, untouched(seed, arguments.seconds)?, [late, soon]))
    };
    study::print(&study::table(COLUMNS, &parallel::run("threshold", &arguments.seeds, row)?));
    Ok(())
}

/// Seed, distance that the untouched base moved, m; the smallest force that is felt and 20 N, N, each with its delay, ms.
type Row = (u64, f64, [(f64, u64); 2]);

const COLUMNS: &[Column<Row>] = &[
    ("seed", |(seed, ..)| seed.to_string()),
    ("untouched base moved, mm", |(_, moved_m, _)| format!("{:.6}", 1e3 * moved_m)),
    ("smallest felt, N", |(.., [(force_n, _), _])| format!("{force_n:.2}")),
    ("felt after (smallest), ms", |(.., [(_, late_ms), _])| late_ms.to_string()),
    ("felt after (20 N), ms", |(.., [_, (_, soon_ms)])| soon_ms.to_string()),
];

fn started(seed: u64) -> Result<World> {
    let config = unattended(Law::Impedance);
    let board = VirtualBoardConfig { seed, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
    armed(&mut world)?;
    Ok(world)
}

/// Largest distance of the base from where it started, m.
fn untouched(seed: u64, seconds: f64) -> Result<f64> {
    let mut world = started(seed)?;
    let place = |sample: &Sample| [sample.base_pose_world[0], sample.base_pose_world[1]];
    let [x0, y0] = place(&world.step(None).0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be 1 to 3600 s")]
    let ticks = (1e3 * seconds) as u64;
    let mut farthest: f64 = 0.0;
    for _ in 0..ticks {
        let [x, y] = place(&world.step(None).0);
        farthest = farthest.max((x - x0).hypot(y - y0));
    }
    Ok(farthest)
}

/// Time from the start of a steady press to the first force the controller sees, ms; `None` if it never does.
fn felt_after(seed: u64, force_n: f64) -> Result<Option<u64>> {
    let mut world = started(seed)?;
    let (_, outcome) = world.step(Some(Request::PressTaxel { taxel: TAXEL, force_n }));
    ensure!(outcome == Some(Ok(())), "the simulated press was refused: {outcome:?}");
    Ok((1..PATIENCE_TICKS).find(|_| world.step(None).0.taxels[usize::from(TAXEL)].force_n > 0.0))
}

fn smallest_felt(seed: u64) -> Result<(f64, u64)> {
    let mut force_n = STEP_N;
    loop {
        if let Some(ms) = felt_after(seed, force_n)? {
            return Ok((force_n, ms));
        }
        force_n += STEP_N;
        ensure!(force_n <= 50.0, "not even 50 N are felt");
    }
}

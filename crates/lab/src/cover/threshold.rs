//! `moca-lab threshold`: what the contact threshold costs and what it buys: the smallest force that is felt, how late
//! it is felt, and how little an untouched robot creeps under the sensor's noise.
#![expect(clippy::print_stdout, reason = "a command prints its result")]

use anyhow::{Context, Result, ensure};
use moca_control::config::{Config, HandConfig};
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::devices::touch_board::ByteCover;
use moca_daemon::runtime::lockstep::{LockStep, MemoryBoards};
use moca_experiments::closed_loop::armed;
use moca_experiments::parallel;
use moca_msgs::{Request, Sample};
use moca_sim::VirtualBoardConfig;

/// Arguments of `moca-lab threshold`.
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
    println!(
        "{:>5} {:>22} {:>20} {:>22} {:>20}",
        "seed", "untouched base moved", "smallest felt", "felt after (smallest)", "felt after (20 N)"
    );
    // A bar and a line of the table do not mix on one screen: all lines follow the bar.
    let row = |&seed: &u64| -> Result<_> {
        let soon_ms = felt_after(seed, 20.0)?.context("20 N were not felt")?;
        Ok((seed, untouched(seed, arguments.seconds)?, smallest_felt(seed)?, soon_ms))
    };
    for (seed, moved_m, (smallest_n, late_ms), soon_ms) in parallel::run("threshold", &arguments.seeds, row)?
    {
        println!(
            "{seed:>5} {:>19.6} mm {smallest_n:>18.2} N {late_ms:>19} ms {soon_ms:>17} ms",
            1e3 * moved_m
        );
    }
    Ok(())
}

fn started(seed: u64) -> Result<World> {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
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

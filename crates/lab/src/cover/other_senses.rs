//! `moca-lab docs --only other-senses`: what the base's own servo error and the arm's external wrench say of a touch on the
//! cover before the cover feels it.

use anyhow::{Result, ensure};
use moca_control::config::{Config, HandConfig};
use moca_control::plant::Simulated;
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::runtime::lockstep::LockStep;
use moca_msgs::{Sample, seconds};
use moca_sim::VirtualBoardConfig;
use moca_tactile::Firmware;
use std::fmt::Write as _;

const BOARDS: [Firmware; 2] = [Firmware::Stock2018, Firmware::Moca];
const FORCES_N: [f64; 5] = [3.0, 5.2, 8.0, 25.0, 100.0];
/// T6, in front.
const FRONT: usize = 5;
/// Ticks after which a press counts as not detected.
const PATIENCE: u64 = 500;
/// Time to come to rest before the touch, ticks.
const REST: u64 = 1000;

/// Signs of a steady press until the cover detects it.
struct Shown {
    felt_after_s: Option<f64>,
    /// Largest difference of the base's measured velocity to its order, m/s, and change of the arm's wrench, N.
    servo_m_s: f64,
    wrench_n: f64,
}

fn pressed(firmware: Firmware, force_n: f64) -> Result<Shown> {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    let board = VirtualBoardConfig { firmware, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?.untimed();
    let mut before = Sample::default();
    let mut rested = 0;
    while rested < REST {
        before = world.step(None).0;
        rested += u64::from(before.mode.moves());
        ensure!(before.fault.is_none() && before.tick < 20_000, "not at rest: {:?}", before.fault);
    }
    ensure!(world.control.plant.press(FRONT, force_n).is_ok(), "nobody can press with {force_n} N");
    let mut shown = Shown { felt_after_s: None, servo_m_s: 0.0, wrench_n: 0.0 };
    for _ in 0..PATIENCE {
        let sample = world.step(None).0;
        if sample.taxels[FRONT].force_n > 0.0 {
            shown.felt_after_s = Some(seconds(sample.time_ns - before.time_ns));
            break;
        }
        let servo_m_s = sample.base_velocity_world[0] - sample.base_velocity_command_body[0];
        shown.servo_m_s = shown.servo_m_s.max(servo_m_s.abs());
        for (now, then) in sample.flange_wrench_world.iter().zip(before.flange_wrench_world).take(3) {
            shown.wrench_n = shown.wrench_n.max((now - then).abs());
        }
    }
    Ok(shown)
}

/// The table.
pub(crate) fn markdown() -> Result<String> {
    let mut out = String::from(
        "| board | T6 pressed with | felt after | base's servo error until then | arm's external force until then |\n\
         |---|---|---|---|---|\n",
    );
    for board in BOARDS {
        for force_n in FORCES_N {
            let shown = pressed(board, force_n)?;
            let felt = shown.felt_after_s.map_or("not".into(), |s| format!("{:.0} ms", 1e3 * s));
            // Writing to a string cannot fail.
            let _ = writeln!(
                out,
                "| {} | {force_n} N | {felt} | {:.2} mm/s | {:.2} N |",
                board.name(),
                1e3 * shown.servo_m_s,
                shown.wrench_n
            );
        }
    }
    Ok(out)
}

//! Servo error of the base and external wrench of the arm in a touch on the cover, until the cover feels it.

use anyhow::{Result, ensure};
use moca_control::plant::Simulated;
use moca_experiments::unattended;
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{Law, Sample, seconds};
use moca_sim::VirtualBoardConfig;
use moca_tactile::Firmware;

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
    let config = unattended(Law::Impedance);
    let board = VirtualBoardConfig { firmware, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
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

#[test]
fn other_senses_show_a_touch_no_sooner_than_the_cover() {
    for board in BOARDS {
        for force_n in FORCES_N {
            let Shown { felt_after_s, servo_m_s, wrench_n } = pressed(board, force_n).unwrap();
            let felt_after_s = felt_after_s.unwrap();
            assert!(
                felt_after_s < if force_n > 5.0 { 0.04 } else { 0.11 },
                "{board:?}, {force_n} N: {felt_after_s} s"
            );
            // 10 µm/s for each newton: the odometry of a base has a noise of 1 mm/s and more
            assert!(
                servo_m_s > 0.0 && servo_m_s < 1.01e-5 * force_n,
                "{board:?}, {force_n} N: {servo_m_s} m/s"
            );
            assert!(wrench_n < 1e-3, "{board:?}, {force_n} N: {wrench_n} N");
        }
    }
}

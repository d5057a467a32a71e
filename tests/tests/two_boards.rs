//! Two Touch Boards under one cover, from their bytes to the base's motion: each with its clock, its port and its faults.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]

use moca_control::config::{Config, HandConfig};
use moca_daemon::runtime::allocations::{self, CountingAllocator};
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::virtual_boards::board_config;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::{BoardFault, Fault, Mode, Refusal, Request, Sample, TaxelStatus};
use moca_sim::BoardFailure;
use moca_tactile::Firmware;
use moca_telemetry::log::read_log;
use moca_tests::Limited;
use std::path::{Path, PathBuf};
use std::process::Command;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

type World = LockStep<ByteCover, MemoryBoards>;

const TARED_TICKS: u64 = 1500;
/// T7 is the first taxel of the second board.
const OF_FIRST: usize = 6;

fn two_boards() -> Config {
    let mut config = Config::parse(
        "[board]\nport = [\"virtual\", \"virtual\"]\n[robot.cover]\nboard = [1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2]\n",
    )
    .unwrap();
    config.simulation.hand = HandConfig::none();
    config
}

fn world(config: &Config) -> World {
    LockStep::with_board(config, &free_scene(config), board_config(config), None).unwrap()
}

fn run(world: &mut World, ticks: u64) -> Sample {
    (0..ticks).map(|_| world.step(None).0).last().expect("at least one tick")
}

/// Statuses of the first board's taxels, and of the second's: what all of them have.
fn statuses(sample: &Sample) -> [Option<TaxelStatus>; 2] {
    let (first, second) = sample.taxels.split_at(OF_FIRST);
    [first, second].map(|taxels| {
        let status = taxels[0].status;
        taxels.iter().all(|taxel| taxel.status == status).then_some(status)
    })
}

#[test]
fn press_on_either_board_moves_base() {
    for firmware in [Firmware::Moca, Firmware::Stock2018] {
        let mut config = two_boards();
        config.board.firmware = firmware;
        let mut world = world(&config);
        assert_eq!(run(&mut world, TARED_TICKS).mode, Mode::Impedance, "{firmware:?}");
        for taxel in [8_u8, 1] {
            let press = |force_n| Some(Request::PressTaxel { taxel, force_n });
            assert_eq!(world.step(press(20.0)).1, Some(Ok(())));
            let inward_rad = config.robot.cover.placements()[usize::from(taxel)].inward_angle_base_rad;
            let pressed = run(&mut world, 300);
            let [vx, vy, _] = pressed.base_velocity_world;
            let along_m_s = vx * inward_rad.cos() + vy * inward_rad.sin();
            assert!(along_m_s > 0.01, "{firmware:?} T{}: {along_m_s} m/s", taxel + 1);
            let felt: Vec<usize> = (0..11).filter(|i| pressed.taxels[*i].force_n > 5.0).collect();
            assert_eq!(felt, [usize::from(taxel)], "{firmware:?}");
            world.step(press(0.0));
            run(&mut world, 1500);
        }

        world.feed[1].board().set_fault(Some(BoardFailure::Silent));
        let stopped = run(&mut world, 300);
        let silent = BoardFault::Silent.of(1);
        assert_eq!((stopped.mode, stopped.fault), (Mode::ProtectiveStop, Some(silent)), "{firmware:?}");
        assert_eq!(statuses(&stopped), [Some(TaxelStatus::Ok), Some(TaxelStatus::Stale)], "{firmware:?}");
        assert_eq!(world.step(Some(Request::Resume)).1, Some(Err(Refusal::CauseRemains(silent))));

        world.feed[1].board().set_fault(None);
        let well = run(&mut world, 300);
        assert_eq!(well.fault, Some(silent), "until somebody resumes");
        assert_eq!(world.step(Some(Request::Resume)).1, Some(Ok(())));
        assert_eq!(run(&mut world, 10).fault, None);
    }
}

#[test]
fn unplugging_one_board_voids_the_zero_of_its_taxels_alone() {
    let mut world = world(&two_boards());
    run(&mut world, TARED_TICKS);
    world.feed[0].unplug();
    let lost = run(&mut world, 50);
    assert_eq!(lost.fault, Some(BoardFault::Lost.of(0)));
    world.feed[0].replug();
    let back = run(&mut world, 300);
    assert_eq!(statuses(&back), [Some(TaxelStatus::NoZero), Some(TaxelStatus::Ok)]);
    assert_eq!(world.step(Some(Request::Tare)).1, Some(Ok(())));
    run(&mut world, 1500);
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Ok(())));
}

/// The second board's clock wraps after 5 s, the first one's does not.
#[test]
fn board_clocks_are_mapped_separately() {
    let mut world = world(&two_boards());
    run(&mut world, TARED_TICKS);
    let mut oldest_s = 0.0_f64;
    let before = allocations::on_this_thread();
    for _ in TARED_TICKS..7000 {
        oldest_s = oldest_s.max(world.step(None).0.frame_age_s);
    }
    assert_eq!(allocations::on_this_thread() - before, 0);
    let hold_s = 1e-9 * f64::from(u32::try_from(Firmware::Moca.worst_hold_ns()).unwrap());
    assert!(oldest_s < hold_s + 0.002, "{oldest_s} s old; one board holds {hold_s} s");
}

/// Exit code of a run that ends in a fault.
const ENDS_IN_A_FAULT: i32 = 6;

/// Runs and records; the run ends with exit code `code`.
fn mocad(name: &str, arguments: &[&str], code: i32) -> (PathBuf, String) {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let (config, log) = (folder.join("two_boards.toml"), folder.join(name));
    let _ = std::fs::remove_file(&log);
    let mut table = two_boards();
    table.telemetry.listen.clear();
    table.flight_recorder.folder.clear();
    std::fs::write(&config, toml::to_string(&table.to_toml()).unwrap()).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"))
        .arg("--config")
        .arg(&config)
        .arg("--record")
        .arg(&log)
        .args(arguments)
        .run()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(code), "{text}{}", String::from_utf8_lossy(&output.stderr));
    (log, text)
}

fn replayed(log: &Path) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_mocad-under-test")).arg("replay").arg(log).run().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn lock_step_with_two_boards_replays_bit_equal() {
    let arguments = ["--as-fast-as-possible", "--duration", "4", "--inject", "silent@3"];
    let (log, text) = mocad("two_boards.mcap", &arguments, ENDS_IN_A_FAULT);
    assert!(text.contains("Board 1 (virtual) with T1 T2 T3 T4 T5 T6."), "{text}");
    let report = replayed(&log);
    assert!(report.starts_with("4000 ticks compared"), "{report}");
    let log = read_log(&log).unwrap();
    let bytes =
        |board| log.serial.iter().filter(|read| read.board == board).map(|read| read.bytes.len()).sum();
    let (first, second): (usize, usize) = (bytes(0), bytes(1));
    assert!(first > 30_000 && second > first * 5 / 4, "the first was silent for a second: {first} {second}");
    assert!(log.samples.iter().any(|sample| sample.fault.and_then(Fault::board) == Some(0)));
}

#[test]
fn two_virtual_boards_live_feed_one_loop_and_the_log_replays() {
    let (log, text) = mocad("two_boards_live.mcap", &["--duration", "3"], 0);
    let line = text.lines().find(|line| line.starts_with("  board")).expect("a line about the boards");
    assert_eq!(line.matches("moca-touch-board-").count(), 2, "{line}");
    let report = replayed(&log);
    assert!(report.contains("every bit the same"), "{report}");
    let log = read_log(&log).unwrap();
    assert!([0, 1].iter().all(|board| log.serial.iter().any(|read| read.board == *board)));
}

#[test]
fn indistinct_or_unused_boards_are_mistakes() {
    let wired = "robot.cover.board = [1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2]\n";
    let real = "plant.kind = \"none\"\n";
    for (ports, rest, words) in [
        (r#"["auto", "name:right"]"#, wired, "\"auto\" does not tell two boards apart"),
        (r#"["name:left", "name:left"]"#, wired, "\"name:left\" does not tell two boards apart"),
        (r#"["virtual", "name:left"]"#, wired, "either both are \"virtual\" or none is simulated"),
        (r#"["name:left", "name:right"]"#, real, "no taxel is on board 2, \"name:right\" in board.port"),
        (r#""name:left""#, wired, "robot.cover.board = 2 of T7: board.port names 1 board(s)"),
        (r#"["a", "b", "c"]"#, real, "expected a text in quotes, or a list of 1 to 2 texts"),
        ("[]", real, "expected a text in quotes, or a list of 1 to 2 texts"),
    ] {
        let mistakes = Config::parse(&format!("board.port = {ports}\n{rest}")).expect_err(words).to_string();
        assert!(mistakes.contains(words), "{ports}: {mistakes}");
    }
    let one_electrode = format!(
        "{wired}board.port = [\"virtual\", \"virtual\"]\nrobot.cover.electrode = [0, 1, 2, 3, 4, 5, 0, 1, 1, 3, 4]"
    );
    let mistakes = Config::parse(&one_electrode).expect_err("T8 and T9").to_string();
    assert!(mistakes.contains("robot.cover.electrode: 1 of T9 is another taxel's too"), "{mistakes}");
}

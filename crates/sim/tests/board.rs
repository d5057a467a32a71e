//! The virtual board's bytes, checked with the real parser, against what the firmware was seen to do.
#![allow(
    clippy::unwrap_used,
    clippy::disallowed_types,
    missing_docs,
    reason = "tests fail by panicking and check bytes by parsing them"
)]

use moca_sim::foam::Foam;
use moca_sim::{BoardFailure, PtyBoard, SharedForces, VirtualBoard, VirtualBoardConfig};
use moca_tactile::{
    Firmware,
    datastream::{Event, Parser, StampedFrame},
};
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

const MS: u64 = 1_000_000;

struct Run {
    frames: Vec<StampedFrame>,
    bad: usize,
    bytes: Vec<u8>,
}

/// Ticks of 1 ms; `force_n(ms)` on T3.
fn run(board: &mut VirtualBoard, from_ms: u64, to_ms: u64, force_n: impl Fn(u64) -> f64) -> Run {
    let mut parser = Parser::default();
    let mut result = Run { frames: Vec::new(), bad: 0, bytes: Vec::new() };
    for ms in from_ms..to_ms {
        let mut force = [0.0; 11];
        force[2] = force_n(ms);
        let mut lines = Vec::new();
        board.advance(ms * MS, &force, &mut |bytes: &[u8]| lines.extend_from_slice(bytes));
        let mut rest = &lines[..];
        while let Some(event) = parser.next_event(&mut rest, ms * MS) {
            match event {
                Event::Frame(frame) => result.frames.push(frame),
                _ => result.bad += 1,
            }
        }
        result.bytes.extend_from_slice(&lines);
    }
    result
}

fn board(config: VirtualBoardConfig) -> VirtualBoard {
    VirtualBoard::new(config).unwrap()
}

#[test]
fn frames_are_good_and_come_at_the_sketch_s_rate() {
    for (sketch, frames) in [(Firmware::Stock2018, 404), (Firmware::Stock2015, 675)] {
        let mut board = board(VirtualBoardConfig { firmware: sketch, ..VirtualBoardConfig::default() });
        let run = run(&mut board, 0, 10_000, |_| 0.0);
        assert_eq!(run.bad, 0);
        assert!(run.frames.len().abs_diff(frames) <= 1, "{sketch:?}: {} frames in 10 s", run.frames.len());
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let bytes = |seed| {
        let mut board = board(VirtualBoardConfig { seed, ..VirtualBoardConfig::default() });
        run(&mut board, 0, 2000, |ms| if ms > 500 { 20.0 } else { 0.0 }).bytes
    };
    assert_eq!(bytes(3), bytes(3));
    assert_ne!(bytes(3), bytes(4));
}

#[test]
fn press_lowers_only_its_electrode_by_foam_counts() {
    let config = VirtualBoardConfig { noise_counts: Some(0.0), ..VirtualBoardConfig::default() };
    let run = run(&mut board(config), 0, 1500, |ms| if ms >= 500 { 50.0 } else { 0.0 });
    let idle = run.frames[0].frame;
    let last = run.frames.last().unwrap().frame;
    assert_eq!(idle.filtered[..12], [720; 12]);
    // 50 N: 27.8 counts once the foam has crept for some seconds, fewer at first.
    let fell = idle.filtered[2] - last.filtered[2];
    assert!((23..=28).contains(&fell), "{fell}");
    assert!((0..12).filter(|e| *e != 2).all(|e| last.filtered[e] == 720));
}

#[test]
fn a_press_is_seen_as_late_as_the_firmware_makes_it() {
    // Over all phases between press and frame: at least the print time, at most print time + frame + chip refresh.
    let mut delays = Vec::new();
    for phase_ms in 0..25 {
        let config = VirtualBoardConfig { noise_counts: Some(0.0), ..VirtualBoardConfig::default() };
        let pressed_ms = 500 + phase_ms;
        let run = run(&mut board(config), 0, 1000, |ms| if ms >= pressed_ms { 50.0 } else { 0.0 });
        let seen = run.frames.iter().find(|f| f.frame.filtered[2] < 710).unwrap();
        delays.push(seen.complete_ns / MS - pressed_ms);
    }
    let (least, most) = (*delays.iter().min().unwrap(), *delays.iter().max().unwrap());
    assert!(least >= 20 && most <= 20 + 25 + 20, "{least} to {most} ms");
    assert!(most - least > 15, "{least} to {most} ms");
}

#[test]
fn faults_look_as_the_firmware_s() {
    let mut lost = board(VirtualBoardConfig::default());
    run(&mut lost, 0, 1000, |_| 0.0);
    lost.set_fault(Some(BoardFailure::I2cLost));
    let frames = run(&mut lost, 1000, 3000, |_| 80.0).frames;
    let after = &frames[2..];
    assert!(after.len() > 100, "faster than before: {}", after.len());
    assert!(after.iter().all(|f| f.frame.filtered == after[0].frame.filtered));
    assert_ne!(after[0].frame.touch_threshold[3], 40);

    let mut reset = board(VirtualBoardConfig::default());
    reset.set_fault(Some(BoardFailure::ChipReset));
    let last = run(&mut reset, 0, 500, |_| 0.0).frames.pop().unwrap().frame;
    assert_eq!((last.filtered, last.baseline), ([0; 13], [0; 13]));

    let mut silent = board(VirtualBoardConfig::default());
    silent.set_fault(Some(BoardFailure::Silent));
    assert!(run(&mut silent, 0, 500, |_| 0.0).bytes.is_empty());
}

#[test]
fn nan_and_wild_forces_leave_the_board_printing() {
    for force_n in [f64::NAN, f64::INFINITY, -50.0, 1e9] {
        let run = run(
            &mut board(VirtualBoardConfig { foam: Foam::PU_LD30, ..VirtualBoardConfig::default() }),
            0,
            500,
            |_| force_n,
        );
        assert_eq!(run.bad, 0);
        assert!(run.frames.len() > 15);
    }
    let noisy = VirtualBoardConfig { noise_counts: Some(f64::NAN), ..VirtualBoardConfig::default() };
    assert!(VirtualBoard::new(noisy).is_err());
}

fn open_port(path: &std::path::Path) -> std::io::Result<std::fs::File> {
    std::fs::OpenOptions::new().read(true).write(true).custom_flags(0o4000 | 0o400).open(path)
}

/// Reads until `enough(bytes)` or the port hangs up (`true`); the deadline only keeps a broken test from hanging.
fn read_until(port: &mut std::fs::File, bytes: &mut Vec<u8>, enough: impl Fn(&[u8]) -> bool) -> bool {
    let deadline = Instant::now() + Duration::from_secs(60);
    let mut chunk = [0; 512];
    while !enough(bytes) {
        assert!(Instant::now() < deadline, "nothing more arrives: {} bytes so far", bytes.len());
        match port.read(&mut chunk) {
            Ok(0) => return true,
            Ok(n) => bytes.extend_from_slice(&chunk[..n]),
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                std::thread::sleep(Duration::from_millis(2));
            }
            Err(_) => return true,
        }
    }
    false
}

#[test]
fn pseudo_terminal_survives_replugging() {
    let forces: SharedForces = Arc::new(std::array::from_fn(|_| AtomicU64::new(0)));
    let path = std::env::temp_dir().join(format!("moca-board-test-{}", std::process::id()));
    let board = PtyBoard::spawn(VirtualBoardConfig::default(), Arc::clone(&forces), &path).unwrap();
    let three_frames = |bytes: &[u8]| bytes.windows(5).filter(|w| *w == b"DIFF:").count() >= 3;

    let mut port = open_port(board.path()).unwrap();
    let mut bytes = Vec::new();
    assert!(!read_until(&mut port, &mut bytes, three_frames));
    let mut good = 0;
    let mut parser = Parser::default();
    let mut rest = &bytes[..];
    while let Some(event) = parser.next_event(&mut rest, 0) {
        good += usize::from(matches!(event, Event::Frame(_)));
    }
    assert!(good >= 2, "{good} good frames");

    forces[0].store(80.0f64.to_bits(), Ordering::Relaxed);
    bytes.clear();
    assert!(!read_until(&mut port, &mut bytes, |b| String::from_utf8_lossy(b).contains("FDAT: 6")));

    board.unplug();
    assert!(read_until(&mut port, &mut Vec::new(), |_| false), "the port hangs up");
    drop(port);
    assert!(open_port(&path).is_err(), "the link is gone");

    board.replug();
    let deadline = Instant::now() + Duration::from_secs(60);
    let mut port = loop {
        assert!(Instant::now() < deadline, "the port does not come back");
        match open_port(&path) {
            Ok(port) => break port,
            Err(_) => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    assert!(!read_until(&mut port, &mut Vec::new(), three_frames));
    drop(board);
    assert!(std::fs::symlink_metadata(&path).is_err(), "the link is removed at the end");
}

#[test]
fn a_port_path_that_is_a_file_is_refused_and_kept() {
    let path = std::env::temp_dir().join(format!("moca-board-file-{}", std::process::id()));
    std::fs::write(&path, "mine").unwrap();
    let forces: SharedForces = Arc::new(std::array::from_fn(|_| AtomicU64::new(0)));
    let error = PtyBoard::spawn(VirtualBoardConfig::default(), forces, &path).unwrap_err();
    assert!(error.to_string().contains("moca-board-file"), "{error}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
    std::fs::remove_file(&path).unwrap();
}

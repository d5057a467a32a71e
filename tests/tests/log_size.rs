//! Size of a log of the run that starts without arguments; with the noise of a real robot too.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_control::robot::JOINTS;
use moca_daemon::record::tick_blocks::{decode, encode};
use moca_msgs::RobotState;
use moca_telemetry::log::{LogFile, LogReader, LogWriter, Meta, Record};
use moca_tests::Limited;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::process::Command;

/// Largest size of the part for viewers, GB for each hour.
const DISPLAY_GB_H: f64 = 0.1;
/// Largest size of a log that also holds the boards' bytes and every bit of each tick's inputs, GB for each hour.
const ALL_GB_H: f64 = 0.42;
/// Noise of a measured joint angle, rad, and of what else is measured, in its unit.
const NOISE: (f64, f64) = (1e-5, 1e-3);

fn path(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_file(&path);
    path
}

fn record(name: &str, duration_s: &str, options: &[&str]) -> PathBuf {
    let path = path(name);
    let config = path.with_extension("toml");
    std::fs::write(&config, "[telemetry]\nlisten = \"\"\n").unwrap();
    let mut mocad = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    mocad.arg("--config").arg(&config).args(options).args(["--duration", duration_s, "--record"]).arg(&path);
    let ran = mocad.run().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    std::fs::remove_file(config).unwrap();
    path
}

#[test]
fn a_log_costs_no_more_than_it_may() {
    let path = record("log-size.mcap", "60", &["--as-fast-as-possible"]);
    let sizes = LogFile::open(&path).unwrap().account(&mut |_| {}).unwrap().sizes;
    let display = sizes.gigabytes_per_hour(sizes.display);
    let all = sizes.gigabytes_per_hour(sizes.file);
    assert!(sizes.span_ns > 59_900_000_000, "{sizes:?}");
    assert!(display < DISPLAY_GB_H, "{display} GB an hour for viewers, allowed are {DISPLAY_GB_H}");
    assert!(all < ALL_GB_H, "{all} GB an hour in all, allowed are {ALL_GB_H}");
    // And `mocad log` says the same.
    let told = Command::new(env!("CARGO_BIN_EXE_mocad-under-test")).arg("log").arg(&path).run().unwrap();
    let told = String::from_utf8(told.stdout).unwrap();
    assert!(told.contains(&format!("{all:.3} GB an hour:")), "{told}");
    std::fs::remove_file(path).unwrap();
}

/// Pseudorandom numbers between -1 and 1.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f64::from(u32::try_from(self.0 >> 32).unwrap()) / f64::from(u32::MAX) * 2.0 - 1.0
    }

    fn on(&mut self, state: &RobotState<JOINTS>) -> RobotState<JOINTS> {
        let mut noisy = *state;
        noisy.q_rad.iter_mut().for_each(|q| *q += NOISE.0 * self.next());
        let torques = noisy.torque_measured_nm.iter_mut();
        let others = noisy.base_pose_world.iter_mut().chain(&mut noisy.base_velocity_world);
        others.chain(&mut noisy.dq_rad_s).chain(torques).for_each(|value| *value += NOISE.1 * self.next());
        noisy.in_single_precision()
    }
}

/// The loop takes a robot's state in single precision (`control::tick`), so that noise costs half of what it would.
#[test]
fn a_log_of_a_robot_with_noise_costs_no_more_than_it_may() {
    let clean = record("log-size-clean.mcap", "20", &["--as-fast-as-possible"]);
    let noisy = path("log-size-noisy.mcap");
    let description = LogFile::open(&clean).unwrap().description().clone();
    let meta = Meta { description, start_unix_ns: 0 };
    let mut log = LogWriter::new(BufWriter::new(File::create_new(&noisy).unwrap()), &meta).unwrap();
    let mut noise = Noise(1);
    let mut last_ns = 0;
    for record in LogReader::open(&clean).unwrap() {
        match record {
            Record::Sample(sample) => {
                last_ns = sample.time_ns;
                log.sample(&sample).unwrap();
            }
            Record::Serial(serial) => log.serial(&serial).unwrap(),
            Record::Replay(block) => {
                let mut ticks = decode(&block).unwrap();
                for tick in &mut ticks {
                    let state = &mut tick.record.input.state;
                    *state = state.map(|state| noise.on(&state));
                }
                log.replay(last_ns, &encode(&ticks, 1e-3)).unwrap();
            }
            _ => {}
        }
    }
    log.finish().unwrap();
    let sizes = LogFile::open(&noisy).unwrap().account(&mut |_| {}).unwrap().sizes;
    let all = sizes.gigabytes_per_hour(sizes.file);
    assert!(all < ALL_GB_H, "{all} GB an hour in all, allowed are {ALL_GB_H}: {sizes:?}");
    std::fs::remove_file(clean).unwrap();
    std::fs::remove_file(noisy).unwrap();
}

/// In real time a simulated robot tells no more of its state than a real one's sensors would; in lock-step it tells every bit.
#[test]
fn a_live_simulation_is_measured_like_a_robot() {
    for (name, options, measured) in
        [("log-size-live.mcap", &[][..], true), ("log-size-exact.mcap", &["--as-fast-as-possible"], false)]
    {
        let path = record(name, "3", options);
        let mut states = Vec::new();
        for record in LogReader::open(&path).unwrap() {
            if let Record::Replay(block) = record {
                states.extend(
                    decode(&block).unwrap().into_iter().filter_map(|tick| tick.record.input.state.ok()),
                );
            }
        }
        assert!(states.len() > 1000, "{} states in {name}", states.len());
        let coarse = states.iter().filter(|state| **state == state.in_single_precision()).count();
        assert!(
            if measured { coarse == states.len() } else { coarse < states.len() / 2 },
            "{name}: {coarse} of {}",
            states.len()
        );
        std::fs::remove_file(path).unwrap();
    }
}

//! A long log, written and opened: `cargo bench -p moca-telemetry --features log --bench long_log -- [HOURS [FILE]]`
//! (default 8; FILE is an absolute path, and is kept). Prints the file's size, how long opening and a look into its middle take, and the memory
//! of both.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use moca_msgs::{Mode, Sample, TaxelReading, TaxelStatus};
use moca_telemetry::{
    RobotDescription,
    log::{LogFile, LogWriter, Meta},
};
use std::{fs::File, io::BufWriter, path::Path, time::Instant};

/// A sample for each record that a viewer is shown: those between cost a writer time and a file nothing.
const PERIOD_NS: u64 = 20_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let hours: u64 = arguments.next().map_or(Ok(8), |hours| hours.parse())?;
    let kept = arguments.next();
    let name = format!("moca-long-log-{}.mcap", std::process::id());
    let path = kept.as_ref().map_or_else(|| std::env::temp_dir().join(name), Into::into);
    let result = write(&path, hours).and_then(|()| open(&path));
    if kept.is_none() {
        std::fs::remove_file(&path)?;
    }
    result
}

fn write(path: &Path, hours: u64) -> Result<(), Box<dyn std::error::Error>> {
    let meta = Meta { description: RobotDescription::paper("long", true), start_unix_ns: 1 };
    let mut log = LogWriter::new(BufWriter::new(File::create_new(path)?), &meta)?;
    for shown in 0..hours * 180_000 {
        log.sample(&sample(shown))?;
    }
    log.finish()?;
    println!("{hours} h at 50 Hz: {:.1} MB, display topics only", 1e-6 * bytes(path)?);
    Ok(())
}

fn open(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let before_kb = resident_kb();
    let start = Instant::now();
    let mut log = LogFile::open(path)?;
    let opened = start.elapsed();
    let overview = log.overview().ok_or("no overview")?;
    println!(
        "opened in {:.3} s: {} spans of {:.0} s, {} marks",
        opened.as_secs_f64(),
        overview.spans.len(),
        1e-9 * float(overview.span_ns),
        overview.marks.len()
    );
    let (_, end_ns) = log.range_ns();
    let start = Instant::now();
    let minute = log.samples(end_ns / 2, end_ns / 2 + 60_000_000_000)?;
    println!("a minute in its middle: {} samples in {:.3} s", minute.len(), start.elapsed().as_secs_f64());
    println!("memory of both: {:.1} MB", 1e-3 * float(resident_kb().saturating_sub(before_kb)));
    Ok(())
}

/// A robot that is leaned on every minute.
fn sample(shown: u64) -> Sample {
    let t = 0.02 * float(shown);
    let leaned = shown % 3000 < 100;
    let mut sample =
        Sample { tick: 20 * shown, time_ns: shown * PERIOD_NS, mode: Mode::Impedance, ..Sample::default() };
    sample.base_pose_world = [t.sin(), (0.3 * t).cos(), 0.1 * t.sin()];
    sample.base_velocity_world = [t.cos(), -0.3 * (0.3 * t).sin(), 0.1 * t.cos()];
    sample.q_rad.extend([0.1 * t.sin(), 0.2, -0.3, -1.5, 0.1 * t.cos(), 1.2, 0.8]);
    sample.dq_rad_s.extend([0.1 * t.cos(), 0.0, 0.0, 0.0, -0.1 * t.sin(), 0.0, 0.0]);
    sample.arm_torque_nm.extend([t.sin(), -20.0 + t.cos(), 0.3, 15.0, 0.2, 2.0, 0.0]);
    let force_n = if leaned { 20.0 + t.sin() } else { 0.0 };
    sample.taxels.extend([TaxelReading { force_n, status: TaxelStatus::Ok }; 11]);
    sample.counts.extend([720; 11]);
    sample.frame_age_s = 0.02 + 0.005 * (7.0 * t).sin();
    sample.lateness_s = 2e-5 * (1.0 + (11.0 * t).sin());
    sample
}

fn bytes(path: &Path) -> std::io::Result<f64> {
    Ok(float(path.metadata()?.len()))
}

#[expect(clippy::cast_precision_loss, reason = "for a human's eye")]
fn float(count: u64) -> f64 {
    count as f64
}

/// Resident memory of this process, kB (Linux).
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    line.and_then(|l| l.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

//! Writes a log of made-up samples, for trying readers: `cargo run --example write_log --features
//! moca-telemetry/log -- FILE [SAMPLES]` (default 3000). `tests/foreign_mcap.py` reads it with another library.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use moca_msgs::{Fault, Mode, Sample, TaxelReading, TaxelStatus};
use moca_telemetry::{
    RobotDescription,
    log::{LogWriter, Meta, SerialBytes},
};
use std::{fs::File, io::BufWriter};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: write_log FILE [SAMPLES]")?;
    let count: u32 = arguments.next().map_or(Ok(3000), |s| s.parse())?;
    let meta = Meta { description: RobotDescription::paper("example", true), start_unix_ns: 1 };
    let mut log = LogWriter::new(BufWriter::new(File::create_new(path)?), &meta)?;
    for i in 0..count {
        let t = f64::from(i) * 1e-3;
        let stopped = i >= count / 2;
        let mut sample = Sample {
            tick: u64::from(i),
            time_ns: u64::from(i) * 1_000_000,
            mode: if stopped { Mode::ProtectiveStop } else { Mode::Impedance },
            fault: stopped.then_some(Fault::TaxelInvalid { taxel: 2, status: TaxelStatus::Stuck }),
            base_pose_world: [t.sin(), t.cos(), 0.1 * t],
            ..Sample::default()
        };
        sample.q_rad.extend([t; 7]);
        sample.arm_torque_nm.extend([-t; 7]);
        let force_n = if i == count / 3 { 57.5 } else { 0.0 };
        sample.taxels.extend([TaxelReading { force_n, status: TaxelStatus::Ok }; 11]);
        sample.counts.extend([720; 11]);
        log.sample(&sample)?;
        if i % 25 == 0 {
            log.serial(&SerialBytes {
                board: 0,
                arrival_ns: sample.time_ns,
                bytes: b"TOUCH: 0 0\r\n".to_vec(),
            })?;
        }
    }
    let summary = log.finish()?;
    println!("{} samples, {} serial bytes", summary.samples, summary.serial_bytes);
    Ok(())
}

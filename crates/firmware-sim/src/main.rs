//! `firmware-sim`: the board's firmware without a board.

use anyhow::{Context, Result, ensure};
use clap::{Parser, Subcommand};
use moca_firmware_sim::measure::{Measured, Report, measure};
use moca_firmware_sim::mpr121::Signal;
use moca_firmware_sim::terminal::Until;
use moca_firmware_sim::{Board, Hex, Settings, faults, pipe, terminal};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Parser)]
#[command(about = "The Touch Board's firmware, instruction by instruction, with its chips and its USB host.")]
struct Arguments {
    /// The program to run.
    #[arg(long, global = true, default_value = "firmware/moca_touch/moca_touch.hex")]
    hex: PathBuf,
    /// Chips on the bus: 5C is the board's own.
    #[arg(long, global = true, value_delimiter = ',', default_value = "5C")]
    chips: Vec<String>,
    /// Duration of one millisecond of the chips' oscillators, ms.
    #[arg(long, global = true, default_value_t = 1.013)]
    chip_clock: f64,
    /// Time between two polls of the host, us.
    #[arg(long, global = true, default_value_t = 1000)]
    poll_us: u64,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Rate, age and hold: exact, and as the reader takes them.
    Latency {
        /// Prints JSON for `moca-lab latency --avr`: of one to four chips, whatever --chips says.
        #[arg(long)]
        json: bool,
        /// Seconds to simulate.
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
    },
    /// Does every fault of the list and says what the reader saw.
    Faults {
        /// Seconds of the long run at the end.
        #[arg(long, default_value_t = 300.0)]
        soak: f64,
    },
    /// Writes the bytes that a host reads, and when: `seconds bytes` a line.
    Record {
        /// Seconds to record.
        #[arg(long, default_value_t = 4.0)]
        seconds: f64,
        /// File for the bytes; their times go into a file beside it that ends in `.times`.
        out: PathBuf,
    },
    /// Sends a command and prints what the board answers.
    Ask {
        /// Such as ID? or SET?
        command: String,
    },
    /// Serves a program over stdin and stdout, in lock-step.
    Pipe,
    /// Makes a pseudo-terminal that a program opens like a board.
    Terminal {
        /// Path of the link.
        path: PathBuf,
        /// Seconds to run.
        #[arg(long, default_value_t = 60.0)]
        seconds: f64,
        /// Runs until stdin ends instead, and takes from it what the electrodes see: `mocad --board avr`.
        #[arg(long)]
        stdin: bool,
    },
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("firmware-sim: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<bool> {
    let hex = Hex::read(&arguments.hex)?;
    let chips = arguments.chips.iter().map(|text| {
        u8::from_str_radix(text, 16).with_context(|| format!("--chips: {text} is no hexadecimal address"))
    });
    let settings = Settings {
        chips: chips.collect::<Result<_>>()?,
        chip_clock: arguments.chip_clock,
        poll_us: arguments.poll_us,
        ..Settings::default()
    };
    match &arguments.command {
        Command::Latency { json, seconds } => latency(&hex, &settings, *json, *seconds).map(|()| true),
        Command::Faults { soak } => faults::run(&hex, *soak, &mut |outcome| match &outcome.failure {
            None => println!("ok      {}: {}", outcome.name, outcome.seen),
            Some(why) => println!("FAILED  {}: {why}; {}", outcome.name, outcome.seen),
        }),
        Command::Record { seconds, out } => record(&hex, &settings, *seconds, out).map(|()| true),
        Command::Ask { command } => ask(&hex, &settings, command).map(|()| true),
        Command::Pipe => {
            let mut board = Board::new(&hex, &settings)?;
            pipe::serve(&mut board, &mut std::io::stdin().lock(), &mut std::io::stdout().lock())?;
            Ok(true)
        }
        Command::Terminal { path, seconds, stdin } => {
            let mut board = Board::new(&hex, &settings)?;
            println!("board at {}", path.display());
            let until = if *stdin { Until::StdinEnds } else { Until::Seconds(*seconds) };
            let behind = terminal::run(&mut board, path, until)?;
            println!("behind real time at worst: {:.1} ms", behind.as_secs_f64() * 1e3);
            Ok(true)
        }
    }
}

/// The board alone, and with one to three breakouts of the chip on its bus.
const CHIPS: [(&str, &[u8]); 4] = [
    ("moca firmware", &[0x5C]),
    ("moca firmware, 2 chips", &[0x5C, 0x5D]),
    ("moca firmware, 3 chips", &[0x5B, 0x5C, 0x5D]),
    ("moca firmware, 4 chips", &[0x5A, 0x5B, 0x5C, 0x5D]),
];

fn latency(hex: &Hex, settings: &Settings, json: bool, seconds: f64) -> Result<()> {
    if json {
        let mut reports = Vec::new();
        for (name, chips) in CHIPS {
            let settings = Settings { chips: chips.to_vec(), ..settings.clone() };
            let measured = measure(hex, name, &settings, b"", seconds)?;
            reports.extend([measured.exact, measured.read]);
        }
        println!("{}", serde_json::to_string_pretty(&reports)?);
        return Ok(());
    }
    let measured = measure(hex, "moca firmware", settings, b"", seconds)?;
    let reports: Vec<&Report> = vec![&measured.exact, &measured.read];
    let Measured { frames, lost, bad, least_transport_us, too_young_ms, filters, .. } = &measured;
    for report in reports {
        println!(
            "{:<26} {:>6.1} refreshes/s a chip, age {:>4.1} ms (worst {:>4.1}), held to {:>4.1} ms",
            report.board, report.rate_hz, report.age_mean_ms, report.age_worst_ms, report.hold_worst_ms
        );
    }
    println!(
        "frames {frames}, lost {lost}, bad {bad}; least time from stamp to arrival {least_transport_us} us"
    );
    println!("reader's sample time minus the chip's, at most {too_young_ms:.3} ms");
    println!("first filter {}, second filter {}, scan {:.0} us", filters.0, filters.1, filters.2);
    Ok(())
}

fn record(hex: &Hex, settings: &Settings, seconds: f64, out: &PathBuf) -> Result<()> {
    let settings = Settings { signal: Signal::Counts { noise: 0.7 }, ..settings.clone() };
    let mut board = Board::new(hex, &settings)?;
    board.plug_in()?;
    let start_us = board.now_us();
    let (mut bytes, mut times) = (Vec::new(), String::new());
    let end_us = start_us + (seconds * 1e6) as u64;
    while board.now_us() < end_us {
        // From the second second on E5 is pressed twice a second: 5 pF of plate, 3 more when deepest.
        let t = (board.now_us() - start_us) as f64 * 1e-6;
        let press = if t > 2.0 { 3.0 * (std::f64::consts::TAU * t).sin().max(0.0) } else { 0.0 };
        board.set_capacitance_pf(0x5C, 5, settings.capacitance_pf + press);
        let next_us = board.now_us() + 1000;
        board.step_until(next_us, &mut |arrival_us, packet| {
            bytes.extend_from_slice(packet);
            times.push_str(&format!("{:.6} {}\n", (arrival_us - start_us) as f64 * 1e-6, packet.len()));
        })?;
    }
    std::fs::write(out, bytes).with_context(|| format!("write {}", out.display()))?;
    std::fs::write(out.with_extension("times"), times)?;
    Ok(())
}

fn ask(hex: &Hex, settings: &Settings, command: &str) -> Result<()> {
    let mut board = Board::new(hex, settings)?;
    let identity = board.plug_in()?;
    board.send(command.as_bytes());
    board.send(b"\n");
    let mut text = Vec::new();
    let until_us = board.now_us() + 100_000;
    board.step_until(until_us, &mut |_, bytes| text.extend_from_slice(bytes))?;
    println!("USB {:04x}:{:04x}, {} interfaces", identity.vendor, identity.product, identity.interfaces);
    let text = String::from_utf8_lossy(&text).into_owned();
    let answers: Vec<&str> = text.lines().filter(|line| line.starts_with('#')).collect();
    ensure!(!answers.is_empty(), "no answer to {command}");
    answers.iter().for_each(|answer| println!("{answer}"));
    Ok(())
}

//! `mocad calibrate`: presses every taxel beside a reference force and writes a calibration file.
//!
//! Live: a board's port and a force gauge that prints one number a line. From files: a recorded stream with its
//! times, and a table of times and forces. Both go through the same guided session.
#![expect(clippy::print_stdout, reason = "a terminal front end")]

use crate::config::AUTO_PORT;
use crate::devices::force_gauge::Gauge;
use crate::devices::ports;
use anyhow::{Context, anyhow, bail, ensure};
use moca_tactile::calibration::file::TaxelEntry;
use moca_tactile::calibration::quality::evaluation_cost_ns;
use moca_tactile::calibration::session::{Measured, Session, Step, Target};
use moca_tactile::calibration::{CalibrationFile, ModelKind, Quality, chart, fit};
use moca_tactile::Firmware;
use moca_tactile::zero::TARE_FRAMES;
use moca_tactile::{BoardEvent, TaxelModel};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// A session without any progress for this long is given up.
const IDLE_LIMIT: Duration = Duration::from_secs(120);
/// A board that gives no frame for this long is given up.
const SILENT_LIMIT: Duration = Duration::from_secs(10);

/// Arguments of `mocad calibrate`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Port of the Touch Board; without it, the only board on USB.
    #[arg(long, conflicts_with = "stream")]
    port: Option<String>,
    /// Port of a force gauge that prints newtons, one number a line.
    #[arg(long, required_unless_present = "stream")]
    gauge: Option<String>,
    /// Speed of the gauge's port, baud.
    #[arg(long, default_value_t = 115_200)]
    gauge_baud: u32,
    /// A recorded stream instead of a port.
    #[arg(long, requires = "times", requires = "force")]
    stream: Option<PathBuf>,
    /// Times of that stream: `seconds bytes` a line.
    #[arg(long)]
    times: Option<PathBuf>,
    /// Reference force of that stream: `seconds newtons` a line, on the same clock.
    #[arg(long)]
    force: Option<PathBuf>,
    /// Taxels to press, in order, as `number:electrode` (T1 on E0 is 1:0).
    #[arg(long, value_delimiter = ',', required = true, value_parser = target)]
    taxels: Vec<Target>,
    /// Presses of each taxel.
    #[arg(long, default_value_t = 3)]
    presses: u32,
    /// Model to store.
    #[arg(long, value_enum, default_value_t = Model::Monotone)]
    model: Model,
    /// The board as the daemon's configuration names it.
    #[arg(long)]
    board: String,
    /// Foam under the plates.
    #[arg(long, default_value = "PU LD30")]
    material: String,
    /// Calibration file to write.
    #[arg(long, default_value = "calibration.toml")]
    out: PathBuf,
    /// Folder for a residual plot of each taxel and model (SVG).
    #[arg(long)]
    residuals: Option<PathBuf>,
}

/// Models that a cover can use.
#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Model {
    /// A line through zero.
    Line,
    /// A monotone curve.
    Monotone,
    /// A monotone curve with hysteresis and creep compensated.
    Compensated,
}

impl From<Model> for ModelKind {
    fn from(model: Model) -> Self {
        match model {
            Model::Line => Self::LineThroughZero,
            Model::Monotone => Self::Monotone,
            Model::Compensated => Self::Compensated,
        }
    }
}

fn target(text: &str) -> Result<Target, String> {
    let parsed = text.split_once(':').and_then(|(number, electrode)| {
        Some(Target {
            number: number.trim_start_matches('T').parse().ok()?,
            electrode: electrode.parse().ok()?,
        })
    });
    match parsed {
        Some(target) if target.number >= 1 && target.electrode < 12 => Ok(target),
        _ => Err(format!("{text:?} is not `number:electrode` with a number from 1 and an electrode 0 to 11")),
    }
}

/// Runs the session, prints the table of every model, writes the file.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    ensure!(arguments.presses >= 1, "--presses must be at least 1, got {}", arguments.presses);
    let mut session = Session::new(&arguments.taxels, arguments.presses);
    match (&arguments.stream, &arguments.times, &arguments.force) {
        (Some(stream), Some(times), Some(force)) => replay(&mut session, stream, times, force)?,
        _ => live(&mut session, arguments)?,
    }
    let sketch = session.firmware().context("the board's sketch is not known: no good frame came")?;
    let file = calibrate(session.measured(), sketch, arguments)?;
    file.write(&arguments.out)?;
    println!("wrote {}", arguments.out.display());
    Ok(())
}

/// Fits every model to every taxel; stores the chosen one.
fn calibrate(
    measured: &[Measured],
    sketch: Firmware,
    arguments: &Arguments,
) -> anyhow::Result<CalibrationFile> {
    let mut file = CalibrationFile::new(&arguments.board, sketch, &today()?, &arguments.material);
    println!(
        "{:<6}{:<21}{:>8}{:>9}{:>11}{:>8}{:>13}{:>10}",
        "taxel", "model", "RMSE N", "loading", "unloading", "worst", "valid to", "cost ns"
    );
    for Measured { target, rest_counts, trial } in measured {
        let trials = core::slice::from_ref(trial);
        for kind in ModelKind::ALL {
            let (model, quality) = fit(kind, trials).with_context(|| format!("T{}", target.number))?;
            print_row(target.number, &model, &quality, evaluation_cost_ns(&model, trials));
            if let Some(folder) = &arguments.residuals {
                let title = format!("T{} {}: RMSE {:.2} N", target.number, model.name(), quality.rmse_n);
                let path = folder.join(format!("T{}-{}.svg", target.number, model.name()));
                std::fs::create_dir_all(folder)
                    .and_then(|()| std::fs::write(&path, chart::residual_plot(&title, &model, trials)))
                    .with_context(|| format!("cannot write {}", path.display()))?;
            }
            if kind == arguments.model.into() {
                file.taxel.push(TaxelEntry::new(target.number, *rest_counts, &model, &quality));
            }
        }
    }
    Ok(file)
}

fn print_row(taxel: usize, model: &TaxelModel, quality: &Quality, cost_ns: f64) {
    println!(
        "{:<6}{:<21}{:>8.2}{:>9.2}{:>11.2}{:>8.1}{:>11.0} N{:>10.0}",
        format!("T{taxel}"),
        model.name(),
        quality.rmse_n,
        quality.rmse_loading_n,
        quality.rmse_unloading_n,
        quality.worst_n,
        quality.force_max_n,
        cost_ns
    );
}

/// A recorded stream: bytes and forces in the order of their times.
fn replay(session: &mut Session, stream: &Path, times: &Path, force: &Path) -> anyhow::Result<()> {
    let bytes = std::fs::read(stream).with_context(|| format!("cannot read {}", stream.display()))?;
    let mut force = pairs(force)?.into_iter().peekable();
    let mut rest = bytes.as_slice();
    for (time_s, count) in pairs(times)? {
        while let Some((at_s, force_n)) = force.next_if(|&(at_s, _)| at_s <= time_s) {
            session.reference(force_n, nanoseconds(at_s));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the stream")]
        let count = count.clamp(0.0, 1e9) as usize;
        let (chunk, after) = rest.split_at(count.min(rest.len()));
        session.push(chunk, nanoseconds(time_s));
        rest = after;
    }
    match session.step() {
        Step::Done => Ok(()),
        step => bail!("the recording ended early: {}. {}", prompt(&step), session.diagnosis().text()),
    }
}

/// Lines of two numbers.
fn pairs(path: &Path) -> anyhow::Result<Vec<(f64, f64)>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let pair = |(number, line): (usize, &str)| {
        let mut fields = line.split_whitespace().map(str::parse::<f64>);
        match (fields.next(), fields.next(), fields.next()) {
            (Some(Ok(a)), Some(Ok(b)), None) if a.is_finite() && b.is_finite() => Ok((a, b)),
            _ => bail!("{}:{}: expected two numbers, got {line:?}", path.display(), number + 1),
        }
    };
    text.lines().enumerate().map(pair).collect()
}

fn nanoseconds(seconds: f64) -> u64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0..1e18")]
    let nanoseconds = (seconds * 1e9).clamp(0.0, 1e18) as u64;
    nanoseconds
}

/// Board and gauge on their ports, a person at the cover.
fn live(session: &mut Session, arguments: &Arguments) -> anyhow::Result<()> {
    let start = Instant::now();
    let port = arguments.port.as_deref().unwrap_or(AUTO_PORT);
    let (_board, mut board) = ports::open(port, start)?;
    let gauge_port = arguments.gauge.as_deref().context("--gauge is missing")?;
    let mut gauge = Gauge::open(gauge_port, arguments.gauge_baud, start)?;
    let mut shown = String::new();
    let mut waiting = None;
    let (mut bytes_at, mut progress_at, mut last_progress) = (start, start, None);
    loop {
        while let Ok(event) = board.pop() {
            match event {
                BoardEvent::Bytes(chunk) => {
                    session.push(chunk.bytes(), chunk.arrival_ns);
                    (bytes_at, waiting) = (Instant::now(), None);
                }
                BoardEvent::OpenFailed { why, .. } => waiting = Some(why.text()),
                BoardEvent::Closed { .. } => bail!("the board's port closed: start again"),
                BoardEvent::Opened { .. } | BoardEvent::Gap { .. } => {}
            }
        }
        let read = gauge.read(|force_n, at_ns| session.reference(force_n, at_ns));
        read.map_err(|why| anyhow!("force gauge: {why}"))?;
        let step = session.step();
        if step == Step::Done {
            println!();
            return Ok(());
        }
        show(&mut shown, waiting.unwrap_or(&prompt(&step)))?;
        if last_progress.replace(progress(&step)) != Some(progress(&step)) {
            progress_at = Instant::now();
        }
        let why = || waiting.unwrap_or(session.diagnosis().text());
        ensure!(bytes_at.elapsed() < SILENT_LIMIT, "no bytes for {} s: {}", SILENT_LIMIT.as_secs(), why());
        ensure!(progress_at.elapsed() < IDLE_LIMIT, "no progress for {} s: {}", IDLE_LIMIT.as_secs(), why());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// What counts as progress: taxel, frames at rest, presses.
const fn progress(step: &Step) -> (usize, u32, u32) {
    match *step {
        Step::Rest { target, frames } => (target.number, frames, 0),
        Step::Press { target, presses, .. } => (target.number, TARE_FRAMES, presses + 1),
        Step::Done => (0, 0, 0),
    }
}

/// Redraws the progress line if it changed.
fn show(shown: &mut String, text: &str) -> anyhow::Result<()> {
    if shown == text {
        return Ok(());
    }
    let width = shown.chars().count();
    print!("\r{text:<width$}");
    std::io::stdout().flush()?;
    text.clone_into(shown);
    Ok(())
}

fn prompt(step: &Step) -> String {
    match *step {
        Step::Rest { target, frames } => format!(
            "T{}: step away from the cover, measuring rest {}",
            target.number,
            bar(f64::from(frames) / f64::from(TARE_FRAMES))
        ),
        Step::Press { target, presses, presses_wanted, counts, force_n } => {
            let force = match force_n {
                Some(force_n) => format!("{force_n:6.1} N"),
                None => "no reading of the gauge yet".to_owned(),
            };
            format!(
                "T{}: press slowly and release, {presses} of {presses_wanted} {} {counts:4.0} counts {force}",
                target.number,
                bar(f64::from(presses) / f64::from(presses_wanted))
            )
        }
        Step::Done => "done".to_owned(),
    }
}

fn bar(share: f64) -> String {
    const WIDTH: usize = 20;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0..20")]
    let full = (share.clamp(0.0, 1.0) * 20.0) as usize;
    format!("[{}{}]", "#".repeat(full), ".".repeat(WIDTH - full))
}

/// Today in UTC, YYYY-MM-DD (proleptic Gregorian calendar, after H. Hinnant's `civil_from_days`).
pub(crate) fn today() -> anyhow::Result<String> {
    let days = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_secs() / 86_400;
    Ok(civil_date(days))
}

fn civil_date(days_since_1970: u64) -> String {
    let z = days_since_1970 + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_the_calendar_s() {
        for (days, date) in [(0, "1970-01-01"), (11_016, "2000-02-29"), (20_778, "2026-11-21")] {
            assert_eq!(civil_date(days), date);
        }
    }

    #[test]
    fn targets_are_checked() {
        assert_eq!(target("T3:2"), Ok(Target { number: 3, electrode: 2 }));
        for bad in ["3", "0:1", "1:12", "a:b", "1:0:2"] {
            assert!(target(bad).is_err(), "{bad}");
        }
    }

    /// A simulated taxel at rest for 2 s, then pressed three times to 100 N, as recorded files.
    #[cfg(feature = "sim")]
    fn record(folder: &Path) {
        use moca_sim::foam::{Foam, FoamState};
        use moca_sim::sensor::{CoverSensor, Effects};
        use moca_tactile::datastream::{Frame, emit};
        use std::fmt::Write;

        let mut sensor = CoverSensor::<1>::new(Foam::PU_LD30, Effects::default(), 5);
        let mut state = FoamState::default();
        let (mut stream, mut times, mut force) = (Vec::new(), String::new(), String::new());
        for millisecond in 0..34_000u32 {
            let time_s = 1.0 + 1e-3 * f64::from(millisecond);
            let phase_s = (time_s - 3.0).max(0.0);
            let force_n = 50.0 * (1.0 - (phase_s * core::f64::consts::TAU / 10.0).cos());
            sensor.sample(&[state.step_force(&Foam::PU_LD30, force_n, 1e-3)], &[f64::INFINITY]);
            writeln!(force, "{time_s:.4} {force_n:.3}").unwrap();
            if millisecond % 25 == 24 {
                let mut frame = Frame { filtered: [700; 13], baseline: [700; 13], ..Frame::default() };
                frame.filtered[4] = sensor.fdat()[0];
                let before = stream.len();
                emit(&frame, &mut stream);
                writeln!(times, "{:.4} {}", time_s + 0.002, stream.len() - before).unwrap();
            }
        }
        std::fs::write(folder.join("stream.txt"), stream).unwrap();
        std::fs::write(folder.join("stream.times"), times).unwrap();
        std::fs::write(folder.join("force.txt"), force).unwrap();
    }

    #[cfg(feature = "sim")]
    #[test]
    fn a_recorded_session_becomes_a_calibration_that_its_cover_takes() {
        #[derive(clap::Parser)]
        struct Command {
            #[command(flatten)]
            arguments: Arguments,
        }
        let folder = std::env::temp_dir().join(format!("moca-calibrate-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        record(&folder);
        let path = |name: &str| folder.join(name).display().to_string();
        let line = [
            "mocad",
            "--stream",
            &path("stream.txt"),
            "--times",
            &path("stream.times"),
            "--force",
            &path("force.txt"),
            "--taxels",
            "1:4",
            "--board",
            "left",
            "--model",
            "compensated",
            "--out",
            &path("out.toml"),
            "--residuals",
            &path("plots"),
        ];
        let command = <Command as clap::Parser>::try_parse_from(line).unwrap();
        run(&command.arguments).unwrap();
        let file = CalibrationFile::read(&folder.join("out.toml")).unwrap();
        file.apply("left", &mut moca_tactile::CoverConfig::<1>::default()).unwrap();
        assert!(file.taxel[0].rmse_n < 4.0 && file.taxel[0].force_max_n > 99.0, "{:?}", file.taxel);
        assert_eq!(std::fs::read_dir(folder.join("plots")).unwrap().count(), 4);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

//! `mocad calibrate`: presses every taxel beside a reference force and writes a calibration file.
//!
//! Live: a board's port and a force gauge that prints one number a line. From files: a recorded stream with its
//! times, and a table of times and forces. Both send the requests of the dashboard to a [`Service`] of their own.
#![expect(clippy::print_stdout, reason = "a terminal front end")]

use crate::calibration::engine::Fitted;
use crate::calibration::reference::Reference;
use crate::calibration::service::{Service, Settings};
use crate::calibration::store::Store;
use crate::config::AUTO_PORT;
use crate::devices::force_gauge::Gauge;
use crate::devices::ports;
use anyhow::{Context, Result, bail};
use moca_figures::progress::cells;
use moca_msgs::{MAX_TAXELS, nanoseconds};
use moca_tactile::calibration::quality::evaluation_cost_ns;
use moca_tactile::calibration::session::Target;
use moca_tactile::calibration::{ModelKind, Quality, read_bytes};
use moca_tactile::cover::Electrode;
use moca_tactile::{BoardEvent, TaxelModel};
use moca_telemetry::calibration::{CalibrationProgress, CalibrationRequest};
use std::io::Write;
use std::iter::Peekable;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::vec::IntoIter;

/// Longest wait for the first reading of a force gauge.
const GAUGE_STARTS_WITHIN: Duration = Duration::from_secs(10);
/// Standard gravity.
const GRAVITY_M_S2: f64 = 9.806_65;
/// Period at which the ports are read.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Longest recorded stream or table that is read, bytes: hours of a board.
const STREAM_BYTES_MAX: u64 = 1 << 28;

/// Arguments of `mocad calibrate`.
#[derive(clap::Args, Clone, Debug)]
pub struct Arguments {
    /// Port of the Touch Board; without it, the only board on USB.
    #[arg(long, conflicts_with = "stream")]
    port: Option<String>,
    /// Port of a force gauge that prints newtons, one number a line.
    #[arg(long, required_unless_present_any = ["stream", "mass"])]
    gauge: Option<String>,
    /// A known mass instead of a gauge, kg: laid on the taxel, which faces up, or pulling at it over a pulley.
    #[arg(long, value_name = "KG", requires = "check", conflicts_with_all = ["gauge", "stream"], value_parser = mass)]
    mass: Option<f64>,
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
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..))]
    presses: u8,
    /// Model to store.
    #[arg(long, value_enum, default_value_t = Model::Monotone)]
    model: Model,
    /// The board as the daemon's configuration names it.
    #[arg(long)]
    board: String,
    /// Foam under the plates.
    #[arg(long, default_value = "PU LD30")]
    material: String,
    /// Compares the calibration file with the presses of these taxels, and renews its date if the foam is as calibrated; one taxel
    /// is enough, and takes a minute.
    #[arg(long, conflicts_with_all = ["model", "material", "residuals"])]
    check: bool,
    /// Temperature of the foam, °C; stored with the date.
    #[arg(long, value_name = "CELSIUS", allow_negative_numbers = true, value_parser = celsius)]
    temperature: Option<f64>,
    /// Calibration file to write, or to check.
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
        Some(target) if (1..=MAX_TAXELS).contains(&target.number) && target.electrode < 12 => Ok(target),
        _ => Err(format!(
            "{text:?} is not `number:electrode`; allowed: a number from 1 to {MAX_TAXELS}, an electrode from 0 to 11"
        )),
    }
}

/// Reads a mass that presses a taxel well above its threshold and within its range.
fn mass(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(mass_kg) if (1.0..=10.0).contains(&mass_kg) => Ok(mass_kg),
        _ => Err(format!("{text:?} kg; allowed: 1 to 10")),
    }
}

/// Reads a temperature at which people and robots work.
fn celsius(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(celsius) if (-20.0..=60.0).contains(&celsius) => Ok(celsius),
        _ => Err(format!("{text:?} °C; allowed: -20 to 60")),
    }
}

/// Calibrates every taxel, prints the table of every model, stores the chosen one.
pub fn run(arguments: &Arguments) -> Result<()> {
    let store = Store {
        path: arguments.out.clone(),
        board: arguments.board.clone(),
        material: arguments.material.clone(),
        temperature_c: arguments.temperature,
    };
    let mut wiring = vec![Electrode { board: 0, electrode: 0 }; MAX_TAXELS];
    for Target { number, electrode } in &arguments.taxels {
        wiring[number - 1].electrode = *electrode;
    }
    let (mut board, reference) = Board::open(arguments)?;
    let mut service = Service::new(Settings { store: store.clone(), wiring }, reference);
    let model = ModelKind::ALL.iter().zip(0..).find(|(kind, _)| **kind == arguments.model.into());
    let save = CalibrationRequest::Save { model: model.map_or(u8::MAX, |(_, place)| place) };
    if !arguments.check {
        println!(
            "{:<6}{:<21}{:>8}{:>9}{:>11}{:>8}{:>13}{:>10}",
            "taxel", "model", "RMSE N", "loading", "unloading", "worst", "valid to", "cost ns"
        );
    }
    for &Target { number, .. } in &arguments.taxels {
        let pressed = board.press(&mut service, u8::try_from(number - 1)?, arguments.presses);
        if arguments.stream.is_none() {
            println!();
        }
        pressed?;
        let fitted = service.fitted().context("nothing is fitted")?;
        if arguments.check {
            let ratio = store.check(fitted, arguments.mass.is_some())?;
            println!(
                "T{number}: {ratio:.2} times the calibrated force; {} has today's date",
                store.path.display()
            );
            continue;
        }
        print_models(fitted, arguments.residuals.as_deref())?;
        service.ask(save, board.now_ns());
        if let CalibrationProgress::Failed(why) = service.progress() {
            bail!("{why}");
        }
        println!("T{number} is in {}", store.path.display());
    }
    Ok(())
}

fn print_models(fitted: &Fitted, residuals: Option<&Path>) -> Result<()> {
    let (number, trials) = (fitted.measured.target.number, core::slice::from_ref(&fitted.measured.trial));
    for fit in &fitted.models {
        print_row(number, &fit.model, &fit.quality, evaluation_cost_ns(&fit.model, trials));
        let Some(folder) = residuals else { continue };
        let title = format!("T{number} {}: RMSE {:.2} N", fit.model.name(), fit.quality.rmse_n);
        let path = folder.join(format!("T{number}-{}.svg", fit.model.name()));
        let points = moca_tactile::calibration::residuals(&fit.model, trials);
        std::fs::create_dir_all(folder)
            .and_then(|()| std::fs::write(&path, moca_figures::residuals(&title, "N", &points).svg()))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
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

/// Source of the board's bytes.
enum Board {
    Live {
        start: Instant,
        events: rtrb::Consumer<BoardEvent>,
        _reader: ports::Reader,
        /// Prompt for a press.
        press: &'static str,
        shown: String,
    },
    Recorded {
        bytes: Vec<u8>,
        at: usize,
        /// s, bytes.
        times: Peekable<IntoIter<(f64, f64)>>,
    },
}

impl Board {
    /// Opens the files or ports of board and reference.
    fn open(arguments: &Arguments) -> Result<(Self, Reference)> {
        if let (Some(stream), Some(times), Some(force)) =
            (&arguments.stream, &arguments.times, &arguments.force)
        {
            let bytes = read_bytes(stream, STREAM_BYTES_MAX)
                .with_context(|| format!("cannot read {}", stream.display()))?;
            let [times, force] = [pairs(times)?, pairs(force)?].map(|pairs| pairs.into_iter().peekable());
            return Ok((Self::Recorded { bytes, at: 0, times }, Reference::Recorded(force)));
        }
        let start = Instant::now();
        let (_reader, events) = ports::open(arguments.port.as_deref().unwrap_or(AUTO_PORT), start)?;
        let (reference, press) = match arguments.mass {
            Some(mass_kg) => {
                (Reference::Weight(mass_kg * GRAVITY_M_S2), "put the mass on, take it off after five seconds")
            }
            None => (Reference::Gauge(gauge(arguments, start)?), "press slowly and release"),
        };
        Ok((Self::Live { start, events, _reader, press, shown: String::new() }, reference))
    }

    /// Returns the present, or the time of what was recorded next, ns.
    fn now_ns(&mut self) -> u64 {
        match self {
            Self::Live { start, .. } => u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX),
            Self::Recorded { times, .. } => times.peek().map_or(0, |(time_s, _)| nanoseconds(*time_s)),
        }
    }

    /// Follows the presses of a taxel (0 is T1) until they are fitted.
    fn press(&mut self, service: &mut Service, taxel: u8, presses: u8) -> Result<()> {
        service.ask(CalibrationRequest::Start { taxel, presses }, self.now_ns());
        while service.fitted().is_none() {
            let now_ns = self.now_ns();
            match self {
                Self::Live { events, press, shown, .. } => {
                    while let Ok(event) = events.pop() {
                        service.event(0, &event);
                    }
                    show(shown, &prompt(service.progress(), press))?;
                    std::thread::sleep(LOOK_EVERY);
                }
                Self::Recorded { bytes, at, times } => {
                    let Some((_, count)) = times.next() else {
                        bail!("the recording ended early: {}", prompt(service.progress(), "press"));
                    };
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "clamped to the stream"
                    )]
                    let end = at.saturating_add(count.clamp(0.0, 1e9) as usize).min(bytes.len());
                    service.bytes(&bytes[*at..end], now_ns);
                    *at = end;
                }
            }
            service.look(now_ns);
            if let CalibrationProgress::Failed(why) = service.progress() {
                bail!("{why}");
            }
        }
        Ok(())
    }
}

/// Lines of two numbers.
fn pairs(path: &Path) -> anyhow::Result<Vec<(f64, f64)>> {
    let bytes =
        read_bytes(path, STREAM_BYTES_MAX).with_context(|| format!("cannot read {}", path.display()))?;
    let text = String::from_utf8(bytes).with_context(|| format!("cannot read {}", path.display()))?;
    let pair = |(number, line): (usize, &str)| {
        let mut fields = line.split_whitespace().map(str::parse::<f64>);
        match (fields.next(), fields.next(), fields.next()) {
            (Some(Ok(a)), Some(Ok(b)), None) if a.is_finite() && b.is_finite() => Ok((a, b)),
            _ => bail!("{}:{}: expected two numbers, got {line:?}", path.display(), number + 1),
        }
    };
    text.lines().enumerate().map(pair).collect()
}

/// Opens the gauge and waits until it speaks: from then on its silence ends the session.
fn gauge(arguments: &Arguments, start: Instant) -> Result<Gauge> {
    let port = arguments.gauge.as_deref().context("--gauge is missing")?;
    let mut gauge = Gauge::open(port, arguments.gauge_baud, start)?;
    loop {
        let mut spoke = false;
        let read = gauge.read(|_, _| spoke = true);
        if spoke {
            return Ok(gauge);
        }
        if start.elapsed() > GAUGE_STARTS_WITHIN {
            bail!("force gauge: {}", read.err().unwrap_or("it prints nothing that is a number, a line each"));
        }
        std::thread::sleep(LOOK_EVERY);
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

fn prompt(progress: &CalibrationProgress, press: &str) -> String {
    match progress {
        CalibrationProgress::Rest { taxel, frames, frames_wanted } => format!(
            "T{}: step away from the cover, measuring rest {}",
            taxel + 1,
            cells(f64::from(*frames) / f64::from(*frames_wanted))
        ),
        CalibrationProgress::Press { taxel, presses, presses_wanted, counts, force_n } => format!(
            "T{}: {press}, {presses} of {presses_wanted} {} {counts:4.0} counts {}",
            taxel + 1,
            cells(f64::from(*presses) / f64::from(*presses_wanted)),
            force_n.map_or("no reading of the gauge yet".to_owned(), |force_n| format!("{force_n:6.1} N"))
        ),
        CalibrationProgress::Failed(why) | CalibrationProgress::Unavailable(why) => why.clone(),
        CalibrationProgress::Idle => "nothing under way".to_owned(),
        CalibrationProgress::Fitted(_) => "measured".to_owned(),
        CalibrationProgress::Saved { path, .. } => format!("saved in {path}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_tactile::calibration::CalibrationFile;
    #[cfg(feature = "sim")]
    use moca_tactile::calibration::file::StoredModel;

    #[test]
    fn targets_are_checked() {
        assert_eq!(target("T3:2"), Ok(Target { number: 3, electrode: 2 }));
        for bad in ["3", "0:1", "49:1", "1:12", "a:b", "1:0:2"] {
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
    fn recorded_session_gives_calibration_for_its_cover() {
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

        // The same presses a year later, and with a foam that has become 1.3 times as stiff.
        let (calibration, out) = (folder.join("out.toml"), path("out.toml"));
        let check = |file: &CalibrationFile| {
            file.write(&calibration).unwrap();
            let line = [&line[..11], &["--check", "--temperature", "-3", "--out", &out]].concat();
            run(&<Command as clap::Parser>::try_parse_from(line).unwrap().arguments)
        };
        let old = CalibrationFile { date: "2020-01-01".into(), ..file };
        check(&old).unwrap();
        let renewed = CalibrationFile::read(&calibration).unwrap();
        assert!(renewed.date > old.date && renewed.temperature_c == Some(-3.0), "{renewed:?}");
        assert_eq!(renewed.taxel, old.taxel);
        let mut softer = old;
        let StoredModel::Compensated { knots, .. } = &mut softer.taxel[0].model else { panic!() };
        knots.iter_mut().for_each(|knot| knot[1] /= 1.3);
        let error = check(&softer).unwrap_err().to_string();
        assert!(error.contains("T1 is 1.3") && error.contains("allowed: 0.9 to 1.1"), "{error}");
        assert_eq!(CalibrationFile::read(&calibration).unwrap(), softer, "a refused check changes nothing");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

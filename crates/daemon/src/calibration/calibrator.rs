//! Calibration from a panel: collects a taxel's counts beside a reference force, fits, and writes the file, on a thread
//! of its own beside the running loop.

use crate::cli::calibrate::today;
use crate::config::{Config, TAXELS};
use crate::devices::force_gauge::Gauge;
use anyhow::{Context, Result, anyhow, ensure};
use moca_tactile::calibration::file::TaxelEntry;
use moca_tactile::calibration::session::{Measured, Session, Step, Target};
use moca_tactile::calibration::{CalibrationFile, ModelKind, Quality, fit, residuals};
use moca_tactile::cover::Electrode;
use moca_tactile::Firmware;
use moca_tactile::zero::TARE_FRAMES;
use moca_tactile::{BoardEvent, TaxelModel};
use moca_telemetry::calibration::{CalibrationFit, CalibrationProgress, CalibrationRequest, FittedModel};
use moca_telemetry::net::CalibrationPort;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often the board's bytes and the reference are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// Looks from one word about the progress to the next.
const LOOKS_PER_WORD: u32 = 20;
/// Residuals told of a fit: what a screen can show.
const RESIDUALS_TOLD: usize = 300;
/// A session without any progress for this long is given up, ns.
const IDLE_NS: u64 = 120_000_000_000;
/// A reference that says nothing for this long is given up, ns.
const REFERENCE_SILENT_NS: u64 = 1_000_000_000;

/// What the calibrator works for.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where the file goes; an existing one keeps its other taxels.
    pub path: PathBuf,
    /// The board as the configuration names it.
    pub board: String,
    /// Which electrode each taxel is, T1 first.
    pub wiring: [Electrode; TAXELS],
}

/// Where a calibration goes: over the one in use, or beside the daemon.
pub fn file(config: &Config) -> PathBuf {
    match config.board.calibration.as_str() {
        "" => PathBuf::from("calibration.toml"),
        path => PathBuf::from(path),
    }
}

/// The force that counts are compared with.
pub enum Reference {
    /// What the simulation presses a taxel (0 is T1) with, N.
    Simulated(Box<dyn Fn(usize) -> Option<f64> + Send>),
    /// What a person presses with.
    Gauge(Gauge),
}

impl Reference {
    /// Hands over the readings since the last call, N, with their times, ns.
    fn read(
        &mut self,
        taxel: u8,
        now_ns: u64,
        mut reading: impl FnMut(f64, u64),
    ) -> Result<(), &'static str> {
        match self {
            Self::Simulated(force_n) => {
                if let Some(force_n) = force_n(usize::from(taxel)) {
                    reading(force_n, now_ns);
                }
                Ok(())
            }
            Self::Gauge(gauge) => gauge.read(reading),
        }
    }
}

/// The calibrator's thread. Dropping it ends it.
pub struct Calibrator {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Calibrator {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic there has been printed by its own thread.
            let _ = thread.join();
        }
    }
}

/// Starts the thread. It drains `events` all the time; without a `reference` it says that it cannot calibrate. While
/// `moving` is set it neither begins nor goes on: a cover on a moving robot is not at rest.
///
/// # Errors
/// The thread could not be started.
pub fn spawn(
    settings: Settings,
    mut events: rtrb::Consumer<BoardEvent>,
    reference: Option<Reference>,
    moving: Arc<AtomicBool>,
    now_ns: impl Fn() -> u64 + Send + 'static,
) -> Result<(Calibrator, CalibrationPort)> {
    let (to_us, requests) = channel();
    let (progress, from_us) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let thread = std::thread::Builder::new().name("calibrator".into()).spawn(move || {
        let mut work = Work::new(settings);
        let Some(mut reference) = reference else {
            let why =
                "it has no reference force: set board.gauge to the port of a force gauge and start it again";
            return unavailable(why, &requests, &progress, &stopped, &mut events);
        };
        let mut told = CalibrationProgress::Idle;
        let mut looks = 0;
        while !stopped.load(Ordering::Acquire) {
            let asked = requests.try_iter().last();
            if let Some(request) = asked {
                work.ask(request, now_ns());
            }
            if moving.load(Ordering::Relaxed) {
                work.robot_moves();
            }
            while let Ok(event) = events.pop() {
                work.event(&event);
            }
            work.look(now_ns(), &mut reference);
            looks += 1;
            if asked.is_some() || looks >= LOOKS_PER_WORD {
                looks = 0;
                if *work.progress() != told {
                    told = work.progress().clone();
                    // Nobody listens any more only when the daemon ends.
                    let _ = progress.send(told.clone());
                }
            }
            std::thread::sleep(LOOK_EVERY);
        }
    })?;
    let port = CalibrationPort { requests: to_us, progress: from_us };
    Ok((Calibrator { stop, thread: Some(thread) }, port))
}

fn unavailable(
    why: &str,
    requests: &Receiver<CalibrationRequest>,
    progress: &Sender<CalibrationProgress>,
    stop: &AtomicBool,
    events: &mut rtrb::Consumer<BoardEvent>,
) {
    let _ = progress.send(CalibrationProgress::Unavailable(why.to_owned()));
    while !stop.load(Ordering::Acquire) {
        while events.pop().is_ok() {}
        requests.try_iter().for_each(drop);
        std::thread::sleep(LOOK_EVERY * LOOKS_PER_WORD);
    }
}

/// A calibration under way; bytes, forces and time are arguments.
struct Work {
    settings: Settings,
    session: Option<Session>,
    taxel: u8,
    progressed_ns: u64,
    reference_ns: u64,
    fitted: Option<Fitted>,
    progress: CalibrationProgress,
}

/// A finished session, ready to be written.
struct Fitted {
    number: usize,
    rest_counts: f64,
    sketch: Firmware,
    models: Vec<(ModelKind, TaxelModel, Quality)>,
}

impl Work {
    fn new(settings: Settings) -> Self {
        let progress = CalibrationProgress::Idle;
        Self { settings, session: None, taxel: 0, progressed_ns: 0, reference_ns: 0, fitted: None, progress }
    }

    fn progress(&self) -> &CalibrationProgress {
        &self.progress
    }

    fn ask(&mut self, request: CalibrationRequest, now_ns: u64) {
        let progress = match request {
            CalibrationRequest::Start { taxel, presses } => self.start(taxel, presses, now_ns),
            CalibrationRequest::Cancel => {
                (self.session, self.fitted) = (None, None);
                Ok(CalibrationProgress::Idle)
            }
            CalibrationRequest::Save { model } => self.save(usize::from(model)),
        };
        self.progress = progress.unwrap_or_else(|error| CalibrationProgress::Failed(format!("{error:#}")));
    }

    fn start(&mut self, taxel: u8, presses: u8, now_ns: u64) -> Result<CalibrationProgress> {
        let wire = self.settings.wiring.get(usize::from(taxel));
        let wire = wire.ok_or_else(|| anyhow!("there is no taxel T{}", u16::from(taxel) + 1))?;
        let number = usize::from(taxel) + 1;
        let target = Target { number, electrode: wire.electrode };
        self.session = Some(Session::new(&[target], u32::from(presses)));
        (self.taxel, self.fitted) = (taxel, None);
        (self.progressed_ns, self.reference_ns) = (now_ns, now_ns);
        Ok(CalibrationProgress::Rest { taxel, frames: 0, frames_wanted: TARE_FRAMES })
    }

    fn event(&mut self, event: &BoardEvent) {
        match (event, &mut self.session) {
            (BoardEvent::Bytes(chunk), Some(session)) => session.push(chunk.bytes(), chunk.arrival_ns),
            (BoardEvent::Closed { .. } | BoardEvent::Gap { .. }, Some(_)) => {
                self.give_up("the board's stream broke off: start again");
            }
            _ => {}
        }
    }

    fn robot_moves(&mut self) {
        if self.session.is_some() {
            self.give_up(
                "a law moves the robot, and a taxel is calibrated at rest: disarm it, then start again",
            );
        }
    }

    /// Reads the reference and says how far it is.
    fn look(&mut self, now_ns: u64, reference: &mut Reference) {
        let (taxel, mut session) = (self.taxel, self.session.as_mut());
        let read = reference.read(taxel, now_ns, |force_n, at_ns| {
            self.reference_ns = at_ns;
            if let Some(session) = &mut session {
                session.reference(force_n, at_ns);
            }
        });
        let Some(session) = session else { return };
        if let Err(why) = read {
            return self.give_up(&format!("force gauge: {why}"));
        }
        // Between two readings the force is interpolated, and a press in a long gap would be none.
        if now_ns.saturating_sub(self.reference_ns) > REFERENCE_SILENT_NS {
            return self
                .give_up("the force gauge is silent: it must print newtons, a number a line, all the time");
        }
        let progress = match session.step() {
            Step::Rest { frames, .. } => {
                CalibrationProgress::Rest { taxel, frames, frames_wanted: TARE_FRAMES }
            }
            Step::Press { presses, presses_wanted, counts, force_n, .. } => {
                CalibrationProgress::Press { taxel, presses, presses_wanted, counts, force_n }
            }
            Step::Done => {
                let (measured, sketch) = (session.measured().first().cloned(), session.firmware());
                self.session = None;
                let fitted = measured.zip(sketch).context("nothing was measured");
                let fitted = fitted.and_then(|(measured, sketch)| self.fit(&measured, sketch));
                self.progress = match fitted {
                    Ok(fit) => CalibrationProgress::Fitted(fit),
                    Err(error) => CalibrationProgress::Failed(format!("T{}: {error:#}", taxel + 1)),
                };
                return;
            }
        };
        if steps(&progress) != steps(&self.progress) {
            self.progressed_ns = now_ns;
        } else if now_ns.saturating_sub(self.progressed_ns) > IDLE_NS {
            let why =
                format!("no progress for {} s: {}", IDLE_NS / 1_000_000_000, session.diagnosis().text());
            return self.give_up(&why);
        }
        self.progress = progress;
    }

    fn give_up(&mut self, why: &str) {
        self.session = None;
        self.progress = CalibrationProgress::Failed(why.to_owned());
    }

    fn fit(&mut self, measured: &Measured, sketch: Firmware) -> Result<CalibrationFit> {
        let trials = core::slice::from_ref(&measured.trial);
        let (mut models, mut told) = (Vec::new(), Vec::new());
        for kind in ModelKind::ALL {
            let (model, quality) = fit(kind, trials).map_err(|error| anyhow!("{error}"))?;
            told.push(describe(kind, &model, &quality, &residuals(&model, trials)));
            models.push((kind, model, quality));
        }
        let (number, rest_counts) = (measured.target.number, measured.rest_counts);
        self.fitted = Some(Fitted { number, rest_counts, sketch, models });
        Ok(CalibrationFit { taxel: self.taxel, rest_counts, models: told })
    }

    fn save(&mut self, model: usize) -> Result<CalibrationProgress> {
        let fitted = self.fitted.as_ref().context("nothing is fitted yet")?;
        let (kind, model, quality) = fitted.models.get(model).context("there is no such model")?;
        ensure!(usable(*kind), "a line with an intercept reads its intercept when untouched");
        let Settings { path, board, .. } = &self.settings;
        let mut file = if path.exists() {
            CalibrationFile::read(path)?
        } else {
            CalibrationFile::new(board, fitted.sketch, "", "not stated")
        };
        ensure!(file.board == *board, "{} is of board {:?}, not {board:?}", path.display(), file.board);
        ensure!(file.sketch == fitted.sketch.name(), "{} is of sketch {}", path.display(), file.sketch);
        file.date = today()?;
        file.taxel.retain(|entry| entry.number != fitted.number);
        file.taxel.push(TaxelEntry::new(fitted.number, fitted.rest_counts, model, quality));
        file.taxel.sort_by_key(|entry| entry.number);
        file.write(path)?;
        let taxels = file.taxel.iter().filter_map(|entry| u8::try_from(entry.number).ok()).collect();
        // Relative to the daemon's folder, the path would say nothing on another machine.
        let path = path.canonicalize().unwrap_or_else(|_| path.clone()).display().to_string();
        self.fitted = None;
        Ok(CalibrationProgress::Saved { path, taxels })
    }
}

/// What counts as progress: frames at rest, presses.
const fn steps(progress: &CalibrationProgress) -> (u32, u32) {
    match *progress {
        CalibrationProgress::Rest { frames, .. } => (frames, 0),
        CalibrationProgress::Press { presses, .. } => (u32::MAX, presses),
        _ => (0, 0),
    }
}

const fn usable(kind: ModelKind) -> bool {
    !matches!(kind, ModelKind::LineWithIntercept)
}

fn describe(kind: ModelKind, model: &TaxelModel, quality: &Quality, residuals: &[(f64, f64)]) -> FittedModel {
    #[expect(clippy::cast_possible_truncation, reason = "f32 resolves far more than a screen shows")]
    let told = |&(force_n, error_n): &(f64, f64)| [force_n as f32, error_n as f32];
    FittedModel {
        name: model.name().to_owned(),
        usable: usable(kind),
        rmse_n: quality.rmse_n,
        rmse_loading_n: quality.rmse_loading_n,
        rmse_unloading_n: quality.rmse_unloading_n,
        worst_n: quality.worst_n,
        force_max_n: quality.force_max_n,
        residuals: residuals
            .iter()
            .step_by(residuals.len().div_ceil(RESIDUALS_TOLD).max(1))
            .map(told)
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_tactile::datastream::{Frame, emit};

    fn settings(name: &str) -> Settings {
        let path = std::env::temp_dir().join(format!("moca-{name}-{}.toml", std::process::id()));
        Settings { path, board: "left".into(), wiring: moca_tactile::CoverConfig::default().wiring }
    }

    /// Runs a session of T`taxel + 1`, pressed three times to 100 N at 0.84 counts/N, until it is fitted.
    fn run(work: &mut Work, taxel: u8) {
        work.ask(CalibrationRequest::Start { taxel, presses: 3 }, 0);
        let mut phase = 0u32;
        for i in 1..4000u64 {
            let force_n = match work.progress() {
                CalibrationProgress::Press { .. } => {
                    phase += 1;
                    50.0 * (1.0 - (f64::from(phase) * 0.02).cos())
                }
                CalibrationProgress::Rest { .. } => 0.0,
                _ => return,
            };
            let mut frame = Frame { filtered: [720; 13], baseline: [720; 13], ..Frame::default() };
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 84")]
            let counts = (0.84 * force_n).round() as u16;
            frame.filtered[usize::from(taxel)] = 720 - counts;
            let mut bytes = Vec::new();
            emit(&frame, &mut bytes);
            let now_ns = i * 24_700_000;
            if let Some(session) = &mut work.session {
                session.push(&bytes, now_ns);
            }
            let mut reference = Reference::Simulated(Box::new(move |_| Some(force_n)));
            work.look(now_ns - 12_000_000, &mut reference);
        }
    }

    #[test]
    fn a_taxel_is_collected_fitted_and_saved_beside_those_that_were_there() {
        let settings = settings("calibrator");
        let mut work = Work::new(settings.clone());
        for taxel in [5, 2] {
            run(&mut work, taxel);
            let CalibrationProgress::Fitted(fit) = work.progress() else {
                panic!("{:?}", work.progress());
            };
            assert_eq!((fit.taxel, fit.models.len()), (taxel, 4));
            assert!(fit.models[1].rmse_n < 0.6 && fit.models[1].force_max_n > 95.0, "{:?}", fit.models[1]);
            assert!((1..=RESIDUALS_TOLD).contains(&fit.models[1].residuals.len()));
            work.ask(CalibrationRequest::Save { model: 0 }, 0);
            assert!(matches!(work.progress(), CalibrationProgress::Failed(why) if why.contains("intercept")));
            work.ask(CalibrationRequest::Save { model: 2 }, 0);
        }
        assert!(matches!(work.progress(), CalibrationProgress::Saved { taxels, .. } if *taxels == [3, 6]));
        let file = CalibrationFile::read(&settings.path).unwrap();
        assert_eq!((file.board.as_str(), file.taxel.len()), ("left", 2));
        std::fs::remove_file(&settings.path).unwrap();
    }

    #[test]
    fn what_makes_no_sense_is_refused_in_words() {
        let mut work = Work::new(settings("refused"));
        for (request, word) in [
            (CalibrationRequest::Save { model: 1 }, "nothing is fitted"),
            (CalibrationRequest::Start { taxel: 11, presses: 3 }, "T12"),
        ] {
            work.ask(request, 0);
            assert!(matches!(work.progress(), CalibrationProgress::Failed(why) if why.contains(word)));
        }
        run(&mut work, 0);
        work.ask(CalibrationRequest::Cancel, 0);
        assert_eq!(*work.progress(), CalibrationProgress::Idle);
    }

    #[test]
    fn a_robot_that_moves_or_a_silent_reference_ends_the_session() {
        let mut work = Work::new(settings("moves"));
        work.ask(CalibrationRequest::Start { taxel: 0, presses: 1 }, 0);
        work.robot_moves();
        assert!(matches!(work.progress(), CalibrationProgress::Failed(why) if why.contains("disarm")));
        work.ask(CalibrationRequest::Start { taxel: 0, presses: 1 }, 0);
        let mut silent = Reference::Simulated(Box::new(|_| None));
        work.look(900_000_000, &mut silent);
        assert!(matches!(work.progress(), CalibrationProgress::Rest { .. }));
        work.look(1_100_000_000, &mut silent);
        assert!(matches!(work.progress(), CalibrationProgress::Failed(why) if why.contains("silent")));
        // What is fitted is not lost by arming.
        run(&mut work, 0);
        work.robot_moves();
        assert!(matches!(work.progress(), CalibrationProgress::Fitted(_)));
    }

    #[test]
    fn a_session_that_nobody_presses_is_given_up() {
        let mut work = Work::new(settings("idle"));
        work.ask(CalibrationRequest::Start { taxel: 0, presses: 1 }, 0);
        let mut last_s = 0;
        let mut reference = Reference::Simulated(Box::new(|_| Some(0.0)));
        for s in 0..200u64 {
            work.look(s * 1_000_000_000, &mut reference);
            last_s = s;
            if work.session.is_none() {
                break;
            }
        }
        assert!(matches!(work.progress(), CalibrationProgress::Failed(why) if why.contains("no progress")));
        assert!((120..125).contains(&last_s));
    }
}

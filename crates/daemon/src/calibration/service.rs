//! The calibration service: one state machine for the clients of a daemon, on a thread beside the loop, and for `mocad calibrate`.

use crate::calibration::engine::{Engine, Fitted};
use crate::calibration::reference::Reference;
use crate::calibration::store::Store;
use crate::config::Config;
use anyhow::{Context, Result};
use moca_tactile::BoardEvent;
use moca_tactile::calibration::ModelKind;
use moca_tactile::calibration::session::Target;
use moca_tactile::cover::Electrode;
use moca_telemetry::calibration::{CalibrationProgress, CalibrationRequest};
use moca_telemetry::net::CalibrationPort;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Period at which the board's bytes and the reference are read.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// Looks from one report of the progress to the next.
const LOOKS_PER_REPORT: u32 = 20;

/// Robot, cover and reference of the calibrator.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Store of accepted fits.
    pub store: Store,
    /// Which electrode each taxel is, T1 first.
    pub wiring: Vec<Electrode>,
}

impl Settings {
    /// Over the calibration file in use, or beside the daemon.
    pub fn new(config: &Config, wiring: &[Electrode]) -> Self {
        let path = match config.board.calibration.as_str() {
            "" => PathBuf::from("calibration.toml"),
            path => PathBuf::from(path),
        };
        let store = Store {
            path,
            board: config.board.name.clone(),
            material: "not stated".into(),
            temperature_c: None,
        };
        Self { store, wiring: wiring.to_vec() }
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
    mut events: rtrb::Consumer<(u8, BoardEvent)>,
    reference: Option<Reference>,
    moving: Arc<AtomicBool>,
    now_ns: impl Fn() -> u64 + Send + 'static,
) -> Result<(Calibrator, CalibrationPort)> {
    let (to_us, requests) = channel();
    let (progress, from_us) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let thread = std::thread::Builder::new().name("calibrator".into()).spawn(move || {
        let Some(reference) = reference else {
            let why =
                "it has no reference force: set board.gauge to the port of a force gauge and start it again";
            return unavailable(why, &requests, &progress, &stopped, &mut events);
        };
        let mut service = Service::new(settings, reference);
        let mut reported = CalibrationProgress::Idle;
        let mut looks = 0;
        while !stopped.load(Ordering::Acquire) {
            let asked = requests.try_iter().last();
            if let Some(request) = asked {
                service.ask(request, now_ns());
            }
            if moving.load(Ordering::Relaxed) {
                service.engine.robot_moves();
            }
            while let Ok((board, event)) = events.pop() {
                service.event(board, &event);
            }
            service.look(now_ns());
            looks += 1;
            if asked.is_some() || looks >= LOOKS_PER_REPORT {
                looks = 0;
                if *service.progress() != reported {
                    reported = service.progress().clone();
                    // Nobody listens any more only when the daemon ends.
                    let _ = progress.send(reported.clone());
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
    events: &mut rtrb::Consumer<(u8, BoardEvent)>,
) {
    let _ = progress.send(CalibrationProgress::Unavailable(why.to_owned()));
    while !stop.load(Ordering::Acquire) {
        while events.pop().is_ok() {}
        requests.try_iter().for_each(drop);
        std::thread::sleep(LOOK_EVERY * LOOKS_PER_REPORT);
    }
}

/// The engine with its reference and its file: requests, bytes and times in, progress out. The thread of [`spawn`] runs one for the
/// clients of a daemon, `mocad calibrate` one of its own.
pub struct Service {
    settings: Settings,
    engine: Engine,
    /// The one under way, 0 is T1.
    taxel: u8,
    reference: Reference,
}

impl Service {
    /// Nothing is under way.
    pub fn new(settings: Settings, reference: Reference) -> Self {
        Self { settings, engine: Engine::default(), taxel: 0, reference }
    }

    /// Returns the progress.
    pub const fn progress(&self) -> &CalibrationProgress {
        self.engine.progress()
    }

    /// Returns the fit that waits to be saved.
    pub const fn fitted(&self) -> Option<&Fitted> {
        self.engine.fitted()
    }

    /// Carries out a request; a refusal is the progress then.
    pub fn ask(&mut self, request: CalibrationRequest, now_ns: u64) {
        let answered = match request {
            CalibrationRequest::Start { taxel, presses } => self.start(taxel, presses, now_ns),
            CalibrationRequest::Cancel => {
                self.engine.cancel();
                Ok(())
            }
            CalibrationRequest::Save { model } => self.save(usize::from(model)),
        };
        if let Err(error) = answered {
            self.engine.fail(&format!("{error:#}"));
        }
    }

    /// Takes an event of a board's port; those of other boards than the taxel's are left out.
    pub fn event(&mut self, board: u8, event: &BoardEvent) {
        let wire = self.settings.wiring.get(usize::from(self.taxel));
        if board == wire.map_or(0, |wire| wire.board) {
            self.engine.event(event);
        }
    }

    /// Takes recorded bytes of the taxel's board, after the reference's readings until then.
    pub fn bytes(&mut self, bytes: &[u8], arrival_ns: u64) {
        self.reference.tell(&mut self.engine, usize::from(self.taxel), arrival_ns);
        self.engine.bytes(bytes, arrival_ns);
    }

    /// Takes the reference's readings and brings the progress up to `now_ns`.
    pub fn look(&mut self, now_ns: u64) {
        self.reference.tell(&mut self.engine, usize::from(self.taxel), now_ns);
        self.engine.look(now_ns);
    }

    fn start(&mut self, taxel: u8, presses: u8, now_ns: u64) -> Result<()> {
        let number = usize::from(taxel) + 1;
        let wire = self.settings.wiring.get(usize::from(taxel));
        let wire = wire.with_context(|| format!("there is no taxel T{number}"))?;
        self.taxel = taxel;
        self.engine.start(Target { number, electrode: wire.electrode }, u32::from(presses), now_ns);
        Ok(())
    }

    fn save(&mut self, model: usize) -> Result<()> {
        let fitted = self.engine.fitted().context("nothing is fitted yet")?;
        let kind = *ModelKind::ALL.get(model).context("there is no such model")?;
        let store = &self.settings.store;
        let taxels = store.save(fitted, kind)?;
        // Relative to the daemon's folder, the path would say nothing on another machine.
        let path = store.path.canonicalize().unwrap_or_else(|_| store.path.clone());
        self.engine.stored(path.display().to_string(), taxels);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::engine::tests::press;
    use moca_tactile::calibration::CalibrationFile;

    fn service(name: &str) -> Service {
        let path = std::env::temp_dir().join(format!("moca-{name}-{}.toml", std::process::id()));
        let store = Store { path, board: "left".into(), material: "PU LD30".into(), temperature_c: None };
        let wiring = moca_tactile::CoverConfig::<11>::default().wiring.to_vec();
        let reference = Reference::Simulated(Box::new(|_| Some(0.0)));
        Service::new(Settings { store, wiring }, reference)
    }

    #[test]
    fn a_taxel_is_saved_beside_those_that_were_there() {
        let mut service = service("calibrator");
        for taxel in [5_u8, 2] {
            press(&mut service.engine, Target { number: usize::from(taxel) + 1, electrode: taxel });
            service.ask(CalibrationRequest::Save { model: 0 }, 0);
            assert!(
                matches!(service.progress(), CalibrationProgress::Failed(why) if why.contains("intercept"))
            );
            service.ask(CalibrationRequest::Save { model: 2 }, 0);
        }
        assert!(matches!(service.progress(), CalibrationProgress::Saved { taxels, .. } if *taxels == [3, 6]));
        let file = CalibrationFile::read(&service.settings.store.path).unwrap();
        assert_eq!((file.board.as_str(), file.taxel.len()), ("left", 2));
        std::fs::remove_file(&service.settings.store.path).unwrap();
    }

    #[test]
    fn what_makes_no_sense_is_refused_in_words() {
        let mut service = service("refused");
        for (request, word) in [
            (CalibrationRequest::Save { model: 1 }, "nothing is fitted"),
            (CalibrationRequest::Start { taxel: 11, presses: 3 }, "T12"),
        ] {
            service.ask(request, 0);
            assert!(matches!(service.progress(), CalibrationProgress::Failed(why) if why.contains(word)));
        }
        service.ask(CalibrationRequest::Start { taxel: 0, presses: 3 }, 0);
        service.ask(CalibrationRequest::Cancel, 0);
        assert_eq!(*service.progress(), CalibrationProgress::Idle);
    }
}

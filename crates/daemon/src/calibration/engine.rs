//! The engine of a calibration: bytes of the board, readings of the reference and times in; progress and fits out. It
//! reads no clock and opens no port, so a terminal, a dashboard, a recording and a test drive it alike.

use anyhow::{Context, Result, anyhow};
use moca_tactile::Firmware;
use moca_tactile::calibration::session::{Measured, PRESS_COUNTS, Session, Step, Target};
use moca_tactile::calibration::{ModelKind, Quality, fit, residuals};
use moca_tactile::zero::TARE_FRAMES;
use moca_tactile::{BoardEvent, TaxelModel};
use moca_telemetry::calibration::{CalibrationFit, CalibrationProgress, FittedModel};

/// A session without any progress for this long is given up, s.
const IDLE_S: u64 = 120;
/// A board that says nothing for this long is given up, s.
const BOARD_SILENT_S: u64 = 10;
/// A reference that says nothing for this long is given up, s: between two readings the force is interpolated, and a
/// press in a long gap would be none.
const REFERENCE_SILENT_S: u64 = 1;
/// Residuals of a fit that are shown: as many as a screen can.
const RESIDUALS_SHOWN: usize = 300;

/// A finished taxel, ready to be stored.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Measured values.
    pub measured: Measured,
    /// The board's sketch.
    pub sketch: Firmware,
    /// Every kind of model, cheapest first.
    pub models: Vec<Fit>,
}

/// One kind of model and how well it describes the presses.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Which kind.
    pub kind: ModelKind,
    /// The model.
    pub model: TaxelModel,
    /// Its errors and its range.
    pub quality: Quality,
}

/// Returns true if a cover can use a model of this kind.
pub const fn usable(kind: ModelKind) -> bool {
    !matches!(kind, ModelKind::LineWithIntercept)
}

/// A taxel's calibration under way, or none.
#[derive(Debug, Default)]
pub struct Engine {
    session: Option<Session>,
    target: Option<Target>,
    fitted: Option<Fitted>,
    progress: CalibrationProgress,
    /// Why the board's port does not open, while it does not.
    port: Option<&'static str>,
    progressed_ns: u64,
    board_ns: u64,
    reference_ns: u64,
}

impl Engine {
    /// Returns the progress.
    pub const fn progress(&self) -> &CalibrationProgress {
        &self.progress
    }

    /// Returns the fit of the last session, until the next one starts.
    pub const fn fitted(&self) -> Option<&Fitted> {
        self.fitted.as_ref()
    }

    /// Begins with one taxel; what was not stored is forgotten.
    pub fn start(&mut self, target: Target, presses: u32, now_ns: u64) {
        *self = Self {
            session: Some(Session::new(&[target], presses)),
            target: Some(target),
            progressed_ns: now_ns,
            board_ns: now_ns,
            reference_ns: now_ns,
            ..Self::default()
        };
        self.progress = shown(&Step::Rest { target, frames: 0 });
    }

    /// Forgets what was collected.
    pub fn cancel(&mut self) {
        *self = Self::default();
    }

    /// Says that what was fitted is stored.
    pub fn stored(&mut self, path: String, taxels: Vec<u8>) {
        self.fitted = None;
        self.progress = CalibrationProgress::Saved { path, taxels };
    }

    /// Takes an event of the board's port.
    pub fn event(&mut self, event: &BoardEvent) {
        match event {
            BoardEvent::Bytes(chunk) => self.bytes(chunk.bytes(), chunk.arrival_ns),
            BoardEvent::Closed { .. } | BoardEvent::Gap { .. } if self.session.is_some() => {
                self.fail("the board's stream broke off: start again");
            }
            BoardEvent::OpenFailed { why, .. } => self.port = Some(why.text()),
            BoardEvent::Opened { .. }
            | BoardEvent::Closed { .. }
            | BoardEvent::Gap { .. }
            | BoardEvent::Starved { .. } => {}
        }
    }

    /// Bytes of the board that arrived at `arrival_ns`.
    pub fn bytes(&mut self, bytes: &[u8], arrival_ns: u64) {
        (self.board_ns, self.port) = (arrival_ns, None);
        if let Some(session) = &mut self.session {
            session.push(bytes, arrival_ns);
        }
    }

    /// A reading of the reference at `at_ns`, N.
    pub fn reference(&mut self, force_n: f64, at_ns: u64) {
        self.reference_ns = at_ns;
        if let Some(session) = &mut self.session {
            session.reference(force_n, at_ns);
        }
    }

    /// A known weight, N, is the reference at `at_ns`: it lies on the taxel whenever that is pressed.
    pub fn weight(&mut self, weight_n: f64, at_ns: u64) {
        let step = self.session.as_ref().map(Session::step);
        let lies = matches!(step, Some(Step::Press { counts, .. }) if counts >= PRESS_COUNTS);
        self.reference(if lies { weight_n } else { 0.0 }, at_ns);
    }

    /// A law moves the robot: a taxel is calibrated at rest.
    pub fn robot_moves(&mut self) {
        if self.session.is_some() {
            self.fail(
                "a law moves the robot, and a taxel is calibrated at rest: disarm it, then start again",
            );
        }
    }

    /// Gives up.
    pub fn fail(&mut self, why: &str) {
        self.session = None;
        self.progress = CalibrationProgress::Failed(why.to_owned());
    }

    /// Looks how far it is at `now_ns`, fits what is complete, gives up what does not go on.
    pub fn look(&mut self, now_ns: u64) {
        let Some(session) = &self.session else { return };
        let silent_s = |since_ns: u64| now_ns.saturating_sub(since_ns) / 1_000_000_000;
        let why = self.port.unwrap_or(session.diagnosis().text());
        if silent_s(self.board_ns) >= BOARD_SILENT_S {
            return self.fail(&format!("no bytes of the board for {BOARD_SILENT_S} s: {why}"));
        }
        if silent_s(self.reference_ns) >= REFERENCE_SILENT_S {
            return self
                .fail("the force gauge is silent: it must print newtons, a number a line, all the time");
        }
        let step = session.step();
        if step == Step::Done {
            return self.finish();
        }
        let progress = shown(&step);
        if steps(&progress) != steps(&self.progress) {
            self.progressed_ns = now_ns;
        } else if silent_s(self.progressed_ns) >= IDLE_S {
            return self.fail(&format!("no progress for {IDLE_S} s: {why}"));
        }
        self.progress = progress;
    }

    fn finish(&mut self) {
        let session = self.session.take();
        let measured = session.as_ref().and_then(|session| session.measured().first().cloned());
        let measured = measured.zip(session.and_then(|session| session.firmware()));
        let fitted = measured
            .context("nothing was measured")
            .and_then(|(measured, sketch)| Ok(Fitted { models: fits(&measured)?, measured, sketch }));
        match fitted {
            Ok(fitted) => {
                self.progress = CalibrationProgress::Fitted(described(&fitted));
                self.fitted = Some(fitted);
            }
            Err(error) => {
                let number = self.target.map_or(0, |target| target.number);
                self.fail(&format!("T{number}: {error:#}"));
            }
        }
    }
}

fn fits(measured: &Measured) -> Result<Vec<Fit>> {
    let trials = core::slice::from_ref(&measured.trial);
    let one = |&kind: &ModelKind| {
        let (model, quality) = fit(kind, trials).map_err(|error| anyhow!("{error}"))?;
        Ok(Fit { kind, model, quality })
    };
    ModelKind::ALL.iter().map(one).collect()
}

/// As a client is shown it.
fn shown(step: &Step) -> CalibrationProgress {
    let taxel = |target: &Target| u8::try_from(target.number - 1).unwrap_or(u8::MAX);
    match step {
        Step::Rest { target, frames } => {
            CalibrationProgress::Rest { taxel: taxel(target), frames: *frames, frames_wanted: TARE_FRAMES }
        }
        Step::Press { target, presses, presses_wanted, counts, force_n } => CalibrationProgress::Press {
            taxel: taxel(target),
            presses: *presses,
            presses_wanted: *presses_wanted,
            counts: *counts,
            force_n: *force_n,
        },
        Step::Done => CalibrationProgress::Idle,
    }
}

/// Returns the counts that are progress: frames at rest, presses.
const fn steps(progress: &CalibrationProgress) -> (u32, u32) {
    match *progress {
        CalibrationProgress::Rest { frames, .. } => (frames, 0),
        CalibrationProgress::Press { presses, .. } => (u32::MAX, presses),
        _ => (0, 0),
    }
}

fn described(fitted: &Fitted) -> CalibrationFit {
    let trials = core::slice::from_ref(&fitted.measured.trial);
    #[expect(clippy::cast_possible_truncation, reason = "f32 resolves far more than a screen shows")]
    let point = |&(force_n, error_n): &(f64, f64)| [force_n as f32, error_n as f32];
    let model = |fit: &Fit| {
        let residuals = residuals(&fit.model, trials);
        let stride = residuals.len().div_ceil(RESIDUALS_SHOWN).max(1);
        FittedModel {
            name: fit.model.name().to_owned(),
            usable: usable(fit.kind),
            rmse_n: fit.quality.rmse_n,
            rmse_loading_n: fit.quality.rmse_loading_n,
            rmse_unloading_n: fit.quality.rmse_unloading_n,
            worst_n: fit.quality.worst_n,
            force_max_n: fit.quality.force_max_n,
            residuals: residuals.iter().step_by(stride).map(point).collect(),
        }
    };
    CalibrationFit {
        taxel: u8::try_from(fitted.measured.target.number - 1).unwrap_or(u8::MAX),
        rest_counts: fitted.measured.rest_counts,
        models: fitted.models.iter().map(model).collect(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use moca_tactile::datastream::{Frame, emit};

    const TARGET: Target = Target { number: 3, electrode: 2 };
    /// Weight of 5 kg.
    const WEIGHT_N: f64 = 49.03;

    /// Presses `target` three times to 100 N at 0.84 counts/N, until it is fitted or has failed.
    pub(in crate::calibration) fn press(engine: &mut Engine, target: Target) {
        let gauge = |engine: &mut Engine, force_n, sampled_ns| engine.reference(force_n, sampled_ns);
        run(engine, target, 3, |phase| 50.0 * (1.0 - (f64::from(phase) * 0.02).cos()), gauge);
    }

    /// Lays a mass of 5 kg on `target` for five seconds, whose foam is `stiffer` than 0.84 counts/N.
    pub(in crate::calibration) fn lay(engine: &mut Engine, target: Target, stiffer: f64) {
        let lies = |phase: u32| if (40..240).contains(&phase) { WEIGHT_N / stiffer } else { 0.0 };
        run(engine, target, 1, lies, |engine, _, sampled_ns| engine.weight(WEIGHT_N, sampled_ns));
    }

    fn run(
        engine: &mut Engine,
        target: Target,
        presses: u32,
        pressed_n: impl Fn(u32) -> f64,
        reference: impl Fn(&mut Engine, f64, u64),
    ) {
        engine.start(target, presses, 0);
        let mut phase = 0_u32;
        for i in 1..4000_u64 {
            let force_n = match engine.progress() {
                CalibrationProgress::Press { .. } => {
                    phase += 1;
                    pressed_n(phase)
                }
                CalibrationProgress::Rest { .. } => 0.0,
                _ => return,
            };
            let mut frame = Frame { filtered: [720; 13], baseline: [720; 13], ..Frame::default() };
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 84")]
            let counts = (0.84 * force_n).round() as u16;
            frame.filtered[usize::from(target.electrode)] = 720 - counts;
            let mut bytes = Vec::new();
            emit(&frame, &mut bytes);
            let now_ns = i * 24_700_000;
            engine.bytes(&bytes, now_ns);
            // The frame's data was sampled 12 ms before its first line came.
            reference(engine, force_n, now_ns - 12_000_000);
            engine.look(now_ns);
        }
    }

    #[test]
    fn a_pressed_taxel_is_fitted_with_every_model() {
        let mut engine = Engine::default();
        press(&mut engine, TARGET);
        let CalibrationProgress::Fitted(fit) = engine.progress() else { panic!("{:?}", engine.progress()) };
        assert_eq!((fit.taxel, fit.models.len()), (2, 4));
        assert!(fit.models[1].rmse_n < 0.6 && fit.models[1].force_max_n > 95.0, "{:?}", fit.models[1]);
        assert!(!fit.models[0].usable && fit.models[1].usable);
        assert!((1..=RESIDUALS_SHOWN).contains(&fit.models[1].residuals.len()));
        engine.robot_moves();
        assert!(engine.fitted().is_some(), "what is fitted is not lost by arming");
        engine.cancel();
        assert_eq!((engine.progress(), engine.fitted().is_none()), (&CalibrationProgress::Idle, true));
    }

    #[test]
    fn what_does_not_go_on_is_given_up_with_its_reason() {
        let failed = |engine: &Engine, word: &str| matches!(engine.progress(), CalibrationProgress::Failed(why) if why.contains(word));
        let mut engine = Engine::default();
        engine.start(TARGET, 1, 0);
        engine.robot_moves();
        assert!(failed(&engine, "disarm"));
        engine.start(TARGET, 1, 0);
        engine.look(900_000_000);
        assert!(matches!(engine.progress(), CalibrationProgress::Rest { .. }));
        engine.look(1_000_000_000);
        assert!(failed(&engine, "gauge is silent"));
        engine.start(TARGET, 1, 0);
        engine.event(&BoardEvent::Gap { at_ns: 5, bytes_lost: 1 });
        assert!(failed(&engine, "broke off"));
    }

    #[test]
    fn silent_board_and_unpressed_taxel_time_out() {
        let given_up = |with_bytes: bool| {
            let mut engine = Engine::default();
            engine.start(TARGET, 1, 0);
            for s in 0..200_u64 {
                engine.reference(0.0, s * 1_000_000_000);
                if with_bytes {
                    engine.bytes(b"", s * 1_000_000_000);
                }
                engine.look(s * 1_000_000_000);
                if let CalibrationProgress::Failed(why) = engine.progress() {
                    return (s, why.clone());
                }
            }
            panic!("it waits for ever");
        };
        let (at_s, why) = given_up(false);
        assert!(at_s == BOARD_SILENT_S && why.contains("no bytes"), "{at_s} s: {why}");
        let (at_s, why) = given_up(true);
        assert!(at_s == IDLE_S && why.contains("no progress"), "{at_s} s: {why}");
    }
}

//! The guided steps of a calibration: rest, then press and release, taxel by taxel. Bytes, reference forces and
//! times are arguments, so a terminal, a test and a recording drive it alike.

use super::Trial;
use crate::board::{BoardMonitor, Diagnosis, MAX_ELECTRODES};
use crate::firmware::Firmware;
use crate::zero::{TARE_FRAMES, TARE_NOISE_MAX};
use moca_msgs::seconds;
use std::vec::Vec;

/// Counts below rest at which a press begins.
pub const PRESS_COUNTS: f64 = 3.0;
/// Counts below rest under which it ends.
const RELEASE_COUNTS: f64 = 1.5;
/// Share of the deepest press so far above which the next one begins, and under which it ends: a foam that has just
/// been pressed has not come back to rest.
const PRESS_SHARE: f64 = 0.3;
const RELEASE_SHARE: f64 = 0.15;
/// Frames below [`RELEASE_COUNTS`] that end a press, so that noise does not.
const RELEASE_FRAMES: u32 = 10;

/// One taxel to calibrate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// 1 is T1.
    pub number: usize,
    /// Its electrode on the board.
    pub electrode: u8,
}

/// Next action of the person.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Nothing may touch the cover.
    Rest {
        /// The taxel that comes next.
        target: Target,
        /// Frames so far, of [`TARE_FRAMES`].
        frames: u32,
    },
    /// Press the taxel slowly and release it.
    Press {
        /// Which.
        target: Target,
        /// Complete presses so far.
        presses: u32,
        /// Wanted.
        presses_wanted: u32,
        /// Counts below rest now.
        counts: f64,
        /// Reference force now, N; `None` before the first value.
        force_n: Option<f64>,
    },
    /// All taxels have been pressed.
    Done,
}

/// One taxel's measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Which taxel.
    pub target: Target,
    /// FDAT at rest, counts.
    pub rest_counts: f64,
    /// Counts beside the reference force.
    pub trial: Trial,
}

/// A calibration under way.
#[derive(Clone, Debug)]
pub struct Session {
    targets: Vec<Target>,
    presses_wanted: u32,
    monitor: BoardMonitor,
    current: usize,
    rest: Vec<f64>,
    rest_counts: Option<f64>,
    counts: Vec<(f64, u16)>,
    force: Vec<(f64, f64)>,
    pressed: bool,
    deepest: f64,
    released_frames: u32,
    presses: u32,
    measured: Vec<Measured>,
}

impl Session {
    /// A session over `targets` in order, each pressed `presses_wanted` times. A target whose electrode does not
    /// exist (48 and above) is left out.
    pub fn new(targets: &[Target], presses_wanted: u32) -> Self {
        let targets: Vec<Target> =
            targets.iter().copied().filter(|t| usize::from(t.electrode) < MAX_ELECTRODES).collect();
        Self {
            targets,
            presses_wanted: presses_wanted.max(1),
            monitor: BoardMonitor::new([true; MAX_ELECTRODES]),
            current: 0,
            rest: Vec::new(),
            rest_counts: None,
            counts: Vec::new(),
            force: Vec::new(),
            pressed: false,
            deepest: 0.0,
            released_frames: 0,
            presses: 0,
            measured: Vec::new(),
        }
    }

    /// Bytes of the board that arrived at `arrival_ns`.
    pub fn push(&mut self, bytes: &[u8], arrival_ns: u64) {
        let mut rest = bytes;
        while let Some(frame) = self.monitor.next_frame(&mut rest, arrival_ns) {
            if let Some(target) = self.targets.get(self.current).copied()
                && let Some(fdat) = frame.fdat_of(target.electrode)
            {
                self.frame(target, fdat, seconds(frame.expected_sample_ns));
            }
        }
    }

    /// A reading of the reference at `at_ns`, N. Values that are not finite or not later than the last are ignored.
    pub fn reference(&mut self, force_n: f64, at_ns: u64) {
        let time_s = seconds(at_ns);
        if force_n.is_finite() && self.force.last().is_none_or(|last| time_s > last.0) {
            self.force.push((time_s, force_n));
        }
    }

    /// Returns the next action.
    pub fn step(&self) -> Step {
        let Some(target) = self.targets.get(self.current).copied() else { return Step::Done };
        match self.rest_counts {
            None => Step::Rest { target, frames: u32::try_from(self.rest.len()).unwrap_or(u32::MAX) },
            Some(rest_counts) => Step::Press {
                target,
                presses: self.presses,
                presses_wanted: self.presses_wanted,
                counts: self.counts.last().map_or(0.0, |&(_, fdat)| rest_counts - f64::from(fdat)),
                force_n: self.force.last().map(|f| f.1),
            },
        }
    }

    /// Returns the state of the board, from its bytes, when no step advances.
    pub fn diagnosis(&self) -> Diagnosis {
        self.monitor.diagnosis()
    }

    /// The board's firmware; `None` before the first good frame.
    pub fn firmware(&self) -> Option<Firmware> {
        self.monitor.firmware()
    }

    /// Measurements so far, one for each finished taxel.
    pub fn measured(&self) -> &[Measured] {
        &self.measured
    }

    fn frame(&mut self, target: Target, fdat: u16, time_s: f64) {
        let Some(rest_counts) = self.rest_counts else {
            return self.rest_frame(f64::from(fdat));
        };
        self.counts.push((time_s, fdat));
        let drop = rest_counts - f64::from(fdat);
        self.deepest = self.deepest.max(drop);
        if drop >= f64::max(PRESS_COUNTS, PRESS_SHARE * self.deepest) {
            (self.pressed, self.released_frames) = (true, 0);
        } else if self.pressed && drop < f64::max(RELEASE_COUNTS, RELEASE_SHARE * self.deepest) {
            self.released_frames += 1;
            if self.released_frames >= RELEASE_FRAMES {
                self.pressed = false;
                self.presses += 1;
            }
        }
        if self.presses >= self.presses_wanted {
            self.finish(target, rest_counts);
        }
    }

    /// Rest is the mean of the last [`TARE_FRAMES`] frames, once they stand still.
    fn rest_frame(&mut self, fdat: f64) {
        self.rest.push(fdat);
        let wanted = usize::try_from(TARE_FRAMES).unwrap_or(usize::MAX);
        if self.rest.len() < wanted {
            return;
        }
        let count = f64::from(TARE_FRAMES);
        let mean = self.rest.iter().sum::<f64>() / count;
        let variance = self.rest.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (count - 1.0);
        if variance <= TARE_NOISE_MAX * TARE_NOISE_MAX {
            self.rest_counts = Some(mean);
            self.force.clear();
        } else {
            self.rest.clear();
        }
    }

    fn finish(&mut self, target: Target, rest_counts: f64) {
        let trial = Trial::align(&self.counts, rest_counts, &self.force);
        self.measured.push(Measured { target, rest_counts, trial });
        self.current += 1;
        self.rest.clear();
        self.rest_counts = None;
        self.counts.clear();
        self.presses = 0;
        self.deepest = 0.0;
        self.released_frames = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{ModelKind, fit};
    use crate::datastream::{Frame, emit};

    #[test]
    fn a_session_asks_for_each_taxel_and_its_trials_fit() {
        let targets = [Target { number: 1, electrode: 0 }, Target { number: 3, electrode: 2 }];
        let mut session = Session::new(&targets, 2);
        let mut steps = Vec::new();
        let (mut now_ns, mut phase) = (1_000_000_000, 0u32);
        for i in 0..6000u16 {
            let step = session.step();
            if steps.last().map(core::mem::discriminant) != Some(core::mem::discriminant(&step)) {
                steps.push(step);
            }
            let mut force_n = 0.0;
            let mut frame = Frame { filtered: [720; 13], baseline: [720; 13], ..Frame::default() };
            frame.filtered[11] = 700 + i % 7; // an electrode that nobody asked for
            match step {
                Step::Done => break,
                Step::Rest { .. } => phase = 0,
                Step::Press { target, .. } => {
                    phase += 1;
                    force_n = 50.0 * (1.0 - (f64::from(phase) * 0.02).cos());
                    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 84")]
                    let counts = (0.84 * force_n).round() as u16;
                    frame.filtered[usize::from(target.electrode)] = 720 - counts;
                }
            }
            now_ns += 24_700_000;
            let mut bytes = Vec::new();
            emit(&frame, &mut bytes);
            session.push(&bytes, now_ns);
            // the frame's data was sampled 12 ms earlier than its first line came
            session.reference(force_n, now_ns - 12_000_000);
        }
        assert_eq!(steps.len(), 5, "{steps:?}");
        assert_eq!(session.measured().iter().map(|m| m.target.number).collect::<Vec<_>>(), [1, 3]);
        for measured in session.measured() {
            assert!((measured.rest_counts - 720.0).abs() < 1e-9);
            let (_, quality) =
                fit(ModelKind::LineThroughZero, core::slice::from_ref(&measured.trial)).unwrap();
            assert!(quality.rmse_n < 0.5 && quality.force_max_n > 95.0, "{quality:?}");
        }
    }

    #[test]
    fn a_cover_that_does_not_stand_still_stays_in_rest() {
        let mut session = Session::new(&[Target { number: 1, electrode: 0 }], 1);
        for i in 0..200u16 {
            let frame = Frame { filtered: [700 + 20 * (i % 2); 13], baseline: [720; 13], ..Frame::default() };
            let mut bytes = Vec::new();
            emit(&frame, &mut bytes);
            session.push(&bytes, u64::from(i) * 24_700_000);
        }
        assert!(matches!(session.step(), Step::Rest { .. }));
    }
}

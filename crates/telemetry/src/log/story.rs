//! Story of a run: stops, touches, gaps, requests. A log holds its story so far once a minute and at its end, so that
//! nobody reads a day to hear of it.
//!
//! ```
//! use moca_msgs::{BoardFault, Fault, Mode, Sample};
//! use moca_telemetry::log::story::Story;
//! let mut story = Story::default();
//! for shown in 0..100 {
//!     let (mode, fault) = if shown < 50 { (Mode::Impedance, None) } else { (Mode::ProtectiveStop, Some(BoardFault::Lost.of(0))) };
//!     story.add(&Sample { time_ns: shown * 20_000_000, mode, fault, ..Sample::default() });
//! }
//! assert_eq!(story.stop_count, 1);
//! assert_eq!(story.stops[0].fault, Some(BoardFault::Lost.of(0)));
//! ```

use crate::audit::Asked;
use moca_msgs::{Fault, Mode, Sample, TaxelStatus, protection::ContactPhase};
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, collections::BTreeMap};

/// A longer time without a sample is a gap, ns: a log shows a sample each 20 ms.
const GAP_NS: u64 = 100_000_000;
/// Stops, and gaps, that are listed; the others are counted.
pub const LISTED: usize = 20;

/// Stop of the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stop {
    /// Its first sample, ns of loop time.
    pub begin_ns: u64,
    /// First sample after it, ns of loop time; `None` if there is none.
    pub end_ns: Option<u64>,
    /// Protective stop or fault.
    pub mode: Mode,
    /// Its cause, if a fault caused it.
    pub fault: Option<Fault>,
}

/// Force on one taxel at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Touch {
    /// Number of the taxel, 0 is T1.
    pub taxel: usize,
    /// Force, N.
    pub force_n: f64,
    /// Loop time, ns.
    pub time_ns: u64,
}

/// Requests of one client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Requests {
    /// Requests that were carried out.
    pub accepted: u64,
    /// Requests that were refused.
    pub refused: u64,
}

/// Events of a run, from the samples that its log shows. Its size is bounded but for the names of clients.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Story {
    /// The first [`LISTED`] stops.
    pub stops: Vec<Stop>,
    /// All stops.
    pub stop_count: u64,
    /// Touches: of a cover that nobody touched before.
    pub touches: u64,
    /// The largest force.
    pub largest: Option<Touch>,
    /// Touches that began at each taxel, T1 first.
    pub of_taxel: Vec<u64>,
    /// Contacts that crossed a limit.
    pub limits: u64,
    /// Begin and end of the first [`LISTED`] gaps, ns of loop time.
    pub gaps: Vec<(u64, u64)>,
    /// All gaps, and their length in all, ns.
    pub gap_count: (u64, u64),
    /// Missed ticks that the first and the last sample counted; `None` without a sample.
    pub overruns: Option<(u64, u64)>,
    /// Requests of each client.
    pub asked: BTreeMap<String, Requests>,
    /// Time and mode of the last sample, and whether the cover was touched.
    last: Option<(u64, Mode, bool)>,
}

impl Story {
    /// Returns true if no sample has been added.
    pub const fn is_empty(&self) -> bool {
        self.last.is_none()
    }

    /// Adds the next sample that the log shows.
    pub fn add(&mut self, sample: &Sample) {
        let Sample { time_ns, mode, .. } = *sample;
        if let Some((last_ns, ..)) = self.last
            && time_ns.saturating_sub(last_ns) > GAP_NS
        {
            push(&mut self.gaps, (last_ns, time_ns));
            let (count, length_ns) = self.gap_count;
            self.gap_count = (count + 1, length_ns.saturating_add(time_ns - last_ns));
        }
        if self.last.is_none_or(|(_, last, _)| last != mode) {
            self.enter(sample);
        }
        let touched = self.touch(sample);
        let crossed = sample.contact_events.iter().filter(|event| event.phase == ContactPhase::LimitCrossed);
        self.limits += crossed.count() as u64;
        let first = self.overruns.map_or(sample.overruns, |(first, _)| first);
        self.overruns = Some((first, sample.overruns));
        self.last = Some((time_ns, mode, touched));
    }

    /// Adds requests of a client.
    pub fn asked(&mut self, asked: &Asked) {
        if !asked.is_request() {
            return;
        }
        let requests = self.asked.entry(asked.who.clone()).or_default();
        *if asked.accepted { &mut requests.accepted } else { &mut requests.refused } += asked.times;
    }

    /// Adds the first sample of a mode.
    fn enter(&mut self, sample: &Sample) {
        if let Some(open) = self.stops.last_mut().filter(|stop| stop.end_ns.is_none()) {
            open.end_ns = Some(sample.time_ns);
        }
        if matches!(sample.mode, Mode::ProtectiveStop | Mode::Fault) {
            self.stop_count += 1;
            let Sample { time_ns: begin_ns, mode, fault, .. } = *sample;
            push(&mut self.stops, Stop { begin_ns, end_ns: None, mode, fault });
        }
    }

    /// Adds the readings of the cover; returns true if it is touched.
    fn touch(&mut self, sample: &Sample) -> bool {
        let forces = sample.taxels.iter().enumerate().filter(|(_, taxel)| taxel.status == TaxelStatus::Ok);
        let strongest = forces
            .filter(|(_, taxel)| taxel.force_n > 0.0 && taxel.force_n.is_finite())
            .max_by(|a, b| a.1.force_n.total_cmp(&b.1.force_n))
            .map(|(taxel, reading)| Touch { taxel, force_n: reading.force_n, time_ns: sample.time_ns });
        let Some(touch) = strongest else { return false };
        if !self.last.is_some_and(|(.., touched)| touched) {
            self.touches += 1;
            self.of_taxel.resize(self.of_taxel.len().max(touch.taxel + 1), 0);
            self.of_taxel[touch.taxel] += 1;
        }
        if self.largest.is_none_or(|largest| touch.force_n > largest.force_n) {
            self.largest = Some(touch);
        }
        true
    }
}

/// State of a story in a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Chapter<'a> {
    /// The story up to there.
    pub(super) story: Cow<'a, Story>,
    /// Bytes of the chunks up to there, by their purpose.
    pub(super) bytes: [u64; 3],
    /// Topic of each channel: some are named in the middle of a log.
    pub(super) topics: BTreeMap<u16, Cow<'a, str>>,
}

/// Lists one more, if there is room.
fn push<T>(list: &mut Vec<T>, item: T) {
    if list.len() < LISTED {
        list.push(item);
    }
}

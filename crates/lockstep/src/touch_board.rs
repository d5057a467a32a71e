//! The cover behind its Touch Boards: events from their byte sources in, a reading out. Serial ports, boards in memory
//! and a replay all fill the same rings.

use crate::board_events::BoardEvents;
use moca_control::cover::{CoverSource, CoverState};
use moca_control::robot::TAXELS;
use moca_control::supervisor::Zero;
use moca_msgs::board::Diagnosis;
use moca_msgs::{Fault, Outcome, Refusal};
use moca_tactile::board::{BoardMonitor, BoardStats};
use moca_tactile::{Cover, TareStatus};

/// Most events of one board taken in one tick: a source that babbles cannot hold the loop up. At 1 kHz this is 4 MB/s.
pub(crate) const EVENTS_PER_TICK: usize = 16;

/// The boards under the cover.
pub struct ByteCover {
    cover: Cover<TAXELS>,
    events: BoardEvents,
}

impl ByteCover {
    /// Reads what arrives in `events`.
    pub const fn new(cover: Cover<TAXELS>, events: BoardEvents) -> Self {
        Self { cover, events }
    }

    fn zero(&self) -> Zero {
        match self.cover.tare_status() {
            TareStatus::InProgress { .. } => Zero::Taring,
            _ if self.cover.zero_valid() => Zero::Valid,
            TareStatus::Refused(_) => Zero::Refused,
            TareStatus::None | TareStatus::Done(_) => Zero::Invalid,
        }
    }
}

impl CoverSource for ByteCover {
    fn read(&mut self, now_ns: u64, felt: &mut CoverState) {
        for board in 0..self.events.boards() {
            for _ in 0..EVENTS_PER_TICK {
                let Some(event) = self.events.take(board) else { break };
                self.cover.event(board, &event);
            }
            if let Some(event) = self.events.take_starved(board, now_ns) {
                self.cover.event(board, &event);
            }
        }
        self.cover.poll_into(now_ns, &mut felt.poll);
        felt.poll.fault = felt.poll.fault.filter(|fault| *fault != Fault::ZeroInvalid);
        let diagnoses = || self.cover.boards().map(BoardMonitor::diagnosis);
        let ill = diagnoses().find(|diagnosis| *diagnosis != Diagnosis::Frames);
        let frames = |of: fn(&BoardStats) -> u64| self.cover.boards().map(|board| of(board.stats())).sum();
        let slowest_hz = self.cover.boards().map(BoardMonitor::rate_hz).reduce(f64::min);
        felt.zero = self.zero();
        felt.deviation_counts = self.cover.deviation_counts();
        felt.counts = self.cover.counts();
        felt.board = ill.or_else(|| diagnoses().next()).unwrap_or_default();
        felt.frames_good = frames(|stats| stats.frames_good);
        felt.frames_bad = frames(|stats| stats.frames_bad);
        felt.rate_hz = slowest_hz.unwrap_or(0.0);
        felt.events = self.events.taken();
    }

    fn start_tare(&mut self, now_ns: u64) {
        self.cover.start_tare(now_ns);
    }

    fn mask(&mut self, taxel: usize, masked: bool) -> Outcome {
        if self.cover.set_masked(taxel, masked) { Ok(()) } else { Err(Refusal::OutOfRange) }
    }

    fn state(&self) -> Option<Cover<TAXELS>> {
        Some(self.cover.clone())
    }

    fn restore(&mut self, state: &Option<Cover<TAXELS>>) {
        if let Some(cover) = state {
            self.cover.clone_from(cover);
        }
    }
}

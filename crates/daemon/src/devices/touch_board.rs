//! The cover behind a Touch Board: events from its byte source in, a reading out. A serial port, a board in memory and
//! a replay all fill the same ring.

use crate::control::cover::{CoverSource, CoverState};
use crate::control::supervisor::Zero;
use crate::devices::board_events::BoardEvents;
use crate::robot::TAXELS;
use moca_msgs::{Fault, Outcome, Refusal};
use moca_tactile::{Cover, TareStatus};

/// Most events taken in one tick: a source that babbles cannot hold the loop up. At 1 kHz this is 4 MB/s.
const EVENTS_PER_TICK: usize = 16;

/// One board under the cover.
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
    fn read(&mut self, now_ns: u64) -> CoverState {
        for _ in 0..EVENTS_PER_TICK {
            let Some(event) = self.events.take() else { break };
            self.cover.event(0, &event);
        }
        if let Some(event) = self.events.take_starved(now_ns) {
            self.cover.event(0, &event);
        }
        let poll = self.cover.poll(now_ns);
        let board = self.cover.boards().next();
        let stats = board.map(|board| *board.stats()).unwrap_or_default();
        CoverState {
            reading: poll.reading,
            forces: poll.forces,
            early: poll.early,
            fault: poll.fault.filter(|fault| *fault != Fault::ZeroInvalid),
            zero: self.zero(),
            counts: self.cover.counts(),
            board: board.map(|board| board.diagnosis()).unwrap_or_default(),
            frames_good: stats.frames_good,
            frames_bad: stats.frames_bad,
            rate_hz: board.map_or(0.0, |board| board.rate_hz()),
            events: self.events.taken(),
        }
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

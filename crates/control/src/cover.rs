//! Source of the cover's forces for the loop.

use crate::robot::TAXELS;
use crate::supervisor::Zero;
use moca_msgs::board::Diagnosis;
use moca_msgs::{CoverReading, Outcome, Refusal, TaxelReading, TaxelStatus};
use moca_tactile::cover::EarlyContact;
use moca_tactile::{Cover, Poll};

/// The cover as the loop sees it at one tick.
#[derive(Clone, Copy, Debug)]
pub struct CoverState {
    /// Readings, forces and the present fault. A missing zero is no fault here: `zero` has it.
    pub poll: Poll<TAXELS>,
    /// State of the zero.
    pub zero: Zero,
    /// Largest standard deviation of a taxel in the zero in force, counts; 0 without one, and of a cover without counts.
    pub deviation_counts: f64,
    /// Last raw FDAT counts, T1 first.
    pub counts: [u16; TAXELS],
    /// State of a board, from its port and bytes: the first board's that does not send frames.
    pub board: Diagnosis,
    /// Good frames so far, of all boards.
    pub frames_good: u64,
    /// Rejected frames so far, of all boards.
    pub frames_bad: u64,
    /// Measured frame rate of the slowest board, Hz; 0 before it is known.
    pub rate_hz: f64,
    /// Events that the cover has taken from its sources since the start.
    pub events: u64,
}

impl CoverState {
    /// Reading of a robot without a cover: no force, no zero, no fault.
    pub const NONE: Self = Self {
        poll: Poll {
            reading: CoverReading {
                taxels: [TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; TAXELS],
                sampled_at_ns: None,
            },
            forces: Ok([0.0; TAXELS]),
            fault: None,
            early: EarlyContact::NONE,
        },
        zero: Zero::Valid,
        deviation_counts: 0.0,
        counts: [0; TAXELS],
        board: Diagnosis::NoBoard,
        frames_good: 0,
        frames_bad: 0,
        rate_hz: 0.0,
        events: 0,
    };
}

/// A source of cover readings: a board's bytes, or the simulator's true forces; `None` is a robot without a cover.
pub trait CoverSource {
    /// Takes in what has arrived until `now_ns`; `felt` becomes what the cover feels, from what it became the last time, or
    /// from [`CoverState::NONE`]. It is large: what has not changed need not be written.
    fn read(&mut self, now_ns: u64, felt: &mut CoverState);

    /// Starts measuring the zero.
    fn start_tare(&mut self, now_ns: u64);

    /// Takes a taxel (0 is T1) out of use, or back into it.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] where there is no such taxel, or no masks.
    fn mask(&mut self, _taxel: usize, _masked: bool) -> Outcome {
        Err(Refusal::OutOfRange)
    }

    /// Returns its memory for a log; `None` where no log can restore it.
    fn state(&self) -> Option<Cover<TAXELS>> {
        None
    }

    /// Goes on from where `state` was taken.
    fn restore(&mut self, _state: &Option<Cover<TAXELS>>) {}
}

impl<S: CoverSource> CoverSource for Option<S> {
    fn read(&mut self, now_ns: u64, felt: &mut CoverState) {
        if let Some(cover) = self {
            cover.read(now_ns, felt);
        }
    }

    fn start_tare(&mut self, now_ns: u64) {
        if let Some(cover) = self {
            cover.start_tare(now_ns);
        }
    }

    fn mask(&mut self, taxel: usize, masked: bool) -> Outcome {
        self.as_mut().map_or(Err(Refusal::OutOfRange), |cover| cover.mask(taxel, masked))
    }

    fn state(&self) -> Option<Cover<TAXELS>> {
        self.as_ref().and_then(S::state)
    }

    fn restore(&mut self, state: &Option<Cover<TAXELS>>) {
        if let Some(cover) = self {
            cover.restore(state);
        }
    }
}

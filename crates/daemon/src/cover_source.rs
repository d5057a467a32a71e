//! Where the loop gets the cover's forces from.

use crate::config::TAXELS;
use crate::supervisor::Zero;
use crate::tape::Copied;
use moca_msgs::board::Diagnosis;
use moca_msgs::{CoverReading, Fault, Outcome, Refusal, TaxelStatus};

/// The cover as the loop sees it at one tick.
#[derive(Clone, Copy, Debug)]
pub struct CoverState {
    /// Every taxel with its health, and the age of the data.
    pub reading: CoverReading<TAXELS>,
    /// Forces for the controller, N, or the first taxel (0 is T1) that has none.
    pub forces: Result<[f64; TAXELS], (usize, TaxelStatus)>,
    /// What is wrong with the cover now, a missing zero left out.
    pub fault: Option<Fault>,
    /// State of the zero.
    pub zero: Zero,
    /// Last raw FDAT counts, T1 first.
    pub counts: [u16; TAXELS],
    /// What the board's port and bytes say about it.
    pub board: Diagnosis,
    /// Good frames so far.
    pub frames_good: u64,
    /// Rejected frames so far.
    pub frames_bad: u64,
    /// Measured frame rate, Hz; 0 before it is known.
    pub rate_hz: f64,
}

/// A source of cover readings: a board's bytes, or the simulator's true forces.
pub trait CoverSource {
    /// Takes in what has arrived until `now_ns` and says what the cover feels.
    fn read(&mut self, now_ns: u64) -> CoverState;

    /// Starts measuring the zero.
    fn start_tare(&mut self, now_ns: u64);

    /// What the last [`CoverSource::read`] handed to a recorder.
    fn copied(&self) -> Copied {
        Copied::default()
    }

    /// Takes a taxel (0 is T1) out of use, or back into it.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] where there is no such taxel, or no masks.
    fn mask(&mut self, _taxel: usize, _masked: bool) -> Outcome {
        Err(Refusal::OutOfRange)
    }
}

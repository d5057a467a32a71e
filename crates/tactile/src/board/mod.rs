//! One board: what its port can say, what a source of frames is, and the source that reads a Touch Board.
//!
//! [`FrameSource`] is the seam for another board or skin: whatever turns bytes into [`SampledFrame`]s feeds
//! [`crate::Cover`], and with it tare, health and calibration. [`BoardMonitor`] is ours: it recognises DataStream and
//! our own firmware's line from the bytes.
//!
//! ```
//! use moca_tactile::board::{BoardMonitor, Diagnosis, MAX_ELECTRODES};
//! use moca_tactile::datastream::{Frame, emit};
//!
//! let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
//! let mut bytes = Vec::new();
//! emit(&Frame { filtered: [720; 13], baseline: [720; 13], ..Frame::default() }, &mut bytes);
//! let mut rest = bytes.as_slice();
//! let frame = board.next_frame(&mut rest, 40_000_000).expect("a whole frame");
//! assert_eq!(frame.fdat_of(11), Some(720));
//! assert_eq!(board.diagnosis(), Diagnosis::Frames);
//! ```

mod clock;
mod monitor;
mod stamped;

pub use crate::firmware::{LEAST_TRANSPORT_NS, STOCK_CHIP_AGE_WORST_NS};
pub use clock::ClockMap;
pub use monitor::BoardMonitor;

use crate::datastream::ELECTRODES;
use crate::firmware::Firmware;
use crate::touchline::BANKS;
use moca_msgs::BoardFault;
pub use moca_msgs::board::{Diagnosis, OpenFailure};

/// Most electrodes of one board.
pub const MAX_ELECTRODES: usize = BANKS * ELECTRODES;

/// No good frame for this long is a silent board, ns (a frame takes at most 25 ms).
pub const SILENT_AFTER_NS: u64 = 120_000_000;
/// A gap this long between bytes means that the host stalled: the next frame's data is as old as the gap, so it is
/// counted but not used, ns.
pub const STALL_GAP_NS: u64 = 100_000_000;
/// Longest time for which a host that did not run explains silence, ns: after it a board would have been received again.
pub const STARVED_FOR_NS: u64 = 1_000_000_000;
/// Consecutive frames with all used columns bit-identical that make a frozen board. Noise of 0.7 count makes this less
/// likely than once in 10 h for a single taxel, and never for two.
pub const FROZEN_FRAMES: u32 = 14;
/// Least time that they span with our own firmware, ns: it sends far more frames.
pub const FROZEN_AFTER_NS: u64 = 130_000_000;
/// End of the `TOUCH` line after the board's I²C read of the chip's data, ns: the same for every known sketch.
pub const TOUCH_LINE_AFTER_READ_NS: u64 = 2_000_000;
/// Mean age of FDAT at that read on a stock board, ns: half of the 10 ms averaging window and half of the 10 ms between
/// refreshes.
pub const STOCK_CHIP_AGE_MEAN_NS: u64 = 10_000_000;
/// Bytes of one read, with room for the largest a port gives at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// When the read returned, ns of loop time.
    pub arrival_ns: u64,
    len: u16,
    bytes: [u8; Chunk::CAPACITY],
}

impl Chunk {
    /// Most bytes in one chunk.
    pub const CAPACITY: usize = 256;

    /// Copies the first [`Chunk::CAPACITY`] bytes; give the rest to the next chunk.
    pub fn new(arrival_ns: u64, bytes: &[u8]) -> Self {
        let taken = &bytes[..bytes.len().min(Self::CAPACITY)];
        let mut chunk = Self { arrival_ns, len: 0, bytes: [0; Self::CAPACITY] };
        chunk.bytes[..taken.len()].copy_from_slice(taken);
        chunk.len = u16::try_from(taken.len()).unwrap_or(0);
        chunk
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }
}

/// Why an open port closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloseReason {
    /// The device vanished: unplugged, or the board lost power.
    Disconnected,
    /// The reader was told to stop.
    Stopped,
}

/// Event of one board's byte source. A serial port, a board in memory and a replay all send these.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(clippy::large_enum_variant, reason = "fixed-size element of a ring between threads")]
pub enum BoardEvent {
    /// The port is open. Zero and gain are invalid from here until the next tare.
    Opened {
        /// ns of loop time.
        at_ns: u64,
    },
    /// Bytes.
    Bytes(Chunk),
    /// The ring was full and bytes were dropped here.
    Gap {
        /// ns of loop time.
        at_ns: u64,
        /// Number of lost bytes.
        bytes_lost: u64,
    },
    /// The port closed.
    Closed {
        /// ns of loop time.
        at_ns: u64,
        /// Why.
        why: CloseReason,
    },
    /// The port could not be opened; the source tries again, less and less often.
    OpenFailed {
        /// ns of loop time.
        at_ns: u64,
        /// Why.
        why: OpenFailure,
    },
    /// The host did not run the threads that bring the bytes, or left the bytes lying: silence is not the board's.
    Starved {
        /// ns of loop time.
        at_ns: u64,
    },
}

/// Counts since the start; never reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BoardStats {
    /// Bytes taken.
    pub bytes: u64,
    /// Frames that passed every check.
    pub frames_good: u64,
    /// Frames that failed one.
    pub frames_bad: u64,
    /// Gaps of more than [`STALL_GAP_NS`] between bytes.
    pub stalls: u64,
    /// Good frames not used, because a stall made their age unknown.
    pub frames_discarded: u64,
    /// Frames that never came, by the gaps in their sequence; a stock board has none.
    pub frames_lost: u64,
    /// Bytes lost on the way to the loop.
    pub bytes_lost: u64,
    /// Times the port opened.
    pub connections: u64,
}

/// Frames of one group of twelve electrodes that may be used, and when their data was sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampledFrame {
    /// Which group: electrodes 12·bank to 12·bank + 11 of the board. A stock board has bank 0 alone.
    pub bank: u8,
    /// FDAT of the electrodes.
    pub fdat: [u16; ELECTRODES],
    /// Baseline of the electrodes, counts; it tells a tare that somebody touches.
    pub baseline: [u16; ELECTRODES],
    /// The earliest time at which the chip can have sampled it (middle of its window), ns of loop time.
    pub sampled_at_ns: u64,
    /// When it most likely sampled it, ns of loop time: for lining it up with a reference.
    pub expected_sample_ns: u64,
    /// When the frame was complete, ns of loop time.
    pub complete_ns: u64,
}

impl SampledFrame {
    /// FDAT of an electrode of the board (0–47), if this frame has it.
    pub fn fdat_of(&self, electrode: u8) -> Option<u16> {
        let (bank, own) = (usize::from(electrode) / ELECTRODES, usize::from(electrode) % ELECTRODES);
        (bank == usize::from(self.bank)).then(|| self.fdat[own])
    }
}

/// FDAT of a frame that is not complete: nothing has confirmed it, so it may slow a robot down and nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EarlyFrame {
    /// As in [`SampledFrame::bank`].
    pub bank: u8,
    /// FDAT of the electrodes.
    pub fdat: [u16; ELECTRODES],
    /// As in [`SampledFrame::sampled_at_ns`].
    pub sampled_at_ns: u64,
}

/// Source of a cover's frames: events of one board's port in, frames and faults out. No clock, no port: bytes and times are
/// arguments.
///
/// A skin of one's own implements `next_frame` and `fault`; the rest has defaults.
///
/// ```
/// use moca_tactile::board::{BoardEvent, FrameSource, SampledFrame};
/// use moca_tactile::{Cover, CoverConfig};
/// use moca_msgs::BoardFault;
///
/// /// Twelve bytes a frame: FDAT / 4.
/// #[derive(Default)]
/// struct Skin { last_ns: Option<u64> }
///
/// impl FrameSource for Skin {
///     fn next_frame(&mut self, bytes: &mut &[u8], arrival_ns: u64) -> Option<SampledFrame> {
///         let (frame, rest) = bytes.split_at_checked(12)?;
///         *bytes = rest;
///         self.last_ns = Some(arrival_ns);
///         let fdat = std::array::from_fn(|e| 4 * u16::from(frame[e]));
///         let sampled_at_ns = arrival_ns.saturating_sub(2_000_000);
///         Some(SampledFrame {
///             bank: 0, fdat, baseline: fdat, sampled_at_ns, expected_sample_ns: sampled_at_ns, complete_ns: arrival_ns,
///         })
///     }
///     fn fault(&self, now_ns: u64) -> Option<BoardFault> {
///         (now_ns > self.last_ns.unwrap_or(0) + 50_000_000).then_some(BoardFault::Silent)
///     }
/// }
///
/// let mut cover = Cover::<3, Skin>::with_sources(CoverConfig::default(), |_, _| Skin::default())?;
/// cover.start_tare(0);
/// for i in 1..100u64 {
///     cover.push(0, &[180; 12], i * 10_000_000);
/// }
/// assert!(cover.poll(990_000_000).forces.is_ok());
/// # Ok::<(), moca_tactile::cover::CoverConfigError>(())
/// ```
pub trait FrameSource {
    /// The next usable frame in `bytes`, which arrived at `arrival_ns`; call until it gives none.
    fn next_frame(&mut self, bytes: &mut &[u8], arrival_ns: u64) -> Option<SampledFrame>;

    /// Returns the most severe fault of the stream at `now_ns`.
    fn fault(&self, now_ns: u64) -> Option<BoardFault>;

    /// Takes an event of the port other than bytes.
    fn event(&mut self, _event: &BoardEvent) {}

    /// Returns the firmware of the board, once it is known: a calibration is bound to it.
    fn firmware(&self) -> Option<Firmware> {
        None
    }

    /// FDAT of a frame under way, once its values are there and before the frame is complete.
    fn early(&self) -> Option<EarlyFrame> {
        None
    }
}

/// Returns true if `fault` means that chip or board restarted or cannot be trusted, so that its zero is void.
pub const fn voids_zero(fault: BoardFault) -> bool {
    matches!(
        fault,
        BoardFault::Lost | BoardFault::Reset | BoardFault::Frozen | BoardFault::Thresholds | BoardFault::Chip
    )
}

//! One board: what its port can say, and a monitor that finds faults of the stream in frames and arrival times.
//!
//! A frozen, reset or reconfigured chip sends well-formed frames: these faults are found across frames.

use crate::datastream::{
    BadFrame, ELECTRODES, Event, ForeignText, Frame, Parser, SketchGeneration, StampedFrame,
};
use moca_msgs::Fault;
pub use moca_msgs::board::{Diagnosis, OpenFailure};

/// No good frame for this long is a silent board, ns (a frame takes at most 25 ms).
pub const SILENT_AFTER_NS: u64 = 120_000_000;
/// A gap this long between bytes means that the host stalled: the next frame's data is as old as the gap, so it is
/// counted but not used, ns.
pub const STALL_GAP_NS: u64 = 100_000_000;
/// How long a host that did not run is to blame for silence, ns: then a board would have been heard again.
pub const STARVED_FOR_NS: u64 = 1_000_000_000;
/// Consecutive frames with all used columns bit-identical that make a frozen board. Noise of 0.7 count makes this
/// less likely than once in 10 h for a single taxel, and never for two.
pub const FROZEN_FRAMES: u32 = 14;
/// End of the `TOUCH` line after the board's I²C read of the chip's data, ns: the same for every known sketch.
pub const TOUCH_LINE_AFTER_READ_NS: u64 = 2_000_000;
/// Mean age of FDAT at that read, ns: half of the 10 ms averaging window and half of the 10 ms between refreshes.
/// The true value lies between 5 and 15 ms.
pub const CHIP_FILTER_AGE_NS: u64 = 10_000_000;
/// Between `TOUCH` and `RTHS` the newer sketch reads 26 thresholds over I²C (12 ms), the older one none (4 ms).
const THRESHOLD_READ_NS: u64 = 8_000_000;
/// This many bytes hold at least one whole frame, if they are DataStream's.
const UNKNOWN_AFTER_BYTES: u32 = 1200;
/// Intervals in the running mean of the frame period.
const RATE_INTERVALS: f64 = 16.0;

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

/// What one board's byte source says. A serial port, a board in memory and a replay all speak this.
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
        /// How many.
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
    /// Bytes lost on the way to the loop.
    pub bytes_lost: u64,
    /// Times the port opened.
    pub connections: u64,
}

/// Parser, arrival times and stream faults of one board.
#[derive(Clone, Debug)]
pub struct BoardMonitor {
    parser: Parser,
    used: [bool; ELECTRODES],
    stats: BoardStats,
    diagnosis: Diagnosis,
    connected: bool,
    last_byte_ns: Option<u64>,
    last_good_ns: Option<u64>,
    stalled: bool,
    starved_ns: Option<u64>,
    mean_period_ns: f64,
    intervals: u32,
    generation: Option<SketchGeneration>,
    thresholds: Option<([u8; 13], [u8; 13])>,
    thresholds_changed: bool,
    last: Option<Frame>,
    identical: u32,
    all_zero: bool,
    last_bad: Option<BadFrame>,
    bytes_without_frame: u32,
}

/// One good frame that may be used, and when its data was sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampledFrame {
    /// FDAT of the electrodes.
    pub fdat: [u16; ELECTRODES],
    /// BVAL of the electrodes.
    pub baseline: [u16; ELECTRODES],
    /// When the chip sampled it, ns of loop time (± 5 ms: the chip's refresh is not synchronous to the read).
    pub sampled_at_ns: u64,
    /// When the frame was complete, ns of loop time.
    pub complete_ns: u64,
}

impl BoardMonitor {
    /// A board whose `used` electrodes carry taxels. It counts as connected until an event says otherwise, so a
    /// source without ports (memory, replay) need only push bytes.
    pub const fn new(used: [bool; ELECTRODES]) -> Self {
        Self {
            parser: Parser::new(),
            used,
            stats: BoardStats {
                bytes: 0,
                frames_good: 0,
                frames_bad: 0,
                stalls: 0,
                frames_discarded: 0,
                bytes_lost: 0,
                connections: 0,
            },
            diagnosis: Diagnosis::Silent,
            connected: true,
            last_byte_ns: None,
            last_good_ns: None,
            stalled: false,
            starved_ns: None,
            mean_period_ns: 0.0,
            intervals: 0,
            generation: None,
            thresholds: None,
            thresholds_changed: false,
            last: None,
            identical: 0,
            all_zero: false,
            last_bad: None,
            bytes_without_frame: 0,
        }
    }

    /// The next usable frame in `bytes`, which arrived at `arrival_ns`; call until `bytes` is empty.
    pub fn next_frame(&mut self, bytes: &mut &[u8], arrival_ns: u64) -> Option<SampledFrame> {
        if !bytes.is_empty() {
            let gap_ns = self.last_byte_ns.map_or(0, |last| arrival_ns.saturating_sub(last));
            if gap_ns > STALL_GAP_NS {
                self.stats.stalls += 1;
                self.stalled = true;
            }
            self.last_byte_ns = Some(arrival_ns);
            self.stats.bytes += u64::try_from(bytes.len()).unwrap_or(u64::MAX);
            self.bytes_without_frame =
                self.bytes_without_frame.saturating_add(u32::try_from(bytes.len()).unwrap_or(u32::MAX));
        }
        while let Some(event) = self.parser.next_event(bytes, arrival_ns) {
            match event {
                Event::Frame(stamped) => {
                    if let Some(frame) = self.good(&stamped) {
                        return Some(frame);
                    }
                }
                Event::Bad(why) => self.bad(why),
                Event::Foreign(text) => self.foreign(text),
            }
        }
        None
    }

    /// The port opened: everything known about the board before is void.
    pub fn opened(&mut self) {
        let stats = BoardStats { connections: self.stats.connections + 1, ..self.stats };
        *self = Self { stats, ..Self::new(self.used) };
    }

    /// The port closed.
    pub fn closed(&mut self) {
        self.connected = false;
        self.diagnosis = Diagnosis::Disconnected;
        self.parser.resynchronise();
    }

    /// The port could not be opened.
    pub fn open_failed(&mut self, why: OpenFailure) {
        self.connected = false;
        self.diagnosis = Diagnosis::NotOpen(why);
    }

    /// Bytes were lost before the next chunk: whatever frame they belonged to is incomplete, and none of it is used.
    pub fn gap(&mut self, bytes_lost: u64) {
        self.stats.bytes_lost += bytes_lost;
        self.parser.resynchronise();
        self.stalled = true;
    }

    /// The host does not run, or does not read: silence is its own for [`STARVED_FOR_NS`] from then on, or until the
    /// next good frame.
    pub const fn starved(&mut self, at_ns: u64) {
        self.starved_ns = Some(at_ns);
    }

    /// The stream's fault at `now_ns`, the gravest first. Silence counts from the last good frame, or from loop
    /// time 0.
    pub fn fault(&self, now_ns: u64) -> Option<Fault> {
        if !self.connected {
            Some(Fault::BoardLost)
        } else if now_ns.saturating_sub(self.last_good_ns.unwrap_or(0)) > SILENT_AFTER_NS {
            let starved = self.starved_ns.is_some_and(|at_ns| now_ns.saturating_sub(at_ns) <= STARVED_FOR_NS);
            Some(if starved { Fault::HostStarved } else { Fault::BoardSilent })
        } else if self.is_all_zero() {
            Some(Fault::BoardReset)
        } else if self.is_frozen() {
            Some(Fault::BoardFrozen)
        } else if self.thresholds_changed {
            Some(Fault::BoardThresholds)
        } else {
            None
        }
    }

    /// Whether `fault` means that chip or board restarted or cannot be trusted, so that its zero is void.
    pub const fn voids_zero(fault: Fault) -> bool {
        matches!(fault, Fault::BoardLost | Fault::BoardReset | Fault::BoardFrozen | Fault::BoardThresholds)
    }

    /// Counts since the start.
    pub const fn stats(&self) -> &BoardStats {
        &self.stats
    }

    /// What the bytes so far say about the board.
    pub const fn diagnosis(&self) -> Diagnosis {
        match self.diagnosis {
            Diagnosis::Silent if self.bytes_without_frame > UNKNOWN_AFTER_BYTES => Diagnosis::Unknown,
            known => known,
        }
    }

    /// Measured frame rate, Hz: running mean over good frames, gaps left out; 0 before two frames came.
    pub fn rate_hz(&self) -> f64 {
        if self.intervals == 0 { 0.0 } else { 1e9 / self.mean_period_ns }
    }

    /// The sketch's generation, from column count and line spacing; `None` before the first good frame.
    pub const fn generation(&self) -> Option<SketchGeneration> {
        self.generation
    }

    /// Every FDAT of the last good frame is 0.
    pub const fn is_all_zero(&self) -> bool {
        self.all_zero
    }

    /// [`FROZEN_FRAMES`] frames in a row were identical in the used columns.
    pub const fn is_frozen(&self) -> bool {
        self.identical + 1 >= FROZEN_FRAMES
    }

    /// The last good frame's thresholds differ from the first one's.
    pub const fn thresholds_changed(&self) -> bool {
        self.thresholds_changed
    }

    /// Columns of a line, 12 or 13; `None` before the first good frame.
    pub fn columns(&self) -> Option<u8> {
        self.last.map(|frame| frame.dialect.columns)
    }

    /// Why the last bad frame was rejected.
    pub const fn last_bad(&self) -> Option<BadFrame> {
        self.last_bad
    }

    /// Consecutive frames whose used FDAT columns equal their predecessor's.
    pub const fn identical_frames(&self) -> u32 {
        self.identical
    }

    fn good(&mut self, stamped: &StampedFrame) -> Option<SampledFrame> {
        self.stats.frames_good += 1;
        self.diagnosis = Diagnosis::Frames;
        self.bytes_without_frame = 0;
        let frame = &stamped.frame;
        self.measure_rate(stamped);
        self.check_across_frames(frame);
        self.last = Some(*frame);
        self.last_good_ns = Some(stamped.complete_ns);
        self.starved_ns = None;
        if self.stalled {
            self.stalled = false;
            self.stats.frames_discarded += 1;
            return None;
        }
        Some(SampledFrame {
            fdat: core::array::from_fn(|e| frame.filtered[e]),
            baseline: core::array::from_fn(|e| frame.baseline[e]),
            sampled_at_ns: stamped
                .touch_line_ns
                .saturating_sub(TOUCH_LINE_AFTER_READ_NS + CHIP_FILTER_AGE_NS),
            complete_ns: stamped.complete_ns,
        })
    }

    fn measure_rate(&mut self, stamped: &StampedFrame) {
        if let Some(last_ns) = self.last_good_ns {
            let interval_ns = stamped.complete_ns.saturating_sub(last_ns);
            if interval_ns > 0 && interval_ns < STALL_GAP_NS && !self.stalled {
                self.intervals = self.intervals.saturating_add(1);
                let weight = 1.0 / f64::from(self.intervals).min(RATE_INTERVALS);
                #[expect(clippy::cast_precision_loss, reason = "below 100 ms")]
                let interval_ns = interval_ns as f64;
                self.mean_period_ns += weight * (interval_ns - self.mean_period_ns);
            }
        }
        if self.generation.is_none() {
            let spacing_ns = stamped.thresholds_line_ns.saturating_sub(stamped.touch_line_ns);
            self.generation = Some(if stamped.frame.dialect.columns == 12 {
                SketchGeneration::PiCap
            } else if spacing_ns > THRESHOLD_READ_NS {
                SketchGeneration::From2018
            } else {
                SketchGeneration::From2015
            });
        }
    }

    fn check_across_frames(&mut self, frame: &Frame) {
        self.all_zero = frame.filtered[..ELECTRODES].iter().all(|&v| v == 0);
        let thresholds = (frame.touch_threshold, frame.release_threshold);
        let reference = *self.thresholds.get_or_insert(thresholds);
        self.thresholds_changed = thresholds != reference;
        let identical = self.last.is_some_and(|last| {
            (0..ELECTRODES).all(|e| !self.used[e] || last.filtered[e] == frame.filtered[e])
        });
        self.identical = if identical { (self.identical + 1).min(u32::MAX / 2) } else { 0 };
    }

    fn bad(&mut self, why: BadFrame) {
        self.stats.frames_bad += 1;
        self.last_bad = Some(why);
    }

    fn foreign(&mut self, text: ForeignText) {
        self.diagnosis = match (text, self.diagnosis) {
            (ForeignText::TouchEvents, _) => Diagnosis::WrongSketch,
            (ForeignText::ChipInitFailed, _) => Diagnosis::ChipInitFailed,
            (ForeignText::Other, Diagnosis::Silent) => Diagnosis::Unknown,
            (ForeignText::Other, known) => known,
        };
    }
}

//! The reader of a Touch Board, whatever firmware runs on it: frames out of bytes, faults out of frames and their times.
//!
//! A frozen, reset or reconfigured chip sends well-formed stock frames: these faults are found across frames. Our own
//! firmware says so itself.

use super::stamped::StampedLines;
use super::{
    BoardEvent, BoardStats, EarlyFrame, FROZEN_FRAMES, FrameSource, MAX_ELECTRODES, SILENT_AFTER_NS,
    STALL_GAP_NS, STARVED_FOR_NS, STOCK_CHIP_AGE_MEAN_NS, STOCK_CHIP_AGE_WORST_NS, SampledFrame,
    TOUCH_LINE_AFTER_READ_NS,
};
use crate::datastream::{Assembler, BadFrame, ELECTRODES, Event, ForeignText, Frame, StampedFrame};
use crate::firmware::Firmware;
use crate::lines::{Cut, LineCutter};
use crate::touchline::{self, Flags};
use moca_msgs::BoardFault;
use moca_msgs::board::{Diagnosis, OpenFailure};

/// Between `TOUCH` and `RTHS` the newer stock sketch reads 26 thresholds over I²C (12 ms), the older one none (4 ms).
const THRESHOLD_READ_NS: u64 = 8_000_000;
/// This many bytes hold at least one whole frame, if they are a known firmware's.
const UNKNOWN_AFTER_BYTES: u32 = 1200;
/// Intervals in the running mean of the frame period.
const RATE_INTERVALS: f64 = 16.0;

/// Reader of one board, from bytes to frames and faults.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BoardMonitor {
    cutter: LineCutter,
    reader: Reader,
}

#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Reader {
    assembler: Assembler,
    stamped: StampedLines,
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    used: [bool; MAX_ELECTRODES],
    stats: BoardStats,
    diagnosis: Diagnosis,
    connected: bool,
    last_byte_ns: Option<u64>,
    last_good_ns: Option<u64>,
    last_refresh_ns: Option<u64>,
    stalled: bool,
    starved_ns: Option<u64>,
    mean_period_ns: f64,
    intervals: u32,
    firmware: Option<Firmware>,
    thresholds: Option<([u8; 13], [u8; 13])>,
    thresholds_changed: bool,
    last: Option<Frame>,
    identical: u32,
    all_zero: bool,
    last_bad: Option<BadFrame>,
    bytes_without_frame: u32,
}

impl BoardMonitor {
    /// A board whose `used` electrodes carry taxels. It counts as connected until an event says otherwise, so a
    /// source without ports (memory, replay) need only push bytes.
    pub fn new(used: [bool; MAX_ELECTRODES]) -> Self {
        Self { cutter: LineCutter::new(), reader: Reader::new(used) }
    }

    /// The next usable frame in `bytes`, which arrived at `arrival_ns`; call until `bytes` is empty.
    pub fn next_frame(&mut self, bytes: &mut &[u8], arrival_ns: u64) -> Option<SampledFrame> {
        self.reader.count_bytes(bytes.len(), arrival_ns);
        while let Some(cut) = self.cutter.next_line(bytes) {
            if let Some(frame) = self.reader.take(cut, arrival_ns) {
                return Some(frame);
            }
        }
        None
    }

    /// The port opened: everything known about the board before is void.
    pub fn opened(&mut self) {
        let stats = BoardStats { connections: self.stats().connections + 1, ..*self.stats() };
        *self = Self::new(self.reader.used);
        self.reader.stats = stats;
    }

    /// The port closed.
    pub fn closed(&mut self) {
        self.reader.connected = false;
        self.reader.diagnosis = Diagnosis::Disconnected;
        self.resynchronise();
    }

    /// The port could not be opened.
    pub fn open_failed(&mut self, why: OpenFailure) {
        self.reader.connected = false;
        self.reader.diagnosis = Diagnosis::NotOpen(why);
    }

    /// Bytes were lost before the next chunk: whatever frame they belonged to is incomplete, and none of it is used.
    pub fn gap(&mut self, bytes_lost: u64) {
        self.reader.stats.bytes_lost += bytes_lost;
        self.resynchronise();
        self.reader.stalled = true;
    }

    /// The host does not run, or does not read: silence is its own for [`STARVED_FOR_NS`] from then on, or until the
    /// next good frame.
    pub const fn starved(&mut self, at_ns: u64) {
        self.reader.starved_ns = Some(at_ns);
    }

    fn resynchronise(&mut self) {
        self.cutter.resynchronise();
        self.reader.assembler.resynchronise();
    }

    /// The stream's fault at `now_ns`, the gravest first. Silence counts from the last good frame of the chip that has
    /// been silent longest, or from loop time 0.
    pub fn fault(&self, now_ns: u64) -> Option<BoardFault> {
        self.reader.fault(now_ns)
    }

    /// Counts since the start.
    pub const fn stats(&self) -> &BoardStats {
        &self.reader.stats
    }

    /// Returns the state of the board, from its bytes so far.
    pub const fn diagnosis(&self) -> Diagnosis {
        match self.reader.diagnosis {
            Diagnosis::Silent if self.reader.bytes_without_frame > UNKNOWN_AFTER_BYTES => Diagnosis::Unknown,
            known => known,
        }
    }

    /// Measured frame rate, Hz: running mean over good frames, gaps left out; 0 before two frames came. Of our own
    /// firmware: refreshes of all its chips.
    pub fn rate_hz(&self) -> f64 {
        if self.reader.intervals == 0 { 0.0 } else { 1e9 / self.reader.mean_period_ns }
    }

    /// Returns the firmware of the board, from its lines; `None` before the first good frame.
    pub const fn firmware(&self) -> Option<Firmware> {
        self.reader.firmware
    }

    /// Every FDAT of the last good stock frame is 0.
    pub const fn is_all_zero(&self) -> bool {
        self.reader.all_zero
    }

    /// [`FROZEN_FRAMES`] stock frames in a row were identical in the used columns.
    pub const fn is_frozen(&self) -> bool {
        self.reader.is_frozen()
    }

    /// The last good stock frame's thresholds differ from the first one's.
    pub const fn thresholds_changed(&self) -> bool {
        self.reader.thresholds_changed
    }

    /// Columns of a stock line, 12 or 13; `None` before the first good frame.
    pub fn columns(&self) -> Option<u8> {
        self.reader.last.map(|frame| frame.dialect.columns)
    }

    /// Why the last bad frame was rejected.
    pub const fn last_bad(&self) -> Option<BadFrame> {
        self.reader.last_bad
    }

    /// Consecutive stock frames whose used FDAT columns equal their predecessor's.
    pub const fn identical_frames(&self) -> u32 {
        self.reader.identical
    }

    /// Returns the flags of our own firmware over all chips; empty for a stock board.
    pub fn flags(&self) -> Flags {
        self.reader.stamped.flags()
    }

    /// Chips that have been heard: 1 to 4; 0 for a stock board.
    pub fn chips(&self) -> usize {
        self.reader.stamped.chips()
    }
}

impl FrameSource for BoardMonitor {
    fn next_frame(&mut self, bytes: &mut &[u8], arrival_ns: u64) -> Option<SampledFrame> {
        self.next_frame(bytes, arrival_ns)
    }

    fn fault(&self, now_ns: u64) -> Option<BoardFault> {
        self.fault(now_ns)
    }

    fn event(&mut self, event: &BoardEvent) {
        match *event {
            BoardEvent::Opened { .. } => self.opened(),
            BoardEvent::Closed { .. } => self.closed(),
            BoardEvent::OpenFailed { why, .. } => self.open_failed(why),
            BoardEvent::Gap { bytes_lost, .. } => self.gap(bytes_lost),
            BoardEvent::Starved { at_ns } => self.starved(at_ns),
            BoardEvent::Bytes(_) => {}
        }
    }

    fn firmware(&self) -> Option<Firmware> {
        self.firmware()
    }

    fn early(&self) -> Option<EarlyFrame> {
        let (filtered, touch_line_ns) = self.reader.assembler.filtered()?;
        let usable = !self.reader.stalled && self.reader.last_good_ns.is_some();
        usable.then(|| EarlyFrame {
            bank: 0,
            fdat: core::array::from_fn(|e| filtered[e]),
            sampled_at_ns: touch_line_ns.saturating_sub(TOUCH_LINE_AFTER_READ_NS + STOCK_CHIP_AGE_WORST_NS),
        })
    }
}

impl Reader {
    fn new(used: [bool; MAX_ELECTRODES]) -> Self {
        Self {
            assembler: Assembler::new(),
            stamped: StampedLines::default(),
            used,
            stats: BoardStats::default(),
            diagnosis: Diagnosis::Silent,
            connected: true,
            last_byte_ns: None,
            last_good_ns: None,
            last_refresh_ns: None,
            stalled: false,
            starved_ns: None,
            mean_period_ns: 0.0,
            intervals: 0,
            firmware: None,
            thresholds: None,
            thresholds_changed: false,
            last: None,
            identical: 0,
            all_zero: false,
            last_bad: None,
            bytes_without_frame: 0,
        }
    }

    fn count_bytes(&mut self, count: usize, arrival_ns: u64) {
        if count == 0 {
            return;
        }
        let gap_ns = self.last_byte_ns.map_or(0, |last| arrival_ns.saturating_sub(last));
        if gap_ns > STALL_GAP_NS {
            self.stats.stalls += 1;
            self.stalled = true;
        }
        self.last_byte_ns = Some(arrival_ns);
        self.stats.bytes += u64::try_from(count).unwrap_or(u64::MAX);
        self.bytes_without_frame =
            self.bytes_without_frame.saturating_add(u32::try_from(count).unwrap_or(u32::MAX));
    }

    fn fault(&self, now_ns: u64) -> Option<BoardFault> {
        let last_ns = self.stamped.oldest_line_ns().or(self.last_good_ns).unwrap_or(0);
        if !self.connected {
            Some(BoardFault::Lost)
        } else if now_ns.saturating_sub(last_ns) > SILENT_AFTER_NS {
            let starved = self.starved_ns.is_some_and(|at_ns| now_ns.saturating_sub(at_ns) <= STARVED_FOR_NS);
            Some(if starved { BoardFault::HostStarved } else { BoardFault::Silent })
        } else if self.all_zero {
            Some(BoardFault::Reset)
        } else if self.is_frozen() {
            Some(BoardFault::Frozen)
        } else if self.thresholds_changed {
            Some(BoardFault::Thresholds)
        } else {
            self.stamped.fault()
        }
    }

    const fn is_frozen(&self) -> bool {
        self.identical + 1 >= FROZEN_FRAMES
    }

    /// One line of whichever dialect it is.
    fn take(&mut self, cut: Cut<'_>, arrival_ns: u64) -> Option<SampledFrame> {
        if let Cut::Line(line) = cut {
            if touchline::looks_like(line) {
                return match touchline::parse(line) {
                    Ok(line) => self.stamped_line(&line, arrival_ns),
                    Err(_) => self.bad(BadFrame::Damaged),
                };
            }
            if touchline::is_note(line) {
                self.diagnosis = match self.diagnosis {
                    Diagnosis::Frames => Diagnosis::Frames,
                    _ => Diagnosis::Silent,
                };
                return None;
            }
        }
        if self.firmware == Some(Firmware::Moca) {
            if matches!(cut, Cut::Line(line) if line.starts_with(b"TOUCH: ")) {
                // The same board was told to speak DataStream.
                *self = Self { stats: self.stats, last_byte_ns: self.last_byte_ns, ..Self::new(self.used) };
            } else if matches!(cut, Cut::Line([] | [b'#', ..])) {
                return None;
            } else {
                return self.bad(BadFrame::Damaged);
            }
        }
        match self.assembler.take(cut, arrival_ns)? {
            Event::Frame(stamped) => self.good(&stamped),
            Event::Bad(why) => self.bad(why),
            Event::Foreign(text) => self.foreign(text),
        }
    }

    fn stamped_line(&mut self, line: &touchline::Line, arrival_ns: u64) -> Option<SampledFrame> {
        if self.firmware != Some(Firmware::Moca) {
            *self = Self { stats: self.stats, last_byte_ns: self.last_byte_ns, ..Self::new(self.used) };
            self.firmware = Some(Firmware::Moca);
        }
        // The stamps say how old the data is, also after a stall.
        self.stalled = false;
        self.diagnosis = Diagnosis::Frames;
        self.bytes_without_frame = 0;
        let Ok(taken) = self.stamped.take(line, arrival_ns, &self.used) else {
            return self.bad(BadFrame::Repeated);
        };
        self.last_good_ns = Some(arrival_ns);
        self.starved_ns = None;
        let taken = taken?;
        self.stats.frames_good += 1;
        self.stats.frames_lost += u64::from(taken.lost);
        if taken.refresh {
            self.measure_rate(arrival_ns);
        }
        if taken.frame.is_none() {
            self.stats.frames_discarded += 1;
        }
        taken.frame
    }

    fn good(&mut self, stamped: &StampedFrame) -> Option<SampledFrame> {
        self.stats.frames_good += 1;
        self.diagnosis = Diagnosis::Frames;
        self.bytes_without_frame = 0;
        let frame = &stamped.frame;
        self.measure_rate(stamped.complete_ns);
        self.recognise(stamped);
        self.check_across_frames(frame);
        self.last = Some(*frame);
        self.last_good_ns = Some(stamped.complete_ns);
        self.starved_ns = None;
        if self.stalled {
            self.stalled = false;
            self.stats.frames_discarded += 1;
            return None;
        }
        let read_ns = stamped.touch_line_ns.saturating_sub(TOUCH_LINE_AFTER_READ_NS);
        Some(SampledFrame {
            bank: 0,
            fdat: core::array::from_fn(|e| frame.filtered[e]),
            baseline: core::array::from_fn(|e| frame.baseline[e]),
            sampled_at_ns: read_ns.saturating_sub(STOCK_CHIP_AGE_WORST_NS),
            expected_sample_ns: read_ns.saturating_sub(STOCK_CHIP_AGE_MEAN_NS),
            complete_ns: stamped.complete_ns,
        })
    }

    fn measure_rate(&mut self, complete_ns: u64) {
        let last_ns = self.last_refresh_ns.replace(complete_ns);
        let interval_ns = last_ns.map_or(0, |last_ns| complete_ns.saturating_sub(last_ns));
        if interval_ns > 0 && interval_ns < STALL_GAP_NS && !self.stalled {
            self.intervals = self.intervals.saturating_add(1);
            let weight = 1.0 / f64::from(self.intervals).min(RATE_INTERVALS);
            #[expect(clippy::cast_precision_loss, reason = "below 100 ms")]
            let interval_ns = interval_ns as f64;
            self.mean_period_ns += weight * (interval_ns - self.mean_period_ns);
        }
    }

    fn recognise(&mut self, stamped: &StampedFrame) {
        if self.firmware.is_none() {
            let spacing_ns = stamped.thresholds_line_ns.saturating_sub(stamped.touch_line_ns);
            self.firmware = Some(if stamped.frame.dialect.columns == 12 {
                Firmware::PiCap
            } else if spacing_ns > THRESHOLD_READ_NS {
                Firmware::Stock2018
            } else {
                Firmware::Stock2015
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

    fn bad(&mut self, why: BadFrame) -> Option<SampledFrame> {
        self.stats.frames_bad += 1;
        self.last_bad = Some(why);
        None
    }

    fn foreign(&mut self, text: ForeignText) -> Option<SampledFrame> {
        self.diagnosis = match (text, self.diagnosis) {
            (ForeignText::TouchEvents, _) => Diagnosis::WrongSketch,
            (ForeignText::ChipInitFailed, _) => Diagnosis::ChipInitFailed,
            (ForeignText::Other, Diagnosis::Silent) => Diagnosis::Unknown,
            (ForeignText::Other, known) => known,
        };
        None
    }
}

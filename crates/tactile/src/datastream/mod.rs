//! The text stream of Bare Conductive's DataStream sketch: [`Parser`] reads bytes in any chunking, [`emit`] is its
//! exact inverse for every frame that passes the checks.
//!
//! One frame is six lines in fixed order: `TOUCH: TTHS: RTHS: FDAT: BVAL: DIFF:`, each with 13 (Touch Board) or 12
//! (Pi Cap) decimal integers. There is no sequence number, time stamp or checksum; what can be checked is checked:
//! field count, ranges, BVAL divisible by 4, BVAL − FDAT = DIFF.
//!
//! This module knows no clock, no port and no cover; a virtual board uses it alone.

mod emit;
mod parse;

pub use emit::{emit, emit_line};
pub use parse::{BadFrame, Event, ForeignText, Parser, StampedFrame};

/// Columns a frame can have: electrodes 0–11 and the virtual proximity electrode.
pub const MAX_COLUMNS: usize = 13;
/// Electrodes of one board.
pub const ELECTRODES: usize = 12;
/// Longest line the parser takes, its line feed not counted; stock lines have at most 83 characters.
pub const MAX_LINE_BYTES: usize = 128;
/// Largest FDAT (10 bits).
pub const FDAT_MAX: u16 = 1023;
/// Largest BVAL: the register holds the upper 8 of 10 bits.
pub const BASELINE_MAX: u16 = 1020;

/// The six lines of a frame, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// `TOUCH`: the chip's own touch decision, 0 or 1.
    Touch,
    /// `TTHS`: touch thresholds, 0–255.
    TouchThreshold,
    /// `RTHS`: release thresholds, 0–255.
    ReleaseThreshold,
    /// `FDAT`: filtered data, 0–1023.
    Filtered,
    /// `BVAL`: baseline, a multiple of 4.
    Baseline,
    /// `DIFF`: BVAL − FDAT, signed.
    Difference,
}

impl Line {
    /// Every line in the order of the stream.
    pub const ALL: [Self; 6] = [
        Self::Touch,
        Self::TouchThreshold,
        Self::ReleaseThreshold,
        Self::Filtered,
        Self::Baseline,
        Self::Difference,
    ];

    /// Key with colon and space.
    pub const fn key(self) -> &'static [u8] {
        match self {
            Self::Touch => b"TOUCH: ",
            Self::TouchThreshold => b"TTHS: ",
            Self::ReleaseThreshold => b"RTHS: ",
            Self::Filtered => b"FDAT: ",
            Self::Baseline => b"BVAL: ",
            Self::Difference => b"DIFF: ",
        }
    }

    /// Name as printed, without the colon.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Touch => "TOUCH",
            Self::TouchThreshold => "TTHS",
            Self::ReleaseThreshold => "RTHS",
            Self::Filtered => "FDAT",
            Self::Baseline => "BVAL",
            Self::Difference => "DIFF",
        }
    }

    const fn next(self) -> Self {
        match self {
            Self::Touch => Self::TouchThreshold,
            Self::TouchThreshold => Self::ReleaseThreshold,
            Self::ReleaseThreshold => Self::Filtered,
            Self::Filtered => Self::Baseline,
            Self::Baseline => Self::Difference,
            Self::Difference => Self::Touch,
        }
    }
}

/// How a sketch lays out its lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dialect {
    /// 12 or 13.
    pub columns: u8,
    /// A space follows the last number.
    pub trailing_space: bool,
    /// Lines end in CR LF rather than LF.
    pub carriage_return: bool,
}

impl Dialect {
    /// Stock DataStream on a Touch Board.
    pub const TOUCH_BOARD: Self = Self { columns: 13, trailing_space: false, carriage_return: true };
    /// DataStream of the Pi Cap.
    pub const PI_CAP: Self = Self { columns: 12, trailing_space: true, carriage_return: false };
}

impl Default for Dialect {
    fn default() -> Self {
        Self::TOUCH_BOARD
    }
}

/// One checked frame: raw registers of the MPR121. Columns beyond the dialect's are 0. DIFF is not kept, because a
/// good frame's DIFF is [`Frame::difference`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Layout of the lines it came in, or goes out in.
    pub dialect: Dialect,
    /// The chip's own touch decision. It forgets a sustained press: never a force.
    pub touched: [bool; MAX_COLUMNS],
    /// Touch thresholds, counts.
    pub touch_threshold: [u8; MAX_COLUMNS],
    /// Release thresholds, counts.
    pub release_threshold: [u8; MAX_COLUMNS],
    /// Filtered data, 0–1023 counts; a press lowers it.
    pub filtered: [u16; MAX_COLUMNS],
    /// Baseline, 0–1020 counts, a multiple of 4.
    pub baseline: [u16; MAX_COLUMNS],
}

impl Frame {
    /// BVAL − FDAT of one column, counts.
    pub fn difference(&self, column: usize) -> i16 {
        // Both registers fit 10 bits, so neither conversion nor difference can overflow in a checked frame.
        i16::try_from(i32::from(self.baseline[column]) - i32::from(self.filtered[column])).unwrap_or(i16::MAX)
    }
}

/// Which generation of the sketch a board runs; it decides frame rate and the age of the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SketchGeneration {
    /// 2015–2018: thresholds are not read back, about 67.5 frames/s, no auto-configuration.
    From2015,
    /// 2018–2020: 26 more I²C reads a frame, about 40.5 frames/s.
    From2018,
    /// Pi Cap: 12 columns.
    PiCap,
}

impl SketchGeneration {
    /// Name as stored in calibration files and shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::From2015 => "2015-2018",
            Self::From2018 => "2018-2020",
            Self::PiCap => "pi-cap",
        }
    }

    /// Nominal time of one frame, ns. The real one is measured, never assumed. The Pi Cap's is not known; it is
    /// taken as the older sketch's.
    pub const fn frame_period_ns(self) -> u64 {
        match self {
            Self::From2015 | Self::PiCap => 14_800_000,
            Self::From2018 => 24_700_000,
        }
    }

    /// When the end of each line reaches the host after the chip's data was read over I²C, ns. For 2018–2020 traced
    /// from the firmware (FDAT 16 ms, DIFF 20 ms); for the others inferred from the same print speed, 2 ms a line.
    pub const fn line_offset_ns(self) -> [u64; 6] {
        match self {
            Self::From2015 | Self::PiCap => {
                [2_000_000, 4_000_000, 6_000_000, 8_000_000, 10_000_000, 12_000_000]
            }
            Self::From2018 => [2_000_000, 8_000_000, 14_000_000, 16_000_000, 18_000_000, 20_000_000],
        }
    }
}

//! The text stream of Bare Conductive's DataStream sketch: [`Parser`] reads bytes in any chunking, [`emit`] is its
//! exact inverse for every frame that passes the checks.
//!
//! One frame is six lines in fixed order: `TOUCH: TTHS: RTHS: FDAT: BVAL: DIFF:`, each with 13 (Touch Board) or 12
//! (Pi Cap) decimal integers. There is no sequence number, time stamp or checksum; what can be checked is checked:
//! field count, ranges, BVAL divisible by 4, BVAL − FDAT = DIFF.
//!
//! This module knows no clock, no port and no cover; a virtual board uses it alone.
//!
//! ```
//! use moca_tactile::datastream::{Event, Frame, Parser, emit};
//!
//! let sent = Frame { filtered: [700; 13], baseline: [720; 13], ..Frame::default() };
//! let mut bytes = Vec::new();
//! emit(&sent, &mut bytes);
//! let (mut parser, mut rest) = (Parser::new(), bytes.as_slice());
//! let Some(Event::Frame(read)) = parser.next_event(&mut rest, 40_000_000) else { panic!("a whole frame") };
//! assert_eq!(read.frame, sent);
//! ```

mod emit;
mod parse;

pub use emit::{emit, emit_line};
pub(crate) use parse::Assembler;
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
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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

/// Layout of a sketch's lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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

//! The line of our own firmware (`firmware/moca_touch`): [`parse`] reads one, [`emit`] is its exact inverse.
//!
//! `C ssss tttttttt ddd×12 ff cccc`, hexadecimal and of fixed width, 60 bytes and a line feed: letter of the chip,
//! sequence of its lines, the board's clock in µs when it began to read the chip, FDAT of E0 to E11, flags, CRC-16
//! (XMODEM) of everything before the last space. A small letter carries the chip's baselines in place of FDAT and the
//! worst age of data when they are read, in 0.1 ms, in place of the flags.
//!
//! ```
//! use moca_tactile::touchline::{Content, parse};
//!
//! let line = parse(b"C 002A 0001E240 2D02D02D02D02D02D02CF2D12D02D02D02D0 01 58FE")?;
//! assert_eq!((line.bank, line.sequence, line.device_us), (0, 42, 123_456));
//! assert_eq!(line.values[6], 719);
//! assert!(matches!(line.content, Content::Data(flags) if flags.is_new() && !flags.bus_fault()));
//! // A damaged line is refused.
//! assert!(parse(b"C 002A 0001E240 2D02D02D02D02D02D02CF2D12D02D02D02D1 01 58FE").is_err());
//! # Ok::<(), moca_tactile::touchline::BadLine>(())
//! ```

mod emit;
mod parse;

pub use emit::emit;
pub use parse::{BadLine, is_note, looks_like, parse};

use crate::datastream::ELECTRODES;

/// Bytes of a line, its line feed not counted.
pub const LINE_BYTES: usize = 60;
/// Chips that one board can carry.
pub const BANKS: usize = 4;
/// Letters of the chips, bank 0 (electrodes 0–11) first: the board's own at 0x5C, then 0x5D, 0x5A, 0x5B.
pub const LETTERS: [u8; BANKS] = *b"CDAB";

/// One good line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Which chip: electrodes 12·bank to 12·bank + 11 of the board.
    pub bank: u8,
    /// Counts this chip's data lines; a baseline line repeats the last one's.
    pub sequence: u16,
    /// The board's clock when the read began, µs; wraps after 71.6 minutes.
    pub device_us: u32,
    /// FDAT or baselines of E0 to E11, 0–1023 counts.
    pub values: [u16; ELECTRODES],
    /// Content of the values.
    pub content: Content,
}

/// Content of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// FDAT.
    Data(Flags),
    /// Baselines.
    Baseline {
        /// Worst age that data has when it is read, 0.1 ms.
        age_tenths_ms: u8,
    },
}

/// Flags of the firmware about its data; the bits are those of `enum Flag` in `firmware/moca_touch/chip.h`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Flags(pub u8);

impl Flags {
    /// At least one value differs from the read before.
    pub const NEW: Self = Self(0x01);
    /// Set in the read before too: both show one refresh of the chip.
    pub const CONTINUES: Self = Self(0x02);
    /// The chip could not bring an electrode to its target.
    pub const OUT_OF_RANGE: Self = Self(0x04);
    /// The chip has stopped: its resistor is shorted.
    pub const OVER_CURRENT: Self = Self(0x08);
    /// The chip was reset and set up again.
    pub const CHIP_RESET: Self = Self(0x10);
    /// The chip did not answer; the values are old.
    pub const BUS_FAULT: Self = Self(0x20);
    /// The chip has just begun to run.
    pub const SETTLING: Self = Self(0x40);
    /// Lines before this one were not sent, because the host did not read.
    pub const DROPPED: Self = Self(0x80);

    /// Returns true if every bit of `flag` is set.
    pub const fn has(self, flag: Self) -> bool {
        self.0 & flag.0 == flag.0
    }

    /// [`Flags::NEW`].
    pub const fn is_new(self) -> bool {
        self.has(Self::NEW)
    }

    /// [`Flags::BUS_FAULT`].
    pub const fn bus_fault(self) -> bool {
        self.has(Self::BUS_FAULT)
    }
}

impl core::ops::BitOr for Flags {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// CRC-16/XMODEM: polynomial 0x1021, from 0.
pub(crate) fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, &byte| {
        (0..8).fold(
            crc ^ u16::from(byte) << 8,
            |crc, _| {
                if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 }
            },
        )
    })
}

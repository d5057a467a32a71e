//! Lines to values.

use super::{Content, Flags, LETTERS, LINE_BYTES, Line, crc16};
use crate::datastream::{ELECTRODES, FDAT_MAX};

/// Places of the spaces.
const SPACES: [usize; 5] = [1, 6, 15, 52, 55];
/// The checksum covers what stands before its space.
const CHECKED: usize = 55;

/// Why a line was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadLine {
    /// Not of this shape: length, letter, spaces, or an invalid digit.
    Shape,
    /// The checksum does not fit.
    Checksum,
    /// A value above 1023.
    OutOfRange {
        /// Electrode of the chip.
        electrode: u8,
    },
}

impl core::fmt::Display for BadLine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Shape => {
                write!(f, "torn: not {LINE_BYTES} bytes of letter, sequence, time, values, flags, sum")
            }
            Self::Checksum => write!(f, "the checksum does not fit its line"),
            Self::OutOfRange { electrode } => {
                write!(f, "electrode {electrode} has a value above {FDAT_MAX} counts")
            }
        }
    }
}

impl core::error::Error for BadLine {}

/// Returns true if `line` has a line's letter and spaces, so that it was meant to be one.
pub fn looks_like(line: &[u8]) -> bool {
    line.len() == LINE_BYTES
        && LETTERS.contains(&line[0].to_ascii_uppercase())
        && SPACES.iter().all(|&place| line[place] == b' ')
}

/// Returns true if `line` is an answer of the firmware (`# text cccc`) whose checksum fits.
pub fn is_note(line: &[u8]) -> bool {
    let Some(end) = line.len().checked_sub(5) else { return false };
    let (text, sum) = line.split_at(end);
    text.starts_with(b"# ") && sum[0] == b' ' && hexadecimal(&sum[1..]) == Some(u32::from(crc16(text)))
}

/// Reads one line, its line feed taken off.
///
/// # Errors
/// What is wrong with it.
pub fn parse(line: &[u8]) -> Result<Line, BadLine> {
    if !looks_like(line) {
        return Err(BadLine::Shape);
    }
    let field = |from: usize, length: usize| hexadecimal(&line[from..from + length]).ok_or(BadLine::Shape);
    let narrow = |value: u32| u16::try_from(value).map_err(|_| BadLine::Shape);
    if narrow(field(56, 4)?)? != crc16(&line[..CHECKED]) {
        return Err(BadLine::Checksum);
    }
    let mut values = [0; ELECTRODES];
    for (electrode, value) in (0u8..).zip(&mut values) {
        *value = narrow(field(16 + 3 * usize::from(electrode), 3)?)?;
        if *value > FDAT_MAX {
            return Err(BadLine::OutOfRange { electrode });
        }
    }
    let letter = line[0].to_ascii_uppercase();
    let bank = (0u8..).zip(LETTERS).find_map(|(bank, own)| (own == letter).then_some(bank));
    let last = u8::try_from(field(53, 2)?).map_err(|_| BadLine::Shape)?;
    Ok(Line {
        bank: bank.ok_or(BadLine::Shape)?,
        sequence: narrow(field(2, 4)?)?,
        device_us: field(7, 8)?,
        values,
        content: if line[0].is_ascii_uppercase() {
            Content::Data(Flags(last))
        } else {
            Content::Baseline { age_tenths_ms: last }
        },
    })
}

/// Digits as the firmware prints them: capital letters only.
fn hexadecimal(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0, |value: u32, digit| {
        let digit = match digit {
            b'0'..=b'9' => digit - b'0',
            b'A'..=b'F' => digit - b'A' + 10,
            _ => return None,
        };
        Some(value << 4 | u32::from(digit))
    })
}

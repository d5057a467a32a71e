//! Bytes to checked frames.

use super::{BASELINE_MAX, Dialect, FDAT_MAX, Frame, Line, MAX_COLUMNS, MAX_LINE_BYTES};
use crate::lines::{Cut, LineCutter};

/// A good frame and when its lines arrived, ns of loop time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StampedFrame {
    /// The registers.
    pub frame: Frame,
    /// End of the `TOUCH` line, the first after the board read the chip.
    pub touch_line_ns: u64,
    /// End of the `RTHS` line.
    pub thresholds_line_ns: u64,
    /// End of the `FDAT` line.
    pub filtered_line_ns: u64,
    /// End of the `DIFF` line: the frame is complete.
    pub complete_ns: u64,
}

/// Why a frame was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum BadFrame {
    /// A line other than the expected one, or numbers that are not 12 or 13 plain decimal integers.
    Torn {
        /// The line that should have come.
        expected: Line,
    },
    /// A value outside its register's range.
    OutOfRange {
        /// In this line.
        line: Line,
    },
    /// Lines of one frame differ in column count, trailing space or line end.
    MixedDialect {
        /// The first line that differs.
        line: Line,
    },
    /// BVAL − FDAT ≠ DIFF.
    Inconsistent {
        /// In this column.
        column: u8,
    },
    /// A line longer than [`MAX_LINE_BYTES`].
    LineTooLong,
    /// A line of our own firmware that is torn or whose checksum does not fit.
    Damaged,
    /// A line of our own firmware with the number of the one before it.
    Repeated,
}

impl core::fmt::Display for BadFrame {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Torn { expected } => {
                write!(f, "torn: no line {} of 12 or 13 integers where one had to come", expected.name())
            }
            Self::OutOfRange { line } => write!(f, "a value of line {} is outside its register", line.name()),
            Self::MixedDialect { line } => {
                write!(f, "torn: line {} is laid out differently from its frame's first line", line.name())
            }
            Self::Inconsistent { column } => write!(f, "BVAL - FDAT is not DIFF in column {column}"),
            Self::Damaged => write!(f, "a torn line, or one whose checksum does not fit"),
            Self::Repeated => write!(f, "a line with the number of the one before it"),
            Self::LineTooLong => write!(f, "a line longer than {MAX_LINE_BYTES} bytes"),
        }
    }
}

/// Text that is no DataStream line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForeignText {
    /// `pin 3 was just touched`: the factory sketch Touch_MP3 or a relative.
    TouchEvents,
    /// `error setting up MPR121`: the sketch runs, its sensor chip does not answer.
    ChipInitFailed,
    /// Anything else.
    Other,
}

/// Event in the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// All six lines and every check passed.
    Frame(StampedFrame),
    /// A check failed. Counted once; the rest is dropped up to the next `TOUCH` line.
    Bad(BadFrame),
    /// A line of text while waiting for the first `TOUCH`.
    Foreign(ForeignText),
}

/// Incremental parser. Bounded memory; the same bytes give the same events in whatever chunks they come.
#[derive(Clone, Debug, Default)]
pub struct Parser {
    cutter: LineCutter,
    assembler: Assembler,
}

impl Parser {
    /// A parser at the start of a stream.
    pub const fn new() -> Self {
        Self { cutter: LineCutter::new(), assembler: Assembler::new() }
    }

    /// Forgets a partial line and frame, as after bytes known to be lost. What is dropped is not counted as bad.
    pub fn resynchronise(&mut self) {
        self.cutter.resynchronise();
        self.assembler.resynchronise();
    }

    /// Consumes `bytes`, which arrived at `arrival_ns`, up to the next event; `None` when all are consumed.
    pub fn next_event(&mut self, bytes: &mut &[u8], arrival_ns: u64) -> Option<Event> {
        while let Some(cut) = self.cutter.next_line(bytes) {
            if let Some(event) = self.assembler.take(cut, arrival_ns) {
                return Some(event);
            }
        }
        None
    }
}

/// Lines to frames.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(crate) struct Assembler {
    /// The line that must come next; `None` while dropping lines until a `TOUCH`.
    expected: Option<Line>,
    frame: Frame,
    touch_line_ns: u64,
    thresholds_line_ns: u64,
    filtered_line_ns: u64,
}

impl Default for Assembler {
    fn default() -> Self {
        Self::new()
    }
}

impl Assembler {
    pub(crate) const fn new() -> Self {
        Self {
            expected: None,
            frame: Frame {
                dialect: Dialect::TOUCH_BOARD,
                touched: [false; MAX_COLUMNS],
                touch_threshold: [0; MAX_COLUMNS],
                release_threshold: [0; MAX_COLUMNS],
                filtered: [0; MAX_COLUMNS],
                baseline: [0; MAX_COLUMNS],
            },
            touch_line_ns: 0,
            thresholds_line_ns: 0,
            filtered_line_ns: 0,
        }
    }

    pub(crate) fn resynchronise(&mut self) {
        self.expected = None;
    }

    pub(crate) fn take(&mut self, cut: Cut<'_>, arrival_ns: u64) -> Option<Event> {
        match cut {
            Cut::Line(line) => self.line(line, false, arrival_ns),
            Cut::TooLong => self.line(&[], true, arrival_ns),
        }
    }

    /// FDAT of the frame under way and when its `TOUCH` line ended, ns, between the end of its `FDAT` line and its end.
    /// Nothing has confirmed it yet.
    pub(crate) fn filtered(&self) -> Option<(&[u16; MAX_COLUMNS], u64)> {
        let waiting = matches!(self.expected, Some(Line::Baseline | Line::Difference));
        waiting.then_some((&self.frame.filtered, self.touch_line_ns))
    }

    fn line(&mut self, line: &[u8], too_long: bool, arrival_ns: u64) -> Option<Event> {
        let outcome = if too_long {
            Err(BadFrame::LineTooLong)
        } else if line.starts_with(Line::Touch.key()) {
            return self.touch_line(line, arrival_ns);
        } else {
            match self.expected {
                None => return foreign(line).map(Event::Foreign),
                Some(expected) => self.register_line(expected, line, arrival_ns).map(|()| expected),
            }
        };
        match outcome {
            Ok(Line::Difference) => {
                self.expected = Some(Line::Touch);
                Some(Event::Frame(self.stamped(arrival_ns)))
            }
            Ok(line) => {
                self.expected = Some(line.next());
                None
            }
            Err(why) => self.reject(why),
        }
    }

    /// A `TOUCH` line starts a frame whatever came before; a frame it cuts short is bad.
    fn touch_line(&mut self, line: &[u8], arrival_ns: u64) -> Option<Event> {
        let interrupted = self.expected.filter(|&expected| expected != Line::Touch);
        if let Err(why) = self.register_line(Line::Touch, line, arrival_ns) {
            return self.reject(why);
        }
        self.expected = Some(Line::TouchThreshold);
        interrupted.map(|expected| Event::Bad(BadFrame::Torn { expected }))
    }

    fn reject(&mut self, why: BadFrame) -> Option<Event> {
        let counted = self.expected.take().is_some();
        counted.then_some(Event::Bad(why))
    }

    fn stamped(&self, complete_ns: u64) -> StampedFrame {
        StampedFrame {
            frame: self.frame,
            touch_line_ns: self.touch_line_ns,
            thresholds_line_ns: self.thresholds_line_ns,
            filtered_line_ns: self.filtered_line_ns,
            complete_ns,
        }
    }

    fn register_line(&mut self, expected: Line, line: &[u8], arrival_ns: u64) -> Result<(), BadFrame> {
        let torn = BadFrame::Torn { expected };
        let body = line.strip_prefix(expected.key()).ok_or(torn)?;
        let (values, dialect) = integers(body).ok_or(torn)?;
        if expected == Line::Touch {
            self.frame = Frame { dialect, ..Frame::default() };
            self.touch_line_ns = arrival_ns;
        } else if dialect != self.frame.dialect {
            return Err(BadFrame::MixedDialect { line: expected });
        }
        let out_of_range = BadFrame::OutOfRange { line: expected };
        for (column, &value) in values[..usize::from(dialect.columns)].iter().enumerate() {
            self.store(expected, column, value).ok_or(out_of_range).and_then(|consistent| {
                if consistent {
                    Ok(())
                } else {
                    Err(BadFrame::Inconsistent { column: u8::try_from(column).unwrap_or(u8::MAX) })
                }
            })?;
        }
        match expected {
            Line::ReleaseThreshold => self.thresholds_line_ns = arrival_ns,
            Line::Filtered => self.filtered_line_ns = arrival_ns,
            _ => {}
        }
        Ok(())
    }

    /// `None` for a value outside its register's range, `Some(false)` for a DIFF that does not fit.
    fn store(&mut self, line: Line, column: usize, value: i16) -> Option<bool> {
        let frame = &mut self.frame;
        match line {
            Line::Touch => frame.touched[column] = matches!(value, 0 | 1).then_some(value == 1)?,
            Line::TouchThreshold => frame.touch_threshold[column] = u8::try_from(value).ok()?,
            Line::ReleaseThreshold => frame.release_threshold[column] = u8::try_from(value).ok()?,
            Line::Filtered => {
                frame.filtered[column] = u16::try_from(value).ok().filter(|&v| v <= FDAT_MAX)?;
            }
            Line::Baseline => {
                frame.baseline[column] =
                    u16::try_from(value).ok().filter(|&v| v <= BASELINE_MAX && v % 4 == 0)?;
            }
            Line::Difference => return Some(frame.difference(column) == value),
        }
        Some(true)
    }
}

/// Reads a line's 12 or 13 plain decimal integers. Anything that [`super::emit`] would print differently (a sign on
/// zero, leading zeros, doubled spaces) is not accepted.
fn integers(body: &[u8]) -> Option<([i16; MAX_COLUMNS], Dialect)> {
    let (body, carriage_return) = match body.strip_suffix(b"\r") {
        Some(body) => (body, true),
        None => (body, false),
    };
    let (body, trailing_space) = match body.strip_suffix(b" ") {
        Some(body) => (body, true),
        None => (body, false),
    };
    let mut values = [0; MAX_COLUMNS];
    let mut columns = 0u8;
    let mut rest = body;
    loop {
        let (value, after) = integer(rest)?;
        *values.get_mut(usize::from(columns))? = value;
        columns += 1;
        match after {
            [] => break,
            [b' ', next @ ..] => rest = next,
            _ => return None,
        }
    }
    matches!(columns, 12 | 13).then_some((values, Dialect { columns, trailing_space, carriage_return }))
}

/// The integer at the start of `text`, at most 4 digits, and what follows it.
fn integer(text: &[u8]) -> Option<(i16, &[u8])> {
    let (digits, negative) = match text {
        [b'-', digits @ ..] => (digits, true),
        _ => (text, false),
    };
    let mut value: i16 = 0;
    let mut length = 0;
    while let Some(digit) = digits.get(length).filter(|b| b.is_ascii_digit()) {
        if length == 4 {
            return None;
        }
        value = value * 10 + i16::from(digit - b'0');
        length += 1;
    }
    let leading_zero = length > 1 && digits[0] == b'0';
    if length == 0 || leading_zero || (negative && value == 0) {
        return None;
    }
    Some((if negative { -value } else { value }, &digits[length..]))
}

/// Names text that no DataStream sketch prints; `None` for the tail of a frame.
fn foreign(line: &[u8]) -> Option<ForeignText> {
    let text = line.strip_suffix(b"\r").unwrap_or(line);
    if text.is_empty() || Line::ALL.iter().any(|l| text.starts_with(l.key())) {
        return None;
    }
    let contains = |needle: &[u8]| text.windows(needle.len()).any(|w| w == needle);
    Some(if contains(b"was just touched") || contains(b"was just released") || contains(b"playing track") {
        ForeignText::TouchEvents
    } else if contains(b"error setting up MPR121") {
        ForeignText::ChipInitFailed
    } else {
        ForeignText::Other
    })
}

//! Bytes to lines, in bounded memory and in whatever chunks they come.

use crate::datastream::MAX_LINE_BYTES;

/// One line, its line feed taken off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cut<'a> {
    /// At most [`MAX_LINE_BYTES`].
    Line(&'a [u8]),
    /// Longer than any line of any board.
    TooLong,
}

#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(crate) struct LineCutter {
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    partial: [u8; MAX_LINE_BYTES],
    length: usize,
    too_long: bool,
}

impl Default for LineCutter {
    fn default() -> Self {
        Self::new()
    }
}

impl LineCutter {
    pub(crate) const fn new() -> Self {
        Self { partial: [0; MAX_LINE_BYTES], length: 0, too_long: false }
    }

    /// Forgets a partial line.
    pub(crate) fn resynchronise(&mut self) {
        self.length = 0;
        self.too_long = false;
    }

    /// Consumes `bytes` up to the end of the next line; `None` when all are consumed.
    pub(crate) fn next_line<'c, 'b: 'c>(&'c mut self, bytes: &mut &'b [u8]) -> Option<Cut<'c>> {
        let Some(end) = bytes.iter().position(|&b| b == b'\n') else {
            self.keep(bytes);
            *bytes = &[];
            return None;
        };
        let (line, rest) = (&bytes[..end], &bytes[end + 1..]);
        *bytes = rest;
        if self.length == 0 && !self.too_long {
            return Some(if line.len() > MAX_LINE_BYTES { Cut::TooLong } else { Cut::Line(line) });
        }
        self.keep(line);
        let (length, too_long) = (self.length, self.too_long);
        self.resynchronise();
        Some(if too_long { Cut::TooLong } else { Cut::Line(&self.partial[..length]) })
    }

    /// Keeps the start of a line whose end has not come yet, up to the longest line allowed.
    fn keep(&mut self, bytes: &[u8]) {
        let room = MAX_LINE_BYTES - self.length;
        if bytes.len() > room {
            self.too_long = true;
        }
        let taken = &bytes[..bytes.len().min(room)];
        self.partial[self.length..self.length + taken.len()].copy_from_slice(taken);
        self.length += taken.len();
    }
}

//! Values to lines.

use super::{BANKS, Content, LETTERS, LINE_BYTES, Line, crc16};

struct Text {
    bytes: [u8; LINE_BYTES + 1],
    length: usize,
}

impl Text {
    fn put(&mut self, byte: u8) {
        // a line is of fixed width and fits
        self.bytes[self.length] = byte;
        self.length += 1;
    }

    fn hexadecimal(&mut self, value: u32, digits: u32) {
        for place in (0..digits).rev() {
            let digit = usize::try_from(value >> (4 * place) & 15).unwrap_or(0);
            self.put(b"0123456789ABCDEF"[digit]);
        }
    }
}

/// Appends the line with its line feed to `out`, byte for byte as the firmware prints it.
pub fn emit(line: &Line, out: &mut impl Extend<u8>) {
    let mut text = Text { bytes: [0; LINE_BYTES + 1], length: 0 };
    let letter = LETTERS[usize::from(line.bank) % BANKS];
    let (letter, last) = match line.content {
        Content::Data(flags) => (letter, flags.0),
        Content::Baseline { age_tenths_ms } => (letter.to_ascii_lowercase(), age_tenths_ms),
    };
    text.put(letter);
    text.put(b' ');
    text.hexadecimal(line.sequence.into(), 4);
    text.put(b' ');
    text.hexadecimal(line.device_us, 8);
    text.put(b' ');
    for value in line.values {
        text.hexadecimal(value.into(), 3);
    }
    text.put(b' ');
    text.hexadecimal(last.into(), 2);
    let sum = crc16(&text.bytes[..text.length]);
    text.put(b' ');
    text.hexadecimal(sum.into(), 4);
    text.put(b'\n');
    out.extend(text.bytes[..text.length].iter().copied());
}

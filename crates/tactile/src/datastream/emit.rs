//! Frames to bytes.

use super::{Frame, Line};

/// Appends the frame's six lines to `out`, byte for byte as the sketch prints them.
pub fn emit(frame: &Frame, out: &mut impl Extend<u8>) {
    for line in Line::ALL {
        emit_line(frame, line, out);
    }
}

/// Appends one line (at most [`super::MAX_LINE_BYTES`] and its line feed), for a board that spaces its lines in time.
pub fn emit_line(frame: &Frame, line: Line, out: &mut impl Extend<u8>) {
    out.extend(line.key().iter().copied());
    let columns = usize::from(frame.dialect.columns).min(super::MAX_COLUMNS);
    for column in 0..columns {
        if column > 0 {
            out.extend([b' ']);
        }
        emit_integer(value(frame, line, column), out);
    }
    if frame.dialect.trailing_space {
        out.extend([b' ']);
    }
    if frame.dialect.carriage_return {
        out.extend([b'\r']);
    }
    out.extend([b'\n']);
}

fn value(frame: &Frame, line: Line, column: usize) -> i32 {
    match line {
        Line::Touch => i32::from(frame.touched[column]),
        Line::TouchThreshold => i32::from(frame.touch_threshold[column]),
        Line::ReleaseThreshold => i32::from(frame.release_threshold[column]),
        Line::Filtered => i32::from(frame.filtered[column]),
        Line::Baseline => i32::from(frame.baseline[column]),
        Line::Difference => i32::from(frame.difference(column)),
    }
}

fn emit_integer(value: i32, out: &mut impl Extend<u8>) {
    if value < 0 {
        out.extend([b'-']);
    }
    let mut rest = value.unsigned_abs();
    let mut digits = [b'0'; 10];
    let mut start = digits.len();
    loop {
        start -= 1;
        // rest % 10 is a single digit
        digits[start] = b'0' + u8::try_from(rest % 10).unwrap_or(0);
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    out.extend(digits[start..].iter().copied());
}

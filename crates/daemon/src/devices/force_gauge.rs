//! A force gauge behind a serial port that prints newtons, one number a line: the reference of a calibration.

use crate::devices::ports::{self, Reader};
use anyhow::Result;
use moca_tactile::BoardEvent;
use std::time::Instant;

/// A gauge's port and what it last said. The port is tried again until it opens.
pub struct Gauge {
    events: rtrb::Consumer<BoardEvent>,
    text: GaugeText,
    problem: Option<&'static str>,
    _reader: Reader,
}

impl Gauge {
    /// Starts reading at `baud`. Times of readings are ns since `start`.
    ///
    /// # Errors
    /// No thread can be started, or the build is without the feature `board`.
    pub fn open(port: &str, baud: u32, start: Instant) -> Result<Self> {
        let (reader, events) = ports::open_gauge(port, baud, start)?;
        Ok(Self { events, text: GaugeText::default(), problem: None, _reader: reader })
    }

    /// Hands over every reading since the last call, N, with the time it arrived, ns.
    ///
    /// # Errors
    /// Why there is no reading while the port is not open.
    pub fn read(&mut self, mut reading: impl FnMut(f64, u64)) -> Result<(), &'static str> {
        while let Ok(event) = self.events.pop() {
            match event {
                BoardEvent::Bytes(chunk) => {
                    self.text.push(chunk.bytes(), |force_n| reading(force_n, chunk.arrival_ns));
                }
                BoardEvent::Opened { .. } => self.problem = None,
                BoardEvent::OpenFailed { why, .. } => self.problem = Some(why.text()),
                BoardEvent::Closed { .. } => self.problem = Some("its port closed"),
                BoardEvent::Starved { .. } => {}
                BoardEvent::Gap { .. } => self.text = GaugeText::default(),
            }
        }
        self.problem.map_or(Ok(()), Err)
    }
}

/// Lines of a gauge; a line that is no number is skipped, an endless one is cut.
#[derive(Default)]
struct GaugeText {
    line: Vec<u8>,
}

impl GaugeText {
    const LINE_MAX: usize = 64;

    fn push(&mut self, bytes: &[u8], mut reading: impl FnMut(f64)) {
        for &byte in bytes {
            if byte != b'\n' {
                if self.line.len() < Self::LINE_MAX {
                    self.line.push(byte);
                }
                continue;
            }
            let text = String::from_utf8_lossy(&self.line);
            if let Ok(force_n) = text.trim().trim_end_matches('N').trim_end().parse::<f64>() {
                reading(force_n);
            }
            self.line.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauge_lines_are_read_in_any_chunking() {
        let mut readings = Vec::new();
        let mut text = GaugeText::default();
        for chunk in [&b"1"[..], b"2.5\r\n  7 N\n--\n", &[b'9'; 1000], b"\n-3\n"] {
            text.push(chunk, |force_n| readings.push(force_n));
        }
        readings.retain(|r| *r < 1e6);
        assert_eq!(readings, [12.5, 7.0, -3.0]);
    }
}

//! A cable that spoils what runs through it: every fault of bytes and board, between any byte source and the loop.

use crate::inject::Random;
use crate::inject::cable_fault::CableFault;
use crate::inject::values::{LineBytes, Values, append};
use moca_tactile::board::{Chunk, OpenFailure};
use moca_tactile::datastream::{ELECTRODES, Line};
use moca_tactile::touchline::{self, Content};
use moca_tactile::{BoardEvent, CloseReason};

/// Largest number of bytes that a stalled host holds back.
const HELD: usize = 8192;
const STALL_NS: u64 = 400_000_000;
const UNPLUGGED_NS: u64 = 1_000_000_000;
const FLOOD_BYTES: usize = 200;

/// The spoiled cable: events in, events out, whichever firmware speaks. Allocates nothing.
#[derive(Debug)]
pub struct Cable {
    fault: CableFault,
    at_ns: u64,
    random: Random,
    line: LineBytes,
    held: heapless::Vec<u8, HELD>,
    values: Values,
    closed_ns: Option<u64>,
    frames: u32,
}

impl Cable {
    /// A cable that is good until `at_ns`.
    pub fn new(fault: CableFault, at_ns: u64, seed: u64) -> Self {
        Self {
            fault,
            at_ns,
            random: Random::new(seed),
            line: heapless::Vec::new(),
            held: heapless::Vec::new(),
            values: Values::new(fault, at_ns, seed),
            closed_ns: None,
            frames: 0,
        }
    }

    /// Passes one event on to `sink`, whole or spoiled.
    pub fn pass(&mut self, event: BoardEvent, sink: &mut impl FnMut(BoardEvent)) {
        let BoardEvent::Bytes(chunk) = event else { return sink(event) };
        for &byte in chunk.bytes() {
            if self.line.push(byte).is_err() || byte == b'\n' {
                let mut line = core::mem::take(&mut self.line);
                if chunk.arrival_ns < self.at_ns {
                    send(&line, chunk.arrival_ns, sink);
                } else {
                    self.spoil(&mut line, chunk.arrival_ns, sink);
                }
            }
        }
    }

    /// Handles events without bytes: a port that closes or comes back, bytes released after a stall.
    pub fn wait(&mut self, now_ns: u64, sink: &mut impl FnMut(BoardEvent)) {
        use CableFault::{HostStall, PortRefused, Replugged, Unplugged};
        if now_ns < self.at_ns {
            return;
        }
        match (self.fault, self.closed_ns) {
            (Unplugged | Replugged | PortRefused, None) => {
                self.closed_ns = Some(now_ns);
                sink(BoardEvent::Closed { at_ns: now_ns, why: CloseReason::Disconnected });
                if self.fault == PortRefused {
                    sink(BoardEvent::OpenFailed { at_ns: now_ns, why: OpenFailure::PermissionDenied });
                }
            }
            (Replugged, Some(closed)) if closed != u64::MAX && now_ns - closed > UNPLUGGED_NS => {
                self.closed_ns = Some(u64::MAX);
                sink(BoardEvent::Opened { at_ns: now_ns });
            }
            (HostStall, None) if now_ns - self.at_ns > STALL_NS => {
                self.closed_ns = Some(now_ns);
                let held = core::mem::take(&mut self.held);
                send(&held, now_ns, sink);
            }
            _ => {}
        }
    }

    fn spoil(&mut self, line: &mut LineBytes, now_ns: u64, sink: &mut impl FnMut(BoardEvent)) {
        use CableFault as F;
        match self.fault {
            F::Garbage => {
                let mut noise = [0; 40];
                noise.fill_with(|| self.random.byte());
                send(&noise, now_ns, sink);
            }
            F::ByteLost if self.random.one_in(6) => {
                let at = self.random.below(line.len());
                line.remove(at);
            }
            F::BitFlipped if self.random.one_in(6) => {
                let (at, bit) = (self.random.below(line.len()), self.random.below(8));
                line[at] ^= 1 << bit;
            }
            F::NulBytes => send(&[0; 30], now_ns, sink),
            F::NoNewline => return send(&[b'7'; FLOOD_BYTES], now_ns, sink),
            F::LineRepeated => send(line, now_ns, sink),
            F::TouchSketch => replace(line, b"Electrode 3 was touched\r\n"),
            F::Silent | F::Unplugged | F::PortRefused => return,
            F::Replugged if self.closed_ns != Some(u64::MAX) => return,
            F::HostStall if self.closed_ns.is_none() => return append(&mut self.held, line),
            _ => {
                let text = line.strip_suffix(b"\n").unwrap_or(line);
                let kept = match touchline::parse(text) {
                    Ok(stamped) => self.spoil_stamped(stamped, line, now_ns),
                    Err(_) => self.spoil_stock(line, now_ns),
                };
                if !kept {
                    return;
                }
            }
        }
        send(line, now_ns, sink);
    }

    /// Spoils a line of DataStream; `false` if it never arrives.
    fn spoil_stock(&mut self, line: &mut LineBytes, now_ns: u64) -> bool {
        use CableFault as F;
        let Some(key) = Line::ALL.into_iter().find(|key| line.starts_with(key.key())) else { return true };
        self.frames += u32::from(key == Line::Touch);
        match (self.fault, key) {
            (F::TornLine, Line::Filtered) => line.truncate(line.len() / 2),
            (F::NumberTooLarge, Line::Filtered) => replace(line, b"FDAT: 99999 1 2\r\n"),
            (F::NotANumber, Line::Filtered) => replace(line, b"FDAT: NaN inf -1\r\n"),
            (F::ColumnMissing, _) => {
                let cut = line.iter().rposition(|&byte| byte == b' ').unwrap_or(0);
                line.truncate(cut);
                append(line, b"\r\n");
            }
            (F::ColumnExtra, _) => {
                line.truncate(line.len().saturating_sub(2));
                append(line, b" 700\r\n");
            }
            (F::LineMissing, Line::Baseline) => return false,
            (F::SlowBoard, _) => return self.frames.is_multiple_of(2),
            (F::Thresholds, Line::TouchThreshold) => {
                replace(line, b"TTHS: 1 2 3 4 5 6 7 8 9 10 11 12 13\r\n");
            }
            _ => self.values.spoil_stock(line, key, now_ns),
        }
        true
    }

    /// Spoils a line of our firmware, which says `stamped`; `false` if it never arrives.
    fn spoil_stamped(&mut self, mut stamped: touchline::Line, line: &mut LineBytes, now_ns: u64) -> bool {
        use CableFault as F;
        let is_data = matches!(stamped.content, Content::Data(_));
        self.frames += u32::from(is_data);
        let last_column = VALUES.end - VALUE_DIGITS..VALUES.end;
        match self.fault {
            F::TornLine if is_data => line.truncate(line.len() / 2),
            // With a checksum that fits, so that the range is what is wrong.
            F::NumberTooLarge if is_data => {
                stamped.values = [0xFFF; ELECTRODES];
                print(line, &stamped);
            }
            F::NotANumber if is_data => line[VALUES][..VALUE_DIGITS].copy_from_slice(b"NaN"),
            F::ColumnMissing => drop(line.drain(last_column)),
            F::ColumnExtra => {
                let rest: LineBytes = line[VALUES.end..].iter().copied().collect();
                line.truncate(VALUES.end);
                append(line, b"2BC");
                append(line, &rest);
            }
            F::LineMissing => return is_data,
            F::SlowBoard => return !is_data || self.frames.is_multiple_of(2),
            _ if self.values.spoil_stamped(&mut stamped, now_ns) => print(line, &stamped),
            _ => {}
        }
        true
    }
}

/// Place of the values in our firmware's line, and digits of each of them.
const VALUES: core::ops::Range<usize> = 16..52;
const VALUE_DIGITS: usize = 3;

fn print(line: &mut LineBytes, stamped: &touchline::Line) {
    line.clear();
    touchline::emit(stamped, line);
}

fn replace(line: &mut LineBytes, bytes: &[u8]) {
    line.clear();
    append(line, bytes);
}

fn send(bytes: &[u8], at_ns: u64, sink: &mut impl FnMut(BoardEvent)) {
    for part in bytes.chunks(Chunk::CAPACITY) {
        sink(BoardEvent::Bytes(Chunk::new(at_ns, part)));
    }
}

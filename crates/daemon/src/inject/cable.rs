//! A cable that spoils what runs through it: every fault of bytes and board, between any byte source and the loop.

use crate::inject::Random;
use core::fmt::Write as _;
use moca_tactile::board::{Chunk, OpenFailure};
use moca_tactile::datastream::{Line, MAX_COLUMNS, MAX_LINE_BYTES};
use moca_tactile::{BoardEvent, CloseReason};

/// The taxel (0 is T1) that the faults of one taxel strike.
pub const STRUCK_TAXEL: usize = 3;
const LINE: usize = MAX_LINE_BYTES + 32;
/// What a stalled host may hold back.
const HELD: usize = 8192;
const STALL_NS: u64 = 400_000_000;
const UNPLUGGED_NS: u64 = 1_000_000_000;
const FLOOD_BYTES: usize = 200;

/// What happens on the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is described once, in the table of inject/mod.rs")]
pub enum CableFault {
    Garbage,
    TornLine,
    ByteLost,
    BitFlipped,
    NulBytes,
    NoNewline,
    NumberTooLarge,
    NotANumber,
    ColumnMissing,
    ColumnExtra,
    LineRepeated,
    LineMissing,
    TouchSketch,
    Silent,
    Unplugged,
    Replugged,
    PortRefused,
    HostStall,
    Frozen,
    ChipReset,
    Thresholds,
    SlowBoard,
    TaxelStuck,
    TaxelDead,
    TaxelSaturated,
    TaxelNoisy,
    TaxelDrifting,
    CommonMode,
}

/// The spoiled cable: events in, events out. Allocates nothing.
#[derive(Debug)]
pub struct Cable {
    fault: CableFault,
    at_ns: u64,
    random: Random,
    line: heapless::Vec<u8, LINE>,
    held: heapless::Vec<u8, HELD>,
    /// Values of the first frame after the strike, by line, for a chip that answers no more.
    first: [Option<heapless::Vec<i32, MAX_COLUMNS>>; 6],
    /// What FDAT was changed by in this frame: DIFF has to agree or the frame is merely a bad one.
    changed: [i32; MAX_COLUMNS],
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
            first: [const { None }; 6],
            changed: [0; MAX_COLUMNS],
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

    /// What happens without any byte: a port that closes or comes back, bytes let go after a stall.
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

    fn spoil(&mut self, line: &mut heapless::Vec<u8, LINE>, now_ns: u64, sink: &mut impl FnMut(BoardEvent)) {
        use CableFault as F;
        let key = Line::ALL.iter().position(|key| line.starts_with(key.key()));
        let is = |wanted: Line| key.is_some_and(|key| Line::ALL[key] == wanted);
        if is(Line::Touch) {
            self.frames += 1;
        }
        match self.fault {
            F::Garbage => {
                let mut noise = [0; 40];
                noise.fill_with(|| self.random.byte());
                send(&noise, now_ns, sink);
            }
            F::TornLine if is(Line::Filtered) => line.truncate(line.len() / 2),
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
            F::NumberTooLarge if is(Line::Filtered) => replace(line, b"FDAT: 99999 1 2\r\n"),
            F::NotANumber if is(Line::Filtered) => replace(line, b"FDAT: NaN inf -1\r\n"),
            F::ColumnMissing if key.is_some() => {
                let cut = line.iter().rposition(|&byte| byte == b' ').unwrap_or(0);
                line.truncate(cut);
                append(line, b"\r\n");
            }
            F::ColumnExtra if key.is_some() => {
                line.truncate(line.len().saturating_sub(2));
                append(line, b" 700\r\n");
            }
            F::LineRepeated => send(line, now_ns, sink),
            F::LineMissing if is(Line::Baseline) => return,
            F::TouchSketch => replace(line, b"Electrode 3 was touched\r\n"),
            F::Silent | F::Unplugged | F::PortRefused => return,
            F::Replugged if self.closed_ns != Some(u64::MAX) => return,
            F::HostStall if self.closed_ns.is_none() => return append(&mut self.held, line),
            F::SlowBoard if self.frames % 2 == 1 => return,
            F::Thresholds if is(Line::TouchThreshold) => {
                replace(line, b"TTHS: 1 2 3 4 5 6 7 8 9 10 11 12 13\r\n")
            }
            F::Frozen | F::ChipReset => self.edit(line, key),
            F::TaxelStuck
            | F::TaxelDead
            | F::TaxelSaturated
            | F::TaxelNoisy
            | F::TaxelDrifting
            | F::CommonMode => self.edit(line, key),
            _ => {}
        }
        send(line, now_ns, sink);
    }

    /// Changes values and prints the line again, so that the frame stays a good one.
    fn edit(&mut self, line: &mut heapless::Vec<u8, LINE>, key: Option<usize>) {
        let Some(key) = key else { return };
        let Some(mut values) = values(&line[Line::ALL[key].key().len()..]) else { return };
        let first = self.first[key].get_or_insert_with(|| values.clone()).clone();
        match (self.fault, Line::ALL[key]) {
            (CableFault::Frozen, _) => values = first,
            (CableFault::ChipReset, _) => values.fill(0),
            (_, Line::Filtered) => {
                self.changed = [0; MAX_COLUMNS];
                for column in 0..values.len() {
                    let new = self.struck(column, values[column], first[column]);
                    self.changed[column] = new - values[column];
                    values[column] = new;
                }
            }
            (_, Line::Difference) => {
                for (value, changed) in values.iter_mut().zip(self.changed) {
                    *value -= changed;
                }
            }
            _ => {}
        }
        print(line, Line::ALL[key], &values);
    }

    fn struck(&mut self, column: usize, value: i32, first: i32) -> i32 {
        let one = column == STRUCK_TAXEL;
        let noise = i32::try_from(self.random.below(41)).unwrap_or(0) - 20;
        let frames = i32::try_from(self.frames).unwrap_or(0);
        match self.fault {
            CableFault::TaxelStuck if one => first,
            CableFault::TaxelDead if one => 950,
            CableFault::TaxelSaturated if one => 0,
            CableFault::TaxelNoisy if one => value + noise,
            CableFault::TaxelDrifting if one => (value - frames / 4).max(1),
            CableFault::CommonMode if value > 0 => value - 12,
            _ => value,
        }
    }
}

fn values(text: &[u8]) -> Option<heapless::Vec<i32, MAX_COLUMNS>> {
    core::str::from_utf8(text).ok()?.split_ascii_whitespace().map(|word| word.parse().ok()).collect()
}

fn print(line: &mut heapless::Vec<u8, LINE>, key: Line, values: &[i32]) {
    line.clear();
    append(line, key.key());
    for (i, value) in values.iter().enumerate() {
        let mut word = heapless::String::<12>::new();
        let space = if i == 0 { "" } else { " " };
        // Twelve characters hold any value with its space.
        let _ = write!(word, "{space}{value}");
        append(line, word.as_bytes());
    }
    append(line, b"\r\n");
}

fn replace<const N: usize>(line: &mut heapless::Vec<u8, N>, bytes: &[u8]) {
    line.clear();
    append(line, bytes);
}

/// What does not fit is lost, as in a full buffer of the operating system.
fn append<const N: usize>(line: &mut heapless::Vec<u8, N>, bytes: &[u8]) {
    let room = bytes.len().min(N - line.len());
    let _ = line.extend_from_slice(&bytes[..room]);
}

fn send(bytes: &[u8], at_ns: u64, sink: &mut impl FnMut(BoardEvent)) {
    for part in bytes.chunks(Chunk::CAPACITY) {
        sink(BoardEvent::Bytes(Chunk::new(at_ns, part)));
    }
}

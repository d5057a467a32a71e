//! Ages of what a host reads, exact per electrode, beside what the reader (`moca-tactile`) makes of the same bytes.

use crate::mpr121::{ELECTRODES, Signal};
use crate::{Board, Hex, Settings};
use anyhow::{Result, ensure};
use moca_tactile::board::{BoardMonitor, MAX_ELECTRODES};
use moca_tactile::datastream::{Event, Parser};
use moca_tactile::touchline::{Content, parse};
use serde::Serialize;

/// Timing of a board's readings, as `moca-lab latency` reads it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Which board, and which of the two views.
    pub board: String,
    /// Refreshes a second that came of each chip, by their codes.
    pub rate_hz: f64,
    /// Age of the oldest electrode when a frame comes, ms.
    pub age_mean_ms: f64,
    /// Largest age of a reading, ms.
    pub age_worst_ms: f64,
    /// Age of the oldest electrode just before it is replaced, worst, ms.
    pub hold_worst_ms: f64,
}

/// Both views of one run, and what only this tool sees.
#[derive(Clone, Debug)]
pub struct Measured {
    /// By the chip's own times.
    pub exact: Report,
    /// By the reader: no earlier than the truth may have been.
    pub read: Report,
    /// Data lines and frames that never came, and bad ones.
    pub lost: u64,
    /// Frames that failed a check.
    pub bad: u64,
    /// Data lines that came.
    pub frames: u64,
    /// Least arrival − stamp, us (board and host share a clock here).
    pub least_transport_us: u64,
    /// Largest error by which the reader took a reading for younger than it was, ms.
    /// It is not above 0 if the ages are right.
    pub too_young_ms: f64,
    /// Filters of the board's own chip and time of a scan, us.
    pub filters: (u32, u32, f64),
}

#[derive(Default)]
struct Ages {
    sum_ms: f64,
    count: u32,
    worst_ms: f64,
    hold_ms: f64,
}

impl Ages {
    fn add(&mut self, age_ms: f64) {
        self.sum_ms += age_ms;
        self.count += 1;
        self.worst_ms = self.worst_ms.max(age_ms);
    }

    fn report(&self, board: String, rate_hz: f64) -> Report {
        let count = f64::from(self.count);
        Report {
            board,
            rate_hz,
            age_mean_ms: self.sum_ms / count.max(1.0),
            age_worst_ms: self.worst_ms,
            hold_worst_ms: self.hold_ms,
        }
    }
}

/// Values of a line that came, with its stamp.
struct Line {
    stamp_us: Option<u32>,
    bank: usize,
    values: [u16; ELECTRODES],
    usable: bool,
}

/// Lines of either dialect out of a byte stream.
#[derive(Default)]
struct Lines {
    text: Vec<u8>,
    stock: Parser,
}

impl Lines {
    fn take(&mut self, arrival_us: u64, bytes: &[u8], lines: &mut Vec<Line>) {
        let mut rest = bytes;
        while let Some(event) = self.stock.next_event(&mut rest, arrival_us * 1000) {
            if let Event::Frame(stamped) = event {
                let mut values = [0; ELECTRODES];
                values.copy_from_slice(&stamped.frame.filtered[..ELECTRODES]);
                lines.push(Line { stamp_us: None, bank: 0, values, usable: true });
            }
        }
        for &byte in bytes {
            if byte != b'\n' {
                self.text.push(byte);
                continue;
            }
            let text = std::mem::take(&mut self.text);
            let Ok(line) = parse(&text) else { continue };
            let Content::Data(flags) = line.content else { continue };
            lines.push(Line {
                stamp_us: Some(line.device_us),
                bank: usize::from(line.bank),
                values: line.values,
                usable: flags.0 & 0x70 == 0,
            });
        }
    }
}

/// Address of the chip of each bank.
const BANK_ADDRESSES: [u8; 4] = [0x5C, 0x5D, 0x5A, 0x5B];

/// Runs `hex` for `seconds` with coded values and measures what arrives. `command` is sent first.
pub fn measure(hex: &Hex, name: &str, settings: &Settings, command: &[u8], seconds: f64) -> Result<Measured> {
    let settings = Settings { signal: Signal::Coded, ..settings.clone() };
    let mut board = Board::new(hex, &settings)?;
    board.plug_in()?;
    board.send(command);
    let start_us = board.now_us() + 1_000_000;
    let end_us = start_us + (seconds * 1e6) as u64;
    let mut reader = BoardMonitor::new([true; MAX_ELECTRODES]);
    let mut lines = Lines::default();
    let (mut exact, mut read) = (Ages::default(), Ages::default());
    let mut last_exact: [Option<[f64; ELECTRODES]>; 4] = [None; 4];
    let mut last_read: [Option<u64>; 4] = [None; 4];
    // Middle of the window of the newest refresh that came, us, and how many came.
    let (mut newest_of, mut refreshes) = ([0.0f64; 4], 0u32);
    let mut least_transport_us = u64::MAX;
    let mut too_young_ms = f64::NEG_INFINITY;
    let mut packets: Vec<(u64, Vec<u8>)> = Vec::new();
    while board.now_us() < end_us {
        let next_us = board.now_us() + settings.poll_us;
        board.step_until(next_us, &mut |arrival_us, bytes| packets.push((arrival_us, bytes.to_vec())))?;
        for (arrival_us, bytes) in packets.drain(..) {
            let mut came = Vec::new();
            lines.take(arrival_us, &bytes, &mut came);
            // Of the refresh that the line shows, if only in part: the reader's claim is about that one.
            let mut newest_us = None;
            for line in came.iter().filter(|line| line.usable && arrival_us >= start_us) {
                let now_us = arrival_us as f64;
                let Some(chip) = board.chips().at(BANK_ADDRESSES[line.bank]) else { continue };
                let sampled: Vec<f64> =
                    (0..ELECTRODES).filter_map(|e| chip.sampled_at_us(e, line.values[e], now_us)).collect();
                ensure!(sampled.len() == ELECTRODES, "a value that the chip never had at {now_us} us");
                let oldest_us = sampled.iter().copied().fold(f64::INFINITY, f64::min);
                let newest = sampled.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                newest_us = Some(newest);
                // Electrodes of one refresh lie a scan apart, refreshes at least four times that.
                if newest > newest_of[line.bank] + 2_000.0 {
                    refreshes += 1;
                    newest_of[line.bank] = newest;
                }
                exact.add((now_us - oldest_us) * 1e-3);
                let mut kept = [0.0; ELECTRODES];
                kept.copy_from_slice(&sampled);
                if let Some(before) = last_exact[line.bank] {
                    // each electrode on its own: held until a newer value of it comes
                    for e in 0..ELECTRODES {
                        if kept[e] > before[e] {
                            exact.hold_ms = exact.hold_ms.max((now_us - before[e]) * 1e-3);
                        }
                    }
                }
                last_exact[line.bank] = Some(kept);
                if let Some(stamp_us) = line.stamp_us {
                    least_transport_us = least_transport_us.min(arrival_us - u64::from(stamp_us));
                }
            }
            let mut rest = bytes.as_slice();
            while let Some(frame) = reader.next_frame(&mut rest, arrival_us * 1000) {
                if arrival_us < start_us {
                    continue;
                }
                let slot = &mut last_read[usize::from(frame.bank)];
                if *slot != Some(frame.sampled_at_ns) {
                    read.add((frame.complete_ns - frame.sampled_at_ns) as f64 * 1e-6);
                    if let Some(before_ns) = slot.replace(frame.sampled_at_ns) {
                        read.hold_ms = read.hold_ms.max((frame.complete_ns - before_ns) as f64 * 1e-6);
                    }
                }
                if let Some(newest_us) = newest_us {
                    too_young_ms = too_young_ms.max((frame.sampled_at_ns as f64 * 1e-3 - newest_us) * 1e-3);
                }
            }
        }
    }
    let rate_hz = f64::from(refreshes) / seconds / settings.chips.len().max(1) as f64;
    let stats = *reader.stats();
    let filters = board.chips().at(0x5C).map(|chip| chip.filters()).unwrap_or_default();
    Ok(Measured {
        exact: exact.report(format!("{name}, exact"), rate_hz),
        read: read.report(format!("{name}, as read"), rate_hz),
        lost: stats.frames_lost,
        bad: stats.frames_bad,
        frames: stats.frames_good,
        least_transport_us,
        too_young_ms,
        filters,
    })
}

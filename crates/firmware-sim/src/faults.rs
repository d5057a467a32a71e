//! The fault list: each fault done to the running firmware, and what the reader must see, in simulated time.

use crate::mpr121::Signal;
use crate::{Board, Hex, Settings};
use anyhow::{Result, ensure};
use moca_msgs::BoardFault;
use moca_tactile::board::{BoardMonitor, BoardStats, MAX_ELECTRODES};
use moca_tactile::touchline::Flags;

/// When a fault begins, us after the port opened.
const FAULT_AT_US: u64 = 1_000_000;

/// One fault and its verdict.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Name of the fault that was injected.
    pub name: &'static str,
    /// Observed behaviour, as a sentence.
    pub seen: String,
    /// Why that is not what it must be.
    pub failure: Option<String>,
}

/// A board with its reader; every fault that the reader reports, with its time.
struct Watch {
    board: Board,
    reader: BoardMonitor,
    start_us: u64,
    /// (us since the start, fault) at each change.
    changes: Vec<(u64, Option<BoardFault>)>,
    /// All flags that any line carried since the last look.
    flags: Flags,
    last_frame_us: u64,
    /// Arrival and age of every usable frame, us.
    ages: Vec<(u64, u64)>,
    refused_writes: u32,
}

impl Watch {
    fn new(hex: &Hex, settings: &Settings) -> Result<Self> {
        let mut board = Board::new(hex, settings)?;
        board.plug_in()?;
        let start_us = board.now_us();
        let reader = BoardMonitor::new([true; MAX_ELECTRODES]);
        let mut watch = Self {
            board,
            reader,
            start_us,
            changes: Vec::new(),
            flags: Flags::default(),
            last_frame_us: 0,
            ages: Vec::new(),
            refused_writes: 0,
        };
        watch.run_until(FAULT_AT_US)?;
        ensure!(watch.fault() == Some(None), "not well before the fault: {:?}", watch.changes.last());
        watch.flags = Flags::default();
        watch.ages.clear();
        Ok(watch)
    }

    fn fault(&self) -> Option<Option<BoardFault>> {
        self.changes.last().map(|change| change.1)
    }

    /// To `us` after the port opened, in steps of a tick.
    fn run_until(&mut self, us: u64) -> Result<()> {
        let mut packets: Vec<(u64, Vec<u8>)> = Vec::new();
        while self.board.now_us() < self.start_us + us {
            let next_us = self.board.now_us() + 1000;
            self.board.step_until(next_us, &mut |at_us, bytes| packets.push((at_us, bytes.to_vec())))?;
            for (at_us, bytes) in packets.drain(..) {
                let mut rest = bytes.as_slice();
                while let Some(frame) = self.reader.next_frame(&mut rest, at_us * 1000) {
                    self.last_frame_us = at_us - self.start_us;
                    self.ages.push((self.last_frame_us, at_us - frame.sampled_at_ns / 1000));
                }
                self.flags = self.flags | self.reader.flags();
            }
            let fault = self.reader.fault(self.board.now_us() * 1000);
            if self.fault() != Some(fault) {
                self.changes.push((self.board.now_us() - self.start_us, fault));
            }
        }
        self.refused_writes = self.board.chips().iter_mut().map(|chip| chip.refused_writes).sum();
        Ok(())
    }

    /// Time from the fault until `fault` was first reported, us.
    fn found_after(&self, fault: BoardFault) -> Option<u64> {
        self.changes
            .iter()
            .find(|(us, f)| *us >= FAULT_AT_US && *f == Some(fault))
            .map(|(us, _)| us - FAULT_AT_US)
    }

    fn healthy_after(&self, us: u64) -> Option<u64> {
        let (since, fault) = *self.changes.last()?;
        (fault.is_none()).then(|| since.saturating_sub(us))
    }

    fn stats(&self) -> BoardStats {
        *self.reader.stats()
    }
}

/// A check of one number: (what, microseconds, most).
type Within = (&'static str, Option<u64>, u64);

fn verdict(name: &'static str, watch: &Watch, checks: &[Within], extra: Option<String>) -> Outcome {
    let mut seen: Vec<String> = Vec::new();
    let mut failure = extra;
    for (what, us, most_us) in checks {
        match us {
            Some(us) => seen.push(format!("{what} {:.1} ms", *us as f64 * 1e-3)),
            None => seen.push(format!("{what} never")),
        }
        if us.is_none_or(|us| us > *most_us) {
            failure.get_or_insert(format!("{what}: {us:?} us, at most {most_us} us allowed"));
        }
    }
    if watch.refused_writes > 0 {
        failure.get_or_insert(format!("{} writes while the chip ran", watch.refused_writes));
    }
    let stats = watch.stats();
    seen.push(format!("{} frames, {} lost, {} bad", stats.frames_good, stats.frames_lost, stats.frames_bad));
    Outcome { name, seen: seen.join(", "), failure }
}

/// Does every fault of the list to a board of its own; `soak_s` of faultless running come last.
pub fn run(hex: &Hex, soak_s: f64, tell: &mut dyn FnMut(&Outcome)) -> Result<bool> {
    type Case = fn(&Hex) -> Result<Outcome>;
    let cases: [Case; 10] = [
        nack,
        chip_reset,
        stuck_sda,
        stalled_host,
        over_current,
        out_of_range,
        port_closed,
        touch_1200,
        oscillator,
        long_wires,
    ];
    let mut all_well = true;
    for case in cases {
        let outcome = case(hex)?;
        all_well &= outcome.failure.is_none();
        tell(&outcome);
    }
    let outcome = soak(hex, soak_s)?;
    all_well &= outcome.failure.is_none();
    tell(&outcome);
    Ok(all_well)
}

fn nack(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    set_mute(&mut watch, true);
    watch.run_until(FAULT_AT_US + 300_000)?;
    set_mute(&mut watch, false);
    watch.run_until(FAULT_AT_US + 700_000)?;
    let checks = [
        ("flagged after", first_of(&watch, &[BoardFault::Frozen, BoardFault::Reset]), 8_000),
        ("good again after", watch.healthy_after(FAULT_AT_US + 300_000), 60_000),
    ];
    Ok(verdict("chip does not answer for 0.3 s", &watch, &checks, None))
}

fn set_mute(watch: &mut Watch, mute: bool) {
    watch.board.chips().iter_mut().for_each(|chip| chip.mute = mute);
}

fn first_of(watch: &Watch, faults: &[BoardFault]) -> Option<u64> {
    faults.iter().filter_map(|fault| watch.found_after(*fault)).min()
}

fn chip_reset(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    let gain = watch.board.chips().at(0x5C).map(|chip| chip.gain());
    watch.board.chips().iter_mut().for_each(|chip| chip.reset());
    watch.run_until(FAULT_AT_US + 300_000)?;
    let kept = watch.board.chips().at(0x5C).map(|chip| chip.gain());
    let checks = [
        ("flagged after", watch.found_after(BoardFault::Reset), 20_000),
        ("good again after", watch.healthy_after(FAULT_AT_US), 60_000),
    ];
    let extra = (gain != kept).then(|| "the gain changed".to_owned());
    Ok(verdict("chip reset", &watch, &checks, extra))
}

fn stuck_sda(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    watch.board.sda_stuck = true;
    watch.run_until(FAULT_AT_US + 500_000)?;
    watch.board.sda_stuck = false;
    watch.run_until(FAULT_AT_US + 700_000)?;
    let flagged = watch.flags.bus_fault();
    let checks = [("good again after", watch.healthy_after(FAULT_AT_US), 60_000)];
    let extra = (!flagged).then(|| "no line said so".to_owned());
    Ok(verdict("SDA held low until nine clocks", &watch, &checks, extra))
}

fn stalled_host(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    watch.board.stalled = true;
    watch.run_until(FAULT_AT_US + 400_000)?;
    watch.board.stalled = false;
    watch.run_until(FAULT_AT_US + 800_000)?;
    // Which lines came after the stall, and did the reader know how old each was?
    let after: Vec<u64> =
        watch.ages.iter().filter(|(us, _)| *us >= FAULT_AT_US + 400_000).map(|(_, age)| *age).collect();
    let old = after.iter().filter(|age| **age > 100_000).count();
    let stats = watch.stats();
    let extra = if stats.frames_bad > 0 {
        Some(format!("{} torn lines", stats.frames_bad))
    } else if old == 0 || old > 3 {
        // One waits in the endpoint, one in the sketch. A third is called old where the first line after them continues a
        // read whose line was dropped: the reader then counts from the last line that it has.
        Some(format!("{old} lines called old, 1 to 3 expected"))
    } else if stats.frames_lost < 80 || !watch.flags.has(Flags::DROPPED) {
        Some(format!("only {} frames counted as lost", stats.frames_lost))
    } else {
        None
    };
    let fresh = watch.ages.iter().find(|(us, age)| *us >= FAULT_AT_US + 400_000 && *age < 12_000);
    let checks = [("fresh after", fresh.map(|(us, _)| us - FAULT_AT_US - 400_000), 12_000)];
    Ok(verdict("host stalls 0.4 s", &watch, &checks, extra))
}

fn over_current(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    watch.board.chips().iter_mut().for_each(|chip| chip.over_current = true);
    watch.run_until(FAULT_AT_US + 200_000)?;
    let checks = [("flagged after", watch.found_after(BoardFault::Chip), 10_000)];
    Ok(verdict("over-current", &watch, &checks, None))
}

fn out_of_range(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    watch.board.chips().iter_mut().for_each(|chip| chip.out_of_range = true);
    watch.run_until(FAULT_AT_US + 200_000)?;
    let checks = [("flagged after", watch.found_after(BoardFault::Chip), 10_000)];
    Ok(verdict("electrode out of range", &watch, &checks, None))
}

fn port_closed(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    watch.board.set_open(false)?;
    // what the host's driver still holds goes with the port
    watch.run_until(FAULT_AT_US + 20_000)?;
    let before = watch.stats().bytes;
    watch.run_until(FAULT_AT_US + 400_000)?;
    let meanwhile = watch.stats().bytes - before;
    watch.board.set_open(true)?;
    let opened_us = watch.board.now_us() - watch.start_us;
    watch.run_until(FAULT_AT_US + 800_000)?;
    let first = watch.ages.iter().find(|(us, _)| *us >= opened_us).copied();
    let old = first.is_some_and(|(_, age)| age > 20_000);
    let extra = if meanwhile > 0 {
        Some(format!("{meanwhile} bytes while closed"))
    } else {
        old.then(|| "the first frame was old".to_owned())
    };
    let checks = [("fresh after", first.map(|(us, _)| us - opened_us), 20_000)];
    Ok(verdict("port closed and opened", &watch, &checks, extra))
}

fn touch_1200(hex: &Hex) -> Result<Outcome> {
    let mut watch = Watch::new(hex, &Settings::default())?;
    let took = watch.board.touch_1200()?;
    let checks = [("reset after", took, 600_000)];
    Ok(verdict("1200-baud touch for the bootloader", &watch, &checks, None))
}

fn oscillator(hex: &Hex) -> Result<Outcome> {
    let mut seen = Vec::new();
    let mut failure = None;
    for chip_clock in [0.9, 1.1] {
        let settings = Settings { chip_clock, ..Settings::default() };
        let measured = crate::measure::measure(hex, "", &settings, b"", 3.0)?;
        seen.push(format!(
            "x {chip_clock}: {:.0} refreshes/s, held to {:.1} ms, read as {:.1} ms, {} lost",
            measured.exact.rate_hz, measured.exact.hold_worst_ms, measured.read.hold_worst_ms, measured.lost
        ));
        if measured.lost > 0 || measured.bad > 0 || measured.read.hold_worst_ms < measured.exact.hold_worst_ms
        {
            failure = Some(format!("clock x {chip_clock}: {measured:?}"));
        }
    }
    Ok(Outcome { name: "chip's oscillator 10 % off", seen: seen.join("; "), failure })
}

fn long_wires(hex: &Hex) -> Result<Outcome> {
    let settings =
        Settings { capacitance_pf: 65.0, signal: Signal::Counts { noise: 0.7 }, ..Settings::default() };
    let mut watch = Watch::new(hex, &settings)?;
    watch.run_until(FAULT_AT_US + 500_000)?;
    let (first, second, scan_us) =
        watch.board.chips().at(0x5C).map(|chip| chip.filters()).unwrap_or_default();
    let checks = [("last frame", Some((FAULT_AT_US + 500_000).saturating_sub(watch.last_frame_us)), 12_000)];
    let extra = (scan_us > 1000.0 || first == 34).then(|| format!("FFI {first}, scan {scan_us} us of 1000"));
    let mut outcome = verdict("60 pF of wire", &watch, &checks, extra);
    outcome.seen += &format!(", FFI {first} x SFI {second}, scan {scan_us:.0} us");
    Ok(outcome)
}

fn soak(hex: &Hex, seconds: f64) -> Result<Outcome> {
    let settings = Settings { chip_clock: 1.00037, ..Settings::default() };
    let measured = crate::measure::measure(hex, "", &settings, b"", seconds)?;
    let seen = format!(
        "{seconds} s: {} frames, {} lost, {} bad, held to {:.2} ms, read as {:.2} ms",
        measured.frames,
        measured.lost,
        measured.bad,
        measured.exact.hold_worst_ms,
        measured.read.hold_worst_ms
    );
    let well = measured.lost == 0
        && measured.bad == 0
        && measured.exact.hold_worst_ms <= measured.read.hold_worst_ms
        && measured.too_young_ms <= 0.2;
    let failure = (!well).then(|| format!("{measured:?}"));
    Ok(Outcome { name: "long run", seen, failure })
}

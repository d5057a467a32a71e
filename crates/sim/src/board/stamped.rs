//! The board with our own firmware: each refresh of the chip one line, at the times that the firmware's simulation
//! shows (`crates/firmware-sim`).

use super::{BoardFailure, FAR};
use crate::foam::{Foam, FoamState};
use crate::sensor::CoverSensor;
use moca_tactile::board::LEAST_TRANSPORT_NS;
use moca_tactile::datastream::ELECTRODES;
use moca_tactile::touchline::{Content, Flags, LINE_BYTES, Line, emit};
use std::collections::VecDeque;

/// Samples in one refresh.
pub(super) const SAMPLES_PER_VALUE: u32 = 4;
/// Sample interval of a chip whose oscillator is 1.3 % slow, so that its refreshes slide against the reads.
const SAMPLE_INTERVAL_NS: u64 = 1_013_000;
/// Noise of 34 × 4 samples where stock's 10 × 10 have 0.7 counts (computed for white noise; nobody has measured it).
pub(super) const NOISE_SHARE: f64 = 0.62 / 0.7;
/// The electrodes show a refresh one after the other.
const SCAN_STEP_NS: u64 = 68_000;
const READ_INTERVAL_NS: u64 = 1_000_000;
const AT_LATEST_NS: u64 = 5_000_000;
const BASELINE_EVERY_NS: u64 = 250_000_000;
/// A baseline is read when no refresh is due: this long after the last one was seen.
const QUIET_NS: core::ops::Range<u64> = 1_500_000..2_600_000;
const FAULT_EVERY_NS: u64 = 20_000_000;
/// From a reset of the chip to good data.
const RESET_NS: u64 = 22_000_000;
/// 1.5 ms from the middle of the window to the refresh and 1 ms until the read.
const AGE_TENTHS_MS: u8 = 25;
/// The host polls each millisecond, at a phase of its own.
const POLL_INTERVAL_NS: u64 = 1_000_000;
const POLL_PHASE_NS: u64 = 333_000;
/// Lines on their way at once; more are dropped as the firmware drops them.
const ON_THE_WAY: usize = 8;

#[derive(Clone, Debug)]
pub(super) struct StampedBoard {
    foam: Foam,
    foams: [FoamState; ELECTRODES],
    sensor: CoverSensor<ELECTRODES>,
    before: [u16; ELECTRODES],
    refreshed_ns: u64,
    next_sample_ns: u64,
    next_read_ns: u64,
    clock_start_us: u32,
    last_read: [u16; ELECTRODES],
    changed_last: bool,
    sequence: u16,
    last_sent_ns: u64,
    last_changed_ns: u64,
    last_baseline_ns: Option<u64>,
    reset_since_ns: Option<u64>,
    on_the_way: VecDeque<(u64, LineBytes)>,
}

#[derive(Clone, Copy, Debug)]
struct LineBytes {
    bytes: [u8; LINE_BYTES + 1],
    length: usize,
}

impl Extend<u8> for LineBytes {
    fn extend<I: IntoIterator<Item = u8>>(&mut self, bytes: I) {
        for byte in bytes {
            if let Some(place) = self.bytes.get_mut(self.length) {
                *place = byte;
                self.length += 1;
            }
        }
    }
}

impl StampedBoard {
    /// A chip that has been running; its first line is read at `first_read_ns`.
    pub(super) fn new(
        foam: Foam,
        mut sensor: CoverSensor<ELECTRODES>,
        first_read_ns: u64,
        clock_start_us: u32,
    ) -> Self {
        for _ in 0..SAMPLES_PER_VALUE {
            sensor.sample(&[0.0; ELECTRODES], &FAR);
        }
        let values = *sensor.fdat();
        Self {
            foam,
            foams: [FoamState::default(); ELECTRODES],
            sensor,
            before: values,
            refreshed_ns: 0,
            next_sample_ns: SAMPLE_INTERVAL_NS,
            next_read_ns: first_read_ns,
            clock_start_us,
            last_read: values,
            changed_last: false,
            sequence: 0,
            last_sent_ns: 0,
            last_changed_ns: 0,
            last_baseline_ns: None,
            reset_since_ns: None,
            on_the_way: VecDeque::with_capacity(ON_THE_WAY),
        }
    }

    pub(super) fn advance(
        &mut self,
        now_ns: u64,
        force_n: &[f64],
        fault: Option<BoardFailure>,
        sink: &mut impl FnMut(&[u8]),
    ) {
        loop {
            let out_ns = self.on_the_way.front().map_or(u64::MAX, |(out_ns, _)| *out_ns);
            let next_ns = self.next_sample_ns.min(self.next_read_ns).min(out_ns);
            if next_ns > now_ns {
                return;
            }
            if self.next_sample_ns == next_ns {
                self.sample(force_n);
            } else if self.next_read_ns == next_ns {
                self.read(next_ns, fault);
                self.next_read_ns += READ_INTERVAL_NS;
            } else if let Some((_, line)) = self.on_the_way.pop_front() {
                sink(&line.bytes[..line.length]);
            }
        }
    }

    fn sample(&mut self, force_n: &[f64]) {
        const DT_S: f64 = 1e-9 * SAMPLE_INTERVAL_NS as f64;
        let mut deformation_m = [0.0; ELECTRODES];
        for (i, (foam, force_n)) in self.foams.iter_mut().zip(force_n).enumerate() {
            let force_n = if force_n.is_finite() { *force_n } else { 0.0 };
            deformation_m[i] = foam.step_force(&self.foam, force_n, DT_S);
        }
        let before = *self.sensor.fdat();
        if self.sensor.sample(&deformation_m, &FAR) {
            self.before = before;
            self.refreshed_ns = self.next_sample_ns;
        }
        self.next_sample_ns += SAMPLE_INTERVAL_NS;
    }

    /// Returns the values of the chip at `at_ns`.
    fn shown(&self, at_ns: u64) -> [u16; ELECTRODES] {
        let after = self.sensor.fdat();
        let mut shows_ns = self.refreshed_ns;
        std::array::from_fn(|e| {
            shows_ns += SCAN_STEP_NS;
            if at_ns >= shows_ns { after[e] } else { self.before[e] }
        })
    }

    fn read(&mut self, at_ns: u64, fault: Option<BoardFailure>) {
        if fault != Some(BoardFailure::ChipReset) {
            self.reset_since_ns = None;
        }
        match fault {
            Some(BoardFailure::Silent) => return,
            Some(BoardFailure::I2cLost) => {
                if at_ns - self.last_sent_ns >= FAULT_EVERY_NS {
                    self.send(at_ns, Flags::BUS_FAULT | Flags::CHIP_RESET);
                }
                return;
            }
            Some(BoardFailure::ChipReset) => {
                let since_ns = *self.reset_since_ns.get_or_insert(at_ns);
                if at_ns - since_ns < RESET_NS {
                    if at_ns - self.last_sent_ns >= AT_LATEST_NS {
                        self.send(at_ns, Flags::CHIP_RESET | Flags::SETTLING);
                    }
                    return;
                }
            }
            None => {}
        }
        let quiet = QUIET_NS.contains(&(at_ns - self.last_changed_ns));
        if self.last_baseline_ns.is_none_or(|last_ns| at_ns - last_ns >= BASELINE_EVERY_NS && quiet) {
            self.last_baseline_ns = Some(at_ns);
            let content = Content::Baseline { age_tenths_ms: AGE_TENTHS_MS };
            return self.put(at_ns, self.sensor.baseline(), content);
        }
        let values = self.shown(at_ns);
        let changed = values != self.last_read;
        let continues = changed && self.changed_last;
        self.last_read = values;
        self.changed_last = changed && !continues;
        if self.changed_last {
            self.last_changed_ns = at_ns;
        }
        if changed || at_ns - self.last_sent_ns >= AT_LATEST_NS {
            let new = if changed { Flags::NEW } else { Flags::default() };
            self.send(at_ns, if continues { new | Flags::CONTINUES } else { new });
        }
    }

    fn send(&mut self, at_ns: u64, flags: Flags) {
        self.sequence = self.sequence.wrapping_add(1);
        self.last_sent_ns = at_ns;
        self.put(at_ns, self.last_read, Content::Data(flags));
    }

    fn put(&mut self, at_ns: u64, values: [u16; ELECTRODES], content: Content) {
        #[expect(clippy::cast_possible_truncation, reason = "the board's clock wraps")]
        let device_us = self.clock_start_us.wrapping_add((at_ns / 1000) as u32);
        let mut bytes = LineBytes { bytes: [0; LINE_BYTES + 1], length: 0 };
        emit(&Line { bank: 0, sequence: self.sequence, device_us, values, content }, &mut bytes);
        let ready_ns = at_ns + LEAST_TRANSPORT_NS;
        let polls = (ready_ns.saturating_sub(POLL_PHASE_NS)).div_ceil(POLL_INTERVAL_NS);
        let mut out_ns = POLL_PHASE_NS + polls * POLL_INTERVAL_NS;
        // one packet a poll
        if let Some((last_ns, _)) = self.on_the_way.back() {
            out_ns = out_ns.max(last_ns + POLL_INTERVAL_NS);
        }
        if self.on_the_way.len() < ON_THE_WAY {
            self.on_the_way.push_back((out_ns, bytes));
        }
    }
}

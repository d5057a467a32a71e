//! A cover of up to `K` taxels on one or more boards: events in, a reading with age and health out.
//!
//! ```
//! use moca_tactile::{Cover, CoverConfig};
//!
//! let mut cover = Cover::<11>::new(CoverConfig::default())?;
//! cover.push(0, b"TOUCH: 0 0", 1_000_000); // bytes of board 0 in any chunking, with their arrival time
//! let poll = cover.poll(2_000_000); // every tick
//! assert!(poll.forces.is_err(), "no zero yet: never 'no contact'");
//! # Ok::<(), moca_tactile::cover::CoverConfigError>(())
//! ```

mod config;

pub use config::{
    CONTACT_OFF_COUNTS, CONTACT_ON_COUNTS, CoverConfig, CoverConfigError, Electrode, MAX_BOARDS, MaskPolicy,
};

use crate::board::{
    BoardEvent, BoardMonitor, FrameSource, MAX_ELECTRODES, SILENT_AFTER_NS, SampledFrame, voids_zero,
};
use crate::cusum::Cusum;
use crate::datastream::ELECTRODES;
use crate::health::TaxelHealth;
use crate::model::{FoamMemory, TaxelModel};
use crate::touchline::BANKS;
use crate::zero::{
    TARE_FRAMES, TARE_TIME_NS, TARE_TIMEOUT_NS, TareQuality, TareRefusal, TareStatus, TareSum, TaxelZero,
};
use moca_msgs::{BoardFault, CoverReading, Fault, TaxelReading, TaxelStatus};

/// For this long after a contact the foam is still recovering, ns: drift is not followed.
const SETTLE_NS: u64 = 2_000_000_000;
/// Taxels needed to tell a common-mode shift from hands.
const COMMON_MODE_TAXELS: usize = 3;
/// Shift of every taxel that makes a common-mode fault, counts.
const COMMON_MODE_COUNTS: f64 = 3.0;
/// Consecutive frames with such a shift.
pub const COMMON_MODE_FRAMES: u32 = 3;

/// One tick's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Poll<const K: usize> {
    /// Every taxel with its status, and when the data was sampled (the oldest of several boards).
    pub reading: CoverReading<K>,
    /// Forces for the controller, N; or the first taxel (0 = T1) that has none. Follows the mask policy.
    pub forces: Result<[f64; K], (usize, TaxelStatus)>,
    /// The gravest fault, if any.
    pub fault: Option<Fault>,
    /// Contact from frames that are not complete yet.
    pub early: EarlyContact<K>,
}

impl<const K: usize> Poll<K> {
    /// A cover that has said nothing yet.
    pub const UNKNOWN: Self = Self {
        reading: CoverReading::UNKNOWN,
        forces: Err((0, TaxelStatus::NoZero)),
        fault: None,
        early: EarlyContact::NONE,
    };
}

/// Contact by data that nothing has confirmed yet, or too light for a force: it may slow a robot down or stop it. A light one may
/// also let a late robot make room, no faster than it may drive until it is certain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EarlyContact<const K: usize> {
    /// Taxels that the reading does not feel, and these data do.
    pub touched: [bool; K],
    /// Taxels that the reading does not feel, and the last frames together do: see [`crate::cusum`].
    pub light: [bool; K],
    /// Taxels that neither feels, and whose last frames are halfway to an alarm: beside a touched one, the same body presses them.
    pub halfway: [bool; K],
    /// Force on each of the last two kinds by its last frame, N; 0 elsewhere.
    pub light_n: [f64; K],
    /// Those of them that are no false alarm: see [`Cusum::is_certain`].
    pub certain: [bool; K],
    /// As [`CoverReading::sampled_at_ns`], with these data counted.
    pub sampled_at_ns: Option<u64>,
}

impl<const K: usize> EarlyContact<K> {
    /// Nobody, at no time.
    pub const NONE: Self = Self {
        touched: [false; K],
        light: [false; K],
        halfway: [false; K],
        light_n: [0.0; K],
        certain: [false; K],
        sampled_at_ns: None,
    };
}

#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Taxel {
    fdat: u16,
    force_n: f64,
    in_contact: bool,
    light: Cusum,
    zero: Option<TaxelZero>,
    health: TaxelHealth,
    memory: FoamMemory,
    tare: TareSum,
}

#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Board<S> {
    source: S,
    banks: [Bank; BANKS],
}

/// Twelve electrodes whose data comes together.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Bank {
    carries_taxels: bool,
    sampled_at_ns: Option<u64>,
    complete_ns: u64,
    common_mode: u32,
}

impl<S> Board<S> {
    fn new(source: S, used: &[bool; MAX_ELECTRODES]) -> Self {
        let mut banks = [Bank::default(); BANKS];
        for (bank, used) in banks.iter_mut().zip(used.chunks(ELECTRODES)) {
            bank.carries_taxels = used.contains(&true);
        }
        Self { source, banks }
    }

    fn wired(&self) -> impl Iterator<Item = &Bank> {
        self.banks.iter().filter(|bank| bank.carries_taxels)
    }
}

/// The cover. Allocates nothing; every method returns in bounded time.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Cover<const K: usize, S: FrameSource = BoardMonitor> {
    config: CoverConfig<K>,
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    taxels: [Taxel; K],
    boards: heapless::Vec<Board<S>, MAX_BOARDS>,
    tare: TareStatus,
    tare_started_ns: u64,
    last_contact_ns: u64,
}

impl<const K: usize> Cover<K> {
    /// A cover of Touch Boards that knows nothing yet.
    pub fn new(config: CoverConfig<K>) -> Result<Self, CoverConfigError> {
        Self::with_sources(config, |_, used| BoardMonitor::new(*used))
    }
}

impl<const K: usize, S: FrameSource> Cover<K, S> {
    /// A cover whose boards are read by sources of one's own: `source(board, used electrodes)`.
    pub fn with_sources(
        config: CoverConfig<K>,
        mut source: impl FnMut(usize, &[bool; MAX_ELECTRODES]) -> S,
    ) -> Result<Self, CoverConfigError> {
        let (used, board_count) = config.check()?;
        let boards = used.iter().enumerate().take(board_count);
        Ok(Self {
            config,
            taxels: [Taxel::default(); K],
            boards: boards.map(|(board, used)| Board::new(source(board, used), used)).collect(),
            tare: TareStatus::None,
            tare_started_ns: 0,
            last_contact_ns: 0,
        })
    }

    /// Takes an event of `board` (0 is the first; others than the configured are ignored).
    pub fn event(&mut self, board: usize, event: &BoardEvent) {
        if let BoardEvent::Bytes(chunk) = event {
            return self.push(board, chunk.bytes(), chunk.arrival_ns);
        }
        let Some(entry) = self.boards.get_mut(board) else { return };
        entry.source.event(event);
        if !matches!(event, BoardEvent::Gap { .. } | BoardEvent::Starved { .. }) {
            self.invalidate(board);
        }
    }

    /// Takes bytes of `board` that arrived at `arrival_ns`, in any chunking.
    pub fn push(&mut self, board: usize, bytes: &[u8], arrival_ns: u64) {
        let mut rest = bytes;
        loop {
            let Some(entry) = self.boards.get_mut(board) else { return };
            let Some(frame) = entry.source.next_frame(&mut rest, arrival_ns) else { break };
            self.frame(board, &frame);
        }
        self.void_zero_on_stream_fault(board, arrival_ns);
    }

    /// Begins a tare. Nobody may touch the cover for about a second; the old zero holds until the new one is done.
    pub fn start_tare(&mut self, now_ns: u64) {
        self.tare_started_ns = now_ns;
        self.tare = TareStatus::InProgress { frames: 0 };
        for taxel in &mut self.taxels {
            taxel.tare = TareSum::default();
        }
    }

    /// Progress or outcome of the last tare.
    pub fn tare_status(&self) -> TareStatus {
        self.tare
    }

    /// Takes a taxel (0 is T1) out of use, or back into it; `false` if there is none with that number. One that comes
    /// back has no zero: what happened to it meanwhile is not known.
    pub fn set_masked(&mut self, taxel: usize, masked: bool) -> bool {
        let (Some(slot), Some(state)) = (self.config.masked.get_mut(taxel), self.taxels.get_mut(taxel))
        else {
            return false;
        };
        if taxel >= self.config.taxels {
            return false;
        }
        if *slot != masked {
            *slot = masked;
            *state = Taxel { fdat: state.fdat, health: state.health, ..Taxel::default() };
        }
        true
    }

    /// Returns true if every taxel in use has a valid zero.
    pub fn zero_valid(&self) -> bool {
        let mut in_use = self.taxels.iter().zip(&self.config.masked).take(self.config.taxels);
        in_use.all(|(taxel, &masked)| masked || taxel.zero.is_some())
    }

    /// Voids zero and gain of one board's taxels, as after re-enumeration.
    pub fn invalidate(&mut self, board: usize) {
        for (taxel, wire) in self.taxels.iter_mut().zip(&self.config.wiring).take(self.config.taxels) {
            if usize::from(wire.board) == board {
                *taxel = Taxel { fdat: taxel.fdat, ..Taxel::default() };
            }
        }
        if let Some(entry) = self.boards.get_mut(board) {
            for bank in &mut entry.banks {
                bank.common_mode = 0;
            }
        }
        self.tare = match self.tare {
            TareStatus::InProgress { .. } => TareStatus::Refused(TareRefusal::StreamFault),
            TareStatus::Done(_) => TareStatus::None,
            other => other,
        };
    }

    /// Reading, forces and fault at `now_ns`.
    pub fn poll(&mut self, now_ns: u64) -> Poll<K> {
        let mut poll = Poll::UNKNOWN;
        self.poll_into(now_ns, &mut poll);
        poll
    }

    /// `poll` becomes what [`Self::poll`] gives, where it stands: it is large.
    pub fn poll_into(&mut self, now_ns: u64, poll: &mut Poll<K>) {
        for board in 0..self.boards.len() {
            self.void_zero_on_stream_fault(board, now_ns);
        }
        if matches!(self.tare, TareStatus::InProgress { .. })
            && now_ns.saturating_sub(self.tare_started_ns) > TARE_TIMEOUT_NS
        {
            self.tare = TareStatus::Refused(TareRefusal::NoFrames);
        }
        let Poll { reading, forces, fault, early } = poll;
        *reading = CoverReading::UNKNOWN;
        // once a board, not once a taxel
        let faults: [_; MAX_BOARDS] =
            core::array::from_fn(|board| self.boards.get(board).and_then(|board| board.source.fault(now_ns)));
        for (i, slot) in reading.taxels.iter_mut().enumerate().take(self.config.taxels) {
            let status = self.status(i, now_ns, &faults);
            let force_n = if status == TaxelStatus::Ok { self.taxels[i].force_n } else { 0.0 };
            *slot = TaxelReading { force_n, status };
        }
        reading.sampled_at_ns = oldest(self.boards.iter().flat_map(Board::wired).map(|b| b.sampled_at_ns));
        self.forces(reading, forces);
        *fault = self.fault(forces, now_ns);
        self.early(early);
    }

    /// FDAT of the last usable frame, T1 first; 0 before one came.
    pub fn counts(&self) -> [u16; K] {
        let mut counts = [0; K];
        for (count, taxel) in counts.iter_mut().zip(&self.taxels).take(self.config.taxels) {
            *count = taxel.fdat;
        }
        counts
    }

    /// Largest standard deviation of a taxel in the zero in force, counts; 0 without one.
    pub fn deviation_counts(&self) -> f64 {
        let zeros = self.taxels.iter().take(self.config.taxels).filter_map(|taxel| taxel.zero.as_ref());
        zeros.fold(0.0, |worst, zero| worst.max(zero.deviation))
    }

    /// Zero of each taxel, T1 first.
    pub fn zeros(&self) -> [Option<TaxelZero>; K] {
        core::array::from_fn(|i| self.taxels[i].zero)
    }

    /// The sources of the boards; a [`BoardMonitor`] tells statistics, rate, firmware and diagnosis.
    pub fn boards(&self) -> impl ExactSizeIterator<Item = &S> {
        self.boards.iter().map(|b| &b.source)
    }

    fn forces(&self, reading: &CoverReading<K>, forces: &mut Result<[f64; K], (usize, TaxelStatus)>) {
        let taxels = reading.taxels.iter().enumerate().take(self.config.taxels);
        let ignored = |status| status == TaxelStatus::Masked && self.config.mask_policy == MaskPolicy::Ignore;
        let lacking =
            |(_, taxel): &(usize, &TaxelReading)| taxel.status != TaxelStatus::Ok && !ignored(taxel.status);
        if let Some((i, taxel)) = taxels.clone().find(lacking) {
            *forces = Err((i, taxel.status));
            return;
        }
        *forces = Ok([0.0; K]);
        if let Ok(forces) = forces {
            // that of a masked taxel is zero
            taxels.for_each(|(i, taxel)| forces[i] = taxel.force_n);
        }
    }

    /// The gravest fault.
    fn fault(&self, forces: &Result<[f64; K], (usize, TaxelStatus)>, now_ns: u64) -> Option<Fault> {
        let first = |of: &dyn Fn(&Board<S>) -> Option<BoardFault>| {
            (0u8..).zip(&self.boards).find_map(|(number, board)| Some(of(board)?.of(number)))
        };
        let mismatch = |board: &Board<S>| {
            let (expected, found) = self.config.calibrated_firmware.zip(board.source.firmware())?;
            (expected != found).then_some(BoardFault::CalibrationMismatch)
        };
        let common_mode = |board: &Board<S>| {
            let shifted = board.wired().any(|bank| bank.common_mode >= COMMON_MODE_FRAMES);
            shifted.then_some(BoardFault::CommonMode)
        };
        let taxel = || match *forces {
            Ok(_) => None,
            Err((_, TaxelStatus::NoZero)) => Some(Fault::ZeroInvalid),
            // The stream has no fault, so frames do come: each after a gap that makes its age unknown.
            Err((i, TaxelStatus::Stale)) => {
                Some(BoardFault::Slow.of(self.config.wiring.get(i).map_or(0, |wire| wire.board)))
            }
            Err((i, status)) => {
                let taxel = u8::try_from(i).unwrap_or(u8::MAX);
                Some(Fault::TaxelInvalid { taxel, status })
            }
        };
        first(&|board| board.source.fault(now_ns))
            .or_else(|| first(&mismatch))
            .or_else(|| first(&common_mode))
            .or_else(taxel)
    }

    fn status(&self, i: usize, now_ns: u64, faults: &[Option<BoardFault>; MAX_BOARDS]) -> TaxelStatus {
        if self.config.masked[i] {
            return TaxelStatus::Masked;
        }
        let taxel = &self.taxels[i];
        let wire = &self.config.wiring[i];
        let number = usize::from(wire.board);
        let board = self.boards.get(number);
        let bank = board.and_then(|b| b.banks.get(wire.bank()).filter(|bank| bank.sampled_at_ns.is_some()));
        let Some(bank) = bank else { return TaxelStatus::NoZero };
        match faults.get(number).copied().flatten() {
            Some(
                BoardFault::Silent
                | BoardFault::HostStarved
                | BoardFault::Lost
                | BoardFault::Frozen
                | BoardFault::Chip,
            ) => return TaxelStatus::Stale,
            _ if now_ns.saturating_sub(bank.complete_ns) > SILENT_AFTER_NS => return TaxelStatus::Stale,
            _ => {}
        }
        match (taxel.health.status(taxel.zero.as_ref()), taxel.zero) {
            (Some(status), _) => status,
            (None, None) => TaxelStatus::NoZero,
            (None, Some(_)) => TaxelStatus::Ok,
        }
    }

    fn void_zero_on_stream_fault(&mut self, board: usize, now_ns: u64) {
        let fault = self.boards.get(board).and_then(|b| b.source.fault(now_ns));
        let mut wired = self.taxels.iter().zip(&self.config.wiring).take(self.config.taxels);
        let zeroed = wired.any(|(taxel, wire)| usize::from(wire.board) == board && taxel.zero.is_some());
        let taring = matches!(self.tare, TareStatus::InProgress { .. });
        if (zeroed || taring) && fault.is_some_and(voids_zero) {
            self.invalidate(board);
        }
    }

    fn frame(&mut self, board: usize, frame: &SampledFrame) {
        let bank = usize::from(frame.bank);
        let Some(entry) = self.boards.get_mut(board).and_then(|b| b.banks.get_mut(bank)) else { return };
        let dt_ns = frame.complete_ns.saturating_sub(entry.complete_ns).min(SILENT_AFTER_NS);
        let refreshed = entry.sampled_at_ns != Some(frame.sampled_at_ns);
        entry.sampled_at_ns = Some(frame.sampled_at_ns);
        entry.complete_ns = frame.complete_ns;
        #[expect(clippy::cast_precision_loss, reason = "at most 120 ms")]
        let dt_s = dt_ns as f64 * 1e-9;
        let taring = matches!(self.tare, TareStatus::InProgress { .. });
        let settles = self.settles(frame.complete_ns);
        for (i, wire) in self.config.wiring.iter().enumerate().take(self.config.taxels) {
            if wire.is_on(board, bank) {
                let electrode = wire.of_bank();
                self.taxels[i].update(
                    frame.fdat[electrode],
                    &self.config.models[i],
                    [self.config.contact_on_counts, self.config.contact_off_counts],
                    self.config.force_max_n,
                    dt_s,
                );
                if refreshed {
                    self.taxels[i].sum_up(settles, self.config.contact_off_counts, dt_s);
                }
                if taring {
                    self.taxels[i].tare.add(frame.fdat[electrode], frame.baseline[electrode]);
                }
            }
        }
        self.watch_common_mode(board, bank);
        self.follow_drift(board, bank, frame.complete_ns, dt_s);
        self.advance_tare(frame.complete_ns);
    }

    fn early(&self, felt: &mut EarlyContact<K>) {
        *felt = EarlyContact::NONE;
        let EarlyContact { touched, light, halfway, light_n, certain, sampled_at_ns } = felt;
        for (i, taxel) in self.taxels.iter().enumerate().take(self.config.taxels) {
            if self.config.masked[i] {
                continue;
            }
            (light[i], halfway[i]) = (taxel.touched_lightly(), taxel.halfway_to_light());
            if light[i] || halfway[i] {
                light_n[i] = taxel.light_force_n(&self.config.models[i]);
            }
            certain[i] = light[i] && taxel.light.is_certain();
        }
        let mut times: heapless::Vec<Option<u64>, { MAX_BOARDS * BANKS }> = heapless::Vec::new();
        for (number, board) in self.boards.iter().enumerate() {
            let early = board.source.early();
            for (bank, state) in board.banks.iter().enumerate().filter(|(_, state)| state.carries_taxels) {
                let early = early.filter(|early| usize::from(early.bank) == bank);
                // as many places as there are banks
                let _ = times.push(state.sampled_at_ns.map(|t| early.map_or(t, |e| e.sampled_at_ns.max(t))));
                let Some(early) = early else { continue };
                for (i, wire) in self.config.wiring.iter().enumerate().take(self.config.taxels) {
                    if wire.is_on(number, bank) && !self.config.masked[i] {
                        touched[i] = self.taxels[i].would_touch(early.fdat[wire.of_bank()], &self.config);
                    }
                }
            }
        }
        *sampled_at_ns = oldest(times.into_iter());
    }

    /// Returns true during a touch and shortly after it, while a foam may still recover: drift is not followed then.
    const fn settles(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.last_contact_ns) < SETTLE_NS
    }

    fn follow_drift(&mut self, board: usize, bank: usize, now_ns: u64, dt_s: f64) {
        if self.taxels.iter().take(self.config.taxels).any(|taxel| taxel.in_contact) {
            self.last_contact_ns = now_ns;
        }
        if self.settles(now_ns) {
            return;
        }
        for (taxel, wire) in self.taxels.iter_mut().zip(&self.config.wiring).take(self.config.taxels) {
            if wire.is_on(board, bank)
                && let Some(zero) = &mut taxel.zero
            {
                zero.follow(taxel.fdat, dt_s);
            }
        }
    }

    fn watch_common_mode(&mut self, board: usize, bank: usize) {
        let (mut drops, mut count) = ([0.0; K], 0);
        for (i, taxel) in self.taxels.iter().enumerate().take(self.config.taxels) {
            if self.config.wiring[i].is_on(board, bank)
                && !self.config.masked[i]
                && let Some(zero) = &taxel.zero
            {
                drops[count] = zero.drop(taxel.fdat);
                count += 1;
            }
        }
        let drops = &mut drops[..count];
        drops.sort_unstable_by(f64::total_cmp);
        let shifted = count >= COMMON_MODE_TAXELS && {
            // Hands may be on up to a quarter of the taxels while the supply sags.
            let (least, most) = (drops[0], drops[count * 3 / 4]);
            let mean = libm::fabs(most + least) / 2.0;
            (least > COMMON_MODE_COUNTS || most < -COMMON_MODE_COUNTS) && most - least <= 0.5 * mean + 2.0
        };
        if let Some(entry) = self.boards.get_mut(board).and_then(|b| b.banks.get_mut(bank)) {
            entry.common_mode = if shifted { entry.common_mode.saturating_add(1) } else { 0 };
        }
    }

    fn advance_tare(&mut self, now_ns: u64) {
        if !matches!(self.tare, TareStatus::InProgress { .. }) {
            return;
        }
        let taxels = self.taxels.iter().enumerate().take(self.config.taxels);
        let in_use = || taxels.clone().filter(|(i, _)| !self.config.masked[*i]);
        let frames = in_use().map(|(_, taxel)| taxel.tare.frames).min().unwrap_or(TARE_FRAMES);
        if frames < TARE_FRAMES || now_ns.saturating_sub(self.tare_started_ns) < TARE_TIME_NS {
            self.tare = TareStatus::InProgress { frames: frames.min(TARE_FRAMES) };
            return;
        }
        let mut zeros = [None; K];
        let mut worst_deviation: f64 = 0.0;
        for (i, taxel) in in_use() {
            match taxel.tare.finish(i, taxel.zero.as_ref(), self.config.expected_rest[i].as_ref()) {
                Ok(zero) => {
                    worst_deviation = worst_deviation.max(zero.deviation);
                    zeros[i] = Some(zero);
                }
                Err(refusal) => {
                    self.tare = TareStatus::Refused(refusal);
                    return;
                }
            }
        }
        for (taxel, zero) in self.taxels.iter_mut().zip(zeros) {
            taxel.zero = zero;
            taxel.in_contact = false;
            taxel.light = Cusum::default();
            taxel.memory = FoamMemory::default();
            taxel.force_n = 0.0;
        }
        self.tare = TareStatus::Done(TareQuality { frames, worst_deviation, finished_ns: now_ns });
    }
}

/// The oldest of several times; `None` if one is missing.
fn oldest(times: impl Iterator<Item = Option<u64>>) -> Option<u64> {
    times.reduce(|a, b| Some(a?.min(b?))).flatten()
}

impl Taxel {
    /// Returns true if `fdat` would begin a contact.
    fn would_touch<const K: usize>(&self, fdat: u16, config: &CoverConfig<K>) -> bool {
        let delta = self.zero.as_ref().map_or(0.0, |zero| zero.gain * zero.drop(fdat));
        !self.in_contact && delta >= config.contact_on_counts
    }

    /// Returns true if the last frames together show a touch that gives no force.
    const fn touched_lightly(&self) -> bool {
        self.light.touched() && !self.in_contact
    }

    /// Returns true if the last frames together are halfway to such a touch.
    const fn halfway_to_light(&self) -> bool {
        self.light.is_halfway() && !self.light.touched() && !self.in_contact
    }

    /// Force of the last frame, N, though it is below the counts at which a contact begins.
    fn light_force_n(&self, model: &TaxelModel) -> f64 {
        let drop = self.zero.as_ref().map_or(0.0, |zero| zero.gain * zero.drop(self.fdat));
        let mut memory = self.memory;
        model.force_n(&mut memory, drop.max(0.0), 0.0)
    }

    /// Takes the present counts, `dt_s` after the last ones, into the test of the last frames. A contact ends `off` counts below
    /// zero; while the foam recovers from it, or the cover `settles` and drifts unfollowed, zero is not known.
    fn sum_up(&mut self, settles: bool, off: f64, dt_s: f64) {
        let Some(zero) = &self.zero else {
            self.light = Cusum::default();
            return;
        };
        let below = zero.drop(self.fdat);
        if self.in_contact {
            self.light = Cusum::recovering_from(off / zero.gain);
        } else if settles || !self.light.has_recovered(zero.deviation) {
            self.light.update_recovering(below, zero.deviation, dt_s);
        } else {
            self.light.update(below, zero.deviation);
        }
    }

    fn update(&mut self, fdat: u16, model: &TaxelModel, [on, off]: [f64; 2], force_max_n: f64, dt_s: f64) {
        self.fdat = fdat;
        self.health.update(fdat, self.zero.as_ref(), on, dt_s);
        if self.health.zero_too_low() {
            (self.zero, self.in_contact, self.force_n) = (None, false, 0.0);
        }
        let Some(zero) = &self.zero else { return };
        let drop = zero.gain * zero.drop(fdat);
        self.in_contact = drop >= if self.in_contact { off } else { on };
        let force_n = model.force_n(&mut self.memory, if self.in_contact { drop } else { 0.0 }, dt_s);
        self.force_n = if self.in_contact { force_n.min(force_max_n) } else { 0.0 };
    }
}

//! The loop without a clock: every tick now, the board's bytes in memory; the same seed gives the same bits.

use crate::board_events::{BoardEvents, NumberedEvent};
use crate::firmware_board::LockStepFirmware;
use crate::ideal_cover::IdealCover;
use crate::inject::{Cable, FaultSite, Injection};
use crate::simulated_robot::{LateForces, SimulatedRobot, true_foam};
use crate::touch_board::{ByteCover, EVENTS_PER_TICK};
use crate::virtual_boards::{fit, nth_board};
use anyhow::Result;
use moca_control::assemble::{cover_config, motion, supervisor};
use moca_control::config::Config;
use moca_control::cover::CoverSource;
use moca_control::stage::{StageTimer, Untimed};
use moca_control::tick::{ControlLoop, Ticked};
use moca_control::tick_input::Slot;
use moca_msgs::{Outcome, Request, Sample};
use moca_sim::{Scene, SimPlant, VirtualBoard, VirtualBoardConfig};
use moca_tactile::board::Chunk;
use moca_tactile::cover::Electrode;
use moca_tactile::datastream::ELECTRODES;
use moca_tactile::{BoardEvent, CloseReason, Cover};
use std::collections::VecDeque;
use std::ops::{Index, IndexMut};
use std::path::Path;

/// Events that a cable holds; a tick sees a handful.
const CABLE_EVENTS: usize = 256;
/// Those of them in the ring to the loop: as many as one tick takes.
const RING_EVENTS: usize = EVENTS_PER_TICK;

/// Way of a board's events to the loop. What the loop cannot take in one tick waits outside the ring, which is small for that: a
/// batch has a thousand of them.
struct Line {
    ring: rtrb::Producer<BoardEvent>,
    waiting: VecDeque<BoardEvent>,
    /// Fault on purpose on the way. Apart, because it is large and rare.
    cable: Option<Box<Cable>>,
}

impl Line {
    /// Returns the line and the loop's end of it.
    fn new() -> (Self, rtrb::Consumer<BoardEvent>) {
        let (ring, events) = rtrb::RingBuffer::new(RING_EVENTS);
        (Self { ring, waiting: VecDeque::new(), cable: None }, events)
    }

    /// Makes room for all that the line can hold.
    fn reserve(&mut self) {
        self.waiting.reserve(CABLE_EVENTS);
    }

    /// Sends an event through the cable, which may spoil it.
    fn send(&mut self, event: BoardEvent) {
        let Some(mut cable) = self.cable.take() else { return self.push(event) };
        cable.pass(event, &mut |event| self.push(event));
        self.cable = Some(cable);
    }

    /// Lets the cable do what it does without bytes until `now_ns`.
    fn wait(&mut self, now_ns: u64) {
        let Some(mut cable) = self.cable.take() else { return };
        cable.wait(now_ns, &mut |event| self.push(event));
        self.cable = Some(cable);
    }

    /// Adds an event. What a full line cannot hold is lost, as in a port.
    fn push(&mut self, event: BoardEvent) {
        self.advance();
        let taken = RING_EVENTS - self.ring.slots();
        if self.waiting.len() + taken < CABLE_EVENTS {
            self.waiting.push_back(event);
            self.advance();
        }
    }

    /// Moves waiting events into the ring as far as it has room; before each tick.
    fn advance(&mut self) {
        while !self.ring.is_full()
            && let Some(event) = self.waiting.pop_front()
        {
            let _ = self.ring.push(event);
        }
    }
}

/// Source of a lock-step cover's data at each tick.
pub trait Feed<S> {
    /// Lets everything pass through a spoiled cable, where there is one.
    fn spoil(&mut self, _cable: Cable) {}

    /// Makes room for the bytes of a long pause, so that none of its ticks allocates.
    fn reserve(&mut self) {}

    /// Returns the forces of the last control period, N, T1 first.
    fn felt<'a>(&self, world: &'a SimPlant) -> &'a [f64] {
        world.taxel_force_true_n()
    }

    /// Lets `cover` have what the true forces, N, give it until `now_ns`.
    fn feed(&mut self, cover: &mut S, now_ns: u64, true_force_n: &[f64]);
}

/// A virtual Touch Board on a cable of memory.
pub struct MemoryBoard {
    board: VirtualBoard,
    line: Line,
    plugged: bool,
    now_ns: u64,
    late: LateForces<ELECTRODES>,
    /// Board and electrode of each taxel, T1 first.
    wiring: Vec<Electrode>,
    number: usize,
}

/// The boards under a cover, the first one first.
pub struct MemoryBoards(Vec<MemoryBoard>);

impl Index<usize> for MemoryBoards {
    type Output = MemoryBoard;

    fn index(&self, board: usize) -> &MemoryBoard {
        &self.0[board]
    }
}

impl IndexMut<usize> for MemoryBoards {
    fn index_mut(&mut self, board: usize) -> &mut MemoryBoard {
        &mut self.0[board]
    }
}

impl MemoryBoard {
    /// The board itself, to inject its faults.
    pub fn board(&mut self) -> &mut VirtualBoard {
        &mut self.board
    }

    /// Pulls the cable.
    pub fn unplug(&mut self) {
        self.plugged = false;
        self.line.push(BoardEvent::Closed { at_ns: self.now_ns, why: CloseReason::Disconnected });
    }

    /// Puts it back: the board boots anew.
    pub fn replug(&mut self) {
        self.plugged = true;
        self.line.push(BoardEvent::Opened { at_ns: self.now_ns });
    }

    /// Puts bytes on the cable as they are.
    pub fn inject(&mut self, bytes: &[u8]) {
        for part in bytes.chunks(Chunk::CAPACITY) {
            self.line.push(BoardEvent::Bytes(Chunk::new(self.now_ns, part)));
        }
    }
}

impl Feed<ByteCover> for MemoryBoards {
    fn reserve(&mut self) {
        self.0.iter_mut().for_each(|board| board.line.reserve());
    }

    /// The first board's cable.
    fn spoil(&mut self, cable: Cable) {
        if let Some(first) = self.0.first_mut() {
            first.line.cable = Some(Box::new(cable));
        }
    }

    fn feed(&mut self, _cover: &mut ByteCover, now_ns: u64, true_force_n: &[f64]) {
        for board in &mut self.0 {
            board.feed(now_ns, true_force_n);
        }
    }
}

impl MemoryBoard {
    fn feed(&mut self, now_ns: u64, true_force_n: &[f64]) {
        self.now_ns = now_ns;
        let felt_n = self.late.pass(by_electrode(&self.wiring, self.number, true_force_n));
        let Self { board, line, plugged, .. } = self;
        line.advance();
        board.advance(now_ns, &felt_n, &mut |bytes: &[u8]| {
            for part in bytes.chunks(Chunk::CAPACITY).filter(|_| *plugged) {
                line.send(BoardEvent::Bytes(Chunk::new(now_ns, part)));
            }
        });
        line.wait(now_ns);
    }
}

/// The firmware itself behind a pipe. A program that ends is a board that was unplugged.
pub struct PipedFirmware {
    firmware: Option<LockStepFirmware>,
    line: Line,
    wiring: Vec<Electrode>,
}

impl Feed<ByteCover> for PipedFirmware {
    fn reserve(&mut self) {
        self.line.reserve();
    }

    fn spoil(&mut self, cable: Cable) {
        self.line.cable = Some(Box::new(cable));
    }

    fn feed(&mut self, _cover: &mut ByteCover, now_ns: u64, true_force_n: &[f64]) {
        let felt_n = by_electrode(&self.wiring, 0, true_force_n);
        let Self { firmware, line, .. } = self;
        line.advance();
        let Some(board) = firmware else { return };
        let advanced = board.advance(now_ns, &felt_n, &mut |arrival_ns, bytes| {
            line.send(BoardEvent::Bytes(Chunk::new(arrival_ns, bytes)));
        });
        line.wait(now_ns);
        if advanced.is_err() {
            line.push(BoardEvent::Closed { at_ns: now_ns, why: CloseReason::Disconnected });
            *firmware = None;
        }
    }
}

/// True forces on the electrodes of one board (0 is the first), N.
fn by_electrode(wiring: &[Electrode], board: usize, true_force_n: &[f64]) -> [f64; ELECTRODES] {
    let mut felt_n = [0.0; ELECTRODES];
    for (wire, force_n) in
        wiring.iter().zip(true_force_n).filter(|(wire, _)| usize::from(wire.board) == board)
    {
        if let Some(place) = felt_n.get_mut(usize::from(wire.electrode)) {
            *place = *force_n;
        }
    }
    felt_n
}

/// Feeds an [`IdealCover`] with the true forces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrueForces {
    /// Those of the last physics step: what is averaged depends on how often the loop runs.
    AtTicks,
    /// Their mean over the physics steps of the last control period: the same for every rate of the loop.
    OfSteps,
}

impl Feed<IdealCover> for TrueForces {
    fn felt<'a>(&self, world: &'a SimPlant) -> &'a [f64] {
        match self {
            Self::AtTicks => world.taxel_force_true_n(),
            Self::OfSteps => world.taxel_force_mean_n(),
        }
    }

    fn feed(&mut self, cover: &mut IdealCover, now_ns: u64, true_force_n: &[f64]) {
        cover.take_forces(now_ns, true_force_n);
    }
}

/// Nothing to feed where there is no cover.
pub struct NoCover;

impl Feed<Option<ByteCover>> for NoCover {
    fn feed(&mut self, _cover: &mut Option<ByteCover>, _now_ns: u64, _true_force_n: &[f64]) {}
}

/// A simulated robot whose ticks the caller makes.
pub struct LockStep<S, F> {
    /// The loop with its plant and cover.
    pub control: ControlLoop<SimulatedRobot, S>,
    /// Source of the cover's data.
    pub feed: F,
    period_ns: u64,
    next_tick: u64,
    overruns: u64,
    skip: Option<(u64, u64)>,
    asked: Option<(u64, Request)>,
}

impl LockStep<ByteCover, MemoryBoards> {
    /// With virtual Touch Boards, as the live daemon has; `board` is the first, the others differ as two boards do.
    ///
    /// # Errors
    /// A scene, board or parameter outside its range.
    pub fn with_board(
        config: &Config,
        scene: &Scene,
        board: VirtualBoardConfig,
        copies: Option<rtrb::Producer<NumberedEvent>>,
    ) -> Result<Self> {
        fit(config)?;
        let (mut boards, mut ports) = (Vec::new(), Vec::new());
        for number in 0..config.board.port.len() {
            let (line, events) = Line::new();
            ports.push(events);
            boards.push(MemoryBoard {
                board: VirtualBoard::new(nth_board(board, number))?,
                line,
                plugged: true,
                now_ns: 0,
                late: LateForces::new(config),
                wiring: config.robot.cover.wiring(),
                number,
            });
        }
        let events = BoardEvents::new(ports).with_recorder(copies);
        let cover = ByteCover::new(Cover::new(cover_config(config)?)?, events);
        Self::new(config, scene, cover, MemoryBoards(boards))
    }
}

impl LockStep<ByteCover, PipedFirmware> {
    /// With the firmware itself, in `program`.
    ///
    /// # Errors
    /// A scene or parameter outside its range; the program cannot be started.
    pub fn with_firmware(
        config: &Config,
        scene: &Scene,
        program: &Path,
        copies: Option<rtrb::Producer<NumberedEvent>>,
    ) -> Result<Self> {
        fit(config)?;
        let (line, events) = Line::new();
        let events = BoardEvents::new([events]).with_recorder(copies);
        let cover = ByteCover::new(Cover::new(cover_config(config)?)?, events);
        let firmware = Some(LockStepFirmware::start(program, true_foam(config))?);
        let wiring = config.robot.cover.wiring();
        Self::new(config, scene, cover, PipedFirmware { firmware, line, wiring })
    }
}

impl LockStep<IdealCover, TrueForces> {
    /// With the true forces instead of a board.
    ///
    /// # Errors
    /// A scene or parameter outside its range.
    pub fn with_true_forces(config: &Config, scene: &Scene, cover: IdealCover) -> Result<Self> {
        Self::new(config, scene, cover, TrueForces::AtTicks)
    }
}

impl LockStep<Option<ByteCover>, NoCover> {
    /// An arm that has no cover.
    ///
    /// # Errors
    /// A scene or parameter outside its range.
    pub fn without_cover(config: &Config, scene: &Scene) -> Result<Self> {
        Self::new(config, scene, None, NoCover)
    }
}

impl<S: CoverSource, F: Feed<S>> LockStep<S, F> {
    fn new(config: &Config, scene: &Scene, cover: S, feed: F) -> Result<Self> {
        let plant = SimulatedRobot::new(config, scene, Vec::new())?;
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s);
        Ok(Self {
            control,
            feed,
            period_ns: config.period_ns(),
            next_tick: 0,
            overruns: 0,
            skip: None,
            asked: None,
        })
    }

    /// Lets `injection` strike; the same seed spoils the same bytes. Disk and sockets are the caller's.
    pub fn inject(&mut self, injection: &Injection, seed: u64) {
        let at_tick = injection.at_ns / self.period_ns;
        self.feed.reserve();
        match injection.fault.site {
            FaultSite::Cable(fault) => self.feed.spoil(Cable::new(fault, injection.at_ns, seed)),
            FaultSite::Plant(_) => self.control.plant.inject(injection),
            FaultSite::Outside(fault) => self.asked = fault.request().map(|request| (at_tick, request)),
            FaultSite::MissedSlots(slots) => self.skip = Some((at_tick, slots)),
        }
    }

    /// One tick: its sample and the answer to its request.
    pub fn step(&mut self, request: Option<Request>) -> (Sample, Option<Outcome>) {
        let Ticked { sample, input } = self.tick(request);
        (sample.clone(), input.outcome)
    }

    /// One tick with what a replay needs of it.
    pub fn tick(&mut self, request: Option<Request>) -> &Ticked {
        self.tick_timed(request, &mut Untimed)
    }

    /// One tick as [`Self::tick`]; `timer` hears when it begins and when each stage ends.
    pub fn tick_timed(&mut self, request: Option<Request>, timer: &mut impl StageTimer) -> &Ticked {
        let request = request.or_else(|| Some(self.asked.take_if(|(at, _)| self.next_tick >= *at)?.1));
        let missed = self.skip.take_if(|(at, _)| self.next_tick >= *at).map_or(0, |(_, slots)| slots);
        self.next_tick += missed;
        self.overruns += missed;
        let now_ns = self.next_tick * self.period_ns;
        let force_n = self.feed.felt(&self.control.plant.world);
        self.feed.feed(&mut self.control.cover, now_ns, force_n);
        let slot = Slot {
            tick: self.next_tick,
            now_ns,
            ticks: 1 + missed,
            overruns: self.overruns,
            ..Slot::default()
        };
        self.next_tick += 1;
        self.control.tick(&slot, request, timer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_keeps_order_and_loses_only_what_a_cable_cannot_hold() {
        let (mut line, mut events) = Line::new();
        let event = |at_ns| BoardEvent::Opened { at_ns };
        (0..300).for_each(|at_ns| line.push(event(at_ns)));
        let mut taken = Vec::new();
        for tick in 1..=20 {
            line.advance();
            while let Ok(event) = events.pop() {
                taken.push(event);
            }
            assert_eq!(taken.len(), (tick * EVENTS_PER_TICK).min(CABLE_EVENTS));
        }
        assert!((0..).zip(&taken).all(|(at_ns, taken)| *taken == event(at_ns)));
        line.push(event(300));
        assert_eq!(events.pop(), Ok(event(300)), "an empty line gives an event at once");
    }
}

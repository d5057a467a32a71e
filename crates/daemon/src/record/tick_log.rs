//! Inputs and answers of a tick: enough to run it again. The loop puts them into a bounded ring; ticks without room there are
//! counted, and a replay reports them. The loop's memory joins once a second, so that the last ticks of a long run
//! can be run again too.

use crate::control::loop_state::{Beyond, LoopState};
use crate::control::tick_input::TickInput;
use moca_lockstep::board_events::NumberedEvent;
use moca_msgs::board::OpenFailure;
use moca_tactile::board::Chunk;
use moca_tactile::{BoardEvent, CloseReason};
use serde::{Deserialize, Serialize};

/// Ticks and board events on their way to a recorder: four seconds at 1 kHz.
const RING: usize = 4096;
/// Period at which the loop's memory is copied, ns.
const STATE_EVERY_NS: u64 = 1_000_000_000;
/// States of the loop on their way: as many seconds of them as of ticks.
const STATES: usize = 4;

/// The loop's end of the tick log.
pub struct TickLog {
    ticks: rtrb::Producer<Noted>,
    states: rtrb::Producer<StateRecord>,
    next_state_ns: u64,
    number: u64,
    lost: u64,
}

#[derive(Clone, Copy, Debug)]
struct Noted {
    input: TickInput,
    number: u64,
    lost: u64,
}

/// The recorder's end of the tick log.
pub struct TickLogReader {
    ticks: rtrb::Consumer<Noted>,
    states: rtrb::Consumer<StateRecord>,
    events: rtrb::Consumer<NumberedEvent>,
    /// Board events of the ticks read so far.
    taken: u64,
    /// Those of them that found no room.
    events_lost: u64,
}

/// A tick log: the loop's end, where copies of the board's events go, and the recorder's end.
pub fn tick_log() -> (TickLog, rtrb::Producer<NumberedEvent>, TickLogReader) {
    let (ticks, from_loop) = rtrb::RingBuffer::new(RING);
    let (copies, events) = rtrb::RingBuffer::new(RING);
    let (states, states_from_loop) = rtrb::RingBuffer::new(STATES);
    let reader =
        TickLogReader { ticks: from_loop, states: states_from_loop, events, taken: 0, events_lost: 0 };
    (TickLog { ticks, states, next_state_ns: 0, number: 0, lost: 0 }, copies, reader)
}

impl TickLog {
    /// Notes one tick; the events it took have been copied before. Now and then it asks for what the loop remembers
    /// after it: that is a copy into a place of the ring, and waits for nobody either.
    pub fn push(&mut self, input: TickInput, state: impl FnOnce() -> LoopState) {
        let slot = &input.slot;
        if slot.now_ns >= self.next_state_ns && !self.states.is_full() {
            self.next_state_ns = slot.now_ns + STATE_EVERY_NS;
            let (number, tick, time_ns) = (self.number, slot.tick, slot.now_ns);
            let cover_events = input.cover_events;
            let _ = self.states.push(StateRecord { number, tick, time_ns, cover_events, state: state() });
        }
        let noted = Noted { input, number: self.number, lost: self.lost };
        self.number += 1;
        if self.ticks.push(noted).is_err() {
            self.lost += 1;
        }
    }
}

impl TickLogReader {
    /// The next tick with its board events, fewer than it took if some were lost.
    pub fn next_tick(&mut self) -> Option<TickRecord> {
        let Noted { input, number, lost } = self.ticks.pop().ok()?;
        let mut events = Vec::new();
        while self.events.peek().is_ok_and(|event| event.number < input.cover_events) {
            events.extend(self.events.pop().ok().map(|event| (event.board, PortEvent::from(event.event))));
        }
        let took = input.cover_events.saturating_sub(self.taken);
        self.taken = input.cover_events;
        self.events_lost += took.saturating_sub(events.len() as u64);
        Some(TickRecord { input, number, lost: lost + self.events_lost, events })
    }

    /// The next state of the loop; that of a tick comes before the tick.
    pub fn next_state(&mut self) -> Option<StateRecord> {
        self.states.pop().ok()
    }
}

/// Memory of the loop after a tick, as a log holds it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StateRecord {
    /// Number of the tick in its run, as in [`TickRecord`].
    pub number: u64,
    /// Its tick count.
    pub tick: u64,
    /// Its loop time, ns.
    pub time_ns: u64,
    /// Board events that the cover had taken.
    pub cover_events: u64,
    /// Memory of the loop.
    pub state: LoopState,
}

impl StateRecord {
    /// Encodes it for a log.
    pub fn encode(&self) -> Vec<u8> {
        // These types always encode; an empty record would be refused by its reader.
        let mut bytes = postcard::to_stdvec(self).unwrap_or_default();
        let beyond = &self.state.motion.beyond;
        if *beyond != Beyond::default() {
            bytes.extend(postcard::to_stdvec(beyond).unwrap_or_default());
        }
        bytes
    }

    /// Decodes what [`Self::encode`] made.
    ///
    /// # Errors
    /// Truncated or corrupt bytes, or those of another version.
    pub fn decode(bytes: &[u8]) -> postcard::Result<Self> {
        let (mut record, behind): (Self, &[u8]) = postcard::take_from_bytes(bytes)?;
        if !behind.is_empty() {
            record.state.motion.beyond = postcard::from_bytes(behind)?;
        }
        Ok(record)
    }
}

/// One tick as a log holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickRecord {
    /// Inputs and answers of the tick.
    pub input: TickInput,
    /// Ticks of this run before this one, lost ones included.
    pub number: u64,
    /// Ticks and board events lost so far for want of room.
    pub lost: u64,
    /// Events that it took from the boards' ports, in order, each with its board: 0 is the first.
    pub events: Vec<(u8, PortEvent)>,
}

/// A [`BoardEvent`] that can be written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PortEvent {
    /// The port opened, ns.
    Opened(u64),
    /// Bytes that arrived, ns.
    Bytes(u64, Vec<u8>),
    /// This many bytes were lost, ns.
    Gap(u64, u64),
    /// The port closed, ns, and whether the reader was told to stop.
    Closed(u64, bool),
    /// The port could not be opened, ns.
    OpenFailed(u64, OpenFailure),
    /// The host did not run the threads that bring the bytes, ns.
    Starved(u64),
}

impl From<BoardEvent> for PortEvent {
    fn from(event: BoardEvent) -> Self {
        match event {
            BoardEvent::Opened { at_ns } => Self::Opened(at_ns),
            BoardEvent::Bytes(chunk) => Self::Bytes(chunk.arrival_ns, chunk.bytes().to_vec()),
            BoardEvent::Gap { at_ns, bytes_lost } => Self::Gap(at_ns, bytes_lost),
            BoardEvent::Closed { at_ns, why } => Self::Closed(at_ns, why == CloseReason::Stopped),
            BoardEvent::OpenFailed { at_ns, why } => Self::OpenFailed(at_ns, why),
            BoardEvent::Starved { at_ns } => Self::Starved(at_ns),
        }
    }
}

impl From<&PortEvent> for BoardEvent {
    fn from(event: &PortEvent) -> Self {
        match *event {
            PortEvent::Opened(at_ns) => Self::Opened { at_ns },
            PortEvent::Bytes(at_ns, ref bytes) => Self::Bytes(Chunk::new(at_ns, bytes)),
            PortEvent::Gap(at_ns, bytes_lost) => Self::Gap { at_ns, bytes_lost },
            PortEvent::Closed(at_ns, stopped) => {
                let why = if stopped { CloseReason::Stopped } else { CloseReason::Disconnected };
                Self::Closed { at_ns, why }
            }
            PortEvent::OpenFailed(at_ns, why) => Self::OpenFailed { at_ns, why },
            PortEvent::Starved(at_ns) => Self::Starved { at_ns },
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::config::Config;
    use crate::control::assemble::{motion, supervisor};
    use crate::control::plant::SourceAge;
    use crate::control::state_check::StateCheck;
    use crate::control::tick_input::Slot;
    use crate::robot::FlangeSensorKind;
    use moca_msgs::{Fault, Payload};

    /// Returns the input of the tick at a number of milliseconds.
    pub(in crate::record) fn input(tick: u64, cover_events: u64) -> TickInput {
        TickInput {
            slot: Slot { tick, now_ns: tick * 1_000_000, ..Slot::default() },
            state: Err(Fault::PlantLost),
            age: SourceAge::default(),
            link: None,
            flange: None,
            gripper: None,
            request: None,
            outcome: None,
            refused: None,
            cover_events,
        }
    }

    pub(in crate::record) fn state() -> LoopState {
        let config = Config::default();
        LoopState {
            state_check: StateCheck::default(),
            supervisor: supervisor(&config),
            arm_released: false,
            motion: motion(&config).unwrap().state(),
            cover: None,
        }
    }

    #[test]
    fn state_that_few_robots_have_is_written_behind_all_else() {
        let mut record = StateRecord { number: 1, tick: 2, time_ns: 3, cover_events: 4, state: state() };
        let without = record.encode();
        assert_eq!(StateRecord::decode(&without).unwrap().state.motion.beyond, Beyond::default());
        let mut config = Config::default();
        config.plant.flange_sensor = FlangeSensorKind::Simulated;
        let flange = motion(&config).unwrap().state().beyond.flange;
        record.state.motion.beyond =
            Beyond { flange, object: Some(Payload::NONE.inertial), doubtful_way: None };
        let with = record.encode();
        assert!(with.starts_with(&without) && flange.is_some());
        assert_eq!(StateRecord::decode(&with).unwrap().state.motion.beyond, record.state.motion.beyond);
        assert!(StateRecord::decode(&with[..with.len() - 1]).is_err());
    }

    #[test]
    fn loop_state_is_copied_once_a_second_if_recorded() {
        let (mut log, _copies, mut reader) = tick_log();
        let mut asked = 0;
        let mut run = |ticks: std::ops::Range<u64>| {
            for tick in ticks {
                log.push(input(tick, 3), || {
                    asked += 1;
                    state()
                });
            }
            asked
        };
        assert_eq!(run(0..9500), STATES);
        let seen: Vec<_> = std::iter::from_fn(|| reader.next_state()).collect();
        assert!(
            seen.iter().map(|state| (state.tick, state.number)).eq([0, 1000, 2000, 3000].map(|t| (t, t)))
        );
        assert!(seen.iter().all(|state| state.cover_events == 3 && state.time_ns == state.tick * 1_000_000));
        assert_eq!(run(9500..9600), STATES + 1);
        assert_eq!(reader.next_state().unwrap().number, 9500);
    }

    #[test]
    fn what_finds_no_room_is_counted_and_the_rest_keeps_its_place() {
        let (mut log, mut copies, mut reader) = tick_log();
        for tick in 0..RING as u64 + 3 {
            log.push(input(tick, 0), state);
        }
        for tick in 0..RING as u64 {
            assert_eq!(reader.next_tick().unwrap().input.slot.tick, tick);
        }
        for (number, board) in [(0, 1), (2, 0)] {
            copies.push(NumberedEvent { number, board, event: BoardEvent::Opened { at_ns: 5 } }).unwrap();
        }
        log.push(input(9000, 2), state);
        log.push(input(9001, 3), state);
        let record = reader.next_tick().unwrap();
        assert_eq!((record.number, record.lost), (RING as u64 + 3, 4));
        assert_eq!(record.events, [(1, PortEvent::Opened(5))]);
        let record = reader.next_tick().unwrap();
        assert_eq!((record.lost, record.events.len()), (4, 1));
    }
}

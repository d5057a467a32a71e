//! What a tick was given and what it answered: enough to run it again. The loop puts it into a bounded ring; what finds
//! no room there is counted, and a replay says so.

use crate::config::JOINTS;
use crate::control::plant::SourceAge;
use crate::control::tick::Slot;
use anyhow::Result;
use moca_msgs::board::OpenFailure;
use moca_msgs::{Fault, Outcome, Request, RobotState};
use moca_tactile::board::Chunk;
use moca_tactile::{BoardEvent, CloseReason};
use serde::{Deserialize, Serialize};

/// Ticks and board events on their way to a recorder: four seconds at 1 kHz.
const RING: usize = 4096;

/// Everything one tick was given, besides the board's events, and what it answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickInput {
    /// When it ran.
    pub slot: Slot,
    /// What the plant measured, or why it did not.
    pub state: std::result::Result<State, Fault>,
    /// How old that was.
    pub age: SourceAge,
    /// What was asked.
    pub request: Option<Request>,
    /// What was answered.
    pub outcome: Option<Outcome>,
    /// What the plant said to the order.
    pub refused: Option<Fault>,
    /// Board events of this tick that were copied for the recorder.
    pub events: u32,
    /// Ticks of this run before this one, lost ones included.
    pub number: u64,
    /// Ticks and events lost so far for want of room.
    pub lost: u64,
}

/// A [`RobotState`] that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the fields are those of RobotState")]
pub struct State {
    pub base_pose_world: [f64; 3],
    pub base_velocity_world: [f64; 3],
    pub q_rad: [f64; JOINTS],
    pub dq_rad_s: [f64; JOINTS],
    pub torque_measured_nm: [f64; JOINTS],
    pub flange_wrench_world: Option<[f64; 6]>,
}

impl From<RobotState<JOINTS>> for State {
    fn from(state: RobotState<JOINTS>) -> Self {
        let RobotState {
            base_pose_world,
            base_velocity_world,
            q_rad,
            dq_rad_s,
            torque_measured_nm,
            flange_wrench_world,
        } = state;
        Self {
            base_pose_world,
            base_velocity_world,
            q_rad,
            dq_rad_s,
            torque_measured_nm,
            flange_wrench_world,
        }
    }
}

impl From<State> for RobotState<JOINTS> {
    fn from(state: State) -> Self {
        let State {
            base_pose_world,
            base_velocity_world,
            q_rad,
            dq_rad_s,
            torque_measured_nm,
            flange_wrench_world,
        } = state;
        Self {
            base_pose_world,
            base_velocity_world,
            q_rad,
            dq_rad_s,
            torque_measured_nm,
            flange_wrench_world,
        }
    }
}

/// Board events handed to a recorder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Copied {
    /// By the last tick.
    pub events: u32,
    /// For which there was no room, so far.
    pub lost: u64,
}

/// The loop's end of the tape.
pub struct Tape {
    ticks: rtrb::Producer<TickInput>,
    number: u64,
    lost: u64,
}

/// The recorder's end of the tape.
pub struct TapeReader {
    ticks: rtrb::Consumer<TickInput>,
    events: rtrb::Consumer<BoardEvent>,
}

/// A tape: the loop's end, where copies of the board's events go, and the recorder's end.
pub fn tape() -> (Tape, rtrb::Producer<BoardEvent>, TapeReader) {
    let (ticks, from_loop) = rtrb::RingBuffer::new(RING);
    let (copies, events) = rtrb::RingBuffer::new(RING);
    (Tape { ticks, number: 0, lost: 0 }, copies, TapeReader { ticks: from_loop, events })
}

impl Tape {
    /// Notes one tick; the events it took have been copied before.
    pub fn push(&mut self, mut input: TickInput, copied: Copied) {
        input.events = copied.events;
        input.number = self.number;
        self.number += 1;
        input.lost = self.lost + copied.lost;
        if self.ticks.push(input).is_err() {
            self.lost += 1;
        }
    }
}

impl TapeReader {
    /// The next tick with its board events, fewer than it took if some were lost.
    pub fn next_tick(&mut self) -> Option<TickRecord> {
        let input = self.ticks.pop().ok()?;
        let events = (0..input.events).map_while(|_| self.events.pop().ok()).map(PortEvent::from).collect();
        Some(TickRecord { input, events })
    }
}

/// One tick as a log holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickRecord {
    /// What it was given and what it answered.
    pub input: TickInput,
    /// What it took from the board's port, in order.
    pub events: Vec<PortEvent>,
}

impl TickRecord {
    /// As bytes: every number with all its bits, NaN and infinity included.
    pub fn encode(&self) -> Vec<u8> {
        // These types always encode; nothing at all would be found by whoever reads it back.
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// From the bytes of [`TickRecord::encode`].
    ///
    /// # Errors
    /// Bytes of another version, or damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self> {
        Ok(postcard::from_bytes(bytes)?)
    }
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
}

impl From<BoardEvent> for PortEvent {
    fn from(event: BoardEvent) -> Self {
        match event {
            BoardEvent::Opened { at_ns } => Self::Opened(at_ns),
            BoardEvent::Bytes(chunk) => Self::Bytes(chunk.arrival_ns, chunk.bytes().to_vec()),
            BoardEvent::Gap { at_ns, bytes_lost } => Self::Gap(at_ns, bytes_lost),
            BoardEvent::Closed { at_ns, why } => Self::Closed(at_ns, why == CloseReason::Stopped),
            BoardEvent::OpenFailed { at_ns, why } => Self::OpenFailed(at_ns, why),
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
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_finds_no_room_is_counted_and_the_rest_keeps_its_place() {
        let (mut tape, mut copies, mut reader) = tape();
        let state = Err(Fault::PlantLost);
        let input = |tick| TickInput {
            slot: Slot { tick, ..Slot::default() },
            state,
            age: SourceAge::default(),
            request: None,
            outcome: None,
            refused: None,
            events: 0,
            number: 0,
            lost: 0,
        };
        for tick in 0..RING as u64 + 3 {
            tape.push(input(tick), Copied::default());
        }
        for tick in 0..RING as u64 {
            assert_eq!(reader.next_tick().unwrap().input.slot.tick, tick);
        }
        copies.push(BoardEvent::Opened { at_ns: 5 }).unwrap();
        tape.push(input(9000), Copied { events: 2, lost: 1 });
        let record = reader.next_tick().unwrap();
        assert_eq!((record.input.lost, record.input.events, record.events.len()), (4, 2, 1));
        assert_eq!(TickRecord::decode(&record.encode()).unwrap(), record);
    }

    #[test]
    fn every_bit_of_a_state_comes_back() {
        let mut state = State {
            base_pose_world: [-0.0, f64::MIN_POSITIVE, 1.0 / 3.0],
            base_velocity_world: [f64::INFINITY, f64::NEG_INFINITY, 0.1],
            q_rad: [f64::from_bits(0x7ff8_0000_0000_0123); JOINTS],
            dq_rad_s: [5e-324; JOINTS],
            torque_measured_nm: [87.0; JOINTS],
            flange_wrench_world: None,
        };
        for wrench in [None, Some([0.1; 6])] {
            state.flange_wrench_world = wrench;
            let bytes = postcard::to_stdvec(&state).unwrap();
            let back: State = postcard::from_bytes(&bytes).unwrap();
            assert_eq!(postcard::to_stdvec(&back).unwrap(), bytes);
            assert_eq!(back.q_rad.map(f64::to_bits), state.q_rad.map(f64::to_bits));
            assert_eq!(back.base_pose_world.map(f64::to_bits), state.base_pose_world.map(f64::to_bits));
        }
    }
}

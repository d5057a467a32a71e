//! Events of a board's port on their way to the cover, copied for recording and calibration.

use moca_tactile::BoardEvent;
use moca_tactile::board::STARVED_FOR_NS;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A thread that brings bytes and has not run for this long, or bytes that have waited for so long, are the host's doing,
/// ns. Longer than a reader waits for a byte, shorter than the silence that stops the robot.
const STARVED_NS: u64 = 100_000_000;

/// Period of reports on a starving host, ns.
const TELL_AGAIN_NS: u64 = STARVED_FOR_NS / 2;

/// A thread's sign of life.
struct Pulse {
    count: Arc<AtomicU64>,
    last: u64,
    changed_ns: u64,
}

impl Pulse {
    /// Returns true if the thread has not run for [`STARVED_NS`].
    fn has_stopped(&mut self, now_ns: u64) -> bool {
        let count = self.count.load(Ordering::Relaxed);
        if count != self.last {
            (self.last, self.changed_ns) = (count, now_ns);
        }
        now_ns.saturating_sub(self.changed_ns) > STARVED_NS
    }
}

/// A board's event as a recorder gets it.
#[derive(Clone, Copy, Debug)]
pub struct NumberedEvent {
    /// Events of all boards before it: a gap is a loss.
    pub number: u64,
    /// Which board, 0 is the first.
    pub board: u8,
    /// Event of its port.
    pub event: BoardEvent,
}

/// The cover's end of one board's ring, and the threads that fill it.
struct Port {
    events: rtrb::Consumer<BoardEvent>,
    pulses: Vec<Pulse>,
    told_ns: Option<u64>,
    arrived_ns: u64,
}

/// The cover's ends of the rings of its boards. Copies never hold it up: who has no room loses them.
pub struct BoardEvents {
    ports: Vec<Port>,
    recorder: Option<rtrb::Producer<NumberedEvent>>,
    calibrator: Option<rtrb::Producer<(u8, BoardEvent)>>,
    taken: u64,
}

impl BoardEvents {
    /// Joins the ports of the boards under a cover, first board first, without copies.
    pub fn new(ports: impl IntoIterator<Item = rtrb::Consumer<BoardEvent>>) -> Self {
        let port = |events| Port { events, pulses: Vec::new(), told_ns: None, arrived_ns: 0 };
        Self { ports: ports.into_iter().map(port).collect(), recorder: None, calibrator: None, taken: 0 }
    }

    /// Copies each event for a recorder.
    #[must_use]
    pub fn with_recorder(self, recorder: Option<rtrb::Producer<NumberedEvent>>) -> Self {
        Self { recorder, ..self }
    }

    /// Copies each event for a calibrator, with its board.
    #[must_use]
    pub fn with_calibrator(self, calibrator: rtrb::Producer<(u8, BoardEvent)>) -> Self {
        Self { calibrator: Some(calibrator), ..self }
    }

    /// Watches the threads that bring the bytes of each board by these counts, which each raises when it runs.
    #[must_use]
    pub fn with_pulses(mut self, counts: impl IntoIterator<Item = Vec<Arc<AtomicU64>>>) -> Self {
        let pulse = |count| Pulse { count, last: 0, changed_ns: 0 };
        for (port, counts) in self.ports.iter_mut().zip(counts) {
            port.pulses = counts.into_iter().map(pulse).collect();
        }
        self
    }

    /// Returns the number of boards.
    pub const fn boards(&self) -> usize {
        self.ports.len()
    }

    /// The next event of `board`, if one has come.
    pub fn take(&mut self, board: usize) -> Option<BoardEvent> {
        let port = self.ports.get_mut(board)?;
        let event = port.events.pop().ok()?;
        if let BoardEvent::Bytes(chunk) = &event {
            port.arrived_ns = chunk.arrival_ns;
        }
        Some(self.copied(board, event))
    }

    /// An event of its own when one of the board's threads has stopped running, or bytes have waited too long; the next
    /// one comes half a second later.
    pub fn take_starved(&mut self, board: usize, now_ns: u64) -> Option<BoardEvent> {
        let port = self.ports.get_mut(board)?;
        if matches!(port.events.peek(), Ok(BoardEvent::Starved { .. })) {
            // A replay: what was made here then stands behind the tick's other events, however many those were.
            return self.take(board);
        }
        if !port.starves(now_ns) {
            port.told_ns = None;
            return None;
        }
        if port.told_ns.is_some_and(|told_ns| now_ns.saturating_sub(told_ns) < TELL_AGAIN_NS) {
            return None;
        }
        port.told_ns = Some(now_ns);
        Some(self.copied(board, BoardEvent::Starved { at_ns: now_ns }))
    }

    fn copied(&mut self, board: usize, event: BoardEvent) -> BoardEvent {
        let board = u8::try_from(board).unwrap_or(u8::MAX);
        if let Some(recorder) = &mut self.recorder {
            let _ = recorder.push(NumberedEvent { number: self.taken, board, event });
        }
        if let Some(calibrator) = &mut self.calibrator {
            let _ = calibrator.push((board, event));
        }
        self.taken += 1;
        event
    }

    /// Events taken since the start, of all boards.
    pub const fn taken(&self) -> u64 {
        self.taken
    }
}

impl Port {
    fn starves(&mut self, now_ns: u64) -> bool {
        let mut stopped = false;
        for pulse in &mut self.pulses {
            stopped |= pulse.has_stopped(now_ns);
        }
        let waited = !self.events.is_empty() && now_ns.saturating_sub(self.arrived_ns) > STARVED_NS;
        stopped || (waited && !self.pulses.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_tactile::Chunk;

    #[test]
    fn a_thread_that_does_not_run_is_told_of_until_it_runs_again() {
        let (_port, events) = rtrb::RingBuffer::new(8);
        let counts = [Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0))];
        let mut events = BoardEvents::new([events]).with_pulses([counts.to_vec()]);
        let mut told = |now_ms: u64, running: bool| {
            counts[0].fetch_add(1, Ordering::Relaxed);
            counts[1].fetch_add(u64::from(running), Ordering::Relaxed);
            events.take_starved(0, now_ms * 1_000_000)
        };
        assert_eq!(told(50, true), None);
        assert_eq!(told(140, false), None);
        assert_eq!(told(160, false), Some(BoardEvent::Starved { at_ns: 160_000_000 }));
        assert_eq!(told(170, false), None);
        assert_eq!(told(600, false), None);
        assert!(told(661, false).is_some());
        assert_eq!(told(680, true), None);
        assert!(told(781, false).is_some());
    }

    #[test]
    fn bytes_that_waited_are_the_hosts_doing() {
        let (mut port, events) = rtrb::RingBuffer::new(8);
        let count = Arc::new(AtomicU64::new(0));
        let mut events = BoardEvents::new([events]).with_pulses([vec![Arc::clone(&count)]]);
        for arrival_ms in [10, 20, 120] {
            port.push(BoardEvent::Bytes(Chunk::new(arrival_ms * 1_000_000, b"x"))).unwrap();
        }
        count.store(1, Ordering::Relaxed);
        events.take(0).unwrap();
        assert!(
            events.take_starved(0, 115_000_000).is_some(),
            "taken 105 ms after it came, and more is waiting"
        );
        while events.take(0).is_some() {}
        assert_eq!(events.take_starved(0, 121_000_000), None);
        assert_eq!(events.taken(), 4, "the event counts as taken");
    }

    #[test]
    fn replayed_starvation_stays_in_its_tick() {
        let (mut log, events) = rtrb::RingBuffer::new(8);
        let mut events = BoardEvents::new([events]);
        log.push(BoardEvent::Opened { at_ns: 1 }).unwrap();
        log.push(BoardEvent::Starved { at_ns: 2 }).unwrap();
        assert_eq!(events.take_starved(0, 2), None, "an event before it is taken first");
        events.take(0).unwrap();
        assert_eq!(events.take_starved(0, 2), Some(BoardEvent::Starved { at_ns: 2 }));
        assert_eq!(events.taken(), 2);
    }

    #[test]
    fn full_event_copy_leaves_gap_and_cover_misses_nothing() {
        let (mut port, events) = rtrb::RingBuffer::new(8);
        let (recorder, mut copies) = rtrb::RingBuffer::new(2);
        let mut events = BoardEvents::new([events]).with_recorder(Some(recorder));
        for at_ns in 0..4 {
            port.push(BoardEvent::Opened { at_ns }).unwrap();
        }
        assert_eq!(std::iter::from_fn(|| events.take(0)).count(), 4);
        assert_eq!(copies.pop().unwrap().number, 0);
        port.push(BoardEvent::Opened { at_ns: 4 }).unwrap();
        events.take(0).unwrap();
        let numbers: Vec<u64> = std::iter::from_fn(|| copies.pop().ok()).map(|copy| copy.number).collect();
        assert_eq!((numbers, events.taken()), (vec![1, 4], 5));
    }
}

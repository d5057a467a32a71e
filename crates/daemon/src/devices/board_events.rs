//! What a board's port says on its way to the cover, copied for those who keep or calibrate it.

use moca_tactile::BoardEvent;

/// A board event with its number since the start, as a recorder gets it: a gap in the numbers is a loss.
pub type NumberedEvent = (u64, BoardEvent);

/// The cover's end of a board's ring. Copies never hold it up: who has no room loses them.
pub struct BoardEvents {
    events: rtrb::Consumer<BoardEvent>,
    recorder: Option<rtrb::Producer<NumberedEvent>>,
    calibrator: Option<rtrb::Producer<BoardEvent>>,
    taken: u64,
}

impl BoardEvents {
    /// Of one board, copied for nobody.
    pub const fn new(events: rtrb::Consumer<BoardEvent>) -> Self {
        Self { events, recorder: None, calibrator: None, taken: 0 }
    }

    /// Copies each event for a recorder.
    #[must_use]
    pub fn with_recorder(self, recorder: Option<rtrb::Producer<NumberedEvent>>) -> Self {
        Self { recorder, ..self }
    }

    /// Copies each event for a calibrator.
    #[must_use]
    pub fn with_calibrator(self, calibrator: rtrb::Producer<BoardEvent>) -> Self {
        Self { calibrator: Some(calibrator), ..self }
    }

    /// The next event, if one has come.
    pub fn take(&mut self) -> Option<BoardEvent> {
        let event = self.events.pop().ok()?;
        if let Some(recorder) = &mut self.recorder {
            let _ = recorder.push((self.taken, event));
        }
        if let Some(calibrator) = &mut self.calibrator {
            let _ = calibrator.push(event);
        }
        self.taken += 1;
        Some(event)
    }

    /// Events taken since the start.
    pub const fn taken(&self) -> u64 {
        self.taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_without_room_is_a_gap_in_the_numbers_and_the_cover_misses_nothing() {
        let (mut port, events) = rtrb::RingBuffer::new(8);
        let (recorder, mut copies) = rtrb::RingBuffer::new(2);
        let mut events = BoardEvents::new(events).with_recorder(Some(recorder));
        for at_ns in 0..4 {
            port.push(BoardEvent::Opened { at_ns }).unwrap();
        }
        assert_eq!(std::iter::from_fn(|| events.take()).count(), 4);
        assert_eq!(copies.pop().unwrap().0, 0);
        port.push(BoardEvent::Opened { at_ns: 4 }).unwrap();
        events.take().unwrap();
        let numbers: Vec<u64> = std::iter::from_fn(|| copies.pop().ok()).map(|(number, _)| number).collect();
        assert_eq!((numbers, events.taken()), (vec![1, 4], 5));
    }
}

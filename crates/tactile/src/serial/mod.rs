//! The port side: a blocking thread that moves bytes and connection events from one serial port into a ring.
//!
//! It parses nothing. The loop thread owns the other end of the ring and feeds what it pops to
//! [`crate::Cover::event`]. Dropping [`SerialBoard`] stops the thread.
//!
//! ```no_run
//! use moca_tactile::serial::{PortSelection, SerialBoard};
//! use moca_tactile::{Cover, CoverConfig};
//! use std::time::Instant;
//!
//! let start = Instant::now();
//! let (_board, mut events) = SerialBoard::spawn(PortSelection::Any, start)?; // lives as long as it is read
//! let mut cover = Cover::<11>::new(CoverConfig::default())?;
//! loop {
//!     while let Ok(event) = events.pop() {
//!         cover.event(0, &event); // unplugged and plugged in again as well
//!     }
//!     let poll = cover.poll(start.elapsed().as_nanos() as u64);
//!     println!("{:?}", poll.forces);
//!     std::thread::sleep(std::time::Duration::from_millis(1));
//! }
//! # #[allow(unreachable_code)]
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod find;

pub use find::{ARDUINO_USB, BOOTLOADER_USB, PortSelection, TOUCH_BOARD_USB, look_for_board, open};

use crate::board::{BoardEvent, Chunk, CloseReason};
use find::BAUD;
pub use serialport::SerialPort;
use std::io;
use std::string::ToString;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// First wait before a port is tried again.
const BACK_OFF_FIRST: Duration = Duration::from_millis(100);
/// Longest wait before a port is tried again.
const BACK_OFF_MAX: Duration = Duration::from_secs(2);
/// Events the ring holds: at least a second of a board's bytes.
const RING_EVENTS: usize = 1024;

/// A running reader thread.
#[derive(Debug)]
pub struct SerialBoard {
    stop: Arc<AtomicBool>,
    pulse: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl SerialBoard {
    /// Starts reading. Times in events are nanoseconds since `start`. Fails only if no thread can be started.
    pub fn spawn(port: PortSelection, start: Instant) -> io::Result<(Self, rtrb::Consumer<BoardEvent>)> {
        Self::spawn_with_baud(port, BAUD, start)
    }

    /// Opens another device, such as a force gauge behind a serial adapter.
    pub fn spawn_with_baud(
        port: PortSelection,
        baud: u32,
        start: Instant,
    ) -> io::Result<(Self, rtrb::Consumer<BoardEvent>)> {
        let (producer, consumer) = rtrb::RingBuffer::new(RING_EVENTS);
        let stop = Arc::new(AtomicBool::new(false));
        let pulse = Arc::new(AtomicU64::new(0));
        let outbox = Outbox { producer, bytes_lost: 0, stop: Arc::clone(&stop) };
        let mut reader = Reader { outbox, baud, start, pulse: Arc::clone(&pulse) };
        let thread =
            std::thread::Builder::new().name("touch-board".to_string()).spawn(move || reader.run(&port))?;
        Ok((Self { stop, pulse, thread: Some(thread) }, consumer))
    }

    /// A count that the thread raises whenever it runs, at least every 50 ms while the port is open.
    pub fn pulse(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.pulse)
    }
}

impl Drop for SerialBoard {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A panic of the reader thread has been reported by its own hook; there is nothing to add here.
            let _ = thread.join();
        }
    }
}

/// Returns the wait after `failures` failures in a row (from 1).
fn back_off(failures: u32) -> Duration {
    BACK_OFF_FIRST.saturating_mul(1 << failures.saturating_sub(1).min(10)).min(BACK_OFF_MAX)
}

struct Outbox {
    producer: rtrb::Producer<BoardEvent>,
    bytes_lost: u64,
    stop: Arc<AtomicBool>,
}

impl Outbox {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.producer.is_abandoned()
    }

    /// Bytes never wait: with a full ring they are dropped and counted.
    fn bytes(&mut self, chunk: Chunk) {
        if self.bytes_lost > 0 {
            let gap = BoardEvent::Gap { at_ns: chunk.arrival_ns, bytes_lost: self.bytes_lost };
            if self.producer.push(gap).is_ok() {
                self.bytes_lost = 0;
            }
        }
        if self.bytes_lost > 0 || self.producer.push(BoardEvent::Bytes(chunk)).is_err() {
            self.bytes_lost += u64::try_from(chunk.bytes().len()).unwrap_or(u64::MAX);
        }
    }

    /// A change of the connection is never dropped: it waits for room.
    fn connection(&mut self, event: BoardEvent) {
        while self.producer.push(event).is_err() && !self.stopped() {
            std::thread::park_timeout(Duration::from_millis(5));
        }
    }
}

struct Reader {
    outbox: Outbox,
    baud: u32,
    start: Instant,
    pulse: Arc<AtomicU64>,
}

impl Reader {
    fn now_ns(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    fn run(&mut self, selection: &PortSelection) {
        let mut failures = 0;
        while !self.outbox.stopped() {
            match open(selection, self.baud) {
                Ok(mut port) => {
                    let at_ns = self.now_ns();
                    self.outbox.connection(BoardEvent::Opened { at_ns });
                    // A port that opens but says nothing before it closes is a failure too, or a flapping
                    // connection would spin.
                    if self.read_until_closed(port.as_mut()) {
                        failures = 0;
                    }
                    let why = match self.outbox.stopped() {
                        true => CloseReason::Stopped,
                        false => CloseReason::Disconnected,
                    };
                    let at_ns = self.now_ns();
                    self.outbox.connection(BoardEvent::Closed { at_ns, why });
                }
                Err(why) => {
                    let at_ns = self.now_ns();
                    self.outbox.connection(BoardEvent::OpenFailed { at_ns, why });
                }
            }
            failures += 1;
            self.wait(back_off(failures));
        }
    }

    fn wait(&self, duration: Duration) {
        let until = Instant::now() + duration;
        while !self.outbox.stopped() {
            let now = Instant::now();
            if now >= until {
                return;
            }
            std::thread::park_timeout(until - now);
        }
    }

    /// True if any byte came.
    fn read_until_closed(&mut self, port: &mut dyn SerialPort) -> bool {
        let mut any = false;
        let mut buffer = [0; Chunk::CAPACITY];
        while !self.outbox.stopped() {
            self.pulse.fetch_add(1, Ordering::Relaxed);
            match port.read(&mut buffer) {
                Ok(0) => return any,
                Ok(count) => {
                    any = true;
                    let arrival_ns = self.now_ns();
                    self.outbox.bytes(Chunk::new(arrival_ns, &buffer[..count]));
                }
                Err(error) => match error.kind() {
                    io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted => {}
                    _ => return any,
                },
            }
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn the_back_off_grows_to_two_seconds_and_stays() {
        let millis: Vec<_> = (1..8).map(|n| back_off(n).as_millis()).collect();
        assert_eq!(millis, vec![100, 200, 400, 800, 1600, 2000, 2000]);
        assert_eq!(back_off(u32::MAX), BACK_OFF_MAX);
    }

    #[test]
    fn bytes_are_dropped_and_counted_when_the_ring_is_full() {
        let (producer, mut consumer) = rtrb::RingBuffer::new(2);
        let mut outbox = Outbox { producer, bytes_lost: 0, stop: Arc::new(AtomicBool::new(false)) };
        for i in 0..5 {
            outbox.bytes(Chunk::new(i, b"abc"));
        }
        assert!(matches!(consumer.pop(), Ok(BoardEvent::Bytes(_))));
        assert!(matches!(consumer.pop(), Ok(BoardEvent::Bytes(_))));
        outbox.bytes(Chunk::new(5, b"abc"));
        assert_eq!(consumer.pop(), Ok(BoardEvent::Gap { at_ns: 5, bytes_lost: 9 }));
        assert_eq!(consumer.pop(), Ok(BoardEvent::Bytes(Chunk::new(5, b"abc"))));
    }
}

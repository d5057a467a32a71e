//! The port side: a blocking thread that moves bytes and connection events from one serial port into a ring.
//!
//! It parses nothing. The loop thread owns the other end of the ring and feeds what it pops to
//! [`crate::Cover::event`]. Dropping [`SerialBoard`] stops the thread.

use crate::board::{BoardEvent, Chunk, CloseReason, OpenFailure};
use serialport::{ErrorKind, SerialPort, SerialPortType, UsbPortInfo};
use std::boxed::Box;
use std::io;
use std::path::Path;
use std::string::{String, ToString};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// USB vendor and product id of a Touch Board that runs a sketch.
pub const TOUCH_BOARD_USB: (u16, u16) = (0x2a6e, 0x8003);
/// USB id of its bootloader: no sketch runs, and the port must not be opened.
pub const BOOTLOADER_USB: (u16, u16) = (0x2a6e, 0x0003);
/// USB id of an Arduino Leonardo, which a Touch Board becomes when it is flashed with that profile.
pub const LEONARDO_USB: (u16, u16) = (0x2341, 0x8036);
/// USB CDC ignores it, but 1200 would start the bootloader.
const BAUD: u32 = 115_200;
/// How long one read waits; also the longest wait for the thread to stop.
const READ_TIMEOUT: Duration = Duration::from_millis(50);
/// First wait before a port is tried again.
const BACK_OFF_FIRST: Duration = Duration::from_millis(100);
/// Longest wait before a port is tried again.
const BACK_OFF_MAX: Duration = Duration::from_secs(2);
/// Events the ring holds: at least a second of a board's bytes.
const RING_EVENTS: usize = 1024;

/// Which port to open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortSelection {
    /// Device path. Two boards differ only by their `/dev/serial/by-path`.
    Path(String),
    /// The only port with this USB vendor and product id.
    Usb(u16, u16),
}

impl Default for PortSelection {
    fn default() -> Self {
        Self::Usb(TOUCH_BOARD_USB.0, TOUCH_BOARD_USB.1)
    }
}

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

    /// The same for another device, such as a force gauge behind a serial adapter.
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

/// How long to wait after `failures` failures in a row (from 1).
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

/// The port of the only Touch Board there is, without opening it.
///
/// # Errors
/// Why there is none, or which board there is instead.
pub fn look_for_board() -> Result<String, OpenFailure> {
    find(&usb_ports(), TOUCH_BOARD_USB)
}

fn open(selection: &PortSelection, baud: u32) -> Result<Box<dyn SerialPort>, OpenFailure> {
    let ports = usb_ports();
    let path = match selection {
        PortSelection::Path(path) => {
            let real = Path::new(path).canonicalize().unwrap_or_default();
            if ports.iter().any(|(name, usb)| Path::new(name) == real && id(usb) == BOOTLOADER_USB) {
                return Err(OpenFailure::Bootloader);
            }
            path.clone()
        }
        PortSelection::Usb(vendor, product) => find(&ports, (*vendor, *product))?,
    };
    serialport::new(path, baud)
        .timeout(READ_TIMEOUT)
        .dtr_on_open(true)
        .open()
        .map_err(|error| failure(error.kind()))
}

/// The only port with USB id `wanted`, or the nearest reason why there is none.
fn find(ports: &[(String, UsbPortInfo)], wanted: (u16, u16)) -> Result<String, OpenFailure> {
    let present = |wanted| ports.iter().any(|(_, usb)| id(usb) == wanted);
    let mut matching = ports.iter().filter(|(_, usb)| id(usb) == wanted).map(|(name, _)| name);
    match (matching.next(), matching.next()) {
        (Some(name), None) => Ok(name.clone()),
        (Some(_), Some(_)) => Err(OpenFailure::Ambiguous),
        (None, _) if present(BOOTLOADER_USB) => Err(OpenFailure::Bootloader),
        (None, _) if present(LEONARDO_USB) => Err(OpenFailure::Leonardo),
        (None, _) => Err(OpenFailure::NotFound),
    }
}

/// Every USB serial port of the machine.
fn usb_ports() -> Vec<(String, UsbPortInfo)> {
    // Without this directory (some containers) serialport panics instead of finding no ports.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Vec::new();
    }
    serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .filter_map(|port| match port.port_type {
            SerialPortType::UsbPort(usb) => Some((port.port_name, usb)),
            _ => None,
        })
        .collect()
}

const fn id(usb: &UsbPortInfo) -> (u16, u16) {
    (usb.vid, usb.pid)
}

/// serialport reports a port that another program holds as `NoDevice`.
fn failure(kind: ErrorKind) -> OpenFailure {
    match kind {
        ErrorKind::NoDevice => OpenFailure::Busy,
        ErrorKind::Io(io::ErrorKind::NotFound) => OpenFailure::NotFound,
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => OpenFailure::PermissionDenied,
        _ => OpenFailure::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    fn usb((vid, pid): (u16, u16)) -> UsbPortInfo {
        UsbPortInfo { vid, pid, serial_number: None, manufacturer: None, product: None }
    }

    fn ports(ids: &[(u16, u16)]) -> Vec<(String, UsbPortInfo)> {
        ids.iter().enumerate().map(|(i, &id)| (std::format!("/dev/ttyACM{i}"), usb(id))).collect()
    }

    #[test]
    fn the_board_is_told_from_bootloader_leonardo_and_its_double() {
        let other = (0x0403, 0x6001);
        let find = |ids: &[_]| find(&ports(ids), TOUCH_BOARD_USB);
        assert_eq!(find(&[other, TOUCH_BOARD_USB]), Ok("/dev/ttyACM1".to_string()));
        assert_eq!(find(&[other, BOOTLOADER_USB, LEONARDO_USB]), Err(OpenFailure::Bootloader));
        assert_eq!(find(&[LEONARDO_USB]), Err(OpenFailure::Leonardo));
        assert_eq!(find(&[TOUCH_BOARD_USB, TOUCH_BOARD_USB]), Err(OpenFailure::Ambiguous));
        assert_eq!(find(&[other]), Err(OpenFailure::NotFound));
    }

    #[test]
    fn the_operating_system_s_answers_are_told_apart() {
        for (kind, expected) in [
            (ErrorKind::NoDevice, OpenFailure::Busy),
            (ErrorKind::Io(io::ErrorKind::NotFound), OpenFailure::NotFound),
            (ErrorKind::Io(io::ErrorKind::PermissionDenied), OpenFailure::PermissionDenied),
            (ErrorKind::Unknown, OpenFailure::Other),
        ] {
            assert_eq!(failure(kind), expected);
        }
    }

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

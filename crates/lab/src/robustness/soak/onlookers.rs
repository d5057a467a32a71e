//! Bad observers of a soak: clients that read, die, or never read, and a terminal that stalled at its first line.

use anyhow::Result;
use moca_daemon::cli::report::Level;
use moca_daemon::cli::terminal::Terminal;
use moca_daemon::runtime::notice::{Notice, Reporter};
use moca_lockstep::inject::Random;
use moca_msgs::Sample;
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{Address, Connection, Ports, RequestReceiver, Server, request_channel, serve};
use std::io::{self, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Samples on their way to the clients: four seconds at 1 kHz.
const RING: usize = 4096;
/// Pause between two reads of the client that reads.
const READ_EVERY: Duration = Duration::from_millis(5);
/// Clients that never read, at most.
const DEAF_MAX: usize = 8;

/// An output that takes nothing, ever.
struct Stalled;

impl Write for Stalled {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        loop {
            std::thread::park();
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A client that reads, in a thread of its own as a window does: samples do not wait while the robot's thread is busy.
struct Reader {
    dies: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Reader {
    fn spawn(address: Address) -> Result<Self> {
        let connection = Connection::spawn(address, || {})?;
        let dies = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&dies);
        let thread = std::thread::spawn(move || {
            while !told.load(Ordering::Relaxed) {
                connection.poll();
                std::thread::sleep(READ_EVERY);
            }
        });
        Ok(Self { dies, thread: Some(thread) })
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.dies.store(true, Ordering::Relaxed);
        // A panic of the reader has been printed; the soak goes on without it.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// All of them, and what they cost.
pub(super) struct Onlookers {
    samples: rtrb::Producer<Sample>,
    _requests: RequestReceiver,
    server: Server,
    reads: Option<Reader>,
    deaf: Vec<UnixStream>,
    terminal: Terminal,
    /// Clients that were cut off.
    pub(super) killed: u64,
    /// Samples that found no room on their way to the clients.
    pub(super) dropped: u64,
}

impl Onlookers {
    pub(super) fn new() -> Result<Self> {
        let (samples, from_loop) = rtrb::RingBuffer::new(RING);
        let (asks, requests) = request_channel();
        let ports = Ports {
            samples: from_loop,
            requests: asks,
            ring_dropped: Arc::new(AtomicU64::new(0)),
            recorder: None,
            calibration: None,
            judge: None,
        };
        let socket = std::env::temp_dir().join(format!("moca-soak-{}.sock", std::process::id()));
        let server = serve(&Address::Unix(socket), 0o600, RobotDescription::paper("soak", true), ports)?;
        let terminal = Terminal::onto(Stalled, Level::Info, false)?;
        let (deaf, reads) = (Vec::new(), None);
        Ok(Self { samples, _requests: requests, server, reads, deaf, terminal, killed: 0, dropped: 0 })
    }

    /// One tick, for everybody.
    pub(super) fn see(&mut self, sample: &Sample) {
        self.dropped += u64::from(self.samples.push(sample.clone()).is_err());
        self.terminal.report(Notice::Sample(sample));
    }

    /// Somebody comes, somebody goes without a word.
    pub(super) fn change(&mut self, random: &mut Random) -> Result<()> {
        match random.below(3) {
            0 => {
                self.killed += u64::from(self.reads.take().is_some());
                self.reads = Some(Reader::spawn(self.server.address().clone())?);
            }
            1 if self.deaf.len() < DEAF_MAX => {
                if let Address::Unix(path) = self.server.address() {
                    self.deaf.push(UnixStream::connect(path)?);
                }
            }
            _ => {
                self.killed += self.deaf.len() as u64;
                self.deaf.clear();
            }
        }
        Ok(())
    }

    /// Lines that the terminal did not take.
    pub(super) const fn lines_lost(&self) -> u64 {
        self.terminal.lost()
    }
}

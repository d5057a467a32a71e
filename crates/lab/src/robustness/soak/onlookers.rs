//! Bad observers of a soak: clients that read, die, or never read, and a terminal that stalled at its first line.

use anyhow::Result;
use moca_daemon::cli::report::Level;
use moca_daemon::cli::terminal::Terminal;
use moca_daemon::inject::Random;
use moca_daemon::runtime::notice::{Notice, Reporter};
use moca_msgs::Sample;
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{Address, Connection, Ports, RequestReceiver, Server, request_channel, serve};
use std::io::{self, Write};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

/// Samples on their way to the clients: four seconds at 1 kHz.
const RING: usize = 4096;
/// Ticks between two reads of the client that reads.
const READ_EVERY: u64 = 20;
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

/// All of them, and what they cost.
pub(super) struct Onlookers {
    samples: rtrb::Producer<Sample>,
    _requests: RequestReceiver,
    server: Server,
    reads: Option<Connection>,
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
        // A client that reads takes what has come: unread samples would wait for it, up to ten seconds of them.
        if sample.tick.is_multiple_of(READ_EVERY)
            && let Some(reads) = &self.reads
        {
            reads.poll();
        }
        self.terminal.report(Notice::Sample(sample));
    }

    /// Somebody comes, somebody goes without a word.
    pub(super) fn change(&mut self, random: &mut Random) -> Result<()> {
        match random.below(3) {
            0 => {
                self.killed += u64::from(self.reads.take().is_some());
                self.reads = Some(Connection::spawn(self.server.address().clone(), || {})?);
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

//! Faults on purpose that need a thread, a disk or a socket; their names, and all others, are those of [`moca_lockstep::inject`].

use crate::runtime::clock::Clock;
use moca_lockstep::inject::{Cable, OutsideFault, Random};
use moca_msgs::Request;
use moca_tactile::BoardEvent;
use moca_telemetry::net::wire::{FromClient, Role, encode_from_client};
use moca_telemetry::net::{Address, Connection, Link, Update};
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Period at which a live spoiled cable looks for bytes.
const CABLE_EVERY: Duration = Duration::from_millis(1);
/// Events on a live spoiled cable: as many as behind a port.
const RING_EVENTS: usize = 1024;
/// Duration of a write to a slow disk.
const SLOW: Duration = Duration::from_millis(10);
/// Period at which a client looks for news and for the strike.
const LOOK_EVERY: Duration = Duration::from_millis(20);
const GARBAGE_BYTES: usize = 1 << 16;

/// The moment of a strike, told to threads that do not see the loop's time.
#[derive(Clone, Debug)]
pub struct Strike {
    at_ns: u64,
    struck: Arc<AtomicBool>,
}

impl Strike {
    /// At loop time `at_ns`.
    pub fn new(at_ns: u64) -> Self {
        Self { at_ns, struck: Arc::default() }
    }

    /// Loop time is now `now_ns`.
    pub fn see(&self, now_ns: u64) {
        if now_ns >= self.at_ns {
            self.struck.store(true, Ordering::Release);
        }
    }

    /// The fault [`OutsideFault::Panic`].
    ///
    /// # Panics
    /// Once the strike has come.
    #[expect(clippy::panic, reason = "this is the fault")]
    pub fn panic(&self) {
        if self.has_come() {
            panic!("injected into a client");
        }
    }

    fn has_come(&self) -> bool {
        self.struck.load(Ordering::Acquire)
    }

    /// Waits for it; `false` if the run is over.
    fn wait(&self, mut meanwhile: impl FnMut()) -> bool {
        while !self.has_come() {
            if self.run_is_over() {
                return false;
            }
            meanwhile();
            std::thread::sleep(LOOK_EVERY);
        }
        true
    }

    fn run_is_over(&self) -> bool {
        Arc::strong_count(&self.struck) == 1
    }
}

/// A disk that fails from the strike on.
pub struct Disk<W> {
    disk: W,
    fault: OutsideFault,
    strike: Strike,
}

impl<W> Disk<W> {
    /// Spoils `disk`.
    pub const fn new(disk: W, fault: OutsideFault, strike: Strike) -> Self {
        Self { disk, fault, strike }
    }
}

impl<W: Write> Write for Disk<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.fault {
            OutsideFault::DiskFull if self.strike.has_come() => Err(ErrorKind::StorageFull.into()),
            OutsideFault::DiskSlow if self.strike.has_come() => {
                std::thread::sleep(SLOW);
                self.disk.write(bytes)
            }
            _ => self.disk.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.disk.flush()
    }
}

/// Starts the client that does `fault` to the telemetry at `address`.
///
/// # Errors
/// No thread, or nobody listens.
pub fn client(fault: OutsideFault, address: &Address, strike: Strike, seed: u64) -> io::Result<()> {
    let client = std::thread::Builder::new().name("spoiled-client".into());
    match fault {
        OutsideFault::PanelGone | OutsideFault::ParameterNan | OutsideFault::ParameterAbsurd => {
            let panel = Connection::spawn(address, || {}).map_err(io::Error::other)?;
            client.spawn(move || misuse(fault, panel, &strike))?;
        }
        _ => {
            let (socket, address) = (connect(address)?, address.clone());
            // A closed socket ends this client, and it has no other purpose.
            client.spawn(move || drop(disturb(fault, socket, &address, &strike, seed)))?;
        }
    }
    Ok(())
}

/// A bare connection.
trait Socket: Read + Write + Send {}
impl<S: Read + Write + Send> Socket for S {}

/// One that introduces itself where no token is needed, so that it is served.
fn connect(address: &Address) -> io::Result<Box<dyn Socket>> {
    let mut socket: Box<dyn Socket> = match address {
        Address::Tcp(address) => {
            let socket = TcpStream::connect(address)?;
            socket.set_read_timeout(Some(LOOK_EVERY))?;
            Box::new(socket)
        }
        Address::Unix(path) => {
            let socket = UnixStream::connect(path)?;
            socket.set_read_timeout(Some(LOOK_EVERY))?;
            Box::new(socket)
        }
        Address::Tls { .. } => return Err(io::ErrorKind::Unsupported.into()),
    };
    let hello = encode_from_client(&FromClient::Hello { role: Role::Observer, proof: None });
    socket.write_all(&hello.map_err(io::Error::other)?)?;
    Ok(socket)
}

fn disturb(
    fault: OutsideFault,
    mut socket: Box<dyn Socket>,
    address: &Address,
    strike: &Strike,
    seed: u64,
) -> io::Result<()> {
    let mut bytes = vec![0; GARBAGE_BYTES];
    let struck = strike.wait(|| {
        // What it reads means nothing to it; a timeout is no news.
        let _ = socket.read(&mut bytes);
    });
    if !struck || fault == OutsideFault::SubscriberGone {
        return Ok(());
    }
    let mut random = Random::new(seed);
    while !strike.run_is_over() {
        if fault == OutsideFault::SocketGarbage {
            bytes.fill_with(|| random.byte());
            // The daemon hangs up on it: it comes again.
            if socket.write_all(&bytes).is_err() {
                socket = connect(address)?;
            }
        }
        std::thread::sleep(LOOK_EVERY);
    }
    Ok(())
}

/// Arms the robot and goes away, or sends an invalid setting.
fn misuse(fault: OutsideFault, panel: Connection, strike: &Strike) {
    if fault == OutsideFault::PanelGone {
        let answered = |request, update: &Update| {
            update.replies.iter().any(|reply| reply.request == request && reply.outcome.is_ok())
        };
        for request in [Request::Disarm, Request::Arm] {
            loop {
                panel.alive();
                panel.request(request);
                std::thread::sleep(LOOK_EVERY);
                if strike.run_is_over() {
                    return;
                }
                if answered(request, &panel.poll()) {
                    break;
                }
            }
        }
    }
    let polls = || {
        panel.alive();
        panel.poll()
    };
    if strike.wait(|| drop(polls()))
        && fault != OutsideFault::PanelGone
        && let (Some(request), Link::Up { .. }) = (fault.request(), panel.poll().link)
    {
        panel.request(request);
        while !strike.run_is_over() {
            std::thread::sleep(LOOK_EVERY);
        }
    }
}

/// Lets a thread of its own pass everything from `events` through `cable`, as a spoiled cable would in real time.
///
/// # Errors
/// The thread could not be started.
pub fn relay(
    mut cable: Cable,
    mut events: rtrb::Consumer<BoardEvent>,
    clock: Clock,
) -> std::io::Result<rtrb::Consumer<BoardEvent>> {
    let (mut out, relayed) = rtrb::RingBuffer::new(RING_EVENTS);
    std::thread::Builder::new().name("spoiled-cable".into()).spawn(move || {
        while !out.is_abandoned() {
            // A full ring loses what follows, as a port does that nobody reads.
            let mut arrive = |event| {
                let _ = out.push(event);
            };
            while let Ok(event) = events.pop() {
                cable.pass(event, &mut arrive);
            }
            cable.wait(clock.now_ns(), &mut arrive);
            std::thread::sleep(CABLE_EVERY);
        }
    })?;
    Ok(relayed)
}

//! The daemon's side: one thread drains the loop's ring and serves every client.
//!
//! ```
//! use moca_msgs::Sample;
//! use moca_telemetry::RobotDescription;
//! use moca_telemetry::net::{Address, Connection, Ports, request_channel, serve};
//! use std::{sync::Arc, time::Duration};
//! // The loop's ends: samples out, requests in.
//! let (mut samples, from_loop) = rtrb::RingBuffer::new(64);
//! let (sender, _requests) = request_channel();
//! let ports = Ports {
//!     samples: from_loop,
//!     requests: sender,
//!     ring_dropped: Arc::default(),
//!     recorder: None,
//!     calibration: None,
//!     judge: None,
//! };
//! let socket = std::env::temp_dir().join(format!("moca-server-{}.sock", std::process::id()));
//! let server = serve(&Address::Unix(socket), 0o600, RobotDescription::paper("lab", true), ports)?;
//!
//! let connection = Connection::spawn(server.address().clone(), || {})?;
//! for tick in 0.. {
//!     // A full ring drops the sample: the loop waits for nobody.
//!     let _ = samples.push(Sample { tick, ..Sample::default() });
//!     if !connection.poll().samples.is_empty() {
//!         break;
//!     }
//!     std::thread::sleep(Duration::from_millis(1));
//! }
//! # Ok::<(), moca_telemetry::net::NetError>(())
//! ```

use super::{
    Address, NetError, access,
    address::Listener,
    command::{Desk, Judge},
    door::{Entrance, TlsPort, accept},
    hub::{Counters, Hub},
    ledger::Ledger,
    requests::RequestSender,
    token::Token,
    wire::{self, FromServer},
};
use crate::{
    RobotDescription,
    audit::Asked,
    calibration::{CalibrationProgress, CalibrationRequest},
};
use moca_msgs::Sample;
use rtrb::{Consumer, Producer};
use std::{
    path::PathBuf,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, Sender, SyncSender, channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio::task::LocalSet;

/// Period of batches: 10 samples at 1 kHz.
const BATCH_PERIOD: Duration = Duration::from_millis(10);
/// Period at which the loop's answers are polled while one is awaited.
const ANSWER_POLL: Duration = Duration::from_millis(1);
/// Most samples in one batch, when the loop runs faster than real time.
const BATCH_MAX: usize = 100;
/// Longest wait of the last samples for the recorder when the server stops.
const SHUTDOWN_WAIT: Duration = Duration::from_secs(2);
/// Permission bits of the socket that only shows: everybody who reaches its folder may look and stop the robot.
const WATCH_MODE: u32 = 0o666;

/// The ends of the loop's rings that belong to telemetry.
pub struct Ports {
    /// One sample for each tick.
    pub samples: Consumer<Sample>,
    /// Requests to the loop, and its answers.
    pub requests: RequestSender,
    /// Samples the loop found no room for, counted by the loop.
    pub ring_dropped: Arc<AtomicU64>,
    /// Receiver of every sample, if a recorder runs. A full recorder holds samples back in the loop's ring, so that samples are
    /// dropped and counted in one place.
    pub recorder: Option<Producer<Sample>>,
    /// The calibrator, if there is one.
    pub calibration: Option<CalibrationPort>,
    /// Judges changes of parameters before the loop hears of them.
    pub judge: Option<Judge>,
}

/// The way to the calibrator, which is no part of the loop.
pub struct CalibrationPort {
    /// Requests to it.
    pub requests: Sender<CalibrationRequest>,
    /// Progress, on every change.
    pub progress: Receiver<CalibrationProgress>,
}

/// A running server. Dropping it stops it, after the last samples have gone to the recorder.
pub struct Server {
    address: Address,
    tls: Option<Address>,
    stop: Arc<AtomicBool>,
    counters: Arc<Counters>,
    notices: Sender<String>,
    thread: Option<JoinHandle<()>>,
}

/// Rules by which a server admits its clients.
#[derive(Clone, Debug, Default)]
pub struct Serving {
    /// Permission bits of a socket file: who may command.
    pub mode: u32,
    /// Token that a client on a TCP port has to know.
    pub token: Option<Token>,
    /// A second socket file, for everybody: it shows the robot and takes no request but a stop.
    pub watch: Option<PathBuf>,
    /// A port for programs of other machines, over TLS.
    pub tls: Option<TlsPort>,
    /// True if the robot arms itself (`startup.arm`): then it may move with nobody in command until an operator
    /// intervenes.
    pub self_armed: bool,
    /// Receiver of what clients ask and are answered. A full one is not waited for: its lines are counted and come later.
    pub audit: Option<SyncSender<Asked>>,
}

impl Serving {
    /// For the owner of this program alone: a socket file of mode 0600, or a port with the token of
    /// [`Token::default_path`], which is made if there is none.
    ///
    /// # Errors
    /// No token file.
    pub fn this_user() -> Result<Self, NetError> {
        let token = Token::default_path().map(|path| Token::read_or_create(&path)).transpose()?;
        Ok(Self { mode: 0o600, token, ..Self::default() })
    }
}

/// A socket file of this mode, and nothing else.
impl From<u32> for Serving {
    fn from(mode: u32) -> Self {
        Self { mode, ..Self::default() }
    }
}

/// Counters of a server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServerStats {
    /// Clients connected now.
    pub clients: u64,
    /// Samples drained from the loop's ring.
    pub samples: u64,
    /// Samples dropped because a client read too slowly, over all clients.
    pub client_dropped: u64,
    /// Longest queue of any client so far, in batches; bounded by design.
    pub longest_queue: u64,
}

/// Serves `description` and the samples of `ports` on `address` (port 0 picks a free one) from a thread of its own. The
/// permission bits of a socket file are enough to say how: `0o600`.
///
/// # Errors
/// An address that other machines reach, that cannot be bound, a port without a token, or no thread.
pub fn serve(
    address: &Address,
    serving: impl Into<Serving>,
    description: RobotDescription,
    ports: Ports,
) -> Result<Server, NetError> {
    let Serving { mode, token, watch, tls, self_armed, audit } = serving.into();
    if !address.is_local() {
        return Err(NetError::NotLoopback(address.clone()));
    }
    // A Unix socket has its file mode instead.
    let token = match address {
        Address::Tcp(_) => Some(token.ok_or_else(|| NetError::NoToken(address.clone()))?),
        Address::Unix(_) | Address::Tls { .. } => None,
    };
    let welcome = wire::encode(&FromServer::Welcome(Box::new(description.clone())))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let entrances = {
        let _context = runtime.enter();
        // The main one last: a program that finds it finds the other too.
        let watch = watch.map(|path| Listener::bind(&Address::Unix(path), WATCH_MODE)).transpose()?;
        let listener = Listener::bind(address, mode)?;
        let seed = Token::random()?;
        let mut entrances = vec![Entrance::new(listener, access::Role::Maintainer, seed.clone())];
        entrances[0].token = token;
        if let Some(watch) = watch {
            entrances.push(Entrance::new(watch, access::Role::Viewer, seed.clone()));
        }
        if let Some(port) = tls {
            entrances.push(Entrance::over_tls(&port, seed)?);
        }
        entrances
    };
    let address = entrances[0].listener.address()?;
    let tls = entrances.last().map(|last| last.listener.address()).transpose()?;
    let tls = tls.filter(|last| matches!(last, Address::Tls { .. }));
    let (notices, from_daemon) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let counters = Arc::new(Counters::default());
    let (thread_stop, thread_counters) = (Arc::clone(&stop), Arc::clone(&counters));
    let thread = std::thread::Builder::new().name("telemetry".into()).spawn(move || {
        let (to_calibrator, from_calibrator) =
            ports.calibration.map(|port| (port.requests, port.progress)).unzip();
        let desk = Desk::new(ports.requests, &description, ports.judge, self_armed);
        let parameters = description.parameters.iter().map(|parameter| parameter.name.clone()).collect();
        let hub = Hub::new(desk, Ledger::new(audit, parameters), thread_counters, welcome, to_calibrator);
        let pump = Pump {
            samples: ports.samples,
            recorder: ports.recorder,
            ring_dropped: ports.ring_dropped,
            calibrator: from_calibrator,
            notices: from_daemon,
        };
        LocalSet::new().block_on(&runtime, async move {
            for entrance in entrances {
                tokio::task::spawn_local(accept(entrance, Rc::clone(&hub)));
            }
            pump.run(&hub, &thread_stop).await;
        });
    });
    Ok(Server { address, tls, stop, counters, notices, thread: Some(thread.map_err(NetError::Thread)?) })
}

impl Server {
    /// The address it listens on.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// The address on which it listens for programs of other machines.
    pub const fn tls_address(&self) -> Option<&Address> {
        self.tls.as_ref()
    }

    /// Returns the sender of notices to every client that are no fault of the robot.
    pub fn notices(&self) -> Sender<String> {
        self.notices.clone()
    }

    /// Returns its counters.
    pub fn stats(&self) -> ServerStats {
        let c = &self.counters;
        ServerStats {
            clients: c.clients.load(Ordering::Relaxed),
            samples: c.samples.load(Ordering::Relaxed),
            client_dropped: c.client_dropped.load(Ordering::Relaxed),
            longest_queue: c.longest_queue.load(Ordering::Relaxed),
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic there has been printed by its own thread, and there is nobody left to serve.
            let _ = thread.join();
        }
    }
}

/// The way of the samples: ring → clients and recorder.
struct Pump {
    samples: Consumer<Sample>,
    recorder: Option<Producer<Sample>>,
    ring_dropped: Arc<AtomicU64>,
    calibrator: Option<Receiver<CalibrationProgress>>,
    notices: Receiver<String>,
}

impl Pump {
    async fn run(mut self, hub: &Hub, stop: &AtomicBool) {
        let mut next_batch = Instant::now() + BATCH_PERIOD;
        while !stop.load(Ordering::Acquire) {
            let wake = if hub.desk.borrow().waits() { Instant::now() + ANSWER_POLL } else { next_batch };
            tokio::select! {
                () = tokio::time::sleep_until(wake.min(next_batch).into()) => {}
                () = hub.asked.notified() => continue,
            }
            hub.deliver_answers();
            let now = Instant::now();
            if now >= next_batch {
                self.notices.try_iter().for_each(|notice| hub.tell_notice(notice));
                if let Some(progress) = self.calibrator.as_ref().and_then(|c| c.try_iter().last()) {
                    hub.tell_calibration(progress);
                }
                // A loop that runs faster than real time fills whole batches: those go out without waiting.
                while self.pass_on(hub) >= BATCH_MAX {
                    tokio::task::yield_now().await;
                }
                hub.ledger.borrow_mut().say_due(now);
                next_batch = next_deadline(next_batch, now);
            }
        }
        hub.ledger.borrow_mut().say_all(Instant::now());
        let deadline = Instant::now() + SHUTDOWN_WAIT;
        while !self.samples.is_empty() && Instant::now() < deadline {
            if self.pass_on(hub) == 0 {
                tokio::time::sleep(ANSWER_POLL).await;
            }
        }
        // The writers get one more turn, so that clients see the last state.
        tokio::time::sleep(BATCH_PERIOD).await;
    }

    /// Passes at most one batch on and returns its size.
    fn pass_on(&mut self, hub: &Hub) -> usize {
        if self.recorder.as_ref().is_some_and(Producer::is_abandoned) {
            self.recorder = None;
        }
        let room = self.recorder.as_ref().map_or(BATCH_MAX, Producer::slots);
        let count = self.samples.slots().min(room).min(BATCH_MAX);
        let mut batch = Vec::with_capacity(count);
        batch.extend(std::iter::from_fn(|| self.samples.pop().ok()).take(count));
        if batch.is_empty() {
            return 0;
        }
        if let Some(recorder) = &mut self.recorder {
            for sample in &batch {
                // Room was counted above and nobody else fills this ring.
                let _ = recorder.push(sample.clone());
            }
        }
        if let Some(latest) = batch.last() {
            hub.desk.borrow_mut().see_posture(&latest.q_rad);
        }
        hub.counters.samples.fetch_add(count as u64, Ordering::Relaxed);
        hub.publish(batch, self.ring_dropped.load(Ordering::Relaxed));
        count
    }
}

/// A period after the last deadline, not after the time of waking: what each wake-up is late would add up. Deadlines that
/// have passed altogether are not made up for.
fn next_deadline(last: Instant, now: Instant) -> Instant {
    (last + BATCH_PERIOD).max(now)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_wake_ups_do_not_add_up() {
        let start = Instant::now();
        let late = Duration::from_micros(1100);
        let mut deadline = start;
        for _ in 0..100 {
            deadline = next_deadline(deadline, deadline + late);
        }
        assert_eq!(deadline - start, 100 * BATCH_PERIOD);
        let slept = deadline + 5 * BATCH_PERIOD;
        assert_eq!(next_deadline(deadline, slept), slept, "batches that were missed come in one");
    }
}

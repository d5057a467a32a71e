//! Attacks on a running daemon, and the time a stop takes under each: shared by the tests, the example `stop_latency` and
//! the lab.
//!
//! ```no_run
//! use moca_telemetry::net::{Address, testing::{Attack, Siege, stop_latencies}};
//! let address: Address = "unix:/tmp/robot.sock".parse()?;
//! for attack in Attack::ALL {
//!     let siege = Siege::begin(&address, attack)?;
//!     let latencies = stop_latencies(&address, 200)?;
//!     println!("{}: p99 {:?}", attack.name(), latencies[197]);
//!     drop(siege);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::{
    Address, Client, Endpoint, NetError, address, client,
    wire::{COMMAND_LEASE, FromServer},
};
use moca_msgs::{Law, Outcome, Request};
use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    sync::oneshot,
};

/// Clients that watch, and connections that say a length and nothing else.
const CROWD: usize = 1000;
/// Clients that the daemon serves besides the one in the commander's place.
const PLACES: usize = 32;
/// Pause of a client that was refused, as dashboards make it.
const AGAIN: Duration = Duration::from_millis(250);

/// Something that others do while somebody wants to stop the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attack {
    /// Nothing, to compare with.
    Nothing,
    /// A thousand clients that watch, or would.
    Watchers,
    /// A thousand connections that announce a frame and never send it, and come again when they are closed.
    HalfOpen,
    /// One client that asks as fast as its socket takes it.
    Flood,
    /// Every place is taken by a watcher, and the last one by a commander that stays.
    LastPlace,
    /// All of them together.
    Everything,
}

impl Attack {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Nothing, Self::Watchers, Self::HalfOpen, Self::Flood, Self::LastPlace, Self::Everything];

    /// Words for a table.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nobody else",
            Self::Watchers => "1000 watchers",
            Self::HalfOpen => "1000 half-open handshakes",
            Self::Flood => "a flood of requests",
            Self::LastPlace => "a commander in the last place",
            Self::Everything => "all of these",
        }
    }

    fn includes(self, part: Self) -> bool {
        self == part || self == Self::Everything
    }
}

/// An attack that goes on until it is dropped.
pub struct Siege {
    end: Option<oneshot::Sender<()>>,
    requests: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Siege {
    /// Begins an attack from a thread of its own. A crowd needs 1000 file descriptors: `ulimit -n`.
    ///
    /// # Errors
    /// No thread.
    pub fn begin(address: &Address, attack: Attack) -> Result<Self, NetError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (end, ended) = oneshot::channel::<()>();
        let (address, requests) = (address.clone(), Arc::new(AtomicU64::new(0)));
        let counter = Arc::clone(&requests);
        let thread = std::thread::Builder::new().name("siege".into()).spawn(move || {
            runtime.block_on(async move {
                let mut tasks = tokio::task::JoinSet::new();
                if attack.includes(Attack::LastPlace) {
                    (0..PLACES).for_each(|_| drop(tasks.spawn(watch(address.clone()))));
                    tasks.spawn(command(address.clone()));
                }
                if attack.includes(Attack::Watchers) {
                    (0..CROWD).for_each(|_| drop(tasks.spawn(watch(address.clone()))));
                }
                if attack.includes(Attack::HalfOpen) {
                    (0..CROWD).for_each(|_| drop(tasks.spawn(stay_half_open(address.clone()))));
                }
                if attack.includes(Attack::Flood) {
                    tasks.spawn(flood(address.clone(), counter));
                }
                // A dropped sender ends it too.
                let _ = ended.await;
            });
        });
        Ok(Self { end: Some(end), requests, thread: Some(thread.map_err(NetError::Thread)?) })
    }

    /// Requests that a flood has sent so far.
    pub fn requests(&self) -> u64 {
        self.requests.load(Ordering::Relaxed)
    }
}

impl Drop for Siege {
    fn drop(&mut self) {
        self.end = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has been printed by its own thread.
            let _ = thread.join();
        }
    }
}

/// Times from the call of a client that is not connected yet to the loop's answer, sorted: `count` stops, one by one.
///
/// # Errors
/// A stop that is not obeyed.
pub fn stop_latencies(address: &Address, count: usize) -> Result<Vec<Duration>, NetError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut latencies = Vec::with_capacity(count);
    for _ in 0..count {
        let start = Instant::now();
        let outcome: Outcome = runtime.block_on(client::stop(address))?;
        outcome.map_err(|refusal| NetError::Refused(refusal.to_string()))?;
        latencies.push(start.elapsed());
        std::thread::sleep(Duration::from_millis(5));
    }
    latencies.sort_unstable();
    Ok(latencies)
}

async fn watch(address: Address) {
    loop {
        if let Ok(Client { mut incoming, .. }) = Client::connect(Endpoint::from(&address).to_watch()).await {
            while incoming.next().await.is_ok() {}
        }
        tokio::time::sleep(AGAIN).await;
    }
}

async fn stay_half_open(address: Address) {
    loop {
        match address::connect(&address, None).await {
            Ok((mut reader, mut writer)) => {
                // Closed or not, it reads until the end and comes again.
                let _ = writer.write_all(&[0, 0, 0, 40]).await;
                let mut ignored = [0; 256];
                while reader.read(&mut ignored).await.is_ok_and(|bytes| bytes > 0) {}
            }
            Err(_) => tokio::time::sleep(AGAIN).await,
        }
    }
}

/// Takes the command, and the last place with it, and keeps both.
async fn command(address: Address) {
    loop {
        // The watchers come first.
        tokio::time::sleep(AGAIN).await;
        if let Ok(Client { mut incoming, mut outgoing, .. }) = Client::connect(&address).await {
            let asking = async {
                while outgoing.request(1, Request::SelectLaw(Law::Impedance)).await.is_ok() {
                    tokio::time::sleep(COMMAND_LEASE / 4).await;
                }
            };
            let reading = async { while incoming.next().await.is_ok() {} };
            tokio::join!(asking, reading);
        }
    }
}

async fn flood(address: Address, requests: Arc<AtomicU64>) {
    loop {
        if let Ok(Client { mut incoming, mut outgoing, .. }) = Client::connect(&address).await {
            let asking = async {
                let mut id = 0;
                while outgoing.request(id, Request::EndTarget).await.is_ok() {
                    id += 1;
                    requests.fetch_add(1, Ordering::Relaxed);
                }
            };
            let reading = async {
                loop {
                    match incoming.next().await {
                        Err(_) | Ok(FromServer::Goodbye(_)) => break,
                        Ok(_) => {}
                    }
                }
            };
            tokio::join!(asking, reading);
        }
        tokio::time::sleep(AGAIN).await;
    }
}

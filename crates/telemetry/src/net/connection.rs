//! A thread that keeps a connection alive: what a dashboard wants.
//!
//! ```
//! use moca_telemetry::net::{Address, Connection, Link};
//! // Nobody listens there: the connection says so, and goes on trying.
//! let address: Address = "unix:/no/such/socket".parse()?;
//! let connection = Connection::spawn(address, || {})?;
//! let update = connection.poll();
//! assert!(matches!(update.link, Link::Down { .. }) && update.samples.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::{
    Address, Endpoint, NetError,
    client::{self, Client, Incoming, Outgoing},
    wire::{FromServer, Status},
};
use crate::{
    RobotDescription,
    calibration::{CalibrationProgress, CalibrationRequest},
};
use moca_msgs::target::check_trajectory;
use moca_msgs::{Outcome, Refusal, Request, Sample, TouchPolicy, Waypoint};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};
use tokio::{sync::mpsc, task::JoinSet};

/// Most samples kept for a reader that does not poll: 10 s at 1 kHz. The oldest are dropped.
const MAX_SAMPLES: usize = 10_000;
/// Most requests on their way.
const MAX_REQUESTS: usize = 64;
/// Pause before the next attempt to connect.
const RETRY: Duration = Duration::from_millis(250);
/// Period at which a sign of life is passed on, if one was given.
const BEAT: Duration = Duration::from_millis(250);
/// Longest duration of connecting and greeting.
const GREETING_TIMEOUT: Duration = Duration::from_secs(2);

/// State of the connection.
#[derive(Clone, Debug, PartialEq)]
pub enum Link {
    /// No daemon, and why the last attempt failed.
    Down {
        /// For the user.
        reason: String,
    },
    /// Connected.
    Up {
        /// Counts connections: a change means that the daemon, its clock and its ticks may be new.
        session: u64,
        /// The robot on the other side, with the present values of its parameters.
        description: Arc<RobotDescription>,
    },
}

/// The answer to a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reply {
    /// Request.
    pub request: Request,
    /// The answer.
    pub outcome: Outcome,
}

impl Reply {
    /// Returns true if this answers `request`. NaN is not equal to itself: a request that carries it is known by its text.
    ///
    /// ```
    /// use moca_msgs::{GripperRequest, Request};
    /// use moca_telemetry::net::Reply;
    ///
    /// let request = Request::Gripper(GripperRequest::Move { width_m: f64::NAN, speed_m_s: 0.05 });
    /// let reply = Reply { request, outcome: Ok(()) };
    /// assert!(reply.request != request && reply.answers(&request));
    /// assert!(!reply.answers(&Request::Gripper(GripperRequest::Move { width_m: 0.04, speed_m_s: 0.05 })));
    /// ```
    pub fn answers(&self, request: &Request) -> bool {
        self.request == *request || format!("{:?}", self.request) == format!("{request:?}")
    }
}

/// News since the last poll.
#[derive(Clone, Debug)]
pub struct Update {
    /// State of the connection.
    pub link: Link,
    /// Status of this connection at the daemon.
    pub status: Status,
    /// Samples of the present session, oldest first.
    pub samples: Vec<Sample>,
    /// Answers.
    pub replies: Vec<Reply>,
    /// Progress of the calibration.
    pub calibration: CalibrationProgress,
    /// Notices to the daemon's owner that are no fault of the robot.
    pub notices: Vec<String>,
    /// Samples dropped because nobody polled, so far.
    pub unread_dropped: u64,
}

impl Update {
    /// `samples` over this link, and no other news.
    pub fn new(link: Link, samples: Vec<Sample>) -> Self {
        Self {
            link,
            status: Status::default(),
            samples,
            replies: Vec::new(),
            calibration: CalibrationProgress::Idle,
            notices: Vec::new(),
            unread_dropped: 0,
        }
    }
}

/// A connection that comes back by itself. Dropping it closes it.
pub struct Connection {
    shared: Arc<Mutex<Shared>>,
    alive: Arc<AtomicBool>,
    commands: Option<mpsc::Sender<Command>>,
    thread: Option<JoinHandle<()>>,
}

enum Command {
    Request(Request),
    Trajectory(TouchPolicy, Vec<Waypoint>),
    Calibrate(CalibrationRequest),
    Release,
}

struct Shared {
    link: Link,
    session: u64,
    status: Status,
    samples: VecDeque<Sample>,
    /// Most of them; the oldest are dropped.
    most: usize,
    unread_dropped: u64,
    replies: Vec<Reply>,
    calibration: CalibrationProgress,
    notices: Vec<String>,
    waiting: BTreeMap<u64, Request>,
    refusal: Option<String>,
}

impl Connection {
    /// Starts to connect to `endpoint`; `wake` is called from the connection's thread whenever there is news.
    pub fn spawn(endpoint: impl Into<Endpoint>, wake: impl Fn() + Send + 'static) -> Result<Self, NetError> {
        Self::keeping(MAX_SAMPLES, endpoint, wake)
    }

    /// As [`Self::spawn`], with at most so many samples kept for a reader that does not poll.
    pub(super) fn keeping(
        most: usize,
        endpoint: impl Into<Endpoint>,
        wake: impl Fn() + Send + 'static,
    ) -> Result<Self, NetError> {
        let endpoint = endpoint.into();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (commands, from_user) = mpsc::channel(MAX_REQUESTS);
        let shared = Arc::new(Mutex::new(Shared {
            link: Link::Down { reason: "not connected yet".into() },
            session: 0,
            status: Status::default(),
            samples: VecDeque::new(),
            most,
            unread_dropped: 0,
            replies: Vec::new(),
            calibration: CalibrationProgress::default(),
            notices: Vec::new(),
            waiting: BTreeMap::new(),
            refusal: None,
        }));
        let alive = Arc::new(AtomicBool::new(false));
        let (thread_shared, thread_alive) = (Arc::clone(&shared), Arc::clone(&alive));
        let thread = std::thread::Builder::new().name("connection".into()).spawn(move || {
            runtime.block_on(keep_connected(&endpoint, &thread_shared, &thread_alive, from_user, &wake));
        });
        Ok(Self { shared, alive, commands: Some(commands), thread: Some(thread.map_err(NetError::Thread)?) })
    }

    /// Everything new since the last call. Never waits for the network.
    pub fn poll(&self) -> Update {
        let mut s = lock(&self.shared);
        Update {
            link: s.link.clone(),
            status: s.status,
            // The storage goes along: what once held a long wait is freed with this update.
            samples: std::mem::take(&mut s.samples).into(),
            replies: std::mem::take(&mut s.replies),
            calibration: s.calibration.clone(),
            notices: std::mem::take(&mut s.notices),
            unread_dropped: s.unread_dropped,
        }
    }

    /// The reason why the daemon, which was reached, does not serve this client. The connection goes on trying: a place may
    /// become free.
    pub fn refusal(&self) -> Option<String> {
        lock(&self.shared).refusal.clone()
    }

    /// A sign of life from the person or program that commands: a window calls this for each picture that it has drawn, a
    /// program wherever it makes progress. Only such a sign keeps the command, never the connection's own thread: a
    /// commander without one for [`super::wire::COMMAND_LEASE`] loses the command, and a moving robot stops.
    pub fn alive(&self) {
        self.alive.store(true, Ordering::Relaxed);
    }

    /// Asks the loop; the answer comes with a later [`Self::poll`], [`Refusal::NoAnswer`] if there is no daemon. A stop is
    /// taken even where the daemon does not serve this client.
    pub fn request(&self, request: Request) {
        if !self.send(Command::Request(request)) {
            lock(&self.shared).replies.push(Reply { request, outcome: Err(Refusal::NoAnswer) });
        }
    }

    /// Leads the flange along poses and times. The answer comes with a later [`Self::poll`], as that to the last pose's
    /// [`Request::Waypoint`].
    pub fn trajectory(&self, touch: TouchPolicy, waypoints: Vec<Waypoint>) {
        let Some(&waypoint) = waypoints.last() else { return };
        let request = as_request(&waypoints, waypoint, touch);
        // What no daemon takes is refused here: of a frame that is too long it could only hang up.
        if let Err(refusal) = check_trajectory(&waypoints) {
            lock(&self.shared).replies.push(Reply { request, outcome: Err(refusal.into()) });
            return;
        }
        if !self.send(Command::Trajectory(touch, waypoints)) {
            lock(&self.shared).replies.push(Reply { request, outcome: Err(Refusal::NoAnswer) });
        }
    }

    /// Asks the calibrator; its progress comes with later [`Self::poll`]s.
    pub fn calibrate(&self, request: CalibrationRequest) {
        // Without a connection there is nobody to calibrate, and the progress says so.
        self.send(Command::Calibrate(request));
    }

    /// Gives the command back, so that another client can take it.
    pub fn release(&self) {
        // Without a connection there is nothing to give back.
        self.send(Command::Release);
    }

    fn send(&self, command: Command) -> bool {
        let up = matches!(lock(&self.shared).link, Link::Up { .. });
        let stops = matches!(command, Command::Request(Request::Stop));
        (up || stops) && self.commands.as_ref().is_some_and(|o| o.try_send(command).is_ok())
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            // A panic there has been printed by its own thread.
            let _ = thread.join();
        }
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn keep_connected(
    endpoint: &Endpoint,
    shared: &Arc<Mutex<Shared>>,
    alive: &AtomicBool,
    mut commands: mpsc::Receiver<Command>,
    wake: &impl Fn(),
) {
    let mut stops = JoinSet::new();
    let address = &endpoint.address;
    loop {
        let greeted = tokio::select! {
            greeted = tokio::time::timeout(GREETING_TIMEOUT, Client::connect(endpoint.clone())) => greeted,
            () = without_daemon(address, shared, &mut commands, &mut stops) => break,
        };
        let reason = match greeted {
            Ok(Ok(Client { description, mut incoming, mut outgoing })) => {
                greet(shared, description);
                wake();
                let end = tokio::select! {
                    end = listen(&mut incoming, shared, wake) => Some(end),
                    end = speak(&mut outgoing, shared, alive, &mut commands) => end,
                };
                let Some(reason) = end else { break };
                reason
            }
            Ok(Err(error)) => {
                lock(shared).refusal = error.is_refusal().then(|| error.to_string());
                error.to_string()
            }
            Err(_) => format!("{address} does not greet: not a MOCA-S daemon?"),
        };
        if hang_up(shared, reason) {
            wake();
        }
        tokio::select! {
            () = tokio::time::sleep(RETRY) => {}
            () = without_daemon(address, shared, &mut commands, &mut stops) => break,
        }
    }
    // A stop that was asked for just before the end is still sent.
    while stops.join_next().await.is_some() {}
}

/// Reads until the connection breaks, and says why it did.
async fn listen(incoming: &mut Incoming, shared: &Mutex<Shared>, wake: &impl Fn()) -> String {
    loop {
        let message = match incoming.next().await {
            Ok(message) => message,
            Err(error) => return error.to_string(),
        };
        let mut s = lock(shared);
        match message {
            FromServer::Batch(batch) => {
                s.samples.extend(batch.samples);
                let excess = s.samples.len().saturating_sub(s.most);
                s.samples.drain(..excess);
                s.unread_dropped += excess as u64;
            }
            FromServer::Status(status) => s.status = status,
            FromServer::Parameters(changed) => {
                if let Link::Up { description, .. } = &mut s.link {
                    let description = Arc::make_mut(description);
                    for (number, values) in &changed {
                        description.note_parameter(usize::from(*number), values);
                    }
                }
            }
            FromServer::Goodbye(reason) => return reason,
            FromServer::Notice(notice) => s.notices.push(notice),
            // It came before.
            FromServer::Welcome(_) => {}
            FromServer::Calibration(progress) => s.calibration = progress,
            FromServer::Reply { id, outcome } => {
                if let Some(request) = s.waiting.remove(&id) {
                    s.replies.push(Reply { request, outcome });
                }
            }
        }
        drop(s);
        wake();
    }
}

/// Passes commands on; `None` once there will be no more.
async fn speak(
    outgoing: &mut Outgoing,
    shared: &Mutex<Shared>,
    alive: &AtomicBool,
    commands: &mut mpsc::Receiver<Command>,
) -> Option<String> {
    let mut id = 0;
    let mut beat = tokio::time::interval(BEAT);
    loop {
        let command = tokio::select! {
            command = commands.recv() => Some(command?),
            _ = beat.tick() => None,
        };
        let sent = match command {
            None if alive.swap(false, Ordering::Relaxed) => outgoing.alive().await,
            None => Ok(()),
            Some(Command::Request(request)) => {
                id += 1;
                lock(shared).waiting.insert(id, request);
                outgoing.request(id, request).await
            }
            Some(Command::Trajectory(touch, waypoints)) => {
                id += 1;
                if let Some(&last) = waypoints.last() {
                    lock(shared).waiting.insert(id, as_request(&waypoints, last, touch));
                }
                outgoing.trajectory(id, touch, waypoints).await
            }
            Some(Command::Calibrate(request)) => outgoing.calibrate(request).await,
            Some(Command::Release) => outgoing.release().await,
        };
        if let Err(error) = sent {
            return Some(error.to_string());
        }
    }
}

/// The request that a trajectory's answer belongs to.
fn as_request(waypoints: &[Waypoint], waypoint: Waypoint, touch: TouchPolicy) -> Request {
    let count = u8::try_from(waypoints.len()).unwrap_or(u8::MAX);
    Request::Waypoint { index: count.saturating_sub(1), count, waypoint, touch }
}

/// Answers commands while this client is not served; ends when there will be no more commands. A stop goes its own way, in
/// `stops`.
async fn without_daemon(
    address: &Address,
    shared: &Arc<Mutex<Shared>>,
    commands: &mut mpsc::Receiver<Command>,
    stops: &mut JoinSet<()>,
) {
    while let Some(command) = commands.recv().await {
        let request = match command {
            Command::Request(Request::Stop) => {
                let (address, shared) = (address.clone(), Arc::clone(shared));
                stops.spawn(async move {
                    let outcome = client::stop(&address).await.unwrap_or(Err(Refusal::NoAnswer));
                    lock(&shared).replies.push(Reply { request: Request::Stop, outcome });
                });
                None
            }
            Command::Request(request) => Some(request),
            Command::Trajectory(touch, waypoints) => {
                waypoints.last().map(|&waypoint| as_request(&waypoints, waypoint, touch))
            }
            Command::Calibrate(_) | Command::Release => None,
        };
        if let Some(request) = request {
            lock(shared).replies.push(Reply { request, outcome: Err(Refusal::NoAnswer) });
        }
    }
}

fn greet(shared: &Mutex<Shared>, description: RobotDescription) {
    let mut s = lock(shared);
    s.session += 1;
    s.refusal = None;
    s.samples.clear();
    s.status = Status::default();
    s.calibration = CalibrationProgress::default();
    s.link = Link::Up { session: s.session, description: Arc::new(description) };
}

/// Notes that there is no connection; whether that is news.
fn hang_up(shared: &Mutex<Shared>, reason: String) -> bool {
    let mut s = lock(shared);
    let unanswered = std::mem::take(&mut s.waiting);
    s.replies
        .extend(unanswered.into_values().map(|request| Reply { request, outcome: Err(Refusal::NoAnswer) }));
    let link = Link::Down { reason };
    let news = s.link != link || !s.replies.is_empty();
    s.link = link;
    news
}

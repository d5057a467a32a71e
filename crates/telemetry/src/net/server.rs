//! The daemon's side: one thread drains the loop's ring and serves every client.
//!
//! ```
//! use moca_msgs::Sample;
//! use moca_telemetry::RobotDescription;
//! use moca_telemetry::net::{Address, Connection, Ports, request_channel, serve};
//! use std::{net::SocketAddr, sync::Arc, time::Duration};
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
//! let any_port = Address::from(SocketAddr::from(([127, 0, 0, 1], 0)));
//! let server = serve(&any_port, 0o600, RobotDescription::paper("lab", true), ports)?;
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
    Address, NetError,
    address::{Listener, Reader, Writer},
    command::{ClientId, Desk, Judge},
    queue::{EncodedBatch, Outgoing, Queue},
    requests::RequestSender,
    wire::{self, Batch, FromClient, FromServer, unix_now_ns},
};
use crate::{
    RobotDescription,
    calibration::{CalibrationProgress, CalibrationRequest},
};
use moca_msgs::{Outcome, ParameterValues, Sample};
use rtrb::{Consumer, Producer};
use std::{
    cell::RefCell,
    collections::BTreeMap,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, Sender, channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio::{io::AsyncWriteExt, sync::Notify, task::LocalSet, time::timeout};

/// How often samples are sent: 10 at 1 kHz.
const BATCH_PERIOD: Duration = Duration::from_millis(10);
/// How often the loop's answers are looked for while one is awaited.
const ANSWER_POLL: Duration = Duration::from_millis(1);
/// Most samples in one batch, when the loop runs faster than real time.
const BATCH_MAX: usize = 100;
/// Most clients at a time: memory is bounded by this times the queue of one. Beyond them there is one place for a
/// commander, so that whoever wants to stop the robot is never locked out by those who only watch.
const MAX_CLIENTS: usize = 32;
/// How long a client in the commander's place may be without the command, and how long one may read nothing.
const PATIENCE: Duration = Duration::from_secs(2);
/// Notices that a new client is told.
const MAX_NOTICES: usize = 16;
/// How long the last samples may wait for the recorder when the server stops.
const SHUTDOWN_WAIT: Duration = Duration::from_secs(2);

/// The ends of the loop's rings that belong to telemetry.
pub struct Ports {
    /// One sample for each tick.
    pub samples: Consumer<Sample>,
    /// Requests to the loop, and its answers.
    pub requests: RequestSender,
    /// Samples the loop found no room for, counted by the loop.
    pub ring_dropped: Arc<AtomicU64>,
    /// Where every sample goes on to, if one records. A full recorder holds samples back in the loop's ring, so
    /// that there is one place where samples are dropped and counted.
    pub recorder: Option<Producer<Sample>>,
    /// The calibrator, if there is one.
    pub calibration: Option<CalibrationPort>,
    /// Judges changes of parameters before the loop hears of them.
    pub judge: Option<Judge>,
}

/// The way to the calibrator, which is no part of the loop.
pub struct CalibrationPort {
    /// What is asked of it.
    pub requests: Sender<CalibrationRequest>,
    /// How far it has come, on every change.
    pub progress: Receiver<CalibrationProgress>,
}

/// A running server. Dropping it stops it, after the last samples have gone to the recorder.
pub struct Server {
    address: Address,
    stop: Arc<AtomicBool>,
    counters: Arc<Counters>,
    notices: Sender<String>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Counters {
    clients: AtomicU64,
    samples: AtomicU64,
    client_dropped: AtomicU64,
    longest_queue: AtomicU64,
}

/// What a server has done so far.
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

/// Serves `description` and the samples of `ports` on `address` (port 0 picks a free one) from a thread of its own. A
/// Unix socket's file gets `mode` (its permission bits).
///
/// # Errors
/// An address that other machines reach, that cannot be bound, or no thread.
pub fn serve(
    address: &Address,
    mode: u32,
    description: RobotDescription,
    ports: Ports,
) -> Result<Server, NetError> {
    if !address.is_local() {
        return Err(NetError::NotLoopback(address.clone()));
    }
    let greeting = wire::greeting(&description)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let listener = {
        let _context = runtime.enter();
        Listener::bind(address, mode)?
    };
    let address = listener.address()?;
    let (notices, from_daemon) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let counters = Arc::new(Counters::default());
    let (thread_stop, thread_counters) = (Arc::clone(&stop), Arc::clone(&counters));
    let thread = std::thread::Builder::new().name("telemetry".into()).spawn(move || {
        let (to_calibrator, from_calibrator) =
            ports.calibration.map(|port| (port.requests, port.progress)).unzip();
        let hub = Rc::new(Hub {
            clients: RefCell::default(),
            desk: RefCell::new(Desk::new(ports.requests, &description, ports.judge)),
            asked: Notify::new(),
            counters: thread_counters,
            greeting,
            parameters: RefCell::default(),
            calibration: RefCell::new(Calibration { requests: to_calibrator, frame: None }),
            notices: RefCell::default(),
        });
        let pump = Pump {
            samples: ports.samples,
            recorder: ports.recorder,
            ring_dropped: ports.ring_dropped,
            calibrator: from_calibrator,
            notices: from_daemon,
        };
        LocalSet::new().block_on(&runtime, async move {
            tokio::task::spawn_local(accept(listener, Rc::clone(&hub)));
            pump.run(&hub, &thread_stop).await;
        });
    });
    Ok(Server { address, stop, counters, notices, thread: Some(thread.map_err(NetError::Thread)?) })
}

impl Server {
    /// The address it listens on.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// Where to tell every client something that is no fault of the robot.
    pub fn notices(&self) -> Sender<String> {
        self.notices.clone()
    }

    /// What it has done so far.
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

/// What every task of the telemetry thread shares.
struct Hub {
    clients: RefCell<BTreeMap<ClientId, Rc<Client>>>,
    desk: RefCell<Desk>,
    /// Wakes the pump when a request has gone to the loop.
    asked: Notify,
    counters: Arc<Counters>,
    greeting: Vec<u8>,
    parameters: RefCell<ToldParameters>,
    calibration: RefCell<Calibration>,
    /// What was said to all, as frames.
    notices: RefCell<Vec<Rc<Vec<u8>>>>,
}

/// The changed parameters, and the frame that tells them.
#[derive(Default)]
struct ToldParameters {
    values: BTreeMap<u8, ParameterValues>,
    frame: Option<Rc<Vec<u8>>>,
}

/// What there is to say about the calibration.
#[derive(Default)]
struct Calibration {
    requests: Option<Sender<CalibrationRequest>>,
    frame: Option<Rc<Vec<u8>>>,
}

struct Client {
    id: ClientId,
    queue: RefCell<Queue>,
    /// Wakes who writes.
    filled: Notify,
    /// Wakes who reads and waits for room.
    emptied: Notify,
}

impl Hub {
    fn publish(&self, samples: Vec<Sample>, ring_dropped: u64) {
        let count = samples.len() as u64;
        let message = FromServer::Batch(Batch { sent_unix_ns: unix_now_ns(), samples });
        let Ok(frame) = wire::encode(&message) else {
            return; // BATCH_MAX samples are far below the largest frame.
        };
        let batch = Rc::new(EncodedBatch { frame, samples: count });
        let (mut dropped, mut longest) = (0, self.counters.longest_queue.load(Ordering::Relaxed));
        let desk = self.desk.borrow();
        for client in self.clients.borrow().values() {
            let mut queue = client.queue.borrow_mut();
            let before = queue.dropped();
            queue.push_batch(Rc::clone(&batch));
            queue.set_status(ring_dropped, desk.commander_seen_by(client.id));
            dropped += queue.dropped() - before;
            longest = longest.max(queue.waiting() as u64);
            client.filled.notify_one();
        }
        self.counters.client_dropped.fetch_add(dropped, Ordering::Relaxed);
        self.counters.longest_queue.store(longest, Ordering::Relaxed);
    }

    fn reply(&self, client: ClientId, id: u64, outcome: Outcome) {
        let clients = self.clients.borrow();
        let (Some(client), Ok(frame)) =
            (clients.get(&client), wire::encode(&FromServer::Reply { id, outcome }))
        else {
            return; // It left before the answer came.
        };
        client.queue.borrow_mut().push_reply(frame);
        client.filled.notify_one();
    }

    fn tell_parameters(&self) {
        let desk = self.desk.borrow();
        let mut told = self.parameters.borrow_mut();
        if told.values == *desk.parameters() {
            return;
        }
        told.values.clone_from(desk.parameters());
        let message =
            FromServer::Parameters(told.values.iter().map(|(number, values)| (*number, *values)).collect());
        let Ok(frame) = wire::encode(&message).map(Rc::new) else {
            return; // 256 parameters are far below the largest frame.
        };
        told.frame = Some(Rc::clone(&frame));
        for client in self.clients.borrow().values() {
            client.queue.borrow_mut().set_parameters(Rc::clone(&frame));
            client.filled.notify_one();
        }
    }

    fn tell_calibration(&self, progress: CalibrationProgress) {
        let Ok(frame) = wire::encode(&FromServer::Calibration(progress)).map(Rc::new) else {
            return; // Some hundred residuals are far below the largest frame.
        };
        for client in self.clients.borrow().values() {
            client.queue.borrow_mut().set_calibration(Rc::clone(&frame));
            client.filled.notify_one();
        }
        self.calibration.borrow_mut().frame = Some(frame);
    }

    fn tell_notice(&self, notice: String) {
        let Ok(frame) = wire::encode(&FromServer::Notice(notice)).map(Rc::new) else {
            return; // A line is far below the largest frame.
        };
        for client in self.clients.borrow().values() {
            client.queue.borrow_mut().push_notice(Rc::clone(&frame));
            client.filled.notify_one();
        }
        let mut notices = self.notices.borrow_mut();
        if notices.len() < MAX_NOTICES {
            notices.push(frame);
        }
    }

    fn calibrate(&self, client: ClientId, request: CalibrationRequest) {
        if self.desk.borrow_mut().claim(client, Instant::now())
            && let Some(requests) = &self.calibration.borrow().requests
        {
            // A calibrator that has ended says nothing any more either.
            let _ = requests.send(request);
        }
    }

    fn deliver_answers(&self) {
        let answers = self.desk.borrow_mut().answers(Instant::now());
        self.tell_parameters();
        for answer in answers {
            self.reply(answer.client, answer.id, answer.outcome);
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
                next_batch = next_deadline(next_batch, now);
            }
        }
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

async fn accept(listener: Listener, hub: Rc<Hub>) {
    let mut next_id = 0;
    loop {
        let Ok((reader, writer)) = listener.accept().await else {
            // Out of descriptors: the others go on, and a later one may succeed.
            tokio::time::sleep(BATCH_PERIOD).await;
            continue;
        };
        if hub.clients.borrow().len() > MAX_CLIENTS {
            tokio::task::spawn_local(refuse(writer));
            continue;
        }
        next_id += 1;
        tokio::task::spawn_local(attend(next_id, reader, writer, Rc::clone(&hub)));
    }
}

/// Says why a client is not served.
async fn refuse(mut writer: Writer) {
    let reason = format!(
        "all {MAX_CLIENTS} places and the one for a commander are taken; close a client that only watches"
    );
    if let Ok(frame) = wire::refusal(&reason) {
        // Whether it listens or not, it is not served.
        let _ = timeout(PATIENCE, writer.write_all(&frame)).await;
    }
}

/// One client from greeting to goodbye.
async fn attend(id: ClientId, reader: Reader, writer: Writer, hub: Rc<Hub>) {
    let client =
        Rc::new(Client { id, queue: RefCell::default(), filled: Notify::new(), emptied: Notify::new() });
    if let Some(frame) = &hub.parameters.borrow().frame {
        client.queue.borrow_mut().set_parameters(Rc::clone(frame));
    }
    if let Some(frame) = &hub.calibration.borrow().frame {
        client.queue.borrow_mut().set_calibration(Rc::clone(frame));
    }
    for frame in &*hub.notices.borrow() {
        client.queue.borrow_mut().push_notice(Rc::clone(frame));
    }
    hub.clients.borrow_mut().insert(id, Rc::clone(&client));
    hub.counters.clients.fetch_add(1, Ordering::Relaxed);
    tokio::select! {
        _ = read_requests(reader, &client, &hub) => {}
        _ = write_queue(writer, &client, &hub.greeting) => {}
        () = leave_commanders_place(&client, &hub) => {}
    }
    hub.clients.borrow_mut().remove(&id);
    hub.desk.borrow_mut().lose(id);
    hub.counters.clients.fetch_sub(1, Ordering::Relaxed);
}

/// Ends once a client beyond [`MAX_CLIENTS`] has gone without the command for too long; never for any other.
async fn leave_commanders_place(client: &Client, hub: &Hub) {
    loop {
        if hub.clients.borrow().len() <= MAX_CLIENTS {
            return std::future::pending().await;
        }
        tokio::time::sleep(PATIENCE).await;
        let crowded = hub.clients.borrow().len() > MAX_CLIENTS;
        if crowded && !hub.desk.borrow().is_commander(client.id) {
            break;
        }
    }
    let reason = format!("{MAX_CLIENTS} others watch, and the last place is kept for a commander");
    if let Ok(frame) = wire::encode(&FromServer::Goodbye(reason)) {
        client.queue.borrow_mut().set_goodbye(frame);
        client.filled.notify_one();
        // The writer ends when it has written it.
        tokio::time::sleep(PATIENCE).await;
    }
}

/// Hears a client as fast as it reads its answers. One that asks and reads nothing is heard no more, and closed by the writer.
async fn read_requests(mut reader: Reader, client: &Client, hub: &Hub) -> Result<(), NetError> {
    let mut payload = Vec::new();
    loop {
        while !client.queue.borrow().has_room() {
            client.emptied.notified().await;
        }
        wire::read_frame(&mut reader, &mut payload, wire::MAX_CLIENT_FRAME).await?;
        hub.desk.borrow_mut().hear(client.id, Instant::now());
        match wire::decode_from_client(&payload)? {
            FromClient::Alive => {}
            FromClient::Request { id, request } => {
                let refused = hub.desk.borrow_mut().ask(client.id, id, request, Instant::now());
                if let Some(answer) = refused {
                    hub.reply(answer.client, answer.id, answer.outcome);
                }
                hub.asked.notify_one();
            }
            FromClient::Trajectory { id, touch, waypoints } => {
                let now = Instant::now();
                let refused = hub.desk.borrow_mut().ask_trajectory(client.id, id, touch, &waypoints, now);
                if let Some(answer) = refused {
                    hub.reply(answer.client, answer.id, answer.outcome);
                }
                hub.asked.notify_one();
            }
            FromClient::Calibrate(request) => hub.calibrate(client.id, request),
            FromClient::Release => hub.desk.borrow_mut().release(client.id),
        }
    }
}

/// Writes what waits for one client; ends when it says goodbye, hangs up or reads nothing for [`PATIENCE`].
async fn write_queue(mut writer: Writer, client: &Client, greeting: &[u8]) -> Result<(), NetError> {
    write(&mut writer, greeting).await?;
    loop {
        let next = client.queue.borrow_mut().pop();
        match next {
            Some(Outgoing::Batch(batch)) => write(&mut writer, &batch.frame).await?,
            Some(Outgoing::Frame(frame)) => {
                client.emptied.notify_one();
                write(&mut writer, &frame).await?;
            }
            Some(Outgoing::Status(status)) => {
                write(&mut writer, &wire::encode(&FromServer::Status(status))?).await?;
            }
            Some(Outgoing::Goodbye(frame)) => return write(&mut writer, &frame).await,
            None => client.filled.notified().await,
        }
    }
}

async fn write(writer: &mut Writer, frame: &[u8]) -> Result<(), NetError> {
    Ok(timeout(PATIENCE, writer.write_all(frame)).await.map_err(|_| NetError::Closed)??)
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

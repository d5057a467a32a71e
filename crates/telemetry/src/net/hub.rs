//! State that every task of the telemetry thread shares: the clients and their messages.

use super::{
    access::Role,
    command::{Answer, ClientId, Desk},
    ledger::Ledger,
    queue::{EncodedBatch, Queue},
    wire::{self, Batch, FromServer, unix_now_ns},
};
use crate::audit::{CONNECT, LEAVE};
use crate::calibration::{CalibrationProgress, CalibrationRequest};
use moca_msgs::{ParameterValues, Refusal, Request, Sample};
use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::Sender,
    },
    time::Instant,
};
use tokio::{sync::Notify, task::AbortHandle};

/// Notices that a new client is told.
const MAX_NOTICES: usize = 16;
/// Between a client and whom it speaks for.
const FOR: &str = ", for ";
/// Word for a calibration in the log.
pub(super) const CALIBRATE: &str = "calibrate";

/// The connections that are not served yet, oldest first.
pub(super) struct Visitors {
    pub(super) next_id: Cell<ClientId>,
    pub(super) present: RefCell<BTreeMap<ClientId, (Rc<Client>, AbortHandle)>>,
    pub(super) most: usize,
}

/// Counts of what the server has done.
#[derive(Default)]
pub(super) struct Counters {
    pub(super) clients: AtomicU64,
    pub(super) samples: AtomicU64,
    pub(super) client_dropped: AtomicU64,
    pub(super) longest_queue: AtomicU64,
}

/// State that every task of the telemetry thread shares.
pub(super) struct Hub {
    pub(super) clients: RefCell<BTreeMap<ClientId, Rc<Client>>>,
    pub(super) visitors: Visitors,
    pub(super) desk: RefCell<Desk>,
    /// Requests and answers for the log.
    pub(super) ledger: RefCell<Ledger>,
    /// Wakes the pump when a request has gone to the loop.
    pub(super) asked: Notify,
    pub(super) counters: Arc<Counters>,
    /// The robot's description as a frame.
    pub(super) welcome: Vec<u8>,
    parameters: RefCell<ToldParameters>,
    calibration: RefCell<Calibration>,
    /// Notices to all, as frames.
    notices: RefCell<Vec<Rc<Vec<u8>>>>,
}

/// The changed parameters, and the frame that tells them.
#[derive(Default)]
struct ToldParameters {
    values: BTreeMap<u8, ParameterValues>,
    frame: Option<Rc<Vec<u8>>>,
}

/// State of the calibration.
#[derive(Default)]
struct Calibration {
    requests: Option<Sender<CalibrationRequest>>,
    frame: Option<Rc<Vec<u8>>>,
}

pub(super) struct Client {
    pub(super) id: ClientId,
    pub(super) role: Role,
    /// Identity for the log.
    pub(super) who: RefCell<String>,
    pub(super) queue: RefCell<Queue>,
    /// Wakes the task that writes.
    pub(super) filled: Notify,
    /// Wakes the task that reads and waits for room.
    pub(super) emptied: Notify,
}

impl Client {
    pub(super) fn new(id: ClientId, role: Role, who: String) -> Rc<Self> {
        let (filled, emptied) = (Notify::new(), Notify::new());
        Rc::new(Self { id, role, who: RefCell::new(who), queue: RefCell::default(), filled, emptied })
    }
}

impl Client {
    /// Notes that it is not served.
    pub(super) fn turned_away(&self, hub: &Hub, reason: String) {
        hub.ledger.borrow_mut().turned_away(&self.who.borrow(), reason, Instant::now());
    }

    /// Notes the person or device that this client says it speaks for.
    pub(super) fn speak_for(&self, name: &str) {
        let mut who = self.who.borrow_mut();
        let itself = who.split(FOR).next().unwrap_or_default();
        *who = format!("{itself}{FOR}{name}");
    }
}

impl Hub {
    pub(super) fn new(
        desk: Desk,
        ledger: Ledger,
        counters: Arc<Counters>,
        welcome: Vec<u8>,
        calibrator: Option<Sender<CalibrationRequest>>,
    ) -> Rc<Self> {
        Rc::new(Self {
            clients: RefCell::default(),
            visitors: Visitors::new(),
            desk: RefCell::new(desk),
            ledger: RefCell::new(ledger),
            asked: Notify::new(),
            counters,
            welcome,
            parameters: RefCell::default(),
            calibration: RefCell::new(Calibration { requests: calibrator, frame: None }),
            notices: RefCell::default(),
        })
    }

    /// A client that is served from now on, with what it has to be told first.
    pub(super) fn admit(&self, id: ClientId, role: Role, who: String) -> Rc<Client> {
        self.ledger.borrow_mut().note(&who, CONNECT, Ok(role.name().into()), Instant::now());
        let client = Client::new(id, role, who);
        let mut queue = client.queue.borrow_mut();
        if let Some(frame) = &self.parameters.borrow().frame {
            queue.set_parameters(Rc::clone(frame));
        }
        if let Some(frame) = &self.calibration.borrow().frame {
            queue.set_calibration(Rc::clone(frame));
        }
        for frame in &*self.notices.borrow() {
            queue.push_reply(Rc::clone(frame));
        }
        drop(queue);
        self.clients.borrow_mut().insert(id, Rc::clone(&client));
        self.counters.clients.fetch_add(1, Ordering::Relaxed);
        client
    }

    /// Ends a client.
    pub(super) fn lose(&self, id: ClientId) {
        let commands = self.desk.borrow().is_commander(id);
        if let Some(client) = self.clients.borrow_mut().remove(&id) {
            let answer = if commands { "it had the command" } else { "" };
            let mut ledger = self.ledger.borrow_mut();
            ledger.note(&client.who.borrow(), LEAVE, Ok(answer.into()), Instant::now());
        }
        self.desk.borrow_mut().forget(id);
        self.counters.clients.fetch_sub(1, Ordering::Relaxed);
    }

    pub(super) fn publish(&self, samples: Vec<Sample>, ring_dropped: u64) {
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

    /// Passes a stop on to the loop: taken from anybody.
    pub(super) fn stop(&self, client: ClientId, id: u64) {
        let refused = self.desk.borrow_mut().ask(client, id, Request::Stop, Instant::now());
        if let Some(refused) = refused {
            self.reply(&refused);
        }
        self.asked.notify_one();
    }

    pub(super) fn reply(&self, answer: &Answer) {
        let Answer { id, outcome, .. } = *answer;
        let client = self.clients.borrow().get(&answer.client).cloned();
        let client = client.or_else(|| self.visitors.client(answer.client));
        let gone = "one that has left".to_owned();
        let who = client.as_ref().map_or(gone, |client| client.who.borrow().clone());
        self.ledger.borrow_mut().answered(&who, &answer.request, outcome, Instant::now());
        let (Some(client), Ok(frame)) = (client, wire::encode(&FromServer::Reply { id, outcome })) else {
            return; // It left before the answer came.
        };
        client.queue.borrow_mut().push_reply(Rc::new(frame));
        client.filled.notify_one();
    }

    pub(super) fn tell_parameters(&self) {
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

    pub(super) fn tell_calibration(&self, progress: CalibrationProgress) {
        let Ok(frame) = wire::encode(&FromServer::Calibration(progress)).map(Rc::new) else {
            return; // Some hundred residuals are far below the largest frame.
        };
        for client in self.clients.borrow().values() {
            client.queue.borrow_mut().set_calibration(Rc::clone(&frame));
            client.filled.notify_one();
        }
        self.calibration.borrow_mut().frame = Some(frame);
    }

    pub(super) fn tell_notice(&self, notice: String) {
        let Ok(frame) = wire::encode(&FromServer::Notice(notice)).map(Rc::new) else {
            return; // A line is far below the largest frame.
        };
        for client in self.clients.borrow().values() {
            client.queue.borrow_mut().push_reply(Rc::clone(&frame));
            client.filled.notify_one();
        }
        let mut notices = self.notices.borrow_mut();
        if notices.len() < MAX_NOTICES {
            notices.push(frame);
        }
    }

    pub(super) fn calibrate(&self, client: &Client, request: CalibrationRequest) {
        let answer = match &self.calibration.borrow().requests {
            None => Err("this robot has no calibrator".to_owned()),
            Some(_) if !self.desk.borrow_mut().claim(client.id, Instant::now()) => {
                Err(Refusal::NotCommander.to_string())
            }
            Some(requests) => {
                // A calibrator that has ended says nothing any more either.
                let _ = requests.send(request);
                Ok(String::new())
            }
        };
        self.ledger.borrow_mut().note(&client.who.borrow(), CALIBRATE, answer, Instant::now());
    }

    pub(super) fn deliver_answers(&self) {
        let answers = self.desk.borrow_mut().answers(Instant::now());
        self.tell_parameters();
        answers.iter().for_each(|answer| self.reply(answer));
    }
}

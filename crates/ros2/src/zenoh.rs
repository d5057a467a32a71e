//! ROS 2 over zenoh, as nodes on `rmw_zenoh` use it: a client of the base's router (`rmw_zenohd`).
//!
//! The router may come later, go and come back; what was announced is announced again. Orders are urgent and dropped rather
//! than kept when the line is full, and the router forgets a client that was silent for [`LEASE_MS`]: an order never
//! arrives long after it was given, which a robot would obey. No services, and nothing for whoever comes later.

use crate::TypeName;
use crate::rmw_zenoh::{self, GID_BYTES, NO_HASH, Node};
use crate::transport::{
    Caller, Endpoint, Qos, ReaderId, ServiceId, Transport, TransportError, WriterId, absolute,
};
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Display;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};

/// The other end gives a line up that was silent for so long, with what it still held of ours.
pub const LEASE_MS: u32 = 500;
/// A router that does not answer is tried again after this.
const RETRY: Duration = Duration::from_millis(500);
/// Payloads that a reader keeps; older ones make room.
const KEPT: usize = 32;
/// A writer that announced nothing is named for so long after its last payload.
const STRANGER_FOR: Duration = Duration::from_secs(1);
/// What we are called in the graph.
const NODE: &str = "mocad";

/// What zenoh's threads leave for ours.
#[derive(Default)]
struct Inbox {
    unread: Vec<VecDeque<Vec<u8>>>,
    endpoints: BTreeMap<String, Endpoint>,
    /// Who else wrote on a topic of ours, by writer and topic, and when last.
    others: BTreeMap<(usize, Vec<u8>), Instant>,
}

#[derive(Default)]
struct Shared {
    inbox: Mutex<Inbox>,
    came: Condvar,
}

impl Shared {
    fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A topic that is written or read.
struct Topic {
    name: String,
    of: TypeName,
    qos: Qos,
    /// Which of the readers or writers it is.
    index: usize,
    writes: bool,
}

/// The keys that one topic is written under.
#[derive(Default)]
struct Writer {
    /// With the hash, and as Humble's nodes have it: a payload that nobody wants is not sent.
    keys: Vec<Publisher<'static>>,
    gid: [u8; GID_BYTES],
    sequence: i64,
}

/// A session, and what lasts as long as it.
struct Opened {
    session: Session,
    _subscribers: Vec<Subscriber<()>>,
    _tokens: Vec<LivelinessToken>,
}

/// A client of one router, in one domain.
pub struct Zenoh {
    domain: u16,
    router: String,
    shared: Arc<Shared>,
    opening: Receiver<Session>,
    topics: Vec<Topic>,
    writers: Vec<Writer>,
    readers: usize,
    /// Or why there is none.
    opened: Result<Opened, TransportError>,
}

impl Zenoh {
    /// Joins `domain` by a router such as `tcp/192.168.0.200:7447`, as soon as it answers.
    ///
    /// # Errors
    /// A router whose address is none, or no thread to open the session from.
    pub fn join(domain: u16, router: &str) -> Result<Self, TransportError> {
        let config = client_of(router)?;
        let (opened, opening) = channel();
        // A router that is not there fails at once, one whose network is not after seconds.
        let open = move || {
            loop {
                match zenoh::open(config.clone()).wait() {
                    // Nobody waits for it any more: it closes.
                    Ok(session) => return drop(opened.send(session)),
                    Err(_) => std::thread::sleep(RETRY),
                }
            }
        };
        let thread = std::thread::Builder::new().name("zenoh-open".into()).spawn(open);
        thread.map_err(|error| TransportError(format!("no thread to open zenoh from: {error}")))?;
        Ok(Self {
            domain,
            router: router.into(),
            shared: Arc::default(),
            opening,
            topics: Vec::new(),
            writers: Vec::new(),
            readers: 0,
            opened: Err(TransportError(unanswered(router))),
        })
    }

    fn topic(&mut self, name: &str, of: TypeName, qos: Qos, writes: bool) -> Result<usize, TransportError> {
        let name = absolute(name)?.to_owned();
        if rmw_zenoh::type_hash(of).is_none() || qos == Qos::Latched {
            return Err(TransportError(format!("{name}: {} is not carried over zenoh", of.0)));
        }
        let index = if writes { self.writers.len() } else { self.readers };
        if writes {
            self.writers.push(Writer::default());
        } else {
            self.readers += 1;
            self.shared.inbox().unread.push(VecDeque::new());
        }
        self.topics.push(Topic { name, of, qos, index, writes });
        if let Ok(Opened { session, .. }) = &self.opened {
            self.opened = self.announce(session.clone());
        }
        Ok(index)
    }

    /// Announces everything on a session that has been opened.
    fn announce(&mut self, session: Session) -> Result<Opened, TransportError> {
        let zid = session.zid().to_string();
        let node = Node { domain: self.domain, session: &zid, name: NODE };
        let token = |token: String| session.liveliness().declare_token(token).wait();
        let mut tokens = vec![token(node.token()).map_err(failed)?];
        let mut subscribers = vec![self.watch(&session, zid.clone())?];
        for (id, topic) in (1..).zip(&self.topics) {
            let hash = rmw_zenoh::type_hash(topic.of).unwrap_or(NO_HASH);
            let key = |hash: &str| rmw_zenoh::data_key(self.domain, &topic.name, topic.of, hash);
            let text = node.endpoint_token(id, topic.writes, &topic.name, topic.of, hash, topic.qos);
            tokens.push(token(text).map_err(failed)?);
            let (shared, index) = (Arc::clone(&self.shared), topic.index);
            let any = session.declare_subscriber(key("*"));
            if topic.writes {
                let gid = gid(&session, &topic.name);
                let keys = [hash, NO_HASH].map(|hash| urgent(&session, key(hash)));
                let keys = keys.into_iter().collect::<Result<_, _>>()?;
                self.writers[index] = Writer { keys, gid, sequence: 0 };
                let other = any.callback(move |sample| shared.other(index, &sample, gid)).wait();
                subscribers.push(other.map_err(failed)?);
            } else {
                // Whatever its hash: the reader of the payload refuses what is none.
                let read = any.callback(move |sample| shared.payload(index, &sample)).wait();
                subscribers.push(read.map_err(failed)?);
            }
        }
        Ok(Opened { session, _subscribers: subscribers, _tokens: tokens })
    }

    /// Keeps book of who is on the domain's topics.
    fn watch(&self, session: &Session, zid: String) -> Result<Subscriber<()>, TransportError> {
        let shared = Arc::clone(&self.shared);
        let all = session.liveliness().declare_subscriber(rmw_zenoh::tokens(self.domain)).history(true);
        let watch = all.callback(move |sample| {
            let token = sample.key_expr().as_str();
            let Some(end) = rmw_zenoh::endpoint(token, &zid) else { return };
            let endpoints = &mut shared.inbox().endpoints;
            match sample.kind() {
                SampleKind::Put => endpoints.insert(token.to_owned(), end),
                SampleKind::Delete => endpoints.remove(token),
            };
        });
        watch.wait().map_err(failed)
    }
}

impl Shared {
    fn payload(&self, reader: usize, sample: &Sample) {
        let payload = sample.payload().to_bytes().into_owned();
        let unread = &mut self.inbox().unread[reader];
        if unread.len() == KEPT {
            unread.pop_front();
        }
        unread.push_back(payload);
        self.came.notify_one();
    }

    /// Somebody wrote on a topic that we write: who needs no token for that is seen by what arrives.
    fn other(&self, writer: usize, sample: &Sample, ours: [u8; GID_BYTES]) {
        let beside = sample.attachment().map(|beside| beside.to_bytes().into_owned()).unwrap_or_default();
        let gid = rmw_zenoh::writer_of(&beside);
        if gid != Some(ours) {
            let gid = gid.map(|gid| gid.to_vec()).unwrap_or_default();
            self.inbox().others.insert((writer, gid), Instant::now());
        }
    }
}

impl Transport for Zenoh {
    fn writer(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<WriterId, TransportError> {
        self.topic(topic, of, qos, true).map(WriterId)
    }

    fn reader(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<ReaderId, TransportError> {
        self.topic(topic, of, qos, false).map(ReaderId)
    }

    fn service(&mut self, name: &str, _: TypeName) -> Result<ServiceId, TransportError> {
        Err(TransportError(format!("{name}: no services over zenoh")))
    }

    fn write(&mut self, to: WriterId, payload: &[u8]) -> Result<(), TransportError> {
        if let Err(error) = &self.opened {
            return Err(error.clone());
        }
        let writer = &mut self.writers[to.0];
        writer.sequence += 1;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let unix_ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        let beside = rmw_zenoh::attachment(writer.sequence, unix_ns, writer.gid);
        for key in &writer.keys {
            key.put(payload).attachment(&beside[..]).wait().map_err(failed)?;
        }
        Ok(())
    }

    fn take(&mut self, from: ReaderId) -> Option<Vec<u8>> {
        self.shared.inbox().unread[from.0].pop_front()
    }

    fn take_call(&mut self, _: ServiceId) -> Option<(Caller, Vec<u8>)> {
        None
    }

    fn answer(&mut self, _: ServiceId, _: &Caller, _: &[u8]) -> Result<(), TransportError> {
        Err(TransportError("no services over zenoh".into()))
    }

    fn wait(&mut self, most: Duration) {
        if let Ok(session) = self.opening.try_recv() {
            self.opened = self.announce(session);
        }
        let inbox = self.shared.inbox();
        if inbox.unread.iter().all(VecDeque::is_empty) {
            // Whoever looks too early looks again.
            drop(self.shared.came.wait_timeout(inbox, most));
        }
    }

    fn problem(&self) -> Option<String> {
        match &self.opened {
            Err(error) => Some(error.to_string()),
            Ok(opened) => {
                let answers = opened.session.info().routers_zid().wait().next().is_some();
                (!answers).then(|| unanswered(&self.router))
            }
        }
    }

    fn endpoints(&self) -> Vec<Endpoint> {
        let mut inbox = self.shared.inbox();
        inbox.others.retain(|_, last| last.elapsed() < STRANGER_FOR);
        let mut endpoints: Vec<Endpoint> = inbox.endpoints.values().cloned().collect();
        for topic in self.topics.iter().filter(|topic| topic.writes) {
            // Which of the announced writers a number is cannot be told.
            if endpoints.iter().any(|end| end.writes && end.topic == topic.name) {
                continue;
            }
            let others = inbox.others.keys().filter(|(writer, _)| *writer == topic.index);
            endpoints.extend(others.map(|(_, gid)| stranger(topic, gid)));
        }
        endpoints
    }
}

/// Somebody who writes on `topic` and is no node.
fn stranger(topic: &Topic, gid: &[u8]) -> Endpoint {
    let number: String = gid.iter().map(|byte| format!("{byte:02x}")).collect();
    let who =
        format!("a zenoh client that is no node ({})", if gid.is_empty() { "no number" } else { &number });
    Endpoint { topic: topic.name.clone(), type_dds: topic.of.dds(), writes: true, who }
}

/// Nothing is kept for a line that is full, and nothing waits for others to be sent along.
fn urgent(session: &Session, key: String) -> Result<Publisher<'static>, TransportError> {
    let publisher = session.declare_publisher(key).congestion_control(CongestionControl::Drop);
    publisher.priority(Priority::RealTime).express(true).wait().map_err(failed)
}

/// A number for a writer that no other has: its session's, and its topic's name.
fn gid(session: &Session, topic: &str) -> [u8; GID_BYTES] {
    let mut gid = session.zid().to_le_bytes();
    gid.iter_mut().zip(topic.bytes().cycle()).for_each(|(byte, of_name)| *byte ^= of_name);
    gid
}

/// A client: a peer whose router is of today hears nothing of others, and nobody says so.
fn client_of(router: &str) -> Result<Config, TransportError> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", &format!("[{router:?}]")),
        ("connect/retry", "{ period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 2 }"),
        ("scouting/multicast/enabled", "false"),
        ("transport/link/tx/lease", &LEASE_MS.to_string()),
    ] {
        config
            .insert_json5(key, value)
            .map_err(|error| TransportError(format!("zenoh, {key} = {value}: {error}")))?;
    }
    Ok(config)
}

fn unanswered(router: &str) -> String {
    format!("no zenoh router answers at {router}: rmw_zenohd is off, or elsewhere")
}

fn failed(error: impl Display) -> TransportError {
    TransportError(format!("zenoh: {error}"))
}

//! ROS 2 over zenoh, as nodes on `rmw_zenoh` use it: a client of the base's router (`rmw_zenohd`).
//!
//! The router may come later, go and come back; what was announced is announced again. Orders are urgent and dropped rather
//! than kept when the line is full, and the router forgets a client that was silent for [`LEASE_MS`]: an order never
//! arrives long after it was given, which a robot would obey. Whoever comes later is told the last of what is
//! [`Qos::Latched`] by writing it again; there is no store that others could ask.

use crate::messages::{Twist, TwistStamped};
use crate::rmw_zenoh::{self, GID_BYTES, Kind, NO_HASH, Node};
use crate::transport::{
    Caller, Endpoint, Qos, ReaderId, ServiceId, Transport, TransportError, WriterId, absolute, unix_ns,
};
use crate::{Message, TypeName};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt::Display;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};

/// The other end gives a line up that was silent for so long, with what it still held of ours.
pub const LEASE_MS: u32 = 500;
/// A router that does not answer is tried again after this.
const RETRY: Duration = Duration::from_millis(500);
/// Payloads that a reader keeps, and calls that wait for an answer; older ones make room.
const KEPT: usize = 32;
/// A reader that has announced itself hears us after this: some announce themselves before they listen.
const LISTENS_AFTER: Duration = Duration::from_millis(500);
/// A writer that announced nothing is named for so long after its last payload.
const STRANGER_FOR: Duration = Duration::from_secs(1);

/// Messages that zenoh's threads leave for ours.
#[derive(Default)]
struct Inbox {
    unread: Vec<VecDeque<Written>>,
    calls: Vec<VecDeque<Query>>,
    /// By their tokens.
    endpoints: BTreeMap<String, Endpoint>,
    /// Topics that somebody has come to, and when.
    newcomers: Vec<(String, Instant)>,
    /// Other writers on our topics, by writer and topic, with the time of their last message.
    others: BTreeMap<(usize, Vec<u8>), Instant>,
}

/// A payload, and the number of who wrote it; empty without one.
struct Written {
    gid: Vec<u8>,
    payload: Vec<u8>,
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

/// A topic that is written or read, or a service.
#[derive(Clone)]
struct Topic {
    name: String,
    of: TypeName,
    qos: Qos,
    /// Which of its kind it is.
    index: usize,
    kind: Kind,
}

/// The keys that one topic is written under.
#[derive(Default)]
struct Writer {
    /// With the hash, and as Humble's nodes have it: a payload that nobody wants is not sent.
    keys: Vec<Publisher<'static>>,
    gid: [u8; GID_BYTES],
    sequence: i64,
    /// The last payload, empty before there is one, if they are [`Qos::Latched`].
    latched: Option<Vec<u8>>,
}

/// Handles that live as long as a topic is announced.
struct Announced {
    _token: LivelinessToken,
    _subscriber: Option<Subscriber<()>>,
    _queryable: Option<Queryable<()>>,
}

/// A session, and what lasts as long as it.
struct Opened {
    session: Session,
    zid: String,
    _token: LivelinessToken,
    _watch: Subscriber<()>,
    announced: Vec<Announced>,
}

/// A client of one router, in one domain.
pub struct Zenoh {
    domain: u16,
    router: String,
    node: &'static str,
    shared: Arc<Shared>,
    opening: Receiver<Session>,
    topics: Vec<Topic>,
    writers: Vec<Writer>,
    /// Calls that wait for an answer, by their number, and how many there were.
    called: BTreeMap<u64, Query>,
    calls: u64,
    /// Or why there is none.
    opened: Result<Opened, TransportError>,
}

impl Zenoh {
    /// Joins `domain` as `node` by a router such as `tcp/192.168.0.200:7447`, as soon as it answers.
    ///
    /// # Errors
    /// A router whose address is none, or no thread to open the session from.
    pub fn join(domain: u16, router: &str, node: &'static str) -> Result<Self, TransportError> {
        let config = client_of(router)?;
        let (opened, opening) = channel();
        let shared = Arc::<Shared>::default();
        let waited_for = Arc::downgrade(&shared);
        // A router that is not there fails at once, one whose network is not after seconds.
        let open = move || {
            while waited_for.strong_count() > 0 {
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
            node,
            shared,
            opening,
            topics: Vec::new(),
            writers: Vec::new(),
            called: BTreeMap::new(),
            calls: 0,
            opened: Err(TransportError(unanswered(router))),
        })
    }

    fn topic(&mut self, name: &str, of: TypeName, qos: Qos, kind: Kind) -> Result<usize, TransportError> {
        let name = absolute(name)?.to_owned();
        if rmw_zenoh::type_hash(of).is_none() {
            return Err(TransportError(format!("{name}: {} is not carried over zenoh", of.0)));
        }
        let index = self.topics.iter().filter(|topic| topic.kind == kind).count();
        match kind {
            Kind::Writer => {
                let latched = (qos == Qos::Latched).then(Vec::new);
                self.writers.push(Writer { latched, ..Writer::default() });
            }
            Kind::Reader => self.shared.inbox().unread.push(VecDeque::new()),
            Kind::Service => self.shared.inbox().calls.push(VecDeque::new()),
        }
        let topic = Topic { name, of, qos, index, kind };
        self.topics.push(topic.clone());
        if let Ok(Opened { session, zid, .. }) = &self.opened {
            let (session, zid) = (session.clone(), zid.clone());
            let announced = self.announce(&session, &zid, self.topics.len(), &topic)?;
            if let Ok(opened) = &mut self.opened {
                opened.announced.push(announced);
            }
        }
        Ok(index)
    }

    /// Announces everything on a session that has been opened.
    fn begin(&mut self, session: Session) -> Result<Opened, TransportError> {
        let zid = session.zid().to_string();
        let node = Node { domain: self.domain, session: &zid, name: self.node };
        let token = session.liveliness().declare_token(node.token()).wait().map_err(failed)?;
        let watch = self.watch(&session, zid.clone())?;
        let mut announced = Vec::new();
        for (id, topic) in (1..).zip(self.topics.clone()) {
            announced.push(self.announce(&session, &zid, id, &topic)?);
        }
        Ok(Opened { session, zid, _token: token, _watch: watch, announced })
    }

    /// Announces one topic; by its token others know that it is served already.
    fn announce(
        &mut self,
        session: &Session,
        zid: &str,
        id: usize,
        topic: &Topic,
    ) -> Result<Announced, TransportError> {
        let Topic { name, of, index, kind, .. } = topic;
        let (index, hash) = (*index, rmw_zenoh::type_hash(*of).unwrap_or(NO_HASH));
        let node = Node { domain: self.domain, session: zid, name: self.node };
        let token = node.endpoint_token(id, *kind, name, *of, hash, topic.qos);
        let key = |hash: &str| rmw_zenoh::data_key(self.domain, name, *of, hash);
        let shared = Arc::clone(&self.shared);
        // Whatever its hash: the reader of the payload refuses what is none.
        let any = session.declare_subscriber(key("*"));
        let (mut subscriber, mut queryable) = (None, None);
        match kind {
            Kind::Writer => {
                let gid = rmw_zenoh::gid(&token);
                let keys = [hash, NO_HASH].map(|hash| publisher(session, key(hash), *of));
                let writer = &mut self.writers[index];
                writer.keys = keys.into_iter().collect::<Result<_, _>>()?;
                (writer.gid, writer.sequence) = (gid, 0);
                let other = any.callback(move |sample| shared.other(index, &sample, gid));
                subscriber = Some(other.wait().map_err(failed)?);
                self.shared.inbox().newcomers.push((name.clone(), Instant::now()));
            }
            Kind::Reader => {
                let read = any.callback(move |sample| shared.payload(index, &sample));
                subscriber = Some(read.wait().map_err(failed)?);
            }
            Kind::Service => {
                let calls = session.declare_queryable(key("*")).complete(true);
                let taken = calls.callback(move |query| shared.call(index, query));
                queryable = Some(taken.wait().map_err(failed)?);
            }
        }
        let token = session.liveliness().declare_token(token).wait().map_err(failed)?;
        Ok(Announced { _token: token, _subscriber: subscriber, _queryable: queryable })
    }

    /// Tells whoever has come what is latched; nothing else is told again.
    fn welcome(&mut self) {
        if self.opened.is_err() {
            return;
        }
        let listens = |(_, came): &mut (String, Instant)| came.elapsed() > LISTENS_AFTER;
        let topics: BTreeSet<_> =
            self.shared.inbox().newcomers.extract_if(.., listens).map(|(topic, _)| topic).collect();
        let written = self.topics.iter().filter(|topic| topic.kind == Kind::Writer);
        for topic in written.filter(|topic| topics.contains(&topic.name)) {
            let writer = &mut self.writers[topic.index];
            if let Some(payload) = writer.latched.clone().filter(|payload| !payload.is_empty()) {
                // What the line does not take now, the next one to come brings.
                let _ = writer.put(&payload);
            }
        }
    }

    /// Keeps book of who is on the domain's topics.
    fn watch(&self, session: &Session, zid: String) -> Result<Subscriber<()>, TransportError> {
        let shared = Arc::clone(&self.shared);
        let all = session.liveliness().declare_subscriber(rmw_zenoh::tokens(self.domain)).history(true);
        let watch = all.callback(move |sample| {
            let token = sample.key_expr().as_str();
            let Some(end) = rmw_zenoh::endpoint(token, &zid) else { return };
            let mut inbox = shared.inbox();
            match sample.kind() {
                SampleKind::Put => {
                    if !end.writes {
                        inbox.newcomers.push((end.topic.clone(), Instant::now()));
                    }
                    inbox.endpoints.insert(token.to_owned(), end);
                }
                SampleKind::Delete => drop(inbox.endpoints.remove(token)),
            }
        });
        watch.wait().map_err(failed)
    }
}

impl Shared {
    fn payload(&self, reader: usize, sample: &Sample) {
        let gid = writer_of(sample);
        let payload = sample.payload().to_bytes().into_owned();
        keep(&mut self.inbox().unread[reader], Written { gid, payload });
        self.came.notify_one();
    }

    fn call(&self, service: usize, query: Query) {
        keep(&mut self.inbox().calls[service], query);
        self.came.notify_one();
    }

    /// Somebody wrote on a topic that we write: who needs no token for that is seen by what arrives.
    fn other(&self, writer: usize, sample: &Sample, ours: [u8; GID_BYTES]) {
        let gid = writer_of(sample);
        if gid != ours {
            self.inbox().others.insert((writer, gid), Instant::now());
        }
    }
}

/// Adds the newest; the oldest makes room.
fn keep<T>(queue: &mut VecDeque<T>, newest: T) {
    if queue.len() == KEPT {
        queue.pop_front();
    }
    queue.push_back(newest);
}

/// The number of who wrote a sample; empty without one.
fn writer_of(sample: &Sample) -> Vec<u8> {
    let beside = sample.attachment().map(|beside| beside.to_bytes().into_owned()).unwrap_or_default();
    rmw_zenoh::writer_of(&beside).map(|gid| gid.to_vec()).unwrap_or_default()
}

/// Returns the node that wrote on `topic` under the number `gid`: the session whose token has that number. Where numbers are
/// not made of tokens it is the only writer there, or else the node with that number.
fn author(endpoints: &BTreeMap<String, Endpoint>, topic: &str, gid: &[u8]) -> Vec<u8> {
    let mut sessions = BTreeSet::new();
    for (token, _) in endpoints.iter().filter(|(_, end)| end.writes && end.topic == topic) {
        let session = rmw_zenoh::session_of(token);
        if rmw_zenoh::gid(token) == gid {
            return session.into();
        }
        sessions.insert(session);
    }
    match sessions.pop_first() {
        Some(only) if sessions.is_empty() => only.into(),
        _ => gid.to_vec(),
    }
}

impl Writer {
    fn put(&mut self, payload: &[u8]) -> Result<(), TransportError> {
        self.sequence += 1;
        let beside = rmw_zenoh::attachment(self.sequence, unix_ns(), self.gid);
        for key in &self.keys {
            key.put(payload).attachment(&beside[..]).wait().map_err(failed)?;
        }
        Ok(())
    }
}

impl Transport for Zenoh {
    fn writer(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<WriterId, TransportError> {
        self.topic(topic, of, qos, Kind::Writer).map(WriterId)
    }

    fn reader(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<ReaderId, TransportError> {
        self.topic(topic, of, qos, Kind::Reader).map(ReaderId)
    }

    fn service(&mut self, name: &str, of: TypeName) -> Result<ServiceId, TransportError> {
        self.topic(name, of, Qos::Reliable, Kind::Service).map(ServiceId)
    }

    fn write(&mut self, to: WriterId, payload: &[u8]) -> Result<(), TransportError> {
        let writer = &mut self.writers[to.0];
        if let Some(last) = &mut writer.latched {
            *last = payload.to_vec();
        }
        match &self.opened {
            Ok(_) => writer.put(payload),
            Err(error) => Err(error.clone()),
        }
    }

    fn take(&mut self, from: ReaderId) -> Option<Vec<u8>> {
        self.shared.inbox().unread[from.0].pop_front().map(|written| written.payload)
    }

    fn take_from_node(&mut self, from: ReaderId) -> Option<(Vec<u8>, Vec<u8>)> {
        let mut inbox = self.shared.inbox();
        let Written { gid, payload } = inbox.unread[from.0].pop_front()?;
        let read = |topic: &&Topic| (topic.kind, topic.index) == (Kind::Reader, from.0);
        let topic = self.topics.iter().find(read)?;
        Some((author(&inbox.endpoints, &topic.name, &gid), payload))
    }

    fn take_call(&mut self, of: ServiceId) -> Option<(Caller, Vec<u8>)> {
        let query = self.shared.inbox().calls[of.0].pop_front()?;
        let payload = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        self.calls += 1;
        if self.called.len() == KEPT {
            // Whoever called is told that there is no answer.
            self.called.pop_first();
        }
        self.called.insert(self.calls, query);
        Some((Caller(self.calls.to_le_bytes().into()), payload))
    }

    fn answer(&mut self, _: ServiceId, caller: &Caller, payload: &[u8]) -> Result<(), TransportError> {
        let number = caller.0.as_slice().try_into().map(u64::from_le_bytes);
        let query = number.ok().and_then(|number| self.called.remove(&number));
        let query = query.ok_or_else(|| TransportError("zenoh: an answer to nobody".into()))?;
        let beside =
            query.attachment().and_then(|beside| rmw_zenoh::answer_to(&beside.to_bytes(), unix_ns()));
        let answer = query.reply(query.key_expr().clone(), payload);
        answer.attachment(beside.map(Vec::from)).wait().map_err(failed)
    }

    fn wait(&mut self, most: Duration) {
        if let Ok(session) = self.opening.try_recv() {
            self.opened = self.begin(session);
        }
        self.welcome();
        let inbox = self.shared.inbox();
        if inbox.unread.iter().all(VecDeque::is_empty) && inbox.calls.iter().all(VecDeque::is_empty) {
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
        for topic in self.topics.iter().filter(|topic| topic.kind == Kind::Writer) {
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

/// Nothing is kept for a line that is full; an order waits for nothing else to be sent along.
fn publisher(session: &Session, key: String, of: TypeName) -> Result<Publisher<'static>, TransportError> {
    let publisher = session.declare_publisher(key).congestion_control(CongestionControl::Drop);
    let publisher = if matches!(of, Twist::TYPE | TwistStamped::TYPE) {
        publisher.priority(Priority::RealTime).express(true)
    } else {
        publisher
    };
    publisher.wait().map_err(failed)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn opening_threads() -> usize {
        let names = std::fs::read_dir("/proc/self/task").unwrap().flatten();
        let names = names.filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok());
        names.filter(|name| name.trim() == "zenoh-open").count()
    }

    #[test]
    fn cancelled_router_wait_leaves_no_thread() {
        // A port that nobody listens on.
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let waits = Zenoh::join(0, &format!("tcp/127.0.0.1:{port}"), "mocad").unwrap();
        while opening_threads() == 0 {
            std::thread::yield_now();
        }
        drop(waits);
        while opening_threads() > 0 {
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    #[test]
    fn writer_is_known_by_number_or_as_only_one() {
        let node = |session| Node { domain: 7, session, name: "planner" };
        let token = |session, id, topic: &str| {
            node(session).endpoint_token(id, Kind::Writer, topic, Twist::TYPE, NO_HASH, Qos::Reliable)
        };
        let mut endpoints = BTreeMap::new();
        let mut announce = |token: &str| {
            endpoints.insert(token.to_owned(), rmw_zenoh::endpoint(token, "us").unwrap());
            endpoints.clone()
        };
        let (a, b) = (token("a1", 1, "/cmd_vel"), token("b2", 1, "/cmd_vel"));
        let nobody = announce(&token("c3", 2, "/elsewhere"));
        assert_eq!(author(&nobody, "/cmd_vel", &[1; 16]), [1; 16], "a stranger is its number");
        let alone = announce(&a);
        assert_eq!(author(&alone, "/cmd_vel", &[1; 16]), b"a1", "its number is no token's");
        let both = announce(&b);
        assert_eq!(author(&both, "/cmd_vel", &rmw_zenoh::gid(&a)), b"a1");
        assert_eq!(author(&both, "/cmd_vel", &rmw_zenoh::gid(&b)), b"b2");
        assert_eq!(author(&both, "/cmd_vel", &[1; 16]), [1; 16], "one of two, and nobody knows which");
    }
}

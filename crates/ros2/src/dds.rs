//! DDS as ROS 2 uses it: topics are `rt/…`, services `rq/…Request` and `rr/…Reply`, payloads are ours.
//!
//! A call says who calls in one of two ways, by the caller's ROS middleware: beside the payload (Fast DDS) or in its first
//! 16 bytes (Cyclone DDS). A call of a service without arguments tells by its length which; the answer goes back the same
//! way.
//!
//! The threads of `rustdds` end, without a word, when a signal interrupts them while they wait: after SIGSTOP and SIGCONT, a
//! debugger, a computer that was suspended. Nothing is heard from then on. This is noticed by what they leave behind, and
//! the domain is joined anew under the same ids.

use crate::TypeName;
use crate::transport::{
    Caller, Endpoint, Qos, ReaderId, ServiceId, Transport, TransportError, WriterId, absolute,
};
use bytes::Bytes;
use rustdds::no_key::{
    DataReader, DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter,
};
use rustdds::policy::{Durability, History, Reliability};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, Publisher, QosPolicies, QosPolicyBuilder, RTPSEntity,
    RepresentationIdentifier, SampleIdentity, SequenceNumber, Subscriber, Topic, TopicKind,
    WriteOptionsBuilder, mio1 as mio,
};
use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::fmt::Display;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// Bytes that Cyclone DDS puts before a call's arguments: the caller, and its number of the call.
const CALL_HEADER_BYTES: usize = 16;
/// The first bytes of an endpoint's number are those of its process.
const PARTICIPANT_BYTES: usize = 12;
/// The byte order before every payload.
const ENCODING_BYTES: usize = 4;
/// Longest call that carries no header: a byte order, an empty request and what fills it up to a word.
const BARE_CALL_BYTES: usize = ENCODING_BYTES + 4;
/// Longest time for which a reliable writer keeps a message that nobody confirms.
const RELIABLE_FOR: rustdds::Duration = rustdds::Duration::from_millis(100);
/// Period at which discovery is checked, and shortest time between two attempts to join a lost domain.
const LOOK_AFTER: Duration = Duration::from_secs(1);

/// A payload as it is, byte order first.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Payload(Vec<u8>);

/// Hands payloads through: the messages are written and read by [`crate::cdr`].
#[derive(Clone)]
struct AsItIs;

impl SerializerAdapter<Payload> for AsItIs {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Payload) -> Result<Bytes, Self::Error> {
        Ok(Bytes::copy_from_slice(value.0.get(ENCODING_BYTES..).unwrap_or_default()))
    }
}

impl DeserializerAdapter<Payload> for AsItIs {
    type Decoded = Payload;
    type Error = Infallible;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: Payload) -> Payload {
        decoded
    }
}

impl Decode<'_, Payload> for AsItIs {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], encoding: RepresentationIdentifier) -> Result<Payload, Infallible> {
        let little_endian = u8::from(encoding == RepresentationIdentifier::CDR_LE);
        Ok(Payload([&[0, little_endian, 0, 0], bytes].concat()))
    }
}

impl DefaultDecoder<Payload> for AsItIs {
    type Decoder = Self;
    const DECODER: Self = Self;
}

type Writer = DataWriter<Payload, AsItIs>;
type Reader = DataReader<Payload, AsItIs>;

/// Announced writer or reader, announced again in a new participant.
#[derive(Clone)]
enum Announced {
    Writer(String, TypeName, Qos),
    Reader(String, TypeName, Qos),
    Service(String, TypeName),
}

/// A participant of one domain.
pub struct Dds {
    domain: u16,
    interfaces: Vec<IpAddr>,
    announced: Vec<Announced>,
    /// The last payload of each writer that is [`Qos::Latched`].
    latched: BTreeMap<usize, Vec<u8>>,
    /// True if a thread of the participant has ended, and the time at which discovery was checked last.
    ended: bool,
    looked: Instant,
    tried: Option<Instant>,
    rejoined: u64,
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    writers: Vec<Writer>,
    readers: Vec<Reader>,
    services: Vec<(Reader, Writer)>,
    ours: BTreeSet<GUID>,
    poll: mio::Poll,
    events: mio::Events,
}

impl Dds {
    /// Joins `domain`, on the interfaces with these addresses only if there are any. Discovery is by multicast: name the
    /// base's interface, so that none of it shares the arm's cable.
    ///
    /// # Errors
    /// No socket, or no interface with that address.
    pub fn join(domain: u16, interfaces: &[IpAddr]) -> Result<Self, TransportError> {
        let builder = DomainParticipantBuilder::new(domain);
        let builder = if interfaces.is_empty() {
            builder
        } else {
            builder.with_only_networks(interfaces.iter().copied())
        };
        let participant = builder.build().map_err(|error| failed("DDS", &error))?;
        let qos = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&qos).map_err(|error| failed("DDS", &error))?;
        let subscriber = participant.create_subscriber(&qos).map_err(|error| failed("DDS", &error))?;
        Ok(Self {
            domain,
            interfaces: interfaces.to_vec(),
            announced: Vec::new(),
            latched: BTreeMap::new(),
            ended: false,
            looked: Instant::now(),
            tried: None,
            rejoined: 0,
            participant,
            publisher,
            subscriber,
            writers: Vec::new(),
            readers: Vec::new(),
            services: Vec::new(),
            ours: BTreeSet::new(),
            poll: mio::Poll::new().map_err(|error| failed("DDS", &error))?,
            events: mio::Events::with_capacity(32),
        })
    }

    /// Returns true if a thread of the participant has ended. The receiving thread holds the other end of each reader's
    /// socket, the discovery thread that of its commands.
    fn has_ended(&mut self) -> bool {
        self.ended |= self.events.iter().any(mio::event::Event::is_read_closed);
        if !self.ended && self.looked.elapsed() > LOOK_AFTER {
            self.looked = Instant::now();
            // A command that changes nothing here: no writer of ours is alive by its participant's word.
            self.ended = self.participant.assert_liveliness().is_err();
        }
        self.ended
    }

    /// Another participant in place of this one, with the same readers, writers and services.
    fn rejoin(&mut self) -> Result<(), TransportError> {
        let mut anew = Self::join(self.domain, &self.interfaces)?;
        for announced in self.announced.clone() {
            match announced {
                Announced::Writer(topic, of, qos) => drop(anew.writer(&topic, of, qos)?),
                Announced::Reader(topic, of, qos) => drop(anew.reader(&topic, of, qos)?),
                Announced::Service(name, of) => drop(anew.service(&name, of)?),
            }
        }
        for (writer, payload) in self.latched.iter().filter(|(_, payload)| !payload.is_empty()) {
            anew.write(WriterId(*writer), payload)?;
        }
        // Others believe in the old one for a while; it is no stranger.
        anew.ours.append(&mut self.ours);
        anew.rejoined = self.rejoined + 1;
        *self = anew;
        Ok(())
    }

    fn topic(&self, name: &str, type_dds: String, qos: &QosPolicies) -> Result<Topic, TransportError> {
        let topic = self.participant.create_topic(name.to_owned(), type_dds, qos, TopicKind::NoKey);
        topic.map_err(|error| failed(name, &error))
    }

    fn write_to(
        &mut self,
        name: &str,
        type_dds: String,
        qos: &QosPolicies,
    ) -> Result<Writer, TransportError> {
        let topic = self.topic(name, type_dds, qos)?;
        let writer = self.publisher.create_datawriter_no_key(&topic, None);
        let writer: Writer = writer.map_err(|error| failed(name, &error))?;
        self.ours.insert(writer.guid());
        Ok(writer)
    }

    fn read_from(
        &mut self,
        name: &str,
        type_dds: String,
        qos: &QosPolicies,
    ) -> Result<Reader, TransportError> {
        let topic = self.topic(name, type_dds, qos)?;
        let reader = self.subscriber.create_datareader_no_key(&topic, None);
        let mut reader: Reader = reader.map_err(|error| failed(name, &error))?;
        self.ours.insert(reader.guid());
        let token = mio::Token(self.readers.len() + self.services.len());
        let registered = self.poll.registry().register(&mut reader, token, mio::Interest::READABLE);
        registered.map_err(|error| failed(name, &error))?;
        Ok(reader)
    }
}

impl Transport for Dds {
    fn writer(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<WriterId, TransportError> {
        let writer = self.write_to(&format!("rt{}", absolute(topic)?), of.dds(), &policies(qos))?;
        if qos == Qos::Latched {
            self.latched.insert(self.writers.len(), Vec::new());
        }
        self.writers.push(writer);
        self.announced.push(Announced::Writer(topic.into(), of, qos));
        Ok(WriterId(self.writers.len() - 1))
    }

    fn reader(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<ReaderId, TransportError> {
        let reader = self.read_from(&format!("rt{}", absolute(topic)?), of.dds(), &policies(qos))?;
        self.readers.push(reader);
        self.announced.push(Announced::Reader(topic.into(), of, qos));
        Ok(ReaderId(self.readers.len() - 1))
    }

    fn service(&mut self, name: &str, of: TypeName) -> Result<ServiceId, TransportError> {
        let (name, kept) = (absolute(name)?, service_policies());
        let half =
            |which: &str| of.dds().strip_suffix('_').map(|of| format!("{of}_{which}_")).unwrap_or_default();
        let calls = self.read_from(&format!("rq{name}Request"), half("Request"), &kept)?;
        let answers = self.write_to(&format!("rr{name}Reply"), half("Response"), &kept)?;
        self.services.push((calls, answers));
        self.announced.push(Announced::Service(name.into(), of));
        Ok(ServiceId(self.services.len() - 1))
    }

    fn write(&mut self, to: WriterId, payload: &[u8]) -> Result<(), TransportError> {
        if let Some(last) = self.latched.get_mut(&to.0) {
            *last = payload.to_vec();
        }
        if let Some(problem) = self.problem() {
            return Err(TransportError(problem));
        }
        let written = self.writers[to.0].write(Payload(payload.to_vec()), None);
        written.map_err(|error| TransportError(format!("DDS: {error}")))
    }

    fn take(&mut self, from: ReaderId) -> Option<Vec<u8>> {
        // What cannot be taken is as good as not there; who waits for it sees its age.
        self.readers[from.0].take_next_sample().ok()?.map(|sample| sample.into_value().0)
    }

    fn take_from_node(&mut self, from: ReaderId) -> Option<(Vec<u8>, Vec<u8>)> {
        let sample = self.readers[from.0].take_next_sample().ok()??;
        let writer = sample.sample_info().sample_identity().writer_guid.to_bytes();
        Some((writer[..PARTICIPANT_BYTES].to_vec(), sample.into_value().0))
    }

    fn take_call(&mut self, of: ServiceId) -> Option<(Caller, Vec<u8>)> {
        let (calls, _) = self.services.get_mut(of.0)?;
        let sample = calls.take_next_sample().ok()??;
        let identity = sample.sample_info().sample_identity();
        let mut caller = identity.writer_guid.to_bytes().to_vec();
        caller.extend(i64::from(identity.sequence_number).to_le_bytes());
        let payload = sample.into_value().0;
        if payload.len() <= BARE_CALL_BYTES {
            return Some((Caller(caller), payload));
        }
        let (encoding, rest) = payload.split_first_chunk::<ENCODING_BYTES>()?;
        let (header, arguments) = rest.split_first_chunk::<CALL_HEADER_BYTES>()?;
        // What a big-endian caller put there would have to be turned round; none of today's is.
        caller.extend(header);
        Some((Caller(caller), [&encoding[..], arguments].concat()))
    }

    fn answer(&mut self, of: ServiceId, caller: &Caller, payload: &[u8]) -> Result<(), TransportError> {
        let unknown = || TransportError("DDS: an answer to nobody".into());
        let (guid, rest) = caller.0.split_first_chunk::<16>().ok_or_else(unknown)?;
        let (number, header) = rest.split_first_chunk::<8>().ok_or_else(unknown)?;
        let related = SampleIdentity {
            writer_guid: GUID::from_bytes(*guid),
            sequence_number: SequenceNumber::from(i64::from_le_bytes(*number)),
        };
        let (encoding, body) = payload.split_at_checked(ENCODING_BYTES).ok_or_else(unknown)?;
        let whole = Payload([encoding, header, body].concat());
        let options = WriteOptionsBuilder::new().related_sample_identity(related).build();
        let written = self.services[of.0].1.write_with_options(whole, options);
        written.map(|_| ()).map_err(|error| TransportError(format!("DDS: {error}")))
    }

    fn wait(&mut self, most: Duration) {
        if self.has_ended() && self.tried.is_none_or(|tried| tried.elapsed() > LOOK_AFTER) {
            self.tried = Some(Instant::now());
            // A network that is not back yet is tried again.
            if self.rejoin().is_ok() {
                return;
            }
        }
        if self.poll.poll(&mut self.events, Some(most)).is_err() {
            std::thread::sleep(most);
        }
    }

    fn problem(&self) -> Option<String> {
        self.ended
            .then(|| format!("DDS has ended and domain {} cannot be joined anew: no network", self.domain))
    }

    fn rejoined(&self) -> u64 {
        self.rejoined
    }

    fn endpoints(&self) -> Vec<Endpoint> {
        let end = |guid: GUID, name: &str, type_dds: &str, writes: bool| {
            let topic = name.strip_prefix("rt").filter(|_| !self.ours.contains(&guid))?.to_owned();
            Some(Endpoint { topic, type_dds: type_dds.to_owned(), writes, who: named(guid) })
        };
        let writers = self.participant.discovered_writers().into_iter().filter_map(|writer| {
            let data = writer.publication_topic_data;
            end(data.key, &data.topic_name, &data.type_name, true)
        });
        let readers = self.participant.discovered_readers().into_iter().filter_map(|reader| {
            let data = reader.subscription_topic_data;
            end(data.key(), &data.topic_name, data.type_name(), false)
        });
        writers.chain(readers).collect()
    }
}

/// `ros2 topic info --verbose` shows the same number beside the node's name.
fn named(guid: GUID) -> String {
    let bytes: Vec<String> = guid.to_bytes().iter().map(|byte| format!("{byte:02x}")).collect();
    format!("DDS endpoint {}", bytes.join("."))
}

fn policies(qos: Qos) -> QosPolicies {
    let builder = QosPolicyBuilder::new().history(History::KeepLast { depth: 1 });
    match qos {
        Qos::BestEffort => builder.reliability(Reliability::BestEffort).durability(Durability::Volatile),
        Qos::Reliable => builder.reliability(reliable()).durability(Durability::Volatile),
        Qos::Latched => builder.reliability(reliable()).durability(Durability::TransientLocal),
    }
    .build()
}

fn service_policies() -> QosPolicies {
    QosPolicyBuilder::new()
        .history(History::KeepLast { depth: 10 })
        .reliability(reliable())
        .durability(Durability::Volatile)
        .build()
}

const fn reliable() -> Reliability {
    Reliability::Reliable { max_blocking_time: RELIABLE_FOR }
}

fn failed(what: &str, error: &impl Display) -> TransportError {
    TransportError(format!("{what}: {error}"))
}

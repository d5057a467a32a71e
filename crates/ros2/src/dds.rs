//! DDS as ROS 2 uses it: topics are `rt/…`, services `rq/…Request` and `rr/…Reply`, payloads are ours.
//!
//! A call says who calls in one of two ways, by the caller's ROS middleware: beside the payload (Fast DDS) or in its first
//! 16 bytes (Cyclone DDS). A call of a service without arguments tells by its length which; the answer goes back the same
//! way.

use crate::TypeName;
use crate::transport::{Caller, Endpoint, Qos, ReaderId, ServiceId, Transport, TransportError, WriterId};
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
use std::collections::BTreeSet;
use std::convert::Infallible;
use std::fmt::Display;
use std::net::IpAddr;
use std::time::Duration;

/// What Cyclone DDS puts before a call's arguments: the caller, and its number of the call.
const CALL_HEADER_BYTES: usize = 16;
/// The first bytes of an endpoint's number are those of its process.
const PARTICIPANT_BYTES: usize = 12;
/// The byte order before every payload.
const ENCODING_BYTES: usize = 4;
/// Longest call that carries no header: a byte order, an empty request and what fills it up to a word.
const BARE_CALL_BYTES: usize = ENCODING_BYTES + 4;
/// How long a reliable writer may keep a message that nobody confirms.
const RELIABLE_FOR: rustdds::Duration = rustdds::Duration::from_millis(100);

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

/// A participant of one domain.
pub struct Dds {
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
        self.writers.push(writer);
        Ok(WriterId(self.writers.len() - 1))
    }

    fn reader(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<ReaderId, TransportError> {
        let reader = self.read_from(&format!("rt{}", absolute(topic)?), of.dds(), &policies(qos))?;
        self.readers.push(reader);
        Ok(ReaderId(self.readers.len() - 1))
    }

    fn service(&mut self, name: &str, of: TypeName) -> Result<ServiceId, TransportError> {
        let (name, kept) = (absolute(name)?, service_policies());
        let half =
            |which: &str| of.dds().strip_suffix('_').map(|of| format!("{of}_{which}_")).unwrap_or_default();
        let calls = self.read_from(&format!("rq{name}Request"), half("Request"), &kept)?;
        let answers = self.write_to(&format!("rr{name}Reply"), half("Response"), &kept)?;
        self.services.push((calls, answers));
        Ok(ServiceId(self.services.len() - 1))
    }

    fn write(&mut self, to: WriterId, payload: &[u8]) -> Result<(), TransportError> {
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
        if self.poll.poll(&mut self.events, Some(most)).is_err() {
            std::thread::sleep(most);
        }
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

fn absolute(name: &str) -> Result<&str, TransportError> {
    let parts = name.strip_prefix('/').map(|rest| rest.split('/')).into_iter().flatten();
    let good = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    let (count, named) = parts.fold((0, true), |(count, all), part| (count + 1, all && good(part)));
    if count > 0 && named {
        return Ok(name);
    }
    Err(TransportError(format!(
        "{name:?} is no ROS name; allowed: /name or /name/name, of letters, digits and _"
    )))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_or_is_refused() {
        for good in ["/cmd_vel", "/robot/robotnik_base_control/odom", "/_x1"] {
            assert_eq!(absolute(good), Ok(good));
        }
        for bad in ["", "/", "cmd_vel", "/a//b", "/a/", "/1a", "/a b", "/grün", "~/odom"] {
            assert!(absolute(bad).is_err_and(|error| error.0.contains("no ROS name")), "{bad}");
        }
    }
}

//! Interface to other nodes that this crate needs, and the other ends of a topic.

use crate::TypeName;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

pub mod memory;

/// Quality of service that a writer offers or a reader asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qos {
    /// The newest only; a lost message is not sent again. As a reader it goes with every writer.
    BestEffort,
    /// Sent again until it has arrived, the newest only.
    Reliable,
    /// Reliable, and whoever comes later gets the last one too: a robot's description.
    Latched,
}

/// Why a transport does not do what it is asked.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct TransportError(pub String);

/// A topic that is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriterId(pub usize);
/// A topic that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReaderId(pub usize);
/// A service that is offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServiceId(pub usize);

/// Caller of a service that waits for an answer, in a transport's own encoding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller(pub Vec<u8>);

/// Somebody on a topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The topic, as ROS writes it.
    pub topic: String,
    /// The type's name on the wire.
    pub type_dds: String,
    /// True for a writer, false for a reader.
    pub writes: bool,
    /// Name of the node, as well as the transport knows it.
    pub who: String,
}

/// A way to other nodes: payloads in, payloads out. Nothing here waits but [`Transport::wait`].
pub trait Transport {
    /// Announces a writer.
    ///
    /// # Errors
    /// An invalid name, or a transport that is gone; so too below.
    fn writer(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<WriterId, TransportError>;
    /// Announces a reader.
    fn reader(&mut self, topic: &str, of: TypeName, qos: Qos) -> Result<ReaderId, TransportError>;
    /// Announces a service of this type, such as `std_srvs/srv/Trigger`.
    fn service(&mut self, name: &str, of: TypeName) -> Result<ServiceId, TransportError>;
    /// Sends a whole CDR payload.
    fn write(&mut self, to: WriterId, payload: &[u8]) -> Result<(), TransportError>;
    /// The oldest payload that has not been taken.
    fn take(&mut self, from: ReaderId) -> Option<Vec<u8>>;
    /// Takes a message with the node that wrote it, in a transport's own encoding; empty where it cannot tell.
    fn take_from_node(&mut self, from: ReaderId) -> Option<(Vec<u8>, Vec<u8>)> {
        self.take(from).map(|payload| (Vec::new(), payload))
    }
    /// The oldest call that has not been taken.
    fn take_call(&mut self, of: ServiceId) -> Option<(Caller, Vec<u8>)>;
    /// Answers a call.
    fn answer(&mut self, of: ServiceId, caller: &Caller, payload: &[u8]) -> Result<(), TransportError>;
    /// Waits until something may have come, at most for `most`.
    fn wait(&mut self, most: Duration);
    /// Why nothing can be sent and heard at all now.
    fn problem(&self) -> Option<String> {
        None
    }
    /// Returns how often the network was joined again because its threads had ended.
    fn rejoined(&self) -> u64 {
        0
    }
    /// Everybody else who has been heard of.
    fn endpoints(&self) -> Vec<Endpoint>;
}

/// Returns the problems of a topic that we write: no reader, a reader of another type, a second writer. Empty if there
/// are none.
///
/// ```
/// use moca_ros2::{Message, messages::Twist};
/// use moca_ros2::transport::{Endpoint, problems_of_writer};
///
/// let other = Endpoint {
///     topic: "/cmd_vel".into(), type_dds: Twist::TYPE.dds(), writes: true, who: "node /joy".into(),
/// };
/// let problems = problems_of_writer(&[other], "/cmd_vel", Twist::TYPE);
/// assert_eq!(problems[0], "/cmd_vel is also written by node /joy: the base obeys both; switch the other off");
/// ```
pub fn problems_of_writer(endpoints: &[Endpoint], topic: &str, ours: TypeName) -> Vec<String> {
    let (readers, writers): (Vec<_>, Vec<_>) = on(endpoints, topic).partition(|end| !end.writes);
    let mut problems: Vec<_> = readers.iter().filter_map(|end| mismatch(end, topic, ours)).collect();
    problems.extend(writers.iter().map(|end| {
        format!("{topic} is also written by {}: the base obeys both; switch the other off", end.who)
    }));
    if readers.is_empty() {
        problems.push(format!(
            "nobody reads {topic}: the base is off, on another domain, or has another name for it"
        ));
    }
    problems
}

/// Returns the problems of a topic that we read.
pub fn problems_of_reader(endpoints: &[Endpoint], topic: &str, ours: TypeName) -> Vec<String> {
    let writers: Vec<_> = on(endpoints, topic).filter(|end| end.writes).collect();
    let mut problems: Vec<_> = writers.iter().filter_map(|end| mismatch(end, topic, ours)).collect();
    match writers.len() {
        0 => problems.push(format!(
            "nobody writes {topic}: the base is off, on another domain, or has another name for it"
        )),
        1 => {}
        count => problems.push(format!("{topic} is written by {count} nodes: which one is the base?")),
    }
    problems
}

/// Returns this PC's clock, ns since the Unix epoch: the stamp of sent messages.
pub(crate) fn unix_ns() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_nanos()).unwrap_or(u64::MAX)
}

/// A name of ROS that begins at the root.
#[cfg(any(feature = "dds", feature = "zenoh", test))]
pub(crate) fn absolute(name: &str) -> Result<&str, TransportError> {
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

fn on<'a>(endpoints: &'a [Endpoint], topic: &'a str) -> impl Iterator<Item = &'a Endpoint> {
    endpoints.iter().filter(move |end| end.topic == topic)
}

/// DDS and zenoh say nothing when two ends differ in their type: they just do not meet.
fn mismatch(end: &Endpoint, topic: &str, ours: TypeName) -> Option<String> {
    let remedy = match (end.type_dds.as_str(), ours.0) {
        ("geometry_msgs::msg::dds_::TwistStamped_", "geometry_msgs/msg/Twist") => "; set stamped = true",
        ("geometry_msgs::msg::dds_::Twist_", "geometry_msgs/msg/TwistStamped") => "; set stamped = false",
        _ => "",
    };
    let does = if end.writes { "writes" } else { "reads" };
    (end.type_dds != ours.dds())
        .then(|| format!("{} {does} {topic} as {}, we have {}{remedy}", end.who, end.type_dds, ours.0))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Message;
    use crate::messages::{Odometry, Twist, TwistStamped};

    pub(crate) fn end(topic: &str, of: TypeName, writes: bool, who: &str) -> Endpoint {
        Endpoint { topic: topic.into(), type_dds: of.dds(), writes, who: who.into() }
    }

    #[test]
    fn who_is_missing_wrong_or_too_many_is_told() {
        let base = end("/cmd_vel", Twist::TYPE, false, "the base");
        let found = |ends: &[Endpoint]| problems_of_writer(ends, "/cmd_vel", Twist::TYPE);
        assert!(found(std::slice::from_ref(&base)).is_empty());
        assert!(found(&[]).concat().contains("nobody reads /cmd_vel"));
        let joy = end("/cmd_vel", Twist::TYPE, true, "node /joy");
        assert!(found(&[base, joy]).concat().contains("also written by node /joy"));
        let stamped = end("/cmd_vel", TwistStamped::TYPE, false, "the base");
        assert!(found(&[stamped]).concat().ends_with("set stamped = true"));
        let odom = |ends: &[Endpoint]| problems_of_reader(ends, "/odom", Odometry::TYPE);
        let one = end("/odom", Odometry::TYPE, true, "the base");
        assert!(odom(std::slice::from_ref(&one)).is_empty());
        assert!(odom(&[]).concat().contains("nobody writes /odom"));
        assert!(odom(&[one.clone(), one]).concat().contains("written by 2 nodes"));
        assert!(
            odom(&[end("/odom", Twist::TYPE, true, "x")])
                .concat()
                .contains("as geometry_msgs::msg::dds_::Twist_")
        );
    }

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

//! Wire format of ROS 2 nodes on `rmw_zenoh`, as texts and bytes; the session is the module `zenoh`'s (feature `zenoh`).
//!
//! A topic's data has a key with domain, name, type and the type's hash, and so has a service. Who is on it is told by
//! liveliness tokens. A payload is CDR as over DDS; number, time and writer go beside it, without which `rmw_zenoh_cpp` drops
//! it. A writer's number is XXH3-128 of its token.
//!
//! ```
//! use moca_ros2::rmw_zenoh::{data_key, endpoint};
//! use moca_ros2::{Message, messages::Twist};
//!
//! let token = "@ros2_lv/0/a1/0/3/MS/%/%robot/base_control/%robot%cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported/::,10:,:,:,,";
//! let base = endpoint(token, "b2").unwrap();
//! assert_eq!((base.topic.as_str(), base.writes, base.who.as_str()), ("/robot/cmd_vel", false, "node /robot/base_control"));
//! assert_eq!(endpoint(token, "a1"), None, "that is we");
//! assert_eq!(data_key(0, "/robot/cmd_vel", Twist::TYPE, "*"), "0/robot/cmd_vel/geometry_msgs::msg::dds_::Twist_/*");
//! ```

use crate::messages::{
    DiagnosticArray, DiagnosticStatus, Empty, Float64MultiArray, GripperCommand, JointState, Odometry,
    PoseStamped, TFMessage, Text, Twist, TwistStamped, WrenchStamped,
};
use crate::transport::{Endpoint, Qos};
use crate::{Message, TypeName};
use twox_hash::XxHash3_128;

/// Text that Humble's nodes send in place of a hash.
pub const NO_HASH: &str = "TypeHashNotSupported";
/// Length of what goes beside a payload.
pub const ATTACHMENT_BYTES: usize = 33;
/// Length of a writer's number.
pub const GID_BYTES: usize = 16;

/// RIHS01 of messages and services (REP-2016), by their definitions in every distribution since Iron.
const HASHES: [(TypeName, &str); 15] = [
    (Twist::TYPE, "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"),
    (TwistStamped::TYPE, "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"),
    (Odometry::TYPE, "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    (PoseStamped::TYPE, "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"),
    (WrenchStamped::TYPE, "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"),
    (JointState::TYPE, "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"),
    (TFMessage::TYPE, "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
    (DiagnosticArray::TYPE, "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"),
    (Float64MultiArray::TYPE, "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f"),
    (Text::TYPE, "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    (Empty::TYPE, "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312"),
    (DiagnosticStatus::TYPE, "RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4"),
    (GripperCommand::TYPE, "RIHS01_57eb8f326c9889ca8bb34ead82cc94cc09bf6bc5c3b6c09546dca3a00b589890"),
    (MARKERS, "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"),
    (TRIGGER, "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
];
const MARKERS: TypeName = TypeName("visualization_msgs/msg/MarkerArray");
const TRIGGER: TypeName = TypeName("std_srvs/srv/Trigger");

/// RIHS01 of a message or service that is spoken here; `None` for others.
pub fn type_hash(of: TypeName) -> Option<&'static str> {
    HASHES.into_iter().find_map(|(known, hash)| (known == of).then_some(hash))
}

/// Role of an end of a topic or service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Writes a topic.
    Writer,
    /// Reads a topic.
    Reader,
    /// Answers calls.
    Service,
}

impl Kind {
    /// As tokens name it.
    const fn code(self) -> &'static str {
        match self {
            Self::Writer => "MP",
            Self::Reader => "MS",
            Self::Service => "SS",
        }
    }
}

/// Key of a topic's data, or of a service's calls. Who takes a type whatever its hash gives `*`.
pub fn data_key(domain: u16, topic: &str, of: TypeName, hash: &str) -> String {
    format!("{domain}/{}/{}/{hash}", topic.trim_matches('/'), of.dds())
}

/// Key of every token of a domain.
pub fn tokens(domain: u16) -> String {
    format!("@ros2_lv/{domain}/**")
}

/// This program as a node, without a namespace.
#[derive(Clone, Copy, Debug)]
pub struct Node<'a> {
    /// `ROS_DOMAIN_ID`.
    pub domain: u16,
    /// Number of its session.
    pub session: &'a str,
    /// Its name.
    pub name: &'a str,
}

impl Node<'_> {
    /// The token of the node itself.
    pub fn token(&self) -> String {
        let Self { domain, session, name } = self;
        format!("@ros2_lv/{domain}/{session}/0/0/NN/%/%/{name}")
    }

    /// The token of its end `id` of a topic or service; ids begin at 1.
    pub fn endpoint_token(
        &self,
        id: usize,
        kind: Kind,
        topic: &str,
        of: TypeName,
        hash: &str,
        qos: Qos,
    ) -> String {
        let Self { domain, session, name } = self;
        let (kind, topic, of) = (kind.code(), topic.replace('/', "%"), of.dds());
        // Reliability, durability, history and depth; what is left out is as ROS has it: reliable, volatile, keep last.
        let qos = match qos {
            Qos::BestEffort => "2::,1:,:,:,,",
            Qos::Reliable => "::,1:,:,:,,",
            Qos::Latched => ":1:,1:,:,:,,",
        };
        format!("@ros2_lv/{domain}/{session}/0/{id}/{kind}/%/%/{name}/{topic}/{of}/{hash}/{qos}")
    }
}

/// The writer or reader that a token announces. `None` for a node, a service, something foreign, and for what session
/// `ours` announced. A reader that wants our type by another hash gets nothing from us: its type says so.
pub fn endpoint(token: &str, ours: &str) -> Option<Endpoint> {
    let parts: Vec<&str> = token.split('/').collect();
    let [space, _, session, _, _, kind, _, namespace, node, topic, of, hash, ..] = parts[..] else {
        return None;
    };
    let writes = kind == Kind::Writer.code();
    if space != "@ros2_lv" || session == ours || !(writes || kind == Kind::Reader.code()) {
        return None;
    }
    let expected = HASHES.into_iter().find_map(|(known, hash)| (known.dds() == of).then_some(hash));
    let other_hash = !writes && hash != NO_HASH && expected.is_some_and(|expected| expected != hash);
    Some(Endpoint {
        topic: topic.replace('%', "/"),
        type_dds: if other_hash { format!("{of} with the hash {hash}") } else { of.into() },
        writes,
        who: format!("node {}/{node}", namespace.replace('%', "/").trim_end_matches('/')),
    })
}

/// The session that announced a token: a process, or a part of one.
pub fn session_of(token: &str) -> &str {
    token.split('/').nth(2).unwrap_or_default()
}

/// The number of the writer with this token.
pub fn gid(token: &str) -> [u8; GID_BYTES] {
    XxHash3_128::oneshot(token.as_bytes()).to_le_bytes()
}

/// Returns the attachment of payload number `sequence` of a writer.
pub fn attachment(sequence: i64, unix_ns: u64, gid: [u8; GID_BYTES]) -> [u8; ATTACHMENT_BYTES] {
    let mut bytes = [0; ATTACHMENT_BYTES];
    bytes[..8].copy_from_slice(&sequence.to_le_bytes());
    bytes[8..16].copy_from_slice(&unix_ns.to_le_bytes());
    bytes[16] = 16;
    bytes[17..].copy_from_slice(&gid);
    bytes
}

/// The writer that something beside a payload names.
pub fn writer_of(attachment: &[u8]) -> Option<[u8; GID_BYTES]> {
    let bytes: &[u8; ATTACHMENT_BYTES] = attachment.try_into().ok()?;
    (bytes[16] == 16).then(|| std::array::from_fn(|i| bytes[17 + i]))
}

/// Returns the attachment of the answer to a call, from the attachment of the call.
pub fn answer_to(call: &[u8], unix_ns: u64) -> Option<[u8; ATTACHMENT_BYTES]> {
    let gid = writer_of(call)?;
    let sequence = i64::from_le_bytes(*call.first_chunk()?);
    Some(attachment(sequence, unix_ns, gid))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::problems_of_writer;

    const US: Node<'_> = Node { domain: 7, session: "c3", name: "mocad" };

    fn twist_token(kind: Kind, of: TypeName, hash: &str) -> String {
        US.endpoint_token(1, kind, "/robot/cmd_vel", of, hash, Qos::Reliable)
    }

    #[test]
    fn what_we_announce_is_read_back_by_others_and_is_nobody_to_us() {
        let token = twist_token(Kind::Writer, Twist::TYPE, type_hash(Twist::TYPE).unwrap());
        let end = endpoint(&token, "somebody else").unwrap();
        assert_eq!(
            (end.topic.as_str(), end.writes, end.who.as_str()),
            ("/robot/cmd_vel", true, "node /mocad")
        );
        assert_eq!(end.type_dds, Twist::TYPE.dds());
        assert_eq!(endpoint(&token, "c3"), None);
        assert_eq!(endpoint(&US.token(), "d4"), None, "a node is on no topic");
        assert_eq!(session_of(&token), "c3");
        let service = US.endpoint_token(2, Kind::Service, "/arm", TRIGGER, NO_HASH, Qos::Reliable);
        assert_eq!(endpoint(&service, "d4"), None, "a service is on no topic");
    }

    #[test]
    fn a_reader_that_gets_nothing_is_told_with_what_it_wants() {
        let problems = |of: TypeName, hash: &str| {
            let end = endpoint(&twist_token(Kind::Reader, of, hash), "d4").unwrap();
            problems_of_writer(&[end], "/robot/cmd_vel", Twist::TYPE)
        };
        assert!(problems(Twist::TYPE, type_hash(Twist::TYPE).unwrap()).is_empty());
        assert!(problems(Twist::TYPE, NO_HASH).is_empty(), "Humble");
        assert!(problems(Twist::TYPE, "RIHS01_abab")[0].contains("with the hash RIHS01_abab"));
        let stamped = problems(TwistStamped::TYPE, type_hash(TwistStamped::TYPE).unwrap());
        assert!(stamped[0].ends_with("set stamped = true"), "{stamped:?}");
    }

    #[test]
    fn foreign_tokens_are_nobody() {
        for token in ["", "/", "@ros2_lv", "a/0/s/0/1/MP/%/%/n/t/T/h/q", "@ros2_lv/0/s/0/1/SS/%/%/n/%t/T/h/q"]
        {
            assert_eq!(endpoint(token, "d4"), None, "{token}");
        }
        let cut = twist_token(Kind::Writer, Twist::TYPE, NO_HASH);
        for length in 0..cut.len() {
            let _ = endpoint(&cut[..length], "d4");
        }
    }

    #[test]
    fn number_time_and_writer_go_beside_a_payload() {
        let gid = std::array::from_fn(|i| u8::try_from(i).unwrap());
        let bytes = attachment(258, 3, gid);
        assert_eq!(bytes[..18], [2, 1, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 16, 0]);
        assert_eq!(writer_of(&bytes), Some(gid));
        assert_eq!(writer_of(&bytes[..32]), None);
        assert_eq!(writer_of(&[0; 33]), None);
        assert_eq!(answer_to(&bytes, 9), Some(attachment(258, 9, gid)), "by its number the caller knows it");
        assert_eq!(answer_to(&bytes[..32], 9), None);
    }
}

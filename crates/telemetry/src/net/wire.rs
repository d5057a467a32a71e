//! Messages, and frames around them: a big-endian `u32` length, then that many bytes of postcard.
//!
//! The first frame of a server is special, so that any version can read it: `MOCA`, the schema version as
//! big-endian `u32`, then a [`Challenge`]. A client answers with [`FromClient::Hello`], and is told the robot
//! ([`FromServer::Welcome`]) or why it is not served ([`FromServer::Goodbye`]). [`moca_msgs::Request::Stop`] is taken and
//! answered at any time, before a Hello and after a refusal too. Every frame of a server but the first is a [`FromServer`].
//!
//! ```
//! use moca_msgs::Request;
//! use moca_telemetry::net::wire::{FromClient, decode_from_client, encode_from_client};
//! let asked = FromClient::Request { id: 1, request: Request::Tare };
//! let frame = encode_from_client(&asked)?;
//! let (length, payload) = frame.split_first_chunk::<4>().unwrap();
//! assert_eq!(u32::from_be_bytes(*length) as usize, payload.len());
//! assert_eq!(decode_from_client(payload)?, asked);
//! # Ok::<(), moca_telemetry::net::NetError>(())
//! ```

use super::NetError;
use crate::{
    RobotDescription,
    calibration::{CalibrationProgress, CalibrationRequest},
};
use moca_msgs::{Outcome, ParameterValues, Request, Sample, TouchPolicy, Waypoint};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt};

/// Version of everything below, [`Sample`] included. Raised with every change.
pub const SCHEMA_VERSION: u32 = 17;
/// Longest frame a server sends, bytes.
pub const MAX_SERVER_FRAME: usize = 1 << 20;
/// Longest frame a client sends, bytes.
pub const MAX_CLIENT_FRAME: usize = 4096;
/// Longest frame of a client that is not served yet, bytes: a Hello or a stop.
pub(crate) const MAX_FIRST_FRAME: usize = 64;
/// Longest wait for a client's role.
pub const HELLO_TIMEOUT: Duration = Duration::from_secs(1);

/// Longest silence of a commander: one that hangs must not keep others from the robot.
pub const COMMAND_LEASE: Duration = Duration::from_secs(3);

/// Leases that a connection may ask for, ms.
pub const LEASE_MS: std::ops::RangeInclusive<u16> = 200..=3000;

/// Longest name of somebody that a connection speaks for, letters.
pub const NAME_MAX: usize = 64;

const MAGIC: [u8; 4] = *b"MOCA";

/// Challenge that a client receives before it names its role.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Challenge {
    /// Random, of this connection alone.
    pub nonce: [u8; 32],
    /// True if the client has to prove that it knows the daemon's token.
    pub token_needed: bool,
}

/// Role that a client may ask for, besides a stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// Nothing: it reads.
    Observer,
    /// Everything, one client at a time.
    #[default]
    Operator,
}

/// Message of a server after its greeting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromServer {
    /// Consecutive samples.
    Batch(Batch),
    /// Status of this client's own connection; sent when it changes.
    Status(Status),
    /// Progress of the calibration; sent on every change and to every new client.
    Calibration(CalibrationProgress),
    /// The answer to one request.
    Reply {
        /// The client's own number of the request.
        id: u64,
        /// The loop's answer.
        outcome: Outcome,
    },
    /// Present values of the parameters that have been changed since the start: number, elements. Sent on every change
    /// and, if there has been one, to every new client.
    Parameters(Vec<(u8, ParameterValues)>),
    /// Why the server closes this connection now.
    Goodbye(String),
    /// Something that the daemon's owner should know and that is no fault of the robot: nothing is recorded any more. New
    /// clients are told what was said before.
    Notice(String),
    /// The robot: this client is served from now on.
    Welcome(Box<RobotDescription>),
}

/// Consecutive samples, oldest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    /// When the batch was sent, ns since the Unix epoch.
    pub sent_unix_ns: u64,
    /// The samples.
    pub samples: Vec<Sample>,
}

/// Status of a client's own connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Samples the loop could not put into its ring, so far.
    pub ring_dropped: u64,
    /// Samples dropped because this client read too slowly, so far.
    pub client_dropped: u64,
    /// Holder of the command.
    pub commander: Commander,
}

/// Holder of the command, as one client sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Commander {
    /// Nobody: the first to ask gets it.
    #[default]
    Nobody,
    /// This client.
    You,
    /// Another client; only `Stop` is taken from this one.
    Another,
}

/// Message of a client.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromClient {
    /// Ask the loop. Anything but `Stop` also asks for the command.
    Request {
        /// Returned with the reply.
        id: u64,
        /// Request.
        request: Request,
    },
    /// Lead the flange along poses and times; answered once it has begun, or is refused. Also asks for the command.
    Trajectory {
        /// Returned with the reply.
        id: u64,
        /// Effect of a touch on it.
        touch: TouchPolicy,
        /// At most [`moca_msgs::target::MAX_WAYPOINTS`].
        waypoints: Vec<Waypoint>,
    },
    /// Calibrate. Also asks for the command; from a client that does not get it, this is not heard.
    Calibrate(CalibrationRequest),
    /// Give the command back. An armed robot is disarmed, unless it armed itself (`startup.arm`) and no operator has
    /// intervened since.
    Release,
    /// Nothing but a sign of life: a commander that is silent for its lease loses the command.
    Alive,
    /// Lease of this connection as a commander, ms, [`LEASE_MS`]; without it [`COMMAND_LEASE`].
    Lease(u16),
    /// The first frame of a client that wants to be served.
    Hello {
        /// Role that it asks for; a read-only socket makes an observer of every client.
        role: Role,
        /// The answer to the challenge, where a token is needed.
        proof: Option<[u8; 32]>,
    },
    /// Person or device that this connection speaks for, [`NAME_MAX`] letters at most: a gateway's word, for the log alone.
    SpeakFor(String),
}

/// A message as a whole frame, length included.
///
/// # Errors
/// One that is longer than [`MAX_SERVER_FRAME`].
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, NetError> {
    finish(postcard::to_extend(message, vec![0; 4])?, MAX_SERVER_FRAME)
}

/// Encodes a client's message as a whole frame, length included.
///
/// # Errors
/// One that is longer than [`MAX_CLIENT_FRAME`]: the daemon would hang up.
pub fn encode_from_client(message: &FromClient) -> Result<Vec<u8>, NetError> {
    finish(postcard::to_extend(message, vec![0; 4])?, MAX_CLIENT_FRAME)
}

/// The greeting as a whole frame.
pub(crate) fn greeting(challenge: &Challenge) -> Result<Vec<u8>, NetError> {
    let mut bytes = vec![0; 4];
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&SCHEMA_VERSION.to_be_bytes());
    finish(postcard::to_extend(challenge, bytes)?, MAX_SERVER_FRAME)
}

/// Reads a greeting's payload: a frame without its length.
///
/// # Errors
/// Another program or another version.
pub fn decode_greeting(payload: &[u8]) -> Result<Challenge, NetError> {
    let (magic, rest) = payload.split_first_chunk::<4>().ok_or(NetError::NotMoca)?;
    let (version, rest) = rest.split_first_chunk::<4>().ok_or(NetError::NotMoca)?;
    if *magic != MAGIC {
        return Err(NetError::NotMoca);
    }
    let theirs = u32::from_be_bytes(*version);
    if theirs != SCHEMA_VERSION {
        return Err(NetError::Schema { theirs, ours: SCHEMA_VERSION });
    }
    Ok(postcard::from_bytes(rest)?)
}

/// Decodes a server's message from a frame's payload.
///
/// # Errors
/// Bytes that are no message.
pub fn decode_from_server(payload: &[u8]) -> Result<FromServer, NetError> {
    Ok(postcard::from_bytes(payload)?)
}

/// Decodes a client's message from a frame's payload.
///
/// # Errors
/// Bytes that are no message.
pub fn decode_from_client(payload: &[u8]) -> Result<FromClient, NetError> {
    Ok(postcard::from_bytes(payload)?)
}

/// Reads one frame's payload into `buffer`. Not cancel-safe: never the losing branch of a `select!`.
pub(crate) async fn read_frame(
    stream: &mut (impl AsyncRead + Unpin),
    buffer: &mut Vec<u8>,
    max: usize,
) -> Result<(), NetError> {
    let bytes = usize::try_from(stream.read_u32().await?).unwrap_or(usize::MAX);
    if bytes > max {
        return Err(NetError::FrameTooLong { bytes, max });
    }
    buffer.resize(bytes, 0);
    stream.read_exact(buffer).await?;
    Ok(())
}

fn finish(mut bytes: Vec<u8>, max: usize) -> Result<Vec<u8>, NetError> {
    let length = bytes.len() - 4;
    let too_long = NetError::FrameTooLong { bytes: length, max };
    match u32::try_from(length) {
        Ok(prefix) if length <= max => {
            bytes[..4].copy_from_slice(&prefix.to_be_bytes());
            Ok(bytes)
        }
        _ => Err(too_long),
    }
}

/// A lease as it is granted.
///
/// # Errors
/// One outside [`LEASE_MS`].
pub fn check_lease(lease_ms: u16) -> Result<Duration, NetError> {
    if LEASE_MS.contains(&lease_ms) {
        return Ok(Duration::from_millis(lease_ms.into()));
    }
    Err(NetError::Lease(lease_ms))
}

/// Returns the name of somebody that a connection speaks for.
///
/// # Errors
/// One that is empty, longer than [`NAME_MAX`] or holds control characters.
pub(crate) fn check_name(name: String) -> Result<String, NetError> {
    let letters = name.chars().count();
    if (1..=NAME_MAX).contains(&letters) && !name.contains(char::is_control) {
        return Ok(name);
    }
    Err(NetError::Name(letters))
}

/// Now, ns since the Unix epoch.
pub fn unix_now_ns() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_nanos()).unwrap_or(u64::MAX)
}

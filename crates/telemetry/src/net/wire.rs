//! Messages, and frames around them: a big-endian `u32` length, then that many bytes of postcard.
//!
//! The first frame of a server is special, so that any version can read it: `MOCA`, the schema version as
//! big-endian `u32`, then a [`RobotDescription`], or else why the client is not served. Every later frame is a
//! [`FromServer`].
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
pub const SCHEMA_VERSION: u32 = 13;
/// Longest frame a server sends, bytes.
pub const MAX_SERVER_FRAME: usize = 1 << 20;
/// Longest frame a client sends, bytes.
pub const MAX_CLIENT_FRAME: usize = 4096;

/// How long a commander may be silent: one that hangs must not keep others from the robot.
pub const COMMAND_LEASE: Duration = Duration::from_secs(3);

const MAGIC: [u8; 4] = *b"MOCA";

/// What a server sends after its greeting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromServer {
    /// Consecutive samples.
    Batch(Batch),
    /// What this client should know about its own connection; sent when it changes.
    Status(Status),
    /// How far the calibration has come; sent on every change and to every new client.
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
}

/// Consecutive samples, oldest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    /// When the batch was sent, ns since the Unix epoch.
    pub sent_unix_ns: u64,
    /// The samples.
    pub samples: Vec<Sample>,
}

/// What a client should know about its own connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Samples the loop could not put into its ring, so far.
    pub ring_dropped: u64,
    /// Samples dropped because this client read too slowly, so far.
    pub client_dropped: u64,
    /// Who holds the command.
    pub commander: Commander,
}

/// Who holds the command, as one client sees it.
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

/// What a client sends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromClient {
    /// Ask the loop. Anything but `Stop` also asks for the command.
    Request {
        /// Returned with the reply.
        id: u64,
        /// What is asked.
        request: Request,
    },
    /// Lead the flange along poses and times; answered once it has begun, or is refused. Also asks for the command.
    Trajectory {
        /// Returned with the reply.
        id: u64,
        /// What a touch does to it.
        touch: TouchPolicy,
        /// At most [`moca_msgs::target::MAX_WAYPOINTS`].
        waypoints: Vec<Waypoint>,
    },
    /// Calibrate. Also asks for the command; from a client that does not get it, this is not heard.
    Calibrate(CalibrationRequest),
    /// Give the command back.
    Release,
    /// Nothing but a sign of life: a commander that is silent for [`COMMAND_LEASE`] loses the command.
    Alive,
}

/// A message as a whole frame, length included.
///
/// # Errors
/// One that is longer than [`MAX_SERVER_FRAME`].
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, NetError> {
    finish(postcard::to_extend(message, vec![0; 4])?, MAX_SERVER_FRAME)
}

/// What a client asks as a whole frame, length included.
///
/// # Errors
/// One that is longer than [`MAX_CLIENT_FRAME`]: the daemon would hang up.
pub fn encode_from_client(message: &FromClient) -> Result<Vec<u8>, NetError> {
    finish(postcard::to_extend(message, vec![0; 4])?, MAX_CLIENT_FRAME)
}

/// The greeting as a whole frame.
pub(crate) fn greeting(description: &RobotDescription) -> Result<Vec<u8>, NetError> {
    first_frame(&Ok(description))
}

/// What a client reads instead of the greeting if it is not served.
pub(crate) fn refusal(reason: &str) -> Result<Vec<u8>, NetError> {
    first_frame(&Err(reason))
}

fn first_frame(content: &Result<&RobotDescription, &str>) -> Result<Vec<u8>, NetError> {
    let mut bytes = vec![0; 4];
    bytes.extend_from_slice(&MAGIC);
    bytes.extend_from_slice(&SCHEMA_VERSION.to_be_bytes());
    finish(postcard::to_extend(content, bytes)?, MAX_SERVER_FRAME)
}

/// Reads a greeting's payload: a frame without its length.
///
/// # Errors
/// Another program, another version, or the reason why the client is not served.
pub fn decode_greeting(payload: &[u8]) -> Result<RobotDescription, NetError> {
    let (magic, rest) = payload.split_first_chunk::<4>().ok_or(NetError::NotMoca)?;
    let (version, rest) = rest.split_first_chunk::<4>().ok_or(NetError::NotMoca)?;
    if *magic != MAGIC {
        return Err(NetError::NotMoca);
    }
    let theirs = u32::from_be_bytes(*version);
    if theirs != SCHEMA_VERSION {
        return Err(NetError::Schema { theirs, ours: SCHEMA_VERSION });
    }
    postcard::from_bytes::<Result<RobotDescription, String>>(rest)?.map_err(NetError::Refused)
}

/// What a server says in a frame's payload.
///
/// # Errors
/// Bytes that are no message.
pub fn decode_from_server(payload: &[u8]) -> Result<FromServer, NetError> {
    Ok(postcard::from_bytes(payload)?)
}

/// What a client says in a frame's payload.
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

/// Now, ns since the Unix epoch.
pub fn unix_now_ns() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_nanos()).unwrap_or(u64::MAX)
}

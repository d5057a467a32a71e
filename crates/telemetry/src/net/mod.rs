//! Samples out, requests in, over a Unix socket or loopback TCP.
//!
//! Layers: [`wire`] (messages and frames) · [`access`] (who may ask what) · [`address`] (where) · [`token`] (the secret of a TCP
//! port) · `tls` (certificates) · `queue` (what waits for one client) · `command` (who may command) · [`requests`] (the way to the
//! loop) · `strangers` (a bound for other machines) · `door` (connections that are not served yet) · `attend` (served ones) · `hub`
//! (what they share) · [`server`] (the daemon's side) · [`client`] (one connection) · [`connection`] (a thread that keeps one alive;
//! what a dashboard wants).
//!
//! Reading is separate from commanding. A Unix socket admits those who may write to its file; a second one shows the robot to
//! everybody and takes no request but a stop. A TCP port on loopback, which every user of the machine reaches, admits those
//! who know a token. A stop needs neither: it is taken from any connection. Another machine comes in by mutual TLS (`tls`), where a
//! certificate has a [role](access), or through an SSH tunnel (`ssh -L /tmp/robot.sock:/run/mocad/telemetry.sock robot`).

pub mod access;
pub mod address;
mod attend;
pub mod client;
mod command;
pub mod connection;
mod door;
#[cfg(feature = "fleet")]
pub mod fleet;
mod halves;
mod hub;
mod ledger;
mod queue;
pub mod requests;
pub mod server;
#[cfg(feature = "tls")]
mod strangers;
#[cfg(feature = "testing")]
pub mod testing;
#[cfg(feature = "tls")]
pub mod tls;
pub mod token;
pub mod wire;

pub use address::{Address, Endpoint};
pub use client::Client;
pub use command::{Judge, ProposedChange};
pub use connection::{Connection, Link, Reply, Update};
pub use door::TlsPort;
pub use requests::{RequestReceiver, RequestSender, request_channel};
pub use server::{CalibrationPort, Ports, Server, Serving, serve};
pub use token::Token;
pub use wire::{Commander, Role, SCHEMA_VERSION, Status};

use std::path::PathBuf;

/// Error of the transport. The text names the cause; `source` does not repeat it.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    /// The transport is not encrypted.
    #[error(
        "telemetry address {0} is not loopback: listen there with telemetry.tls, or bind 127.0.0.1 and use an SSH tunnel"
    )]
    NotLoopback(Address),
    /// A port without a token would admit every user of the machine.
    #[error("telemetry address {0} needs a token: name a token file, or listen on a Unix socket")]
    NoToken(Address),
    /// The file with the token cannot be used.
    #[error("token file {path}: {why}", path = path.display())]
    Token {
        /// The file.
        path: PathBuf,
        /// Reason of the refusal.
        why: String,
    },
    /// Certificates, keys or the list of those who may come in cannot be used.
    #[error("{path}: {why}", path = path.display())]
    Access {
        /// The file or folder.
        path: PathBuf,
        /// Reason.
        why: String,
    },
    /// This program was built without TLS.
    #[error("this program was built without feature tls")]
    NoTls,
    /// The socket could not be bound.
    #[error("cannot listen on {address}: {cause}")]
    Bind {
        /// Address asked for.
        address: Address,
        /// Why not.
        cause: std::io::Error,
    },
    /// The telemetry thread could not be started.
    #[error("cannot start the telemetry thread: {0}")]
    Thread(std::io::Error),
    /// The other side went away.
    #[error("the daemon closed the connection")]
    Closed,
    /// The daemon does not serve this client.
    #[error("the daemon refuses this connection: {0}")]
    Refused(String),
    /// Connecting, reading or writing failed.
    #[error("no connection: {0}")]
    Io(std::io::Error),
    /// The other side is not a MOCA-S daemon, or not of this version.
    #[error("the daemon speaks telemetry schema {theirs}, this program speaks {ours}: use matching versions")]
    Schema {
        /// Version the daemon announced.
        theirs: u32,
        /// Version of this program.
        ours: u32,
    },
    /// The first frame was not a MOCA-S greeting.
    #[error("the other side is not a MOCA-S daemon")]
    NotMoca,
    /// A frame is longer than allowed.
    #[error("frame of {bytes} bytes, allowed are at most {max}")]
    FrameTooLong {
        /// Announced length.
        bytes: usize,
        /// Allowed length.
        max: usize,
    },
    /// A connection asks for a lease that is not allowed.
    #[error("a lease of {} ms is outside {} to {} ms", .0, wire::LEASE_MS.start(), wire::LEASE_MS.end())]
    Lease(u16),
    /// A connection speaks for somebody whose name is not allowed.
    #[error("{} letters are no name; allowed: 1 to {} without control characters", .0, wire::NAME_MAX)]
    Name(usize),
    /// A frame could not be decoded.
    #[error("malformed frame: {0}")]
    Malformed(postcard::Error),
}

impl NetError {
    /// Returns true if another attempt may succeed a moment later.
    pub(crate) fn may_pass(&self) -> bool {
        matches!(self, Self::Closed)
            || matches!(self, Self::Io(error) if error.kind() == std::io::ErrorKind::WouldBlock)
    }

    /// Returns true if the daemon was reached and refuses this client, however often it tries.
    pub(crate) fn is_refusal(&self) -> bool {
        matches!(
            self,
            Self::Refused(_) | Self::NoToken(_) | Self::Token { .. } | Self::Schema { .. } | Self::NotMoca
        )
    }
}

impl From<postcard::Error> for NetError {
    fn from(error: postcard::Error) -> Self {
        Self::Malformed(error)
    }
}

impl From<std::io::Error> for NetError {
    fn from(error: std::io::Error) -> Self {
        use std::io::ErrorKind::{BrokenPipe, ConnectionReset, UnexpectedEof};
        match error.kind() {
            UnexpectedEof | ConnectionReset | BrokenPipe => Self::Closed,
            _ => Self::Io(error),
        }
    }
}

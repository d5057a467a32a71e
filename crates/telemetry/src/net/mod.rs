//! Samples out, requests in, over loopback TCP or a Unix socket.
//!
//! Layers: [`wire`] (messages and frames) · [`address`] (where) · `queue` (what waits for one client) · `command` (who
//! may command) · [`requests`] (the way to the loop) · [`server`] (the daemon's side) · [`client`] (one connection) ·
//! [`connection`] (a thread that keeps one alive; what a dashboard wants).
//!
//! The transport has no authentication. A Unix socket admits who may write to its file; a TCP port on loopback admits
//! every user of the machine. Another machine comes in through an SSH tunnel (`ssh -L 7611:127.0.0.1:7611 robot`, or
//! `ssh -L 7611:/run/mocad/telemetry.sock robot`).

pub mod address;
pub mod client;
mod command;
pub mod connection;
mod queue;
pub mod requests;
pub mod server;
pub mod wire;

pub use address::Address;
pub use client::Client;
pub use command::{Judge, ProposedChange};
pub use connection::{Connection, Link, Reply, Update};
pub use requests::{RequestReceiver, RequestSender, request_channel};
pub use server::{CalibrationPort, Ports, Server, serve};
pub use wire::{Commander, SCHEMA_VERSION, Status};

use std::net::{Ipv4Addr, SocketAddr};

/// Where a daemon listens that is no service, unless told otherwise.
pub const DEFAULT_ADDRESS: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 7611);

/// What can go wrong on the transport. The text says the cause; `source` does not say it again.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    /// The transport has no authentication.
    #[error("telemetry address {0} is not loopback: bind 127.0.0.1 and reach it through an SSH tunnel")]
    NotLoopback(Address),
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
    /// A frame could not be decoded.
    #[error("malformed frame: {0}")]
    Malformed(postcard::Error),
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

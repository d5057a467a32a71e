//! One connection to a daemon.
//!
//! ```no_run
//! use moca_telemetry::net::{Address, Client, wire::FromServer};
//! # async fn watch() -> Result<(), moca_telemetry::net::NetError> {
//! let mut client = Client::connect(&Address::of_this_machine()).await?;
//! println!("{}", client.description.name);
//! while let FromServer::Batch(batch) = client.incoming.next().await? {
//!     println!("{} samples", batch.samples.len());
//! }
//! # Ok(())
//! # }
//! ```

use super::{
    Address, Endpoint, NetError, Token, address,
    halves::{Reader, Writer},
    wire::{self, Challenge, FromClient, FromServer},
};
use crate::{RobotDescription, calibration::CalibrationRequest};
use moca_msgs::{Outcome, Request, TouchPolicy, Waypoint};
use std::time::{Duration, Instant};
use tokio::{io::AsyncWriteExt, time::timeout};

/// Time for which [`stop`] keeps trying.
const STOP_PATIENCE: Duration = Duration::from_secs(3);
/// Pause before the next try of a stop.
const STOP_RETRY: Duration = Duration::from_millis(2);

/// A greeted connection, in two halves that may be used at the same time.
pub struct Client {
    /// The robot on the other side.
    pub description: RobotDescription,
    /// Messages of the daemon.
    pub incoming: Incoming,
    /// Messages to the daemon.
    pub outgoing: Outgoing,
}

/// The reading half.
pub struct Incoming {
    stream: Reader,
    payload: Vec<u8>,
}

/// The writing half.
pub struct Outgoing {
    stream: Writer,
}

impl Client {
    /// Connects, says who it is and reads the welcome.
    ///
    /// # Errors
    /// No daemon, another version, or the daemon's reason not to serve this client.
    pub async fn connect(endpoint: impl Into<Endpoint>) -> Result<Self, NetError> {
        let Endpoint { address, role, token } = endpoint.into();
        let (incoming, stream) = address::connect(&address, token.as_deref()).await?;
        let mut incoming = Incoming { stream: incoming, payload: Vec::new() };
        let mut outgoing = Outgoing { stream };
        let Challenge { nonce, token_needed } = incoming.greeting().await?;
        let proof = if token_needed {
            let path = token.ok_or(NetError::NoToken(address))?;
            Some(Token::read(&path)?.proof(&nonce))
        } else {
            None
        };
        outgoing.send(FromClient::Hello { role, proof }).await?;
        loop {
            match incoming.next().await? {
                FromServer::Welcome(description) => {
                    return Ok(Self { description: *description, incoming, outgoing });
                }
                FromServer::Goodbye(reason) => return Err(NetError::Refused(reason)),
                _ => {}
            }
        }
    }
}

/// Stops the robot without being served: needs neither a place among the clients nor the token. Returns the loop's answer.
///
/// # Errors
/// No daemon, or no answer in three seconds.
pub async fn stop(address: &Address) -> Result<Outcome, NetError> {
    let until = Instant::now() + STOP_PATIENCE;
    loop {
        let left = until.saturating_duration_since(Instant::now());
        match timeout(left, stop_once(address)).await {
            Err(_) => return Err(NetError::Io(std::io::ErrorKind::TimedOut.into())),
            // Whoever crowds the daemon may have pushed this connection out before it was read.
            Ok(Err(error)) if error.may_pass() && Instant::now() < until => {
                tokio::time::sleep(STOP_RETRY).await;
            }
            Ok(answered) => return answered,
        }
    }
}

/// As [`stop`], for a program without a runtime.
///
/// # Errors
/// As [`stop`].
pub fn stop_blocking(address: &Address) -> Result<Outcome, NetError> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(stop(address))
}

async fn stop_once(address: &Address) -> Result<Outcome, NetError> {
    let file = Endpoint::from(address).token;
    let (stream, outgoing) = address::connect(address, file.as_deref()).await?;
    let (mut incoming, mut outgoing) =
        (Incoming { stream, payload: Vec::new() }, Outgoing { stream: outgoing });
    // Before anything is read: a daemon that is slow to greet still hears it.
    outgoing.request(0, Request::Stop).await?;
    incoming.greeting().await?;
    loop {
        match incoming.next().await? {
            FromServer::Reply { outcome, .. } => return Ok(outcome),
            FromServer::Goodbye(reason) => return Err(NetError::Refused(reason)),
            _ => {}
        }
    }
}

impl Incoming {
    async fn greeting(&mut self) -> Result<Challenge, NetError> {
        wire::read_frame(&mut self.stream, &mut self.payload, wire::MAX_SERVER_FRAME).await?;
        wire::decode_greeting(&self.payload)
    }

    /// The next message. Not cancel-safe: a call that is dropped half-way loses the frame's boundary.
    pub async fn next(&mut self) -> Result<FromServer, NetError> {
        wire::read_frame(&mut self.stream, &mut self.payload, wire::MAX_SERVER_FRAME).await?;
        wire::decode_from_server(&self.payload)
    }
}

impl Outgoing {
    /// Sends a request; the reply carries the same `id`.
    pub async fn request(&mut self, id: u64, request: Request) -> Result<(), NetError> {
        self.send(FromClient::Request { id, request }).await
    }

    /// Leads the flange along poses and times; the reply carries the same `id`.
    pub async fn trajectory(
        &mut self,
        id: u64,
        touch: TouchPolicy,
        waypoints: Vec<Waypoint>,
    ) -> Result<(), NetError> {
        self.send(FromClient::Trajectory { id, touch, waypoints }).await
    }

    /// Asks the calibrator.
    pub async fn calibrate(&mut self, request: CalibrationRequest) -> Result<(), NetError> {
        self.send(FromClient::Calibrate(request)).await
    }

    /// Gives the command back.
    pub async fn release(&mut self) -> Result<(), NetError> {
        self.send(FromClient::Release).await
    }

    /// Shows that this client is alive, which keeps the command.
    pub async fn alive(&mut self) -> Result<(), NetError> {
        self.send(FromClient::Alive).await
    }

    /// Sets how long this client may be silent while it commands, ms, [`wire::LEASE_MS`].
    pub async fn lease(&mut self, lease_ms: u16) -> Result<(), NetError> {
        wire::check_lease(lease_ms)?;
        self.send(FromClient::Lease(lease_ms)).await
    }

    /// Says for which person or device this client speaks from now on; the robot's log names it.
    pub async fn speak_for(&mut self, name: &str) -> Result<(), NetError> {
        let name = wire::check_name(name.into())?;
        self.send(FromClient::SpeakFor(name)).await
    }

    async fn send(&mut self, message: FromClient) -> Result<(), NetError> {
        self.stream.write_all(&wire::encode_from_client(&message)?).await?;
        // TLS keeps what the kernel has no room for.
        Ok(self.stream.flush().await?)
    }
}

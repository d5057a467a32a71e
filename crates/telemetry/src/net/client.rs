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
    Address, NetError,
    address::{self, Reader, Writer},
    wire::{self, FromClient, FromServer},
};
use crate::{RobotDescription, calibration::CalibrationRequest};
use moca_msgs::{Request, TouchPolicy, Waypoint};
use tokio::io::AsyncWriteExt;

/// A greeted connection, in two halves that may be used at the same time.
pub struct Client {
    /// The robot on the other side.
    pub description: RobotDescription,
    /// What the daemon says.
    pub incoming: Incoming,
    /// What the daemon is asked.
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
    /// Connects and reads the greeting.
    pub async fn connect(address: &Address) -> Result<Self, NetError> {
        let (mut stream, outgoing) = address::connect(address).await?;
        let mut payload = Vec::new();
        wire::read_frame(&mut stream, &mut payload, wire::MAX_SERVER_FRAME).await?;
        let description = wire::decode_greeting(&payload)?;
        Ok(Self {
            description,
            incoming: Incoming { stream, payload },
            outgoing: Outgoing { stream: outgoing },
        })
    }
}

impl Incoming {
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

    async fn send(&mut self, message: FromClient) -> Result<(), NetError> {
        Ok(self.stream.write_all(&wire::encode_from_client(&message)?).await?)
    }
}

//! A running robot in other people's viewers: the daemon's telemetry over the Foxglove WebSocket protocol, for Foxglove,
//! Lichtblick and PlotJuggler. Read-only: it sends the daemon no request and takes none from a viewer.
//!
//! Layers: [`protocol`] (texts and frames) · `hub` (who watches what) · [`origin`] (who may) · `server` (one viewer) ·
//! `feed` (the daemon's samples as messages) · [`serve`].
//!
//! This crate refuses to know: requests, control laws, the board.

mod feed;
mod hub;
pub mod origin;
pub mod protocol;
mod server;

use hub::Hub;
use moca_telemetry::net::Address;
use origin::Origins;
use std::{net::SocketAddr, rc::Rc};

/// Port that viewers try first.
pub const DEFAULT_PORT: u16 = 8765;

/// Served robot, address and allowed origins.
#[derive(Clone, Debug)]
pub struct Options {
    /// The daemon.
    pub daemon: Address,
    /// Address for viewers; loopback only.
    pub listen: SocketAddr,
    /// Web pages that may connect besides those of this machine.
    pub origins: Origins,
    /// Rate of numbers, Hz.
    pub rate_hz: u32,
}

/// Serves until the process ends; `listening` is told the address with the port that the system chose.
///
/// # Errors
/// An address that is not loopback or cannot be bound. A daemon that is not there is no error: it is waited for.
pub async fn serve(options: Options, listening: impl FnOnce(SocketAddr)) -> anyhow::Result<()> {
    let listener = server::bind(options.listen)?;
    listening(listener.local_addr()?);
    let hub = Rc::new(Hub::default());
    let local = tokio::task::LocalSet::new();
    let period_ns = 1_000_000_000 / u64::from(options.rate_hz.max(1));
    local
        .run_until(async {
            tokio::join!(
                feed::feed(&options.daemon, period_ns, &hub),
                server::accept_all(&listener, &options.origins, &hub)
            );
        })
        .await;
    Ok(())
}

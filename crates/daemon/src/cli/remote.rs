//! A running daemon, as the commands that ask it for something meet it.

use anyhow::{Result, bail, ensure};
use clap::Args;
use moca_msgs::{Outcome, Request, Sample};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{Address, Connection, Endpoint, Link, Update};
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest wait for a daemon on the same machine to greet or to answer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(3);
/// Period at which the connection is read.
pub(crate) const LOOK_EVERY: Duration = Duration::from_millis(5);

/// Which daemon.
#[derive(Args)]
pub(crate) struct DaemonArguments {
    /// Address of the daemon's telemetry: unix:PATH, HOST:PORT on this machine, or tls://HOST:PORT.
    #[arg(long, value_name = "ADDRESS", default_value_t = Address::of_this_machine())]
    pub(crate) address: Address,
}

/// The daemon refused a request: exit code 4.
#[derive(Debug)]
pub struct Refused(pub(crate) String);

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "refused: {}", self.0)
    }
}

impl std::error::Error for Refused {}

impl DaemonArguments {
    /// Returns the address for observers: the socket that only shows, if there is one beside the operators'.
    pub(crate) fn to_watch(&self) -> Endpoint {
        let shows = self.address.watch_socket().filter(|path| path.exists());
        Endpoint::from(shows.map_or_else(|| self.address.clone(), Address::Unix)).to_watch()
    }
}

/// Connects, and waits for the welcome.
///
/// # Errors
/// No daemon in three seconds; at once, a daemon that does not serve this client.
pub(crate) fn connect(endpoint: impl Into<Endpoint>) -> Result<(Connection, Arc<RobotDescription>)> {
    let endpoint = endpoint.into();
    let address = endpoint.address.clone();
    let connection = Connection::spawn(endpoint, || {})?;
    let until = Instant::now() + PATIENCE;
    loop {
        if let Some(reason) = connection.refusal() {
            bail!("{address}: {reason}");
        }
        match connection.poll().link {
            Link::Up { description, .. } => return Ok((connection, description)),
            Link::Down { reason } if Instant::now() >= until => bail!("{address}: {reason}"),
            Link::Down { .. } => std::thread::sleep(LOOK_EVERY),
        }
    }
}

/// The description and the first news: changed values come right after the greeting, before any sample.
///
/// # Errors
/// The daemon hung up, or sends no sample.
pub(crate) fn settled(connection: &Connection) -> Result<(Arc<RobotDescription>, Update)> {
    let update = news(connection, |_| true)?;
    let Link::Up { description, .. } = &update.link else { bail!("the daemon hung up") };
    Ok((Arc::clone(description), update))
}

/// Waits for a sample that is `wanted`, as the last one of the news it came with. The command is kept meanwhile.
///
/// # Errors
/// The daemon hung up, or no such sample came in time.
pub(crate) fn news(connection: &Connection, wanted: impl Fn(&Sample) -> bool) -> Result<Update> {
    let until = Instant::now() + PATIENCE;
    loop {
        connection.alive();
        let mut update = connection.poll();
        if let Link::Down { reason } = &update.link {
            bail!("the daemon hung up: {reason}");
        }
        if let Some(found) = update.samples.iter().rposition(&wanted) {
            update.samples.truncate(found + 1);
            return Ok(update);
        }
        ensure!(Instant::now() < until, "the daemon sends nothing new");
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Asks, and waits for the answer. A caller that then goes without releasing the command stops a moving robot.
///
/// # Errors
/// No answer.
pub(crate) fn ask(connection: &Connection, request: Request) -> Result<Outcome> {
    connection.request(request);
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        connection.alive();
        if let Some(reply) = connection.poll().replies.iter().find(|reply| reply.answers(&request)) {
            return Ok(reply.outcome);
        }
        std::thread::sleep(LOOK_EVERY);
    }
    bail!("the daemon does not answer")
}

//! A connection to a running daemon, as the commands of an operator use it.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::remote::{DaemonArguments, Refused, ask, connect, news};
use crate::cli::status::Status;
use anyhow::{Context, Result};
use clap::Args;
use moca_msgs::{Mode, Request, Sample};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::client::stop_blocking;
use moca_telemetry::net::{Connection, Endpoint, Link, NetError, Update};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Said where nobody answers.
const IS_ONE_RUNNING: &str = "is a daemon running, and does it listen there (telemetry.listen)?";

/// Which daemon, and how its answer is written.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    daemon: DaemonArguments,
    /// Print the robot's status as JSON, an object a line; null is what is not known.
    #[arg(long)]
    json: bool,
}

/// The robot stopped while it was armed or tared, or is out of reach and has to: exit code 5.
#[derive(Debug)]
pub struct Stopped(String);

impl fmt::Display for Stopped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the robot stopped: {}", self.0)
    }
}

impl std::error::Error for Stopped {}

impl Stopped {
    pub(super) fn new(why: impl Into<String>) -> Self {
        Self(why.into())
    }

    pub(super) fn because(sample: &Sample) -> Self {
        Self(sample.fault.map_or_else(|| sample.mode.name().into(), |fault| fault.to_string()))
    }
}

/// Set once somebody has pressed Ctrl-C.
///
/// # Errors
/// The handler is not accepted.
pub(super) fn interrupted() -> Result<Arc<AtomicBool>> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let on_signal = Arc::clone(&interrupted);
    ctrlc::set_handler(move || on_signal.store(true, Ordering::Relaxed)).context("Ctrl-C handler")?;
    Ok(interrupted)
}

/// A connection, and how what comes over it is written.
pub(super) struct Operator {
    connection: Connection,
    robot: Arc<RobotDescription>,
    json: bool,
}

impl Operator {
    pub(super) const fn robot(&self) -> &Arc<RobotDescription> {
        &self.robot
    }

    /// Returns true if a status is written as JSON.
    pub(super) const fn json(&self) -> bool {
        self.json
    }

    pub(super) const fn connection(&self) -> &Connection {
        &self.connection
    }

    pub(super) fn connect(arguments: &Arguments) -> Result<Self> {
        Self::reach((&arguments.daemon.address).into(), arguments)
    }

    /// One that only looks on.
    pub(super) fn look_on(arguments: &Arguments) -> Result<Self> {
        Self::reach(arguments.daemon.to_watch(), arguments)
    }

    fn reach(endpoint: Endpoint, arguments: &Arguments) -> Result<Self> {
        let (connection, robot) = connect(endpoint).context(IS_ONE_RUNNING)?;
        Ok(Self { connection, robot, json: arguments.json })
    }

    /// Stops the robot, then says what it does. Needs no place among the daemon's clients, no token, and
    /// on this machine no rights but to look on.
    ///
    /// # Errors
    /// No daemon or no answer; refused, with the reason.
    pub(super) fn stop(arguments: &Arguments) -> Result<()> {
        let address = &arguments.daemon.address;
        let stopped = match stop_blocking(address) {
            Err(NetError::Io(_)) if arguments.daemon.to_watch().address != *address => {
                stop_blocking(&arguments.daemon.to_watch().address)
            }
            stopped => stopped,
        };
        let outcome = stopped.with_context(|| format!("{address}: {IS_ONE_RUNNING}"))?;
        outcome.map_err(|refusal| Refused(refusal.to_string()))?;
        let stopped = |sample: &Sample| matches!(sample.mode, Mode::ProtectiveStop | Mode::Fault);
        match Self::look_on(arguments).and_then(|shown| Ok((news(&shown.connection, stopped)?, shown))) {
            Ok((update, shown)) => shown.print(&update),
            Err(_) if arguments.json => {}
            Err(why) => println!("stopped; its status is not shown: {why:#}"),
        }
        Ok(())
    }

    /// One request from somebody who leaves again: the command is given back. A robot that armed itself goes on.
    pub(super) fn once(&self, request: Request) -> Result<()> {
        let outcome = self.ask(request);
        self.connection.release();
        outcome?;
        let carried_out = |sample: &Sample| match request {
            Request::SelectLaw(law) => sample.law == Some(law),
            Request::Disarm => !sample.mode.moves(),
            _ => sample.mode == Mode::Ready,
        };
        // Samples from before the answer may come after it; and by now the next thing may have happened.
        let update = news(&self.connection, carried_out).or_else(|_| news(&self.connection, |_| true))?;
        self.print(&update);
        Ok(())
    }

    /// Shows that somebody is there; what has come meanwhile.
    ///
    /// # Errors
    /// [`Stopped`]: the daemon is gone, and with it whoever commands.
    pub(super) fn stay(&self) -> Result<Update> {
        self.connection.alive();
        let update = self.connection.poll();
        match &update.link {
            Link::Down { reason } => {
                let why = format!("the daemon hung up ({reason}), and its commander is gone");
                Err(Stopped::new(why).into())
            }
            _ => Ok(update),
        }
    }

    /// Gives the command back if the robot has stopped.
    ///
    /// # Errors
    /// [`Stopped`], with the cause.
    pub(super) fn leave_if_stopped(&self, update: &Update) -> Result<()> {
        let stops = |sample: &&Sample| matches!(sample.mode, Mode::ProtectiveStop | Mode::Fault);
        let Some(sample) = update.samples.iter().find(stops) else { return Ok(()) };
        self.connection.release();
        Err(Stopped::because(sample).into())
    }

    pub(super) fn ask(&self, request: Request) -> Result<()> {
        Ok(ask(&self.connection, request)?
            .map_err(|refusal| Refused(request.refused(refusal).to_string()))?)
    }

    /// The last sample of some news.
    pub(super) fn print(&self, update: &Update) {
        let Some(sample) = update.samples.last() else { return };
        let status = Status::new(&self.robot, sample, update.status.commander);
        if self.json {
            println!("{}", status.json());
        } else {
            print!("{status}");
        }
    }
}

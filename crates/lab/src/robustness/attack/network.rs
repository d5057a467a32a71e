//! Clients that crowd the server, while another one asks for a stop.

use crate::robustness::watch::Findings;
use anyhow::{Context, Result};
use moca_msgs::{Request, Sample};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{Address, Connection, Ports, RequestReceiver, request_channel, serve};
use serde::Serialize;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Clients of a crowd: several times as many as the server has places for.
const CLIENTS: usize = 400;
/// Clients that storm.
const STORMING: usize = 8;
/// A stop that takes longer never comes, s.
const NEVER: Duration = Duration::from_secs(10);
/// Time for a crowd to settle.
const SETTLE: Duration = Duration::from_millis(500);

/// Clients of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Crowd {
    /// Clients that connect and watch.
    Watchers,
    /// Clients that send a length and nothing else.
    SlowHandshakes,
    /// Clients that ask as fast as they can.
    RequestStorm,
}

impl Crowd {
    pub(super) const ALL: [Self; 3] = [Self::Watchers, Self::SlowHandshakes, Self::RequestStorm];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Watchers => "400 watchers",
            Self::SlowHandshakes => "400 slow handshakes",
            Self::RequestStorm => "8 clients that ask without end",
        }
    }
}

/// The loop's end of the requests, answered at once.
struct Loop {
    requests: RequestReceiver,
    stops: u64,
}

impl Loop {
    fn answer(&mut self) {
        while let Some((ticket, request)) = self.requests.take() {
            self.stops += u64::from(request == Request::Stop);
            self.requests.answer(ticket, Ok(()));
        }
    }
}

/// The crowd, connected while this lives.
enum Present {
    Streams(#[expect(dead_code, reason = "they are open")] Vec<UnixStream>),
    Connections(Vec<Connection>),
}

/// Lets the crowd come and another client ask for a stop. The time that it takes is printed, not judged: it is the
/// machine's.
///
/// # Errors
/// The server or a client could not be started.
#[expect(clippy::print_stderr, reason = "a time of the wall clock, beside the table")]
pub(super) fn run(crowd: Crowd) -> Result<Findings> {
    let (mut samples, from_loop) = rtrb::RingBuffer::new(64);
    let (asks, requests) = request_channel();
    let ports = Ports {
        samples: from_loop,
        requests: asks,
        ring_dropped: Arc::new(AtomicU64::new(0)),
        recorder: None,
        calibration: None,
        judge: None,
    };
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let socket = std::env::temp_dir().join(format!("moca-attack-{}-{number}.sock", std::process::id()));
    let server = serve(&Address::Unix(socket), 0o600, RobotDescription::paper("attack", true), ports)?;
    let address = server.address().clone();
    let mut answering = Loop { requests, stops: 0 };
    let present = come(crowd, &address)?;
    let mut findings = Findings::default();
    let mut wait = |until: &mut dyn FnMut(&Loop) -> bool, at_most: Duration| {
        let begin = Instant::now();
        while begin.elapsed() < at_most {
            // What finds no room is dropped, as the loop drops it.
            let _ = samples.push(Sample::default());
            answering.answer();
            if let (Crowd::RequestStorm, Present::Connections(clients)) = (crowd, &present) {
                clients.iter().for_each(|client| client.request(Request::EndTarget));
            }
            if until(&answering) {
                return Some(begin.elapsed());
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        None
    };
    wait(&mut |_: &Loop| false, SETTLE);
    findings.stops_asked = 1;
    let stopper = Connection::spawn(address, || {})?;
    let mut asked = Instant::now();
    stopper.request(Request::Stop);
    let obeyed = wait(
        &mut |answering: &Loop| {
            // A client that was refused asks again.
            if asked.elapsed() > Duration::from_millis(100) {
                stopper.request(Request::Stop);
                asked = Instant::now();
            }
            answering.stops > 0
        },
        NEVER,
    );
    match obeyed {
        Some(after) => {
            eprintln!("{}: the stop reached the loop after {:.1} ms", crowd.name(), after.as_secs_f64() * 1e3)
        }
        None => findings.violation(format!("a stop beside {} never reached the loop", crowd.name())),
    }
    Ok(findings)
}

fn come(crowd: Crowd, address: &Address) -> Result<Present> {
    let Address::Unix(socket) = address else { anyhow::bail!("a socket file") };
    let clients = || (0..CLIENTS).map(|_| UnixStream::connect(socket).context("a client of the crowd"));
    Ok(match crowd {
        Crowd::Watchers => Present::Streams(clients().collect::<Result<_>>()?),
        Crowd::SlowHandshakes => {
            let mut streams = clients().collect::<Result<Vec<_>>>()?;
            // One that was closed meanwhile takes nothing.
            streams.iter_mut().for_each(|stream| drop(stream.write_all(&[16, 0, 0, 0])));
            Present::Streams(streams)
        }
        Crowd::RequestStorm => {
            let connections = (0..STORMING).map(|_| Connection::spawn(address.clone(), || {}));
            Present::Connections(connections.collect::<Result<Vec<_>, _>>()?)
        }
    })
}

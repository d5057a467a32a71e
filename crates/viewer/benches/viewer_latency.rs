//! Measures what the way through `moca-viewer` costs, beside a bare TCP echo in the same run:
//! `cargo bench -p moca-viewer --bench viewer_latency -- [SECONDS]` (default 15).
//!
//! One thread plays the loop at 1 kHz. Printed: the age of a sample when a telemetry client has it, when a viewer has it, and
//! an echo of as many bytes. Daemons send batches of 10 ms, so that ages of 0 to 10 ms are the batch's.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use moca_msgs::Sample;
use moca_telemetry::{
    RobotDescription,
    net::{Address, Client, Ports, Serving, request_channel, serve as serve_telemetry, wire::FromServer},
};
use moca_viewer::{Options, origin::Origins, serve};
use rtrb::RingBuffer;
use serde_json::{Value, json};
use std::{
    error::Error,
    io::{Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    sync::{Arc, atomic::AtomicU64, mpsc},
    thread,
    time::{Duration, Instant},
};
use tokio_tungstenite::tungstenite::{self, Message, http::Request};

type Failure = Box<dyn Error + Send + Sync>;

type Measuring = thread::JoinHandle<Result<Vec<Duration>, Failure>>;

const PERIOD: Duration = Duration::from_millis(1);
const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

fn main() -> Result<(), Failure> {
    let seconds: u64 = std::env::args()
        .skip(1)
        .find(|argument| argument != "--bench")
        .map_or(Ok(15), |number| number.parse())?;
    let (mut samples, from_loop) = RingBuffer::new(4096);
    let (requests, _robot) = request_channel();
    let ring_dropped = Arc::new(AtomicU64::new(0));
    let ports =
        Ports { samples: from_loop, requests, ring_dropped, recorder: None, calibration: None, judge: None };
    let server =
        serve_telemetry(&ANY.into(), Serving::this_user()?, RobotDescription::paper("latency", true), ports)?;
    let daemon = server.address().clone();
    let options = Options { daemon: daemon.clone(), listen: ANY, origins: Origins::default(), rate_hz: 1000 };
    let (told, listening) = mpsc::channel();
    thread::spawn(move || -> Result<(), Failure> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        // Nobody waits for the address any more only where the program ends.
        runtime.block_on(serve(options, |address| told.send(address).unwrap_or_default()))?;
        Ok(())
    });
    let viewer = listening.recv()?;

    let start = Instant::now();
    let ticks = seconds * 1000;
    let rows: [(&str, Measuring); 3] = [
        ("sample to telemetry client", thread::spawn(move || telemetry(&daemon, start, ticks))),
        ("sample to viewer", thread::spawn(move || watch(viewer, start, ticks))),
        ("bare TCP echo, there and back", thread::spawn(move || echo(ticks))),
    ];
    for tick in 0..ticks + 100 {
        let due = start + PERIOD * u32::try_from(tick + 1)?;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let now_ns = u64::try_from(start.elapsed().as_nanos())?;
        let mut sample = Sample { tick: now_ns, time_ns: tick * 1_000_000, ..Sample::default() };
        sample.taxels.extend([moca_msgs::TaxelReading::default(); 11]);
        sample.q_rad.extend([0.1; 7]);
        sample.dq_rad_s.extend([0.1; 7]);
        sample.arm_torque_nm.extend([0.1; 7]);
        // What finds no room is not measured.
        let _ = samples.push(sample);
    }
    println!("{seconds} s at 1 kHz; ages in µs, batching of 10 ms included\n");
    println!("{:<32} {:>8} {:>8} {:>8} {:>8}", "", "samples", "p50", "p99", "max");
    for (name, row) in rows {
        let mut ages = row.join().map_err(|_| "a thread panicked")??;
        ages.sort_unstable();
        let at =
            |part: usize| ages.get(ages.len() * part / 1000).or(ages.last()).map_or(0, Duration::as_micros);
        println!("{name:<32} {:>8} {:>8} {:>8} {:>8}", ages.len(), at(500), at(990), at(1000));
    }
    Ok(())
}

/// A sample's tick is the time at which it was made, ns since the start.
fn age(start: Instant, made_ns: u64) -> Duration {
    start.elapsed().saturating_sub(Duration::from_nanos(made_ns))
}

fn telemetry(daemon: &Address, start: Instant, ticks: u64) -> Result<Vec<Duration>, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut client = Client::connect(daemon).await?;
        let mut ages = Vec::new();
        while start.elapsed() < PERIOD * u32::try_from(ticks)? {
            let FromServer::Batch(batch) = client.incoming.next().await? else { continue };
            ages.extend(batch.samples.iter().map(|sample| age(start, sample.tick)));
        }
        Ok(ages)
    })
}

fn watch(address: SocketAddr, start: Instant, ticks: u64) -> Result<Vec<Duration>, Failure> {
    let request = Request::get(format!("ws://{address}/"))
        .header("Host", address.to_string())
        .header("Connection", "Upgrade")
        .header("Upgrade", "websocket")
        .header("Sec-WebSocket-Version", "13")
        .header("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ==")
        .header("Sec-WebSocket-Protocol", "foxglove.sdk.v1")
        .body(())?;
    let (mut socket, _) = tungstenite::client(request, TcpStream::connect(address)?)?;
    let mut ages = Vec::new();
    while start.elapsed() < PERIOD * u32::try_from(ticks)? {
        match socket.read()? {
            Message::Text(text) => {
                let text: Value = serde_json::from_str(&text)?;
                let channels = text["channels"].as_array().cloned().unwrap_or_default();
                if let Some(state) = channels.iter().find(|channel| channel["topic"] == "/state") {
                    let pair = json!({ "id": 1, "channelId": state["id"] });
                    let ask = json!({ "op": "subscribe", "subscriptions": [pair] });
                    socket.send(Message::text(ask.to_string()))?;
                }
            }
            Message::Binary(frame) => {
                // Behind the frame's head and the encapsulation the state begins with its tick.
                let tick = frame.get(17..25).ok_or("a state is longer")?;
                ages.push(age(start, u64::from_le_bytes(tick.try_into()?)));
            }
            _ => {}
        }
    }
    Ok(ages)
}

/// As many bytes as a state has, as often.
fn echo(ticks: u64) -> Result<Vec<Duration>, Failure> {
    const BYTES: usize = 500;
    let listener = TcpListener::bind(ANY)?;
    let mut near = TcpStream::connect(listener.local_addr()?)?;
    let (mut far, _) = listener.accept()?;
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    thread::spawn(move || {
        let mut bytes = [0; BYTES];
        while far.read_exact(&mut bytes).is_ok() && far.write_all(&bytes).is_ok() {}
    });
    let mut bytes = [7; BYTES];
    let mut times = Vec::new();
    for _ in 0..ticks {
        let sent = Instant::now();
        near.write_all(&bytes)?;
        near.read_exact(&mut bytes)?;
        times.push(sent.elapsed());
        thread::sleep(PERIOD);
    }
    Ok(times)
}

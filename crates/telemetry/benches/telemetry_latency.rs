//! Measures telemetry next to a bare TCP echo, in one run:
//! `cargo bench -p moca-telemetry --features net --bench telemetry_latency -- [SECONDS]` (default 25).
//!
//! One thread plays the loop at 1 kHz. Three subscribers: two read, one never does. Printed: a batch from its
//! send to a subscriber's receipt, the age of each sample when received (batching included), a TCP echo of a
//! batch's size at a batch's rate, what each reader lost, and how far memory grew.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use moca_msgs::Sample;
use moca_telemetry::{
    RobotDescription,
    net::{
        Address, Client, NetError, Ports, Serving, request_channel, serve,
        wire::{FromServer, unix_now_ns},
    },
};
use rtrb::RingBuffer;
use std::{
    io::{Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

const PERIOD: Duration = Duration::from_millis(1);
const BATCH_BYTES: usize = 7000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seconds: u64 = std::env::args()
        .skip(1)
        .find(|argument| argument != "--bench")
        .map_or(Ok(25), |number| number.parse())?;
    let (mut samples, from_loop) = RingBuffer::new(4096);
    let (requests, _robot) = request_channel();
    let ring_dropped = Arc::new(AtomicU64::new(0));
    let ports = Ports {
        samples: from_loop,
        requests,
        ring_dropped: Arc::clone(&ring_dropped),
        recorder: None,
        calibration: None,
        judge: None,
    };
    let any = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0).into();
    let server = serve(&any, Serving::this_user()?, RobotDescription::paper("latency", true), ports)?;

    let stop = Arc::new(AtomicBool::new(false));
    let address = server.address().clone();
    let readers: Vec<_> = (0..2)
        .map(|_| {
            let address = address.clone();
            thread::spawn(move || read(&address))
        })
        .collect();
    let stopped = TcpStream::connect(address.tcp().ok_or("no port")?)?;
    let echo_stop = Arc::clone(&stop);
    let echo = thread::spawn(move || echo(&echo_stop));
    thread::sleep(Duration::from_millis(200));

    let start = Instant::now();
    let mut resident_half_kb = 0;
    let ticks = seconds * 1000;
    for tick in 0..ticks {
        let mut sample = Sample { tick, time_ns: unix_now_ns(), ..Sample::default() };
        sample.taxels.extend([moca_msgs::TaxelReading::default(); 11]);
        sample.counts.extend([720; 11]);
        sample.q_rad.extend([0.1; 7]);
        sample.dq_rad_s.extend([0.1; 7]);
        sample.arm_torque_nm.extend([0.1; 7]);
        if samples.push(sample).is_err() {
            ring_dropped.fetch_add(1, Ordering::Relaxed);
        }
        if tick == ticks / 2 {
            // By now the kernel's buffers and the queue of the stopped subscriber are full.
            resident_half_kb = resident_kb();
        }
        let due = start + PERIOD * u32::try_from(tick + 1)?;
        thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    let resident_end_kb = resident_kb();
    thread::sleep(Duration::from_millis(100));
    let stats = server.stats();
    stop.store(true, Ordering::Relaxed);
    drop(server);
    drop(stopped);

    println!("{seconds} s of samples at 1 kHz, two readers and one subscriber that never reads\n");
    println!("{:<52} {:>8} {:>8} {:>8}", "µs", "p50", "p99", "max");
    let mut lost = Vec::new();
    for (i, reader) in readers.into_iter().enumerate() {
        let r = reader.join().map_err(|_| "a reader panicked")?;
        print_row(&format!("reader {}: batch from send to receipt", i + 1), r.transit_us);
        print_row(&format!("reader {}: age of a sample at receipt", i + 1), r.age_us);
        lost.push(ticks - r.samples);
    }
    let echo = echo.join().map_err(|_| "the echo panicked")??;
    print_row(&format!("bare TCP echo of {BATCH_BYTES} bytes, there and back"), echo);
    println!(
        "\nsamples lost by the readers: {lost:?}; by the loop's ring: {}",
        ring_dropped.load(Ordering::Relaxed)
    );
    println!("samples dropped for the stopped subscriber: {}", stats.client_dropped);
    println!("longest queue: {} batches", stats.longest_queue);
    println!("resident memory: {resident_half_kb} kB half-way, {resident_end_kb} kB at the end");
    Ok(())
}

#[derive(Default)]
struct Received {
    transit_us: Vec<u64>,
    age_us: Vec<u64>,
    samples: u64,
}

fn read(address: &Address) -> Received {
    // Reserved at once, so that the measurement itself does not show up as memory that grows.
    let mut received =
        Received { transit_us: Vec::with_capacity(1 << 16), age_us: Vec::with_capacity(1 << 20), samples: 0 };
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else {
        return received;
    };
    // Ends with the server.
    let _: Result<(), NetError> = runtime.block_on(async {
        let mut client = Client::connect(address).await?;
        loop {
            let FromServer::Batch(batch) = client.incoming.next().await? else { continue };
            let now = unix_now_ns();
            received.transit_us.push(now.saturating_sub(batch.sent_unix_ns) / 1000);
            received.age_us.extend(batch.samples.iter().map(|s| now.saturating_sub(s.time_ns) / 1000));
            received.samples += batch.samples.len() as u64;
        }
    });
    received
}

fn echo(stop: &AtomicBool) -> std::io::Result<Vec<u64>> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let mut near = TcpStream::connect(listener.local_addr()?)?;
    let (mut far, _) = listener.accept()?;
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    thread::spawn(move || {
        let mut bytes = [0; BATCH_BYTES];
        while far.read_exact(&mut bytes).is_ok() && far.write_all(&bytes).is_ok() {}
    });
    let mut bytes = [7; BATCH_BYTES];
    let mut times = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        let sent = Instant::now();
        near.write_all(&bytes)?;
        near.read_exact(&mut bytes)?;
        times.push(u64::try_from(sent.elapsed().as_micros()).unwrap_or(u64::MAX));
        thread::sleep(Duration::from_millis(10));
    }
    Ok(times)
}

fn print_row(name: &str, mut us: Vec<u64>) {
    us.sort_unstable();
    let at =
        |part: usize| us.get((us.len() * part / 1000).min(us.len().saturating_sub(1))).copied().unwrap_or(0);
    println!("{name:<52} {:>8} {:>8} {:>8}", at(500), at(990), at(1000));
}

/// Resident memory of this process, kB (Linux).
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    line.and_then(|l| l.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

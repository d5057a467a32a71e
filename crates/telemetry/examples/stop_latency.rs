//! Times a stop takes while others do their worst, over a Unix socket and TCP: from the call of a client that is not
//! connected yet to the answer of a loop of 1 kHz.
//!
//! `cargo run --release -p moca-telemetry --features testing --example stop_latency [ADDRESS]`; with an address it attacks
//! the daemon there, and stops its robot.
#![allow(clippy::print_stdout, reason = "the figures are what it is for")]

use moca_telemetry::RobotDescription;
use moca_telemetry::net::testing::{Attack, Siege, stop_latencies};
use moca_telemetry::net::{Address, Ports, Server, Serving, request_channel, serve};
use rtrb::RingBuffer;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const STOPS: usize = 400;
const PERIOD: Duration = Duration::from_millis(1);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    if let Some(address) = std::env::args().nth(1) {
        return measure(&address.parse()?);
    }
    let socket = std::env::temp_dir().join(format!("stop-latency-{}.sock", std::process::id()));
    for address in [Address::Unix(socket), "127.0.0.1:0".parse()?] {
        let ended = Arc::new(AtomicBool::new(false));
        let (server, robot) = robot(&address, Arc::clone(&ended))?;
        println!("{}", if address.tcp().is_some() { "TCP" } else { "Unix socket" });
        measure(server.address())?;
        ended.store(true, Ordering::Relaxed);
        // A panic there has been printed by its own thread.
        let _ = robot.join();
    }
    Ok(())
}

/// A server and a loop that sends a sample and takes one request each millisecond.
fn robot(
    address: &Address,
    ended: Arc<AtomicBool>,
) -> Result<(Server, std::thread::JoinHandle<()>), Box<dyn std::error::Error>> {
    let (mut samples, from_loop) = RingBuffer::new(4096);
    let (requests, mut asked) = request_channel();
    let ports = Ports {
        samples: from_loop,
        requests,
        ring_dropped: Arc::default(),
        recorder: None,
        calibration: None,
        judge: None,
    };
    // The attackers and the server are of one user, who has one token.
    let server = serve(address, Serving::this_user()?, RobotDescription::paper("stop latency", true), ports)?;
    let robot = std::thread::spawn(move || {
        let mut sample = moca_msgs::Sample::default();
        while !ended.load(Ordering::Relaxed) {
            if let Some((ticket, _)) = asked.take() {
                asked.answer(ticket, Ok(()));
            }
            sample.tick += 1;
            // A full ring drops the sample, as in the real loop.
            let _ = samples.push(sample.clone());
            std::thread::sleep(PERIOD);
        }
    });
    Ok((server, robot))
}

fn measure(address: &Address) -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "| others do | stops | p50 ms | p99 ms | largest ms | requests a second |\n|---|---|---|---|---|---|"
    );
    for attack in Attack::ALL {
        let siege = Siege::begin(address, attack)?;
        std::thread::sleep(Duration::from_secs(1));
        let (before, start) = (siege.requests(), std::time::Instant::now());
        let latencies = stop_latencies(address, STOPS)?;
        #[expect(clippy::cast_precision_loss, reason = "some millions")]
        let rate = (siege.requests() - before) as f64 / start.elapsed().as_secs_f64();
        let ms = |quantile: usize| 1e3 * latencies[(STOPS * quantile / 100).min(STOPS - 1)].as_secs_f64();
        println!(
            "| {} | {STOPS} | {:.1} | {:.1} | {:.1} | {rate:.0} |",
            attack.name(),
            ms(50),
            ms(99),
            ms(100)
        );
    }
    Ok(())
}

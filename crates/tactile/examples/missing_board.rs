//! Cost of the reader while it looks for a board that is missing:
//! `cargo run --release -p moca-tactile --features serial --example missing_board`.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a measurement for the terminal")]

use moca_tactile::serial::{PortSelection, SerialBoard};
use std::time::{Duration, Instant};

const LENGTH: Duration = Duration::from_secs(20);
/// Ticks a second of /proc/self/stat, the same on every Linux of this architecture.
const CLOCK_TICKS_PER_S: f64 = 100.0;

/// CPU time of this process, s: fields 14 and 15 of proc(5).
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let after_name = stat.rsplit(')').next().unwrap();
    after_name.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<f64>().unwrap()).sum::<f64>()
        / CLOCK_TICKS_PER_S
}

fn main() {
    for (name, port) in [
        ("by USB id", PortSelection::default()),
        ("by path", PortSelection::Path("/dev/no-such-touch-board".into())),
    ] {
        let (reader, mut events) = SerialBoard::spawn(port, Instant::now()).unwrap();
        let (before, started) = (cpu_s(), Instant::now());
        std::thread::sleep(LENGTH);
        let share = (cpu_s() - before) / started.elapsed().as_secs_f64();
        let tries = std::iter::from_fn(|| events.pop().ok()).count();
        drop(reader);
        println!("{name}: {:.2} % of a core over {} s, {tries} events", 1e2 * share, LENGTH.as_secs());
    }
}

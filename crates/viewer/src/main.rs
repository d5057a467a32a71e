//! moca-viewer: a running robot in Foxglove, Lichtblick and PlotJuggler, read-only.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that says where it listens")]

use clap::Parser;
use moca_telemetry::net::Address;
use moca_viewer::{DEFAULT_PORT, Options, origin::Origins, serve};
use std::net::{Ipv4Addr, SocketAddr};

/// Shows a running robot in Foxglove, Lichtblick and PlotJuggler. Read-only: nothing that a viewer does reaches the robot.
#[derive(Parser)]
#[command(name = "moca-viewer", version)]
struct Arguments {
    /// The daemon: HOST:PORT or unix:/PATH; without it the one of this machine.
    #[arg(long, value_name = "ADDRESS")]
    address: Option<Address>,
    /// Address for viewers, on loopback; port 0 picks a free one.
    #[arg(long, value_name = "ADDRESS", default_value_t = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), DEFAULT_PORT))]
    listen: SocketAddr,
    /// A web page that may connect, as its browser says it: https://HOST. May be given more than once.
    #[arg(long, value_name = "ORIGIN")]
    allow_origin: Vec<String>,
    /// Rate of numbers, Hz, at most once a tick; transforms and poses come at most at 100 Hz.
    #[arg(long, value_name = "HZ", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    rate: u32,
}

fn main() -> anyhow::Result<()> {
    let arguments: Arguments = moca_manual::parse("moca-viewer", &[]);
    let options = Options {
        daemon: arguments.address.unwrap_or_else(Address::of_this_machine_to_watch),
        listen: arguments.listen,
        origins: Origins::new(arguments.allow_origin),
        rate_hz: arguments.rate,
    };
    let daemon = options.daemon.clone();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(serve(options, |address| {
        println!("listening on ws://{address} for Foxglove, Lichtblick and PlotJuggler; robot: {daemon}");
    }))
}

#[cfg(test)]
mod tests {
    #[test]
    fn chapter_of_the_docs_is_what_the_command_line_says() {
        assert_eq!(moca_manual::check_chapter::<super::Arguments>("moca-viewer"), Ok(()));
    }
}

//! `moca-lab clients`: what watching costs the live loop, with and without clients in one run.
#![expect(clippy::print_stdout, reason = "a command prints its result")]

use anyhow::{Context, Result};
use moca_control::config::Config;
use moca_control::stage::Stage;
use moca_daemon::runtime::live::Shared;
use moca_daemon::runtime::notice::Silent;
use moca_daemon::runtime::options::Options;
use moca_daemon::runtime::run::{LiveRun, live_simulated};
use moca_figures::progress;
use moca_telemetry::net::{Address, Connection};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::time::Duration;

/// Prints the cost of observers to the live loop: overruns and publish stage with and without clients.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Length of each of the two runs, s, 2 to 3600.
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    anyhow::ensure!(
        (2.0..=3600.0).contains(&arguments.seconds),
        "--seconds {} s is outside 2 to 3600 s",
        arguments.seconds
    );
    let duration = Duration::from_secs_f64(arguments.seconds);
    println!("-- nobody watches");
    let alone = live(duration, None)?;
    println!("-- three clients: one reads, one is killed half way, one never reads");
    let socket = std::env::temp_dir().join(format!("moca-clients-{}.sock", std::process::id()));
    let address = Address::Unix(socket.clone());
    let watched_at = address.clone();
    let clients = std::thread::spawn(move || {
        // The daemon needs a moment to listen.
        std::thread::sleep(Duration::from_millis(500));
        let _never_reads = UnixStream::connect(socket).context("no telemetry")?;
        watch(&watched_at, duration)
    });
    let watched = live(duration, Some(&address))?;
    let received = clients.join().map_err(|_| anyhow::anyhow!("the clients' thread panicked"))??;
    println!("\n{:<34} {:>12} {:>12}", "", "nobody", "three");
    let row = |name: &str, of: &dyn Fn(&LiveRun) -> String| {
        println!("{name:<34} {:>12} {:>12}", of(&alone), of(&watched))
    };
    row("ticks", &|run| run.report.ticks.to_string());
    row("overruns (slots skipped)", &|run| run.report.overruns.to_string());
    let publish = |run: &LiveRun, quantile| {
        format!("{:.1}", run.timing.stages[Stage::Publish as usize].quantile_us(quantile))
    };
    row("publish stage p50, µs", &|run| publish(run, 0.5));
    row("publish stage p99.9, µs", &|run| publish(run, 0.999));
    row("lateness p99.9, µs", &|run| format!("{:.1}", run.timing.lateness.quantile_us(0.999)));
    println!("the client that reads received {received} samples");
    Ok(())
}

fn live(duration: Duration, telemetry: Option<&Address>) -> Result<LiveRun> {
    let mut config = Config::default();
    config.telemetry.listen = telemetry.map(|address| address.to_string()).unwrap_or_default();
    let options = Options { config, duration: Some(duration), ..Options::default() };
    let _bar = progress::during("clients", duration);
    live_simulated(&options, &Arc::new(Shared::default()), &mut Silent)
}

fn watch(address: &Address, duration: Duration) -> Result<usize> {
    let mut killed = Some(Connection::spawn(address, || {})?);
    let reads = Connection::spawn(address, || {})?;
    let (step, mut received) = (Duration::from_millis(20), 0);
    let steps = duration.saturating_sub(Duration::from_secs(1)).as_millis() / step.as_millis();
    for i in 0..steps {
        received += reads.poll().samples.len();
        if i == steps / 2 {
            killed = None;
        }
        std::thread::sleep(step);
    }
    drop(killed);
    Ok(received)
}

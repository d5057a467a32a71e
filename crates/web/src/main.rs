//! moca-web: a page for the tablet, phone or laptop of the person next to the robot.
#![allow(clippy::print_stdout, reason = "a program that says where it listens")]

use anyhow::{Context, bail, ensure};
use clap::{Args, Parser, Subcommand};
use moca_telemetry::net::{
    Address,
    fleet::{self, Entry},
};
use moca_web::{
    DEFAULT_LEASE_MS, DEFAULT_PORT, Listening, Options, SiteCertificate,
    access::{
        Role,
        devices::{CODE_LIFE_S, Store},
    },
    serve,
};
use std::{
    env, fs,
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    time::Duration,
};

/// A page for the tablet, phone or laptop of the person next to the robot.
#[derive(Parser)]
#[command(name = "moca-web", version)]
struct Arguments {
    /// Folder of devices, certificates and the audit; without it that of the service or of this user.
    #[arg(long, global = true, value_name = "FOLDER")]
    state: Option<PathBuf>,
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: Serve,
}

#[derive(Subcommand)]
enum Command {
    /// Prints a code that pairs one device within two minutes.
    Pair {
        /// Rights of the device: viewer, operator or maintainer.
        role: Role,
    },
    /// Lists the paired devices.
    Devices,
    /// Takes the rights of a device away at once.
    Revoke {
        /// Its name, as moca-web devices lists it.
        name: String,
    },
}

#[derive(Args)]
struct Serve {
    /// The daemon: HOST:PORT or unix:/PATH; without it the one of this machine.
    #[arg(long, value_name = "ADDRESS")]
    address: Option<Address>,
    /// Address for browsers: 0.0.0.0:7643 for every network of this machine; port 0 for any.
    #[arg(long, value_name = "ADDRESS", default_value_t = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), DEFAULT_PORT))]
    listen: SocketAddr,
    /// A name or address under which browsers reach the robot; may be given more than once. Without it this machine's name,
    /// that name with .local, localhost and 127.0.0.1.
    #[arg(long, value_name = "NAME")]
    name: Vec<String>,
    /// Folder of the robot's logs.
    #[arg(long, value_name = "FOLDER")]
    logs: Option<PathBuf>,
    /// A list of other robots to show at a glance: robots.toml, see docs/fleet.md.
    #[arg(long, value_name = "FILE")]
    robots: Option<PathBuf>,
    /// A certificate of the site's own, a chain in PEM, instead of one by the robot's authority.
    #[arg(long, value_name = "FILE", requires = "key")]
    certificate: Option<PathBuf>,
    /// The key of that certificate in PEM.
    #[arg(long, value_name = "FILE", requires = "certificate")]
    key: Option<PathBuf>,
    /// Largest age of the newest picture that the page that holds has drawn, ms, 200 to 1000; beyond it the robot stops.
    #[arg(long, value_name = "MS", default_value_t = DEFAULT_LEASE_MS)]
    lease_ms: u64,
}

fn main() -> anyhow::Result<()> {
    let arguments: Arguments = moca_manual::parse("moca-web", &[]);
    let state = arguments.state.map_or_else(|| home("STATE_DIRECTORY", "moca-web"), Ok)?;
    match arguments.command {
        None => run(state, arguments.serve),
        Some(Command::Pair { role }) => {
            let code = Store::open(&state)?.new_code(role)?;
            let (left, right) = code.split_at(code.len() / 2);
            // At once: a reader of the first line alone closes the pipe.
            println!(
                "{left}-{right}\nType it on the device within {CODE_LIFE_S} s; its role is {}.",
                role.name()
            );
            Ok(())
        }
        Some(Command::Devices) => {
            for device in Store::open(&state)?.devices()?.values() {
                println!("{:12}{}", device.role.name(), device.name);
            }
            Ok(())
        }
        Some(Command::Revoke { name }) => {
            ensure!(
                Store::open(&state)?.revoke(&name)? > 0,
                "no device is called {name:?}: see moca-web devices"
            );
            println!("{name} is no longer let in");
            Ok(())
        }
    }
}

fn run(state: PathBuf, serve_arguments: Serve) -> anyhow::Result<()> {
    let Serve { address, listen, name, logs, robots, certificate, key, lease_ms } = serve_arguments;
    let names = if name.is_empty() { names_of_this_machine() } else { name };
    let options = Options {
        daemon: address.unwrap_or_else(Address::of_this_machine),
        listen,
        names,
        state,
        logs: logs.map_or_else(|| home("LOGS_DIRECTORY", "mocad"), Ok)?,
        robots: robots.map_or_else(|| Ok(Vec::new()), |file| read_robots(&file))?,
        site: certificate.zip(key).map(|(chain, key)| SiteCertificate { chain, key }),
        lease: Duration::from_millis(lease_ms),
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(serve(options, |Listening { pages, fingerprint, .. }| {
        println!("{}", pages.join("  "));
        if let Some(fingerprint) = fingerprint {
            println!("certificate authority {fingerprint}");
        }
    }))
}

/// The folder that systemd names, or else one of this user.
fn home(variable: &str, name: &str) -> anyhow::Result<PathBuf> {
    if let Some(folder) = env::var_os(variable).filter(|folder| !folder.is_empty()) {
        return Ok(folder.into());
    }
    if let Some(folder) = env::var_os("XDG_STATE_HOME").filter(|folder| !folder.is_empty()) {
        return Ok(PathBuf::from(folder).join(name));
    }
    match env::var_os("HOME") {
        Some(home) => Ok(PathBuf::from(home).join(".local/state").join(name)),
        None => bail!("neither {variable} nor HOME is set: give --state and --logs"),
    }
}

fn read_robots(file: &Path) -> anyhow::Result<Vec<Entry>> {
    let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
    fleet::parse(&text).with_context(|| file.display().to_string())
}

fn names_of_this_machine() -> Vec<String> {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").context("no host name").unwrap_or_default();
    let host = host.trim().to_ascii_lowercase();
    let own = [host.clone(), format!("{host}.local")].into_iter().filter(|_| !host.is_empty());
    own.chain(["localhost".to_owned(), "127.0.0.1".to_owned()]).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn chapter_of_the_docs_is_what_the_command_line_says() {
        assert_eq!(moca_manual::check_chapter::<super::Arguments>("moca-web"), Ok(()));
    }
}

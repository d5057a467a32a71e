//! A page for the person next to the robot: tablet, phone or laptop, over HTTPS and a WebSocket. The gateway is a client of the
//! daemon like any other; when it ends, a robot that it held stops by the daemon's own rule.
//!
//! Layers: [`access`] (who may come in, and ask what) · `rate`, `audit` · `look` (newest state), `feed` (the connection that
//! watches and stops) · `link`, `holder` (the connection that commands) · `picture`, `said` (state for a page) · `ears`,
//! `session` (one page) · `robots` (others at a glance) · `gateway`, `guard`, `routes`, `socket`, `acceptor` (HTTP and TLS) · [`serve`].
//!
//! This crate refuses to know: control laws, the simulation, the board.

mod acceptor;
pub mod access;
mod assets;
mod audit;
mod ears;
mod feed;
mod gateway;
mod guard;
mod holder;
mod link;
mod logs;
mod look;
mod picture;
mod rate;
mod robots;
mod routes;
mod said;
mod session;
mod socket;

pub use access::authority::SiteCertificate;

use access::{
    authority::{self, Identity},
    devices::Store,
};
use anyhow::ensure;
use audit::Audit;
use gateway::{Gateway, Parts};
use holder::Commander;
use look::Look;
use moca_telemetry::net::{Address, fleet::Entry};
use std::{net::SocketAddr, path::PathBuf, sync::Arc, time::Duration};
use tokio::sync::watch;

/// Port of the page.
pub const DEFAULT_PORT: u16 = 7643;
/// Life of a sign of life, ms.
pub const DEFAULT_LEASE_MS: u64 = 400;
/// Allowed lives of a sign of life, ms.
pub const LEASE_MS: std::ops::RangeInclusive<u64> = 200..=1000;
/// Pause before certificates are looked at again.
const CERTIFICATES_EVERY: Duration = Duration::from_secs(12 * 3600);

/// Choices of a gateway's owner.
#[derive(Clone, Debug)]
pub struct Options {
    /// The daemon.
    pub daemon: Address,
    /// Address for browsers.
    pub listen: SocketAddr,
    /// Names and addresses under which browsers reach the robot.
    pub names: Vec<String>,
    /// Folder of devices, codes, certificates and the audit.
    pub state: PathBuf,
    /// Folder of the robot's logs.
    pub logs: PathBuf,
    /// Other robots to show at a glance.
    pub robots: Vec<Entry>,
    /// A certificate of the site's own instead of the robot's.
    pub site: Option<SiteCertificate>,
    /// Life of a sign of life of the page that holds, [`LEASE_MS`].
    pub lease: Duration,
}

/// Addresses of a gateway that listens.
#[derive(Clone, Debug)]
pub struct Listening {
    /// Address, with the port that the system chose.
    pub address: SocketAddr,
    /// Pages under which browsers reach it.
    pub pages: Vec<String>,
    /// SHA-256 of the authority's certificate; `None` with a certificate of the site's own.
    pub fingerprint: Option<String>,
}

/// Serves until the process ends.
///
/// # Errors
/// A folder, certificate or address that cannot be used. A daemon that is away is no error: it is waited for.
pub async fn serve(options: Options, listening: impl FnOnce(Listening)) -> anyhow::Result<()> {
    let lease_ms = u64::try_from(options.lease.as_millis()).unwrap_or(u64::MAX);
    ensure!(
        LEASE_MS.contains(&lease_ms),
        "a lease of {lease_ms} ms is outside {} to {} ms",
        LEASE_MS.start(),
        LEASE_MS.end()
    );
    let names: Vec<String> = options.names.iter().map(|name| name.to_ascii_lowercase()).collect();
    let store = Store::open(&options.state)?;
    let identity = authority::load(&options.state, &names, options.site.as_ref())?;
    let audit = Arc::new(Audit::open(&options.state)?);
    let listener = acceptor::bind(options.listen)?;
    let address = listener.local_addr()?;
    let (look_to, look) = watch::channel(Look::default());
    let (stops, newest_stop) = watch::channel(feed::NewestStop::default());
    tokio::spawn(feed::follow(options.daemon.clone(), look_to, newest_stop, Arc::clone(&audit)));
    let commander = Commander::new(options.daemon, options.lease, look.clone(), Arc::clone(&audit));
    let (config_to, config) = watch::channel(Arc::clone(&identity.config));
    let fingerprint = identity.fingerprint.clone();
    let hosts = names.iter().flat_map(|name| hosts(name, address.port())).collect();
    let (logs, robots) = (options.logs, robots::Robots::new(options.robots));
    tokio::spawn(Arc::clone(&robots).look_away());
    let gateway =
        Gateway::new(Parts { hosts, store, audit, look, stops, commander, identity, logs, robots })?;
    tokio::spawn(Arc::clone(&gateway).follow_devices());
    let renewed = (options.state, names.clone(), options.site);
    tokio::spawn(renew(renewed, config_to, Arc::clone(&gateway)));
    let page = |name: &String| format!("https://{}:{}/", bracketed(name), address.port());
    listening(Listening { address, pages: names.iter().map(page).collect(), fingerprint });
    acceptor::serve(listener, config, routes::routes(gateway)).await;
    Ok(())
}

/// Certificates that are due are renewed while the gateway runs, and a site's own are read again.
async fn renew(
    (folder, names, site): (PathBuf, Vec<String>, Option<SiteCertificate>),
    config: watch::Sender<Arc<rustls::ServerConfig>>,
    gateway: Arc<Gateway>,
) {
    loop {
        tokio::time::sleep(CERTIFICATES_EVERY).await;
        match authority::load(&folder, &names, site.as_ref()) {
            Ok(Identity { config: renewed, .. }) => drop(config.send_replace(renewed)),
            Err(error) => {
                gateway.audit.note("gateway", "certificates cannot be renewed", format!("{error:#}"))
            }
        }
    }
}

/// `Host` headers of a name; browsers leave the default port out.
fn hosts(name: &str, port: u16) -> Vec<String> {
    let name = bracketed(name);
    let mut hosts = vec![format!("{name}:{port}")];
    if port == 443 {
        hosts.push(name);
    }
    hosts
}

/// An IPv6 address as it stands in a URL.
fn bracketed(name: &str) -> String {
    if name.contains(':') { format!("[{name}]") } else { name.to_owned() }
}

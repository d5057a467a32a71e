//! The parts of a running gateway that its pages share.

use crate::{
    access::{
        authority::Identity,
        devices::{Device, Devices, Store, device_of, now_unix_s},
    },
    audit::Audit,
    feed::NewestStop,
    holder::{Commander, PageId},
    look::Look,
    rate::{Rate, Rates},
    robots::Robots,
};
use axum::http::{HeaderMap, header};
use std::{
    net::IpAddr,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};
use tokio::sync::{Semaphore, watch};

/// Name of the cookie. Browsers take one with this prefix only from a secure page of exactly this host.
pub(crate) const COOKIE: &str = "__Host-moca";
/// Pages that are served at the same time.
pub(crate) const PAGES_MAX: usize = 16;
/// HTTP requests of one address.
const REQUESTS: Rate = Rate { burst: 100.0, per_s: 50.0 };
/// Addresses with a bound of their own.
const ADDRESSES_MAX: usize = 1024;
/// Pause before the files of devices are read again.
const DEVICES_EVERY: Duration = Duration::from_millis(200);

/// Shared parts.
pub(crate) struct Gateway {
    /// `Host` headers under which this robot is known; after `https://` the allowed `Origin`.
    pub(crate) hosts: Vec<String>,
    pub(crate) store: Store,
    pub(crate) devices: watch::Sender<Devices>,
    pub(crate) audit: Arc<Audit>,
    pub(crate) look: watch::Receiver<Look>,
    pub(crate) stops: watch::Sender<NewestStop>,
    pub(crate) commander: Arc<Commander>,
    pub(crate) identity: Identity,
    pub(crate) logs: PathBuf,
    pub(crate) robots: Arc<Robots>,
    pub(crate) pages: Arc<Semaphore>,
    next_page: AtomicU64,
    requests: Mutex<Rates<IpAddr>>,
}

/// Parts that a gateway is made of.
pub(crate) struct Parts {
    pub(crate) hosts: Vec<String>,
    pub(crate) store: Store,
    pub(crate) audit: Arc<Audit>,
    pub(crate) look: watch::Receiver<Look>,
    pub(crate) stops: watch::Sender<NewestStop>,
    pub(crate) commander: Arc<Commander>,
    pub(crate) identity: Identity,
    pub(crate) logs: PathBuf,
    pub(crate) robots: Arc<Robots>,
}

impl Gateway {
    pub(crate) fn new(parts: Parts) -> anyhow::Result<Arc<Self>> {
        let Parts { hosts, store, audit, look, stops, commander, identity, logs, robots } = parts;
        let (devices, _) = watch::channel(present(store.devices()?));
        Ok(Arc::new(Self {
            hosts,
            store,
            devices,
            audit,
            look,
            stops,
            commander,
            identity,
            logs,
            robots,
            pages: Arc::new(Semaphore::new(PAGES_MAX)),
            next_page: AtomicU64::new(1),
            requests: Mutex::new(Rates::new(REQUESTS, ADDRESSES_MAX, std::time::Instant::now())),
        }))
    }

    /// Reads the devices again for ever. Files that cannot be read let nobody in.
    pub(crate) async fn follow_devices(self: Arc<Self>) {
        loop {
            tokio::time::sleep(DEVICES_EVERY).await;
            self.read_devices();
        }
    }

    /// Reads the devices again now.
    pub(crate) fn read_devices(&self) {
        let devices = self.store.devices().map(present).unwrap_or_else(|error| {
            self.audit.note("gateway", "devices cannot be read: nobody is let in", format!("{error:#}"));
            Devices::default()
        });
        self.devices.send_if_modified(|present| {
            let changed = *present != devices;
            *present = devices;
            changed
        });
    }

    /// The paired device that a request comes from, with its key.
    pub(crate) fn device(&self, headers: &HeaderMap) -> Option<(String, Device)> {
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut tokens = cookies
            .flat_map(|cookies| cookies.split(';'))
            .filter_map(|cookie| cookie.trim().strip_prefix(COOKIE)?.strip_prefix('='));
        let devices = self.devices.borrow();
        device_of(&devices, tokens.next()?).map(|(key, device)| (key.clone(), device.clone()))
    }

    /// Stops the robot; the number of this stop.
    pub(crate) fn stop(&self, who: &str) -> u64 {
        self.stops.send_modify(|newest| *newest = NewestStop { number: newest.number + 1, who: who.into() });
        self.stops.borrow().number
    }

    /// Stops asked for and seen so far: what began before the newest one moves nothing.
    pub(crate) fn stop_count(&self) -> u64 {
        self.stops.borrow().number + self.look.borrow().stops
    }

    /// Number of a new page.
    pub(crate) fn new_page(&self) -> PageId {
        self.next_page.fetch_add(1, Ordering::Relaxed)
    }

    /// Tells if this address may send one more request now.
    pub(crate) fn admits(&self, address: IpAddr) -> bool {
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        requests.take(address, std::time::Instant::now())
    }
}

/// The devices whose time is not over: a page that is open ends with it.
fn present(mut devices: Devices) -> Devices {
    devices.retain(|_, device| device.until_unix_s > now_unix_s());
    devices
}

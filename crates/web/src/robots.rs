//! Other robots at a glance. They are watched only while somebody looks: each costs a connection and a thread.

use moca_telemetry::net::fleet::{Entry, Fleet, Watched};
use serde_json::{Value, json};
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use tokio::time::Instant;

/// Nobody has looked for so long: the connections are closed.
const LOOKS_AWAY: Duration = Duration::from_secs(10);

type Watching = Option<(Fleet, Instant)>;

/// The robots of a list.
pub(crate) struct Robots {
    list: Vec<Entry>,
    watching: Mutex<Watching>,
}

impl Robots {
    pub(crate) fn new(list: Vec<Entry>) -> Arc<Self> {
        Arc::new(Self { list, watching: Mutex::new(None) })
    }

    /// Every robot of the list as JSON; empty without a list.
    pub(crate) fn look(&self) -> anyhow::Result<Value> {
        let mut watching = self.watching();
        let (fleet, looked) = match &mut *watching {
            Some(watching) => watching,
            none => none.insert((Fleet::watch(self.list.clone())?, Instant::now())),
        };
        *looked = Instant::now();
        Ok(fleet.poll().iter().map(shown).collect())
    }

    /// Closes the connections whenever nobody looks, for ever.
    pub(crate) async fn look_away(self: Arc<Self>) {
        loop {
            tokio::time::sleep(LOOKS_AWAY).await;
            let idle = self.watching().take_if(|(_, looked)| looked.elapsed() > LOOKS_AWAY);
            // Its threads are waited for.
            let closed = tokio::task::spawn_blocking(move || drop(idle));
            let _ = closed.await;
        }
    }

    fn watching(&self) -> MutexGuard<'_, Watching> {
        self.watching.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn shown(robot: &Watched) -> Value {
    let glance = robot.glance.as_ref();
    json!({
        "name": robot.entry.name,
        "page": robot.entry.page,
        "away": glance.is_none().then_some(&robot.why),
        "mode": glance.map(|glance| glance.mode.name()),
        "fault": glance.and_then(|glance| glance.fault).map(|fault| fault.to_string()),
        "force_n": glance.map(|glance| glance.force_n),
        "taxels_ok": glance.map(|glance| glance.taxels_ok),
        "taxels": glance.map(|glance| glance.taxels),
        "cover_age_s": glance.map(|glance| glance.cover_age_s),
        "age_s": robot.at.map(|at| at.elapsed().as_secs_f64()),
    })
}

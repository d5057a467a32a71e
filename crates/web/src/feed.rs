//! The connection that watches the robot and stops it. It asks for nothing else, so a stop waits behind nothing.

use crate::{audit::Audit, look::Look};
use moca_msgs::{Mode, Refusal, Request};
use moca_telemetry::net::{
    Address, Client, Endpoint, NetError,
    client::{Incoming, Outgoing},
    wire::FromServer,
};
use std::{convert::Infallible, sync::Arc, time::Duration};
use tokio::{
    sync::watch,
    time::{Instant, timeout},
};

/// Pause before the next attempt to connect.
const RETRY: Duration = Duration::from_millis(200);
/// Most time for connecting.
const CONNECT: Duration = Duration::from_secs(2);
/// Longest silence of the daemon: a loop that runs sends 100 batches a second.
const SILENCE: Duration = Duration::from_millis(500);
/// Pause after a stop before the next one is passed on, which then stands for all that came meanwhile.
const STOPS_APART: Duration = Duration::from_millis(5);

/// Newest stop that anybody asked for.
#[derive(Clone, Debug, Default)]
pub(crate) struct NewestStop {
    /// Number of stops so far.
    pub(crate) number: u64,
    /// Device that asked for it.
    pub(crate) who: String,
}

/// Follows the daemon for ever, and passes the newest of the `stops` on.
pub(crate) async fn follow(
    daemon: Address,
    look: watch::Sender<Look>,
    mut stops: watch::Receiver<NewestStop>,
    audit: Arc<Audit>,
) {
    let mut said = String::new();
    loop {
        let Err(error) = session(&daemon, &look, &mut stops, &audit).await;
        let why = format!("{daemon}: {error}");
        if why != said {
            audit.note("robot", "daemon away", why.as_str());
            said.clone_from(&why);
        }
        look.send_modify(|look| {
            look.robot = None;
            look.why = why;
        });
        tokio::time::sleep(RETRY).await;
    }
}

async fn session(
    daemon: &Address,
    look: &watch::Sender<Look>,
    stops: &mut watch::Receiver<NewestStop>,
    audit: &Audit,
) -> anyhow::Result<Infallible> {
    let connected = timeout(CONNECT, Client::connect(Endpoint::from(daemon).to_watch())).await;
    let Client { description, mut incoming, mut outgoing } =
        connected.map_err(|_| NetError::Refused("it does not greet".into()))??;
    look.send_modify(|look| {
        look.robot = Some(Arc::new(description));
        look.at = None;
    });
    let answered = look.borrow().stop_answered;
    tokio::select! {
        end = listen(&mut incoming, look, audit) => end,
        end = pass_stops(&mut outgoing, stops, answered) => Ok(end?),
    }
}

/// Passes on every stop after number `sent`: one that has been answered is not asked for again by a new connection.
async fn pass_stops(
    outgoing: &mut Outgoing,
    stops: &mut watch::Receiver<NewestStop>,
    mut sent: u64,
) -> Result<Infallible, NetError> {
    loop {
        let NewestStop { number, who } = stops.borrow_and_update().clone();
        if number > sent {
            sent = number;
            match outgoing.speak_for(&who).await {
                // A name that the robot's log does not take keeps no stop back.
                Ok(()) | Err(NetError::Name(_)) => {}
                Err(error) => return Err(error),
            }
            outgoing.request(number, Request::Stop).await?;
            tokio::time::sleep(STOPS_APART).await;
        }
        if stops.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

async fn listen(
    incoming: &mut Incoming,
    look: &watch::Sender<Look>,
    audit: &Audit,
) -> anyhow::Result<Infallible> {
    let mut mode = None;
    loop {
        let silent = |_| NetError::Refused("it sends no samples".into());
        match timeout(SILENCE, incoming.next()).await.map_err(silent)?? {
            FromServer::Batch(batch) => {
                let mut stopped = 0;
                for sample in &batch.samples {
                    if mode.replace(sample.mode) != Some(sample.mode) {
                        stopped += u64::from(matches!(sample.mode, Mode::ProtectiveStop | Mode::Fault));
                        let cause = sample.fault.map(|fault| fault.to_string());
                        audit.note("robot", sample.mode.name(), cause);
                    }
                }
                look.send_modify(|look| {
                    look.stops += stopped;
                    look.take(&batch.samples, Instant::now());
                });
            }
            // A robot in a fault has stopped for good: it takes no stop.
            FromServer::Reply { id, outcome: Ok(()) | Err(Refusal::Mode(_)) } => {
                look.send_modify(|look| look.stop_answered = id);
            }
            FromServer::Parameters(changed) => look.send_modify(|look| {
                if let Some(robot) = &mut look.robot {
                    let robot = Arc::make_mut(robot);
                    for (number, values) in &changed {
                        robot.note_parameter(usize::from(*number), values);
                    }
                }
            }),
            FromServer::Status(status) => look.send_modify(|look| look.commander = status.commander),
            FromServer::Calibration(progress) => look.send_modify(|look| look.calibration = progress),
            FromServer::Notice(notice) => look.send_modify(|look| look.notice = notice),
            FromServer::Goodbye(why) => anyhow::bail!(why),
            FromServer::Reply { .. } | FromServer::Welcome(_) => {}
        }
    }
}

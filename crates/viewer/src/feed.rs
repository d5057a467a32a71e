//! The daemon's samples as messages: connects, comes back by itself, and says when there is nothing to show.

use crate::hub::Hub;
use moca_telemetry::{
    RobotDescription,
    display::{Display, Periods, Sink},
    log::{LogError, records::Channel},
    net::{
        Address, Client, Endpoint, NetError,
        client::Incoming,
        wire::{Batch, FromServer},
    },
    ros::{self, Message, cdr::Writer},
};
use std::time::Duration;
use tokio::time::timeout;

/// Pause before the next attempt to connect.
const RETRY: Duration = Duration::from_millis(250);
/// Longest silence of a daemon: a running loop sends 100 batches a second.
const SILENCE: Duration = Duration::from_secs(2);
/// Repeat period of seldom-changing messages, ns of loop time.
const REPEAT_NS: u64 = 1_000_000_000;
/// Shortest period of poses, ns.
const POSES_NS: u64 = 10_000_000;

/// Why a session ended.
#[derive(Debug)]
enum End {
    /// The connection did.
    Net(NetError),
    /// No samples came.
    Silent,
    /// A message could not be made.
    Message(LogError),
}

impl From<NetError> for End {
    fn from(error: NetError) -> Self {
        Self::Net(error)
    }
}

impl From<LogError> for End {
    fn from(error: LogError) -> Self {
        Self::Message(error)
    }
}

/// Feeds the hub, for ever.
pub(crate) async fn feed(daemon: &Address, period_ns: u64, hub: &Hub) {
    loop {
        let Err(end) = session(daemon, period_ns, hub).await;
        let why = match end {
            End::Net(error) => format!("{daemon}: {error}"),
            End::Silent => format!("{daemon} sends no samples"),
            End::Message(error) => error.to_string(),
        };
        hub.end(&why);
        tokio::time::sleep(RETRY).await;
    }
}

async fn session(daemon: &Address, period_ns: u64, hub: &Hub) -> Result<std::convert::Infallible, End> {
    let Client { description, mut incoming, outgoing: _open } =
        timeout(SILENCE, Client::connect(Endpoint::from(daemon).to_watch()))
            .await
            .map_err(|_| End::Silent)??;
    hub.begin(&description);
    let first = next_batch(&mut incoming, hub).await?;
    let mut shown = Shown::begin(&description, &first, period_ns, hub)?;
    hub.announce();
    let mut batch = first;
    loop {
        shown.batch(&batch)?;
        batch = next_batch(&mut incoming, hub).await?;
    }
}

/// The next batch that has samples; parameters that come before it are noted.
async fn next_batch(incoming: &mut Incoming, hub: &Hub) -> Result<Batch, End> {
    let samples = async {
        loop {
            match incoming.next().await? {
                FromServer::Batch(batch) if !batch.samples.is_empty() => return Ok(batch),
                FromServer::Parameters(changed) => hub.note_parameters(|robot| {
                    let note = |(number, values): &(u8, _)| {
                        robot.note_parameter(usize::from(*number), values);
                        Some(robot.parameters.get(usize::from(*number))?.name.clone())
                    };
                    changed.iter().filter_map(note).collect()
                }),
                FromServer::Goodbye(why) => return Err(NetError::Refused(why)),
                _ => {}
            }
        }
    };
    Ok(timeout(SILENCE, samples).await.map_err(|_| End::Silent)??)
}

/// Loop time of the newest sample, ns.
fn newest_ns(batch: &Batch) -> u64 {
    batch.samples.last().map_or(0, |sample| sample.time_ns)
}

struct Shown<'a> {
    display: Display,
    to: ToHub<'a>,
    next_repeat_ns: u64,
}

impl<'a> Shown<'a> {
    fn begin(
        robot: &RobotDescription,
        first: &Batch,
        period_ns: u64,
        hub: &'a Hub,
    ) -> Result<Self, LogError> {
        let start_unix_ns = first.sent_unix_ns.saturating_sub(newest_ns(first));
        let periods =
            Periods { numbers_ns: period_ns, poses_ns: POSES_NS.max(period_ns), fixed_ns: REPEAT_NS };
        let display = Display::new(robot, start_unix_ns, periods);
        let mut to = ToHub { hub, start_unix_ns, cdr: Writer::default(), keeps: true };
        display.begin(&mut to)?;
        to.keeps = false;
        Ok(Self { display, to, next_repeat_ns: 0 })
    }

    fn batch(&mut self, batch: &Batch) -> Result<(), LogError> {
        self.display.follow_clock(batch.sent_unix_ns, newest_ns(batch));
        self.to.start_unix_ns = self.display.start_unix_ns();
        for sample in &batch.samples {
            let again = sample.time_ns >= self.next_repeat_ns;
            if again {
                self.next_repeat_ns = sample.time_ns + REPEAT_NS;
            }
            self.display.sample(sample, again, &mut self.to)?;
        }
        Ok(())
    }
}

struct ToHub<'a> {
    hub: &'a Hub,
    /// Unix time of loop time 0, ns.
    start_unix_ns: u64,
    cdr: Writer,
    /// True while new messages are kept for later viewers.
    keeps: bool,
}

impl Sink for ToHub<'_> {
    fn offer_record<C: Channel + Message>(&mut self) -> Result<(), LogError> {
        self.offer::<C>(C::TOPIC)
    }

    fn offer<M: Message>(&mut self, topic: &'static str) -> Result<(), LogError> {
        self.hub.add(topic, M::TYPE.0, &ros::definition::<M>());
        if !self.keeps {
            self.hub.announce_last();
        }
        Ok(())
    }

    fn record<C: Channel + Message>(&mut self, time_ns: u64, record: &C) -> Result<(), LogError> {
        self.message(C::TOPIC, time_ns, record)
    }

    fn message<M: Message>(
        &mut self,
        topic: &'static str,
        time_ns: u64,
        message: &M,
    ) -> Result<(), LogError> {
        let unix_ns = self.start_unix_ns.saturating_add(time_ns);
        if self.keeps {
            self.hub.keep(topic, unix_ns, self.cdr.encode(message));
        } else if self.hub.is_watched(topic) {
            self.hub.publish(topic, unix_ns, self.cdr.encode(message));
        }
        Ok(())
    }
}

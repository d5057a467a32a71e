//! A connection to the daemon that commands. Dropping it closes it, and the daemon then stops a robot that it had armed.

use moca_msgs::{Outcome, Request};
use moca_telemetry::{
    calibration::CalibrationRequest,
    net::{Address, Client, NetError, client::Outgoing, wire::FromServer},
};
use std::time::Duration;
use tokio::{sync::mpsc, task::JoinHandle, time::timeout};

/// Most time for connecting.
const CONNECT: Duration = Duration::from_millis(500);
/// Most time for an answer: the daemon itself gives up after 500 ms.
const ANSWER: Duration = Duration::from_millis(600);
/// Answers that wait to be read.
const ANSWERS: usize = 16;

/// A connection that commands.
pub(crate) struct Link {
    outgoing: Outgoing,
    answers: mpsc::Receiver<(u64, Outcome)>,
    reader: JoinHandle<()>,
    asked: u64,
}

impl Drop for Link {
    fn drop(&mut self) {
        self.reader.abort();
    }
}

impl Link {
    /// Connects; the daemon takes the command away after `lease` without a sign of life.
    ///
    /// The robot's log names `who` as the one that it speaks for.
    pub(crate) async fn open(daemon: &Address, lease: Duration, who: &str) -> Result<Self, String> {
        let connected = timeout(CONNECT, Client::connect(daemon)).await;
        let Client { mut incoming, mut outgoing, .. } =
            connected.map_err(|_| format!("{daemon} does not answer"))?.map_err(text)?;
        let lease_ms = u16::try_from(lease.as_millis()).unwrap_or(u16::MAX);
        outgoing.lease(lease_ms).await.map_err(text)?;
        outgoing.speak_for(who).await.map_err(text)?;
        let (to, answers) = mpsc::channel(ANSWERS);
        // Reading is not cancel-safe, so it has a task of its own.
        let reader = tokio::spawn(async move {
            while let Ok(message) = incoming.next().await {
                if let FromServer::Reply { id, outcome } = message
                    && to.send((id, outcome)).await.is_err()
                {
                    return;
                }
            }
        });
        Ok(Self { outgoing, answers, reader, asked: 0 })
    }

    /// Asks the loop and awaits its answer.
    pub(crate) async fn ask(&mut self, request: Request) -> Result<(), String> {
        self.asked += 1;
        let id = self.asked;
        self.outgoing.request(id, request).await.map_err(text)?;
        let answer = async {
            loop {
                match self.answers.recv().await {
                    Some((answered, outcome)) if answered == id => {
                        return outcome.map_err(|no| no.to_string());
                    }
                    Some(_) => {}
                    None => return Err("the daemon hung up".into()),
                }
            }
        };
        timeout(ANSWER, answer).await.unwrap_or_else(|_| Err("the daemon does not answer".into()))
    }

    /// Asks the calibrator, whose progress every client sees.
    pub(crate) async fn calibrate(&mut self, request: CalibrationRequest) -> Result<(), String> {
        self.outgoing.calibrate(request).await.map_err(text)
    }

    /// Passes a sign of life on.
    pub(crate) async fn alive(&mut self) -> Result<(), String> {
        self.outgoing.alive().await.map_err(text)
    }

    /// Gives the command back.
    pub(crate) async fn release(&mut self) {
        // A daemon that is gone has no command to take back.
        let _ = self.outgoing.release().await;
    }

    /// Ends when the daemon hangs up. Answers that nobody waits for any more are dropped.
    pub(crate) async fn closed(&mut self) -> String {
        while self.answers.recv().await.is_some() {}
        "the daemon hung up".into()
    }
}

fn text(error: NetError) -> String {
    error.to_string()
}

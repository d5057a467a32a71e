//! A client that is served: what it asks, and what it is sent.

use super::{
    NetError,
    access::{self, Role, least_role},
    command::{Answer, ClientId, trajectory},
    halves::{Reader, Writer},
    hub::{CALIBRATE, Client, Hub},
    queue::Outgoing,
    wire::{self, FromClient, FromServer},
};
use moca_msgs::{Refusal, Request};
use std::{
    rc::Rc,
    time::{Duration, Instant},
};
use tokio::{io::AsyncWriteExt, time::timeout};

/// Most clients that are served at a time: memory is bounded by this times the queue of one. Beyond them there is one place
/// for a commander.
pub(super) const MAX_CLIENTS: usize = 32;
/// Longest time in the commander's place without the command, and longest time without reading.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest time for what a client has said before it hung up.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// Frames of one client that are read before the others have their turn: a flood of one delays nobody's stop.
const FRAMES_PER_TURN: u32 = 16;

/// One client from welcome to goodbye, or until its rights are `over`.
pub(super) async fn attend(
    id: ClientId,
    (role, who): (Role, String),
    (reader, writer): (Reader, Writer),
    over: impl Future<Output = ()>,
    hub: Rc<Hub>,
) {
    let client = hub.admit(id, role, who);
    let requests = read_requests(reader, &client, &hub);
    tokio::pin!(requests);
    tokio::select! {
        _ = &mut requests => {}
        written = write_queue(writer, &client, &hub.welcome) => {
            if written.is_err() {
                // It has hung up, but may have given the command back before: unread, that would stop the robot.
                let _ = timeout(LAST_WORDS, requests).await;
            }
        }
        () = leave_commanders_place(&client, &hub) => {}
        () = over => {}
    }
    hub.lose(id);
}

/// Ends once a client beyond [`MAX_CLIENTS`] has gone without the command for too long; never for any other.
async fn leave_commanders_place(client: &Client, hub: &Hub) {
    loop {
        if hub.clients.borrow().len() <= MAX_CLIENTS {
            return std::future::pending().await;
        }
        tokio::time::sleep(PATIENCE).await;
        let crowded = hub.clients.borrow().len() > MAX_CLIENTS;
        if crowded && !hub.desk.borrow().is_commander(client.id) {
            break;
        }
    }
    let reason = format!("{MAX_CLIENTS} others watch, and the last place is kept for a commander");
    if let Ok(frame) = wire::encode(&FromServer::Goodbye(reason)) {
        client.queue.borrow_mut().set_goodbye(frame);
        client.filled.notify_one();
        // The writer ends when it has written it.
        tokio::time::sleep(PATIENCE).await;
    }
}

/// Hears a client as fast as it reads its answers. One that asks and reads nothing is heard no more, and closed by the writer.
async fn read_requests(mut reader: Reader, client: &Client, hub: &Hub) -> Result<(), NetError> {
    let (mut payload, mut turn) = (Vec::new(), 0);
    loop {
        while !client.queue.borrow().has_room() {
            client.emptied.notified().await;
        }
        wire::read_frame(&mut reader, &mut payload, wire::MAX_CLIENT_FRAME).await?;
        let message = wire::decode_from_client(&payload)?;
        turn += 1;
        // A change of a parameter may take its judge some milliseconds.
        let long = matches!(message, FromClient::Request { request: Request::SetParameter { .. }, .. });
        hear(message, client, hub)?;
        if long || turn >= FRAMES_PER_TURN {
            turn = 0;
            tokio::task::yield_now().await;
        }
    }
}

fn hear(message: FromClient, client: &Client, hub: &Hub) -> Result<(), NetError> {
    let now = Instant::now();
    hub.desk.borrow_mut().hear(client.id, now);
    let may = |least: Option<Role>| least.is_some_and(|least| client.role >= least);
    match message {
        FromClient::Request { id, request: Request::Stop } => hub.stop(client.id, id),
        FromClient::Request { id, request } if !may(least_role(&request)) => {
            hub.reply(&Answer { client: client.id, id, request, outcome: Err(Refusal::ReadOnly) });
        }
        FromClient::Trajectory { id, touch, waypoints } if !may(Some(access::TRAJECTORY)) => {
            let request = trajectory(touch, &waypoints);
            hub.reply(&Answer { client: client.id, id, request, outcome: Err(Refusal::ReadOnly) });
        }
        FromClient::Request { id, request } => {
            let refused = hub.desk.borrow_mut().ask(client.id, id, request, now);
            if let Some(answer) = refused {
                hub.reply(&answer);
            }
            hub.asked.notify_one();
        }
        FromClient::Trajectory { id, touch, waypoints } => {
            let refused = hub.desk.borrow_mut().ask_trajectory(client.id, id, touch, &waypoints, now);
            if let Some(answer) = refused {
                hub.reply(&answer);
            }
            hub.asked.notify_one();
        }
        FromClient::Calibrate(request) if may(Some(access::CALIBRATE)) => hub.calibrate(client, request),
        FromClient::Calibrate(_) => {
            let refused = Err(Refusal::ReadOnly.to_string());
            hub.ledger.borrow_mut().note(&client.who.borrow(), CALIBRATE, refused, now);
        }
        FromClient::Release => {
            if hub.desk.borrow().is_commander(client.id) {
                let answer = Ok(String::new());
                hub.ledger.borrow_mut().note(&client.who.borrow(), "release the command", answer, now);
            }
            hub.desk.borrow_mut().release(client.id);
        }
        FromClient::SpeakFor(name) => client.speak_for(&wire::check_name(name)?),
        FromClient::Lease(lease_ms) => {
            hub.desk.borrow_mut().set_lease(client.id, wire::check_lease(lease_ms)?);
        }
        // A second Hello changes nothing.
        FromClient::Alive | FromClient::Hello { .. } => {}
    }
    Ok(())
}

/// Writes what waits for one client; ends when it says goodbye, hangs up or reads nothing for [`PATIENCE`].
async fn write_queue(mut writer: Writer, client: &Client, welcome: &[u8]) -> Result<(), NetError> {
    write(&mut writer, welcome).await?;
    loop {
        let next = client.queue.borrow_mut().pop();
        match next {
            Some(Outgoing::Batch(batch)) => write(&mut writer, &batch.frame).await?,
            Some(Outgoing::Frame(frame)) => {
                client.emptied.notify_one();
                write(&mut writer, &frame).await?;
            }
            Some(Outgoing::Status(status)) => {
                write(&mut writer, &wire::encode(&FromServer::Status(status))?).await?;
            }
            Some(Outgoing::Goodbye(frame)) => return write(&mut writer, &frame).await,
            None => client.filled.notified().await,
        }
    }
}

pub(super) async fn write(writer: &mut Writer, frame: &[u8]) -> Result<(), NetError> {
    let written = async {
        writer.write_all(frame).await?;
        // TLS keeps what the kernel has no room for.
        writer.flush().await
    };
    Ok(timeout(PATIENCE, written).await.map_err(|_| NetError::Closed)??)
}

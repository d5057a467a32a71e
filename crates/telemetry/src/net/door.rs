//! Connections that are not served yet: each says who it is within a second, and is heard for a stop whatever happens.
//!
//! No number of connections keeps a stop out. Everything here is bounded, and a newcomer pushes out the connection that has
//! stood here longest, so the bytes of the last one to come are read at once.

use super::{
    NetError, Token,
    address::{Listener, Reader, Writer},
    attend::{MAX_CLIENTS, attend, write},
    command::ClientId,
    hub::{Client, Hub, Visitors},
    wire::{self, Challenge, FromClient, FromServer, HELLO_TIMEOUT, MAX_FIRST_FRAME, Role},
};
use moca_msgs::Request;
use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    time::Duration,
};
use tokio::{task::AbortHandle, time::timeout};

/// Most connections that are not served yet: a crowd of a thousand waits its second without pushing anybody out.
const MAX_VISITORS: usize = 2048;
/// Fewest of them that a low limit of descriptors leaves.
const MIN_VISITORS: usize = 64;
/// Descriptors for everything else: served clients, recordings, ports.
const SPARE_DESCRIPTORS: usize = 256;
/// Connections that are taken before the others have their turn; below [`MIN_VISITORS`], so that each is read at least once.
const ACCEPTS_PER_TURN: u32 = 32;
/// Pause when the process is out of descriptors and nobody here can be pushed out.
const OUT_OF_DESCRIPTORS: Duration = Duration::from_millis(1);

/// Entrance of connections, and the roles that they may take.
pub(super) struct Entrance {
    pub(super) listener: Listener,
    /// Asked of those that want to be served.
    pub(super) token: Option<Token>,
    /// The most that a connection may become here.
    pub(super) role: Role,
    /// Random; the challenge of a connection is a keyed hash of its number.
    pub(super) seed: Token,
}

/// Returns the number of visitors that the process's limit of descriptors leaves room for.
fn most_visitors() -> usize {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let files = limits.lines().find_map(|line| line.strip_prefix("Max open files"));
    let soft = files.and_then(|line| line.split_whitespace().next()?.parse::<usize>().ok());
    // "unlimited" is no number.
    soft.map_or(MAX_VISITORS, |soft| soft.saturating_sub(SPARE_DESCRIPTORS).clamp(MIN_VISITORS, MAX_VISITORS))
}

impl Visitors {
    pub(super) fn new() -> Self {
        Self { next_id: Cell::default(), present: RefCell::default(), most: most_visitors() }
    }

    /// The visitor with this number, for answers to its stop.
    pub(super) fn client(&self, id: ClientId) -> Option<Rc<Client>> {
        self.present.borrow().get(&id).map(|(client, _)| Rc::clone(client))
    }

    fn next_id(&self) -> ClientId {
        self.next_id.set(self.next_id.get() + 1);
        self.next_id.get()
    }

    /// Pushes out the one that has stood here longest; whether there was one.
    fn push_out_oldest(&self) -> bool {
        let oldest = self.present.borrow_mut().pop_first();
        oldest.map(|(_, (_, task))| task.abort()).is_some()
    }

    fn enter(&self, client: Rc<Client>, task: AbortHandle) {
        if self.present.borrow().len() >= self.most {
            self.push_out_oldest();
        }
        self.present.borrow_mut().insert(client.id, (client, task));
    }

    fn leave(&self, id: ClientId) {
        self.present.borrow_mut().remove(&id);
    }
}

/// Takes connections as long as the server runs.
pub(super) async fn accept(entrance: Entrance, hub: Rc<Hub>) {
    let (entrance, mut turn) = (Rc::new(entrance), 0);
    loop {
        match entrance.listener.accept().await {
            Ok(halves) => {
                let visitor = Client::new(hub.visitors.next_id(), Role::Observer);
                let stays = receive(Rc::clone(&visitor), halves, Rc::clone(&entrance), Rc::clone(&hub));
                hub.visitors.enter(visitor, tokio::task::spawn_local(stays).abort_handle());
            }
            // Out of descriptors: a later one may succeed once somebody has gone.
            Err(_) if hub.visitors.push_out_oldest() => turn = ACCEPTS_PER_TURN,
            Err(_) => tokio::time::sleep(OUT_OF_DESCRIPTORS).await,
        }
        turn += 1;
        if turn >= ACCEPTS_PER_TURN {
            turn = 0;
            tokio::task::yield_now().await;
        }
    }
}

/// One connection from its first byte on.
async fn receive(
    visitor: Rc<Client>,
    (mut reader, mut writer): (Reader, Writer),
    entrance: Rc<Entrance>,
    hub: Rc<Hub>,
) {
    let said = timeout(HELLO_TIMEOUT, greet(&visitor, &mut reader, &mut writer, &entrance, &hub)).await;
    hub.visitors.leave(visitor.id);
    if let Ok(Ok(role)) = said {
        attend(visitor.id, role, reader, writer, hub).await;
    }
}

/// Hears a connection until it may be served, and says what it is then. One that may not be served is told why, and still
/// heard for a stop.
async fn greet(
    visitor: &Client,
    reader: &mut Reader,
    writer: &mut Writer,
    entrance: &Entrance,
    hub: &Hub,
) -> Result<Role, NetError> {
    let mut number = [0; 32];
    number[..8].copy_from_slice(&visitor.id.to_le_bytes());
    let nonce = entrance.seed.proof(&number);
    let challenge = Challenge { nonce, token_needed: entrance.token.is_some() };
    write(writer, &wire::greeting(&challenge)?).await?;
    let (mut payload, mut refused) = (Vec::new(), false);
    loop {
        wire::read_frame(reader, &mut payload, MAX_FIRST_FRAME).await?;
        match wire::decode_from_client(&payload)? {
            FromClient::Request { id, request: Request::Stop } => {
                hub.stop(visitor.id, id);
                loop {
                    let answer = visitor.queue.borrow_mut().pop_reply();
                    match answer {
                        Some(frame) => break write(writer, &frame).await?,
                        None => visitor.filled.notified().await,
                    }
                }
            }
            FromClient::Hello { role, proof } if !refused => {
                let served = hub.clients.borrow().len();
                match entrance.judge(role, proof.as_ref(), &nonce, served) {
                    Ok(role) => return Ok(role),
                    Err(reason) => {
                        refused = true;
                        write(writer, &wire::encode(&FromServer::Goodbye(reason))?).await?;
                    }
                }
            }
            // Whatever else it asks, it is not served.
            _ => {}
        }
    }
}

impl Entrance {
    /// Returns the role of a client that asks for `role`, while `served` others are served.
    fn judge(
        &self,
        role: Role,
        proof: Option<&[u8; 32]>,
        nonce: &[u8; 32],
        served: usize,
    ) -> Result<Role, String> {
        if let Some(token) = &self.token
            && !proof.is_some_and(|proof| token.admits(nonce, proof))
        {
            return Err(
                "wrong token: this port needs the token file of the daemon's owner (telemetry.token)".into(),
            );
        }
        let role = if self.role == Role::Observer { Role::Observer } else { role };
        // The last place is for whoever wants to command.
        let places = MAX_CLIENTS + usize::from(role == Role::Operator);
        if served >= places {
            return Err(format!(
                "all {MAX_CLIENTS} places and the one for a commander are taken: close a client that only watches"
            ));
        }
        Ok(role)
    }
}

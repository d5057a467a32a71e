//! Connections that are not served yet: each says who it is within a second, and is heard for a stop whatever happens.
//!
//! No number of connections keeps a stop out. Everything here is bounded, and a newcomer pushes out the connection that has
//! stood here longest, so the bytes of the last one to come are read at once.

use super::{
    NetError, Token, access,
    address::{Arrived, Listener},
    attend::{MAX_CLIENTS, attend, write},
    command::ClientId,
    halves::{Reader, Writer},
    hub::{Client, Hub, Visitors},
    wire::{self, Challenge, FromClient, FromServer, HELLO_TIMEOUT, MAX_FIRST_FRAME, Role},
};
#[cfg(feature = "tls")]
use super::{
    strangers::{Place, Strangers},
    tls::{Gate, Proof},
};
use moca_msgs::Request;
use std::{
    cell::{Cell, RefCell},
    net::SocketAddr,
    path::PathBuf,
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
    pub(super) most: access::Role,
    /// Certificates, where clients have to show theirs.
    #[cfg(feature = "tls")]
    pub(super) gate: Option<Gate>,
    /// Random; the challenge of a connection is a keyed hash of its number.
    pub(super) seed: Token,
}

/// A port for programs of other machines, over TLS (feature `tls`).
#[derive(Clone, Debug)]
pub struct TlsPort {
    /// Address on which it listens.
    pub listen: SocketAddr,
    /// The robot's folder of certificates (`access`).
    pub folder: PathBuf,
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

    /// Pushes out one of them.
    #[cfg(feature = "tls")]
    fn push_out(&self, id: ClientId) {
        if let Some((_, task)) = self.present.borrow_mut().remove(&id) {
            task.abort();
        }
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
    let (entrance, strangers, mut turn) = (Rc::new(entrance), Rc::default(), 0);
    loop {
        match entrance.listener.accept().await {
            Ok(arrived) => {
                let visitor = Client::new(hub.visitors.next_id(), access::Role::Viewer, arrived.who());
                let place = place(&strangers, &arrived, visitor.id, &hub.visitors);
                let stays =
                    receive(Rc::clone(&visitor), arrived, place, Rc::clone(&entrance), Rc::clone(&hub));
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

/// The place of a connection of another machine: nobody of another machine crowds out those of this one.
#[cfg(feature = "tls")]
fn place(strangers: &Rc<Strangers>, arrived: &Arrived, id: ClientId, visitors: &Visitors) -> Option<Place> {
    let Arrived::Tls(_, address) = arrived else { return None };
    let (place, displaced) = strangers.enter(*address, id);
    if let Some(displaced) = displaced {
        visitors.push_out(displaced);
    }
    Some(place)
}

#[cfg(not(feature = "tls"))]
const fn place(_: &Rc<()>, _: &Arrived, _: ClientId, _: &Visitors) -> Option<Place> {
    None
}

/// One connection from its first byte on.
async fn receive(
    visitor: Rc<Client>,
    arrived: Arrived,
    place: Option<Place>,
    entrance: Rc<Entrance>,
    hub: Rc<Hub>,
) {
    let greeted = timeout(HELLO_TIMEOUT, async {
        let let_in = entrance.let_in(arrived).await;
        let turned_away = |error: &NetError| visitor.turned_away(&hub, error.to_string());
        let (mut reader, mut writer, proof) = let_in.inspect_err(turned_away)?;
        if let Some(name) = proof.as_ref().and_then(Proof::name) {
            *visitor.who.borrow_mut() = format!("certificate {name}");
        }
        let role = greet(&visitor, &mut reader, &mut writer, proof.as_ref(), &entrance, &hub).await?;
        Ok::<_, NetError>((role, reader, writer, proof))
    });
    let greeted = {
        let _until_served = place;
        greeted.await
    };
    hub.visitors.leave(visitor.id);
    let who = visitor.who.take();
    if let Ok(Ok((role, reader, writer, proof))) = greeted {
        let over = async {
            match &proof {
                None => std::future::pending().await,
                Some(proof) => proof.is_over().await,
            }
        };
        attend(visitor.id, (role, who), (reader, writer), over, hub).await;
    }
}

/// Without TLS nobody waits to show a certificate.
#[cfg(not(feature = "tls"))]
enum Place {}

/// Without TLS nobody shows a certificate.
#[cfg(not(feature = "tls"))]
enum Proof {}

#[cfg(not(feature = "tls"))]
impl Proof {
    const fn role(&self) -> Option<access::Role> {
        match *self {}
    }

    const fn name(&self) -> Option<&str> {
        match *self {}
    }

    async fn is_over(&self) {
        match *self {}
    }
}

/// Hears a connection until it may be served, and says what it is then. One that may not be served is told why, and still
/// heard for a stop.
async fn greet(
    visitor: &Client,
    reader: &mut Reader,
    writer: &mut Writer,
    shown: Option<&Proof>,
    entrance: &Entrance,
    hub: &Hub,
) -> Result<access::Role, NetError> {
    let mut number = [0; 32];
    number[..8].copy_from_slice(&visitor.id.to_le_bytes());
    let nonce = entrance.seed.proof(&number);
    let challenge = Challenge { nonce, token_needed: entrance.token.is_some() };
    write(writer, &wire::greeting(&challenge)?).await?;
    let most = shown.map_or(Some(entrance.most), Proof::role);
    if most.is_none() {
        let reason =
            "this certificate is not on the robot's list: have a new one made (mocad access new)".to_owned();
        visitor.turned_away(hub, reason.clone());
        write(writer, &wire::encode(&FromServer::Goodbye(reason))?).await?;
    }
    let (mut payload, mut refused) = (Vec::new(), false);
    loop {
        wire::read_frame(reader, &mut payload, MAX_FIRST_FRAME).await?;
        let Some(most) = most else { continue };
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
                match entrance.judge(role, most, proof.as_ref(), &nonce, served) {
                    Ok(role) => return Ok(role),
                    Err(reason) => {
                        refused = true;
                        visitor.turned_away(hub, reason.clone());
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
    pub(super) const fn new(listener: Listener, most: access::Role, seed: Token) -> Self {
        Self {
            listener,
            token: None,
            most,
            #[cfg(feature = "tls")]
            gate: None,
            seed,
        }
    }

    /// Listens for programs of other machines. Needs a runtime's context.
    #[cfg(feature = "tls")]
    pub(super) fn over_tls(port: &TlsPort, seed: Token) -> Result<Self, NetError> {
        let gate = Some(Gate::open(&port.folder)?);
        // What a certificate may, the list says.
        Ok(Self { gate, ..Self::new(Listener::bind_tls(port.listen)?, access::Role::Viewer, seed) })
    }

    #[cfg(not(feature = "tls"))]
    pub(super) fn over_tls(_: &TlsPort, _: Token) -> Result<Self, NetError> {
        Err(NetError::NoTls)
    }

    /// A connection's halves, and the certificate that it showed.
    async fn let_in(&self, arrived: Arrived) -> Result<(Reader, Writer, Option<Proof>), NetError> {
        match arrived {
            Arrived::Halves(reader, writer, _) => Ok((reader, writer, None)),
            #[cfg(feature = "tls")]
            Arrived::Tls(stream, _) => {
                let gate = self.gate.as_ref().ok_or(NetError::Closed)?;
                let (reader, writer, proof) = gate.let_in(stream).await?;
                Ok((reader, writer, Some(proof)))
            }
        }
    }

    /// Returns the rights of a client that asks for `role` and may have `most`, while `served` others are served.
    fn judge(
        &self,
        role: Role,
        most: access::Role,
        proof: Option<&[u8; 32]>,
        nonce: &[u8; 32],
        served: usize,
    ) -> Result<access::Role, String> {
        if let Some(token) = &self.token
            && !proof.is_some_and(|proof| token.admits(nonce, proof))
        {
            return Err(
                "wrong token: this port needs the token file of the daemon's owner (telemetry.token)".into(),
            );
        }
        let role = if role == Role::Observer { access::Role::Viewer } else { most };
        // The last place is for whoever wants to command.
        let places = MAX_CLIENTS + usize::from(role > access::Role::Viewer);
        if served >= places {
            return Err(format!(
                "all {MAX_CLIENTS} places and the one for a commander are taken: close a client that only watches"
            ));
        }
        Ok(role)
    }
}

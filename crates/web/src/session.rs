//! One page: pictures and texts to it, signs of life and requests from it. Reading never waits for writing, so a stop is heard
//! even from a page that takes nothing.

use crate::{
    access::devices::Device,
    ears::{Heard, Page},
    gateway::Gateway,
    holder::Holder,
    picture::{Extras, HolderSeen, picture},
    said,
};
use futures_util::{
    SinkExt, StreamExt,
    stream::{SplitSink, SplitStream},
};
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use std::time::Duration;
use tokio::{
    sync::{mpsc, watch},
    time::{Instant, MissedTickBehavior, timeout},
};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        Message,
        protocol::{CloseFrame, frame::coding::CloseCode},
    },
};

/// Pause between two pictures.
const PICTURE: Duration = Duration::from_nanos(1_000_000_000 / 30);
/// Longest time in which a page takes nothing.
const PATIENCE: Duration = Duration::from_secs(2);
/// Most time for saying goodbye.
const GOODBYE: Duration = Duration::from_millis(200);
/// Answers that wait for a page.
const ANSWERS: usize = 32;

pub(crate) type Socket = WebSocketStream<TokioIo<Upgraded>>;

/// Serves a page from its first picture to its end.
pub(crate) async fn attend(socket: Socket, key: String, device: Device, gateway: &Gateway) {
    let (answers, from_robot) = mpsc::channel(ANSWERS);
    let id = gateway.new_page();
    let page = Page::new(id, device, gateway, answers);
    let (mut to_page, from_page) = socket.split();
    let why = tokio::select! {
        why = listen(from_page, &page) => why,
        why = show(&mut to_page, &page, from_robot) => why,
        () = revoked(&key, gateway) => "the rights of this device have been taken away",
    };
    // Before anything else: a robot that this page held stops.
    gateway.commander.lose(id);
    gateway.audit.note(&page.device.name, "page closed", why);
    let frame = CloseFrame { code: CloseCode::Policy, reason: why.into() };
    let _ = timeout(GOODBYE, to_page.send(Message::Close(Some(frame)))).await;
}

/// Ends once the device is revoked or its time is over.
async fn revoked(key: &str, gateway: &Gateway) {
    let mut devices = gateway.devices.subscribe();
    let gone = |devices: &crate::access::devices::Devices| !devices.contains_key(key);
    if devices.wait_for(gone).await.is_err() {
        std::future::pending::<()>().await;
    }
}

async fn listen(mut from_page: SplitStream<Socket>, page: &Page<'_>) -> &'static str {
    while let Some(message) = from_page.next().await {
        match message {
            Ok(Message::Text(text)) => match crate::ears::hear(&text, page) {
                Heard::Nothing => {}
                Heard::Refused(answer) => {
                    // A page that asks and takes no answers goes without.
                    let _ = page.answers.try_send(answer);
                }
                Heard::Broken(why) => return why,
            },
            Ok(Message::Close(_)) => return "closed by the page",
            Ok(Message::Binary(_)) => return "a page sends text only",
            Ok(_) => {} // Answered by the library.
            Err(_) => return "the connection broke",
        }
        // A page that talks without end must not keep the others from being served.
        tokio::task::yield_now().await;
    }
    "the connection ended"
}

/// Shows pictures until the page takes none for too long.
async fn show(
    to_page: &mut SplitSink<Socket, Message>,
    page: &Page<'_>,
    mut answers: mpsc::Receiver<String>,
) -> &'static str {
    let mut tick = tokio::time::interval(PICTURE);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let holder = page.gateway.commander.holder();
    let (mut shown, mut batch) = (String::new(), 0);
    loop {
        let mut texts = Vec::new();
        let mut bytes = None;
        tokio::select! {
            Some(answer) = answers.recv() => texts.push(answer),
            _ = tick.tick() => {
                let state = said::state(page, &holder);
                if state != shown {
                    shown.clone_from(&state);
                    texts.push(state);
                }
                let (newest, drawn) = draw(page, &holder, batch);
                batch = newest;
                bytes = Some(drawn);
            }
        }
        let messages = texts.into_iter().map(Message::text).chain(bytes.map(Message::binary));
        for message in messages {
            match timeout(PATIENCE, to_page.send(message)).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return "the connection broke",
                Err(_) => return "the page takes nothing",
            }
        }
    }
}

/// The next picture, and the number of the newest batch in it.
fn draw(page: &Page<'_>, holder: &watch::Receiver<Option<Holder>>, since: u64) -> (u64, Vec<u8>) {
    let now = Instant::now();
    let stops = page.gateway.stop_count();
    let look = page.gateway.look.borrow();
    let mut ears = page.ears();
    ears.confirm_stop(look.stop_answered, !look.moves());
    let holder = match &*holder.borrow() {
        None => HolderSeen::Nobody,
        Some(holder) if holder.page == page.id => HolderSeen::ThisPage,
        Some(_) => HolderSeen::Another,
    };
    let extras = Extras { holder, ..ears.note_sent(now, stops) };
    drop(ears);
    let (newest, force_n) = look.force_since(since);
    (newest, picture(&look, &force_n, &extras, now))
}

//! One viewer: let in, listened to, written to.

use crate::{
    hub::{Hub, Outgoing, Viewer, complain},
    origin::Origins,
    protocol::SUBPROTOCOLS,
};
use anyhow::{Context, ensure};
use futures_util::{
    SinkExt, StreamExt,
    stream::{SplitSink, SplitStream},
};
use std::{cell::Cell, net::SocketAddr, rc::Rc, time::Duration};
use tokio::{
    net::{TcpListener, TcpSocket, TcpStream},
    time::{Instant, timeout},
};
use tokio_tungstenite::{
    WebSocketStream, accept_hdr_async_with_config,
    tungstenite::{
        Message,
        handshake::server::{ErrorResponse, Request, Response},
        http::{HeaderValue, StatusCode, header},
        protocol::WebSocketConfig,
    },
};

/// Kernel's send buffer for one viewer, bytes. After a sleep the viewer is shown these bytes first.
const SEND_BUFFER: u32 = 32 * 1024;
/// Connections that wait to be accepted.
const BACKLOG: u32 = 16;
/// Viewers and handshakes at the same time.
const MAX_VIEWERS: usize = 16;
/// Longest message of a viewer, bytes.
const MAX_MESSAGE: usize = 64 * 1024;
/// Longest duration of a handshake, and of a viewer that reads nothing.
const PATIENCE: Duration = Duration::from_secs(10);

/// Binds to loopback.
pub(crate) fn bind(address: SocketAddr) -> anyhow::Result<TcpListener> {
    ensure!(
        address.ip().is_loopback(),
        "{address} is not loopback, and this protocol has no authentication: listen on 127.0.0.1 and reach it through an \
         SSH tunnel (ssh -L 8765:127.0.0.1:8765 robot)"
    );
    let bound = || {
        let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
        socket.set_reuseaddr(true)?;
        // Accepted connections inherit both. Nagle's algorithm would hold messages back for 40 ms.
        socket.set_send_buffer_size(SEND_BUFFER)?;
        if let Err(error) = socket.set_nodelay(true) {
            eprintln!("messages may come late: {error}");
        }
        socket.bind(address)?;
        socket.listen(BACKLOG)
    };
    bound().with_context(|| {
        format!("cannot listen on {address} (another viewer server? choose another port with --listen)")
    })
}

/// Lets viewers in, for ever.
pub(crate) async fn accept_all(listener: &TcpListener, origins: &Origins, hub: &Rc<Hub>) {
    let present = Rc::new(Cell::new(0));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // No more file descriptors: viewers that leave give some back.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        if present.get() >= MAX_VIEWERS {
            continue; // Closed.
        }
        present.set(present.get() + 1);
        let (origins, hub, present) = (origins.clone(), Rc::clone(hub), Rc::clone(&present));
        tokio::task::spawn_local(async move {
            if let Ok(Ok(socket)) = timeout(PATIENCE, greet(stream, &origins)).await {
                let (id, viewer) = hub.enter();
                attend(socket, &viewer, &hub).await;
                hub.leave(id);
            }
            present.set(present.get() - 1);
        });
    }
}

type Socket = WebSocketStream<TcpStream>;

async fn greet(
    stream: TcpStream,
    origins: &Origins,
) -> Result<Socket, Box<tokio_tungstenite::tungstenite::Error>> {
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE))
        .max_frame_size(Some(MAX_MESSAGE))
        // Messages wait in the hub, where they can grow old, and nowhere else.
        .write_buffer_size(0);
    #[expect(clippy::result_large_err, reason = "the signature that the library wants")]
    let check = |request: &Request, mut response: Response| {
        let protocol = admit(request, origins)?;
        response.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(protocol));
        Ok(response)
    };
    accept_hdr_async_with_config(stream, check, Some(config)).await.map_err(Box::new)
}

/// The protocol to speak with who asks.
#[expect(clippy::result_large_err, reason = "the signature that the library wants")]
fn admit(request: &Request, origins: &Origins) -> Result<&'static str, ErrorResponse> {
    let headers = request.headers();
    let origin = match headers.get(header::ORIGIN).map(HeaderValue::to_str) {
        None => None,
        Some(Ok(origin)) => Some(origin),
        Some(Err(_)) => return Err(refusal(StatusCode::FORBIDDEN, "an Origin that is no text".into())),
    };
    if !origins.allow(origin) {
        let origin = origin.unwrap_or_default();
        let why = format!("pages of {origin} may not watch this robot (--allow-origin {origin} lets them)");
        return Err(refusal(StatusCode::FORBIDDEN, why));
    }
    let offered = headers.get_all(header::SEC_WEBSOCKET_PROTOCOL);
    let offered: Vec<&str> = offered
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|list| list.split(','))
        .map(str::trim)
        .collect();
    SUBPROTOCOLS.into_iter().find(|protocol| offered.contains(protocol)).ok_or_else(|| {
        let why = format!("this server speaks {}, not {offered:?}", SUBPROTOCOLS.join(" and "));
        refusal(StatusCode::BAD_REQUEST, why)
    })
}

fn refusal(code: StatusCode, why: String) -> ErrorResponse {
    let mut response = ErrorResponse::new(Some(why));
    *response.status_mut() = code;
    response
}

/// Listens and writes until one of them ends.
async fn attend(socket: Socket, viewer: &Viewer, hub: &Hub) {
    let (to_viewer, from_viewer) = socket.split();
    tokio::select! {
        () = listen(from_viewer, viewer, hub) => {}
        () = write(to_viewer, viewer) => {}
    }
}

async fn listen(mut from_viewer: SplitStream<Socket>, viewer: &Viewer, hub: &Hub) {
    while let Some(Ok(message)) = from_viewer.next().await {
        match message {
            Message::Text(text) => hub.hear(viewer, &text),
            Message::Binary(_) => complain(viewer, "nothing can be published here: this server is read-only"),
            Message::Close(_) => return,
            _ => {} // Answered by the library.
        }
        if viewer.flooded.get() {
            return;
        }
        // A viewer that talks without end must not keep the others from being served.
        tokio::task::yield_now().await;
    }
}

async fn write(mut to_viewer: SplitSink<Socket, Message>, viewer: &Viewer) {
    loop {
        let Some(next) = viewer.next(Instant::now().into_std()) else {
            viewer.filled.notified().await;
            continue;
        };
        let message = match next {
            Outgoing::Text(text) => Message::text(text),
            Outgoing::Data(frame) => Message::binary(frame),
        };
        if !matches!(timeout(PATIENCE, to_viewer.send(message)).await, Ok(Ok(()))) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_viewers_connection_holds_no_message_back() {
        let listener = bind(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
        let _viewer = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (accepted, _) = listener.accept().await.unwrap();
        assert!(accepted.nodelay().unwrap(), "inherited from the listener");
    }
}

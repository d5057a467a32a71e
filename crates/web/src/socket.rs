//! From a request to a WebSocket.

use crate::{gateway::Gateway, session};
use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use hyper_util::rt::TokioIo;
use std::sync::Arc;
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{handshake::derive_accept_key, protocol::Role, protocol::WebSocketConfig},
};

/// Longest message of a page, bytes.
const MESSAGE_MAX: usize = 1024;
/// Bytes that may wait for a page beside what the kernel holds.
const WAITING_MAX: usize = 64 * 1024;

/// Opens a page's socket for a paired device.
pub(crate) async fn open(State(gateway): State<Arc<Gateway>>, mut request: Request) -> Response {
    let Some((key, device)) = gateway.device(request.headers()) else {
        return (StatusCode::UNAUTHORIZED, "this device is not paired").into_response();
    };
    let Some(accept) = accept_key(request.headers()) else {
        return (StatusCode::BAD_REQUEST, "this path speaks WebSocket 13").into_response();
    };
    let Ok(place) = Arc::clone(&gateway.pages).try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many pages are open: close one").into_response();
    };
    let upgraded = hyper::upgrade::on(&mut request);
    tokio::spawn(async move {
        let _place = place;
        let Ok(upgraded) = upgraded.await else { return };
        let config = WebSocketConfig::default()
            .max_message_size(Some(MESSAGE_MAX))
            .max_frame_size(Some(MESSAGE_MAX))
            .write_buffer_size(0)
            .max_write_buffer_size(WAITING_MAX);
        let io = TokioIo::new(upgraded);
        let socket = WebSocketStream::from_raw_socket(io, Role::Server, Some(config)).await;
        session::attend(socket, key, device, &gateway).await;
    });
    let headers = [
        (header::CONNECTION, HeaderValue::from_static("upgrade")),
        (header::UPGRADE, HeaderValue::from_static("websocket")),
        (header::SEC_WEBSOCKET_ACCEPT, accept),
    ];
    (StatusCode::SWITCHING_PROTOCOLS, headers).into_response()
}

fn accept_key(headers: &HeaderMap) -> Option<HeaderValue> {
    let has = |name, wanted: &str| {
        let value = headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
        value.is_some_and(|text| text.split(',').any(|part| part.trim().eq_ignore_ascii_case(wanted)))
    };
    let websocket = has(header::UPGRADE, "websocket") && has(header::CONNECTION, "upgrade");
    let key = headers.get(header::SEC_WEBSOCKET_KEY)?;
    (websocket && has(header::SEC_WEBSOCKET_VERSION, "13"))
        .then(|| HeaderValue::try_from(derive_accept_key(key.as_bytes())).ok())?
}

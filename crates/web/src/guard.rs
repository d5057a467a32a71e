//! The checks before every request: the robot's own name, no page of another site, not too often.

use crate::gateway::Gateway;
use axum::{
    extract::{Request, State},
    http::{HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use std::{net::IpAddr, sync::Arc, time::Duration};

/// Most time for a request to come in and be answered; a log is sent afterwards.
const PATIENCE: Duration = Duration::from_secs(10);

/// Address of the peer, which the acceptor puts beside each request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) IpAddr);

/// Checks a request, and says in the answer what a browser may do with it.
pub(crate) async fn guard(State(gateway): State<Arc<Gateway>>, request: Request, next: Next) -> Response {
    let host = match admit(&gateway, &request) {
        Ok(host) => host,
        Err(refused) => return refused.into_response(),
    };
    let answered = tokio::time::timeout(PATIENCE, next.run(request)).await;
    let mut response = answered.unwrap_or_else(|_| StatusCode::REQUEST_TIMEOUT.into_response());
    harden(&mut response, &host);
    response
}

/// The host that is asked, or why the request is refused.
fn admit(gateway: &Gateway, request: &Request) -> Result<String, (StatusCode, &'static str)> {
    let headers = request.headers();
    let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    let peer = request.extensions().get::<Peer>().map(|peer| peer.0);
    // A stop is never too often.
    let stops = request.uri().path() == "/stop";
    if !stops && !peer.is_some_and(|peer| gateway.admits(peer)) {
        return Err((StatusCode::TOO_MANY_REQUESTS, "too many requests from this address"));
    }
    let host = text(header::HOST).unwrap_or_default().to_ascii_lowercase();
    if !gateway.hosts.contains(&host) {
        return Err((
            StatusCode::MISDIRECTED_REQUEST,
            "this robot has no such name: start moca-web with --name",
        ));
    }
    let origin = text(header::ORIGIN);
    let own = origin.is_some_and(|origin| origin.strip_prefix("https://") == Some(&host));
    let changes = request.method() != Method::GET || request.uri().path() == "/socket";
    if !own && (changes || origin.is_some()) {
        let from = peer.map_or_else(String::new, |peer| peer.to_string());
        gateway.audit.note(&from, "request of another site's page refused", origin.unwrap_or_default());
        return Err((StatusCode::FORBIDDEN, "requests of another site's page are refused"));
    }
    Ok(host)
}

fn harden(response: &mut Response, host: &str) {
    let policy = format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self' wss://{host}; \
         frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    );
    let headers = response.headers_mut();
    if let Ok(policy) = HeaderValue::try_from(policy) {
        headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    for (name, value) in [
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-opener-policy", "same-origin"),
        ("cross-origin-resource-policy", "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
}

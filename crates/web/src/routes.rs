//! Every path of the server.

use crate::{
    access::{Role, devices::DEVICE_LIFE_S},
    assets::ASSETS,
    gateway::{COOKIE, Gateway},
    guard::{Peer, guard},
    logs, socket,
};
use axum::{
    Extension, Json, Router,
    extract::{DefaultBodyLimit, Path, State},
    http::{HeaderMap, StatusCode, header},
    middleware,
    response::{IntoResponse, Response},
    routing::{get, post},
};
use moca_telemetry::{ParameterValue, net::access::LOGS};
use serde::Deserialize;
use serde_json::{Value, json};
use std::{sync::Arc, time::Duration};

/// Longest body of a request, bytes.
const BODY_MAX: usize = 1024;
/// Pause before a wrong code is answered.
const WRONG_CODE: Duration = Duration::from_secs(1);

/// Every path, behind the guard.
pub(crate) fn routes(gateway: Arc<Gateway>) -> Router {
    let mut router = Router::new();
    for asset in ASSETS {
        let headers = [
            (header::CONTENT_TYPE, asset.kind),
            (header::CONTENT_ENCODING, "gzip"),
            (header::CACHE_CONTROL, "no-cache"),
        ];
        router = router.route(asset.path, get(move || async move { (headers, asset.gzip) }));
    }
    router
        .route("/socket", get(socket::open))
        .route("/pair", post(pair))
        .route("/me", get(me))
        .route("/stop", post(stop))
        .route("/authority.crt", get(authority))
        .route("/urdf", get(urdf))
        .route("/parameters", get(parameters))
        .route("/robots", get(robots))
        .route("/logs", get(list_logs))
        .route("/logs/{name}", get(log))
        .layer(DefaultBodyLimit::max(BODY_MAX))
        .layer(middleware::from_fn_with_state(Arc::clone(&gateway), guard))
        .with_state(gateway)
}

/// A response that ends the handling of a request.
type Refused = (StatusCode, &'static str);

/// Name of the device that asks, if its role suffices.
fn admitted(gateway: &Gateway, headers: &HeaderMap, least: Role) -> Result<String, Refused> {
    match gateway.device(headers) {
        Some((_, device)) if device.role >= least => Ok(device.name),
        Some(_) => Err((StatusCode::FORBIDDEN, "the role of this device does not suffice")),
        None => Err((StatusCode::UNAUTHORIZED, "this device is not paired")),
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pairing {
    code: String,
    name: String,
}

async fn pair(
    State(gateway): State<Arc<Gateway>>,
    Extension(peer): Extension<Peer>,
    Json(asked): Json<Pairing>,
) -> Response {
    let from = peer.0.to_string();
    match gateway.store.pair(&asked.code, &asked.name) {
        Ok((token, device)) => {
            gateway.read_devices();
            gateway.audit.note(&device.name, "paired", format!("{} from {from}", device.role.name()));
            let cookie = format!(
                "{COOKIE}={token}; Path=/; Secure; HttpOnly; SameSite=Strict; Max-Age={DEVICE_LIFE_S}"
            );
            let answer = json!({"name": device.name, "role": device.role});
            ([(header::SET_COOKIE, cookie)], Json(answer)).into_response()
        }
        Err(error) => {
            gateway.audit.note(&from, "pairing refused", error.to_string());
            tokio::time::sleep(WRONG_CODE).await;
            (StatusCode::FORBIDDEN, error.to_string()).into_response()
        }
    }
}

async fn me(State(gateway): State<Arc<Gateway>>, headers: HeaderMap) -> Result<Json<Value>, Refused> {
    let (_, device) =
        gateway.device(&headers).ok_or((StatusCode::UNAUTHORIZED, "this device is not paired"))?;
    Ok(Json(json!({"name": device.name, "role": device.role})))
}

/// STOP without a socket: while that comes back, and from a page that is being closed.
async fn stop(State(gateway): State<Arc<Gateway>>, headers: HeaderMap) -> Result<StatusCode, Refused> {
    let who = admitted(&gateway, &headers, Role::Viewer)?;
    gateway.stop(&who);
    gateway.audit.note(&who, "stop", "passed on");
    Ok(StatusCode::ACCEPTED)
}

async fn authority(State(gateway): State<Arc<Gateway>>) -> Result<Response, Refused> {
    let missing = (StatusCode::NOT_FOUND, "this site has a certificate of its own");
    let pem = gateway.identity.authority_pem.clone().ok_or(missing)?;
    Ok(([(header::CONTENT_TYPE, "application/x-x509-ca-cert")], pem).into_response())
}

async fn urdf(State(gateway): State<Arc<Gateway>>, headers: HeaderMap) -> Result<Response, Refused> {
    admitted(&gateway, &headers, Role::Viewer)?;
    let urdf = gateway.look.borrow().robot.as_ref().map(|robot| robot.urdf.clone()).unwrap_or_default();
    Ok(([(header::CONTENT_TYPE, "application/xml")], urdf).into_response())
}

/// Parameters that can be changed now.
async fn parameters(State(gateway): State<Arc<Gateway>>, headers: HeaderMap) -> Result<Json<Value>, Refused> {
    admitted(&gateway, &headers, Role::Maintainer)?;
    let robot = gateway.look.borrow().robot.clone().unwrap_or_default();
    let live = robot.parameters.iter().filter(|parameter| parameter.live).filter_map(|parameter| {
        let numbers = |value: &ParameterValue| match value {
            ParameterValue::Numbers(numbers) => Some(numbers.clone()),
            ParameterValue::Text(_) => None,
        };
        Some(json!({
            "name": parameter.name, "units": parameter.units, "min": parameter.min, "max": parameter.max,
            "description": parameter.description, "default": numbers(&parameter.default),
            "value": numbers(&parameter.value)?,
        }))
    });
    Ok(Json(live.collect()))
}

/// Other robots at a glance.
async fn robots(State(gateway): State<Arc<Gateway>>, headers: HeaderMap) -> Result<Json<Value>, Refused> {
    admitted(&gateway, &headers, Role::Viewer)?;
    let robots = gateway.robots.look();
    robots.map(Json).map_err(|_| (StatusCode::SERVICE_UNAVAILABLE, "no thread is left to watch other robots"))
}

async fn list_logs(State(gateway): State<Arc<Gateway>>, headers: HeaderMap) -> Result<Json<Value>, Refused> {
    admitted(&gateway, &headers, LOGS)?;
    let logs = logs::list(&gateway.logs);
    Ok(Json(logs.into_iter().map(|log| json!({"name": log.name, "bytes": log.bytes})).collect()))
}

async fn log(
    State(gateway): State<Arc<Gateway>>,
    headers: HeaderMap,
    Path(name): Path<String>,
) -> Result<Response, Refused> {
    let who = admitted(&gateway, &headers, LOGS)?;
    let body =
        logs::open(&gateway.logs, &name).await.ok_or((StatusCode::NOT_FOUND, "there is no such log"))?;
    gateway.audit.note(&who, "log downloaded", name.as_str());
    // The name is one of the list, where only letters, digits and - _ . are.
    let disposition = format!("attachment; filename=\"{name}\"");
    let kind = "application/octet-stream".to_owned();
    Ok(([(header::CONTENT_DISPOSITION, disposition), (header::CONTENT_TYPE, kind)], body).into_response())
}

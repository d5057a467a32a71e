//! The Foxglove WebSocket protocol as far as a read-only server needs it: texts in JSON, data in binary frames.
//! <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>
//!
//! ```
//! use moca_viewer::protocol::{FromViewer, data, parse};
//! let asked = parse(r#"{"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 3}]}"#);
//! assert_eq!(asked, Ok(FromViewer::Subscribe(vec![(7, 3)])));
//! assert!(parse(r#"{"op": "advertise", "channels": []}"#).unwrap_err().contains("read-only"));
//! assert_eq!(data(7, 1, b"x"), [1, 7, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, b'x']);
//! ```

use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue, RobotDescription};
use serde_json::{Value, json};

/// Names of the protocol that are understood, the preferred one first; they differ in nothing that is used here.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Severity of a message for the viewer's user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// To be known.
    Info,
    /// Something is missing.
    Warning,
    /// Something does not work.
    Error,
}

/// Message from a viewer.
#[derive(Clone, Debug, PartialEq)]
pub enum FromViewer {
    /// Data of channels: number of the subscription, number of the channel.
    Subscribe(Vec<(u32, u32)>),
    /// No more data for these subscriptions.
    Unsubscribe(Vec<u32>),
    /// Values of the parameters with these names, of all where there are none; `set` asked to change them.
    Parameters {
        /// Dotted names.
        names: Vec<String>,
        /// The viewer's own name for this request.
        id: Option<String>,
        /// True if the viewer wanted to change the parameters.
        set: bool,
    },
    /// Every change of a parameter, or no more.
    WatchParameters(bool),
}

/// Reads what a viewer says.
///
/// # Errors
/// For its user: what is no message, or asks for more than reading.
pub fn parse(text: &str) -> Result<FromViewer, String> {
    let message: Value =
        serde_json::from_str(text).map_err(|error| format!("this is no message: {error}"))?;
    let list = |key: &str| message[key].as_array().cloned().unwrap_or_default();
    let number = |value: &Value| value.as_u64().and_then(|number| u32::try_from(number).ok());
    let id = message["id"].as_str().map(Into::into);
    let texts = |values: Vec<Value>| values.iter().filter_map(|v| v.as_str().map(Into::into)).collect();
    match message["op"].as_str() {
        Some("subscribe") => {
            let pair = |s: &Value| Some((number(&s["id"])?, number(&s["channelId"])?));
            let pairs: Option<_> = list("subscriptions").iter().map(pair).collect();
            pairs
                .map(FromViewer::Subscribe)
                .ok_or_else(|| "a subscription needs an id and a channelId".into())
        }
        Some("unsubscribe") => {
            Ok(FromViewer::Unsubscribe(list("subscriptionIds").iter().filter_map(number).collect()))
        }
        Some("getParameters") => {
            Ok(FromViewer::Parameters { names: texts(list("parameterNames")), id, set: false })
        }
        Some("setParameters") => {
            let names = list("parameters").into_iter().map(|parameter| parameter["name"].clone()).collect();
            Ok(FromViewer::Parameters { names: texts(names), id, set: true })
        }
        Some("subscribeParameterUpdates") => Ok(FromViewer::WatchParameters(true)),
        Some("unsubscribeParameterUpdates") => Ok(FromViewer::WatchParameters(false)),
        Some(op) => Err(format!("{op:?} is not understood: this server is read-only")),
        None => Err("a message needs an \"op\"".into()),
    }
}

/// The first text of a connection, and of each new session with a daemon.
pub fn server_info(name: &str, session: &str) -> String {
    json!({
        "op": "serverInfo",
        "name": name,
        "capabilities": ["parameters", "parametersSubscribe"],
        "sessionId": session,
        "metadata": { "moca": env!("CARGO_PKG_VERSION") },
    })
    .to_string()
}

/// A text for the viewer's user.
pub fn status(level: Level, message: &str) -> String {
    json!({ "op": "status", "level": level as u8, "message": message }).to_string()
}

/// One channel as [`advertise`] lists it.
pub(crate) fn channel(id: u32, topic: &str, schema_name: &str, schema: &str) -> Value {
    json!({
        "id": id,
        "topic": topic,
        "encoding": "cdr",
        "schemaName": schema_name,
        "schemaEncoding": "ros2msg",
        "schema": schema,
    })
}

/// Channels that can be subscribed to.
pub(crate) fn advertise(channels: &[Value]) -> String {
    json!({ "op": "advertise", "channels": channels }).to_string()
}

/// Channels that are gone.
pub(crate) fn unadvertise(ids: &[u32]) -> String {
    json!({ "op": "unadvertise", "channelIds": ids }).to_string()
}

/// Present values of the parameters called `names`, of all where there are none.
pub fn parameter_values(robot: &RobotDescription, names: &[String], id: Option<&str>) -> String {
    let asked = |name: &String| names.is_empty() || names.contains(name);
    let values: Vec<Value> = robot.parameters.iter().filter(|p| asked(&p.name)).map(parameter).collect();
    let mut message = json!({ "op": "parameterValues", "parameters": values });
    if let Some(id) = id {
        message["id"] = id.into();
    }
    message.to_string()
}

fn parameter(parameter: &ParameterDescription) -> Value {
    let name = &parameter.name;
    match (&parameter.value, &parameter.form) {
        (ParameterValue::Text(text), _) => json!({ "name": name, "value": text }),
        (ParameterValue::Numbers(numbers), ParameterForm::Flag) => {
            json!({ "name": name, "value": numbers.first().is_some_and(|flag| *flag > 0.5) })
        }
        (ParameterValue::Numbers(numbers), _) => match numbers.as_slice() {
            [one] => json!({ "name": name, "value": one, "type": "float64" }),
            many => json!({ "name": name, "value": many, "type": "float64_array" }),
        },
    }
}

/// A message of a channel: number of the subscription, time in ns since the Unix epoch, content.
pub fn data(subscription: u32, unix_ns: u64, content: &[u8]) -> Vec<u8> {
    let mut frame = Vec::with_capacity(13 + content.len());
    frame.push(1);
    frame.extend(subscription.to_le_bytes());
    frame.extend(unix_ns.to_le_bytes());
    frame.extend(content);
    frame
}

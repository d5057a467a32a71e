//! The records of a log that come from the table of a sample have the bytes that they had before there was one.
#![cfg(feature = "log")]
#![allow(clippy::unwrap_used, reason = "test helpers fail by panicking")]

use moca_telemetry::log::records::{Channel, Command, Cover, State, Timing};
use serde::{Serialize, de::DeserializeOwned};

/// Schemas and messages of a recorded run: kind, topic, JSON.
const RECORDED: &str = include_str!("records.txt");

fn recorded<'a>(kind: &'a str, topic: &'a str) -> impl Iterator<Item = &'a str> {
    RECORDED.lines().filter_map(move |line| line.strip_prefix(kind)?.strip_prefix(' ')?.strip_prefix(topic))
}

fn reencodes<C: Channel + Serialize + DeserializeOwned>() {
    let messages: Vec<&str> = recorded("message", C::TOPIC).map(str::trim_start).collect();
    assert!(messages.len() > 5, "{}", C::TOPIC);
    for message in messages {
        let record: C = serde_json::from_str(message).unwrap();
        assert_eq!(serde_json::to_string(&record).unwrap(), message);
    }
    let schema = recorded("schema", C::TOPIC).map(str::trim_start).next().unwrap();
    assert_eq!(String::from_utf8(C::schema().unwrap()).unwrap(), schema);
}

#[test]
fn recorded_messages_and_schemas_reencode_to_equal_bytes() {
    reencodes::<State>();
    reencodes::<Command>();
    reencodes::<Cover>();
    reencodes::<Timing>();
}

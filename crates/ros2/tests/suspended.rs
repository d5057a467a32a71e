//! A program that was stopped and goes on (SIGSTOP, a debugger, a computer that was suspended) is heard, and hears, again.
#![cfg(feature = "dds")]
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use moca_ros2::Message;
use moca_ros2::dds::Dds;
use moca_ros2::messages::Text;
use moca_ros2::transport::{Qos, ReaderId, Transport, WriterId};
use std::process::Command;
use std::time::{Duration, Instant};

/// A domain that no other test uses.
const DOMAIN: u16 = 173;
/// Nodes find each other in a second or two.
const PATIENCE: Duration = Duration::from_secs(60);

fn hears(from: &mut Dds, writer: WriterId, to: &mut Dds, reader: ReaderId, text: &[u8]) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < PATIENCE {
        // While it is being joined anew nothing can be sent.
        let _ = from.write(writer, text);
        from.wait(Duration::from_millis(5));
        to.wait(Duration::from_millis(5));
        while let Some(payload) = to.take(reader) {
            if payload == text {
                return true;
            }
        }
    }
    false
}

#[test]
fn a_program_that_was_stopped_is_heard_and_hears_again() {
    let (mut one, mut other) = (Dds::join(DOMAIN, &[]).unwrap(), Dds::join(DOMAIN, &[]).unwrap());
    let writer = one.writer("/text", Text::TYPE, Qos::Reliable).unwrap();
    let reader = other.reader("/text", Text::TYPE, Qos::BestEffort).unwrap();
    for round in 0..10_u8 {
        // A payload of its own: what was under way before is not taken for an answer.
        let text = [0, 1, 0, 0, 2, 0, 0, 0, b'a' + round, 0, 0, 0];
        assert!(hears(&mut one, writer, &mut other, reader, &text), "nothing is heard in round {round}");
        // Whoever stops it has to be another.
        let stop = format!("kill -STOP {0}; sleep 0.3; kill -CONT {0}", std::process::id());
        assert!(Command::new("sh").args(["-c", &stop]).status().unwrap().success());
    }
    assert!(one.rejoined() > 0 && other.rejoined() > 0, "it was never interrupted: this shows nothing");
}

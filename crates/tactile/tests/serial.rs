//! The reader thread against pseudo-terminals.
#![cfg(all(unix, feature = "serial"))]

use moca_tactile::serial::{PortSelection, SerialBoard};
use moca_tactile::{BoardEvent, CloseReason, OpenFailure};
use serialport::{SerialPort, TTYPort};
use std::io::Write;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// One at a time: a terminal that is let go gives its name to the next one, where a reader that still looks for it would find it.
fn terminals() -> MutexGuard<'static, ()> {
    static TERMINALS: Mutex<()> = Mutex::new(());
    TERMINALS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits for an event that `wanted` accepts; gives up after 20 s, so that a broken reader fails instead of hanging.
fn wait_for(
    events: &mut rtrb::Consumer<BoardEvent>,
    mut wanted: impl FnMut(&BoardEvent) -> bool,
) -> Option<BoardEvent> {
    let until = Instant::now() + Duration::from_secs(20);
    while Instant::now() < until {
        match events.pop() {
            Ok(event) if wanted(&event) => return Some(event),
            Ok(_) => {}
            Err(_) => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    None
}

#[test]
fn unplugged_board_is_reported_and_found_again() {
    let _alone = terminals();
    let (mut board, end) = TTYPort::pair().unwrap();
    let path = end.name().unwrap();
    drop(end);
    let (_reader, mut events) = SerialBoard::spawn(PortSelection::Path(path), Instant::now()).unwrap();
    assert!(wait_for(&mut events, |e| matches!(e, BoardEvent::Opened { .. })).is_some());
    board.write_all(b"TOUCH: 0\r\n").unwrap();
    let mut got = Vec::new();
    wait_for(&mut events, |event| {
        if let BoardEvent::Bytes(chunk) = event {
            got.extend_from_slice(chunk.bytes());
        }
        got.len() >= 10
    });
    assert_eq!(got, b"TOUCH: 0\r\n");
    drop(board);
    let closed = wait_for(&mut events, |e| matches!(e, BoardEvent::Closed { .. }));
    assert!(matches!(closed, Some(BoardEvent::Closed { why: CloseReason::Disconnected, .. })));
    assert!(wait_for(&mut events, |e| matches!(e, BoardEvent::OpenFailed { .. })).is_some());
}

#[test]
fn a_port_held_by_another_program_is_busy() {
    let _alone = terminals();
    let (_board, mut end) = TTYPort::pair().unwrap();
    end.set_exclusive(true).unwrap();
    let path = end.name().unwrap();
    let (_reader, mut events) = SerialBoard::spawn(PortSelection::Path(path), Instant::now()).unwrap();
    let failed = wait_for(&mut events, |_| true);
    assert!(matches!(failed, Some(BoardEvent::OpenFailed { why: OpenFailure::Busy, .. })), "{failed:?}");
    drop(end);
    assert!(wait_for(&mut events, |e| matches!(e, BoardEvent::Opened { .. })).is_some());
}

#[test]
fn a_path_that_does_not_exist_is_not_found() {
    let port = PortSelection::Path("/dev/no-such-touch-board".to_string());
    let (_reader, mut events) = SerialBoard::spawn(port, Instant::now()).unwrap();
    let failed = wait_for(&mut events, |_| true);
    assert!(matches!(failed, Some(BoardEvent::OpenFailed { why: OpenFailure::NotFound, .. })), "{failed:?}");
}

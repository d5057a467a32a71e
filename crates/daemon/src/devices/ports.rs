//! Serial ports of a Touch Board and of a force gauge: all that the feature `board` adds, and with it serialport.
//! Without the feature `ports_absent.rs` stands here.

use anyhow::Result;
use moca_tactile::BoardEvent;
pub(crate) use moca_tactile::serial::SerialBoard as Reader;
use moca_tactile::serial::{PortSelection, look_for_board};
use std::io::{Read, Write};
use std::time::Instant;

/// Starts reading the Touch Board at `port`, a path or [`crate::config::AUTO_PORT`]. Times of events are ns since
/// `start`. Dropping the reader ends it.
pub(crate) fn open(port: &str, start: Instant) -> Result<(Reader, rtrb::Consumer<BoardEvent>)> {
    Ok(Reader::spawn(selection(port), start)?)
}

fn selection(port: &str) -> PortSelection {
    match (port, port.strip_prefix(crate::config::NAMED_PORT)) {
        (crate::config::AUTO_PORT, _) => PortSelection::Any,
        (_, Some(name)) => PortSelection::Named(name.to_owned()),
        (path, None) => PortSelection::Path(path.to_owned()),
    }
}

/// A port to ask and to listen to.
pub(crate) trait Line: Read + Write {}

impl<T: Read + Write> Line for T {}

/// Opens the Touch Board at `port` to talk with it.
///
/// # Errors
/// Why it cannot be opened, with the remedy.
pub(crate) fn talk(port: &str) -> Result<Box<dyn Line>> {
    let opened = moca_tactile::serial::open(&selection(port), 115_200);
    Ok(Box::new(opened.map_err(|failure| anyhow::anyhow!("board.port = {port:?}: {}", failure.text()))?))
}

/// Opens a force gauge behind a serial adapter of this speed.
pub(crate) fn open_gauge(
    path: &str,
    baud: u32,
    start: Instant,
) -> Result<(Reader, rtrb::Consumer<BoardEvent>)> {
    Ok(Reader::spawn_with_baud(PortSelection::Path(path.to_owned()), baud, start)?)
}

/// Finds the only Touch Board, or returns the reason why there is none.
pub(crate) fn look() -> Result<String, &'static str> {
    look_for_board().map_err(|failure| failure.text())
}

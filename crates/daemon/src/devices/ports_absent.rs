//! A build without the feature `board`: it links no serialport, and who asks for a port is told what to build.

use anyhow::{Result, bail};
use moca_tactile::BoardEvent;
use std::io::{Read, Write};
use std::time::Instant;

const ABSENT: &str = "this build opens no serial port; for a live cover, a virtual one too, or a force gauge build with \
                      the feature `board` (cargo build --release -p moca-daemon --bin mocad). An arm alone \
                      (plant.parts = \"arm\"), lock-step, replay and calibrate --stream need none";

/// There is no reader.
pub(crate) enum Reader {}

impl Reader {
    pub(crate) fn pulse(&self) -> std::sync::Arc<std::sync::atomic::AtomicU64> {
        match *self {}
    }
}

/// Always refused.
pub(crate) fn open(_port: &str, _start: Instant) -> Result<(Reader, rtrb::Consumer<BoardEvent>)> {
    bail!(ABSENT)
}

/// Always refused.
pub(crate) fn open_gauge(
    _path: &str,
    _baud: u32,
    _start: Instant,
) -> Result<(Reader, rtrb::Consumer<BoardEvent>)> {
    bail!(ABSENT)
}

/// A port to ask and to listen to.
pub(crate) trait Line: Read + Write {}

/// Always refused.
pub(crate) fn talk(_port: &str) -> Result<Box<dyn Line>> {
    bail!(ABSENT)
}

/// Nobody looked, and nothing is missed.
pub(crate) fn look() -> Result<String, &'static str> {
    Ok("not looked for: this build is without the feature `board`".into())
}

//! The log of a run: MCAP, one channel for each kind of message, JSON with its schema, so that it opens in
//! Foxglove, Lichtblick, PlotJuggler and the `mcap` tools.
//!
//! Layers: [`records`] (the messages and their schemas) · [`LogWriter`] (samples in, file out) · [`Recorder`] (a
//! writer on a thread of its own, fed by a ring) · [`LogReader`] (file in, samples out).
//!
//! A chunk is at most 256 KiB of messages and is written in one piece: a file that ends anywhere gives back every
//! whole chunk before the cut.

pub mod records;

mod reader;
mod recorder;
mod writer;

pub use reader::{Log, LogReader, Record, read_log};
pub use recorder::{Recorder, SerialInput};
pub use writer::{LogSummary, LogWriter, Meta};

use std::path::PathBuf;

/// Bytes of the Touch Board as they came in.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SerialBytes {
    /// Arrival, ns of loop time.
    pub arrival_ns: u64,
    /// The bytes of one read.
    pub bytes: Vec<u8>,
}

/// What can go wrong with a log.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file could not be created; an existing one is never overwritten.
    #[error("cannot create the log {path}: {source}")]
    Create {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file could not be opened.
    #[error("cannot open the log {path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file has not even the first bytes of an MCAP file.
    #[error("{0} is not an MCAP file")]
    NotMcap(PathBuf),
    /// Writing failed: disk full, medium gone.
    #[error("cannot write the log: {0}")]
    Mcap(#[from] mcap::McapError),
    /// A message could not be put into JSON.
    #[error("cannot encode a log message: {0}")]
    Encode(#[from] serde_json::Error),
    /// The recorder's thread could not be started.
    #[error("cannot start the recorder's thread: {0}")]
    Thread(std::io::Error),
    /// The recorder's thread panicked.
    #[error("the recorder stopped for an internal error, printed above")]
    Panicked,
}

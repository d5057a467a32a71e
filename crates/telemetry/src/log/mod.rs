//! The log of a run: MCAP, one channel for each kind of message, JSON with its schema, so that it opens in
//! Foxglove, Lichtblick, PlotJuggler and the `mcap` tools; bytes as bytes.
//!
//! Two halves: what a viewer shows is written at 50 Hz with seven digits, and whenever something happened; what a replay
//! needs is written for each tick, every bit of it, in [`columns`].
//!
//! Layers: [`records`] (the messages and their schemas) · [`LogWriter`] (samples in, file out) · [`Recorder`] (a
//! writer on a thread of its own, fed by a ring) · [`LogReader`] (file in, entries out, one after the other) · [`LogFile`]
//! (a file looked into anywhere) · [`Overview`] (a run at a glance).
//!
//! A chunk is at most half a second of a run and is written in one piece: a file that ends anywhere, or is damaged
//! anywhere, gives back every whole chunk before. No length in a file is believed before it is checked.

pub mod columns;
mod file;
mod framing;
pub mod overview;
mod reader;
mod recorder;
pub mod records;
pub(crate) mod shown;
mod sizes;
mod writer;

pub use file::LogFile;
pub use overview::Overview;
pub use reader::{Log, LogReader, Record, read_log};
pub use recorder::{Recorder, RecorderOptions, part_path};
pub use shown::shown;
pub use sizes::LogSizes;
pub use writer::{LogSummary, LogWriter, Meta};

use std::path::PathBuf;

/// Bytes of the Touch Board as they came in.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SerialBytes {
    /// Which board, 0 is the first.
    pub board: u8,
    /// Arrival of the first of them, ns of loop time.
    pub arrival_ns: u64,
    /// The bytes of one read, or of several that followed each other.
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
    /// The file is a log of another form.
    #[error(
        "{path} is a log of form {theirs}, this program reads {}: use the version that wrote it",
        writer::FORM
    )]
    OtherForm {
        /// The file.
        path: PathBuf,
        /// Its form.
        theirs: String,
    },
    /// A part of the file is damaged.
    #[error("the log is damaged: {0}")]
    Damaged(String),
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

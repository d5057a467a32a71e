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
//!
//! Contents for viewers, the boards' bytes and what a replay needs have chunks of their own. Once a minute, and at its end, a
//! log holds its [`story`] so far as a metadata record.

pub mod columns;
mod container;
mod file;
mod framing;
pub mod overview;
mod own_file;
mod purpose;
mod reader;
mod recorder;
pub mod records;
pub(crate) mod shown;
mod sizes;
pub mod story;
mod writer;

pub use file::LogFile;
pub use overview::Overview;
pub use reader::{Log, LogReader, Record, read_log};
pub use recorder::{Recorder, RecorderOptions, part_path};
pub use shown::shown;
pub use sizes::{Account, LogSizes};
pub use writer::{LogSummary, LogWriter, Meta};

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// Permission bits of a recording: nobody but its owner and the group reads who leaned on a robot.
const RECORDING_MODE: u32 = 0o640;

/// Creates the file of a recording, with mode 0640 or what the umask leaves of it; one that exists is never overwritten.
///
/// # Errors
/// It exists, or cannot be created.
pub fn create_file(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create_new(true).mode(RECORDING_MODE).open(path)
}

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

/// Error of a log. The text names the cause completely; `source` does not repeat it.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file could not be created; an existing one is never overwritten.
    #[error("cannot create the log {path}: {cause}")]
    Create {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: std::io::Error,
    },
    /// The file could not be opened.
    #[error("cannot open the log {path}: {cause}")]
    Open {
        /// The file.
        path: PathBuf,
        /// Why not.
        cause: std::io::Error,
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
    /// An MCAP file with another profile than a log's.
    #[error("{path} is {}, a log's is {}", with_profile(.profile), writer::FORM)]
    OtherProfile {
        /// The file.
        path: PathBuf,
        /// Its profile.
        profile: String,
    },
    /// An MCAP file that holds messages outside of chunks.
    #[error(
        "{0} holds messages outside of chunks, which no log does: write it again in chunks, such as with `mcap compress`"
    )]
    NotInChunks(PathBuf),
    /// Chunks are compressed in a way that is not read.
    #[error(
        "{path} is compressed with {compression}, a log with zstd: write it again with `mcap compress --compression zstd`"
    )]
    OtherCompression {
        /// The file.
        path: PathBuf,
        /// Its compression.
        compression: String,
    },
    /// The file has a beginning and nothing that can be read after it.
    #[error("{path} {why}: nothing in it can be read")]
    Nothing {
        /// The file.
        path: PathBuf,
        /// Reason of the end.
        why: &'static str,
    },
    /// A part of the file is damaged.
    #[error("the log is damaged: {0}")]
    Damaged(String),
    /// Writing failed: disk full, medium gone.
    #[error("cannot write the log: {}", with_causes(.0))]
    Write(io::Error),
    /// A message could not be put into JSON.
    #[error("cannot encode a log message: {0}")]
    Encode(serde_json::Error),
    /// The recorder's thread could not be started.
    #[error("cannot start the recorder's thread: {0}")]
    Thread(std::io::Error),
    /// The recorder's thread panicked.
    #[error("the recorder stopped for an internal error, printed above")]
    Panicked,
}

impl LogError {
    /// Returns true if the file is not a log that this program can read.
    pub const fn is_of_no_log(&self) -> bool {
        matches!(
            self,
            Self::NotMcap(_)
                | Self::OtherForm { .. }
                | Self::OtherProfile { .. }
                | Self::NotInChunks(_)
                | Self::OtherCompression { .. }
                | Self::Nothing { .. }
        )
    }
}

/// Returns the likely origin of a file with another profile.
fn with_profile(profile: &str) -> String {
    if profile.is_empty() {
        return "an MCAP file without a profile (a log of form moca-s/1, or one that another program has written again)"
            .into();
    }
    format!("an MCAP file of another program, with the profile {profile:?}")
}

impl From<io::Error> for LogError {
    fn from(error: io::Error) -> Self {
        Self::Write(error)
    }
}

impl From<serde_json::Error> for LogError {
    fn from(error: serde_json::Error) -> Self {
        Self::Encode(error)
    }
}

/// An error with what lies beneath it: a full disk hides under the compressor.
fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| match cause.to_string() {
        cause if text.ends_with(&cause) => text,
        cause => format!("{text}: {cause}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_its_cause_once() {
        let full = || std::io::Error::other("no space left");
        let errors = [
            LogError::Create { path: "run.mcap".into(), cause: full() },
            LogError::Open { path: "run.mcap".into(), cause: full() },
            LogError::Write(full()),
            LogError::Encode(serde_json::Error::io(full())),
            LogError::Thread(full()),
        ];
        for error in &errors {
            let error: &dyn std::error::Error = error;
            let causes = std::iter::successors(error.source(), |cause| cause.source());
            let said = causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"));
            assert_eq!(said.matches("no space left").count(), 1, "{said}");
        }
    }
}

//! The audit: a JSON line for each command, pairing and refusal, with its answer, in a file and on standard error.

use crate::rate::{Rate, Rates};
use anyhow::Context;
use serde_json::{Value, json};
use std::{
    collections::HashMap,
    fs::{self, File, OpenOptions},
    io::Write,
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::Instant,
};

/// Lines of one party: a flood of one writes no more and hides no other.
const RATE: Rate = Rate { burst: 20.0, per_s: 2.0 };
/// Parties with a bound of their own.
const PARTIES_MAX: usize = 256;
/// A file beyond this is set aside, bytes; one older file is kept.
const FILE_MAX: u64 = 10 * 1024 * 1024;

/// Writes the audit.
pub(crate) struct Audit(Mutex<Inner>);

struct Inner {
    path: PathBuf,
    file: File,
    written: u64,
    rates: Rates<String>,
    unsaid: HashMap<String, u64>,
}

impl Audit {
    /// Opens `audit.jsonl` of a folder.
    pub(crate) fn open(folder: &Path) -> anyhow::Result<Self> {
        let path = folder.join("audit.jsonl");
        let file = append(&path).with_context(|| path.display().to_string())?;
        let written = file.metadata().map_or(0, |data| data.len());
        let rates = Rates::new(RATE, PARTIES_MAX, Instant::now());
        Ok(Self(Mutex::new(Inner { path, file, written, rates, unsaid: HashMap::new() })))
    }

    /// Notes that `who` did `what`, and what came of it.
    pub(crate) fn note(&self, who: &str, what: &str, outcome: impl Into<Value>) {
        let mut inner = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !inner.rates.take(who.to_owned(), Instant::now()) {
            if inner.unsaid.len() < PARTIES_MAX || inner.unsaid.contains_key(who) {
                *inner.unsaid.entry(who.to_owned()).or_default() += 1;
            }
            return;
        }
        let unsaid = inner.unsaid.remove(who);
        let unix_ns = moca_telemetry::net::wire::unix_now_ns();
        let mut line =
            json!({"unix_ms": unix_ns / 1_000_000, "who": who, "what": what, "outcome": outcome.into()});
        if let Some(unsaid) = unsaid {
            line["unsaid"] = unsaid.into();
        }
        inner.write(&line.to_string());
    }
}

impl Inner {
    fn write(&mut self, line: &str) {
        say(line);
        if self.written > FILE_MAX {
            let moved =
                fs::rename(&self.path, self.path.with_extension("1.jsonl")).and_then(|()| append(&self.path));
            if let Ok(file) = moved {
                self.file = file;
                self.written = 0;
            }
        }
        match writeln!(self.file, "{line}") {
            Ok(()) => self.written += line.len() as u64 + 1,
            Err(error) => say(&format!("the audit cannot be written: {error}")),
        }
    }
}

fn append(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().create(true).append(true).mode(0o600).open(path)
}

/// Under systemd the journal keeps standard error; a closed one is no reason to end.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

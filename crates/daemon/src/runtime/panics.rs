//! A panic on any thread ends the run: the loop brakes, logs are closed, and the program fails with the panic's message.

use crate::runtime::live::Shared;
use std::panic::PanicHookInfo;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

/// Panic of a run, with its place.
#[derive(Debug)]
pub(crate) struct Panicked(String);

impl std::fmt::Display for Panicked {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "stopped by an error in this program (please report it): {}", self.0)
    }
}

impl std::error::Error for Panicked {}

/// Watches every thread of the process.
pub(crate) struct PanicWatch(Arc<Mutex<Vec<String>>>);

impl PanicWatch {
    /// From now on a panic stops the loop of `shared`. It prints nothing: standard error may be what hangs, and the
    /// robot has to brake first.
    pub(crate) fn start(shared: &Arc<Shared>) -> Self {
        let words = Arc::new(Mutex::new(Vec::new()));
        let (shared, kept) = (Arc::clone(shared), Arc::clone(&words));
        std::panic::set_hook(Box::new(move |info| {
            shared.stop.store(true, Ordering::Relaxed);
            if let Ok(mut kept) = kept.try_lock() {
                kept.push(said(info));
            }
        }));
        Self(words)
    }

    /// Returns an error if something has panicked.
    pub(crate) fn seen(&self) -> Result<(), Panicked> {
        let words = self.0.lock().map(|words| words.join("; ")).unwrap_or_default();
        if words.is_empty() { Ok(()) } else { Err(Panicked(words)) }
    }
}

impl Drop for PanicWatch {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            drop(std::panic::take_hook());
        }
    }
}

fn said(info: &PanicHookInfo<'_>) -> String {
    let thread = std::thread::current();
    let place = info.location().map(ToString::to_string).unwrap_or_default();
    let words = info.payload_as_str().unwrap_or("no words");
    format!("thread {} at {place}: {words}", thread.name().unwrap_or("without a name"))
}

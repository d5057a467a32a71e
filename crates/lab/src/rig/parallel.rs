//! The same work on many inputs, on all cores, with progress on the terminal.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// `work` on every input, results in the order of the inputs and the same for any number of cores. `done` is called,
/// on one thread at a time, with each finished stretch from the first input on.
pub(crate) fn run<I: Sync, O: Send>(
    what: &str,
    inputs: &[I],
    work: impl Fn(&I) -> O + Sync,
    mut done: impl FnMut(&O) + Send,
) -> Vec<O> {
    let next = AtomicUsize::new(0);
    let slots: Vec<Mutex<Option<O>>> = inputs.iter().map(|_| Mutex::new(None)).collect();
    let (finished, received) = std::sync::mpsc::channel::<usize>();
    let cores =
        std::thread::available_parallelism().map_or(1, std::num::NonZero::get).min(inputs.len().max(1));
    let mut results = Vec::with_capacity(inputs.len());
    std::thread::scope(|scope| {
        for _ in 0..cores {
            let (finished, next, slots, work) = (finished.clone(), &next, &slots, &work);
            scope.spawn(move || {
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let (Some(input), Some(slot)) = (inputs.get(i), slots.get(i)) else { return };
                    let output = work(input);
                    if let Ok(mut slot) = slot.lock() {
                        *slot = Some(output);
                    }
                    if finished.send(i).is_err() {
                        return;
                    }
                }
            });
        }
        drop(finished);
        let mut ready = 0;
        while received.recv().is_ok() {
            ready += 1;
            progress(what, ready, inputs.len());
            while let Some(output) = slots.get(results.len()).and_then(|slot| slot.lock().ok()?.take()) {
                done(&output);
                results.push(output);
            }
        }
    });
    results
}

/// A bar on a terminal, nothing elsewhere.
fn progress(what: &str, ready: usize, all: usize) {
    let mut terminal = std::io::stderr();
    if !terminal.is_terminal() {
        return;
    }
    const CELLS: usize = 30;
    let filled = CELLS * ready / all.max(1);
    let bar: String = (0..CELLS).map(|cell| if cell < filled { '#' } else { '.' }).collect();
    let end = if ready == all { "\n" } else { "" };
    // A terminal that went away is no reason to stop.
    let _ = write!(terminal, "\r{what} [{bar}] {ready}/{all}{end}");
    let _ = terminal.flush();
}

#[cfg(test)]
mod tests {
    #[test]
    fn results_and_calls_keep_the_order_of_the_inputs() {
        let inputs: Vec<u64> = (0..200).collect();
        let mut called = Vec::new();
        let results = super::run("", &inputs, |i| i * i, |square| called.push(*square));
        assert_eq!(results, inputs.iter().map(|i| i * i).collect::<Vec<_>>());
        assert_eq!(results, called);
    }
}

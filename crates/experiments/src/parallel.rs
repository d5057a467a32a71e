//! Parallel work on many inputs, on all cores, with its progress.

use anyhow::Result;
use moca_figures::progress::Progress;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of inputs that are done.
pub struct Count {
    progress: Progress,
    ready: usize,
    all: usize,
}

impl Count {
    /// Starts a count of `all` inputs with none done.
    pub fn new(what: &str, all: usize) -> Self {
        Self { progress: Progress::new(what), ready: 0, all }
    }

    /// One more is done.
    pub fn one_more(&mut self) {
        self.ready += 1;
        self.progress.count(self.ready, self.all);
    }
}

/// `work` on every input, results in the order of the inputs and the same for any number of cores.
///
/// # Errors
/// That of the first input whose work failed, once all are done.
pub fn run<I: Sync, O: Send>(
    what: &str,
    inputs: &[I],
    work: impl Fn(&I) -> Result<O> + Sync,
) -> Result<Vec<O>> {
    run_part(&mut Count::new(what, inputs.len()), inputs, work, |_| ()).into_iter().collect()
}

/// Runs on a part of the inputs that `count` counts. `done` is called, on one thread at a time, with each finished stretch
/// from the first input on.
pub fn run_part<I: Sync, O: Send>(
    count: &mut Count,
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
        while received.recv().is_ok() {
            count.one_more();
            while let Some(output) = slots.get(results.len()).and_then(|slot| slot.lock().ok()?.take()) {
                done(&output);
                results.push(output);
            }
        }
    });
    results
}

#[cfg(test)]
mod tests {
    #[test]
    fn results_and_calls_keep_the_order_of_the_inputs() {
        let inputs: Vec<u64> = (0..200).collect();
        let mut called = Vec::new();
        let mut count = super::Count::new("", inputs.len());
        let results = super::run_part(&mut count, &inputs, |i| i * i, |square| called.push(*square));
        assert_eq!(results, inputs.iter().map(|i| i * i).collect::<Vec<_>>());
        assert_eq!(results, called);
        let small = |i: &u64| if *i < 100 { Ok(*i) } else { Err(anyhow::anyhow!("{i} is too large")) };
        assert_eq!(super::run("", &inputs[..100], small).unwrap(), inputs[..100]);
        assert_eq!(super::run("", &inputs, small).unwrap_err().to_string(), "100 is too large");
    }
}

//! CPU time: unlike the wall clock's it does not count what other programs do.

use nix::time::{ClockId, clock_gettime};

/// Used by this thread since its start, s; NaN where the system does not say.
pub fn of_thread_s() -> f64 {
    seconds(ClockId::CLOCK_THREAD_CPUTIME_ID)
}

/// Used by all threads of this process, s; NaN where the system does not say.
pub fn of_process_s() -> f64 {
    seconds(ClockId::CLOCK_PROCESS_CPUTIME_ID)
}

fn seconds(clock: ClockId) -> f64 {
    clock_gettime(clock).map_or(f64::NAN, |time| std::time::Duration::from(time).as_secs_f64())
}

/// Returns the result of `work`, and the CPU time this thread spent on it, s.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let before_s = of_thread_s();
    let result = work();
    (result, of_thread_s() - before_s)
}

//! Callers of the tick, and the threads beside it: the wall clock ([`live`]), or a run that wants every tick now ([`run`]);
//! real time, telemetry, recording and the watchdog.

pub mod allocations;
pub mod assemble;
pub mod clients;
pub mod clock;
pub mod drivers;
pub mod live;
pub mod notice;
pub mod options;
pub(crate) mod panics;
pub mod realtime;
pub mod recovery;
pub mod replay;
pub mod run;
pub mod schedule;
pub mod tick_source;
pub mod timing;
pub mod watchdog;

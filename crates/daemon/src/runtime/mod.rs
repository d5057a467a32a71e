//! Who calls the tick, and what runs beside it: the wall clock ([`live`]) or a caller that wants every tick now
//! ([`lockstep`]); real time, telemetry, recording and the watchdog.

pub mod allocations;
pub mod assemble;
pub(crate) mod clients;
pub mod live;
#[cfg(feature = "sim")]
pub mod lockstep;
pub mod realtime;
pub mod replay;
pub mod run;
pub mod schedule;
pub mod tick_source;
pub mod timing;
pub mod watchdog;

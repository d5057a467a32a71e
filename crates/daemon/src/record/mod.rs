//! Records of a run: every tick for a replay, the last seconds for a fault, commands as CSV.

pub mod command_csv;
pub mod flight_recorder;
pub mod recording;
pub mod tick_blocks;
pub mod tick_log;

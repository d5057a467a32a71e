//! What one tick decides: pure, without thread, clock, file or port. From the inside out: [`tick`] reads, feels, decides,
//! commands and writes; [`supervisor`] says which mode, [`law`] which torques, [`protection`] how fast.

pub mod barrier;
pub mod contacts;
pub mod cover;
pub mod law;
pub mod loop_state;
pub mod plant;
pub mod protection;
pub mod stage;
pub mod state_check;
pub mod supervisor;
pub mod targets;
pub mod tick;
pub mod tick_input;
pub mod uncovered;

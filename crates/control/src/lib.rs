//! One tick of a robot: pure, without thread, clock or port. From the inside out: [`tick`] reads, feels, decides, commands
//! and writes; [`supervisor`] says which mode, [`law`] which torques, [`protection`] how fast. [`robot`] is arm, base, cover,
//! tool and load as data, [`config`] a file as checked settings, and [`assemble`] makes the parts of a tick from them.

pub mod approach;
pub mod assemble;
pub mod barrier;
pub mod base_watch;
pub mod compensation;
pub mod config;
pub mod contacts;
mod controller;
pub mod cover;
pub mod flange_sensor;
pub mod foam_recovery;
pub mod law;
pub mod load_identification;
pub mod loop_state;
pub mod plant;
pub mod protection;
pub mod recentre;
pub mod robot;
pub mod stage;
pub mod state_check;
pub mod stopping;
pub mod supervisor;
pub mod targets;
pub mod tick;
pub mod tick_input;
pub mod uncalibrated;
pub mod uncovered;
pub mod unknown_load;

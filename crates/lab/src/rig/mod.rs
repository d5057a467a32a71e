//! The rig of every experiment: settings with their keys, the closed loop under test, what is measured of it, and how
//! many cores it may take.

pub(crate) mod closed_loop;
pub(crate) mod cpu_time;
pub(crate) mod keys;
pub(crate) mod measure;
pub(crate) mod parallel;
pub(crate) mod settings;

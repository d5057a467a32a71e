//! Calibration of a cover: counts against a reference force, taxel by taxel.
//!
//! One [`engine`], fed with bytes, forces and times, collects and fits. The terminal (`mocad calibrate`) and the
//! dashboard (through [`service`]) are two views of it; [`store`] writes what they accept. [`age`] says how far a foam is still
//! as it was calibrated.

pub mod age;
pub mod engine;
pub mod reference;
pub mod service;
pub mod store;

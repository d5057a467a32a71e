//! Calibration of a cover: counts against a reference force, taxel by taxel.
//!
//! One [`service`] takes requests and drives the [`engine`], which collects and fits bytes, forces and times. The dashboard reaches
//! it over telemetry, the terminal (`mocad calibrate`) has one of its own; [`store`] writes what they accept. [`age`] says how far a
//! foam is still as it was calibrated.

pub mod age;
pub mod engine;
pub mod reference;
pub mod service;
pub mod store;

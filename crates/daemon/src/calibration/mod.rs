//! Calibration of a cover: counts against a reference force, taxel by taxel.

pub mod calibrator;

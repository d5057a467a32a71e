//! The force that a taxel's counts are compared with.

use crate::calibration::engine::Engine;
use crate::devices::force_gauge::Gauge;
use moca_msgs::nanoseconds;
use moca_telemetry::calibration::CalibrationProgress;
use std::iter::Peekable;
use std::vec::IntoIter;

/// Source of the force on the taxel under way.
pub enum Reference {
    /// Force with which the simulation presses a taxel (0 is T1), N.
    Simulated(Box<dyn Fn(usize) -> Option<f64> + Send>),
    /// Gauge with which a person presses.
    Gauge(Gauge),
    /// Weight of a known mass, N, that a person lays on the taxel.
    Weight(f64),
    /// Readings of a file: s, N.
    Recorded(Peekable<IntoIter<(f64, f64)>>),
}

impl Reference {
    /// Tells the engine the force on `taxel` (0 is T1). A gauge that cannot be read ends the session.
    pub fn tell(&mut self, engine: &mut Engine, taxel: usize, now_ns: u64) {
        match self {
            Self::Simulated(force_n) => {
                if let Some(force_n) = force_n(taxel) {
                    engine.reference(force_n, now_ns);
                }
            }
            Self::Gauge(gauge) => {
                let read = gauge.read(|force_n, at_ns| engine.reference(force_n, at_ns));
                if let (Err(why), CalibrationProgress::Rest { .. } | CalibrationProgress::Press { .. }) =
                    (read, engine.progress())
                {
                    engine.fail(&format!("force gauge: {why}"));
                }
            }
            Self::Weight(weight_n) => engine.weight(*weight_n, now_ns),
            Self::Recorded(readings) => {
                while let Some((at_s, force_n)) = readings.next_if(|(at_s, _)| nanoseconds(*at_s) <= now_ns) {
                    engine.reference(force_n, nanoseconds(at_s));
                }
            }
        }
    }
}

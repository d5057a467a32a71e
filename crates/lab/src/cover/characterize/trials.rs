//! Simulated trials of one taxel under a press.

use moca_sim::foam::{ElasticLaw, Foam, FoamState, REFERENCE_FORCE_N};
use moca_sim::sensor::{IDLE_COUNTS, Noise, quantise};
use moca_tactile::calibration::{Trial, TrialSample};

/// Sample rate of the paper's recordings, Hz.
const RATE_HZ: f64 = 35.0;
/// Steps of the foam per sample.
pub(super) const STEPS: u32 = 4;
/// Spread of a ramp's duration over trials, relative. ASSUMED: a bench set by hand.
const DURATION_SPREAD: f64 = 0.03;

/// Way of pressing the taxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    /// Three ramps 0 → 100 → 0 N, 10 s each way: the one that the foams' constants were fitted with.
    Ramps,
    /// Three ramps of 3 s each way with a pause of 10 s at 60 N on the way up: never fitted.
    FastWithPause,
}

impl Protocol {
    fn period_s(self) -> f64 {
        match self {
            Self::Ramps => 20.0,
            Self::FastWithPause => 16.0,
        }
    }

    /// Force at `time_s`, N.
    fn force_n(self, time_s: f64) -> f64 {
        let t = time_s % self.period_s();
        let share = match self {
            Self::Ramps => 1.0 - (t / 10.0 - 1.0).abs(),
            Self::FastWithPause if t < 1.8 => t / 3.0,
            Self::FastWithPause if t < 11.8 => 0.6,
            Self::FastWithPause if t < 13.0 => 0.6 + (t - 11.8) / 3.0,
            Self::FastWithPause => 1.0 - (t - 13.0) / 3.0,
        };
        REFERENCE_FORCE_N * share.clamp(0.0, 1.0)
    }
}

/// One instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) time_s: f64,
    pub(super) force_n: f64,
    pub(super) deformation_m: f64,
    pub(super) fdat: u16,
}

/// One trial: three presses.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    pub(super) samples: Vec<Sample>,
}

impl Recording {
    /// Counts against force.
    pub(super) fn trial(&self) -> Trial {
        self.with(|sample| IDLE_COUNTS - f64::from(sample.fdat))
    }

    /// Deformation in micrometres against force, for the same line fit.
    pub(super) fn deformation_trial(&self) -> Trial {
        self.with(|sample| 1e6 * sample.deformation_m)
    }

    fn with(&self, drop: impl Fn(&Sample) -> f64) -> Trial {
        let sample = |s: &Sample| TrialSample { time_s: s.time_s, drop: drop(s), force_n: s.force_n };
        Trial { samples: self.samples.iter().map(sample).collect() }
    }
}

/// `count` trials of a fresh foam each.
pub(super) fn record(foam: &Foam, protocol: Protocol, count: usize, seed: u64) -> Vec<Recording> {
    record_in_steps(foam, protocol, count, seed, STEPS)
}

/// Records a trial with a number of foam steps per sample.
pub(super) fn record_in_steps(
    foam: &Foam,
    protocol: Protocol,
    count: usize,
    seed: u64,
    steps: u32,
) -> Vec<Recording> {
    let exponent = match foam.elastic {
        ElasticLaw::Power { exponent, .. } => exponent,
        ElasticLaw::Hyperbolic { .. } => 1.0,
    };
    // Noise of its own for every foam.
    let mut noise = Noise::new(seed.wrapping_mul(31).wrapping_add(foam.gap_m.to_bits() ^ exponent.to_bits()));
    (0..count).map(|_| one(foam, protocol, &mut noise, steps)).collect()
}

fn one(foam: &Foam, protocol: Protocol, noise: &mut Noise, steps: u32) -> Recording {
    let pace = 1.0 + DURATION_SPREAD * noise.standard_normal().clamp(-2.0, 2.0);
    let dt_s = 1.0 / (RATE_HZ * f64::from(steps));
    let mut state = FoamState::default();
    let mut samples = Vec::new();
    let mut step = 0u32;
    loop {
        step += 1;
        let time_s = f64::from(step) * dt_s;
        if time_s * pace >= 3.0 * protocol.period_s() {
            return Recording { samples };
        }
        let force_n = protocol.force_n(time_s * pace);
        let deformation_m = state.step_force(foam, force_n, dt_s);
        if step.is_multiple_of(steps) {
            let counts =
                IDLE_COUNTS - foam.counts_drop(deformation_m) + foam.noise_counts * noise.standard_normal();
            samples.push(Sample { time_s, force_n, deformation_m, fdat: quantise(counts) });
        }
    }
}

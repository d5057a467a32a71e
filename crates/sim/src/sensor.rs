//! Sensor of the cover: plate capacitance, counts of the MPR121, its filter and quantisation, and disturbances
//! that a scene switches on one by one. What a scene does not switch on is not computed.
//!
//! N = I·T·1024/(V_DD·C) and C = εA/d, eq. (1): counts go as the plate gap, so a press **lowers** FDAT.
//! The stock settings sample each electrode every millisecond and refresh FDAT every 10 ms with the mean.

use crate::foam::Foam;

/// FDAT of an untouched electrode with the stock settings of 2020 (auto-configuration on), counts.
pub const IDLE_COUNTS: f64 = 720.0;
/// The chip's electrode sample interval (ESI), ns.
pub const SAMPLE_INTERVAL_NS: u64 = 1_000_000;
/// Samples in one FDAT value (SFI) with the stock settings; FDAT is refreshed every `SAMPLE_INTERVAL_NS · SAMPLES_PER_VALUE`.
pub const SAMPLES_PER_VALUE: u32 = 10;
/// Time in which the chip's baseline follows FDAT, s. ASSUMED; the reader does not use the baseline.
const BASELINE_TIME_S: f64 = 30.0;

impl Foam {
    /// Counts by which FDAT falls at deformation `x_m`: s = N₀·a·u/(1 + a·u), u = x/(gap at rest − x).
    pub fn counts_drop(&self, x_m: f64) -> f64 {
        if x_m <= 0.0 {
            return 0.0;
        }
        let left_m = self.gap_left_m(x_m);
        let au = self.sensitivity * (self.gap_m - left_m) / left_m;
        IDLE_COUNTS * au / (1.0 + au)
    }
}

/// Returns the FDAT value for `counts`: rounded to the nearest whole count, within 10 bits.
pub fn quantise(counts: f64) -> u16 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0..=1023; NaN is 0"
    )]
    let fdat = counts.round().clamp(0.0, 1023.0) as u16;
    fdat
}

/// Seeded normal noise (SplitMix64, Marsaglia's polar method): same seed, same bits.
#[derive(Clone, Debug)]
pub struct Noise {
    state: u64,
    spare: Option<f64>,
}

impl Noise {
    /// A stream of its own for every seed.
    pub const fn new(seed: u64) -> Self {
        Self { state: seed ^ 0x9e37_79b9_7f4a_7c15, spare: None }
    }

    fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in \[0, 1).
    pub fn uniform(&mut self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit an f64 exactly")]
        let mantissa = (self.next_u64() >> 11) as f64;
        mantissa * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Mean 0, standard deviation 1.
    pub fn standard_normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        loop {
            let (u, v) = (2.0 * self.uniform() - 1.0, 2.0 * self.uniform() - 1.0);
            let s = u * u + v * v;
            if s > 0.0 && s < 1.0 {
                let scale = (-2.0 * s.ln() / s).sqrt();
                self.spare = Some(v * scale);
                return u * scale;
            }
        }
    }
}

/// A conducting body near the cover lowers FDAT before it touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proximity {
    /// Counts at the moment of contact. ASSUMED.
    pub counts_at_contact: f64,
    /// Distance in which the effect falls to 1/e, m. ASSUMED.
    pub decay_m: f64,
}

impl Default for Proximity {
    fn default() -> Self {
        Self { counts_at_contact: 3.0, decay_m: 0.02 }
    }
}

/// Disturbances, each off at 0 or `None`. Sizes are ASSUMED: nobody has measured them on this cover.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effects {
    /// Steady fall of every FDAT (temperature, humidity), counts/min; negative rises.
    pub drift_counts_per_min: f64,
    /// Bodies felt at a distance.
    pub proximity: Option<Proximity>,
    /// Share of a taxel's counts that its electrode neighbours also lose.
    pub crosstalk: f64,
    /// Standard deviation of the supply voltage over its mean, common to all electrodes (N goes as 1/V_DD).
    pub supply_noise: f64,
}

impl Effects {
    /// Returns true if anything is switched on.
    pub fn any(&self) -> bool {
        *self != Self::default()
    }
}

/// The capacitive side of a cover of `K` taxels: deformations in, FDAT out.
#[derive(Clone, Debug)]
pub struct CoverSensor<const K: usize> {
    foam: Foam,
    noise_counts: f64,
    effects: Option<Effects>,
    noise: Noise,
    sum_drop: [f64; K],
    samples: u32,
    samples_per_value: u32,
    elapsed_s: f64,
    fdat: [u16; K],
    baseline: [f64; K],
}

impl<const K: usize> CoverSensor<K> {
    /// A cover at rest over `foam`, with that foam's stock noise.
    pub fn new(foam: Foam, effects: Effects, seed: u64) -> Self {
        Self {
            foam,
            noise_counts: foam.noise_counts,
            effects: effects.any().then_some(effects),
            noise: Noise::new(seed),
            sum_drop: [0.0; K],
            samples: 0,
            samples_per_value: SAMPLES_PER_VALUE,
            elapsed_s: 0.0,
            fdat: [quantise(IDLE_COUNTS); K],
            baseline: [IDLE_COUNTS; K],
        }
    }

    /// Returns the cover with another noise per FDAT value, counts; 0 for none.
    #[must_use]
    pub fn with_noise(mut self, noise_counts: f64) -> Self {
        self.noise_counts = noise_counts;
        self
    }

    /// Returns the cover with another second filter (SFI).
    #[must_use]
    pub fn with_samples_per_value(mut self, samples: u32) -> Self {
        self.samples_per_value = samples.max(1);
        self
    }

    /// One chip sample, due every [`SAMPLE_INTERVAL_NS`]: deformations (m) and, for [`Effects::proximity`], the
    /// distance of the nearest body to each taxel (m, infinite for none). True when FDAT was refreshed.
    pub fn sample(&mut self, deformation_m: &[f64; K], distance_m: &[f64; K]) -> bool {
        for i in 0..K {
            self.sum_drop[i] += self.foam.counts_drop(deformation_m[i]);
            if let Some(Proximity { counts_at_contact, decay_m }) = self.effects.and_then(|e| e.proximity) {
                self.sum_drop[i] += counts_at_contact * (-distance_m[i].max(0.0) / decay_m).exp();
            }
        }
        self.samples += 1;
        if self.samples < self.samples_per_value {
            return false;
        }
        self.refresh();
        true
    }

    /// FDAT of the last refresh, T1 first.
    pub fn fdat(&self) -> &[u16; K] {
        &self.fdat
    }

    /// Baseline registers: multiples of 4, T1 first. They absorb a sustained press, as the chip's do.
    pub fn baseline(&self) -> [u16; K] {
        self.baseline.map(|b| quantise(b) & !3)
    }

    fn refresh(&mut self) {
        let samples = f64::from(self.samples);
        let mut drop = self.sum_drop.map(|sum| sum / samples);
        self.sum_drop = [0.0; K];
        self.samples = 0;
        let dt_s = 1e-3 * samples;
        self.elapsed_s += dt_s;
        let mut supply = 1.0;
        if let Some(effects) = self.effects {
            if effects.crosstalk > 0.0 {
                drop = with_crosstalk(&drop, effects.crosstalk);
            }
            for value in &mut drop {
                *value += effects.drift_counts_per_min * self.elapsed_s / 60.0;
            }
            if effects.supply_noise > 0.0 {
                supply += effects.supply_noise * self.noise.standard_normal();
            }
        }
        for (i, drop) in drop.into_iter().enumerate() {
            let mut counts = (IDLE_COUNTS - drop) / supply;
            if self.noise_counts > 0.0 {
                counts += self.noise_counts * self.noise.standard_normal();
            }
            self.fdat[i] = quantise(counts);
            self.baseline[i] += (f64::from(self.fdat[i]) - self.baseline[i]) * dt_s / BASELINE_TIME_S;
        }
    }
}

fn with_crosstalk<const K: usize>(drop: &[f64; K], share: f64) -> [f64; K] {
    core::array::from_fn(|i| {
        let left = if i > 0 { drop[i - 1] } else { 0.0 };
        let right = if i + 1 < K { drop[i + 1] } else { 0.0 };
        drop[i] + share * (left + right)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pu_ramp_counts_match_the_known_curve() {
        for (force_n, counts) in
            [(5.0, 3.9), (10.0, 6.4), (20.0, 11.2), (30.0, 16.2), (50.0, 27.8), (75.0, 48.5), (100.0, 84.0)]
        {
            let drop = Foam::PU_LD30.counts_drop(Foam::PU_LD30.ramp_deformation_m(force_n));
            assert!((drop - counts).abs() < 0.06, "{force_n} N: {drop} counts, expected {counts}");
        }
    }

    #[test]
    fn every_foam_spans_the_table_s_counts_at_100_n() {
        for (foam, counts) in Foam::PAPER.into_iter().zip([84.0, 70.0, 5.0, 4.0]) {
            let drop = foam.counts_drop(foam.deformation_at_100n_m);
            assert!((drop - counts).abs() < 0.06, "{foam:?}: {drop}");
        }
    }

    #[test]
    fn fdat_is_the_mean_of_ten_samples() {
        let mut sensor = CoverSensor::<1>::new(Foam::PU_LD30, Effects::default(), 1).with_noise(0.0);
        let pressed = [0.0114];
        for i in 0..10 {
            let x = if i < 5 { [0.0] } else { pressed };
            assert_eq!(sensor.sample(&x, &[f64::INFINITY]), i == 9);
        }
        assert_eq!(sensor.fdat()[0], 720 - 42);
    }

    #[test]
    fn noise_has_the_stated_spread_and_repeats_with_its_seed() {
        let run = |seed| {
            let mut sensor = CoverSensor::<4>::new(Foam::PU_LD30, Effects::default(), seed);
            let mut values = Vec::new();
            for _ in 0..20_000 {
                if sensor.sample(&[0.0; 4], &[f64::INFINITY; 4]) {
                    values.extend(sensor.fdat().map(|v| f64::from(v) - IDLE_COUNTS));
                }
            }
            values
        };
        let values = run(7);
        assert_eq!(values, run(7));
        assert_ne!(values, run(8));
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
        // quantisation adds a twelfth of a count squared
        let expected = (0.49f64 + 1.0 / 12.0).sqrt();
        assert!(mean.abs() < 0.05 && (deviation - expected).abs() < 0.02, "{mean} {deviation}");
    }

    #[test]
    fn each_effect_acts_alone() {
        let last = |effects, x: [f64; 3], distance: [f64; 3]| {
            let mut sensor = CoverSensor::<3>::new(Foam::PU_LD30, effects, 3).with_noise(0.0);
            for _ in 0..60_000 {
                sensor.sample(&x, &distance);
            }
            *sensor.fdat()
        };
        let far = [f64::INFINITY; 3];
        assert_eq!(last(Effects::default(), [0.0; 3], far), [720; 3]);
        let drift = Effects { drift_counts_per_min: 6.0, ..Effects::default() };
        assert_eq!(last(drift, [0.0; 3], far), [714; 3]);
        let near = Effects { proximity: Some(Proximity::default()), ..Effects::default() };
        assert_eq!(last(near, [0.0; 3], [0.0, 1.0, f64::INFINITY]), [717, 720, 720]);
        let crosstalk = Effects { crosstalk: 0.1, ..Effects::default() };
        assert_eq!(last(crosstalk, [0.0, 0.0114, 0.0], far), [712, 636, 712]);
        let supply = Effects { supply_noise: 0.01, ..Effects::default() };
        let values = last(supply, [0.0; 3], far);
        assert!(values[0] != 720 && values[0] == values[1] && values[1] == values[2], "{values:?}");
    }

    #[test]
    fn the_baseline_absorbs_a_sustained_press_and_fdat_does_not() {
        let mut sensor = CoverSensor::<1>::new(Foam::PU_LD30, Effects::default(), 3).with_noise(0.0);
        for _ in 0..300_000 {
            sensor.sample(&[0.0114], &[f64::INFINITY]);
        }
        assert_eq!(sensor.fdat()[0], 636);
        assert!(sensor.baseline()[0].abs_diff(636) <= 4 && sensor.baseline()[0].is_multiple_of(4));
    }
}

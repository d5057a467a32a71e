//! The largest speed at which the base may meet somebody: it stops before the cover is deeper than the force limit allows, the
//! depth at which the cover detects a touch and the measured stopping distance counted in. `docs/math.md` has the proof.
//!
//! v is the largest with h(v) + v (age + tick) + S⁺(v) + r ≤ d(F/(s n)), and not above the fastest stop that was measured. r is what
//! the watch on the base does not see ([`RESERVE_M`]).

use crate::barrier::{GAP_M, SENSITIVITY};
use crate::config::Config;
use crate::robot::{CoverTable, FoamKind, PlantKind};
use moca_wbc::contact_barrier::FoamCurve;

/// Advances between two frames of the table below, m: each is 1.5 times the one before.
pub const FIRST_ADVANCE_M: f64 = 1e-5;
/// Ratio of two neighbouring advances.
pub const ADVANCE_RATIO: f64 = 1.5;
/// Noise of a frame, counts, for which the table holds.
pub const NOISE_COUNTS: [f64; 4] = [0.5, 0.7, 1.0, 1.4];
/// Advances of the table.
const ADVANCES: usize = 17;
/// Plates that a body presses at once, at most.
pub const PLATES: usize = 3;
/// Variance of rounding to whole counts, which a tare finds on top of the noise.
const ROUNDING: f64 = 1.0 / 12.0;

/// Depth of a plate at the frame that first alarms, mm, but for one touch in a thousand: by plates pressed at once, noise and
/// advance, for the plates of PU LD30. By Monte-Carlo with the shipped test, whole counts and a tare of 40 frames: a test in
/// `crates/lab/src/cover/detection.rs` recomputes the table.
#[rustfmt::skip]
pub const DEPTH_MM: [[[f64; ADVANCES]; NOISE_COUNTS.len()]; PLATES] = [
    [
        [0.712, 0.768, 0.846, 0.955, 1.062, 1.177, 1.335, 1.541, 1.808, 2.101, 2.501, 2.963, 3.467, 4.147, 5.097, 6.519, 8.666],
        [0.868, 0.933, 1.024, 1.137, 1.259, 1.408, 1.594, 1.798, 2.087, 2.421, 2.788, 3.190, 3.706, 4.304, 5.204, 6.699, 8.798],
        [1.122, 1.201, 1.300, 1.404, 1.552, 1.724, 1.925, 2.178, 2.444, 2.730, 3.078, 3.496, 3.924, 4.522, 5.487, 6.910, 9.003],
        [1.307, 1.399, 1.527, 1.684, 1.821, 2.017, 2.244, 2.467, 2.725, 3.005, 3.373, 3.706, 4.247, 4.935, 5.804, 7.165, 9.300],
    ],
    [
        [0.618, 0.665, 0.741, 0.813, 0.918, 1.045, 1.205, 1.405, 1.643, 1.932, 2.303, 2.750, 3.284, 3.942, 4.880, 6.313, 8.466],
        [0.759, 0.827, 0.895, 0.989, 1.112, 1.257, 1.412, 1.626, 1.907, 2.203, 2.544, 2.943, 3.382, 4.016, 4.962, 6.376, 8.523],
        [0.948, 1.025, 1.121, 1.247, 1.347, 1.518, 1.688, 1.913, 2.172, 2.484, 2.781, 3.125, 3.544, 4.149, 5.064, 6.505, 8.668],
        [1.073, 1.171, 1.289, 1.408, 1.565, 1.712, 1.878, 2.112, 2.353, 2.602, 2.905, 3.227, 3.708, 4.330, 5.239, 6.700, 8.830],
    ],
    [
        [0.563, 0.619, 0.684, 0.769, 0.863, 0.984, 1.135, 1.335, 1.559, 1.848, 2.211, 2.657, 3.153, 3.797, 4.781, 6.219, 8.388],
        [0.694, 0.754, 0.842, 0.922, 1.038, 1.173, 1.339, 1.539, 1.805, 2.104, 2.448, 2.776, 3.247, 3.860, 4.813, 6.266, 8.401],
        [0.865, 0.950, 1.039, 1.137, 1.279, 1.422, 1.598, 1.817, 2.033, 2.305, 2.599, 2.915, 3.355, 3.995, 4.898, 6.327, 8.436],
        [0.931, 1.050, 1.164, 1.293, 1.414, 1.577, 1.747, 1.941, 2.157, 2.381, 2.673, 3.015, 3.443, 4.108, 5.026, 6.381, 8.591],
    ],
];

/// Points of a measured stopping distance, at most.
pub const STOPS: usize = 16;
/// Base that is assumed where nothing was measured: delay and time constant, s, deceleration, m/s².
pub const WORST_CREDIBLE: Stopping = Stopping::Assumed { delay_s: 0.1, servo_s: 0.1, deceleration_m_s2: 1.0 };

/// Way of a stop beyond the measured one that the watch on the base ([`crate::base_watch`]) does not see, m.
pub const RESERVE_M: f64 = 1e-3;

/// Upper bound of the distance in which a base stops from the moment of the order, S⁺(v).
#[derive(Clone, Debug, PartialEq)]
pub enum Stopping {
    /// v (D + τ) + v²/(2a).
    Assumed {
        /// Delay of an order, s.
        delay_s: f64,
        /// Time constant of the servo, s.
        servo_s: f64,
        /// Deceleration, m/s².
        deceleration_m_s2: f64,
    },
    /// Speeds, m/s, rising, with the distance of each, m; straight lines between them lie above a curve that bends upward.
    Measured(Vec<[f64; 2]>),
}

impl Stopping {
    /// Stopping distance for the base of `config`; `None` where the limit does not depend on it: the simulated robot, whose base
    /// is as described.
    pub fn of(config: &Config) -> Option<Self> {
        let p = &config.protection;
        if !p.stopping_speed_m_s.is_empty() {
            let pairs = p.stopping_speed_m_s.iter().zip(&p.stopping_distance_m);
            return Some(Self::Measured(
                pairs.map(|(speed, distance)| [*speed, *distance]).take(STOPS).collect(),
            ));
        }
        if config.plant.kind == PlantKind::Robot {
            return Some(WORST_CREDIBLE);
        }
        let base = &config.robot.base;
        let assumed = Self::Assumed {
            delay_s: 1e-3 * (p.order_delay_ms + p.order_delay_error_ms),
            servo_s: base.servo_time_constant_s,
            deceleration_m_s2: base.acceleration_max_m_s2,
        };
        (p.order_delay_ms > 0.0 || p.foam_scale() > 1.0 || p.plates > 1).then_some(assumed)
    }

    /// Returns the distance from a speed, m; infinite above the fastest stop that was measured.
    pub fn distance_m(&self, speed_m_s: f64) -> f64 {
        match self {
            Self::Assumed { delay_s, servo_s, deceleration_m_s2 } => {
                speed_m_s * (delay_s + servo_s) + speed_m_s * speed_m_s / (2.0 * deceleration_m_s2)
            }
            Self::Measured(points) => {
                let mut from = [0.0; 2];
                for &[speed, distance] in points {
                    if speed_m_s <= speed {
                        let share = (speed_m_s - from[0]) / (speed - from[0]);
                        return from[1] + share * (distance - from[1]);
                    }
                    from = [speed, distance];
                }
                f64::INFINITY
            }
        }
    }

    /// Time in which a base is at rest that was ordered to be faster than the fastest stop that was measured, s; 0 for an order within
    /// it. The distance S of a delay, a lag and a deceleration grows no faster than v². At a constant deceleration a stop takes
    /// 2S/v; of a lag alone an eighth of the speed is left then.
    pub fn rests_within_s(&self, speed_m_s: f64) -> f64 {
        match self {
            Self::Measured(points) => points
                .last()
                .filter(|[fastest_m_s, _]| speed_m_s > *fastest_m_s)
                .map_or(0.0, |[fastest_m_s, distance_m]| {
                    2.0 * distance_m * speed_m_s / (fastest_m_s * fastest_m_s)
                }),
            Self::Assumed { .. } => 0.0,
        }
    }
}

/// Timing and noise of a board as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// Longest time between two samples, s.
    pub period_s: f64,
    /// Age of a frame when it arrives, and what the loop and a base later than measured add, s.
    pub age_s: f64,
    /// Standard deviation of a taxel at the tare, counts.
    pub deviation_counts: f64,
}

/// Inputs of the speed limit, apart from the board.
#[derive(Clone, Debug)]
pub struct Approach {
    stopping: Stopping,
    foam: FoamCurve,
    /// Force limit over the credible stiffness of the foam, N.
    limit_n: f64,
    /// Plates that a body presses at once.
    plates: usize,
    /// Depth of a plate of this cover over one of the table at the same counts.
    scale: f64,
}

/// Steps of the bisection: 0.1 mm/s of 3 m/s.
const BISECTIONS: u32 = 16;
/// Fastest that is looked for, m/s.
const FASTEST_M_S: f64 = 3.0;

impl Approach {
    /// Returns the limit's own data; `None` without a contact barrier, or where [`Stopping::of`] has none.
    pub fn of(config: &Config) -> Option<Self> {
        let (_, foam) = crate::barrier::curves(config)?;
        let p = &config.protection;
        Some(Self {
            stopping: Stopping::of(config)?,
            foam,
            limit_n: p.force_limit_n / p.foam_scale(),
            plates: usize::from(p.plates),
            scale: plate_scale(&config.robot.cover),
        })
    }

    /// Largest speed, m/s, for a body on a seam, which two plates share, or in the middle of one.
    pub fn speed_m_s(&self, frames: &Frames, seam: bool) -> f64 {
        let most_m = self.foam.depth_m(self.limit_n / as_f64(self.plates));
        let (mut low, mut high) = (0.0, FASTEST_M_S);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if self.depth_m(middle, frames, seam) <= most_m { low = middle } else { high = middle }
        }
        low
    }

    /// Depth at which a base comes to rest that meets a body at this speed, m.
    pub fn depth_m(&self, speed_m_s: f64, frames: &Frames, seam: bool) -> f64 {
        let advance_m = speed_m_s * frames.period_s;
        let hidden_m = if seam && self.plates == 1 {
            self.hidden_on_seam_m(advance_m, frames.deviation_counts)
        } else {
            self.scale * hidden_m(self.plates, advance_m / self.scale, frames.deviation_counts)
        };
        hidden_m + speed_m_s * frames.age_s + self.stopping.distance_m(speed_m_s) + RESERVE_M
    }

    /// Depth of a body of which two plates feel half of the force each, m. Of its advance a plate shows the part that the end of its
    /// way has, which is the largest: the alarm is no later than that.
    fn hidden_on_seam_m(&self, advance_m: f64, deviation_counts: f64) -> f64 {
        let foam = &self.foam;
        let mut depth_m = foam.depth_m(self.limit_n);
        for _ in 0..4 {
            let own_m = foam.depth_m(0.5 * foam.force_n(depth_m));
            let part = (0.5 * foam.slope_n_m(depth_m) / foam.slope_n_m(own_m)).min(1.0);
            let alarm_m = self.scale * hidden_m(2, part * advance_m / self.scale, deviation_counts);
            depth_m = foam.depth_m(2.0 * foam.force_n(alarm_m)).min(depth_m);
        }
        depth_m
    }
}

/// Depth of a plate over one of the table at the same counts, for the cover's gap and sensitivity.
const fn plate_scale(cover: &CoverTable) -> f64 {
    let (gap_m, sensitivity) = match cover.foam {
        FoamKind::PuLd30 => (GAP_M, SENSITIVITY),
        FoamKind::Cc => (GAP_M, 0.034_01),
        FoamKind::Pe5 => (0.005, 0.004_66),
        FoamKind::Pe3 => (0.006, 0.005_97),
        FoamKind::Hyperbolic => (cover.foam_thickness_m, SENSITIVITY),
    };
    gap_m / GAP_M * (SENSITIVITY / sensitivity)
}

/// Depth of a plate at the alarm, m: [`DEPTH_MM`] between its points.
pub fn hidden_m(plates: usize, advance_m: f64, deviation_counts: f64) -> f64 {
    let table = &DEPTH_MM[plates.clamp(1, PLATES) - 1];
    let noise = (deviation_counts * deviation_counts - ROUNDING).max(0.0).sqrt();
    let (row, share) = place(&NOISE_COUNTS, noise);
    let at = |row: usize| along(&table[row], advance_m);
    // noise below the table's is taken for its least, noise beyond goes on as it grew
    let share = share.max(0.0);
    1e-3 * (at(row) + share * (at(row + 1) - at(row)))
}

fn along(depths_mm: &[f64; ADVANCES], advance_m: f64) -> f64 {
    if !advance_m.is_finite() {
        return f64::INFINITY;
    }
    let (mut from_m, mut place) = (FIRST_ADVANCE_M, 0);
    while place + 2 < ADVANCES && advance_m > ADVANCE_RATIO * from_m {
        (from_m, place) = (ADVANCE_RATIO * from_m, place + 1);
    }
    let share = ((advance_m - from_m) / ((ADVANCE_RATIO - 1.0) * from_m)).max(0.0);
    depths_mm[place] + share * (depths_mm[place + 1] - depths_mm[place])
}

/// The interval of rising points in which a value lies, or the nearest one, and how far along it.
fn place(points: &[f64], value: f64) -> (usize, f64) {
    let mut i = 0;
    while i + 2 < points.len() && value > points[i + 1] {
        i += 1;
    }
    (i, (value - points[i]) / (points[i + 1] - points[i]))
}

#[expect(clippy::cast_precision_loss, reason = "a small count")]
const fn as_f64(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{BarrierReadings, Config};

    /// Board with our firmware, and a stock one, with 1 ms of the loop.
    const MOCA: Frames =
        Frames { period_s: 1.0 / 245.0, age_s: 0.0087 - 1.0 / 245.0 + 1e-3, deviation_counts: 0.684 };
    const STOCK: Frames =
        Frames { period_s: 1.0 / 40.5, age_s: 0.055 - 1.0 / 40.5 + 1e-3, deviation_counts: 0.757 };

    fn with(change: impl Fn(&mut Config)) -> Approach {
        let mut config = Config::default();
        config.robot.cover.foam = FoamKind::Hyperbolic;
        config.protection.contact_barrier = BarrierReadings::Foam;
        config.protection.order_delay_ms = 50.0;
        change(&mut config);
        Approach::of(&config).unwrap()
    }

    /// The largest speeds by an independent simulation of the test, which knows the noise: docs/math.md has the equation.
    #[test]
    fn speed_limit_is_that_of_its_equation() {
        for (frames, order_delay_ms, foam, plates, expected) in [
            (MOCA, 20.0, 1.0, 1, 0.0789),
            (MOCA, 50.0, 1.0, 1, 0.0564),
            (MOCA, 100.0, 1.0, 1, 0.0377),
            (MOCA, 50.0, 1.5, 1, 0.0420),
            (MOCA, 50.0, 1.0, 2, 0.0399),
            (MOCA, 50.0, 1.0, 3, 0.0286),
            (STOCK, 20.0, 1.0, 1, 0.0362),
            (STOCK, 50.0, 1.0, 1, 0.0290),
            (STOCK, 100.0, 1.0, 1, 0.0222),
            (STOCK, 50.0, 1.5, 1, 0.0201),
        ] {
            let mut approach = with(|config| {
                let p = &mut config.protection;
                (p.order_delay_ms, p.foam_credible, p.plates) = (order_delay_ms, foam, plates);
            });
            let allowed_m = approach.foam.depth_m(25.0 / foam / f64::from(plates));
            // the independent one has no reserve
            approach.limit_n = f64::from(plates) * approach.foam.force_n(allowed_m + RESERVE_M);
            let speed_m_s = approach.speed_m_s(&frames, true);
            println!(
                "{order_delay_ms} ms, foam x {foam}, {plates} plates: {speed_m_s:.4}, independent {expected} m/s"
            );
            // a tare finds the noise with the rounding to whole counts and its own error: h is a tenth deeper
            let near = speed_m_s <= 1.01 * expected && speed_m_s > 0.86 * expected;
            assert!(near, "{speed_m_s} of {expected} m/s");
            let sum_m = approach.depth_m(speed_m_s, &frames, true);
            let allowed_m = allowed_m + RESERVE_M;
            assert!(sum_m <= allowed_m && sum_m > 0.98 * allowed_m, "{sum_m} of {allowed_m} m");
        }
    }

    /// With the reserve, by the same simulation.
    #[test]
    fn reserve_and_lateness_lower_the_speed_limit() {
        for (frames, expected) in [(MOCA, 0.0465), (STOCK, 0.0228)] {
            let approach = with(|_| ());
            let speed_m_s = approach.speed_m_s(&frames, true);
            assert!(
                speed_m_s <= 1.01 * expected && speed_m_s > 0.86 * expected,
                "{speed_m_s} of {expected} m/s"
            );
            let later_frames = Frames { age_s: frames.age_s + 0.05, ..frames };
            let later = with(|config| config.protection.order_delay_ms = 100.0);
            let difference_m_s = approach.speed_m_s(&later_frames, true) - later.speed_m_s(&frames, true);
            assert!(difference_m_s.abs() < 1e-12, "{difference_m_s}");
        }
    }

    #[test]
    fn stopping_distance_ends_at_fastest_measured_stop() {
        let measured = with(|config| {
            let p = &mut config.protection;
            (p.stopping_speed_m_s, p.stopping_distance_m) =
                (vec![0.01, 0.02, 0.03], vec![1e-3, 2.2e-3, 3.6e-3]);
        });
        let near =
            |value: f64, expected: f64| assert!((value - expected).abs() < 1e-12, "{value} {expected}");
        near(measured.stopping.distance_m(0.005), 5e-4);
        near(measured.stopping.distance_m(0.025), 2.9e-3);
        assert!(measured.stopping.distance_m(0.0301).is_infinite());
        let speed_m_s = measured.speed_m_s(&MOCA, false);
        assert!(speed_m_s <= 0.03 && speed_m_s > 0.0299, "no faster than what was measured: {speed_m_s}");
    }

    #[test]
    fn real_base_without_measurement_is_the_worst_credible_one() {
        let real = |config: &mut Config| {
            config.plant.kind = PlantKind::Robot;
            config.protection.order_delay_ms = 0.0;
        };
        assert_eq!(with(real).stopping, WORST_CREDIBLE);
        let mut simulated = Config::default();
        simulated.protection.contact_barrier = BarrierReadings::Foam;
        assert!(Approach::of(&simulated).is_none(), "the simulated base is as described");
    }

    #[test]
    fn noise_and_advance_only_deepen_a_touch() {
        for plates in 1..=PLATES {
            let mut last_m = 0.0;
            for step in 0..200 {
                let hidden_m = hidden_m(plates, 2e-5 * f64::from(step), 0.757);
                assert!(hidden_m >= last_m, "{plates} plates, step {step}");
                last_m = hidden_m;
                assert!(super::hidden_m(plates, 2e-5 * f64::from(step), 1.2) > hidden_m);
            }
        }
    }
}

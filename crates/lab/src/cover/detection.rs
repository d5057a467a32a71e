//! Lightest touch that each test of the counts feels, its delay, its false alarms, and the speed that it therefore allows.

use anyhow::Result;
use moca_control::approach::{ADVANCE_RATIO, DEPTH_MM, FIRST_ADVANCE_M, NOISE_COUNTS};
use moca_control::config::{Config, ProtectionConfig};
use moca_msgs::seconds;
use moca_sim::foam::Foam;
use moca_sim::sensor::{IDLE_COUNTS, Noise, quantise};
use moca_tactile::cover::{CONTACT_OFF_COUNTS, CONTACT_ON_COUNTS};
use moca_tactile::cusum::{ALARM, CERTAIN, Cusum, LEAST_DEVIATION, REFERENCE};
use moca_tactile::{Firmware, zero};
use moca_wbc::contact_stability::{Contact, speed_for_stopping};

/// Noise of a frame, counts, and how often one comes, Hz.
const BOARDS: [(Firmware, f64, f64); 2] = [(Firmware::Stock2018, 0.70, 40.5), (Firmware::Moca, 0.62, 235.0)];
const FORCES_N: [f64; 4] = [1.5, 3.0, 5.2, 8.0];
/// Touches of each kind.
const TRIALS: u32 = 2000;
/// Cells of the sum's range in the chain.
const STATES: usize = 96;
/// A steady force that is not felt in this time is not felt, s.
const PATIENCE_S: f64 = 2.0;
/// Time constant with which a foam comes back from a touch, s: ASSUMED.
const RECOVERS_S: f64 = 0.4;
/// When after a release somebody comes again, s.
const AGAIN_S: f64 = 0.5;
/// Frames of noise before a touch.
const WARMED_FRAMES: u32 = 25;
/// Depth at which a touch is no longer waited for, m.
const DEEPEST_M: f64 = 0.014;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Test {
    /// Four counts in one frame.
    Threshold,
    /// The sum of the last frames, or four counts in one.
    Cusum,
}

/// A taxel with its tare, frame by frame.
struct Taxel {
    noise: Noise,
    noise_counts: f64,
    rest: f64,
    zero: f64,
    deviation: f64,
    cusum: Cusum,
    test: Test,
}

impl Taxel {
    fn tared(test: Test, noise_counts: f64, rate_hz: f64, seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        let rest = IDLE_COUNTS + noise.uniform();
        let (mut count, mut mean, mut squares) = (0.0, 0.0, 0.0);
        while count < tare_frames(rate_hz) {
            let value = f64::from(quantise(rest + noise_counts * noise.standard_normal()));
            count += 1.0;
            let delta = value - mean;
            mean += delta / count;
            squares += delta * (value - mean);
        }
        let deviation = (squares / (count - 1.0)).sqrt();
        Self { noise, noise_counts, rest, zero: mean, deviation, cusum: Cusum::default(), test }
    }

    /// Returns how far a frame lies below zero that holds `drop` counts of a touch.
    fn below(&mut self, drop: f64) -> f64 {
        self.zero - f64::from(quantise(self.rest - drop + self.noise_counts * self.noise.standard_normal()))
    }

    /// Returns true if the sum of frames alarms at one that comes `dt_s` after the one before, with `drop` counts of a touch
    /// and of the foam that recovers from the last one in it.
    fn feels_recovering(&mut self, drop: f64, dt_s: f64) -> bool {
        let below = self.below(drop);
        self.cusum.update_recovering(below, self.deviation, dt_s)
    }

    /// Returns true if a frame with `drop` counts of a touch in it alarms.
    fn feels(&mut self, drop: f64) -> bool {
        let below = self.below(drop);
        let summed = self.test == Test::Cusum && self.cusum.update(below, self.deviation);
        summed || below >= CONTACT_ON_COUNTS
    }
}

fn tare_frames(rate_hz: f64) -> f64 {
    f64::from(zero::TARE_FRAMES).max((rate_hz * seconds(zero::TARE_TIME_NS)).floor())
}

/// Share of the normal distribution below `x`: Abramowitz and Stegun 7.1.26, to 1.5e-7, and its asymptote in the tail.
fn below(x: f64) -> f64 {
    if x < -4.0 {
        let density = (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
        return density / -x * (1.0 - 1.0 / (x * x) + 3.0 / x.powi(4) - 15.0 / x.powi(6));
    }
    if x > 0.0 {
        return 1.0 - below(-x);
    }
    let z = -x / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let sum = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592]
        .iter()
        .fold(0.0, |s, c| s * t + c);
    0.5 * sum * t * (-z * z).exp()
}

/// Counts below zero of an untouched taxel that rests at `rest` past a whole count, with their probabilities.
fn at_rest(noise_counts: f64, rest: f64) -> Vec<(f64, f64)> {
    (-12..=12)
        .map(|count: i32| {
            let count = f64::from(count);
            let to = |edge: f64| below((count + edge - rest) / noise_counts);
            (rest - count, to(0.5) - to(-0.5))
        })
        .collect()
}

/// Mean of frames until the test of an untouched taxel is as high as `height`, of a tare that was `off` counts too high and found
/// `deviation`.
fn frames_to_alarm(test: Test, height: f64, noise_counts: f64, rest: f64, off: f64, deviation: f64) -> f64 {
    let drops = at_rest(noise_counts, rest);
    if test == Test::Threshold {
        // the tail in closed form: the table of counts has too few digits there
        let most = (rest + off - CONTACT_ON_COUNTS).floor() + 0.5;
        return 1.0 / below((most - rest) / noise_counts);
    }
    let per_cell = as_f64(STATES) / ALARM;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some cells")]
    let states = (height * per_cell).round() as usize;
    let deviation = deviation.max(LEAST_DEVIATION);
    let mut rows = vec![vec![0.0; states + 2]; states + 1];
    for (state, row) in rows.iter_mut().enumerate() {
        // a cell's middle: sums of whole counts over a whole deviation are then what they are, at the alarm too
        let sum = as_f64(state) / per_cell;
        row[state] += 1.0;
        row[states + 1] = 1.0;
        for (drop, share) in &drops {
            let next = sum + (drop + off) / deviation - REFERENCE;
            if next < height {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "within the range"
                )]
                let next = (next.max(0.0) * per_cell).round() as usize;
                row[next.min(states)] -= share;
            }
        }
    }
    solved(rows)
}

/// First unknown of a diagonally dominant system of rows with their right-hand sides.
fn solved(mut rows: Vec<Vec<f64>>) -> f64 {
    let n = rows.len();
    for pivot in (0..n).rev() {
        let (above, from) = rows.split_at_mut(pivot);
        let pivot_row = &from[0];
        for row in above {
            let factor = row[pivot] / pivot_row[pivot];
            for column in (0..pivot).chain([n]) {
                row[column] -= factor * pivot_row[column];
            }
        }
    }
    rows[0][n] / rows[0][0]
}

fn as_f64(count: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "some cells")]
    let count = count as f64;
    count
}

/// False alarms of one taxel in an hour, over tares and places between two counts.
fn alarms_per_hour(test: Test, noise_counts: f64, rate_hz: f64) -> f64 {
    reaches_per_hour(test, ALARM, noise_counts, rate_hz)
}

/// Times in an hour at which one untouched taxel's test is as high as `height`.
fn reaches_per_hour(test: Test, height: f64, noise_counts: f64, rate_hz: f64) -> f64 {
    let spread = noise_counts.mul_add(noise_counts, 1.0 / 12.0).sqrt();
    let frames = tare_frames(rate_hz);
    // Gauss and Hermite's three points
    let nodes = [(-3.0_f64.sqrt(), 1.0 / 6.0), (0.0, 2.0 / 3.0), (3.0_f64.sqrt(), 1.0 / 6.0)];
    let mut per_frame = 0.0;
    for rest in [0.0, 0.2, 0.4, 0.6, 0.8] {
        for (off, of_mean) in nodes {
            for (scale, of_deviation) in nodes {
                let deviation = spread * (1.0 + scale / (2.0 * frames).sqrt());
                let off = off * spread / frames.sqrt();
                per_frame += 0.2 * of_mean * of_deviation
                    / frames_to_alarm(test, height, noise_counts, rest, off, deviation);
            }
        }
    }
    3600.0 * rate_hz * per_frame
}

/// Time in which nine of ten feel a steady force, ms; `None` if they do not.
fn felt_after_ms(test: Test, noise_counts: f64, rate_hz: f64, force_n: f64) -> Option<f64> {
    let drop = Foam::PU_LD30.counts_drop(Foam::PU_LD30.ramp_deformation_m(force_n));
    let mut frames: Vec<u32> = (0..TRIALS)
        .map(|trial| {
            let mut taxel = Taxel::tared(test, noise_counts, rate_hz, u64::from(trial));
            let mut frames = 1;
            while !taxel.feels(drop) && f64::from(frames) < PATIENCE_S * rate_hz {
                frames += 1;
            }
            frames
        })
        .collect();
    frames.sort_unstable();
    let late = f64::from(frames[frames.len() * 9 / 10]) / rate_hz;
    (late < PATIENCE_S).then_some(1e3 * late)
}

/// Readings of a taxel after its release.
struct Released {
    /// Share of the releases after which the sum of frames alarms in 2 s though nobody comes again.
    wrong: f64,
    /// Time in which nine of ten feel who comes again with 3 N, ms; `None` if they do not.
    again_ms: Option<f64>,
}

impl Released {
    fn of(noise_counts: f64, rate_hz: f64) -> Self {
        let drop = Foam::PU_LD30.counts_drop(Foam::PU_LD30.ramp_deformation_m(3.0));
        let (mut wrong, mut late_s) = (0, Vec::new());
        for trial in 0..TRIALS {
            let run = |comes_after_s: f64| {
                let mut taxel = Taxel::tared(Test::Cusum, noise_counts, rate_hz, u64::from(trial));
                taxel.cusum = Cusum::recovering_from(CONTACT_OFF_COUNTS);
                let times_s = (0_u32..).map(|frame| f64::from(frame) / rate_hz);
                times_s.take_while(|t| *t < PATIENCE_S).find(|&t| {
                    let pressed = if t >= comes_after_s { drop } else { 0.0 };
                    let left = CONTACT_OFF_COUNTS * (-t / RECOVERS_S).exp();
                    taxel.feels_recovering(left + pressed, 1.0 / rate_hz)
                })
            };
            wrong += u32::from(run(f64::INFINITY).is_some());
            late_s.push(run(AGAIN_S).map_or(f64::INFINITY, |t| t - AGAIN_S));
        }
        late_s.sort_by(f64::total_cmp);
        let again_ms = Some(1e3 * late_s[late_s.len() * 9 / 10]).filter(|ms| ms.is_finite());
        Self { wrong: f64::from(wrong) / f64::from(TRIALS), again_ms }
    }
}

/// Depth that a touch at `speed_m_s` hides from 99 of 100, m: that of the frame that alarms, less the way in the interval
/// before it, which the delay of the board counts.
fn hidden_m(test: Test, noise_counts: f64, rate_hz: f64, speed_m_s: f64) -> f64 {
    let step_m = speed_m_s / rate_hz;
    let mut depths: Vec<f64> = (0..TRIALS)
        .map(|trial| {
            let mut taxel = Taxel::tared(test, noise_counts, rate_hz, u64::from(trial));
            let mut depth = taxel.noise.uniform() * step_m;
            while depth < 0.01 && !taxel.feels(Foam::PU_LD30.counts_drop(depth)) {
                depth += step_m;
            }
            depth
        })
        .collect();
    depths.sort_by(f64::total_cmp);
    (depths[depths.len() * 99 / 100] - step_m).max(0.0)
}

/// Depth of `plates` that are pressed at once, at the frame that first alarms, but for one touch in a thousand, m; each frame finds
/// them `advance_m` deeper. The tare has as few frames as it may.
fn alarm_depth_m(plates: u64, noise_counts: f64, advance_m: f64, trials: u64) -> f64 {
    let slowest_hz = f64::from(zero::TARE_FRAMES) / seconds(zero::TARE_TIME_NS) - 1.0;
    let mut depths: Vec<f64> = (0..trials)
        .map(|trial| {
            let seeds = (0..plates).map(|plate| plates * trial + plate);
            let mut taxels: Vec<Taxel> =
                seeds.map(|seed| Taxel::tared(Test::Cusum, noise_counts, slowest_hz, seed)).collect();
            let mut depth_m = taxels[0].noise.uniform() * advance_m;
            // the sum is not zero when the touch begins
            for taxel in &mut taxels {
                for _ in 0..WARMED_FRAMES {
                    if taxel.feels(0.0) {
                        taxel.cusum = Cusum::default();
                    }
                }
            }
            let felt = |taxels: &mut [Taxel], depth_m: f64| {
                let drop = Foam::PU_LD30.counts_drop(depth_m);
                taxels.iter_mut().fold(false, |felt, taxel| felt | taxel.feels(drop))
            };
            while depth_m < DEEPEST_M && !felt(&mut taxels, depth_m) {
                depth_m += advance_m;
            }
            depth_m
        })
        .collect();
    depths.sort_by(f64::total_cmp);
    depths[depths.len() * 999 / 1000]
}

/// Largest speed at which the base stops within the collision foam's way at the force limit, m/s, and what is hidden
/// there, m.
fn safe_speed(test: Test, firmware: Firmware, noise_counts: f64, rate_hz: f64) -> Result<(f64, f64)> {
    let base = Config::default().robot.base;
    let contact = Contact {
        stiffness_n_m: 1.0, // not asked for
        damping_n_s_m: 0.0,
        delay_s: seconds(firmware.worst_hold_ns()),
        servo_s: base.servo_time_constant_s,
    };
    let way_m = Foam::COLLISION_ASSUMED.deformation_m(ProtectionConfig::default().force_limit_n);
    let (mut low, mut high) = (0.0, 0.3);
    for _ in 0..10 {
        let middle = 0.5 * (low + high);
        let left_m = way_m - hidden_m(test, noise_counts, rate_hz, middle);
        let allowed = speed_for_stopping(left_m.max(0.0), base.acceleration_max_m_s2, &contact)?;
        if middle <= allowed { low = middle } else { high = middle }
    }
    Ok((low, hidden_m(test, noise_counts, rate_hz, low)))
}

#[test]
fn cusum_feels_lighter_touches_sooner_and_allows_no_less_speed() {
    // ms in which nine of ten feel each of [`FORCES_N`], mm that stay hidden, and m/s that this allows
    let never = f64::INFINITY;
    let bounds = [
        (
            Test::Threshold,
            [[never, never, 124.0, 25.0], [never, 1240.0, 22.0, 5.0]],
            [2.13, 2.16],
            [0.055, 0.105],
        ),
        (Test::Cusum, [[273.0, 124.0, 75.0, 25.0], [35.0, 18.0, 13.0, 5.0]], [2.13, 1.82], [0.055, 0.110]),
    ];
    for (test, within_ms, hides_mm, allows_m_s) in bounds {
        for (board, (firmware, noise_counts, rate_hz)) in BOARDS.into_iter().enumerate() {
            let felt_ms = FORCES_N.map(|force_n| felt_after_ms(test, noise_counts, rate_hz, force_n));
            for (felt_ms, within_ms) in felt_ms.into_iter().zip(within_ms[board]) {
                assert_eq!(felt_ms.is_some(), within_ms.is_finite(), "{test:?}, {firmware:?}: {felt_ms:?}");
                assert!(felt_ms.is_none_or(|ms| ms < within_ms), "{test:?}, {firmware:?}: {felt_ms:?}");
            }
            let (speed_m_s, hidden_m) = safe_speed(test, firmware, noise_counts, rate_hz).unwrap();
            assert!(speed_m_s > allows_m_s[board], "{test:?}, {firmware:?}: {speed_m_s} m/s");
            assert!(1e3 * hidden_m < hides_mm[board], "{test:?}, {firmware:?}: {hidden_m} m");
        }
    }
}

#[test]
fn cusum_false_alarms_stay_below_one_an_hour() {
    for ((_, noise_counts, rate_hz), rarer) in BOARDS.into_iter().zip([39.0, 270.0]) {
        let alarms = alarms_per_hour(Test::Cusum, noise_counts, rate_hz);
        assert!(alarms < 1.0, "{alarms} an hour");
        assert!(alarms_per_hour(Test::Threshold, noise_counts, rate_hz) < 0.02);
        let certain = reaches_per_hour(Test::Cusum, CERTAIN, noise_counts, rate_hz);
        assert!(rarer * certain < alarms, "{certain} of {alarms} an hour");
    }
}

/// An alarm of which a plate beside it shows half is as little a false one as a certain alarm.
#[test]
fn noise_seldom_is_halfway_beside_a_false_alarm() {
    for ((_, noise_counts, rate_hz), rarer) in BOARDS.into_iter().zip([39.0, 270.0]) {
        let (mut halfway, mut frames) = (0.0, 0.0);
        for seed in 0..400 {
            let mut taxel = Taxel::tared(Test::Cusum, noise_counts, rate_hz, seed);
            for _ in 0..2000 {
                taxel.feels(0.0);
                frames += 1.0;
                halfway += f64::from(u8::from(taxel.cusum.is_halfway()));
            }
        }
        let beside = 2.0 * halfway / frames;
        assert!(beside > 0.0 && rarer * beside < 1.0, "{beside} of the false alarms");
    }
}

/// Every fourth advance of each row of the table.
#[test]
fn depths_of_speed_limit_are_what_the_test_detects() {
    for (plates, rows) in (1..).zip(DEPTH_MM) {
        for (noise_counts, row) in NOISE_COUNTS.into_iter().zip(rows) {
            for (i, depth_mm) in (0..).zip(row).skip(3).step_by(4) {
                let advance_m = FIRST_ADVANCE_M * ADVANCE_RATIO.powi(i);
                let found_mm = 1e3 * alarm_depth_m(plates, noise_counts, advance_m, 20_000);
                assert!(
                    (found_mm - depth_mm).abs() < 2e-3,
                    "{plates}, {noise_counts}, {i}: {found_mm} {depth_mm}"
                );
            }
        }
    }
}

#[test]
fn recovering_foam_rarely_raises_false_alarm() {
    let [stock, moca] = BOARDS.map(|(_, noise_counts, rate_hz)| Released::of(noise_counts, rate_hz));
    assert!(stock.wrong < 0.002 && moca.wrong < 0.002, "{} and {} of the releases", stock.wrong, moca.wrong);
    let [stock_ms, moca_ms] = [stock.again_ms, moca.again_ms];
    assert!(stock_ms.is_none() && moca_ms.is_some_and(|ms| ms < 25.0), "{stock_ms:?} and {moca_ms:?}");
}

/// The chain against what it stands for: noise so large that it alarms often.
#[test]
fn the_chain_counts_the_alarms_that_there_are() {
    let (noise_counts, deviation) = (0.7, 0.5);
    let mut noise = Noise::new(5);
    let (mut cusum, mut alarms, frames) = (Cusum::default(), 0.0, 400_000);
    for _ in 0..frames {
        let fdat = quantise(IDLE_COUNTS + noise_counts * noise.standard_normal());
        if cusum.update(IDLE_COUNTS - f64::from(fdat), deviation) {
            (cusum, alarms) = (Cusum::default(), alarms + 1.0);
        }
    }
    let counted = f64::from(frames) / alarms;
    let chain = frames_to_alarm(Test::Cusum, ALARM, noise_counts, 0.0, 0.0, deviation);
    assert!((chain / counted - 1.0).abs() < 0.15, "{chain} {counted}, {alarms} alarms");
}

#[test]
fn the_normal_distribution_is_one() {
    for (x, share) in [(0.0, 0.5), (1.0, 0.841_344_7), (-2.0, 0.022_750_1), (-5.0, 2.866_516e-7)] {
        assert!((below(x) / share - 1.0).abs() < 1e-3, "{x}: {}", below(x));
    }
}

//! Meetings drawn at random: robot, base, foam, person, board, lead and walk from stated ranges. What the controller believes is what
//! commissioning of that robot measures.

use crate::bound;
use crate::campaign::{Column, Table, cells, names};
use crate::commissioning;
use crate::meeting::{Meeting, Outcome, WATCHED_S};
use crate::settings::Settings;
use anyhow::{Result, anyhow};
use moca_control::protection::nominal_speed_m_s;
use moca_msgs::Law;
use moca_sim::sensor::Noise;
use std::fmt::Write as _;

/// Time in which the base, at its speed limit, or the person comes as far as the other, s.
const COMES_S: [f64; 2] = [2.0, 6.0];
/// Time from the touch on for which somebody who walks is watched, and so may follow a base that makes room, s.
const FOLLOWED_S: f64 = 10.0;
/// Smallest distance of the person from the cover at the start, m.
const GAP_MIN_M: f64 = 0.002;
/// Half the distance of two taxels in front, and on a side, m: from the middle of a plate to its seam.
const TO_THE_SEAM_M: [f64; 2] = [bound::TO_THE_SEAM_M, 0.122_25];
/// Keys that a row shows; the others follow from seed and number.
const SHOWN: [&str; 3] = ["sensor.firmware", "person.plates", "person.walk"];
/// Columns after these.
const RESULTS: &[Column<Met>] = &[
    ("gap_m", |met| format!("{:.4}", met.gap_m)),
    ("limit_m_s", |met| format!("{:.4}", met.limit_m_s)),
    ("approach_m_s", |met| format!("{:.4}", met.one.approach_m_s)),
    ("impact_n", |met| format!("{:.2}", met.one.impact_n)),
    ("peak_n", |met| format!("{:.2}", met.one.peak_n)),
    ("peak_after_s", |met| format!("{:.3}", met.one.peak_after_s)),
    ("noticed_after_s", |met| format!("{:.3}", met.one.noticed_after_s)),
    ("least_n", |met| format!("{:.2}", met.least_n)),
    ("first_peak_n", |met| format!("{:.2}", met.one.first_peak_n)),
    ("later_n", |met| format!("{:.2}", met.one.later_n)),
    ("flange_mm", |met| format!("{:.2}", met.one.flange_mm)),
    ("stopped", |met| met.one.stopped.clone()),
];

/// Distribution of a key's value.
#[derive(Clone, Copy, Debug)]
enum Draw {
    /// From the first to the second alike.
    Uniform(f64, f64),
    /// Whole numbers, likewise.
    Whole(f64, f64),
    /// From the first to the second, alike in the logarithm.
    Log(f64, f64),
    /// One of these alike.
    Of(&'static [&'static str]),
}

impl Draw {
    fn value(self, noise: &mut Noise) -> String {
        let share = noise.uniform();
        let between = |from: f64, to: f64| from + share * (to - from);
        match self {
            Self::Uniform(from, to) => format!("{:.4}", between(from, to)),
            Self::Whole(from, to) => format!("{}", between(from, to).floor()),
            Self::Log(from, to) => format!("{:.4e}", from * (to / from).powf(share)),
            Self::Of(words) => words[pick(share, words.len())].into(),
        }
    }
}

/// Key of `moca-lab experiment --set` with its distribution.
const RANGES: &[(&str, Draw)] = &[
    ("sensor.firmware", Draw::Of(&["moca", "stock-2018", "stock-2015"])),
    ("seed", Draw::Whole(1.0, 1e9)),
    ("sensor.phase_ms", Draw::Uniform(0.0, 60.0)),
    ("true.sensor.extra_age_ms", Draw::Uniform(0.0, 5.0)),
    ("true.base.order_delay_ms", Draw::Uniform(0.0, 100.0)),
    ("true.base.order_jitter_ms", Draw::Uniform(0.0, 10.0)),
    ("true.base.order_period_ms", Draw::Of(&["0", "10", "20"])),
    ("true.base.servo_ms", Draw::Uniform(15.0, 200.0)),
    ("true.base.acceleration", Draw::Uniform(0.5, 3.0)),
    ("true.base.deceleration", Draw::Uniform(0.5, 3.0)),
    ("true.base.odometry_scale", Draw::Uniform(0.97, 1.03)),
    ("true.base.odometry_delay_ms", Draw::Uniform(0.0, 30.0)),
    ("true.base.odometry_noise", Draw::Uniform(0.0, 0.003)),
    ("true.base.odometry_rate_hz", Draw::Of(&["0", "50", "100"])),
    ("true.arm.mass_scale", Draw::Uniform(0.9, 1.1)),
    ("true.arm.joint_friction", Draw::Uniform(0.0, 1.0)),
    ("true.arm.torque_noise", Draw::Uniform(0.0, 0.3)),
    ("true.arm.tool_mass", Draw::Uniform(0.0, 1.0)),
    ("robot.cover.foam", Draw::Of(&["pu-ld30", "hyperbolic"])),
    ("robot.cover.foam_stiffness_n_m", Draw::Uniform(1000.0, 4000.0)),
    ("true.foam.creep", Draw::Uniform(0.0, 0.1)),
    ("person.taxel", Draw::Of(&["T1", "T2", "T3", "T4", "T5", "T6", "T7", "T8", "T9", "T10", "T11"])),
    ("person.stiffness", Draw::Log(5e3, 1e7)),
    ("person.fixed", Draw::Of(&["true", "false"])),
    ("person.mass", Draw::Log(3.0, 100.0)),
    ("person.radius", Draw::Uniform(0.03, 0.12)),
    ("speed", Draw::Uniform(0.02, 0.25)),
];

/// Index of one of `count` things at this share of them, 0 to 1.
pub fn pick(share: f64, count: usize) -> usize {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a small index"
    )]
    let index = (share * count as f64) as usize;
    index.min(count - 1)
}

/// A drawn meeting.
struct Drawn {
    meeting: Meeting,
    /// Time until the two meet, s.
    comes_s: f64,
    assignments: Vec<(&'static str, String)>,
}

impl Drawn {
    /// The meeting with this number of the campaign with this seed: no other is drawn for it.
    fn of(seed: u64, id: usize) -> Self {
        let mut noise = Noise::new(seed.wrapping_mul(0x1_0000_0001).wrapping_add(id as u64));
        let meeting = match noise.uniform() {
            kind if kind < 0.5 => Meeting::Led,
            kind if kind < 0.75 => Meeting::ByHand,
            _ => Meeting::Walks,
        };
        let comes_s = COMES_S[0] + noise.uniform() * (COMES_S[1] - COMES_S[0]);
        let mut drawn = Self { meeting, comes_s, assignments: Vec::new() };
        for (key, range) in RANGES {
            drawn.set(key, range.value(&mut noise));
        }
        drawn.place(&mut noise);
        drawn.age(&mut noise);
        drawn.walk(&mut noise);
        drawn
    }

    fn set(&mut self, key: &'static str, value: impl Into<String>) {
        match self.assignments.iter_mut().find(|(known, _)| *known == key) {
            Some((_, known)) => *known = value.into(),
            None => self.assignments.push((key, value.into())),
        }
    }

    fn get(&self, key: &str) -> &str {
        self.assignments.iter().find(|(known, _)| *known == key).map_or("", |(_, value)| value)
    }

    /// On one plate, at a seam, or flat on two or three plates, as configured.
    fn place(&mut self, noise: &mut Noise) {
        let (kind, share) = (noise.uniform(), noise.uniform());
        let in_front = ["T5", "T6", "T7"].contains(&self.get("person.taxel"));
        let to_seam_m = TO_THE_SEAM_M[usize::from(!in_front)];
        let plates = match kind {
            k if k < 0.8 => "1",
            k if k < 0.9 => "2",
            _ => "3",
        };
        let offset_m = match kind {
            k if k < 0.5 => 0.6 * to_seam_m * (2.0 * share - 1.0),
            k if k < 0.8 && share < 0.5 => to_seam_m,
            k if k < 0.8 => -to_seam_m,
            _ => 0.0,
        };
        self.set("person.offset", format!("{offset_m:.4}"));
        self.set("person.plates", plates);
        self.set("protection.plates", plates);
    }

    /// Draws the calibration: half of them are of this year, within 5 %; the other foams may have become half as stiff again.
    fn age(&mut self, noise: &mut Noise) {
        let (is_old, share) = (noise.uniform() < 0.5, noise.uniform());
        let (scale, credible) = if is_old { (0.9 + 0.6 * share, "1.5") } else { (0.95 + 0.1 * share, "1") };
        self.set("true.foam.scale", format!("{scale:.4}"));
        self.set("protection.foam_credible", credible);
    }

    /// One in five of those who are led into somebody meets a person who walks too.
    fn walk(&mut self, noise: &mut Noise) {
        let (also, share) = (noise.uniform() < 0.2, noise.uniform());
        let walks = self.meeting == Meeting::Walks || also;
        self.set("person.walk", format!("{:.4}", if walks { 0.01 + 0.09 * share } else { 0.0 }));
        if self.meeting == Meeting::Walks {
            self.set("speed", "0");
        }
    }

    /// Sets the robot up and commissions it, and returns its speed limit besides, m/s; the person stands so far away that the two meet
    /// after [`COMES_S`].
    fn settings(&self) -> Result<(Settings, f64)> {
        let follows = self.meeting == Meeting::ByHand;
        let mut settings = Settings::paper(if follows { Law::FollowMe } else { Law::Impedance });
        settings.set_all(["law=barrier", "engine=analytic", "person.steps_away_s=1000"])?;
        settings.set_all(self.assignments.iter().map(|(key, value)| format!("{key}={value}")))?;
        settings.set(&format!("true.foam.kind={}", self.get("robot.cover.foam")))?;
        settings.check()?;
        let scene = settings.collision_scene()?;
        commissioning::commission(&mut settings.config, &scene)?;
        let limit_m_s = nominal_speed_m_s(&settings.config, settings.firmware);
        let led_m_s = limit_m_s.min(settings.speed_m_s);
        settings.person.gap_m = GAP_MIN_M.max((led_m_s + settings.person.walk_m_s) * self.comes_s);
        settings.check()?;
        Ok((settings, limit_m_s))
    }

    /// Cover, body and base as they are.
    fn meeting_there(&self, settings: &Settings) -> bound::Meeting {
        let truth = &settings.config.simulation.truth.base;
        bound::Meeting {
            foam: settings.true_foam().stiffened(f64::from(settings.person.plates.max(1))),
            tissue_n_m: settings.person.tissue_stiffness(),
            limit_n: settings.config.protection.force_limit_n,
            deceleration_m_s2: truth.deceleration_m_s2,
            servo_s: 1e-3 * truth.servo_ms,
            order_delay_s: 1e-3 * (truth.order_delay_ms + truth.order_jitter_ms),
            board: settings.firmware,
            sharing: 1.0,
        }
    }

    fn run(&self, id: usize) -> Result<Met> {
        let (settings, limit_m_s) = self.settings().map_err(|error| anyhow!("run {id}: {error:#}"))?;
        let there = self.meeting_there(&settings);
        let watched_s = if settings.person.walk_m_s > 0.0 { FOLLOWED_S } else { WATCHED_S };
        let one = Outcome::of(self.meeting, &there, &settings, watched_s)?;
        let least_n = match one.alarm.filter(|_| one.peak_n > there.limit_n) {
            Some(alarm) => one.peak_n.min(self.meeting.least_of_any_law_n(&settings, &alarm)?),
            None => one.peak_n,
        };
        Ok(Met { limit_m_s, gap_m: settings.person.gap_m, least_n, one })
    }

    fn row(&self, id: usize) -> Result<String> {
        let [board, plates, walk_m_s] = SHOWN.map(|key| self.get(key));
        Ok(format!(
            "{id},{},{board},{plates},{walk_m_s},{}",
            self.meeting.name(),
            cells(RESULTS, &self.run(id)?)
        ))
    }
}

/// Result of a drawn meeting.
struct Met {
    /// Speed limit of the commissioned robot, m/s.
    limit_m_s: f64,
    /// Distance of the person from the cover at the start, m.
    gap_m: f64,
    /// Least force that any law has left, N: this one, or where that is above the limit one that knew what comes.
    least_n: f64,
    one: Outcome,
}

/// Table of drawn meetings. One of more runs continues one of fewer with the same seed.
#[derive(Clone, Copy, Debug)]
pub struct Meetings {
    /// Number of meetings.
    pub runs: usize,
    /// Seed of what is drawn.
    pub seed: u64,
}

impl Meetings {
    /// Kind of meeting `id`, the time until the two meet, and its keys with their values, one a line, as
    /// `moca-lab experiment --set` takes them.
    pub fn keys(&self, id: usize) -> String {
        let drawn = Drawn::of(self.seed, id);
        let mut out = format!("# {}, {:.2} s apart\n", drawn.meeting.name(), drawn.comes_s);
        for (key, value) in &drawn.assignments {
            // Writing to a string cannot fail.
            let _ = writeln!(out, "{key}={value}");
        }
        out
    }
}

impl Table for Meetings {
    fn rows(&self) -> usize {
        self.runs
    }

    fn header(&self) -> String {
        format!("run,meeting,{},{}", SHOWN.join(","), names(RESULTS))
    }

    fn words(&self) -> Vec<&str> {
        vec!["meeting", "sensor.firmware", "stopped"]
    }

    fn row(&self, id: usize) -> Result<String> {
        Drawn::of(self.seed, id).row(id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_loop::Flight;
    use crate::meeting::Alarm;

    /// A meeting, and its first alarm.
    fn alarmed(seed: u64, id: usize) -> (Meeting, Settings, Outcome, Alarm) {
        let drawn = Drawn::of(seed, id);
        let (settings, _) = drawn.settings().unwrap();
        let one = Outcome::of(drawn.meeting, &drawn.meeting_there(&settings), &settings, WATCHED_S).unwrap();
        let alarm = one.alarm.unwrap();
        (drawn.meeting, settings, one, alarm)
    }

    /// A walker whom this law gives less room than it could.
    #[test]
    fn any_law_leaves_more_the_later_its_alarm() {
        let (meeting, settings, one, alarm) = alarmed(1, 9972);
        let least_n = |later: usize| {
            let alarm = Alarm { row: alarm.row + later, ..alarm };
            meeting.least_of_any_law_n(&settings, &alarm).unwrap()
        };
        let [at_once_n, later_n, never_n] = [0, 60, 2000].map(least_n);
        assert!(at_once_n < one.peak_n - 1.0, "{at_once_n} {} N", one.peak_n);
        assert!(later_n > at_once_n + 1.0, "{at_once_n} {later_n} N");
        // by then the law itself has made room
        assert!((never_n - one.peak_n).abs() < 1e-9, "{never_n} {} N", one.peak_n);
    }

    /// A walker beyond the bound: all axes at their utmost, each either way or not at all, as fast as the base may be.
    #[test]
    fn no_direction_of_flight_leaves_less_than_any_law() {
        let (meeting, settings, _, alarm) = alarmed(1, 1677);
        let least_n = meeting.least_of_any_law_n(&settings, &alarm).unwrap();
        assert!(least_n > 25.0, "{least_n} N");
        let limits = &settings.config.limits;
        let mut best_n = f64::INFINITY;
        for direction in (0..27_u8).filter(|direction| *direction != 13) {
            let flight = Flight {
                row: alarm.row,
                wrench_base: [1, 3, 9].map(|place| f64::from(direction / place % 3) - 1.0),
                turns: true,
                acceleration: limits.base_acceleration,
                fastest: limits.base_velocity,
                retreat_m_s: f64::INFINITY,
            };
            best_n = best_n.min(meeting.fleeing_n(&settings, flight).unwrap());
        }
        assert!((best_n - least_n).abs() < 0.02, "{best_n} {least_n} N");
    }

    /// A walker who presses T6 beside its middle, with a moment about the base that no taxel shows.
    #[test]
    fn who_knew_the_place_on_a_plate_would_leave_less_than_any_law() {
        let (meeting, settings, one, alarm) = alarmed(4242, 1034);
        let least_n = |alarm: &Alarm| meeting.least_of_any_law_n(&settings, alarm).unwrap();
        let [x_n, y_n, turn_nm] = alarm.wrench_base;
        assert!(turn_nm.abs() < 1e-9 && alarm.row > 0, "{turn_nm} N·m");
        let beside_m = settings.person.offset_m;
        let known_n = least_n(&Alarm { wrench_base: [x_n, y_n, -beside_m * x_n], ..alarm });
        assert!(beside_m < -0.06 && (one.peak_n - least_n(&alarm)).abs() < 1e-3, "{beside_m} m");
        let said = include_str!("../../../docs/results.md");
        let words = format!("{:.1} N to who would be left {known_n:.1} N", one.peak_n);
        assert!(said.contains(&words), "{words}");
    }

    #[test]
    fn a_meeting_follows_from_seed_and_number_alone() {
        let drawn = |seed, id| Drawn::of(seed, id).assignments;
        assert_eq!(drawn(1, 7), drawn(1, 7));
        assert_ne!(drawn(1, 7), drawn(1, 8));
        assert_ne!(drawn(1, 7), drawn(2, 7));
        for id in 0..50 {
            let first = Drawn::of(3, id);
            let listed = Meetings { runs: 50, seed: 3 }.keys(id);
            assert!(
                SHOWN.iter().all(|key| listed.contains(&format!("{key}={}", first.get(key)))),
                "{listed}"
            );
            assert!(first.meeting == Meeting::Walks || first.get("speed") != "0");
        }
    }
}

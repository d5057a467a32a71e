//! The contact barrier beside the equations of docs/math.md, written down again for one taxel: from its whole history instead
//! of what is remembered of it, and in steps instead of seconds.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::float_cmp,
    reason = "tests"
)]

use moca_wbc::TaxelPlacement;
use moca_wbc::contact_barrier::{
    BarrierInput, BarrierSettings, ContactBarrier, ContactLimits, FoamCurve, TaxelSample,
};
use moca_wbc::reach::ArmReach;
use moca_wbc::robot::PAPER_COVER;
use moca_wbc::testing::Numbers;

/// A power of two: times add up without rounding, so what ends after a time ends at one step.
const DT_S: f64 = 1.0 / 1024.0;
const FOAM: FoamCurve = FoamCurve::Hyperbolic { stiffness_n_m: 2105.0, thickness_m: 0.015 };
/// The calibration is of another one.
const READING: FoamCurve = FoamCurve::Power { depth_at_100n_m: 0.0114, exponent: 1.586 };
/// T6, in front: its way outward is that of the base along x.
const FRONT: usize = 5;

fn settings() -> BarrierSettings {
    let settings = BarrierSettings::new(READING, FOAM, 25.0, 0.015).unwrap();
    BarrierSettings { forget_s: 0.25, creep_s: 0.125, ..settings }
}

fn barrier() -> ContactBarrier<11> {
    ContactBarrier::new(&PAPER_COVER, &settings()).unwrap()
}

fn seconds(steps: usize) -> f64 {
    steps as f64 * DT_S
}

/// Readings of T6 in one step.
#[derive(Clone, Copy, Debug)]
struct Felt {
    /// The last reading, N, the steps since it was taken, and whether there is a touch too light for one.
    force_n: f64,
    age: usize,
    light: bool,
    /// The base's speed forward and what it can brake with, m/s, m/s².
    speed: f64,
    deceleration: f64,
}

impl Felt {
    fn given_to(self, barrier: &mut ContactBarrier<11>) -> ContactLimits<11> {
        let age_s = seconds(self.age);
        let mut samples = [Some(TaxelSample { force_n: 0.0, age_s }); 11];
        samples[FRONT] = Some(TaxelSample { force_n: self.force_n, age_s });
        let deceleration = [self.deceleration, 3.0, 6.0];
        let mut input = BarrierInput::new(samples, [self.speed, 0.0, 0.0], deceleration, DT_S);
        input.light[FRONT] = self.light;
        barrier.update(&input).unwrap()
    }
}

/// The law of docs/math.md for one taxel that nothing else is near to.
#[derive(Default)]
struct Equations {
    /// Displacements of the base, m, from its start on.
    ways_m: Vec<f64>,
    /// Step at which the last reading was taken, how far outward the base was then, m, and the depth and force of each
    /// reading of a touch.
    taken: Option<usize>,
    way_m: f64,
    touch: Vec<(f64, f64)>,
    released: Option<usize>,
    /// Estimate of the person's speed, what a soft body's yielding adds, how fast the compression grows, m/s.
    person: f64,
    yields: f64,
    rate: f64,
    /// Speed of the base before the last reading without even a light touch, and at which it met who is touched, m/s; 0 if
    /// it stood.
    approach: f64,
    met: Option<f64>,
    /// Step of the last reading of a touch, even of a light one, how far outward the base goes until 2 s later, m, and
    /// whether that time has not ended yet, longer where the base has not looked.
    felt: Option<usize>,
    far_m: Option<f64>,
    here: bool,
}

impl Equations {
    /// Depth, m, the person's speed, m/s, the largest speed outward, m/s, and the force that the law is given, N.
    fn step(&mut self, felt: Felt) -> [f64; 4] {
        let s = settings();
        if self.ways_m.is_empty() {
            self.ways_m.push(0.0);
        }
        let way_m = self.ways_m[self.ways_m.len() - 1] + felt.speed * DT_S;
        self.ways_m.push(way_m);
        let now = self.ways_m.len() - 1;
        if self.touch.is_empty() {
            self.person -= self.person * DT_S / s.forget_s;
        }
        // before the start nothing is known; 128 places are kept
        self.look(now);
        let taken = now + 1000 - felt.age;
        let is_new = self.taken.is_none_or(|last| taken > last);
        if is_new {
            let place = self.ways_m[now - felt.age.min(127).min(now)];
            self.read(&s, felt, taken, now, place);
        }
        let w = (self.person + self.yields).max(0.0);
        let held = self.held_limit(&s, felt, is_new, now);
        let Some((read_m, force_n)) = self.touch.last().copied() else {
            return [0.0, 0.0, self.released_limit(&s, now, w).min(held), 0.0];
        };
        let since_s = seconds(now + 1000 - self.taken.unwrap());
        let depth_m = read_m + way_m - self.way_m + w * since_s;
        let soon_m = depth_m + s.servo_s * (felt.speed + w);
        let own = closing(&s, felt, s.stop_m - soon_m).max(0.0);
        let room = closing(&s, felt, s.yield_m - soon_m) - w;
        let eased_m = depth_m + s.damping_s * (felt.speed + w + s.speed_noise_m_s).min(0.0);
        let most = own.min(room).max(-s.retreat_m_s).min(held);
        [depth_m, w, most, force_n * (FOAM.force_n(eased_m) / FOAM.force_n(read_m)).min(1.0)]
    }

    /// Held for 2 s after the last touch, and until it has stood where it is held for half a second, or for 4 s.
    fn look(&mut self, now: usize) {
        let Some(last) = self.felt else { return };
        let felt_s = seconds(now - last);
        if !self.here || felt_s <= 2.0 {
            return;
        }
        let there = |way_m: &&f64| self.far_m.is_some_and(|far_m| **way_m > far_m - 0.2e-3);
        let looked_s = seconds(self.ways_m[last + 1..=now].iter().filter(there).count());
        if looked_s >= 0.5 || felt_s >= 4.0 {
            (self.far_m, self.here) = (None, false);
        }
    }

    /// No further outward than where the base stood or gave way at first.
    fn held_limit(&mut self, s: &BarrierSettings, felt: Felt, is_new: bool, now: usize) -> f64 {
        let way_m = self.ways_m[now];
        let stands = felt.speed <= 0.005;
        if is_new && (felt.light || !self.touch.is_empty()) {
            (self.felt, self.here) = (Some(now), true);
            self.far_m = self.far_m.or(stands.then_some(way_m));
        }
        let left_m = |far_m: f64| far_m - way_m - s.servo_s * felt.speed;
        self.far_m.map_or(f64::INFINITY, |far_m| closing(s, felt, left_m(far_m)).max(0.0))
    }

    /// Seconds since the last release.
    fn released_s(&self, now: usize) -> f64 {
        self.released.map_or(f64::INFINITY, |released| seconds(now - released))
    }

    fn read(&mut self, s: &BarrierSettings, felt: Felt, taken: usize, now: usize, place_m: f64) {
        let Felt { force_n, light, .. } = felt;
        let interval_s = self.taken.replace(taken).map_or(f64::INFINITY, |last| seconds(taken - last));
        let gone_m = place_m - core::mem::replace(&mut self.way_m, place_m);
        let released_s = self.released_s(now);
        let still_s = if self.here && self.far_m.is_some() { 4.0 } else { 2.0 };
        if force_n < s.touch_n {
            if self.touch.is_empty() && light {
                self.meet(self.approach);
            } else if self.touch.is_empty() {
                self.approach = gone_m / interval_s;
            } else {
                let seen = self.touch.len() > 1;
                self.person = if seen { (self.person + self.yields).max(0.0) } else { 0.0 };
                (self.yields, self.rate, self.released) = (0.0, 0.0, Some(now));
                self.approach = 0.0;
                self.touch.clear();
            }
            return;
        }
        let (remembered, readings) = (self.person, self.touch.len());
        let depth_m = READING.depth_m(force_n);
        if interval_s < 0.2 {
            let before_m = match self.touch.last() {
                Some((depth_m, _)) => *depth_m,
                None if released_s < still_s => READING.depth_m(s.hidden_n),
                None => 0.0,
            };
            let rate = (depth_m - before_m) / interval_s;
            let came = self.met.is_some_and(|met| met < 0.005);
            let seen = (readings + usize::from(came)).max(1) as f64;
            let weight = (interval_s / interval_s.max(s.speed_s)).max(1.0 / seen);
            self.person += weight * (rate - gone_m / interval_s - self.person);
            self.person = self.person.clamp(-0.05, s.fastest_person_m_s);
            self.rate += weight * (rate - self.rate);
            let seen = (self.rate.min(self.person) - 0.5 * s.speed_noise_m_s).max(0.0);
            self.yields =
                (seen * FOAM.slope_n_m(depth_m) / s.softest_n_m).min(s.fastest_person_m_s - self.person);
        }
        if readings == 0 {
            let assumed = if released_s < s.forget_s { remembered } else { s.first_speed_m_s };
            self.person = self.person.max(assumed);
            self.meet((gone_m / interval_s).max(self.approach));
        }
        self.touch.push((depth_m, force_n));
    }

    /// The least speed at which the base met who touches.
    fn meet(&mut self, speed: f64) {
        let before = self.met.filter(|_| self.here);
        self.met = Some(before.map_or(speed.max(0.0), |before| before.min(speed.max(0.005))));
    }

    fn released_limit(&self, s: &BarrierSettings, now: usize, w: f64) -> f64 {
        let released_s = self.released_s(now);
        let creeping = s.creep_m_s + s.recovery_m_s2 * (released_s - s.creep_s).max(0.0);
        let again = self.met.map_or(f64::INFINITY, |met| {
            let slow_s = if met < 0.005 { 2.0 } else { 4.0 };
            let felt_s = self.felt.map_or(f64::INFINITY, |last| seconds(now - last));
            (0.5 * met).max(0.005) + s.recovery_m_s2 * (felt_s - slow_s).max(0.0)
        });
        let most = creeping.min(again);
        if most < 1.0 { (most - w).max(-s.retreat_m_s) } else { f64::INFINITY }
    }
}

/// Speed outward with `left` m to go.
fn closing(s: &BarrierSettings, felt: Felt, left: f64) -> f64 {
    let braking = (2.0 * s.braking_share * felt.deceleration * left.max(0.0)).sqrt();
    let steady = left / s.response_s;
    if left > 0.0 { steady.min(braking) } else { steady }
}

/// Hands that come, press and go, at any rate and delay of the readings, on a base that drives about.
#[test]
fn every_step_is_that_of_the_equations() {
    let mut random = Numbers::from_seed(3);
    let mut draw = |from: f64, to: f64| from + (to - from) * 0.5 * (random.next_number() + 1.0);
    let (mut readings, mut limits) = ([0; 3], [0; 4]);
    for _ in 0..60 {
        let (mut barrier, mut equations) = (barrier(), Equations::default());
        let mut felt = Felt { force_n: 0.0, age: 0, light: false, speed: 0.0, deceleration: 3.0 };
        for _ in 0..12 {
            let pick = |from: &[usize], at: f64| from[(at * from.len() as f64) as usize];
            let period = pick(&[1, 4, 10, 40, 250], draw(0.0, 1.0));
            let delay = pick(&[0, 3, 35, 140], draw(0.0, 1.0));
            let length = pick(&[20, 100, 256, 400, 2100], draw(0.0, 1.0));
            let (pressed, slow) = (draw(0.0, 1.0) < 0.5, draw(0.0, 1.0) < 0.3);
            felt.force_n = if pressed { draw(1.0, 20.0) } else { 0.0 };
            felt.deceleration = if draw(0.0, 1.0) < 0.5 { 3.0 } else { 0.05 };
            for step in 0..length {
                if step % period == 0 {
                    felt.speed = if slow { draw(-0.001, 0.006) } else { draw(-0.2, 0.2) };
                    let lost = draw(0.0, 1.0) < 0.02;
                    felt.light = draw(0.0, 1.0) < 0.3;
                    let next_n = (felt.force_n + draw(-1.0, 1.0)).clamp(1.0, 40.0);
                    felt.force_n = if pressed && !lost { next_n } else { 0.0 };
                }
                felt.age = delay + step % period;
                let found = felt.given_to(&mut barrier);
                let found = [
                    found.depth_m[FRONT],
                    found.person_m_s[FRONT],
                    found.outward_m_s[FRONT],
                    found.force_n[FRONT],
                ];
                let expected = equations.step(felt);
                for (i, (found, expected)) in found.into_iter().zip(expected).enumerate() {
                    let same = found == expected || (found - expected).abs() < 1e-9 * (1.0 + expected.abs());
                    assert!(same, "{i}: {found} instead of {expected}, {felt:?}");
                }
                let touched = !equations.touch.is_empty();
                readings[0] += usize::from(touched);
                limits[0] += usize::from(touched && expected[2] == 0.0);
                limits[1] += usize::from(touched && expected[2] < 0.0);
                limits[2] += usize::from(touched && expected[2] > 0.0);
                limits[3] += usize::from(!touched && expected[2].is_finite());
                readings[1] += usize::from(equations.met.is_some());
                readings[2] += usize::from(expected[1] > 0.0 && expected[1] < 0.59);
            }
        }
    }
    println!("{readings:?} {limits:?}");
    assert!(readings.into_iter().chain(limits).all(|seen| seen > 2000), "{readings:?} {limits:?}");
}

/// The whole cover in one step, all of it read now on a base that stands.
fn pressed(
    barrier: &mut ContactBarrier<11>,
    forces_n: &[(usize, f64)],
    light: &[usize],
) -> ContactLimits<11> {
    let mut input = BarrierInput::new([None; 11], [0.0; 3], [3.0, 3.0, 6.0], DT_S);
    input.samples = [Some(TaxelSample { force_n: 0.0, age_s: 0.0 }); 11];
    for &(taxel, force_n) in forces_n {
        input.samples[taxel] = Some(TaxelSample { force_n, age_s: 0.0 });
    }
    light.iter().for_each(|&taxel| input.light[taxel] = true);
    barrier.update(&input).unwrap()
}

/// Returns the depth of a body whose force several taxels share, m: forces add, depths do not.
fn body_m(readings_n: &[f64]) -> f64 {
    FOAM.depth_m(
        readings_n.iter().map(|reading_n| FOAM.force_n::<f64>(READING.depth_m(*reading_n))).sum::<f64>(),
    )
}

/// A body on a seam is as deep as all of its force says, of which a taxel is only told its share.
#[test]
fn a_seam_counts_with_what_both_taxels_feel_and_hide() {
    let depth_m = |forces_n: &[(usize, f64)], light: &[usize]| {
        let limits = pressed(&mut barrier(), forces_n, light);
        (limits.depth_m[FRONT], limits.force_n[FRONT])
    };
    // T5 and T7 beside T6; T2 is far away
    for (forces_n, light, counted_n) in [
        (&[(FRONT, 6.0)][..], &[][..], &[6.0][..]),
        (&[(FRONT, 6.0), (4, 2.0)], &[], &[6.0, 2.0]),
        (&[(FRONT, 6.0), (4, 1.0), (6, 1.5)], &[], &[6.0, 1.0, 1.5]),
        (&[(FRONT, 6.0), (4, 10.0)], &[], &[6.0, 6.0]),
        (&[(FRONT, 1.5), (4, 10.0)], &[], &[1.5, 1.5]),
        (&[(FRONT, 1.0), (4, 10.0)], &[], &[1.0, 1.0]),
        (&[(FRONT, 6.0), (4, 0.9)], &[], &[6.0]),
        (&[(FRONT, 6.0), (4, 1.0)], &[], &[6.0, 1.0]),
        (&[(FRONT, 6.0)], &[4], &[6.0, 1.0]),
        (&[(FRONT, 6.0)], &[4, 6], &[6.0, 1.0, 1.0]),
        (&[(FRONT, 6.0), (4, 3.0)], &[4], &[6.0, 3.0]),
        (&[(FRONT, 6.0), (1, 5.0)], &[1], &[6.0]),
    ] {
        let (depth, force) = depth_m(forces_n, light);
        assert!((depth - body_m(counted_n)).abs() < 1e-12, "{forces_n:?} {light:?}: {depth}");
        assert!((force - forces_n[0].1).abs() < 1e-9, "never more than was felt: {force}");
    }
    // what was let go of a moment ago may be pressed still
    let mut barrier = barrier();
    pressed(&mut barrier, &[(4, 5.0)], &[]);
    pressed(&mut barrier, &[], &[]);
    let depth = pressed(&mut barrier, &[(FRONT, 6.0)], &[]).depth_m[FRONT];
    assert!((depth - body_m(&[6.0, 1.0])).abs() < 1e-12, "{depth}");
}

/// The base goes no further before a touched person, however light the touch, nor with the neighbours on that side.
#[test]
fn who_is_touched_holds_his_side_of_the_cover_for_two_seconds() {
    let held = |limits: &ContactLimits<11>| -> Vec<usize> {
        (0..11).filter(|&i| limits.outward_m_s[i] <= 0.0).collect()
    };
    // T4 is as near to T5 as T6, and round the corner
    for (taxel, side) in [(FRONT, vec![4, 5, 6]), (4, vec![4, 5]), (1, vec![0, 1, 2]), (3, vec![2, 3])] {
        let mut barrier = barrier();
        for (forces_n, light) in [(&[(taxel, 12.0)][..], &[][..]), (&[], &[taxel])] {
            pressed(&mut barrier, forces_n, light);
            assert_eq!(held(&pressed(&mut barrier, forces_n, light)), side, "T{}", taxel + 1);
            let steps = (0..3000).take_while(|_| held(&pressed(&mut barrier, &[], &[])).contains(&taxel));
            assert_eq!(steps.count(), 2048, "T{}", taxel + 1);
        }
    }
}

/// A reading's believed depth shrinks with the force on the whole body once the base has retreated from it.
#[test]
fn of_a_body_on_a_seam_each_taxel_is_believed_its_share() {
    let mut barrier = barrier();
    let away = |barrier: &mut ContactBarrier<11>, age: usize| {
        let age_s = seconds(age);
        let mut input = BarrierInput::new([None; 11], [-0.13, 0.0, 0.0], [3.0, 3.0, 6.0], DT_S);
        input.samples = [Some(TaxelSample { force_n: 0.0, age_s }); 11];
        input.samples[FRONT] = Some(TaxelSample { force_n: 6.0, age_s });
        input.samples[4] = Some(TaxelSample { force_n: 2.0, age_s });
        barrier.update(&input).unwrap()
    };
    away(&mut barrier, 0);
    let limits = away(&mut barrier, 1);
    let eased_m = limits.depth_m[FRONT] + 0.05 * (-0.13 + limits.person_m_s[FRONT] + 0.01);
    let expected = 6.0 * FOAM.force_n(eased_m) / FOAM.force_n(body_m(&[6.0, 2.0]));
    assert!(
        eased_m > 0.0 && expected < 6.0 && (limits.force_n[FRONT] - expected).abs() < 1e-9,
        "{expected} {limits:?}"
    );
}

/// Neighbours of a cover are at most a fifth further apart than the loneliest of its taxels is from its own.
#[test]
fn neighbours_are_a_fifth_further_apart_at_most() {
    let sharing = |far_m: f64| {
        // an isosceles triangle with two sides of 0.5 m
        let cos = 1.0 - 0.5 * (far_m / 0.5) * (far_m / 0.5);
        let places = [[0.0, 0.0], [0.0, 0.5], [0.5 * (1.0 - cos * cos).sqrt(), 0.5 * cos]];
        let taxels = places.map(|position_base_m| TaxelPlacement { position_base_m, ..PAPER_COVER[FRONT] });
        let mut barrier = ContactBarrier::<11>::new(&taxels, &settings()).unwrap();
        let depth_m = pressed(&mut barrier, &[(1, 6.0), (2, 6.0)], &[]).depth_m[1];
        (depth_m - body_m(&[6.0, 6.0])).abs() < 1e-12
    };
    assert!(sharing(0.51) && sharing(0.59) && !sharing(0.61));
}

/// The tool goes along where a retreat would stretch the arm, and nowhere else.
#[test]
fn tool_follows_retreat_of_stretched_arm() {
    let reach = ArmReach { place_base_m: [0.1, -0.2], stretch_m: [0.25, 0.35] };
    for (force_n, from_place_m, share) in [
        (40.0, [0.18, 0.24], 0.5),
        (40.0, [0.24, -0.18], 0.5),
        (40.0, [0.0, 0.4], 1.0),
        (40.0, [0.0, 0.2], 0.0),
        // between the depths the base stands and makes no room
        (20.0, [0.4, 0.0], 0.0),
    ] {
        // slowly away from the tool
        let away = [-0.01 * from_place_m[0], -0.01 * from_place_m[1], 0.0];
        let mut input = BarrierInput::new([None; 11], away, [3.0, 3.0, 6.0], DT_S);
        input.samples[FRONT] = Some(TaxelSample { force_n, age_s: 0.0 });
        input.tool_base_m = Some([from_place_m[0] + 0.1, from_place_m[1] - 0.2]);
        let settings = BarrierSettings { first_speed_m_s: 0.0, reach: Some(reach), ..settings() };
        let mut barrier = ContactBarrier::<11>::new(&PAPER_COVER, &settings).unwrap();
        let limits = barrier.update(&input).unwrap();
        assert_eq!(limits.outward_m_s[FRONT] == 0.0, force_n < 30.0, "{limits:?}");
        let carried = limits.carried_body_m_s;
        assert!(
            (0..2).all(|i| (carried[i] - share * away[i]).abs() < 1e-9),
            "{force_n} N, {from_place_m:?} m: {carried:?}"
        );
        // the place goes with the base's turns, 0.2 m beside and 0.1 m before its middle
        let length = f64::hypot(from_place_m[0], from_place_m[1]);
        for yaw_rate in [-0.05, 0.05] {
            let mut barrier = ContactBarrier::<11>::new(&PAPER_COVER, &settings).unwrap();
            let turning = BarrierInput { velocity_body: [away[0], away[1], yaw_rate], ..input };
            let carried = barrier.update(&turning).unwrap().carried_body_m_s;
            let place = [away[0] + 0.2 * yaw_rate, away[1] + 0.1 * yaw_rate];
            let behind = (0..2).map(|i| place[i] * from_place_m[i] / length).sum::<f64>().min(0.0);
            assert!(
                (0..2).all(|i| (carried[i] - share * behind * from_place_m[i] / length).abs() < 1e-9),
                "{force_n} N, {from_place_m:?} m, {yaw_rate} rad/s: {carried:?}"
            );
        }
        // without an arm that holds its place there is nothing to take along
        for (tool_base_m, reach) in [(None, Some(reach)), (input.tool_base_m, None)] {
            let settings = BarrierSettings { reach, ..settings };
            let mut barrier = ContactBarrier::<11>::new(&PAPER_COVER, &settings).unwrap();
            let limits = barrier.update(&BarrierInput { tool_base_m, ..input }).unwrap();
            assert_eq!(limits.carried_body_m_s, [0.0; 2]);
        }
    }
}

/// Three centimetres back at most, for 0.6 s at most, and only then does a robot in a stop stand.
#[test]
fn what_ends_in_a_touch_is_backed_off_from_as_far_as_said() {
    for (speed, steps) in [(-0.2, 154), (-0.01, 614)] {
        let mut barrier = barrier();
        pressed(&mut barrier, &[(FRONT, 6.0)], &[]);
        let mut input = BarrierInput::new([None; 11], [0.0; 3], [3.0, 3.0, 6.0], DT_S);
        for step in 0..1000 {
            let limits = barrier.update(&input).unwrap();
            let backs = limits.outward_m_s[FRONT] == -0.3;
            assert_eq!(backs, step < steps, "{speed} m/s, step {step}: {limits:?}");
            assert_eq!(limits.backs_off, backs);
            assert!(backs || limits.outward_m_s[FRONT] == 0.0);
            input.velocity_body[0] = speed;
        }
    }
}

#[test]
fn a_barrier_goes_on_from_what_another_remembers() {
    let (mut first, mut second) = (barrier(), barrier());
    let felt =
        |step: usize| Felt { force_n: 6.0, age: step % 7, light: false, speed: 0.02, deceleration: 3.0 };
    (0..50).for_each(|step| _ = felt(step).given_to(&mut first));
    second.restore(first.state());
    for step in 50..80 {
        assert_eq!(felt(step).given_to(&mut first), felt(step).given_to(&mut second));
    }
    assert_ne!(felt(80).given_to(&mut first), felt(80).given_to(&mut barrier()));
}

#[test]
fn a_foam_out_of_range_is_named_with_its_range() {
    let hyperbolic = |stiffness_n_m, thickness_m| FoamCurve::Hyperbolic { stiffness_n_m, thickness_m };
    let power = |depth_at_100n_m, exponent| FoamCurve::Power { depth_at_100n_m, exponent };
    for (foam, name) in [
        (hyperbolic(0.5, 0.015), "foam stiffness"),
        (hyperbolic(f64::NAN, 0.015), "foam stiffness"),
        (hyperbolic(2105.0, 2.0), "foam thickness"),
        (power(0.0, 1.5), "foam depth at 100 N"),
        (power(0.01, 11.0), "foam exponent"),
    ] {
        for (reading, foam) in [(FOAM, foam), (foam, FOAM)] {
            assert_eq!(BarrierSettings::new(reading, foam, 25.0, 0.015).unwrap_err().name, name);
        }
    }
}

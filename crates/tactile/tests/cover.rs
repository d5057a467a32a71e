//! A cover against a virtual board: tare, contact, drift, and every fault of a taxel with its detection time.
#![expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small positive test numbers")]
#![expect(clippy::unwrap_used, clippy::panic, reason = "tests")]

use moca_msgs::{BoardFault, Fault, TaxelStatus};
use moca_tactile::board::{BoardEvent, CloseReason, OpenFailure};
use moca_tactile::cover::{COMMON_MODE_FRAMES, EarlyContact, MaskPolicy};
use moca_tactile::datastream::{Frame, emit};
use moca_tactile::health::{ABOVE_ZERO_FRAMES, DEAD_FRAMES, STUCK_FRAMES};
use moca_tactile::zero::{DRIFT_BUDGET, ExpectedRest, TARE_FRAMES};
use moca_tactile::{Cover, CoverConfig, TareRefusal, TareStatus, TaxelModel};

const PERIOD_NS: u64 = 24_700_000;
const IDLE: f64 = 720.0;

/// A board whose electrodes fall by `drop` counts, with normal noise of `sigma` counts.
struct Bench {
    cover: Cover<11>,
    now_ns: u64,
    drop: [f64; 12],
    sigma: [f64; 12],
    baseline: u16,
    thresholds: u8,
    random: u64,
}

impl Bench {
    fn new(config: CoverConfig<11>) -> Self {
        Self {
            cover: Cover::new(config).unwrap(),
            now_ns: 1_000_000_000,
            drop: [0.0; 12],
            sigma: [0.7; 12],
            baseline: 720,
            thresholds: 40,
            random: 1,
        }
    }

    fn tared() -> Self {
        let mut bench = Self::new(CoverConfig { models: [TaxelModel::PAPER; 11], ..CoverConfig::default() });
        bench.tare();
        assert!(bench.cover.zero_valid(), "{:?}", bench.cover.tare_status());
        bench
    }

    /// Sum of 12 uniform numbers: mean 0, deviation 1.
    fn normal(&mut self) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            self.random =
                self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += f64::from((self.random >> 33) as u32) / f64::from(1u32 << 31);
        }
        sum
    }

    fn frame(&mut self) {
        self.now_ns += PERIOD_NS;
        let mut frame = Frame { touch_threshold: [self.thresholds; 13], ..Frame::default() };
        for e in 0..12 {
            let noise = self.sigma[e] * self.normal();
            frame.filtered[e] = (IDLE - self.drop[e] + noise).round().clamp(0.0, 1023.0) as u16;
            frame.baseline[e] = self.baseline;
        }
        let mut bytes = Vec::new();
        emit(&frame, &mut bytes);
        self.cover.push(0, &bytes, self.now_ns);
    }

    fn frames(&mut self, count: u32) {
        for _ in 0..count {
            self.frame();
        }
    }

    /// Early touches of a frame with `drop` counts on T6.
    fn early(&mut self, drop: f64) -> EarlyContact<11> {
        self.drop[5] = drop;
        self.frame();
        self.cover.poll(self.now_ns).early
    }

    fn tare(&mut self) {
        self.cover.start_tare(self.now_ns);
        self.frames(TARE_FRAMES);
    }

    fn fault(&mut self) -> Option<Fault> {
        self.cover.poll(self.now_ns).fault
    }

    fn force_n(&mut self, taxel: usize) -> f64 {
        let reading = self.cover.poll(self.now_ns).reading.taxels[taxel];
        assert_eq!(reading.status, TaxelStatus::Ok);
        reading.force_n
    }

    /// Frames until `fault` shows, at most `limit`.
    fn frames_until(&mut self, fault: Fault, limit: u32) -> u32 {
        for count in 1..=limit {
            self.frame();
            if self.fault() == Some(fault) {
                return count;
            }
        }
        panic!("{fault:?} not found within {limit} frames, but {:?}", self.fault());
    }
}

#[test]
fn without_a_zero_there_is_a_fault_and_no_force() {
    let mut bench = Bench::new(CoverConfig::default());
    assert_eq!(bench.cover.poll(0).reading.sampled_at_ns, None);
    bench.frames(3);
    let poll = bench.cover.poll(bench.now_ns);
    assert_eq!(poll.forces, Err((0, TaxelStatus::NoZero)));
    assert_eq!(poll.fault, Some(Fault::ZeroInvalid));
}

#[test]
fn tare_gives_quality_and_hides_noise() {
    let mut bench = Bench::tared();
    let TareStatus::Done(quality) = bench.cover.tare_status() else { panic!() };
    assert_eq!(quality.frames, TARE_FRAMES);
    assert!((0.5..1.5).contains(&quality.worst_deviation), "{quality:?}");
    let known = bench.cover.zeros().iter().flatten().fold(0.0, |worst: f64, zero| worst.max(zero.deviation));
    assert!((known - quality.worst_deviation).abs() < f64::EPSILON, "{known} {quality:?}");
    for _ in 0..2400 {
        bench.frame();
        assert_eq!(bench.cover.poll(bench.now_ns).forces, Ok([0.0; 11]));
    }
}

#[test]
fn contact_begins_at_four_counts_and_ends_below_two() {
    let mut bench = Bench::tared();
    bench.sigma = [0.0; 12];
    for (drop, felt) in [(3, false), (5, true), (3, true), (1, false), (3, false), (5, true), (1, false)] {
        bench.drop[4] = f64::from(drop);
        bench.frame();
        let zero = bench.cover.zeros()[4].unwrap().counts;
        let expected_n = if felt { (zero - (IDLE - f64::from(drop))) * 100.0 / 84.0 } else { 0.0 };
        assert!((bench.force_n(4) - expected_n).abs() < 1e-9, "{drop} counts");
    }
}

#[test]
fn subthreshold_touch_is_found_and_lost_again() {
    let mut bench = Bench::tared();
    let early = |bench: &mut Bench| bench.cover.poll(bench.now_ns).early.light;
    for _ in 0..4000 {
        bench.frame();
        assert_eq!(early(&mut bench), [false; 11], "nobody touches");
    }
    // 1.5 N on PU LD30
    bench.drop[4] = 1.7;
    let found = (1..100).find(|_| {
        bench.frame();
        early(&mut bench)[4]
    });
    assert!((3..20).contains(&found.unwrap()), "{found:?}");
    assert!(bench.cover.poll(bench.now_ns).forces.unwrap().iter().all(|force_n| *force_n == 0.0));
    assert_eq!(early(&mut bench).iter().filter(|touched| **touched).count(), 1);
    bench.drop[4] = 0.0;
    bench.frames(20);
    assert_eq!(early(&mut bench), [false; 11]);
}

#[test]
fn a_light_touch_is_found_beside_a_firm_one() {
    let mut bench = Bench::tared();
    (bench.drop[4], bench.drop[5]) = (20.0, 1.7);
    let found = (1..100).find(|_| {
        bench.frame();
        bench.cover.poll(bench.now_ns).early.light[5]
    });
    assert!((3..20).contains(&found.unwrap()), "{found:?}");
    let early = bench.cover.poll(bench.now_ns).early;
    assert!(!early.light[4] && !early.certain[4], "that one has a force");
    assert!(!early.certain[5], "that alarm may be a false one");
}

#[test]
fn light_touch_becomes_certain_after_its_alarm_until_it_ends() {
    let mut bench = Bench::tared();
    let mut felt = |drop| {
        let early = bench.early(drop);
        (early.light[5], early.certain[5])
    };
    let touched: Vec<_> = (0..40).map(|_| felt(1.7)).collect();
    let count = |state| touched.iter().filter(|felt| **felt == state).count();
    assert!(count((true, false)) > 0 && count((true, true)) > 20 && count((false, true)) == 0, "{touched:?}");
    assert!(
        touched.is_sorted_by_key(|(light, certain)| u8::from(*light) + u8::from(*certain)),
        "{touched:?}"
    );
    let left: Vec<_> = (0..40).map(|_| felt(0.0)).collect();
    assert_eq!((left[0], left[39]), ((true, true), (false, false)), "{left:?}");
}

#[test]
fn light_touch_is_halfway_before_its_alarm_and_shows_its_force() {
    let mut bench = Bench::tared();
    let mut felt = |drop| {
        let early = bench.early(drop);
        assert!(!(early.halfway[5] && early.light[5]), "one or the other");
        assert!(!early.halfway[4], "nobody touches that one");
        (early.light[5], early.halfway[5], early.light_n[5])
    };
    let touched: Vec<_> = (0..40).map(|_| felt(1.7)).collect();
    let alarm = touched.iter().position(|(light, ..)| *light).unwrap();
    let halfway = touched.iter().position(|(_, halfway, _)| *halfway).unwrap();
    assert!((1..alarm).contains(&halfway), "{touched:?}");
    assert!(touched[halfway..alarm].iter().all(|(_, halfway, _)| *halfway), "{touched:?}");
    assert!(touched[halfway..].iter().any(|(.., force_n)| *force_n > 0.5), "{touched:?}");
    let before_n = touched[..halfway].iter().map(|(.., force_n)| *force_n);
    assert!(before_n.fold(0.0, f64::max) <= 0.0, "{touched:?}");
    // a force that is felt is no half of an alarm
    let firm: Vec<_> = (0..5).map(|_| felt(20.0)).collect();
    assert!(firm.iter().all(|(light, halfway, _)| !light && !halfway), "{firm:?}");
}

/// After a touch the foam comes back by an exponential: that is not felt, and who comes again meanwhile is.
#[test]
fn light_touch_is_found_on_recovering_foam() {
    let mut bench = Bench::tared();
    let light = |bench: &mut Bench| bench.cover.poll(bench.now_ns).early.light[4];
    let left = |frames: f64| 1.9 * (-frames * 0.0247 / 0.4).exp();
    for again_after in [8.0, 20.0, 40.0, 80.0] {
        let mut false_alarms = 0;
        for _ in 0..40 {
            bench.drop[4] = 20.0;
            bench.frames(40);
            let mut frames = 0.0;
            while frames < again_after {
                bench.drop[4] = left(frames);
                bench.frame();
                false_alarms += u32::from(light(&mut bench));
                frames += 1.0;
            }
            let found = (1..200).find(|_| {
                bench.drop[4] = left(frames) + 3.0;
                bench.frame();
                frames += 1.0;
                light(&mut bench) || bench.cover.poll(bench.now_ns).forces.unwrap()[4] > 0.0
            });
            assert!(found.is_some_and(|frames| frames <= 12), "{found:?}, {again_after}");
        }
        assert_eq!(false_alarms, 0, "in {again_after} frames after each of 40 releases");
    }
}

/// While somebody leans on one taxel for minutes the others' drift is not followed, and a foam that is slow keeps counts
/// below zero for longer than drift waits: neither is a touch.
#[test]
fn drift_or_long_recovery_is_no_light_touch() {
    let mut bench = Bench::tared();
    let light = |bench: &mut Bench| bench.cover.poll(bench.now_ns).early.light;
    bench.drop[4] = 20.0;
    for frame in 0..2400 {
        bench.drop[7] = 1.5 * f64::from(frame) / 2400.0;
        bench.frame();
        assert_eq!(light(&mut bench), [false; 11], "frame {frame}");
    }
    bench.drop[7] = 0.0;
    for frame in 0..400 {
        bench.drop[4] = 1.5 * (-f64::from(frame) * 0.0247 / 4.0).exp();
        bench.frame();
        assert!(!light(&mut bench)[4], "{frame} frames after the release");
    }
}

#[test]
fn a_tare_is_refused_while_touched_noisy_or_without_frames() {
    let mut bench = Bench::new(CoverConfig::default());
    bench.drop[2] = 20.0;
    bench.tare();
    let status = bench.cover.tare_status();
    assert!(
        matches!(status, TareStatus::Refused(TareRefusal::Touched { taxel: 2, counts }) if counts > 15.0),
        "{status:?}"
    );

    let mut bench = Bench::tared();
    let zeros = bench.cover.zeros();
    // the chip's baseline has followed the hand, so only the old zero can tell
    bench.drop[5] = 30.0;
    bench.baseline = 692;
    bench.tare();
    assert!(matches!(bench.cover.tare_status(), TareStatus::Refused(TareRefusal::Touched { taxel: 5, .. })));
    assert_eq!(bench.cover.zeros(), zeros, "a refused tare leaves the old zero");

    let mut bench = Bench::new(CoverConfig::default());
    bench.sigma[7] = 3.0;
    bench.tare();
    let status = bench.cover.tare_status();
    assert!(matches!(status, TareStatus::Refused(TareRefusal::Noisy { taxel: 7, .. })), "{status:?}");

    let mut bench = Bench::new(CoverConfig::default());
    bench.cover.start_tare(0);
    bench.cover.poll(6_000_000_000);
    assert_eq!(bench.cover.tare_status(), TareStatus::Refused(TareRefusal::NoFrames));

    let mut bench = Bench::new(CoverConfig::default());
    bench.drop[3] = -303.0;
    bench.tare();
    let status = bench.cover.tare_status();
    let dead = TareRefusal::Unusable { taxel: 3, status: TaxelStatus::Dead };
    assert_eq!(status, TareStatus::Refused(dead));
}

#[test]
fn a_zero_taken_under_a_hand_is_void_once_the_hand_has_gone() {
    // The board was switched on with the hand there: its own baseline knows no better.
    let mut bench = Bench::new(CoverConfig::default());
    (bench.drop[2], bench.baseline) = (28.0, 692);
    bench.tare();
    assert!(bench.cover.zero_valid(), "nothing tells this hand from rest: {:?}", bench.cover.tare_status());
    bench.frames(40);
    assert!(bench.cover.zero_valid());

    bench.drop[2] = 0.0;
    assert_eq!(bench.frames_until(Fault::ZeroInvalid, 20), ABOVE_ZERO_FRAMES);
    bench.drop[2] = 28.0;
    bench.frames(20);
    assert_eq!(bench.fault(), Some(Fault::ZeroInvalid), "the press would read as nothing: only a tare helps");
    (bench.drop[2], bench.baseline) = (0.0, 720);
    bench.tare();
    assert_eq!(bench.fault(), None);
}

#[test]
fn small_rise_or_lost_plate_is_no_release() {
    let mut bench = Bench::tared();
    bench.drop[2] = -3.0;
    bench.frames(400);
    assert_eq!(bench.fault(), None);
    bench.drop[2] = -60.0;
    bench.frames(40);
    assert_eq!(bench.fault(), Some(Fault::TaxelInvalid { taxel: 2, status: TaxelStatus::Dead }));
    assert!(bench.cover.zero_valid(), "a lost plate is named, its zero is not what is wrong");
}

#[test]
fn calibration_refuses_tare_away_from_rest() {
    let expected = ExpectedRest { counts: IDLE, range_counts: 10.0 };
    let config = CoverConfig { expected_rest: [Some(expected); 11], ..CoverConfig::default() };
    for (drop, refused) in [(28.0, true), (-28.0, true), (8.0, false), (-8.0, false)] {
        let mut bench = Bench::new(config);
        (bench.drop[2], bench.baseline) = (drop, 692);
        bench.tare();
        let status = bench.cover.tare_status();
        let not_at_rest = matches!(status, TareStatus::Refused(TareRefusal::NotAtRest { taxel: 2, counts, expected: e })
                if (counts - (IDLE - drop)).abs() < 1.0 && e == expected);
        assert_eq!(not_at_rest, refused, "{drop}: {status:?}");
        assert_eq!(bench.cover.zero_valid(), !refused, "{drop}");
    }
}

#[test]
fn no_reading_is_above_the_largest_force_that_is_believed() {
    let config = CoverConfig { force_max_n: 200.0, ..CoverConfig::default() };
    let mut bench = Bench::new(config);
    bench.tare();
    bench.drop[4] = 60.0;
    bench.frame();
    let below_n = bench.force_n(4);
    assert!((80.0..90.0).contains(&below_n), "{below_n}");
    bench.drop[4] = 480.0;
    bench.frame();
    assert_eq!(bench.force_n(4).to_bits(), 200.0_f64.to_bits());
    for wrong in [0.0, f64::NAN] {
        assert!(Cover::new(CoverConfig { force_max_n: wrong, ..config }).is_err(), "{wrong}");
    }
}

#[test]
fn ten_minutes_of_leaning_are_not_followed_away() {
    let mut bench = Bench::tared();
    bench.drop[1] = 28.0;
    bench.baseline = 692;
    let mut mean_of = |frames: u32| {
        let mut sum = 0.0;
        for _ in 0..frames {
            bench.frame();
            sum += bench.force_n(1);
        }
        sum / f64::from(frames)
    };
    let first_minute = mean_of(2430);
    mean_of(8 * 2430);
    let last_minute = mean_of(2430);
    assert!((last_minute / first_minute - 1.0).abs() < 0.01, "{first_minute} {last_minute}");
}

#[test]
fn slow_drift_is_followed_and_beyond_its_budget_a_fault() {
    let mut bench = Bench::tared();
    let per_frame = 0.6 / 60.0 * 0.0247; // 0.6 counts a minute
    let mut frames = 0;
    while bench.fault().is_none() {
        bench.drop = bench.drop.map(|drop| drop + per_frame);
        bench.frame();
        frames += 1;
        assert!(frames < 100_000);
    }
    let drifted = Fault::TaxelInvalid { taxel: 0, status: TaxelStatus::Drifted };
    assert!(
        matches!(bench.fault(), Some(Fault::TaxelInvalid { status: TaxelStatus::Drifted, .. })),
        "{drifted:?}"
    );
    assert!((bench.drop[0] - DRIFT_BUDGET).abs() < 1.5, "{}", bench.drop[0]);
    bench.baseline = 708; // the chip's baseline follows too
    bench.tare();
    assert_eq!(bench.fault(), None, "a new tare starts a new budget");
}

#[test]
fn silence_is_stale_within_120_ms_and_recovers_without_a_tare() {
    let mut bench = Bench::tared();
    let last_ns = bench.now_ns;
    assert_eq!(bench.cover.poll(last_ns + 119_000_000).fault, None);
    let poll = bench.cover.poll(last_ns + 121_000_000);
    assert_eq!(poll.fault, Some(BoardFault::Silent.of(0)));
    assert_eq!(poll.forces, Err((0, TaxelStatus::Stale)));
    bench.now_ns += 300_000_000;
    bench.frame();
    assert_eq!(bench.cover.poll(bench.now_ns).forces, Err((0, TaxelStatus::Stale)), "as old as the gap");
    bench.frame();
    assert_eq!(bench.cover.poll(bench.now_ns).forces, Ok([0.0; 11]));
}

#[test]
fn silence_while_the_host_did_not_run_is_the_hosts() {
    let mut bench = Bench::tared();
    let at_ns = bench.now_ns + 110_000_000;
    bench.cover.event(0, &BoardEvent::Starved { at_ns });
    assert_eq!(bench.cover.poll(at_ns).fault, None, "nothing is late yet");
    let poll = bench.cover.poll(at_ns + 20_000_000);
    assert_eq!(
        (poll.fault, poll.forces),
        (Some(BoardFault::HostStarved.of(0)), Err((0, TaxelStatus::Stale)))
    );
    assert_eq!(bench.cover.poll(at_ns + 990_000_000).fault, Some(BoardFault::HostStarved.of(0)));
    assert_eq!(
        bench.cover.poll(at_ns + 1_010_000_000).fault,
        Some(BoardFault::Silent.of(0)),
        "a dead board after all"
    );
    bench.now_ns += 30_000_000;
    bench.frame();
    assert_eq!(bench.fault(), None);
    bench.now_ns += 130_000_000;
    assert_eq!(bench.fault(), Some(BoardFault::Silent.of(0)), "the next silence is the board's again");
}

#[test]
fn slow_frames_are_named_without_blaming_a_plate() {
    let mut bench = Bench::tared();
    for _ in 0..20 {
        bench.now_ns += 111_000_000 - PERIOD_NS;
        bench.frame();
    }
    assert_eq!(bench.fault(), Some(BoardFault::Slow.of(0)), "9 Hz");
    bench.frames(2);
    assert_eq!(bench.fault(), None);
}

#[test]
fn frozen_reset_and_changed_thresholds_void_the_zero() {
    let mut bench = Bench::tared();
    bench.sigma = [0.0; 12];
    assert!(bench.frames_until(BoardFault::Frozen.of(0), 15) > 10);
    bench.sigma = [0.7; 12];
    bench.frame();
    assert_eq!(bench.fault(), Some(Fault::ZeroInvalid));

    let mut bench = Bench::tared();
    (bench.drop, bench.sigma) = ([IDLE; 12], [0.0; 12]);
    assert_eq!(bench.frames_until(BoardFault::Reset.of(0), 1), 1);
    assert!(!bench.cover.zero_valid());

    let mut bench = Bench::tared();
    bench.thresholds = 41;
    assert_eq!(bench.frames_until(BoardFault::Thresholds.of(0), 1), 1);
    assert!(!bench.cover.zero_valid());
}

#[test]
fn re_enumeration_voids_zero_and_gain() {
    let mut bench = Bench::tared();
    let at_ns = bench.now_ns;
    bench.cover.event(0, &BoardEvent::Closed { at_ns, why: CloseReason::Disconnected });
    assert_eq!(bench.fault(), Some(BoardFault::Lost.of(0)));
    bench.cover.event(0, &BoardEvent::OpenFailed { at_ns, why: OpenFailure::NotFound });
    assert_eq!(bench.fault(), Some(BoardFault::Lost.of(0)));
    bench.cover.event(0, &BoardEvent::Opened { at_ns });
    bench.frames(2);
    assert_eq!(bench.fault(), Some(Fault::ZeroInvalid));
    bench.tare();
    assert_eq!(bench.fault(), None);
}

#[test]
fn faults_of_one_taxel_are_found_in_their_time() {
    let invalid = |status| Fault::TaxelInvalid { taxel: 6, status };

    let mut bench = Bench::tared();
    bench.drop[6] = -IDLE;
    assert_eq!(bench.frames_until(invalid(TaxelStatus::Saturated), 1), 1);

    let mut bench = Bench::tared();
    bench.drop[6] = -60.0;
    assert_eq!(bench.frames_until(invalid(TaxelStatus::Dead), DEAD_FRAMES), DEAD_FRAMES);

    let mut bench = Bench::tared();
    bench.sigma[6] = 0.0;
    bench.frames_until(invalid(TaxelStatus::Stuck), STUCK_FRAMES + 1);

    let mut bench = Bench::tared();
    bench.sigma[6] = 8.0;
    bench.frames_until(invalid(TaxelStatus::Noisy), 100);

    let mut bench = Bench::tared();
    bench.drop = [6.0; 12];
    assert_eq!(bench.frames_until(BoardFault::CommonMode.of(0), COMMON_MODE_FRAMES + 3), COMMON_MODE_FRAMES);
}

#[test]
fn a_sagging_supply_is_found_though_taxels_shift_unevenly() {
    let mut bench = Bench::tared();
    bench.drop = core::array::from_fn(|e| 17.0 + 0.6 * e as f64);
    assert_eq!(bench.frames_until(BoardFault::CommonMode.of(0), COMMON_MODE_FRAMES + 3), COMMON_MODE_FRAMES);
}

#[test]
fn a_taxel_at_the_end_of_its_range_is_saturated_at_a_tare() {
    for (drop, status) in
        [(-303.0, TaxelStatus::Saturated), (600.0, TaxelStatus::Saturated), (-290.0, TaxelStatus::Dead)]
    {
        let mut bench = Bench::new(CoverConfig::default());
        (bench.drop[3], bench.sigma[3]) = (drop, 0.0);
        bench.baseline = 0;
        bench.tare();
        let refused = TareStatus::Refused(TareRefusal::Unusable { taxel: 3, status });
        assert_eq!(bench.cover.tare_status(), refused, "{drop}");
    }
}

#[test]
fn pushing_hard_and_fast_is_no_fault() {
    let mut bench = Bench::tared();
    for i in 0..400 {
        let force = 42.0 * (1.0 - (f64::from(i) * 0.0247 * 2.0 * core::f64::consts::TAU).cos());
        bench.drop[6] = force;
        bench.drop[5] = 0.5 * force;
        bench.frame();
        assert_eq!(bench.fault(), None, "frame {i}");
    }
}

#[test]
fn a_masked_taxel_is_reported_and_its_policy_is_chosen() {
    let mut masked = [false; 11];
    masked[3] = true;
    let mut bench = Bench::new(CoverConfig { masked, ..CoverConfig::default() });
    bench.drop[3] = -303.0; // its wire is broken
    bench.tare();
    let poll = bench.cover.poll(bench.now_ns);
    assert_eq!(poll.forces, Err((3, TaxelStatus::Masked)));
    assert_eq!(poll.fault, Some(Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Masked }));

    let mut bench =
        Bench::new(CoverConfig { masked, mask_policy: MaskPolicy::Ignore, ..CoverConfig::default() });
    bench.tare();
    let poll = bench.cover.poll(bench.now_ns);
    assert_eq!((poll.forces, poll.fault), (Ok([0.0; 11]), None));
    assert_eq!(poll.reading.taxels[3].status, TaxelStatus::Masked);
}

#[test]
fn bytes_lost_on_the_way_make_no_frame_of_two_halves() {
    let mut bench = Bench::tared();
    let good = bench.cover.boards().next().unwrap().stats().frames_good;
    let mut bytes = Vec::new();
    emit(&Frame { touch_threshold: [40; 13], ..Frame::default() }, &mut bytes);
    bench.cover.push(0, &bytes[..100], bench.now_ns);
    bench.cover.event(0, &BoardEvent::Gap { at_ns: bench.now_ns, bytes_lost: 300 });
    bench.cover.push(0, &bytes[100..], bench.now_ns);
    let stats = *bench.cover.boards().next().unwrap().stats();
    assert_eq!((stats.frames_good, stats.bytes_lost), (good, 300));
}

#[test]
fn what_a_board_sends_is_counted_and_its_rate_is_measured() {
    let mut bench = Bench::tared();
    let rate_hz = bench.cover.boards().next().unwrap().rate_hz();
    assert!((rate_hz - 1e9 / PERIOD_NS as f64).abs() < 0.01, "{rate_hz}");
    // A pause is no interval of the board's.
    bench.now_ns += 500_000_000;
    bench.frames(3);
    let after_hz = bench.cover.boards().next().unwrap().rate_hz();
    assert!((after_hz - rate_hz).abs() < 0.01, "{after_hz}");
    // Another rate is found.
    for _ in 0..100 {
        bench.now_ns += PERIOD_NS / 4;
        bench.frame();
    }
    let slower_hz = bench.cover.boards().next().unwrap().rate_hz();
    assert!((slower_hz - 0.8 * rate_hz).abs() < 0.2, "{slower_hz}");

    let before = *bench.cover.boards().next().unwrap().stats();
    let broken = b"TOUCH: 0 0\nFDAT: 1 x\n";
    bench.cover.push(0, broken, bench.now_ns);
    let mut bytes = Vec::new();
    emit(&Frame { touch_threshold: [40; 13], ..Frame::default() }, &mut bytes);
    bench.cover.push(0, &bytes, bench.now_ns);
    let after = *bench.cover.boards().next().unwrap().stats();
    assert_eq!(after.bytes, before.bytes + (broken.len() + bytes.len()) as u64);
    assert_eq!(after.frames_bad, before.frames_bad + 1);
}

#[test]
fn the_first_frame_after_lost_bytes_is_counted_and_not_used() {
    let mut bench = Bench::tared();
    let at_ns = bench.now_ns;
    bench.cover.event(0, &BoardEvent::Gap { at_ns, bytes_lost: 300 });
    let discarded = |bench: &Bench| bench.cover.boards().next().unwrap().stats().frames_discarded;
    let before = discarded(&bench);
    bench.frame();
    assert_eq!(discarded(&bench), before + 1, "its age is not known");
    bench.frame();
    assert_eq!(discarded(&bench), before + 1);
}

#[test]
fn two_boards_make_one_cover_as_old_as_the_older() {
    let mut cover = Cover::<24>::new(CoverConfig::default()).unwrap();
    let frame = Frame { filtered: [700; 13], baseline: [700; 13], ..Frame::default() };
    let mut bytes = Vec::new();
    emit(&frame, &mut bytes);
    cover.push(0, &bytes, 50_000_000);
    assert_eq!(cover.poll(50_000_000).reading.sampled_at_ns, None, "the second board has not spoken");
    cover.push(1, &bytes, 60_000_000);
    assert_eq!(
        cover.poll(60_000_000).reading.sampled_at_ns,
        Some(33_000_000),
        "at worst 17 ms before the line of the older"
    );
    cover.push(7, &bytes, 60_000_000);
    assert_eq!(cover.boards().len(), 2);
}

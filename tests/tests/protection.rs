//! Protection of the people around the base, measured in simulation through a stock board's bytes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_control::config::stability::Stability;
use moca_control::config::{BarrierReadings, Config, HandConfig, RecentrePolicy};
use moca_control::protection::speed_for_delay_m_s;
use moca_control::stopping;
use moca_daemon::runtime::allocations::{self, CountingAllocator};
use moca_lockstep::simulated_robot::{self, free_scene};
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::params::CONTROLLER;
use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::robot::{PANDA, PAPER_COVER};
use moca_msgs::{
    ContactEvent, ContactReaction, Fault, Law, ParameterValues, Request, Sample, SpeedLimitReason,
};
use moca_sim::foam::Foam;
use moca_sim::{BodyPart, Mobility, Person, Scene, VirtualBoardConfig};
use moca_tactile::Firmware;
use moca_wbc::guard::CoverOutline;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

type World = LockStep<ByteCover, MemoryBoards>;

/// In front of the base.
const FRONT: usize = 5;
/// On the left side.
const LEFT: usize = 2;

fn config() -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    // The base follows a flange that is led without a request, as in the experiments.
    config.control.recentre = RecentrePolicy::Always;
    config
}

fn overridden(speed_m_s: f64) -> Config {
    let mut config = config();
    config.protection.override_speed_limit_m_s = speed_m_s;
    config.protection.override_statement = "a test".into();
    config
}

fn armed(config: &Config, scene: &Scene, board: VirtualBoardConfig) -> World {
    let mut world = LockStep::with_board(config, scene, board, None).unwrap();
    for _ in 0..3000 {
        if world.step(None).0.mode.moves() {
            return world;
        }
    }
    panic!("not armed within 3 s");
}

fn press(world: &mut World, taxel: usize, force_n: f64) -> Sample {
    let taxel = u8::try_from(taxel).unwrap();
    let (sample, outcome) = world.step(Some(Request::PressTaxel { taxel, force_n }));
    outcome.unwrap().unwrap();
    sample
}

fn run(world: &mut World, ticks: u64) -> Vec<Sample> {
    (0..ticks).map(|_| world.step(None).0).collect()
}

fn outline() -> CoverOutline<11, f64> {
    CoverOutline::new(&PAPER_COVER).unwrap()
}

/// Motion of a base that was led into a person.
struct Collision {
    approach_m_s: f64,
    /// Largest force in the first half second, and until the person steps away after 1.5 s.
    impact_n: f64,
    pressed_n: f64,
}

/// Leads the flange at `speed_m_s` towards a person 8 cm in front of T6, and goes on leading.
fn collide(config: &Config, speed_m_s: f64, phase: u64) -> Collision {
    let scene =
        Scene { people: vec![Person::beside(&PAPER_COVER, FRONT, 0.08).unwrap()], ..free_scene(config) };
    let mut world = armed(config, &scene, VirtualBoardConfig { seed: phase + 1, ..Default::default() });
    run(&mut world, 7 * phase);
    world.control.set_target_twist([speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let mut collision = Collision { approach_m_s: 0.0, impact_n: 0.0, pressed_n: 0.0 };
    let mut ticks_in_contact = 0;
    for _ in 0..10_000 {
        let force_n = world.control.plant.world.taxel_force_true_n()[FRONT];
        let sample = world.step(None).0;
        ticks_in_contact += u64::from(force_n > 0.0 || ticks_in_contact > 0);
        if ticks_in_contact == 1 {
            collision.approach_m_s = sample.base_velocity_world[0];
        }
        if ticks_in_contact <= 500 {
            collision.impact_n = collision.impact_n.max(force_n);
        }
        collision.pressed_n = collision.pressed_n.max(force_n);
        if ticks_in_contact > 1500 {
            return collision;
        }
    }
    panic!("never met the person");
}

#[test]
fn impact_is_below_25_n_at_speed_limit_only() {
    for phase in 0..4 {
        let limited = collide(&config(), 0.04, phase);
        let paper = collide(&overridden(10.0), 0.2, phase);
        let mut believing = config();
        believing.protection.threshold_force_n = 0.0;
        believing.protection.contact_travel_m = 0.1;
        let plain = collide(&believing, 0.05, phase);
        println!(
            "phase {phase}: limited {:.4} m/s: impact {:.1} N, pressed on {:.1} N | 25 N/(k (T + servo)) \
             {:.4} m/s: impact {:.1} N | 0.2 m/s led: {:.3} m/s: impact {:.1} N",
            limited.approach_m_s,
            limited.impact_n,
            limited.pressed_n,
            plain.approach_m_s,
            plain.impact_n,
            paper.approach_m_s,
            paper.impact_n
        );
        assert!(limited.approach_m_s > 0.035, "the base was at its limit");
        assert!(limited.impact_n < 25.0, "{} N", limited.impact_n);
        assert!(paper.impact_n > 25.0, "{} N: the limit is not needed", paper.impact_n);
    }
}

/// A base of which the stopping distance was measured 20 ms late is 120 ms late in operation. An operator
/// stops it at half of the limit: it is slower afterwards. A hand in front of it at the limit: the robot stops.
#[test]
fn base_that_became_later_is_found_at_its_next_stop() {
    let mut measured = config();
    measured.protection.contact_barrier = BarrierReadings::PuLd30;
    measured.simulation.truth.base.order_delay_ms = 20.0;
    let stops = simulated_robot::stops(&measured, &free_scene(&measured)).unwrap();
    stopping::believe(&mut measured, &stops, "a test".into());
    let moca = VirtualBoardConfig { firmware: Firmware::Moca, ..VirtualBoardConfig::default() };
    for (late_ms, share, fault) in
        [(20.0, 1.0, None), (120.0, 0.5, Some(Fault::OperatorStop)), (120.0, 1.0, Some(Fault::BaseLate))]
    {
        let mut config = measured.clone();
        config.simulation.truth.base.order_delay_ms = late_ms;
        let mut world = armed(&config, &free_scene(&config), moca);
        let before = run(&mut world, 100).pop().unwrap().speed_limit;
        assert_eq!(before.reason, SpeedLimitReason::BoardRate);
        world.control.set_target_twist([share * before.m_s, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let driven = run(&mut world, 3000).pop().unwrap();
        assert!(driven.cover_speed_m_s > 0.8 * share * before.m_s, "{} m/s", driven.cover_speed_m_s);
        if fault == Some(Fault::OperatorStop) {
            world.step(Some(Request::Stop));
        } else {
            press(&mut world, FRONT, 5.0);
        }
        let met = run(&mut world, 1000);
        let (after, stopped) = (met.last().unwrap().speed_limit, met.last().unwrap().fault);
        println!("{late_ms} ms late, {share} of the limit: {:.4} m/s, then {:.4} m/s", before.m_s, after.m_s);
        assert_eq!(stopped, fault);
        if late_ms > 100.0 {
            assert_eq!(after.reason, SpeedLimitReason::BaseLate);
            assert!(after.m_s < 0.8 * before.m_s, "{} m/s", after.m_s);
        } else {
            // a person in contact may press one plate only
            assert!(after.reason == before.reason && after.m_s >= before.m_s, "{after:?}");
        }
    }
}

#[test]
fn the_limit_follows_the_measured_rate_and_age_of_the_board() {
    let limit = |firmware| {
        let board = VirtualBoardConfig { firmware, ..VirtualBoardConfig::default() };
        let mut world = armed(&config(), &free_scene(&config()), board);
        // the worst of a second: reads and refreshes slide against each other
        let sample = run(&mut world, 1500).pop().unwrap();
        assert_eq!(sample.speed_limit.reason, SpeedLimitReason::BoardRate, "{firmware:?}");
        sample.speed_limit.m_s
    };
    for firmware in [Firmware::Moca, Firmware::Stock2018, Firmware::Stock2015] {
        let delay_s = 1e-9 * firmware.worst_hold_ns() as f64 - 0.001;
        let by_timing = speed_for_delay_m_s(&config(), 25.0, delay_s);
        let measured = limit(firmware);
        println!("{firmware:?}: {measured:.4} m/s, by the firmware's timing {by_timing:.4} m/s");
        // ticks of 1 ms round up; the worst phases of read and poll need not meet within a second
        assert!(measured < 1.03 * by_timing && measured > 0.95 * by_timing, "{measured} {by_timing}");
    }
}

#[test]
fn the_delay_of_a_stock_board_counts_the_worst_age_in_its_chip() {
    // 15 ms in the chip, FDAT 16 ms after the read, 24.7 ms between frames: what the firmware's simulation bounds, not
    // the chip's mean age of 10 ms with which 25 N would be 27.
    let board = VirtualBoardConfig { firmware: Firmware::Stock2018, ..VirtualBoardConfig::default() };
    let mut world = armed(&config(), &free_scene(&config()), board);
    let limit_m_s = run(&mut world, 1500).pop().unwrap().speed_limit.m_s;
    let force_n = 7783.0 * limit_m_s * (0.0547 + 0.015) + 5.2;
    assert!((24.0..25.0).contains(&force_n), "{limit_m_s} m/s: {force_n} N");
}

#[test]
fn unconfirmed_touch_stops_base_and_reaches_no_law() {
    let board = VirtualBoardConfig { firmware: Firmware::Stock2018, ..VirtualBoardConfig::default() };
    let mut world = armed(&config(), &free_scene(&config()), board);
    world.control.set_target_twist([0.04, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    run(&mut world, 2000);
    let mut blocked_ticks = 0;
    let mut sample = press(&mut world, FRONT, 60.0);
    let before = sample.base_velocity_command_body[0];
    while sample.taxels[FRONT].force_n == 0.0 {
        sample = run(&mut world, 1).pop().unwrap();
        if sample.base_velocity_command_body[0] < before - 1e-4 && sample.taxels[FRONT].force_n == 0.0 {
            blocked_ticks += 1;
        }
    }
    println!("slowed {blocked_ticks} ms before the reading felt anything");
    assert!((3..=5).contains(&blocked_ticks), "{blocked_ticks}");
}

#[test]
fn stale_data_lowers_limit_until_the_stop() {
    let mut world = armed(&config(), &free_scene(&config()), VirtualBoardConfig::default());
    let before = run(&mut world, 200).pop().unwrap().speed_limit.m_s;
    world.feed[0].board().set_fault(Some(moca_sim::board::BoardFailure::Silent));
    let samples = run(&mut world, 150);
    let moving: Vec<&Sample> = samples.iter().filter(|sample| sample.mode.moves()).collect();
    let stale = moving.iter().find(|s| s.speed_limit.reason == SpeedLimitReason::Stale).expect("named");
    assert!(stale.frame_age_s < 0.07, "{}", stale.frame_age_s);
    assert!(moving.windows(2).all(|pair| pair[1].speed_limit.m_s <= pair[0].speed_limit.m_s));
    let last = moving.last().unwrap();
    println!(
        "limit {before:.4} m/s, {:.4} m/s before the stop, data {:.3} s old",
        last.speed_limit.m_s, last.frame_age_s
    );
    assert!(last.speed_limit.m_s < 0.65 * before);
    assert!(!samples.last().unwrap().mode.moves());
}

/// Pushed hard from every side, under both laws and with the flange led: no command is faster than the limit.
#[test]
fn no_push_moves_any_point_of_the_cover_faster_than_the_limit() {
    let outline = outline();
    for law in [Law::Impedance, Law::FollowMe] {
        let mut config = config();
        config.startup.law = law;
        let mut world = armed(&config, &free_scene(&config), VirtualBoardConfig::default());
        let (mut fastest, mut at_limit) = (0.0_f64, 0_u32);
        for taxel in 0..PAPER_COVER.len() {
            let twist = if taxel % 2 == 0 { [0.3, -0.2, 0.0, 0.0, 0.0, 0.5] } else { [0.0; 6] };
            world.control.set_target_twist(twist).unwrap();
            press(&mut world, taxel, 60.0);
            for sample in run(&mut world, 500) {
                let speed = outline.fastest(&sample.base_velocity_command_body);
                assert!(speed <= sample.speed_limit.m_s + 3.0e-3, "{law:?} T{}: {speed} m/s", taxel + 1);
                fastest = fastest.max(speed / sample.speed_limit.m_s);
                at_limit += u32::from(speed > 0.99 * sample.speed_limit.m_s);
            }
            press(&mut world, taxel, 0.0);
        }
        println!("{law:?}: fastest command {fastest:.4} of the limit, at it in {at_limit} of 5500 ticks");
        assert!(at_limit > 2000, "the limit was hardly met: the test shows little");
    }
}

#[test]
fn override_needs_statement_and_is_in_every_sample() {
    let text = "[protection]\nforce_limit_n = 0.5\noverride_speed_limit_m_s = 0.3\nreaction = \"slow\"\nretreat_m = nan\n";
    let mistakes = Config::parse(text).unwrap_err().mistakes;
    assert_eq!(mistakes.len(), 3, "{mistakes:?}");
    assert_eq!(mistakes[0], "line 2: protection.force_limit_n = 0.5 N is outside 1 to 500 N");
    assert!(
        mistakes.iter().any(|m| m == "line 5: protection.retreat_m = NaN m is outside 0 to 1 m"),
        "{mistakes:?}"
    );
    assert!(
        mistakes[1].starts_with("line 3: protection.override_speed_limit_m_s = 0.3 m/s switches off"),
        "{mistakes:?}"
    );

    // The threshold force beside a limit that is in its own range.
    let mistakes = Config::parse("[protection]\nforce_limit_n = 5.0\n").unwrap_err().mistakes;
    assert!(mistakes.len() == 1 && mistakes[0].contains("is not below"), "{mistakes:?}");

    let mut world = armed(&overridden(0.3), &free_scene(&overridden(0.3)), VirtualBoardConfig::default());
    press(&mut world, FRONT, 40.0);
    let samples = run(&mut world, 2000);
    let overridden = |s: &Sample| {
        s.speed_limit.reason == SpeedLimitReason::Overridden
            && s.speed_limit.m_s.to_bits() == 0.3_f64.to_bits()
    };
    assert!(samples.iter().all(overridden));
    let fastest = samples.iter().map(|s| -s.base_velocity_world[0]).fold(0.0, f64::max);
    assert!(fastest > 0.1, "{fastest} m/s: the override let nothing through");
}

/// Effect of a reaction on a base that was led into a person.
#[derive(Debug)]
struct Reacted {
    crossing: ContactEvent,
    /// From the tick of the crossing until the command obeys.
    ticks: u64,
    /// Fastest command of T6 outward from then on until the contact ends, m/s.
    outward_m_s: f64,
    /// Fastest command along the cover meanwhile, m/s.
    along_m_s: f64,
    /// Distance that the base went back from where it was at the crossing, m.
    back_m: f64,
    /// Largest force after the crossing, N.
    pressed_n: f64,
    end: ContactEvent,
}

/// Leads the flange forward and to the left, with a person in front of T6. The limit is the
/// first force that is felt, so that the base is still going outward when it is crossed.
fn provoke(reaction: ContactReaction) -> Reacted {
    let path =
        std::env::temp_dir().join(format!("moca-limits-{}-{}.toml", std::process::id(), reaction.name()));
    std::fs::write(&path, "source = \"a test\"\n[T6]\ntransient_n = 4.0\nquasi_static_n = 3.0\n").unwrap();
    let mut config = config();
    config.protection.thresholds = path.display().to_string();
    config.protection.uncalibrated_statement = "a simulated cover, in a test".into();
    config.protection.reaction = reaction;
    config.protection.retreat_m = 0.02;
    let scene =
        Scene { people: vec![Person::beside(&PAPER_COVER, FRONT, 0.08).unwrap()], ..free_scene(&config) };
    let mut world = armed(&config, &scene, VirtualBoardConfig::default());
    std::fs::remove_file(&path).unwrap();
    world.control.set_target_twist([0.04, 0.01, 0.0, 0.0, 0.0, 0.0]).unwrap();

    let outline = outline();
    let allowed_m_s = if reaction == ContactReaction::Slow { config.protection.slow_m_s } else { 0.0 };
    let (mut crossing, mut obeyed, mut crossed_x) = (None, None, 0.0);
    let (mut outward_m_s, mut along_m_s, mut back_m) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut pressed_n = 0.0_f64;
    let allocated = allocations::on_this_thread();
    for tick in 0..12_000_u64 {
        let force_n = world.control.plant.world.taxel_force_true_n()[FRONT];
        let sample = world.step(None).0;
        let command = sample.base_velocity_command_body;
        let of_front =
            |phase| sample.contact_events.iter().copied().find(|e| e.taxel == 5 && e.phase == phase);
        if crossing.is_none() {
            crossing = of_front(ContactPhase::LimitCrossed).map(|event| (tick, event));
            crossed_x = sample.base_pose_world[0];
        }
        let Some((crossed_at, crossing)) = crossing else { continue };
        if let Some(end) = of_front(ContactPhase::Finished) {
            assert_eq!(allocations::on_this_thread(), allocated, "the loop allocated");
            assert_eq!(sample.contact_reaction, None, "over with the contact");
            return Reacted {
                crossing,
                ticks: obeyed.expect("it never obeyed") - crossed_at,
                outward_m_s,
                along_m_s,
                back_m,
                pressed_n,
                end,
            };
        }
        assert_eq!(sample.contact_reaction, Some(reaction));
        let outward = outline.outward(FRONT, &command);
        if obeyed.is_none()
            && outward <= allowed_m_s + 1e-6
            && outline.fastest(&command) <= sample.speed_limit.m_s + 1e-6
        {
            obeyed = Some(tick);
        }
        if obeyed.is_some() {
            outward_m_s = outward_m_s.max(outward);
            along_m_s = along_m_s.max(command[1].abs());
        }
        back_m = back_m.max(crossed_x - sample.base_pose_world[0]);
        pressed_n = pressed_n.max(force_n);
    }
    panic!("no contact came and went");
}

#[test]
fn reaction_to_limit_ends_with_the_contact() {
    let mut durations_s = Vec::new();
    for reaction in ContactReaction::ALL {
        let r = provoke(reaction);
        durations_s.push(r.end.duration_s);
        println!(
            "{}: obeyed after {} ticks; then at most {:.4} m/s outward, {:.4} m/s along; back {:.1} mm; pressed {:.1} N at most; contact {:.2} s, peak {:.1} N, clamp {:.1} N mean, {:.1} N at most, {:.1} N·s as read",
            reaction.name(),
            r.ticks,
            r.outward_m_s,
            r.along_m_s,
            1e3 * r.back_m,
            r.pressed_n,
            r.end.duration_s,
            r.end.peak_n,
            r.end.clamp_mean_n,
            r.end.clamp_max_n,
            r.end.impulse_n_s,
        );
        assert_eq!(r.crossing.reaction, Some(reaction));
        assert!(r.crossing.peak_n > 4.0 && r.crossing.crossed_n.is_some());
        // 35 mm/s at 3 m/s² are 12 ms
        assert!(r.ticks > 0, "it was obeyed before: the test shows nothing");
        assert!(r.ticks <= 15, "{} ticks", r.ticks);
        match reaction {
            ContactReaction::Slow => assert!(r.outward_m_s <= 0.01 + 1e-6, "{r:?}"),
            ContactReaction::StopDirection => {
                assert!(r.outward_m_s <= 1e-6, "{r:?}");
                assert!(r.along_m_s > 0.002, "the other directions go on: {r:?}");
            }
            ContactReaction::Retreat => {
                assert!(r.outward_m_s <= 1e-6, "{r:?}");
                assert!(r.back_m > 0.001 && r.back_m < 0.03, "{r:?}");
            }
        }
        assert!(r.end.impulse_n_s > 0.0 && r.end.peak_n >= r.crossing.peak_n);
    }
    // The board shows the end of a contact frame by frame: a stop and a retreat may end it in the same one.
    assert!(durations_s.is_sorted_by(|longer, shorter| longer >= shorter), "each does more: {durations_s:?}");
    assert!(durations_s[0] > durations_s[2], "a retreat ends it sooner than slowness: {durations_s:?}");
}

/// The furthest that the flange was from its place, mm, and the fastest joint of what it may, under gains as close to
/// unstable as they are let through, untouched for two seconds and then leaned on with 100 N for three.
#[expect(clippy::print_stdout, reason = "the figures, with --nocapture")]
fn at_the_edge(name: &str, asked: &[f64]) -> (f64, f64) {
    let config = config();
    let number = CONTROLLER.iter().position(|row| row.name.ends_with(name)).unwrap();
    let asked = ParameterValues::new(asked).unwrap();
    let (present, home) = (config.parameters(), config.control.gains.posture_rad);
    let nearest = Stability::new(&config).nearest_stable(&present, number, &asked, &home);
    let values = nearest.unwrap_or(asked);
    let mut world = armed(&config, &free_scene(&config), VirtualBoardConfig::default());
    let first = world.step(None).0;
    let parameter = u8::try_from(number).unwrap();
    assert_eq!(world.step(Some(Request::SetParameter { parameter, values })).1, Some(Ok(())));
    let mut samples = run(&mut world, 2000);
    press(&mut world, FRONT, 100.0);
    samples.append(&mut run(&mut world, 3000));
    let (mut flange_mm, mut joints) = (0.0_f64, 0.0_f64);
    for sample in &samples {
        let off = |i: usize| (sample.flange_position_world[i] - first.flange_position_world[i]).powi(2);
        flange_mm = flange_mm.max(1e3 * (off(0) + off(1) + off(2)).sqrt());
        let share = |(dq, most): (&f64, f64)| dq.abs() / most;
        joints = sample.dq_rad_s.iter().zip(PANDA.dq_max_rad_s).map(share).fold(joints, f64::max);
    }
    let last = samples.last().unwrap();
    println!(
        "{name} = {:.1?}: flange {flange_mm:.2} mm, joints {joints:.3}, {:?}",
        values.as_slice(),
        last.fault
    );
    assert!(last.mode.moves(), "{name}: {:?}", last.fault);
    (flange_mm, joints)
}

#[test]
fn gains_that_are_just_let_through_bear_a_strong_lean() {
    for (name, asked) in [
        ("gains.stiffness", &[1e5; 6][..]),
        ("gains.stiffness", &[1e5, 1e5, 1e5, 40.0, 40.0, 40.0]),
        ("gains.stiffness", &[800.0, 800.0, 800.0, 1e5, 1e5, 1e5]),
        ("posture_stiffness", &[1e4; 7]),
        ("posture_damping", &[1e3; 7]),
        ("damping_ratio", &[5.0]),
        ("reactivity", &[3.0]),
        ("virtual_mass", &[0.5, 0.5, 0.5]),
        ("virtual_damping", &[1.0, 1.0, 1.0]),
    ] {
        let (flange_mm, joints) = at_the_edge(name, asked);
        assert!(flange_mm < 10.0 && joints < 1.0, "{name}: {flange_mm} mm, {joints}");
    }
}

/// Returns the distances along `axis` that a lean of 40 N on `taxel` moves the base within six seconds, and again after a rest, m.
fn leaned(config: &Config, taxel: usize, axis: usize) -> [f64; 2] {
    let mut world = armed(config, &free_scene(config), VirtualBoardConfig::default());
    let mut lean = || {
        let before = press(&mut world, taxel, 40.0).base_pose_world[axis];
        let samples = run(&mut world, 6000);
        let way_m = samples.iter().fold(0.0, |most: f64, s| most.max(before - s.base_pose_world[axis]));
        press(&mut world, taxel, 0.0);
        // the foam feels the hand for seconds after it is gone
        let last = run(&mut world, 6000).pop().unwrap();
        assert!(last.mode.moves(), "{:?}", last.fault);
        way_m
    };
    [lean(), lean()]
}

#[test]
fn base_pushed_to_bare_rear_stops_after_0_1_m() {
    for law in [Law::Impedance, Law::FollowMe] {
        let mut config = config();
        config.startup.law = law;
        let backwards = leaned(&config, FRONT, 0);
        let sideways = leaned(&config, LEFT, 1);
        config.protection.uncovered_m = 100.0;
        let unlimited = leaned(&config, FRONT, 0);
        println!(
            "{law:?}: backwards {backwards:.4?}, to the covered right {sideways:.4?}, no limit {unlimited:.4?} m"
        );
        // 0.4 mm/s is what 40 N push the base's own servo back
        assert!(backwards[0] > 0.09 && backwards[0] < 0.104, "{law:?}: {backwards:?} m");
        assert!(backwards[1] < 0.104, "{law:?}: {backwards:?} m");
        if law == Law::FollowMe {
            assert!(backwards[1] > 0.09, "it counts anew: {backwards:?} m");
        }
        assert!(sideways[0] > 0.15 && unlimited[0] > 0.15, "{law:?}: the limit is not met: it shows nothing");
    }
}

/// Force on a leg from which on the base does not give way any more, N.
const STANDS_N: f64 = 50.0;

/// Largest force of a leg that walks on for three tenths of a metre after it has touched the standing robot, N, and how far
/// back that has taken the base, m: before it stood in the way, where a leg that nothing slows down pushes it. The leg
/// comes before the place on `taxel`'s panel that is `offset_m` to the left of the taxel's middle.
fn walked_into(
    config: &Config,
    firmware: Firmware,
    (taxel, offset_m): (usize, f64),
    walk_m_s: f64,
) -> (f64, f64) {
    let person = Person {
        walk_m_s,
        mobility: Mobility::Fixed, // nothing slows it down
        ..Person::part(BodyPart::Leg, &PAPER_COVER, taxel, 0.02, offset_m).unwrap()
    };
    let scene = Scene { people: vec![person], ..free_scene(config) };
    let board = VirtualBoardConfig { firmware, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(config, &scene, board, None).unwrap();
    world.control.plant.world.set_people_waiting(true);
    while !world.step(None).0.mode.moves() {}
    world.control.plant.world.set_people_waiting(false);
    let (mut walked_m, mut peak_n, mut back_m) = (0.0, 0.0_f64, 0.0);
    while walked_m < 0.3 {
        let sample = world.step(None).0;
        let force_n = world.control.plant.world.contact_largest_true_n();
        walked_m += if walked_m > 0.0 || force_n > 0.0 { 1e-3 * walk_m_s } else { 0.0 };
        peak_n = peak_n.max(force_n);
        if peak_n < STANDS_N {
            back_m = -sample.base_pose_world[0];
        }
    }
    (peak_n, back_m)
}

/// With the contact barrier nobody is caught between the own walk and a base that fears its bare rear.
#[test]
fn walker_into_front_gets_room_beyond_0_1_m() {
    let mut config = config();
    config.protection.contact_barrier = BarrierReadings::PuLd30;
    // pushed off its middle the base turns, and the leg comes from its taxel to a seam
    let seam_m = 0.776 / 6.0;
    let on_taxels = [(4, 0.0), (FRONT, 0.0), (6, 0.0), (FRONT, 0.8 * seam_m), (FRONT, -0.4 * seam_m)];
    for firmware in [Firmware::Stock2018, Firmware::Moca] {
        let delay_s = 1e-9 * firmware.worst_hold_ns() as f64 - 0.001;
        // as fast as a base with this board may go: the bound is the same whoever comes, and that of a seam, where two
        // thresholds hide the touch
        let most_m_s = speed_for_delay_m_s(&config, 25.0, delay_s);
        for (place, share) in on_taxels.map(|place| (place, 1.2)).into_iter().chain([((FRONT, seam_m), 0.95)])
        {
            let walk_m_s = share * most_m_s;
            let (peak_n, back_m) = walked_into(&config, firmware, place, walk_m_s);
            println!("{place:?} {firmware:?} {walk_m_s:.4} m/s: {peak_n:.1} N, base {back_m:.3} m back");
            assert!(peak_n < 25.0, "{place:?} {walk_m_s} m/s: {peak_n} N");
            assert!(back_m > 0.15, "the law's own way is not used up: it shows nothing ({back_m} m)");
        }
    }
    // the room ends as well, and without it the base stands in the way
    config.protection.uncovered_room_m = 0.2;
    let (_, back_m) = walked_into(&config, Firmware::Moca, (FRONT, 0.0), 0.12);
    assert!(back_m > 0.19 && back_m < 0.201, "{back_m} m");
    config.protection.uncovered_room_m = 0.0;
    let (peak_n, back_m) = walked_into(&config, Firmware::Moca, (FRONT, 0.0), 0.12);
    assert!(peak_n > 100.0 && back_m < 0.11, "{peak_n} N, {back_m} m: nothing needs the room");
}

#[test]
fn bare_side_displacement_is_in_sample_and_follows_mask() {
    let mut config = config();
    config.startup.law = Law::FollowMe;
    let mut world = armed(&config, &free_scene(&config), VirtualBoardConfig::default());
    press(&mut world, FRONT, 40.0);
    let samples = run(&mut world, 6000);
    let last = samples.last().unwrap();
    assert!(samples.is_sorted_by(|a, b| a.uncovered_way_m <= b.uncovered_way_m + 1e-4));
    assert!((last.uncovered_way_m + last.base_pose_world[0]).abs() < 5e-3, "{last:?}");
    press(&mut world, FRONT, 0.0);
    assert!(run(&mut world, 8000).pop().unwrap().uncovered_way_m < 1e-3, "it rested");

    config.board.masked = vec![8, 9, 10, 11];
    config.board.mask_policy = moca_tactile::cover::MaskPolicy::Ignore;
    let [way_m, _] = leaned(&config, LEFT, 1);
    assert!(way_m > 0.09 && way_m < 0.11, "to the right, whose taxels are masked: {way_m} m");
}

#[test]
fn staying_hand_is_quasi_static_contact() {
    let mut world = armed(&config(), &free_scene(&config()), VirtualBoardConfig::default());
    press(&mut world, LEFT, 30.0);
    run(&mut world, 2000);
    press(&mut world, LEFT, 0.0);
    let samples = run(&mut world, 1000);
    let mut events = samples.iter().flat_map(|sample| &sample.contact_events);
    let end = events.find(|event| event.phase == ContactPhase::Finished).expect("it let go");
    println!("30 N for 2 s on T3: {end:?}");
    assert_eq!((usize::from(end.taxel), end.kind), (LEFT, ContactKind::QuasiStatic));
    // the foam creeps back, so the hand is felt 0.25 s after it let go; a line through zero under-reads this foam by up to
    // 17 N; the figures are of what the board reads
    assert!(
        end.duration_s > 2.0 && end.duration_s < 2.4 && end.clamp_mean_n > 12.0 && end.clamp_mean_n < 32.0,
        "{end:?}"
    );
    assert!(end.clamp_max_n >= end.clamp_mean_n && end.peak_n >= end.clamp_max_n);
    assert!((end.impulse_n_s / (end.clamp_mean_n * end.duration_s) - 1.0).abs() < 0.15, "{end:?}");
    assert_eq!((end.crossed_n, end.reaction), (None, None), "no limits are shipped");
}

#[test]
fn the_default_contact_is_the_simulated_foam_on_a_leg() {
    let (foam, tissue_n_m) = (Foam::PU_LD30, 50_000.0);
    let settings = Config::default().protection;
    let (at_limit_m, threshold_m) =
        (foam.deformation_m(settings.force_limit_n), foam.deformation_m(settings.threshold_force_n));
    let foam_n_m = foam.stiffness_n_per_m(at_limit_m);
    let stiffness_n_m = foam_n_m * tissue_n_m / (foam_n_m + tissue_n_m);
    assert!((settings.contact_stiffness_n_m / stiffness_n_m - 1.0).abs() < 0.01, "{stiffness_n_m}");
    let travel_m =
        at_limit_m - threshold_m + (settings.force_limit_n - settings.threshold_force_n) / tissue_n_m;
    assert!((settings.contact_travel_m / travel_m - 1.0).abs() < 0.05, "{travel_m}");
    // felt from the first whole count above the threshold's 4
    let felt_n = |force_n: f64| foam.counts_drop(foam.ramp_deformation_m(force_n)) >= 4.0;
    assert!(felt_n(settings.threshold_force_n + 0.1) && !felt_n(settings.threshold_force_n - 0.2));
}

//! Protection of the people around the base, measured in simulation through a stock board's bytes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_daemon::allocations::CountingAllocator;
use moca_daemon::byte_cover::ByteCover;
use moca_daemon::config::{Config, HandConfig, TAXELS};
use moca_daemon::lockstep::{LockStep, MemoryBoard};
use moca_msgs::robot::PAPER_COVER;
use moca_msgs::{Law, Request, Sample, SpeedLimitReason};
use moca_sim::{Person, Scene, VirtualBoardConfig};
use moca_tactile::datastream::SketchGeneration;
use moca_wbc::guard::CoverOutline;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

type World = LockStep<ByteCover, MemoryBoard>;

/// In front of the base.
const FRONT: usize = 5;

fn config() -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
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

fn outline() -> CoverOutline<TAXELS, f64> {
    CoverOutline::new(&PAPER_COVER)
}

/// What a base did that was led into a person.
struct Collision {
    approach_m_s: f64,
    /// Largest force in the first half second, and until the person steps away after 1.5 s.
    impact_n: f64,
    pressed_n: f64,
}

/// Leads the flange at `speed_m_s` towards a person 8 cm in front of T6, and goes on leading.
fn collide(config: &Config, speed_m_s: f64, phase: u64) -> Collision {
    let scene = Scene { people: vec![Person::beside(FRONT, 0.08).unwrap()], ..Scene::default() };
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
fn at_the_speed_limit_an_impact_stays_under_25_n_and_at_the_papers_speed_it_does_not() {
    for phase in 0..4 {
        let limited = collide(&config(), 0.04, phase);
        let paper = collide(&overridden(10.0), 0.2, phase);
        println!(
            "phase {phase}: limited {:.4} m/s: impact {:.1} N, pressed on {:.1} N | 0.2 m/s led: {:.3} m/s: impact {:.1} N",
            limited.approach_m_s, limited.impact_n, limited.pressed_n, paper.approach_m_s, paper.impact_n
        );
        assert!(limited.approach_m_s > 0.035, "the base was at its limit");
        assert!(limited.impact_n < 25.0, "{} N", limited.impact_n);
        assert!(paper.impact_n > 25.0, "{} N: the limit is not needed", paper.impact_n);
    }
}

#[test]
fn the_limit_follows_the_measured_rate_and_age_of_the_board() {
    // Firmware timing: (sketch, delay T by moca-lab latency, s)
    let limit = |sketch| {
        let board = VirtualBoardConfig { sketch, ..VirtualBoardConfig::default() };
        let mut world = armed(&config(), &Scene::default(), board);
        let sample = run(&mut world, 500).pop().unwrap();
        assert_eq!(sample.speed_limit.reason, SpeedLimitReason::BoardRate, "{sketch:?}");
        sample.speed_limit.m_s
    };
    for (sketch, delay_s) in [(SketchGeneration::From2018, 0.0537), (SketchGeneration::From2015, 0.0358)] {
        let by_theory = (25.0 - 5.2) / (7783.0 * (delay_s + 0.015));
        let measured = limit(sketch);
        println!("{sketch:?}: {measured:.4} m/s, by theory {by_theory:.4} m/s");
        // ticks of 1 ms round age and interval up
        assert!(measured < 1.01 * by_theory && measured > 0.95 * by_theory, "{measured} {by_theory}");
    }
}

#[test]
fn data_older_than_a_frame_explains_lowers_the_limit_until_the_stop() {
    let mut world = armed(&config(), &Scene::default(), VirtualBoardConfig::default());
    let before = run(&mut world, 200).pop().unwrap().speed_limit.m_s;
    world.feed.board().set_fault(Some(moca_sim::board::BoardFault::Silent));
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
        let mut world = armed(&config, &Scene::default(), VirtualBoardConfig::default());
        let (mut fastest, mut at_limit) = (0.0_f64, 0_u32);
        for taxel in 0..TAXELS {
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
fn an_override_is_refused_without_a_statement_and_shown_in_every_sample() {
    let text = "[protection]\nforce_limit_n = 0.5\noverride_speed_limit_m_s = 0.3\nreaction = \"slow\"\nretreat_m = nan\n";
    let mistakes = Config::parse(text).unwrap_err().mistakes;
    assert_eq!(mistakes.len(), 4, "{mistakes:?}");
    assert_eq!(mistakes[0], "line 2: protection.force_limit_n = 0.5 N is outside 1 to 500 N");
    assert!(
        mistakes.iter().any(|m| m == "line 5: protection.retreat_m = NaN m is outside 0 to 1 m"),
        "{mistakes:?}"
    );
    assert!(
        mistakes[3].starts_with("line 3: protection.override_speed_limit_m_s = 0.3 m/s switches off"),
        "{mistakes:?}"
    );

    let mut world = armed(&overridden(0.3), &Scene::default(), VirtualBoardConfig::default());
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

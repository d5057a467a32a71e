//! References from outside: what is taken, how the robot goes there, and what is refused.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]
#![allow(clippy::float_cmp, reason = "what does not move stays equal to the bit")]

use moca_control::config::{Config, HandConfig};
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::{LockStep, TrueForces};
use moca_msgs::robot::PANDA;
use moca_msgs::target::{TargetKind, TargetPhase};
use moca_msgs::{
    Law, Mode, Outcome, ParameterValues, Refusal, Request, Sample, Target, TargetRefusal, TimedTarget,
    TouchPolicy, TwistAxes, Waypoint,
};

type World = LockStep<IdealCover, TrueForces>;

fn armed(law: Law) -> World {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.startup.law = law;
    let cover = IdealCover::new(1, 0);
    let mut world = LockStep::with_true_forces(&config, &free_scene(&config), cover).unwrap();
    let mode = run(&mut world, 200).mode;
    assert_eq!(mode, law.into());
    world
}

fn run(world: &mut World, ticks: u64) -> Sample {
    let mut last = None;
    for _ in 0..ticks {
        last = Some(world.step(None).0);
    }
    last.expect("at least one tick")
}

fn ask(world: &mut World, request: Request) -> Outcome {
    world.step(Some(request)).1.expect("every request is answered in its tick")
}

fn lead(world: &mut World, target: Target) -> Outcome {
    ask(world, Request::Target(TimedTarget::new(target)))
}

/// Sends a target 20 times a second for so many ticks.
fn stream(world: &mut World, target: Target, ticks: u64) -> Sample {
    for _ in 0..ticks / 50 {
        lead(world, target).unwrap();
        run(world, 49);
    }
    run(world, 1)
}

fn pose(sample: &Sample, by: [f64; 3]) -> Target {
    let position_world = std::array::from_fn(|i| sample.flange_desired_position_world[i] + by[i]);
    Target::Pose { position_world, quaternion_world: sample.flange_desired_quaternion_world }
}

/// The reference at a later time, as it is but `dy_m` to the left.
fn sideways(sample: &Sample, time_s: f64, dy_m: f64) -> Waypoint {
    let [x, y, z] = sample.flange_desired_position_world;
    let quaternion_world = sample.flange_desired_quaternion_world;
    Waypoint { time_s, position_world: [x, y + dy_m, z], quaternion_world }
}

/// A trajectory, pose after pose.
fn send(world: &mut World, waypoints: &[Waypoint], touch: TouchPolicy) -> Outcome {
    let count = u8::try_from(waypoints.len()).unwrap();
    (0..count)
        .zip(waypoints)
        .try_for_each(|(index, &waypoint)| ask(world, Request::Waypoint { index, count, waypoint, touch }))
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn phase(sample: &Sample) -> Option<TargetPhase> {
    sample.target.map(|target| target.phase)
}

#[test]
fn pose_is_reached_under_both_laws() {
    for law in [Law::Impedance, Law::FollowMe] {
        let mut world = armed(law);
        let start = run(&mut world, 1);
        assert_eq!(start.target, None);
        let target = pose(&start, [0.05, -0.08, 0.06]);
        let Target::Pose { position_world, .. } = target else { unreachable!("a pose") };
        let (mut there, mut left) = (start, f64::INFINITY);
        for _ in 0..80 {
            there = stream(&mut world, target, 50);
            // However slowly the joints have to go: never past the place and back.
            let now = distance(there.flange_desired_position_world, position_world);
            assert!(now < left + 1e-5, "{law:?}: {left} m to go, then {now} m");
            left = now;
        }
        assert_eq!(phase(&there), Some(TargetPhase::Reached), "{law:?}");
        assert_eq!(there.target.unwrap().progress, 1.0);
        assert!(distance(there.flange_desired_position_world, position_world) < 1e-5, "{law:?}");
        let off = distance(there.flange_position_world, position_world);
        assert!(off < 4e-3, "{law:?}: the flange is {off} m away");
    }
}

#[test]
fn a_target_that_nobody_renews_holds_after_its_age() {
    let mut world = armed(Law::Impedance);
    let start = run(&mut world, 1);
    lead(&mut world, pose(&start, [0.2, 0.0, 0.0])).unwrap();
    assert_eq!(phase(&run(&mut world, 199)), Some(TargetPhase::Moving));
    assert_eq!(phase(&run(&mut world, 10)), Some(TargetPhase::Aged));
    let held = run(&mut world, 1000);
    let later = run(&mut world, 1000);
    assert_eq!(held.flange_desired_position_world, later.flange_desired_position_world, "it holds");
    assert!(distance(held.flange_desired_position_world, start.flange_desired_position_world) < 0.08);
    // what is old when it arrives is refused
    let old = TimedTarget { age_s: 0.25, ..TimedTarget::new(pose(&start, [0.0; 3])) };
    let refused = ask(&mut world, Request::Target(old)).unwrap_err().to_string();
    assert_eq!(refused, "age of the target = 0.250000 s is outside -0.050000 to 0.200000 s");
    let early = TimedTarget { age_s: -0.3, ..old };
    assert!(ask(&mut world, Request::Target(early)).is_err(), "from the future");
}

#[test]
fn twist_moves_flange_and_posture_all_joints() {
    // A base that has turned tells the axes apart.
    for law in [Law::FollowMe, Law::Impedance] {
        for axes in [TwistAxes::World, TwistAxes::Base, TwistAxes::Flange] {
            let mut world = armed(Law::FollowMe);
            stream(&mut world, Target::BaseVelocity { velocity_body: [0.0, 0.0, 0.4] }, 2500);
            ask(&mut world, Request::SelectLaw(law)).unwrap();
            let start = run(&mut world, 1000);
            let yaw = start.base_pose_world[2];
            assert!((0.3..0.6).contains(&yaw), "{yaw}");
            let (sin, cos) = yaw.sin_cos();
            let y_axis = match axes {
                TwistAxes::World => [0.0, 1.0],
                TwistAxes::Base => [-sin, cos],
                TwistAxes::Flange => {
                    let [x, y, z, w] = start.flange_quaternion_world;
                    [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z)]
                }
            };
            let twist = Target::Twist { axes, twist: [0.0, 0.05, 0.0, 0.0, 0.0, 0.0] };
            let end = stream(&mut world, twist, 1000);
            let way: [f64; 2] = std::array::from_fn(|i| {
                end.flange_desired_position_world[i] - start.flange_desired_position_world[i]
            });
            let along = way[0] * y_axis[0] + way[1] * y_axis[1];
            let across = way[0] * y_axis[1] - way[1] * y_axis[0];
            // at 1 m/s² and 20 m/s³ it takes 0.1 s to 0.05 m/s
            assert!((0.045..0.05).contains(&along) && across.abs() < 2e-3, "{law:?} {axes:?}: {way:?}");
        }
    }
    // turned about its own z axis the flange stays where it is
    let mut world = armed(Law::Impedance);
    let start = run(&mut world, 1);
    let twist = Target::Twist { axes: TwistAxes::Flange, twist: [0.0, 0.0, 0.0, 0.0, 0.0, 0.3] };
    let end = stream(&mut world, twist, 1000);
    assert!(distance(end.flange_position_world, start.flange_position_world) < 5e-3);
    let turned: f64 = (0..7).map(|i| (end.q_rad[i] - start.q_rad[i]).abs()).sum();
    assert!(turned > 0.2, "{turned}");

    let mut world = armed(Law::FollowMe);
    let mut posture = PANDA.home_rad;
    posture[0] += 0.3;
    posture[3] += 0.2;
    posture[5] -= 0.1;
    let end = stream(&mut world, Target::Posture(ParameterValues::new(&posture).unwrap()), 5000);
    assert_eq!(phase(&end), Some(TargetPhase::Reached));
    for (i, q) in posture.iter().enumerate() {
        assert!((end.q_rad[i] - q).abs() < 0.02, "joint {}: {} where {q} is wanted", i + 1, end.q_rad[i]);
    }
}

#[test]
fn a_base_is_driven_in_follow_me_and_only_there() {
    let mut world = armed(Law::Impedance);
    let drive = Target::BaseVelocity { velocity_body: [0.1, 0.0, 0.0] };
    let refused = lead(&mut world, drive).unwrap_err();
    assert_eq!(refused, Refusal::Target(TargetRefusal::NeedsFollowMe));

    let mut world = armed(Law::FollowMe);
    let start = run(&mut world, 1);
    let end = stream(&mut world, drive, 2000);
    assert!((end.base_velocity_world[0] - 0.1).abs() < 0.01, "{:?}", end.base_velocity_world);
    let flange_m = end.flange_position_world[0] - start.flange_position_world[0];
    let base_m = end.base_pose_world[0] - start.base_pose_world[0];
    assert!((flange_m - base_m).abs() < 0.01, "the flange goes along: {flange_m} and {base_m} m");
    let stopped = run(&mut world, 2000);
    assert_eq!(phase(&stopped), Some(TargetPhase::Aged));
    assert!(stopped.base_velocity_world[0].abs() < 1e-3, "nobody drives it any more");
}

#[test]
fn a_touch_wins_or_is_waited_for() {
    let press = |force_n| Request::PressTaxel { taxel: 2, force_n };
    let drive = Target::BaseVelocity { velocity_body: [0.1, 0.0, 0.0] };
    for touch in [TouchPolicy::TouchWins, TouchPolicy::PassThrough] {
        let mut world = armed(Law::FollowMe);
        let request = Request::Target(TimedTarget { touch, age_limit_s: 2.0, ..TimedTarget::new(drive) });
        ask(&mut world, request).unwrap();
        run(&mut world, 1000);
        ask(&mut world, request).unwrap();
        ask(&mut world, press(20.0)).unwrap();
        let touched = run(&mut world, 500);
        assert!(touched.taxels[2].force_n > 0.0);
        if touch == TouchPolicy::TouchWins {
            assert_eq!(phase(&touched), Some(TargetPhase::EndedByTouch));
            let refused = ask(&mut world, request).unwrap_err();
            assert!(matches!(refused, Refusal::Touched { taxel: 2, .. }), "{refused}");
        } else {
            assert_eq!(phase(&touched), Some(TargetPhase::SetAside));
            ask(&mut world, request).unwrap();
        }
        ask(&mut world, press(0.0)).unwrap();
        let later = run(&mut world, 1200);
        if touch == TouchPolicy::TouchWins {
            assert_eq!(phase(&later), Some(TargetPhase::EndedByTouch), "only a new one moves it");
            assert!(later.base_velocity_world[0].abs() < 0.02);
            assert_eq!(ask(&mut world, request), Ok(()));
        } else {
            assert_eq!(phase(&later), Some(TargetPhase::Moving), "it counts again");
            assert!((later.base_velocity_world[0] - 0.1).abs() < 0.02, "{:?}", later.base_velocity_world);
        }
    }
}

#[test]
fn a_trajectory_waits_for_who_touches_and_goes_on_where_it_was() {
    let mut world = armed(Law::Impedance);
    let start = run(&mut world, 1);
    let y = start.flange_desired_position_world[1];
    let waypoints = [(0.0, 0.0), (2.0, 0.1), (4.0, 0.0)].map(|(time_s, dy)| sideways(&start, time_s, dy));
    send(&mut world, &waypoints, TouchPolicy::PassThrough).unwrap();
    run(&mut world, 1000);
    ask(&mut world, Request::PressTaxel { taxel: 2, force_n: 20.0 }).unwrap();
    let touched = run(&mut world, 500);
    assert_eq!(phase(&touched), Some(TargetPhase::SetAside));
    let aside = touched.target.unwrap().progress;
    ask(&mut world, Request::PressTaxel { taxel: 2, force_n: 0.0 }).unwrap();
    let waits = |sample: &Sample| phase(sample) == Some(TargetPhase::SetAside);
    let mut sample = run(&mut world, 1);
    for _ in 0..3000 {
        if waits(&sample) {
            assert_eq!(sample.target.unwrap().progress, aside, "it waits");
            sample = run(&mut world, 1);
        }
    }
    assert!(!waits(&sample), "nobody touches any more");
    let on = run(&mut world, 100).target.unwrap().progress;
    assert!((on - aside - 0.025).abs() < 1e-3, "a tenth of a second after {aside}: {on}");
    let mut furthest = 0.0_f64;
    for _ in 0..60 {
        furthest = furthest.max(run(&mut world, 50).flange_desired_position_world[1] - y);
    }
    assert!((furthest - 0.1).abs() < 0.01, "no pose is left out: {furthest}");
}

#[test]
fn a_trajectory_is_one_request_with_progress_and_an_end() {
    let mut world = armed(Law::Impedance);
    let start = run(&mut world, 1);
    let [x, y, z] = start.flange_desired_position_world;
    let at = |time_s, dy| sideways(&start, time_s, dy);
    let waypoints = [at(0.0, 0.0), at(1.0, 0.1), at(2.0, 0.0)];
    let touch = TouchPolicy::TouchWins;
    send(&mut world, &waypoints, touch).unwrap();
    let half = run(&mut world, 1000);
    let state = half.target.unwrap();
    assert_eq!((state.kind, state.phase), (TargetKind::Trajectory, TargetPhase::Moving));
    assert!((state.progress - 0.5).abs() < 0.01, "{}", state.progress);
    assert!((half.flange_desired_position_world[1] - y - 0.1).abs() < 0.02, "it is at the turning point");
    let end = run(&mut world, 1500);
    assert_eq!((phase(&end), end.target.unwrap().progress), (Some(TargetPhase::Reached), 1.0));
    assert!(distance(end.flange_desired_position_world, [x, y, z]) < 1e-5);

    send(&mut world, &waypoints, touch).unwrap();
    run(&mut world, 500);
    ask(&mut world, Request::EndTarget).unwrap();
    let ended = run(&mut world, 1000);
    assert_eq!(phase(&ended), Some(TargetPhase::Ended));
    assert_eq!(ended.flange_desired_position_world, run(&mut world, 500).flange_desired_position_world);

    let too_fast = [at(0.0, 0.0), at(0.1, 0.1)];
    let refused = send(&mut world, &too_fast, touch).unwrap_err().to_string();
    assert!(refused.contains("linear speed y = 1.0"), "{refused}");
    // About whatever axis, and by the shorter way round: 0.3 rad in 0.25 s.
    let mut turned = at(1.25, 0.0);
    let [qx, qy, qz, qw] = turned.quaternion_world;
    let (sin, cos) = 0.15_f64.sin_cos();
    turned.quaternion_world =
        [-(qx * cos + qw * sin), -(qy * cos - qz * sin), -(qz * cos + qy * sin), -(qw * cos - qx * sin)];
    let refused = send(&mut world, &[at(1.0, 0.0), turned], touch).unwrap_err().to_string();
    assert!(refused.contains("speed of turning = 1.2000"), "{refused}");
    turned.time_s = 1.31;
    send(&mut world, &[at(1.0, 0.0), turned], touch).unwrap();
    ask(&mut world, Request::EndTarget).unwrap();
    let backwards = [at(1.0, 0.0), at(0.5, 0.0)];
    let refused = send(&mut world, &backwards, touch).unwrap_err().to_string();
    assert!(refused.contains("time of a pose = 0.500000 s is outside 1.001000"), "{refused}");
    // after a pose that is refused the rest is out of turn, and nothing begins
    let rest = Request::Waypoint { index: 1, count: 2, waypoint: at(1.0, 0.0), touch };
    assert_eq!(ask(&mut world, rest), Err(Refusal::Target(TargetRefusal::OutOfTurn)));
}

#[test]
fn impossible_target_is_refused_with_value_and_range() {
    let mut world = armed(Law::Impedance);
    let start = run(&mut world, 1);
    let Target::Pose { position_world, quaternion_world } = pose(&start, [0.0; 3]) else {
        unreachable!("a pose")
    };
    let at = |position_world| Target::Pose { position_world, quaternion_world };
    let twist =
        |speed, turn| Target::Twist { axes: TwistAxes::World, twist: [speed, 0.0, 0.0, 0.0, turn, 0.0] };
    let posture = |q: &[f64]| Target::Posture(ParameterValues::new(q).unwrap());
    let mut beyond = PANDA.home_rad;
    beyond[3] = 0.5;
    let mut pushed_back = PANDA.home_rad;
    pushed_back[3] = PANDA.q_max_rad[3] - 0.14;
    let refused = [
        (at([f64::NAN, 0.0, 0.5]), "position x is not a finite number"),
        (at([0.0, f64::INFINITY, 0.5]), "position y is not a finite number"),
        (at([2.5, 0.0, 0.8]), "distance from the arm's shoulder = 2."),
        (at([0.0, 0.0, 0.2]), "depth inside the base = 0."),
        (
            Target::Pose { position_world, quaternion_world: [0.0; 4] },
            "squared length of the quaternion = 0 is outside 0.998 to 1.002",
        ),
        (twist(0.3, 0.0), "linear speed x = 0.300000 m/s is outside -0.250000 to 0.250000 m/s"),
        (twist(0.0, f64::NAN), "angular speed y is not a finite number"),
        (posture(&beyond), "joint angle J4 = 0.500000 rad is outside"),
        (posture(&pushed_back), "joint angle J4 = -0.209800 rad is outside"),
        (posture(&PANDA.home_rad[..5]), "number of joints = 5 is outside 7 to 7"),
    ];
    for (target, text) in refused {
        let said = lead(&mut world, target).unwrap_err().to_string();
        assert!(said.contains(text), "{target:?}: {said}");
        assert_eq!(run(&mut world, 1).target, None, "nothing of it is kept");
    }
    let patient = TimedTarget { age_limit_s: 60.0, ..TimedTarget::new(twist(0.1, 0.0)) };
    let said = ask(&mut world, Request::Target(patient)).unwrap_err().to_string();
    assert_eq!(said, "age limit = 60.000000 s is outside 0.020000 to 2.000000 s");
    ask(&mut world, Request::Disarm).unwrap();
    assert_eq!(lead(&mut world, twist(0.1, 0.0)), Err(Refusal::Mode(Mode::Ready)));
}

#[test]
fn a_pose_that_no_posture_has_is_approached_as_far_as_the_leash() {
    for law in [Law::Impedance, Law::FollowMe] {
        let mut world = armed(law);
        let start = run(&mut world, 1);
        // As high as the joints' distances add up to, which no arm can be stretched to.
        let target = pose(&start, [0.0, 0.0, 0.62]);
        let Target::Pose { position_world, .. } = target else { unreachable!("a pose") };
        let mut furthest = 0.0_f64;
        for _ in 0..200 {
            let now = stream(&mut world, target, 50);
            assert_eq!((now.mode, now.fault), (law.into(), None));
            furthest = furthest.max(distance(now.flange_position_world, now.flange_desired_position_world));
            for i in 0..7 {
                assert!(PANDA.q_min_rad[i] < now.q_rad[i] && now.q_rad[i] < PANDA.q_max_rad[i], "{now:?}");
            }
        }
        let there = run(&mut world, 1);
        let left = distance(there.flange_position_world, position_world);
        let went = there.flange_position_world[2] - start.flange_position_world[2];
        println!("{law:?}: {went} m up, {left} m are left, the reference at most {furthest} m ahead");
        assert!(went > 0.1 && left > 0.02 && phase(&there) == Some(TargetPhase::Moving), "{went}, {left}");
        assert!(furthest < 0.06, "{law:?}: {furthest} m ahead");
        // On the straight way back rounding decides whether a stretched elbow bends.
        let mut lead_to = |target| {
            let mut back = run(&mut world, 1);
            for _ in 0..600 {
                back = stream(&mut world, target, 50);
                assert_eq!((back.mode, back.fault), (law.into(), None));
                if phase(&back) == Some(TargetPhase::Reached) {
                    break;
                }
            }
            back
        };
        let straight = lead_to(pose(&start, [0.0; 3]));
        let off = distance(straight.flange_position_world, start.flange_position_world);
        let bent = lead_to(Target::Posture(ParameterValues::new(&start.q_rad).unwrap()));
        println!("{law:?}: {off} m from where it came from; by a posture: {:?}", phase(&bent));
        // where the base gives way a posture bends it
        assert!(law == Law::FollowMe || phase(&bent) == Some(TargetPhase::Reached), "{bent:?}");
    }
}

#[test]
fn jumping_target_moves_reference_within_bounds() {
    let mut world = armed(Law::Impedance);
    let start = run(&mut world, 1);
    let ends = [pose(&start, [0.2, 0.15, 0.0]), pose(&start, [-0.2, -0.15, 0.1])];
    let (mut before, mut speed_before) = (start.flange_desired_position_world, [0.0; 3]);
    let (mut speed, mut acceleration) = (0.0_f64, 0.0_f64);
    for tick in 0..4000_usize {
        let jump = tick.is_multiple_of(10).then(|| ends[tick / 10 % 2]);
        let request = jump.map(|target| Request::Target(TimedTarget::new(target)));
        let now = world.step(request).0.flange_desired_position_world;
        for i in 0..3 {
            let v = (now[i] - before[i]) / 1e-3;
            speed = speed.max(v.abs());
            acceleration = acceleration.max((v - speed_before[i]).abs() / 1e-3);
            speed_before[i] = v;
        }
        before = now;
    }
    assert!(speed <= 0.25 + 1e-9 && acceleration <= 1.0 + 1e-6, "{speed} m/s, {acceleration} m/s²");
    assert!(speed > 0.0);
}

//! A grasped object through the whole loop: carried while people press the cover, kept through stops and restarts, and lost only
//! where somebody is told so.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has to stop")]

use moca_control::assemble::{motion, supervisor};
use moca_control::config::{Config, HandConfig};
use moca_control::robot::GripperKind;
use moca_control::stage::Untimed;
use moca_control::tick::ControlLoop;
use moca_control::tick_input::Slot;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::virtual_boards::board_config;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::gripper::FRANKA_HAND;
use moca_msgs::{
    GripperFault, GripperPhase, GripperRefusal, GripperRequest, GripperState, Law, Mode, Outcome, Request,
    Sample,
};
use moca_sim::{Engine, Scene};

type World = LockStep<ByteCover, MemoryBoards>;

const GRASP: GripperRequest =
    GripperRequest::Grasp { width_m: 0.05, speed_m_s: 0.05, force_n: 40.0, tolerance_m: 0.005, mass_kg: 0.0 };

/// A robot with a gripper and a cube of 50 mm between its fingers.
fn config(law: Law, mass_kg: f64) -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.startup.law = law;
    config.plant.gripper = GripperKind::Simulated;
    config.simulation.truth.object.mass_kg = mass_kg;
    config
}

fn world(config: &Config) -> World {
    let scene = Scene { engine: Engine::Analytic, ..free_scene(config) };
    let mut world = LockStep::with_board(config, &scene, board_config(config), None).unwrap();
    let law = config.startup.law;
    assert!((0..5000).any(|_| world.step(None).0.mode == law.into()), "it arms itself");
    world
}

fn ask(world: &mut World, request: GripperRequest) -> Outcome {
    world.step(Some(Request::Gripper(request))).1.unwrap()
}

fn run(world: &mut World, ticks: u32) -> Sample {
    (0..ticks).fold(Sample::default(), |_, _| world.step(None).0)
}

/// Lets the fingers come to rest.
fn settle(world: &mut World) -> GripperState {
    for _ in 0..6000 {
        let gripper = world.step(None).0.gripper.unwrap();
        if gripper.phase != GripperPhase::Moving {
            return gripper;
        }
    }
    panic!("the fingers move for ever")
}

/// Starts with the cube held.
fn holding(config: &Config) -> World {
    let mut world = world(config);
    ask(&mut world, GRASP).unwrap();
    let state = settle(&mut world);
    assert_eq!((state.phase, state.fault), (GripperPhase::Holding, None));
    world
}

fn object_world(world: &World) -> [f64; 3] {
    world.control.plant.world.object_position_world().unwrap()
}

fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn object_is_carried_5_m_while_every_taxel_is_pressed() {
    let mut world = holding(&config(Law::FollowMe, 0.5));
    let (mut way_m, mut last, mut presses) = (0.0, object_world(&world), 0);
    for force_n in [20.0, 40.0, 60.0] {
        for taxel in 0..11 {
            for (force_n, ticks) in [(force_n, 3000), (0.0, 500)] {
                let pressed = world.step(Some(Request::PressTaxel { taxel, force_n }));
                assert_eq!(pressed.1, Some(Ok(())));
                for _ in 0..ticks {
                    let sample = world.step(None).0;
                    let holds = sample.gripper.is_some_and(|gripper| gripper.is_holding());
                    assert!(
                        holds && sample.mode == Mode::FollowMe,
                        "T{}, {force_n} N: {sample:?}",
                        taxel + 1
                    );
                }
                let now = object_world(&world);
                way_m += distance_m(now, last);
                last = now;
            }
            presses += 1;
        }
    }
    println!("{way_m:.2} m in {presses} presses, {:.1} mm below its place", 1e3 * below_tip_m(&world));
    assert!(way_m >= 5.0, "{way_m}");
    assert!(below_tip_m(&world) < 1e-4, "it does not slide");
}

/// Distance of the cube from the middle of the fingers, m.
fn below_tip_m(world: &World) -> f64 {
    let flange = world.control.plant.world.flange_position_world().unwrap();
    (distance_m(object_world(world), flange) - FRANKA_HAND.tip_flange_m[2]).abs()
}

/// Largest and last distance of the flange from its place, m, in the 3 s after 1 kg is held whose mass was told as `told_kg`, and
/// in the 3 s after it is let go.
fn drop_m(law: Law, told_kg: f64) -> [[f64; 2]; 2] {
    let GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, .. } = GRASP else { panic!() };
    let grasp = GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg: told_kg };
    let mut world = world(&config(law, 1.0));
    let place = run(&mut world, 1000).flange_position_world;
    [(grasp, true), (GripperRequest::Release, false)].map(|(request, holds)| {
        ask(&mut world, request).unwrap();
        assert_eq!(settle(&mut world).is_holding(), holds);
        let (mut most_m, mut off_m) = (0.0_f64, 0.0);
        for _ in 0..3000 {
            let sample = world.step(None).0;
            assert_eq!(sample.mode, law.into());
            assert_eq!(
                sample.gripper.unwrap().object_kg.to_bits(),
                if holds { told_kg } else { 0.0 }.to_bits()
            );
            off_m = distance_m(sample.flange_position_world, place);
            most_m = most_m.max(off_m);
        }
        [most_m, off_m]
    })
}

#[test]
fn flange_stays_under_an_object_whose_mass_is_told() {
    for law in [Law::Impedance, Law::FollowMe] {
        let (told, untold) = (drop_m(law, 1.0), drop_m(law, 0.0));
        println!("{law:?}: 1 kg told {told:?} m, not told {untold:?} m");
        assert!(told.as_flattened().iter().all(|off_m| *off_m < 2e-3), "{law:?}: {told:?} m");
        let [[_, sags_m], [_, let_go_m]] = untold;
        assert!(sags_m > 1e-2 && let_go_m < 2e-3, "{law:?}: {untold:?} m");
    }
}

#[test]
fn grasp_of_nothing_and_of_a_box_too_large_say_so() {
    for (mass_kg, size_m, fault) in
        [(0.0, 0.05, GripperFault::NothingGrasped), (0.5, 0.07, GripperFault::TooLarge)]
    {
        let mut config = config(Law::Impedance, mass_kg);
        config.simulation.truth.object.size_m = size_m;
        let mut world = world(&config);
        ask(&mut world, GRASP).unwrap();
        let state = settle(&mut world);
        assert_eq!((state.phase, state.fault), (GripperPhase::Resting, Some(fault)));
        assert_eq!(run(&mut world, 1).mode, Mode::Impedance, "nothing stops for it");
    }
}

#[test]
fn stop_resume_and_disarm_let_nothing_go() {
    for law in [Law::Impedance, Law::FollowMe] {
        let mut world = holding(&config(law, 0.5));
        for (request, mode) in [
            (Request::Stop, Mode::ProtectiveStop),
            (Request::Resume, Mode::Ready),
            (Request::Arm, law.into()),
            (Request::Disarm, Mode::Ready),
        ] {
            assert_eq!(world.step(Some(request)).1, Some(Ok(())), "{request}");
            for _ in 0..1500 {
                let sample = world.step(None).0;
                assert!(sample.gripper.unwrap().is_holding() && sample.mode == mode, "{request}: {sample:?}");
            }
        }
        world.step(Some(Request::Stop));
        assert_eq!(ask(&mut world, GripperRequest::Stop), Ok(()));
        assert!(settle(&mut world).is_holding(), "a stop of the fingers lets nothing go");
        assert_eq!(ask(&mut world, GripperRequest::Release), Ok(()), "asked for, in a protective stop too");
        let open = settle(&mut world);
        assert_eq!((open.phase, open.fault), (GripperPhase::Resting, None));
        assert!((open.width_m - FRANKA_HAND.width_max_m).abs() < 1e-9);
    }
}

#[test]
fn restarted_controller_finds_the_object_held() {
    let config = config(Law::FollowMe, 0.5);
    let world = holding(&config);
    let plant = world.control.plant;
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let mut control =
        ControlLoop::new(plant, None::<ByteCover>, supervisor(&config), motion(&config).unwrap(), period_s);
    for tick in 0..2000 {
        let slot = Slot { tick, now_ns: tick * config.period_ns(), ticks: 1, ..Slot::default() };
        let sample = &control.tick(&slot, None, &mut Untimed).sample;
        assert!(sample.gripper.unwrap().is_holding() && sample.mode == Mode::Starting, "{sample:?}");
    }
}

#[test]
fn unplugged_hand_is_a_fault_of_its_own() {
    let config = config(Law::FollowMe, 0.5);
    let mut world = holding(&config);
    let now_s = moca_msgs::seconds(run(&mut world, 1).time_ns);
    world.inject(&format!("gripper-unplugged@{}", now_s + 0.1).parse().unwrap(), 1);
    let before = run(&mut world, 300);
    let gripper = before.gripper.unwrap();
    assert_eq!((gripper.phase, gripper.fault), (GripperPhase::Unknown, Some(GripperFault::Unplugged)));
    assert_eq!(ask(&mut world, GripperRequest::Release), Err(GripperRefusal::Silent.into()));
    world.step(Some(Request::PressTaxel { taxel: 0, force_n: 30.0 }));
    let pressed = run(&mut world, 1500);
    assert_eq!((pressed.mode, pressed.fault), (Mode::FollowMe, None));
    let moved = |of: fn(&Sample) -> [f64; 3]| distance_m(of(&pressed), of(&before));
    let (base_m, flange_m) =
        (moved(|sample| sample.base_pose_world), moved(|sample| sample.flange_position_world));
    assert!(base_m > 0.05 && flange_m > 0.05, "base {base_m} m, flange {flange_m} m");
    assert!(below_tip_m(&world) < 1e-4, "its fingers stay as they are");
}

#[test]
fn robot_without_gripper_shows_none_and_takes_no_request() {
    let mut world = world(&Config { plant: Config::default().plant, ..config(Law::Impedance, 0.0) });
    assert_eq!(run(&mut world, 1).gripper, None);
    assert_eq!(ask(&mut world, GripperRequest::Home), Err(GripperRefusal::NoGripper.into()));
    let wide = GripperRequest::Move { width_m: 0.081, speed_m_s: 0.05 };
    let mut with = holding(&config(Law::Impedance, 0.5));
    let said = Request::Gripper(wide).refused(ask(&mut with, wide).unwrap_err()).to_string();
    assert_eq!(said, "width of the gripper = 0.081 m; allowed: 0 to 0.08 m");
    assert!(run(&mut with, 1).gripper.unwrap().is_holding(), "a refused request changes nothing");
}

#[test]
fn configuration_asks_for_an_arm_and_for_a_gripper() {
    let mistakes = |text: &str| Config::parse(text).unwrap_err().to_string();
    for (text, said) in [
        (
            "[plant]\ngripper = \"simulated\"\nparts = \"base\"\n",
            "plant.gripper = \"simulated\" needs a simulated arm",
        ),
        (
            "[simulation.true.object]\nmass_kg = 0.5\n",
            "simulation.true.object.mass_kg = 0.5 kg needs a gripper",
        ),
        ("[plant]\ngripper = \"fci\"\n", "plant.gripper = \"fci\" needs a Franka arm"),
        ("[plant]\ngripper = \"suction\"\n", "plant.gripper"),
    ] {
        assert!(mistakes(text).contains(said), "{}", mistakes(text));
    }
    let whole = "[plant]\ngripper = \"simulated\"\n[simulation.true.object]\nmass_kg = 0.5\n";
    assert!(Config::parse(whole).is_ok());
}

//! Fingers and cube: what is grasped is a load on both engines, held as far as friction allows, and lost beyond.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::float_cmp,
    missing_docs,
    reason = "tests fail by panicking"
)]

use moca_msgs::gripper::FRANKA_HAND;
use moca_msgs::robot::{AnyArm, MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
use moca_msgs::{
    Actuation, GripperFault, GripperPhase, GripperRefusal, GripperRequest, Payload, RobotCommand, TrueObject,
};
use moca_sim::{Engine, Scene, SimError, SimPlant};

const BOX: TrueObject = TrueObject { mass_kg: 0.5, ..TrueObject::NONE };
const STIFFNESS: [f64; 7] = [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0];
const DAMPING: [f64; 7] = [10.0, 10.0, 10.0, 10.0, 5.0, 3.5, 1.7];
const ENGINES: [Engine; 2] = [Engine::MuJoCo, Engine::Analytic];

fn scene(engine: Engine, gripper: Option<TrueObject>) -> Scene {
    Scene { engine, gripper, ..Scene::new(&AnyArm::of(&PANDA), &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER) }
}

fn plant(engine: Engine, object: TrueObject) -> SimPlant {
    SimPlant::new(&scene(engine, Some(object))).unwrap()
}

/// Lets the braked robot stand until the fingers rest, and returns what the hand then reports of its phase and fault.
fn settle(plant: &mut SimPlant) -> (GripperPhase, Option<GripperFault>) {
    for _ in 0..6000 {
        plant.step().unwrap();
        let state = plant.gripper().unwrap();
        if state.phase != GripperPhase::Moving {
            return (state.phase, state.fault);
        }
    }
    panic!("the fingers move for ever")
}

fn grasp(width_m: f64, force_n: f64) -> GripperRequest {
    GripperRequest::Grasp { width_m, speed_m_s: 0.05, force_n, tolerance_m: 0.005, mass_kg: 0.0 }
}

fn ask(plant: &mut SimPlant, request: GripperRequest) -> (GripperPhase, Option<GripperFault>) {
    plant.request_gripper(&request).unwrap();
    settle(plant)
}

fn height_m(plant: &SimPlant) -> f64 {
    plant.object_position_world().unwrap()[2]
}

/// Height of the flange over the cube, m: a braked arm sinks by some micrometres.
fn below_m(plant: &SimPlant) -> f64 {
    plant.flange_position_world().unwrap()[2] - height_m(plant)
}

#[test]
fn grasp_says_what_is_between_the_fingers() {
    let of_size = |size_m| TrueObject { size_m, ..BOX };
    for engine in ENGINES {
        for (object, asked_m, width_m, fault) in [
            (of_size(0.05), 0.05, 0.05, None),
            (TrueObject::NONE, 0.05, 0.0, Some(GripperFault::NothingGrasped)),
            (of_size(0.07), 0.05, 0.07, Some(GripperFault::TooLarge)),
            (of_size(0.03), 0.05, 0.03, Some(GripperFault::TooSmall)),
            (of_size(0.1), 0.05, 0.0, Some(GripperFault::NothingGrasped)),
        ] {
            let mut plant = plant(engine, object);
            let phase = if fault.is_none() { GripperPhase::Holding } else { GripperPhase::Resting };
            assert_eq!(ask(&mut plant, grasp(asked_m, 40.0)), (phase, fault), "{object:?}");
            let state = plant.gripper().unwrap();
            assert!((state.width_m - width_m).abs() < 1e-12 && state.requests == 1, "{state:?}");
        }
    }
}

#[test]
fn fingers_close_at_the_speed_that_was_asked_for() {
    let mut plant = plant(Engine::Analytic, TrueObject::NONE);
    plant.request_gripper(&GripperRequest::Move { width_m: 0.03, speed_m_s: 0.02 }).unwrap();
    for _ in 0..1000 {
        plant.step().unwrap();
    }
    assert!((plant.gripper().unwrap().width_m - 0.06).abs() < 1e-9);
    assert_eq!(settle(&mut plant), (GripperPhase::Resting, None));
    assert!((plant.gripper().unwrap().width_m - 0.03).abs() < 1e-12);
}

#[test]
fn held_object_is_a_payload_on_both_engines() {
    let carried = Payload { inertial: BOX.at(FRANKA_HAND.tip_flange_m), ..Payload::NONE };
    for engine in ENGINES {
        let mut gripper = plant(engine, BOX);
        let mut bare = SimPlant::new(&scene(engine, None)).unwrap();
        let mut loaded = SimPlant::new(&Scene { payload: carried, ..scene(engine, None) }).unwrap();
        let same = |gripper: &mut SimPlant, other: &mut SimPlant| {
            let q = [0.3, -0.6, 0.2, -2.0, 0.1, 1.5, 0.7];
            let alike = |a: &[f64], b: &[f64]| {
                let most = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(most < 1e-9, "{engine:?}: {most}");
            };
            for plant in [&mut *gripper, &mut *other] {
                plant.set_state(&[0.1, 0.2, 0.3], &[0.4, 0.3, 0.2], &q, &[0.5; 7]);
            }
            alike(gripper.bias(), other.bias());
            alike(gripper.full_mass_matrix().0, other.full_mass_matrix().0);
        };
        let home = gripper.state().q_rad;
        same(&mut gripper, &mut bare);
        gripper.set_state(&[0.0; 3], &[0.0; 3], &home, &[0.0; 8]);
        assert_eq!(ask(&mut gripper, grasp(0.05, 40.0)).0, GripperPhase::Holding);
        same(&mut gripper, &mut loaded);
        gripper.set_state(&[0.0; 3], &[0.0; 3], &home, &[0.0; 8]);
        ask(&mut gripper, GripperRequest::Release);
        same(&mut gripper, &mut bare);
    }
}

#[test]
fn sensor_at_the_flange_weighs_what_the_fingers_hold() {
    for engine in ENGINES {
        let scene = Scene { flange_sensor_origin: Some([0.0; 6]), ..scene(engine, Some(BOX)) };
        let mut plant = SimPlant::new(&scene).unwrap();
        let weight_n = |plant: &mut SimPlant| {
            let mut sum_n = 0.0;
            for _ in 0..200 {
                plant.step().unwrap();
                let [x, y, z, ..] = plant.flange_reading().unwrap();
                sum_n += f64::hypot(x, y).hypot(z) * z.signum();
            }
            (sum_n / 200.0).abs()
        };
        let bare_n = weight_n(&mut plant);
        assert_eq!(ask(&mut plant, grasp(0.05, 40.0)), (GripperPhase::Holding, None));
        let held_n = weight_n(&mut plant);
        assert!(bare_n < 0.2 && (held_n - 0.5 * 9.81).abs() < 0.2, "{engine:?}: {bare_n} N, then {held_n} N");
    }
}

#[test]
fn object_is_held_up_to_the_friction_of_two_fingers() {
    let least_n = BOX.mass_kg * 9.81 / (2.0 * BOX.friction);
    for engine in ENGINES {
        for (share, phase, fault) in
            [(1.02, GripperPhase::Holding, None), (0.98, GripperPhase::Resting, Some(GripperFault::Lost))]
        {
            let mut plant = plant(engine, BOX);
            let (start_m, below_start_m) = (height_m(&plant), below_m(&plant));
            ask(&mut plant, grasp(0.05, share * least_n));
            for _ in 0..3000 {
                plant.step().unwrap();
            }
            let state = plant.gripper().unwrap();
            assert_eq!((state.phase, state.fault), (phase, fault), "{share}");
            let closed_m = if fault.is_some() { 0.0 } else { 0.05 };
            assert!(
                (state.width_m - closed_m).abs() < 1e-12,
                "a hand that lost its object closes: {state:?}"
            );
            let fell_m = start_m - height_m(&plant);
            let slid_m = (below_m(&plant) - below_start_m).abs();
            assert!(if fault.is_some() { fell_m > 0.4 } else { slid_m < 1e-6 }, "{fell_m} {slid_m}");
        }
    }
}

#[test]
fn slide_of_a_weak_grasp_takes_as_long_as_coulomb_says() {
    let mut plant = plant(Engine::Analytic, BOX);
    let force_n = 0.5 * BOX.mass_kg * 9.81 / (2.0 * BOX.friction);
    ask(&mut plant, grasp(0.05, force_n));
    let ticks = (0..2000).take_while(|_| {
        plant.step().unwrap();
        plant.gripper().unwrap().is_holding()
    });
    let took_s = 1e-3 * f64::from(u32::try_from(ticks.count()).unwrap());
    // half of its weight is carried: half the length of an edge at g/2
    let expected_s = (BOX.size_m / (0.5 * 9.81)).sqrt();
    assert!((took_s - expected_s).abs() < 0.003, "{took_s} s, {expected_s} s");
}

#[test]
fn dropped_object_falls_freely_onto_the_floor() {
    let mut plant = plant(Engine::MuJoCo, BOX);
    assert_eq!(ask(&mut plant, grasp(0.05, 40.0)).0, GripperPhase::Holding);
    for _ in 0..1000 {
        let (state, mut arm_torque_nm) = (plant.state(), [0.0; 7]);
        for (i, torque) in arm_torque_nm.iter_mut().enumerate() {
            *torque = plant.bias()[3 + i] + STIFFNESS[i] * (PANDA.home_rad[i] - state.q_rad[i])
                - DAMPING[i] * state.dq_rad_s[i];
        }
        let base_velocity_body = [0.3, 0.0, 0.0];
        let command = RobotCommand { base_velocity_body, arm_torque_nm, arm_gravity_nm: [0.0; 7] };
        plant.apply(&Actuation::Drive(command)).unwrap();
        plant.step().unwrap();
    }
    plant.apply(&Actuation::<7>::Brake).unwrap();
    for _ in 0..600 {
        plant.step().unwrap();
    }
    assert!(plant.gripper().unwrap().is_holding(), "driven off, and braked");
    let above_m = height_m(&plant) - 0.5 * BOX.size_m;
    plant.request_gripper(&GripperRequest::Release).unwrap();
    let falls = (0..2000).take_while(|_| {
        plant.step().unwrap();
        height_m(&plant) > 0.5 * BOX.size_m
    });
    let took_s = 1e-3 * f64::from(u32::try_from(falls.count()).unwrap());
    assert!((took_s - (2.0 * above_m / 9.81).sqrt()).abs() < 0.005, "{took_s} s for {above_m} m");
    assert_eq!(settle(&mut plant), (GripperPhase::Resting, None), "let go on purpose");
    let again = ask(&mut plant, grasp(0.05, 40.0));
    assert_eq!(again, (GripperPhase::Resting, Some(GripperFault::NothingGrasped)), "it lies on the floor");
}

#[test]
fn nothing_but_a_wider_request_lets_go() {
    for engine in ENGINES {
        let mut plant = plant(engine, BOX);
        ask(&mut plant, grasp(0.05, 40.0));
        assert_eq!(ask(&mut plant, GripperRequest::Stop), (GripperPhase::Holding, None));
        let narrower = GripperRequest::Move { width_m: 0.02, speed_m_s: 0.05 };
        assert_eq!(ask(&mut plant, narrower), (GripperPhase::Holding, Some(GripperFault::Blocked)));
        let bad = GripperRequest::Move { width_m: 0.09, speed_m_s: 0.05 };
        assert!(matches!(plant.request_gripper(&bad), Err(GripperRefusal::OutOfRange { .. })));
        assert!(plant.gripper().unwrap().is_holding(), "a refused request changes nothing");
        let wider = GripperRequest::Move { width_m: 0.06, speed_m_s: 0.05 };
        assert_eq!(ask(&mut plant, wider), (GripperPhase::Resting, None));
        assert_eq!(
            ask(&mut plant, grasp(0.05, 40.0)),
            (GripperPhase::Holding, None),
            "it fell onto its support"
        );
        assert_eq!(
            ask(&mut plant, GripperRequest::Home),
            (GripperPhase::Resting, Some(GripperFault::Blocked))
        );
    }
}

#[test]
fn homing_opens_closes_and_opens_empty_fingers() {
    let mut plant = plant(Engine::Analytic, TrueObject::NONE);
    ask(&mut plant, GripperRequest::Move { width_m: 0.04, speed_m_s: 0.1 });
    plant.request_gripper(&GripperRequest::Home).unwrap();
    let mut widths_m = vec![];
    while plant.gripper().unwrap().phase == GripperPhase::Moving {
        plant.step().unwrap();
        widths_m.push(plant.gripper().unwrap().width_m);
    }
    let turns = widths_m.windows(3).filter(|w| (w[1] - w[0]) * (w[2] - w[1]) < 0.0).count();
    let least_m = widths_m.iter().copied().fold(1.0, f64::min);
    assert_eq!((turns, plant.gripper().unwrap().fault), (2, None), "{least_m}");
    assert!(least_m.abs() < 1e-12 && (widths_m.last().unwrap() - 0.08).abs() < 1e-12);
}

#[test]
fn latest_request_counts_and_a_stop_ends_it_on_the_way() {
    let mut plant = plant(Engine::Analytic, TrueObject::NONE);
    plant.request_gripper(&GripperRequest::Move { width_m: 0.0, speed_m_s: 0.1 }).unwrap();
    for _ in 0..300 {
        plant.step().unwrap();
    }
    plant.request_gripper(&GripperRequest::Move { width_m: 0.08, speed_m_s: 0.1 }).unwrap();
    for _ in 0..100 {
        plant.step().unwrap();
    }
    assert_eq!(ask(&mut plant, GripperRequest::Stop), (GripperPhase::Resting, None));
    let state = plant.gripper().unwrap();
    assert!((state.width_m - 0.06).abs() < 1e-9 && state.requests == 3, "{state:?}");
}

#[test]
fn unplugged_hand_keeps_its_object_and_answers_nothing() {
    let mut plant = plant(Engine::MuJoCo, BOX);
    ask(&mut plant, grasp(0.05, 40.0));
    plant.unplug_gripper();
    assert_eq!(settle(&mut plant), (GripperPhase::Unknown, Some(GripperFault::Unplugged)));
    assert_eq!(plant.request_gripper(&GripperRequest::Release), Err(GripperRefusal::Silent));
    let before_m = below_m(&plant);
    for _ in 0..500 {
        plant.step().unwrap();
    }
    assert!((below_m(&plant) - before_m).abs() < 1e-5, "the fingers stay as they are");
}

#[test]
fn gripper_without_object_changes_no_bit_and_no_model() {
    for engine in ENGINES {
        let mut plants =
            [None, Some(TrueObject::NONE)].map(|gripper| SimPlant::new(&scene(engine, gripper)).unwrap());
        assert_eq!(plants[0].model_size(), plants[1].model_size());
        plants[1].request_gripper(&grasp(0.05, 40.0)).unwrap();
        for _ in 0..500 {
            for plant in &mut plants {
                plant.press(3, 30.0).unwrap();
                plant.step().unwrap();
            }
        }
        assert_eq!(plants[0].state(), plants[1].state());
        assert_eq!((plants[0].gripper(), plants[0].object_position_world()), (None, None));
        assert_eq!(plants[0].request_gripper(&GripperRequest::Home), Err(GripperRefusal::NoGripper));
    }
}

#[test]
fn scene_refuses_an_object_or_gripper_that_cannot_be() {
    for (object, name) in [
        (TrueObject { mass_kg: f64::NAN, ..BOX }, "object.mass"),
        (TrueObject { size_m: 0.001, ..BOX }, "object.size"),
        (TrueObject { friction: -0.1, ..BOX }, "object.friction"),
        (TrueObject { position_world_m: [0.0, f64::INFINITY, 0.0], ..BOX }, "object.position_world"),
    ] {
        let Err(SimError::Scene { name: said, .. }) = SimPlant::new(&scene(Engine::MuJoCo, Some(object)))
        else {
            panic!("{object:?} is taken")
        };
        assert_eq!(said, name);
    }
    let no_arm = Scene { robot: moca_sim::Robot::BaseOnly, ..scene(Engine::MuJoCo, Some(BOX)) };
    assert!(matches!(SimPlant::new(&no_arm), Err(SimError::Unsupported { .. })));
}

#[test]
fn object_stands_where_it_was_put_until_the_fingers_are_there() {
    let away = TrueObject { position_world_m: [2.0, 0.0, 0.4], ..BOX };
    let mut plant = plant(Engine::Analytic, away);
    assert_eq!(
        ask(&mut plant, grasp(0.05, 40.0)),
        (GripperPhase::Resting, Some(GripperFault::NothingGrasped))
    );
    assert_eq!(plant.object_position_world(), Some([2.0, 0.0, 0.4]));
}

#[test]
fn told_mass_is_reported_while_the_object_is_held() {
    let mut plant = plant(Engine::Analytic, BOX);
    let GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, .. } = grasp(0.05, 40.0) else {
        panic!()
    };
    let told = |plant: &SimPlant| plant.gripper().unwrap().object_kg;
    let heavy = GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg: 0.4 };
    assert_eq!(plant.gripper().unwrap().object_flange_m, FRANKA_HAND.tip_flange_m);
    plant.request_gripper(&heavy).unwrap();
    assert_eq!(told(&plant), 0.0, "the fingers are on their way");
    assert_eq!(settle(&mut plant), (GripperPhase::Holding, None));
    assert_eq!(told(&plant), 0.4);
    ask(&mut plant, GripperRequest::Stop);
    assert_eq!(told(&plant), 0.4, "stopped fingers hold on");
    plant.request_gripper(&GripperRequest::Release).unwrap();
    plant.step().unwrap();
    assert_eq!(told(&plant), 0.0, "the fingers have left it");
    settle(&mut plant);
    assert_eq!(ask(&mut plant, grasp(0.05, 40.0)), (GripperPhase::Holding, None));
    assert_eq!(told(&plant), 0.0, "a grasp that tells no mass");
}

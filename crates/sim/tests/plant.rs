//! The plant against an independent model (Pinocchio's numbers), against what a velocity-controlled base promises,
//! and against bad input.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs, reason = "tests fail by panicking")]

use moca_msgs::robot::{AnyArm, FR3, MOCA_MOUNT, Mount, PANDA, PAPER_COVER, SUMMIT_XL};
use moca_msgs::{Actuation, RobotCommand};
use moca_sim::foam::Foam;
use moca_sim::{BodyPart, Integrator, Mobility, Person, Robot, Scene, Shape, SimError, SimPlant, Tissue};

/// The free robot of the paper.
fn paper_scene() -> Scene {
    Scene::new(&AnyArm::of(&PANDA), &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER)
}

const STILL: [f64; 3] = [0.0; 3];
const STIFFNESS: [f64; 7] = [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0];
const DAMPING: [f64; 7] = [10.0, 10.0, 10.0, 10.0, 5.0, 3.5, 1.7];

/// Gravity torques of the home posture, held: read from the plant's own bias.
fn hold(plant: &SimPlant) -> [f64; 7] {
    plant.bias()[3..10].try_into().unwrap()
}

fn drive(plant: &mut SimPlant, base_velocity_body: [f64; 3], ticks: usize) {
    for _ in 0..ticks {
        let state = plant.state();
        let mut arm_torque_nm = hold(plant);
        for i in 0..7 {
            arm_torque_nm[i] +=
                STIFFNESS[i] * (PANDA.home_rad[i] - state.q_rad[i]) - DAMPING[i] * state.dq_rad_s[i];
        }
        plant
            .apply(&Actuation::Drive(RobotCommand {
                base_velocity_body,
                arm_torque_nm,
                arm_gravity_nm: [0.0; 7],
            }))
            .unwrap();
        plant.step().unwrap();
    }
}

#[test]
fn mass_matrix_and_bias_agree_with_pinocchio() {
    let text = include_str!("../../../tests/fixtures/wbc.json");
    let json: serde_json::Value = serde_json::from_str(text).unwrap();
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let mut plant = SimPlant::new(&Scene { joint_limits: false, ..paper_scene() }).unwrap();
    let vectors = json["vectors"].as_array().unwrap();
    assert!(!vectors.is_empty());
    for vector in vectors {
        let (q, qd) = (numbers(&vector["q"]), numbers(&vector["qd"]));
        plant.set_state(&q[..3].try_into().unwrap(), &qd[..3].try_into().unwrap(), &q[3..], &qd[3..]);
        let bias = numbers(&vector["bias_full"]);
        let scale = bias.iter().fold(1.0f64, |m, v| m.max(v.abs()));
        for (a, b) in plant.bias().iter().zip(&bias) {
            assert!((a - b).abs() < 1e-9 * scale, "bias {a} against {b}");
        }
        let flange = plant.flange_position_world().unwrap();
        for (a, b) in flange.iter().zip(numbers(&vector["p_ee"])) {
            assert!((a - b).abs() < 1e-12, "flange {a} against {b}");
        }
        let reference = vector["M_full"].as_array().unwrap();
        let (mass, nv) = plant.full_mass_matrix();
        assert_eq!(nv, 10);
        for (row, expected) in reference.iter().enumerate() {
            for (column, b) in numbers(expected).into_iter().enumerate() {
                let a = mass[row * nv + column];
                assert!((a - b).abs() < 1e-9 * 125.0, "M[{row}][{column}] {a} against {b}");
            }
        }
    }
}

#[test]
fn the_base_follows_cmd_vel_in_its_own_axes_within_its_servo() {
    let start = [1.0, -2.0, std::f64::consts::FRAC_PI_2];
    let mut plant = SimPlant::new(&Scene { base_pose_world: start, ..paper_scene() }).unwrap();
    drive(&mut plant, [0.2, 0.0, 0.0], 1000);
    let state = plant.state();
    // Forward of a base that faces +y is +y; 3 m/s² takes 67 ms to 0.2 m/s, the 15 ms lag adds to it.
    assert!((state.base_velocity_world[1] - 0.2).abs() < 1e-4, "{:?}", state.base_velocity_world);
    assert!(state.base_velocity_world[0].abs() < 1e-4);
    let travelled = state.base_pose_world[1] - start[1];
    assert!((0.17..0.20).contains(&travelled), "{travelled}");
}

#[test]
fn acceleration_stays_within_the_servo_limit() {
    let mut plant = SimPlant::new(&paper_scene()).unwrap();
    let mut last = STILL;
    for _ in 0..300 {
        drive(&mut plant, [0.5, -0.5, 0.8], 1);
        let now = plant.state().base_velocity_world;
        assert!((now[2] - last[2]).abs() < 1.1 * 6.0 * 1e-3, "yaw {} {}", now[2], last[2]);
        let change = (now[0] - last[0]).hypot(now[1] - last[1]);
        assert!(change < 1.1 * 2f64.sqrt() * 3.0 * 1e-3, "{change}");
        last = now;
    }
}

#[test]
fn a_push_of_20_n_does_not_back_drive_the_base() {
    let mut plant = SimPlant::new(&paper_scene()).unwrap();
    plant.press(0, 20.0).unwrap();
    drive(&mut plant, STILL, 3000);
    let pose = plant.state().base_pose_world;
    assert!(pose[0].abs() < 1e-3 && pose[1].abs() < 1e-3 && pose[2].abs() < 1e-3, "{pose:?}");
    assert!(pose[1] < -1e-5, "the push is really there: {pose:?}");
    let wrench = plant.cover_wrench_true_base();
    assert!((wrench[1] + 20.0).abs() < 1e-12 && (wrench[2] - 0.36675 * 20.0).abs() < 1e-12, "{wrench:?}");
}

#[test]
fn braking_stops_base_and_arm_and_holds_against_gravity() {
    for integrator in
        [Integrator::Euler, Integrator::RungeKutta4, Integrator::Implicit, Integrator::ImplicitFast]
    {
        let mut plant = SimPlant::new(&Scene { integrator, ..paper_scene() }).unwrap();
        plant.set_state(&STILL, &STILL, &PANDA.home_rad, &[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0]);
        drive(&mut plant, [0.3, 0.0, 0.3], 5);
        plant.apply(&Actuation::<7>::Brake).unwrap();
        for _ in 0..500 {
            plant.step().unwrap();
        }
        let state = plant.state();
        assert!(state.base_velocity_world.iter().all(|v| v.abs() < 1e-4), "{integrator:?} {state:?}");
        assert!(state.dq_rad_s.iter().all(|v| v.abs() < 1e-4), "{integrator:?} {state:?}");
    }
}

#[test]
fn nan_in_a_command_is_refused_and_the_plant_brakes() {
    let mut plant = SimPlant::new(&paper_scene()).unwrap();
    drive(&mut plant, [0.2, 0.0, 0.0], 200);
    let bad = RobotCommand {
        base_velocity_body: [f64::NAN, 0.0, 0.0],
        arm_torque_nm: [0.0; 7],
        arm_gravity_nm: [0.0; 7],
    };
    let refused = plant.apply(&Actuation::Drive(bad)).unwrap_err();
    assert!(matches!(refused, SimError::Command { name: "base velocity", .. }), "{refused}");
    for _ in 0..400 {
        plant.step().unwrap();
    }
    assert!(plant.state().base_velocity_world[0].abs() < 1e-4);
    assert!(plant.set_flange_wrench_world([0.0, 0.0, f64::INFINITY, 0.0, 0.0, 0.0]).is_err());
    assert!(plant.press(11, 5.0).is_err());
    assert!(plant.press(0, f64::NAN).is_err());
    assert!(plant.press(0, -1.0).is_err());
}

#[test]
fn base_that_is_taken_over_goes_as_it_is_told() {
    let mut plant = SimPlant::new(&paper_scene()).unwrap();
    plant.take_over_base(Some([0.1, 0.0, 0.0])).unwrap();
    drive(&mut plant, [-0.2, 0.0, 0.0], 400);
    assert!((plant.state().base_velocity_world[0] - 0.1).abs() < 1e-3);
    assert!(plant.take_over_base(Some([0.0, f64::NAN, 0.0])).is_err());
    drive(&mut plant, [-0.2, 0.0, 0.0], 1);
    assert!((plant.state().base_velocity_world[0] - 0.1).abs() < 1e-3, "a refused order changes nothing");
    plant.take_over_base(None).unwrap();
    drive(&mut plant, [-0.2, 0.0, 0.0], 400);
    assert!((plant.state().base_velocity_world[0] + 0.2).abs() < 1e-3);
}

#[test]
fn nan_in_the_state_is_an_error_and_not_a_silent_restart() {
    let mut plant = SimPlant::new(&paper_scene()).unwrap();
    drive(&mut plant, [0.2, 0.0, 0.0], 100);
    plant.set_state(&[f64::NAN, 0.0, 0.0], &STILL, &PANDA.home_rad, &[0.0; 7]);
    let failed = plant.step().unwrap_err();
    assert!(matches!(failed, SimError::Unstable { .. }), "{failed}");
    assert!(plant.time_s() > 0.09, "time was not set back");
}

#[test]
fn a_scene_with_a_bad_number_names_it() {
    let error = SimPlant::new(&Scene { physics_step_s: f64::NAN, ..paper_scene() }).unwrap_err();
    assert_eq!(error.to_string(), "scene: physics_step_s = NaN s is outside 0.000001 to 0.1 s");
    let error = SimPlant::new(&Scene { physics_step_s: 3e-4, ..paper_scene() }).unwrap_err();
    assert!(matches!(error, SimError::Period { .. }));
    let foam = Foam { gap_m: 0.5, ..Foam::default() };
    let error = SimPlant::new(&Scene { foam, ..paper_scene() }).unwrap_err();
    assert_eq!(error.to_string(), "scene: foam.thickness = 0.5 m is outside 0.001 to 0.1 m");
    let mut scene = Scene { people: vec![Person::beside(&PAPER_COVER, 5, 0.1).unwrap()], ..paper_scene() };
    scene.cover[5].inward_angle_base_rad = 0.0;
    let error = SimPlant::new(&scene).unwrap_err();
    assert_eq!(error.to_string(), "scene: taxel.distance_outward = -0.489 m is outside 0.03 to 15 m");
}

/// Nothing but its servo pushes the base: it gives way by the change of the robot's momentum over the servo's damping.
#[test]
fn base_gives_way_to_momentum_of_its_arm() {
    let mut plant = SimPlant::new(&paper_scene()).unwrap();
    let (mut before, mut largest) = (plant.momentum_world(), [0.0_f64; 3]);
    assert!(before == STILL, "nothing moves: {before:?}");
    for tick in 0..300 {
        let mut arm_torque_nm = hold(&plant);
        arm_torque_nm[0] += 30.0 * (f64::from(tick) * 0.05).sin();
        arm_torque_nm[1] += 30.0 * (f64::from(tick) * 0.05).cos();
        let command = RobotCommand { base_velocity_body: STILL, arm_torque_nm, arm_gravity_nm: [0.0; 7] };
        plant.apply(&Actuation::Drive(command)).unwrap();
        plant.step().unwrap();
        let (now, velocity) = (plant.momentum_world(), plant.state().base_velocity_world);
        for i in 0..3 {
            let given = (before[i] - now[i]) / 1e-3 / moca_sim::SERVO_DAMPING[i];
            largest[i] = largest[i].max(given.abs());
            let off = (velocity[i] - given).abs();
            assert!(tick < 10 || off < 0.05 * largest[i], "axis {i}, tick {tick}: {velocity:?}, {given}");
        }
        before = now;
    }
    assert!(largest.iter().all(|given| *given > 1e-4), "the arm was swung: {largest:?}");
}

#[test]
fn flange_wrench_is_reported_only_with_sensor() {
    let mut plant = SimPlant::new(&Scene { flange_sensor: true, ..paper_scene() }).unwrap();
    plant.set_flange_wrench_world([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]).unwrap();
    let before = plant.flange_position_world().unwrap();
    drive(&mut plant, STILL, 500);
    assert!(plant.flange_position_world().unwrap()[2] > before[2] + 1e-3);
    assert_eq!(plant.state().flange_wrench_world, Some([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]));
    assert_eq!(SimPlant::new(&paper_scene()).unwrap().state().flange_wrench_world, None);
}

/// Joint torque of a wrench about the flange's origin: from differences of the flange's place, not from MuJoCo's
/// Jacobian.
#[test]
fn a_force_at_the_flange_acts_at_its_origin_and_nowhere_else() {
    const STEP_RAD: f64 = 1e-6;
    let scene = Scene { robot: Robot::ArmOnly, joint_limits: false, ..paper_scene() };
    let mut plant = SimPlant::new(&scene).unwrap();
    let q = [0.3, -0.5, 0.4, -2.0, 0.3, 1.7, 0.6];
    let force = [12.0, -7.0, 5.0];
    let expected: Vec<f64> = (0..7)
        .map(|joint| {
            let mut place = |sign: f64| {
                let mut q = q;
                q[joint] += sign * STEP_RAD;
                plant.set_state(&STILL, &STILL, &q, &[0.0; 7]);
                plant.flange_position_world().unwrap()
            };
            let (ahead, behind) = (place(1.0), place(-1.0));
            (0..3).map(|k| force[k] * (ahead[k] - behind[k]) / (2.0 * STEP_RAD)).sum()
        })
        .collect();
    // M (dq with - dq without) / dt is the torque that the force alone makes.
    let mut speeds = |wrench: [f64; 6]| {
        plant.set_state(&STILL, &STILL, &q, &[0.0; 7]);
        plant.set_flange_wrench_world(wrench).unwrap();
        let command =
            RobotCommand { base_velocity_body: STILL, arm_torque_nm: [0.0; 7], arm_gravity_nm: [0.0; 7] };
        plant.apply(&Actuation::Drive(command)).unwrap();
        plant.step().unwrap();
        let mass = plant.full_mass_matrix().0.to_vec();
        (plant.state().dq_rad_s, mass)
    };
    let (without, mass) = speeds([0.0; 6]);
    let (with, _) = speeds([force[0], force[1], force[2], 0.0, 0.0, 0.0]);
    for (row, expected) in expected.iter().enumerate() {
        let torque: f64 = (0..7).map(|k| mass[row * 7 + k] * (with[k] - without[k]) / 1e-3).sum();
        // 0.107 m beside the flange it would be up to 1.3 N·m more.
        assert!((torque - expected).abs() < 2e-3, "joint {}: {torque} against {expected} N·m", row + 1);
    }
}

/// The person's place and the force on each taxel while the base drives at `velocity_body`.
fn driven(person: Person, velocity_body: [f64; 3], ticks: usize) -> Vec<[f64; 11]> {
    let mut plant = SimPlant::new(&Scene { people: vec![person], ..paper_scene() }).unwrap();
    (0..ticks)
        .map(|_| {
            drive(&mut plant, velocity_body, 1);
            plant.taxel_force_true_n().try_into().unwrap()
        })
        .collect()
}

#[test]
fn a_leg_before_the_corner_is_felt_at_once_and_by_both_sides() {
    // The centre of the leg, 5 mm outside the corner's diagonal; forwards and to the left at the same speed.
    let corner = Person { friction: 0.0, ..Person::part(BodyPart::Leg, &PAPER_COVER, 3, 0.0, 0.0).unwrap() };
    let reach = (0.07 + 0.015 + 0.005) * std::f64::consts::FRAC_1_SQRT_2;
    let corner = Person { position_world: [0.489 - 0.015 + reach, 0.388 - 0.015 + reach], ..corner };
    let forces = driven(corner, [0.05, 0.05, 0.0], 400);
    let touch = forces.iter().position(|f| f[3] > 0.0).unwrap();
    let largest_rise =
        forces.windows(2).map(|w| w[1].iter().sum::<f64>() - w[0].iter().sum::<f64>()).fold(0.0, f64::max);
    // 5 mm at 0.07 m/s; a tick of 1 ms adds 0.07 mm of foam.
    assert!((70..130).contains(&touch), "{touch} ms");
    assert!(largest_rise < 2.0, "{largest_rise} N in a millisecond");
    let last = forces[399];
    assert!(last[3] > 5.0 && (last[3] / last[4] - 1.0).abs() < 0.1, "{last:?}");
}

#[test]
fn a_leg_that_slides_over_a_seam_is_handed_over_without_a_jump() {
    // Held against the left side 3 cm behind the seam of T2 and T3; the base drives backwards, so it slides forwards.
    let mut leg = Person::part(BodyPart::Leg, &PAPER_COVER, 1, -0.006, -0.0922).unwrap();
    leg.mobility = moca_sim::Mobility::Fixed;
    let forces = driven(leg, [-0.2, 0.0, 0.0], 600);
    let total: Vec<f64> = forces.iter().map(|f| f.iter().sum()).collect();
    let jump_n = total[200..].windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    let most = total[200..].iter().copied().fold(0.0, f64::max);
    // A foam that forgot what it has relaxed would jump by some newtons.
    assert!(jump_n < 0.05 && most > 20.0, "a jump of {jump_n} N of {most} N");
    assert!(forces[200][1] > 0.0 && forces[599][1] == 0.0 && forces[599][2] > 10.0, "{:?}", forces[599]);
    assert!(forces.iter().any(|f| f[1] > 0.4 * most && f[2] > 0.4 * most), "shared on the seam");
}

#[test]
fn friction_along_the_cover_drags_base_and_person_alike() {
    let drag = |friction| {
        let mut leg =
            Person { friction, ..Person::part(BodyPart::Leg, &PAPER_COVER, 1, -0.006, 0.0).unwrap() };
        leg.mobility = moca_sim::Mobility::Fixed;
        let mut plant = SimPlant::new(&Scene { people: vec![leg], ..paper_scene() }).unwrap();
        drive(&mut plant, [0.1, 0.0, 0.0], 500);
        plant.cover_wrench_true_base()
    };
    let [along, across, _] = drag(0.5);
    assert!(across < -5.0 && (along / across - 0.5).abs() < 1e-9, "{along} N along, {across} N across");
    assert!(drag(0.0)[0].abs() < f64::MIN_POSITIVE);
}

#[test]
fn walker_has_requested_speed_from_start() {
    let mut walker = Person::part(BodyPart::Leg, &PAPER_COVER, 5, 0.3, 0.0).unwrap();
    (walker.walk_m_s, walker.starts_after_s) = (0.146, 0.2);
    let mut plant = SimPlant::new(&Scene { people: vec![walker], ..paper_scene() }).unwrap();
    drive(&mut plant, STILL, 202);
    let mut last = plant.person_position_world(0).unwrap()[0];
    for _ in 0..1800 {
        drive(&mut plant, STILL, 1);
        let now = plant.person_position_world(0).unwrap()[0];
        let speed = (last - now) / 1e-3;
        assert!((speed - 0.146).abs() < 1e-3, "{speed} m/s");
        last = now;
    }
}

#[test]
fn light_hand_on_stiff_damped_foam_stays_finite() {
    for (walk_m_s, stiffness_n_per_m) in [(0.5, 7.5e4), (1.0, 1e7), (3.0, 1e7)] {
        let mut hand = Person::part(BodyPart::Hand, &PAPER_COVER, 5, 0.05, 0.0).unwrap();
        (hand.walk_m_s, hand.tissue.stiffness_n_per_m) = (walk_m_s, stiffness_n_per_m);
        let scene = Scene { people: vec![hand], foam: Foam::COLLISION_ASSUMED, ..paper_scene() };
        let mut plant = SimPlant::new(&scene).unwrap();
        drive(&mut plant, STILL, 1500);
        let peak_n = plant.contact_peak_true_n();
        assert!(peak_n.is_finite() && peak_n > 1.0, "{peak_n}");
    }
}

#[test]
fn driving_into_a_person_gives_equal_and_opposite_forces() {
    let person = Person::beside(&PAPER_COVER, 5, 0.02).unwrap();
    let mut plant = SimPlant::new(&Scene { people: vec![person], ..paper_scene() }).unwrap();
    let mut peak: f64 = 0.0;
    for _ in 0..1500 {
        drive(&mut plant, [0.05, 0.0, 0.0], 1);
        let force = plant.taxel_force_true_n();
        peak = peak.max(force[5]);
        assert!(force.iter().enumerate().all(|(i, f)| i == 5 || *f == 0.0), "{force:?}");
        assert!((plant.cover_wrench_true_base()[0] + force[5]).abs() < 1e-12);
    }
    let pushed = plant.person_position_world(0).unwrap()[0] - person.position_world[0];
    assert!(peak > 5.0 && pushed > 0.005, "peak {peak} N, person pushed {pushed} m");
}

#[test]
fn base_only_and_arm_only_scenes_hold_only_their_own_joints() {
    let dofs = |robot| SimPlant::new(&Scene { robot, ..paper_scene() }).unwrap().full_mass_matrix().1;
    assert_eq!(dofs(Robot::BaseOnly), 3);
    assert_eq!(dofs(Robot::ArmOnly), 7);
    assert_eq!(dofs(Robot::MobileManipulator), 10);
}

#[test]
fn a_scene_without_contacts_takes_the_memory_that_it_uses() {
    for integrator in
        [Integrator::Euler, Integrator::RungeKutta4, Integrator::Implicit, Integrator::ImplicitFast]
    {
        let people = (0..8).map(|taxel| Person::beside(&PAPER_COVER, taxel, 0.01).unwrap()).collect();
        let mut plant = SimPlant::new(&Scene { people, integrator, ..paper_scene() }).unwrap();
        // every joint beyond its end: all limits push at once
        let beyond = PANDA.q_max_rad.map(|q| q + 0.05);
        plant.set_state(&STILL, &STILL, &beyond, &[0.0; 7]);
        drive(&mut plant, [0.2, 0.1, 0.1], 200);
        let size = plant.model_size();
        println!("{integrator:?}: {} of {} bytes", size.arena_used_bytes, size.arena_bytes);
        assert!(size.arena_used_bytes > 0 && 4 * size.arena_used_bytes < size.arena_bytes, "{size:?}");
        assert!(size.arena_bytes <= 256 << 10, "{size:?}");
    }
}

#[test]
fn the_same_commands_give_the_same_bits() {
    let run = || {
        let person = Person::beside(&PAPER_COVER, 0, 0.01).unwrap();
        let mut plant = SimPlant::new(&Scene { people: vec![person], ..paper_scene() }).unwrap();
        drive(&mut plant, [0.0, 0.1, 0.1], 800);
        (plant.state(), plant.taxel_force_true_n().to_vec())
    };
    assert_eq!(run(), run());
}

#[test]
fn late_walker_and_leaning_hand_press_as_scheduled() {
    let mut comer = Person::part(BodyPart::Hand, &PAPER_COVER, 5, 0.02, 0.05).unwrap();
    (comer.walk_m_s, comer.starts_after_s) = (0.1, 0.3);
    let mut plant = SimPlant::new(&Scene { people: vec![comer], ..paper_scene() }).unwrap();
    plant.set_people_waiting(true);
    drive(&mut plant, STILL, 700);
    plant.set_people_waiting(false);
    let mut first_ms = None;
    for ms in 0..700 {
        drive(&mut plant, STILL, 1);
        if plant.taxel_force_true_n()[5] > 0.0 {
            first_ms = first_ms.or(Some(ms));
        }
    }
    // 0.3 s of waiting and 20 mm at 0.1 m/s.
    assert!((480..560).contains(&first_ms.unwrap()), "{first_ms:?}");
    let [fx, fy, mz] = plant.cover_wrench_true_base();
    let lever_m = (mz - 0.489 * fy) / -fx;
    assert!(fx < -1.0 && (lever_m - 0.05).abs() < 2e-3, "the force acts where the hand is: {lever_m} m");

    let mut leaning = Person::part(BodyPart::Thigh, &PAPER_COVER, 5, 0.0, 0.0).unwrap();
    leaning.lean_n = 30.0;
    let mut plant = SimPlant::new(&Scene { people: vec![leaning], ..paper_scene() }).unwrap();
    drive(&mut plant, STILL, 3000);
    // 800 N/m of posture hold back what the foam gives way.
    assert!((20.0..30.0).contains(&plant.taxel_force_true_n()[5]), "{:?}", plant.taxel_force_true_n());
}

#[test]
fn wall_presses_whole_panel_and_stops_base() {
    let wall = Person::part(BodyPart::Wall, &PAPER_COVER, 5, 0.02, 0.0).unwrap();
    let mut plant = SimPlant::new(&Scene { people: vec![wall], ..paper_scene() }).unwrap();
    drive(&mut plant, [0.05, 0.0, 0.0], 2000);
    let force = plant.taxel_force_true_n();
    assert!(force[4] > 50.0 && (force[4] - force[6]).abs() < 1.0, "{force:?}");
    assert!(force.iter().enumerate().all(|(i, f)| (4..=6).contains(&i) || *f == 0.0), "{force:?}");
    let state = plant.state();
    assert!(state.base_pose_world[0] < 0.06 && state.base_pose_world[2].abs() < 1e-3, "{state:?}");
}

#[test]
fn an_fr3_in_the_scene_agrees_with_pinocchio() {
    let text = include_str!("../../../tests/fixtures/arms.json");
    let json: serde_json::Value = serde_json::from_str(text).unwrap();
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let mut compared = 0;
    for case in json["fr3"].as_array().unwrap() {
        if case["payload"]["mass"].as_f64() != Some(0.0) {
            continue; // the scene's flange is bare
        }
        let mount = numbers(&case["mount"]);
        let scene = Scene {
            robot: Robot::ArmOnly,
            joint_limits: false,
            arm: AnyArm::of(&FR3),
            mount: Mount {
                position_base_m: mount[..3].try_into().unwrap(),
                rpy_rad: mount[3..].try_into().unwrap(),
            },
            ..paper_scene()
        };
        let mut plant = SimPlant::new(&scene).unwrap();
        let (q, dq) = (numbers(&case["q"]), numbers(&case["dq"]));
        plant.set_state(&STILL, &STILL, &q, &dq);
        for (a, b) in plant.bias().iter().zip(numbers(&case["bias"])) {
            assert!((a - b).abs() < 1e-9, "bias {a} against {b}");
        }
        let (mass, nv) = plant.full_mass_matrix();
        assert_eq!(nv, 7);
        for (row, expected) in case["mass"].as_array().unwrap().iter().enumerate() {
            for (column, b) in numbers(expected).into_iter().enumerate() {
                let a = mass[row * nv + column];
                assert!((a - b).abs() < 1e-9, "M[{row}][{column}] {a} against {b}");
            }
        }
        compared += 1;
    }
    assert!(compared >= 1, "no case without a payload");
}

const RIGID_N_M: f64 = 1e9;

/// Force on a body that is held so deep before T6, the base turned by `yaw_rad`, and what T5, T6 and T7 feel of it, N.
fn pressed_by(plates: u8, flesh_n_m: f64, [offset_m, depth_m]: [f64; 2], yaw_rad: f64) -> (f64, [f64; 3]) {
    let flesh = Tissue { stiffness_n_per_m: flesh_n_m, damping_n_s_per_m: 0.0 };
    let shape = Shape::Cylinder { radius_m: 0.05 };
    let person = Person::before(&PAPER_COVER, 5, -depth_m, offset_m, shape, flesh, Mobility::Fixed).unwrap();
    let people = vec![Person { plates, friction: 0.0, ..person }];
    let mut plant = SimPlant::new(&Scene { people, foam: Foam::COLLISION_ASSUMED, ..paper_scene() }).unwrap();
    plant.set_state(&[0.0, 0.0, yaw_rad], &STILL, &[], &[]);
    plant.step().unwrap();
    let felt = plant.taxel_force_true_n();
    (plant.contact_largest_true_n(), [felt[4], felt[5], felt[6]])
}

#[test]
fn flat_body_presses_each_plate_by_all_of_its_depth() {
    let (one_n, _) = pressed_by(1, RIGID_N_M, [0.0, 0.003], 0.0);
    for (plates, offset_m, pressed) in [
        (1, 0.0, [0.0, 1.0, 0.0]),
        (2, 0.01, [1.0, 1.0, 0.0]),
        (2, -0.01, [0.0, 1.0, 1.0]),
        (3, 0.0, [1.0; 3]),
    ] {
        let (all_n, felt_n) = pressed_by(plates, RIGID_N_M, [offset_m, 0.003], 0.0);
        let expected_n = one_n * f64::from(plates);
        assert!((all_n / expected_n - 1.0).abs() < 1e-3, "{plates} plates: {all_n} N, not {expected_n} N");
        for (felt_n, pressed) in felt_n.iter().zip(pressed) {
            assert!((felt_n - pressed * one_n).abs() < 1e-3 * one_n, "{plates} at {offset_m} m: {felt_n} N");
        }
    }
    // all its flesh yields to the sum of their forces
    let (all_n, _) = pressed_by(3, 5e3, [0.0, 0.02], 0.0);
    let (alone_n, _) = pressed_by(1, RIGID_N_M, [0.0, 0.02 - all_n / 5e3], 0.0);
    assert!((all_n / alone_n / 3.0 - 1.0).abs() < 1e-3, "{all_n} N, not three times {alone_n} N");
}

/// T5 and T7 are 0.2586 m left and right of T6.
#[test]
fn flat_body_does_not_turn_with_the_base() {
    let yaw_rad = 0.004;
    let (all_n, felt_n) = pressed_by(3, RIGID_N_M, [0.0, 0.003], yaw_rad);
    let expected_n = [-0.2586, 0.0, 0.2586]
        .map(|right_m| pressed_by(1, RIGID_N_M, [0.0, 0.003 + right_m * yaw_rad], 0.0).0);
    assert!((felt_n.iter().sum::<f64>() - all_n).abs() < 1e-9);
    for (felt_n, expected_n) in felt_n.into_iter().zip(expected_n) {
        assert!((felt_n / expected_n - 1.0).abs() < 0.02, "{felt_n} N, not {expected_n} N");
    }
    // one that is turned away from is let go of
    let (_, [left_n, _, right_n]) = pressed_by(3, RIGID_N_M, [0.0, 0.003], 0.02);
    assert!(left_n <= 0.0 && right_n > felt_n[2], "{left_n} {right_n} N");
}

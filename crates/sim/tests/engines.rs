//! The analytic engine against MuJoCo: step by step from equal states, and along whole trajectories.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs, reason = "tests fail by panicking")]

use moca_msgs::robot::{AnyArm, FR3, LinkInertial, MOCA_MOUNT, Mount, PANDA, PAPER_COVER, SUMMIT_XL, UR10E};
use moca_msgs::{Actuation, Payload, RobotCommand};
use moca_sim::foam::Foam;
use moca_sim::{BodyPart, Engine, Integrator, Person, Robot, Scene, SimError, SimPlant};
use moca_wbc::testing::Numbers;

/// Largest difference after one step from equal states: m, rad, m/s, rad/s.
const STEP: f64 = 1e-9;

fn scene_of(arm: &AnyArm) -> Scene {
    Scene::new(arm, &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER)
}

fn paper_scene() -> Scene {
    scene_of(&AnyArm::of(&PANDA))
}

fn both(scene: &Scene) -> [SimPlant; 2] {
    [Engine::MuJoCo, Engine::Analytic]
        .map(|engine| SimPlant::new(&Scene { engine, ..scene.clone() }).unwrap())
}

/// Every coordinate and rate of base and arm.
fn state(plant: &SimPlant) -> Vec<f64> {
    let state = plant.state();
    [&state.base_pose_world[..], &state.base_velocity_world, &state.q_rad, &state.dq_rad_s].concat()
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Largest difference after one step, from states anywhere, an arm's joints up to `beyond_rad` beyond their ends.
fn one_step(scene: &Scene, beyond_rad: f64) -> f64 {
    let mut plants = both(scene);
    let (mut numbers, mut worst) = (Numbers::from_seed(7), 0.0f64);
    let (table, joints) = (&scene.arm.table, scene.arm.joints);
    for case in 0..400 {
        let base: [f64; 3] = numbers.array(3.0);
        let rate: [f64; 3] = numbers.array(1.0);
        let dq: [f64; 8] = numbers.array(1.0);
        let q: [f64; 8] = std::array::from_fn(|i| {
            let (min, max) = (table.q_min_rad[i] - beyond_rad, table.q_max_rad[i] + beyond_rad);
            0.5 * (min + max) + 0.5 * (max - min) * numbers.next_number()
        });
        let command = RobotCommand {
            base_velocity_body: numbers.array(0.5),
            arm_torque_nm: numbers.array::<8>(30.0),
            arm_gravity_nm: [0.0; 8],
        };
        let wrench = numbers.array(if case % 2 == 0 { 20.0 } else { 0.0 });
        for plant in &mut plants {
            plant.set_state(&base, &rate, &q[..joints], &dq[..joints]);
            plant.set_flange_wrench_world(wrench).unwrap();
            plant.press(case % 11, 40.0).unwrap();
            plant.apply(&if case % 7 == 0 { Actuation::Brake } else { Actuation::Drive(command) }).unwrap();
        }
        let [a, b] = &mut plants;
        assert!(difference(a.bias(), b.bias()) < 1e-11 * 500.0);
        assert!(difference(a.full_mass_matrix().0, b.full_mass_matrix().0) < 1e-11 * 500.0);
        let flange = [&*a, &*b].map(|plant| plant.flange_position_world().unwrap());
        assert!(difference(&flange[0], &flange[1]) < 1e-12, "{flange:?}");
        for plant in &mut plants {
            plant.step().unwrap();
        }
        worst = worst.max(difference(&state(&plants[0]), &state(&plants[1])));
        for plant in &mut plants {
            plant.press(case % 11, 0.0).unwrap();
        }
    }
    worst
}

#[test]
fn engines_agree_on_one_step_for_every_robot() {
    let loaded = Payload {
        inertial: LinkInertial {
            mass_kg: 2.5,
            com_m: [0.02, -0.01, 0.08],
            inertia_com: [0.02, 0.001, -0.001, 0.018, 0.002, 0.01],
        },
        tool_origin: [0.01, 0.02, 0.15, 0.3, -0.2, 0.5],
    };
    let tilted = Mount { position_base_m: [0.25, -0.13, 0.4], rpy_rad: [0.5, -0.3, 1.1] };
    for (name, scene) in [
        ("Panda", paper_scene()),
        ("Panda, Euler", Scene { integrator: Integrator::Euler, ..paper_scene() }),
        ("Panda, 0.1 ms", Scene { physics_step_s: 1e-4, ..paper_scene() }),
        (
            "FR3 with a load and a tool, tilted",
            Scene { mount: tilted, payload: loaded, ..scene_of(&AnyArm::of(&FR3)) },
        ),
        ("UR10e", scene_of(&AnyArm::of(&UR10E))),
    ] {
        let worst = one_step(&scene, -0.01);
        println!("{name}: {worst:.1e}");
        assert!(worst < STEP, "{name}: {worst:.1e}");
    }
}

#[test]
fn joints_beyond_their_ends_are_pushed_back_alike() {
    // up to 0.2 mrad and up to 50 mrad beyond: both ends of the limit's impedance
    for beyond_rad in [0.0002, 0.05] {
        let worst = one_step(&paper_scene(), beyond_rad);
        println!("within {beyond_rad} rad beyond: {worst:.1e}");
        assert!(worst < STEP, "{worst:.1e}");
    }
}

/// Largest difference of base (m, rad), arm (rad), force on a taxel (N) and person (m) along a trajectory of 4 s.
fn along(scene: &Scene, press: Option<(usize, f64)>, velocity_body: [f64; 3]) -> ([f64; 4], f64) {
    const STIFFNESS: [f64; 7] = [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0];
    let mut plants = both(scene);
    let gravity: [f64; 7] = plants[0].bias()[3..10].try_into().unwrap();
    let (mut worst, mut most_n) = ([0.0f64; 4], 0.0f64);
    for tick in 0..4000 {
        for plant in &mut plants {
            let state = plant.state();
            let mut arm_torque_nm = gravity;
            for i in 0..7 {
                arm_torque_nm[i] +=
                    STIFFNESS[i] * (PANDA.home_rad[i] - state.q_rad[i] - state.dq_rad_s[i] / 9.0);
            }
            // arm and base are let go, driven, and braked
            let order = match tick {
                ..3000 => Actuation::Drive(RobotCommand {
                    base_velocity_body: if tick > 100 { velocity_body } else { [0.0; 3] },
                    arm_torque_nm,
                    arm_gravity_nm: [0.0; 7],
                }),
                _ => Actuation::Brake,
            };
            if let Some((taxel, force_n)) = press {
                plant.press(taxel, if (500..2500).contains(&tick) { force_n } else { 0.0 }).unwrap();
            }
            plant.apply(&order).unwrap();
            plant.step().unwrap();
        }
        let [a, b] = &plants;
        let [one, other] = [a.state(), b.state()];
        let place = |plant: &SimPlant| plant.person_position_world(0).unwrap_or_default();
        for (worst, now) in worst.iter_mut().zip([
            difference(&one.base_pose_world, &other.base_pose_world),
            difference(&one.q_rad, &other.q_rad),
            difference(a.taxel_force_true_n(), b.taxel_force_true_n()),
            difference(&place(a), &place(b)),
        ]) {
            *worst = worst.max(now);
        }
        most_n = most_n.max(a.contact_peak_true_n());
        assert!((a.time_s() - b.time_s()).abs() < 1e-12);
    }
    (worst, most_n)
}

#[test]
fn whole_trajectories_agree_free_pushed_and_in_collision() {
    let person = Person::beside(&PAPER_COVER, 5, 0.05).unwrap();
    let collision = Scene { people: vec![person], foam: Foam::COLLISION_ASSUMED, ..paper_scene() };
    let hand = Person::part(BodyPart::Hand, &PAPER_COVER, 3, 0.02, -0.11).unwrap();
    let wall = Person::part(BodyPart::Wall, &PAPER_COVER, 5, 0.3, 0.0).unwrap();
    let crowd = Scene { people: vec![hand, person, wall], ..paper_scene() };
    for (name, scene, press, velocity) in [
        ("free", paper_scene(), None, [0.15, -0.1, 0.2]),
        ("push", paper_scene(), Some((0, 20.0)), [0.0, 0.0, 0.1]),
        ("collision", collision, None, [0.1, 0.0, 0.02]),
        ("a hand at the corner, a leg, a wall", crowd, None, [0.1, 0.05, 0.1]),
    ] {
        let (worst, most_n) = along(&scene, press, velocity);
        let [base, arm, force_n, person] = worst;
        println!(
            "{name}: base {base:.1e} m, rad; arm {arm:.1e} rad; force {force_n:.1e} of {most_n:.0} N; person {person:.1e} m"
        );
        assert!(worst.iter().all(|worst| *worst < 1e-9), "{name}: {worst:?}");
        assert_eq!(most_n > 5.0, press.is_some() || !scene.people.is_empty(), "{name}: {most_n} N");
    }
}

#[test]
fn what_only_mujoco_can_do_is_refused_by_name() {
    let refused = |scene: Scene| match SimPlant::new(&Scene { engine: Engine::Analytic, ..scene }) {
        Err(error @ SimError::NeedsMuJoCo { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    };
    assert_eq!(
        refused(Scene { robot: Robot::BaseOnly, ..paper_scene() }),
        "the analytic engine cannot do a base without its arm: take MuJoCo"
    );
    for scene in [
        Scene { geoms: true, ..paper_scene() },
        Scene { robot: Robot::ArmOnly, ..paper_scene() },
        Scene { integrator: Integrator::RungeKutta4, ..paper_scene() },
        Scene { integrator: Integrator::Implicit, ..paper_scene() },
    ] {
        assert!(refused(scene.clone()).contains(scene.needs_mujoco().unwrap()));
    }
    assert_eq!(paper_scene().needs_mujoco(), None);
}

#[test]
fn a_state_that_is_not_a_number_is_the_same_error() {
    for mut plant in both(&paper_scene()) {
        plant.set_state(&[f64::NAN, 0.0, 0.0], &[0.0; 3], &PANDA.home_rad, &[0.0; 7]);
        let error = plant.step().unwrap_err().to_string();
        assert!(error.contains("a position is not a number or too large"), "{error}");
    }
}

//! The leapfrog: of second order in contact, stable with what is stiff, the same on either engine, and the steps that an
//! accuracy chooses.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs, reason = "tests fail by panicking")]

use moca_msgs::robot::{AnyArm, MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
use moca_msgs::{Actuation, RobotCommand};
use moca_sim::foam::Foam;
use moca_sim::{BodyPart, Engine, Integrator, Mobility, Person, Scene, SimPlant, Tissue};

const PERIOD_S: f64 = 1e-3;
const TICKS: u32 = 1500;

/// A base that drives into somebody with an arm that holds its posture.
fn collision(person: Person, foam: Foam) -> Scene {
    Scene {
        people: vec![person],
        foam,
        integrator: Integrator::Leapfrog,
        engine: Engine::Analytic,
        control_period_s: PERIOD_S,
        ..Scene::new(&AnyArm::of(&PANDA), &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER)
    }
}

fn leg() -> Person {
    Person { steps_away_after_s: Some(0.5), ..Person::beside(&PAPER_COVER, 5, 0.0213).unwrap() }
}

/// Base (m, rad), arm (rad), person (m) and force on T6 (N) at every tick.
struct Trace {
    places: Vec<Vec<f64>>,
    forces_n: Vec<f64>,
}

impl Trace {
    fn peak_n(&self) -> f64 {
        self.forces_n.iter().copied().fold(0.0, f64::max)
    }

    /// Largest difference of places (m, rad) and of forces (N) at any tick.
    fn off(&self, other: &Self) -> [f64; 2] {
        let largest = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let places = self.places.iter().zip(&other.places).map(|(a, b)| largest(a, b)).fold(0.0, f64::max);
        [places, largest(&self.forces_n, &other.forces_n)]
    }
}

fn trace(plant: &mut SimPlant, speed_m_s: f64) -> Trace {
    const STIFFNESS: [f64; 7] = [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0];
    let gravity: [f64; 7] = plant.bias()[3..10].try_into().unwrap();
    let mut trace = Trace { places: Vec::new(), forces_n: Vec::new() };
    for tick in 0..TICKS {
        let state = plant.state();
        let arm_torque_nm = std::array::from_fn(|i| {
            gravity[i] + STIFFNESS[i] * (PANDA.home_rad[i] - state.q_rad[i] - state.dq_rad_s[i] / 9.0)
        });
        let back = tick > TICKS / 2;
        plant
            .apply(&Actuation::Drive(RobotCommand {
                base_velocity_body: [if back { -speed_m_s } else { speed_m_s }, 0.0, 0.0],
                arm_torque_nm,
                arm_gravity_nm: [0.0; 7],
            }))
            .unwrap();
        plant.step().unwrap();
        let state = plant.state();
        let person = plant.person_position_world(0).unwrap();
        trace.places.push([&state.base_pose_world[..], &state.q_rad, &person].concat());
        trace.forces_n.push(plant.taxel_force_true_n()[5]);
    }
    trace
}

fn run(scene: &Scene, step_s: f64) -> Trace {
    trace(&mut SimPlant::new(&Scene { physics_step_s: step_s, ..scene.clone() }).unwrap(), 0.1)
}

/// Slope of log₂ error over the halvings, by least squares.
fn fitted_order(errors: &[f64]) -> f64 {
    let n = errors.len() as f64;
    let mean = (n - 1.0) / 2.0;
    let (mut above, mut below) = (0.0, 0.0);
    for (i, error) in errors.iter().enumerate() {
        above += (i as f64 - mean) * error.log2();
        below += (i as f64 - mean).powi(2);
    }
    -above / below
}

#[test]
fn leapfrog_is_second_order_along_a_collision() {
    let relaxing = Foam { relaxation: 0.3, ..Foam::COLLISION_ASSUMED };
    for (name, foam) in [("collision foam", Foam::COLLISION_ASSUMED), ("and with memory", relaxing)] {
        let scene = collision(leg(), foam);
        let exact = run(&scene, PERIOD_S / 128.0);
        assert!(exact.peak_n() > 20.0 && exact.forces_n[1400] <= 0.0, "{} N", exact.peak_n());
        let mut orders = Vec::new();
        for integrator in [Integrator::Leapfrog, Integrator::ImplicitFast] {
            let scene = Scene { integrator, ..scene.clone() };
            let offs: Vec<[f64; 2]> =
                (0..5).map(|i| run(&scene, PERIOD_S / f64::from(1 << i)).off(&exact)).collect();
            let of = |k: usize| fitted_order(&offs.iter().map(|off| off[k]).collect::<Vec<_>>());
            println!("{name}, {integrator:?}: order {:.2} places, {:.2} force; {offs:?}", of(0), of(1));
            orders.push((of(0), of(1), offs[0]));
        }
        assert!(orders[0].0 > 1.7 && orders[0].1 > 1.4, "leapfrog");
        assert!(orders[1].0 < 1.3, "implicitfast");
        assert!(orders[0].2[0] < 0.2 * orders[1].2[0], "places at 1 ms");
    }
}

#[test]
fn leapfrog_goes_the_same_way_on_either_engine() {
    let hand = Person::part(BodyPart::Hand, &PAPER_COVER, 5, 0.01, 0.03).unwrap();
    for person in [leg(), hand] {
        let scene = collision(person, Foam::PU_LD30);
        let [one, other] = [Engine::Analytic, Engine::MuJoCo]
            .map(|engine| run(&Scene { engine, ..scene.clone() }, PERIOD_S));
        let off = one.off(&other);
        println!("{off:?} of {:.0} N", one.peak_n());
        assert!(off.iter().all(|off| *off < 1e-9) && one.peak_n() > 1.0, "{off:?}");
    }
}

#[test]
fn stiff_and_light_bodies_neither_ring_nor_gain_at_a_long_step() {
    for (mass_kg, stiffness, damping) in [(75.0, 1e7, 0.0), (0.6, 1e7, 0.0), (0.1, 1e9, 0.0), (0.6, 1e6, 1e4)]
    {
        let mut person = Person { steps_away_after_s: None, ..leg() };
        person.tissue = Tissue { stiffness_n_per_m: stiffness, damping_n_s_per_m: damping };
        person.mobility = Mobility::Standing { mass_kg, stiffness_n_per_m: 800.0, damping_n_s_per_m: 300.0 };
        let scene = collision(person, Foam::COLLISION_ASSUMED);
        let (long, exact) = (run(&scene, PERIOD_S), run(&scene, PERIOD_S / 32.0));
        println!("{mass_kg} kg, {stiffness:e} N/m: {:.2} of {:.2} N", long.peak_n(), exact.peak_n());
        assert!((long.peak_n() / exact.peak_n() - 1.0).abs() < 0.05, "{mass_kg} kg, {stiffness:e} N/m");
    }
}

#[test]
fn an_accuracy_is_kept_at_the_steps_that_it_needs() {
    let scene = collision(leg(), Foam::COLLISION_ASSUMED);
    let exact = run(&scene, PERIOD_S / 128.0);
    let mut before = (f64::INFINITY, 0.0);
    for accuracy in [1e-2, 1e-3, 1e-4] {
        let mut plant = SimPlant::new(&Scene { accuracy: Some(accuracy), ..scene.clone() }).unwrap();
        let off = trace(&mut plant, 0.1).off(&exact);
        let spent = plant.steps_spent().unwrap();
        let per_tick = spent.steps as f64 / spent.periods as f64;
        println!("{accuracy:e}: {off:?} m, rad, N; {per_tick:.2} steps a period, {spent:?}");
        assert_eq!((spent.periods, spent.missed), (u64::from(TICKS), 0));
        assert!(off[1] / 25.0 < accuracy, "{off:?}");
        // where the base is, errors of all periods add up
        assert!(off[0] / 0.015 < accuracy || accuracy < 1e-3, "{off:?}");
        assert!(off[1] < before.0 && per_tick > before.1, "more exact and more steps");
        before = (off[1], per_tick);
    }
    // both engines choose alike
    let chosen = [Engine::Analytic, Engine::MuJoCo].map(|engine| {
        let scene = Scene { accuracy: Some(1e-3), engine, ..scene.clone() };
        let mut plant = SimPlant::new(&scene).unwrap();
        (trace(&mut plant, 0.1), plant.steps_spent())
    });
    assert_eq!(chosen[0].1, chosen[1].1);
    assert!(chosen[0].0.off(&chosen[1].0).iter().all(|off| *off < 1e-8));
}

#[test]
fn what_leapfrog_cannot_do_is_refused_with_its_reason() {
    let scene = collision(leg(), Foam::COLLISION_ASSUMED);
    for (scene, words) in [
        (Scene { geoms: true, engine: Engine::MuJoCo, ..scene.clone() }, "leapfrog with geoms"),
        (Scene { accuracy: Some(1e-3), integrator: Integrator::Euler, ..scene.clone() }, "an accuracy with"),
        (Scene { accuracy: Some(0.0), ..scene.clone() }, "accuracy = 0"),
        (Scene { accuracy: Some(f64::NAN), ..scene }, "accuracy = NaN"),
    ] {
        let error = SimPlant::new(&scene).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn euler_and_implicitfast_are_one_where_only_joints_damp() {
    for engine in [Engine::MuJoCo, Engine::Analytic] {
        let scene = Scene { engine, ..collision(leg(), Foam::COLLISION_ASSUMED) };
        let [euler, fast] = [Integrator::Euler, Integrator::ImplicitFast]
            .map(|integrator| run(&Scene { integrator, ..scene.clone() }, PERIOD_S));
        let off = euler.off(&fast);
        println!("{engine:?}: {off:?}");
        assert!(off.iter().all(|off| *off < 1e-9), "{off:?}");
    }
}

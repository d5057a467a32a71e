//! The calls of every control period make no Rust allocation (MuJoCo's own C memory is outside this).
#![allow(
    clippy::unwrap_used,
    unsafe_code,
    missing_docs,
    reason = "a counting allocator is unsafe by nature; tests fail by panicking"
)]

use moca_msgs::robot::{AnyArm, MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
use moca_msgs::{Actuation, RobotCommand};
use moca_sim::{Engine, Person, Scene, SimPlant, VirtualBoard, VirtualBoardConfig};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is handed to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn simulation_step_allocates_nothing_on_either_engine() {
    run(Engine::MuJoCo);
    run(Engine::Analytic);
}

fn run(engine: Engine) {
    let scene = Scene {
        engine,
        people: vec![Person::beside(&PAPER_COVER, 0, 0.01).unwrap()],
        flange_sensor: true,
        ..Scene::new(&AnyArm::of(&PANDA), &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER)
    };
    let mut plant = SimPlant::new(&scene).unwrap();
    let mut board = VirtualBoard::new(VirtualBoardConfig::default()).unwrap();
    let mut bytes = 0;
    let mut touched = false;
    let before = ALLOCATIONS.with(Cell::get);
    for tick in 0..1000u64 {
        let state = plant.state();
        let mut arm_torque_nm: [f64; 7] = plant.bias()[3..10].try_into().unwrap();
        for (torque, dq) in arm_torque_nm.iter_mut().zip(state.dq_rad_s) {
            *torque -= dq;
        }
        let command =
            RobotCommand { base_velocity_body: [0.0, 0.1, 0.0], arm_torque_nm, arm_gravity_nm: [0.0; 7] };
        let order = if tick % 100 < 95 { Actuation::Drive(command) } else { Actuation::Brake };
        plant.apply(&order).unwrap();
        plant.press(5, 10.0).unwrap();
        plant.step().unwrap();
        let force = plant.taxel_force_true_n();
        touched |= force[0] > 0.0;
        board.advance(tick * 1_000_000, force, &mut |line: &[u8]| bytes += line.len());
    }
    assert_eq!(ALLOCATIONS.with(Cell::get), before);
    assert!(bytes > 10_000 && touched, "the run did something: {bytes} bytes");
}

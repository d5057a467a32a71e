//! The simulated robot: everything that `mocad` would otherwise find in the laboratory.
//!
//! Read in this order:
//! 1. [`scene`]: what there is ([`Scene`], [`Person`]) and what integrates it ([`Engine`]: MuJoCo, or base and arm by
//!    the model of `moca-wbc`); the model follows from it and holds nothing else.
//! 2. [`plant`]: [`SimPlant`], the Panda on its velocity-controlled base, stepped one control period at a time.
//! 3. [`foam`] and [`sensor`]: how a force on a taxel becomes a plate gap, counts, and noise.
//! 4. [`board`]: [`VirtualBoard`], which turns forces into the bytes of a Touch Board at its rate and age;
//!    [`pty`]: [`PtyBoard`], the same on a pseudo-terminal in real time.
//!
//! This crate refuses to know: the controllers, the parser of the bytes it emits, and (but for [`PtyBoard`]) a clock.

mod base_link;
pub mod board;
pub mod contact;
mod error;
mod flange_sensor;
pub mod foam;
mod gripper;
mod joint_friction;
mod mechanics;
mod mjcf;
mod outline;
mod people;
pub mod plant;
pub mod pty;
mod quiet;
pub mod scene;
pub mod sensor;
mod stepping;

pub use board::{BoardFailure, VirtualBoard, VirtualBoardConfig};
pub use contact::Tissue;
pub use error::SimError;
pub use mjcf::SERVO_DAMPING;
pub use plant::{ModelSize, SimPlant};
pub use pty::{PtyBoard, SharedForces};
pub use scene::{BodyPart, Engine, Integrator, Mobility, Person, Robot, Scene, Shape};
pub use stepping::StepsSpent;

/// Version of the MuJoCo library that is linked.
pub fn mujoco_version() -> &'static str {
    mujoco_rs::mujoco_version()
}

#[cfg(test)]
mod tests {
    #[test]
    fn linked_mujoco_is_the_pinned_version() {
        assert_eq!(super::mujoco_version(), "3.17.0");
    }
}

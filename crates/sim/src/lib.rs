//! The simulated robot.

pub mod foam;
pub mod sensor;

/// Version of MuJoCo that is linked, e.g. `"3.17.0"`.
pub fn mujoco_version() -> &'static str {
    mujoco_rs::mujoco_version()
}

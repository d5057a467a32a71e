//! The rig of every experiment, without pictures: settings with their keys, the closed loop under test, what is measured
//! of it, and how many cores it may take; on it the collision, its sweep and the drawn meetings, which `moca-lab` and the
//! Python package share.

use moca_control::config::{Config, HandConfig};
use moca_lockstep::simulated_robot;
use moca_msgs::robot::{PANDA, PAPER_COVER};
use moca_msgs::{Law, RobotState};
use moca_sim::Scene;

/// Joints and taxels of the paper's robot, which the experiments are about.
pub const JOINTS: usize = PANDA.joints();
/// Taxels of the paper's cover.
pub const TAXELS: usize = PAPER_COVER.len();

pub mod bound;
pub mod campaign;
pub mod closed_loop;
pub mod collision;
pub mod commissioning;
pub mod cpu_time;
pub mod drawn;
pub mod keys;
pub mod measure;
pub mod meeting;
pub mod parallel;
pub mod run_info;
pub mod settings;
pub mod sweep;
#[cfg(feature = "timed")]
pub mod timed;

/// The free robot that the daemon simulates by default.
pub fn free_scene() -> Scene {
    simulated_robot::free_scene(&Config::default())
}

/// The default configuration with a law to start in, and nobody who presses the cover.
pub fn unattended(law: Law) -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.startup.law = law;
    config
}

/// Converts the state to another scalar.
pub fn state_in<T>(robot: &RobotState<JOINTS>, of: fn(f64) -> T) -> RobotState<JOINTS, T> {
    RobotState {
        base_pose_world: robot.base_pose_world.map(of),
        base_velocity_world: robot.base_velocity_world.map(of),
        q_rad: robot.q_rad.map(of),
        dq_rad_s: robot.dq_rad_s.map(of),
        torque_measured_nm: robot.torque_measured_nm.map(of),
        flange_wrench_world: robot.flange_wrench_world.map(|wrench| wrench.map(of)),
    }
}

/// A number of things, to reckon with.
pub fn count(n: usize) -> f64 {
    u32::try_from(n).map_or(f64::INFINITY, f64::from)
}

/// Bits of functions that differ between C libraries: where these differ, bits of a simulation do too.
pub fn c_library() -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    for i in 1..4000 {
        let x = f64::from(i) * 1.37e-3;
        for value in [x.sin(), x.cos(), x.exp(), x.powf(1.586), x.atan2(0.3)] {
            hash = (hash ^ value.to_bits()).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    hash
}

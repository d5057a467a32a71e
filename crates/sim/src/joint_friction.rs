//! Friction of the arm's joints, and the torque that acts beside the one that a joint reports.
//!
//! Friction is Coulomb's with a smooth way through zero: τ = −τ_C q̇/√(q̇² + v_s²). A step takes the factor D = τ_C/√(q̇² + v_s²)
//! as of its start and the speed as of its end, so friction never turns a joint round and is stable for every step. What rests
//! under a torque below τ_C creeps, at most at v_s for 0.7 τ_C.

use crate::SimError;
use crate::error::within;
use crate::sensor::Noise;
use moca_msgs::{MAX_JOINTS, TrueArm};

/// Speed at which friction has 0.7 of its full value, rad/s; at 0.01 it has 0.995.
const SMOOTHING_RAD_S: f64 = 1e-3;
/// Stream of the torque noise: apart from the others of the same seed.
const STREAM: u64 = 0x746f_7271;

/// Checks the numbers, and that the integrator, explicit or not, can carry friction.
pub(crate) fn check(truth: &TrueArm, is_explicit: bool, has_arm: bool) -> Result<(), SimError> {
    let TrueArm { mass_scale, joint_friction_nm, torque_noise_nm, tool_mass_kg, tool_com_m } = *truth;
    within("true.arm.mass_scale", "", &[mass_scale], 0.5, 2.0)?;
    within("true.arm.joint_friction", "N·m", &[joint_friction_nm], 0.0, 20.0)?;
    within("true.arm.torque_noise", "N·m", &[torque_noise_nm], 0.0, 10.0)?;
    within("true.arm.tool_mass", "kg", &[tool_mass_kg], 0.0, 20.0)?;
    within("true.arm.tool_com", "m", &tool_com_m, -1.0, 1.0)?;
    if joint_friction_nm > 0.0 && is_explicit {
        return Err(SimError::Unsupported {
            what: "joint friction with rk4",
            why: "it is explicit, and friction near rest needs an implicit step: take implicitfast or leapfrog",
        });
    }
    if !has_arm && *truth != TrueArm::AS_DESCRIBED {
        return Err(SimError::Unsupported {
            what: "true.arm on a base without its arm",
            why: "there is nothing that it could change",
        });
    }
    Ok(())
}

/// Friction and noise of every joint of one arm.
#[derive(Debug)]
pub(crate) struct JointFriction {
    coulomb_nm: f64,
    noise_nm: f64,
    noise: Noise,
    /// Torque beside the reported one in this control period, N·m.
    pub(crate) unreported_nm: [f64; MAX_JOINTS],
}

impl JointFriction {
    /// Friction and noise of `truth`; `None` where there is neither.
    pub(crate) fn new(truth: &TrueArm, seed: u64) -> Option<Self> {
        (truth.joint_friction_nm > 0.0 || truth.torque_noise_nm > 0.0).then(|| Self {
            coulomb_nm: truth.joint_friction_nm,
            noise_nm: truth.torque_noise_nm,
            noise: Noise::new(STREAM.wrapping_add(seed)),
            unreported_nm: [0.0; MAX_JOINTS],
        })
    }

    /// Begins a control period of an arm with this number of joints.
    pub(crate) fn next_period(&mut self, joints: usize) {
        if self.noise_nm > 0.0 {
            for torque in &mut self.unreported_nm[..joints] {
                *torque = self.noise_nm * self.noise.standard_normal();
            }
        }
    }

    /// Damping of each joint in a step that starts at the rates `dq`, N·m·s/rad.
    pub(crate) fn damping(&self, dq: &[f64]) -> [f64; MAX_JOINTS] {
        let mut damping = [0.0; MAX_JOINTS];
        for (damping, dq) in damping.iter_mut().zip(dq) {
            *damping = self.coulomb_nm / dq.hypot(SMOOTHING_RAD_S);
        }
        damping
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Engine, Integrator, Robot, Scene, SimPlant};
    use moca_msgs::robot::{AnyArm, MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
    use moca_msgs::{Actuation, RobotCommand};

    fn scene(truth: TrueArm) -> Scene {
        let arm = truth.applied(&AnyArm::of(&PANDA));
        Scene { arm_joints: truth, ..Scene::new(&arm, &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER) }
    }

    /// Speed of the last joint, rad/s, after 0.2 s under `torque_nm` beside gravity's, on either engine and integrator.
    fn speeds(truth: TrueArm, torque_nm: f64, dq_rad_s: f64) -> Vec<f64> {
        let mut speeds = Vec::new();
        for engine in [Engine::MuJoCo, Engine::Analytic] {
            for integrator in [Integrator::ImplicitFast, Integrator::Leapfrog] {
                let mut plant = SimPlant::new(&Scene { engine, integrator, ..scene(truth) }).unwrap();
                let mut start = plant.state();
                start.dq_rad_s[6] = dq_rad_s;
                plant.set_state(&[0.0; 3], &[0.0; 3], &start.q_rad, &start.dq_rad_s);
                for _ in 0..200 {
                    let mut arm_torque_nm = [0.0; MAX_JOINTS];
                    arm_torque_nm[..7].copy_from_slice(&plant.bias()[3..10]);
                    arm_torque_nm[6] += torque_nm;
                    let base_velocity_body = [0.0; 3];
                    let arm_gravity_nm = [0.0; MAX_JOINTS];
                    let command = RobotCommand { base_velocity_body, arm_torque_nm, arm_gravity_nm };
                    plant.apply(&Actuation::Drive(command)).unwrap();
                    plant.step().unwrap();
                }
                speeds.push(plant.state().dq_rad_s[6]);
            }
        }
        speeds
    }

    #[test]
    fn friction_stops_joint_and_never_turns_it_round() {
        let rough = TrueArm { joint_friction_nm: 1.0, ..TrueArm::AS_DESCRIBED };
        let free = speeds(TrueArm::AS_DESCRIBED, 0.0, 0.5);
        for (rough, free) in speeds(rough, 0.0, 0.5).iter().zip(free) {
            assert!(*rough > -1e-12 && *rough < 1e-3 && free > 0.3, "{rough} {free} rad/s");
        }
    }

    #[test]
    fn torque_below_friction_creeps_and_above_it_moves() {
        let rough = TrueArm { joint_friction_nm: 1.0, ..TrueArm::AS_DESCRIBED };
        for speed in speeds(rough, 0.6, 0.0) {
            // 0.6 of the friction: at equilibrium 0.75 of the speed of the smoothing
            assert!((speed - 0.75e-3).abs() < 1e-4, "{speed} rad/s");
        }
        assert!(speeds(rough, 1.5, 0.0).iter().all(|speed| *speed > 0.1));
    }

    #[test]
    fn engines_agree_under_friction_and_noise() {
        let truth = TrueArm {
            mass_scale: 1.1,
            joint_friction_nm: 1.0,
            torque_noise_nm: 0.3,
            ..TrueArm::AS_DESCRIBED
        };
        let [mujoco, mujoco_2, analytic, analytic_2] = speeds(truth, 1.2, 0.1)[..] else {
            panic!("four runs")
        };
        for (mujoco, analytic) in [(mujoco, analytic), (mujoco_2, analytic_2)] {
            assert!((mujoco - analytic).abs() < 1e-8, "{mujoco} {analytic} rad/s");
        }
    }

    #[test]
    fn torque_noise_has_its_deviation_and_is_not_reported() {
        let truth = TrueArm { torque_noise_nm: 0.3, ..TrueArm::AS_DESCRIBED };
        let mut friction = JointFriction::new(&truth, 1).unwrap();
        let (mut sum, mut squares, periods) = (0.0, 0.0, 5000);
        for _ in 0..periods {
            friction.next_period(7);
            for torque in &friction.unreported_nm[..7] {
                sum += torque;
                squares += torque * torque;
            }
            assert_eq!(friction.unreported_nm[7].to_bits(), 0.0_f64.to_bits());
        }
        let drawn = f64::from(7 * periods);
        assert!((sum / drawn).abs() < 0.01 && ((squares / drawn).sqrt() - 0.3).abs() < 0.01);
        let mut plant = SimPlant::new(&scene(truth)).unwrap();
        plant.step().unwrap();
        let reported = plant.state().torque_measured_nm;
        let mut quiet = SimPlant::new(&scene(TrueArm::AS_DESCRIBED)).unwrap();
        quiet.step().unwrap();
        assert_eq!(reported.map(f64::to_bits), quiet.state().torque_measured_nm.map(f64::to_bits));
        assert_ne!(plant.state().dq_rad_s.map(f64::to_bits), quiet.state().dq_rad_s.map(f64::to_bits));
        assert!(JointFriction::new(&TrueArm::AS_DESCRIBED, 1).is_none());
    }

    #[test]
    fn truth_that_nothing_can_carry_is_refused_with_reason() {
        let rough = scene(TrueArm { joint_friction_nm: 1.0, ..TrueArm::AS_DESCRIBED });
        let refused = |scene: Scene| SimPlant::new(&scene).unwrap_err().to_string();
        let explicit = refused(Scene { integrator: Integrator::RungeKutta4, ..rough.clone() });
        assert!(explicit.contains("joint friction with rk4") && explicit.contains("leapfrog"), "{explicit}");
        let alone = refused(Scene { robot: Robot::BaseOnly, ..rough.clone() });
        assert!(alone.contains("true.arm on a base without its arm"), "{alone}");
        for bad in [-1.0, 21.0, f64::NAN] {
            let arm_joints = TrueArm { joint_friction_nm: bad, ..TrueArm::AS_DESCRIBED };
            let said = refused(Scene { arm_joints, ..rough.clone() });
            assert!(said.contains("true.arm.joint_friction") && said.contains("N·m"), "{said}");
        }
    }
}

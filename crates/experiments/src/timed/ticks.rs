//! Whole-body tick on the data of an independent implementation, to be timed next to it.
//!
//! One tick: state → kinematics, Jacobian, mass matrix, bias, task force, eq. (6), torques. The pose error is part of the
//! data's law: e = \[p_d − p; ½ Σ R_k × R_dk\].

use crate::JOINTS;
use moca_wbc::ControlError;
use moca_wbc::impedance::posture_torque;
use moca_wbc::linalg::times;
use moca_wbc::model::{ArmModel, Dynamics};
use moca_wbc::nalgebra::{Matrix3, Vector3};
use moca_wbc::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};

/// Model and parameters of the ticks.
#[derive(Clone, Debug)]
pub struct Ticker {
    /// Arm on its base.
    pub model: ArmModel<JOINTS, f64>,
    /// M_v: kg, kg, kg·m².
    pub virtual_mass: [f64; 3],
    /// H with one value per block.
    pub block: BlockWeight<f64>,
    /// Any diagonal H.
    pub general: AxisWeight<JOINTS, f64>,
    /// K_d: N/m, N·m/rad.
    pub stiffness: [f64; 6],
    /// D_d: N·s/m, N·m·s/rad.
    pub damping: [f64; 6],
    /// Stiffness of the posture, N·m/rad.
    pub posture_stiffness: [f64; JOINTS],
    /// Damping of the posture, N·m·s/rad.
    pub posture_damping: [f64; JOINTS],
    /// Posture, rad.
    pub posture: [f64; JOINTS],
}

/// Input of a tick.
#[derive(Clone, Copy, Debug)]
pub struct Input {
    /// Pose of the base in W: m, m, rad.
    pub base_pose: [f64; 3],
    /// Joint angles, rad.
    pub q: [f64; JOINTS],
    /// Velocity of the base in W: m/s, m/s, rad/s.
    pub base_rate: [f64; 3],
    /// Joint rates, rad/s.
    pub dq: [f64; JOINTS],
    /// Desired orientation of the tool in W.
    pub desired_rotation: Matrix3<f64>,
    /// Desired position of the tool in W, m.
    pub desired_position: Vector3<f64>,
    /// Desired twist of the tool in W: m/s, rad/s.
    pub twist: [f64; 6],
    /// Wrench of the cover on the base in W: N, N, N·m.
    pub cover: [f64; 3],
}

impl Ticker {
    /// Tick with [`Self::block`].
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if a matrix is not.
    pub fn block(
        &self,
        room: &mut Dynamics<JOINTS, f64>,
        input: &Input,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.tick(room, input, |task, wrench, null| {
            let mut weighted = self.block.of(task);
            weighted.factorise()?;
            Ok(weighted.force(wrench, null))
        })
    }

    /// Tick with [`Self::general`].
    ///
    /// # Errors
    /// As [`Self::block`].
    pub fn general(
        &self,
        room: &mut Dynamics<JOINTS, f64>,
        input: &Input,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.tick(room, input, |task, wrench, null| self.general.force(task, wrench, null))
    }

    #[inline]
    fn tick(
        &self,
        dynamics: &mut Dynamics<JOINTS, f64>,
        input: &Input,
        law: impl Fn(
            &TaskDynamics<'_, JOINTS, f64>,
            &[f64; 6],
            &WholeBodyForce<JOINTS, f64>,
        ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError>,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.model.dynamics_at(input.base_pose[2], &input.q, &input.dq, dynamics);
        let (dynamics, kinematics) = (&*dynamics, &dynamics.kinematics);
        let tool = kinematics.tool_from_base() + Vector3::new(input.base_pose[0], input.base_pose[1], 0.0);
        let error =
            pose_error(&(input.desired_position - tool), &kinematics.tool_rotation, &input.desired_rotation);
        let of_base = kinematics.twist_from_base(&input.base_rate);
        let of_arm = times(kinematics.arm_jacobian(), &input.dq);
        let wrench = core::array::from_fn(|i| {
            self.damping[i] * (input.twist[i] - of_base[i] - of_arm[i]) + self.stiffness[i] * error[i]
        });
        let posture = posture_torque(
            &self.posture_stiffness,
            &self.posture_damping,
            &self.posture,
            &input.q,
            &input.dq,
        );
        let null = WholeBodyForce { base: input.cover, arm: posture };
        let mut arm = ArmDynamics::unset(dynamics);
        arm.factorise()?;
        let task = TaskDynamics::new(self.virtual_mass, &arm);
        let mut force = law(&task, &wrench, &null)?;
        force.arm.iter_mut().zip(dynamics.bias).for_each(|(torque, bias)| *torque += bias);
        Ok(force)
    }
}

#[inline]
fn pose_error(linear: &Vector3<f64>, actual: &Matrix3<f64>, desired: &Matrix3<f64>) -> [f64; 6] {
    let mut angular = Vector3::zeros();
    for k in 0..3 {
        angular += actual.column(k).cross(&desired.column(k));
    }
    let angular = angular * 0.5;
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

//! One step's quantities of the arm: computed once, read by every law.

use super::arm_state::ArmState;
use super::law::ControlLaw;
use crate::error::ControlError;
use crate::follow_me;
use crate::impedance;
use crate::limits::LimitsHit;
use crate::linalg::times;
use crate::model::{ArmModel, Dynamics, GRAVITY_M_S2, Kinematics};
use crate::momentum_observer::MomentumObserver;
use crate::opspace::ArmDynamics;
use crate::reference::{Pose, saturated};
use crate::rotation;
use crate::scalar::{Scalar, of};
use crate::self_collision::Near;
use moca_msgs::robot::LinkInertial;
use moca_msgs::{Payload, RobotState};
use nalgebra::{SMatrix, Vector3};

/// One step's quantities, computed once and read by every law.
pub(super) struct ArmTick<'a, const N: usize, T> {
    pub robot: &'a RobotState<N, T>,
    pub dt_s: T,
    pub model: &'a ArmModel<N, T>,
    pub kinematics: &'a Kinematics<N, T>,
    pub dynamics: &'a Dynamics<N, T>,
    pub flange: Pose<T>,
    /// Parts of the arm that are near to others; `None` for none, or without a guard.
    pub near: Option<&'a Near<N, T>>,
    /// Object in the model that the arm's own controller does not know of.
    pub object: Option<&'a HeldObject<T>>,
    /// Nominal control period, s.
    pub period_s: T,
}

/// An object that the hand holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeldObject<T> {
    mass_kg: T,
    /// Centre of mass in the axes of the tool frame E, m.
    com_tool_m: Vector3<T>,
}

impl<T: Scalar> HeldObject<T> {
    /// Object given in the flange's axes; `None` without mass.
    pub(super) fn new(object: &LinkInertial, payload: &Payload) -> Option<Self> {
        let [x, y, z, roll, pitch, yaw] = payload.tool_origin;
        let from_tool = Vector3::from(object.com_m) - Vector3::new(x, y, z);
        let com_tool_m = rotation::from_rpy([roll, pitch, yaw]).tr_mul(&from_tool).map(of);
        (object.mass_kg > 0.0).then(|| Self { mass_kg: of(object.mass_kg), com_tool_m })
    }
}

/// State of the tool, as a law computes it.
#[derive(Clone, Copy)]
pub(super) struct Tracking<T> {
    /// Pose error \[m; rad\], not saturated.
    pub error: [T; 6],
    /// Twist that the joints give it, world axes \[m/s; rad/s\].
    pub arm_twist: [T; 6],
}

impl<const N: usize, T: Scalar> ArmTick<'_, N, T> {
    /// Room for the arm as its task sees it, to be factorised where it stands; a law that holds a posture has none.
    #[inline]
    pub(super) fn task(&self, law: ControlLaw) -> Option<ArmDynamics<'_, N, T>> {
        match law {
            ControlLaw::Hold => None,
            ControlLaw::Impedance | ControlLaw::FollowMe => Some(ArmDynamics::unset(self.dynamics)),
        }
    }

    /// F = K·e + D·ė, e saturated, and what it was computed from. `base_twist` is what the base's motion gives the tool; nothing of
    /// `inverse_task_inertia` is left. eqs. (10), (16)
    #[inline]
    pub(super) fn task_wrench(
        &self,
        state: &ArmState<N, T>,
        base_twist: &[T; 6],
        inverse_task_inertia: &mut SMatrix<T, 6, 6>,
        hit: &mut LimitsHit,
    ) -> Result<([T; 6], Tracking<T>), ControlError> {
        let gains = &state.gains;
        let desired = self.desired(state);
        let error = impedance::pose_error(
            (&self.flange.position, &self.flange.rotation),
            (&desired.position, &desired.rotation),
        );
        let (saturated_error, saturated) = saturated(&error);
        hit.error_saturation = saturated;
        let arm_twist = times(self.kinematics.arm_jacobian(), &self.robot.dq_rad_s);
        let wanted = self.desired_twist(state);
        let rate: [T; 6] = core::array::from_fn(|i| wanted[i] - base_twist[i] - arm_twist[i]);
        let damped = impedance::damped(inverse_task_inertia, &gains.stiffness, gains.damping_ratio, &rate)?;
        let wrench = core::array::from_fn(|i| gains.stiffness[i] * saturated_error[i] + damped[i]);
        Ok((wrench, Tracking { error, arm_twist }))
    }

    /// Torques of the null space, N·m: to the posture, and away from what is near.
    #[inline]
    pub(super) fn posture_torque(&self, state: &ArmState<N, T>) -> [T; N] {
        let dq = &self.robot.dq_rad_s;
        let posture = impedance::posture_torque(
            &state.gains.posture_stiffness,
            &state.gains.posture_damping,
            &state.posture_rad,
            &self.robot.q_rad,
            dq,
        );
        match self.near {
            None => posture,
            Some(near) => {
                let apart = near.avoidance(dq, self.period_s);
                core::array::from_fn(|i| posture[i] + apart[i])
            }
        }
    }

    /// Gravity torques that the arm's own controller knows of, N·m: without those of the object that is held.
    #[inline]
    pub(super) fn gravity_without_object(&self) -> [T; N] {
        let gravity = self.dynamics.gravity();
        let Some(object) = self.object else { return gravity };
        let kinematics = self.kinematics;
        let com = kinematics.tool_position + kinematics.tool_rotation * object.com_tool_m;
        let weight = object.mass_kg * of::<T>(GRAVITY_M_S2);
        core::array::from_fn(|i| {
            let (axis, origin) = kinematics.joint(i);
            gravity[i] - weight * axis.cross(&(com - origin)).z
        })
    }

    /// The reference in W.
    pub(super) fn desired(&self, state: &ArmState<N, T>) -> Pose<T> {
        match state.law {
            ControlLaw::Hold => self.flange,
            ControlLaw::Impedance => state.reference.now,
            ControlLaw::FollowMe => {
                let [x, y, _] = self.robot.base_pose_world;
                let turn = &self.kinematics.base_rotation;
                let reference = &state.reference.now;
                Pose {
                    position: turn * reference.position + Vector3::new(x, y, T::zero()),
                    rotation: turn * reference.rotation,
                }
            }
        }
    }

    /// The reference's twist, world axes.
    fn desired_twist(&self, state: &ArmState<N, T>) -> [T; 6] {
        let twist = state.reference.given();
        if state.law != ControlLaw::FollowMe {
            return twist;
        }
        let [vx, vy, vz, wx, wy, wz] = twist;
        let heading = &self.kinematics.heading;
        let [v0, v1, v2] = heading.to_world([vx, vy, vz]);
        let [w0, w1, w2] = heading.to_world([wx, wy, wz]);
        [v0, v1, v2, w0, w1, w2]
    }

    /// The external wrench from the best source there is: `measured` by the caller, else the robot's own, else the
    /// observer's, which runs where the other two are missing. `arm` is asked for only then.
    #[inline]
    pub(super) fn flange_wrench(
        &self,
        state: &mut ArmState<N, T>,
        measured: Option<[T; 6]>,
        arm: Option<&ArmDynamics<'_, N, T>>,
    ) -> Result<[T; 6], ControlError> {
        if let Some(wrench) = measured.or(self.robot.flange_wrench_world) {
            // an observer that missed steps would take what happened in them for a push
            state.observer = MomentumObserver::new();
            return Ok(wrench);
        }
        let (robot, kinematics) = (self.robot, self.kinematics);
        let (base_velocity, dq) = (&robot.base_velocity_world, &robot.dq_rad_s);
        let momentum = self.model.momentum(kinematics, base_velocity, dq);
        let gravity = self.dynamics.gravity();
        state.observer.update(&momentum, &gravity, &robot.torque_measured_nm, self.dt_s);
        let torque = state.observer.external_torque();
        let about_tool = match arm {
            Some(arm) => arm.felt_wrench(torque)?,
            None => {
                let mut arm = ArmDynamics::unset(self.dynamics);
                arm.factorise()?;
                arm.felt_wrench(torque)?
            }
        };
        Ok(follow_me::moved(&about_tool, &(kinematics.tool_position - kinematics.flange_position)))
    }
}

/// `pose`, given in W, in B.
pub(super) fn seen_from_base<const N: usize, T: Scalar>(
    pose: &Pose<T>,
    kinematics: &Kinematics<N, T>,
    robot: &RobotState<N, T>,
) -> Pose<T> {
    let [x, y, _] = robot.base_pose_world;
    let turn = kinematics.base_rotation.transpose();
    Pose { position: turn * (pose.position - Vector3::new(x, y, T::zero())), rotation: turn * pose.rotation }
}

/// The controlled frame E in W.
pub(super) fn tool_pose<const N: usize, T: Scalar>(
    kinematics: &Kinematics<N, T>,
    robot: &RobotState<N, T>,
) -> Pose<T> {
    let [x, y, _] = robot.base_pose_world;
    Pose {
        position: kinematics.tool_from_base() + Vector3::new(x, y, T::zero()),
        rotation: kinematics.tool_rotation,
    }
}

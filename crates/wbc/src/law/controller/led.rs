//! A law led from outside: targets in the world, followed in the frame of the law's reference.

use super::FlangePose;
use super::arm_state::ArmState;
use super::joint_pace::{JointLimits, JointPace, LED_SHARE, WAITING_SHARE};
use super::law::ControlLaw;
use super::lead::{Lead, Target, ToolTarget, Way};
use super::tick::{ArmTick, seen_from_base};
use crate::error::{ControlError, finite};
use crate::linalg::times;
use crate::model::ArmModel;
use crate::online_trajectory::{Axis, AxisBounds};
use crate::opspace::ArmDynamics;
use crate::reference::{HeldBack, Pose};
use crate::reference_generator::{Goal, Leash, PoseGenerator, ReferenceBounds, TwistAxes, Workspace};
use crate::rotation;
use crate::scalar::{Scalar, of};
use moca_msgs::RobotState;
use nalgebra::{Matrix3, Vector3};

/// Speed of a joint that counts as none, rad/s: a bound of 0 would leave nothing to reach.
const STANDSTILL_RAD_S: f64 = 1e-9;

impl<const N: usize, T: Scalar> ArmState<N, T> {
    /// Leads the law's reference to `target` within `bounds`, and stops it before it leaves `workspace`. It starts from
    /// where the reference is and how fast; a change of law ends it.
    ///
    /// # Errors
    /// A value that is not finite, or a quaternion that is not of length 1; the reference goes on as it did.
    pub fn lead(
        &mut self,
        target: &Target<N, T>,
        robot: &RobotState<N, T>,
        bounds: &ReferenceBounds<T>,
        workspace: Option<&Workspace<T>>,
    ) -> Result<(), ControlError> {
        let way = match target {
            Target::Posture(wanted) => {
                finite("target posture", wanted)?;
                match self.lead {
                    // On the way to another one the base goes on counting as where it stood: the tool's reference does not jump.
                    Some(Lead { way: Way::Posture { axes, target: Some(_), base_pose_world }, .. }) => {
                        Way::Posture { axes, target: Some(*wanted), base_pose_world }
                    }
                    // From where the arm is: what the tool's reference is away from it is given up, and what the torque would
                    // jump by fades.
                    _ => {
                        self.entering = true;
                        let axes = core::array::from_fn(|i| Axis::moving(robot.q_rad[i], robot.dq_rad_s[i]));
                        Way::Posture { axes, target: Some(*wanted), base_pose_world: robot.base_pose_world }
                    }
                }
            }
            Target::Hold => match self.lead {
                None => return Ok(()),
                Some(Lead { way: Way::Posture { axes, base_pose_world, .. }, .. }) => {
                    Way::Posture { axes, target: None, base_pose_world }
                }
                Some(Lead { way: Way::Tool { generator, .. }, .. }) => {
                    Way::Tool { generator, target: ToolTarget::World(Goal::Hold) }
                }
            },
            Target::Pose(FlangePose { position_world, quaternion_world }) => {
                finite("target position", position_world)?;
                let rotation = rotation::from_unit_quaternion(*quaternion_world)?;
                let goal = Goal::Pose { position: Vector3::from(*position_world), rotation };
                Way::Tool { generator: self.generator(), target: ToolTarget::World(goal) }
            }
            Target::Twist { axes, twist } => {
                finite("target twist", twist)?;
                Way::Tool { generator: self.generator(), target: ToolTarget::Twist(*axes, *twist) }
            }
        };
        self.lead = Some(Lead { bounds: *bounds, workspace: workspace.copied(), way, reached: false });
        Ok(())
    }

    /// Returns true if the reference rests at the target to which it was last led.
    pub fn has_reached(&self) -> bool {
        self.lead.as_ref().is_none_or(|lead| lead.reached)
    }

    fn generator(&self) -> PoseGenerator<T> {
        match self.lead {
            Some(Lead { way: Way::Tool { generator, .. }, .. }) => generator,
            _ => PoseGenerator::moving(&self.reference.now, &self.reference.given()),
        }
    }

    /// Returns true if something leads or has led the reference under this law.
    pub(super) const fn has_lead(&self) -> bool {
        self.lead.is_some()
    }

    /// Returns true if the reference is led and moves. One that rests, at its target or short of it, stands like one that
    /// nobody has ever led.
    pub(super) fn is_led(&self) -> bool {
        self.lead.as_ref().is_some_and(|lead| !lead.way.rests())
    }

    /// Moves reference and posture on by one step where something leads them; to rest while joints are too fast.
    ///
    /// # Errors
    /// As for [`JointPace::at`].
    pub(super) fn advance_lead(
        &mut self,
        model: &ArmModel<N, T>,
        tick: &ArmTick<'_, N, T>,
        arm: &ArmDynamics<'_, N, T>,
        limits: JointLimits<'_, N, T>,
    ) -> Result<(), ControlError> {
        let Some(mut lead) = self.lead else { return Ok(()) };
        let speeds = limits.speeds;
        let waits = speeds.share(&tick.robot.q_rad, &tick.robot.dq_rad_s) > of(WAITING_SHARE);
        let frame = Frame { tick, law: self.law };
        let Lead { bounds, workspace, way, reached } = &mut lead;
        match way {
            Way::Tool { generator, target } => {
                let wanted = frame.goal(target, generator.rotation());
                let goal = if waits { Goal::Hold } else { wanted };
                let leash = ToolLeash {
                    frame: &frame,
                    actual: frame.actual(),
                    workspace: workspace.as_ref(),
                    held_back: self.held_back.as_ref(),
                    pace: JointPace::at(arm, &tick.robot.q_rad, &self.gains.stiffness, limits)?,
                };
                generator.step_on_leash(&goal, bounds, &leash, tick.dt_s);
                *reached = generator.has_reached(&wanted);
                let pose = Pose { position: generator.position().into(), rotation: *generator.rotation() };
                self.reference.follow(pose, generator.twist());
            }
            Way::Posture { axes, target, base_pose_world } => {
                let actual = frame.actual();
                let near = (self.reference.now.position - actual.position).norm() < bounds.leash_m
                    && rotation::error(&actual.rotation, &self.reference.now.rotation).norm()
                        < bounds.leash_rad
                    && (0..N).all(|i| (axes[i].position - tick.robot.q_rad[i]).abs() < bounds.leash_rad);
                let step = |axes: &mut [Axis<T>; N], most: &[T; N]| {
                    for (i, axis) in axes.iter_mut().enumerate() {
                        match target.filter(|_| near && !waits) {
                            Some(target) => {
                                let ahead = target[i] - axis.position;
                                let fastest =
                                    of::<T>(LED_SHARE) * speeds.largest(i, tick.robot.q_rad[i], ahead);
                                let velocity = most[i].min(fastest);
                                let bounds = AxisBounds { velocity, ..bounds.joint };
                                axis.step_to_position(ahead, &bounds, tick.dt_s);
                            }
                            None => axis.step_to_velocity(T::zero(), &bounds.joint, tick.dt_s),
                        }
                    }
                };
                let before = *axes;
                step(axes, &[bounds.joint.velocity; N]);
                if let Some(near) = tick.near {
                    let rates = axes.map(|axis| axis.velocity);
                    let times = near.too_fast(&rates);
                    if times > T::one() {
                        *axes = before;
                        step(axes, &rates.map(|rate| (rate.abs() / times).max(of(STANDSTILL_RAD_S))));
                    }
                }
                let q_rad = axes.map(|axis| axis.position);
                *reached = target.is_none_or(|target| (0..N).all(|i| axes[i].rests_at(target[i])))
                    && axes.iter().all(Axis::rests);
                let (pose, twist) =
                    frame.of_posture(model, &q_rad, &axes.map(|axis| axis.velocity), base_pose_world);
                self.reference.follow(pose, twist);
                self.posture_rad = q_rad;
            }
        }
        self.lead = Some(lead);
        Ok(())
    }

    /// Returns true if a posture is led, which the configured one then does not pull at.
    pub(super) fn leads_posture(&self) -> bool {
        matches!(self.lead, Some(Lead { way: Way::Posture { .. }, .. }))
    }

    /// The reference is carried along with its frame.
    pub(super) fn carry_lead(&mut self, shift_m: [T; 2]) {
        match &mut self.lead {
            Some(Lead { way: Way::Tool { generator, .. }, .. }) => generator.carry(shift_m),
            Some(Lead { way: Way::Posture { base_pose_world: [x, y, _], .. }, .. }) => {
                *x += shift_m[0];
                *y += shift_m[1];
            }
            None => {}
        }
    }
}

/// Leash on the reference of a tool that is led.
struct ToolLeash<'a, const N: usize, T> {
    frame: &'a Frame<'a, N, T>,
    actual: Pose<T>,
    workspace: Option<&'a Workspace<T>>,
    held_back: Option<&'a HeldBack<T>>,
    pace: JointPace<'a, N, T>,
}

impl<const N: usize, T: Scalar> ToolLeash<'_, N, T> {
    /// A twist or an error of the reference's frame, in world axes.
    fn world(&self, twist: &[T; 6]) -> [T; 6] {
        if self.frame.is_base() {
            rotation::turned(&self.frame.tick.kinematics.base_rotation, twist)
        } else {
            *twist
        }
    }
}

impl<const N: usize, T: Scalar> Leash<T> for ToolLeash<'_, N, T> {
    fn actual(&self) -> (&Vector3<T>, &Matrix3<T>) {
        (&self.actual.position, &self.actual.rotation)
    }

    fn outside(&self, position: &[T; 3]) -> T {
        self.workspace.map_or(T::zero(), |workspace| workspace.outside(&self.frame.base_from(position)))
    }

    fn slowed(&self, twist: &[T; 6]) -> [T; 6] {
        let [vx, vy, vz, wx, wy, wz] = *twist;
        let v = Vector3::new(vx, vy, vz);
        let v = self.held_back.map_or(v, |held| held.slowed(v));
        [v.x, v.y, v.z, wx, wy, wz]
    }

    fn joints_too_fast(&self, twist: &[T; 6]) -> T {
        let twist = self.world(twist);
        let share = self.pace.share(&twist) / of(LED_SHARE);
        match self.frame.tick.near {
            None => share,
            Some(near) => share.max(near.too_fast(&self.pace.rates(&twist))),
        }
    }

    fn joints_beyond(&self, error: &[T; 6]) -> T {
        (self.pace.share_to_catch_up(&self.world(error)) - of(LED_SHARE)).max(T::zero())
    }
}

/// The frame of a law's reference: B for follow-me, else W.
struct Frame<'a, const N: usize, T> {
    tick: &'a ArmTick<'a, N, T>,
    law: ControlLaw,
}

impl<const N: usize, T: Scalar> Frame<'_, N, T> {
    fn is_base(&self) -> bool {
        self.law == ControlLaw::FollowMe
    }

    /// The tool.
    fn actual(&self) -> Pose<T> {
        if self.is_base() {
            seen_from_base(&self.tick.flange, self.tick.kinematics, self.tick.robot)
        } else {
            self.tick.flange
        }
    }

    /// A place of this frame, in B.
    fn base_from(&self, position: &[T; 3]) -> [T; 3] {
        if self.is_base() {
            return *position;
        }
        let [x, y, _] = self.tick.robot.base_pose_world;
        let from_base = Vector3::from(*position) - Vector3::new(x, y, T::zero());
        (self.tick.kinematics.base_rotation.transpose() * from_base).into()
    }

    /// `target` in this frame, for a reference with these axes.
    fn goal(&self, target: &ToolTarget<T>, rotation: &Matrix3<T>) -> Goal<T> {
        match *target {
            ToolTarget::World(Goal::Pose { position, rotation }) if self.is_base() => {
                let pose = Pose { position, rotation };
                let Pose { position, rotation } =
                    seen_from_base(&pose, self.tick.kinematics, self.tick.robot);
                Goal::Pose { position, rotation }
            }
            ToolTarget::World(goal) => goal,
            ToolTarget::Twist(axes, twist) => {
                let base = &self.tick.kinematics.base_rotation;
                Goal::Twist(match (axes, self.is_base()) {
                    (TwistAxes::World, true) => rotation::turned(&base.transpose(), &twist),
                    (TwistAxes::Base, false) => rotation::turned(base, &twist),
                    (TwistAxes::Flange, _) => rotation::turned(rotation, &twist),
                    (TwistAxes::World, false) | (TwistAxes::Base, true) => twist,
                })
            }
        }
    }

    /// The tool of a posture and its twist: on the base, or in W on the base as it stood at `base_pose_world`.
    fn of_posture(
        &self,
        model: &ArmModel<N, T>,
        q_rad: &[T; N],
        dq_rad_s: &[T; N],
        base_pose_world: &[T; 3],
    ) -> (Pose<T>, [T; 6]) {
        let [x, y, yaw] = if self.is_base() { [T::zero(); 3] } else { *base_pose_world };
        let kinematics = model.kinematics(yaw, q_rad);
        let position = kinematics.tool_from_base() + Vector3::new(x, y, T::zero());
        let pose = Pose { position, rotation: kinematics.tool_rotation };
        (pose, times(kinematics.arm_jacobian(), dq_rad_s))
    }
}

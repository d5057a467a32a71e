//! An arm: Cartesian impedance of its tool on the base it stands on.

use super::arm_state::ArmState;
use super::joint_pace::{HELD_SHARE, JointLimits, LED_SHARE, braking_torque};
use super::law::ControlLaw;
use super::lead::Target;
use super::tick::{ArmTick, HeldObject, Tracking, seen_from_base, tool_pose};
use super::{CARRY_FADE_S, FlangePose, LONGEST_STEP_S, check};
use crate::error::{ControlError, finite};
use crate::gains::ArmGains;
use crate::impedance;
use crate::joint_stiffness;
use crate::limits::{Exceeded, FlangeLimits, JointRepulsion, JointSpeeds, LimitsHit, TorqueLimits};
use crate::model::{ArmModel, Dynamics};
use crate::momentum_observer::MomentumObserver;
use crate::opspace::ArmDynamics;
use crate::reference::{Reference, approach_posture};
use crate::rotation;
use crate::scalar::{Scalar, of};
use crate::self_collision::{SelfCollision, Separation};
use crate::state_check::{check_robot, check_step, check_wrench};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{ArmTable, Mount, ParameterError, Parameters, Payload, RobotState};
use nalgebra::Vector3;

/// Share of its largest speed at which a joint of an arm whose tool stands ends the law near a singularity, share of the largest
/// pose error that does, and the mobility ([`ArmDynamics::mobility_left`]) below which they count. Stopping from there no joint
/// passes a third of its speed. Up to that mobility, a joint that swings through a straight elbow doubles its speed within 15 ms.
/// Of an arm on its way to a target only a speed counts, the one to which it is held ([`HELD_SHARE`]).
const STRETCHED_SHARE: f64 = 0.1;
const STRETCHED_ERROR: f64 = 0.5;
const STRETCHED_MOBILITY: f64 = 0.03;

/// Cartesian impedance of an arm of `N` joints, eqs. (10), (11), (15), (16): the tool keeps its place on the base,
/// standing or moving, and gives way to a hand as a spring.
///
/// ```
/// use moca_wbc::robot::{MOCA_MOUNT, UR10E};
/// use moca_wbc::{ArmController, ArmInput, LimitsHit, Parameters, Payload, RobotState};
///
/// let parameters = Parameters::for_arm(&UR10E);
/// let controller: ArmController<6> = ArmController::new(&UR10E, &MOCA_MOUNT, &Payload::NONE, &parameters)?;
/// let robot = RobotState::at_rest(UR10E.home_rad);
/// let mut state = controller.enter(&robot)?;
/// let output = controller.step(&mut state, &ArmInput { robot, flange_wrench_world: None, dt_s: 1e-3 })?;
/// assert_eq!(output.limits, LimitsHit::NONE);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct ArmController<const N: usize, T = f64> {
    model: ArmModel<N, T>,
    pub(super) gains: ArmGains<N, T>,
    posture_rad: [f64; N],
    pub(super) limits: TorqueLimits<N, T>,
    joint_speeds: JointSpeeds<N, T>,
    flange_limits: FlangeLimits<T>,
    repulsion: JointRepulsion<N, T>,
    /// Joint stiffness with which a posture is held where inertia and period allow it, N·m/rad.
    hold_stiffness: [T; N],
    period_s: T,
    /// Guard against self-collision; without one no bit of a command changes.
    self_collision: Option<SelfCollision<N, T>>,
    /// Object in the model that the arm's own controller does not know of.
    object: Option<HeldObject<T>>,
}

/// One step's measurements of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmInput<const N: usize, T = f64> {
    /// State of the arm and of the base it stands on.
    pub robot: RobotState<N, T>,
    /// As in [`super::ControlInput`].
    pub flange_wrench_world: Option<[T; 6]>,
    /// Time since the last step, s, > 0.
    pub dt_s: T,
}

/// One step's result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmOutput<const N: usize, T = f64> {
    /// Joint torques including gravity compensation, N·m, inside every limit.
    pub torque_nm: [T; N],
    /// Share of gravity in them, N·m, without that of an object which is held ([`ArmController::carrying`]).
    pub gravity_nm: [T; N],
    /// External wrench: on the robot about the flange origin, world axes \[N; N·m\].
    pub flange_wrench_world: [T; 6],
    /// Pose of the controlled frame E (flange, or tool if one is set).
    pub flange: FlangePose<T>,
    /// Desired pose of it.
    pub flange_desired: FlangePose<T>,
    /// Limits that were met.
    pub limits: LimitsHit,
    /// A motion that the law must not go on with; the posture is held in this step, and should be from now on.
    pub exceeded: Option<Exceeded>,
}

impl<const N: usize, T: Scalar> ArmController<N, T> {
    /// Builds the controller. Of the parameters only the arm's are used: impedance, posture, torque limits.
    ///
    /// # Errors
    /// The first number of the tables or of the parameters that is not finite or out of range.
    pub fn new(
        arm: &ArmTable<N>,
        mount: &Mount,
        payload: &Payload,
        parameters: &Parameters<N>,
    ) -> Result<Self, ParameterError> {
        check(parameters)?;
        Ok(Self {
            model: ArmModel::new(arm, mount, payload)?,
            gains: ArmGains::from(&parameters.gains),
            posture_rad: parameters.gains.posture_rad,
            limits: TorqueLimits::from(&parameters.limits),
            joint_speeds: JointSpeeds::new(arm),
            flange_limits: FlangeLimits::from(&parameters.limits),
            repulsion: JointRepulsion::new(arm),
            hold_stiffness: arm.torque_max_nm.map(|most| of(2.0 * most)),
            period_s: of(parameters.limits.period_s),
            self_collision: None,
            object: None,
        })
    }

    /// Returns the controller of the same arm with `object` in its hand, beside tool and load; one without mass is none. The laws
    /// carry it from the next step on; [`ArmState::change_model`] tells a state of it. The arm's own controller knows nothing of it, so
    /// [`ArmOutput::gravity_nm`] is without it.
    ///
    /// # Errors
    /// As for [`Self::new`], of which the tables are.
    pub fn carrying(
        &self,
        arm: &ArmTable<N>,
        mount: &Mount,
        payload: &Payload,
        object: &LinkInertial,
    ) -> Result<Self, ParameterError> {
        Ok(Self {
            model: ArmModel::new(arm, mount, &payload.with(object))?,
            object: HeldObject::new(object, payload),
            ..*self
        })
    }

    /// Returns the controller with a guard that keeps the arm from itself, from the base and from the floor.
    #[must_use]
    pub fn with_self_collision(self, guard: SelfCollision<N, T>) -> Self {
        Self { self_collision: Some(guard), ..self }
    }

    /// Returns the two parts that come too near to each other where `target` leads an arm from where it is; `None` if it leads
    /// nowhere near, if the target is a twist, or without a guard. Of a pose the posture is predicted, and `None` is the answer too if
    /// no posture was found.
    pub fn too_near_at(&self, target: &Target<N, T>, robot: &RobotState<N, T>) -> Option<Separation<N, T>> {
        let guard = self.self_collision.as_ref()?;
        let [x, y, yaw] = robot.base_pose_world;
        let q_rad = match target {
            Target::Hold | Target::Twist { .. } => return None,
            Target::Posture(q_rad) => *q_rad,
            Target::Pose(FlangePose { position_world, quaternion_world }) => {
                let from_base = Vector3::from(*position_world) - Vector3::new(x, y, T::zero());
                let at = self.model.kinematics(yaw, &robot.q_rad).arm_from_base;
                let rotation = rotation::from_unit_quaternion(*quaternion_world).ok()?;
                let posture = self.posture_rad.map(of);
                guard.predicted(&self.model, yaw, (&robot.q_rad, &posture), (&(from_base - at), &rotation))?
            }
        };
        let nearest = guard.nearest(&self.model.kinematics(yaw, &q_rad))?;
        (nearest.distance < guard.least()).then_some(nearest)
    }

    /// Returns the smallest distance that the guard against self-collision allows, m; `None` without one.
    pub fn smallest_distance(&self) -> Option<T> {
        self.self_collision.as_ref().map(SelfCollision::least)
    }

    /// Returns the controller with other parameters for the same state. Gains reach the law through a first-order filter, the
    /// posture at its own speed; limits hold from the next step on.
    ///
    /// # Errors
    /// The first parameter out of range.
    pub fn with_parameters(&self, parameters: &Parameters<N>) -> Result<Self, ParameterError> {
        check(parameters)?;
        Ok(Self {
            gains: ArmGains::from(&parameters.gains),
            posture_rad: parameters.gains.posture_rad,
            limits: TorqueLimits::from(&parameters.limits),
            flange_limits: FlangeLimits::from(&parameters.limits),
            period_s: of(parameters.limits.period_s),
            ..*self
        })
    }

    /// The arm's model.
    pub fn model(&self) -> &ArmModel<N, T> {
        &self.model
    }

    /// State for an arm that stands still: the target is where it is, the last torque is C q̇ + g.
    ///
    /// # Errors
    /// A value of `robot` that is not finite.
    pub fn enter(&self, robot: &RobotState<N, T>) -> Result<ArmState<N, T>, ControlError> {
        self.entered(ControlLaw::FollowMe, robot)
    }

    /// One step: the tool keeps its place on the base.
    ///
    /// # Errors
    /// An input or a result that is not finite, a step that is not positive. `state` is then as it was.
    pub fn step(
        &self,
        state: &mut ArmState<N, T>,
        input: &ArmInput<N, T>,
    ) -> Result<ArmOutput<N, T>, ControlError> {
        self.run(ControlLaw::FollowMe, state, input)
    }

    /// One step in which the joints hold the posture that they had when it was first asked for.
    ///
    /// # Errors
    /// As for [`Self::step`].
    pub fn hold(
        &self,
        state: &mut ArmState<N, T>,
        input: &ArmInput<N, T>,
    ) -> Result<ArmOutput<N, T>, ControlError> {
        self.run(ControlLaw::Hold, state, input)
    }

    fn run(
        &self,
        law: ControlLaw,
        state: &mut ArmState<N, T>,
        input: &ArmInput<N, T>,
    ) -> Result<ArmOutput<N, T>, ControlError> {
        check_step(input.dt_s)?;
        check_robot(&input.robot)?;
        check_wrench("flange_wrench_world", input.flange_wrench_world.as_ref())?;
        let before = state.kept();
        let next = &mut *state;
        let mut hit = LimitsHit::default();
        let output = self.at(&input.robot, input.dt_s, |tick| {
            next.enter_law(law, tick);
            next.gains.approach(&self.gains, tick.dt_s);
            let measured = input.flange_wrench_world;
            let mut arm = tick.task(law);
            if let Some(arm) = &mut arm {
                arm.factorise()?;
            }
            let arm = arm.as_ref();
            let flange_wrench_world = tick.flange_wrench(next, measured, arm)?;
            let (wanted, tracking) = match arm {
                None => (self.holding(tick, next), None),
                Some(arm) => {
                    let (torque, tracking) = self.on_the_base(tick, next, arm, &mut hit)?;
                    (torque, Some(tracking))
                }
            };
            let torque_nm = self.limited(tick, arm, next, &wanted, &[T::zero(); N], &mut hit)?;
            Ok(ArmOutput {
                torque_nm,
                gravity_nm: tick.gravity_without_object(),
                flange_wrench_world,
                flange: (&tick.flange).into(),
                flange_desired: (&tick.desired(next)).into(),
                limits: hit,
                exceeded: self.exceeded(tick, arm.zip(tracking.as_ref()), !next.has_lead()),
            })
        });
        match &output {
            Ok(ArmOutput { exceeded: None, .. }) => output,
            Ok(ArmOutput { exceeded, .. }) => {
                *state = before;
                let mut holding = before;
                holding.hold_at_once(&input.robot);
                let held = self.run(ControlLaw::Hold, &mut holding, input)?;
                *state = holding;
                Ok(ArmOutput { exceeded: *exceeded, ..held })
            }
            Err(_) => {
                *state = before;
                output
            }
        }
    }

    /// `law` with what is computed once a step and read by every law.
    #[inline]
    pub(super) fn at<R>(
        &self,
        robot: &RobotState<N, T>,
        dt_s: T,
        law: impl FnOnce(&ArmTick<'_, N, T>) -> R,
    ) -> R {
        let mut dynamics = Dynamics::unset();
        self.model.dynamics_at(robot.base_pose_world[2], &robot.q_rad, &robot.dq_rad_s, &mut dynamics);
        // 2 kB that are neither written nor copied without a guard
        let guarded;
        let near = match &self.self_collision {
            None => None,
            Some(guard) => {
                guarded = guard.near(&dynamics.kinematics, &dynamics.mass);
                guarded.as_ref()
            }
        };
        law(&ArmTick {
            robot,
            dt_s: dt_s.min(of(LONGEST_STEP_S)),
            model: &self.model,
            kinematics: &dynamics.kinematics,
            dynamics: &dynamics,
            flange: tool_pose(&dynamics.kinematics, robot),
            near,
            object: self.object.as_ref(),
            period_s: self.period_s,
        })
    }

    pub(super) fn entered(
        &self,
        law: ControlLaw,
        robot: &RobotState<N, T>,
    ) -> Result<ArmState<N, T>, ControlError> {
        check_robot(robot)?;
        self.at(robot, of(LONGEST_STEP_S), |tick| {
            let mut state = ArmState {
                law,
                reference: Reference::hold(tick.flange),
                posture_rad: robot.q_rad,
                gains: self.gains,
                torque_nm: tick.dynamics.bias,
                carried_nm: [T::zero(); N],
                entering: true,
                held_back: None,
                observer: MomentumObserver::new(),
                lead: None,
            };
            state.retarget(tick);
            finite("entry torque", &state.torque_nm)?;
            Ok(state)
        })
    }

    /// Joint torques that hold the posture, N·m, as stiff as the torque limits ask for and [`joint_stiffness`] allows.
    pub(super) fn holding(&self, tick: &ArmTick<'_, N, T>, state: &ArmState<N, T>) -> [T; N] {
        let mass = &tick.dynamics.mass;
        let most = joint_stiffness::largest(mass, self.period_s);
        let stiffness = core::array::from_fn(|i| self.hold_stiffness[i].min(most[i]));
        let damping = core::array::from_fn(|i| joint_stiffness::damping(stiffness[i], mass[(i, i)]));
        let posture = impedance::posture_torque(
            &stiffness,
            &damping,
            &state.posture_rad,
            &tick.robot.q_rad,
            &tick.robot.dq_rad_s,
        );
        core::array::from_fn(|i| posture[i] + tick.dynamics.bias[i])
    }

    /// Moves reference and posture on by one step.
    #[inline]
    pub(super) fn advance(
        &self,
        tick: &ArmTick<'_, N, T>,
        arm: &ArmDynamics<'_, N, T>,
        state: &mut ArmState<N, T>,
    ) -> Result<(), ControlError> {
        if state.has_lead() {
            state.advance_lead(&self.model, tick, arm, self.joint_limits())?;
            if !state.leads_posture() {
                approach_posture(&mut state.posture_rad, &self.posture_rad, tick.dt_s);
            }
            self.keep_posture_near(tick, state);
            return Ok(());
        }
        let actual = match state.law {
            ControlLaw::FollowMe => seen_from_base(&tick.flange, tick.kinematics, tick.robot),
            ControlLaw::Hold | ControlLaw::Impedance => tick.flange,
        };
        state.reference.advance(&actual, state.held_back.as_ref(), tick.dt_s);
        approach_posture(&mut state.posture_rad, &self.posture_rad, tick.dt_s);
        Ok(())
    }

    pub(super) const fn joint_limits(&self) -> JointLimits<'_, N, T> {
        JointLimits { speeds: &self.joint_speeds, repulsion: &self.repulsion }
    }

    /// Keeps the posture so near that the null space goes there no faster than joints are led: at K_0·e/D_0.
    fn keep_posture_near(&self, tick: &ArmTick<'_, N, T>, state: &mut ArmState<N, T>) {
        let gains = &state.gains;
        for i in 0..N {
            let q = tick.robot.q_rad[i];
            let error = state.posture_rad[i] - q;
            let fastest = of::<T>(LED_SHARE) * self.joint_speeds.largest(i, q, error);
            let (stiffness, damping) = (gains.posture_stiffness[i], gains.posture_damping[i]);
            if stiffness * error.abs() > damping * fastest {
                state.posture_rad[i] = q + (damping * fastest / stiffness).copysign(error);
            }
        }
    }

    /// Joint torques that keep the tool on the base, N·m, and what they were computed from. eqs. (15), (16)
    #[inline]
    pub(super) fn on_the_base(
        &self,
        tick: &ArmTick<'_, N, T>,
        state: &mut ArmState<N, T>,
        arm: &ArmDynamics<'_, N, T>,
        hit: &mut LimitsHit,
    ) -> Result<([T; N], Tracking<T>), ControlError> {
        self.advance(tick, arm, state)?;
        let mut inverse_task_inertia = *arm.inverse_task_inertia();
        let (wrench, tracking) = tick.task_wrench(state, &[T::zero(); 6], &mut inverse_task_inertia, hit)?;
        let torque = arm.torque(&wrench, &tick.posture_torque(state))?;
        Ok((core::array::from_fn(|i| torque[i] + tick.dynamics.bias[i]), tracking))
    }

    /// Why a law must not go on; one that tracks no pose may.
    pub(super) fn exceeded(
        &self,
        tick: &ArmTick<'_, N, T>,
        tracked: Option<(&ArmDynamics<'_, N, T>, &Tracking<T>)>,
        arrived: bool,
    ) -> Option<Exceeded> {
        let (arm, Tracking { error, arm_twist }) = tracked?;
        let robot = tick.robot;
        let (joint, share) = self.joint_speeds.fastest(&robot.q_rad, &robot.dq_rad_s);
        if share > T::one()
            && let Some(joint) = self.joint_speeds.exceeded(&robot.q_rad, &robot.dq_rad_s)
        {
            return Some(Exceeded::JointSpeed(joint));
        }
        let fast = share > of(if arrived { STRETCHED_SHARE } else { HELD_SHARE });
        let far = arrived && self.flange_limits.share(error) > of(STRETCHED_ERROR);
        if (fast || far) && arm.mobility_left() < of(STRETCHED_MOBILITY) {
            return Some(Exceeded::Stretched(joint));
        }
        let base = tick.kinematics.twist_from_base(&robot.base_velocity_world);
        let [vx, vy, vz] = core::array::from_fn(|i| base[i] + arm_twist[i]);
        let speed_m_s = (vx * vx + vy * vy + vz * vz).sqrt();
        self.flange_limits.exceeded(speed_m_s, error)
    }

    /// `wanted` inside every limit of the arm, and the state that goes with it. `coupling` of it only carries the arm along
    /// with its base. `None` for `arm` is a law without a task, under which nothing leads.
    #[inline]
    pub(super) fn limited(
        &self,
        tick: &ArmTick<'_, N, T>,
        arm: Option<&ArmDynamics<'_, N, T>>,
        state: &mut ArmState<N, T>,
        wanted: &[T; N],
        coupling: &[T; N],
        hit: &mut LimitsHit,
    ) -> Result<[T; N], ControlError> {
        let (robot, mass) = (tick.robot, &tick.dynamics.mass);
        let mut repulsion = self.repulsion.torque(&robot.q_rad, &robot.dq_rad_s, mass, self.period_s);
        hit.joint_range = repulsion.iter().any(|torque| *torque != T::zero());
        if let Some(near) = tick.near {
            let apart = near.repulsion(&robot.dq_rad_s, self.period_s);
            repulsion = core::array::from_fn(|i| repulsion[i] + apart[i]);
        }
        if state.entering {
            state.entering = false;
            state.carried_nm = core::array::from_fn(|i| state.torque_nm[i] - wanted[i] - repulsion[i]);
        }
        let total = core::array::from_fn(|i| wanted[i] + state.carried_nm[i] + repulsion[i]);
        let mut torque = self.limits.limited(&total, &state.torque_nm, tick.dt_s, hit);
        if let (true, Some(arm)) = (state.has_lead(), arm) {
            // What brakes answers what this step can give, not what the law would have: torques change only so fast.
            let moving = core::array::from_fn(|i| torque[i] - coupling[i]);
            let braking = braking_torque(tick, arm, self.joint_limits(), &moving);
            let braked = core::array::from_fn(|i| torque[i] + braking[i]);
            torque = self.limits.limited(&braked, &state.torque_nm, tick.dt_s, hit);
        }
        if let Some(near) = tick.near {
            let bias = &tick.dynamics.bias;
            let moving = core::array::from_fn(|i| torque[i] - coupling[i] - bias[i]);
            let braking = near.braking(&robot.dq_rad_s, &moving, tick.dt_s);
            let braked = core::array::from_fn(|i| torque[i] + braking[i]);
            torque = self.limits.limited(&braked, &state.torque_nm, tick.dt_s, hit);
        }
        state.send(torque, tick.dt_s)
    }
}

impl<const N: usize, T: Scalar> ArmState<N, T> {
    /// Remembers a torque that keeps its limits as the last one, and lets what was carried over fade.
    #[inline]
    fn send(&mut self, torque_nm: [T; N], dt_s: T) -> Result<[T; N], ControlError> {
        self.torque_nm = torque_nm;
        let fade = (-dt_s / of(CARRY_FADE_S)).exp();
        self.carried_nm = self.carried_nm.map(|carried| carried * fade);
        finite("torque command", &self.torque_nm)?;
        Ok(self.torque_nm)
    }

    /// Wants the controlled frame at `position` m with axes `quaternion` (x, y, z, w), in B. The reference travels there
    /// at [`crate::reference::REFERENCE_SPEED_M_S`] and [`crate::reference::REFERENCE_SPEED_RAD_S`].
    ///
    /// # Errors
    /// A value that is not finite, or a quaternion that is not of length 1.
    pub fn set_target_pose(&mut self, position: [T; 3], quaternion: [T; 4]) -> Result<(), ControlError> {
        self.lead = None;
        self.reference.set_pose(position, quaternion)
    }

    /// Moves the target with `twist` \[m/s; rad/s\], axes of B, until told otherwise; it waits while the controlled
    /// frame is [`crate::reference::ERROR_SATURATION_M`] behind. A faster twist than the reference's speeds is slowed
    /// to them.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [T; 6]) -> Result<(), ControlError> {
        self.lead = None;
        self.reference.set_twist(twist)
    }

    /// Estimated external joint torques of the momentum observer, N·m, on the robot.
    pub fn external_torque_nm(&self) -> &[T; N] {
        self.observer.external_torque()
    }

    /// Goes on with a controller of other masses ([`ArmController::carrying`]): the change is no push.
    pub const fn change_model(&mut self) {
        self.observer.change_model();
    }

    /// Starts `law` from the measured state if it is another one than before.
    pub(super) fn enter_law(&mut self, law: ControlLaw, tick: &ArmTick<'_, N, T>) {
        if self.law != law {
            self.law = law;
            self.entering = true;
            self.held_back = None;
            self.retarget(tick);
        }
    }

    /// Makes the measured state the target.
    fn retarget(&mut self, tick: &ArmTick<'_, N, T>) {
        self.lead = None;
        self.posture_rad = tick.robot.q_rad;
        self.reference = Reference::hold(match self.law {
            ControlLaw::FollowMe => seen_from_base(&tick.flange, tick.kinematics, tick.robot),
            ControlLaw::Hold | ControlLaw::Impedance => tick.flange,
        });
    }
}

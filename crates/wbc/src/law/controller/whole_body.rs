//! Base and arm as one robot: the laws of the paper.

use super::arm::ArmController;
use super::arm_state::ArmState;
use super::base::{BaseController, BaseState};
use super::followed::followed;
use super::law::ControlLaw;
use super::lead::Target;
use super::tick::{ArmTick, Tracking};
use super::{FlangePose, LIGHTEST_DAMPED_BASE, check};
use crate::admittance::{admitted, damped_in_null_space};
use crate::error::{ControlError, finite};
use crate::follow_me;
use crate::gains;
use crate::guard::{BaseGuard, CoverOutline};
use crate::limits::{Exceeded, LimitsHit};
use crate::linalg::times;
use crate::model::ArmModel;
use crate::opspace::{ArmDynamics, BlockWeight, TaskDynamics, WholeBodyForce};
use crate::reference::HeldBack;
use crate::reference_generator::{ReferenceBounds, Workspace};
use crate::scalar::{Scalar, of};
use crate::self_collision::{SelfCollision, Separation};
use crate::state_check::{check_robot, check_step, check_wrench};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{
    ArmTable, Corrections, Mount, ParameterError, Parameters, Payload, RobotCommand, RobotState,
    TaxelPlacement,
};

/// One step's measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlInput<const N: usize, const K: usize, T = f64> {
    /// State of base and arm.
    pub robot: RobotState<N, T>,
    /// Compression force of each taxel, N, T1 first; what is beyond the last taxel is not looked at.
    pub taxel_force_n: [T; K],
    /// Wrench on the robot about the flange origin, world axes \[N; N·m\]. `None` takes the robot's own estimate, and
    /// where there is none the momentum observer's.
    pub flange_wrench_world: Option<[T; 6]>,
    /// Guard of the people around the base in this step. [`ControlLaw::Hold`] brakes; of a guard it only keeps
    /// [`BaseGuard::outward_m_s`], so that it may still make room.
    pub guard: BaseGuard<K, T>,
    /// Time since the last step, s, > 0.
    pub dt_s: T,
}

impl<const N: usize, const K: usize, T: Scalar> ControlInput<N, K, T> {
    /// Without a guard, and with the robot's own estimate of the flange wrench or the observer's.
    pub const fn new(robot: RobotState<N, T>, taxel_force_n: [T; K], dt_s: T) -> Self {
        Self { robot, taxel_force_n, flange_wrench_world: None, guard: BaseGuard::NONE, dt_s }
    }
}

/// One step's result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlOutput<const N: usize, T = f64> {
    /// Inside every limit.
    pub command: RobotCommand<N, T>,
    /// Cover wrench, eq. (4): \[N, N, N·m\] in B about its origin.
    pub cover_wrench_base: [T; 3],
    /// The external wrench the law used: on the robot about the flange origin, world axes \[N; N·m\].
    pub flange_wrench_world: [T; 6],
    /// Pose of the controlled frame E (flange, or tool if one is set).
    pub flange: FlangePose<T>,
    /// Desired pose of it.
    pub flange_desired: FlangePose<T>,
    /// Limits that were met.
    pub limits: LimitsHit,
    /// A motion that the law must not go on with; this step was [`ControlLaw::Hold`], and the next ones should be.
    pub exceeded: Option<Exceeded>,
}

/// Everything a [`WholeBodyController`] remembers between steps.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub struct ControllerState<const N: usize, T = f64> {
    pub(super) arm: ArmState<N, T>,
    pub(super) base: BaseState<T>,
    /// η_B and η_A on their way to the configured ones.
    pub(super) eta: [T; 2],
    /// As of the last step: a change is entered like a change of law.
    corrections: Corrections,
}

/// The expanded controllers for an arm of `N` joints on a base with a cover of up to `K` taxels.
///
/// ```
/// use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
/// use moca_wbc::{ControlInput, ControlLaw, Parameters, Payload, RobotState, WholeBodyController};
///
/// let controller: WholeBodyController<7, 11> =
///     WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER)?;
/// let robot = RobotState::at_rest(PANDA.home_rad);
/// let mut state = controller.enter(ControlLaw::Impedance, &robot)?;
/// let mut input = ControlInput::new(robot, [0.0; 11], 1e-3);
/// input.taxel_force_n[5] = 20.0; // a hand on T6, in front
/// let output = controller.step(ControlLaw::Impedance, &mut state, &input)?;
/// assert!(output.command.base_velocity_body[0] < 0.0, "the base gives way backwards");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct WholeBodyController<const N: usize, const K: usize, T = f64> {
    pub(super) arm: ArmController<N, T>,
    pub(super) base: BaseController<K, T>,
    /// η_B and η_A of eq. (9).
    eta: [T; 2],
    pub(super) corrections: Corrections,
}

/// Outputs of a law before any limit.
struct Wanted<const N: usize, T> {
    torque: [T; N],
    /// World axes.
    base_velocity: [T; 3],
    /// Acceleration of the base that the arm's torque counts on per change of its velocity in this step, 1/s, world
    /// axes; `None` where it counts on none.
    counted_on: Option<[T; 3]>,
    /// `None` where no pose is tracked.
    tracking: Option<Tracking<T>>,
}

/// One step's quantities of base and arm.
struct Step<'a, const N: usize, T> {
    tick: &'a ArmTick<'a, N, T>,
    cover_world: [T; 3],
    flange_wrench: [T; 6],
    /// v_d of eq. (2), world axes.
    base_velocity: [T; 3],
}

impl<const N: usize, const K: usize, T: Scalar> WholeBodyController<N, K, T> {
    /// # Errors
    /// The first number of the tables or of the parameters that is not finite or out of range.
    pub fn new(
        arm: &ArmTable<N>,
        mount: &Mount,
        payload: &Payload,
        taxels: &[TaxelPlacement],
        parameters: &Parameters<N>,
    ) -> Result<Self, ParameterError> {
        check(parameters)?;
        check_light_base(parameters)?;
        Ok(Self {
            arm: ArmController::new(arm, mount, payload, parameters)?,
            base: BaseController::new(taxels, parameters)?,
            eta: eta(parameters),
            corrections: parameters.corrections,
        })
    }

    /// As [`ArmController::carrying`].
    ///
    /// # Errors
    /// As for [`ArmController::carrying`].
    pub fn carrying(
        &self,
        arm: &ArmTable<N>,
        mount: &Mount,
        payload: &Payload,
        object: &LinkInertial,
    ) -> Result<Self, ParameterError> {
        Ok(Self { arm: self.arm.carrying(arm, mount, payload, object)?, ..*self })
    }

    /// As [`ArmController::with_self_collision`].
    #[must_use]
    pub fn with_self_collision(self, guard: SelfCollision<N, T>) -> Self {
        Self { arm: self.arm.with_self_collision(guard), ..self }
    }

    /// As [`ArmController::too_near_at`].
    pub fn too_near_at(&self, target: &Target<N, T>, robot: &RobotState<N, T>) -> Option<Separation<N, T>> {
        self.arm.too_near_at(target, robot)
    }

    /// As [`ArmController::smallest_distance`].
    pub fn smallest_distance(&self) -> Option<T> {
        self.arm.smallest_distance()
    }

    /// Returns the controller with other parameters for the same state. Gains reach the law through a first-order filter, the
    /// posture at its own speed, corrections at the next step with a fading torque jump, limits at the
    /// next step.
    ///
    /// # Errors
    /// The first parameter out of range.
    pub fn with_parameters(&self, parameters: &Parameters<N>) -> Result<Self, ParameterError> {
        check_light_base(parameters)?;
        Ok(Self {
            arm: self.arm.with_parameters(parameters)?,
            base: self.base.with_parameters(parameters)?,
            eta: eta(parameters),
            corrections: parameters.corrections,
        })
    }

    /// The cover's geometry, to say what a guard has to.
    pub fn outline(&self) -> &CoverOutline<K, T> {
        self.base.outline()
    }

    /// The arm's model.
    pub fn model(&self) -> &ArmModel<N, T> {
        self.arm.model()
    }

    /// State for a robot that stands still: targets are where it is, v_d = 0, the last torque is C q̇ + g. A moving
    /// robot changes its law by [`WholeBodyController::step`] instead.
    ///
    /// # Errors
    /// A value of `robot` that is not finite.
    pub fn enter(
        &self,
        law: impl Into<ControlLaw>,
        robot: &RobotState<N, T>,
    ) -> Result<ControllerState<N, T>, ControlError> {
        Ok(ControllerState {
            arm: self.arm.entered(law.into(), robot)?,
            base: self.base.enter(),
            eta: self.eta,
            corrections: self.corrections,
        })
    }

    /// One control step. Another law than the last step's starts from the measured state; base velocity and torque go
    /// on from where they were, and what the torque would have jumped by fades.
    ///
    /// # Errors
    /// An input or a result that is not finite, a step that is not positive. `state` is then as it was.
    pub fn step(
        &self,
        law: ControlLaw,
        state: &mut ControllerState<N, T>,
        input: &ControlInput<N, K, T>,
    ) -> Result<ControlOutput<N, T>, ControlError> {
        check_step(input.dt_s)?;
        check_robot(&input.robot)?;
        self.base.check_cover(&input.taxel_force_n, &input.guard)?;
        check_wrench("flange_wrench_world", input.flange_wrench_world.as_ref())?;
        let mut hit = LimitsHit::default();
        let cover_wrench_base = self.base.cover_wrench(&input.taxel_force_n, &mut hit);
        let before = ControllerState { arm: state.arm.kept(), ..*state };
        let next = &mut *state;
        let output = self.arm.at(&input.robot, input.dt_s, |tick| {
            if law != ControlLaw::FollowMe {
                next.base.lead = None;
            }
            next.arm.enter_law(law, tick);
            self.approach(next, tick.dt_s);
            let mut arm = tick.task(law);
            if let Some(arm) = &mut arm {
                arm.factorise()?;
            }
            let arm = arm.as_ref();
            let heading = &tick.kinematics.heading;
            let step = Step {
                tick,
                cover_world: heading.to_world(cover_wrench_base),
                flange_wrench: tick.flange_wrench(&mut next.arm, input.flange_wrench_world, arm)?,
                base_velocity: heading.to_world(next.base.velocity_body),
            };
            let wanted = match arm {
                None => {
                    let torque = self.arm.holding(tick, &next.arm);
                    Wanted { torque, base_velocity: [T::zero(); 3], counted_on: None, tracking: None }
                }
                Some(arm) if law == ControlLaw::Impedance => self.impedance(&step, arm, next, &mut hit)?,
                Some(arm) => self.follow_me(&step, arm, next, &mut hit)?,
            };
            // Only the impedance law bounds its base by what the arm can follow.
            let arrived =
                if law == ControlLaw::Impedance { next.arm.has_reached() } else { !next.arm.has_lead() };
            let command = self.limited(&step, arm, next, &input.guard, &wanted, &mut hit)?;
            Ok(ControlOutput {
                command,
                cover_wrench_base,
                flange_wrench_world: step.flange_wrench,
                flange: (&tick.flange).into(),
                flange_desired: (&tick.desired(&next.arm)).into(),
                limits: hit,
                exceeded: self.arm.exceeded(tick, arm.zip(wanted.tracking.as_ref()), arrived),
            })
        });
        match &output {
            Ok(ControlOutput { exceeded: None, .. }) => output,
            Ok(ControlOutput { exceeded, .. }) => {
                *state = before;
                let mut holding = before;
                holding.arm.hold_at_once(&input.robot);
                let held = self.step(ControlLaw::Hold, &mut holding, input)?;
                *state = holding;
                Ok(ControlOutput { exceeded: *exceeded, ..held })
            }
            Err(_) => {
                *state = before;
                output
            }
        }
    }

    /// Gains on their way to the configured ones, and corrections that have changed.
    fn approach(&self, state: &mut ControllerState<N, T>, dt_s: T) {
        if state.corrections != self.corrections {
            state.corrections = self.corrections;
            state.arm.entering = true;
        }
        state.arm.gains.approach(&self.arm.gains, dt_s);
        state.base.gains.approach(&self.base.gains, dt_s);
        if state.eta != self.eta {
            gains::approach(&mut state.eta, &self.eta, dt_s);
        }
    }

    /// eqs. (2), (6)–(11), with the corrections that are switched on.
    #[inline]
    fn impedance(
        &self,
        step: &Step<'_, N, T>,
        arm: &ArmDynamics<'_, N, T>,
        state: &mut ControllerState<N, T>,
        hit: &mut LimitsHit,
    ) -> Result<Wanted<N, T>, ControlError> {
        let tick = step.tick;
        self.arm.advance(tick, arm, &mut state.arm)?;
        let gains = &state.base.gains;
        let task = TaskDynamics::new(gains.virtual_mass, arm);
        let base = tick.kinematics.twist_from_base(&tick.robot.base_velocity_world);
        let mut inverse_task_inertia = task.inverse_task_inertia();
        let (wrench, tracking) = tick.task_wrench(&state.arm, &base, &mut inverse_task_inertia, hit)?;
        let mut null = WholeBodyForce {
            base: step.cover_world.map(|f| f * gains.reactivity),
            arm: tick.posture_torque(&state.arm),
        };
        let [eta_base, eta_arm] = state.eta;
        let mut weighted = BlockWeight::new(eta_base, eta_arm).of(&task);
        weighted.factorise()?;
        let goal = weighted.goal(&wrench, &null.arm);
        let mut y = weighted.multiplier(&goal, &null.base);
        let base_force = weighted.base_force(&y, &null.base);
        let fed = if self.corrections.flange_wrench_feedforward {
            flange_wrench_on_base_world(step)
        } else {
            [T::zero(); 3]
        };
        let pushed = core::array::from_fn(|i| base_force[i] + fed[i]);
        let mut counted_per_s = [T::one() / tick.dt_s; 3];
        let base_velocity = if self.corrections.null_space_damping {
            let velocity = damped_in_null_space(&weighted, gains, &step.base_velocity, &pushed, tick.dt_s)?;
            for i in 0..3 {
                null.base[i] -= gains.virtual_damping[i] * velocity[i];
            }
            y = weighted.multiplier(&goal, &null.base);
            velocity
        } else {
            let (velocity, mean_shares) = admitted(gains, &step.base_velocity, &pushed, tick.dt_s);
            // eq. (6) knows the acceleration at the step's start, eq. (2) gives its mean
            for i in 0..3 {
                counted_per_s[i] /= mean_shares[i];
            }
            velocity
        };
        let arm_force = weighted.arm_force(&y, &null.arm);
        let torque = core::array::from_fn(|i| arm_force[i] + tick.dynamics.bias[i]);
        Ok(Wanted { torque, base_velocity, counted_on: Some(counted_per_s), tracking: Some(tracking) })
    }

    /// eqs. (2), (12)–(16): the tool keeps its pose on the base, the base follows cover and flange.
    #[inline]
    fn follow_me(
        &self,
        step: &Step<'_, N, T>,
        arm: &ArmDynamics<'_, N, T>,
        state: &mut ControllerState<N, T>,
        hit: &mut LimitsHit,
    ) -> Result<Wanted<N, T>, ControlError> {
        let (torque, tracking) = self.arm.on_the_base(step.tick, &mut state.arm, arm, hit)?;
        let led = flange_wrench_on_base_world(step);
        let reactivity = state.base.gains.reactivity;
        let force = core::array::from_fn(|i| reactivity * (step.cover_world[i] + led[i]));
        let heading = &step.tick.kinematics.heading;
        let base_velocity =
            self.base.admitted(&mut state.base, heading, &step.base_velocity, &force, step.tick.dt_s);
        Ok(Wanted { torque, base_velocity, counted_on: None, tracking: Some(tracking) })
    }

    /// Part of the base velocity `wanted_world` that the arm can follow, axes of B, where the tool is to stand in the world;
    /// `None` for all of it.
    #[inline]
    fn followed(
        &self,
        step: &Step<'_, N, T>,
        arm: Option<&ArmDynamics<'_, N, T>>,
        state: &ControllerState<N, T>,
        wanted_world: &[T; 3],
        hit: &mut LimitsHit,
    ) -> Result<Option<[T; 3]>, ControlError> {
        let tick = step.tick;
        // The law as published knows no such bound: experiments with it stay equal to the bit. A tool that is led goes along with
        // the base: where it leads, a base that stands back would stretch the arm.
        let corrected = self.corrections.null_space_damping || self.corrections.base_coupling;
        let stands = corrected && !state.arm.is_led() && state.law() == ControlLaw::Impedance;
        let Some(arm) = arm.filter(|_| stands) else { return Ok(None) };
        let joints = (self.arm.joint_limits(), &state.arm.posture_rad);
        let followed = followed(tick, arm, joints, (wanted_world, &step.base_velocity))?;
        if followed.is_some() {
            (hit.guard, hit.arm_reach) = (true, true);
        }
        Ok(followed.map(|velocity| tick.kinematics.heading.to_base(velocity)))
    }

    /// The command inside every limit, and the state that goes with it.
    #[inline]
    fn limited(
        &self,
        step: &Step<'_, N, T>,
        arm: Option<&ArmDynamics<'_, N, T>>,
        state: &mut ControllerState<N, T>,
        guard: &BaseGuard<K, T>,
        wanted: &Wanted<N, T>,
        hit: &mut LimitsHit,
    ) -> Result<RobotCommand<N, T>, ControlError> {
        let (tick, heading) = (step.tick, &step.tick.kinematics.heading);
        let moves = state.law() != ControlLaw::Hold;
        let room;
        let guard = if moves {
            guard
        } else {
            room = guard.room();
            &room
        };
        let wanted_body = heading.to_base(wanted.base_velocity);
        let before_body = &state.base.velocity_body;
        let followed_body =
            self.followed(step, arm, state, &wanted.base_velocity, hit)?.unwrap_or(wanted_body);
        let mut base_velocity_body = self.base.limited(guard, &followed_body, before_body, tick.dt_s, hit);
        if base_velocity_body != followed_body {
            // a guard may leave a turn alone whose translation would have spared the arm
            let left_world = heading.to_world(base_velocity_body);
            if let Some(shorter) = self.followed(step, arm, state, &left_world, hit)? {
                base_velocity_body = self.base.limited(guard, &shorter, before_body, tick.dt_s, hit);
            }
        }
        finite("base velocity command", &base_velocity_body)?;
        state.hold_back(step, wanted, &base_velocity_body, hit);
        let mut torque = wanted.torque;
        if let (Some(arm), Some(per_s)) = (arm, wanted.counted_on)
            && wanted_body != base_velocity_body
        {
            let refused = heading.to_world(core::array::from_fn(|i| wanted_body[i] - base_velocity_body[i]));
            let refused = core::array::from_fn(|i| refused[i] * per_s[i]);
            let instead = arm.torque_for_refused(&refused)?;
            torque = core::array::from_fn(|i| torque[i] + instead[i]);
        }
        let mut coupling = [T::zero(); N];
        if self.corrections.base_coupling && moves {
            let commanded = heading.to_world(base_velocity_body);
            let acceleration: [T; 3] =
                core::array::from_fn(|i| (commanded[i] - step.base_velocity[i]) / tick.dt_s);
            coupling = times(&tick.dynamics.base_coupling, &acceleration);
            torque = core::array::from_fn(|i| torque[i] + coupling[i]);
        }
        let arm_torque_nm = self.arm.limited(tick, arm, &mut state.arm, &torque, &coupling, hit)?;
        state.base.velocity_body = base_velocity_body;
        Ok(RobotCommand { base_velocity_body, arm_torque_nm, arm_gravity_nm: tick.gravity_without_object() })
    }
}

impl<const N: usize, T: Scalar> ControllerState<N, T> {
    /// Remembers where a guard refused the base its way.
    #[inline]
    fn hold_back(
        &mut self,
        step: &Step<'_, N, T>,
        wanted: &Wanted<N, T>,
        base_velocity_body: &[T; 3],
        hit: &LimitsHit,
    ) {
        let kinematics = step.tick.kinematics;
        // follow-me's reference stands on the base and is carried along by it
        self.arm.held_back = (hit.guard && self.law() == ControlLaw::Impedance)
            .then(|| {
                let carried = |velocity_world: &[T; 3]| {
                    let [x, y, ..] = kinematics.twist_from_base(velocity_world);
                    [x, y]
                };
                HeldBack::between(
                    carried(&wanted.base_velocity),
                    carried(&kinematics.heading.to_world(*base_velocity_body)),
                )
            })
            .flatten();
    }

    /// The law of the last step.
    pub fn law(&self) -> ControlLaw {
        self.arm.law
    }

    /// Takes the base to have been told this velocity in the last step: axes of B.
    pub(crate) fn set_base_velocity_body(&mut self, velocity_body: [T; 3]) {
        self.base.velocity_body = velocity_body;
    }

    /// As [`ArmState::set_target_pose`]; in W for [`ControlLaw::Impedance`], in B for [`ControlLaw::FollowMe`]. A change
    /// of law forgets the target.
    ///
    /// # Errors
    /// A value that is not finite, or a quaternion that is not of length 1.
    pub fn set_target_pose(&mut self, position: [T; 3], quaternion: [T; 4]) -> Result<(), ControlError> {
        self.arm.set_target_pose(position, quaternion)
    }

    /// As [`ArmState::set_target_twist`]; axes as for [`ControllerState::set_target_pose`].
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [T; 6]) -> Result<(), ControlError> {
        self.arm.set_target_twist(twist)
    }

    /// Takes the target and the way there along at `velocity_m_s`, axes of its frame, in the step of `dt_s` that follows, and
    /// until told otherwise: a tool that the arm cannot hold in its place any further goes with the base, and as fast.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn carry_target(&mut self, velocity_m_s: [T; 2], dt_s: T) -> Result<(), ControlError> {
        finite("velocity of a carried target", &velocity_m_s)?;
        self.arm.reference.carry(velocity_m_s);
        self.arm.carry_lead(velocity_m_s.map(|v| v * dt_s));
        Ok(())
    }

    /// As [`ArmState::lead`].
    ///
    /// # Errors
    /// As there.
    pub fn lead(
        &mut self,
        target: &Target<N, T>,
        robot: &RobotState<N, T>,
        bounds: &ReferenceBounds<T>,
        workspace: Option<&Workspace<T>>,
    ) -> Result<(), ControlError> {
        self.arm.lead(target, robot, bounds, workspace)
    }

    /// As [`ArmState::has_reached`].
    pub fn has_reached(&self) -> bool {
        self.arm.has_reached()
    }

    /// As [`BaseState::lead`], in [`ControlLaw::FollowMe`]: the impedance law's flange stays in W, and no base can be
    /// driven away from it. Another law ends it.
    ///
    /// # Errors
    /// As there.
    pub fn lead_base(&mut self, velocity_body: [T; 3]) -> Result<(), ControlError> {
        self.base.lead(velocity_body)
    }

    /// As [`ArmState::change_model`].
    pub const fn change_model(&mut self) {
        self.arm.change_model();
    }

    /// Estimated external joint torques of the momentum observer, N·m, on the robot.
    pub fn external_torque_nm(&self) -> &[T; N] {
        self.arm.external_torque_nm()
    }
}

/// Returns the part of the flange's wrench that a planar base can follow, world axes. eqs. (12)–(14): the way over the axes of A
/// changes nothing.
fn flange_wrench_on_base_world<const N: usize, T: Scalar>(step: &Step<'_, N, T>) -> [T; 3] {
    let kinematics = step.tick.kinematics;
    let flange_from_base = kinematics.arm_from_base + kinematics.flange_position;
    let [fx, fy, _, _, _, mz] = follow_me::moved(&step.flange_wrench, &flange_from_base);
    [fx, fy, mz]
}

fn eta<const N: usize, T: Scalar>(parameters: &Parameters<N>) -> [T; 2] {
    [parameters.gains.eta_base, parameters.gains.eta_arm].map(of)
}

/// Null-space damping leaves a virtual base without damping of its own: a light one would chatter on the lag of any
/// real base servo (15 ms: below 0.3 kg).
fn check_light_base<const N: usize>(parameters: &Parameters<N>) -> Result<(), ParameterError> {
    let light = parameters.gains.virtual_mass.iter().find(|mass| **mass < LIGHTEST_DAMPED_BASE);
    match light {
        Some(&value) if parameters.corrections.null_space_damping => Err(ParameterError {
            name: "virtual_mass with null_space_damping",
            value,
            unit: "kg, kg, kg·m²",
            min: LIGHTEST_DAMPED_BASE,
            max: 1000.0,
        }),
        _ => Ok(()),
    }
}

//! The controllers as one step function: measurements in, command out.

mod base_alone;

use crate::admittance::{admitted, damped_in_null_space};
use crate::cover::Cover;
use crate::door::{check_input, check_robot};
use crate::error::{ControlError, finite};
use crate::follow_me;
use crate::gains::Gains;
use crate::guard::{BaseGuard, CoverOutline};
use crate::impedance;
use crate::limits::{JointRepulsion, LimitsHit, OutputLimits};
use crate::linalg::times;
use crate::model::{ArmModel, Kinematics};
use crate::observer::MomentumObserver;
use crate::opspace::{BlockWeight, TaskDynamics, WholeBodyForce};
use crate::reference::{Pose, Reference, approach_posture};
use crate::rotation::{self, Heading};
use crate::scalar::{Scalar, of};
use crate::state::{ControlInput, ControlLaw, ControlOutput, ControllerState, FlangePose};
use crate::tick::{Tick, flange_pose, seen_from_base};
use moca_msgs::{
    ArmTable, Corrections, Mount, ParameterError, Parameters, Payload, RobotCommand, RobotState,
    TaxelPlacement,
};
use nalgebra::Vector3;

/// Longest step that is integrated, s: after a longer gap old forces are not made up for.
pub const LONGEST_STEP_S: f64 = 0.01;
/// Time constant with which the torque carried over a change of law fades, s.
pub const CARRY_FADE_S: f64 = 0.2;
/// Least virtual mass, kg or kg·m², with [`Corrections::null_space_damping`].
pub const LIGHTEST_DAMPED_BASE: f64 = 0.5;

/// Constant configuration of the controllers for an arm of `N` joints and a cover of `K` taxels.
#[derive(Clone, Copy, Debug)]
pub struct Controller<const N: usize, const K: usize, T = f64> {
    model: ArmModel<N, T>,
    cover: Cover<K, T>,
    outline: CoverOutline<K, T>,
    guard: BaseGuard<K, T>,
    gains: Gains<N, T>,
    posture_rad: [f64; N],
    corrections: Corrections,
    limits: OutputLimits<N, T>,
    repulsion: JointRepulsion<N, T>,
    /// Joint stiffness of [`ControlLaw::Hold`], N·m/rad.
    hold_stiffness: [T; N],
}

/// What a law wants before any limit.
struct Wanted<const N: usize, T> {
    torque: [T; N],
    /// World axes.
    base_velocity: [T; 3],
}

impl<const N: usize, const K: usize, T: Scalar> Controller<N, K, T> {
    /// # Errors
    /// The first number of the tables or of the parameters that is not finite or out of range.
    pub fn new(
        arm: &ArmTable<N>,
        mount: &Mount,
        payload: &Payload,
        taxels: &[TaxelPlacement; K],
        parameters: &Parameters<N>,
    ) -> Result<Self, ParameterError> {
        let mut controller = Self {
            model: ArmModel::new(arm, mount, payload)?,
            cover: Cover::new(taxels)?,
            outline: CoverOutline::new(taxels),
            guard: BaseGuard::NONE,
            gains: Gains::from(&parameters.gains),
            posture_rad: parameters.gains.posture_rad,
            corrections: parameters.corrections,
            limits: OutputLimits::from(&parameters.limits),
            repulsion: JointRepulsion::new(arm),
            hold_stiffness: arm.torque_max_nm.map(|most| of(2.0 * most)),
        };
        controller.set_parameters(parameters)?;
        Ok(controller)
    }

    /// Takes new parameters while running: gains reach the law through a first-order filter, the posture at its own
    /// speed, corrections at the next step with what the torque would jump by fading, limits at the next step.
    ///
    /// # Errors
    /// The first parameter out of range; nothing is changed.
    pub fn set_parameters(&mut self, parameters: &Parameters<N>) -> Result<(), ParameterError> {
        let mut first = Ok(());
        parameters.check(|error| {
            if first.is_ok() {
                first = Err(error);
            }
        });
        first?;
        check_light_base(parameters)?;
        self.gains = Gains::from(&parameters.gains);
        self.posture_rad = parameters.gains.posture_rad;
        self.corrections = parameters.corrections;
        self.limits = OutputLimits::from(&parameters.limits);
        Ok(())
    }

    /// What protects the people around the base, from the next step on. It holds for the laws that move the robot;
    /// [`ControlLaw::Hold`] only ever brakes.
    ///
    /// # Errors
    /// A speed that is negative or not finite; nothing is changed.
    pub fn set_guard(&mut self, guard: BaseGuard<K, T>) -> Result<(), ParameterError> {
        guard.check()?;
        self.guard = guard;
        Ok(())
    }

    /// The cover's geometry, to say what a guard has to.
    pub fn outline(&self) -> &CoverOutline<K, T> {
        &self.outline
    }

    /// The arm's model.
    pub fn model(&self) -> &ArmModel<N, T> {
        &self.model
    }

    /// State for a robot that stands still: targets are where it is, v_d = 0, the last torque is C q̇ + g. A moving
    /// robot changes its law by [`Controller::step`] instead.
    ///
    /// # Errors
    /// A value of `robot` that is not finite.
    pub fn enter(
        &self,
        law: impl Into<ControlLaw>,
        robot: &RobotState<N, T>,
    ) -> Result<ControllerState<N, T>, ControlError> {
        check_robot(robot)?;
        let kinematics = self.model.kinematics(robot.base_pose_world[2], &robot.q_rad);
        let flange = flange_pose(&kinematics, robot);
        let inertias = self.model.link_inertias(&kinematics);
        let mut state = ControllerState {
            law: law.into(),
            reference: Reference::hold(flange),
            posture_rad: robot.q_rad,
            gains: self.gains,
            corrections: self.corrections,
            base_velocity_body: [T::zero(); 3],
            torque_nm: kinematics.bias(&inertias, &robot.dq_rad_s),
            carried_nm: [T::zero(); N],
            entering: true,
            observer: MomentumObserver::new(),
        };
        retarget(&mut state, &flange, &kinematics, robot);
        finite("entry torque", &state.torque_nm)?;
        Ok(state)
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
        let (cover_wrench_base, mut hit) = self.feel(input)?;
        let mut next = *state;
        let robot = &input.robot;
        let kinematics = self.model.kinematics(robot.base_pose_world[2], &robot.q_rad);
        let inertias = self.model.link_inertias(&kinematics);
        let mass = kinematics.mass_matrix(&inertias);
        let tick = Tick {
            robot,
            dt_s: input.dt_s.min(of(LONGEST_STEP_S)),
            kinematics: &kinematics,
            inertias: &inertias,
            mass: &mass,
            bias: kinematics.bias(&inertias, &robot.dq_rad_s),
            flange: flange_pose(&kinematics, robot),
            cover_world: kinematics.heading.to_world(cover_wrench_base),
            base_velocity: kinematics.heading.to_world(next.base_velocity_body),
        };
        if next.law != law {
            next.law = law;
            next.entering = true;
            retarget(&mut next, &tick.flange, &kinematics, robot);
        }
        if next.corrections != self.corrections {
            next.corrections = self.corrections;
            next.entering = true;
        }
        next.gains.approach(&self.gains, tick.dt_s);
        let task = TaskDynamics::new(
            kinematics.base_jacobian(),
            kinematics.arm_jacobian(),
            next.gains.virtual_mass,
            &mass.arm,
        )?;
        let flange_wrench_world = tick.flange_wrench(&mut next, input, &task)?;
        let wanted = match law {
            ControlLaw::Hold => self.hold(&tick, &next),
            ControlLaw::Impedance => {
                self.impedance(&tick, &mut next, &task, &flange_wrench_world, &mut hit)?
            }
            ControlLaw::FollowMe => {
                self.follow_me(&tick, &mut next, &task, &flange_wrench_world, &mut hit)?
            }
        };
        let command = self.limited(&tick, &mut next, wanted, &mut hit);
        finite("torque command", &command.arm_torque_nm)?;
        finite("base velocity command", &command.base_velocity_body)?;
        let desired = tick.desired(&next);
        *state = next;
        Ok(ControlOutput {
            command,
            cover_wrench_base,
            flange_wrench_world,
            flange: shown(&tick.flange),
            flange_desired: shown(&desired),
            limits: hit,
        })
    }

    /// What a step begins with: an input that can be believed, and its wrench on the base, eq. (4).
    #[inline]
    fn feel(&self, input: &ControlInput<N, K, T>) -> Result<([T; 3], LimitsHit), ControlError> {
        check_input(input)?;
        let mut hit = LimitsHit::default();
        let forces = self.limits.taxel_forces(&input.taxel_force_n, &mut hit);
        Ok((self.cover.wrench(&forces), hit))
    }

    fn hold(&self, tick: &Tick<'_, N, T>, state: &ControllerState<N, T>) -> Wanted<N, T> {
        let damping = core::array::from_fn(|i| {
            of::<T>(1.4) * (self.hold_stiffness[i] * tick.mass.arm[(i, i)].max(T::zero())).sqrt()
        });
        let posture = impedance::posture_torque(
            &self.hold_stiffness,
            &damping,
            &state.posture_rad,
            &tick.robot.q_rad,
            &tick.robot.dq_rad_s,
        );
        Wanted { torque: core::array::from_fn(|i| posture[i] + tick.bias[i]), base_velocity: [T::zero(); 3] }
    }

    /// eqs. (2), (6)–(11), with the corrections that are switched on.
    #[inline]
    fn impedance(
        &self,
        tick: &Tick<'_, N, T>,
        state: &mut ControllerState<N, T>,
        task: &TaskDynamics<N, T>,
        flange_wrench: &[T; 6],
        hit: &mut LimitsHit,
    ) -> Result<Wanted<N, T>, ControlError> {
        state.reference.advance(&tick.flange, tick.dt_s);
        approach_posture(&mut state.posture_rad, &self.posture_rad, tick.dt_s);
        let gains = &state.gains;
        let robot = tick.robot;
        let base = times(task.base_jacobian(), &robot.base_velocity_world);
        let wrench = tick.task_wrench(state, task, &base, &task.mobility(), hit)?;
        let mut null = WholeBodyForce {
            base: tick.cover_world.map(|f| f * gains.reactivity),
            arm: tick.posture_torque(state),
        };
        let weighted = BlockWeight::new(gains.eta_base, gains.eta_arm).factor(task)?;
        let mut force = weighted.force(&wrench, &null);
        let fed = if self.corrections.flange_feed {
            self.base_wrench_world(tick, flange_wrench)
        } else {
            [T::zero(); 3]
        };
        let velocity = if self.corrections.null_space_damping {
            let pushed = core::array::from_fn(|i| force.base[i] + fed[i]);
            let velocity = damped_in_null_space(&weighted, gains, &tick.base_velocity, &pushed, tick.dt_s)?;
            for i in 0..3 {
                null.base[i] -= gains.virtual_damping[i] * velocity[i];
            }
            force = weighted.force(&wrench, &null);
            velocity
        } else {
            let pushed = core::array::from_fn(|i| force.base[i] + fed[i]);
            admitted(gains, &tick.base_velocity, &pushed, tick.dt_s)
        };
        Ok(Wanted { torque: core::array::from_fn(|i| force.arm[i] + tick.bias[i]), base_velocity: velocity })
    }

    /// eqs. (2), (12)–(16): the tool keeps its pose on the base, the base follows cover and flange.
    #[inline]
    fn follow_me(
        &self,
        tick: &Tick<'_, N, T>,
        state: &mut ControllerState<N, T>,
        task: &TaskDynamics<N, T>,
        flange_wrench: &[T; 6],
        hit: &mut LimitsHit,
    ) -> Result<Wanted<N, T>, ControlError> {
        let robot = tick.robot;
        state.reference.advance(&seen_from_base(&tick.flange, tick.kinematics, robot), tick.dt_s);
        approach_posture(&mut state.posture_rad, &self.posture_rad, tick.dt_s);
        let wrench = tick.task_wrench(state, task, &[T::zero(); 6], &task.arm_mobility(), hit)?;
        let arm = task.arm_torque(&wrench, &tick.posture_torque(state))?;
        let led = self.base_wrench_world(tick, flange_wrench);
        let force = core::array::from_fn(|i| state.gains.reactivity * (tick.cover_world[i] + led[i]));
        Ok(Wanted {
            torque: core::array::from_fn(|i| arm[i] + tick.bias[i]),
            base_velocity: admitted(&state.gains, &tick.base_velocity, &force, tick.dt_s),
        })
    }

    /// What a planar base can follow of a wrench about the flange, world axes. eqs. (12)–(14)
    fn base_wrench_world(&self, tick: &Tick<'_, N, T>, flange_wrench: &[T; 6]) -> [T; 3] {
        let about_arm = follow_me::moved(flange_wrench, &tick.kinematics.flange_position);
        let [fx, fy, fz, mx, my, mz] = about_arm;
        let to_arm = tick.kinematics.arm_rotation.transpose();
        let (f, m) = (to_arm * Vector3::new(fx, fy, fz), to_arm * Vector3::new(mx, my, mz));
        let (rotation, position) = self.model.mount();
        let base = follow_me::base_wrench(rotation, position, &[f.x, f.y, f.z, m.x, m.y, m.z]);
        tick.kinematics.heading.to_world(base)
    }

    /// The base's velocity inside its limits and the guard, axes of B.
    fn guarded(
        &self,
        law: ControlLaw,
        heading: &Heading<T>,
        wanted_world: [T; 3],
        before_body: &[T; 3],
        dt_s: T,
        hit: &mut LimitsHit,
    ) -> [T; 3] {
        let guard = if law == ControlLaw::Hold { &BaseGuard::NONE } else { &self.guard };
        let wanted = heading.to_base(wanted_world);
        self.limits.guarded_base_velocity(&self.outline, guard, &wanted, before_body, dt_s, hit)
    }

    /// The command inside every limit, and the state that goes with it.
    #[inline]
    fn limited(
        &self,
        tick: &Tick<'_, N, T>,
        state: &mut ControllerState<N, T>,
        wanted: Wanted<N, T>,
        hit: &mut LimitsHit,
    ) -> RobotCommand<N, T> {
        let heading = &tick.kinematics.heading;
        let before = &state.base_velocity_body;
        let base_velocity_body =
            self.guarded(state.law, heading, wanted.base_velocity, before, tick.dt_s, hit);
        let mut torque = wanted.torque;
        if self.corrections.base_coupling && state.law != ControlLaw::Hold {
            let commanded = heading.to_world(base_velocity_body);
            let acceleration: [T; 3] =
                core::array::from_fn(|i| (commanded[i] - tick.base_velocity[i]) / tick.dt_s);
            let coupling = times(&tick.mass.base_coupling, &acceleration);
            torque = core::array::from_fn(|i| torque[i] + coupling[i]);
        }
        let repulsion =
            self.repulsion.torque(&tick.robot.q_rad, &tick.robot.dq_rad_s, |i| tick.mass.arm[(i, i)]);
        if state.entering {
            state.entering = false;
            state.carried_nm = core::array::from_fn(|i| state.torque_nm[i] - torque[i] - repulsion[i]);
        }
        hit.joint_range = repulsion.iter().any(|torque| *torque != T::zero());
        let total = core::array::from_fn(|i| torque[i] + state.carried_nm[i] + repulsion[i]);
        let arm_torque_nm = self.limits.torque(&total, &state.torque_nm, tick.dt_s, hit);
        let fade = (-tick.dt_s / of(CARRY_FADE_S)).exp();
        state.carried_nm = state.carried_nm.map(|carried| carried * fade);
        state.torque_nm = arm_torque_nm;
        state.base_velocity_body = base_velocity_body;
        RobotCommand { base_velocity_body, arm_torque_nm }
    }
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

/// Makes the measured state the target.
fn retarget<const N: usize, T: Scalar>(
    state: &mut ControllerState<N, T>,
    flange: &Pose<T>,
    kinematics: &Kinematics<N, T>,
    robot: &RobotState<N, T>,
) {
    state.posture_rad = robot.q_rad;
    state.reference = Reference::hold(match state.law {
        ControlLaw::FollowMe => seen_from_base(flange, kinematics, robot),
        ControlLaw::Hold | ControlLaw::Impedance => *flange,
    });
}

fn shown<T: Scalar>(pose: &Pose<T>) -> FlangePose<T> {
    FlangePose {
        position_world: pose.position.into(),
        quaternion_world: rotation::to_quaternion(&pose.rotation),
    }
}

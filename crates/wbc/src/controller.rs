//! The controllers as one step function: measurements in, command out.

use crate::admittance;
use crate::cover::{Cover, rotate_planar};
use crate::error::{ControlError, finite};
use crate::follow_me;
use crate::gains::Gains;
use crate::impedance;
use crate::limits::{JointRepulsion, LimitsHit, OutputLimits, check_step};
use crate::linalg::times;
use crate::model::{ArmModel, Kinematics, LinkInertias, MassMatrix};
use crate::observer::MomentumObserver;
use crate::opspace::{BlockWeight, BlockWeighted, TaskDynamics, WholeBodyForce};
use crate::reference::{Pose, Reference, approach_posture, leashed};
use crate::rotation;
use crate::scalar::{Scalar, of};
use crate::state::{ControlInput, ControlLaw, ControlOutput, ControllerState, FlangePose};
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
    gains: Gains<N, T>,
    posture_rad: [f64; N],
    corrections: Corrections,
    limits: OutputLimits<N, T>,
    repulsion: JointRepulsion<N, T>,
    /// Joint stiffness of [`ControlLaw::Hold`], N·m/rad.
    hold_stiffness: [T; N],
}

/// One step's quantities, computed once and read by every law.
struct Tick<'a, const N: usize, T> {
    robot: &'a RobotState<N, T>,
    dt_s: T,
    kinematics: Kinematics<N, T>,
    inertias: LinkInertias<N, T>,
    mass: MassMatrix<N, T>,
    bias: [T; N],
    flange: Pose<T>,
    cover_world: [T; 3],
    /// v_d of eq. (2), world axes.
    base_velocity: [T; 3],
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
    /// speed, corrections and limits at the next step.
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
            base_velocity_body: [T::zero(); 3],
            torque_nm: kinematics.bias(&inertias, &robot.dq_rad_s),
            carried_nm: [T::zero(); N],
            entering: true,
            observer: MomentumObserver::new(),
        };
        retarget(&mut state, &flange, robot);
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
        check_input(input)?;
        let mut next = *state;
        let mut hit = LimitsHit::default();
        let forces = self.limits.taxel_forces(&input.taxel_force_n, &mut hit);
        let cover_wrench_base = self.cover.wrench(&forces);
        let tick = self.tick(&next, input, &cover_wrench_base);
        if next.law != law {
            next.law = law;
            next.entering = true;
            retarget(&mut next, &tick.flange, tick.robot);
        }
        next.gains.approach(&self.gains, tick.dt_s);
        let task = TaskDynamics::new(
            tick.kinematics.base_jacobian(),
            tick.kinematics.arm_jacobian(),
            next.gains.virtual_mass,
            &tick.mass.arm,
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

    #[inline]
    fn tick<'a>(
        &self,
        state: &ControllerState<N, T>,
        input: &'a ControlInput<N, K, T>,
        cover_wrench_base: &[T; 3],
    ) -> Tick<'a, N, T> {
        let robot = &input.robot;
        let yaw = robot.base_pose_world[2];
        let kinematics = self.model.kinematics(yaw, &robot.q_rad);
        let inertias = self.model.link_inertias(&kinematics);
        Tick {
            robot,
            dt_s: input.dt_s.min(of(LONGEST_STEP_S)),
            mass: kinematics.mass_matrix(&inertias),
            bias: kinematics.bias(&inertias, &robot.dq_rad_s),
            flange: flange_pose(&kinematics, robot),
            cover_world: rotate_planar(yaw, *cover_wrench_base),
            base_velocity: rotate_planar(yaw, state.base_velocity_body),
            kinematics,
            inertias,
        }
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
        let base = times(&tick.kinematics.base_jacobian(), &robot.base_velocity_world);
        let wrench = tick.task_wrench(state, &tick.flange, &base, &task.mobility(), hit)?;
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
        state.reference.advance(&seen_from_base(&tick.flange, robot), tick.dt_s);
        approach_posture(&mut state.posture_rad, &self.posture_rad, tick.dt_s);
        let wrench = tick.task_wrench(state, &tick.flange, &[T::zero(); 6], &task.arm_mobility(), hit)?;
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
        rotate_planar(tick.robot.base_pose_world[2], base)
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
        let yaw = tick.robot.base_pose_world[2];
        let base_velocity_body = self.limits.base_velocity(
            &rotate_planar(-yaw, wanted.base_velocity),
            &state.base_velocity_body,
            tick.dt_s,
            hit,
        );
        let mut torque = wanted.torque;
        if self.corrections.base_coupling && state.law != ControlLaw::Hold {
            let commanded = rotate_planar(yaw, base_velocity_body);
            let acceleration: [T; 3] =
                core::array::from_fn(|i| (commanded[i] - tick.base_velocity[i]) / tick.dt_s);
            let coupling = times(&tick.mass.base_coupling, &acceleration);
            torque = core::array::from_fn(|i| torque[i] + coupling[i]);
        }
        if state.entering {
            state.entering = false;
            state.carried_nm = core::array::from_fn(|i| state.torque_nm[i] - torque[i]);
        }
        let repulsion =
            self.repulsion.torque(&tick.robot.q_rad, &tick.robot.dq_rad_s, |i| tick.mass.arm[(i, i)]);
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

impl<const N: usize, T: Scalar> Tick<'_, N, T> {
    /// F = K·e + D·ė with the leash on e. `base_twist` is what the base's motion gives the tool. eqs. (10), (16)
    #[inline]
    fn task_wrench(
        &self,
        state: &ControllerState<N, T>,
        actual: &Pose<T>,
        base_twist: &[T; 6],
        mobility: &nalgebra::SMatrix<T, 6, 6>,
        hit: &mut LimitsHit,
    ) -> Result<[T; 6], ControlError> {
        let gains = &state.gains;
        let desired = self.desired(state);
        let error = impedance::pose_error(
            (&actual.position, &actual.rotation),
            (&desired.position, &desired.rotation),
        );
        let (error, taut) = leashed(&error);
        hit.leash = taut;
        let arm_twist = times(&self.kinematics.arm_jacobian(), &self.robot.dq_rad_s);
        let wanted = self.desired_twist(state);
        let rate = core::array::from_fn(|i| wanted[i] - base_twist[i] - arm_twist[i]);
        let damping = impedance::damping(mobility, &gains.stiffness, gains.damping_ratio)?;
        Ok(impedance::wrench(&gains.stiffness, &damping, &error, &rate))
    }

    #[inline]
    fn posture_torque(&self, state: &ControllerState<N, T>) -> [T; N] {
        impedance::posture_torque(
            &state.gains.posture_stiffness,
            &state.gains.posture_damping,
            &state.posture_rad,
            &self.robot.q_rad,
            &self.robot.dq_rad_s,
        )
    }

    /// The reference in W.
    fn desired(&self, state: &ControllerState<N, T>) -> Pose<T> {
        match state.law {
            ControlLaw::Hold => self.flange,
            ControlLaw::Impedance => state.reference.now,
            ControlLaw::FollowMe => {
                let [x, y, yaw] = self.robot.base_pose_world;
                let turn = rotation::about_z(yaw);
                let reference = &state.reference.now;
                Pose {
                    position: turn * reference.position + Vector3::new(x, y, T::zero()),
                    rotation: turn * reference.rotation,
                }
            }
        }
    }

    /// The reference's twist, world axes.
    fn desired_twist(&self, state: &ControllerState<N, T>) -> [T; 6] {
        let twist = *state.reference.twist();
        if state.law != ControlLaw::FollowMe {
            return twist;
        }
        let [vx, vy, vz, wx, wy, wz] = twist;
        let yaw = self.robot.base_pose_world[2];
        let [v0, v1, v2] = rotate_planar(yaw, [vx, vy, vz]);
        let [w0, w1, w2] = rotate_planar(yaw, [wx, wy, wz]);
        [v0, v1, v2, w0, w1, w2]
    }

    /// The external wrench from the best source there is. The observer runs where the other two are missing.
    fn flange_wrench<const K: usize>(
        &self,
        state: &mut ControllerState<N, T>,
        input: &ControlInput<N, K, T>,
        task: &TaskDynamics<N, T>,
    ) -> Result<[T; 6], ControlError> {
        if let Some(wrench) = input.flange_wrench_world.or(self.robot.flange_wrench_world) {
            return Ok(wrench);
        }
        let (robot, kinematics) = (self.robot, &self.kinematics);
        let momentum = kinematics.momentum(&self.inertias, &robot.base_velocity_world, &robot.dq_rad_s);
        let gravity = kinematics.gravity(&self.inertias);
        state.observer.update(&momentum, &gravity, &robot.torque_measured_nm, self.dt_s);
        let about_tool = task.arm_wrench(state.observer.external_torque())?;
        Ok(follow_me::moved(&about_tool, &(kinematics.tool_position - kinematics.flange_position)))
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

/// Exact zero-order hold of eq. (2) on all three axes.
fn admitted<const N: usize, T: Scalar>(
    gains: &Gains<N, T>,
    velocity: &[T; 3],
    force: &[T; 3],
    dt_s: T,
) -> [T; 3] {
    core::array::from_fn(|i| {
        admittance::step(velocity[i], force[i], gains.virtual_mass[i], gains.virtual_damping[i], dt_s)
    })
}

/// eq. (2) with its damping moved into τ_0: M_v·v̇ = τ_v − S·M_v⁻¹·D_v·v, S the free base mass. Implicit in v, because
/// S couples the axes: (M_v/dt + Q·S·Q)·Q·v⁺ = Q·(M_v·v/dt + τ_v) with Q = (M_v⁻¹D_v)^½ is symmetric and stable for
/// every D/M and dt.
fn damped_in_null_space<const N: usize, T: Scalar>(
    weighted: &BlockWeighted<'_, N, T>,
    gains: &Gains<N, T>,
    velocity: &[T; 3],
    force: &[T; 3],
    dt_s: T,
) -> Result<[T; 3], ControlError> {
    let mass = &gains.virtual_mass;
    let free = weighted.free_base_mass();
    let q: [T; 3] = core::array::from_fn(|i| (gains.virtual_damping[i] / mass[i]).sqrt());
    let system = nalgebra::Matrix3::from_fn(|i, j| {
        let inertia = if i == j { mass[i] / dt_s } else { T::zero() };
        inertia + q[i] * free[(i, j)] * q[j]
    });
    let factor = crate::linalg::Cholesky::new_shifted(&system)
        .ok_or(ControlError::NotPositiveDefinite { what: "base damping" })?;
    let z = factor.solve(&core::array::from_fn(|i| q[i] * (mass[i] / dt_s * velocity[i] + force[i])));
    let drag = times(&free, &core::array::from_fn(|i| q[i] * z[i]));
    Ok(core::array::from_fn(|i| velocity[i] + dt_s / mass[i] * (force[i] - drag[i])))
}

/// Makes the measured state the target.
fn retarget<const N: usize, T: Scalar>(
    state: &mut ControllerState<N, T>,
    flange: &Pose<T>,
    robot: &RobotState<N, T>,
) {
    state.posture_rad = robot.q_rad;
    state.reference = Reference::hold(match state.law {
        ControlLaw::FollowMe => seen_from_base(flange, robot),
        ControlLaw::Hold | ControlLaw::Impedance => *flange,
    });
}

fn seen_from_base<const N: usize, T: Scalar>(pose: &Pose<T>, robot: &RobotState<N, T>) -> Pose<T> {
    let [x, y, yaw] = robot.base_pose_world;
    let turn = rotation::about_z(-yaw);
    Pose { position: turn * (pose.position - Vector3::new(x, y, T::zero())), rotation: turn * pose.rotation }
}

fn flange_pose<const N: usize, T: Scalar>(
    kinematics: &Kinematics<N, T>,
    robot: &RobotState<N, T>,
) -> Pose<T> {
    let [x, y, _] = robot.base_pose_world;
    Pose {
        position: kinematics.tool_from_base() + Vector3::new(x, y, T::zero()),
        rotation: kinematics.tool_rotation,
    }
}

fn shown<T: Scalar>(pose: &Pose<T>) -> FlangePose<T> {
    FlangePose {
        position_world: pose.position.into(),
        quaternion_world: rotation::to_quaternion(&pose.rotation),
    }
}

fn check_robot<const N: usize, T: Scalar>(robot: &RobotState<N, T>) -> Result<(), ControlError> {
    finite("base_pose_world", &robot.base_pose_world)?;
    finite("base_velocity_world", &robot.base_velocity_world)?;
    finite("q_rad", &robot.q_rad)?;
    finite("dq_rad_s", &robot.dq_rad_s)?;
    finite("torque_measured_nm", &robot.torque_measured_nm)?;
    finite("robot.flange_wrench_world", robot.flange_wrench_world.as_ref().map_or(&[], |w| &w[..]))
}

fn check_input<const N: usize, const K: usize, T: Scalar>(
    input: &ControlInput<N, K, T>,
) -> Result<(), ControlError> {
    check_step(input.dt_s)?;
    check_robot(&input.robot)?;
    finite("taxel_force_n", &input.taxel_force_n)?;
    finite("flange_wrench_world", input.flange_wrench_world.as_ref().map_or(&[], |w| &w[..]))
}

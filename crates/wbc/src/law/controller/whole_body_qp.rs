//! Every limit of arm and base in one quadratic programme, instead of one after the other.
//!
//! The variables are the joint torques u (without what carries the arm along with its base), the base's velocity v in its own
//! axes, and two slacks. The cost is the law's own: of all forces with the wanted wrench at the tool eq. (6) takes those that
//! are nearest to τ_0 in W, and with P the part of W that the tool feels, W + (w − 1)·P has its least at them, whatever w is.
//! w says how much dearer a force is that the tool feels. `docs/math.md` has the derivation and what it is worth.

use super::joint_pace::acceleration_bounds;
use super::law::ControlLaw;
use super::whole_body::{ControlInput, ControlOutput, ControllerState, Step, Wanted, WholeBodyController};
use crate::error::{ControlError, finite};
use crate::guard::BaseGuard;
use crate::limits::LimitsHit;
use crate::linalg::{dot, times};
use crate::opspace::{ArmDynamics, BlockWeight, TaskDynamics};
use crate::scalar::{Scalar, of};
use moca_msgs::RobotCommand;
use moca_qp::{Metric, Row, WorkingSet};

/// Most joints of an arm.
const MOST_JOINTS: usize = 7;
/// Indices of the first variable of the base's velocity, of the slack of touched taxels, of the slack of joints' bounds.
const BASE: usize = MOST_JOINTS;
const CONTACTS: usize = BASE + 3;
const JOINTS: usize = CONTACTS + 1;
const VARIABLES: usize = JOINTS + 1;
/// Torque and both directions of each joint, the base's axes, and as many touched taxels as are looked at.
const MOST_ROWS: usize = 3 * MOST_JOINTS + 3 + 32;

/// Cost of a force that the tool feels, relative to one in the null space: w.
const TASK: f64 = 1e4;
/// Cost of exceeding a soft bound, relative to that.
const SOFT: f64 = 1e4;
/// Change of the base's velocity that the arm need not hear of, m/s and rad/s: rounding, and what softness leaves.
const ROUNDING: f64 = 1e-6;

/// Work of [`WholeBodyController::step_by_qp`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QpUse {
    /// Programmes that were solved: none where the law keeps all limits, two where what the base is to do is not inside
    /// its guard, which bounds no polyhedron.
    pub programmes: usize,
    /// Rows that they took up or dropped.
    pub iterations: usize,
    /// One of them failed, and the limits were kept one after the other.
    pub fell_back: bool,
}

/// Torques and base velocity inside every limit; `None` where the programme fails.
type Found<const N: usize, T> = Option<([T; N], [T; 3])>;

/// The programme of one step.
struct Programme<'a, const N: usize, const K: usize, T> {
    controller: &'a WholeBodyController<N, K, T>,
    step: &'a Step<'a, N, T>,
    arm: &'a ArmDynamics<'a, N, T>,
    state: &'a ControllerState<N, T>,
    /// Targets of the programme: joint torques, the base's velocity.
    torque: [T; N],
    velocity_body: [T; 3],
    /// Largest speed of each touched taxel outward.
    outward_m_s: Option<&'a [T; K]>,
    counted_on: Option<[T; 3]>,
    /// Rows of M_A⁻¹.
    mobility: [[T; N]; N],
}

impl<const N: usize, const K: usize, T: Scalar> WholeBodyController<N, K, T> {
    /// [`Self::step`] with all limits kept together, by one quadratic programme of arm and base, where some are not kept
    /// by what the law wants; where all are, the same to the bit, but for the repulsion from the ends of the joints' ranges,
    /// in whose place the programme has bounds. `docs/math.md` derives it. `used` says what it took.
    ///
    /// # Errors
    /// As for [`Self::step`].
    pub fn step_by_qp(
        &self,
        law: ControlLaw,
        state: &mut ControllerState<N, T>,
        input: &ControlInput<N, K, T>,
        used: &mut QpUse,
    ) -> Result<ControlOutput<N, T>, ControlError> {
        *used = QpUse::default();
        self.stepped(law, state, input, |step, arm, next, wanted, hit| {
            if let Some(arm) = arm
                && let Some(command) =
                    self.limited_together(step, arm, next, &input.guard, wanted, (&mut *hit, used))?
            {
                return Ok(command);
            }
            self.limited(step, arm, next, &input.guard, wanted, hit)
        })
    }

    /// The command inside every limit, and the state that goes with it; `None` where that is not found.
    pub(super) fn limited_together(
        &self,
        step: &Step<'_, N, T>,
        arm: &ArmDynamics<'_, N, T>,
        state: &mut ControllerState<N, T>,
        guard: &BaseGuard<K, T>,
        wanted: &Wanted<N, T>,
        (hit, used): (&mut LimitsHit, &mut QpUse),
    ) -> Result<Option<RobotCommand<N, T>>, ControlError> {
        const { assert!(N <= MOST_JOINTS) };
        let (tick, heading) = (step.tick, &step.tick.kinematics.heading);
        let before_body = state.base.velocity_body;
        let wanted_body = heading.to_base(wanted.base_velocity);
        let mut wished_hit = *hit;
        let alone = self.base.limited(guard, &wanted_body, &before_body, tick.dt_s, &mut wished_hit);
        finite("base velocity command", &alone)?;
        let entering = state.arm.entering;
        if entering {
            state.arm.entering = false;
            let coupling = self.coupling(step, &wanted_body);
            state.arm.carried_nm =
                core::array::from_fn(|i| state.arm.torque_nm[i] - (wanted.torque[i] + coupling[i]));
        }
        let programme = Programme {
            controller: self,
            step,
            arm,
            state,
            torque: wanted.torque,
            velocity_body: wanted_body,
            outward_m_s: guard.outward_m_s.as_ref(),
            counted_on: wanted.counted_on,
            mobility: core::array::from_fn(|i| arm.joint_acceleration(&unit(i))),
        };
        let kept = programme.joints_keep(&mut wished_hit);
        let found = if kept && alone == wanted_body {
            Some((wanted.torque, wanted_body))
        } else {
            programme.found(guard, &alone, &before_body, used)?
        };
        let Some((torque, velocity_body)) = found else {
            state.arm.entering = entering;
            return Ok(None);
        };
        let coupling = self.coupling(step, &velocity_body);
        let total = core::array::from_fn(|i| torque[i] + coupling[i] + state.arm.carried_nm[i]);
        *hit = wished_hit;
        let arm_torque_nm = self.arm.sent(&total, &mut state.arm, tick.dt_s)?;
        state.hold_back(step, wanted, &velocity_body, hit);
        state.base.velocity_body = velocity_body;
        Ok(Some(RobotCommand {
            base_velocity_body: velocity_body,
            arm_torque_nm,
            arm_gravity_nm: tick.dynamics.gravity(),
        }))
    }

    /// Torques that carry the arm along with its base, where the law knows of them.
    fn coupling(&self, step: &Step<'_, N, T>, velocity_body: &[T; 3]) -> [T; N] {
        if !self.corrections.base_coupling {
            return [T::zero(); N];
        }
        let tick = step.tick;
        let commanded = tick.kinematics.heading.to_world(*velocity_body);
        let acceleration = core::array::from_fn(|i| (commanded[i] - step.base_velocity[i]) / tick.dt_s);
        times(&tick.dynamics.base_coupling, &acceleration)
    }
}

impl<const N: usize, const K: usize, T: Scalar> Programme<'_, N, K, T> {
    /// Least and largest acceleration that the torques u of joint `i` may give it.
    fn acceleration_bounds(&self, i: usize) -> [T; 2] {
        let (tick, carried) = (self.step.tick, &self.state.arm.carried_nm);
        let known = core::array::from_fn(|j| carried[j] - tick.dynamics.bias[j]);
        let without = dot(&self.mobility[i], &known);
        acceleration_bounds(tick.robot, self.controller.arm.joint_limits(), i).map(|bound| bound - without)
    }

    /// Least and largest u of joint `i` with an arm that needs not be carried along.
    fn torque_bounds(&self, i: usize) -> [T; 2] {
        let (state, dt_s) = (&self.state.arm, self.step.tick.dt_s);
        let limits = &self.controller.arm.limits;
        limits.reachable(i, state.torque_nm[i], dt_s).map(|bound| bound - state.carried_nm[i])
    }

    /// Returns true if the target keeps every bound of the joints; else names the kind that it does not.
    fn joints_keep(&self, hit: &mut LimitsHit) -> bool {
        let (state, dt_s) = (&self.state.arm, self.step.tick.dt_s);
        let coupling = self.controller.coupling(self.step, &self.velocity_body);
        let total = core::array::from_fn(|i| self.torque[i] + coupling[i] + state.carried_nm[i]);
        let limited = self.controller.arm.limits.limited(&total, &state.torque_nm, dt_s, hit);
        hit.joint_range = (0..N).any(|i| {
            let ([least, most], is) = (self.acceleration_bounds(i), dot(&self.mobility[i], &self.torque));
            is < least || is > most
        });
        limited == total && !hit.joint_range
    }

    /// Torques and base velocity inside every limit; `alone` is what the base would do by itself.
    fn found(
        &self,
        guard: &BaseGuard<K, T>,
        alone: &[T; 3],
        before_body: &[T; 3],
        used: &mut QpUse,
    ) -> Result<Found<N, T>, ControlError> {
        let (base, dt_s) = (&self.controller.base, self.step.tick.dt_s);
        // a speed limit of every point of the cover bounds no polyhedron: the base does not help where it is in the way
        let free = guard.instead_body.is_none() && base.outline().permits(guard, &self.velocity_body);
        let (least, most) = if free { base.limits.room(guard, before_body, dt_s) } else { (*alone, *alone) };
        let Some((torque, velocity)) = self.solved(&least, &most, used)? else { return Ok(None) };
        let inside = base.limited(guard, &velocity, before_body, dt_s, &mut LimitsHit::default());
        if (0..3).all(|i| (inside[i] - velocity[i]).abs() <= of(ROUNDING)) {
            return Ok(Some((torque, inside)));
        }
        let solved = self.solved(&inside, &inside, used)?;
        Ok(solved.map(|(torque, _)| (torque, inside)))
    }

    /// Torques and base velocity nearest to what is wanted, the base between `least` and `most`.
    fn solved(&self, least: &[T; 3], most: &[T; 3], used: &mut QpUse) -> Result<Found<N, T>, ControlError> {
        used.programmes += 1;
        let metric = self.metric()?;
        let (rows, count) = self.rows(least, most);
        let mut target = [T::zero(); VARIABLES];
        target[..N].copy_from_slice(&self.torque);
        target[BASE..CONTACTS].copy_from_slice(&self.velocity_body);
        let rows = rows.get(..count).unwrap_or(&rows);
        let solution = metric.and_then(|metric| metric.nearest(&target, rows, &WorkingSet::EMPTY));
        let Ok(solution) = solution else {
            used.fell_back = true;
            return Ok(None);
        };
        used.iterations += solution.iterations;
        let velocity = core::array::from_fn(|i| solution.x[BASE + i].clamp(least[i], most[i]));
        Ok(Some((core::array::from_fn(|i| solution.x[i]), velocity)))
    }

    /// W + (w − 1)·P, and the prices of the slacks.
    fn metric(&self) -> Result<Result<Metric<VARIABLES, T>, moca_qp::QpError>, ControlError> {
        let (kinematics, dt_s) = (self.step.tick.kinematics, self.step.tick.dt_s);
        let task = TaskDynamics::new(self.state.base.gains.virtual_mass, self.arm);
        let [eta_base, eta_arm] = self.state.eta;
        let weighted = BlockWeight::new(eta_base, eta_arm).factor(&task)?;
        let bearable = self.arm.bearable_task_inertia()?;
        let ([mx, my, turning], arm_share) = weighted.metric();
        let per_s = self.counted_on.unwrap_or([T::one() / dt_s; 3]);
        // acceleration of the base, world axes, for each of its velocities in its own
        let accelerations: [[T; 3]; 3] = core::array::from_fn(|j| {
            let world = kinematics.heading.to_world(unit(j));
            core::array::from_fn(|i| world[i] * per_s[i])
        });
        // what each variable does to the tool, whitened: P is the product of these with each other
        let mut felt = [[T::zero(); 6]; CONTACTS];
        for i in 0..N {
            felt[i] = weighted.whitened(&times(kinematics.arm_jacobian(), &self.mobility[i]));
        }
        if self.counted_on.is_some() {
            for j in 0..3 {
                let twist = kinematics.twist_from_base(&accelerations[j]);
                // where the tool is heavy it goes with the base
                let borne = times(self.arm.inverse_task_inertia(), &bearable.solve(&twist));
                felt[BASE + j] = weighted.whitened(&borne);
            }
        }
        let mut hessian = [[T::zero(); VARIABLES]; VARIABLES];
        for i in 0..CONTACTS {
            for j in 0..=i {
                hessian[i][j] = of::<T>(TASK - 1.0) * dot(&felt[i], &felt[j]);
            }
        }
        for i in 0..N {
            for j in 0..=i {
                hessian[i][j] += arm_share * self.mobility[i][j];
            }
        }
        for i in N..MOST_JOINTS {
            hessian[i][i] = T::one();
        }
        for i in 0..3 {
            for j in 0..=i {
                let ([x, y, yaw], [x1, y1, yaw1]) = (accelerations[i], accelerations[j]);
                hessian[BASE + i][BASE + j] += mx * x * x1 + my * y * y1 + turning * yaw * yaw1;
            }
        }
        let dearest = |from: usize, to: usize| (from..to).fold(T::zero(), |most, i| most.max(hessian[i][i]));
        let inertia = (0..N).fold(T::zero(), |most, i| most.max(self.step.tick.dynamics.mass[(i, i)]));
        hessian[CONTACTS][CONTACTS] = of::<T>(SOFT) * dearest(BASE, CONTACTS);
        hessian[JOINTS][JOINTS] = of::<T>(SOFT * TASK) * arm_share * inertia;
        Ok(Metric::new(&hessian))
    }

    /// Torques and the base's velocity are inside their bounds; joints and touched taxels if that is possible.
    fn rows(&self, least: &[T; 3], most: &[T; 3]) -> ([Row<VARIABLES, T>; MOST_ROWS], usize) {
        let mut rows = [Row::bound(0, T::zero(), T::zero()); MOST_ROWS];
        let mut count = 0;
        let mut push = |row| {
            if let Some(place) = rows.get_mut(count) {
                *place = row;
                count += 1;
            }
        };
        for i in 0..3 {
            push(Row::bound(BASE + i, least[i], most[i]));
        }
        let standing = self.controller.coupling(self.step, &[T::zero(); 3]);
        let along: [[T; N]; 3] = core::array::from_fn(|j| self.controller.coupling(self.step, &unit(j)));
        for i in 0..N {
            let [least, most] = self.torque_bounds(i).map(|bound| bound - standing[i]);
            let mut row = Row::bound(i, least, most);
            for j in 0..3 {
                row.normal[BASE + j] = along[j][i] - standing[i];
            }
            push(row);
        }
        for i in 0..N {
            let [least, most] = self.acceleration_bounds(i);
            let mut normal = [T::zero(); VARIABLES];
            normal[..N].copy_from_slice(&self.mobility[i]);
            push(Row::at_least(normal, least).softened(JOINTS));
            push(Row::at_most(normal, most).softened(JOINTS));
        }
        for (inward, most) in
            self.controller.outline().map().columns().iter().zip(self.outward_m_s.into_iter().flatten())
        {
            if most.is_finite() {
                let mut normal = [T::zero(); VARIABLES];
                normal[BASE..CONTACTS].copy_from_slice(inward);
                push(Row::at_least(normal, -*most).softened(CONTACTS));
            }
        }
        (rows, count)
    }
}

fn unit<const D: usize, T: Scalar>(i: usize) -> [T; D] {
    core::array::from_fn(|j| if i == j { T::one() } else { T::zero() })
}

//! Weighted operational space, eqs. (6)–(9): which torques of base and arm give the wrench F at the tool.
//!
//! Among all torques with J̄ᵀτ = F these are nearest to τ_0 in (τ − τ_0)ᵀW(τ − τ_0), W = Hᵀ M⁻¹ H. The weight H comes as two
//! types, [`BlockWeight`] (the paper's, one gain for the base and one for the arm) and [`AxisWeight`] (a gain per axis),
//! because the short form that is exact for the first is wrong for the second.
//!
//! ```
//! use moca_wbc::opspace::{ArmDynamics, BlockWeight, TaskDynamics, WholeBodyForce};
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let dynamics = model.dynamics(0.0, &PANDA.home_rad, &[0.0; 7]);
//! let arm = ArmDynamics::new(&dynamics)?;
//! let task = TaskDynamics::new([4.0, 4.0, 2.0], &arm);
//! let null = WholeBodyForce { base: [5.0, 0.0, 1.0], arm: [0.5; 7] };
//! let wrench = [1.0, -2.0, 3.0, 0.1, 0.0, 0.2];
//! let force = BlockWeight::new(3.0, 1.0).factor(&task)?.force(&wrench, &null);
//! for (achieved, wanted) in task.wrench(&force)?.iter().zip(wrench) {
//!     assert!((achieved - wanted).abs() < 1e-9, "whatever τ_0 is");
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::error::ControlError;
use crate::linalg::{Cholesky, dot, times, transpose_times, weighted_outer};
use crate::model::Dynamics;
use crate::scalar::{Scalar, of};
use moca_msgs::ParameterError;
use nalgebra::SMatrix;

/// Generalised forces of base and arm: τ_v (world \[N, N, N·m\]) and τ_A (N·m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WholeBodyForce<const N: usize, T> {
    /// Virtual force on the base, world x, y, yaw.
    pub base: [T; 3],
    /// Joint torques.
    pub arm: [T; N],
}

/// The arm as its tool frame sees it: M_A and J_A.
#[derive(Clone, Copy, Debug)]
pub struct ArmDynamics<'a, const N: usize, T> {
    dynamics: &'a Dynamics<N, T>,
    mass: Cholesky<N, T>,
    /// (L⁻¹·J_Aᵀ)ᵀ with M_A = L·D·Lᵀ.
    reduced: SMatrix<T, 6, N>,
    /// A_A = J_A M_A⁻¹ J_Aᵀ.
    inverse_task_inertia: SMatrix<T, 6, 6>,
}

impl<'a, const N: usize, T: Scalar> ArmDynamics<'a, N, T> {
    /// From the arm's Jacobian and mass matrix.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if the mass matrix is not.
    pub fn new(dynamics: &'a Dynamics<N, T>) -> Result<Self, ControlError> {
        let mut arm = Self::unset(dynamics);
        arm.factorise()?;
        Ok(arm)
    }

    /// Room for an arm that is factorised where it stands: returned, it would be copied.
    #[inline]
    pub fn unset(dynamics: &'a Dynamics<N, T>) -> Self {
        Self {
            dynamics,
            mass: Cholesky::unset(),
            reduced: [[T::zero(); 6]; N].into(),
            inverse_task_inertia: [[T::zero(); 6]; 6].into(),
        }
    }

    /// Becomes what [`ArmDynamics::new`] gives.
    ///
    /// # Errors
    /// As [`ArmDynamics::new`].
    #[inline(never)]
    pub fn factorise(&mut self) -> Result<(), ControlError> {
        let Self { dynamics, mass, reduced, inverse_task_inertia } = self;
        if !mass.factorise(&dynamics.mass) {
            return Err(ControlError::NotPositiveDefinite { what: "M_A" });
        }
        *reduced = SMatrix::from(mass.solve_lower_rows(&dynamics.kinematics.arm_jacobian().data.0));
        *inverse_task_inertia = weighted_outer(reduced, mass.inverse_diagonal());
        Ok(())
    }

    /// Λ⁻¹ = J_A M_A⁻¹ J_Aᵀ of the arm alone.
    pub fn inverse_task_inertia(&self) -> &SMatrix<T, 6, 6> {
        &self.inverse_task_inertia
    }

    /// J_A M_A⁻¹ τ: acceleration of the tool under joint torques on a standing base.
    #[inline(never)]
    pub fn acceleration(&self, torque: &[T; N]) -> [T; 6] {
        let (lower, inverse) = (self.mass.solve_lower(torque), self.mass.inverse_diagonal());
        times(&self.reduced, &core::array::from_fn(|i| lower[i] * inverse[i]))
    }

    /// τ_A = J_AᵀF + (I − J_AᵀΛ J_A M_A⁻¹)·τ_0 with the arm's own Λ: the wrench F by the arm alone. eq. (15)
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub fn torque(&self, wrench: &[T; 6], null_torque: &[T; N]) -> Result<[T; N], ControlError> {
        let mut factor = Cholesky::unset();
        factorise(&self.inverse_task_inertia, &mut factor)?;
        let wanted = difference(&times(&self.inverse_task_inertia, wrench), &self.acceleration(null_torque));
        let task = transpose_times(self.dynamics.kinematics.arm_jacobian(), &solved(&factor, &wanted));
        Ok(core::array::from_fn(|i| null_torque[i] + task[i]))
    }

    /// Joint torques that stand in for a base acceleration a* − a (world x, y, yaw) that the law counted on and that
    /// was refused: by a guard, by the base's speed or acceleration limit, or by any other constraint on its motion.
    ///
    /// Eq. (6) chooses τ_v and τ_A together so that J_B·M_v⁻¹τ_v + J_A·M_A⁻¹τ_A = Λ⁻¹F. If the base is given a instead
    /// of a*, the tool misses J_B·(a* − a), and what a push on the cover should have done to the base is left to the arm:
    /// it is thrown. δτ = J_Aᵀ(J_A·M_A⁻¹J_Aᵀ)⁻¹J_B·(a* − a) gives the tool what it misses, J_A·M_A⁻¹δτ = J_B·(a* − a), so
    /// that Λ⁻¹F holds again whatever was refused: the force on the cover cancels, and the error obeys the same
    /// equation as with a free base. Of all torques that do so it is the one nearest to τ_A in the metric M_A⁻¹.
    ///
    /// Near a singularity, where a direction of the tool is heavier than 1/[`HEAVY`], the tool goes with the base there
    /// instead of asking for torques without bound: Λ_A⁻¹ is shifted by what its smallest pivot falls short of it.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub fn torque_for_refused(&self, refused: &[T; 3]) -> Result<[T; N], ControlError> {
        let missed = self.bearable_task_inertia()?.solve(&self.dynamics.kinematics.twist_from_base(refused));
        Ok(transpose_times(self.dynamics.kinematics.arm_jacobian(), &missed))
    }

    /// Λ of the arm alone, no heavier than 1/[`HEAVY`], as the factors of its inverse.
    #[inline]
    pub(crate) fn bearable_task_inertia(&self) -> Result<Cholesky<6, T>, ControlError> {
        let factor = self.task_inertia()?;
        let short = factor.diagonal().iter().fold(T::zero(), |most, &pivot| most.max(of::<T>(HEAVY) - pivot));
        if short <= T::zero() {
            return Ok(factor);
        }
        let mut shifted = self.inverse_task_inertia;
        for i in 0..6 {
            shifted[(i, i)] += short;
        }
        Cholesky::new_shifted(&shifted).ok_or(SINGULAR)
    }

    /// Smallest part of the tool's mobility along or about an axis (x, y, z, then their rotations) that is left once the axes
    /// before it are held: 1 if no axis depends on another, 0 in a singular posture. It has no unit, so that a light arm and a
    /// heavy one are judged alike.
    ///
    /// ```
    /// use moca_wbc::opspace::ArmDynamics;
    /// use moca_wbc::robot::{MOCA_MOUNT, PANDA};
    /// use moca_wbc::{ArmModel, Payload};
    ///
    /// let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
    /// let left = |q_rad| Ok::<_, moca_wbc::ControlError>(ArmDynamics::new(&model.dynamics(0.0, q_rad, &[0.0; 7]))?.mobility_left());
    /// assert!(left(&PANDA.home_rad)? > 0.15);
    /// assert!(left(&[0.0, 0.5, 0.0, -0.45, 0.0, 1.2, 0.785])? < 1e-3, "the elbow is straight");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn mobility_left(&self) -> T {
        self.task_inertia().map_or(T::zero(), |factor| self.left(&factor))
    }

    /// [`ArmDynamics::mobility_left`] of Λ⁻¹, whose factors are `factor`.
    fn left(&self, factor: &Cholesky<6, T>) -> T {
        let inertia = &self.inverse_task_inertia;
        let parts = factor.diagonal().iter().enumerate().map(|(i, pivot)| *pivot / inertia[(i, i)]);
        parts.fold(T::one(), |least, part| least.min(part))
    }

    /// True if a direction of the tool is heavier than 1/[`HEAVY`]: the arm is near a singularity.
    pub fn is_singular(&self) -> bool {
        self.task_inertia().is_ok_and(|factor| factor.diagonal().iter().any(|pivot| *pivot < of(HEAVY)))
    }

    /// Wrench at the tool that moves it as the joint torques do: J̄ᵀτ of the arm alone.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub fn wrench(&self, torque: &[T; N]) -> Result<[T; 6], ControlError> {
        Ok(self.task_inertia()?.solve(&self.acceleration(torque)))
    }

    /// [`ArmDynamics::wrench`] of joint torques that are only estimated. An arm that is nearly singular feels a force along the
    /// axis that cannot move through a lever of millimetres: an error of 0.1 N·m looks like a push of 20 N. Below a mobility of
    /// 0.04 that axis counts for less, in the singular posture not at all, and every other one as before.
    ///
    /// ```
    /// use moca_wbc::opspace::ArmDynamics;
    /// use moca_wbc::robot::{MOCA_MOUNT, PANDA};
    /// use moca_wbc::{ArmModel, Payload};
    ///
    /// let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
    /// // the elbow is all but straight, and joint 4 seems to feel 0.1 N·m
    /// let torque = [0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0];
    /// let dynamics = model.dynamics(0.0, &[0.0, 0.5, 0.0, -0.451, 0.0, 1.2, 0.785], &[0.0; 7]);
    /// let arm = ArmDynamics::new(&dynamics)?;
    /// let length = |[x, y, z, ..]: [f64; 6]| x.hypot(y).hypot(z);
    /// assert!(length(arm.wrench(&torque)?) > 10.0);
    /// assert!(length(arm.felt_wrench(&torque)?) < 2.0);
    /// // at home nothing is left out
    /// let dynamics = model.dynamics(0.0, &PANDA.home_rad, &[0.0; 7]);
    /// let arm = ArmDynamics::new(&dynamics)?;
    /// assert_eq!(arm.felt_wrench(&torque)?, arm.wrench(&torque)?);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub fn felt_wrench(&self, torque: &[T; N]) -> Result<[T; 6], ControlError> {
        let mut factor = Cholesky::unset();
        factorise(&self.inverse_task_inertia, &mut factor)?;
        let left = self.left(&factor);
        if left < of(FEELS_FROM) {
            factorise(&self.dulled(left), &mut factor)?;
        }
        Ok(solved(&factor, &self.acceleration(torque)))
    }

    /// Λ⁻¹ of an arm with the mobility `left`, whose weak axes are as light as an error of the estimate needs them.
    #[cold]
    fn dulled(&self, left: T) -> SMatrix<T, 6, 6> {
        let share = of::<T>(DULLED) * (T::one() - left / of(FEELS_FROM));
        let mut light = self.inverse_task_inertia;
        for i in 0..6 {
            light[(i, i)] *= T::one() + share;
        }
        light
    }

    /// Λ of the arm alone, as the factors of its inverse.
    #[inline]
    pub(crate) fn task_inertia(&self) -> Result<Cholesky<6, T>, ControlError> {
        Cholesky::new_shifted(&self.inverse_task_inertia).ok_or(SINGULAR)
    }

    /// M_A⁻¹ J_Aᵀ·F: what a wrench at the tool makes the joints do.
    pub(crate) fn response(&self, wrench: &[T; 6]) -> [T; N] {
        self.joint_acceleration(&transpose_times(self.dynamics.kinematics.arm_jacobian(), wrench))
    }

    /// M_A⁻¹ τ: what joint torques make the joints do on a standing base, rad/s².
    pub(crate) fn joint_acceleration(&self, torque: &[T; N]) -> [T; N] {
        self.mass.solve(torque)
    }
}

/// The whole robot as the tool frame sees it: M = blkdiag(M_v, M_A) of eq. (3) and J = \[J_B J_A\].
#[derive(Clone, Copy, Debug)]
pub struct TaskDynamics<'a, const N: usize, T> {
    virtual_mass: [T; 3],
    arm: &'a ArmDynamics<'a, N, T>,
}

impl<'a, const N: usize, T: Scalar> TaskDynamics<'a, N, T> {
    /// From the virtual mass (> 0) of the base and the arm on it.
    #[inline]
    pub fn new(virtual_mass: [T; 3], arm: &'a ArmDynamics<'a, N, T>) -> Self {
        Self { virtual_mass, arm }
    }

    /// The arm on the base.
    pub fn arm(&self) -> &'a ArmDynamics<'a, N, T> {
        self.arm
    }

    /// Λ⁻¹ = J M⁻¹ Jᵀ of base and arm together.
    #[inline]
    pub fn inverse_task_inertia(&self) -> SMatrix<T, 6, 6> {
        let mut sum = self.arm.inverse_task_inertia;
        self.add_base(&mut sum, &self.virtual_mass.map(|mass| T::one() / mass));
        sum
    }

    /// Adds J_B·diag(w)·J_Bᵀ: a planar base moves the tool in x, y and about z.
    #[inline]
    fn add_base(&self, sum: &mut SMatrix<T, 6, 6>, &[wx, wy, w]: &[T; 3]) {
        let lever = self.arm.dynamics.kinematics.tool_from_base();
        let (x, y) = (lever.x * w, -(lever.y * w));
        sum[(0, 0)] += wx - lever.y * y;
        sum[(1, 1)] += wy + lever.x * x;
        sum[(5, 5)] += w;
        for (i, j, value) in [(1, 0, lever.x * y), (5, 0, y), (5, 1, x)] {
            sum[(i, j)] += value;
            sum[(j, i)] += value;
        }
    }

    /// Λ⁻¹·F.
    #[inline]
    fn acceleration_of_wrench(&self, wrench: &[T; 6]) -> [T; 6] {
        let by_base = self.base_acceleration(&self.arm.dynamics.kinematics.force_on_base(wrench));
        sum(&times(&self.arm.inverse_task_inertia, wrench), &by_base)
    }

    /// J M⁻¹ τ: acceleration of the tool under generalised forces.
    #[inline]
    pub fn acceleration(&self, force: &WholeBodyForce<N, T>) -> [T; 6] {
        sum(&self.base_acceleration(&force.base), &self.arm.acceleration(&force.arm))
    }

    #[inline]
    fn base_acceleration(&self, force: &[T; 3]) -> [T; 6] {
        self.arm
            .dynamics
            .kinematics
            .twist_from_base(&core::array::from_fn(|i| force[i] / self.virtual_mass[i]))
    }

    /// J̄ᵀτ of base and arm together.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub fn wrench(&self, force: &WholeBodyForce<N, T>) -> Result<[T; 6], ControlError> {
        let factor = Cholesky::new_shifted(&self.inverse_task_inertia()).ok_or(SINGULAR)?;
        Ok(factor.solve(&self.acceleration(force)))
    }
}

/// Acceleration per force, 1/kg and 1/(kg·m²), below which a direction of the arm counts as near a singularity: 50 kg.
pub const HEAVY: f64 = 0.02;
/// Mobility from which on an arm feels a wrench at its tool along every axis. At home the Panda has 0.157, the UR10e 0.071.
const FEELS_FROM: f64 = 0.04;
/// Share by which every axis of the tool is lighter to a singular arm that feels.
const DULLED: f64 = 0.1;

const SINGULAR: ControlError = ControlError::NotPositiveDefinite { what: "J M⁻¹ Jᵀ" };

/// H = blkdiag(η_B·I, η_A·I), eq. (9). Only η_B/η_A matters. H commutes with M, so that W⁻¹M⁻¹ = H⁻²; with
/// ρ = (η_B/η_A)² eq. (6) is (A_B + ρ A_A)·y = Λ⁻¹F − J M⁻¹τ_0, τ_v = τ_0B + J_Bᵀy, τ_A = τ_0A + ρ J_Aᵀy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockWeight<T> {
    /// Weights of base and arm, the larger one 1.
    base: T,
    arm: T,
}

impl<T: Scalar> BlockWeight<T> {
    /// From η_B and η_A, both > 0: the block with the larger gain departs less from its τ_0.
    #[inline]
    pub fn new(eta_base: T, eta_arm: T) -> Self {
        let (b, a) = (eta_base * eta_base, eta_arm * eta_arm);
        if a >= b { Self { base: T::one(), arm: b / a } } else { Self { base: a / b, arm: T::one() } }
    }

    /// Factorises A_B + ρ A_A.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if it is not even semi-definite (NaN).
    #[inline]
    pub fn factor<'a, const N: usize>(
        &self,
        task: &'a TaskDynamics<'a, N, T>,
    ) -> Result<BlockWeighted<'a, N, T>, ControlError> {
        let mut weighted = self.of(task);
        weighted.factorise()?;
        Ok(weighted)
    }

    /// Weight of `task`, not factorised yet: room for factors that are computed where they stand.
    #[inline]
    pub fn of<'a, const N: usize>(&self, task: &'a TaskDynamics<'a, N, T>) -> BlockWeighted<'a, N, T> {
        BlockWeighted { task, weight: *self, factor: Cholesky::unset() }
    }
}

/// A robot and a block weight, factorised: eq. (6) for any F and τ_0.
#[derive(Clone, Copy, Debug)]
pub struct BlockWeighted<'a, const N: usize, T> {
    task: &'a TaskDynamics<'a, N, T>,
    weight: BlockWeight<T>,
    factor: Cholesky<6, T>,
}

/// Λ⁻¹F, and the part of J M⁻¹τ_0 that the arm has: what stays as it is while only the base's part changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Goal<T> {
    wanted: [T; 6],
    by_arm: [T; 6],
}

impl<const N: usize, T: Scalar> BlockWeighted<'_, N, T> {
    /// Becomes what [`BlockWeight::factor`] gives.
    ///
    /// # Errors
    /// As [`BlockWeight::factor`].
    #[inline]
    pub fn factorise(&mut self) -> Result<(), ControlError> {
        let Self { task, weight, factor } = self;
        let mut weighted = task.arm.inverse_task_inertia * weight.arm;
        task.add_base(&mut weighted, &task.virtual_mass.map(|mass| weight.base / mass));
        factorise(&weighted, factor)
    }

    /// τ_c for the wrench F at the tool and the null-space forces τ_0. eq. (6)
    #[inline]
    pub fn force(&self, wrench: &[T; 6], null: &WholeBodyForce<N, T>) -> WholeBodyForce<N, T> {
        let y = self.multiplier(&self.goal(wrench, &null.arm), &null.base);
        WholeBodyForce { base: self.base_force(&y, &null.base), arm: self.arm_force(&y, &null.arm) }
    }

    /// Computes the effect of F and of the arm's part of τ_0 on the tool.
    #[inline]
    pub(crate) fn goal(&self, wrench: &[T; 6], null_arm: &[T; N]) -> Goal<T> {
        let wanted = self.task.acceleration_of_wrench(wrench);
        Goal { wanted, by_arm: self.task.arm.acceleration(null_arm) }
    }

    /// y of eq. (6).
    #[inline]
    pub(crate) fn multiplier(&self, goal: &Goal<T>, null_base: &[T; 3]) -> [T; 6] {
        let by_base = self.task.base_acceleration(null_base);
        solved(&self.factor, &difference(&goal.wanted, &sum(&by_base, &goal.by_arm)))
    }

    /// τ_v of eq. (6).
    #[inline]
    pub(crate) fn base_force(&self, y: &[T; 6], null_base: &[T; 3]) -> [T; 3] {
        let base = self.task.arm.dynamics.kinematics.force_on_base(y);
        core::array::from_fn(|i| null_base[i] + self.weight.base * base[i])
    }

    /// τ_A of eq. (6).
    #[inline]
    pub(crate) fn arm_force(&self, y: &[T; 6], null_arm: &[T; N]) -> [T; N] {
        let arm = transpose_times(self.task.arm.dynamics.kinematics.arm_jacobian(), y);
        core::array::from_fn(|i| null_arm[i] + self.weight.arm * arm[i])
    }

    /// S = M_v − J_Bᵀ(A_B + ρ A_A)⁻¹J_B, symmetric: S·M_v⁻¹·f is what the null space leaves of a force f on the base.
    pub fn free_base_mass(&self) -> SMatrix<T, 3, 3> {
        let inverse = self.factor.inverse_diagonal();
        let columns = self
            .task
            .arm
            .dynamics
            .kinematics
            .base_jacobian()
            .data
            .0
            .map(|column| self.factor.solve_lower(&column));
        let mut out = SMatrix::<T, 3, 3>::zeros();
        for (i, column) in columns.iter().enumerate() {
            let scaled = core::array::from_fn(|k| -self.weight.base * column[k] * inverse[k]);
            for j in 0..=i {
                let value = dot(&scaled, &columns[j]);
                out[(i, j)] = value;
                out[(j, i)] = value;
            }
            out[(i, i)] += self.task.virtual_mass[i];
        }
        out
    }
}

/// Any positive diagonal H: one gain per base axis and per joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisWeight<const N: usize, T> {
    base: [T; 3],
    arm: [T; N],
}

impl<const N: usize, T: Scalar> AxisWeight<N, T> {
    /// From the gains of base (x, y, yaw) and arm.
    ///
    /// # Errors
    /// The first gain outside 1e-3 to 1e3.
    pub fn new(base: [f64; 3], arm: [f64; N]) -> Result<Self, ParameterError> {
        let (min, max) = (1e-3, 1e3);
        match base.iter().chain(&arm).find(|&&gain| !(gain >= min && gain <= max)) {
            Some(&value) => Err(ParameterError { name: "eta", value, unit: "", min, max }),
            None => Ok(Self { base: base.map(of), arm: arm.map(of) }),
        }
    }

    /// τ_c for the wrench F at the tool and the null-space forces τ_0, by Z = H⁻¹M⁻¹Jᵀ, V = LᵀZ,
    /// (VᵀDV)·y = Λ⁻¹F − J M⁻¹τ_0, τ = τ_0 + H⁻¹M Z y. eq. (6)
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if the weighted Λ⁻¹ is not even semi-definite (NaN).
    #[inline]
    pub fn force(
        &self,
        task: &TaskDynamics<'_, N, T>,
        wrench: &[T; 6],
        null: &WholeBodyForce<N, T>,
    ) -> Result<WholeBodyForce<N, T>, ControlError> {
        let arm = &task.arm.mass;
        let mut z = task.arm.reduced.data.0;
        for (row, &inverse) in z.iter_mut().zip(arm.inverse_diagonal()) {
            *row = row.map(|value| value * inverse);
        }
        let mut z = arm.solve_upper_rows(&z);
        for (row, &gain) in z.iter_mut().zip(&self.arm) {
            *row = row.map(|value| value / gain);
        }
        let v: SMatrix<T, 6, N> = SMatrix::from(arm.transpose_times_rows(&z));
        let base_weights =
            core::array::from_fn(|i| T::one() / (self.base[i] * self.base[i] * task.virtual_mass[i]));
        let mut weighted = weighted_outer(&v, arm.diagonal());
        task.add_base(&mut weighted, &base_weights);
        let factor = Cholesky::new_shifted(&weighted).ok_or(SINGULAR)?;
        let y = factor.solve(&difference(&task.acceleration_of_wrench(wrench), &task.acceleration(null)));
        let along = transpose_times(&v, &y);
        let arm = arm.times(&core::array::from_fn(|i| arm.diagonal()[i] * along[i]));
        let base = task.arm.dynamics.kinematics.force_on_base(&y);
        Ok(WholeBodyForce {
            base: core::array::from_fn(|i| null.base[i] + base[i] / (self.base[i] * self.base[i])),
            arm: core::array::from_fn(|i| null.arm[i] + arm[i] / self.arm[i]),
        })
    }
}

/// `factor` becomes that of a Λ⁻¹: returned, it would be copied.
#[inline]
fn factorise<T: Scalar>(
    inverse_task_inertia: &SMatrix<T, 6, 6>,
    factor: &mut Cholesky<6, T>,
) -> Result<(), ControlError> {
    if factor.factorise_shifted(inverse_task_inertia) { Ok(()) } else { Err(SINGULAR) }
}

/// Λ·a. Its code is long, and once for all who call it in a step.
#[inline(never)]
fn solved<T: Scalar>(factor: &Cholesky<6, T>, acceleration: &[T; 6]) -> [T; 6] {
    factor.solve(acceleration)
}

#[inline]
fn difference<T: Scalar>(a: &[T; 6], b: &[T; 6]) -> [T; 6] {
    core::array::from_fn(|i| a[i] - b[i])
}

#[inline]
fn sum<T: Scalar>(a: &[T; 6], b: &[T; 6]) -> [T; 6] {
    core::array::from_fn(|i| a[i] + b[i])
}

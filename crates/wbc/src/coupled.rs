//! The whole plant with its physical base: what a simulator integrates, not what the law of eq. (3) uses.
//!
//! ```
//! use moca_wbc::coupled::CoupledDynamics;
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA, SUMMIT_XL};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let kinematics = model.kinematics(0.0, &PANDA.home_rad);
//! let inertias = model.link_inertias(&kinematics);
//! let plant = CoupledDynamics::new(&model, &SUMMIT_XL, &kinematics, &inertias, &[0.0; 3], &[0.0; 7]);
//! let mass_kg = plant.base[(0, 0)];
//! assert!(mass_kg > SUMMIT_XL.mass_kg && mass_kg < SUMMIT_XL.mass_kg + 20.0, "base and arm together");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::model::{ArmModel, Kinematics, LinkInertias};
use crate::opspace::WholeBodyForce;
use crate::scalar::{Scalar, all, of};
use crate::spatial::{Inertia, Motion};
use moca_msgs::BaseTable;
use nalgebra::{SMatrix, Vector3};

/// Mass matrix \[base coupling; couplingᵀ arm\] and bias of base and arm together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledDynamics<const N: usize, T> {
    /// Base block, world x, y, yaw: kg, kg·m, kg·m².
    pub base: SMatrix<T, 3, 3>,
    /// M_AB: arm rows, base columns.
    pub coupling: SMatrix<T, N, 3>,
    /// M_A.
    pub arm: SMatrix<T, N, N>,
    /// Coriolis and gravity forces.
    pub bias: WholeBodyForce<N, T>,
}

impl<const N: usize, T: Scalar> CoupledDynamics<N, T> {
    /// For `base` with link 0 and the arm on it, at joint and base rates (world x, y, yaw).
    pub fn new(
        model: &ArmModel<N, T>,
        base: &BaseTable,
        kinematics: &Kinematics<N, T>,
        inertias: &LinkInertias<N, T>,
        base_velocity_world: &[T; 3],
        dq: &[T; N],
    ) -> Self {
        let mass = kinematics.mass_matrix(inertias);
        let standing = base_inertia(base, kinematics) + model.link0_inertia(kinematics);
        let total = standing + inertias.total();
        let mut block = SMatrix::<T, 3, 3>::zeros();
        for axis in 0..3 {
            let mut unit = [T::zero(); 3];
            unit[axis] = T::one();
            let momentum = total.times(&kinematics.base_motion(&unit));
            block.set_column(axis, &Vector3::from(kinematics.planar(&momentum)));
        }
        let velocity = kinematics.base_motion(base_velocity_world);
        let acceleration = base_drift(base_velocity_world) + Kinematics::<N, T>::against_gravity();
        let (arm_bias, arm_force) = kinematics.newton_euler(inertias, dq, velocity, acceleration);
        let force = arm_force + standing.rate_of_momentum(&velocity, &acceleration);
        Self {
            base: block,
            coupling: mass.base_coupling,
            arm: mass.arm,
            bias: WholeBodyForce { base: kinematics.planar(&force), arm: arm_bias },
        }
    }
}

/// Spatial acceleration of the base at constant rates: its yaw axis is carried along.
fn base_drift<T: Scalar>([vx, vy, yaw_rate]: &[T; 3]) -> Motion<T> {
    let linear = Vector3::new(*vx, *vy, T::zero()).cross(&Vector3::new(T::zero(), T::zero(), *yaw_rate));
    Motion { angular: Vector3::zeros(), linear }
}

/// Inertia of the mobile base about A's origin, world axes.
fn base_inertia<const N: usize, T: Scalar>(base: &BaseTable, kinematics: &Kinematics<N, T>) -> Inertia<T> {
    let yaw_axes = kinematics.base_rotation;
    let com = yaw_axes * Vector3::from(all::<3, T>(&base.com_m)) - kinematics.arm_from_base;
    let [xx, yy, zz] = all::<3, T>(&base.inertia_com_diagonal);
    let zero = T::zero();
    let inertia = crate::spatial::rotate_symmetric(&yaw_axes, &[xx, zero, zero, yy, zero, zz]);
    Inertia::about(of(base.mass_kg), &com, &inertia)
}

//! The whole plant with its physical base: what a simulator integrates, not what the law of eq. (3) uses.
//!
//! ```
//! use moca_wbc::coupled::CoupledDynamics;
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA, SUMMIT_XL};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let plant = CoupledDynamics::new(&model, &SUMMIT_XL, (0.0, &PANDA.home_rad), (&[0.0; 3], &[0.0; 7]));
//! let mass_kg = plant.base[(0, 0)];
//! assert!(mass_kg > SUMMIT_XL.mass_kg && mass_kg < SUMMIT_XL.mass_kg + 20.0, "base and arm together");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::model::{ArmModel, Kinematics};
use crate::opspace::WholeBodyForce;
use crate::scalar::{Scalar, all, of};
use crate::spatial::Inertia;
use moca_msgs::BaseTable;
use nalgebra::{SMatrix, Vector3};

/// Mass matrix \[base coupling; couplingᵀ arm\] and bias of base and arm together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledDynamics<const N: usize, T> {
    /// Where everything is.
    pub kinematics: Kinematics<N, T>,
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
    /// For `base` with link 0 and the arm on it, at its yaw and the joint angles, and at its rates (world x, y, yaw) and
    /// theirs.
    pub fn new(
        model: &ArmModel<N, T>,
        base: &BaseTable,
        (yaw, q): (T, &[T; N]),
        (base_velocity_world, dq): (&[T; 3], &[T; N]),
    ) -> Self {
        let yaw_rate = base_velocity_world[2];
        let on_base = model.on_moving_base(yaw, q, yaw_rate, dq);
        let kinematics = on_base.arm.kinematics;
        let own = own_inertia(base);
        let Inertia { mass, first_moment, rotational } = own + on_base.inertia;
        let zero = T::zero();
        // a planar base knows of its load the mass, where it is from above, and how it resists turning about the vertical
        let [hx, hy, _] = kinematics.heading.to_world([first_moment.x, first_moment.y, zero]);
        let inwards = Vector3::new(own.first_moment.x, own.first_moment.y, zero) * (-yaw_rate * yaw_rate);
        let force = on_base.force + inwards;
        Self {
            base: SMatrix::from([[mass, zero, -hy], [zero, mass, hx], [-hy, hx, rotational[5]]]),
            coupling: on_base.arm.base_coupling,
            arm: on_base.arm.mass,
            bias: WholeBodyForce {
                base: kinematics.heading.to_world([force.x, force.y, on_base.moment.z]),
                arm: on_base.arm.bias,
            },
            kinematics,
        }
    }
}

/// Of the mobile base in its own axes, about its origin.
fn own_inertia<T: Scalar>(base: &BaseTable) -> Inertia<T> {
    let [xx, yy, zz] = all::<3, T>(&base.inertia_com_diagonal);
    let zero = T::zero();
    Inertia::about(
        of(base.mass_kg),
        &Vector3::from(all::<3, T>(&base.com_m)),
        &[xx, zero, zero, yy, zero, zz],
    )
}

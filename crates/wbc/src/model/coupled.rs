//! The whole plant with its physical base: what a simulator integrates, not what the law of eq. (3) uses.
//!
//! ```
//! use moca_wbc::coupled::CoupledDynamics;
//! use moca_wbc::opspace::WholeBodyForce;
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA, SUMMIT_XL};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let plant = CoupledDynamics::new(&model, &SUMMIT_XL, (0.0, &PANDA.home_rad), (&[0.0; 3], &[0.0; 7]));
//! let mass_kg = plant.base[(0, 0)];
//! assert!(mass_kg > SUMMIT_XL.mass_kg && mass_kg < SUMMIT_XL.mass_kg + 20.0, "base and arm together");
//! // what holds it against gravity holds it
//! let held = WholeBodyForce { base: plant.base_bias, arm: plant.arm.bias };
//! assert_eq!(plant.acceleration(&held, (&[0.0; 3], &[0.0; 7])), Some(([0.0; 3], [0.0; 7])));
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::linalg::{Cholesky, dot};
use crate::model::{ArmModel, Dynamics};
use crate::opspace::WholeBodyForce;
use crate::scalar::{Scalar, all, of, same};
use crate::spatial::Inertia;
use moca_msgs::BaseTable;
use nalgebra::{SMatrix, Vector3};

/// Mass matrix \[base couplingᵀ; coupling arm\] and bias of base and arm together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledDynamics<const N: usize, T> {
    /// Kinematics, M_A, M_AB and the bias of the arm, which the turning of the base is part of.
    pub arm: Dynamics<N, T>,
    /// Base block, world x, y, yaw: kg, kg·m, kg·m².
    pub base: SMatrix<T, 3, 3>,
    /// Coriolis forces on the base, world x, y, yaw: N, N, N·m.
    pub base_bias: [T; 3],
    /// Inertia of the mobile base alone, in its own axes, about its origin.
    own: Inertia<T>,
}

impl<const N: usize, T: Scalar> CoupledDynamics<N, T> {
    /// For `base` with link 0 and the arm on it, at its yaw and the joint angles, and at its rates (world x, y, yaw) and
    /// theirs.
    pub fn new(
        model: &ArmModel<N, T>,
        base: &BaseTable,
        place: (T, &[T; N]),
        rates: (&[T; 3], &[T; N]),
    ) -> Self {
        let mut dynamics = Self {
            arm: Dynamics::unset(),
            base: SMatrix::zeros(),
            base_bias: [T::zero(); 3],
            own: own_inertia(base),
        };
        dynamics.update(model, place, rates);
        dynamics
    }

    /// Becomes what [`CoupledDynamics::new`] gives for the same base: nothing is copied.
    pub fn update(
        &mut self,
        model: &ArmModel<N, T>,
        (yaw, q): (T, &[T; N]),
        (base_velocity_world, dq): (&[T; 3], &[T; N]),
    ) {
        let yaw_rate = base_velocity_world[2];
        let load = model.on_moving_base((yaw, q), (yaw_rate, dq), &mut self.arm);
        let own = &self.own;
        let Inertia { mass, first_moment, rotational } = *own + load.inertia;
        let (zero, heading) = (T::zero(), &self.arm.kinematics.heading);
        // a planar base knows of its load the mass, where it is from above, and how it resists turning about the vertical
        let [hx, hy, _] = heading.to_world([first_moment.x, first_moment.y, zero]);
        let inwards = Vector3::new(own.first_moment.x, own.first_moment.y, zero) * (-yaw_rate * yaw_rate);
        let force = load.force + inwards;
        self.base = SMatrix::from([[mass, zero, -hy], [zero, mass, hx], [-hy, hx, rotational[5]]]);
        self.base_bias = heading.to_world([force.x, force.y, load.moment.z]);
    }

    /// (M + diag(added))⁻¹·(`force` − bias): accelerations of base (world x, y, yaw: m/s², m/s², rad/s²) and arm (rad/s²)
    /// under forces on every joint, with inertias (kg, kg·m²) added to theirs, as implicit dampers and springs do. `None`
    /// if the matrix is not positive definite, or not finite.
    ///
    /// The base is eliminated first, whose block is almost diagonal: what is left to be factorised is the arm's.
    pub fn acceleration(
        &self,
        force: &WholeBodyForce<N, T>,
        (added_base, added_arm): (&[T; 3], &[T; N]),
    ) -> Option<([T; 3], [T; N])> {
        // x and y do not know of each other, yaw knows of both
        let [x, y, yaw] = self.arm.base_coupling.data.0;
        let [_, _, [to_x, to_y, yaw_block]] = self.base.data.0;
        let [pivot_x, pivot_y] = core::array::from_fn(|i| self.base[(i, i)] + added_base[i]);
        let (inverse_x, inverse_y) = (T::one() / pivot_x, T::one() / pivot_y);
        let (of_x, of_y) = (to_x * inverse_x, to_y * inverse_y);
        let pivot_yaw = yaw_block + added_base[2] - (to_x * of_x + to_y * of_y);
        let inverse_yaw = T::one() / pivot_yaw;
        if !((pivot_x > T::zero()) & (pivot_y > T::zero()) & (pivot_yaw > T::zero())) {
            return None;
        }
        let yaw: [T; N] = core::array::from_fn(|i| yaw[i] - (of_x * x[i] + of_y * y[i]));
        let [left_x, left_y, left_yaw] = core::array::from_fn(|i| force.base[i] - self.base_bias[i]);
        let left_yaw = left_yaw - (of_x * left_x + of_y * left_y);
        let left: [T; N] = core::array::from_fn(|i| {
            let by_base =
                x[i] * (inverse_x * left_x) + y[i] * (inverse_y * left_y) + yaw[i] * (inverse_yaw * left_yaw);
            force.arm[i] - self.arm.bias[i] - by_base
        });
        // column by column, which compilers take at once
        let column = |j: usize| {
            let [x_j, y_j, yaw_j] = [x[j] * inverse_x, y[j] * inverse_y, yaw[j] * inverse_yaw];
            core::array::from_fn(|i| self.arm.mass[(i, j)] - (x[i] * x_j + y[i] * y_j + yaw[i] * yaw_j))
        };
        let mut mass = SMatrix::<T, N, N>::from(core::array::from_fn(column));
        if !same(added_arm, &[T::zero(); N]) {
            for i in 0..N {
                mass[(i, i)] += added_arm[i];
            }
        }
        let arm = Cholesky::new(&mass)?.solve(&left);
        let base_yaw = (left_yaw - dot(&yaw, &arm)) * inverse_yaw;
        let base_x = (left_x - dot(&x, &arm)) * inverse_x - of_x * base_yaw;
        let base_y = (left_y - dot(&y, &arm)) * inverse_y - of_y * base_yaw;
        Some(([base_x, base_y, base_yaw], arm))
    }
}

/// Returns the inertia of the mobile base in its own axes, about its origin.
fn own_inertia<T: Scalar>(base: &BaseTable) -> Inertia<T> {
    let [xx, yy, zz] = all::<3, T>(&base.inertia_com_diagonal);
    let zero = T::zero();
    Inertia::about(
        of(base.mass_kg),
        &Vector3::from(all::<3, T>(&base.com_m)),
        &[xx, zero, zero, yy, zero, zz],
    )
}

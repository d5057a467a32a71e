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

use crate::linalg::Cholesky;
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
    /// The arm is eliminated first, so that what is factorised are its own block and a 3×3 one.
    pub fn acceleration(
        &self,
        force: &WholeBodyForce<N, T>,
        (added_base, added_arm): (&[T; 3], &[T; N]),
    ) -> Option<([T; 3], [T; N])> {
        let mut base = self.base;
        // not copied where nothing is added
        let mut heavier;
        let mass = if same(added_arm, &[T::zero(); N]) {
            &self.arm.mass
        } else {
            heavier = self.arm.mass;
            for i in 0..N {
                heavier[(i, i)] += added_arm[i];
            }
            &heavier
        };
        let factor = Cholesky::new(mass)?;
        let [x, y, yaw] = self.arm.base_coupling.data.0;
        let columns = core::array::from_fn(|i| [x[i], y[i], yaw[i], force.arm[i] - self.arm.bias[i]]);
        let solved = factor.solve_lower_rows::<4>(&columns);
        let mut left: [T; 3] = core::array::from_fn(|i| force.base[i] - self.base_bias[i]);
        for (row, &inverse) in solved.iter().zip(factor.inverse_diagonal()) {
            for i in 0..3 {
                let scaled = row[i] * inverse;
                left[i] -= scaled * row[3];
                for j in i..3 {
                    base[(j, i)] -= scaled * row[j];
                }
            }
        }
        for i in 0..3 {
            base[(i, i)] += added_base[i];
        }
        let base = Cholesky::new(&base)?.solve(&left);
        let rest = core::array::from_fn(|i| {
            let [x, y, yaw, own] = solved[i];
            [(own - x * base[0] - y * base[1] - yaw * base[2]) * factor.inverse_diagonal()[i]]
        });
        Some((base, factor.solve_upper_rows::<1>(&rest).map(|[value]| value)))
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

//! The tactile cover: from the forces of its taxels to one planar wrench on the base, eqs. (4)–(5).
//!
//! ```
//! use moca_wbc::cover_wrench;
//! use moca_wbc::robot::PAPER_COVER;
//!
//! let mut force_n = [0.0; 11];
//! (force_n[3], force_n[7]) = (15.0, 15.0); // T4 and T8, opposite corners
//! let [x, y, moment] = cover_wrench(&PAPER_COVER, &force_n);
//! assert!(f64::hypot(x, y) < 1e-12 && moment < -10.0, "a pure torque about the vertical");
//! ```

use crate::scalar::{Scalar, of};
use moca_msgs::{ParameterError, TaxelPlacement};

/// CoverMap wrench \[f_x N, f_y N, m_z N·m\] in B about its origin: the force **on** the robot, so that a push moves the
/// base away from it. `force_n` is in compression, ≥ 0. eq. (4)
pub fn cover_wrench<const K: usize, T: Scalar>(taxels: &[TaxelPlacement; K], force_n: &[T; K]) -> [T; 3] {
    CoverMap::from_table(taxels).wrench(force_n)
}

/// The constant of eq. (4): what each taxel adds to the wrench per newton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoverMap<const K: usize, T> {
    /// Per taxel: direction (x, y) in B and lever arm of the moment about B's origin, m.
    columns: [[T; 3]; K],
}

impl<const K: usize, T: Scalar> CoverMap<K, T> {
    /// # Errors
    /// The first position or angle that is not finite or not within 10 m or 10 rad.
    pub fn new(taxels: &[TaxelPlacement; K]) -> Result<Self, ParameterError> {
        for taxel in taxels {
            let [x, y] = taxel.position_base_m;
            for (name, unit, value) in [
                ("taxel position", "m", x),
                ("taxel position", "m", y),
                ("taxel angle", "rad", taxel.inward_angle_base_rad),
            ] {
                if !(-10.0..=10.0).contains(&value) {
                    return Err(ParameterError { name, value, unit, min: -10.0, max: 10.0 });
                }
            }
        }
        Ok(Self::from_table(taxels))
    }

    fn from_table(taxels: &[TaxelPlacement; K]) -> Self {
        Self {
            columns: taxels.map(|taxel| {
                let [x, y] = taxel.position_base_m;
                let (s, c) = nalgebra::ComplexField::sin_cos(taxel.inward_angle_base_rad);
                [of(c), of(s), of(x * s - y * c)]
            }),
        }
    }

    /// eq. (4); see [`cover_wrench`].
    #[inline]
    pub fn wrench(&self, force_n: &[T; K]) -> [T; 3] {
        let mut wrench = [T::zero(); 3];
        for (column, &force) in self.columns.iter().zip(force_n) {
            for (sum, &per_newton) in wrench.iter_mut().zip(column) {
                *sum += per_newton * force;
            }
        }
        wrench
    }
}

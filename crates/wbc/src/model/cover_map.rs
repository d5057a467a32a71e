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

/// Largest distance of two taxels that may feel one body, m: half a trunk.
pub const BODY_M: f64 = 0.3;
/// Least cosine of the angle between two taxels of one side of the cover.
pub const SAME_SIDE: f64 = 0.7;

/// Returns true if taxels with these unit directions inward are on one side of the cover.
pub(crate) fn on_one_side<T: Scalar>([x, y]: [T; 2], [to_x, to_y]: [T; 2]) -> bool {
    x * to_x + y * to_y > of(SAME_SIDE)
}

/// Distance of two places, m, squared.
pub(crate) fn squared<T: Scalar>(a: &[T; 2], b: &[T; 2]) -> T {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    x * x + y * y
}

/// Cover wrench \[f_x N, f_y N, m_z N·m\] in B about its origin: the force **on** the robot, so that a push moves the
/// base away from it. `force_n` is in compression, ≥ 0. eq. (4)
pub fn cover_wrench<const K: usize, T: Scalar>(taxels: &[TaxelPlacement; K], force_n: &[T; K]) -> [T; 3] {
    CoverMap::of_table(taxels).wrench(force_n)
}

/// The constant of eq. (4): what each taxel adds to the wrench per newton. Room for `K` taxels, and as many as its table
/// has: no step spends time on the places that are left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoverMap<const K: usize, T> {
    /// Per taxel: inward direction (x, y) in B and lever arm of the moment about B's origin, m.
    columns: [[T; 3]; K],
    count: usize,
}

impl<const K: usize, T: Scalar> CoverMap<K, T> {
    /// Builds the map of 0 to `K` taxels, T1 first.
    ///
    /// # Errors
    /// More than `K` taxels, or the first position or angle that is not finite or not within 10 m or 10 rad.
    pub fn new(taxels: &[TaxelPlacement]) -> Result<Self, ParameterError> {
        if taxels.len() > K {
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let (value, max) = (taxels.len() as f64, K as f64);
            return Err(ParameterError { name: "number of taxels", value, unit: "", min: 0.0, max });
        }
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
        Ok(Self::of_table(taxels))
    }

    /// Builds the map of the first `K` taxels.
    fn of_table(taxels: &[TaxelPlacement]) -> Self {
        let mut columns = [[T::zero(); 3]; K];
        for (column, taxel) in columns.iter_mut().zip(taxels) {
            let [x, y] = taxel.position_base_m;
            let (s, c) = nalgebra::ComplexField::sin_cos(taxel.inward_angle_base_rad);
            *column = [of(c), of(s), of(x * s - y * c)];
        }
        Self { columns, count: taxels.len().min(K) }
    }

    /// Returns the number of taxels.
    pub const fn taxels(&self) -> usize {
        self.count
    }

    /// Returns inward direction (x, y) in B of each taxel and its lever arm about B's origin, m.
    #[inline]
    pub(crate) fn columns(&self) -> &[[T; 3]] {
        &self.columns[..self.count]
    }

    /// eq. (4); see [`cover_wrench`].
    #[inline]
    pub fn wrench(&self, force_n: &[T; K]) -> [T; 3] {
        self.sum(force_n.iter().copied())
    }

    /// eq. (4) of forces that are computed one by one.
    #[inline]
    pub(crate) fn sum(&self, force_n: impl Iterator<Item = T>) -> [T; 3] {
        let mut wrench = [T::zero(); 3];
        for (column, force) in self.columns().iter().zip(force_n) {
            for (sum, &per_newton) in wrench.iter_mut().zip(column) {
                *sum += per_newton * force;
            }
        }
        wrench
    }
}

//! A^(−1/2) of a small symmetric positive-definite matrix.
//!
//! Reflections make A tridiagonal, a sum of rational functions takes the root of that, and the reflections turn it back: the
//! same steps for every A whose condition is ordinary. Any other is left to its eigenvalues. Both only turn the matrix, so
//! the result errs by ε times the condition of A, as that of any method that does not know A's factors.
//!
//! ```
//! use moca_wbc::nalgebra::Matrix2;
//! use moca_wbc::square_root::inverse_square_root;
//!
//! let a = Matrix2::new(5.0, 4.0, 4.0, 5.0); // eigenvalues 9 and 1
//! let root = inverse_square_root(&a).ok_or("not positive definite")?;
//! assert!((root * a * root - Matrix2::identity()).amax() < 1e-14);
//! assert!(inverse_square_root(&Matrix2::new(1.0, 2.0, 2.0, 1.0)).is_none());
//! assert!(inverse_square_root(&Matrix2::new(f64::NAN, 0.0, 0.0, 1.0)).is_none());
//! # Ok::<(), &str>(())
//! ```

mod eigenvalues;
mod poles;
mod tridiagonal;

use crate::scalar::Scalar;
use nalgebra::SMatrix;
use tridiagonal::Tridiagonal;

/// A^(−1/2) of a symmetric positive-definite matrix; `None` if it is not even semi-definite, or not finite. A direction
/// whose eigenvalue is lost in rounding, below 16·ε of the trace, is taken to have that one.
pub fn inverse_square_root<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>) -> Option<SMatrix<T, D, D>> {
    let mut root = *a;
    become_inverse_square_root(&mut root).then_some(root)
}

/// `a` becomes what [`inverse_square_root`] gives; false if that is `None`. Returned, it would be copied.
#[inline(never)]
pub(crate) fn become_inverse_square_root<const D: usize, T: Scalar>(a: &mut SMatrix<T, D, D>) -> bool {
    let mut t = Tridiagonal::unset();
    t.reduce(&mut a.data.0);
    if poles::inverse_square_root(&t, &mut a.data.0) {
        t.turn_back(&mut a.data.0);
        return true;
    }
    eigenvalues::inverse_square_root(&t).is_some_and(|root| {
        *a = root;
        true
    })
}

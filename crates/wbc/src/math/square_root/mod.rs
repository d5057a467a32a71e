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
    let mut root = SMatrix::<T, D, D>::identity();
    times_inverse_square_root(&mut a.clone(), &mut root.data.0).then_some(root)
}

/// B, D rows of C numbers, becomes A^(−1/2)·B; false if [`inverse_square_root`] has none. Nothing of A is left.
#[inline(never)]
pub(crate) fn times_inverse_square_root<const C: usize, const D: usize, T: Scalar>(
    a: &mut SMatrix<T, D, D>,
    b: &mut [[T; C]; D],
) -> bool {
    let mut t = Tridiagonal::unset();
    t.reduce(&mut a.data.0);
    t.turn_there(b);
    let found = poles::times_inverse_square_root(&t, b) || eigenvalues::times_inverse_square_root(&t, b);
    t.turn_back(b);
    found
}

/// aᵀ·b, every other product apart: half as many sums one after another.
#[inline]
fn in_pairs<const D: usize, T: Scalar>(a: &[T; D], b: &[T; D]) -> T {
    let products: [T; D] = core::array::from_fn(|i| a[i] * b[i]);
    let mut sums = [T::zero(); 2];
    for (i, &product) in products.iter().enumerate() {
        sums[i % 2] += product;
    }
    sums[0] + sums[1]
}

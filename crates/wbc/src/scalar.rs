//! The two scalars the crate is offered in.

use nalgebra::RealField;

mod sealed {
    #[cfg(not(feature = "serde"))]
    pub trait Sealed {}
    /// What a controller remembers in either scalar can be written down.
    #[cfg(feature = "serde")]
    pub trait Sealed: serde::Serialize + serde::de::DeserializeOwned {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// `f32` or `f64`.
pub trait Scalar: RealField + Copy + moca_qp::Scalar + sealed::Sealed {}
impl Scalar for f32 {}
impl Scalar for f64 {}

/// A constant in the scalar of the computation.
#[inline]
pub(crate) fn of<T: Scalar>(value: f64) -> T {
    nalgebra::convert(value)
}

/// `values` in the scalar of the computation.
#[inline]
pub(crate) fn all<const N: usize, T: Scalar>(values: &[f64; N]) -> [T; N] {
    values.map(of)
}

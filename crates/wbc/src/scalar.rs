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

/// What is computed for several numbers at once.
pub trait Abreast: Sized {
    /// Sines and cosines of four angles, rad, to the last digit but one: the same with every C library.
    fn sin_cos_of_four(angles: [Self; 4]) -> [[Self; 4]; 2];
}

impl Abreast for f32 {
    #[inline]
    fn sin_cos_of_four(angles: [Self; 4]) -> [[Self; 4]; 2] {
        let (sines, cosines) = wide::f32x4::from(angles).sin_cos();
        [sines.to_array(), cosines.to_array()]
    }
}

impl Abreast for f64 {
    #[inline]
    fn sin_cos_of_four(angles: [Self; 4]) -> [[Self; 4]; 2] {
        let (sines, cosines) = wide::f64x4::from(angles).sin_cos();
        [sines.to_array(), cosines.to_array()]
    }
}

/// `f32` or `f64`.
pub trait Scalar: RealField + Copy + moca_qp::Scalar + Abreast + sealed::Sealed {}
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

//! The two scalars the crate is offered in.

use nalgebra::RealField;

mod sealed {
    #[cfg(not(feature = "serde"))]
    pub trait Sealed {}
    /// Scalars whose controller memory can be written down.
    #[cfg(feature = "serde")]
    pub trait Sealed: serde::Serialize + serde::de::DeserializeOwned {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// Several numbers that are computed at once.
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

/// `value`, or the bound beyond which it is; `min` is not above `max`. `clamp` asks about that in every step.
#[inline]
pub(crate) fn between<T: Scalar>(value: T, min: T, max: T) -> T {
    let value = if value < min { min } else { value };
    if value > max { max } else { value }
}

/// Returns true if all are equal, without a branch for each.
#[inline]
pub(crate) fn same<T: Scalar>(a: &[T], b: &[T]) -> bool {
    a.iter().zip(b).fold(true, |same, (a, b)| same & (a == b))
}

/// `values` in the scalar of the computation.
#[inline]
pub(crate) fn all<const N: usize, T: Scalar>(values: &[f64; N]) -> [T; N] {
    values.map(of)
}

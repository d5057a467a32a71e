//! The two scalars that the crate is offered in.

use core::fmt::{Debug, Display};
use core::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

mod sealed {
    /// What only this crate calls.
    pub trait Sealed {
        /// 1/√x of a normal number within 4 %, without a root or a division: half the exponent, negated, and the mantissa with it.
        fn about_inverse_root(x: Self) -> Self;
    }

    impl Sealed for f32 {
        #[inline]
        fn about_inverse_root(x: Self) -> Self {
            Self::from_bits(0x5F37_5A86_u32.wrapping_sub(x.to_bits() >> 1))
        }
    }

    impl Sealed for f64 {
        #[inline]
        fn about_inverse_root(x: Self) -> Self {
            Self::from_bits(0x5FE6_EB50_C7B5_37A9_u64.wrapping_sub(x.to_bits() >> 1))
        }
    }
}

/// `f32` or `f64`. Its functions are no methods, so that they cannot be taken for those of another numeric trait.
pub trait Scalar:
    Copy
    + Debug
    + Display
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + sealed::Sealed
{
    /// 0.
    const NOTHING: Self;
    /// 1.
    const UNIT: Self;
    /// No bound.
    const UNBOUNDED: Self;
    /// Share of its terms by which a row may be outside: rounding.
    const KEPT: Self;
    /// The same where no step can do better, and the sine of the angle to the active rows below which a row is taken
    /// to depend on them: what nearly dependent rows lose.
    const LOOSE: Self;

    /// √x.
    fn root_of(x: Self) -> Self;
    /// |x|.
    fn size_of(x: Self) -> Self;
}

macro_rules! scalar {
    ($float:ty, root: $root:path, loose: $loose:literal) => {
        impl Scalar for $float {
            const NOTHING: Self = 0.0;
            const UNIT: Self = 1.0;
            const UNBOUNDED: Self = Self::INFINITY;
            const KEPT: Self = 64.0 * Self::EPSILON;
            const LOOSE: Self = $loose;

            #[inline]
            fn root_of(x: Self) -> Self {
                $root(x)
            }

            #[inline]
            fn size_of(x: Self) -> Self {
                x.abs()
            }
        }
    };
}

scalar!(f32, root: libm::sqrtf, loose: 1e-4);
scalar!(f64, root: libm::sqrt, loose: 1e-9);

/// a·b, summed in four parts, which a processor can do side by side.
#[inline]
pub(crate) fn dot<const N: usize, T: Scalar>(a: &[T; N], b: &[T; N]) -> T {
    let mut parts = [T::NOTHING; 4];
    for i in 0..N {
        let product = a[i] * b[i];
        parts[i % 4] = if i < 4 { product } else { parts[i % 4] + product };
    }
    (parts[0] + parts[2]) + (parts[1] + parts[3])
}

/// y + f·x.
#[inline]
pub(crate) fn add_scaled<const N: usize, T: Scalar>(y: &mut [T; N], f: T, x: &[T; N]) {
    for i in 0..N {
        y[i] += f * x[i];
    }
}

/// Whether a number is one: neither NaN nor infinite.
#[inline]
pub(crate) fn is_number<T: Scalar>(x: T) -> bool {
    T::size_of(x) < T::UNBOUNDED
}

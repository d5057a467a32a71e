//! The two scalars that the crate is offered in.

use core::fmt::{Debug, Display};
use core::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

/// Number of values that the last digits of a scalar can mark: a power of two.
pub(crate) const MARKS: u8 = 64;

mod sealed {
    use super::MARKS;

    /// Functions that only this crate calls.
    pub trait Sealed: Sized + 'static {
        /// Numbers from [`super::MARKS`] − 1 down to 0 as the last bits of a scalar.
        const MARKS: &[Self; MARKS as usize];

        /// 1/√x of a normal number within 4 %, without a root or a division: half the exponent, negated, and the mantissa with it.
        fn about_inverse_root(x: Self) -> Self;
        /// x with a mark in place of its last digits: the largest of many such says by itself which one it was. Infinity
        /// becomes the largest number, because it would be none with a mark.
        fn marked(x: Self, mark: Self) -> Self;
        /// The number that x is marked with.
        fn mark(x: Self) -> u8;
    }

    macro_rules! sealed {
        ($float:ty, bits: $bits:ty, inverse_root: $inverse_root:literal) => {
            impl Sealed for $float {
                const MARKS: &[Self; MARKS as usize] = &{
                    let mut marks = [0.0; MARKS as usize];
                    let mut i = 0;
                    while i < MARKS {
                        marks[i as usize] = Self::from_bits((MARKS - 1 - i) as $bits);
                        i += 1;
                    }
                    marks
                };

                #[inline]
                fn about_inverse_root(x: Self) -> Self {
                    Self::from_bits(<$bits>::wrapping_sub($inverse_root, x.to_bits() >> 1))
                }

                #[inline]
                fn marked(x: Self, mark: Self) -> Self {
                    let x = if x > Self::MAX { Self::MAX } else { x };
                    Self::from_bits(x.to_bits() & !<$bits>::from(MARKS - 1) | mark.to_bits())
                }

                #[inline]
                fn mark(x: Self) -> u8 {
                    x.to_bits().to_le_bytes()[0] & (MARKS - 1)
                }
            }
        };
    }

    sealed!(f32, bits: u32, inverse_root: 0x5F37_5A86);
    sealed!(f64, bits: u64, inverse_root: 0x5FE6_EB50_C7B5_37A9);
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
    /// The least positive number with all its digits.
    const LEAST: Self;
    /// Share of its terms by which a row may be outside: rounding.
    const KEPT: Self;
    /// Looser tolerance for a step that cannot improve, and smallest sine of the angle to the active rows at which a row
    /// counts as independent: the loss of nearly dependent rows.
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
            const LEAST: Self = Self::MIN_POSITIVE;
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

/// Returns true if `x` is finite.
#[inline]
pub(crate) fn is_number<T: Scalar>(x: T) -> bool {
    T::size_of(x) < T::UNBOUNDED
}

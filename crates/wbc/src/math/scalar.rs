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

/// A number whose sine and cosine take no branch, so that compilers compute several at once.
pub trait Abreast: Sized {
    /// Sine and cosine of an angle, rad, to the last digit but one: the same with every C library. NaN of an angle that is not
    /// finite, or that is too large for its quarter turn to be known.
    fn sin_cos_abreast(self) -> (Self, Self);
}

/// As Agner Fog's vector class library has them: `quarter` is π/2 in parts, which leave no rounding to a few turns, and
/// sin x = x + x³·`sine`(x²), cos x = 1 − x²/2 + x⁴·`cosine`(x²) within an eighth of a turn.
macro_rules! abreast {
    ($float:ident, $bits:ident, quarter: $quarter:expr, sine: $sine:expr, cosine: $cosine:expr) => {
        impl Abreast for $float {
            #[inline]
            fn sin_cos_abreast(self) -> (Self, Self) {
                // from here on to twice as much there are only whole numbers
                const WHOLE: $float = (1_u64 << ($float::MANTISSA_DIGITS - 1)) as $float;
                const SIGN: $bits = 1 << ($bits::BITS - 1);
                let size = self.abs();
                let quarters = size * core::$float::consts::FRAC_2_PI;
                let shifted = quarters + WHOLE;
                let (nearest, number) = (shifted - WHOLE, shifted.to_bits());
                let left = $quarter.iter().fold(size, |left, part| left - nearest * part);
                let x = if quarters < WHOLE { left } else { $float::NAN };
                let square = x * x;
                let s = x * square * $sine(square) + x;
                let c = square * square * $cosine(square) + (1.0 - square * 0.5);
                let (sin, cos) = if number & 1 == 0 { (s, c) } else { (c, s) };
                let sign_of = |number: $bits| (number << ($bits::BITS - 2)) & SIGN;
                let sign = sign_of(number) ^ (self.to_bits() & SIGN);
                (
                    $float::from_bits(sin.to_bits() ^ sign),
                    $float::from_bits(cos.to_bits() ^ sign_of(number.wrapping_add(1))),
                )
            }
        }
    };
}

abreast!(
    f64, u64,
    quarter: [1.570_796_310_901_641_8, 1.589_325_471_229_585_7e-8, 6.123_233_995_736_766e-17],
    sine: |x| polynomial(x, [
        -0.166_666_666_666_666_3,
        0.008_333_333_333_322_118,
        -0.000_198_412_698_295_895_4,
        2.755_731_362_138_572_2e-6,
        -2.505_074_776_285_780_7e-8,
        1.589_623_015_765_465_6e-10,
    ]),
    cosine: |x| polynomial(x, [
        0.041_666_666_666_666_595,
        -0.001_388_888_888_887_305_6,
        2.480_158_728_885_170_4e-5,
        -2.755_731_417_929_674e-7,
        2.087_570_084_197_473e-9,
        -1.135_853_652_138_768_2e-11,
    ])
);
abreast!(
    f32, u32,
    quarter: [1.570_312_5, 4.837_513e-4, 7.549_79e-8],
    sine: |x| x * x * -1.951_529_6e-4 + (x * 8.332_161e-3 - 0.166_666_55),
    cosine: |x| x * x * 2.443_315_7e-5 + (x * -1.388_731_6e-3 + 0.041_666_646)
);

/// Σ c_i·xⁱ, in as few steps one after another as it takes.
#[inline]
fn polynomial(x: f64, [c0, c1, c2, c3, c4, c5]: [f64; 6]) -> f64 {
    let square = x * x;
    (c3 * x + c2) * square + ((c5 * x + c4) * (square * square) + (c1 * x + c0))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_those_of_the_angle_to_the_last_digit_but_one() {
        for i in -40_000..=40_000 {
            let angle = f64::from(i) * 1e-3;
            let (sin, cos) = angle.sin_cos_abreast();
            assert!((sin - angle.sin()).abs() < 2e-16 && (cos - angle.cos()).abs() < 2e-16, "{angle}");
            let (narrow_sin, narrow_cos) = of::<f32>(angle).sin_cos_abreast();
            let angle = f64::from(of::<f32>(angle));
            let errors = [f64::from(narrow_sin) - angle.sin(), f64::from(narrow_cos) - angle.cos()];
            assert!(errors.iter().all(|error| error.abs() < 1.2e-7), "{angle}: {errors:?}");
        }
        assert_eq!((-0.0_f64).sin_cos_abreast().0.to_bits(), (-0.0_f64).to_bits());
    }

    #[test]
    fn an_angle_whose_quarter_turn_nobody_knows_has_no_sine() {
        for angle in [f64::INFINITY, -f64::INFINITY, f64::NAN, 1e16, -1e300] {
            assert!(angle.sin_cos_abreast().0.is_nan() && angle.sin_cos_abreast().1.is_nan(), "{angle}");
        }
        for angle in [f32::INFINITY, f32::NAN, 1e9] {
            assert!(angle.sin_cos_abreast().0.is_nan() && angle.sin_cos_abreast().1.is_nan(), "{angle}");
        }
    }
}

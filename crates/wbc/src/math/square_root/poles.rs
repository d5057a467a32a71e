//! T^(−1/2) of a tridiagonal matrix without its eigenvalues: Zolotarev's best rational approximation, whose poles do not wait
//! for each other as the rotations of an eigenvalue method do.
//!
//! On \[1/√κ, √κ\], r(z) = Σ w_j/(z + s_j) with √κ·s_j = (sn u_j/cn u_j)², κ^¼·w_j = 2K/(πn)·dn u_j/cn² u_j and u_j = (j − ½)·K/n,
//! all of modulus √(1 − 1/κ), has the least relative error of z^(−1/2) that n poles can have (Zolotarev 1877; Hale, Higham
//! and Trefethen, SIAM J. Numer. Anal. 46, 2008, method 3): 1.2e-16, half an ε, for n = 32 and κ = 10⁶. r(1/z)/z = r(z), as it
//! is of z^(−1/2): beside each pole s with its w there is one at 1/s with w/s.
//!
//! Entry (i, j) of (T + s)⁻¹ is the minor before row j times the one behind row i over the determinant, times what stands beside
//! the diagonal from j to i. Minors are polynomials in s, so that of all poles only n moments are needed, those of w/det(T + s):
//! Σ w·s^m/det. Every coefficient and every moment is positive, so that nothing cancels where they are put together; what
//! cancels does so where a minor is found of those with fewer rows, as in the determinant itself. Of T^(−1/2)·B, entries are put
//! together only where they are summed up: B's rows before each row, a power of s each, then those behind it.

use super::tridiagonal::{LARGEST, Tridiagonal};
use crate::scalar::{Scalar, of};

/// κ
const SPAN: f64 = 1e6;
/// s_j and w_j of half of the poles.
const HALF: [[f64; 2]; 16] = [
    [1.688_898_053_900_745_3e-5, 0.005_261_791_616_659_927],
    [0.000_158_923_614_479_487_1, 0.005_617_257_219_165_670_5],
    [0.000_482_022_278_058_607_74, 0.006_352_202_598_928_810_6],
    [0.001_074_968_635_123_939, 0.007_516_278_646_159_787_5],
    [0.002_100_697_525_529_254, 0.009_188_127_813_839_512],
    [0.003_841_068_199_194_115, 0.011_480_698_316_483_809],
    [0.006_774_317_935_955_953_6, 0.014_548_877_599_941_796],
    [0.011_706_481_985_227_736, 0.018_599_962_772_389_848],
    [0.019_992_899_862_948_495, 0.023_907_679_704_536_722],
    [0.033_910_696_287_313_13, 0.030_830_707_382_579_634],
    [0.057_284_649_458_466_85, 0.039_836_979_643_278_35],
    [0.096_538_595_613_513_54, 0.051_535_451_070_707_8],
    [0.162_461_757_046_408_72, 0.066_717_571_097_193_8],
    [0.273_176_696_624_353_84, 0.086_411_481_627_700_32],
    [0.459_128_230_889_621_8, 0.111_953_064_475_577_65],
    [0.771_474_845_743_238_7, 0.145_079_651_150_878_17],
];
/// Poles that are taken side by side.
const LANES: usize = 8;
/// s_j and w_j of all.
const POLES: [[[f64; LANES]; 2]; 2 * HALF.len() / LANES] = {
    let half = LANES / 2;
    let mut poles = [[[0.0; LANES]; 2]; 2 * HALF.len() / LANES];
    let mut i = 0;
    while i < HALF.len() {
        let ([s, w], group, lane) = (HALF[i], &mut poles[i / half], i % half);
        (group[0][lane], group[1][lane]) = (s, w);
        (group[0][lane + half], group[1][lane + half]) = (1.0 / s, w / s);
        i += 1;
    }
    poles
};

/// B, D rows of C numbers, becomes T^(−1/2)·B, exact but for rounding; false, and B as it was, unless T is positive definite
/// and its trace times that of T⁻¹ at most κ: no eigenvalue is then above the one, nor below the inverse of the other.
#[inline]
pub(super) fn times_inverse_square_root<const C: usize, const D: usize, T: Scalar>(
    t: &Tridiagonal<D, T>,
    b: &mut [[T; C]; D],
) -> bool {
    let trace = t.trace();
    let scale = of::<T>(SPAN).sqrt() / trace;
    let (diagonal, beside) = (t.diagonal.map(|d| d * scale), t.beside.map(|b| b * scale));
    let squares = beside.map(|b| b * b);
    let minors = Minors::of(&diagonal, &squares);
    let mut definite = trace > T::zero() && minors.determinant[0] > T::zero();
    let mut trace_of_inverse = T::zero();
    for (before, behind) in minors.before.iter().zip(&minors.behind) {
        definite &= *before > T::zero();
        trace_of_inverse += *before * behind[0];
    }
    // NaN is neither
    if !(definite && trace_of_inverse <= of::<T>(SPAN).sqrt() * minors.determinant[0]) {
        return false;
    }
    let behind = &minors.behind;
    let (mut of_row, mut of_last) = (moments(&minors.determinant), [T::zero(); D]);
    let (mut of_rows, mut sums) = ([[T::zero(); D]; D], [[T::zero(); C]; D]);
    // B's rows up to each one, by all that does not depend on the row of the result
    let mut there = [[T::zero(); C]; D];
    each_row::<D>(|i| {
        of_rows[i] = of_row;
        for m in 0..D - i {
            let here = b[i].map(|b| of_row[m] * b);
            there[m] = if i == 0 { here } else { less(here, beside[i - 1], there[m]) };
        }
        sums[i] = along(&behind[i], &there, D - i);
        // the minor before the next row, as it is of this and the last one; of its last moments nobody asks
        let mut next = [T::zero(); D];
        for m in 0..D - 1 - i {
            next[m] = diagonal[i] * of_row[m] + of_row[m + 1];
            if i > 0 {
                next[m] -= squares[i - 1] * of_last[m];
            }
        }
        (of_row, of_last) = (next, of_row);
    });
    // and B's rows behind it
    let mut back = [[T::zero(); C]; D];
    each_row::<D>(|row| {
        let i = D - 1 - row;
        if row > 0 {
            sums[i] = plus(sums[i], along(&of_rows[i], &back, row));
        }
        for m in 0..D - i {
            let here = b[i].map(|b| behind[i][m] * b);
            let all = if m < row { plus(here, back[m]) } else { here };
            back[m] = if i == 0 { all } else { all.map(|x| -beside[i - 1] * x) };
        }
    });
    let scale = scale.sqrt();
    *b = sums.map(|row| row.map(|x| x * scale));
    true
}

/// a + b.
#[inline(always)]
fn plus<const C: usize, T: Scalar>(a: [T; C], b: [T; C]) -> [T; C] {
    core::array::from_fn(|c| a[c] + b[c])
}

/// a − factor·b.
#[inline(always)]
fn less<const C: usize, T: Scalar>(a: [T; C], factor: T, b: [T; C]) -> [T; C] {
    core::array::from_fn(|c| a[c] - factor * b[c])
}

/// Σ weights_m·rows_m of the first `count`.
#[inline(always)]
fn along<const C: usize, const D: usize, T: Scalar>(
    weights: &[T; D],
    rows: &[[T; C]; D],
    count: usize,
) -> [T; C] {
    let mut sum = rows[0].map(|x| weights[0] * x);
    for m in 1..count {
        sum = core::array::from_fn(|c| sum[c] + weights[m] * rows[m][c]);
    }
    sum
}

/// Calls `f` for each row, written out instead of a loop: compilers then know which of a row's numbers are zero.
#[inline(always)]
fn each_row<const D: usize>(mut f: impl FnMut(usize)) {
    const { assert!(D <= LARGEST, "rows that it knows") }
    macro_rules! rows {
        ($($row:literal)*) => { $(if D > $row { f($row); })* };
    }
    rows!(0 1 2 3 4 5);
}

/// Σ w·s^m/det(T + s) over the poles, for m from 0 on, of the determinant's coefficients.
fn moments<const D: usize, T: Scalar>(determinant: &[T; D]) -> [T; D] {
    let mut sums = [[T::zero(); 2]; D];
    for group in &POLES {
        add_poles(&mut sums, determinant, group);
    }
    sums.map(|[a, b]| a + b)
}

/// Adds some poles' share of every moment: pair beside pair, which is what makes compilers take them at once.
#[inline(never)]
fn add_poles<const D: usize, T: Scalar>(
    sums: &mut [[T; 2]; D],
    determinant: &[T; D],
    [poles, weights]: &[[f64; LANES]; 2],
) {
    let poles = poles.map(of::<T>);
    let mut values = [T::one(); LANES];
    for &coefficient in determinant.iter().rev() {
        values = core::array::from_fn(|k| values[k] * poles[k] + coefficient);
    }
    let mut terms: [T; LANES] = core::array::from_fn(|k| of::<T>(weights[k]) / values[k]);
    for sum in sums {
        *sum = core::array::from_fn(|k| sum[k] + ((terms[k] + terms[k + 2]) + (terms[k + 4] + terms[k + 6])));
        terms = core::array::from_fn(|k| terms[k] * poles[k]);
    }
}

/// Minors of T + s, polynomials in s.
struct Minors<const D: usize, T> {
    /// Product of the rows before each, at s = 0.
    before: [T; D],
    /// Coefficients of those of the rows behind each, from s^0 on: one for each of these rows, and a 1.
    behind: [[T; D]; D],
    /// Coefficients of the determinant from s^0 on; that of s^D, which is 1, is left out.
    determinant: [T; D],
}

impl<const D: usize, T: Scalar> Minors<D, T> {
    /// `squares` are those of what stands beside the diagonal.
    #[inline]
    fn of(diagonal: &[T; D], squares: &[T; D]) -> Self {
        let zero = T::zero();
        let mut minors = Self { before: [zero; D], behind: [[zero; D]; D], determinant: [zero; D] };
        let (mut last, mut one_less, mut square) = (T::one(), zero, zero);
        for i in 0..D {
            minors.before[i] = last;
            (last, one_less) = (diagonal[i] * last - square * one_less, last);
            square = squares[i];
        }
        let (mut last, mut one_less) = ([zero; D], [zero; D]);
        last[0] = T::one();
        each_row::<D>(|row| {
            let i = D - 1 - row;
            minors.behind[i] = last;
            // (d + s) times the one with a row less, less b² times the one with two
            let mut next = [zero; D];
            for m in 0..row + 1 {
                next[m] = diagonal[i] * last[m];
                if m > 0 {
                    next[m] += last[m - 1];
                }
                if m < row {
                    next[m] -= squares[i] * one_less[m];
                }
            }
            if row + 1 < D {
                next[row + 1] = T::one();
            }
            (last, one_less) = (next, last);
        });
        minors.determinant = last;
        minors
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::square_root::eigenvalues;
    use nalgebra::{Matrix6, SMatrix};
    use std::f64::consts::PI;
    use std::vec::Vec;

    fn all_poles() -> impl Iterator<Item = [f64; 2]> {
        POLES.iter().flat_map(|[poles, weights]| poles.iter().zip(weights)).map(|(&s, &w)| [s, w])
    }

    /// K and sn, cn, dn of a parameter 1 − `complement`, by the arithmetic-geometric mean (Abramowitz and Stegun, 16.4, 17.6).
    fn elliptic(complement: f64) -> (f64, impl Fn(f64) -> [f64; 3]) {
        let mut means = std::vec![[1.0, complement.sqrt(), (1.0 - complement).sqrt()]];
        while let Some(&[a, b, c]) = means.last().filter(|[_, _, c]| *c > 1e-16) {
            means.push([0.5 * (a + b), (a * b).sqrt(), if c > 1e-8 { 0.5 * (a - b) } else { 0.0 }]);
        }
        let mean = means.last().unwrap()[0];
        let functions = move |u: f64| {
            let mut phi = (1 << (means.len() - 1)) as f64 * mean * u;
            for [a, _, c] in means[1..].iter().rev() {
                phi = 0.5 * (phi + (c / a * phi.sin()).asin());
            }
            let (sn, cn) = phi.sin_cos();
            [sn, cn, (cn * cn + complement * sn * sn).sqrt()]
        };
        (0.5 * PI / mean, functions)
    }

    #[test]
    fn the_table_is_zolotarevs() {
        let (quarter, functions) = elliptic(1.0 / SPAN);
        let count = (2 * HALF.len()) as f64;
        let mut poles: Vec<[f64; 2]> = all_poles().collect();
        poles.sort_by(|a, b| a[0].total_cmp(&b[0]));
        for (j, [s, w]) in poles.into_iter().enumerate() {
            let [sn, cn, dn] = functions((j as f64 + 0.5) * quarter / count);
            let (pole, weight) = ((sn / cn).powi(2), 2.0 * quarter / (PI * count) * dn / (cn * cn));
            assert!((s * SPAN.sqrt() / pole - 1.0).abs() < 1e-10, "pole {j}: {s}, {}", pole / SPAN.sqrt());
            assert!((w * SPAN.powf(0.25) / weight - 1.0).abs() < 1e-10, "weight {j}: {w}");
        }
    }

    #[test]
    fn the_sum_is_the_root_all_over_the_span_and_not_outside() {
        let r = |z: f64| all_poles().map(|[s, w]| w / (z + s)).sum::<f64>();
        let error = |z: f64| (z.sqrt() * r(z) - 1.0).abs();
        let worst = (0..=6000).map(|i| error(1e-3 * 10_f64.powf(f64::from(i) * 1e-3))).fold(0.0, f64::max);
        assert!(worst < 2e-15, "{worst}");
        assert!(error(1e-4) > 1e-8 && error(1e4) > 1e-8);
    }

    /// A tridiagonal matrix of eigenvalues from `least` to 1, evenly apart in their logarithms.
    fn spread_to(least: f64) -> Tridiagonal<6, f64> {
        let turned = nalgebra::Rotation3::from_euler_angles(0.3, 0.8, -0.5);
        let mut v = Matrix6::<f64>::identity();
        for corner in [0, 1, 2, 3] {
            let mut turn = Matrix6::<f64>::identity();
            turn.fixed_view_mut::<3, 3>(corner, corner).copy_from(turned.matrix());
            v *= turn;
        }
        let values = SMatrix::from_fn(|i, _| least.powf(f64::from(u8::try_from(i).unwrap()) / 5.0));
        let a: Matrix6<f64> = v * Matrix6::from_diagonal(&values) * v.transpose();
        Tridiagonal::of(&a.data.0)
    }

    /// V·F·Vᵀ of a symmetric F.
    fn turned<const D: usize>(t: &Tridiagonal<D, f64>, f: &[[f64; D]; D]) -> SMatrix<f64, D, D> {
        let mut half = *f;
        t.turn_back(&mut half);
        let mut whole = SMatrix::<f64, D, D>::from(half).transpose().data.0;
        t.turn_back(&mut whole);
        whole.into()
    }

    fn root_of<const D: usize>(t: &Tridiagonal<D, f64>) -> Option<SMatrix<f64, D, D>> {
        let mut root = SMatrix::<f64, D, D>::identity().data.0;
        times_inverse_square_root(t, &mut root).then(|| turned(t, &root))
    }

    #[test]
    fn poles_and_eigenvalues_give_the_same_root() {
        for least in [1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5] {
            let t = spread_to(least);
            let root = root_of(&t).unwrap();
            let mut other = Matrix6::identity().data.0;
            assert!(eigenvalues::times_inverse_square_root(&t, &mut other));
            let other = turned(&t, &other);
            let apart = (root - other).amax() / other.amax();
            assert!(apart < 8.0 * f64::EPSILON / least, "{least}: {apart}");
            let mut large = spread_to(least);
            large.diagonal = large.diagonal.map(|d| d * 1e40);
            large.beside = large.beside.map(|b| b * 1e40);
            let scaled = root_of(&large).unwrap() * 1e20;
            assert!((scaled - root).amax() < 1e-12 * root.amax());
        }
        assert!(root_of(&spread_to(1e-6)).is_none(), "its trace is above its largest eigenvalue");
    }

    #[test]
    fn span_is_that_of_the_trace_times_the_inverses_trace() {
        let has_root = |least: f64| {
            let mut t = Tridiagonal::of(&[[0.0; 2]; 2]);
            t.diagonal = [1.0, least];
            root_of(&t).is_some()
        };
        // 2 + least + 1/least
        assert!(has_root(1.001 / SPAN) && !has_root(0.999 / SPAN));
    }

    #[test]
    fn what_is_not_definite_or_no_number_has_no_root_here() {
        let none = |diagonal: [f64; 3], beside: [f64; 3]| {
            let mut t = Tridiagonal::of(&[[0.0; 3]; 3]);
            (t.diagonal, t.beside) = (diagonal, beside);
            root_of(&t).is_none()
        };
        assert!(!none([1.0; 3], [0.5, 0.5, 0.0]));
        assert!(none([1.0; 3], [0.8, 0.8, 0.0]), "an eigenvalue of 1 − 0.8·√2");
        assert!(none([-1.0; 3], [0.0; 3]));
        assert!(none([3.0, -0.001, -0.001], [0.0; 3]), "two negative ones: the determinant is positive");
        assert!(none([0.0; 3], [0.0; 3]));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(none([1.0, bad, 1.0], [0.0; 3]) && none([1.0; 3], [0.0, bad, 0.0]), "{bad}");
        }
        let root = root_of(&Tridiagonal::of(&[[4.0]])).unwrap();
        assert!((root[(0, 0)] - 0.5).abs() < 1e-15);
    }
}

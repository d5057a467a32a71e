//! Rows side by side, so that a processor looks at several of them at once.

use crate::row::Row;
use crate::scalar::Scalar;

/// Rows of a block.
pub(crate) const LANES: usize = 4;

/// Rows as columns, with normals of a length of about 1, so that the unit of a row does not matter.
#[derive(Clone, Copy)]
pub(crate) struct Block<const N: usize, T> {
    normal: [[T; LANES]; N],
    lower: [T; LANES],
    upper: [T; LANES],
}

impl<const N: usize, T: Scalar> Block<N, T> {
    /// Puts a block of `rows` in the place of `old`. Whether bounds make sense and squares are numbers above 0.
    pub(crate) fn replace(old: &mut Option<Self>, rows: &[Row<N, T>; LANES]) -> bool {
        let mut squared = [T::NOTHING; LANES];
        for i in 0..N {
            for lane in 0..LANES {
                squared[lane] += rows[lane].normal[i] * rows[lane].normal[i];
            }
        }
        let mut fine = true;
        for lane in 0..LANES {
            fine &= rows[lane].bounds_make_sense()
                & (squared[lane] < T::UNBOUNDED)
                & (squared[lane] > T::NOTHING);
        }
        let weight = squared.map(T::about_inverse_root);
        *old = Some(Self {
            normal: core::array::from_fn(|i| {
                core::array::from_fn(|lane| rows[lane].normal[i] * weight[lane])
            }),
            lower: core::array::from_fn(|lane| rows[lane].lower * weight[lane]),
            upper: core::array::from_fn(|lane| rows[lane].upper * weight[lane]),
        });
        fine
    }

    /// Sets the bounds of a row whose normal has a length of about 1.
    #[inline]
    pub(crate) fn set_bounds(&mut self, lane: usize, lower: T, upper: T) {
        (self.lower[lane], self.upper[lane]) = (lower, upper);
    }

    /// Returns the distance of x outside each row; negative inside.
    #[inline]
    fn violation(&self, x: &[T; N]) -> [T; LANES] {
        // in two parts, which a processor can do side by side
        let mut parts = [[T::NOTHING; LANES]; 2];
        for i in 0..N {
            for lane in 0..LANES {
                let product = self.normal[i][lane] * x[i];
                parts[i % 2][lane] = if i < 2 { product } else { parts[i % 2][lane] + product };
            }
        }
        let along: [T; LANES] = core::array::from_fn(|lane| parts[0][lane] + parts[1][lane]);
        core::array::from_fn(|lane| larger(self.lower[lane] - along[lane], along[lane] - self.upper[lane]))
    }
}

/// The largest violation, marked by its row: the earlier, the larger the mark. Not inlined, because a compiler that sees
/// more at once puts the lanes together in ways that cost more than they save.
#[inline(never)]
pub(crate) fn worst<const N: usize, T: Scalar>(blocks: &[Option<Block<N, T>>], x: &[T; N]) -> T {
    let mut worst = [T::LEAST; LANES];
    let (marks, _) = T::MARKS.as_chunks::<LANES>();
    for (block, marks) in blocks.iter().map_while(Option::as_ref).zip(marks) {
        let outside = block.violation(x);
        for lane in 0..LANES {
            worst[lane] = larger(T::marked(outside[lane], marks[lane]), worst[lane]);
        }
    }
    larger(larger(worst[0], worst[2]), larger(worst[1], worst[3]))
}

/// Selected, not branched: no processor could guess it.
#[inline]
pub(crate) fn larger<T: Scalar>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

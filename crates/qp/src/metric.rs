//! The cost, and the search for the least of it.

use crate::factor::{Factor, Step, replace_by_last};
use crate::lanes::{self, Block, LANES, larger};
use crate::row::Row;
use crate::scalar::{MARKS, Scalar, add_scaled, dot, is_number};
use crate::solution::{Active, QpError, Side, Solution, WorkingSet};

/// Most iterations for each variable and each row.
const ITERATIONS: usize = 4;
/// Rows of the first blocks, which are kept.
const IN_BLOCKS: usize = MARKS as usize;
/// Rows after those whose weights are kept together.
const TOGETHER: usize = 16;
/// Rows after those whose weights are kept. Those of further rows are computed each time.
const WEIGHTED: usize = 192;

/// Weights of rows in no block. `None` is quickly written, zeros would not be.
type Weights<T> = [Option<[T; TOGETHER]>; WEIGHTED / TOGETHER];

/// A quadratic cost ½(x − target)ᵀH(x − target), factored once: H is the metric in which a solution is nearest.
///
/// ```
/// use moca_qp::{Metric, Row, WorkingSet};
///
/// // x + y ≤ 1, wanted (1, 1): what leaving x costs four times as much as y gives way less.
/// let metric = Metric::new(&[[4.0, 0.0], [0.0, 1.0]])?;
/// let solution = metric.nearest(&[1.0, 1.0], &[Row::at_most([1.0, 1.0], 1.0)], &WorkingSet::EMPTY)?;
/// assert!((solution.x[0] - 0.8_f64).abs() < 1e-12 && (solution.x[1] - 0.2).abs() < 1e-12);
/// # Ok::<(), moca_qp::QpError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric<const N: usize, T = f64> {
    /// L⁻ᵀ as columns, H = LLᵀ.
    inverse_factor: [[T; N]; N],
}

/// The search's state.
struct Search<'a, const N: usize, T> {
    rows: &'a [Row<N, T>],
    target: &'a [T; N],
    factor: Factor<N, T>,
    x: [T; N],
    /// The first rows once more; active ones have no bounds there. `None` is quickly written, zeros would not be.
    /// Borrowed, because they would be copied when the rest is put in its place.
    blocks: &'a mut [Option<Block<N, T>>; IN_BLOCKS / LANES],
    /// By which the violations of the rows after those are multiplied: 0 for active ones, else about 1/‖normal‖.
    weights: &'a mut Weights<T>,
    active: [(usize, Side); N],
    /// Zero where nothing is active.
    multipliers: [T; N],
    iterations: usize,
    /// Share of its terms by which a row may be outside. Grows only where no step can do better.
    kept: T,
}

/// Result of [`Search::settle`].
#[derive(PartialEq)]
enum Settled {
    /// Nothing but rounding.
    Near,
    /// It may be outside other rows now.
    Moved,
}

impl<const N: usize, T: Scalar> Metric<N, T> {
    /// A symmetric positive-definite Hessian, of which the lower triangle is read.
    ///
    /// # Errors
    /// [`QpError::NotFinite`] with the row of the Hessian, [`QpError::NotPositiveDefinite`].
    pub fn new(hessian: &[[T; N]; N]) -> Result<Self, QpError> {
        let mut l = [[T::NOTHING; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let mut sum = hessian[i][j];
                if !is_number(sum) {
                    return Err(QpError::NotFinite { what: "metric", index: i });
                }
                for k in 0..j {
                    sum -= l[i][k] * l[j][k];
                }
                if i > j {
                    l[i][j] = sum / l[j][j];
                } else if sum > T::KEPT * hessian[i][i] {
                    l[i][i] = T::root_of(sum);
                } else {
                    return Err(QpError::NotPositiveDefinite { pivot: i });
                }
            }
        }
        Self::from_factor(&l)
    }

    /// A Hessian without coupling: one weight for each variable.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn diagonal(weights: &[T; N]) -> Result<Self, QpError> {
        let mut l = [[T::NOTHING; N]; N];
        for (i, weight) in weights.iter().enumerate() {
            if !is_number(*weight) {
                return Err(QpError::NotFinite { what: "metric", index: i });
            }
            if *weight <= T::NOTHING {
                return Err(QpError::NotPositiveDefinite { pivot: i });
            }
            l[i][i] = T::root_of(*weight);
        }
        Self::from_factor(&l)
    }

    fn from_factor(l: &[[T; N]; N]) -> Result<Self, QpError> {
        // column c of L⁻ᵀ is row c of L⁻¹: forward substitution, one row after another
        let mut inverse_factor = [[T::NOTHING; N]; N];
        for c in 0..N {
            let mut row = [T::NOTHING; N];
            for k in 0..c {
                add_scaled(&mut row, -l[c][k], &inverse_factor[k]);
            }
            row[c] += T::UNIT;
            inverse_factor[c] = row.map(|value| value / l[c][c]);
            if !inverse_factor[c].iter().all(|value| is_number(*value)) {
                return Err(QpError::NotFinite { what: "metric", index: c });
            }
        }
        Ok(Self { inverse_factor })
    }

    /// Returns the unconstrained minimum of ½xᵀHx + gradientᵀx: −H⁻¹·gradient, the target for [`Self::nearest`].
    pub fn minimum(&self, gradient: &[T; N]) -> [T; N] {
        let mut x = [T::NOTHING; N];
        for column in &self.inverse_factor {
            add_scaled(&mut x, -dot(column, gradient), column);
        }
        x
    }

    /// The point nearest to `target` that keeps every row; `target` itself, bit for bit, where it keeps them all.
    /// `from` is [`WorkingSet::EMPTY`] or that of a similar problem's solution: it changes the time, not the result.
    ///
    /// # Errors
    /// NaN or infinity in what is given, rows that exclude each other. Never for rows of which all but bounds of
    /// single variables are softened.
    pub fn nearest(
        &self,
        target: &[T; N],
        rows: &[Row<N, T>],
        from: &WorkingSet<N>,
    ) -> Result<Solution<N, T>, QpError> {
        if let Some(index) = target.iter().position(|value| !is_number(*value)) {
            return Err(QpError::NotFinite { what: "target", index });
        }
        let mut search = Search {
            rows,
            target,
            factor: Factor::new(&self.inverse_factor),
            x: *target,
            blocks: &mut [None; IN_BLOCKS / LANES],
            weights: &mut [None; WEIGHTED / TOGETHER],
            active: [(0, Side::Lower); N],
            multipliers: [T::NOTHING; N],
            iterations: 0,
            kept: T::KEPT,
        };
        search.line_up()?;
        let mut ended = search.run(from);
        if ended.is_err() && from.count > 0 {
            // rows that are nearly dependent may be a bad place to start from
            search = Search {
                factor: Factor::new(&self.inverse_factor),
                x: *target,
                multipliers: [T::NOTHING; N],
                iterations: 0,
                kept: T::KEPT,
                ..search
            };
            search.line_up()?;
            ended = search.run(&WorkingSet::EMPTY);
        }
        ended?;
        match search.x.iter().position(|value| !is_number(*value)) {
            Some(index) => Err(QpError::NotFinite { what: "solution", index }),
            None => Ok(Solution {
                x: search.x,
                iterations: search.iterations,
                active: core::array::from_fn(|i| {
                    let (row, side) = search.active[i];
                    Active { row, side, multiplier: search.multipliers[i] }
                }),
                count: search.factor.count,
            }),
        }
    }
}

impl<'a, const N: usize, T: Scalar> Search<'a, N, T> {
    /// Rows that fill blocks, and the others.
    #[inline]
    fn split(&self) -> (&'a [Row<N, T>], &'a [Row<N, T>]) {
        self.rows.split_at(self.rows.len().min(IN_BLOCKS) / LANES * LANES)
    }

    /// Puts the rows side by side, and refuses those that make no sense.
    #[inline]
    fn line_up(&mut self) -> Result<(), QpError> {
        let (in_blocks, others) = self.split();
        let mut fine = true;
        for (block, rows) in self.blocks.iter_mut().zip(in_blocks.as_chunks().0) {
            fine &= Block::replace(block, rows);
        }
        for (i, row) in others.iter().enumerate() {
            let squared = dot(&row.normal, &row.normal);
            fine &= row.bounds_make_sense() & (squared < T::UNBOUNDED) & (squared > T::NOTHING);
            if let Some(weights) = self.weights.get_mut(i / TOGETHER) {
                weights.get_or_insert([T::NOTHING; TOGETHER])[i % TOGETHER] = T::about_inverse_root(squared);
            }
        }
        if fine { Ok(()) } else { self.line_up_carefully() }
    }

    /// Looks at each row alone: a square may be infinite, or 0, where its root is not.
    #[cold]
    fn line_up_carefully(&mut self) -> Result<(), QpError> {
        if let Some(row) = self.rows.iter().position(|row| !row.makes_sense()) {
            return Err(self.rows[row].error(row));
        }
        let tolerance = T::KEPT * self.largest_number();
        for (i, row) in self.rows.iter().enumerate().filter(|(_, row)| row.is_of_zeros()) {
            if row.violation(self.target) > tolerance {
                return Err(QpError::Infeasible { row: i });
            }
            self.ignore(i);
        }
        Ok(())
    }

    /// Largest size of a number of the target and of the bounds.
    fn largest_number(&self) -> T {
        let bounds = self.rows.iter().flat_map(|row| [row.lower, row.upper]);
        let finite = self.target.iter().copied().chain(bounds).filter(|number| is_number(*number));
        finite.map(T::size_of).fold(T::NOTHING, larger)
    }

    fn run(&mut self, from: &WorkingSet<N>) -> Result<(), QpError> {
        if from.count > 0 {
            self.resume(from);
        }
        loop {
            while let Some((row, side)) = self.worst() {
                self.take_up(row, side)?;
            }
            if self.iterations < 2 || self.settle() == Settled::Near {
                return Ok(());
            }
            self.count()?;
        }
    }

    fn is_active(&self, row: usize) -> bool {
        self.active[..self.factor.count].iter().any(|(active, _)| *active == row)
    }

    /// The row that x is farthest from keeping, as the crow flies, if it is by more than rounding.
    #[inline]
    fn worst(&self) -> Option<(usize, Side)> {
        let mut worst = lanes::worst(self.blocks, &self.x);
        let mut at = usize::from(MARKS - 1 - T::mark(worst));
        let (in_blocks, others) = self.split();
        let mut compare = |i: usize, row: &Row<N, T>, weight: T| {
            let outside = row.violation(&self.x) * weight;
            at = if outside > worst { in_blocks.len() + i } else { at };
            worst = larger(outside, worst);
        };
        let weights = self.weights.iter().map_while(Option::as_ref).flatten();
        for (i, (row, weight)) in others.iter().zip(weights).enumerate() {
            compare(i, row, *weight);
        }
        for (i, row) in others.iter().enumerate().skip(WEIGHTED) {
            compare(i, row, row.weight());
        }
        if worst <= T::LEAST {
            return None;
        }
        let row = self.rows.get(at)?;
        // active ones among the first were not looked at
        let free = at < IN_BLOCKS || !self.is_active(at);
        if free && row.violation(&self.x) > self.kept * row.size(&self.x) && !row.is_of_zeros() {
            return Some((at, row.violated_side(&self.x)));
        }
        self.worst_beyond_rounding()
    }

    /// [`Self::worst`] where the largest violation is none: the careful way.
    #[cold]
    fn worst_beyond_rounding(&self) -> Option<(usize, Side)> {
        let mut worst = T::NOTHING;
        let mut found = None;
        for (i, row) in self.rows.iter().enumerate() {
            let violation = row.violation(&self.x);
            let free = !self.is_active(i) && !row.is_of_zeros();
            if violation > worst && free && violation > self.kept * row.size(&self.x) {
                (worst, found) = (violation, Some((i, row.violated_side(&self.x))));
            }
        }
        found
    }

    /// Makes a violated row active; rows whose multiplier would turn negative on the way are dropped.
    fn take_up(&mut self, row: usize, side: Side) -> Result<(), QpError> {
        let normal = self.rows[row].inward(side);
        let mut multiplier = T::NOTHING;
        // now, not when it is active: a processor has to wait before it reads together what it has written apart
        self.ignore(row);
        loop {
            self.count()?;
            let step = self.factor.step(&normal);
            let violation = self.rows[row].violation_at(&self.x, side);
            let free = self.factor.count < N && independent(&step);
            let full = violation / step.left;
            match self.first_to_drop(&step) {
                Some((length, k)) if !free || length < full => {
                    self.advance(&step, length, free);
                    multiplier += length;
                    self.drop_row(k);
                }
                _ if free => {
                    self.advance(&step, full, true);
                    self.add(row, side, multiplier + full, &step);
                    return Ok(());
                }
                _ => return self.give_up(row, violation),
            }
        }
    }

    fn count(&mut self) -> Result<(), QpError> {
        self.iterations += 1;
        let limit = ITERATIONS * (N + self.rows.len());
        if 2 * self.iterations == limit {
            // it goes round on what rounding leaves
            self.kept = T::LOOSE;
        }
        if self.iterations > limit { Err(QpError::IterationLimit { iterations: limit }) } else { Ok(()) }
    }

    /// No step comes nearer to the row: rounding gathered on the way, rounding that stays, or a contradiction.
    fn give_up(&mut self, row: usize, violation: T) -> Result<(), QpError> {
        self.heed(row);
        if self.settle() == Settled::Moved {
            return Ok(());
        }
        let size = self.rows[row].size(&self.x);
        if violation > T::LOOSE * size {
            return Err(QpError::Infeasible { row });
        }
        self.kept = (violation + violation) / size;
        Ok(())
    }

    /// Length of the step at which the first multiplier is used up, and whose it is.
    #[inline]
    fn first_to_drop(&self, step: &Step<N, T>) -> Option<(T, usize)> {
        let (mut least, mut first) = (T::UNBOUNDED, N);
        for i in 0..N {
            let falls = (step.dual[i] > T::NOTHING) & self.factor.coupled(step, i);
            let length = if falls { self.multipliers[i] / step.dual[i] } else { T::UNBOUNDED };
            first = if length < least { i } else { first };
            least = if length < least { length } else { least };
        }
        (first < N).then_some((least, first))
    }

    #[inline]
    fn advance(&mut self, step: &Step<N, T>, length: T, free: bool) {
        if free {
            add_scaled(&mut self.x, length, &step.primal);
        }
        for i in 0..N {
            self.multipliers[i] = not_negative(self.multipliers[i] - length * step.dual[i]);
        }
    }

    #[inline]
    fn add(&mut self, row: usize, side: Side, multiplier: T, step: &Step<N, T>) {
        self.active[self.factor.count] = (row, side);
        self.multipliers[self.factor.count] = multiplier;
        self.factor.add(step);
    }

    #[inline]
    fn drop_row(&mut self, k: usize) {
        let (row, _) = self.active[k];
        self.factor.drop_row(k);
        self.active[k] = self.active[self.factor.count];
        replace_by_last(&mut self.multipliers, k, self.factor.count);
        self.heed(row);
    }

    /// Does not look at a row among the first any more.
    #[inline]
    fn ignore(&mut self, row: usize) {
        self.set(row, -T::UNBOUNDED, T::UNBOUNDED, T::NOTHING);
    }

    /// Looks at it again.
    #[inline]
    fn heed(&mut self, row: usize) {
        let Row { lower, upper, .. } = self.rows[row];
        let weight = self.rows[row].weight();
        self.set(row, lower * weight, upper * weight, weight);
    }

    /// Sets the quantities that a scan reads of a row: its bounds in a block, else its weight.
    #[inline]
    fn set(&mut self, row: usize, lower: T, upper: T, weight: T) {
        let other = row.wrapping_sub(self.split().0.len());
        if let Some(Some(weights)) = self.weights.get_mut(other / TOGETHER) {
            weights[other % TOGETHER] = weight;
        } else if let Some(Some(block)) = self.blocks.get_mut(row / LANES) {
            block.set_bounds(row % LANES, lower, upper);
        }
    }

    /// Starts on the rows of an earlier solution, without those that would pull instead of push.
    fn resume(&mut self, from: &WorkingSet<N>) {
        for &(row, side) in from.rows.iter().take(from.count) {
            let known = self.rows.get(row).is_some_and(|r| is_number(r.bound_at(side)));
            if !known || self.is_active(row) {
                continue;
            }
            let step = self.factor.step(&self.rows[row].inward(side));
            if self.factor.count < N && independent(&step) {
                self.add(row, side, T::NOTHING, &step);
                self.ignore(row);
            }
        }
        self.settle();
    }

    /// Point and multipliers anew from the active rows, free of what the steps have gathered in rounding, without rows
    /// that would pull instead of push.
    fn settle(&mut self) -> Settled {
        let before = self.x;
        loop {
            self.x = *self.target;
            let mut multipliers = [T::NOTHING; N];
            // the second time restores the digits that an inverse loses where rows are nearly dependent
            for _ in 0..2 {
                let mut missing = [T::NOTHING; N];
                for (missing, (row, side)) in missing.iter_mut().zip(&self.active[..self.factor.count]) {
                    *missing = self.rows[*row].violation_at(&self.x, *side);
                }
                let (step, more) = self.factor.onto_rows(&missing);
                add_scaled(&mut self.x, T::UNIT, &step);
                add_scaled(&mut multipliers, T::UNIT, &more);
            }
            let Some(k) = self.factor.pulling(&multipliers) else {
                self.multipliers = multipliers.map(not_negative);
                break;
            };
            self.drop_row(k);
        }
        let (mut moved, mut size) = (T::NOTHING, T::NOTHING);
        for (before, after) in before.iter().zip(&self.x) {
            moved += T::size_of(*after - *before);
            size += T::size_of(*after);
        }
        if moved > T::KEPT * size { Settled::Moved } else { Settled::Near }
    }
}

/// Returns true if the active rows leave a direction in which the row of `step` can be approached.
fn independent<const N: usize, T: Scalar>(step: &Step<N, T>) -> bool {
    step.left > T::LOOSE * T::LOOSE * step.squared
}

#[inline]
fn not_negative<T: Scalar>(x: T) -> T {
    if x > T::NOTHING { x } else { T::NOTHING }
}

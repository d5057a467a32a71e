//! Panels with axes, and maps of coloured cells, on a [`Drawing`].

use crate::figures::drawing::{Anchor, BLACK, Colour, Drawing, GREY, PALETTE, RED};

/// Room for the numbers and for the legend, px.
const LEFT: f64 = 62.0;
const RIGHT: f64 = 190.0;

/// How an axis maps numbers to pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    Linear,
    Log,
}

/// One line of a panel.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    /// In the legend; not listed there if empty.
    pub name: String,
    pub points: Vec<[f64; 2]>,
    pub colour: Colour,
    /// Every point gets a dot.
    pub dots: bool,
}

impl Series {
    /// A line in the `i`th colour of the palette.
    pub(crate) fn line(i: usize, name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { name: name.into(), points, colour: PALETTE[i % PALETTE.len()], dots: false }
    }

    /// The same with a dot at every point: few measured values and not a trace.
    pub(crate) fn dots(i: usize, name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { dots: true, ..Self::line(i, name, points) }
    }

    /// The same line in a paler colour and without a place in the legend.
    #[must_use]
    pub(crate) fn pale(mut self) -> Self {
        self.name.clear();
        self.colour = self.colour.map(|c| c / 2 + 127);
        self
    }
}

/// One panel: title, axis labels, lines, marks.
#[derive(Clone, Debug)]
pub(crate) struct Panel {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    pub x_scale: Scale,
    pub y_scale: Scale,
    pub series: Vec<Series>,
    /// Where vertical lines go.
    pub marks: Vec<f64>,
    /// Horizontal lines with their names.
    pub levels: Vec<(f64, &'static str)>,
}

impl Panel {
    /// Linear axes, nothing in it yet.
    pub(crate) fn new(title: &str, x_label: &str, y_label: &str) -> Self {
        Self {
            title: title.into(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            x_scale: Scale::Linear,
            y_scale: Scale::Linear,
            series: Vec::new(),
            marks: Vec::new(),
            levels: Vec::new(),
        }
    }

    /// Draws into the box at `origin` of `size` pixels.
    pub(crate) fn draw(&self, drawing: &mut Drawing, origin: [f64; 2], size: [f64; 2]) {
        let frame = Frame {
            left: origin[0] + LEFT,
            top: origin[1] + 18.0,
            width: size[0] - LEFT - RIGHT,
            height: size[1] - 18.0 - 34.0,
            x: self.range(0, self.x_scale),
            y: self.range(1, self.y_scale),
            x_scale: self.x_scale,
            y_scale: self.y_scale,
        };
        frame.grid(drawing, &self.x_label);
        drawing.text([origin[0] + LEFT, origin[1] + 12.0], Anchor::Start, &self.title, BLACK);
        drawing.text([frame.left + frame.width, origin[1] + 12.0], Anchor::End, &self.y_label, BLACK);
        for x in &self.marks {
            let px = frame.px(*x);
            drawing.line(&[[px, frame.top], [px, frame.top + frame.height]], 1.0, GREY);
        }
        for (y, name) in &self.levels {
            let py = frame.py(*y);
            if (frame.top..=frame.top + frame.height).contains(&py) {
                drawing.line(&[[frame.left, py], [frame.left + frame.width, py]], 1.0, RED);
                drawing.text([frame.left + frame.width - 4.0, py - 3.0], Anchor::End, name, RED);
            }
        }
        let mut listed = 0.0;
        for series in &self.series {
            let points: Vec<[f64; 2]> =
                series.points.iter().map(|&[x, y]| [frame.px(x), frame.py(y)]).collect();
            drawing.line(&thinned(&points), 1.4, series.colour);
            for point in points.iter().filter(|_| series.dots) {
                drawing.circle(*point, 2.6, series.colour);
            }
            if series.name.is_empty() {
                continue;
            }
            let y = frame.top + 8.0 + 14.0 * listed;
            let x = frame.left + frame.width + 8.0;
            drawing.line(&[[x, y - 3.0], [x + 12.0, y - 3.0]], 2.0, series.colour);
            drawing.text([x + 16.0, y + 1.0], Anchor::Start, &series.name, BLACK);
            listed += 1.0;
        }
    }

    /// Where `x` of a panel `size_x` pixels wide whose left edge is at 0 comes to lie, px.
    pub(crate) fn place(&self, x: f64, size_x: f64) -> f64 {
        LEFT + (size_x - LEFT - RIGHT) * share(x, self.range(0, self.x_scale), self.x_scale)
    }

    fn range(&self, axis: usize, scale: Scale) -> [f64; 2] {
        let values = self.series.iter().flat_map(|s| s.points.iter().map(move |p| p[axis]));
        let usable = values.filter(|v| v.is_finite() && (scale == Scale::Linear || *v > 0.0));
        let [low, high] =
            usable.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
        if low > high {
            return [0.1, 1.0];
        }
        match scale {
            Scale::Log => [
                10f64.powf(low.log10().floor()),
                10f64.powf(high.log10().ceil().max(low.log10().floor() + 1.0)),
            ],
            Scale::Linear if axis == 0 => [low, if high > low { high } else { low + 1.0 }],
            Scale::Linear => {
                let margin = 0.06 * (high - low).max(1e-9 + 0.02 * high.abs().max(low.abs()));
                [low - margin, high + margin]
            }
        }
    }
}

struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    x: [f64; 2],
    y: [f64; 2],
    x_scale: Scale,
    y_scale: Scale,
}

impl Frame {
    fn px(&self, x: f64) -> f64 {
        self.left + self.width * share(x, self.x, self.x_scale)
    }

    fn py(&self, y: f64) -> f64 {
        self.top + self.height * (1.0 - share(y, self.y, self.y_scale))
    }

    fn grid(&self, drawing: &mut Drawing, x_label: &str) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        for tick in ticks(self.y, self.y_scale) {
            let y = self.py(tick);
            drawing.line(&[[self.left, y], [right, y]], 0.4, GREY);
            drawing.text([self.left - 4.0, y + 4.0], Anchor::End, &number(tick), BLACK);
        }
        for tick in ticks(self.x, self.x_scale) {
            let x = self.px(tick);
            drawing.line(&[[x, bottom], [x, bottom + 4.0]], 0.8, BLACK);
            drawing.text([x, bottom + 15.0], Anchor::Middle, &number(tick), BLACK);
        }
        drawing.line(&[[self.left, self.top], [self.left, bottom], [right, bottom]], 0.8, BLACK);
        drawing.text([right + 26.0, bottom + 15.0], Anchor::Start, x_label, BLACK);
    }
}

fn share(value: f64, [low, high]: [f64; 2], scale: Scale) -> f64 {
    match scale {
        Scale::Linear => (value - low) / (high - low),
        Scale::Log => (value.max(f64::MIN_POSITIVE) / low).log10() / (high / low).log10(),
    }
}

fn ticks([low, high]: [f64; 2], scale: Scale) -> Vec<f64> {
    if scale == Scale::Log {
        #[expect(clippy::cast_possible_truncation, reason = "decades of a finite number")]
        let (from, to) = (low.log10().round() as i32, high.log10().round() as i32);
        return (from..=to).map(|decade| 10f64.powi(decade)).collect();
    }
    let rough = (high - low) / 4.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let mut tick = (low / step).ceil() * step;
    let mut ticks = Vec::new();
    while tick <= high + 1e-9 * step && ticks.len() < 20 {
        ticks.push(if tick.abs() < 1e-9 * step { 0.0 } else { tick });
        tick += step;
    }
    ticks
}

/// Short and exact enough for an axis.
pub(crate) fn number(value: f64) -> String {
    let size = value.abs();
    if size >= 1e5 || (size > 0.0 && size < 1e-3) {
        format!("{value:.0e}")
    } else {
        let text = format!("{value:.3}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

/// Keeps the extremes of each stretch of a long trace and leaves out what lies on a level line: a trace of a minute stays
/// a small file.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    const MOST: usize = 600;
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut keep = |point: [f64; 2]| {
        let level = |a: [f64; 2], b: [f64; 2]| (a[1] - b[1]).abs() < 0.05;
        if let [.., before, last] = kept[..]
            && level(before, last)
            && level(last, point)
        {
            kept.pop();
        }
        kept.push(point);
    };
    for chunk in points.chunks(points.len().div_ceil(MOST).max(1)) {
        let by_y = |a: &&[f64; 2], b: &&[f64; 2]| a[1].total_cmp(&b[1]);
        let ends = [chunk.iter().min_by(by_y), chunk.iter().max_by(by_y)];
        let mut ends: Vec<[f64; 2]> = ends.into_iter().flatten().copied().collect();
        ends.sort_by(|a, b| a[0].total_cmp(&b[0]));
        ends.dedup();
        ends.into_iter().for_each(&mut keep);
    }
    kept
}

/// A map: one coloured cell for each pair of an x and a y value, with an optional boundary curve in cell units.
pub(crate) struct Map {
    pub title: String,
    pub x_label: String,
    pub y_label: String,
    pub x: Vec<String>,
    pub y: Vec<String>,
    /// Row by row from the first y: colour and a short text.
    pub cells: Vec<(Colour, String)>,
    /// Which side of a line each cell is on; the line is drawn between cells that differ.
    pub sides: Vec<bool>,
}

impl Map {
    pub(crate) fn draw(&self, drawing: &mut Drawing, [left, top]: [f64; 2], cell: [f64; 2]) {
        let x0 = left + 80.0;
        let bottom = top + 20.0 + cell[1] * count(self.y.len());
        drawing.text([left, top + 10.0], Anchor::Start, &self.title, BLACK);
        for (row, name) in self.y.iter().enumerate() {
            let y = bottom - cell[1] * (count(row) + 1.0);
            drawing.text([x0 - 6.0, y + 0.5 * cell[1] + 4.0], Anchor::End, name, BLACK);
            for (column, (colour, text)) in
                self.cells.iter().skip(row * self.x.len()).take(self.x.len()).enumerate()
            {
                let x = x0 + cell[0] * count(column);
                drawing.rectangle([x, y], [cell[0] - 1.0, cell[1] - 1.0], *colour);
                drawing.text([x + 0.5 * cell[0], y + 0.5 * cell[1] + 4.0], Anchor::Middle, text, BLACK);
            }
        }
        for (column, name) in self.x.iter().enumerate() {
            let x = x0 + cell[0] * (count(column) + 0.5);
            drawing.text([x, bottom + 13.0], Anchor::Middle, name, BLACK);
        }
        drawing.text([x0, bottom + 28.0], Anchor::Start, &self.x_label, BLACK);
        drawing.text([left, top + 24.0], Anchor::Start, &self.y_label, BLACK);
        let side = |row: usize, column: usize| {
            (row < self.y.len() && column < self.x.len())
                .then(|| self.sides.get(row * self.x.len() + column))
                .flatten()
        };
        let differ = |a: Option<&bool>, b: Option<&bool>| a.zip(b).is_some_and(|(a, b)| a != b);
        for row in 0..self.y.len() {
            for column in 0..self.x.len() {
                let [left, bottom] =
                    [x0 + cell[0] * count(column) - 0.5, bottom - cell[1] * count(row) - 0.5];
                let [right, top] = [left + cell[0], bottom - cell[1]];
                if differ(side(row, column), side(row, column + 1)) {
                    drawing.line(&[[right, bottom], [right, top]], 3.0, BLACK);
                }
                if differ(side(row, column), side(row + 1, column)) {
                    drawing.line(&[[left, top], [right, top]], 3.0, BLACK);
                }
            }
        }
    }
}

fn count(value: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few cells")]
    let value = value as f64;
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks([0.0, 10.0], Scale::Linear).len(), 3);
        assert!(ticks([-0.37, 0.21], Scale::Linear).iter().all(|t| (-0.37..=0.21).contains(t)));
        assert_eq!(ticks([1e-3, 1e1], Scale::Log).len(), 5);
    }

    #[test]
    fn a_long_trace_is_thinned_and_keeps_its_extremes() {
        let points: Vec<[f64; 2]> =
            (0..20_000).map(|i| [f64::from(i), if i == 12_345 { 9.0 } else { 0.0 }]).collect();
        let thin = thinned(&points);
        assert!(thin.len() < 4000 && thin.iter().any(|p| p[1] > 8.0));
    }
}

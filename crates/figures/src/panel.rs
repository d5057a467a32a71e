//! A panel: axes, lines, dots, bands, marks, and a legend beside it.

use crate::axis::{Axis, Scale, range};
use crate::drawing::{Anchor, BLACK, Colour, Drawing, GREY, PALETTE, RED, text_px, wrapped};

/// Room for the numbers and, at least, for the legend, px.
const LEFT: f64 = 74.0;
const RIGHT: f64 = 176.0;
const TOP: f64 = 20.0;
const BOTTOM: f64 = 38.0;
/// Without a legend.
const RIGHT_BARE: f64 = 16.0;
/// Widest panel that has its legend above the axes instead of beside them, px.
const NARROW: f64 = 500.0;
/// Room for the numbers of a narrow panel, px.
const LEFT_NARROW: f64 = 58.0;
/// Height of a line of the title, and of the legend of a narrow panel, px.
const LINE: f64 = 14.0;
/// Room that an entry of the legend takes besides its name, px.
const ENTRY: f64 = 27.0;

/// Marks that show the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    Line,
    /// A line with a dot at every point: few measured values and not a trace.
    Dots,
    /// Small pale dots alone: many measured values.
    Cloud,
    /// Failed points: a cross at each x, at the top of the panel.
    Failures,
}

/// One line of a panel.
#[derive(Clone, Debug)]
pub struct Series {
    /// In the legend; not listed there if empty.
    pub name: String,
    /// x, y.
    pub points: Vec<[f64; 2]>,
    /// Colour of line, dots and band.
    pub colour: Colour,
    /// Outline of a translucent band, for the uncertainty of the line; empty for none.
    pub band: Vec<[f64; 2]>,
    style: Style,
}

impl Series {
    /// A line in the `i`th colour of the palette.
    pub fn line(i: usize, name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        let colour = PALETTE[i % PALETTE.len()];
        Self { name: name.into(), points, colour, band: Vec::new(), style: Style::Line }
    }

    /// A line with a dot at every point.
    pub fn dots(i: usize, name: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { style: Style::Dots, ..Self::line(i, name, points) }
    }

    /// Small pale dots without a line.
    pub fn cloud(i: usize, points: Vec<[f64; 2]>) -> Self {
        Self { style: Style::Cloud, ..Self::line(i, "", points) }
    }

    /// Runs that gave no value: a red cross for each at its x, at the top of the panel.
    pub fn failures(name: impl Into<String>, x: impl IntoIterator<Item = f64>) -> Self {
        let points = x.into_iter().map(|x| [x, f64::NAN]).collect();
        Self { style: Style::Failures, colour: RED, ..Self::line(0, name, points) }
    }

    /// With the band between two lines through as many points: least and most.
    #[must_use]
    pub fn between(mut self, least: Vec<[f64; 2]>, most: impl DoubleEndedIterator<Item = [f64; 2]>) -> Self {
        self.band = least.into_iter().chain(most.rev()).collect();
        self
    }

    /// Legend entry for the grey vertical lines.
    pub fn marks(name: impl Into<String>) -> Self {
        Self { colour: GREY, ..Self::line(0, name, Vec::new()) }
    }

    /// Draws the line in a paler colour and without a legend entry.
    #[must_use]
    pub fn pale(mut self) -> Self {
        self.name.clear();
        self.colour = self.colour.map(|c| c / 2 + 127);
        self
    }
}

/// One panel: title, axis labels, lines, marks.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// With its unit.
    pub x_label: String,
    /// With its unit.
    pub y_label: String,
    /// Scale of the x axis.
    pub x_scale: Scale,
    /// Scale of the y axis.
    pub y_scale: Scale,
    /// Drawn in this order.
    pub series: Vec<Series>,
    /// Places of the vertical lines on the x axis.
    pub marks: Vec<f64>,
    /// Horizontal lines with their names.
    pub levels: Vec<(f64, &'static str)>,
}

impl Panel {
    /// Linear axes, nothing in it yet.
    pub fn new(title: &str, x_label: &str, y_label: &str) -> Self {
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

    /// Puts the letter of the `i`th panel before the title: (a), (b) and so on.
    #[must_use]
    pub fn lettered(mut self, i: usize) -> Self {
        if let Some(letter) = ('a'..='z').nth(i) {
            self.title = format!("({letter}) {}", self.title);
        }
        self
    }

    /// Returns the height of a panel `width` wide whose axes are `axes` high, px.
    pub fn height(&self, width: f64, axes: f64) -> f64 {
        self.above(width) + axes + BOTTOM
    }

    /// Draws into the box at `origin` of `size` pixels.
    pub fn draw(&self, drawing: &mut Drawing, origin: [f64; 2], size: [f64; 2]) {
        let frame = self.frame(origin, size);
        frame.axes(drawing, self, origin[0]);
        let (left, right) = (frame.x.start_px, frame.right());
        for x in &self.marks {
            let px = frame.x.place(*x);
            drawing.line(&[[px, frame.top], [px, frame.bottom()]], 1.0, GREY);
        }
        for series in &self.series {
            frame.series(drawing, series);
        }
        for (y, name) in &self.levels {
            let py = frame.y.place(*y);
            if (frame.top..=frame.bottom()).contains(&py) {
                drawing.line(&[[left, py], [right, py]], 1.0, RED);
                drawing.text([right - 4.0, py - 3.0], Anchor::End, name, RED);
            }
        }
        if size[0] <= NARROW {
            let top = origin[1] + 13.0 + LINE * lines(self.title_lines(size[0]).len());
            for (series, [x, line]) in self.named().zip(self.legend_places(size[0])) {
                Self::legend_entry(drawing, series, [left + x, top + LINE * line]);
            }
        } else {
            for (series, line) in self.named().zip(0u32..) {
                Self::legend_entry(drawing, series, [right + 10.0, frame.top + 8.0 + 15.0 * f64::from(line)]);
            }
        }
    }

    /// Returns the place of `x`, px, in a panel `size_x` pixels wide whose left edge is at 0.
    pub fn place(&self, x: f64, size_x: f64) -> f64 {
        self.frame([0.0; 2], [size_x, 100.0]).x.place(x)
    }

    /// Series that the legend lists.
    fn named(&self) -> impl Iterator<Item = &Series> {
        self.series.iter().filter(|series| !series.name.is_empty())
    }

    fn title_lines(&self, width: f64) -> Vec<String> {
        let left = if width <= NARROW { LEFT_NARROW } else { LEFT };
        wrapped(&self.title, width - left - 4.0)
    }

    /// Place of each entry of a narrow panel's legend: px from the left end of the axes, and line.
    fn legend_places(&self, width: f64) -> Vec<[f64; 2]> {
        let (mut x, mut line) = (0.0, 0.0);
        let place = |series: &Series| {
            let room = ENTRY + text_px(series.name.chars().count());
            if x > 0.0 && x + room > width - LEFT_NARROW {
                (x, line) = (0.0, line + 1.0);
            }
            let at = [x, line];
            x += room;
            at
        };
        self.named().map(place).collect()
    }

    /// Room above the axes, px.
    fn above(&self, width: f64) -> f64 {
        let title = LINE * lines(self.title_lines(width).len().max(1));
        let legend = match self.legend_places(width).last() {
            Some([_, line]) if width <= NARROW => LINE * (line + 1.0),
            _ => 0.0,
        };
        TOP - LINE + title + legend
    }

    fn legend_entry(drawing: &mut Drawing, series: &Series, [x, y]: [f64; 2]) {
        let middle = [x + 6.0, y - 4.0];
        match series.style {
            Style::Failures => drawing.cross(middle, 3.5, series.colour),
            Style::Cloud => drawing.circle(middle, 2.6, series.colour, 1.0),
            Style::Line | Style::Dots => {
                drawing.line(&[[x, middle[1]], [x + 12.0, middle[1]]], 2.0, series.colour);
            }
        }
        drawing.text([x + 17.0, y], Anchor::Start, &series.name, BLACK);
    }

    fn frame(&self, [left, top]: [f64; 2], [width, height]: [f64; 2]) -> Frame {
        let longest = self.series.iter().map(|series| series.name.chars().count()).max().unwrap_or(0);
        let narrow = width <= NARROW;
        let beside = longest > 0 && !narrow;
        let right = if beside { RIGHT.max(32.0 + text_px(longest)) } else { RIGHT_BARE };
        let room_left = if narrow { LEFT_NARROW } else { LEFT };
        let values = |axis: usize| {
            let shown = self.series.iter().flat_map(|s| s.points.iter().chain(&s.band));
            shown.map(move |point| point[axis])
        };
        let above = self.above(width);
        let (title_top, top, height) = (top, top + above, height - above - BOTTOM);
        Frame {
            title: self.title_lines(width),
            title_top,
            top,
            height,
            x: Axis {
                range: range(values(0), self.x_scale, false),
                scale: self.x_scale,
                start_px: left + room_left,
                length_px: width - room_left - right,
            },
            y: Axis {
                range: range(values(1), self.y_scale, true),
                scale: self.y_scale,
                start_px: top + height,
                length_px: -height,
            },
        }
    }
}

struct Frame {
    title: Vec<String>,
    /// Upper edge of the box, px.
    title_top: f64,
    top: f64,
    height: f64,
    x: Axis,
    y: Axis,
}

impl Frame {
    fn right(&self) -> f64 {
        self.x.start_px + self.x.length_px
    }

    fn bottom(&self) -> f64 {
        self.top + self.height
    }

    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.x.place(x), self.y.place(y)]
    }

    /// Axes, grid, ticks and every text but the legend; `edge` is the left edge of the box.
    fn axes(&self, drawing: &mut Drawing, panel: &Panel, edge: f64) {
        let (left, right, bottom) = (self.x.start_px, self.right(), self.bottom());
        for (line, i) in self.title.iter().zip(0u32..) {
            drawing.text([left, self.title_top + 13.0 + LINE * f64::from(i)], Anchor::Start, line, BLACK);
        }
        drawing.text_upwards([edge + 13.0, self.top + 0.5 * self.height], &panel.y_label, BLACK);
        drawing.text([0.5 * (left + right), bottom + 30.0], Anchor::Middle, &panel.x_label, BLACK);
        for (value, label) in self.y.ticks() {
            let y = self.y.place(value);
            drawing.line(&[[left, y], [right, y]], 0.4, GREY);
            drawing.text([left - 6.0, y + 4.0], Anchor::End, &label, BLACK);
        }
        for (value, label) in self.x.ticks() {
            let x = self.x.place(value);
            drawing.line(&[[x, bottom], [x, bottom + 5.0]], 0.8, BLACK);
            drawing.text([x, bottom + 16.0], Anchor::Middle, &label, BLACK);
        }
        for y in self.y.minor_ticks().into_iter().map(|value| self.y.place(value)) {
            drawing.line(&[[left, y], [left + 3.0, y]], 0.6, BLACK);
        }
        for x in self.x.minor_ticks().into_iter().map(|value| self.x.place(value)) {
            drawing.line(&[[x, bottom], [x, bottom - 3.0]], 0.6, BLACK);
        }
        drawing.line(&[[left, self.top], [left, bottom], [right, bottom]], 0.8, BLACK);
    }

    fn series(&self, drawing: &mut Drawing, series: &Series) {
        let band: Vec<[f64; 2]> = series.band.iter().map(|point| self.at(*point)).collect();
        drawing.area(&band, series.colour, 0.2);
        let points: Vec<[f64; 2]> = series.points.iter().map(|point| self.at(*point)).collect();
        match series.style {
            Style::Line => drawing.line(&thinned(&points), 1.4, series.colour),
            Style::Dots => {
                drawing.line(&points, 1.4, series.colour);
                points.iter().for_each(|point| drawing.circle(*point, 2.6, series.colour, 1.0));
            }
            Style::Cloud => {
                points.iter().for_each(|point| drawing.circle(*point, 1.3, series.colour, 0.4));
            }
            Style::Failures => {
                points.iter().for_each(|[x, _]| drawing.cross([*x, self.top + 6.0], 4.0, series.colour));
            }
        }
    }
}

fn lines(count: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few lines")]
    let lines = count as f64;
    lines
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_trace_is_thinned_and_keeps_its_extremes() {
        let points: Vec<[f64; 2]> =
            (0..20_000).map(|i| [f64::from(i), if i == 12_345 { 9.0 } else { 0.0 }]).collect();
        let thin = thinned(&points);
        assert!(thin.len() < 4000 && thin.iter().any(|p| p[1] > 8.0));
    }

    #[test]
    fn everything_lies_in_its_box_and_failures_are_marked() {
        let mut line = Series::line(0, "a", vec![[1e-3, 2.0], [10.0, 900.0], [0.3, f64::NAN]]);
        line.band = vec![[1e-3, 1.0], [10.0, 800.0], [10.0, 1000.0], [1e-3, 3.0]];
        let panel = Panel {
            x_scale: Scale::Log,
            y_scale: Scale::Log,
            series: vec![line, Series::failures("fails", [0.02])],
            marks: vec![0.1],
            levels: vec![(25.0, "UNSAFE")],
            ..Panel::new("title", "t [s]", "N")
        };
        let mut drawing = Drawing::new(400.0, 200.0);
        panel.draw(&mut drawing, [0.0, 0.0], [400.0, 200.0]);
        let [left, top, right, bottom] = drawing.extent().unwrap_or_default();
        assert!(left >= 0.0 && top >= 0.0 && right <= 400.0 && bottom <= 200.0);
        assert!(drawing.texts().any(|text| text == "UNSAFE") && drawing.texts().any(|text| text == "10⁻³"));
        // Two crosses of two lines: in the panel and in the legend.
        assert_eq!(drawing.svg().matches("stroke=\"#c82828\" stroke-width=\"1.6\"").count(), 4);
    }

    #[test]
    fn narrow_panel_has_title_and_legend_above_its_axes() {
        let names = ["flange, actual", "flange, desired", "base"];
        let series =
            names.iter().enumerate().map(|(i, name)| Series::line(i, *name, vec![[0.0, 0.0], [10.0, 1.0]]));
        let title = "displacement from the start, world axes: actual and desired";
        let panel = Panel { series: series.collect(), ..Panel::new(title, "t [s]", "m") }.lettered(1);
        let width = 88.0 * 96.0 / 25.4;
        let height = panel.height(width, 100.0);
        // Two lines of title, two of legend.
        assert!((height - (TOP + 3.0 * LINE + 100.0 + BOTTOM)).abs() < 1e-9, "{height}");
        let mut drawing = Drawing::new(width, height);
        panel.draw(&mut drawing, [0.0; 2], [width, height]);
        let [left, top, right, bottom] = drawing.extent().unwrap_or_default();
        assert!(left >= 0.0 && top >= 0.0 && right <= width && bottom <= height);
        assert!(drawing.texts().any(|text| text.starts_with("(b) displacement")));
        // The axes use the width that the legend leaves.
        assert!((panel.place(10.0, width) - (width - RIGHT_BARE)).abs() < 1e-9);
        assert!((panel.height(900.0, 100.0) - (TOP + 100.0 + BOTTOM)).abs() < 1e-9);
    }

    #[test]
    fn a_panel_of_nothing_and_of_nonsense_is_still_a_picture() {
        let nothing = Series::line(0, "", vec![[f64::NAN, f64::INFINITY]]);
        let panel = Panel { series: vec![nothing], ..Panel::new("a < b", "x", "y") };
        let mut drawing = Drawing::new(400.0, 200.0);
        panel.draw(&mut drawing, [0.0, 0.0], [400.0, 200.0]);
        assert!(drawing.svg().ends_with("</svg>\n") && !drawing.svg().contains("NaN"));
    }
}

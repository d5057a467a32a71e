//! A small chart: axes, lines, bands and points, as SVG.

use super::Trial;
use crate::model::TaxelModel;
use std::fmt::Write;
use std::format;
use std::string::String;
use std::vec::Vec;

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 55.0;

/// Colours of series, told apart by most colour-blind readers (Okabe–Ito).
pub const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

/// One chart under construction.
#[derive(Clone, Debug)]
pub struct Chart {
    x: [f64; 2],
    y: [f64; 2],
    body: String,
    legend: Vec<(String, String)>,
    title: String,
    axes: [String; 2],
}

impl Chart {
    /// An empty chart. `x` and `y` are ranges; an axis label carries its unit.
    pub fn new(title: &str, [x_label, y_label]: [&str; 2], x: [f64; 2], y: [f64; 2]) -> Self {
        Self {
            x: non_empty(x),
            y: non_empty(y),
            body: String::new(),
            legend: Vec::new(),
            title: title.into(),
            axes: [x_label.into(), y_label.into()],
        }
    }

    /// A line through `points`; `name` goes into the legend unless empty.
    pub fn line(&mut self, name: &str, colour: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let path = self.path(points);
        // writing to a String cannot fail
        let _ = writeln!(
            self.body,
            r#"<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.8"/>"#
        );
        if !name.is_empty() {
            self.legend.push((name.into(), colour.into()));
        }
    }

    /// A translucent band between `lower` and `upper`, both over the same rising x.
    pub fn band(&mut self, colour: &str, lower: &[(f64, f64)], upper: &[(f64, f64)]) {
        let path = self.path(lower.iter().copied().chain(upper.iter().rev().copied()));
        let _ = writeln!(
            self.body,
            r#"<polygon points="{path}" fill="{colour}" fill-opacity="0.2" stroke="none"/>"#
        );
    }

    /// Small dots.
    pub fn points(&mut self, colour: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        for (x, y) in points {
            let (px, py) = self.place(x, y);
            let _ = writeln!(
                self.body,
                r#"<circle cx="{px:.1}" cy="{py:.1}" r="1.2" fill="{colour}" fill-opacity="0.4"/>"#
            );
        }
    }

    /// The finished picture.
    pub fn svg(&self) -> String {
        side_by_side(core::slice::from_ref(self))
    }

    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        let along = |value: f64, [from, to]: [f64; 2]| ((value - from) / (to - from)).clamp(-0.02, 1.02);
        let px = LEFT + along(x, self.x) * (WIDTH - LEFT - RIGHT);
        let py = HEIGHT - BOTTOM - along(y, self.y) * (HEIGHT - TOP - BOTTOM);
        (px, py)
    }

    fn path(&self, points: impl IntoIterator<Item = (f64, f64)>) -> String {
        let mut path = String::new();
        for (x, y) in points {
            let (px, py) = self.place(x, y);
            let _ = write!(path, "{px:.1},{py:.1} ");
        }
        path
    }

    fn write(&self, out: &mut String) {
        let (x0, y0) = (LEFT, HEIGHT - BOTTOM);
        let (x1, y1) = (WIDTH - RIGHT, TOP);
        let text = |out: &mut String, x: f64, y: f64, anchor: &str, more: &str, text: &str| {
            let _ = writeln!(
                out,
                r#"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}" {more}>{}</text>"#,
                escaped(text)
            );
        };
        for value in ticks(self.x) {
            let (px, _) = self.place(value, self.y[0]);
            let _ = writeln!(out, r##"<path d="M{px:.1} {y0}V{y1}" stroke="#e0e0e0"/>"##);
            text(out, px, y0 + 18.0, "middle", "", &short(value));
        }
        for value in ticks(self.y) {
            let (_, py) = self.place(self.x[0], value);
            let _ = writeln!(out, r##"<path d="M{x0} {py:.1}H{x1}" stroke="#e0e0e0"/>"##);
            text(out, x0 - 8.0, py + 4.0, "end", "", &short(value));
        }
        let _ = writeln!(out, r##"<path d="M{x0} {y1}V{y0}H{x1}" fill="none" stroke="#404040"/>"##);
        out.push_str(&self.body);
        text(out, WIDTH / 2.0, 22.0, "middle", r#"font-size="15" font-weight="bold""#, &self.title);
        text(out, (x0 + x1) / 2.0, HEIGHT - 12.0, "middle", "", &self.axes[0]);
        let y = (y0 + y1) / 2.0;
        text(out, 18.0, y, "middle", &format!(r#"transform="rotate(-90 18 {y})""#), &self.axes[1]);
        for (row, (name, colour)) in (0u32..).zip(self.legend.iter().rev()) {
            let y = y0 - 14.0 - 17.0 * f64::from(row);
            let _ = writeln!(out, r#"<path d="M{} {y}h22" stroke="{colour}" stroke-width="3"/>"#, x1 - 34.0);
            text(out, x1 - 42.0, y + 4.0, "end", "", name);
        }
    }
}

/// Charts beside each other in one SVG.
pub fn side_by_side(charts: &[Chart]) -> String {
    let width = charts.iter().map(|_| WIDTH).sum::<f64>();
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {HEIGHT}\" width=\"{width}\" \
         height=\"{HEIGHT}\" font-family=\"DejaVu Sans, Helvetica, Arial, sans-serif\" font-size=\"12\">\n\
         <rect width=\"{width}\" height=\"{HEIGHT}\" fill=\"white\"/>\n"
    );
    let mut left = 0.0;
    for chart in charts {
        let _ = writeln!(out, r#"<g transform="translate({left} 0)">"#);
        chart.write(&mut out);
        out.push_str("</g>\n");
        left += WIDTH;
    }
    out.push_str("</svg>\n");
    out
}

/// Residuals (model minus reference, N) over the reference force, at most 2000 dots.
pub fn residual_plot(title: &str, model: &TaxelModel, trials: &[Trial]) -> String {
    let residuals = super::residuals(model, trials);
    let force_max_n = residuals.iter().map(|r| r.0).fold(1.0, f64::max);
    let error_max_n = residuals.iter().map(|r| r.1.abs()).fold(1.0, f64::max);
    let labels = ["reference force [N]", "model - reference [N]"];
    let mut chart = Chart::new(title, labels, [0.0, force_max_n], [-error_max_n, error_max_n]);
    chart.line("", "#404040", [(0.0, 0.0), (force_max_n, 0.0)]);
    chart.points(COLOURS[0], residuals.iter().step_by(residuals.len() / 2000 + 1).copied());
    chart.svg()
}

fn non_empty([from, to]: [f64; 2]) -> [f64; 2] {
    if to > from && from.is_finite() && to.is_finite() { [from, to] } else { [0.0, 1.0] }
}

/// Four to ten round values within the range.
fn ticks([from, to]: [f64; 2]) -> Vec<f64> {
    let rough = (to - from) / 6.0;
    let decade = libm::pow(10.0, libm::floor(libm::log10(rough)));
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|&s| s >= rough).unwrap_or(rough);
    let first = libm::ceil(from / step - 1e-9);
    (0u32..50).map(|i| (first + f64::from(i)) * step).take_while(|&v| v <= to + 1e-9 * step).collect()
}

fn short(value: f64) -> String {
    let rounded = libm::round(value * 1e6) / 1e6;
    format!("{}", if rounded == 0.0 { 0.0 } else { rounded })
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks([0.0, 100.0]), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(ticks([-9.0, 11.0]), [-5.0, 0.0, 5.0, 10.0]);
        assert_eq!(ticks([0.0, 0.0114]).len(), 6);
    }

    #[test]
    fn a_chart_of_nothing_and_of_nonsense_is_still_a_picture() {
        let mut chart = Chart::new("a < b", ["x [m]", "y [N]"], [f64::NAN, 0.0], [3.0, 3.0]);
        chart.line("none", COLOURS[0], []);
        chart.band(COLOURS[1], &[], &[]);
        let svg = chart.svg();
        assert!(svg.contains("a &lt; b") && svg.ends_with("</svg>\n") && !svg.contains("NaN"));
    }
}

//! Lines, areas and texts, written as SVG.

use std::fmt::Write;

/// Red, green, blue.
pub type Colour = [u8; 3];

/// Text and axes.
pub const BLACK: Colour = [30, 30, 30];
/// Grids and marks.
pub const GREY: Colour = [190, 190, 190];
/// Limits and failures.
pub const RED: Colour = [200, 40, 40];
/// Distinct for colour-blind readers too (Okabe and Ito).
pub const PALETTE: [Colour; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [90, 90, 90],
];

/// Size of all text, px.
pub(crate) const FONT_PX: f64 = 11.0;

/// Splits a text into lines that are at most `width` wide, px; a longer word stays whole.
pub fn wrapped(text: &str, width: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_px(line.chars().count() + 1 + word.chars().count()) <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Room that so many characters take at most, but for wide ones alone, px.
pub fn text_px(characters: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "some tens")]
    let characters = characters as f64;
    0.62 * FONT_PX * characters
}

/// Horizontal anchor of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// At its beginning.
    Start,
    /// In its middle.
    Middle,
    /// At its end.
    End,
}

#[derive(Clone, Debug)]
enum Shape {
    Line { points: Vec<[f64; 2]>, width: f64, colour: Colour },
    Area { points: Vec<[f64; 2]>, colour: Colour, opacity: f64 },
    Circle { centre: [f64; 2], radius: f64, colour: Colour, opacity: f64 },
    Text { at: [f64; 2], anchor: Anchor, upwards: bool, text: String, colour: Colour },
}

/// A drawing in pixels, y downwards.
#[derive(Clone, Debug)]
pub struct Drawing {
    width: f64,
    height: f64,
    shapes: Vec<Shape>,
}

impl Drawing {
    /// A white sheet, px.
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    /// A polyline; points that are not finite break it.
    pub fn line(&mut self, points: &[[f64; 2]], width: f64, colour: Colour) {
        for run in points.split(|p| !(p[0].is_finite() && p[1].is_finite())) {
            if run.len() > 1 {
                self.shapes.push(Shape::Line { points: run.to_vec(), width, colour });
            }
        }
    }

    /// A filled polygon, `opacity` 0 to 1; nothing if a point is not finite.
    pub fn area(&mut self, points: &[[f64; 2]], colour: Colour, opacity: f64) {
        if points.len() > 2 && points.iter().flatten().all(|c| c.is_finite()) {
            self.shapes.push(Shape::Area { points: points.to_vec(), colour, opacity });
        }
    }

    /// A filled rectangle from its upper left corner.
    pub fn rectangle(&mut self, [x, y]: [f64; 2], [w, h]: [f64; 2], colour: Colour) {
        self.area(&[[x, y], [x + w, y], [x + w, y + h], [x, y + h]], colour, 1.0);
    }

    /// A filled circle, `opacity` 0 to 1; nothing if its centre is not finite.
    pub fn circle(&mut self, centre: [f64; 2], radius: f64, colour: Colour, opacity: f64) {
        if centre.iter().all(|c| c.is_finite()) {
            self.shapes.push(Shape::Circle { centre, radius, colour, opacity });
        }
    }

    /// A cross of two short lines.
    pub fn cross(&mut self, [x, y]: [f64; 2], half: f64, colour: Colour) {
        self.line(&[[x - half, y - half], [x + half, y + half]], 1.6, colour);
        self.line(&[[x - half, y + half], [x + half, y - half]], 1.6, colour);
    }

    /// A text on its base line.
    pub fn text(&mut self, at: [f64; 2], anchor: Anchor, text: &str, colour: Colour) {
        self.shapes.push(Shape::Text { at, anchor, upwards: false, text: text.to_owned(), colour });
    }

    /// A text that reads upwards, its middle at `at`.
    pub fn text_upwards(&mut self, at: [f64; 2], text: &str, colour: Colour) {
        let text = text.to_owned();
        self.shapes.push(Shape::Text { at, anchor: Anchor::Middle, upwards: true, text, colour });
    }

    /// Width and height, px.
    pub fn size(&self) -> [f64; 2] {
        [self.width, self.height]
    }

    /// Every text of the drawing.
    pub fn texts(&self) -> impl Iterator<Item = &str> {
        self.shapes.iter().filter_map(|shape| match shape {
            Shape::Text { text, .. } => Some(text.as_str()),
            _ => None,
        })
    }

    /// Smallest box that holds every line, area and circle drawn: left, top, right, bottom, px.
    pub fn extent(&self) -> Option<[f64; 4]> {
        let mut extent: Option<[f64; 4]> = None;
        let mut hold = |[x, y]: [f64; 2], r: f64| {
            let [l, t, rt, b] = extent.unwrap_or([x - r, y - r, x + r, y + r]);
            extent = Some([l.min(x - r), t.min(y - r), rt.max(x + r), b.max(y + r)]);
        };
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, .. } | Shape::Area { points, .. } => {
                    points.iter().for_each(|point| hold(*point, 0.0));
                }
                Shape::Circle { centre, radius, .. } => hold(*centre, *radius),
                Shape::Text { .. } => {}
            }
        }
        extent
    }

    /// The drawing as an SVG file.
    pub fn svg(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_svg(&mut out);
        out
    }

    fn write_svg(&self, out: &mut String) -> std::fmt::Result {
        let (w, h) = (self.width, self.height);
        writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"DejaVu Sans, Verdana, sans-serif\" font-size=\"{FONT_PX}\">\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>"
        )?;
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, width, colour } => writeln!(
                    out,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\"/>",
                    list(points),
                    hex(*colour)
                )?,
                Shape::Area { points, colour, opacity } => {
                    writeln!(out, "<polygon points=\"{}\" {}/>", list(points), fill(*colour, *opacity))?;
                }
                Shape::Circle { centre: [x, y], radius, colour, opacity } => writeln!(
                    out,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" {}/>",
                    fill(*colour, *opacity)
                )?,
                Shape::Text { at: [x, y], anchor, upwards, text, colour } => {
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    let turn = if *upwards {
                        format!(" transform=\"rotate(-90 {x:.1} {y:.1})\"")
                    } else {
                        String::new()
                    };
                    writeln!(
                        out,
                        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" fill=\"{}\"{turn}>{}</text>",
                        hex(*colour),
                        escaped(text)
                    )?;
                }
            }
        }
        writeln!(out, "</svg>")
    }
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn fill(colour: Colour, opacity: f64) -> String {
    if opacity < 1.0 {
        format!("fill=\"{}\" fill-opacity=\"{opacity}\"", hex(colour))
    } else {
        format!("fill=\"{}\"", hex(colour))
    }
}

fn list(points: &[[f64; 2]]) -> String {
    points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_split_between_words_alone() {
        assert_eq!(wrapped("force of the hand", 60.0), ["force of", "the hand"]);
        assert_eq!(wrapped("  unbreakable ", 10.0), ["unbreakable"]);
    }

    #[test]
    fn what_is_not_finite_is_left_out_and_text_is_escaped() {
        let mut drawing = Drawing::new(60.0, 30.0);
        drawing.line(&[[0.0, f64::NAN], [1.0, 1.0], [2.0, 2.0]], 1.0, RED);
        drawing.area(&[[0.0, 0.0], [1.0, f64::INFINITY], [1.0, 1.0]], RED, 1.0);
        drawing.circle([f64::NAN, 1.0], 2.0, RED, 1.0);
        drawing.text([30.0, 12.0], Anchor::Start, "a<b & c", BLACK);
        let svg = drawing.svg();
        assert!(svg.contains("a&lt;b &amp; c") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(svg.matches("<polyline").count(), 1);
        assert_eq!(drawing.extent(), Some([1.0, 1.0, 2.0, 2.0]));
    }
}

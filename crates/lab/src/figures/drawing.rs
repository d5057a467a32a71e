//! Line drawings as SVG and as PNG from one list of shapes.

use font8x8::{BASIC_FONTS, GREEK_FONTS, LATIN_FONTS, UnicodeFonts};
use std::fmt::Write;

/// Width of a PNG's character over its height; the bitmap font is square.
const FONT_PX: f64 = 8.0;
/// The PNG is drawn this much larger and then averaged: smooth lines.
const OVERSAMPLING: usize = 2;

/// Red, green, blue.
pub(crate) type Colour = [u8; 3];

pub(crate) const BLACK: Colour = [30, 30, 30];
pub(crate) const GREY: Colour = [190, 190, 190];
pub(crate) const RED: Colour = [200, 40, 40];
/// Distinct for colour-blind readers too (Okabe and Ito).
pub(crate) const PALETTE: [Colour; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [90, 90, 90],
];

/// Where a text's anchor is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

#[derive(Clone, Debug)]
enum Shape {
    Line { points: Vec<[f64; 2]>, width: f64, colour: Colour },
    Area { points: Vec<[f64; 2]>, colour: Colour },
    Circle { centre: [f64; 2], radius: f64, colour: Colour },
    Text { at: [f64; 2], anchor: Anchor, text: String, colour: Colour },
}

/// A drawing in pixels, y downwards.
#[derive(Clone, Debug)]
pub(crate) struct Drawing {
    width: f64,
    height: f64,
    shapes: Vec<Shape>,
}

impl Drawing {
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    /// A polyline; points that are not finite break it.
    pub(crate) fn line(&mut self, points: &[[f64; 2]], width: f64, colour: Colour) {
        for run in points.split(|p| !(p[0].is_finite() && p[1].is_finite())) {
            if run.len() > 1 {
                self.shapes.push(Shape::Line { points: run.to_vec(), width, colour });
            }
        }
    }

    /// A filled convex polygon.
    pub(crate) fn area(&mut self, points: &[[f64; 2]], colour: Colour) {
        self.shapes.push(Shape::Area { points: points.to_vec(), colour });
    }

    pub(crate) fn rectangle(&mut self, [x, y]: [f64; 2], [w, h]: [f64; 2], colour: Colour) {
        self.area(&[[x, y], [x + w, y], [x + w, y + h], [x, y + h]], colour);
    }

    pub(crate) fn circle(&mut self, centre: [f64; 2], radius: f64, colour: Colour) {
        if centre.iter().all(|c| c.is_finite()) {
            self.shapes.push(Shape::Circle { centre, radius, colour });
        }
    }

    pub(crate) fn text(&mut self, at: [f64; 2], anchor: Anchor, text: &str, colour: Colour) {
        self.shapes.push(Shape::Text { at, anchor, text: text.to_owned(), colour });
    }

    pub(crate) fn svg(&self) -> String {
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
             font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>"
        )?;
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, width, colour } => writeln!(
                    out,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\"/>",
                    list(points),
                    hex(*colour)
                )?,
                Shape::Area { points, colour } => {
                    writeln!(out, "<polygon points=\"{}\" fill=\"{}\"/>", list(points), hex(*colour))?;
                }
                Shape::Circle { centre: [x, y], radius, colour } => {
                    writeln!(
                        out,
                        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"{}\"/>",
                        hex(*colour)
                    )?;
                }
                Shape::Text { at: [x, y], anchor, text, colour } => {
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    let text = text.replace('&', "&amp;").replace('<', "&lt;");
                    writeln!(
                        out,
                        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" fill=\"{}\">{text}</text>",
                        hex(*colour)
                    )?;
                }
            }
        }
        writeln!(out, "</svg>")
    }

    /// The drawing as a PNG file.
    ///
    /// # Errors
    /// The encoder's.
    pub(crate) fn png(&self) -> anyhow::Result<Vec<u8>> {
        let mut canvas = Canvas::new(pixels(self.width), pixels(self.height));
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, width, colour } => {
                    for pair in points.windows(2) {
                        canvas.segment(pair[0], pair[1], *width, *colour);
                    }
                }
                Shape::Area { points, colour } => canvas.polygon(points, *colour),
                Shape::Circle { centre, radius, colour } => {
                    canvas.segment(*centre, *centre, 2.0 * radius, *colour);
                }
                Shape::Text { at, anchor, text, colour } => canvas.text(*at, *anchor, text, *colour),
            }
        }
        canvas.encode()
    }
}

fn hex([r, g, b]: Colour) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn list(points: &[[f64; 2]]) -> String {
    points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

fn pixels(length: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 1..=8192")]
    let pixels = length.clamp(1.0, 8192.0) as usize;
    pixels
}

/// Pixels, [`OVERSAMPLING`] times finer than the drawing.
struct Canvas {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        let (width, height) = (width * OVERSAMPLING, height * OVERSAMPLING);
        Self { width, height, rgb: vec![255; 3 * width * height] }
    }

    fn fine(length: f64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a small constant")]
        let factor = OVERSAMPLING as f64;
        length * factor
    }

    /// Fills every pixel of the box around (x, y) ± half for which `inside` holds.
    fn fill(&mut self, x: [f64; 2], y: [f64; 2], colour: Colour, inside: impl Fn(f64, f64) -> bool) {
        let range = |[from, to]: [f64; 2], most: usize| {
            let clamped = |v: f64| if v.is_finite() && v > 0.0 { pixels(v.max(1.0)) } else { 0 };
            clamped(from.floor()).min(most)..(clamped(to.ceil()) + 1).min(most)
        };
        for row in range(y, self.height) {
            for column in range(x, self.width) {
                #[expect(clippy::cast_precision_loss, reason = "pixel numbers")]
                if inside(column as f64 + 0.5, row as f64 + 0.5) {
                    let start = 3 * (row * self.width + column);
                    self.rgb[start..start + 3].copy_from_slice(&colour);
                }
            }
        }
    }

    fn segment(&mut self, from: [f64; 2], to: [f64; 2], width: f64, colour: Colour) {
        let [ax, ay] = from.map(Self::fine);
        let [bx, by] = to.map(Self::fine);
        let half = 0.5 * Self::fine(width).max(1.0);
        let (dx, dy) = (bx - ax, by - ay);
        let length2 = (dx * dx + dy * dy).max(1e-12);
        self.fill(
            [ax.min(bx) - half, ax.max(bx) + half],
            [ay.min(by) - half, ay.max(by) + half],
            colour,
            |x, y| {
                let along = (((x - ax) * dx + (y - ay) * dy) / length2).clamp(0.0, 1.0);
                (x - ax - along * dx).hypot(y - ay - along * dy) <= half
            },
        );
    }

    fn polygon(&mut self, points: &[[f64; 2]], colour: Colour) {
        let fine: Vec<[f64; 2]> = points.iter().map(|p| p.map(Self::fine)).collect();
        let bound = |axis: usize| {
            fine.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], p| {
                [low.min(p[axis]), high.max(p[axis])]
            })
        };
        self.fill(bound(0), bound(1), colour, |x, y| {
            let side = |i: usize| {
                let (a, b) = (fine[i], fine[(i + 1) % fine.len()]);
                (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            };
            (0..fine.len()).all(|i| side(i) >= 0.0) || (0..fine.len()).all(|i| side(i) <= 0.0)
        });
    }

    fn text(&mut self, [x, y]: [f64; 2], anchor: Anchor, text: &str, colour: Colour) {
        #[expect(clippy::cast_precision_loss, reason = "a short text")]
        let length = text.chars().count() as f64 * FONT_PX;
        let left = match anchor {
            Anchor::Start => x,
            Anchor::Middle => x - 0.5 * length,
            Anchor::End => x - length,
        };
        let mut at = left;
        for character in text.chars() {
            self.glyph([at, y - FONT_PX], plain(character), colour);
            at += FONT_PX;
        }
    }

    fn glyph(&mut self, [x, y]: [f64; 2], character: char, colour: Colour) {
        let glyph = BASIC_FONTS
            .get(character)
            .or_else(|| LATIN_FONTS.get(character))
            .or_else(|| GREEK_FONTS.get(character))
            .unwrap_or([0, 0, 0, 24, 24, 0, 0, 0]);
        let side = Self::fine(1.0);
        for (row, bits) in (0u8..).zip(glyph) {
            for column in (0u8..8).filter(|column| bits & (1 << column) != 0) {
                let px = Self::fine(x).round() + side * f64::from(column);
                let py = Self::fine(y).round() + side * f64::from(row);
                self.fill([px, px + side - 1.0], [py, py + side - 1.0], colour, |cx, cy| {
                    cx >= px && cx < px + side && cy >= py && cy < py + side
                });
            }
        }
    }

    /// Averages down and encodes.
    fn encode(&self) -> anyhow::Result<Vec<u8>> {
        let (width, height) = (self.width / OVERSAMPLING, self.height / OVERSAMPLING);
        let mut small = Vec::with_capacity(3 * width * height);
        let area = OVERSAMPLING * OVERSAMPLING;
        for row in 0..height {
            for column in 0..width {
                for channel in 0..3 {
                    let mut sum = 0;
                    for dy in 0..OVERSAMPLING {
                        for dx in 0..OVERSAMPLING {
                            let (y, x) = (row * OVERSAMPLING + dy, column * OVERSAMPLING + dx);
                            sum += usize::from(self.rgb[3 * (y * self.width + x) + channel]);
                        }
                    }
                    small.push(u8::try_from(sum / area)?);
                }
            }
        }
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, u32::try_from(width)?, u32::try_from(height)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header()?.write_image_data(&small)?;
        Ok(file)
    }
}

/// What the bitmap font has instead of a character that it lacks.
fn plain(character: char) -> char {
    match character {
        '−' | '–' => '-',
        '·' => '.',
        '→' => '>',
        'ẏ' => 'y',
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn svg_and_png_hold_what_was_drawn() {
        let mut drawing = Drawing::new(60.0, 30.0);
        drawing.line(&[[5.0, 25.0], [55.0, 25.0]], 2.0, RED);
        drawing.rectangle([10.0, 2.0], [8.0, 8.0], BLACK);
        drawing.text([30.0, 12.0], Anchor::Start, "a<b", BLACK);
        drawing.line(&[[0.0, f64::NAN], [1.0, 1.0]], 1.0, RED);
        let svg = drawing.svg();
        assert!(svg.contains("a&lt;b") && svg.matches("<polyline").count() == 1, "{svg}");

        let file = drawing.png().unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!((info.width, info.height), (60, 30));
        let at = |x: usize, y: usize| &rgb[3 * (60 * y + x)..3 * (60 * y + x) + 3];
        assert_eq!(at(30, 25), RED);
        assert_eq!(at(14, 6), BLACK);
        assert_eq!(at(1, 1), [255; 3]);
        assert!((30..54).any(|x| at(x, 8) != [255; 3]), "the text left marks");
    }
}

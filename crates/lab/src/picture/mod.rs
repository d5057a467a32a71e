//! A drawing as PNG and PDF: resvg reads its SVG with the embedded font.

mod font;
mod pdf;

use anyhow::Context as _;
use font::{FONT, PictureError, refused};
use moca_figures::Drawing;
use resvg::{tiny_skia, usvg};
use skrifa::{FontRef, MetadataProvider};
use std::path::Path;

/// Pixels of the PNG for each of the drawing.
const SCALE: f32 = 2.0;

/// Pixels of one millimetre on paper: 96 px are one inch, so that text is 8.25 pt high.
const PX_PER_MM: f64 = 96.0 / 25.4;

/// Width of a figure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Width {
    /// 900 px.
    #[default]
    Screen,
    /// One column of a journal, 88 mm.
    Single,
    /// Both columns of a journal, 180 mm.
    Double,
}

impl Width {
    /// Returns the width in px.
    pub(crate) fn px(self) -> f64 {
        match self {
            Self::Screen => 900.0,
            Self::Single => 88.0 * PX_PER_MM,
            Self::Double => 180.0 * PX_PER_MM,
        }
    }
}

/// Pictures that can be drawn as seen.
pub(crate) trait Picture {
    /// The drawing as a PNG file, twice as fine as its pixels.
    ///
    /// # Errors
    /// A character that the font lacks: a text that would not be seen is no picture.
    fn png(&self) -> Result<Vec<u8>, PictureError>;

    /// The drawing as a PDF file of one page: 96 px are one inch.
    ///
    /// # Errors
    /// As [`Self::png`].
    fn pdf(&self) -> Result<Vec<u8>, PictureError>;

    /// Writes `path`.svg, `path`.pdf and `path`.png.
    ///
    /// # Errors
    /// As [`Self::png`], or a file that cannot be written.
    fn write(&self, path: &Path) -> anyhow::Result<()>;

    /// Texts that run over the edge of the drawing, and how many were not drawn at all.
    ///
    /// # Errors
    /// As [`Self::png`].
    #[cfg(test)]
    fn texts_outside(&self) -> Result<Vec<String>, PictureError>;
}

impl Picture for Drawing {
    fn png(&self) -> Result<Vec<u8>, PictureError> {
        check_glyphs(self)?;
        let tree = tree(self)?;
        let Some(size) = tree.size().to_int_size().scale_by(SCALE) else {
            return Err(refused(&"it is empty"));
        };
        let Some(mut pixmap) = tiny_skia::Pixmap::new(size.width(), size.height()) else {
            return Err(refused(&"it is too large"));
        };
        resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut pixmap.as_mut());
        pixmap.encode_png().map_err(|error| refused(&error))
    }

    fn pdf(&self) -> Result<Vec<u8>, PictureError> {
        check_glyphs(self)?;
        pdf::pdf(&tree(self)?)
    }

    fn write(&self, path: &Path) -> anyhow::Result<()> {
        for (ending, bytes) in [("svg", self.svg().into_bytes()), ("pdf", self.pdf()?), ("png", self.png()?)]
        {
            let path = path.with_extension(ending);
            std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    #[cfg(test)]
    fn texts_outside(&self) -> Result<Vec<String>, PictureError> {
        check_glyphs(self)?;
        let tree = tree(self)?;
        let (width, height) = (tree.size().width(), tree.size().height());
        let (mut drawn, mut outside) = (Vec::new(), Vec::new());
        texts_in(tree.root(), &mut drawn);
        for text in &drawn {
            let bounds = text.abs_bounding_box();
            let inside = bounds.left() >= 0.0
                && bounds.top() >= 0.0
                && bounds.right() <= width
                && bounds.bottom() <= height;
            if !inside {
                outside.push(text.chunks().iter().map(usvg::TextChunk::text).collect::<String>());
            }
        }
        let wanted = self.texts().filter(|text| !text.trim().is_empty()).count();
        if drawn.len() < wanted {
            outside.push(format!("{} of {wanted} texts were not drawn at all", wanted - drawn.len()));
        }
        Ok(outside)
    }
}

fn check_glyphs(drawing: &Drawing) -> Result<(), PictureError> {
    let font = FontRef::new(FONT).map_err(|error| refused(&error))?;
    let characters = font.charmap();
    for text in drawing.texts() {
        let missing = |c: &char| !c.is_whitespace() && characters.map(*c).is_none();
        if let Some(character) = text.chars().find(missing) {
            return Err(PictureError::NoGlyph { character, text: text.to_owned() });
        }
    }
    Ok(())
}

fn tree(drawing: &Drawing) -> Result<usvg::Tree, PictureError> {
    let mut options = usvg::Options { font_family: "DejaVu Sans".into(), ..usvg::Options::default() };
    options.fontdb_mut().load_font_data(FONT.to_vec());
    usvg::Tree::from_str(&drawing.svg(), &options).map_err(|error| refused(&error))
}

#[cfg(test)]
fn texts_in<'a>(group: &'a usvg::Group, found: &mut Vec<&'a usvg::Text>) {
    for node in group.children() {
        match node {
            usvg::Node::Text(text) => found.push(text),
            usvg::Node::Group(group) => texts_in(group, found),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

    use super::*;
    use moca_figures::{Anchor, BLACK, Map, Panel, RED, Scale, Series};

    fn pixels(drawing: &Drawing) -> tiny_skia::Pixmap {
        tiny_skia::Pixmap::decode_png(&drawing.png().unwrap()).unwrap()
    }

    fn dark(pixmap: &tiny_skia::Pixmap) -> usize {
        pixmap.pixels().iter().filter(|p| p.red() < 128).count()
    }

    #[test]
    fn a_picture_holds_what_was_drawn() {
        let mut drawing = Drawing::new(60.0, 30.0);
        drawing.line(&[[5.0, 25.0], [55.0, 25.0]], 2.0, RED);
        drawing.rectangle([10.0, 2.0], [8.0, 8.0], BLACK);
        let pixmap = pixels(&drawing);
        assert_eq!((pixmap.width(), pixmap.height()), (120, 60));
        let at = |x, y| {
            let p = pixmap.pixel(x, y).unwrap();
            [p.red(), p.green(), p.blue()]
        };
        assert_eq!((at(60, 50), at(28, 12), at(2, 2)), (RED, BLACK, [255; 3]));
    }

    #[test]
    fn every_kind_of_text_that_figures_use_leaves_ink() {
        for text in ["K_d e·ẏ ≤ −10⁻³", "η_B/η_A τ_v,ext ± 0.5 °", "→ ∞ Σ √ ∂ µm m/s²", "N·s/m (k₀, θ₁)"]
        {
            let mut drawing = Drawing::new(260.0, 20.0);
            drawing.text([4.0, 14.0], Anchor::Start, text, BLACK);
            assert!(dark(&pixels(&drawing)) > 100, "{text}");
            assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new());
        }
    }

    #[test]
    fn panels_and_maps_keep_their_texts_inside() {
        let mut drawing = Drawing::new(400.0, 420.0);
        let panel = Panel {
            x_scale: Scale::Log,
            y_scale: Scale::Log,
            series: vec![Series::line(0, "a line", vec![[0.01, 0.1], [1.0, 10.0]])],
            levels: vec![(25.0, "UNSAFE")],
            ..Panel::new("title", "t [s]", "N")
        };
        panel.draw(&mut drawing, [0.0, 0.0], [400.0, 200.0]);
        let map = Map {
            title: "worst of all phases [N]".into(),
            x_label: "speed [m/s]".into(),
            y_label: "taxel".into(),
            x: vec!["0.04".into(), "0.08".into()],
            y: vec!["T1".into(), "T11".into()],
            cells: vec![([200; 3], "24.9".to_owned()); 4],
            sides: vec![true, false, true, false],
            legend: vec![([200; 3], "all the same")],
            fit_px: None,
        };
        map.draw(&mut drawing, [0.0, 210.0], [60.0, 30.0]);
        assert_eq!(drawing.texts_outside(), Ok(Vec::new()));
    }

    #[test]
    fn a_text_that_would_not_be_seen_is_an_error() {
        let mut drawing = Drawing::new(60.0, 30.0);
        drawing.text([4.0, 14.0], Anchor::Start, "力 12 N", BLACK);
        let error = drawing.png().unwrap_err();
        assert_eq!(error.to_string(), "the embedded font has no glyph for '力' of \"力 12 N\"");
        let mut drawing = Drawing::new(60.0, 30.0);
        drawing.text([40.0, 14.0], Anchor::Start, "runs over the edge", BLACK);
        assert_eq!(drawing.texts_outside().unwrap(), ["runs over the edge"]);
    }

    fn streams(pdf: &[u8]) -> Vec<Vec<u8>> {
        let find = |from: usize, what: &[u8]| {
            let at = pdf.get(from..)?.windows(what.len()).position(|window| window == what)?;
            Some(from + at)
        };
        let (mut found, mut from) = (Vec::new(), 0);
        while let Some(begin) = find(from, b"\nstream\n") {
            let begin = begin + b"\nstream\n".len();
            let end = find(begin, b"\nendstream").unwrap();
            let stream = pdf[begin..end].to_vec();
            found.push(miniz_oxide::inflate::decompress_to_vec_zlib(&stream).unwrap_or(stream));
            from = end;
        }
        found
    }

    #[test]
    fn widths_are_those_of_journal_columns() {
        let mm = [Width::Single, Width::Double].map(|width| width.px() / PX_PER_MM);
        assert!((mm[0] - 88.0).abs() < 1e-9 && (mm[1] - 180.0).abs() < 1e-9, "{mm:?}");
    }

    #[test]
    fn pdf_has_its_physical_size_and_keeps_vectors_and_texts() {
        let mut drawing = Drawing::new(Width::Single.px(), 96.0);
        drawing.line(&[[5.0, 25.0], [55.0, 25.0]], 2.0, RED);
        drawing.area(&[[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]], RED, 0.2);
        drawing.circle([20.0, 20.0], 4.0, BLACK, 1.0);
        drawing.text([4.0, 14.0], Anchor::Start, "τ ≤ 5", BLACK);
        drawing.text_upwards([30.0, 50.0], "N·m", BLACK);
        let pdf = drawing.pdf().unwrap();
        let shown = String::from_utf8_lossy(&pdf);
        // 88 mm are 249.4 points, 96 px are 72.
        assert!(shown.contains("/MediaBox [0 0 249.448"), "{shown:.600}");
        assert!(shown.contains("/ca 0.2") && !shown.contains("/Image"));
        let streams = streams(&pdf);
        let content = String::from_utf8_lossy(&streams[0]);
        assert!(content.contains("5 25 m\n55 25 l\nS"), "{content}");
        // The circle's curves, a glyph for each character but spaces or with them, text that reads upwards.
        assert!(content.matches(" c\n").count() >= 4 && content.matches("Tj").count() >= 6, "{content}");
        // Reads upwards: the first axis of the text points up, the second one to the left.
        assert!(content.lines().any(|line| line.contains(" -11 -11 ") && line.ends_with("Tm")), "{content}");
        let unicode = String::from_utf8_lossy(&streams[1]);
        for character in ['τ', '≤', '5', '·'] {
            assert!(unicode.contains(&format!("<{:04X}>", u32::from(character))), "{character}: {unicode}");
        }
    }
}

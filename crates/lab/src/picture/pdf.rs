//! A drawing as PDF: lines, areas and texts stay vectors, and texts can be searched and copied.

use super::font::{FONT, PictureError, refused};
use pdf_writer::types::{CidFontType, FontFlags, LineCapStyle, LineJoinStyle, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Filter, Finish as _, Name, Pdf, Rect, Ref, Str};
use resvg::tiny_skia::{PathSegment, Point, Transform};
use resvg::usvg;
use skrifa::instance::{LocationRef, Size};
use skrifa::{FontRef, GlyphId, MetadataProvider as _};

/// Points of one pixel: 96 px and 72 points are one inch.
const POINTS: f32 = 0.75;
/// Units of an em in a PDF font.
const EM: f32 = 1000.0;
/// Size of the effort that compression takes, 0 to 10.
const EFFORT: u8 = 6;

const FONT_NAME: Name<'static> = Name(b"DejaVuSans");
const SYSTEM: SystemInfo<'static> =
    SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };
const CATALOG: Ref = Ref::new(1);
const PAGES: Ref = Ref::new(2);
const PAGE: Ref = Ref::new(3);
const CONTENT: Ref = Ref::new(4);
const TYPE_0: Ref = Ref::new(5);
const CID_FONT: Ref = Ref::new(6);
const DESCRIPTOR: Ref = Ref::new(7);
const FONT_FILE: Ref = Ref::new(8);
const TO_UNICODE: Ref = Ref::new(9);
/// First of the graphics states, one for each opacity.
const OPACITIES: i32 = 10;

/// Writes one page of the tree's size.
///
/// # Errors
/// A font that cannot be read, or a kind of SVG element that no drawing has.
pub(super) fn pdf(tree: &usvg::Tree) -> Result<Vec<u8>, PictureError> {
    let font = FontRef::new(FONT).map_err(|error| refused(&error))?;
    let units_per_em = f32::from(font.metrics(Size::unscaled(), LocationRef::default()).units_per_em);
    let (content, unicode) = (Content::new(), UnicodeCmap::new(FONT_NAME, SYSTEM));
    let mut page = Page { content, opacities: vec![1.0], unicode, units_per_em };
    let (width, height) = (tree.size().width(), tree.size().height());
    page.content.transform([POINTS, 0.0, 0.0, -POINTS, 0.0, POINTS * height]);
    page.content.set_line_cap(LineCapStyle::ButtCap).set_line_join(LineJoinStyle::MiterJoin);
    page.group(tree.root())?;

    let mut pdf = Pdf::new();
    pdf.catalog(CATALOG).pages(PAGES);
    pdf.pages(PAGES).kids([PAGE]).count(1);
    let mut out = pdf.page(PAGE);
    out.parent(PAGES).contents(CONTENT).media_box(Rect::new(0.0, 0.0, POINTS * width, POINTS * height));
    let mut resources = out.resources();
    resources.fonts().pair(FONT_NAME, TYPE_0);
    let mut states = resources.ext_g_states();
    for (i, id) in (0..page.opacities.len()).zip(OPACITIES..) {
        states.pair(Name(state_name(i).as_bytes()), Ref::new(id));
    }
    states.finish();
    resources.finish();
    out.finish();
    for (opacity, id) in page.opacities.iter().zip(OPACITIES..) {
        pdf.ext_graphics(Ref::new(id)).non_stroking_alpha(*opacity).stroking_alpha(*opacity);
    }
    let content = compressed(&page.content.finish());
    pdf.stream(CONTENT, &content).filter(Filter::FlateDecode);
    pdf.cmap(TO_UNICODE, &page.unicode.finish());
    embed(&mut pdf, &font)?;
    Ok(pdf.finish())
}

/// Content of a page as it is written.
struct Page {
    content: Content,
    opacities: Vec<f32>,
    unicode: UnicodeCmap,
    /// Units of an outline's em.
    units_per_em: f32,
}

impl Page {
    fn group(&mut self, group: &usvg::Group) -> Result<(), PictureError> {
        let plain = group.opacity() == usvg::Opacity::ONE
            && group.clip_path().is_none()
            && group.mask().is_none()
            && group.filters().is_empty();
        if !plain {
            return Err(refused(&"no drawing has a group with opacity, mask or filter"));
        }
        for node in group.children() {
            match node {
                usvg::Node::Group(group) => self.group(group)?,
                usvg::Node::Path(path) => self.path(path)?,
                usvg::Node::Text(text) => self.text(text)?,
                usvg::Node::Image(_) => return Err(refused(&"no drawing has an image")),
            }
        }
        Ok(())
    }

    fn path(&mut self, path: &usvg::Path) -> Result<(), PictureError> {
        let (fill, stroke) = (path.fill(), path.stroke());
        let opacity =
            fill.map(|f| f.opacity()).or(stroke.map(|s| s.opacity())).map_or(1.0, |opacity| opacity.get());
        self.opacity(opacity);
        if let Some(fill) = fill {
            let [r, g, b] = colour(fill.paint())?;
            self.content.set_fill_rgb(r, g, b);
        }
        if let Some(stroke) = stroke {
            let [r, g, b] = colour(stroke.paint())?;
            self.content.set_stroke_rgb(r, g, b).set_line_width(stroke.width().get());
        }
        self.outline(path);
        match (fill, stroke) {
            (Some(_), Some(_)) => self.content.fill_nonzero_and_stroke(),
            (Some(_), None) => self.content.fill_nonzero(),
            (None, Some(_)) => self.content.stroke(),
            (None, None) => self.content.end_path(),
        };
        Ok(())
    }

    fn outline(&mut self, path: &usvg::Path) {
        let to_page = |mut point: Point| {
            path.abs_transform().map_point(&mut point);
            point
        };
        let mut last = Point::zero();
        for segment in path.data().segments() {
            match segment {
                PathSegment::MoveTo(p) => {
                    last = to_page(p);
                    self.content.move_to(last.x, last.y);
                }
                PathSegment::LineTo(p) => {
                    last = to_page(p);
                    self.content.line_to(last.x, last.y);
                }
                PathSegment::QuadTo(control, p) => {
                    // The cubic curve with the same points: two thirds of the way to the control point.
                    let (control, end) = (to_page(control), to_page(p));
                    let third = |from: Point| {
                        (from.x + 2.0 / 3.0 * (control.x - from.x), from.y + 2.0 / 3.0 * (control.y - from.y))
                    };
                    let ((x1, y1), (x2, y2)) = (third(last), third(end));
                    self.content.cubic_to(x1, y1, x2, y2, end.x, end.y);
                    last = end;
                }
                PathSegment::CubicTo(a, b, p) => {
                    let (a, b) = (to_page(a), to_page(b));
                    last = to_page(p);
                    self.content.cubic_to(a.x, a.y, b.x, b.y, last.x, last.y);
                }
                PathSegment::Close => {
                    self.content.close_path();
                }
            }
        }
    }

    fn text(&mut self, text: &usvg::Text) -> Result<(), PictureError> {
        for span in text.layouted() {
            let fill = span.fill.as_ref();
            self.opacity(fill.map_or(1.0, |fill| fill.opacity().get()));
            let [r, g, b] = fill.map_or(Ok([0.0; 3]), |fill| colour(fill.paint()))?;
            self.content.set_fill_rgb(r, g, b).begin_text();
            for glyph in &span.positioned_glyphs {
                let id = u16::try_from(glyph.id.0).map_err(|error| refused(&error))?;
                // An outline has its font's units; a PDF font of size 1 has one em.
                let em = Transform::from_scale(self.units_per_em, self.units_per_em);
                let Transform { sx, kx, ky, sy, tx, ty } =
                    text.abs_transform().pre_concat(glyph.outline_transform()).pre_concat(em);
                self.content.set_font(FONT_NAME, 1.0).set_text_matrix([sx, ky, kx, sy, tx, ty]);
                self.content.show(Str(&id.to_be_bytes()));
                self.unicode.pair_with_multiple(id, glyph.text.chars());
            }
            self.content.end_text();
        }
        Ok(())
    }

    /// Sets the opacity of what is drawn next.
    fn opacity(&mut self, opacity: f32) {
        let known = self.opacities.iter().position(|known| (known - opacity).abs() < 1e-6);
        let i = known.unwrap_or_else(|| {
            self.opacities.push(opacity);
            self.opacities.len() - 1
        });
        self.content.set_parameters(Name(state_name(i).as_bytes()));
    }
}

fn state_name(i: usize) -> String {
    format!("opacity{i}")
}

fn colour(paint: &usvg::Paint) -> Result<[f32; 3], PictureError> {
    match paint {
        usvg::Paint::Color(c) => Ok([c.red, c.green, c.blue].map(|part| f32::from(part) / 255.0)),
        _ => Err(refused(&"no drawing has a gradient or a pattern")),
    }
}

fn compressed(bytes: &[u8]) -> Vec<u8> {
    miniz_oxide::deflate::compress_to_vec_zlib(bytes, EFFORT)
}

/// The embedded font: its file as it is, the widths of its glyphs.
fn embed(pdf: &mut Pdf, font: &FontRef<'_>) -> Result<(), PictureError> {
    let metrics = font.metrics(Size::new(EM), LocationRef::default());
    let glyphs = font.glyph_metrics(Size::new(EM), LocationRef::default());
    let widths = (0..metrics.glyph_count).map(|id| glyphs.advance_width(GlyphId::from(id)).unwrap_or(0.0));
    let bounds = metrics
        .bounds
        .map_or([0.0, metrics.descent, EM, metrics.ascent], |b| [b.x_min, b.y_min, b.x_max, b.y_max]);

    let mut type_0 = pdf.type0_font(TYPE_0);
    type_0
        .base_font(FONT_NAME)
        .encoding_predefined(Name(b"Identity-H"))
        .descendant_font(CID_FONT)
        .to_unicode(TO_UNICODE);
    type_0.finish();
    let mut cid = pdf.cid_font(CID_FONT);
    cid.subtype(CidFontType::Type2).base_font(FONT_NAME).system_info(SYSTEM).font_descriptor(DESCRIPTOR);
    cid.cid_to_gid_map_predefined(Name(b"Identity"));
    cid.widths().consecutive(0, widths);
    cid.finish();
    pdf.font_descriptor(DESCRIPTOR)
        .name(FONT_NAME)
        .flags(FontFlags::NON_SYMBOLIC)
        .bbox(Rect::new(bounds[0], bounds[1], bounds[2], bounds[3]))
        .italic_angle(0.0)
        .ascent(metrics.ascent)
        .descent(metrics.descent)
        .cap_height(metrics.cap_height.unwrap_or(metrics.ascent))
        .stem_v(80.0)
        .font_file2(FONT_FILE);
    let file = compressed(FONT);
    let length = i32::try_from(FONT.len()).map_err(|error| refused(&error))?;
    pdf.stream(FONT_FILE, &file).filter(Filter::FlateDecode).pair(Name(b"Length1"), length);
    Ok(())
}

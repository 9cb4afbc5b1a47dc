//! A scene as a PNG of twice the resolution of a screen.

use tiny_skia::{FillRule, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, StrokeDash, Transform};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use crate::plot::canvas::{AREA, DASH, PlotColor, PlotScene, SceneShape, TextAnchor};
use crate::plot::error::PlotError;
use crate::plot::svg::MIDDLE;

/// Pixels in a point.
const PIXELS: f32 = 2.0;
/// Latin, Greek and Cyrillic letters and mathematical signs of DejaVu Sans; see assets/README.md.
pub(super) const FONT: &[u8] = include_bytes!("../../assets/DejaVuSans.ttf");

pub(super) fn png(scene: &PlotScene) -> Result<Vec<u8>, PlotError> {
    let failed = |what: String| PlotError::Draw(what);
    let font = Face::parse(FONT, 0).map_err(|error| failed(error.to_string()))?;
    let pixels = |points: f64| (points as f32 * PIXELS).ceil() as u32;
    let (wide, high) = (pixels(scene.width), pixels(scene.height));
    let mut pixmap = Pixmap::new(wide, high).ok_or_else(|| failed(format!("{wide} × {high} pixels are too many")))?;
    pixmap.fill(tiny_skia::Color::WHITE);
    let mut paper = PngPaper { pixmap, font };
    scene.shapes.iter().for_each(|shape| paper.put(shape));
    paper.pixmap.encode_png().map_err(|error| failed(error.to_string()))
}

struct PngPaper {
    pixmap: Pixmap,
    font: Face<'static>,
}

impl PngPaper {
    fn put(&mut self, shape: &SceneShape) {
        match shape {
            SceneShape::Line { points, color, width, dashed } => {
                let dash = if *dashed { StrokeDash::new(vec![DASH, DASH], 0.0) } else { None };
                self.stroke(through(points, false), *color, Stroke { width: *width as f32, dash, ..Stroke::default() });
            }
            SceneShape::Area { points, color } => self.fill(through(points, true), *color, AREA),
            SceneShape::Bar { from, to, color } => {
                let [[x, y], [right, bottom]] = [single(*from), single(*to)];
                self.fill(Rect::from_ltrb(x, y, right, bottom).map(PathBuilder::from_rect), *color, 1.0);
            }
            SceneShape::Dot { at, radius, color, filled } => {
                let [x, y] = single(*at);
                let circle = || PathBuilder::from_circle(x, y, *radius as f32);
                self.fill(circle(), if *filled { *color } else { [255; 3] }, 1.0);
                self.stroke(circle(), *color, Stroke::default());
            }
            SceneShape::Text { at, words, size, side, color } => {
                let letters = self.letters(words, single(*at), *size as f32, *side);
                self.fill(letters, *color, 1.0);
            }
        }
    }

    /// Nothing where there is no path: of one point, or without extent.
    fn fill(&mut self, path: Option<Path>, color: PlotColor, opacity: f32) {
        let Some(path) = path else { return };
        let scaled = Transform::from_scale(PIXELS, PIXELS);
        self.pixmap.fill_path(&path, &paint(color, opacity), FillRule::Winding, scaled, None);
    }

    fn stroke(&mut self, path: Option<Path>, color: PlotColor, stroke: Stroke) {
        let Some(path) = path else { return };
        let scaled = Transform::from_scale(PIXELS, PIXELS);
        self.pixmap.stroke_path(&path, &paint(color, 1.0), &stroke, scaled, None);
    }

    /// The outlines of words.
    fn letters(&self, words: &str, [x, y]: [f32; 2], size: f32, side: TextAnchor) -> Option<Path> {
        let scale = size / f32::from(self.font.units_per_em());
        let glyphs: Vec<GlyphId> = words.chars().map(|c| self.font.glyph_index(c).unwrap_or(GlyphId(0))).collect();
        let advance = |glyph: &GlyphId| scale * f32::from(self.font.glyph_hor_advance(*glyph).unwrap_or(0));
        let width: f32 = glyphs.iter().map(advance).sum();
        let before = match side {
            TextAnchor::Left => 0.0,
            TextAnchor::Middle => 0.5 * width,
            TextAnchor::Right => width,
        };
        let mut pen = GlyphPen { path: PathBuilder::new(), x: x - before, line: y + MIDDLE as f32 * size, scale };
        for glyph in &glyphs {
            self.font.outline_glyph(*glyph, &mut pen);
            pen.x += advance(glyph);
        }
        pen.path.finish()
    }
}

/// Writes outlines of letters, whose y goes up, where they belong.
struct GlyphPen {
    path: PathBuilder,
    x: f32,
    line: f32,
    scale: f32,
}

impl GlyphPen {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.x + self.scale * x, self.line - self.scale * y)
    }
}

impl OutlineBuilder for GlyphPen {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.path.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}

fn single([x, y]: [f64; 2]) -> [f32; 2] {
    [x as f32, y as f32]
}

fn through(points: &[[f64; 2]], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (k, [x, y]) in points.iter().map(|point| single(*point)).enumerate() {
        if k == 0 { path.move_to(x, y) } else { path.line_to(x, y) }
    }
    if closed {
        path.close();
    }
    path.finish()
}

fn paint(color: PlotColor, opacity: f32) -> Paint<'static> {
    let [red, green, blue] = color;
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(red, green, blue, (255.0 * opacity).round() as u8);
    paint
}

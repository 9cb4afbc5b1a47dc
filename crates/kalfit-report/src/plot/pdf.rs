//! A scene as a PDF of one page: lines stay lines, and words can be searched.

use std::collections::BTreeMap;

use pdf_writer::types::{CidFontType, FontFlags, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str};
use ttf_parser::{Face, GlyphId};

use crate::plot::canvas::{AREA, DASH, PlotColor, PlotScene, SceneShape, TextAnchor};
use crate::plot::error::PlotError;
use crate::plot::png::FONT;
use crate::plot::svg::MIDDLE;

/// Points of a page in a point of a screen: a figure 960 wide is 25 cm wide.
const SCALE: f32 = 0.75;
/// How far the control points of a quarter of a circle are from its ends, in radii: 4/3 (√2 - 1).
const QUARTER: f32 = 0.552_284_8;

const LETTERS: Name<'static> = Name(b"F");
const FAINT: Name<'static> = Name(b"A");
const FONT_NAME: Name<'static> = Name(b"DejaVuSans");
const IDENTITY: SystemInfo<'static> = SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };

pub(super) fn pdf(scene: &PlotScene) -> Result<Vec<u8>, PlotError> {
    let font = Face::parse(FONT, 0).map_err(|error| PlotError::Draw(error.to_string()))?;
    let mut page = PdfPage { content: Content::new(), font, glyphs: BTreeMap::new(), height: scene.height as f32 };
    page.content.transform([SCALE, 0.0, 0.0, SCALE, 0.0, 0.0]);
    scene.shapes.iter().for_each(|shape| page.put(shape));
    Ok(page.file(scene))
}

struct PdfPage {
    content: Content,
    font: Face<'static>,
    /// The letters that occur.
    glyphs: BTreeMap<u16, char>,
    height: f32,
}

impl PdfPage {
    fn put(&mut self, shape: &SceneShape) {
        match shape {
            SceneShape::Line { points, color, width, dashed } => {
                self.content.save_state().set_line_width(*width as f32);
                self.stroke_color(*color);
                if *dashed {
                    self.content.set_dash_pattern([DASH, DASH], 0.0);
                }
                self.through(points);
                self.content.stroke().restore_state();
            }
            SceneShape::Area { points, color } => {
                self.content.save_state().set_parameters(FAINT);
                self.fill_color(*color);
                self.through(points);
                self.content.close_path().fill_nonzero().restore_state();
            }
            SceneShape::Bar { from, to, color } => {
                let ([x, y], [right, bottom]) = (self.place(*from), self.place(*to));
                self.fill_color(*color);
                self.content.rect(x, bottom, (right - x).max(0.0), (y - bottom).max(0.0)).fill_nonzero();
            }
            SceneShape::Dot { at, radius, color, filled } => {
                self.fill_color(if *filled { *color } else { [255; 3] });
                self.stroke_color(*color);
                self.content.set_line_width(1.0);
                self.circle(*at, *radius as f32);
                self.content.fill_nonzero_and_stroke();
            }
            SceneShape::Text { at, words, size, side, color } => self.words((*at, *side), words, *size as f32, *color),
        }
    }

    /// A place of the scene, whose y goes down, on the page, whose y goes up.
    fn place(&self, [x, y]: [f64; 2]) -> [f32; 2] {
        [x as f32, self.height - y as f32]
    }

    fn through(&mut self, points: &[[f64; 2]]) {
        for (k, point) in points.iter().enumerate() {
            let [x, y] = self.place(*point);
            if k == 0 {
                self.content.move_to(x, y)
            } else {
                self.content.line_to(x, y)
            };
        }
    }

    fn circle(&mut self, at: [f64; 2], radius: f32) {
        let [x, y] = self.place(at);
        let on = |across: f32, up: f32| (x + radius * across, y + radius * up);
        let (start_x, start_y) = on(1.0, 0.0);
        self.content.move_to(start_x, start_y);
        for (a, b) in
            [((1.0, 0.0), (0.0, 1.0)), ((0.0, 1.0), (-1.0, 0.0)), ((-1.0, 0.0), (0.0, -1.0)), ((0.0, -1.0), (1.0, 0.0))]
        {
            let (first, second) =
                (on(a.0 + QUARTER * b.0, a.1 + QUARTER * b.1), on(b.0 + QUARTER * a.0, b.1 + QUARTER * a.1));
            let end = on(b.0, b.1);
            self.content.cubic_to(first.0, first.1, second.0, second.1, end.0, end.1);
        }
        self.content.close_path();
    }

    fn words(&mut self, (at, side): ([f64; 2], TextAnchor), words: &str, size: f32, color: PlotColor) {
        let letters: Vec<(u16, char)> =
            words.chars().map(|c| (self.font.glyph_index(c).unwrap_or(GlyphId(0)).0, c)).collect();
        let width: f32 = letters.iter().map(|(glyph, _)| self.advance(*glyph)).sum::<f32>() * size / 1000.0;
        let before = match side {
            TextAnchor::Left => 0.0,
            TextAnchor::Middle => 0.5 * width,
            TextAnchor::Right => width,
        };
        let bytes: Vec<u8> = letters.iter().flat_map(|(glyph, _)| glyph.to_be_bytes()).collect();
        let [x, y] = self.place(at);
        self.fill_color(color);
        self.content.begin_text().set_font(LETTERS, size);
        self.content.next_line(x - before, y - MIDDLE as f32 * size).show(Str(&bytes)).end_text();
        self.glyphs.extend(letters);
    }

    /// Width of a letter, in thousandths of its size.
    fn advance(&self, glyph: u16) -> f32 {
        let width = self.font.glyph_hor_advance(GlyphId(glyph)).unwrap_or(0);
        self.thousandths(f32::from(width))
    }

    fn thousandths(&self, units: f32) -> f32 {
        1000.0 * units / f32::from(self.font.units_per_em())
    }

    fn fill_color(&mut self, color: PlotColor) {
        let [red, green, blue] = color.map(|part| f32::from(part) / 255.0);
        self.content.set_fill_rgb(red, green, blue);
    }

    fn stroke_color(&mut self, color: PlotColor) {
        let [red, green, blue] = color.map(|part| f32::from(part) / 255.0);
        self.content.set_stroke_rgb(red, green, blue);
    }

    /// The file: catalog, pages, page, content, letters.
    fn file(self, scene: &PlotScene) -> Vec<u8> {
        let [catalog, pages, page, content, font, letters, descriptor, program, unicode] =
            std::array::from_fn(|k| Ref::new(k as i32 + 1));
        let mut pdf = Pdf::new();
        pdf.catalog(catalog).pages(pages);
        pdf.pages(pages).kids([page]).count(1);
        let mut one = pdf.page(page);
        one.media_box(Rect::new(0.0, 0.0, scene.width as f32 * SCALE, scene.height as f32 * SCALE));
        one.parent(pages).contents(content);
        let mut resources = one.resources();
        resources.fonts().pair(LETTERS, font);
        resources
            .ext_g_states()
            .insert(FAINT)
            .start::<pdf_writer::writers::ExtGraphicsState<'_>>()
            .non_stroking_alpha(AREA);
        resources.finish();
        one.finish();
        pdf.type0_font(font)
            .base_font(FONT_NAME)
            .encoding_predefined(Name(b"Identity-H"))
            .descendant_font(letters)
            .to_unicode(unicode);
        let mut of_letters = pdf.cid_font(letters);
        of_letters.subtype(CidFontType::Type2).base_font(FONT_NAME).system_info(IDENTITY).font_descriptor(descriptor);
        of_letters.cid_to_gid_map_predefined(Name(b"Identity")).default_width(0.0);
        let mut widths = of_letters.widths();
        for &glyph in self.glyphs.keys() {
            widths.consecutive(glyph, [self.advance(glyph)]);
        }
        widths.finish();
        of_letters.finish();
        let bounds = self.font.global_bounding_box();
        let unit = |units: i16| self.thousandths(f32::from(units));
        pdf.font_descriptor(descriptor)
            .name(FONT_NAME)
            .flags(FontFlags::NON_SYMBOLIC)
            .bbox(Rect::new(unit(bounds.x_min), unit(bounds.y_min), unit(bounds.x_max), unit(bounds.y_max)))
            .italic_angle(0.0)
            .ascent(unit(self.font.ascender()))
            .descent(unit(self.font.descender()))
            .cap_height(unit(self.font.capital_height().unwrap_or(self.font.ascender())))
            .stem_v(80.0)
            .font_file2(program);
        pdf.stream(program, FONT).pair(Name(b"Length1"), FONT.len() as i32);
        let mut map = UnicodeCmap::new(Name(b"Unicode"), IDENTITY);
        self.glyphs.iter().for_each(|(&glyph, &letter)| map.pair(glyph, letter));
        pdf.cmap(unicode, &map.finish());
        pdf.stream(content, &self.content.finish());
        pdf.finish()
    }
}

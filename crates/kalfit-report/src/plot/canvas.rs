//! A scene of lines, marks and words, in points of a screen.

use crate::words::wrap;

/// Three parts of 255.
pub(super) type PlotColor = [u8; 3];

pub(super) const INK: PlotColor = [0x22; 3];
pub(super) const FAINT: PlotColor = [0x77; 3];
pub(super) const GRID: PlotColor = [0xdd; 3];
/// Of Okabe and Ito's palette, which colour-blind readers can tell apart.
pub(super) const BLUE: PlotColor = [0x00, 0x72, 0xb2];
pub(super) const ORANGE: PlotColor = [0xd5, 0x5e, 0x00];

/// How much of an area's colour is seen.
pub(super) const AREA: f32 = 0.15;
/// Of a dash and of the gap after it.
pub(super) const DASH: f32 = 4.0;

/// From one line of words to the next.
pub(super) const LINE: f64 = 16.0;
/// Sizes of letters.
pub(super) const TITLE: f64 = 16.0;
pub(super) const WORDS: f64 = 12.0;
pub(super) const SMALL: f64 = 11.0;

/// Which end of some words a place says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TextAnchor {
    /// Their first letter begins there.
    Left,
    Middle,
    /// Their last letter ends there.
    Right,
}

/// What is drawn, in order.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum SceneShape {
    Line {
        points: Vec<[f64; 2]>,
        color: PlotColor,
        width: f64,
        dashed: bool,
    },
    Area {
        points: Vec<[f64; 2]>,
        color: PlotColor,
    },
    Bar {
        from: [f64; 2],
        to: [f64; 2],
        color: PlotColor,
    },
    Dot {
        at: [f64; 2],
        radius: f64,
        color: PlotColor,
        filled: bool,
    },
    /// `at` is half way up a small letter.
    Text {
        at: [f64; 2],
        words: String,
        size: f64,
        side: TextAnchor,
        color: PlotColor,
    },
}

/// All shapes of a figure.
#[derive(Debug)]
pub(super) struct PlotScene {
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) shapes: Vec<SceneShape>,
}

/// A part of a scene, from some height on.
pub(super) struct PlotCanvas<'a> {
    scene: &'a mut PlotScene,
    top: f64,
    pub(super) width: f64,
}

impl PlotScene {
    pub(super) fn canvas(&mut self) -> PlotCanvas<'_> {
        PlotCanvas { top: 0.0, width: self.width, scene: self }
    }
}

impl PlotCanvas<'_> {
    /// The same without its first points.
    pub(super) fn below(&mut self, height: f64) -> PlotCanvas<'_> {
        PlotCanvas { scene: self.scene, top: self.top + height, width: self.width }
    }

    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x, y + self.top]
    }

    fn places(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        points.iter().map(|point| self.place(*point)).collect()
    }

    pub(super) fn line(&mut self, points: &[[f64; 2]], color: PlotColor, width: f64) {
        let points = self.places(points);
        self.scene.shapes.push(SceneShape::Line { points, color, width, dashed: false });
    }

    pub(super) fn dashed(&mut self, from: [f64; 2], to: [f64; 2], color: PlotColor) {
        let points = self.places(&[from, to]);
        self.scene.shapes.push(SceneShape::Line { points, color, width: 1.0, dashed: true });
    }

    /// A closed area of a faint colour.
    pub(super) fn area(&mut self, points: &[[f64; 2]], color: PlotColor) {
        let points = self.places(points);
        self.scene.shapes.push(SceneShape::Area { points, color });
    }

    pub(super) fn bar(&mut self, from: [f64; 2], to: [f64; 2], color: PlotColor) {
        let (from, to) = (self.place(from), self.place(to));
        self.scene.shapes.push(SceneShape::Bar { from, to, color });
    }

    pub(super) fn dot(&mut self, at: [f64; 2], radius: f64, color: PlotColor, filled: bool) {
        let at = self.place(at);
        self.scene.shapes.push(SceneShape::Dot { at, radius, color, filled });
    }

    pub(super) fn text(&mut self, at: [f64; 2], words: &str, size: f64, side: TextAnchor, color: PlotColor) {
        let at = self.place(at);
        self.scene.shapes.push(SceneShape::Text { at, words: words.to_owned(), size, side, color });
    }

    /// The lines over a figure.
    pub(super) fn heading(&mut self, title: &str, caption: &[String]) {
        self.text([12.0, 18.0], &cut(title, self.width - 24.0, TITLE), TITLE, TextAnchor::Left, INK);
        for (k, line) in caption.iter().enumerate() {
            self.text([12.0, 38.0 + LINE * k as f64], line, WORDS, TextAnchor::Left, FAINT);
        }
    }
}

/// About how wide words are, in any font that a viewer may have.
pub(super) fn width_of(words: &str, size: f64) -> f64 {
    0.6 * size * words.chars().count() as f64
}

/// Words that fit, with an ellipsis where they do not.
pub(super) fn cut(words: &str, room: f64, size: f64) -> String {
    let fits = (room / (0.6 * size)).max(2.0) as usize;
    match words.chars().count() > fits {
        true => words.chars().take(fits - 1).chain(['…']).collect(),
        false => words.to_owned(),
    }
}

/// Words in as many lines as they need.
pub(super) fn lines(words: &str, room: f64, size: f64) -> Vec<String> {
    wrap(words, (room / (0.6 * size)) as usize, 0).lines().map(str::to_owned).collect()
}

/// The widest of some words, up to a limit.
pub(super) fn widest<'a>(words: impl Iterator<Item = &'a str>, size: f64, most: f64) -> f64 {
    words.map(|one| width_of(one, size)).fold(0.0, f64::max).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_do_not_fit_end_in_an_ellipsis() {
        assert_eq!(cut("bias", 100.0, 10.0), "bias");
        assert_eq!(cut("a long name", 30.0, 10.0), "a lo…");
    }
}

//! Figures as files, without a browser: SVG, or PNG at twice the resolution of a screen.
//!
//! What is drawn is what the report draws, from the same rows. A figure is a scene of a few kinds of shapes, which both formats are
//! made from (docs/decisions/0023-figures.md).

mod axis;
mod canvas;
mod ellipses;
mod forest;
mod influence;
mod png;
mod records;
mod svg;

use kalfit::FitRecord;
use kalfit::record::AlongRecord;

use crate::plot::canvas::{Canvas, LINE, Scene, WORDS, lines};
use crate::plot::ellipses::Ellipses;
use crate::plot::forest::Forest;
use crate::plot::influence::Influence;
use crate::plot::records::Records;
use crate::words::clean;

/// Widths of a figure, in points of a screen.
pub const WIDTHS: std::ops::RangeInclusive<u32> = 300..=3000;

/// What a figure shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What {
    /// Means, standard deviations and free parameters with their 95 % intervals.
    Forest,
    /// Each pair of states: the population, and the tests in it.
    Ellipses,
    /// How far the estimates move when a test is left out.
    Influence,
    /// A test along its record: measured and predicted values, innovations.
    Records,
}

/// How a figure is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Scalable.
    Svg,
    /// Points.
    Png,
}

/// Why there is no figure.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The results lack what it would show.
    #[error("the results have nothing for this figure: {0}")]
    Nothing(String),
    /// No such test.
    #[error("test `{test}` is not among those that can be drawn: {known}")]
    NoTest {
        /// What was asked for.
        test: String,
        /// Tests that can be drawn.
        known: String,
    },
    /// It could not be drawn or encoded.
    #[error("cannot draw the figure: {0}")]
    Draw(String),
}

/// A figure of a fit, as a whole file. `along` and `test` are for [`What::Records`] alone: what is known along the records, and the
/// test to show, by default the least probable.
///
/// # Errors
/// [`PlotError`].
pub fn plot(
    record: &FitRecord,
    what: What,
    (along, test): (Option<&AlongRecord>, Option<&str>),
    (format, width): (Format, u32),
) -> Result<Vec<u8>, PlotError> {
    let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
    match what {
        What::Forest => Forest::of(record)?.put(record, format, width),
        What::Ellipses => Ellipses::of(record)?.put(record, format, width),
        What::Influence => Influence::of(record)?.put(record, format, width),
        What::Records => Records::of(along, test)?.put(record, format, width),
    }
}

/// A figure that knows how to draw itself, in points, below its heading.
trait Picture {
    /// What it shows, for the lines below its title.
    fn caption(&self) -> String;

    /// Its height at this width.
    fn height(&self, width: f64) -> f64;

    fn draw(&self, on: &mut Canvas<'_>);

    /// The file.
    fn put(&self, record: &FitRecord, format: Format, width: u32) -> Result<Vec<u8>, PlotError> {
        let width = f64::from(width);
        let caption = lines(&self.caption(), width - 24.0, WORDS);
        let heading = HEADING + LINE * caption.len() as f64;
        let mut scene = Scene { width, height: (heading + self.height(width)).ceil(), shapes: Vec::new() };
        let mut canvas = scene.canvas();
        canvas.heading(&clean(&record.title), &caption);
        self.draw(&mut canvas.below(heading));
        match format {
            Format::Svg => Ok(svg::svg(&scene).into_bytes()),
            Format::Png => png::png(&scene),
        }
    }
}

/// Height of the heading, without its caption.
const HEADING: f64 = 36.0;

//! From a figure's shapes to its file.

use crate::plot::canvas::{LINE, PlotCanvas, PlotScene, WORDS, lines};
use crate::plot::error::PlotError;
use crate::plot::{pdf, png, svg};
use crate::words::clean;

/// Height of the heading, without its caption.
const HEADING: f64 = 36.0;

/// How a figure is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlotFormat {
    /// Scalable.
    Svg,
    /// Points.
    Png,
    /// A page.
    Pdf,
}

/// A figure that knows how to draw itself, in points, below its heading.
pub(super) trait DrawablePlot {
    /// What it shows, for the lines below its title.
    fn caption(&self) -> String;

    /// Its height at this width.
    fn height(&self, width: f64) -> f64;

    fn draw(&self, on: &mut PlotCanvas<'_>);

    /// The file.
    fn put(&self, title: &str, format: PlotFormat, width: u32) -> Result<Vec<u8>, PlotError> {
        let width = f64::from(width);
        let caption = lines(&self.caption(), width - 24.0, WORDS);
        let heading = HEADING + LINE * caption.len() as f64;
        let mut scene = PlotScene { width, height: (heading + self.height(width)).ceil(), shapes: Vec::new() };
        let mut canvas = scene.canvas();
        canvas.heading(&clean(title), &caption);
        self.draw(&mut canvas.below(heading));
        match format {
            PlotFormat::Svg => Ok(svg::svg(&scene).into_bytes()),
            PlotFormat::Png => png::png(&scene),
            PlotFormat::Pdf => pdf::pdf(&scene),
        }
    }
}

//! Figures as files, without a browser: SVG, or PNG at twice the resolution of a screen.
//!
//! What is drawn is what the report draws, from the same rows. A figure is a scene of a few kinds of shapes, which both formats are
//! made from (docs/decisions/0023-figures.md).

mod allan;
mod axis;
mod canvas;
mod each_test;
mod ellipses;
mod error;
mod forest;
mod influence;
mod pdf;
mod picture;
mod png;
mod records;
mod sensitivities;
mod svg;

use kalfit::FitRecord;
use kalfit::record::{AlongRecord, PlanRecord};

pub use crate::plot::error::PlotError;
pub use crate::plot::picture::PlotFormat;

use crate::plot::allan::AllanPlot;
use crate::plot::each_test::TestsPlot;
use crate::plot::ellipses::EllipsePlot;
use crate::plot::forest::ForestPlot;
use crate::plot::influence::InfluencePlot;
use crate::plot::picture::DrawablePlot;
use crate::plot::records::{RecordPanels, RecordPlot};
use crate::plot::sensitivities::SensitivityPlot;

/// Widths of a figure, in points of a screen.
pub const WIDTHS: std::ops::RangeInclusive<u32> = 300..=3000;

/// What a figure shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlotKind {
    /// Means, standard deviations and free parameters with their 95 % intervals.
    Forest,
    /// Each pair of states: the population, and the tests in it.
    Ellipses,
    /// Each test by itself and as part of the population, and the mean: the forest plot of a meta-analysis.
    Tests,
    /// How far the estimates move when a test is left out.
    Influence,
    /// A test along its record: measured and predicted values, innovations.
    Records,
    /// Standardised innovations of a test over time.
    Residuals,
    /// Standardised innovations of a test against the quantiles of the normal law.
    Quantiles,
    /// Allan deviations of the records and of the fitted model.
    Allan,
    /// Candidates of a plan: what one more unit of cost brings.
    Sensitivities,
}

impl PlotKind {
    /// Whether the figure needs the model and the data, not the results alone.
    pub fn is_of_data(self) -> bool {
        matches!(self, PlotKind::Records | PlotKind::Residuals | PlotKind::Quantiles | PlotKind::Allan)
    }
}

/// A figure of a fit, as a whole file. `along` and `test` are for figures of data alone: what is known along the records, and
/// the test to show, by default the least probable.
///
/// # Errors
/// [`PlotError`].
pub fn plot(
    record: &FitRecord,
    what: PlotKind,
    (along, test): (Option<&AlongRecord>, Option<&str>),
    (format, width): (PlotFormat, u32),
) -> Result<Vec<u8>, PlotError> {
    let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
    let records = |panels| RecordPlot::of(along, test, panels)?.put(&record.title, format, width);
    match what {
        PlotKind::Forest => ForestPlot::of(record)?.put(&record.title, format, width),
        PlotKind::Ellipses => EllipsePlot::of(record)?.put(&record.title, format, width),
        PlotKind::Tests => TestsPlot::of(record)?.put(&record.title, format, width),
        PlotKind::Influence => InfluencePlot::of(record)?.put(&record.title, format, width),
        PlotKind::Records => records(RecordPanels::Values),
        PlotKind::Residuals => records(RecordPanels::Innovations),
        PlotKind::Quantiles => records(RecordPanels::Quantiles),
        PlotKind::Allan => AllanPlot::of(along)?.put(&record.title, format, width),
        PlotKind::Sensitivities => {
            Err(PlotError::Nothing("they are those of a plan: give the file that `kalfit plan --out` wrote".to_owned()))
        }
    }
}

/// The sensitivities of a plan among candidates, as a whole file.
///
/// # Errors
/// [`PlotError`].
pub fn plot_plan(record: &PlanRecord, (format, width): (PlotFormat, u32)) -> Result<Vec<u8>, PlotError> {
    let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
    SensitivityPlot::of(record)?.put(&record.title, format, width)
}

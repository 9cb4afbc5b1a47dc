//! Results in words and tables.
//!
//! From a [`FitRecord`](kalfit::FitRecord) alone, without models or data: [`summary`] makes the text that
//! `kalfit fit` prints. [`check_summary`] does the same for `kalfit check`, from a [`CheckRecord`].

mod applied;
mod best_plan;
mod check;
mod compared;
mod datasheet;
mod exported;
mod figures;
mod html;
mod number;
mod page;
mod plan;
mod plot;
mod predicted;
mod ratio;
mod summary;
mod table;
mod validated;
mod words;

pub use applied::applied_summary;
pub use check::{CheckFindings, CheckRecord, CheckedLevel, CheckedPhase, ParameterCounts, PhaseCounts, check_summary};
pub use compared::compared_summary;
pub use datasheet::datasheet_summary;
pub use exported::exported_summary;
pub use html::{html, html_along, html_with_test};
pub use number::seconds;
pub use plan::plan_summary;
pub use plot::{PlotError, PlotFormat, PlotKind, WIDTHS, plot, plot_plan};
pub use predicted::predicted_summary;
pub use ratio::ratio_summary;
pub use summary::summary;
pub use validated::validated_summary;

/// How a text is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TextStyle {
    /// Characters a line may have; less than 60 is taken as 60.
    pub width: usize,
    /// Bold headings and a coloured headline, by ANSI escape sequences. Nothing is said by colour alone.
    pub color: bool,
}

impl Default for TextStyle {
    /// 80 characters, no colour.
    fn default() -> TextStyle {
        TextStyle { width: 80, color: false }
    }
}

impl TextStyle {
    fn columns(&self) -> usize {
        self.width.max(60)
    }

    fn bold(&self, text: &str) -> String {
        self.paint("1", text)
    }

    /// Green and bold: can be trusted.
    fn good(&self, text: &str) -> String {
        self.paint("1;32", text)
    }

    /// Yellow and bold: with doubts.
    fn fair(&self, text: &str) -> String {
        self.paint("1;33", text)
    }

    /// Red and bold: cannot.
    fn bad(&self, text: &str) -> String {
        self.paint("1;31", text)
    }

    fn paint(&self, code: &str, text: &str) -> String {
        if self.color { format!("\u{1b}[{code}m{text}\u{1b}[0m") } else { text.to_owned() }
    }
}

//! Jobs: a model and data in, a record out, without a terminal.
//!
//! Each command of `kalfit` and each function of the Python package is one job: a struct that says what is wanted
//! ([`FitJob`] and its sisters), one function that does it ([`fit`] …), and a record that anybody can show. A [`JobWatch`] hears how
//! it goes, and may ask it to stop. Whatever is wrong with the input is a [`Failure`], which [`render`] puts into words.
//!
//! ```
//! use kalfit_job::{Document, FitJob, ModelJob, Unwatched, fit};
//!
//! let text = "[data]\ntest = \"unit\"\n[states.bias]\n[measurements.y]\ncolumn = \"y\"\nequation = \"bias\"\nnoise = 0.1\n";
//! let model = Document::Text { name: "bias".to_owned(), text: text.to_owned(), file: None };
//! let job = FitJob::new(ModelJob { document: model, set: Vec::new() }, vec!["no-such.csv".to_owned().into()]);
//! let failure = fit(&job, &mut Unwatched).unwrap_err();
//! assert!(failure.to_string().starts_with("cannot read no-such.csv"));
//! ```

mod along;
mod apply;
mod check;
mod compare;
mod datasheet;
mod diagnostic;
mod document;
mod dynamic;
mod estimates;
mod evidence;
mod exchange;
mod export;
mod failure;
mod fit;
mod fitted;
mod forecast;
mod groups;
mod hypothesis;
mod idle;
mod inferred;
mod innovations;
mod instructions;
mod job;
pub mod json;
mod known;
mod lost;
mod memory;
mod model;
mod offset;
mod output;
mod plan;
mod plot;
mod predict;
mod ratio;
mod reduce;
mod reductions;
mod refused;
mod report;
mod results;
mod simulate;
mod simultaneous;
pub mod sums;
mod survey;
mod table;
mod tables;
mod test;
mod tests;
mod threads;
mod truth;
mod validate;
pub mod words;
mod work;
mod write;

pub use apply::apply;
pub use check::check;
pub use compare::compare;
pub use datasheet::datasheet;
pub use diagnostic::{render, render_hinted, render_message};
pub use document::Document;
pub use estimates::estimates;
pub use export::{ExportFormat, export};
pub use failure::{Failure, SourcePlace, SourceText, UnknownUnit};
pub use fit::fit;
pub use instructions::{INSTRUCTIONS, fix_instructions};
pub use job::{
    AppliedModel, ApplyJob, BestPlanRequest, BootstrapChoice, CheckJob, CompareJob, DatasheetJob, DesignPlan,
    ExchangeJob, ExchangedTable, ExportJob, FitJob, FitTables, FoldChoice, JobDone, MethodChoice, ModelJob, PlanJob,
    PlanRequest, PlotJob, PredictJob, PredictedModel, PredictedUnits, ReportJob, SimulateJob, SimulatedEnsemble, SoFar,
    TableDestination, TestJob, ValidateJob,
};
pub use kalfit_spec::schema as model_schema;
pub use memory::{check_rows_variable, is_there as memory_is_there};
pub use model::read as read_model;
pub use output::{FileContents, OutputError, abandon};
pub use plan::error::BestPlanError;
pub use plan::plan;
pub use plot::plot;
pub use predict::predict;
pub use reduce::reduce;
pub use report::report;
pub use results::ResultError;
pub use simulate::simulate;
pub use tables::{FitTableKind, fit_table};
pub use test::test;
pub use threads::{of_variable as threads_of_variable, used as used_threads};
pub use truth::error::TruthError;
pub use truth::fit_record;
pub use validate::validate;
pub use work::{JobWatch, ProgressShare, Unwatched};
pub use write::{save, save_text};

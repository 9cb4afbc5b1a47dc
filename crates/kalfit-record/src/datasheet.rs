//! The numbers of a datasheet, as a record.

use serde::{Deserialize, Serialize};

use kalfit_infer::Interval;

/// The schema of [`DatasheetRecord`].
pub const DATASHEET_SCHEMA: &str = "kalfit-datasheet/1";

/// What `kalfit datasheet` makes of a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DatasheetRecord {
    /// Always `kalfit-datasheet/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Title of the model.
    pub title: String,
    /// What the parameters were taken from, as named by the user.
    pub from: String,
    /// Columns that were given a value for all rows, each as `column=value`.
    pub at: Vec<String>,
    /// Unit label of the model's time.
    pub time_unit: Option<String>,
    /// The numbers, phase by phase: those of measurements, then those of states.
    pub entries: Vec<EntryRecord>,
    /// Allan deviations, one entry for each measurement.
    pub allan: Vec<CurveRecord>,
    /// What else should be known, in plain words.
    pub notes: Vec<String>,
}

/// One number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EntryRecord {
    /// Name of the number, such as `angle random walk`.
    pub name: String,
    /// Name of the measurement or state that the number describes, such as `gyro` or `drift`.
    pub of: String,
    /// `measurement` or `state`.
    pub kind: String,
    /// Name of the phase; `main` where there is only one.
    pub phase: String,
    /// For a spread in a model with levels, the name of its level, `tests` for the level of the tests; null elsewhere.
    pub level: Option<String>,
    /// Where the number depends on parameters with one value per level of a column, its level, as `column=level`; null
    /// elsewhere.
    #[serde(default)]
    pub at: Option<String>,
    /// Value of the number; null where it differs with columns, or where the step is not known.
    pub value: Option<f64>,
    /// Unit of the value.
    pub unit: Option<String>,
    /// 95 % interval, lower and upper end.
    pub interval95: Interval,
    /// Definition of the number.
    pub definition: String,
    /// Parameters and elements of μ and Σ that it depends on.
    pub from: Vec<String>,
    /// Why it has no value: columns that it differs with, `step` for a step that is not known.
    pub varies_with: Vec<String>,
}

/// The Allan deviation of a measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurveRecord {
    /// Name of the measurement.
    pub measurement: String,
    /// The column it is read from.
    pub column: String,
    /// Name of the phase.
    pub phase: String,
    /// Unit of the deviations.
    pub unit: Option<String>,
    /// Time from a value to the next: the median of the records, or as given; 1 where rows have no times; null where it
    /// is not known.
    pub step: Option<f64>,
    /// Columns that were taken as zero for the curve of the model.
    pub zero: Vec<String>,
    /// Tests whose records have two neighbouring spans or more; null without data.
    pub tests: Option<usize>,
    /// Points, by averaging time.
    pub points: Vec<AllanPoint>,
    /// Why the model or the records have no curve, where they have none.
    pub notes: Vec<String>,
}

/// The Allan deviation at one averaging time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AllanPoint {
    /// Averaging time, in the model's unit of time; in rows where those have no times.
    pub time: f64,
    /// Number of values in a span.
    pub values: usize,
    /// Allan deviation of the model.
    pub model: Option<f64>,
    /// Allan deviation of the records.
    pub data: Option<f64>,
    /// 95 % interval of the deviation of the records.
    pub interval95: Interval,
    /// Effective degrees of freedom of the deviation of the records.
    pub degrees_of_freedom: Option<f64>,
}

//! Why there is no filter of constant matrices.

use kalfit_filter::reduce::ReduceError;
use kalfit_model::PopulationError;

/// Why a model has no filter of constant matrices.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The model has no such phase.
    #[error("the model has no phase `{found}`, expected {}", either(expected))]
    UnknownPhase {
        /// The phase requested.
        found: String,
        /// Phases of the model.
        expected: Vec<String>,
    },
    /// No phase was named, although the model has several.
    #[error("the model has the phases {}, and each has a filter of its own", either(expected))]
    WhichPhase {
        /// Phases of the model.
        expected: Vec<String>,
    },
    /// The length of a step is not a positive number.
    #[error("the step is {found}, expected a number above 0")]
    BadStep {
        /// The step requested.
        found: f64,
    },
    /// The length of a step is needed, but not given.
    #[error("{what} depends on the length of a step, which is not given")]
    NoStep {
        /// Name of the matrix or column that depends on the length of a step.
        what: String,
    },
    /// A step was given, although the rows of the model have no times.
    #[error("a step of {found} has no effect: the rows of the model have no times, each is a step")]
    StepWithoutTime {
        /// The step requested.
        found: f64,
    },
    /// A column that nothing depends on is given a value.
    #[error("a value of column `{column}` has no effect: {}", reads(columns))]
    NoEffect {
        /// Name of the column.
        column: String,
        /// Columns whose values have an effect.
        columns: Vec<String>,
    },
    /// A column is given two values.
    #[error("column `{column}` is given a value more than once")]
    GivenTwice {
        /// Name of the column.
        column: String,
    },
    /// A column of numbers is given something that is not a finite number.
    #[error("column `{column}` is given the value `{found}`, expected a finite number")]
    NotANumber {
        /// Name of the column.
        column: String,
        /// The value given.
        found: String,
    },
    /// A parameter has no value at the level requested.
    #[error("parameter `{parameter}` has no value where `{column}` is `{level}`{}", known(levels))]
    NoLevel {
        /// Name of the parameter.
        parameter: String,
        /// The column with the levels of the parameter.
        column: String,
        /// The level requested.
        level: String,
        /// Levels at which the parameter has a value.
        levels: Vec<String>,
    },
    /// The matrices differ from row to row.
    #[error("the filter has no constant matrices: {}", listed(varies))]
    Varies {
        /// Each quantity that differs, with the column that it depends on.
        varies: Vec<Varies>,
    },
    /// No measurement reads a row at the given values.
    #[error("no measurement is left at these values: {} read no row", either(measurements))]
    NothingMeasured {
        /// Measurements of the model.
        measurements: Vec<String>,
    },
    /// The population does not fit the model.
    #[error(transparent)]
    Population(#[from] PopulationError),
    /// A coefficient has no value, or a noise covariance is impossible.
    #[error(transparent)]
    Reduce(Box<ReduceError>),
}

/// Something that differs from row to row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Varies {
    /// Description of the quantity, such as "derivative of state `angle`".
    pub what: String,
    /// The column that the quantity depends on.
    pub column: String,
    /// The parameter that has a value for each level of the column; `None` where the column itself is read.
    pub parameter: Option<String>,
}

impl ExportError {
    /// Advice that helps whatever the model; `None` where there is none.
    pub fn hint(&self) -> Option<String> {
        match self {
            ExportError::UnknownPhase { .. } => None,
            ExportError::WhichPhase { expected } => Some(format!("say which: `--phase {}`", expected.first()?)),
            ExportError::BadStep { .. } | ExportError::NoStep { .. } => {
                Some("give it in the model's unit of time: `--step 0.01`".to_owned())
            }
            ExportError::StepWithoutTime { .. } => Some("leave it out".to_owned()),
            ExportError::NoEffect { .. } => Some("leave it out".to_owned()),
            ExportError::GivenTwice { .. } => Some("give each column one value".to_owned()),
            ExportError::Varies { varies } => {
                let mut columns: Vec<&str> = varies.iter().map(|one| one.column.as_str()).collect();
                columns.sort_unstable();
                columns.dedup();
                let options: Vec<String> = columns.iter().map(|column| format!("`--at {column}=VALUE`")).collect();
                Some(format!("fix what they depend on: {}", options.join(", ")))
            }
            ExportError::NothingMeasured { .. } => Some("give the column of `where` another value".to_owned()),
            _ => None,
        }
    }
}

impl From<ReduceError> for ExportError {
    fn from(error: ReduceError) -> ExportError {
        ExportError::Reduce(Box::new(error))
    }
}

fn quoted(names: &[String]) -> Vec<String> {
    names.iter().map(|name| format!("`{name}`")).collect()
}

fn either(names: &[String]) -> String {
    quoted(names).join(", ")
}

fn reads(columns: &[String]) -> String {
    match columns {
        [] => "the filter depends on no column".to_owned(),
        columns => format!("the filter depends on {}", either(columns)),
    }
}

fn known(levels: &[String]) -> String {
    const MAX_LISTED: usize = 8;
    match levels.len() {
        0 => String::new(),
        n if n <= MAX_LISTED => format!(", expected one of {}", either(levels)),
        n => format!(", expected one of {} and {} more", either(&levels[..MAX_LISTED]), n - MAX_LISTED),
    }
}

fn listed(varies: &[Varies]) -> String {
    const MAX_LISTED: usize = 4;
    let mut all: Vec<String> = Vec::new();
    for group in varies.chunk_by(|a, b| a.what == b.what) {
        let columns: Vec<String> = group.iter().map(column).collect();
        let columns = match columns.as_slice() {
            [only] => format!("column {only}"),
            [before @ .., last] => format!("columns {} and {last}", before.join(", ")),
            [] => continue,
        };
        all.push(format!("{} depends on {columns}", group[0].what));
    }
    let more = all.len().saturating_sub(MAX_LISTED);
    all.truncate(MAX_LISTED);
    if more > 0 {
        all.push(format!("and {more} more"));
    }
    all.join("; ")
}

fn column(one: &Varies) -> String {
    match &one.parameter {
        None => format!("`{}`", one.column),
        Some(parameter) => format!("`{}`, of which parameter `{parameter}` has levels", one.column),
    }
}

//! Why there is no filter of constant matrices.

use kalfit_filter::reduce::ReduceError;
use kalfit_model::PopulationError;

/// Why a model has no filter of constant matrices.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// There is no such phase.
    #[error("the model has no phase `{found}`, expected {}", either(expected))]
    UnknownPhase {
        /// What was asked for.
        found: String,
        /// Those of the model.
        expected: Vec<String>,
    },
    /// It is not said which phase is meant.
    #[error("the model has the phases {}, and each has a filter of its own", either(expected))]
    WhichPhase {
        /// Those of the model.
        expected: Vec<String>,
    },
    /// The length of a step is no length.
    #[error("the step is {found}, expected a number above 0")]
    BadStep {
        /// What was asked for.
        found: f64,
    },
    /// Something depends on the length of a step.
    #[error("{what} depends on the length of a step, which is not given")]
    NoStep {
        /// What depends on it.
        what: String,
    },
    /// Rows have no times.
    #[error("a step of {found} has no effect: the rows of the model have no times, each is a step")]
    StepWithoutTime {
        /// What was asked for.
        found: f64,
    },
    /// A column that nothing depends on is given a value.
    #[error("a value of column `{column}` has no effect: {}", reads(columns))]
    NoEffect {
        /// The column.
        column: String,
        /// Columns that have one.
        columns: Vec<String>,
    },
    /// A column is given two values.
    #[error("column `{column}` is given a value more than once")]
    GivenTwice {
        /// The column.
        column: String,
    },
    /// A column of numbers is given something else.
    #[error("column `{column}` is given the value `{found}`, expected a finite number")]
    NotANumber {
        /// The column.
        column: String,
        /// What was given.
        found: String,
    },
    /// A parameter has no value at the level that was asked for.
    #[error("parameter `{parameter}` has no value where `{column}` is `{level}`{}", known(levels))]
    NoLevel {
        /// The parameter.
        parameter: String,
        /// Its column.
        column: String,
        /// What was asked for.
        level: String,
        /// Levels that have one.
        levels: Vec<String>,
    },
    /// Matrices that differ from row to row.
    #[error("the filter has no constant matrices: {}", listed(varies))]
    Varies {
        /// What differs, and with what.
        varies: Vec<Varies>,
    },
    /// No measurement is left.
    #[error("no measurement is left at these values: {} read no row", either(measurements))]
    NothingMeasured {
        /// Those of the model.
        measurements: Vec<String>,
    },
    /// Values that do not fit the model.
    #[error(transparent)]
    Population(#[from] PopulationError),
    /// A coefficient without a value, or noise that cannot be.
    #[error(transparent)]
    Reduce(Box<ReduceError>),
}

/// Something that differs from row to row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Varies {
    /// What: "derivative of state `angle`".
    pub what: String,
    /// The column it differs with.
    pub column: String,
    /// The parameter that has a value for each level of the column; `None` where the column itself is read.
    pub parameter: Option<String>,
}

impl ExportError {
    /// What to do about it.
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
    const MOST: usize = 8;
    match levels.len() {
        0 => String::new(),
        n if n <= MOST => format!(", expected one of {}", either(levels)),
        n => format!(", expected one of {} and {} more", either(&levels[..MOST]), n - MOST),
    }
}

fn listed(varies: &[Varies]) -> String {
    const MOST: usize = 4;
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
    let more = all.len().saturating_sub(MOST);
    all.truncate(MOST);
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

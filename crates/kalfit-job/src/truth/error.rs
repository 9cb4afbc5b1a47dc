//! Why nothing can be taken as true.

use kalfit::model::PopulationError;
use kalfit::record::RecordError;
use kalfit_spec::SpecError;

use crate::results::ResultError;

/// Why nothing can be taken as true.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TruthError {
    /// It is no result of a fit that can be read.
    #[error(transparent)]
    Results(#[from] ResultError),
    /// A result of a fit that does not go with the model.
    #[error("`{path}`: {error}")]
    Record {
        /// The file.
        path: String,
        /// What is wrong.
        error: RecordError,
    },
    /// Its population is not one of the model.
    #[error("`{path}`: {error}")]
    Population {
        /// The file.
        path: String,
        /// What is wrong.
        error: PopulationError,
    },
    /// It has a parameter that the model lacks.
    #[error("`{path}` has the parameter `{name}`, which the model does not have")]
    UnknownParameter {
        /// The file.
        path: String,
        /// Name of the parameter.
        name: String,
    },
    /// A parameter has levels of another column.
    #[error(
        "`{path}` has parameter `{name}` {}, expected it {} as in the model",
        per_words(found),
        per_words(expected)
    )]
    Per {
        /// The file.
        path: String,
        /// Name of the parameter.
        name: String,
        /// What is there.
        found: Option<String>,
        /// What the model has.
        expected: Option<String>,
    },
    /// A value that a parameter cannot have.
    #[error("`{path}`: {error}")]
    Value {
        /// The file.
        path: String,
        /// What is wrong.
        error: Box<SpecError>,
    },
    /// Parameters without a value.
    #[error("no value is given for {}", names.iter().map(|n| format!("parameter `{n}`")).collect::<Vec<_>>().join(", "))]
    NoParameter {
        /// Their names.
        names: Vec<String>,
    },
}

fn per_words(per: &Option<String>) -> String {
    per.as_ref().map_or("common to all tests".to_owned(), |per| format!("per `{per}`"))
}

/// The tables of a model file that give values to elements; those of a phase or a level are named `mean[phase.state]`.
fn tables(elements: &[String]) -> String {
    let part = |element: &String| Some(element.split_once('[')?.1.split_once('.')?.0.to_owned());
    let phase = elements.iter().filter(|element| element.starts_with("mean")).find_map(part);
    match phase {
        Some(phase) => format!("`[phases.{phase}.mean]` and `[phases.{phase}.covariance]`"),
        None if elements.iter().any(|element| part(element).is_some()) => {
            "`[mean]`, `[covariance]` and the covariances of levels and factors".to_owned()
        }
        None => "`[mean]` and `[covariance]`".to_owned(),
    }
}

impl TruthError {
    pub(crate) fn hint(&self) -> Option<String> {
        match self {
            TruthError::Results(ResultError::NotARecord { .. } | ResultError::Schema { .. }) => {
                Some("`--from` takes what `kalfit fit --out` writes, or a model file that ends in `.toml`".to_owned())
            }
            TruthError::Population { error: PopulationError::NoValue { elements }, .. } => {
                Some(format!("fix it or give it a start value in {}, or take a fit", tables(elements)))
            }
            TruthError::NoParameter { names } => Some(format!("give it: `--set {}=VALUE`", names.first()?)),
            TruthError::Value { error, .. } => error.hint.clone(),
            TruthError::Record { error: RecordError::Names { .. }, .. } | TruthError::UnknownParameter { .. } => Some(
                "it is of another model: phases, states, regressions and parameters must have the same names"
                    .to_owned(),
            ),
            _ => None,
        }
    }
}

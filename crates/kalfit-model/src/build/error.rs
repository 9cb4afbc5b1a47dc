//! Errors in building a model.

/// Reason why no model could be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// Two things of one kind, or a state and a parameter, have one name.
    #[error("{what} have the name `{name}`")]
    Twice {
        /// The two things, in words.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A formula or a constraint names a thing that does not exist.
    #[error("there is no {what} `{name}`, which {place} names; there {}", are(known))]
    Unknown {
        /// Kind of thing that the name should denote.
        what: &'static str,
        /// The name.
        name: String,
        /// Where the name is used.
        place: String,
        /// All names of this kind that exist.
        known: Vec<String>,
    },
    /// An equation contains a product, a quotient or a function of states.
    #[error("{place} is not linear in the states")]
    NotLinear {
        /// Where the equation is used.
        place: String,
    },
    /// A formula depends on a state where only columns and parameters are allowed.
    #[error("{place} depends on state `{state}`, expected columns and parameters only")]
    HasState {
        /// Where the formula is used.
        place: String,
        /// The state.
        state: String,
    },
    /// Nothing depends on a parameter.
    #[error("nothing depends on parameter `{name}`")]
    Unused {
        /// Name of the parameter.
        name: String,
    },
    /// Continuous motion or `dt` needs times, and the model has none.
    #[error("{place} needs times, and the model names no column of times")]
    NoTime {
        /// What needs the times.
        place: String,
    },
    /// The model has no states or no phases.
    #[error("the model has no {what}")]
    Nothing {
        /// What the model lacks.
        what: &'static str,
    },
    /// A number is outside the allowed range.
    #[error("{what} is {found}, expected {expected}")]
    OutOfRange {
        /// The number, in words.
        what: String,
        /// Value of the number.
        found: f64,
        /// Allowed range, in words.
        expected: String,
    },
    /// Two constraints contradict each other.
    #[error("{first} does not go with {second}")]
    Contradiction {
        /// One of the two constraints.
        first: String,
        /// The other constraint.
        second: String,
    },
    /// A matrix has the wrong size.
    #[error("{what} is {} × {}, expected {expected} × {expected}", found.0, found.1)]
    Shape {
        /// Which matrix has the wrong size.
        what: String,
        /// Numbers of rows and columns of the matrix.
        found: (usize, usize),
        /// Expected number of rows and of columns: the number of states.
        expected: usize,
    },
    /// The phases of a test differ in something that must be equal.
    #[error("phase `{phase}` has another {what} than the phases before it")]
    PhasesDiffer {
        /// The phase.
        phase: String,
        /// What differs.
        what: String,
    },
    /// The first phase inherits states, but no phase precedes it.
    #[error("phase `{phase}` is the first one, and carries over what was before it")]
    FirstCarries {
        /// The phase.
        phase: String,
    },
}

fn are(known: &[String]) -> String {
    match known {
        [] => "is none".to_owned(),
        [only] => format!("is `{only}`"),
        _ => format!("are {}", known.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")),
    }
}

impl BuildError {
    /// Advice on how to avoid the error.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            BuildError::NoTime { .. } => Some("`ModelBuilder::time` names the column with the time of each row"),
            BuildError::Unused { .. } => Some("a misspelt name is taken as a column"),
            BuildError::NotLinear { .. } => {
                Some("coefficients of states may depend on columns and parameters in any way")
            }
            _ => None,
        }
    }
}

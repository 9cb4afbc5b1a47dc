//! What makes no model.

/// Why there is no model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// Two things of one kind, or a state and a parameter, have one name.
    #[error("{what} have the name `{name}`")]
    Twice {
        /// What they are.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// Nothing of this kind has this name.
    #[error("there is no {what} `{name}`, which {place} names; there {}", are(known))]
    Unknown {
        /// What kind of thing.
        what: &'static str,
        /// The name.
        name: String,
        /// Where it stands.
        place: String,
        /// The names that there are.
        known: Vec<String>,
    },
    /// A product, a quotient or a function of states.
    #[error("{place} is not linear in the states")]
    NotLinear {
        /// Where.
        place: String,
    },
    /// A state where only columns and parameters may stand.
    #[error("{place} depends on state `{state}`, expected columns and parameters only")]
    HasState {
        /// Where.
        place: String,
        /// The state.
        state: String,
    },
    /// Nothing depends on a parameter.
    #[error("nothing depends on parameter `{name}`")]
    Unused {
        /// Its name.
        name: String,
    },
    /// Continuous motion or `dt` without times.
    #[error("{place} needs times, and the model names no column of times")]
    NoTime {
        /// Where.
        place: String,
    },
    /// Nothing to estimate, or nothing that is measured.
    #[error("the model has no {what}")]
    Nothing {
        /// What it has not.
        what: &'static str,
    },
    /// A number that cannot be.
    #[error("{what} is {found}, expected {expected}")]
    OutOfRange {
        /// Which number.
        what: String,
        /// What it is.
        found: f64,
        /// What it should be.
        expected: String,
    },
    /// Two constraints that contradict each other.
    #[error("{first} does not go with {second}")]
    Contradiction {
        /// One.
        first: String,
        /// The other.
        second: String,
    },
    /// A matrix of the wrong size.
    #[error("{what} is {} × {}, expected {expected} × {expected}", found.0, found.1)]
    Shape {
        /// Which matrix.
        what: String,
        /// Its rows and columns.
        found: (usize, usize),
        /// The number of states.
        expected: usize,
    },
    /// The phases of a test disagree where they must not.
    #[error("phase `{phase}` has another {what} than the phases before it")]
    PhasesDiffer {
        /// The phase.
        phase: String,
        /// What differs.
        what: String,
    },
    /// The first phase inherits.
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
    /// What to do about it.
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

//! Why there is no best plan.

/// Most names in a message.
const MOST_NAMED: usize = 6;

/// Why there is no best plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BestPlanError {
    /// A cost or number of a candidate that is no number, or of the wrong size.
    #[error("candidate `{candidate}` has `{found}` in column `{column}`, expected {expected}")]
    Number {
        /// Name of the candidate.
        candidate: String,
        /// Name of the column.
        column: String,
        /// What stands there.
        found: String,
        /// What should.
        expected: &'static str,
    },
    /// A cost or number that is not the same in all rows of a candidate.
    #[error("candidate `{candidate}` has `{first}` and `{second}` in column `{column}`")]
    Varies {
        /// Name of the candidate.
        candidate: String,
        /// Name of the column.
        column: String,
        /// One text.
        first: String,
        /// Another.
        second: String,
    },
    /// `--for` names what is no figure of the model.
    #[error("`--for` names `{found}`, which is no figure of this model")]
    UnknownFigure {
        /// What was named.
        found: String,
        /// All figures.
        known: Vec<String>,
    },
    /// The model fixes a figure.
    #[error("the model fixes {figure}: no test can make it better known")]
    Fixed {
        /// The figure.
        figure: String,
    },
    /// A figure that a plan takes as known.
    #[error("the plan takes {figure} as known")]
    Known {
        /// The figure.
        figure: String,
    },
    /// Figures that are to be known together depend on each other.
    #[error("the figures of `{goal}` depend on each other: they have no determinant")]
    Dependent {
        /// What was asked for.
        goal: String,
    },
    /// There is nothing to plan for.
    #[error("the model leaves nothing free that `{goal}` asks for")]
    NothingFree {
        /// What was asked for.
        goal: String,
    },
    /// Standard input without a column that has a default.
    #[error("standard input has no column `{column}`, and it can be read only once")]
    Stdin {
        /// The column.
        column: String,
    },
    /// A mission of none or several tests.
    #[error("the mission has {found} tests, expected one")]
    Mission {
        /// Number of tests.
        found: usize,
    },
    /// All draws contradict the model.
    #[error("no draw can be used: the model fixes elements of the covariance that draws would move")]
    NoDraws,
    /// Results of another model.
    #[error("`{path}` has the covariance of other estimates: it is a fit of another model")]
    OtherModel {
        /// The file.
        path: String,
    },
    /// No candidate informs some figures.
    #[error("no candidate informs {}, and nothing is known of {} yet", listed(figures), if figures.len() == 1 { "it" } else { "them" })]
    Uninformed {
        /// The figures.
        figures: Vec<String>,
        /// Whether all free values were asked for.
        of_all: bool,
    },
    /// The budget is below the cheapest candidate.
    #[error("the budget is {budget}, and the cheapest candidate costs {cheapest}")]
    Budget {
        /// The budget.
        budget: f64,
        /// The cost of the cheapest candidate.
        cheapest: f64,
    },
    /// The budget is too small.
    #[error("no plan in whole numbers within the budget of {budget} determines {what}")]
    TooLittle {
        /// The budget.
        budget: f64,
        /// What was to be known.
        what: String,
    },
    /// A fit that says nothing of its errors.
    #[error("`{path}` has no covariance of the estimates, so it does not say what is known already")]
    NoErrors {
        /// The file.
        path: String,
    },
    /// Draws without a fit.
    #[error("`--draws` draws parameters by the errors of a fit, and `{from}` has none")]
    NoLaw {
        /// What the population is from.
        from: String,
    },
    /// The information about free parameters needs rows.
    #[error("{0}")]
    NotByRows(String),
    /// Candidates whose information does not fit into memory.
    #[error("the information of {candidates} candidates about {values} values, in {sets} sets of parameters, has {} million numbers", numbers / 1_000_000)]
    TooMany {
        /// Number of candidates.
        candidates: usize,
        /// Number of values.
        values: usize,
        /// Number of sets of parameters.
        sets: usize,
        /// Number of numbers.
        numbers: usize,
    },
}

fn listed(names: &[String]) -> String {
    let shown: Vec<&str> = names.iter().take(MOST_NAMED).map(String::as_str).collect();
    match names.len().saturating_sub(MOST_NAMED) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

impl BestPlanError {
    /// What to do about it.
    pub fn hint(&self) -> Option<String> {
        Some(match self {
            BestPlanError::Number { .. } | BestPlanError::Varies { .. } => {
                "the columns of `--cost` and `--most` hold one number in all rows of a candidate".to_owned()
            }
            BestPlanError::UnknownFigure { found, known } => {
                match kalfit_spec::nearest(found, known.iter().map(String::as_str)) {
                    Some(name) => format!("did you mean `{name}`?"),
                    None => format!("give `D`, `A`, or figures: {}", listed(known)),
                }
            }
            BestPlanError::Known { .. } => {
                "parameters with a value for each level of a column, those given by `--set`, and those that the covariance depends on \
                 are taken as known"
                    .to_owned()
            }
            BestPlanError::Dependent { .. } => "leave one of them out, or name them without `D(…)`".to_owned(),
            BestPlanError::NothingFree { .. } => "free a mean, covariance or parameter in the model".to_owned(),
            BestPlanError::Stdin { .. } => "put the table in a file, or name a column by `--cost` or `--most`".to_owned(),
            BestPlanError::Mission { .. } => "give the rows of one test: `output(NAME, 3)` is its value at row 3".to_owned(),
            BestPlanError::NoDraws => "leave `--draws` out".to_owned(),
            BestPlanError::OtherModel { .. } => "give a fit of this model, or the tests that were made".to_owned(),
            BestPlanError::Fixed { .. } => "name another figure, or free this one in the model".to_owned(),
            BestPlanError::Uninformed { of_all: true, .. } => {
                "name by `--for` what is to be known, such as `--for \"sd(bias)\"`, or add a candidate that informs them"
                    .to_owned()
            }
            BestPlanError::Uninformed { .. } => "add a candidate that informs it".to_owned(),
            BestPlanError::Budget { .. } | BestPlanError::TooLittle { .. } => {
                "give a larger `--budget`, or what is known already by `--with`".to_owned()
            }
            BestPlanError::NoErrors { .. } => "give the tests that were made instead: `--with made.csv`".to_owned(),
            BestPlanError::NoLaw { .. } => "leave it out, or give the results of a fit by `--from`".to_owned(),
            BestPlanError::NotByRows(_) => "fix the free parameters by `--set`".to_owned(),
            BestPlanError::TooMany { .. } => "give fewer candidates or draws".to_owned(),
        })
    }
}

//! The reasons why there is no estimate.

use kalfit_model::StructureError;

/// The reason why there is no estimate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FitError {
    /// There are no tests.
    #[error("there are no tests")]
    NoTests,
    /// The structure of Σ is not valid.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Two tests have the same id.
    #[error("two tests have the id `{id}`")]
    DuplicateTest {
        /// The id that both tests have.
        id: String,
    },
    /// The groups of a test are not known, under a model with levels.
    #[error("the model has levels of groups, and the groups of test `{test}` are not known")]
    Ungrouped {
        /// The id of the test.
        test: String,
    },
    /// A test measures estimated states without noise, under a model with levels.
    #[error(
        "test `{test}` measures a combination of estimated states without any noise, which levels of groups do not take"
    )]
    ExactInGroups {
        /// The id of the test.
        test: String,
    },
    /// The levels of crossed factors are too many for one system.
    #[error(
        "the effects of the crossed factors are {found} unknowns of one system (levels × states), expected at most {most}"
    )]
    ManyLevels {
        /// Levels × states of the largest system.
        found: usize,
        /// The largest system that is solved.
        most: usize,
    },
    /// A test is not stored phase by phase, although each phase is to be fitted separately.
    #[error("the reduction of test `{test}` does not hold its phases one by one, which `marginal` needs")]
    NoPhases {
        /// The id of the test.
        test: String,
    },
    /// The restricted likelihood is requested for phases that are fitted separately.
    #[error("the restricted likelihood is not available for phases that are fitted separately (`marginal`)")]
    RestrictedMarginal,
    /// Σ became singular along what tests measure without noise.
    #[error(
        "the log-likelihood has no maximum: it grows without bound as the covariance becomes singular along what test `{test}` measures without any noise"
    )]
    Unbounded {
        /// The id of a test that measures without noise.
        test: String,
    },
    /// ℓ is not a finite number at the start.
    #[error("the log-likelihood is not finite at the start values")]
    NotFinite,
    /// A step lowered the log-likelihood, which EM cannot do: the arithmetic has broken down.
    #[error("an EM step lowered the log-likelihood from {before} to {after}; the problem is too ill-conditioned")]
    NotMonotone {
        /// ℓ before the step.
        before: f64,
        /// ℓ after the step.
        after: f64,
    },
}

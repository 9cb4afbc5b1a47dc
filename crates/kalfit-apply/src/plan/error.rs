//! Why a plan is not possible.

use kalfit_algebra::elements::Element;
use kalfit_estimate::{ExpectedError, FitError};
use kalfit_model::PopulationError;

/// Why a plan is not possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The population does not fit the model.
    #[error("the population cannot be planned for: {0}")]
    Population(#[from] PopulationError),
    /// A design or a structure that is not possible.
    #[error(transparent)]
    Design(#[from] FitError),
    /// A number of tests that is zero.
    #[error("found a number of tests of 0, expected 1 or more")]
    ZeroTests,
    /// More tests than can be arranged in groups.
    #[error("found an arrangement of {found} tests, expected at most {most}")]
    TooManyTests {
        /// Number of tests of the arrangement.
        found: usize,
        /// Largest number of tests that can be arranged.
        most: usize,
    },
    /// Fewer levels of a factor than one test has slots for.
    #[error("found a number of levels of {found} of a factor of which a test has {slots}, expected {slots} or more")]
    TooFewLevels {
        /// Number of levels.
        found: usize,
        /// Number of slots.
        slots: usize,
    },
    /// An element of the population that contradicts the model's structure.
    #[error("{} is {found} in the population, and the model makes it {expected}", words(element))]
    OffStructure {
        /// The element, by indices in μ or Σ.
        element: Element,
        /// Value of the element in the population.
        found: f64,
        /// Value of the element under the structure.
        expected: f64,
    },
}

impl From<ExpectedError> for PlanError {
    fn from(error: ExpectedError) -> PlanError {
        match error {
            ExpectedError::Fit(error) => PlanError::Design(error),
            ExpectedError::Off { element, found, expected } => PlanError::OffStructure { element, found, expected },
        }
    }
}

fn words(element: &Element) -> String {
    match element {
        Element::Mean(i) => format!("mean {}", i + 1),
        Element::Covariance(i, j) => format!("covariance ({}, {})", i + 1, j + 1),
    }
}

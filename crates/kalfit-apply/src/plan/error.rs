//! Why there is no plan.

use kalfit_algebra::elements::Element;
use kalfit_estimate::FitError;
use kalfit_model::PopulationError;

/// A refusal to plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The population does not fit the model.
    #[error("the population cannot be planned for: {0}")]
    Population(#[from] PopulationError),
    /// The design or the structure cannot be.
    #[error(transparent)]
    Design(#[from] FitError),
    /// A number of tests of zero.
    #[error("found a number of tests of 0, expected 1 or more")]
    ZeroTests,
    /// More tests than can be arranged in groups.
    #[error("found an arrangement of {found} tests, expected at most {most}")]
    TooManyTests {
        /// How many there would be.
        found: usize,
        /// The most.
        most: usize,
    },
    /// An element of the population is not what the model's structure makes it.
    #[error("{} is {found} in the population, and the model makes it {expected}", words(element))]
    OffStructure {
        /// Which element, by places in μ and Σ.
        element: Element,
        /// Its value in the population.
        found: f64,
        /// Its value under the structure.
        expected: f64,
    },
}

fn words(element: &Element) -> String {
    match element {
        Element::Mean(i) => format!("mean {}", i + 1),
        Element::Covariance(i, j) => format!("covariance ({}, {})", i + 1, j + 1),
    }
}

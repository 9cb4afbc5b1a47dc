//! Whether tests are of the population, all of them together.

use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::apply::Said;
use crate::infer::Distance;

/// Sums over all tests against their laws at the given parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Log density of all that was measured.
    pub log_density: f64,
    /// Distances of the tests' initial states from the population, or of the groups of the outermost level.
    pub distance: Joint,
    /// Of tests in groups: how far the tests of one group of the outermost level are from each other, whatever the group is.
    pub within: Option<Joint>,
    /// What measured values are off the model whatever the initial states are; without degrees of freedom where nothing was measured.
    pub residual: Joint,
}

/// A sum of squares and its law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Σ of the squares.
    pub squared: f64,
    /// Degrees of freedom of χ².
    pub degrees_of_freedom: usize,
    /// Twice the smaller tail; `None` without degrees of freedom.
    pub p_value: Option<f64>,
}

impl Joint {
    pub(crate) fn new(squared: f64, degrees_of_freedom: usize) -> Joint {
        let law = ChiSquared::new(degrees_of_freedom as f64).ok();
        let p_value = law.map(|law| (2.0 * law.cdf(squared).min(law.sf(squared))).min(1.0));
        Joint { squared, degrees_of_freedom, p_value }
    }

    fn of<'a>(distances: impl Iterator<Item = &'a Distance>) -> Joint {
        let (squared, degrees) =
            distances.fold((0.0, 0), |(sum, count), own| (sum + own.squared, count + own.degrees_of_freedom));
        Joint::new(squared, degrees)
    }
}

impl Said {
    /// All tests together.
    pub fn verdict(&self) -> Verdict {
        // tests of one group are not independent: the groups of the outermost level are
        let distance = match self.groups.last() {
            Some(groups) => Joint::of(groups.iter().map(|group| &group.distance)),
            None => Joint::of(self.posteriors.iter().map(|test| &test.distance)),
        };
        let log_density = match self.groups.last() {
            Some(groups) => groups.iter().map(|group| group.log_likelihood).sum(),
            None => self.posteriors.iter().map(|test| test.log_likelihood).sum(),
        };
        let within = self.groups.last().map(|groups| {
            let tests: usize = self.posteriors.iter().map(|test| test.distance.degrees_of_freedom).sum();
            let squared = groups.iter().map(|group| group.within).sum();
            Joint::new(squared, tests.saturating_sub(distance.degrees_of_freedom))
        });
        let residuals = self.residuals.iter().flatten();
        let (squared, degrees) = residuals.fold((0.0, 0), |(sum, count), own| (sum + own.0, count + own.1));
        Verdict { log_density, distance, within, residual: Joint::new(squared, degrees) }
    }
}

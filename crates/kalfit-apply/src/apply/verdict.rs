//! Whether tests are of the population, all of them together.

use crate::apply::{Law, Laws, Said};

/// Sums over all tests against their laws.
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
    /// Their degrees of freedom: what they add up to on average at known parameters.
    pub degrees_of_freedom: usize,
    /// `None` without degrees of freedom, and where it is not known.
    pub law: Option<Law>,
    /// Twice the smaller tail; `None` without a law.
    pub p_value: Option<f64>,
}

/// Number of squares that are not of nothing, and their degrees of freedom.
type Degrees = (usize, usize);

impl Joint {
    fn new(squared: f64, degrees_of_freedom: usize, law: Option<Law>) -> Joint {
        Joint { squared, degrees_of_freedom, law, p_value: law.and_then(|law| law.two_sided(squared)) }
    }
}

impl Said {
    /// Of the distances of the groups of the outermost level or of the tests where there are none, of tests within groups, and of residuals.
    pub(super) fn degrees(&self) -> [Degrees; 3] {
        let of = |degrees: &mut dyn Iterator<Item = usize>| {
            degrees.filter(|own| *own > 0).fold((0, 0), |(count, sum), own| (count + 1, sum + own))
        };
        let tests = of(&mut self.posteriors.iter().map(|test| test.distance.degrees_of_freedom));
        let residuals = of(&mut self.residuals.iter().flatten().map(|own| own.1));
        match self.groups.last() {
            Some(groups) => {
                let groups = of(&mut groups.iter().map(|group| group.distance.degrees_of_freedom));
                [groups, (tests.0.saturating_sub(groups.0), tests.1.saturating_sub(groups.1)), residuals]
            }
            None => [tests, (0, 0), residuals],
        }
    }

    /// All tests together.
    pub fn verdict(&self, laws: &Laws) -> Verdict {
        let [(_, of_distance), (_, of_within), (_, of_residual)] = self.degrees();
        // tests of one group are not independent: the groups of the outermost level are
        let squared = match self.groups.last() {
            Some(groups) => groups.iter().map(|group| group.distance.squared).sum(),
            None => self.posteriors.iter().map(|test| test.distance.squared).sum(),
        };
        let within = self.groups.last().map(|groups| {
            let squared = groups.iter().map(|group| group.within).sum();
            Joint::new(squared, of_within, laws.within)
        });
        let residual = self.residuals.iter().flatten().map(|own| own.0).sum();
        Verdict {
            log_density: self.log_density(),
            distance: Joint::new(squared, of_distance, laws.distance),
            within,
            residual: Joint::new(residual, of_residual, laws.residual),
        }
    }

    /// Log density of all that was measured: tests of one group are not independent.
    pub fn log_density(&self) -> f64 {
        match self.groups.last() {
            Some(groups) => groups.iter().map(|group| group.log_likelihood).sum(),
            None => self.posteriors.iter().map(|test| test.log_likelihood).sum(),
        }
    }
}

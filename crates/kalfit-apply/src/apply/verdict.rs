//! Whether all tests together come from the population.

use crate::apply::{Law, Laws, Said};

/// Sums over all tests, compared with their laws.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Log density of all measured values.
    pub log_density: f64,
    /// Distances of the tests' initial states from the population; of groups of the outermost level, where tests stand
    /// in groups.
    pub distance: Joint,
    /// Distances of the tests of one outermost group from each other, whatever the group is; `None` without groups.
    pub within: Option<Joint>,
    /// Residuals of measured values whatever the initial states are; without degrees of freedom where nothing was
    /// measured.
    pub residual: Joint,
}

/// A sum of squares and its law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Sum of the squares.
    pub squared: f64,
    /// Degrees of freedom of the squares: the expected value of their sum at known parameters.
    pub degrees_of_freedom: usize,
    /// Law of the sum; `None` without degrees of freedom, and where the law is not known.
    pub law: Option<Law>,
    /// Two-sided p-value, twice the smaller tail; `None` without a law.
    pub p_value: Option<f64>,
}

/// (Number of squares that have degrees of freedom, sum of these degrees of freedom).
type Degrees = (usize, usize);

impl Joint {
    fn new(squared: f64, degrees_of_freedom: usize, law: Option<Law>) -> Joint {
        Joint { squared, degrees_of_freedom, law, p_value: law.and_then(|law| law.two_sided(squared)) }
    }
}

impl Said {
    /// Degrees of freedom of distances (of outermost groups, or of tests without groups), of distances within groups,
    /// and of residuals.
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

    /// Sums over all tests, compared with `laws`.
    pub fn verdict(&self, laws: &Laws) -> Verdict {
        let [(_, of_distance), (_, of_within), (_, of_residual)] = self.degrees();
        // tests of one group are not independent; groups of the outermost level are
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

    /// Log density of all measured values, summed over independent units: tests of one group are not independent.
    pub fn log_density(&self) -> f64 {
        match self.groups.last() {
            Some(groups) => groups.iter().map(|group| group.log_likelihood).sum(),
            None => self.posteriors.iter().map(|test| test.log_likelihood).sum(),
        }
    }
}

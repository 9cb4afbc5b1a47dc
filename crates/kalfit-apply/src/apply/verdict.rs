//! Whether all tests together come from the population.

use crate::apply::{Law, Laws, Said};

/// Log density and sums of squares over all tests; each sum is compared with a law.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Log density of all measured values.
    pub log_density: f64,
    /// Sum of the squared distances of the tests from the population, or of the groups of the outermost level where
    /// tests are in groups.
    pub distance: Joint,
    /// Sum of squares of the differences between tests of one outermost group; `None` without groups.
    pub within: Option<Joint>,
    /// Sum of the squared residuals of the measured values at the initial states that fit each test best; zero degrees
    /// of freedom where nothing was measured.
    pub residual: Joint,
}

/// A sum of squares with the law of the sum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Sum of the squares.
    pub squared: f64,
    /// Degrees of freedom of the squares: E`squared` at known parameters.
    pub degrees_of_freedom: usize,
    /// Law of the sum; `None` without degrees of freedom, and where the law is not known.
    pub law: Option<Law>,
    /// Two-sided p-value, twice the smaller tail; `None` without a law.
    pub p_value: Option<f64>,
}

/// (Number of squares with at least one degree of freedom, sum of the degrees of freedom of all squares).
type CountAndSum = (usize, usize);

impl Joint {
    fn new(squared: f64, degrees_of_freedom: usize, law: Option<Law>) -> Joint {
        Joint { squared, degrees_of_freedom, law, p_value: law.and_then(|law| law.two_sided(squared)) }
    }
}

impl Said {
    /// Degrees of freedom of the distances (of outermost groups, or of tests without groups), of the distances within
    /// groups, and of the residuals.
    pub(super) fn degrees(&self) -> [CountAndSum; 3] {
        let count_and_sum = |degrees: &mut dyn Iterator<Item = usize>| {
            degrees.filter(|own| *own > 0).fold((0, 0), |(count, sum), own| (count + 1, sum + own))
        };
        let tests = count_and_sum(&mut self.posteriors.iter().map(|test| test.distance.degrees_of_freedom));
        let residuals = count_and_sum(&mut self.residuals.iter().flatten().map(|own| own.1));
        if let Some(joint) = &self.joint {
            return [(tests.0, joint.degrees_of_freedom), (0, 0), residuals];
        }
        match self.groups.last() {
            Some(groups) => {
                let groups = count_and_sum(&mut groups.iter().map(|group| group.distance.degrees_of_freedom));
                [groups, (tests.0.saturating_sub(groups.0), tests.1.saturating_sub(groups.1)), residuals]
            }
            None => [tests, (0, 0), residuals],
        }
    }

    /// Log density and sums of squares over all tests; the sums are compared with `laws`.
    pub fn verdict(&self, laws: &Laws) -> Verdict {
        let [(_, distance_degrees), (_, within_degrees), (_, residual_degrees)] = self.degrees();
        // tests of one group are not independent; groups of the outermost level are
        let squared = match (&self.joint, self.groups.last()) {
            (Some(joint), _) => joint.squared,
            (None, Some(groups)) => groups.iter().map(|group| group.distance.squared).sum(),
            (None, None) => self.posteriors.iter().map(|test| test.distance.squared).sum(),
        };
        let nested = self.groups.last().filter(|_| self.joint.is_none());
        let within = nested.map(|groups| {
            let squared = groups.iter().map(|group| group.within).sum();
            Joint::new(squared, within_degrees, laws.within)
        });
        let residual = self.residuals.iter().flatten().map(|own| own.0).sum();
        Verdict {
            log_density: self.log_density(),
            distance: Joint::new(squared, distance_degrees, laws.distance),
            within,
            residual: Joint::new(residual, residual_degrees, laws.residual),
        }
    }

    /// Log density of all measured values: the sum over the groups of the outermost level, or over the tests where
    /// there are no groups, because tests of one group are not independent; that of all tests together where groups
    /// cross.
    pub fn log_density(&self) -> f64 {
        match (&self.joint, self.groups.last()) {
            (Some(joint), _) => joint.log_density,
            (None, Some(groups)) => groups.iter().map(|group| group.log_likelihood).sum(),
            (None, None) => self.posteriors.iter().map(|test| test.log_likelihood).sum(),
        }
    }
}

//! Posteriors of all tests, stored in columns: every column has the same number of entries for each test.

use nalgebra::DMatrixView;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Posteriors of tests, in a given order of the tests.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Posteriors {
    /// Number of states of each phase.
    sizes: Vec<usize>,
    log_likelihood: Vec<f64>,
    mean: Vec<f64>,
    /// Covariance of each phase by rows, phase after phase, for each test in turn.
    covariances: Vec<f64>,
    distance: Vec<Distance>,
}

/// Posterior of one test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posterior<'a> {
    /// log p of the test's measurements.
    pub log_likelihood: f64,
    /// E[ξ | z] (p).
    pub mean: &'a [f64],
    sizes: &'a [usize],
    covariances: &'a [f64],
    /// Distance of the test from the population.
    pub distance: Distance,
}

/// Standardised squared distance of a test's estimate from the population mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// The squared distance (y - Jμ)'(J + JΣJ)⁺(y - Jμ).
    pub squared: f64,
    /// Rank of J, the information of the test.
    pub degrees_of_freedom: usize,
    /// χ² tail probability; `None` without degrees of freedom.
    pub p_value: Option<f64>,
}

/// Posteriors of some tests, and the index of each test.
#[derive(Debug)]
pub(super) struct NumberedPosteriors {
    numbers: Vec<usize>,
    store: Posteriors,
}

impl Posteriors {
    /// An empty store; `sizes`: number of states of each phase.
    pub(super) fn new(sizes: Vec<usize>) -> Posteriors {
        Posteriors { sizes, ..Posteriors::default() }
    }

    /// Number of tests.
    pub fn len(&self) -> usize {
        self.distance.len()
    }

    /// Whether there are no tests.
    pub fn is_empty(&self) -> bool {
        self.distance.is_empty()
    }

    /// Posterior of the test with this index. Panics when there is no such test.
    pub fn get(&self, test: usize) -> Posterior<'_> {
        let (p, covariance_entries) = (self.states(), self.covariance_entries());
        Posterior {
            log_likelihood: self.log_likelihood[test],
            mean: &self.mean[test * p..][..p],
            sizes: &self.sizes,
            covariances: &self.covariances[test * covariance_entries..][..covariance_entries],
            distance: self.distance[test],
        }
    }

    /// The posteriors, test by test.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Posterior<'_>> {
        (0..self.len()).map(|test| self.get(test))
    }

    /// Adds a test: `covariances` holds the covariance of each phase by rows, phase after phase.
    pub(super) fn push(&mut self, (log_likelihood, distance): (f64, Distance), mean: &[f64], covariances: &[f64]) {
        self.log_likelihood.push(log_likelihood);
        self.distance.push(distance);
        self.mean.extend_from_slice(mean);
        self.covariances.extend_from_slice(covariances);
        debug_assert_eq!(self.covariances.len(), self.len() * self.covariance_entries());
    }

    /// Joins parts in the order of the tests' indices, which are 0, 1, 2, … without gaps.
    pub(super) fn ordered(sizes: Vec<usize>, parts: &[NumberedPosteriors]) -> Posteriors {
        let mut numbered: Vec<(usize, usize, usize)> = parts
            .iter()
            .enumerate()
            .flat_map(|(part, own)| own.numbers.iter().enumerate().map(move |(at, &number)| (number, part, at)))
            .collect();
        numbered.sort_unstable();
        let mut all = Posteriors::new(sizes);
        for (_, part, at) in numbered {
            let one = parts[part].store.get(at);
            all.push((one.log_likelihood, one.distance), one.mean, one.covariances);
        }
        all
    }

    fn states(&self) -> usize {
        self.sizes.iter().sum()
    }

    fn covariance_entries(&self) -> usize {
        self.sizes.iter().map(|size| size * size).sum()
    }
}

impl<'a> Posterior<'a> {
    /// Var[ξ_i | z] of the phase with this index (p_i × p_i). Panics when the model has no such phase.
    pub fn covariance(&self, phase: usize) -> DMatrixView<'a, f64> {
        DMatrixView::from_slice(self.covariance_rows(phase), self.sizes[phase], self.sizes[phase])
    }

    /// The covariance of a phase by rows.
    pub fn covariance_rows(&self, phase: usize) -> &'a [f64] {
        let (before, size) = (&self.sizes[..phase], self.sizes[phase]);
        let start: usize = before.iter().map(|size| size * size).sum();
        &self.covariances[start..][..size * size]
    }

    /// The covariances of all phases.
    pub fn covariances(&self) -> impl ExactSizeIterator<Item = DMatrixView<'a, f64>> {
        let own = *self;
        (0..own.sizes.len()).map(move |phase| own.covariance(phase))
    }
}

impl Distance {
    /// A distance, with the tail probability of `squared` under χ² with `degrees_of_freedom`.
    pub(super) fn new(squared: f64, degrees_of_freedom: usize) -> Distance {
        let p_value = ChiSquared::new(degrees_of_freedom as f64).ok().map(|chi| chi.sf(squared));
        Distance { squared, degrees_of_freedom, p_value }
    }
}

impl NumberedPosteriors {
    /// An empty store; `sizes`: number of states of each phase.
    pub(super) fn new(sizes: &[usize]) -> NumberedPosteriors {
        NumberedPosteriors { numbers: Vec::new(), store: Posteriors::new(sizes.to_vec()) }
    }

    /// Records the index of the next test; returns the store, to which the caller adds the test.
    pub(super) fn of(&mut self, number: usize) -> &mut Posteriors {
        self.numbers.push(number);
        &mut self.store
    }
}

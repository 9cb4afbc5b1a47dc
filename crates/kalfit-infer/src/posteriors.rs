//! What all tests say, in columns: a number, or as many as all tests have alike, for each test.

use nalgebra::DMatrixView;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// What each test says, in an order of tests.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Posteriors {
    /// States of each phase.
    sizes: Vec<usize>,
    log_likelihood: Vec<f64>,
    mean: Vec<f64>,
    /// Of each test phase after phase, by rows.
    covariances: Vec<f64>,
    distance: Vec<Distance>,
}

/// What one test says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posterior<'a> {
    /// log p of its measurements.
    pub log_likelihood: f64,
    /// E[ξ | z] (p).
    pub mean: &'a [f64],
    sizes: &'a [usize],
    covariances: &'a [f64],
    /// How far the test is from the population.
    pub distance: Distance,
}

/// Standardised squared distance of a test's own estimate from the population mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// (y - Jμ)'(J + JΣJ)⁺(y - Jμ).
    pub squared: f64,
    /// Rank of J.
    pub degrees_of_freedom: usize,
    /// χ² tail probability; `None` without degrees of freedom.
    pub p_value: Option<f64>,
}

/// What some tests say, each with its number.
#[derive(Debug)]
pub(super) struct NumberedPosteriors {
    numbers: Vec<usize>,
    found: Posteriors,
}

impl Posteriors {
    /// Of no test yet, with so many states in each phase.
    pub(super) fn new(sizes: Vec<usize>) -> Posteriors {
        Posteriors { sizes, ..Posteriors::default() }
    }

    /// How many tests they are.
    pub fn len(&self) -> usize {
        self.distance.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.distance.is_empty()
    }

    /// What the test with this number says. Panics when there is no such test.
    pub fn get(&self, test: usize) -> Posterior<'_> {
        let (p, squares) = (self.states(), self.squares());
        Posterior {
            log_likelihood: self.log_likelihood[test],
            mean: &self.mean[test * p..][..p],
            sizes: &self.sizes,
            covariances: &self.covariances[test * squares..][..squares],
            distance: self.distance[test],
        }
    }

    /// What each test says.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Posterior<'_>> {
        (0..self.len()).map(|test| self.get(test))
    }

    /// Adds a test: `covariances` of each phase after the other, by rows.
    pub(super) fn push(&mut self, (log_likelihood, distance): (f64, Distance), mean: &[f64], covariances: &[f64]) {
        self.log_likelihood.push(log_likelihood);
        self.distance.push(distance);
        self.mean.extend_from_slice(mean);
        self.covariances.extend_from_slice(covariances);
        debug_assert_eq!(self.covariances.len(), self.len() * self.squares());
    }

    /// In the order of their numbers, which are those from 0 on.
    pub(super) fn ordered(sizes: Vec<usize>, parts: &[NumberedPosteriors]) -> Posteriors {
        let mut places: Vec<(usize, usize, usize)> = parts
            .iter()
            .enumerate()
            .flat_map(|(part, own)| own.numbers.iter().enumerate().map(move |(at, &number)| (number, part, at)))
            .collect();
        places.sort_unstable();
        let mut all = Posteriors::new(sizes);
        for (_, part, at) in places {
            let one = parts[part].found.get(at);
            all.push((one.log_likelihood, one.distance), one.mean, one.covariances);
        }
        all
    }

    fn states(&self) -> usize {
        self.sizes.iter().sum()
    }

    fn squares(&self) -> usize {
        self.sizes.iter().map(|size| size * size).sum()
    }
}

impl<'a> Posterior<'a> {
    /// Var[ξ_i | z] of the phase with this number (p_i × p_i). Panics when the model has no such phase.
    pub fn covariance(&self, phase: usize) -> DMatrixView<'a, f64> {
        DMatrixView::from_slice(self.square(phase), self.sizes[phase], self.sizes[phase])
    }

    /// The same by rows.
    pub fn square(&self, phase: usize) -> &'a [f64] {
        let (before, size) = (&self.sizes[..phase], self.sizes[phase]);
        let start: usize = before.iter().map(|size| size * size).sum();
        &self.covariances[start..][..size * size]
    }

    /// The same of all phases.
    pub fn covariances(&self) -> impl ExactSizeIterator<Item = DMatrixView<'a, f64>> {
        let own = *self;
        (0..own.sizes.len()).map(move |phase| own.covariance(phase))
    }
}

impl Distance {
    /// Of χ² with so many degrees of freedom.
    pub(super) fn new(squared: f64, degrees_of_freedom: usize) -> Distance {
        let p_value = ChiSquared::new(degrees_of_freedom as f64).ok().map(|chi| chi.sf(squared));
        Distance { squared, degrees_of_freedom, p_value }
    }
}

impl NumberedPosteriors {
    /// Of no test yet.
    pub(super) fn new(sizes: &[usize]) -> NumberedPosteriors {
        NumberedPosteriors { numbers: Vec::new(), found: Posteriors::new(sizes.to_vec()) }
    }

    /// Where to add the test with this number.
    pub(super) fn of(&mut self, number: usize) -> &mut Posteriors {
        self.numbers.push(number);
        &mut self.found
    }
}

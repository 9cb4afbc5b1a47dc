//! Sums over remote tests: the requests, and the reading of the answers.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::classes::Classes;
use crate::frame::Frame;
use crate::frame::Pooled;
use crate::order::SumsWanted;
use crate::point::Point;
use crate::sums::Sums;
use kalfit_algebra::elements::Elements;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Path;
use kalfit_model::remote::{Flat, Place, Question, Remote};

/// Counts of the tests of one place or of all places, at the head of the answer to [`Question::Survey`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Number of tests.
    pub tests: usize,
    /// Number of steps of all tests.
    pub steps: usize,
    /// Number of scalar measurements of all tests.
    pub observations: usize,
    /// Number of tests that need square-root arithmetic.
    pub square_root_tests: usize,
    /// Number of designs, added over places: a design that two places share counts twice.
    pub designs: usize,
}

impl Counts {
    const LENGTH: usize = 5;

    /// Counts of the tests of reductions, stored here or remote.
    pub fn of(reductions: &Reductions) -> Counts {
        if let Some(remote) = reductions.remote() {
            let survey = remote.ask(Question::Survey).unwrap_or_default();
            return survey.first_chunk().map_or_else(Counts::default, |head| Counts::read(*head));
        }
        let mut designs = reductions.designs().to_vec();
        designs.par_sort_unstable();
        designs.dedup();
        Counts {
            tests: reductions.len(),
            steps: reductions.steps().iter().sum(),
            observations: reductions.observations().iter().sum(),
            square_root_tests: reductions.paths().iter().filter(|path| **path == Path::SquareRoot).count(),
            designs: designs.len(),
        }
    }

    pub(super) fn numbers(self) -> [f64; Self::LENGTH] {
        [self.tests, self.steps, self.observations, self.square_root_tests, self.designs].map(|n| n as f64)
    }

    fn read(head: [f64; Self::LENGTH]) -> Counts {
        let [tests, steps, observations, square_root_tests, designs] = head.map(|n| n as usize);
        Counts { tests, steps, observations, square_root_tests, designs }
    }
}

impl Classes {
    /// The classes of remote tests, in coordinates from the survey of all of them.
    pub(super) fn of_remote(remote: &Remote, (elements, centred): (Elements, &[bool]), chained: bool) -> Classes {
        let (blocks, sizes) = (elements.blocks().len(), (elements.states(), centred.len()));
        let survey_totals = || {
            let numbers = remote.ask(Question::Survey)?;
            let (head, rest) = numbers.split_first_chunk()?;
            let (present, pooled) = rest.split_at_checked(blocks)?;
            Some((Counts::read(*head).tests, present.to_vec(), Pooled::of_numbers(sizes, pooled)?))
        };
        let (tests, present, pooled) = survey_totals().unwrap_or_else(|| (0, vec![0.0; blocks], Pooled::none(sizes)));
        Classes::of_survey(remote, (tests, present, &pooled), (elements, centred, chained))
    }
}

/// ℓ and its derivatives at a point; NaN where there is no answer.
pub(super) fn pass((remote, classes): (&Remote, &Classes), point: &Point, wanted: SumsWanted<'_>) -> Sums {
    let flat = wanted.flat.map(|flat| Flat {
        free: flat.jacobian.ncols(),
        jacobian: column_list(flat.jacobian),
        covariance: flat.covariance.map(column_list),
    });
    let (frame, place) = (classes.frame.clone(), point.message());
    let answer = remote.ask(Question::Pass { frame, place, detail: wanted.order, flat });
    let zero = || if classes.units.is_some() { wanted.zero_in_groups() } else { wanted.zero() };
    answer.and_then(|numbers| zero().of_numbers(&numbers)).unwrap_or_else(|| zero().unknown())
}

/// [`Classes::excess`] of remote tests; zero where there is no answer.
pub(super) fn excess(remote: &Remote, frame: &Frame, mean: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
    let p = mean.len();
    let answer = remote.ask(Question::Excess { frame: frame.clone(), mean: mean.as_slice().to_vec() });
    let numbers = answer.filter(|numbers| numbers.len() == 2 * p).unwrap_or_else(|| vec![0.0; 2 * p]);
    (DVector::from_column_slice(&numbers[..p]), DVector::from_column_slice(&numbers[p..]))
}

impl Point {
    /// The point in the form that is sent to remote places.
    pub(super) fn message(&self) -> Place {
        Place { mean: self.mean.clone(), coefficients: self.coefficients.clone(), root: column_list(&self.root) }
    }
}

/// A matrix as a list by columns.
pub(super) fn column_list(matrix: &DMatrix<f64>) -> Vec<f64> {
    matrix.as_slice().to_vec()
}

//! Sums over tests that are elsewhere: what is asked for, and what a place that holds some of them answers.

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use crate::estimate::classes::{Classes, present};
use crate::estimate::frame::{Frame, Pooled};
use crate::estimate::order::{FlatMean, Wanted};
use crate::estimate::pass;
use crate::estimate::point::{Point, Regressors};
use crate::estimate::structure::Structure;
use crate::estimate::sums::Sums;
use crate::linalg::elements::Elements;
use crate::reduce::{Path, Reductions};
use crate::remote::{Answer, Coordinates, Flat, Place, Question, Remote};

/// Counts of the tests of one place or of all, at the head of its answer to [`Question::Survey`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct RemoteCounts {
    pub(crate) tests: usize,
    pub(crate) steps: usize,
    pub(crate) observations: usize,
    pub(crate) square_root_tests: usize,
    /// Added place by place: what two have in common counts twice.
    pub(crate) designs: usize,
}

impl RemoteCounts {
    const LENGTH: usize = 5;

    /// Of the tests behind reductions that are elsewhere.
    pub(crate) fn of(remote: &Remote) -> RemoteCounts {
        let survey = remote.ask(Question::Survey).unwrap_or_default();
        survey.first_chunk().map_or_else(RemoteCounts::default, |head| RemoteCounts::read(*head))
    }

    fn here(reductions: &Reductions) -> RemoteCounts {
        RemoteCounts {
            tests: reductions.len(),
            steps: reductions.iter().map(|r| r.steps).sum(),
            observations: reductions.iter().map(|r| r.observations).sum(),
            square_root_tests: reductions.iter().filter(|r| r.path == Path::SquareRoot).count(),
            designs: reductions.iter().map(|r| r.design).collect::<BTreeSet<u128>>().len(),
        }
    }

    fn numbers(self) -> [f64; Self::LENGTH] {
        [self.tests, self.steps, self.observations, self.square_root_tests, self.designs].map(|n| n as f64)
    }

    fn read(head: [f64; Self::LENGTH]) -> RemoteCounts {
        let [tests, steps, observations, square_root_tests, designs] = head.map(|n| n as usize);
        RemoteCounts { tests, steps, observations, square_root_tests, designs }
    }
}

impl Classes {
    /// Those of tests that are elsewhere, in the coordinates that all of them together suggest.
    pub(super) fn afar(remote: &Remote, (elements, regressors): (Elements, usize), chained: bool) -> Classes {
        let (blocks, sizes) = (elements.blocks().len(), (elements.states(), regressors));
        let told = || {
            let numbers = remote.ask(Question::Survey)?;
            let (head, rest) = numbers.split_first_chunk()?;
            let (present, pooled) = rest.split_at_checked(blocks)?;
            Some((RemoteCounts::read(*head).tests, present.to_vec(), Pooled::of_numbers(sizes, pooled)?))
        };
        let (tests, present, pooled) = told().unwrap_or_else(|| (0, vec![0.0; blocks], Pooled::none(sizes)));
        Classes::of_survey(remote, (tests, present, &pooled), (elements, chained))
    }
}

/// ℓ and its derivatives at a point; NaN where nobody has answered.
pub(super) fn pass(remote: &Remote, frame: &Frame, point: &Point, wanted: Wanted<'_>) -> Sums {
    let list = |matrix: &DMatrix<f64>| matrix.as_slice().to_vec();
    let flat = wanted.flat.map(|flat| Flat {
        free: flat.jacobian.ncols(),
        jacobian: list(flat.jacobian),
        covariance: flat.covariance.map(list),
    });
    let place = Place { mean: point.mean.clone(), coefficients: point.coefficients.clone(), root: list(&point.root) };
    let answer = remote.ask(Question::Pass { frame: frame.told(), place, detail: wanted.order, flat });
    answer.and_then(|numbers| wanted.zero().of_numbers(&numbers)).unwrap_or_else(|| wanted.zero().unknown())
}

/// [`Classes::excess`] of tests that are elsewhere; zero where nobody has answered.
pub(super) fn excess(remote: &Remote, frame: &Frame, mean: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
    let p = mean.len();
    let answer = remote.ask(Question::Excess { frame: frame.told(), mean: mean.as_slice().to_vec() });
    let numbers = answer.filter(|numbers| numbers.len() == 2 * p).unwrap_or_else(|| vec![0.0; 2 * p]);
    (DVector::from_column_slice(&numbers[..p]), DVector::from_column_slice(&numbers[p..]))
}

/// The reductions of one place at one α, ready to be asked for sums over them.
#[derive(Debug)]
pub(crate) struct Summed {
    pub(crate) reductions: Reductions,
    elements: Elements,
    regressors: Vec<usize>,
    /// The classes in the coordinates that were asked for last.
    gathered: Option<(Coordinates, Classes)>,
}

impl Summed {
    pub(crate) fn new(reductions: Reductions, structure: &Structure<'_>) -> Summed {
        let regressors = structure.regressions().iter().map(|r| r.element).collect();
        Summed { reductions, elements: Elements::new(structure.ranges()), regressors, gathered: None }
    }

    /// The answer to a question about μ and Σ; `None` where it is none, or not of this model.
    pub(crate) fn answer(&mut self, question: &Question) -> Option<Answer> {
        let numbers = match question {
            Question::Survey => self.survey(),
            Question::Excess { frame, mean } if self.is_state(mean) => {
                let (excess, weight) = self.classes(frame)?.0.excess(&DVector::from_column_slice(mean));
                excess.iter().chain(weight.iter()).copied().collect()
            }
            Question::Pass { frame, place, detail, flat } => {
                let (point, flat) = (self.point(place)?, flat.as_ref());
                let flat = flat.map_or(Some(None), |flat| self.flat(flat).map(Some))?;
                let flat =
                    flat.as_ref().map(|(jacobian, covariance)| FlatMean { jacobian, covariance: covariance.as_ref() });
                let (classes, regressors) = self.classes(frame)?;
                pass::pass(classes, regressors, &point, *detail, flat.as_ref()).numbers()
            }
            _ => return None,
        };
        Some(numbers.iter().all(|x| x.is_finite()).then_some(numbers))
    }

    /// The classes in these coordinates, with the elements that regressions act on; `None` where the coordinates are not of this model.
    pub(crate) fn classes(&mut self, frame: &Coordinates) -> Option<(&Classes, &Regressors)> {
        let fits = self.is_state(&frame.centre) && self.is_state(&frame.scale);
        if !fits || frame.covariate_scale.len() != self.regressors.len() {
            return None;
        }
        if self.gathered.as_ref().is_none_or(|(known, _)| known != frame) {
            let own = Frame::from_told(frame);
            let classes = Classes::in_frame(&self.reductions, &own, self.elements.clone(), true);
            self.gathered = Some((frame.clone(), classes));
        }
        let (_, classes) = self.gathered.as_ref()?;
        Some((classes, &self.regressors))
    }

    fn survey(&self) -> Vec<f64> {
        let all: Vec<usize> = (0..self.reductions.len()).collect();
        let pooled = Pooled::all(&self.reductions, &all, (self.elements.states(), self.regressors.len()));
        let head = RemoteCounts::here(&self.reductions).numbers();
        let present = present(&self.reductions, &self.elements);
        head.into_iter().chain(present).chain(pooled.numbers()).collect()
    }

    fn is_state(&self, numbers: &[f64]) -> bool {
        numbers.len() == self.elements.states()
    }

    fn point(&self, place: &Place) -> Option<Point> {
        let p = self.elements.states();
        let fits = self.is_state(&place.mean) && place.coefficients.len() == self.regressors.len();
        let root = matrix(p, &place.root).filter(|_| fits)?;
        Some(Point { mean: place.mean.clone(), coefficients: place.coefficients.clone(), root })
    }

    fn flat(&self, flat: &Flat) -> Option<(DMatrix<f64>, Option<DMatrix<f64>>)> {
        let rows = self.elements.states() + self.regressors.len();
        let jacobian = matrix(rows, &flat.jacobian).filter(|jacobian| jacobian.ncols() == flat.free)?;
        let covariance = match &flat.covariance {
            Some(numbers) => Some(matrix(flat.free, numbers).filter(|square| square.is_square())?),
            None => None,
        };
        Some((jacobian, covariance))
    }
}

/// A matrix of so many rows from its columns.
pub(super) fn matrix(rows: usize, numbers: &[f64]) -> Option<DMatrix<f64>> {
    let columns = numbers.len().checked_div(rows).unwrap_or(0);
    (rows * columns == numbers.len()).then(|| DMatrix::from_column_slice(rows, columns, numbers))
}

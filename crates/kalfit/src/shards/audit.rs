//! Whether the answer of a place can come from tests: counts are whole numbers that agree, sums of squares are not
//! negative, and information is positive semidefinite.

use nalgebra::DMatrix;

use kalfit_algebra::symmetric::{self, pair, pairs};
use kalfit_estimate::Structure;
use kalfit_filter::reduce::grouping;
use kalfit_model::remote::Question;
use kalfit_model::{PhasedModel, Slots};
use std::sync::Arc;

/// Largest whole number up to which every whole number is a number of double precision.
const MOST_COUNTED: f64 = 9_007_199_254_740_992.0;
/// Least eigenvalue of a matrix with unit diagonal that is no rounding error of a sum of squares.
const LEAST_EIGENVALUE: f64 = -1e-6;

/// Numbers at the head of a survey: tests, steps, measurements, tests by square roots, designs.
const COUNTS: usize = 5;

/// Sizes of the answers about a model.
#[derive(Debug, Clone, Copy)]
pub struct Audit {
    /// Number of blocks of Σ: phases, or levels and tests.
    blocks: usize,
    /// Number of states of all blocks.
    states: usize,
    /// Number of regressions.
    regressions: usize,
}

impl Audit {
    /// The sizes of the answers about `model`.
    pub fn new(model: &PhasedModel, values: &Slots) -> Option<Audit> {
        let alpha = values.alpha(model.shared(), &vec![0.0; values.len()]);
        let grouping = grouping(model, &[]).ok()?.map(Arc::new);
        let structure = Structure::of(model, &alpha, grouping.as_ref());
        let ranges = structure.ranges();
        let states = ranges.iter().map(ExactSizeIterator::len).sum();
        Some(Audit { blocks: ranges.len(), states, regressions: structure.regressions().len() })
    }

    /// Why the answer of a place with so many tests cannot come from tests; `None` where nothing contradicts that.
    pub fn fault(&self, question: &Question, numbers: &[f64], tests: usize) -> Option<&'static str> {
        if numbers.iter().any(|x| !x.is_finite()) {
            return Some("a sum is no number");
        }
        match question {
            Question::Opening => (!numbers.first().is_some_and(|&n| is_count(n, tests, tests))).then_some(OTHER_TESTS),
            Question::Survey => self.survey(numbers, tests),
            Question::Observability { .. } => {
                let is_whole = numbers.iter().all(|&n| is_count(n, 0, tests));
                (!is_whole).then_some("a number of tests that inform a state is not among those of the tests")
            }
            Question::Excess { .. } => {
                let weights = &numbers[numbers.len() / 2..];
                weights.iter().any(|x| *x < 0.0).then_some("a sum of weights is negative")
            }
            Question::Pass { .. } => self.pass(numbers),
            Question::Score { .. } => None,
        }
    }

    fn survey(&self, numbers: &[f64], tests: usize) -> Option<&'static str> {
        let (p, r) = (self.states, self.regressions);
        if numbers.len() != COUNTS + self.blocks + pairs(p) + 2 * p + 2 * r + 1 {
            return Some(OTHER_MODEL);
        }
        let (head, rest) = numbers.split_at(COUNTS);
        let (present, rest) = rest.split_at(self.blocks);
        let (information, rest) = rest.split_at(pairs(p));
        let (informed, rest) = rest.split_at(p);
        let (sums, rest) = rest[p..].split_at(r);
        let (squares, last) = rest.split_at(r);
        if [head[0], last[0]].iter().any(|&n| !is_count(n, tests, tests)) {
            return Some(OTHER_TESTS);
        }
        if head[1..].iter().any(|&n| !(0.0..=MOST_COUNTED).contains(&n) || n.fract() != 0.0) {
            return Some("a number of rows or measurements is no whole number");
        }
        if present.iter().chain(informed).chain(&head[3..]).any(|&n| !is_count(n, 0, tests)) {
            return Some("a number of tests is not among those of the tests");
        }
        let of_tests = tests as f64;
        if sums.iter().zip(squares).any(|(s, q)| *q < 0.0 || s * s > of_tests * q * (1.0 + 1e-9)) {
            return Some("the mean square of a covariate is less than the square of its mean");
        }
        let matrix = DMatrix::from_fn(p, p, |i, k| information[pair(i.max(k), i.min(k))]);
        if informed.iter().zip(matrix.diagonal().iter()).any(|(n, own)| *n == 0.0 && *own != 0.0) {
            return Some("there is information on a state that no test informs");
        }
        (!is_information(&matrix)).then_some("the information on the states is not positive semidefinite")
    }

    /// Numbers of a pass: ℓ, the quadratic form, the score of the mean, its information, and Σ r r', Σ W.
    fn pass(&self, numbers: &[f64]) -> Option<&'static str> {
        let (p, m) = (self.states, self.states + self.regressions);
        if numbers.len() < 2 + m + m * m + 2 * p * p {
            return Some(OTHER_MODEL);
        }
        if numbers[1] < 0.0 {
            return Some("a sum of squares is negative");
        }
        let square = |from: usize, n: usize| DMatrix::from_column_slice(n, n, &numbers[from..from + n * n]);
        let all = [(2 + m, m), (2 + m + m * m, p), (2 + m + m * m + p * p, p)].map(|(from, n)| square(from, n));
        (!all.iter().all(is_information))
            .then_some("the information on the mean or on the spread is not positive semidefinite")
    }
}

const OTHER_TESTS: &str = "the number of tests in the sums is not that of the file";
const OTHER_MODEL: &str = "there are not as many sums as the model has";

/// Whether a number is a whole number from `least` to `most`.
fn is_count(n: f64, least: usize, most: usize) -> bool {
    n.fract() == 0.0 && n <= MOST_COUNTED && (least as f64..=most as f64).contains(&n)
}

/// Whether a symmetric matrix may be a sum of squares.
fn is_information(matrix: &DMatrix<f64>) -> bool {
    let size: Vec<f64> = matrix.diagonal().iter().map(|x| x.max(0.0).sqrt()).collect();
    let n = matrix.nrows();
    let bounded = |i: usize, k: usize| matrix[(i, k)].abs() <= size[i] * size[k] * (1.0 + 1e-6) + f64::MIN_POSITIVE;
    if matrix.diagonal().iter().any(|x| *x < 0.0) || (0..n).any(|i| (0..i).any(|k| !bounded(i, k))) {
        return false;
    }
    let unit = |i: usize| if size[i] > 0.0 { size[i].recip() } else { 1.0 };
    let scaled = DMatrix::from_fn(n, n, |i, k| 0.5 * (matrix[(i, k)] + matrix[(k, i)]) * unit(i) * unit(k));
    symmetric::eigen(&scaled).0.first().is_none_or(|least| *least >= LEAST_EIGENVALUE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_whole_numbers_of_the_tests() {
        for (n, expected) in [(14.0, true), (13.5, false), (-14.0, false), (1e18, false), (15.0, false), (0.0, true)] {
            assert_eq!(is_count(n, 0, 14), expected, "{n}");
        }
    }

    #[test]
    fn information_is_positive_semidefinite() {
        let matrix = |c: f64| DMatrix::from_row_slice(2, 2, &[4.0, c, c, 1.0]);
        assert!(is_information(&matrix(1.9)) && is_information(&matrix(2.0)) && !is_information(&matrix(2.1)));
        assert!(!is_information(&DMatrix::from_row_slice(1, 1, &[-1e-9])));
        assert!(is_information(&DMatrix::zeros(3, 3)));
    }
}

//! Fisher scoring: the start of the Newton solver.
//!
//! One pass gives the mean by generalised least squares at the present Σ, the score of Σ at *that* mean, and the
//! expected information; the scoring step in Σ is exact when all tests have the same design. No direction of Σ shrinks
//! more than tenfold. With several phases the sums do not determine the score at another mean, so a pass of first order
//! moves the mean beforehand.

use nalgebra::{DMatrix, DVector};

use crate::covariance::{CoordinateForm, PhaseForm};
use crate::local::Objective;
use crate::order::Order;
use crate::point::Point;
use crate::problem::Problem;
use crate::sums::Sums;
use kalfit_algebra::elements::Elements;
use kalfit_algebra::regular::Regular;
use kalfit_algebra::sparse::Sparse;
use kalfit_algebra::symmetric;

/// Largest fraction of Σ that one step may remove in any direction.
const LARGEST_LOSS: f64 = 0.9;

/// The point after generalised least squares for the mean, where there are several phases; else the point itself.
pub(crate) fn with_least_squares_mean(problem: &Problem, point: Point) -> Option<Point> {
    if problem.covariance.elements.is_single() {
        return Some(point);
    }
    let sums = problem.sums(&point, Order::Mean, None)?;
    Some(problem.move_mean(&point, problem.least_squares_step(&sums).as_slice()))
}

/// The next point, and the gain in ℓ that the step promises, from the sums of order
/// [`Expected`](crate::estimate::order::Order::Expected) at a point.
pub(crate) fn step(problem: &Problem, point: &Point, sums: &Sums) -> (Point, f64) {
    let map = &problem.covariance;
    let move_mean = problem.least_squares_step(sums);
    let shift = problem.mean.jacobian() * &move_mean;
    let mut next = problem.move_mean(point, move_mean.as_slice());
    let chart = map.chart(&point.root);
    let free = map.free_directions(&chart);
    let score = match map.elements.is_single() {
        true => sums.score_after(&problem.mean.regressors, &shift),
        false => sums.score(), // the mean has moved already
    };
    let information = || free.congruence_of(sums.expected_information());
    let score = free.transposed_times(&map.elements.pack_score(&score));
    let along = solved(information(), &score)
        .unwrap_or_else(|| relative_solve(&information(), &score, &metric(&chart.root, &free, &map.elements)));
    let promised = 0.5 * (along.dot(&score) + shift.dot(&sums.mean_score));
    let change = map.elements.unpack(&free.times(&along));
    let of = |part: &PhaseForm| {
        let (own, before) = (map.of_part(part), part.of(&point.root));
        match &part.form {
            CoordinateForm::Fixed(_) => before,
            _ => bounded_sum(&part.of(&chart.root), &part.of(&change), own.constraints.is_empty())
                .map_or(before, |sigma| own.root_of(&sigma)),
        }
    };
    next.root = map.block_diagonal(map.parts.iter().map(of));
    (next, promised)
}

/// tr(Σ⁺D Σ⁺E) over the free directions: the size of a change relative to Σ = FF'.
fn metric(root: &DMatrix<f64>, free: &Sparse, elements: &Elements) -> DMatrix<f64> {
    let inverse = symmetric::scaled_inverse(&(root * root.transpose()));
    free.congruence_of(elements.over(|k, l, a, b| inverse[(l, a)] * inverse[(b, k)]))
}

/// The solution of I x = g where it is unique.
fn solved(mut information: DMatrix<f64>, score: &DVector<f64>) -> Option<DVector<f64>> {
    let size = DVector::from_vec(symmetric::sizes(&information));
    for (j, mut column) in information.column_iter_mut().enumerate() {
        column.iter_mut().zip(size.iter()).for_each(|(x, of_row)| *x = *x / of_row / size[j]);
    }
    let root = Regular::within(information)?;
    root.has_no_zero_rows().then(|| root.solve(&score.component_div(&size)).component_div(&size))
}

/// The smallest solution of I x = g in a metric: what the data do not determine changes as little as possible relative
/// to Σ. That preserves the regression of an unobserved state on the observed ones (the paper's §2.3), and so keeps Σ
/// positive.
fn relative_solve(information: &DMatrix<f64>, score: &DVector<f64>, metric: &DMatrix<f64>) -> DVector<f64> {
    let (size, values, vectors) = symmetric::scaled_eigen(metric);
    let floor = values.last().copied().unwrap_or(0.0) * 1e-14;
    let unit = |k: usize| if values[k] > floor { values[k].sqrt().recip() } else { 0.0 };
    let half = DMatrix::from_fn(size.len(), size.len(), |i, k| vectors[(i, k)] * unit(k) / size[i]);
    let relative = half.transpose() * information * &half;
    let right = half.transpose() * score;
    half * symmetric::pseudo_solve(&relative, &right)
}

/// Σ + change, with the change reduced where Σ + change would fall below a tenth of Σ = FF': direction by direction, or
/// as a whole where constraints must be kept.
fn bounded_sum(root: &DMatrix<f64>, change: &DMatrix<f64>, by_direction: bool) -> Option<DMatrix<f64>> {
    let (size, values, vectors) = symmetric::scaled_eigen(&(root * root.transpose()));
    let largest = values.last().copied().filter(|v| *v > 0.0)?;
    // only within the range of Σ, where a relative change is defined; zero rows (fixed variances) stay zero
    let range: Vec<usize> = (0..values.len()).filter(|&k| values[k] > 1e-14 * largest).collect();
    let half =
        DMatrix::from_fn(root.nrows(), range.len(), |i, k| size[i] * vectors[(i, range[k])] * values[range[k]].sqrt());
    let inverse =
        DMatrix::from_fn(range.len(), root.nrows(), |k, i| vectors[(i, range[k])] / values[range[k]].sqrt() / size[i]);
    let relative = &inverse * change * inverse.transpose();
    let (relative, directions) = symmetric::eigen(&relative);
    let worst = relative.first().copied().unwrap_or(0.0);
    let shrinkage = if by_direction || worst > -LARGEST_LOSS { 1.0 } else { LARGEST_LOSS / -worst };
    let factors = relative.iter().map(|m| 1.0 + (shrinkage * m).max(-LARGEST_LOSS));
    let factors = DMatrix::from_diagonal(&DVector::from_iterator(relative.len(), factors));
    let rotated = half * directions;
    Some(&rotated * factors * rotated.transpose())
}

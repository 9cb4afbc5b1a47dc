//! The inputs of a filter run: prior, model without a law of x_0, and the columns constant within a test.

use crate::reduce::error::{ReduceErrorKind, check_shape, finite};
use kalfit_algebra::symmetric::{is_semidefinite, scaled_range};
use kalfit_model::{CovarianceStructure, Expression, Filter, Initial, MeanStructure, Model};
use kalfit_model::{Label, Test};

/// One row with the value of each column that has one value in all rows of the test in which the column is not missing,
/// without measured values and times.
pub(super) fn constants(model: &Model, test: &Test) -> Test {
    let mut row = Test::new(test.id.clone(), model.columns.len(), model.text_columns.len());
    let measured = |column: usize| {
        model.clock.time == Some(column) || model.measurements.iter().any(|meter| meter.column == column)
    };
    let number = |column: usize| {
        let mut cells = (0..test.rows()).map(|row| test.numbers(row)[column]).filter(|cell| !cell.is_nan());
        let first = if measured(column) { None } else { cells.next() };
        first.filter(|first| cells.all(|cell| cell == *first)).unwrap_or(f64::NAN)
    };
    let text = |column: usize| {
        let mut cells = (0..test.rows()).map(|row| test.texts(row)[column]).filter(|cell| !cell.is_missing());
        let first = cells.next();
        first.filter(|first| cells.all(|cell| cell == *first)).unwrap_or(Label::MISSING)
    };
    let numbers: Vec<f64> = (0..model.columns.len()).map(number).collect();
    let texts: Vec<Label> = (0..model.text_columns.len()).map(text).collect();
    row.push(&numbers, &texts, test.source(0));
    row
}

/// The model without the law of x_0: estimates are expressed as functions of the whole x_0.
pub(super) fn without_start(model: &Model) -> Model {
    let mut model = model.clone();
    for state in &mut model.states {
        (state.offset, state.initial) = (None, Initial::Known { mean: zero(), variance: zero() });
    }
    model.estimated.clear();
    (model.mean, model.covariance) = (MeanStructure::free(0), CovarianceStructure::full());
    model
}

fn zero() -> Expression {
    Expression::Number(0.0)
}

/// Checks that the filter's prior is a law of the model's states.
pub(super) fn check(filter: &Filter, model: &Model) -> Result<(), (&'static str, ReduceErrorKind)> {
    let n = model.states.len();
    let (mean, covariance) = ("prior mean of the filter", "prior covariance of the filter");
    check_shape((filter.mean.len(), 1), (n, 1)).map_err(|kind| (mean, kind))?;
    check_shape(filter.covariance.shape(), (n, n)).map_err(|kind| (covariance, kind))?;
    if let Some(&state) = filter.consider.iter().find(|state| **state >= n) {
        let kind = ReduceErrorKind::Shape { found: (state + 1, 1), expected: (n, 1) };
        return Err(("considered state of the filter", kind));
    }
    finite(&filter.mean).map_err(|kind| (mean, kind))?;
    finite(filter.covariance.as_slice()).map_err(|kind| (covariance, kind))?;
    for i in 0..n {
        for j in 0..i {
            let (lower, upper) = (filter.covariance[(i, j)], filter.covariance[(j, i)]);
            if (lower - upper).abs() > 1e-12 * lower.abs().max(upper.abs()) {
                return Err((covariance, ReduceErrorKind::NotSymmetric { upper, lower }));
            }
        }
    }
    let (left, variance) = scaled_range(&filter.covariance);
    if is_semidefinite(&filter.covariance) && filter.covariance.diagonal().iter().all(|x| *x >= 0.0) {
        Ok(())
    } else {
        Err((covariance, ReduceErrorKind::NotSemidefinite { left, variance }))
    }
}

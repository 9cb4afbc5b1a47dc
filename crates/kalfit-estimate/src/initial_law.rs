//! The law of ξ_j at a point of the search (theory §6), and the posteriors of the tests of a unit given all tests of
//! the unit.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::frame::Frame;
use crate::levels::{self, TestPosterior, Units};
use crate::point::{Point, Regressors};
use crate::problem::Problem;
use kalfit_algebra::symmetric;
use kalfit_filter::score::{InitialLaw, JointPosteriors};
use kalfit_model::remote::InGroups;

/// The law of ξ_j at a point whose μ is taken as known.
pub fn law_at(problem: &Problem, point: &Point) -> InitialLaw {
    law_with(problem, point, None)
}

/// The law of ξ_j at a point; `mean_covariance`: the covariance of the free mean coordinates, under the restricted
/// likelihood.
pub(crate) fn law_with(problem: &Problem, point: &Point, mean_covariance: Option<&DMatrix<f64>>) -> InitialLaw {
    let frame = &problem.classes.frame;
    let (all_states, units) = (frame.scale.len(), problem.mean_units());
    let (mean, coefficients) = problem.mean.in_user_units(frame, point);
    // ξ of a test in groups is a sum over the levels
    let levels = problem.classes.units.as_ref().map_or(1, |units| units.levels());
    let p = all_states / levels;
    let whole = mean_covariance.map(|covariance| problem.mean.jacobian() * symmetric::square_root(covariance));
    let of_test = |half: DMatrix<f64>| {
        let sum = |k: usize, c: usize| (0..levels).map(|l| half[(l * p + k, c)]).sum::<f64>();
        let entry = |k: usize, c: usize| if k < p { sum(k, c) } else { half[(k - p + all_states, c)] };
        DMatrix::from_fn(half.nrows() - all_states + p, half.ncols(), entry)
    };
    let in_units = |whole: &DMatrix<f64>| {
        let half = of_test(problem.mean.centring.uncentred(whole));
        DMatrix::from_fn(half.nrows(), half.ncols(), |k, c| {
            units[if k < p { k } else { k - p + all_states }] * half[(k, c)]
        })
    };
    let (half, slots) = (whole.clone().map(of_test), problem.slots());
    let given = |units: &Arc<Units>| match problem.classes.remote {
        Some(_) => JointPosteriors::Elsewhere(InGroups { frame: frame.clone(), place: point.message() }),
        None => joint_posteriors((units, frame), (point, &problem.mean.regressors), half.as_ref()),
    };
    InitialLaw {
        mean: DVector::from_fn(p, |i, _| (0..levels).map(|l| mean[l * p + i]).sum()),
        regression: problem.mean.regressors.iter().copied().zip(coefficients).collect(),
        root: side_by_side(
            p,
            (0..levels).map(|l| {
                let block = |i: usize, c: usize| frame.scale[l * p + i] * point.root[(l * p + i, c)];
                slots.of_states(l, &DMatrix::from_fn(p, point.root.ncols(), block))
            }),
        ),
        mean_half: whole.as_ref().map(in_units),
        given: problem.classes.units.as_ref().map(given).map(Arc::new),
    }
}

/// Matrices of p rows, side by side.
fn side_by_side(p: usize, blocks: impl Iterator<Item = DMatrix<f64>>) -> DMatrix<f64> {
    let blocks: Vec<DMatrix<f64>> = blocks.collect();
    let mut all = DMatrix::zeros(p, blocks.iter().map(DMatrix::ncols).sum());
    let mut first = 0;
    for block in blocks {
        all.columns_mut(first, block.ncols()).copy_from(&block);
        first += block.ncols();
    }
    all
}

/// The law with the posterior of each test given all tests of these units, at a point.
pub(crate) fn within_units(
    law: InitialLaw,
    (units, frame): (&Units, &Frame),
    (point, regressors): (&Point, &Regressors),
) -> InitialLaw {
    InitialLaw { given: Some(Arc::new(joint_posteriors((units, frame), (point, regressors), None))), ..law }
}

/// The posterior of each test given all tests of these units. `half`: a root of the covariance of the mean coordinates
/// of a test, under the restricted likelihood.
fn joint_posteriors(
    (units, frame): (&Units, &Frame),
    (point, regressors): (&Point, &Regressors),
    half: Option<&DMatrix<f64>>,
) -> JointPosteriors {
    let p = units.states;
    let found = levels::posteriors(units, (point, regressors), None, half.is_some());
    let test_posterior = |test: &TestPosterior| {
        if test.mean.is_empty() {
            return (DVector::zeros(0), DMatrix::zeros(0, 0)); // a test that is not among the reductions
        }
        let own = symmetric::square_root(&DMatrix::from_row_slice(p, p, &test.covariance));
        let extra = half.map(|half| DMatrix::from_row_slice(p, half.nrows(), &test.moved) * half);
        let columns = p + extra.as_ref().map_or(0, DMatrix::ncols);
        let entry = |i: usize, c: usize| match (c.checked_sub(p), &extra) {
            (Some(c), Some(extra)) => extra[(i, c)],
            _ => own[(i, c)],
        };
        let mean = (0..p).map(|i| frame.centre[i] + frame.scale[i] * test.mean[i]);
        let root = DMatrix::from_fn(p, columns, |i, c| frame.scale[i] * entry(i, c));
        (DVector::from_iterator(p, mean), root)
    };
    JointPosteriors::Here {
        grouping: units.grouping.clone(),
        tests: found.tests.par_iter().map(test_posterior).collect(),
    }
}

//! Fits to tests that are given by matrices step by step, or by their reductions.

use kalfit_lanes::Isa;
use rayon::prelude::*;

use crate::face::error::EnsembleError;
use crate::face::fit::{Fit, Options};
use crate::face::flow::fit_at_alpha;
use kalfit_estimate::Silent;
use kalfit_filter::reduce::{Plain, Reductions};
use kalfit_model::{Alpha, PhasedModel};

/// Fits μ and Σ to tests given by matrices step by step; [`Model::unknowns`](crate::Model::unknowns) names the unknowns
/// of each test.
///
/// ```
/// use kalfit::reduce::{Plain, StepMatrices};
/// use nalgebra::{DMatrix, DVector};
///
/// // two random constants, start and slope, seen through a line with noise of standard deviation 0.1, in six tests
/// let ends = [(1.0, 2.1), (0.2, 0.3), (1.9, 4.2), (0.8, 0.9), (1.1, 3.0), (0.4, 1.2)];
/// let test = |(j, &(start, end)): (usize, &(f64, f64))| {
///     let steps = [(0.0, start), (5.0, 0.5 * (start + end)), (10.0, end)];
///     let step = |(t, z)| StepMatrices::new(
///         DMatrix::from_row_slice(1, 2, &[1.0, t]), // M, 1 × 2
///         DMatrix::from_element(1, 1, 0.01),        // R, 1 × 1
///         DVector::from_element(1, z),              // z
///     );
///     Plain::constants(format!("test {j}"), steps.map(step))
/// };
/// let tests: Vec<Plain> = ends.iter().enumerate().map(test).collect();
///
/// let fit = kalfit::fit_matrices(&kalfit::Model::unknowns(["start", "slope"])?, &tests)?;
/// assert!(fit.converged());
/// assert!((fit.mean("start")?.estimate - 0.9).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Matrices do not fit together, or are no covariances; a test has another number of unknowns than the model; there are
/// no tests.
pub fn fit_matrices(model: &PhasedModel, tests: &[Plain]) -> Result<Fit, EnsembleError> {
    let reductions: Vec<_> = tests.par_iter().map(Plain::reduce).collect();
    fit_reductions(model, reductions.into_iter().collect::<Result<_, _>>()?, &Options::default())
}

/// Fits μ and Σ to existing reductions, at known parameters.
///
/// # Errors
/// There are free parameters; a reduction has another number of unknowns than the model; there are no reductions.
pub fn fit_reductions(model: &PhasedModel, reductions: Reductions, options: &Options) -> Result<Fit, EnsembleError> {
    Isa::chosen()?;
    let alpha = Alpha::fixed(&model.shared().parameters)?;
    let expected = model.dimension();
    if let Some(other) = reductions.iter().find(|reduction| reduction.data.len() != expected) {
        let (test, found) = (other.test.to_owned(), other.data.len());
        return Err(EnsembleError::Dimension { test, found, expected, names: model.estimated_names() });
    }
    fit_at_alpha((model, &alpha), (reductions, None), options, &mut Silent)
}

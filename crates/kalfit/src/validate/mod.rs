//! How well a model predicts tests that it was not fitted to: fits without each of several folds of tests,
//! each applied to its fold.
//!
//! ```text
//! tests ──> folds ──> (α, μ, Σ) without a fold ──> log p of the fold, innovations, distances
//! ```
//!
//! Leaving out a single test at a known α needs no new fit: [`deletions`](crate::infer::deletions) gives the exact
//! result.

mod error;
mod folds;
mod record;
#[cfg(test)]
mod tests;

pub use error::ValidateError;
pub use folds::{Folds, FoldsError};
pub use record::{
    AgainstRecord, CoverageRecord, FoldRecord, NotComparable, PieceRecord, VALIDATE_SCHEMA, ValidateProvenance,
    ValidatedRecord,
};

use crate::face::{Ensemble, Fit, Options};
use kalfit_apply::apply::Applied;
use kalfit_estimate::{Criterion, Progress, Stop};
use kalfit_filter::innovations::Innovations;
use kalfit_filter::reduce::grouping;
use kalfit_infer::{DeletionChoice, Distance, SharedProgress, TestsChoice, deletions_while};
use kalfit_model::PhasedTest;
use kalfit_model::{Alpha, Level, PhasedModel, Population, Value};

/// Predictions of tests by fits without their fold.
#[derive(Debug, Clone, PartialEq)]
pub struct Validation {
    /// log p of all tests at the fit to all of them.
    pub fitted: f64,
    /// Whether the fit to all tests is certified.
    pub converged: bool,
    /// For each fold, whether the fit without it is certified.
    pub folds: Vec<bool>,
    /// Tests, or groups of the outermost level, that are predicted as a whole and have measured values.
    pub pieces: Vec<Piece>,
    /// Results of each test, in the order of the tests.
    pub tests: Vec<LeftOut>,
}

/// A test, or a group of the outermost level, that is predicted as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// Name of the test or group.
    pub name: String,
    /// Fold of the test or group.
    pub fold: usize,
    /// log p of its measurements at the fit without this fold.
    pub log_density: f64,
    /// Number of its measured values.
    pub observations: usize,
}

/// Results of a test at the fit without its fold.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    /// Number of its innovations within the central interval of each of the probabilities [`LEVELS`].
    pub within: [usize; LEVELS.len()],
    /// Number of its innovations.
    pub innovations: usize,
    /// Distance of its initial state from the population that the other folds give.
    pub distance: Distance,
}

/// Probabilities of the central intervals in which innovations are counted.
pub const LEVELS: [f64; 3] = [0.5, 0.9, 0.95];
/// Half widths of the intervals with probabilities `LEVELS`, in standard deviations.
const HALF_WIDTHS: [f64; 3] = [0.674_489_750_196_082, 1.644_853_626_951_472, 1.959_963_984_540_054];

/// Fits the model without each fold in turn, and applies the fit to that fold.
///
/// # Errors
/// A fit fails, or cannot be applied to its fold; no test has measured values; `progress` stops.
pub fn validate(
    ensemble: &Ensemble,
    folds: &Folds,
    options: &Options,
    progress: &mut dyn Progress,
) -> Result<Validation, ValidateError> {
    let mut options = options.clone();
    options.innovations = false;
    options.choices.deletion = DeletionChoice::None;
    options.choices.tests = TestsChoice::None;
    let whole = ensemble.fit_with(&options, progress)?;
    let fitted = match options.settings.criterion {
        Criterion::Ml => whole.log_likelihood(),
        // the restricted likelihood is not a density of the tests
        Criterion::Reml => {
            let (pieces, _) = applied(ensemble, (&whole.alpha, &whole.population()), ensemble.tests(), 0)?;
            pieces.iter().map(|piece| piece.log_density).sum()
        }
    };
    let mut found = Validation {
        fitted,
        converged: whole.converged(),
        folds: Vec::with_capacity(folds.count()),
        pieces: Vec::new(),
        tests: Vec::new(),
    };
    let mut tests: Vec<Option<LeftOut>> = vec![None; ensemble.tests().len()];
    let model = with_start_values(&whole);
    let populations_without = populations_without(ensemble, &whole, folds, progress);
    for fold in 0..folds.count() {
        if progress.stops() {
            return Err(ValidateError::Interrupted);
        }
        let (inside, others) = folds.split(fold);
        let values = match populations_without.as_ref().and_then(|all| all[inside[0]].clone()) {
            Some(population) => (whole.alpha.clone(), population, true),
            None => fit_without(&model, ensemble, &others, &options, progress)?,
        };
        found.folds.push(values.2);
        let left: Vec<PhasedTest> = inside.iter().map(|&test| ensemble.tests()[test].clone()).collect();
        let (pieces, each) = applied(ensemble, (&values.0, &values.1), &left, fold)?;
        found.pieces.extend(pieces);
        inside.iter().zip(each).for_each(|(&test, one)| tests[test] = Some(one));
    }
    found.pieces.retain(|piece| piece.observations > 0);
    if found.pieces.is_empty() {
        return Err(ValidateError::NothingMeasured);
    }
    found.pieces.sort_by(|a, b| a.name.cmp(&b.name));
    found.tests = tests.into_iter().map(|test| test.expect("every test is in a fold")).collect();
    Ok(found)
}

/// The model with the values of the fit to all tests as start values.
fn with_start_values(whole: &Fit) -> PhasedModel {
    let mut model = whole.model.clone();
    for phase in model.models_mut() {
        for (parameter, level) in phase.parameters.iter_mut().zip(&whole.alpha.values) {
            if let (Value::Free { start }, Level::Common(value)) = (&mut parameter.value, level)
                && (!parameter.positive || *value > 0.0)
            {
                *start = Some(*value);
            }
        }
    }
    model
}

/// The population without each test, where every fold is one test and α is known; `None` otherwise, or once `progress`
/// stops.
fn populations_without(
    ensemble: &Ensemble,
    whole: &Fit,
    folds: &Folds,
    progress: &mut dyn Progress,
) -> Option<Vec<Option<Population>>> {
    let is_known = whole.record.parameters.iter().all(|parameter| parameter.fixed);
    let single = folds.count() == ensemble.tests().len() && ensemble.model().levels.is_empty();
    if !(is_known && single && whole.converged()) {
        return None;
    }
    let found = deletions_while(&whole.estimate, &whole.reductions, &SharedProgress::new(progress, None))?;
    Some(found.into_iter().map(|deletion| Some(deletion?.estimate)).collect())
}

/// α and the population of a fit to some tests, and whether the fit is certified.
fn fit_without(
    model: &PhasedModel,
    ensemble: &Ensemble,
    others: &[usize],
    options: &Options,
    progress: &mut dyn Progress,
) -> Result<(Alpha, Population, bool), ValidateError> {
    let tests = others.iter().map(|&test| ensemble.tests()[test].clone()).collect();
    let fit = Ensemble::of_tests(model, ensemble.labels().clone(), tests).fit_with(options, progress)?;
    if fit.estimate.stop == Stop::Interrupted {
        return Err(ValidateError::Interrupted);
    }
    Ok((fit.alpha.clone(), fit.population(), fit.converged()))
}

/// Predictions of a fit for tests that it was not fitted to.
fn applied(
    ensemble: &Ensemble,
    (alpha, population): (&Alpha, &Population),
    tests: &[PhasedTest],
    fold: usize,
) -> Result<(Vec<Piece>, Vec<LeftOut>), ValidateError> {
    let model = ensemble.model();
    let applied = Applied::new(model, alpha, population, tests)?;
    let (said, observations) = (applied.said()?, applied.observations());
    let left = |(own, posterior): (&Option<Innovations>, kalfit_infer::Posterior<'_>)| {
        let series = own.as_ref().map_or(&[][..], |own| &own.series);
        let within = HALF_WIDTHS.map(|width| series.iter().filter(|one| one.standardised.abs() <= width).count());
        LeftOut { within, innovations: series.len(), distance: posterior.distance }
    };
    let each = said.innovations.iter().zip(said.posteriors.iter()).map(left).collect();
    let grouping = grouping(model, tests)?;
    // where groups cross, a unit is predicted as one at levels that nobody has met
    let outermost = grouping.as_ref().and_then(|grouping| grouping.nested().checked_sub(1));
    let pieces = match (outermost.map(|level| (level, &said.groups[level])), grouping) {
        (Some((level, groups)), Some(grouping)) => {
            let mut seen = vec![0; groups.len()];
            for (test, observations) in tests.iter().zip(&observations) {
                if let Some(number) = grouping.number(&test.id) {
                    seen[grouping.group_of(number, level)] += observations;
                }
            }
            let name = |group: usize| {
                let path = grouping.groups(level)[group].path.iter();
                path.map(|&name| ensemble.labels().text(name)).collect::<Vec<_>>().join("/")
            };
            let piece = |(group, found): (usize, &kalfit_infer::GroupPosterior)| Piece {
                name: name(group),
                fold,
                log_density: found.log_likelihood,
                observations: seen[group],
            };
            groups.iter().enumerate().map(piece).collect()
        }
        _ => {
            let all = tests.iter().zip(said.posteriors.iter()).zip(observations);
            all.map(|((test, found), observations)| Piece {
                name: test.id.to_string(),
                fold,
                log_density: found.log_likelihood,
                observations,
            })
            .collect()
        }
    };
    Ok((pieces, each))
}

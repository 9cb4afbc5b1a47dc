//! How well a model predicts tests that it was not fitted to: fits without each of several folds of tests, applied to that fold.
//!
//! ```text
//! tests ──> folds ──> (α, μ, Σ) without a fold ──> log p of the fold, innovations, distances
//! ```
//!
//! What leaves a single test out at a known α is no new fit: [`deletions`](kalfit_infer::deletions) has it exactly.

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

/// What fits without their fold say of tests.
#[derive(Debug, Clone, PartialEq)]
pub struct Validation {
    /// log p of all tests at the fit to all of them.
    pub fitted: f64,
    /// Whether that fit is certified.
    pub converged: bool,
    /// Of each fold, whether the fit without it is certified.
    pub folds: Vec<bool>,
    /// What is predicted as a whole: tests, or groups of the outermost level, of which anything was measured.
    pub pieces: Vec<Piece>,
    /// Of each test, in their order.
    pub tests: Vec<LeftOut>,
}

/// Tests that are predicted together.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// The test, or the group of the outermost level.
    pub name: String,
    /// Its fold.
    pub fold: usize,
    /// log p of its measurements at the fit without its fold.
    pub log_density: f64,
    /// Its measured values.
    pub observations: usize,
}

/// A test at the fit without its fold.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    /// How many of its innovations are within [`LEVELS`] of what was predicted.
    pub within: [usize; LEVELS.len()],
    /// Number of its innovations.
    pub innovations: usize,
    /// Distance of its initial state from the population of the others.
    pub distance: Distance,
}

/// Probabilities of the intervals that innovations are counted in,
pub const LEVELS: [f64; 3] = [0.5, 0.9, 0.95];
/// and their half widths in standard deviations.
const WIDTHS: [f64; 3] = [0.674_489_750_196_082, 1.644_853_626_951_472, 1.959_963_984_540_054];

/// Fits without each fold in turn, and applies the fit to it.
///
/// # Errors
/// What a fit ends with that cannot be made; a fold that a fit to the others says nothing of.
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
        // the restricted one is no density of the tests
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
    let model = started(&whole);
    let alone = alone(ensemble, &whole, folds, progress);
    for fold in 0..folds.count() {
        if progress.stops() {
            return Err(ValidateError::Interrupted);
        }
        let (inside, others) = folds.split(fold);
        let values = match alone.as_ref().and_then(|all| all[inside[0]].clone()) {
            Some(population) => (whole.alpha.clone(), population, true),
            None => without(&model, ensemble, &others, &options, progress)?,
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

/// The model with the values of the fit to all tests to start from.
fn started(whole: &Fit) -> PhasedModel {
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

/// The population without each test, where every fold is one test and α is known, as long as somebody waits.
fn alone(
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

/// The fit to these tests alone, and whether it is certified.
fn without(
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

/// What a fit says of tests that it was not made from.
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
        let within = WIDTHS.map(|width| series.iter().filter(|one| one.standardised.abs() <= width).count());
        LeftOut { within, innovations: series.len(), distance: posterior.distance }
    };
    let each = said.innovations.iter().zip(said.posteriors.iter()).map(left).collect();
    let pieces = match (said.groups.last(), grouping(model, tests)?) {
        (Some(groups), Some(grouping)) => {
            let level = model.levels.len() - 1;
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

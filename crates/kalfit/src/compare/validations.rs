//! Comparison of the results of `kalfit validate` for several models.

use serde::{Deserialize, Serialize};

use crate::compare::PredictiveDifference;
use crate::compare::data::CompareError;
use crate::validate::{PieceRecord, ValidatedRecord};

/// How well one model predicts folds of tests that it was not fitted to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedValidation {
    /// Name, as given by the user.
    pub name: String,
    /// Title of its model.
    pub title: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// Number of folds.
    pub folds: usize,
    /// Number of tests, or of groups of the outermost level.
    pub pieces: usize,
    /// Number of measured values.
    pub observations: usize,
    /// Sum of the log predictive densities.
    pub log_density: f64,
    /// Standard error of the log density, by the scatter over tests or groups.
    pub std_error: Option<f64>,
    /// The best log density less this one; null where the folds differ from those of the best.
    pub difference: Option<PredictiveDifference>,
    /// Every fit is certified.
    pub converged: bool,
}

/// Compares validations, with notes on those that cannot be compared.
///
/// # Errors
/// A validation that is given twice.
pub(super) fn compare_all(
    all: &[(String, ValidatedRecord)],
    notes: &mut Vec<String>,
) -> Result<Vec<ComparedValidation>, CompareError> {
    for (k, (name, _)) in all.iter().enumerate() {
        if all[..k].iter().any(|(other, _)| other == name) {
            return Err(CompareError::Twice { name: name.clone() });
        }
    }
    let best = all.iter().max_by(|a, b| a.1.log_density.total_cmp(&b.1.log_density));
    let mut compared = Vec::with_capacity(all.len());
    for (name, own) in all {
        let differences = best.and_then(|(_, best)| differences(best, own));
        if let (None, Some((best, _))) = (&differences, best) {
            notes.push(format!(
                "`{name}` and `{best}` did not predict the same values in the same folds, so their difference is not given. Give `kalfit validate` the same data and the same `--folds`, `--seed` or `--by`"
            ));
        }
        compared.push(ComparedValidation {
            name: name.clone(),
            title: own.title.clone(),
            model_digest: own.model_digest.clone(),
            folds: own.folds.len(),
            pieces: own.pieces.len(),
            observations: own.observations,
            log_density: own.log_density,
            std_error: own.std_error,
            difference: differences.as_deref().map(PredictiveDifference::of),
            converged: own.converged && own.folds.iter().all(|fold| fold.converged),
        });
    }
    Ok(compared)
}

/// How much better the best model predicts each test, where both predicted the same values in the same folds.
fn differences(best: &ValidatedRecord, own: &ValidatedRecord) -> Option<Vec<f64>> {
    let (best, own) = (sorted(best), sorted(own));
    let same =
        |a: &PieceRecord, b: &PieceRecord| (&a.name, &a.fold, a.observations) == (&b.name, &b.fold, b.observations);
    let difference = |(a, b): (&&PieceRecord, &&PieceRecord)| same(a, b).then_some(a.log_density - b.log_density);
    if best.len() == own.len() { best.iter().zip(&own).map(difference).collect() } else { None }
}

/// Tests or groups of a validation, sorted by name.
fn sorted(record: &ValidatedRecord) -> Vec<&PieceRecord> {
    let mut pieces: Vec<&PieceRecord> = record.pieces.iter().collect();
    pieces.sort_by(|a, b| a.name.cmp(&b.name));
    pieces
}

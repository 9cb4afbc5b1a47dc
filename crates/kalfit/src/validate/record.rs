//! The record of a validation: how well a model predicts tests that it was not fitted to.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::validate::{Folds, LEVELS, Validation};
use kalfit_model::PhasedModel;

/// Name of the schema of [`ValidatedRecord`].
pub const VALIDATE_SCHEMA: &str = "kalfit-validate/1";

/// Results of a validation: predictions of tests by fits that were made without these tests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ValidatedRecord {
    /// Always `kalfit-validate/1`.
    pub schema: String,
    /// Title of the model.
    pub title: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// Data files, as named by the user.
    pub files: Vec<String>,
    /// The column that defines the folds; null where they were drawn.
    pub by: Option<String>,
    /// Seed of the draw; null where a column defines the folds.
    pub seed: Option<u64>,
    /// The kind of piece that is predicted as a whole: `test`, or the name of the outermost level of groups.
    pub of: String,
    /// Results of each fold.
    pub folds: Vec<FoldRecord>,
    /// Sum of the log predictive densities.
    pub log_density: f64,
    /// Standard error of `log_density`, from the scatter over tests or groups.
    pub std_error: Option<f64>,
    /// Number of measured values.
    pub observations: usize,
    /// Log-likelihood of all tests at the fit to all, to compare with `log_density`.
    pub fitted: f64,
    /// Whether the fit to all tests is certified.
    pub converged: bool,
    /// Fractions of innovations within predicted intervals.
    pub coverage: Vec<CoverageRecord>,
    /// Number of tests whose distance from the population of the other folds is within its 95 % limit.
    pub near: usize,
    /// Number of tests that have a distance.
    pub compared: usize,
    /// Predictions of each test, or of each group of the outermost level.
    pub pieces: Vec<PieceRecord>,
    /// Another model on the same folds; null when there is none.
    pub against: Option<AgainstRecord>,
}

/// Results of one fold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoldRecord {
    /// Name of the fold.
    pub name: String,
    /// Number of tests in the fold.
    pub tests: usize,
    /// Sum of the log predictive densities of its tests.
    pub log_density: f64,
    /// Whether the fit to the other folds is certified.
    pub converged: bool,
}

/// Fraction of the innovations within an interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CoverageRecord {
    /// Probability of the interval.
    pub expected: f64,
    /// Fraction of all innovations that are within the interval.
    pub found: Option<f64>,
    /// Number of innovations.
    pub innovations: usize,
}

/// A test, or a group of the outermost level, that is predicted as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PieceRecord {
    /// Name of the test or group.
    pub name: String,
    /// Name of its fold.
    pub fold: String,
    /// Log predictive density of its measurements.
    pub log_density: f64,
    /// Number of its measured values.
    pub observations: usize,
    /// Log predictive density by the other model; null when there is none.
    pub against: Option<f64>,
}

/// Comparison with another model on the same folds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AgainstRecord {
    /// Title of the other model, or its file.
    pub title: String,
    /// Sum of the log predictive densities of the other model.
    pub log_density: f64,
    /// Log-likelihood of all tests at the other model's fit to all.
    pub fitted: f64,
    /// Advantage of the first model: its sum of log predictive densities minus that of the other model.
    pub difference: f64,
    /// Standard error of the difference, from the scatter over tests or groups.
    pub std_error: Option<f64>,
    /// Two-sided p-value of the difference, by Student's t.
    pub p_value: Option<f64>,
    /// For each fold, whether the other model's fit to the other folds is certified.
    pub converged: Vec<bool>,
}

/// Origin of a validation: model file, data files and folds.
#[derive(Debug, Clone, Default)]
pub struct ValidateProvenance {
    /// SHA-256 of the model file.
    pub model_digest: Option<String>,
    /// Data files, as named by the user.
    pub files: Vec<String>,
    /// The column that defines the folds.
    pub by: Option<String>,
    /// Seed of the draw.
    pub seed: Option<u64>,
}

/// Why two models cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotComparable {
    /// The two models measure different columns.
    #[error("it measures the columns {}, the other model {}", second.join(", "), first.join(", "))]
    Columns {
        /// Columns that the first model measures.
        first: Vec<String>,
        /// Columns that the second model measures.
        second: Vec<String>,
    },
    /// The two models have different tests or groups.
    #[error("{found} is not in both models' data")]
    Names {
        /// Name of a test or group that only one model has.
        found: String,
    },
    /// The two models have different numbers of measured values of a test or group.
    #[error("`{name}` has {first} measured values for the one model and {second} for the other")]
    Observations {
        /// Name of the test or group.
        name: String,
        /// Number of values of the first model.
        first: usize,
        /// Number of values of the second model.
        second: usize,
    },
}

impl ValidatedRecord {
    /// The record of a validation of a model.
    pub fn new(
        model: &PhasedModel,
        folds: &Folds,
        found: &Validation,
        provenance: ValidateProvenance,
    ) -> ValidatedRecord {
        let densities: Vec<f64> = found.pieces.iter().map(|piece| piece.log_density).collect();
        let innovations: usize = found.tests.iter().map(|test| test.innovations).sum();
        let coverage = LEVELS.iter().enumerate().map(|(k, &expected)| {
            let within: usize = found.tests.iter().map(|test| test.within[k]).sum();
            let part = (innovations > 0).then(|| within as f64 / innovations as f64);
            CoverageRecord { expected, found: part, innovations }
        });
        let fold = |k: usize| FoldRecord {
            name: folds.names[k].clone(),
            tests: folds.of.iter().filter(|&&fold| fold == k).count(),
            log_density: found.pieces.iter().filter(|piece| piece.fold == k).map(|piece| piece.log_density).sum(),
            converged: found.folds[k],
        };
        let distances = || found.tests.iter().filter_map(|test| test.distance.p_value);
        ValidatedRecord {
            schema: VALIDATE_SCHEMA.to_owned(),
            title: model.shared().title.clone(),
            model_digest: provenance.model_digest,
            files: provenance.files,
            by: provenance.by,
            seed: provenance.seed,
            of: model.levels.first().map_or("test", |level| level.name.as_str()).to_owned(),
            folds: (0..folds.count()).map(fold).collect(),
            log_density: densities.iter().sum(),
            std_error: std_error_of_sum(&densities),
            observations: found.pieces.iter().map(|piece| piece.observations).sum(),
            fitted: found.fitted,
            converged: found.converged,
            coverage: coverage.collect(),
            near: distances().filter(|p| *p >= 0.05).count(),
            compared: distances().count(),
            pieces: found
                .pieces
                .iter()
                .map(|piece| PieceRecord {
                    name: piece.name.clone(),
                    fold: folds.names[piece.fold].clone(),
                    log_density: piece.log_density,
                    observations: piece.observations,
                    against: None,
                })
                .collect(),
            against: None,
        }
    }

    /// Whether every fit is certified.
    pub fn is_certified(&self) -> bool {
        let mut other_fits = self.against.iter().flat_map(|other| &other.converged);
        self.converged && self.folds.iter().all(|fold| fold.converged) && other_fits.all(|one| *one)
    }

    /// Adds the comparison with another model.
    ///
    /// # Errors
    /// The other validation has other tests, or other numbers of measured values.
    pub fn set_against(&mut self, title: String, other: &Validation) -> Result<(), NotComparable> {
        let of: BTreeMap<&str, (f64, usize)> =
            other.pieces.iter().map(|piece| (piece.name.as_str(), (piece.log_density, piece.observations))).collect();
        let own: BTreeMap<&str, ()> = self.pieces.iter().map(|piece| (piece.name.as_str(), ())).collect();
        if let Some(unmatched) = of.keys().find(|name| !own.contains_key(*name)) {
            return Err(NotComparable::Names { found: format!("`{unmatched}`") });
        }
        let mut differences = Vec::with_capacity(self.pieces.len());
        for piece in &mut self.pieces {
            let &(density, second) = of
                .get(piece.name.as_str())
                .ok_or_else(|| NotComparable::Names { found: format!("`{}`", piece.name) })?;
            if second != piece.observations {
                let (name, first) = (piece.name.clone(), piece.observations);
                return Err(NotComparable::Observations { name, first, second });
            }
            piece.against = Some(density);
            differences.push(piece.log_density - density);
        }
        let difference: f64 = differences.iter().sum();
        let std_error = std_error_of_sum(&differences).filter(|error| *error > 0.0);
        let law = StudentsT::new(0.0, 1.0, (differences.len().max(2) - 1) as f64).ok();
        let p_value = std_error.and_then(|error| Some(2.0 * law?.sf((difference / error).abs())));
        self.against = Some(AgainstRecord {
            title,
            log_density: other.pieces.iter().map(|piece| piece.log_density).sum(),
            fitted: other.fitted,
            difference,
            std_error,
            p_value,
            converged: other.folds.clone(),
        });
        Ok(())
    }
}

/// Standard error of the sum of n values, from their scatter: √n s.
fn std_error_of_sum(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
    (values.len() > 1).then(|| (squares / (n - 1.0) * n).sqrt()).filter(|error| error.is_finite())
}

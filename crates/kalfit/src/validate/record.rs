//! How well a model predicts tests that it was not fitted to.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::validate::{Folds, LEVELS, Validation};
use kalfit_model::PhasedModel;

/// The schema of [`ValidatedRecord`].
pub const VALIDATE_SCHEMA: &str = "kalfit-validate/1";

/// Predictions of tests by fits that were made without them.
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
    /// The column that makes folds; null where they were drawn.
    pub by: Option<String>,
    /// Seed of the draw; null where a column makes them.
    pub seed: Option<u64>,
    /// What is predicted as a whole: `test`, or the outermost level of groups.
    pub of: String,
    /// The folds.
    pub folds: Vec<FoldRecord>,
    /// Sum of the log predictive densities.
    pub log_density: f64,
    /// Its standard error, by the scatter over tests or groups.
    pub std_error: Option<f64>,
    /// Measured values.
    pub observations: usize,
    /// log-likelihood of all at the fit to all: by how much more a fit to the same data promises.
    pub fitted: f64,
    /// Whether that fit is certified.
    pub converged: bool,
    /// Innovations within intervals of what was predicted.
    pub coverage: Vec<CoverageRecord>,
    /// Tests whose distance from the population of the others is within its 95 % limit.
    pub near: usize,
    /// Tests that have a distance.
    pub compared: usize,
    /// Of each test, or of each group of the outermost level.
    pub pieces: Vec<PieceRecord>,
    /// Another model on the same folds; null when there is none.
    pub against: Option<AgainstRecord>,
}

/// One fold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoldRecord {
    /// Its name.
    pub name: String,
    /// Number of its tests.
    pub tests: usize,
    /// Sum of their log predictive densities.
    pub log_density: f64,
    /// Whether the fit to the others is certified.
    pub converged: bool,
}

/// How many innovations are within an interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CoverageRecord {
    /// The probability of the interval.
    pub expected: f64,
    /// The part of all innovations that is within.
    pub found: Option<f64>,
    /// Number of innovations.
    pub innovations: usize,
}

/// What is predicted as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PieceRecord {
    /// The test, or the group.
    pub name: String,
    /// Its fold.
    pub fold: String,
    /// Log predictive density.
    pub log_density: f64,
    /// Measured values.
    pub observations: usize,
    /// The same by the other model; null when there is none.
    pub against: Option<f64>,
}

/// Another model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AgainstRecord {
    /// What it is called: its title, or its file.
    pub title: String,
    /// Sum of its log predictive densities.
    pub log_density: f64,
    /// log-likelihood of all at its fit to all.
    pub fitted: f64,
    /// By how much the first model predicts better: the difference of the sums.
    pub difference: f64,
    /// Its standard error, by the scatter of the differences.
    pub std_error: Option<f64>,
    /// Two-sided, by Student's t.
    pub p_value: Option<f64>,
    /// Of each fold, whether its fit to the others is certified.
    pub converged: Vec<bool>,
}

/// Where the validation came from.
#[derive(Debug, Clone, Default)]
pub struct ValidateProvenance {
    /// SHA-256 of the model file.
    pub model_digest: Option<String>,
    /// Data files, as named by the user.
    pub files: Vec<String>,
    /// The column that makes folds.
    pub by: Option<String>,
    /// Seed of the draw.
    pub seed: Option<u64>,
}

/// Why two models cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotComparable {
    /// Other columns are measured.
    #[error("it measures the columns {}, the other model {}", second.join(", "), first.join(", "))]
    Columns {
        /// By the first model.
        first: Vec<String>,
        /// By the second.
        second: Vec<String>,
    },
    /// Other tests, or other groups.
    #[error("{found} is not in both models' data")]
    Names {
        /// A test, or a group.
        found: String,
    },
    /// Other measured values.
    #[error("`{name}` has {first} measured values for the one model and {second} for the other")]
    Observations {
        /// The test, or the group.
        name: String,
        /// By the first model.
        first: usize,
        /// By the second.
        second: usize,
    },
}

impl ValidatedRecord {
    /// Of a model and what was found.
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
            std_error: of_sum(&densities),
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
        let mut theirs = self.against.iter().flat_map(|other| &other.converged);
        self.converged && self.folds.iter().all(|fold| fold.converged) && theirs.all(|one| *one)
    }

    /// Sets another model beside it.
    ///
    /// # Errors
    /// Other tests, or other numbers of measured values.
    pub fn set_against(&mut self, title: String, other: &Validation) -> Result<(), NotComparable> {
        let of: BTreeMap<&str, (f64, usize)> =
            other.pieces.iter().map(|piece| (piece.name.as_str(), (piece.log_density, piece.observations))).collect();
        let own: BTreeMap<&str, ()> = self.pieces.iter().map(|piece| (piece.name.as_str(), ())).collect();
        if let Some(strange) = of.keys().find(|name| !own.contains_key(*name)) {
            return Err(NotComparable::Names { found: format!("`{strange}`") });
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
        let std_error = of_sum(&differences).filter(|error| *error > 0.0);
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

/// The standard error of a sum over n, by their scatter: √n s.
fn of_sum(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
    (values.len() > 1).then(|| (squares / (n - 1.0) * n).sqrt()).filter(|error| error.is_finite())
}

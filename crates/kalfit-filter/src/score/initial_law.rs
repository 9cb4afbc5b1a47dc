//! The law of ξ_j given α, μ and Σ, as scores, posteriors and predictions use it.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use kalfit_model::Grouping;
use kalfit_model::remote::{InGroups, Law};

/// The law ξ_j ~ N(μ_j, FF') of the initial state of test j, in the user's units; the values of regression columns multiply their
/// coefficients.
#[derive(Debug, Clone)]
pub struct InitialLaw {
    /// μ without regression, p numbers.
    pub mean: DVector<f64>,
    /// (element of μ, coefficient) of each regression column.
    pub regression: Vec<(usize, f64)>,
    /// F with FF' = Σ, p rows.
    pub root: DMatrix<f64>,
    /// A root of the covariance of (μ, coefficients) at a known Σ, under the restricted likelihood.
    pub mean_half: Option<DMatrix<f64>>,
    /// Where tests stand in groups: ξ of each test given all tests of its unit.
    pub given: Option<Arc<JointPosteriors>>,
}

/// The posterior of ξ of every test, where it depends on other tests too.
#[derive(Debug)]
pub enum JointPosteriors {
    /// Of tests that are at hand.
    Here {
        /// The groups that tests stand in.
        grouping: Arc<Grouping>,
        /// x̂ and a root of V of each test, by its number in the grouping; under the restricted likelihood with what the mean adds to V.
        tests: Vec<(DVector<f64>, DMatrix<f64>)>,
    },
    /// Of tests that are elsewhere: what the posterior follows from.
    Elsewhere(InGroups),
}

impl InitialLaw {
    /// A law without regression or groups: μ, and F with FF' = Σ.
    pub fn known(mean: DVector<f64>, root: DMatrix<f64>) -> InitialLaw {
        InitialLaw { mean, regression: Vec::new(), root, mean_half: None, given: None }
    }

    /// The law as a message to tests that are elsewhere.
    pub fn message(&self) -> Law {
        Law {
            mean: self.mean.as_slice().to_vec(),
            regression: self.regression.clone(),
            root: self.root.as_slice().to_vec(),
            mean_half: self.mean_half.as_ref().map(|half| half.as_slice().to_vec()),
            given: match self.given.as_deref() {
                Some(JointPosteriors::Elsewhere(groups)) => Some(groups.clone()),
                _ => None,
            },
        }
    }

    /// The law that a message describes; `None` where the message does not have p states and that many regressions.
    pub fn from_message(law: &Law, (p, regressions): (usize, usize)) -> Option<InitialLaw> {
        let fits = law.mean.len() == p && law.regression.len() == regressions;
        if !fits || law.regression.iter().any(|&(element, _)| element >= p) {
            return None;
        }
        let mean_half = match &law.mean_half {
            Some(half) => Some(by_columns(p + regressions, half)?),
            None => None,
        };
        Some(InitialLaw {
            mean: DVector::from_column_slice(&law.mean),
            regression: law.regression.clone(),
            root: by_columns(p, &law.root)?,
            mean_half,
            given: None,
        })
    }

    /// The posterior of ξ is known of each test, from all tests of its unit.
    pub fn has_posteriors(&self) -> bool {
        self.given.is_some()
    }

    /// x̂ and a root of V of a test, where they depend on other tests too.
    pub fn given(&self, test: &str) -> Option<(&DVector<f64>, &DMatrix<f64>)> {
        let JointPosteriors::Here { grouping, tests } = self.given.as_deref()? else { return None };
        let (mean, root) = &tests[grouping.number(test)?];
        Some((mean, root))
    }

    /// μ_j of a test with these covariates, p numbers.
    pub fn mean_of(&self, covariates: &[f64]) -> DVector<f64> {
        let mut mean = self.mean.clone();
        for (&(element, coefficient), x) in self.regression.iter().zip(covariates) {
            mean[element] += coefficient * x;
        }
        mean
    }

    /// True where μ_j is uncertain: the likelihood is the restricted one.
    pub fn is_restricted(&self) -> bool {
        self.mean_half.is_some()
    }

    /// A root of the covariance of μ_j at a known Σ, under the restricted likelihood.
    pub fn mean_root_of(&self, covariates: &[f64]) -> Option<DMatrix<f64>> {
        let half = self.mean_half.as_ref()?;
        let mut root = half.rows(0, self.mean.len()).into_owned();
        for (c, (&(element, _), x)) in self.regression.iter().zip(covariates).enumerate() {
            let row = root.row(element) + half.row(self.mean.len() + c) * *x;
            root.set_row(element, &row);
        }
        Some(root)
    }
}

/// A matrix of that many rows from its columns; `None` where the numbers do not fill it.
pub fn by_columns(rows: usize, numbers: &[f64]) -> Option<DMatrix<f64>> {
    let columns = numbers.len().checked_div(rows).unwrap_or(0);
    (rows * columns == numbers.len()).then(|| DMatrix::from_column_slice(rows, columns, numbers))
}

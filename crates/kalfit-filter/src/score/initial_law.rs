//! The law of ξ_j given α, μ and Σ, as scores, posteriors and predictions use it.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use kalfit_model::Grouping;
use kalfit_model::remote::{InGroups, Law};

/// The law ξ_j ~ N(μ_j, FF') of the initial state of test j, in the user's units; μ_j is μ plus Σ coefficient × value
/// of a regression column, each term in one element.
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
    /// The posterior of ξ of each test given all tests of the unit, where tests are in groups.
    pub given: Option<Arc<JointPosteriors>>,
}

/// The posteriors of ξ of all tests, where tests are in groups and a posterior depends on other tests too.
#[derive(Debug)]
pub enum JointPosteriors {
    /// The posteriors of tests that are in this place.
    Here {
        /// The groups of the tests.
        grouping: Arc<Grouping>,
        /// x̂ and a root of V of each test, by index of the test in the grouping; under the restricted likelihood, V
        /// includes the uncertainty of the mean.
        tests: Vec<(DVector<f64>, DMatrix<f64>)>,
    },
    /// The numbers from which the posteriors of tests in other places follow.
    Elsewhere(InGroups),
}

impl InitialLaw {
    /// A law without regression or groups: μ, and F with FF' = Σ.
    pub fn known(mean: DVector<f64>, root: DMatrix<f64>) -> InitialLaw {
        InitialLaw { mean, regression: Vec::new(), root, mean_half: None, given: None }
    }

    /// The law as a message to the places that have the tests.
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

    /// The law that a message describes; `None` where the message does not have `p` states and `regressions` regression
    /// columns.
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

    /// Whether the posterior of ξ of each test is known, given all tests of the unit.
    pub fn has_posteriors(&self) -> bool {
        self.given.is_some()
    }

    /// x̂ and a root of V of a test, where the law has the posteriors of tests in this place.
    pub fn given(&self, test: &str) -> Option<(&DVector<f64>, &DMatrix<f64>)> {
        let JointPosteriors::Here { grouping, tests } = self.given.as_deref()? else { return None };
        let (mean, root) = &tests[grouping.number(test)?];
        Some((mean, root))
    }

    /// μ_j of a test with the given covariates, p values.
    pub fn mean_of(&self, covariates: &[f64]) -> DVector<f64> {
        let mut mean = self.mean.clone();
        for (&(element, coefficient), x) in self.regression.iter().zip(covariates) {
            mean[element] += coefficient * x;
        }
        mean
    }

    /// Whether μ_j is uncertain, as under the restricted likelihood.
    pub fn is_restricted(&self) -> bool {
        self.mean_half.is_some()
    }

    /// A root of the covariance of μ_j at a known Σ, p rows, under the restricted likelihood; otherwise `None`.
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

/// The matrix with `rows` rows whose columns are concatenated in `numbers`; `None` where `numbers` does not fill a
/// matrix.
pub fn by_columns(rows: usize, numbers: &[f64]) -> Option<DMatrix<f64>> {
    let columns = numbers.len().checked_div(rows).unwrap_or(0);
    (rows * columns == numbers.len()).then(|| DMatrix::from_column_slice(rows, columns, numbers))
}

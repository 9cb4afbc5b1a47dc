//! What is known of the estimates.

use nalgebra::DMatrix;

use crate::infer::Estimated;

/// One number that was estimated, as a model names it.
#[derive(Debug, Clone, PartialEq)]
pub enum Estimand {
    /// Of μ, of the regression coefficients or of Σ.
    Population(Estimated),
    /// A dynamic parameter.
    Parameter {
        /// Its place in the model.
        parameter: usize,
        /// The text of its level.
        level: Option<String>,
    },
}

/// How far estimates can be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Knowledge {
    /// What was estimated.
    pub quantities: Vec<Estimand>,
    /// Covariance of the estimates.
    pub covariance: DMatrix<f64>,
    /// What the data do not determine.
    pub open: Vec<Estimand>,
    /// Free variances and noise levels whose estimate is zero.
    pub at_zero: Vec<Estimand>,
    /// How many tests, or groups of the outermost level, they are from; infinitely many of values that are given.
    pub tests: f64,
    /// By restricted maximum likelihood: Σ allows for the means that were estimated with it.
    pub is_restricted: bool,
}

impl Knowledge {
    /// Of values that are given: nothing was estimated.
    pub fn exact() -> Knowledge {
        Knowledge {
            quantities: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            open: Vec::new(),
            at_zero: Vec::new(),
            tests: f64::INFINITY,
            is_restricted: true,
        }
    }
}

impl Knowledge {
    /// The same with some numbers known exactly.
    #[must_use]
    pub fn without(&self, is_exact: &dyn Fn(&Estimand) -> bool) -> Knowledge {
        let kept: Vec<usize> = (0..self.quantities.len()).filter(|&i| !is_exact(&self.quantities[i])).collect();
        Knowledge {
            quantities: kept.iter().map(|&i| self.quantities[i].clone()).collect(),
            covariance: self.covariance.select_rows(&kept).select_columns(&kept),
            open: self.open.iter().filter(|known| !is_exact(known)).cloned().collect(),
            at_zero: self.at_zero.iter().filter(|known| !is_exact(known)).cloned().collect(),
            tests: self.tests,
            is_restricted: self.is_restricted,
        }
    }
}

//! What is known of the estimates.

use nalgebra::DMatrix;

use crate::estimated::Estimated;
use kalfit_model::Label;
use kalfit_model::{Alpha, Level, PhasedModel};

/// A step of a free value is this part of its standard error,
const PART: f64 = 1e-3;
/// and at most this part of the value.
pub const MOST: f64 = 1e-3;

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

impl Estimand {
    /// α with this parameter moved a little to both sides, and how far the sides are from each other; `None` of what is no parameter, or does
    /// not move. `error`: its standard error, where there is one.
    pub fn sides(&self, model: &PhasedModel, alpha: &Alpha, error: Option<f64>) -> Option<([Alpha; 2], f64)> {
        let value = *self.value(model, &mut alpha.clone())?;
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let step = error.map_or(MOST * size, |error| (PART * error).min(MOST * size));
        let sides = [value - step, value + step];
        let moved = |side: f64| {
            let mut alpha = alpha.clone();
            if let Some(own) = self.value(model, &mut alpha) {
                *own = side;
            }
            alpha
        };
        (step > 0.0).then(|| (sides.map(moved), sides[1] - sides[0]))
    }

    /// The value of a parameter at its level; `None` of what is no parameter, or where α has no value of its own there.
    pub fn value<'a>(&self, model: &PhasedModel, alpha: &'a mut Alpha) -> Option<&'a mut f64> {
        let Estimand::Parameter { parameter, level } = self else { return None };
        match (alpha.values.get_mut(*parameter)?, level) {
            (Level::Common(value), None) => Some(value),
            (Level::Each { values, .. }, Some(text)) => {
                let literal = model.shared().literals.iter().position(|literal| literal == text)?;
                values.get_mut(&Label::literal(literal))
            }
            (Level::Each { other, .. }, None) => other.as_mut(),
            (Level::Common(_), Some(_)) => None,
        }
    }
}

/// How far estimates can be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Knowledge {
    /// What was estimated.
    pub quantities: Vec<Estimand>,
    /// Covariance of the estimates.
    pub covariance: DMatrix<f64>,
    /// Estimates that the data do not determine.
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

//! Uncertainty of the estimates, by the parameters and states of a model.

use std::borrow::Cow;

use nalgebra::DMatrix;

use crate::estimated::Estimated;
use crate::small_sample::MeanAndVarianceLaw;
use kalfit_model::Label;
use kalfit_model::{Alpha, Level, PhasedModel};

/// Step of a difference by a free value, as a fraction of the standard error.
const STEP_PER_STD_ERROR: f64 = 1e-3;
/// Largest step of a difference by a free value, as a fraction of the value.
pub const MAX_RELATIVE_STEP: f64 = 1e-3;

/// An estimated quantity of a model.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Estimand {
    /// An element of μ, a regression coefficient or an element of Σ.
    Population(Estimated),
    /// A dynamic parameter.
    Parameter {
        /// Index of the parameter in the model.
        parameter: usize,
        /// Text of the level for which the parameter has this value; `None` for a parameter with one value, and for the
        /// value at all other levels.
        level: Option<String>,
    },
}

impl Estimand {
    /// α with the value of this parameter lowered and raised by one step, and the distance of two steps; `None` where
    /// the quantity is no parameter, or the step is zero. `error`: standard error of the value, where known.
    pub fn sides(&self, model: &PhasedModel, alpha: &Alpha, error: Option<f64>) -> Option<([Alpha; 2], f64)> {
        let value = *self.value(model, &mut alpha.clone())?;
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let step =
            error.map_or(MAX_RELATIVE_STEP * size, |error| (STEP_PER_STD_ERROR * error).min(MAX_RELATIVE_STEP * size));
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

    /// Value of a parameter at its level; `None` where the quantity is no parameter, or α has no separate value at the
    /// level.
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

/// Uncertainty of the estimates.
#[derive(Debug, Clone, PartialEq)]
pub struct Knowledge {
    /// The estimated quantities, in the order of the rows of the covariance.
    pub quantities: Vec<Estimand>,
    /// Covariance of the estimates.
    pub covariance: DMatrix<f64>,
    /// Estimates that the data do not determine.
    pub open: Vec<Estimand>,
    /// Free variances and noise levels whose estimate is zero.
    pub at_zero: Vec<Estimand>,
    /// Number of tests, or of groups of the outermost level, that the estimates come from; infinite for given values.
    pub tests: f64,
    /// Whether restricted maximum likelihood was used: Σ then allows for the estimation of the means.
    pub is_restricted: bool,
    /// Laws of the means and of the covariances with few tests, under the restricted likelihood.
    pub few_tests: Option<MeanAndVarianceLaw<Estimand>>,
}

impl Knowledge {
    /// Knowledge of a model with given values, none of which was estimated.
    pub fn exact() -> Knowledge {
        Knowledge {
            quantities: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            open: Vec::new(),
            at_zero: Vec::new(),
            tests: f64::INFINITY,
            is_restricted: true,
            few_tests: None,
        }
    }
}

impl Knowledge {
    /// This knowledge with the quantities that `is_exact` selects treated as known exactly.
    #[must_use]
    pub fn without(&self, is_exact: &dyn Fn(&Estimand) -> bool) -> Knowledge {
        let uncertain_indices: Vec<usize> =
            (0..self.quantities.len()).filter(|&i| !is_exact(&self.quantities[i])).collect();
        Knowledge {
            quantities: uncertain_indices.iter().map(|&i| self.quantities[i].clone()).collect(),
            covariance: self.covariance.select_rows(&uncertain_indices).select_columns(&uncertain_indices),
            open: self.open.iter().filter(|known| !is_exact(known)).cloned().collect(),
            at_zero: self.at_zero.iter().filter(|known| !is_exact(known)).cloned().collect(),
            tests: self.tests,
            is_restricted: self.is_restricted,
            few_tests: self.few_tests.as_ref().map(|law| law.without(is_exact)),
        }
    }

    /// This knowledge with the errors by the laws of few tests where there are such laws: of the means by the method of
    /// degrees of freedom, and of covariances and parameters over all directions that the model leaves free, so that a
    /// variance that is estimated as zero is uncertain, too. Errors of means and of covariances are then uncorrelated.
    pub fn of_few_tests(&self) -> Cow<'_, Knowledge> {
        let Some(law) = &self.few_tests else { return Cow::Borrowed(self) };
        let mean_row = |known: &Estimand| match *known {
            Estimand::Population(Estimated::Mean(i)) if i < law.means => Some(i),
            Estimand::Population(Estimated::Coefficient(c)) => Some(law.means + c),
            _ => None,
        };
        let means = self.quantities.iter().filter(|known| mean_row(known).is_some());
        let quantities: Vec<Estimand> = means.chain(&law.quantities).cloned().collect();
        let (count, of_theta) = (quantities.len(), law.quantities.len());
        let rows: Vec<usize> = quantities.iter().filter_map(mean_row).collect();
        let mut covariance = DMatrix::zeros(count, count);
        let of_means = law.mean_covariance.select_rows(&rows).select_columns(&rows);
        covariance.view_mut((0, 0), of_means.shape()).copy_from(&of_means);
        covariance.view_mut((count - of_theta, count - of_theta), (of_theta, of_theta)).copy_from(&law.covariance);
        let at_zero = self.at_zero.iter().filter(|known| !law.quantities.contains(known)).cloned().collect();
        Cow::Owned(Knowledge { quantities, covariance, at_zero, ..self.clone() })
    }
}

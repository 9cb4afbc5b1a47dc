//! The result of a search.

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::DMatrix;

use crate::certificate::Certificate;
use crate::covariance::CoordinateForm;
use crate::error::FitError;
use crate::evidence::evidence;
use crate::joint_law::JointLaw;
use crate::newton::NewtonIterate;
use crate::order::Order;
use crate::problem::Problem;
use crate::rounding::rounding;
use crate::settings::{Combination, Criterion, Settings, Solver, Stop};
use crate::structure::{OwnedStructure, Structure};
use crate::sums::Sums;
use kalfit_filter::reduce::Reductions;
use kalfit_model::Grouping;
use kalfit_model::Population;

/// The result of a search, in the user's units.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// μ (p).
    pub mean: Vec<f64>,
    /// Regression coefficients, in the order of [`Structure::regressions`].
    pub coefficients: Vec<f64>,
    /// Σ (p × p). Fixed elements have exactly their values.
    pub covariance: DMatrix<f64>,
    /// ℓ, or under [`Criterion::Reml`] the restricted ℓ_R, with every constant included. The value is that of all
    /// phases together, even where another function was maximised.
    pub log_likelihood: f64,
    /// The function that was maximised instead under [`Combination::Marginal`] in several phases: the sum of the
    /// log-densities of the phases' least-squares differences. Standard errors within a phase, the certificate and the
    /// trace belong to that function.
    pub composite: Option<f64>,
    /// The optimality certificate.
    pub certificate: Certificate,
    /// Why the search stopped.
    pub stop: Stop,
    /// ℓ after each accepted step.
    pub trace: Vec<f64>,
    /// Number of passes over the reductions of all tests.
    pub passes: usize,
    /// Number of classes of tests with one information matrix.
    pub classes: usize,
    /// Solver that was used.
    pub solver: Solver,
    /// The criterion that was maximised.
    pub criterion: Criterion,
    /// The input of inference: the problem, the final point in the estimator's coordinates, and the derivatives there.
    pub state: FinalState,
}

impl Estimate {
    /// Adds the log-likelihood of all phases together, where another function was maximised; an error where ℓ is
    /// unbounded.
    pub(super) fn with_joint_likelihood(mut self, reductions: &Reductions) -> Result<Estimate, FitError> {
        let classes = &self.state.problem.classes;
        if self.stop != Stop::Certified
            && let Some(class) = classes.singular_exact_class(&self.state.newton_iterate.point)
        {
            return Err(FitError::Unbounded { test: reductions.id(classes.tests_of(class)[0]).to_owned() });
        }
        if self.state.is_marginal() {
            let (problem, point) = (&self.state.problem, &self.state.newton_iterate.point);
            let whole = Problem::within(reductions, &self.state.structure(), problem)?;
            self.composite = Some(self.log_likelihood);
            self.log_likelihood = whole.likelihood(point, Order::First).value;
        }
        Ok(self)
    }

    /// The groups of the tests, where the model has levels.
    pub fn grouping(&self) -> Option<&Arc<Grouping>> {
        self.state.problem.classes.units.as_ref().map(|units| &units.grouping)
    }

    /// Number of free mean quantities, as declared: elements of μ and regression coefficients.
    pub fn declared_mean(&self) -> usize {
        let mean = &self.state.problem.mean;
        mean.basis.ncols() + mean.regressors.len()
    }

    /// Number of free covariance quantities, as declared.
    pub fn declared_covariance(&self) -> usize {
        self.state.problem.covariance.declared()
    }

    /// β of a phase's Σ = βΣ*; zero for other structures.
    pub fn covariance_scale(&self, phase: usize) -> f64 {
        let part = &self.state.problem.covariance.parts[phase];
        let sigma = self.state.newton_iterate.point.covariance();
        match &part.form {
            CoordinateForm::Scale(star) => {
                part.states.clone().map(|i| sigma[(i, i)]).sum::<f64>() / star.norm_squared()
            }
            _ => 0.0,
        }
    }
}

impl From<&Estimate> for Population {
    fn from(estimate: &Estimate) -> Population {
        Population {
            mean: estimate.mean.clone(),
            coefficients: estimate.coefficients.clone(),
            covariance: estimate.covariance.clone(),
        }
    }
}

/// The end of a search, in the estimator's coordinates.
#[derive(Debug, Clone)]
pub struct FinalState {
    /// The problem whose maximum was sought.
    pub problem: Arc<Problem>,
    /// The last point of the search, with value and derivatives.
    pub newton_iterate: NewtonIterate,
    /// Sums over tests at the last point.
    pub sums: Sums,
    pub(crate) assumed: OwnedStructure,
    /// Settings of the fit.
    pub settings: Settings,
    /// The joint distribution with the dynamic parameters, for standard errors, where these parameters are estimated
    /// too.
    pub joint: Option<JointLaw>,
}

impl FinalState {
    /// The reductions whose likelihood was maximised, from the reductions that the estimate was made from.
    pub fn evidence<'a>(&self, reductions: &'a Reductions) -> Cow<'a, Reductions> {
        evidence(reductions, &self.structure(), &self.settings).expect("the estimate was made from such")
    }

    /// Whether each phase was fitted separately.
    pub fn is_marginal(&self) -> bool {
        let levels = self.problem.classes.units.is_some();
        self.settings.phases == Combination::Marginal && !self.problem.covariance.elements.is_single() && !levels
    }

    /// Bound on the effect of rounding errors for each mean coordinate (elements of μ, then regression coefficients),
    /// in standard errors.
    pub fn rounding(&self) -> Vec<f64> {
        rounding(&self.problem.classes.frame, &self.newton_iterate)
    }

    /// The structure that was assumed.
    pub fn structure(&self) -> Structure<'_> {
        self.assumed.structure()
    }

    /// dΣ, given in the user's units, as a list over the elements of Σ in η.
    pub fn elements_in(&self, derivative: &DMatrix<f64>) -> Vec<f64> {
        let scale = &self.problem.classes.frame.scale;
        let elements = &self.problem.covariance.elements;
        elements.all().map(|(i, j)| derivative[(i, j)] / (scale[i] * scale[j])).collect()
    }
}

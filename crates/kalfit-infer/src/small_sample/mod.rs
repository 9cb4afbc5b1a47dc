//! Inference about means with few tests, under the restricted likelihood: Kenward and Roger's standard errors and
//! degrees of freedom, Satterthwaite's degrees of freedom, and F tests of several combinations (theory §14).
//!
//! ```text
//! I_ab = -½ ∂²(λ + log|M|)/∂θ_a∂θ_b,  V = I⁻¹       expected information about Σ and variances of noise       (14.5)
//! C_A = C + 2 Σ V_ab C(½M_ab - M_aCM_b)C            C = M⁻¹, the covariance of β̂ at known θ                  (14.7)
//! ν = 2c²/(g'Vg),  c = l'Cl,  g_a = -l'CM_aCl       degrees of freedom of l'β̂                                (14.8)
//! ```
//!
//! V allows for what is estimated as zero: it is the inverse over all directions in which the structure lets Σ move, not
//! over those of the rank of Σ̂ alone.

mod assembled;
mod border;
mod differences;
mod each_mean;
mod effects;
mod exported;
mod face;
mod forest;
mod hypothesis;
mod information;
mod level;
mod mean_law;
mod pass;
mod student;
#[cfg(test)]
mod tests;
mod theta;
mod variances;

use nalgebra::{DMatrix, DVector};

use crate::small_sample::exported::UserTheta;
use crate::small_sample::face::Face;
use crate::small_sample::mean_law::MeanLaw;
use kalfit_estimate::{Criterion, Estimate};
use kalfit_filter::reduce::Reductions;
use kalfit_model::Grouping;

use differences::VarianceSlopes;
pub(crate) use differences::slopes;
pub use each_mean::FewTests;
pub use exported::MeanAndVarianceLaw;
pub use student::student_quantile;

/// Number of independent tests or units beyond which the laws of many tests hold.
const MANY_UNITS: usize = 5000;

/// Method of standard errors and degrees of freedom of means under the restricted likelihood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DfMethod {
    /// Standard errors and degrees of freedom by Kenward and Roger (1997), in the form that is linear in the variances.
    KenwardRoger,
    /// Degrees of freedom by Satterthwaite, with the standard errors of generalised least squares.
    Satterthwaite,
}

/// The method that is asked for; only the restricted likelihood has one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DfChoice {
    /// By Kenward and Roger under the restricted likelihood, none under maximum likelihood.
    #[default]
    Auto,
    /// By Kenward and Roger; by Satterthwaite where free parameters are no variances of noise.
    KenwardRoger,
    /// By Satterthwaite.
    Satterthwaite,
    /// None: normal quantiles.
    None,
}

/// Number of groups of the outermost nested level, or of the crossed factor with fewest groups.
fn fewest(grouping: &Grouping) -> usize {
    let outermost = grouping.nested().saturating_sub(1);
    (outermost..grouping.depth()).map(|level| grouping.groups(level).len()).min().unwrap_or(0)
}

/// Why there are no degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoDf {
    /// The search did not end at a certified maximum.
    NotCertified,
    /// The tests are elsewhere: only sums of them are known.
    Remote,
    /// Some tests measure a combination of states exactly.
    Exact,
    /// A standard deviation whose correlations are given is zero.
    ZeroDeviation,
    /// Free parameters move more than variances of noise, and their information is not positive definite.
    Parameters,
    /// There are too many states or parameters for the second derivatives.
    Size,
    /// The computation was stopped.
    Stopped,
    /// Some number was not finite.
    NotFinite,
}

/// A t test of a combination of means, and the interval of the combination.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanTest {
    /// Standard error by the method.
    pub std_error: f64,
    /// Standard error of generalised least squares at the estimated θ.
    pub std_error_plain: f64,
    /// Degrees of freedom; `None` where the covariance of the data is known, so that the law is normal.
    pub df: Option<f64>,
    /// Degrees of freedom among matrices of the rank of the estimated Σ, by Satterthwaite with the observed
    /// information; for comparison with lmerTest.
    pub df_face: Option<f64>,
    /// Value / standard error: t of the hypothesis that the combination is zero.
    pub statistic: f64,
    /// Two-sided p-value of that hypothesis.
    pub p_value: f64,
    /// 95 % interval.
    pub interval: [f64; 2],
}

/// An F test of several combinations of means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointTest {
    /// F, with the scale.
    pub value: f64,
    /// Number of combinations.
    pub df_num: usize,
    /// Degrees of freedom of the denominator; `None` where the covariance of the data is known.
    pub df_den: Option<f64>,
    /// The scale λ of Kenward and Roger: F = λ × Wald statistic / number of combinations.
    pub scale: f64,
    /// P(F at least this large) under the hypothesis.
    pub p_value: f64,
    /// Method of the test.
    pub method: DfMethod,
}

/// Why there is no F test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoJointTest {
    /// Some combination is not identified, or depends on what is not.
    Unidentified,
    /// The combinations depend on each other.
    Dependent,
    /// There are too few tests for a joint test.
    TooFew,
}

/// Small-sample inference at a maximum of the restricted likelihood.
#[derive(Debug, Clone)]
pub struct SmallSample {
    law: MeanLaw,
    face: Option<Face>,
    /// l in free coordinates from weights of (μ, coefficients) in the user's units: q × (p + r).
    from_user: DMatrix<f64>,
    /// Estimates of (μ, coefficients).
    estimates: DVector<f64>,
    /// Number of elements of μ.
    means: usize,
    /// The elements of θ in the user's units.
    user_theta: Vec<UserTheta>,
}

impl SmallSample {
    /// Small-sample inference where α is known; `None` under maximum likelihood, where none was asked for, where no mean is
    /// free, and for more than 5000 independent tests or units, and groups of each crossed factor, to which the laws of
    /// many tests apply.
    pub fn of(estimate: &Estimate, reductions: &Reductions, choice: DfChoice) -> Option<Result<SmallSample, NoDf>> {
        SmallSample::with_parameters(estimate, reductions, choice, &|| Ok(None))
    }

    /// As [`SmallSample::of`]; `noise` gives the derivatives of the tests by free parameters.
    pub(crate) fn with_parameters(
        estimate: &Estimate,
        reductions: &Reductions,
        choice: DfChoice,
        noise: &dyn Fn() -> Result<Option<VarianceSlopes>, NoDf>,
    ) -> Option<Result<SmallSample, NoDf>> {
        if estimate.criterion == Criterion::Ml || choice == DfChoice::None || estimate.declared_mean() == 0 {
            return None;
        }
        if estimate.grouping().map_or(reductions.len(), |grouping| fewest(grouping)) > MANY_UNITS {
            return None;
        }
        Some(assembled::small_sample(estimate, reductions, choice, noise))
    }

    /// Method of the standard errors and degrees of freedom.
    pub fn method(&self) -> DfMethod {
        self.law.method
    }

    /// The t test and interval of weights'(μ, coefficients), in the user's units; `None` where the data do not identify
    /// the combination or the variance of its standard error.
    pub fn row(&self, weights: &DVector<f64>) -> Option<MeanTest> {
        let l = &self.from_user * weights;
        let row = self.law.row(&l, weights.dot(&self.estimates))?;
        Some(MeanTest { df_face: self.face.as_ref().and_then(|face| face.freedom(&self.law, &l)), ..row })
    }

    /// The F test of `weights` × (μ, coefficients) = `values`, one row for each combination, in the user's units.
    ///
    /// # Errors
    /// Why there is no such test.
    pub fn joint(&self, weights: &DMatrix<f64>, values: &DVector<f64>) -> Result<JointTest, NoJointTest> {
        let l = weights * self.from_user.transpose();
        self.law.joint(&l, &(weights * &self.estimates - values))
    }
}

//! Dynamic parameters α (time constants, noise levels, coefficients) together with μ and Σ: ℓ(α) = maximum over (μ, Σ) of the
//! reductions at α, and the filters run again only when α moves (the paper's section 2.4, theory §6).
//!
//! ```text
//! ℓ(α) = max over (μ, Σ) of ℓ(μ, Σ | reductions at α)           the paper's Figure 1
//! dℓ/dα = ∂ℓ/∂α at the best (μ, Σ)                              one backward pass over each test, see score
//! ```

mod balance;
mod bench;
mod coordinates;
mod em;
mod indirect;
mod interval;
mod joint;
mod matrices;
#[cfg(test)]
mod phased_tests;
mod scale;
mod search;
mod settings;
mod start;
#[cfg(test)]
mod tests;
mod worth;

use crate::ensemble::Labels;
use crate::estimate::{Combination, Estimate, FitError, Progress, Stop};
use crate::infer::{Choices, Inference, Interval, IntervalKind};
use crate::model::{Alpha, PhasedModel};
use crate::reduce::{Evidence, PhasedTest, ReduceError, Reduction};
use crate::score::{Slots, dependences};

pub(crate) use bench::Bench;
pub(crate) use coordinates::Coordinate;
pub use settings::{Method, Settings};

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DynamicError {
    /// A test has no reduction, whatever α is tried.
    #[error(transparent)]
    Reduce(#[from] Box<ReduceError>),
    /// μ and Σ cannot be estimated.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Free parameters, and phases put together by their marginals: what would be maximised is no likelihood of α.
    #[error("`{parameter}` is free, and `marginal` is for known parameters: found {free} free values, expected none")]
    Marginal {
        /// The first free parameter.
        parameter: String,
        /// Number of free values.
        free: usize,
    },
    /// A reduction is for one value of each parameter; it cannot follow a free one.
    #[error(
        "test `{test}` comes as a reduction, made at known parameters, but `{parameter}` of phase `{phase}` is free"
    )]
    FixedReduction {
        /// Id of the test.
        test: String,
        /// Name of the phase.
        phase: String,
        /// The first free parameter that the phase depends on.
        parameter: String,
    },
}

impl DynamicError {
    /// What to do about it.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            DynamicError::Reduce(error) => error.hint(),
            DynamicError::Fit(_) => None,
            DynamicError::Marginal { .. } => {
                Some("give every parameter a value, or put the phases together by `chain`")
            }
            DynamicError::FixedReduction { .. } => {
                Some("give the parameter the value that the reduction was made at, or give the data in its place")
            }
        }
    }
}

/// μ, Σ and α at the end of a search.
#[derive(Debug, Clone)]
pub struct DynamicFit {
    /// Every value of α.
    pub alpha: Alpha,
    /// Which of them are free.
    pub slots: Slots,
    /// Their values, in the order of the slots.
    pub values: Vec<f64>,
    /// Reductions at α, in the order of the tests.
    pub reductions: Vec<Reduction>,
    /// μ and Σ at α, with their own certificate.
    pub estimate: Estimate,
    /// Largest score of α in units of its standard error.
    pub certificate: f64,
    /// Why the search for α stopped.
    pub stop: Stop,
    /// How α was found.
    pub method: Method,
    /// ℓ after each accepted step.
    pub trace: Vec<f64>,
    /// Forward runs of the filters over all tests.
    pub filter_passes: usize,
    /// Backward runs over all tests.
    pub score_passes: usize,
    /// Passes over reductions, all of them.
    pub passes: usize,
    /// Where other starts ended, best first.
    pub others: Vec<OtherEnd>,
    /// Observed information of (α, μ, Σ).
    pub(crate) joint: joint::Joint,
    /// Where each free value lies.
    pub(crate) standing: Vec<Standing>,
    /// What was asked.
    pub(crate) settings: Settings,
}

/// Where another start ended.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherEnd {
    /// ℓ there.
    pub log_likelihood: f64,
    /// The free values of α, in the order of the slots.
    pub values: Vec<f64>,
    /// Why the search stopped.
    pub stop: Stop,
}

/// What is known of one free value of α.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterInference {
    /// Standard error; `None` at a bound, and where the data do not determine the value.
    pub std_error: Option<f64>,
    /// 95 % interval.
    pub interval: Interval,
    /// Where the value lies.
    pub standing: Standing,
}

/// Where a free value of α lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Inside.
    Inside,
    /// At its lower bound, or at zero.
    Lower,
    /// At its upper bound.
    Upper,
    /// ℓ still rises, ever more slowly, towards infinity: a time constant far longer than the records.
    Unbounded,
    /// ℓ does not depend on it.
    Unidentified,
}

/// Estimates α, μ and Σ of tests, phases and all. With no free values it is [`estimate::fit`](crate::estimate::fit) on the reductions.
pub fn fit(
    model: &PhasedModel,
    labels: &Labels,
    tests: &[PhasedTest],
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<DynamicFit, DynamicError> {
    let slots = Slots::in_phases(model, labels, tests);
    refuse(model, tests, &slots, settings)?;
    let bench = Bench::new(model, tests, &slots, settings);
    let mut ends = Vec::new();
    let mut first_error = None;
    let mut floor = None;
    for start in start::starts(&bench)? {
        if progress.stops() && !ends.is_empty() {
            break;
        }
        match search::search(&bench, &start, floor, progress) {
            Ok(end) => {
                floor = Some(floor.map_or(end.home.value(), |floor: f64| floor.max(end.home.value())));
                ends.push(end);
            }
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    // the best certified one; of equals the first. What is not certified may be on its way to where ℓ has no bound.
    let certified = |end: &search::End| end.stop == Stop::Certified;
    ends.sort_by(|a, b| certified(b).cmp(&certified(a)).then(b.home.value().total_cmp(&a.home.value())));
    let mut ends = ends.into_iter();
    let Some(best) = ends.next() else {
        return Err(first_error.unwrap_or(DynamicError::Fit(FitError::NoTests)));
    };
    let others = ends.map(|end| OtherEnd { log_likelihood: end.home.value(), values: end.home.values, stop: end.stop });
    let others = others.collect();
    let (filter_passes, score_passes, passes) = (bench.filter_passes(), bench.score_passes(), bench.passes());
    let (alpha, values) = (best.home.alpha.clone(), best.home.values.clone());
    let (reductions, estimate) = bench.grounded(best.home)?;
    Ok(DynamicFit {
        alpha,
        values,
        reductions,
        estimate,
        certificate: best.certificate,
        stop: best.stop,
        method: settings.method,
        trace: best.trace,
        filter_passes,
        score_passes,
        passes,
        others,
        joint: best.joint,
        standing: best.standing,
        settings: settings.clone(),
        slots,
    })
}

/// What has no meaning while parameters are free.
fn refuse(model: &PhasedModel, tests: &[PhasedTest], slots: &Slots, settings: &Settings) -> Result<(), DynamicError> {
    let name = |parameter: usize| model.shared().parameters[parameter].name.clone();
    if let (Some(slot), Combination::Marginal, false) =
        (slots.slots().first(), settings.inner.phases, model.is_single())
    {
        return Err(DynamicError::Marginal { parameter: name(slot.parameter), free: slots.len() });
    }
    for (at, phase) in model.phases.iter().enumerate() {
        let Some(&parameter) = dependences(phase, slots).first() else { continue };
        let reduced = |test: &&PhasedTest| matches!(test.phases.get(at), Some(Evidence::Reduced(_)));
        if let Some(test) = tests.iter().find(reduced) {
            let (test, phase) = (test.id.clone(), phase.name.clone());
            return Err(DynamicError::FixedReduction { test, phase, parameter: name(parameter) });
        }
    }
    Ok(())
}

/// What each number is worth: of μ and Σ with the uncertainty of α in it, and of each free value of α.
pub fn infer(
    model: &PhasedModel,
    tests: &[PhasedTest],
    fit: &DynamicFit,
    choices: Choices,
) -> Result<(Inference, Vec<ParameterInference>), DynamicError> {
    let covariances = fit.joint.covariances();
    let mut estimate = fit.estimate.clone();
    estimate.state.joint = Some(covariances.inner.clone());
    // with α free, those of μ and Σ are Wald's, the uncertainty of α in them
    let wald = Choices { intervals: IntervalKind::Wald, ..choices };
    let inference = crate::infer::infer(&estimate, &fit.reductions, wald);
    let mut parameters = worth::parameters(model.shared(), fit, &covariances);
    if choices.intervals == IntervalKind::Profile && fit.stop == Stop::Certified {
        let bench = Bench::new(model, tests, &fit.slots, &fit.settings);
        interval::profiles(&bench, fit, &covariances, &mut parameters)?;
    }
    Ok((inference, parameters))
}

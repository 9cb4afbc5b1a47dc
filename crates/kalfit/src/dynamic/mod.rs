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
mod edges;
mod em;
mod explore;
mod glide;
mod gradient_function;
mod indirect;
mod interval;
mod joint;
mod law;
mod matrices;
#[cfg(test)]
mod phased_tests;
mod profile;
mod sandwich;
mod scale;
mod search;
mod settings;
mod start;
#[cfg(test)]
mod tests;
mod touching;
mod twins;
mod worth;
mod zero;

use crate::ensemble::Labels;
use crate::estimate::{Combination, Criterion, Estimate, FitError, Progress, Stage, Stop};
use crate::infer::{Choices, Inference, Interval, IntervalKind, StdErrors, sensitivities};
use crate::model::{Alpha, PhasedModel};
use crate::reduce::{Evidence, PhasedTest, ReduceError, Reduction};
use crate::score::{Slots, dependences};

pub(crate) use bench::Bench;
pub(crate) use coordinates::Coordinate;
pub use settings::{Method, Settings};

/// Log-likelihoods that differ by this part are equal.
const ROUNDING: f64 = 1e-11;

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
    /// Expected information of free parameters, which is not worked out.
    #[error(
        "standard errors from the expected information are for models whose parameters are all known, and `{parameter}` is free"
    )]
    Expected {
        /// The first free parameter.
        parameter: String,
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
            DynamicError::Expected { .. } => {
                Some("take those from the observed information, or the sandwich, or give every parameter a value")
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
    /// The same as they are sought.
    pub(crate) sought: Vec<f64>,
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
    /// Other maxima were looked for from the best end.
    pub explored: bool,
    /// Observed information of (α, μ, Σ).
    pub(crate) joint: joint::Joint,
    /// Where each free value lies.
    pub(crate) standing: Vec<Standing>,
    /// What was asked.
    pub(crate) settings: Settings,
}

impl DynamicFit {
    /// Where each free value lies, in the order of the slots.
    pub fn standing(&self) -> &[Standing] {
        &self.standing
    }
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
    /// It was given up where no higher end than the best was in sight.
    pub given_up: bool,
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
    /// A noise level that ℓ would have at zero, where a measurement would be exact: left a little above it.
    Vanishing,
    /// At its upper bound.
    Upper,
    /// A covariance of two noises that is as large as their variances allow.
    Edge,
    /// ℓ still rises, ever more slowly, towards infinity: a time constant far longer than the records.
    Unbounded,
    /// ℓ does not depend on it while some noise level is zero: its time constant, its correlation.
    Idle,
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
    for start in start::starts(&bench, progress)? {
        if progress.stops() && !ends.is_empty() {
            break;
        }
        progress.stage(Stage::Filters { filter_runs: bench.filter_passes() });
        match search::search(&bench, start, floor, progress) {
            Ok(end) => {
                floor = Some(floor.map_or(end.home.value(), |floor: f64| floor.max(end.home.value())));
                ends.push(end);
            }
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    let explored = explore::is_possible(&bench) && !progress.stops();
    if explored {
        explore::explore(&bench, &mut ends, start::all_given(&bench), progress)?;
    }
    let Some(at) = chosen(&ends) else {
        return Err(first_error.unwrap_or(DynamicError::Fit(FitError::NoTests)));
    };
    let best = ends.remove(at);
    ends.sort_by(|a, b| b.home.value().total_cmp(&a.home.value()));
    let other = |end: search::End| OtherEnd {
        log_likelihood: end.home.value(),
        values: bench.values(&twins::aligned(&bench.twins, &end.home.values, &best.home.values)),
        stop: end.stop,
        given_up: end.given_up,
    };
    let others = ends.into_iter().map(other).collect();
    let (filter_passes, score_passes, passes) = (bench.filter_passes(), bench.score_passes(), bench.passes());
    let (alpha, sought) = (best.home.alpha.clone(), best.home.values.clone());
    let values = bench.values(&sought);
    let (reductions, estimate) = bench.grounded(best.home)?;
    Ok(DynamicFit {
        alpha,
        values,
        sought,
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
        explored,
        joint: best.joint,
        standing: on_edges(&bench, best.standing),
        settings: settings.clone(),
        slots,
    })
}

/// Covariances of noises, and levels beside known ones, at a bound of what is sought are at the edge of what they may be.
fn on_edges(bench: &Bench<'_>, standing: Vec<Standing>) -> Vec<Standing> {
    let one = |(s, standing): (usize, Standing)| match standing {
        Standing::Lower | Standing::Upper if bench.edges.has(s) => Standing::Edge,
        Standing::Lower if bench.cone.contains(&s) => Standing::Edge,
        other => other,
    };
    standing.into_iter().enumerate().map(one).collect()
}

/// The best certified end, of equals the first: what is not certified may be on its way to where ℓ has no bound. But no answer
/// lies below the first start.
fn chosen(ends: &[search::End]) -> Option<usize> {
    let highest = |among: &dyn Fn(&search::End) -> bool| {
        let ends = ends.iter().enumerate().filter(|(_, end)| among(end));
        ends.reduce(|a, b| if b.1.home.value() > a.1.home.value() { b } else { a }).map(|(at, _)| at)
    };
    let begun = ends.first()?.trace.first().copied().unwrap_or(f64::NEG_INFINITY);
    let above = |end: &search::End| end.stop == Stop::Certified && end.home.value() >= begun - ROUNDING * begun.abs();
    highest(&above).or_else(|| highest(&|_| true))
}

/// Where [`fit`] begins: a start value of each free value, in the order of [`Slots`], given or worked out from the tests.
///
/// # Errors
/// As [`fit`] has them before its first step.
pub fn start_values(
    model: &PhasedModel,
    labels: &Labels,
    tests: &[PhasedTest],
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<Vec<f64>, DynamicError> {
    let slots = Slots::in_phases(model, labels, tests);
    refuse(model, tests, &slots, settings)?;
    let bench = Bench::new(model, tests, &slots, settings);
    let starts = start::starts(&bench, progress)?;
    starts.first().map(|first| bench.values(&first.values)).ok_or(DynamicError::Fit(FitError::NoTests))
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
    let ml = fit.estimate.criterion == Criterion::Ml;
    if let (StdErrors::Expected, true, Some(slot)) = (choices.std_errors, ml, fit.slots.slots().first()) {
        let parameter = model.shared().parameters[slot.parameter].name.clone();
        return Err(DynamicError::Expected { parameter });
    }
    let bench = Bench::new(model, tests, &fit.slots, &fit.settings);
    let known = (&fit.slots, &bench.coordinates[..]);
    let spread = |mut covariances: joint::Covariances| {
        bench.edges.spread((&fit.sought, &fit.alpha), known, &fit.values, &mut covariances);
        covariances
    };
    let observed = spread(fit.joint.covariances());
    let mut estimate = fit.estimate.clone();
    estimate.state.joint = Some(law::joint(model, fit, &observed));
    // by profiles only once the maximum is certain
    let wald = Choices { intervals: IntervalKind::Wald, ..choices };
    let sandwich = match choices.std_errors {
        StdErrors::Sandwich if ml => Some(spread(sandwich::sandwich(&bench, fit, &observed)?)),
        _ => None,
    };
    let (mut inference, mut parameters) = match &sandwich {
        Some(sandwich) => {
            let mut robust = fit.estimate.clone();
            robust.state.joint = Some(law::joint(model, fit, sandwich));
            let inference = crate::infer::infer(&robust, &fit.reductions, wald);
            // score tests stay those of the observed information
            let inference = Inference { sensitivities: sensitivities(&estimate), ..inference };
            (inference, worth::parameters(model, fit, sandwich))
        }
        None => {
            let inference = crate::infer::infer(&estimate, &fit.reductions, wald);
            (inference, worth::parameters(model, fit, &observed))
        }
    };
    if choices.intervals == IntervalKind::Profile && fit.stop == Stop::Certified {
        interval::profiles(&bench, fit, &observed, &mut parameters)?;
        if fit.estimate.stop == Stop::Certified {
            profile::profiles((&bench, fit), &estimate, &observed, (&mut inference, &parameters));
        }
    }
    Ok((inference, parameters))
}

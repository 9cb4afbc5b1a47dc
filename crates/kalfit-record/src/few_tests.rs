//! Notes on the standard errors and degrees of freedom of means with few tests.

use crate::number::plain;
use kalfit_estimate::Estimate;
use kalfit_infer::{DfMethod, Inference, MeanTest, NoDf};
use kalfit_model::PhasedModel;

/// A standard error so many times the plain one is no sharp figure.
const LARGE_RATIO: f64 = 1.5;
/// Number of significant digits of ratios in notes.
const DIGITS: usize = 2;

/// The method by its name; `None` where standard errors of means are those of many tests.
pub(super) fn method(inference: &Inference) -> Option<&'static str> {
    Some(name(inference.few_tests.as_ref()?.as_ref().ok()?.method))
}

/// The method by its name.
pub(super) fn name(method: DfMethod) -> &'static str {
    match method {
        DfMethod::KenwardRoger => "kenward-roger",
        DfMethod::Satterthwaite => "satterthwaite",
    }
}

/// Notes on means that have no degrees of freedom, and on those whose standard error few tests make large.
pub(super) fn notes(model: &PhasedModel, estimate: &Estimate, inference: &Inference) -> Vec<String> {
    let found = match &inference.few_tests {
        None => return Vec::new(),
        Some(Err(reason)) => {
            return vec![format!(
                "means have no degrees of freedom, and intervals as for many tests: {}",
                words(*reason)
            )];
        }
        Some(Ok(found)) => found,
    };
    let regressions = model.phases.iter().flat_map(|phase| {
        let own = &phase.model;
        own.mean.regression.iter().map(|r| {
            let state = &own.states[own.estimated[r.element]].name;
            format!("the coefficient of `{}` in the mean of `{state}`", own.columns[r.column].name)
        })
    });
    let names = model.element_names().into_iter().map(|name| format!("the mean of `{name}`"));
    let errors = &inference.uncertainty.errors;
    let means = names.take(estimate.mean.len()).zip(&found.mean).zip(&errors.mean);
    let all = means.chain(regressions.zip(&found.coefficients).zip(&errors.coefficients));
    let (mut without, mut notes, mut worst) = (Vec::new(), Vec::new(), None::<(String, &MeanTest, f64)>);
    for ((name, test), error) in all {
        match test {
            None if error.is_some() => without.push(name),
            None => {}
            Some(test) => {
                let ratio = test.std_error / test.std_error_plain;
                if ratio >= LARGE_RATIO && worst.as_ref().is_none_or(|(_, _, largest)| ratio > *largest) {
                    worst = Some((name, test, ratio));
                }
            }
        }
    }
    if !without.is_empty() {
        notes.push(format!(
            "{} without an interval: too few tests for its degrees of freedom, which need an estimate of every variance that moves it",
            without.join(", ")
        ));
    }
    if let Some((name, _, ratio)) = worst {
        notes.push(format!(
            "the standard error of {name} by Kenward and Roger is {} times the plain one: these tests are too unequal for a sharp interval",
            plain(ratio, DIGITS)
        ));
    }
    notes
}

/// Why there are no degrees of freedom.
fn words(reason: NoDf) -> &'static str {
    match reason {
        NoDf::NotCertified => "the search did not end at a certified maximum",
        NoDf::Remote => "only sums over the tests are known",
        NoDf::Exact => "some tests measure a combination of states without noise",
        NoDf::ZeroDeviation => "a standard deviation with given correlations is zero",
        NoDf::Parameters => {
            "free parameters that are no variances of noise, and that are given for each test, filtered by a suboptimal filter, or hardly determined"
        }
        NoDf::Size => "there are too many states or free parameters for second derivatives of all tests",
        NoDf::Stopped => "the computation was stopped",
        NoDf::NotFinite => "some number was not finite",
    }
}

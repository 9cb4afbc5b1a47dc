//! The record of a test of a hypothesis where dynamic parameters are estimated.

use crate::diagnosis::list;
use crate::dynamic::{DynamicParts, converged};
use crate::parameters;
use crate::ratio::{add_doubts, independent, side};
use crate::{PartRecord, RatioProvenance, RatioRecord, SideRecord};
use kalfit_infer::{Bootstrap, BootstrapResult, LikelihoodRatio};
use kalfit_search::{DynamicFit, Standing};

/// The two fits of a test.
#[derive(Debug, Clone, Copy)]
pub struct DynamicSides<'a> {
    /// Fit under the hypothesis.
    pub null: DynamicParts<'a>,
    /// Fit of the model.
    pub alternative: DynamicParts<'a>,
}

impl RatioRecord {
    /// The record of a test of a hypothesis, with α estimated.
    pub fn dynamic(
        sides: &DynamicSides<'_>,
        ratio: &LikelihoodRatio,
        bootstrap: Option<(Bootstrap, &BootstrapResult)>,
        parts: Vec<PartRecord>,
        provenance: RatioProvenance,
    ) -> RatioRecord {
        let both = (dynamic_side(&sides.null), dynamic_side(&sides.alternative));
        let notes = notes(sides, ratio, &both, bootstrap.is_some());
        let reductions = &sides.alternative.fit.reductions;
        RatioRecord::at(reductions, both, ratio, bootstrap, (parts, notes), provenance)
    }
}

impl PartRecord {
    /// The record of one part that was tested alone, with α estimated.
    pub fn dynamic(what: &str, null: &DynamicFit, ratio: &LikelihoodRatio) -> PartRecord {
        PartRecord { converged: converged(null), ..PartRecord::new(what, &null.estimate, ratio) }
    }
}

fn dynamic_side(parts: &DynamicParts<'_>) -> SideRecord {
    let plain = side(parts.model, &parts.fit.estimate);
    SideRecord {
        free_parameters: plain.free_parameters + parts.fit.slots.len(),
        converged: converged(parts.fit),
        parameters: parameters::estimated(parts.model.shared(), parts.labels, parts.fit, parts.parameters),
        ..plain
    }
}

fn notes(
    sides: &DynamicSides<'_>,
    ratio: &LikelihoodRatio,
    (null, alternative): &(SideRecord, SideRecord),
    drawn: bool,
) -> Vec<String> {
    let mut notes = Vec::new();
    let gap = alternative.log_likelihood - null.log_likelihood;
    if gap < -1e-6 * (1.0 + null.log_likelihood.abs()) {
        notes.push(format!(
            "the log-likelihood of the hypothesis is higher by {:.4} than that of the model that contains it: the search for the model ended at a lower maximum",
            -gap
        ));
    }
    let without = without_effect(sides);
    if !without.is_empty() {
        let have = if without.len() == 1 { "has" } else { "have" };
        notes.push(format!(
            "under the hypothesis {} {have} no effect. The large-sample distribution does not hold then, and its p-value tends to be too small; `--bootstrap` does not use it",
            list(without.iter().map(String::as_str), "and")
        ));
    }
    let of = |parts: &DynamicParts<'_>| {
        let estimate = &parts.fit.estimate;
        estimate.declared_mean() + estimate.declared_covariance()
    };
    let DynamicParts { model, fit, .. } = sides.alternative;
    // for values of α alone, χ² becomes accurate with the number of measurements, not of tests
    let by_tests = of(&sides.null) != of(&sides.alternative) || !ratio.law.is_chi_squared();
    let independent = (!drawn && by_tests).then(|| independent(model, &fit.estimate, &fit.reductions));
    add_doubts(&mut notes, ratio, (null, alternative), "quantities", independent);
    notes
}

/// Free parameters that have an effect in the model and none under the hypothesis.
fn without_effect(sides: &DynamicSides<'_>) -> Vec<String> {
    let idle = |parts: &DynamicParts<'_>, index: usize| {
        let mut own = parts.fit.slots.slots().iter().zip(parts.parameters).filter(|(s, _)| s.parameter == index);
        own.any(|(_, found)| found.standing == Standing::Unidentified)
    };
    let names = sides.null.model.shared().parameters.iter().enumerate();
    names
        .filter(|(index, _)| idle(&sides.null, *index) && !idle(&sides.alternative, *index))
        .map(|(_, parameter)| parameter.name.clone())
        .collect()
}

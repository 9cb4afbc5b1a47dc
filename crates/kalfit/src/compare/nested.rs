//! Nested fits, and likelihood-ratio tests of them.
//!
//! A fit is nested in another where both have the same states and equations, what is fixed in the larger fit is fixed
//! at the same value in the smaller one, and every element that is not fixed is free by itself, so that the flags in a
//! record describe the whole structure. Where a record does not show that, no test is made.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::compare::elements::{CovarianceOf, ElementKey, FitElements, elements, equal};
use crate::compare::lines;
use kalfit_record::FitRecord;

/// A fit that is nested in another, with its likelihood-ratio test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NestedRecord {
    /// Index in `fits` of the smaller fit, the hypothesis.
    pub null: usize,
    /// Index in `fits` of the larger fit.
    pub alternative: usize,
    /// -2 log λ = 2 (ℓ of the larger fit - ℓ of the smaller one).
    pub lr: f64,
    /// Number of free quantities that the hypothesis takes away.
    pub df: usize,
    /// Tail probability of `lr` under χ² with `df` degrees of freedom; null where that is not its law.
    pub p_value: Option<f64>,
    /// Kind of `p_value`.
    pub p_value_kind: PValueKind,
    /// Why `p_value` is of this kind, in words; null where it is that of the large-sample law.
    pub reason: Option<String>,
}

/// Kind of a p-value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PValueKind {
    /// The tail probability of the large-sample law.
    LargeSample,
    /// Too large, if anything: the hypothesis is on a boundary.
    UpperBound,
    /// Possibly too large, possibly too small.
    Approximate,
    /// No p-value.
    None,
}

/// Restriction by which a smaller fit differs from a larger one.
#[derive(Debug, Default)]
struct NestedRestriction {
    /// Number of values that are free in the larger fit alone.
    df: usize,
    /// Variances of Σ and parameters that are fixed at an end of their range, in words.
    ends: Vec<String>,
    /// Number of parameters among `ends`.
    parameter_ends: usize,
    /// Number of parameters that are fixed.
    parameters: usize,
}

/// All pairs of nested fits.
pub(super) fn all(fits: &[(String, FitRecord)], notes: &mut Vec<String>) -> Vec<NestedRecord> {
    let own: Vec<FitElements> = fits.iter().map(|(_, fit)| elements(fit)).collect();
    let mut found = Vec::new();
    for null in 0..fits.len() {
        for alternative in (0..fits.len()).filter(|&other| other != null) {
            let (small, large) = (&fits[null].1, &fits[alternative].1);
            let Some(restricted) = restricted((small, &own[null]), (large, &own[alternative])) else { continue };
            let lr = 2.0 * (large.log_likelihood - small.log_likelihood);
            if small.converged && large.converged && lr < -rounding(large) {
                notes.push(format!(
                    "`{}` seems to be nested in `{}` but has the higher log-likelihood, so no test is given",
                    fits[null].0, fits[alternative].0
                ));
                continue;
            }
            found.push(record((null, alternative), lr, (small, large), &restricted));
        }
    }
    found
}

/// Rounding error of twice a difference of log-likelihoods.
fn rounding(fit: &FitRecord) -> f64 {
    1e-6 * (1.0 + 1e-3 * fit.log_likelihood.abs())
}

fn record(
    (null, alternative): (usize, usize),
    lr: f64,
    (small, large): (&FitRecord, &FitRecord),
    restricted: &NestedRestriction,
) -> NestedRecord {
    let (p_value_kind, reason) = law((small, large), restricted);
    let tail = |df: usize| ChiSquared::new(df as f64).ok().map(|law| law.sf(lr.max(0.0)));
    let p_value = tail(restricted.df).filter(|_| p_value_kind != PValueKind::None);
    NestedRecord { null, alternative, lr, df: restricted.df, p_value, p_value_kind, reason }
}

/// Kind of p-value that the tail probability of χ² is, and why.
fn law((small, large): (&FitRecord, &FitRecord), restricted: &NestedRestriction) -> (PValueKind, Option<String>) {
    let none = |reason: &str| (PValueKind::None, Some(reason.to_owned()));
    if !small.converged || !large.converged {
        return none("a fit is not certified");
    }
    if [small, large].into_iter().any(has_unidentified) {
        return none("some free quantities are not identified, so the degrees of freedom are unknown");
    }
    if restricted.parameter_ends > 0 && restricted.parameters > restricted.parameter_ends {
        return none(
            "parameters that have no effect where another one is fixed at an end of its range are fixed too: the law is \
             not known",
        );
    }
    if is_on_boundary(small) {
        let reason = "the smaller fit is itself on a boundary".to_owned();
        return (PValueKind::Approximate, Some(reason));
    }
    match restricted.ends.as_slice() {
        [] => (PValueKind::LargeSample, None),
        ends => {
            let reason = format!("at the end of its range: {}; the p-value is an upper bound", ends.join(", "));
            (PValueKind::UpperBound, Some(reason))
        }
    }
}

fn has_unidentified(fit: &FitRecord) -> bool {
    let idle = |standing: &Option<String>| matches!(standing.as_deref(), Some("unidentified" | "without_effect"));
    fit.phases.iter().any(|phase| !phase.unidentified.is_empty())
        || fit.levels.iter().any(|level| !level.unidentified.is_empty())
        || fit.parameters.iter().any(|parameter| !parameter.fixed && idle(&parameter.standing))
}

fn is_on_boundary(fit: &FitRecord) -> bool {
    fit.phases.iter().any(|phase| !phase.boundary.is_empty())
        || fit.levels.iter().any(|level| !level.boundary.is_empty())
        || fit.parameters.iter().any(|parameter| !parameter.fixed && parameter.at_bound)
}

/// The restriction of the smaller fit; `None` where the records do not show that it is nested in the larger one.
fn restricted(
    (small, own): (&FitRecord, &FitElements),
    (large, others): (&FitRecord, &FitElements),
) -> Option<NestedRestriction> {
    let is_described = |fit: &FitRecord, own: &FitElements| {
        lines::is_freely_structured(fit) && free_quantities(fit, own) == fit.free_parameters
    };
    if !same_states(small, large)
        || !lines::have_same_equations(small, large)
        || !is_described(small, own)
        || !is_described(large, others)
    {
        return None;
    }
    let mut found = NestedRestriction::default();
    let keys = own.keys().chain(others.keys().filter(|key| !own.contains_key(key)));
    for key in keys.filter(|key| !matches!(key, ElementKey::Parameter(..))) {
        // an absent element of these kinds adds nothing: it counts as fixed at zero
        let absent = matches!(key, ElementKey::Regression(..) | ElementKey::Covariance(CovarianceOf::Level(_), ..));
        let of = |all: &FitElements| match all.get(key) {
            Some(standing) => Some((standing.fixed, standing.value)),
            None => absent.then_some((true, 0.0)),
        };
        let (a, b) = (of(own)?, of(others)?);
        match (a.0, b.0) {
            (false, false) => {}
            (true, true) if equal(a.1, b.1) => {}
            (true, false) => {
                found.df += 1;
                if matches!(key, ElementKey::Covariance(_, i, k) if i == k) && a.1 == 0.0 {
                    found.ends.push(super::elements::element_name(key, small.phases.len() > 1));
                }
            }
            _ => return None,
        }
    }
    let mut names: Vec<&String> = small.parameters.iter().chain(&large.parameters).map(|own| &own.name).collect();
    names.sort_unstable();
    names.dedup();
    names.into_iter().try_for_each(|name| parameter(name, (small, large), &mut found))?;
    (found.df > 0 && found.df + small.free_parameters == large.free_parameters).then_some(found)
}

/// Adds all values of a parameter; `None` where the records do not show that those of the smaller fit are nested in
/// those of the larger one.
fn parameter(name: &str, (small, large): (&FitRecord, &FitRecord), found: &mut NestedRestriction) -> Option<()> {
    let of = |fit: &'_ FitRecord| -> Vec<(Option<String>, bool, f64)> {
        let own = fit.parameters.iter().filter(|own| own.name == name);
        own.map(|own| (own.level.clone(), own.fixed, own.estimate)).collect()
    };
    let (a, b) = (of(small), of(large));
    let levels = |all: &[(Option<String>, bool, f64)]| {
        let mut levels: Vec<Option<String>> = all.iter().map(|own| own.0.clone()).collect();
        levels.sort_unstable();
        levels
    };
    if let ([(None, false, _)], [(Some(_), ..), ..]) = (a.as_slice(), b.as_slice()) {
        // one common value in the smaller fit, one value per level in the larger one
        found.df += b.len() - 1;
        return b.iter().all(|own| !own.1).then_some(());
    }
    let common = matches!(a.as_slice(), [(None, true, _)]) && b.iter().all(|own| own.0.is_some()) && !b.is_empty();
    if levels(&a) != levels(&b) && !common {
        return None;
    }
    for (level, fixed, value) in &b {
        let own = if common { &a[0] } else { a.iter().find(|own| own.0 == *level)? };
        match (own.1, *fixed) {
            (false, false) => {}
            (true, true) if equal(own.2, *value) => {}
            (true, false) => {
                found.df += 1;
                found.parameters += 1;
                if lines::is_range_end(large, name, own.2) {
                    found.parameter_ends += 1;
                    found.ends.push(super::elements::element_name(
                        &ElementKey::Parameter(name.to_owned(), level.clone()),
                        false,
                    ));
                }
            }
            _ => return None,
        }
    }
    Some(())
}

/// Number of free quantities, if each element that is not fixed is one of them.
fn free_quantities(fit: &FitRecord, own: &FitElements) -> usize {
    let scaled = fit.phases.iter().any(|phase| phase.mean.scale.is_some() || phase.covariance.scale.is_some());
    match scaled || fit.levels.iter().any(|level| level.covariance.scale.is_some()) {
        true => usize::MAX,
        false => own.values().filter(|standing| !standing.fixed).count(),
    }
}

/// Whether two fits have the same phases with the same estimated states, in any order.
fn same_states(a: &FitRecord, b: &FitRecord) -> bool {
    let of = |fit: &FitRecord| -> Vec<(String, Vec<String>)> {
        let sorted = |states: &[String]| {
            let mut states = states.to_vec();
            states.sort_unstable();
            states
        };
        fit.phases.iter().map(|phase| (phase.name.clone(), sorted(&phase.states))).collect()
    };
    of(a) == of(b)
}

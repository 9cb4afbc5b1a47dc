//! What is free in a fit and what is fixed: elements of μ and Σ, regression coefficients, parameters.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use kalfit_record::{CovarianceRecord, FitRecord};

/// Something that is not free, or fixed at one value, in all fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DifferenceRecord {
    /// `mean[a]`, `covariance[a, b]`, `mean[a] on column`, or the name of a parameter.
    pub element: String,
    /// Standing of the element in each fit; null where a fit does not have it.
    pub standing: Vec<Option<StandingRecord>>,
}

/// Free or fixed, and the value.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StandingRecord {
    /// Whether the element is fixed, not estimated.
    pub fixed: bool,
    /// Value of the element.
    pub value: f64,
}

/// Identifies an element of a fit.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum ElementKey {
    /// Phase and state.
    Mean(String, String),
    /// Phase, state and column.
    Regression(String, String, String),
    /// Phase or level of groups, and two states in the order of their texts.
    Covariance(CovarianceOf, String, String),
    /// Name, and level of the column that the parameter has values by.
    Parameter(String, Option<String>),
}

/// Owner of a covariance Σ.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum CovarianceOf {
    Phase(String),
    Level(String),
}

/// All elements of a fit.
pub(super) type FitElements = BTreeMap<ElementKey, StandingRecord>;

pub(super) fn elements(fit: &FitRecord) -> FitElements {
    let mean = |(key, fixed): (ElementKey, bool)| {
        let value = mean_value(fit, &key);
        (key, StandingRecord { fixed, value })
    };
    let mut all: FitElements = means(fit).into_iter().map(mean).collect();
    for phase in &fit.phases {
        add(&mut all, &CovarianceOf::Phase(phase.name.clone()), &phase.states, &phase.covariance);
    }
    for level in fit.levels.iter().filter(|level| level.column.is_some()) {
        add(&mut all, &CovarianceOf::Level(level.name.clone()), &level.states, &level.covariance);
    }
    for parameter in &fit.parameters {
        let key = ElementKey::Parameter(parameter.name.clone(), parameter.level.clone());
        all.insert(key, StandingRecord { fixed: parameter.fixed, value: parameter.estimate });
    }
    all
}

fn add(all: &mut FitElements, block: &CovarianceOf, states: &[String], covariance: &CovarianceRecord) {
    for (i, (estimates, fixed)) in covariance.estimate.iter().zip(&covariance.fixed).enumerate().take(states.len()) {
        for (k, (&value, &fixed)) in estimates.iter().zip(fixed).enumerate().take(i + 1) {
            let (first, second) = (states[i].clone().min(states[k].clone()), states[i].clone().max(states[k].clone()));
            all.insert(ElementKey::Covariance(block.clone(), first, second), StandingRecord { fixed, value });
        }
    }
}

/// Elements of the means and regression coefficients, and whether they are fixed.
pub(super) fn means(fit: &FitRecord) -> BTreeMap<ElementKey, bool> {
    let mut all = BTreeMap::new();
    for phase in &fit.phases {
        for (state, &fixed) in phase.states.iter().zip(&phase.mean.fixed) {
            all.insert(ElementKey::Mean(phase.name.clone(), state.clone()), fixed);
        }
        for regression in &phase.mean.regression {
            all.insert(
                ElementKey::Regression(phase.name.clone(), regression.state.clone(), regression.column.clone()),
                false,
            );
        }
    }
    all
}

fn mean_value(fit: &FitRecord, key: &ElementKey) -> f64 {
    let phase = |name: &String| fit.phases.iter().find(|phase| phase.name == *name);
    let found = match key {
        ElementKey::Mean(name, state) => phase(name).and_then(|phase| {
            let place = phase.states.iter().position(|own| own == state)?;
            phase.mean.estimate.get(place).copied()
        }),
        ElementKey::Regression(name, state, column) => phase(name).and_then(|phase| {
            let mut all = phase.mean.regression.iter();
            Some(all.find(|own| own.state == *state && own.column == *column)?.estimate)
        }),
        _ => None,
    };
    found.unwrap_or(f64::NAN)
}

/// Name of an element; with its phase where there are several.
pub(super) fn element_name(key: &ElementKey, several: bool) -> String {
    let of = |phase: &str, state: &str| if several { format!("{phase}.{state}") } else { state.to_owned() };
    match key {
        ElementKey::Mean(phase, state) => format!("mean[{}]", of(phase, state)),
        ElementKey::Regression(phase, state, column) => format!("mean[{}] on {column}", of(phase, state)),
        ElementKey::Covariance(CovarianceOf::Phase(phase), a, b) => {
            format!("covariance[{}, {}]", of(phase, a), of(phase, b))
        }
        ElementKey::Covariance(CovarianceOf::Level(level), a, b) => format!("covariance[{level}.{a}, {level}.{b}]"),
        ElementKey::Parameter(name, None) => name.clone(),
        ElementKey::Parameter(name, Some(level)) => format!("{name}[{level}]"),
    }
}

/// Elements whose standing is not the same in all fits.
pub(super) fn differences(fits: &[&FitRecord]) -> Vec<DifferenceRecord> {
    let several = fits.iter().any(|fit| fit.phases.len() > 1);
    let all: Vec<FitElements> = fits.iter().map(|fit| elements(fit)).collect();
    let mut keys: Vec<&ElementKey> = all.iter().flat_map(FitElements::keys).collect();
    keys.sort_unstable();
    keys.dedup();
    let same = |a: &Option<StandingRecord>, b: &Option<StandingRecord>| match (a, b) {
        (Some(a), Some(b)) => a.fixed == b.fixed && (!a.fixed || equal(a.value, b.value)),
        (None, None) => true,
        _ => false,
    };
    let record = |key: &ElementKey| {
        let standing: Vec<Option<StandingRecord>> = all.iter().map(|own| own.get(key).copied()).collect();
        let differs = standing.iter().any(|one| !same(one, &standing[0]));
        differs.then(|| DifferenceRecord { element: element_name(key, several), standing })
    };
    keys.into_iter().filter_map(record).collect()
}

/// Whether two fixed values are equal up to the rounding of a file.
pub(super) fn equal(a: f64, b: f64) -> bool {
    a == b || (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
}

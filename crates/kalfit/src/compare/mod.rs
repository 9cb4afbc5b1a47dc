//! Comparison of fits of the same data, from their records alone: likelihoods, criteria, tests of nested fits where the
//! records show that one is nested in the other, and differences in structure.

mod data;
mod elements;
mod lines;
mod nested;
#[cfg(test)]
mod tests;
mod validations;

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

pub use data::CompareError;
pub use elements::{DifferenceRecord, StandingRecord};
pub use lines::LineRecord;
pub use nested::{NestedRecord, PValueKind};
pub use validations::ComparedValidation;

use crate::validate::ValidatedRecord;
use kalfit_record::{FitRecord, TestRecord};

/// The schema of [`ComparedRecord`].
pub const COMPARE_SCHEMA: &str = "kalfit-compare/1";

/// Comparison of fits of the same data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedRecord {
    /// Always `kalfit-compare/1`.
    pub schema: String,
    /// Version that made it.
    pub kalfit_version: String,
    /// Number of tests, of each fit.
    pub tests: usize,
    /// Scalar measurements, of each fit.
    pub observations: usize,
    /// Whether the log-likelihoods are of the same thing, so that differences mean something.
    pub comparable: bool,
    /// The fits, as they were given.
    pub fits: Vec<ComparedFit>,
    /// Nested fits, by their indices in `fits`.
    pub nested: Vec<NestedRecord>,
    /// Elements of μ and Σ and parameters that are not free, or fixed at one value, in all fits.
    pub differences: Vec<DifferenceRecord>,
    /// Sentences on states and measurements that not all models have.
    pub lines: Vec<LineRecord>,
    /// How well models predict folds of tests that they were not fitted to, where validations were given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub validated: Vec<ComparedValidation>,
    /// Findings in plain words, most important first.
    pub notes: Vec<String>,
}

/// One of the fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedFit {
    /// Name, as given by the user.
    pub name: String,
    /// Title of its model.
    pub title: String,
    /// SHA-256 of the model file, `sha256:…`.
    pub model_digest: Option<String>,
    /// `ml` or `reml`.
    pub criterion: String,
    /// `measurements` or `estimates`.
    pub log_likelihood_kind: String,
    /// log p of all measurements; under `reml` the restricted log-likelihood.
    pub log_likelihood: f64,
    /// Declared free quantities.
    pub free_parameters: usize,
    /// 2k - 2ℓ; null if ℓ is that of estimates, or is not the maximised function.
    pub aic: Option<f64>,
    /// k log(observations) - 2ℓ; null where `aic` is.
    pub bic: Option<f64>,
    /// AIC less the smallest; null where fits are not comparable, and without a certificate.
    pub delta_aic: Option<f64>,
    /// BIC less the smallest; null where `delta_aic` is.
    pub delta_bic: Option<f64>,
    /// exp(-ΔAIC/2) over the sum of these; null where `delta_aic` is.
    pub akaike_weight: Option<f64>,
    /// Sum over tests of the log density of each at μ and Σ of the fit without it; null where a test has none.
    pub log_predictive_density: Option<f64>,
    /// Whether the fit has free parameters, which in `log_predictive_density` have their values from all tests.
    #[serde(default)]
    pub parameters_held: bool,
    /// The largest log predictive density of the fits less this one, and the standard error of the difference over
    /// tests; null where the fits differ in their free parameters.
    pub predictive_difference: Option<PredictiveDifference>,
    /// The optimality certificate holds.
    pub converged: bool,
    /// Why the solver stopped, in words.
    pub reason: String,
}

/// A difference of log predictive densities.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PredictiveDifference {
    /// The best fit's less this one's.
    pub difference: f64,
    /// √N times the standard deviation of the tests' differences; null with one test.
    pub std_error: Option<f64>,
}

impl PredictiveDifference {
    /// Difference from, for each test, the best fit's log predictive density less this fit's.
    fn of(differences: &[f64]) -> PredictiveDifference {
        let (n, sum) = (differences.len() as f64, differences.iter().sum::<f64>());
        let squares: f64 = differences.iter().map(|one| (one - sum / n).powi(2)).sum();
        let std_error = (n > 1.0).then(|| (n * squares / (n - 1.0)).sqrt());
        PredictiveDifference { difference: sum, std_error }
    }
}

/// Compares fits as [`compare`] does, together with results of `kalfit validate`; there may be no fits where there are
/// two validations or more.
///
/// # Errors
/// The errors of [`compare`]; a validation that is given twice.
pub fn compare_with(
    fits: &[(String, FitRecord)],
    validated: &[(String, ValidatedRecord)],
) -> Result<ComparedRecord, CompareError> {
    let mut record = match fits {
        [] if validated.len() > 1 => without_fits(&validated[0].1),
        _ => compare(fits)?,
    };
    record.validated = validations::compare_all(validated, &mut record.notes)?;
    for own in record.validated.iter().filter(|own| own.observations != record.observations) {
        record.notes.push(format!(
            "`{}` is a fit of {} measured values, not of {}: its data are different",
            own.name, own.observations, record.observations
        ));
    }
    Ok(record)
}

/// A record without fits, for a comparison of validations alone.
fn without_fits(validated: &ValidatedRecord) -> ComparedRecord {
    ComparedRecord {
        schema: COMPARE_SCHEMA.to_owned(),
        kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
        tests: validated.folds.iter().map(|fold| fold.tests).sum(),
        observations: validated.observations,
        comparable: false,
        fits: Vec::new(),
        nested: Vec::new(),
        differences: Vec::new(),
        lines: Vec::new(),
        validated: Vec::new(),
        notes: Vec::new(),
    }
}

/// Compares fits, each with the name that the user gave it.
///
/// # Errors
/// Fewer than two fits; a fit that is given twice; fits of different data.
pub fn compare(fits: &[(String, FitRecord)]) -> Result<ComparedRecord, CompareError> {
    data::check(fits)?;
    let (comparable, mut notes) = comparable(fits);
    let records: Vec<&FitRecord> = fits.iter().map(|(_, fit)| fit).collect();
    let mut all: Vec<ComparedFit> = fits.iter().map(fit).collect();
    if comparable {
        rank(&mut all);
    }
    predictive(&mut all, &records);
    notes.extend(all.iter().filter(|fit| !fit.converged).map(|fit| {
        format!("`{}` is not certified: its log-likelihood is only a lower bound of the maximum", fit.name)
    }));
    let nested = if comparable { nested::all(fits, &mut notes) } else { Vec::new() };
    Ok(ComparedRecord {
        schema: COMPARE_SCHEMA.to_owned(),
        kalfit_version: env!("CARGO_PKG_VERSION").to_owned(),
        tests: records[0].data.tests,
        observations: records[0].data.observations,
        comparable,
        fits: all,
        nested,
        differences: elements::differences(&records),
        lines: lines::differences(&records),
        validated: Vec::new(),
        notes,
    })
}

fn fit((name, fit): &(String, FitRecord)) -> ComparedFit {
    ComparedFit {
        name: name.clone(),
        title: fit.title.clone(),
        model_digest: fit.model_digest.clone(),
        criterion: fit.criterion.clone(),
        log_likelihood_kind: fit.log_likelihood_kind.clone(),
        log_likelihood: fit.log_likelihood,
        free_parameters: fit.free_parameters,
        aic: fit.aic,
        bic: fit.bic,
        delta_aic: None,
        delta_bic: None,
        akaike_weight: None,
        log_predictive_density: own_densities(fit).map(|all| all.iter().map(|(_, density)| density).sum()),
        parameters_held: !free_parameters(fit).is_empty(),
        predictive_difference: None,
        converged: fit.converged,
        reason: fit.reason.clone(),
    }
}

/// Whether the log-likelihoods can be compared, and why not.
fn comparable(fits: &[(String, FitRecord)]) -> (bool, Vec<String>) {
    let first = &fits[0].1;
    let differs = |of: &dyn Fn(&FitRecord) -> bool| fits.iter().any(|(_, fit)| of(fit));
    let mut notes = Vec::new();
    if differs(&|fit| fit.log_likelihood_kind != first.log_likelihood_kind) {
        notes.push(
            "Some log-likelihoods are those of measurements, others those of filter estimates: they cannot be compared"
                .to_owned(),
        );
    }
    if differs(&|fit| fit.criterion != first.criterion) {
        notes.push(
            "Some fits maximise the likelihood, others the restricted likelihood (REML): the two cannot be compared"
                .to_owned(),
        );
    } else if first.criterion == "reml" {
        let own = elements::means(first);
        if differs(&|fit| elements::means(fit) != own) {
            notes.push(
                "Restricted likelihoods (REML) do not compare between models whose means differ in structure: fit them \
                 with `--criterion ml`"
                    .to_owned(),
            );
        }
    }
    if notes.is_empty() && first.log_likelihood_kind != "measurements" {
        notes.push(
            "The log-likelihoods are of what filters made of the measurements: they compare only where the filters and \
             all parameters that these believe in are the same"
                .to_owned(),
        );
    }
    if differs(&|fit| fit.composite_log_likelihood.is_some()) {
        notes.push(
            "The log-likelihood of `--phases marginal` is not the maximised function, so it cannot be compared"
                .to_owned(),
        );
    }
    (notes.is_empty(), notes)
}

/// Differences of AIC and BIC, and weights, among certified fits.
fn rank(fits: &mut [ComparedFit]) {
    let least = |of: &dyn Fn(&ComparedFit) -> Option<f64>| {
        fits.iter().filter(|fit| fit.converged).filter_map(of).min_by(f64::total_cmp)
    };
    let (aic, bic) = (least(&|fit| fit.aic), least(&|fit| fit.bic));
    for fit in fits.iter_mut().filter(|fit| fit.converged) {
        fit.delta_aic = fit.aic.zip(aic).map(|(own, least)| own - least);
        fit.delta_bic = fit.bic.zip(bic).map(|(own, least)| own - least);
        fit.akaike_weight = fit.delta_aic.map(|delta| (-0.5 * delta).exp());
    }
    let sum: f64 = fits.iter().filter_map(|fit| fit.akaike_weight).sum();
    fits.iter_mut().for_each(|fit| fit.akaike_weight = fit.akaike_weight.map(|weight| weight / sum));
}

/// (Test, log density of the test at the fit without it), sorted by test; `None` where a test has none.
fn own_densities(fit: &FitRecord) -> Option<Vec<(&str, f64)>> {
    let one = |test: TestRecord<'_>| test.deletion.map(|deletion| deletion.log_density);
    let all: Option<Vec<(&str, f64)>> = fit.tests.iter().map(|test| Some((test.id, one(test)?))).collect();
    let mut all = all.filter(|all| !all.is_empty())?;
    all.sort_by_key(|(id, _)| *id);
    Some(all)
}

/// Name and level of each free parameter.
fn free_parameters(fit: &FitRecord) -> BTreeSet<(&str, Option<&str>)> {
    let free = fit.parameters.iter().filter(|parameter| !parameter.fixed);
    free.map(|parameter| (parameter.name.as_str(), parameter.level.as_deref())).collect()
}

/// Differences of log predictive densities to the best fit; predictive densities can be compared whatever criterion was
/// maximised. A fit without a test keeps the parameters of all tests, so that each free parameter flatters the density
/// of the test: only fits with the same free parameters compare.
fn predictive(fits: &mut [ComparedFit], records: &[&FitRecord]) {
    let first = records[0];
    let is_other = |fit: &&FitRecord| {
        fit.log_likelihood_kind != first.log_likelihood_kind || free_parameters(fit) != free_parameters(first)
    };
    if records.iter().any(is_other) {
        return;
    }
    let all: Vec<Option<Vec<(&str, f64)>>> = records.iter().map(|fit| own_densities(fit)).collect();
    let total = |k: &usize| fits[*k].log_predictive_density;
    let known = (0..fits.len()).filter(|k| total(k).is_some());
    let Some(best) = known.max_by(|a, b| total(a).unwrap_or(0.0).total_cmp(&total(b).unwrap_or(0.0))) else { return };
    let Some(best) = all[best].as_ref() else { return };
    for (fit, own) in fits.iter_mut().zip(&all) {
        let Some(own) = own.as_ref().filter(|own| own.iter().map(|x| x.0).eq(best.iter().map(|x| x.0))) else {
            continue;
        };
        let differences: Vec<f64> = best.iter().zip(own).map(|((_, best), (_, own))| best - own).collect();
        fit.predictive_difference = Some(PredictiveDifference::of(&differences));
    }
}

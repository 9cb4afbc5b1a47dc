//! The record of a fit with free dynamic parameters.

use crate::build;
use crate::diagnosis::{joined, list};
use crate::parameters;
use crate::parameters::{MethodRecord, StartRecord, ZERO_MEANING, meaning};
use crate::{FitRecord, Provenance, SearchRecord};
use kalfit_estimate::{Criterion, Stop};
use kalfit_infer::dynamic::MOST_PROFILED;
use kalfit_infer::{Inference, IntervalKind};
use kalfit_model::Labels;
use kalfit_model::{Expression, Model, Parameter, PhasedModel, State};
use kalfit_search::{DynamicFit, Explored, Method, ParameterInference, Standing};

/// Largest difference of log-likelihoods at which two searches count as equally high.
const EQUAL_HEIGHT: f64 = 1e-4;
/// Largest difference at which two values count as equal, as a fraction of the standard error, or of the value without
/// one.
const EQUAL_VALUE: f64 = 0.05;

/// Number of filter runs above which a note compares EM with the hybrid method.
const MANY_RUNS: usize = 300;
/// Note for ensembles that are too large to search for other maxima.
const NOT_EXPLORED: &str =
    "no other maxima were searched for beyond these starts, because one search takes long; `--starts` adds more starts";
const CUT_SHORT: &str =
    "the search for other maxima used up its filter runs, so there may be a higher one; `--starts` adds more starts";
/// Note for ensembles of many rows.
const ON_A_SAMPLE: &str = "other maxima were searched for on a part of the data, because there are many rows";

/// Note for several free processes; the figure of 1 in 200 fits is from trials with random models.
const SEVERAL_PROCESSES: &str = "several processes are free, and a higher maximum can be missed: in trials with random models about 1 of 200 fits missed one; `--starts` adds more starts";

/// Note for ensembles whose data are elsewhere.
const ONE_SEARCH: &str = "no other maxima were searched for, because a fit by sums makes one search only; `start` in the model begins it elsewhere";

/// Addition to the note on a value that is estimated as zero: how to get an upper limit.
const LIMIT_HINT: &str = "; `--intervals profile` gives the upper limit";

/// Beginning of the reason where ℓ has no maximum, because the data fit the model exactly.
const NO_MAXIMUM: &str = "the log-likelihood has no maximum: it rises without bound as";
/// Part of the reason where a search stopped at its limit of iterations.
const PASS_LIMIT: &str = "reached its limit of iterations";

/// Advice where ℓ has no maximum.
const EXACT_DATA_ADVICE: &str = "noise-free data do not determine a noise level: give it a fixed value or a `lower` bound, or check whether the data were rounded, repeated or made without noise";

/// A fit of α, μ and Σ, and what was inferred from it.
#[derive(Debug, Clone, Copy)]
pub struct DynamicParts<'a> {
    /// The model.
    pub model: &'a PhasedModel,
    /// Texts of the labels in the data.
    pub labels: &'a Labels,
    /// Result of the search.
    pub fit: &'a DynamicFit,
    /// Inference on μ and Σ.
    pub inference: &'a Inference,
    /// Inference on the free values of α, in the order of the slots.
    pub parameters: &'a [ParameterInference],
}

impl FitRecord {
    /// The record of a fit of α, μ and Σ.
    pub fn dynamic(parts: &DynamicParts<'_>, provenance: Provenance) -> FitRecord {
        let &DynamicParts { model, labels, fit, inference, parameters: inferred } = parts;
        let mut parameters = parameters::estimated(model.shared(), labels, fit, inferred);
        if !converged(fit) {
            // without a maximum, the standing of the values is not known
            parameters.iter_mut().for_each(|p| (p.standing, p.note) = (None, None));
        }
        let mut record = FitRecord::at(
            model,
            &fit.reductions,
            &fit.estimate,
            inference,
            (parameters, Some((&fit.slots, labels))),
            provenance,
        );
        let free = record.free_parameters + fit.slots.len();
        let penalty = |per: f64| free as f64 * per - 2.0 * record.log_likelihood;
        record.aic = record.aic.map(|_| penalty(2.0));
        record.bic = record.bic.map(|_| penalty((record.data.observations as f64).ln()));
        record.free_parameters = free;
        record.converged = converged(fit);
        record.reason = reason(fit);
        record.certificate.parameters = if fit.certificate.is_finite() { fit.certificate } else { f64::MAX };
        record.solver.method = name(fit.method).to_owned();
        record.solver.iterations = fit.passes;
        record.solver.filter_passes = fit.filter_passes;
        record.solver.score_passes = fit.score_passes;
        record.solver.trace = fit.trace.clone();
        record.search = SearchRecord::of(parts);
        record.starts = StartRecord::all(fit);
        let mut notes = if record.converged { standing_notes(parts) } else { Vec::new() };
        notes.extend(if fit.unbounded.is_empty() { start_notes(parts) } else { vec![EXACT_DATA_ADVICE.to_owned()] });
        if record.converged && fit.slots.len() > 1 {
            let said = match fit.explored {
                Explored::No if fit.reductions.remote().is_some() => Some(ONE_SEARCH),
                Explored::No => Some(NOT_EXPLORED),
                Explored::Part => Some(CUT_SHORT),
                Explored::Sample => Some(ON_A_SAMPLE),
                Explored::Whole => (processes(parts) > 1).then_some(SEVERAL_PROCESSES),
            };
            notes.extend(said.map(str::to_owned));
        }
        if fit.method == Method::Em && fit.filter_passes > MANY_RUNS {
            let runs = fit.filter_passes;
            notes.push(format!("EM took {runs} runs of the filters here; the hybrid method needs far fewer"));
        }
        notes.append(&mut record.notes);
        notes.extend(restricted_note(parts));
        record.notes = notes;
        record
    }

    /// Whether the fit failed because ℓ has no maximum: the data determine no noise level.
    pub fn has_no_maximum(&self) -> bool {
        !self.converged && self.reason.starts_with(NO_MAXIMUM)
    }

    /// Whether the fit failed because a search reached its limit of iterations.
    pub fn is_at_limit(&self) -> bool {
        !self.converged && self.reason.contains(PASS_LIMIT)
    }

    /// Adds the results of several methods, including the method of this record, and a note on methods that disagree.
    pub fn add_methods(&mut self, methods: Vec<MethodRecord>) {
        let differs = |m: &MethodRecord| (m.log_likelihood - self.log_likelihood).abs() > EQUAL_HEIGHT;
        let differ: Vec<String> = methods
            .iter()
            .filter(|m| m.converged && differs(m))
            .map(|m| format!("`{}` at a log-likelihood of {:.4}", m.method, m.log_likelihood))
            .collect();
        if !differ.is_empty() {
            self.notes.insert(
                0,
                format!(
                    "the methods ended at different maxima: {}, `{}` at {:.4}",
                    differ.join(", "),
                    self.solver.method,
                    self.log_likelihood
                ),
            );
        }
        self.methods = methods;
    }
}

/// Number of states that are driven by noise of a free level, in the phase with most of them.
fn processes(parts: &DynamicParts<'_>) -> usize {
    let is_free = |variance: &Expression| variance.parameters().into_iter().any(|p| parts.fit.slots.is_free(p));
    let is_driven = |state: &&State| state.motion.noise_variance().is_some_and(is_free);
    parts.model.phases.iter().map(|phase| phase.model.states.iter().filter(is_driven).count()).max().unwrap_or(0)
}

impl MethodRecord {
    /// The record of where a method ended.
    pub fn new(fit: &DynamicFit, seconds: f64) -> MethodRecord {
        MethodRecord {
            method: name(fit.method).to_owned(),
            log_likelihood: fit.estimate.log_likelihood,
            converged: converged(fit),
            reason: reason(fit),
            values: fit.values.clone(),
            iterations: fit.passes,
            filter_passes: fit.filter_passes,
            score_passes: fit.score_passes,
            seconds,
        }
    }
}

fn name(method: Method) -> &'static str {
    match method {
        Method::Hybrid => "hybrid",
        Method::Innovations => "innovations",
        Method::Em => "em",
    }
}

pub(super) fn converged(fit: &DynamicFit) -> bool {
    fit.stop == Stop::Certified && fit.estimate.stop == Stop::Certified
}

fn reason(fit: &DynamicFit) -> String {
    let n = fit.slots.len();
    let inner = build::reason(&fit.estimate);
    if n == 0 {
        return inner;
    }
    if !fit.unbounded.is_empty() {
        let named = joined(fit.unbounded.iter().cloned(), "and");
        let go = if fit.unbounded.len() == 1 { "goes to zero" } else { "go to zero together" };
        return format!("{NO_MAXIMUM} {named} {go}, because the data fit the model exactly");
    }
    let (far, what) = (fit.certificate, if n == 1 { "the dynamic parameter" } else { "the dynamic parameters" });
    match (fit.stop, fit.estimate.stop) {
        (Stop::Certified, Stop::Certified) => format!(
            "the optimality conditions hold: mean and covariance are within {:.1e} standard errors of the optimum, {what} within {far:.1e}",
            fit.estimate.certificate.distance()
        ),
        (Stop::Certified, _) => format!("at the values found for {what}: {inner}"),
        (Stop::PassLimit, _) => format!(
            "the search for {what} reached its limit of iterations ({}) with a score of {far:.1e} standard errors",
            fit.passes
        ),
        (Stop::Interrupted, _) => format!(
            "the search for {what} was interrupted after {} filter runs, with a score of {far:.1e} standard errors",
            fit.filter_passes
        ),
        (Stop::Stalled, _) => format!(
            "no step of {what} increases the log-likelihood, but the optimality conditions do not hold (score of {far:.1e} standard errors)"
        ),
    }
}

/// Note on parameters that act as means do, of which the restricted likelihood knows nothing.
fn restricted_note(parts: &DynamicParts<'_>) -> Option<String> {
    if parts.fit.estimate.criterion != Criterion::Reml {
        return None;
    }
    let parameters = &parts.model.shared().parameters;
    let linear = parts.model.with_coefficients_as_states()?.parameters;
    let names = linear.iter().map(|&k| parameters[k].name.as_str());
    let first = &parameters[*linear.first()?].name;
    let [acts, has] = match linear.len() {
        1 => ["which acts on the mean of the data as a parameter", "as a state"],
        _ => ["which act on the mean of the data as parameters", "as states"],
    };
    Some(format!(
        "the restricted likelihood does not allow for the estimation of {}, {acts}: {has}, such as `{first} = {{ random = false }}` in `[states]`, it does, with degrees of freedom",
        list(names, "and")
    ))
}

/// Notes on values at a limit, one sentence for each parameter and limit.
fn standing_notes(parts: &DynamicParts<'_>) -> Vec<String> {
    let mut notes = Vec::new();
    let unlimited = parts.inference.intervals.kind == IntervalKind::Wald && parts.fit.slots.len() <= MOST_PROFILED;
    for (index, parameter) in parts.model.shared().parameters.iter().enumerate() {
        let mut seen: Vec<(&'static str, Vec<String>)> = Vec::new();
        for ((slot, value), found) in parts.fit.slots.slots().iter().zip(&parts.fit.values).zip(parts.parameters) {
            let Some(meaning) = meaning(found.standing, *value).filter(|_| slot.parameter == index) else { continue };
            if found.standing == Standing::Idle {
                continue; // has a separate sentence
            }
            let level = slot.level.map_or(String::new(), |level| parts.labels.text(level).to_owned());
            match seen.iter_mut().find(|(known, _)| *known == meaning) {
                Some((_, levels)) => levels.push(level),
                None => seen.push((meaning, vec![level])),
            }
        }
        let sentence = |(meaning, levels): &(&str, Vec<String>)| {
            let how = if unlimited && *meaning == ZERO_MEANING { LIMIT_HINT } else { "" };
            format!("{} is {meaning}{how}", parameter_phrase(parts.model.shared(), parameter, levels))
        };
        notes.extend(seen.iter().map(sentence));
        notes.extend(idle_note(parts, index));
    }
    notes
}

/// Note on a parameter without effect, with the parameters that are zero.
fn idle_note(parts: &DynamicParts<'_>, index: usize) -> Option<String> {
    let is = |parameter: usize, standing: &dyn Fn(Standing) -> bool| {
        let slots = parts.fit.slots.slots().iter().zip(parts.parameters);
        slots.filter(|(slot, _)| slot.parameter == parameter).any(|(_, found)| standing(found.standing))
    };
    if !is(index, &|standing| standing == Standing::Idle) {
        return None;
    }
    let model = parts.model.shared();
    let zero = |&p: &usize| is(p, &|standing| matches!(standing, Standing::Lower | Standing::Vanishing));
    let stands_with = |&p: &usize| parts.model.phases.iter().any(|phase| phase.model.occur_together(index, p));
    let zeros: Vec<usize> = (0..model.parameters.len()).filter(zero).collect();
    let own: Vec<usize> = zeros.iter().copied().filter(stands_with).collect();
    let named: Vec<String> = if own.is_empty() { zeros } else { own }
        .into_iter()
        .map(|p| format!("`{}`", model.parameters[p].name))
        .collect();
    let verb = if named.len() == 1 { "is" } else { "are" };
    Some(format!("`{}` has no effect while {} {verb} zero", model.parameters[index].name, named.join(" and ")))
}

/// A parameter with some levels, in words: `tau`, or `sigma` at `lot` A, B and 7 more.
fn parameter_phrase(model: &Model, parameter: &Parameter, levels: &[String]) -> String {
    match parameter.per {
        None => format!("`{}`", parameter.name),
        Some(column) => {
            let shown = list(levels.iter().map(String::as_str), "and");
            format!("`{}` for {} {shown}", parameter.name, model.text_columns[column].name)
        }
    }
}

/// Notes on searches from other starts: lower maxima, other α of equal ℓ, searches that were stopped or not certified.
fn start_notes(parts: &DynamicParts<'_>) -> Vec<String> {
    let fit = parts.fit;
    let what = if fit.estimate.criterion == Criterion::Reml { "restricted log-likelihood" } else { "log-likelihood" };
    let top = fit.estimate.log_likelihood;
    let equal_height = EQUAL_HEIGHT + 1e-9 * top.abs();
    let all = fit.others.len();
    let certified: Vec<_> = fit.others.iter().filter(|end| end.stop == Stop::Certified).collect();
    let below = fit.lower_maxima(equal_height);
    let mut notes = Vec::new();
    if let (Some(least), count) = (below.iter().copied().reduce(f64::min), below.len()) {
        let ended = if count == 1 { "another maximum" } else { "other maxima" };
        let nearest = if count == 1 { "by" } else { "the best of them by" };
        notes.push(format!(
            "{count} of {all} other starts ended at {ended} of the {what}, lower {nearest} {least:.4}: more `--starts` may find a higher one"
        ));
    }
    let elsewhere = |end: &&&kalfit_search::OtherEnd| {
        top - end.log_likelihood <= equal_height && (0..fit.values.len()).any(|i| differs(parts, i, end.values[i]))
    };
    let equally_high = certified.iter().filter(elsewhere).count();
    if equally_high > 0 {
        notes.push(format!(
            "{equally_high} of {all} other starts reached the same height at other values of the dynamic parameters, so the maximum is not unique"
        ));
    }
    let given_up = fit.others.iter().filter(|end| end.given_up).count();
    if given_up > 0 {
        notes.push(format!(
            "{given_up} of {all} other starts were stopped early, because they were not leading to a higher {what}"
        ));
    }
    let uncertified = fit.others.iter().filter(|end| end.stop != Stop::Certified && !end.given_up).count();
    let higher = fit.others.iter().filter(|end| end.stop != Stop::Certified && end.log_likelihood > top + equal_height);
    if let Some(most) = higher.map(|end| end.log_likelihood).reduce(f64::max) {
        notes.push(format!(
            "another start reached a {what} of {most:.4}, higher by {:.4}, at a point that is not a certified maximum: the likelihood may be unbounded there, or the search was cut short",
            most - top
        ));
    }
    if uncertified > 0 {
        notes.push(format!("{uncertified} of {all} other starts did not end at a certified optimum"));
    }
    notes
}

/// Whether the value of slot `i` from another start differs from this fit's.
fn differs(parts: &DynamicParts<'_>, i: usize, other: f64) -> bool {
    let (value, found) = (parts.fit.values[i], &parts.parameters[i]);
    let unit = found.std_error.unwrap_or(value.abs());
    found.standing == Standing::Inside && (other - value).abs() > EQUAL_VALUE * unit
}

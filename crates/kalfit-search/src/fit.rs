//! The best (α, μ, Σ) found by searches from all starts, and by exploration beyond them.

use std::sync::Arc;

use crate::profile_likelihood::ProfileLikelihood;
use crate::record::{Candidate, SearchStage, Stages};
use crate::search_state::SearchEnd;
use crate::slot_name::slot_name;
use crate::{
    DynamicError, DynamicFit, Explored, OtherEnd, Settings, Standing, coefficients, exchangeable, explore, search,
    start, unbounded,
};
use kalfit_estimate::{Combination, FitError, Progress, Stage, Stop};
use kalfit_filter::reduce::grouping;
use kalfit_filter::score::dependences;
use kalfit_model::Labels;
use kalfit_model::remote::Answers;
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{PhasedModel, Population, Slots};

/// Relative difference up to which log-likelihoods are equal.
const ROUNDING: f64 = 1e-11;
/// Information on the logarithm of a level below which a larger size is tried, as for a level at zero.
const MIN_INFORMATION: f64 = 1e-2;
/// Sizes at which such a level is tried, relative to the former size or, if larger, the size that the data suggest: the
/// next where ℓ falls at one. A level that could be a variance of states instead costs nothing up to the least of them.
const RAISED_SIZES: [f64; 2] = [0.3, 0.03];
/// Maximal number of levels that are tried at a larger size.
const MAX_RAISED: usize = 8;
/// Rise of ℓ above the best certified end from which on an uncertified end is worth another search.
const MIN_RISE: f64 = 1e-6;

/// Estimates α, μ and Σ from tests, in any number of phases. With no free values it is
/// `estimate::fit` on the reductions.
pub fn fit(
    model: &PhasedModel,
    labels: &Labels,
    tests: &[PhasedTest],
    settings: &Settings,
    progress: &mut dyn Progress,
) -> Result<DynamicFit, DynamicError> {
    let slots = Slots::in_phases(model, labels, tests);
    check_supported(model, tests, &slots, settings)?;
    let objective = ProfileLikelihood::new(model, tests, &slots, settings);
    let ends = match coefficients::ends(&objective, progress)? {
        Some(ends) => ends,
        None => ends(&objective, labels, progress)?,
    };
    fit_at_end(&objective, ends)
}

/// The ends of all searches: the best one, from which a fit is made, and the others.
pub(crate) struct Ends {
    pub(crate) best: SearchEnd,
    /// Ends of the other searches.
    pub(crate) others: Vec<OtherEnd>,
    /// Extent of the exploration.
    pub(crate) explored: Explored,
    /// Stages of the searches, and number of starts.
    pub(crate) stages: Stages,
    /// Names of the levels with which ℓ is unbounded.
    pub(crate) unbounded: Vec<String>,
}

/// The ends of all searches for all free values.
fn ends(objective: &ProfileLikelihood<'_>, labels: &Labels, progress: &mut dyn Progress) -> Result<Ends, DynamicError> {
    let AllEnds { mut ends, explored, first_error, mut stages } = all_ends(objective, progress)?;
    let Some(at) = best_end(&ends) else {
        return Err(first_error.unwrap_or(DynamicError::Fit(FitError::NoTests)));
    };
    let (at, vanishing) = unbounded::find(objective, &ends, at).unwrap_or((at, Vec::new()));
    let best = ends.remove(at);
    let best = stages.run(objective, SearchStage::Certificate, || raise_free_zeros(objective, best, progress));
    ends.sort_by(|a, b| b.iterate.value().total_cmp(&a.iterate.value()));
    let other = |end: SearchEnd| OtherEnd {
        log_likelihood: end.iterate.value(),
        values: objective.values(&exchangeable::aligned(&objective.twins, &end.iterate.values, &best.iterate.values)),
        stop: end.stop,
        given_up: end.given_up,
    };
    let others = ends.into_iter().map(other).collect();
    let name = |&s: &usize| slot_name(objective.model.shared(), labels, objective.slots, s);
    Ok(Ends { best, others, explored, stages, unbounded: vanishing.iter().map(name).collect() })
}

/// Estimates α, μ and Σ from remote tests, by one search from the start values `start`; `units`: sizes of the values
/// that the tests suggest.
pub fn fit_remote(
    model: &PhasedModel,
    (slots, settings): (&Slots, &Settings),
    (answers, start, units): (&Arc<Answers>, Vec<f64>, Vec<f64>),
    progress: &mut dyn Progress,
) -> Result<DynamicFit, DynamicError> {
    let objective = ProfileLikelihood::elsewhere(model, (slots, settings), (answers, units));
    let mut stages = Stages { starts: 1, ..Stages::default() };
    let end =
        stages.run(&objective, SearchStage::Starts, || search::search(&objective, start.into(), None, progress))?;
    let (others, unbounded) = (Vec::new(), Vec::new());
    fit_at_end(&objective, Ends { best: end, others, explored: Explored::No, stages, unbounded })
}

/// The ends of all searches: from the starts, from the exploration, and once more from a high uncertified end.
pub(crate) struct AllEnds {
    pub(crate) ends: Vec<SearchEnd>,
    pub(crate) explored: Explored,
    /// The first error of a search from a start.
    first_error: Option<DynamicError>,
    pub(crate) stages: Stages,
}

/// Searches from all starts, explores, and searches again where a high end is not certified.
pub(crate) fn all_ends(
    objective: &ProfileLikelihood<'_>,
    progress: &mut dyn Progress,
) -> Result<AllEnds, DynamicError> {
    let mut stages = Stages::default();
    let of_starts = stages.run(objective, SearchStage::Starts, || search_all_starts(objective, progress));
    let (mut ends, first_error) = of_starts?;
    stages.starts = ends.len();
    let all_given = start::all_given(objective);
    let explored = match progress.stops() {
        true => Explored::No,
        false => stages
            .run(objective, SearchStage::Exploration, || explore::explore(objective, &mut ends, all_given, progress))?,
    };
    stages.run(objective, SearchStage::Certificate, || search_higher_again(objective, &mut ends, progress));
    Ok(AllEnds { ends, explored, first_error, stages })
}

/// Searches once more from the highest uncertified end above the best certified end, if there is one: a search that
/// stalled or used up all steps may lead on from a fresh start.
fn search_higher_again(objective: &ProfileLikelihood<'_>, ends: &mut Vec<SearchEnd>, progress: &mut dyn Progress) {
    if progress.stops() {
        return;
    }
    let Some(certified) = explore::best(ends).map(|end| end.iterate.value()) else { return };
    let higher = ends.iter().filter(|end| end.iterate.value() > certified + MIN_RISE);
    let highest = higher.max_by(|a, b| a.iterate.value().total_cmp(&b.iterate.value()));
    if let Some(start) = highest.map(Candidate::from) {
        ends.extend(search::search(objective, start.into(), None, progress));
    }
}

/// The end of a search, with noise levels near zero raised where ℓ does not fall at a larger size, such as the noise of
/// a single row per test in addition to the variance of the measured state. With the level at zero, that variance would
/// look known.
pub(crate) fn raise_free_zeros(
    objective: &ProfileLikelihood<'_>,
    best: SearchEnd,
    progress: &mut dyn Progress,
) -> SearchEnd {
    let is_undetermined = |s: usize| {
        let is_open = matches!(best.standing[s], Standing::Inside | Standing::Unidentified);
        best.is_at_zero(s) || (is_open && best.joint.curvature(s).abs() < MIN_INFORMATION)
    };
    let is_level = |s: usize| objective.coordinates[s].level.is_some();
    let zeros: Vec<usize> =
        (0..best.standing.len()).filter(|&s| is_level(s) && is_undetermined(s)).take(MAX_RAISED).collect();
    if best.stop != Stop::Certified || zeros.is_empty() || progress.stops() {
        return best;
    }
    let near = Population::from(&best.iterate.estimate);
    let least = best.iterate.value() - ROUNDING * best.iterate.value().abs().max(1.0);
    let costs_nothing = |values: &[f64]| objective.solve(values, Some(&near)).is_ok_and(|there| there.value() >= least);
    let mut raised = best.iterate.values.clone();
    for &s in &zeros {
        let before = raised[s];
        let is_free = RAISED_SIZES.iter().any(|size| {
            raised[s] = size * best.before_zero[s].max(objective.units()[s]);
            costs_nothing(&raised)
        });
        if !is_free {
            raised[s] = before;
        }
    }
    if raised == best.iterate.values {
        return best;
    }
    let start = Candidate { values: raised, origin: best.origin };
    let end = search::search(objective, start.into(), None, progress).ok();
    end.filter(|end| end.stop == Stop::Certified && end.iterate.value() >= least).unwrap_or(best)
}

/// The fit at the best end, with the other ends, the extent of the exploration, and the levels with which ℓ is
/// unbounded.
fn fit_at_end(
    objective: &ProfileLikelihood<'_>,
    Ends { best, others, explored, stages, unbounded }: Ends,
) -> Result<DynamicFit, DynamicError> {
    let (filter_passes, score_passes, passes) =
        (objective.filter_passes(), objective.score_passes(), objective.passes());
    let search = stages.record(&best);
    let (alpha, sought) = (best.iterate.alpha.clone(), best.iterate.values.clone());
    let values = objective.values(&sought);
    let (reductions, estimate) = objective.with_reductions(best.iterate)?;
    Ok(DynamicFit {
        alpha,
        values,
        sought,
        reductions,
        estimate,
        certificate: best.certificate,
        stop: if unbounded.is_empty() { best.stop } else { Stop::Stalled },
        method: objective.settings.method,
        trace: best.trace,
        filter_passes,
        score_passes,
        passes,
        others,
        explored,
        search,
        unbounded,
        joint: best.joint,
        standing: mark_edges(objective, best.standing),
        settings: objective.settings.clone(),
        slots: objective.slots.clone(),
    })
}

/// The best end of all searches, as a start of another search; `None` where all searches fail.
pub(crate) fn best(objective: &ProfileLikelihood<'_>, progress: &mut dyn Progress) -> Option<Vec<f64>> {
    let AllEnds { ends, .. } = all_ends(objective, progress).ok()?;
    best_end(&ends).map(|at| ends[at].restart())
}

/// The ends of the searches from all starts, and the first error of a search that fails.
fn search_all_starts(
    objective: &ProfileLikelihood<'_>,
    progress: &mut dyn Progress,
) -> Result<(Vec<SearchEnd>, Option<DynamicError>), DynamicError> {
    let (mut ends, mut first_error, mut floor) = (Vec::new(), None, None);
    for start in start::starts(objective, progress)? {
        if progress.stops() && !ends.is_empty() {
            break;
        }
        progress.stage(Stage::Filters { filter_runs: objective.filter_passes() });
        match search::search(objective, start, floor, progress) {
            Ok(end) => {
                floor = Some(floor.map_or(end.iterate.value(), |floor: f64| floor.max(end.iterate.value())));
                ends.push(end);
            }
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    Ok((ends, first_error))
}

/// Sets the standing of covariances of noises at a bound, and of levels at a lower bound from a known covariance, to
/// [`Standing::Edge`].
fn mark_edges(objective: &ProfileLikelihood<'_>, standing: Vec<Standing>) -> Vec<Standing> {
    let one = |(s, standing): (usize, Standing)| match standing {
        Standing::Lower | Standing::Upper if objective.edges.has(s) => Standing::Edge,
        Standing::Lower if objective.lower_bounded.contains(&s) => Standing::Edge,
        other => other,
    };
    standing.into_iter().enumerate().map(one).collect()
}

/// Index of the best certified end, the first of equal ones; an uncertified end may be on the way to an unbounded ℓ. A
/// certified end below ℓ at the first start does not count. If no end counts, index of the highest end.
pub(crate) fn best_end(ends: &[SearchEnd]) -> Option<usize> {
    let highest = |among: &dyn Fn(&SearchEnd) -> bool| {
        let ends = ends.iter().enumerate().filter(|(_, end)| among(end));
        ends.reduce(|a, b| if b.1.iterate.value() > a.1.iterate.value() { b } else { a }).map(|(at, _)| at)
    };
    let begun = ends.first()?.trace.first().copied().unwrap_or(f64::NEG_INFINITY);
    let above = |end: &SearchEnd| end.stop == Stop::Certified && end.iterate.value() >= begun - ROUNDING * begun.abs();
    highest(&above).or_else(|| highest(&|_| true))
}

/// Start values of [`fit`], one for each free value in the order of [`Slots`]: the given one, or else a first guess from
/// the sizes of measured values, their differences and the lengths of records. It costs a pass over the tests; [`fit`]
/// improves the guess by the likelihood before its first step.
///
/// # Errors
/// The errors of [`fit`] before the first step.
pub fn start_values(
    model: &PhasedModel,
    labels: &Labels,
    tests: &[PhasedTest],
    settings: &Settings,
) -> Result<Vec<f64>, DynamicError> {
    let slots = Slots::in_phases(model, labels, tests);
    check_supported(model, tests, &slots, settings)?;
    let objective = ProfileLikelihood::new(model, tests, &slots, settings);
    Ok(objective.values(&start::guess(&objective, true)))
}

/// Refuses tests and settings that have no meaning while parameters are free.
fn check_supported(
    model: &PhasedModel,
    tests: &[PhasedTest],
    slots: &Slots,
    settings: &Settings,
) -> Result<(), DynamicError> {
    let name = |parameter: usize| model.shared().parameters[parameter].name.clone();
    grouping(model, tests)?;
    if let (Some(slot), Combination::Marginal, false) =
        (slots.slots().first(), settings.inner.phases, model.is_single())
    {
        return Err(DynamicError::Marginal { parameter: name(slot.parameter), free: slots.len() });
    }
    for (at, phase) in model.phases.iter().enumerate() {
        let Some(&parameter) = dependences(phase, slots).first() else { continue };
        let reduced = |test: &&PhasedTest| matches!(test.phases.get(at), Some(Evidence::Reduced(_)));
        if let Some(test) = tests.iter().find(reduced) {
            let (test, phase) = (test.id.to_string(), phase.name.clone());
            return Err(DynamicError::FixedReduction { test, phase, parameter: name(parameter) });
        }
    }
    Ok(())
}

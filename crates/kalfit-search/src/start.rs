//! Start values of α: from the model file where given, else computed from the data.
//!
//! Scales come from differences of measured values and from the lengths of steps and records; then each value without a
//! start is tried over several powers of ten, on a part of the data, with μ and Σ solved for at each trial.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::DynamicError;
use crate::balance::balance;
use crate::profile_likelihood::ProfileLikelihood;
use crate::record::{Candidate, Origin};
use crate::sample::{larger, promising, refined, rough_settings, sample, total_rows};
use crate::scales::{drives, is_ratio, measures, time_constants};
use crate::search_state::SearchStart;
use crate::tries::{other_maxima, scan, with_likelihood};
use kalfit_estimate::Progress;
use kalfit_model::Value;

/// Number of points scattered about the first guess.
const SCATTERED: usize = 40;
/// Standard deviation of a logarithm over the scattered points.
const SCATTER_SPREAD: f64 = 2.5;
/// Standard deviation of a logarithm over the random starts.
const RANDOM_SPREAD: f64 = 1.5;

/// Start values: the first guess from the data, points where ℓ seems to have other maxima in noise levels or a time
/// constant, and as many random points as the settings request.
pub(crate) fn starts(
    objective: &ProfileLikelihood<'_>,
    progress: &mut dyn Progress,
) -> Result<Vec<SearchStart>, DynamicError> {
    let common = objective.slots.slots().iter().all(|slot| slot.level.is_none());
    let sample = sample(objective.tests, common);
    let small = ProfileLikelihood::new(objective.model, &sample, objective.slots, objective.settings);
    let unknown = unknown(objective);
    let (first, peaks) = likeliest((objective, &small), &unknown, progress);
    if small.tried_values(std::slice::from_ref(&first), 1, &mut || true) == [None] {
        objective.solve(&first, None)?; // returns the error
    }
    let mut all = vec![Candidate { values: first.clone(), origin: Origin::FirstStart }];
    if !unknown.is_empty() {
        all.extend(Origin::OtherBalance.of(peaks.into_iter().take(1)));
    }
    if unknown.len() > 1 {
        // a single unknown has been scanned completely
        all.extend(Origin::Scattered.of(scattered(&small, &unknown, &first, progress)));
    }
    for parameter in time_constants(objective.model).into_iter().filter(|&p| objective.slots.is_free(p)) {
        all.extend(Origin::TimeConstant.of(other_maxima(&small, parameter, &first, progress)));
    }
    all.extend(Origin::Random.of((0..objective.settings.starts).map(|k| random(objective, &first, k))));
    if total_rows(&sample) == total_rows(objective.tests) {
        return Ok(all.into_iter().map(SearchStart::from).collect());
    }
    // given values remain a start, wherever searches on a part of the data end
    let free = (0..objective.model.shared().parameters.len()).filter(|&p| objective.slots.is_free(p)).count();
    let given = (unknown.len() < free).then(|| all.remove(0));
    let mut starts = promising((objective, &small), given, all, progress);
    let settings = rough_settings(objective.settings);
    for part in larger(objective.tests, common) {
        let larger = ProfileLikelihood::new(objective.model, &part, objective.slots, &settings);
        starts = refined((objective, &larger), starts, progress);
    }
    Ok(starts)
}

/// The first start, from a part of the tests, and points where ℓ of that part seems to have other maxima.
fn likeliest(
    (objective, small): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    unknown: &[usize],
    progress: &mut dyn Progress,
) -> (Vec<f64>, Vec<Vec<f64>>) {
    let (mut first, mut peaks) = (guess(objective, true), Vec::new());
    if !unknown.is_empty() {
        peaks = balance(small, unknown, &mut first, progress);
        for _ in 0..unknown.len().min(2) {
            unknown.iter().for_each(|&parameter| scan(small, parameter, &mut first, progress));
        }
    }
    (first, peaks)
}

/// The start that was given, or that is worked out from the tests: the first of [`starts`].
pub(crate) fn first(objective: &ProfileLikelihood<'_>, progress: &mut dyn Progress) -> Vec<f64> {
    let common = objective.slots.slots().iter().all(|slot| slot.level.is_none());
    let sample = sample(objective.tests, common);
    let small = ProfileLikelihood::new(objective.model, &sample, objective.slots, objective.settings);
    likeliest((objective, &small), &unknown(objective), progress).0
}

/// Starts computed from the data alone, without the given start values; `held`: a slot and the value of that slot in
/// every start.
pub(crate) fn from_data(
    objective: &ProfileLikelihood<'_>,
    held: Option<(usize, f64)>,
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let held_parameter =
        held.map(|(s, _)| objective.slots.slots()[s]).filter(|slot| slot.level.is_none()).map(|slot| slot.parameter);
    let parameters = 0..objective.model.shared().parameters.len();
    let all: Vec<usize> = parameters.filter(|&p| objective.slots.is_free(p) && held_parameter != Some(p)).collect();
    let common = objective.slots.slots().iter().all(|slot| slot.level.is_none());
    let sample = sample(objective.tests, common);
    let small = ProfileLikelihood::new(objective.model, &sample, objective.slots, objective.settings);
    let mut first = guess(objective, false);
    let hold = |values: &mut Vec<f64>| held.iter().for_each(|&(s, value)| values[s] = value);
    hold(&mut first);
    let peaks = balance(&small, &all, &mut first, progress);
    all.iter().for_each(|&parameter| scan(&small, parameter, &mut first, progress));
    let mut starts = vec![first.clone()];
    starts.extend(peaks.into_iter().take(1));
    starts.extend(scattered(&small, &all, &first, progress));
    starts.iter_mut().for_each(hold);
    starts
}

/// Whether every free parameter has a start value.
pub(crate) fn all_given(objective: &ProfileLikelihood<'_>) -> bool {
    unknown(objective).is_empty()
}

/// Indices of the free parameters without a start value.
fn unknown(objective: &ProfileLikelihood<'_>) -> Vec<usize> {
    let is_given = |value: Value, log: bool| match value {
        Value::Free { start: Some(start) } => !(log && start == 0.0), // a logarithm cannot start at zero
        Value::Free { start: None } => false,
        Value::Fixed(_) => true,
    };
    let parameters = objective.model.shared().parameters.iter().enumerate();
    parameters
        .filter(|(p, what)| objective.slots.is_free(*p) && !is_given(what.value, what.positive))
        .map(|(p, _)| p)
        .collect()
}

/// First guess of each sought value; `use_given`: given start values are used.
pub(crate) fn guess(objective: &ProfileLikelihood<'_>, use_given: bool) -> Vec<f64> {
    let scales = objective.scales();
    let model = objective.model;
    let is_noise =
        |parameter: usize| (measures(model, parameter) || drives(model, parameter)) && !is_ratio(model, parameter);
    let one = |(s, slot): (usize, &kalfit_model::Slot)| {
        let parameter = &objective.model.shared().parameters[slot.parameter];
        let coordinate = objective.coordinates[s];
        if objective.edges.has(s) {
            // the covariance itself, not yet divided by the edge
            return if let Value::Free { start: Some(start) } = parameter.value { start } else { 0.0 };
        }
        let guess = match parameter.value {
            Value::Free { start: Some(start) } if use_given && !(coordinate.log && start == 0.0) => start,
            _ if coordinate.log || is_noise(slot.parameter) => scales.guess(objective.model, slot.parameter),
            _ => 0.0,
        };
        coordinate.within_bounds(guess)
    };
    let values: Vec<f64> = objective.slots.slots().iter().enumerate().map(one).collect();
    objective.sought(&values)
}

/// The two best of [`SCATTERED`] points around the first guess: the variation may be noise of the measurements or of
/// the motion, and a search may end with the attribution that the start has.
fn scattered(
    small: &ProfileLikelihood<'_>,
    unknown: &[usize],
    first: &[f64],
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut places = Vec::new();
    for _ in 0..SCATTERED {
        // one draw for all levels of a parameter
        let draws: Vec<f64> =
            small.model.shared().parameters.iter().map(|_| StandardNormal.sample(&mut random)).collect();
        let moved = |(s, value): (usize, &f64)| {
            let parameter = small.slots.slots()[s].parameter;
            let is_scattered = unknown.contains(&parameter) && small.coordinates[s].log;
            if is_scattered { small.coordinates[s].moved(*value, SCATTER_SPREAD * draws[parameter]) } else { *value }
        };
        places.push(first.iter().enumerate().map(moved).collect());
    }
    let mut found = with_likelihood(small, places, progress);
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.into_iter().take(2).map(|(values, _)| values).collect()
}

/// Random start `k`: logarithms are moved by normal numbers of standard deviation [`RANDOM_SPREAD`], other values by normal
/// numbers times the size of the value. Each start has a separate random stream.
fn random(objective: &ProfileLikelihood<'_>, first: &[f64], k: usize) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(objective.settings.seed);
    random.set_stream(k as u64);
    let moved = |(s, value): (usize, &f64)| {
        let draw: f64 = StandardNormal.sample(&mut random);
        let coordinate = objective.coordinates[s];
        coordinate.moved(*value, if coordinate.log { RANDOM_SPREAD * draw } else { draw * value.abs().max(0.5) })
    };
    first.iter().enumerate().map(moved).collect()
}

//! Candidate starts from which a search may reach another maximum than the known one: another part of the model may
//! explain the same variation.

use crate::exchangeable::ExchangeablePair;
use crate::noise_transfer::NoiseTransfer;
use crate::profile_likelihood::ProfileLikelihood;
use crate::record::{Candidate, Origin};
use crate::scales;
use crate::scales::time_constants;
use crate::search_state::SearchEnd;
use crate::tries::{TRIAL_FACTOR, best_of, lengthened_time, other_maxima};
use kalfit_estimate::Progress;

/// Values tried for a covariance of noises, relative to the bound of the covariance.
const TRIAL_CORRELATIONS: [f64; 4] = [-0.9, -0.3, 0.3, 0.9];
/// Distance from the present relative covariance above which a value of [`TRIAL_CORRELATIONS`] is tried.
const MIN_DISTANCE: f64 = 0.4;
/// Difference up to which two values of ℓ count as equal.
const EQUAL_VALUE: f64 = 1e-3;
/// Change of ℓ with the time constant reduced to a quarter up to which a process is white.
const WHITE_LOSS: f64 = 1e-6;
/// Change of ℓ with the time constant reduced to a quarter up to which a process may be noise of a measurement.
const NEARLY_WHITE_LOSS: f64 = 0.1;
/// Maximal number of candidates that separate two coinciding processes.
const MAX_SEPARATED: usize = 3;
/// Sizes tried for levels at zero, in units of the size that the data suggest.
const TRIAL_SIZES: [f64; 5] = [2.0, 0.7, 0.25, 0.08, 0.025];

/// Candidate starts around the end of a search; only values common to all tests change, and the value `held` does not.
pub(super) fn places(
    objective: &ProfileLikelihood<'_>,
    end: &SearchEnd,
    held: Option<usize>,
    progress: &mut dyn Progress,
) -> Vec<Candidate> {
    let values = &end.iterate.values;
    let (mut all, mut bases) = (Vec::new(), vec![values.clone()]);
    for twins in &objective.twins {
        let Some(one) = twins.merged(values, &objective.coordinates) else { continue };
        all.extend(Origin::Merged.of([one.clone()]));
        all.extend(Origin::Separated.of(separated_pair(objective, &one, twins, progress)));
        bases.push(one);
    }
    let is_level = |s: &usize| {
        let coordinate = &objective.coordinates[*s];
        let common = objective.slots.slots()[*s].level.is_none();
        common && coordinate.level.is_some() && coordinate.lower == 0.0 && held != Some(*s)
    };
    let levels: Vec<usize> = (0..values.len()).filter(is_level).collect();
    let is_timed = !time_constants(objective.model).is_empty();
    for &s in levels.iter().filter(|&&s| values[s] > 0.0 && is_timed && drives(objective, s)) {
        all.extend(Origin::WithoutLevel.of([with_zero(values, s)]));
    }
    for t in (0..values.len()).filter(|&t| objective.edges.has(t) && held != Some(t)) {
        all.extend(Origin::Covariance.of(other_correlations(values, t)));
    }
    for &s in levels.iter().filter(|&&s| values[s] > 0.0 && !drives(objective, s) && has_free_covariance(objective, s))
    {
        all.extend(Origin::WithoutLevel.of([with_zero(values, s)]));
    }
    let is_open = |parameter: &usize| objective.slots.common(*parameter).is_some_and(|s| held != Some(s));
    let timed: Vec<usize> = time_constants(objective.model).into_iter().filter(is_open).collect();
    let [white, nearly_white] = white_processes(objective, end, &timed);
    let exchanges = ExchangeablePair::unlike(objective.model, objective.slots);
    let mut as_noise = returned_to_noise(objective, end, &levels);
    as_noise.extend(held.and_then(|t| held_level_as_measurement_noise(objective, end, (t, &timed), progress)));
    as_noise.extend(process_to_noise(objective, values, (&levels, &nearly_white), &exchanges));
    all.extend(Origin::ProcessAsNoise.of(as_noise));
    for &s in &levels {
        all.extend(Origin::LevelFromZero.of(other_sizes(objective, end, (s, objective.units()[s]))));
    }
    for parameter in timed {
        all.extend(Origin::TimeConstant.of(other_maxima(objective, parameter, values, progress)));
        if white.contains(&parameter) {
            all.extend(Origin::TimeConstant.of(lengthened_process(objective, end, parameter, progress)));
        }
        for base in &bases {
            let height = end.iterate.value();
            let from =
                levels.iter().filter_map(|&s| noise_to_process(objective, (base, height), s, parameter, progress));
            all.extend(Origin::NoiseAsProcess.of(from));
        }
    }
    all.extend(Origin::Exchanged.of(exchanges.iter().map(|pair| pair.exchanged(values))));
    all.extend(Origin::ScaledTimes.of(scaled_times(objective, values)));
    // a candidate must not move the value that is held
    deduplicated(all.into_iter().filter(|place| held.is_none_or(|s| place.values[s] == values[s])))
}

/// The candidates in the given order, without repetitions.
pub(super) fn deduplicated(places: impl Iterator<Item = Candidate>) -> Vec<Candidate> {
    let mut all: Vec<Candidate> = Vec::new();
    for place in places {
        if !all.iter().any(|other| other.values == place.values) {
            all.push(place);
        }
    }
    all
}

/// The values with one level set to zero.
fn with_zero(values: &[f64], s: usize) -> Vec<f64> {
    let mut with_zero = values.to_vec();
    with_zero[s] = 0.0;
    with_zero
}

/// Indices of the time constants of processes that ℓ cannot distinguish from white noise, and of nearly white
/// processes.
fn white_processes(objective: &ProfileLikelihood<'_>, end: &SearchEnd, timed: &[usize]) -> [Vec<usize>; 2] {
    let loss = |&parameter: &usize| Some((parameter, loss_if_shorter(objective, end, parameter)?));
    let losses: Vec<(usize, f64)> = timed.iter().filter_map(loss).collect();
    [WHITE_LOSS, NEARLY_WHITE_LOSS]
        .map(|most| losses.iter().filter(|(_, loss)| *loss <= most).map(|(parameter, _)| *parameter).collect())
}

/// Candidates where one of two coinciding processes takes the variance of both, and the other one gets another size and
/// shape.
fn separated_pair(
    objective: &ProfileLikelihood<'_>,
    one: &[f64],
    twins: &ExchangeablePair,
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let (Some(level), Some(shape)) = (twins.freed(&objective.coordinates), twins.shape(&objective.coordinates)) else {
        return Vec::new();
    };
    let of_size = |size: &f64| {
        let mut beside = one.to_vec();
        beside[level] = (size * objective.units()[level]).min(objective.coordinates[level].upper);
        beside
    };
    let parameter = objective.slots.slots()[shape].parameter;
    let found = TRIAL_SIZES.iter().flat_map(|size| other_maxima(objective, parameter, &of_size(size), progress));
    let valued = found.filter_map(|place| Some((objective.value(&place)?, place)));
    let mut valued: Vec<(f64, Vec<f64>)> = valued.collect();
    valued.sort_by(|a, b| b.0.total_cmp(&a.0));
    valued.into_iter().take(MAX_SEPARATED).map(|(_, place)| place).collect()
}

/// Candidates where the variance of a process becomes noise of a measurement whose noise level is at zero: the process
/// may have replaced that noise, and may return in another shape.
fn returned_to_noise(objective: &ProfileLikelihood<'_>, end: &SearchEnd, levels: &[usize]) -> Vec<Vec<f64>> {
    let (driving, measurement_levels): (Vec<usize>, Vec<usize>) = levels.iter().partition(|&&s| drives(objective, s));
    let values = &end.iterate.values;
    let zeros = measurement_levels.into_iter().filter(|&s| end.is_at_zero(s));
    let pairs = zeros.flat_map(|s| driving.iter().filter(|&&t| values[t] > 0.0).map(move |&t| (s, t)));
    pairs.filter_map(|pair| transferred(objective, values, pair)).collect()
}

/// Candidate for a search that holds the size of a process: all measurement noises at zero get the variance of the
/// process, and the process gets the best time constant given these noises. The noises may then explain the variation,
/// and a slow process may have the held size.
fn held_level_as_measurement_noise(
    objective: &ProfileLikelihood<'_>,
    end: &SearchEnd,
    (t, timed): (usize, &[usize]),
    progress: &mut dyn Progress,
) -> Option<Vec<f64>> {
    let parameter = timed.iter().find(|&&parameter| driving_level(objective, parameter) == Some((t, true)))?;
    let source_exponent = objective.coordinates[t].level?;
    let mut beside = end.iterate.values.clone();
    let measures = |s: usize| scales::measures(objective.model, objective.slots.slots()[s].parameter);
    for s in (0..beside.len()).filter(|&s| end.is_at_zero(s) && measures(s)) {
        let Some(target_exponent) = objective.coordinates[s].level else { continue };
        beside[s] = beside[t]
            .powf(source_exponent / target_exponent)
            .clamp(objective.coordinates[s].lower, objective.coordinates[s].upper);
    }
    let is_other = beside != end.iterate.values;
    is_other.then(|| best_of(objective, *parameter, &beside, progress))?.map(|(beside, _)| beside)
}

/// Candidates where the variance of a nearly white process becomes noise of a measurement: with the other processes
/// unchanged, with the process exchanged for an unlike one first, and, where noises have a covariance, with the unlike
/// process then taking over as much of the noise as possible. The process at zero may return in another shape.
fn process_to_noise(
    objective: &ProfileLikelihood<'_>,
    values: &[f64],
    (levels, white): (&[usize], &[usize]),
    exchanges: &[ExchangeablePair],
) -> Vec<Vec<f64>> {
    let measurement_levels: Vec<usize> =
        levels.iter().copied().filter(|&s| values[s] > 0.0 && !drives(objective, s)).collect();
    let sized =
        white.iter().filter_map(|&parameter| driving_level(objective, parameter).filter(|(_, is_size)| *is_size));
    let sized: Vec<usize> = sized.map(|(t, _)| t).filter(|t| levels.contains(t) && values[*t] > 0.0).collect();
    let mut all = Vec::new();
    for (&s, &t) in measurement_levels.iter().flat_map(|s| sized.iter().map(move |t| (s, t))) {
        all.extend(transferred(objective, values, (s, t)));
        let other = |pair: &ExchangeablePair| {
            pair.pairs.iter().find_map(|&(a, b)| if a == t { Some(b) } else { (b == t).then_some(a) })
        };
        all.extend(
            exchanges.iter().filter_map(|pair| transferred(objective, &pair.exchanged(values), (s, other(pair)?))),
        );
        let changed = |pair: &ExchangeablePair| {
            let (own, given) = (other(pair)?, transferred(objective, values, (s, t))?);
            NoiseTransfer::of(objective, s, own)?.taken(&pair.exchanged(&given))
        };
        all.extend(exchanges.iter().filter_map(changed));
    }
    all
}

/// The values with the variance of level `t` added to level `s`, and to the covariances of noises where these are free;
/// level `t` is then zero.
fn transferred(objective: &ProfileLikelihood<'_>, values: &[f64], (s, t): (usize, usize)) -> Option<Vec<f64>> {
    if let Some(noises) = NoiseTransfer::of(objective, s, t) {
        return Some(noises.given(values));
    }
    let (taker, giver) = (objective.coordinates[s], objective.coordinates[t]);
    let (source_exponent, target_exponent) = (giver.level?, taker.level?);
    let mut given = values.to_vec();
    given[s] = (values[s].powf(target_exponent) + values[t].powf(source_exponent))
        .powf(target_exponent.recip())
        .clamp(taker.lower, taker.upper);
    given[t] = 0.0;
    Some(given)
}

/// Absolute change of ℓ with a time constant reduced to a quarter.
fn loss_if_shorter(objective: &ProfileLikelihood<'_>, end: &SearchEnd, time_constant: usize) -> Option<f64> {
    let slot = objective.slots.common(time_constant)?;
    let mut shorter = end.iterate.values.clone();
    shorter[slot] = objective.coordinates[slot].moved(shorter[slot], -TRIAL_FACTOR.ln());
    Some((objective.value(&shorter)? - end.iterate.value()).abs())
}

/// Candidate where a nearly white process has the best time constant among longer ones, at which ℓ begins to
/// distinguish it from white noise.
fn lengthened_process(
    objective: &ProfileLikelihood<'_>,
    end: &SearchEnd,
    time_constant: usize,
    progress: &mut dyn Progress,
) -> Option<Vec<f64>> {
    let (best, value) = best_of(objective, time_constant, &end.iterate.values, progress)?;
    let is_level = (value - end.iterate.value()).abs() <= EQUAL_VALUE;
    is_level.then(|| lengthened_time(objective, time_constant, (best, value), progress))
}

/// Candidates with all time constants four times as long, or a quarter as long, and each process as rough as before:
/// the data may be explained by slower and larger processes, or by quicker and smaller ones.
fn scaled_times(objective: &ProfileLikelihood<'_>, values: &[f64]) -> Vec<Vec<f64>> {
    let open = |&parameter: &usize| objective.slots.common(parameter).is_some();
    let parameters: Vec<usize> = time_constants(objective.model).into_iter().filter(open).collect();
    let scaled_by = |step: f64| {
        let mut moved = values.to_vec();
        for &parameter in &parameters {
            let Some(time) = objective.slots.common(parameter) else { continue };
            moved[time] = objective.coordinates[time].moved(values[time], step);
            let sized = driving_level(objective, parameter).filter(|(_, is_size)| *is_size);
            let Some((level, _)) = sized else { continue };
            let Some(exponent) = objective.coordinates[level].level else { continue };
            moved[level] = objective.coordinates[level].moved(values[level], step / exponent);
        }
        moved
    };
    if parameters.is_empty() { Vec::new() } else { [TRIAL_FACTOR.ln(), -TRIAL_FACTOR.ln()].map(scaled_by).to_vec() }
}

/// Slot of the noise level of the process with a given time constant, and whether the level is the size of the process:
/// the noise variance then depends on the time constant, too.
fn driving_level(objective: &ProfileLikelihood<'_>, time_constant: usize) -> Option<(usize, bool)> {
    objective.model.phases.iter().flat_map(|phase| &phase.model.states).find_map(|state| {
        let (form, noise_variance) = state.motion.parts()?;
        let timed = form.terms.iter().any(|(_, term)| term.mentions(time_constant));
        let mentioned = |t: &usize| noise_variance.mentions(objective.slots.slots()[*t].parameter);
        let level = |t: &usize| objective.coordinates[*t].level.is_some() && mentioned(t);
        let found = (0..objective.coordinates.len()).find(level).filter(|_| timed)?;
        Some((found, noise_variance.mentions(time_constant)))
    })
}

/// Candidate where a process with this time constant takes over the measurement noise of level `s`, with the best value
/// of the time constant; `height`: ℓ at the end of the search.
fn noise_to_process(
    objective: &ProfileLikelihood<'_>,
    (values, height): (&[f64], f64),
    s: usize,
    time_constant: usize,
    progress: &mut dyn Progress,
) -> Option<Vec<f64>> {
    let (taker, is_size) = driving_level(objective, time_constant)?;
    if values[s] == 0.0 || drives(objective, s) {
        return None;
    }
    let noises = NoiseTransfer::of(objective, s, taker).filter(|noises| is_size && noises.first() == s);
    let crossed = noises.and_then(|noises| noises.taken(values));
    let over = crossed.or_else(|| replaced(objective, values, (s, taker)))?;
    let best = best_of(objective, time_constant, &over, progress)?;
    // ℓ is unchanged: the process is as white as the noise was, and ℓ may rise at a somewhat longer time constant
    let is_level = (best.1 - height).abs() <= EQUAL_VALUE;
    Some(if is_level { lengthened_time(objective, time_constant, best, progress) } else { best.0 })
}

/// The values with level `s` at zero and level `t` at the variance that `s` had.
fn replaced(objective: &ProfileLikelihood<'_>, values: &[f64], (s, t): (usize, usize)) -> Option<Vec<f64>> {
    let (source_exponent, target_exponent) = (objective.coordinates[s].level?, objective.coordinates[t].level?);
    let mut replaced = values.to_vec();
    replaced[t] = values[s]
        .powf(source_exponent / target_exponent)
        .clamp(objective.coordinates[t].lower, objective.coordinates[t].upper);
    replaced[s] = 0.0;
    Some(replaced)
}

/// Candidates with other values of a noise covariance, some of the other sign.
fn other_correlations(values: &[f64], t: usize) -> impl Iterator<Item = Vec<f64>> {
    let apart = TRIAL_CORRELATIONS.into_iter().filter(move |part| (part - values[t]).abs() > MIN_DISTANCE);
    apart.map(move |part| {
        let mut other = values.to_vec();
        other[t] = part;
        other
    })
}

/// Whether level `s` belongs to a noise with a free covariance to another noise.
fn has_free_covariance(objective: &ProfileLikelihood<'_>, s: usize) -> bool {
    !objective.edges.beside(objective.slots.slots()[s].parameter).is_empty()
}

/// Whether a level drives the motion of some state.
fn drives(objective: &ProfileLikelihood<'_>, s: usize) -> bool {
    scales::drives(objective.model, objective.slots.slots()[s].parameter)
}

/// Candidates with a level at zero set to another size: the sizes at which ℓ is higher than at the neighbouring sizes.
fn other_sizes(objective: &ProfileLikelihood<'_>, end: &SearchEnd, (s, unit): (usize, f64)) -> Vec<Vec<f64>> {
    let value = end.iterate.values[s];
    if value > 0.0 && !end.is_at_zero(s) {
        return Vec::new();
    }
    let at = |size: &f64| {
        let mut values = end.iterate.values.clone();
        values[s] = (size * unit).clamp(objective.coordinates[s].lower, objective.coordinates[s].upper);
        values
    };
    let places: Vec<Vec<f64>> = TRIAL_SIZES.iter().map(at).collect();
    let heights: Vec<f64> = places.iter().map(|place| objective.value(place).unwrap_or(f64::NEG_INFINITY)).collect();
    let beside = |k: usize, other: Option<usize>| other.and_then(|o| heights.get(o)).is_none_or(|h| *h < heights[k]);
    let peak = |k: &usize| heights[*k].is_finite() && beside(*k, k.checked_sub(1)) && beside(*k, Some(k + 1));
    // zero is the neighbour of the smallest size
    let last = TRIAL_SIZES.len() - 1;
    (0..TRIAL_SIZES.len())
        .filter(peak)
        .filter(|k| *k < last || heights[last] > end.iterate.value())
        .map(|k| places[k].clone())
        .collect()
}

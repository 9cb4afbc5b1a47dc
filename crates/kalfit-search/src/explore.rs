//! Search for other maxima, from the best end.
//!
//! A certificate holds for the neighbourhood of a point. With several noises, ℓ often has several maxima, which differ
//! in the noise that explains a variation. So each process is removed and may return in another shape, coinciding
//! processes are merged, levels at zero are tried at other sizes, and the search begins anew from the data where the
//! start values were given. Where rows are many, a part of the data is explored: a search on all rows follows only
//! where ℓ of the part is about as high elsewhere.

use crate::coordinates::alike;
use crate::exchangeable::ordered;
use crate::places::{deduplicated, places};
use crate::profile_likelihood::ProfileLikelihood;
use crate::record::{Candidate, Origin};
use crate::sample::{
    CLOSE_LOSS, MAX_FOLLOWED, SAME_END_DIFFERENCE, SubsampleProgress, larger, refined, rough_settings, sample,
    total_rows,
};
use crate::search::search;
use crate::search_state::{MIN_RISE, SearchEnd, SearchStart, SearchState};
use crate::tries::likelihoods_at;
use crate::{DynamicError, Explored, Method, Settings, start};
use kalfit_estimate::{Progress, Stop};

/// Maximal number of rows that the exploration filters, over all runs.
const MAX_ROWS: usize = 20_000_000;
/// Ratio of the number of all rows to the number of rows in the sample from which on the exploration uses the sample.
const MIN_RATIO: usize = 2;
/// Maximal number of runs of the filters.
const MAX_RUNS: usize = 600;
/// Number of free values above which nothing is explored: a single search costs too much.
const MAX_VALUES: usize = 24;
/// Number of affordable runs below which nothing is explored.
const MIN_RUNS: usize = 150;
/// Maximal number of rounds; each round tries candidates around the best end so far.
const MAX_ROUNDS: usize = 4;
/// Maximal number of runs where rows are few.
const MAX_RUNS_FEW_ROWS: usize = 1800;
/// Maximal number of rows that more than [`MAX_RUNS`] runs may filter in all.
const FEW_ROWS: usize = 900_000;
/// Rise of ℓ up to which a higher end counts as the same maximum, reached along a direction in which ℓ is level.
const SAME_MAXIMUM: f64 = 1e-5;

/// Adds the ends found, and returns how far the exploration went; `all_given`: all start values were given.
pub(super) fn explore(
    objective: &ProfileLikelihood<'_>,
    ends: &mut Vec<SearchEnd>,
    all_given: bool,
    progress: &mut dyn Progress,
) -> Result<Explored, DynamicError> {
    let settings = Settings { method: Method::Hybrid, ..objective.settings.clone() };
    let hybrid = ProfileLikelihood::new(objective.model, objective.tests, objective.slots, &settings);
    let common = objective.slots.slots().iter().all(|slot| slot.level.is_none());
    let part = if common { sample(objective.tests, common) } else { Vec::new() };
    let small = ProfileLikelihood::new(objective.model, &part, objective.slots, &settings);
    let is_long = common && objective.rows() > 0 && MIN_RATIO * total_rows(&part) <= objective.rows();
    let explored = match best(ends) {
        Some(_) if is_long && is_possible(&small) => {
            explore_sample((objective, &hybrid, &small), ends, all_given, progress)
        }
        _ if is_possible(objective) => explore_from_best((objective, &hybrid), ends, (all_given, 0.0), progress),
        _ => Ok(Explored::No),
    };
    objective.add_counts(&hybrid);
    explored
}

/// Explores a part of the data, searches on all of the data from points where ℓ of the part is high, and adds certified
/// ends above the best one to `ends`.
fn explore_sample(
    (objective, hybrid, small): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    ends: &mut Vec<SearchEnd>,
    all_given: bool,
    progress: &mut dyn Progress,
) -> Result<Explored, DynamicError> {
    let Some(iterate) = best(ends).map(SearchEnd::restart) else { return Ok(Explored::No) };
    let mut subsample_progress = SubsampleProgress { small, progress: &mut *progress };
    let Ok(start) = small.solve(&iterate, None) else { return Ok(Explored::No) };
    let mut found = vec![SearchState::new(small, &mut subsample_progress, start).run()?];
    let known = ordered(&objective.twins, &found[0].restart());
    let looked = explore_from_best((small, small), &mut found, (all_given, CLOSE_LOSS), &mut subsample_progress)?;
    found.sort_by(|a, b| b.iterate.value().total_cmp(&a.iterate.value()));
    let highest = found[0].iterate.value();
    let near = found.iter().filter(|end| highest - end.iterate.value() <= CLOSE_LOSS).map(Candidate::from);
    let elsewhere = near.filter(|place| !alike(&ordered(&objective.twins, &place.values), &known, SAME_END_DIFFERENCE));
    let elsewhere: Vec<SearchStart> = elsewhere.take(MAX_FOLLOWED).map(SearchStart::from).collect();
    for start in away_from(&iterate, elsewhere, (objective, hybrid), progress) {
        let floor = best(ends).map(|best| best.iterate.value() + MIN_RISE);
        let Ok(iterate) = hybrid.solve(&start.values, None) else { continue };
        if progress.stops() {
            return Ok(Explored::Part);
        }
        let mut search = SearchState::new(hybrid, progress, iterate).with_best_known(floor).with_origin(start.origin);
        search.start_from_curvature(start.curvature);
        let end = search.run()?;
        if is_higher(&end, floor) {
            ends.push(by_method(objective, end, progress)?);
        }
    }
    Ok(if looked == Explored::Whole { Explored::Sample } else { looked })
}

/// The starts of `elsewhere` from which searches on larger parts of the data do not end near `iterate`, nor far below
/// in ℓ.
fn away_from(
    iterate: &[f64],
    elsewhere: Vec<SearchStart>,
    (objective, hybrid): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    progress: &mut dyn Progress,
) -> Vec<SearchStart> {
    if elsewhere.is_empty() {
        return elsewhere;
    }
    let mut starts = vec![SearchStart::from(iterate.to_vec())];
    starts.extend(elsewhere);
    let settings = rough_settings(hybrid.settings);
    for part in larger(objective.tests, true) {
        let larger = ProfileLikelihood::new(objective.model, &part, objective.slots, &settings);
        starts = refined((hybrid, &larger), starts, progress);
    }
    starts.split_off(1)
}

/// Whether an end is certified and above `floor`.
fn is_higher(end: &SearchEnd, floor: Option<f64>) -> bool {
    end.stop == Stop::Certified && floor.is_none_or(|floor| end.iterate.value() > floor)
}

/// The end, searched for again where the settings request another method than the hybrid one.
fn by_method(
    objective: &ProfileLikelihood<'_>,
    found: SearchEnd,
    progress: &mut dyn Progress,
) -> Result<SearchEnd, DynamicError> {
    match objective.settings.method {
        Method::Hybrid => Ok(found),
        _ => search(objective, Candidate::from(&found).into(), None, progress),
    }
}

/// The first certified end above `end`, by searches from candidates around `end` that hold one value; `end` where none
/// is higher.
pub fn around(
    objective: &ProfileLikelihood<'_>,
    end: SearchEnd,
    held: usize,
    progress: &mut dyn Progress,
) -> SearchEnd {
    if !is_possible(objective) {
        return end;
    }
    let affordable_runs = objective.filter_passes() + affordable_runs(objective);
    let floor = end.iterate.value() + MIN_RISE;
    let mut places = places(objective, &end, Some(held), progress);
    places.extend(Origin::Data.of(start::from_data(objective, Some((held, end.iterate.values[held])), progress)));
    let mut found =
        places.into_iter().take_while(|_| objective.filter_passes() < affordable_runs).filter_map(|place| {
            let iterate = objective.solve(&place.values, None).ok()?;
            let mut search = SearchState::new(objective, &mut *progress, iterate)
                .with_best_known(Some(floor))
                .with_origin(place.origin);
            search.hold(held);
            search.run().ok().filter(|found| found.stop == Stop::Certified && found.iterate.value() > floor)
        });
    found.next().unwrap_or(end)
}

/// Whether enough runs may be spent to look for other maxima.
fn is_possible(objective: &ProfileLikelihood<'_>) -> bool {
    affordable_runs(objective) > 0
}

/// Number of runs of the filters that may be spent; 0 where the number is too small for a search, or the free values
/// are too many.
fn affordable_runs(objective: &ProfileLikelihood<'_>) -> usize {
    let rows = objective.rows().max(1);
    let runs = (MAX_ROWS / rows).min(MAX_RUNS).max((FEW_ROWS / rows).min(MAX_RUNS_FEW_ROWS));
    if runs < MIN_RUNS || objective.slots.len() > MAX_VALUES { 0 } else { runs }
}

/// Adds ends that are higher than the best one, or lower by no more than `slack`; `all_given`: all start values were given.
fn explore_from_best(
    (objective, hybrid): (&ProfileLikelihood<'_>, &ProfileLikelihood<'_>),
    ends: &mut Vec<SearchEnd>,
    (all_given, slack): (bool, f64),
    progress: &mut dyn Progress,
) -> Result<Explored, DynamicError> {
    let affordable_runs = affordable_runs(objective);
    let mut tried: Vec<Vec<f64>> = ends.iter().map(|end| end.iterate.values.clone()).collect();
    for round in 0..MAX_ROUNDS {
        let best = best(ends);
        let mut places = best.map_or_else(Vec::new, |best| places(hybrid, best, None, progress));
        if round == 0 && all_given {
            places.extend(Origin::Data.of(start::from_data(objective, None, progress)));
        }
        let mut floor = best.map(|best| best.iterate.value() + MIN_RISE);
        let new_maximum_floor = floor.map(|floor| floor + SAME_MAXIMUM);
        let mut higher = false;
        let places = interleaved(hybrid, untried(hybrid, &places, &tried), affordable_runs, progress);
        if progress.stops() {
            return Ok(Explored::Part);
        }
        for place in places {
            if hybrid.filter_passes() >= affordable_runs || progress.stops() {
                return Ok(Explored::Part);
            }
            tried.push(place.values.clone());
            let Ok(iterate) = hybrid.solve(&place.values, None) else { continue };
            let lowest_value = floor.map(|floor| floor - slack);
            let search = SearchState::new(hybrid, progress, iterate).with_best_known(lowest_value);
            let found = search.with_origin(place.origin).run()?;
            if !is_higher(&found, lowest_value) {
                continue;
            }
            higher = is_higher(&found, new_maximum_floor);
            let (value, is_better) = (found.iterate.value(), is_higher(&found, floor));
            ends.push(if is_better { by_method(objective, found, progress)? } else { found });
            if higher {
                break;
            }
            floor = floor.map(|floor| floor.max(value + MIN_RISE));
        }
        if !higher {
            return Ok(Explored::Whole);
        }
    }
    Ok(Explored::Part)
}

/// The points that have not been tried, without repetitions.
fn untried(objective: &ProfileLikelihood<'_>, places: &[Candidate], tried: &[Vec<f64>]) -> Vec<Candidate> {
    let ordered = |place: &Candidate| Candidate { values: ordered(&objective.twins, &place.values), ..*place };
    deduplicated(places.iter().map(ordered).filter(|place| !tried.contains(&place.values)))
}

/// The points in alternation, without repetitions: the remaining point with the highest ℓ, then the next point of the
/// list. A search from a point with a high ℓ is short, but may lead back to a known end and use up runs that other
/// points need. Half of the `affordable_runs` runs are reserved for searches: ℓ is evaluated at no more points than the
/// other half allows.
fn interleaved(
    objective: &ProfileLikelihood<'_>,
    places: Vec<Candidate>,
    affordable_runs: usize,
    progress: &mut dyn Progress,
) -> Vec<Candidate> {
    let affordable = affordable_runs.saturating_sub(objective.filter_passes()) / 2;
    let first: Vec<Vec<f64>> = places.iter().take(affordable).map(|place| place.values.clone()).collect();
    let values = likelihoods_at(objective, &first, progress);
    let mut with_likelihood: Vec<(&Candidate, f64)> =
        places.iter().zip(values).filter_map(|(place, value)| Some((place, value?))).collect();
    with_likelihood.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut highest = with_likelihood.into_iter().map(|(place, _)| place.clone());
    let mut turns: Vec<Candidate> = Vec::with_capacity(places.len());
    for listed in &places {
        let next = highest.find(|place| !turns.contains(place));
        turns.extend(next);
        if !turns.contains(listed) {
            turns.push(listed.clone());
        }
    }
    turns
}

/// The best certified end.
pub(super) fn best(ends: &[SearchEnd]) -> Option<&SearchEnd> {
    let certified = ends.iter().filter(|end| end.stop == Stop::Certified);
    certified.max_by(|a, b| a.iterate.value().total_cmp(&b.iterate.value()))
}

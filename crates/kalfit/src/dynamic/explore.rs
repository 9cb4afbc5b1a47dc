//! Other maxima, looked for from the best end.
//!
//! A certificate is about the neighbourhood of a point. ℓ of several noises often has more maxima than one, and they differ in what
//! explains what: so each process is taken away and may come back in another shape, processes that coincide become one, levels at
//! zero are tried at other sizes, and the search begins anew from the data where the start values were given. Of many rows a part
//! will do: only where ℓ of that part is about as high elsewhere does the search go there on all of them.

use crate::dynamic::bench::Bench;
use crate::dynamic::coordinates::alike;
use crate::dynamic::iterate::{End, RISE, Search};
use crate::dynamic::sample::{ALIKE, Beside, CLOSE, FOLLOWED, sample, total};
use crate::dynamic::scales::{mentions, time_constants};
use crate::dynamic::search::search;
use crate::dynamic::tries::{FACTOR, best_of, longer, other_maxima};
use crate::dynamic::twins::{Twins, ordered};
use crate::dynamic::{DynamicError, Explored, Method, Settings, start};
use crate::estimate::{Progress, Silent, Stop};
use crate::model::Motion;

/// Rows that may be filtered for it, all runs together.
const ROWS: usize = 20_000_000;
/// A part of the data serves where they are so many times as long.
const LONGER: usize = 2;
/// Most runs of the filters.
const RUNS: usize = 600;
/// With more values than this one search costs too much.
const VALUES: usize = 24;
/// Fewer runs than this are not begun with.
const FEWEST: usize = 150;
/// Most times that a better end is looked around from.
const ROUNDS: usize = 4;
/// … more of them where rows are so few that all runs together are of no more than this.
const MORE_RUNS: usize = 1200;
const FEW_ROWS: usize = 600_000;
/// Parts of what a covariance of noises may be that are tried, those that are this far from the present one.
const PARTS: [f64; 4] = [-0.9, -0.3, 0.3, 0.9];
const APART: f64 = 0.4;
/// ℓ is as high as another to this.
const LEVEL: f64 = 1e-3;
/// A process whose time constant may be a quarter of what it is, at no more loss of ℓ than this, is white.
const WHITE: f64 = 1e-6;
/// Of processes that are set apart so many shapes are followed.
const APART_TRIED: usize = 3;
/// Sizes of levels at zero that are tried, in units of what the data suggest.
const SIZES: [f64; 5] = [2.0, 0.7, 0.25, 0.08, 0.025];

/// Adds the ends that are found, and says where it was looked; `told`: all start values were given.
pub(super) fn explore(
    bench: &Bench<'_>,
    ends: &mut Vec<End>,
    told: bool,
    progress: &mut dyn Progress,
) -> Result<Explored, DynamicError> {
    let settings = Settings { method: Method::Hybrid, ..bench.settings.clone() };
    let hybrid = Bench::new(bench.model, bench.tests, bench.slots, &settings);
    let common = bench.slots.slots().iter().all(|slot| slot.level.is_none());
    let part = if common { sample(bench.tests, common) } else { Vec::new() };
    let small = Bench::new(bench.model, &part, bench.slots, &settings);
    let is_long = common && LONGER * total(&part) <= bench.rows();
    let explored = match best(ends) {
        Some(_) if is_long && is_possible(&small) => on_part((bench, &hybrid, &small), ends, told, progress),
        _ if is_possible(bench) => look_around((bench, &hybrid), ends, (told, 0.0), progress),
        _ => Ok(Explored::No),
    };
    bench.absorb(&hybrid);
    explored
}

/// Adds the best certified end that a part of the data leads to.
fn on_part(
    (bench, hybrid, small): (&Bench<'_>, &Bench<'_>, &Bench<'_>),
    ends: &mut Vec<End>,
    told: bool,
    progress: &mut dyn Progress,
) -> Result<Explored, DynamicError> {
    let Some(home) = best(ends).map(End::restart) else { return Ok(Explored::No) };
    let mut beside = Beside { small, progress: &mut *progress };
    let Ok(start) = small.solve(&home, None) else { return Ok(Explored::No) };
    let mut found = vec![Search::new(small, &mut beside, start).run()?];
    let known = ordered(&bench.twins, &found[0].restart());
    let looked = look_around((small, small), &mut found, (told, CLOSE), &mut beside)?;
    found.sort_by(|a, b| b.home.value().total_cmp(&a.home.value()));
    let highest = found[0].home.value();
    let near = found.iter().filter(|end| highest - end.home.value() <= CLOSE).map(End::restart);
    let elsewhere = near.filter(|values| !alike(&ordered(&bench.twins, values), &known, ALIKE));
    for values in elsewhere.take(FOLLOWED) {
        let floor = best(ends).map(|best| best.home.value() + RISE);
        let Ok(home) = hybrid.solve(&values, None) else { continue };
        if progress.stops() {
            return Ok(Explored::Part);
        }
        let end = Search::new(hybrid, progress, home).beyond(floor).run()?;
        if is_higher(&end, floor) {
            ends.push(by_method(bench, end, progress)?);
        }
    }
    Ok(if looked == Explored::Whole { Explored::Sample } else { looked })
}

/// A certified end above another.
fn is_higher(end: &End, floor: Option<f64>) -> bool {
    end.stop == Stop::Certified && floor.is_none_or(|floor| end.home.value() > floor)
}

/// The end by the method that was asked for.
fn by_method(bench: &Bench<'_>, found: End, progress: &mut dyn Progress) -> Result<End, DynamicError> {
    match bench.settings.method {
        Method::Hybrid => Ok(found),
        _ => search(bench, found.restart().into(), None, progress),
    }
}

/// The best end that is found around another while a value is held; the other where none is higher.
pub(super) fn around(bench: &Bench<'_>, end: End, held: usize) -> End {
    let most = bench.filter_passes() + most(bench);
    let floor = end.home.value() + RISE;
    let mut places = places(bench, &end, Some(held), &mut Silent);
    places.extend(start::from_data(bench, Some((held, end.home.values[held])), &mut Silent));
    let mut found = places.into_iter().take_while(|_| bench.filter_passes() < most).filter_map(|place| {
        let (home, mut silent) = (bench.solve(&place, None).ok()?, Silent);
        let mut search = Search::new(bench, &mut silent, home).beyond(Some(floor));
        search.hold(held);
        search.run().ok().filter(|found| found.stop == Stop::Certified && found.home.value() > floor)
    });
    found.next().unwrap_or(end)
}

/// Other maxima are within reach of the runs that may be spent.
fn is_possible(bench: &Bench<'_>) -> bool {
    most(bench) > 0
}

/// Runs of the filters that may be spent; none where they are too few for a search.
fn most(bench: &Bench<'_>) -> usize {
    let rows = bench.rows().max(1);
    let runs = (ROWS / rows).min(RUNS).max((FEW_ROWS / rows).min(MORE_RUNS));
    if runs < FEWEST || bench.slots.len() > VALUES { 0 } else { runs }
}

/// Adds ends that are higher than the best one, or no further below it than by `slack`; `told`: all start values were given.
fn look_around(
    (bench, hybrid): (&Bench<'_>, &Bench<'_>),
    ends: &mut Vec<End>,
    (told, slack): (bool, f64),
    progress: &mut dyn Progress,
) -> Result<Explored, DynamicError> {
    let most = most(bench);
    let mut tried: Vec<Vec<f64>> = ends.iter().map(|end| end.home.values.clone()).collect();
    for round in 0..ROUNDS {
        let best = best(ends);
        let mut places = best.map_or_else(Vec::new, |best| places(hybrid, best, None, progress));
        if round == 0 && told {
            places.extend(start::from_data(bench, None, progress));
        }
        let floor = best.map(|best| best.home.value() + RISE);
        let mut higher = false;
        for place in places {
            if hybrid.filter_passes() >= most || progress.stops() {
                return Ok(Explored::Part);
            }
            let place = ordered(&bench.twins, &place);
            if tried.iter().any(|other| other == &place) {
                continue;
            }
            tried.push(place.clone());
            let Ok(home) = hybrid.solve(&place, None) else { continue };
            let within = floor.map(|floor| floor - slack);
            let found = Search::new(hybrid, progress, home).beyond(within).run()?;
            if !is_higher(&found, within) {
                continue;
            }
            higher = is_higher(&found, floor);
            ends.push(if higher { by_method(bench, found, progress)? } else { found });
            if higher {
                break;
            }
        }
        if !higher {
            return Ok(Explored::Whole);
        }
    }
    Ok(Explored::Part)
}

/// The best certified end.
pub(super) fn best(ends: &[End]) -> Option<&End> {
    let certified = ends.iter().filter(|end| end.stop == Stop::Certified);
    certified.max_by(|a, b| a.home.value().total_cmp(&b.home.value()))
}

/// Where to look from an end: at common values but the one that is held.
fn places(bench: &Bench<'_>, end: &End, held: Option<usize>, progress: &mut dyn Progress) -> Vec<Vec<f64>> {
    let values = &end.home.values;
    let (mut all, mut bases) = (Vec::new(), vec![values.clone()]);
    for twins in &bench.twins {
        let Some(one) = twins.merged(values, &bench.coordinates) else { continue };
        all.push(one.clone());
        all.extend(set_apart(bench, &one, twins, progress));
        bases.push(one);
    }
    let is_level = |s: &usize| {
        let coordinate = &bench.coordinates[*s];
        let common = bench.slots.slots()[*s].level.is_none();
        common && coordinate.level.is_some() && coordinate.lower == 0.0 && held != Some(*s)
    };
    let levels: Vec<usize> = (0..values.len()).filter(is_level).collect();
    let timed = !time_constants(bench.model).is_empty();
    for &s in levels.iter().filter(|&&s| values[s] > 0.0 && timed && drives(bench, s)) {
        let mut without = values.clone();
        without[s] = 0.0;
        all.push(without);
    }
    for t in (0..values.len()).filter(|&t| bench.edges.has(t) && held != Some(t)) {
        all.extend(other_parts(values, t));
    }
    for &s in levels.iter().filter(|&&s| values[s] > 0.0 && !drives(bench, s) && is_crossed(bench, s)) {
        let mut without = values.clone();
        without[s] = 0.0;
        all.push(without);
    }
    all.extend(given_back(bench, end, &levels));
    for &s in &levels {
        all.extend(sizes(bench, end, (s, bench.units()[s])));
    }
    let is_open = |parameter: usize| bench.slots.common(parameter).is_some_and(|s| held != Some(s));
    for parameter in time_constants(bench.model).into_iter().filter(|&p| is_open(p)) {
        all.extend(other_maxima(bench, parameter, values, progress));
        all.extend(less_white(bench, end, parameter, progress));
        for base in &bases {
            all.extend(
                levels.iter().filter_map(|&s| taken_over(bench, (base, end.home.value()), s, parameter, progress)),
            );
        }
    }
    // whatever moved it
    all.retain(|place| held.is_none_or(|s| place[s] == values[s]));
    all
}

/// Of two processes that coincide one has taken the variance of both, and the other one may be of any size and shape beside it.
fn set_apart(bench: &Bench<'_>, one: &[f64], twins: &Twins, progress: &mut dyn Progress) -> Vec<Vec<f64>> {
    let (Some(level), Some(shape)) = (twins.freed(&bench.coordinates), twins.shape(&bench.coordinates)) else {
        return Vec::new();
    };
    let of_size = |size: &f64| {
        let mut beside = one.to_vec();
        beside[level] = (size * bench.units()[level]).min(bench.coordinates[level].upper);
        beside
    };
    let parameter = bench.slots.slots()[shape].parameter;
    let found = SIZES.iter().flat_map(|size| other_maxima(bench, parameter, &of_size(size), progress));
    let valued = found.filter_map(|place| Some((bench.value(&place)?, place)));
    let mut valued: Vec<(f64, Vec<f64>)> = valued.collect();
    valued.sort_by(|a, b| b.0.total_cmp(&a.0));
    valued.into_iter().take(APART_TRIED).map(|(_, place)| place).collect()
}

/// Processes in the place of a measurement's noise, which is at zero, given back to it: they may return in another shape.
fn given_back(bench: &Bench<'_>, end: &End, levels: &[usize]) -> Vec<Vec<f64>> {
    let (driving, still): (Vec<usize>, Vec<usize>) = levels.iter().partition(|&&s| drives(bench, s));
    let (values, coordinates) = (&end.home.values, &bench.coordinates);
    let back = |s: usize, t: usize| -> Option<Vec<f64>> {
        let (from, to) = (coordinates[t].level?, coordinates[s].level?);
        let mut given = values.clone();
        given[s] = values[t].powf(from / to).clamp(coordinates[s].lower, coordinates[s].upper);
        given[t] = 0.0;
        Some(given)
    };
    let zeros = still.into_iter().filter(|&s| end.is_at_zero(s));
    let pairs = zeros.flat_map(|s| driving.iter().filter(|&&t| values[t] > 0.0).map(move |&t| (s, t)));
    pairs.filter_map(|(s, t)| back(s, t)).collect()
}

/// A process that is all but white, with the time constant that suits it best among those from which it is told apart from white noise.
fn less_white(bench: &Bench<'_>, end: &End, time_constant: usize, progress: &mut dyn Progress) -> Option<Vec<f64>> {
    let (slot, height) = (bench.slots.common(time_constant)?, end.home.value());
    let mut shorter = end.home.values.clone();
    shorter[slot] = bench.coordinates[slot].moved(shorter[slot], -FACTOR.ln());
    let is_white = (bench.value(&shorter)? - height).abs() <= WHITE;
    let (best, value) = best_of(bench, time_constant, &end.home.values, progress).filter(|_| is_white)?;
    ((value - height).abs() <= LEVEL).then(|| longer(bench, time_constant, (best, value), progress))
}

/// Noise of a measurement, in the level `s`, taken over by a process with this time constant in the shape that suits it best; `height`: ℓ
/// before.
fn taken_over(
    bench: &Bench<'_>,
    (values, height): (&[f64], f64),
    s: usize,
    time_constant: usize,
    progress: &mut dyn Progress,
) -> Option<Vec<f64>> {
    let taker =
        bench.model.phases.iter().flat_map(|phase| &phase.model.states).find_map(|state| match &state.motion {
            Motion::Constant => None,
            Motion::Continuous { derivative: motion, noise_variance }
            | Motion::Discrete { next: motion, noise_variance } => {
                let timed = motion.terms.iter().any(|(_, term)| mentions(term, time_constant));
                let mentioned = |t: &usize| mentions(noise_variance, bench.slots.slots()[*t].parameter);
                let level = |t: &usize| bench.coordinates[*t].level.is_some() && mentioned(t);
                (0..values.len()).find(level).filter(|_| timed)
            }
        })?;
    if values[s] == 0.0 || drives(bench, s) {
        return None;
    }
    let (from, to) = (bench.coordinates[s].level?, bench.coordinates[taker].level?);
    let mut over = values.to_vec();
    over[taker] = values[s].powf(from / to).clamp(bench.coordinates[taker].lower, bench.coordinates[taker].upper);
    over[s] = 0.0;
    let best = best_of(bench, time_constant, &over, progress)?;
    // no higher and no lower: white as the noise was, and the way up may be close by
    let is_level = (best.1 - height).abs() <= LEVEL;
    Some(if is_level { longer(bench, time_constant, best, progress) } else { best.0 })
}

/// Other parts of what a covariance of noises may be: of the other sign, say.
fn other_parts(values: &[f64], t: usize) -> impl Iterator<Item = Vec<f64>> {
    let apart = PARTS.into_iter().filter(move |part| (part - values[t]).abs() > APART);
    apart.map(move |part| {
        let mut other = values.to_vec();
        other[t] = part;
        other
    })
}

/// A level of a noise that has a free covariance with another.
fn is_crossed(bench: &Bench<'_>, s: usize) -> bool {
    !bench.edges.beside(bench.slots.slots()[s].parameter).is_empty()
}

/// A level of the motion of some state.
fn drives(bench: &Bench<'_>, s: usize) -> bool {
    let parameter = bench.slots.slots()[s].parameter;
    bench.model.phases.iter().flat_map(|phase| &phase.model.states).any(|state| match &state.motion {
        Motion::Constant => false,
        Motion::Continuous { noise_variance, .. } | Motion::Discrete { noise_variance, .. } => {
            mentions(noise_variance, parameter)
        }
    })
}

/// Other sizes of a level, the rest as it is, where ℓ is higher than at the sizes beside them.
fn sizes(bench: &Bench<'_>, end: &End, (s, unit): (usize, f64)) -> Vec<Vec<f64>> {
    let value = end.home.values[s];
    if value > 0.0 && !end.is_at_zero(s) {
        return Vec::new();
    }
    let at = |size: &f64| {
        let mut values = end.home.values.clone();
        values[s] = (size * unit).clamp(bench.coordinates[s].lower, bench.coordinates[s].upper);
        values
    };
    let places: Vec<Vec<f64>> = SIZES.iter().map(at).collect();
    let heights: Vec<f64> = places.iter().map(|place| bench.value(place).unwrap_or(f64::NEG_INFINITY)).collect();
    let beside = |k: usize, other: Option<usize>| other.and_then(|o| heights.get(o)).is_none_or(|h| *h < heights[k]);
    let peak = |k: &usize| heights[*k].is_finite() && beside(*k, k.checked_sub(1)) && beside(*k, Some(k + 1));
    // the smallest size is beside zero
    let last = SIZES.len() - 1;
    (0..SIZES.len())
        .filter(peak)
        .filter(|k| *k < last || heights[last] > end.home.value())
        .map(|k| places[k].clone())
        .collect()
}

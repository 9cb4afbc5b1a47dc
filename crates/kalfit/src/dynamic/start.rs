//! Start values of α: the model file's where it gives them, else worked out from the data.
//!
//! Scales come from the spread of what was measured and from the lengths of steps and records; then each value without a start
//! is tried over many powers of ten, cheaply: on a part of the data, with μ and Σ solved for each.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::dynamic::balance::balance;
use crate::dynamic::bench::Bench;
use crate::dynamic::glide::Curvature;
use crate::dynamic::search::{End, search};
use crate::dynamic::twins::ordered;
use crate::dynamic::{Coordinate, DynamicError};
use crate::ensemble::Test;
use crate::estimate::{Progress, Stage, Step};
use crate::model::{Expression, Linear, Motion, Operator, PhasedModel, State, Value};
use crate::reduce::{Evidence, PhasedTest};

/// Ends on a part of the data whose ℓ is this close to the best one's are followed on all of it.
const CLOSE: f64 = 5.0;
/// … so many of them, none but those that differ by more than this part.
const FOLLOWED: usize = 3;
const ALIKE: f64 = 2e-2;
/// Rows that start values are worked out from, and rows of one test among them.
const ROWS: usize = 100_000;
const ROWS_OF_A_TEST: usize = 20_000;
/// Where values are common to all tests, these rows are enough if they are of so many tests.
const ROWS_OF_MANY: usize = 20_000;
const MANY: usize = 256;
/// Powers of this factor are tried, so many to each side.
pub(super) const FACTOR: f64 = 4.0;
const EACH_SIDE: i32 = 6;
/// Points scattered about the first guess, and their spread: standard deviation of a logarithm.
const SCATTERED: usize = 40;
const WIDE: f64 = 2.5;
/// Spread of random starts: standard deviation of a logarithm.
const SPREAD: f64 = 1.5;
/// Values other than logarithms that are tried where none is given.
const TRIED: [f64; 5] = [0.0, 0.5, 0.9, -0.5, 1.0];

/// Where a search begins.
#[derive(Debug, Clone)]
pub(crate) struct Start {
    pub(crate) values: Vec<f64>,
    /// How ℓ curves about it, as far as a part of the data tells.
    pub(crate) curvature: Option<Curvature>,
}

impl From<Vec<f64>> for Start {
    fn from(values: Vec<f64>) -> Start {
        Start { values, curvature: None }
    }
}

/// Start values, the likeliest first: the one worked out from the data, others where the likelihood looks to have other maxima
/// in a time constant, and as many random ones as the settings say.
pub(crate) fn starts(bench: &Bench<'_>, progress: &mut dyn Progress) -> Result<Vec<Start>, DynamicError> {
    let common = bench.slots.slots().iter().all(|slot| slot.level.is_none());
    let sample = sample(bench.tests, common);
    let small = Bench::new(bench.model, &sample, bench.slots, bench.settings);
    let mut first = guess(bench, true);
    let unknown = unknown(bench);
    let mut peaks = Vec::new();
    if !unknown.is_empty() {
        peaks = balance(&small, &unknown, &mut first, progress);
        for _ in 0..unknown.len().min(2) {
            unknown.iter().for_each(|&parameter| scan(&small, parameter, &mut first, progress));
        }
    }
    if small.value(&first).is_none() {
        bench.solve(&first, None)?; // says what is wrong
    }
    let mut all = vec![first.clone()];
    if !unknown.is_empty() {
        all.extend(peaks.into_iter().take(1));
    }
    if unknown.len() > 1 {
        all.extend(scattered(&small, &unknown, &first, progress)); // of one alone the scan has seen all
    }
    for parameter in time_constants(bench.model).into_iter().filter(|&p| bench.slots.is_free(p)) {
        all.extend(other_maxima(&small, parameter, &first, progress));
    }
    all.extend((0..bench.settings.starts).map(|k| random(bench, &first, k)));
    if total(&sample) == total(bench.tests) {
        return Ok(all.into_iter().map(Start::from).collect());
    }
    // values that were given are one start, whatever a part of the data makes of them
    let free = (0..bench.model.shared().parameters.len()).filter(|&p| bench.slots.is_free(p)).count();
    let given = (unknown.len() < free).then(|| Start::from(all.remove(0)));
    let more = bench.rows() as f64 / small.rows() as f64;
    Ok(given.into_iter().chain(promising(&small, all, more, progress)).collect())
}

/// Starts from the data alone, whatever values were given.
pub(crate) fn from_data(bench: &Bench<'_>, progress: &mut dyn Progress) -> Vec<Vec<f64>> {
    let all: Vec<usize> = (0..bench.model.shared().parameters.len()).filter(|&p| bench.slots.is_free(p)).collect();
    let common = bench.slots.slots().iter().all(|slot| slot.level.is_none());
    let sample = sample(bench.tests, common);
    let small = Bench::new(bench.model, &sample, bench.slots, bench.settings);
    let mut first = guess(bench, false);
    let peaks = balance(&small, &all, &mut first, progress);
    all.iter().for_each(|&parameter| scan(&small, parameter, &mut first, progress));
    let mut starts = vec![first.clone()];
    starts.extend(peaks.into_iter().take(1));
    starts.extend(scattered(&small, &all, &first, progress));
    starts
}

/// ℓ at start values; whoever waits hears of it, and nothing more is tried once nobody does.
pub(super) fn tried(small: &Bench<'_>, values: &[f64], progress: &mut dyn Progress) -> Option<f64> {
    progress.stage(Stage::StartValues { filter_runs: small.filter_passes() });
    if progress.stops() { None } else { small.value(values) }
}

/// Listens to a search on a part of the data: it is about start values still.
struct Beside<'a, 'b> {
    small: &'a Bench<'b>,
    progress: &'a mut dyn Progress,
}

impl Progress for Beside<'_, '_> {
    fn stage(&mut self, _: Stage) {
        self.progress.stage(Stage::StartValues { filter_runs: self.small.filter_passes() });
    }

    fn step(&mut self, _: Step) {
        self.progress.stage(Stage::StartValues { filter_runs: self.small.filter_passes() });
    }

    fn stops(&self) -> bool {
        self.progress.stops()
    }
}

fn total(tests: &[PhasedTest]) -> usize {
    tests.iter().map(rows).sum()
}

/// Rows of all phases.
fn rows(test: &PhasedTest) -> usize {
    test.phases.iter().map(|evidence| if let Evidence::Rows(test) = evidence { test.rows() } else { 0 }).sum()
}

/// Of many starts, where the best ones end on a part of the data, and how ℓ curves there on `more` times as many; all of them when
/// they all fail there.
fn promising(small: &Bench<'_>, starts: Vec<Vec<f64>>, more: f64, progress: &mut dyn Progress) -> Vec<Start> {
    let mut beside = Beside { small, progress };
    let begun = starts.iter().map(|start| search(small, start.clone().into(), None, &mut beside));
    let mut ends: Vec<End> = begun.flatten().collect();
    ends.sort_by(|a, b| b.home.value().total_cmp(&a.home.value()));
    let Some(best) = ends.first().map(|end| end.home.value()) else {
        return starts.into_iter().map(Start::from).collect();
    };
    let (mut kept, mut seen): (Vec<Start>, Vec<Vec<f64>>) = Default::default();
    for end in ends.into_iter().filter(|end| best - end.home.value() <= CLOSE) {
        let values = end.restart();
        let place = ordered(&small.twins, &values);
        let same =
            |other: &Vec<f64>| other.iter().zip(&place).all(|(a, b)| (a - b).abs() <= ALIKE * a.abs().max(b.abs()));
        if kept.len() < FOLLOWED && !seen.iter().any(same) {
            let curvature = Curvature::of(&end.joint).map(|curvature| curvature.times(more));
            kept.push(Start { values, curvature });
            seen.push(place);
        }
    }
    kept
}

/// The first rows of every phase of every test, as many tests as fit; `common`: values are common to all tests.
fn sample(tests: &[PhasedTest], common: bool) -> Vec<PhasedTest> {
    let mut order: Vec<&PhasedTest> = tests.iter().collect();
    order.sort_by(|a, b| a.id.cmp(&b.id));
    let first = |evidence: &Evidence| match evidence {
        Evidence::Rows(test) => Evidence::Rows(test.first(ROWS_OF_A_TEST)),
        other => other.clone(),
    };
    let mut many = 0;
    let mut sample = Vec::new();
    for test in order {
        let kept = PhasedTest { id: test.id.clone(), phases: test.phases.iter().map(first).collect() };
        many += rows(&kept);
        sample.push(kept);
        if many > ROWS || (common && many > ROWS_OF_MANY && sample.len() >= MANY) {
            break;
        }
    }
    sample
}

/// Every free parameter has a start value.
pub(crate) fn all_given(bench: &Bench<'_>) -> bool {
    unknown(bench).is_empty()
}

/// Parameters without a start value, by index.
fn unknown(bench: &Bench<'_>) -> Vec<usize> {
    let told = |value: Value, log: bool| match value {
        Value::Free { start: Some(start) } => !(log && start == 0.0), // a logarithm cannot start at zero
        Value::Free { start: None } => false,
        Value::Fixed(_) => true,
    };
    let parameters = bench.model.shared().parameters.iter().enumerate();
    parameters.filter(|(p, what)| bench.slots.is_free(*p) && !told(what.value, what.positive)).map(|(p, _)| p).collect()
}

/// A first value for each slot: those that were given where they are to be heeded.
fn guess(bench: &Bench<'_>, heeded: bool) -> Vec<f64> {
    let scales = Scales::of(bench);
    let one = |(s, slot): (usize, &crate::score::Slot)| {
        let parameter = &bench.model.shared().parameters[slot.parameter];
        let coordinate = bench.coordinates[s];
        if bench.edges.has(s) {
            // the value itself, which is no part of the edge yet
            return if let Value::Free { start: Some(start) } = parameter.value { start } else { 0.0 };
        }
        let guess = match parameter.value {
            Value::Free { start: Some(start) } if heeded && !(coordinate.log && start == 0.0) => start,
            _ if coordinate.log || is_noise(bench.model, slot.parameter) => scales.guess(bench.model, slot.parameter),
            _ => 0.0,
        };
        inside(coordinate, guess)
    };
    let values: Vec<f64> = bench.slots.slots().iter().enumerate().map(one).collect();
    bench.sought(&values)
}

/// A start value strictly between the bounds where that is possible.
fn inside(coordinate: Coordinate, value: f64) -> f64 {
    if value > coordinate.lower && value < coordinate.upper {
        return value;
    }
    match (coordinate.lower.is_finite(), coordinate.upper.is_finite()) {
        (true, true) => 0.5 * (coordinate.lower + coordinate.upper),
        (true, false) if coordinate.log => 2.0 * coordinate.lower.max(0.5),
        (true, false) => coordinate.lower + 1.0,
        (false, true) => coordinate.upper - 1.0,
        (false, false) => value,
    }
}

/// Sizes found in the data.
pub(crate) struct Scales {
    /// Of the differences of successive measured values, by phase and measurement.
    noise: Vec<Vec<f64>>,
    /// Median length of a step.
    step: f64,
    /// Median length of a phase of a test.
    span: f64,
}

impl Scales {
    pub(crate) fn of(bench: &Bench<'_>) -> Scales {
        let noise_of = |at: usize| -> Vec<f64> {
            let columns = bench.model.phases[at].model.measurements.iter().map(|m| m.column);
            columns.map(|column| differences(&phase_rows(bench, at), column)).collect()
        };
        let noise = (0..bench.model.phases.len()).map(noise_of).collect();
        let (mut steps, mut spans) = (Vec::new(), Vec::new());
        for (at, phase) in bench.model.phases.iter().enumerate() {
            let Some(time) = phase.model.clock.time else { continue };
            for test in phase_rows(bench, at) {
                let times: Vec<f64> = (0..test.rows().min(ROWS_OF_A_TEST)).map(|row| test.numbers(row)[time]).collect();
                steps.extend(times.windows(2).map(|pair| pair[1] - pair[0]).filter(|d| *d > 0.0));
                let last = test.rows().checked_sub(1).map(|row| test.numbers(row)[time]);
                spans.extend(last.zip(times.first()).map(|(last, first)| last - first).filter(|d| *d > 0.0));
            }
        }
        Scales { noise, step: median(steps).unwrap_or(1.0), span: median(spans).unwrap_or(1.0) }
    }

    /// Times from a part of the length of a step to so many times that of a test, each `factor` times the one before.
    pub(crate) fn range(&self, part: f64, spans: f64, factor: f64) -> impl Iterator<Item = f64> + use<> {
        let (first, last) = (part * self.step, spans * self.span.max(self.step));
        (0..).map(move |k| first * factor.powi(k)).take_while(move |time| *time <= last)
    }

    /// A value for a positive parameter.
    pub(crate) fn guess(&self, model: &PhasedModel, parameter: usize) -> f64 {
        if time_constants(model).contains(&parameter) {
            return (self.step * self.span).sqrt();
        }
        let measurements =
            model.phases.iter().zip(&self.noise).flat_map(|(p, noise)| p.model.measurements.iter().zip(noise));
        let own = measurements.into_iter().find(|(m, _)| mentions(&m.noise_variance, parameter));
        if let Some((measurement, &size)) = own {
            // the variance is the square of the parameter, or the parameter itself
            let as_variance = !is_square(&measurement.noise_variance);
            return if as_variance { size * size } else { size };
        }
        let sizes = self.noise.iter().flatten().copied().filter(|size| *size > 0.0);
        let all = median(sizes.collect()).unwrap_or(1.0);
        let variance = |motion: &Motion| match motion {
            Motion::Continuous { noise_variance, .. } | Motion::Discrete { noise_variance, .. } => {
                *noise_variance == Expression::Parameter(parameter)
            }
            Motion::Constant => false,
        };
        if states(model).any(|state| variance(&state.motion)) { all * all } else { all }
    }
}

/// The states of all phases.
fn states(model: &PhasedModel) -> impl Iterator<Item = &State> {
    model.phases.iter().flat_map(|phase| &phase.model.states)
}

/// The rows of one phase, of the tests that have them, in an order that does not depend on theirs: sums over them begin the search.
fn phase_rows<'a>(bench: &Bench<'a>, at: usize) -> Vec<&'a Test> {
    let tests = bench.tests;
    let evidence = bench.order().iter().filter_map(|&j| tests[j].phases.get(at));
    evidence.filter_map(|evidence| if let Evidence::Rows(rows) = evidence { Some(rows) } else { None }).collect()
}

/// Whether a parameter stands in the variance of a noise.
fn is_noise(model: &PhasedModel, parameter: usize) -> bool {
    let mut measurements = model.phases.iter().flat_map(|phase| &phase.model.measurements);
    measurements.any(|m| mentions(&m.noise_variance, parameter))
        || states(model).any(|state| match &state.motion {
            Motion::Constant => false,
            Motion::Continuous { noise_variance, .. } | Motion::Discrete { noise_variance, .. } => {
                mentions(noise_variance, parameter)
            }
        })
}

/// A variance that was given as a standard deviation.
fn is_square(variance: &Expression) -> bool {
    matches!(variance, Expression::Binary(Operator::Multiply, a, b) if a == b)
}

/// Root mean square of the differences of successive values within tests, over √2.
fn differences(tests: &[&Test], column: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for test in tests {
        let mut last = f64::NAN;
        for row in 0..test.rows().min(ROWS_OF_A_TEST) {
            let value = test.numbers(row)[column];
            if !value.is_nan() {
                if !last.is_nan() {
                    sum += (value - last).powi(2);
                    count += 2.0;
                }
                last = value;
            }
        }
    }
    let size: f64 = if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 };
    if size > 0.0 && size.is_finite() { size } else { 1.0 }
}

fn median(mut list: Vec<f64>) -> Option<f64> {
    list.sort_by(f64::total_cmp);
    list.get(list.len() / 2).copied()
}

pub(super) fn mentions(expression: &Expression, parameter: usize) -> bool {
    expression.any(&mut |part| matches!(part, Expression::Parameter(index) if *index == parameter))
}

/// Positive parameters that the coefficients of a motion depend on.
pub(crate) fn time_constants(model: &PhasedModel) -> Vec<usize> {
    let motion = |linear: &Linear, parameter| linear.terms.iter().any(|(_, h)| mentions(h, parameter));
    let used = |parameter: usize| {
        states(model).any(|state| match &state.motion {
            Motion::Constant => false,
            Motion::Continuous { derivative, .. } => motion(derivative, parameter),
            Motion::Discrete { next, .. } => motion(next, parameter),
        })
    };
    let parameters = &model.shared().parameters;
    (0..parameters.len()).filter(|&p| parameters[p].positive && used(p)).collect()
}

/// All levels of one parameter over many powers of a factor.
fn scan(small: &Bench<'_>, parameter: usize, values: &mut Vec<f64>, progress: &mut dyn Progress) {
    let tries = std::iter::once(values.clone()).chain(grid(small, parameter, values));
    if let Some((best, _)) = best(small, tries, progress) {
        *values = best;
    }
}

/// The best of the same with all levels of one parameter over many powers of a factor.
pub(super) fn best_of(
    bench: &Bench<'_>,
    parameter: usize,
    values: &[f64],
    progress: &mut dyn Progress,
) -> Option<Vec<f64>> {
    best(bench, grid(bench, parameter, values).into_iter(), progress).map(|(values, _)| values)
}

fn grid(small: &Bench<'_>, parameter: usize, values: &[f64]) -> Vec<Vec<f64>> {
    let own = |s: usize| small.slots.slots()[s].parameter == parameter;
    let with = |change: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
        values.iter().enumerate().map(|(s, &v)| if own(s) { change(s, v) } else { v }).collect()
    };
    if (0..values.len()).any(|s| own(s) && small.coordinates[s].log) {
        (-EACH_SIDE..=EACH_SIDE)
            .map(|k| with(&|s, v| small.coordinates[s].moved(v, f64::from(k) * FACTOR.ln())))
            .collect()
    } else {
        TRIED.iter().map(|&x| with(&|s, _| inside(small.coordinates[s], x))).collect()
    }
}

fn best(
    small: &Bench<'_>,
    tries: impl Iterator<Item = Vec<f64>>,
    progress: &mut dyn Progress,
) -> Option<(Vec<f64>, f64)> {
    let valued = tries.filter_map(|values| tried(small, &values, progress).map(|value| (values, value)));
    valued.fold(None, |best: Option<(Vec<f64>, f64)>, next| match best {
        Some(best) if best.1 >= next.1 => Some(best),
        _ => Some(next),
    })
}

/// Starts where ℓ over the powers of a time constant has other maxima than at the first start.
pub(super) fn other_maxima(
    small: &Bench<'_>,
    parameter: usize,
    first: &[f64],
    progress: &mut dyn Progress,
) -> Vec<Vec<f64>> {
    let grid = grid(small, parameter, first);
    let values: Vec<f64> = grid.iter().map(|v| tried(small, v, progress).unwrap_or(f64::NEG_INFINITY)).collect();
    let at = |k: usize| values.get(k).copied().unwrap_or(f64::NEG_INFINITY);
    let peak = |&k: &usize| values[k].is_finite() && (k == 0 || at(k - 1) < values[k]) && at(k + 1) < values[k];
    let middle = EACH_SIDE as usize;
    let near = |k: usize| k.abs_diff(middle) <= 1;
    (0..values.len()).filter(peak).filter(|&k| !near(k)).take(3).map(|k| grid[k].clone()).collect()
}

/// The best of some points scattered widely about the first guess: noise may lie in the measurements or in the motion, and
/// a search that begins with one may end there.
fn scattered(small: &Bench<'_>, unknown: &[usize], first: &[f64], progress: &mut dyn Progress) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let mut found: Vec<(Vec<f64>, f64)> = Vec::new();
    for _ in 0..SCATTERED {
        // all levels of a parameter together
        let draws: Vec<f64> =
            small.model.shared().parameters.iter().map(|_| StandardNormal.sample(&mut random)).collect();
        let moved = |(s, value): (usize, &f64)| {
            let parameter = small.slots.slots()[s].parameter;
            let own = unknown.contains(&parameter) && small.coordinates[s].log;
            if own { small.coordinates[s].moved(*value, WIDE * draws[parameter]) } else { *value }
        };
        let values: Vec<f64> = first.iter().enumerate().map(moved).collect();
        if let Some(value) = tried(small, &values, progress) {
            found.push((values, value));
        }
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.into_iter().take(2).map(|(values, _)| values).collect()
}

/// Random start `k`: logarithms moved by normal numbers, other values by their own size. A stream of its own for each.
fn random(bench: &Bench<'_>, first: &[f64], k: usize) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(bench.settings.seed);
    random.set_stream(k as u64);
    let moved = |(s, value): (usize, &f64)| {
        let draw: f64 = StandardNormal.sample(&mut random);
        let coordinate = bench.coordinates[s];
        coordinate.moved(*value, if coordinate.log { SPREAD * draw } else { draw * value.abs().max(0.5) })
    };
    first.iter().enumerate().map(moved).collect()
}

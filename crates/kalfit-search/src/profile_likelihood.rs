//! ℓ(α): the reductions at α, the maximum of ℓ over (μ, Σ) on the reductions, and dℓ/dα. The filters run only when α
//! moves.

use std::borrow::Cow;
use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use nalgebra::DVector;
use rayon::prelude::*;

use crate::before_runs::BeforeRuns;
use crate::correlation_bounds::CorrelationBounds;
use crate::exact::add_exact;
use crate::exchangeable::ExchangeablePair;
use crate::indirect::{Around, Indirect};
use crate::matrices;
use crate::matrices::matrix_gradient;
use crate::scale;
use crate::scale::{AtScale, Scale};
use crate::scales::Scales;
use crate::{Coordinate, DynamicError, Settings};
use kalfit_estimate as estimate;
use kalfit_estimate::{Criterion, Estimate, FitError, NoiseInformation, Silent, Structure};
use kalfit_filter::reduce::{FilteredPhases, PhasedReducer, Reductions, grouping};
use kalfit_filter::score::InitialLaw;
use kalfit_filter::score::{Batching, Gradient, Levels, PhasedComplete, PhasedScorer, carried};
use kalfit_model::Grouping;
use kalfit_model::PhasedTest;
use kalfit_model::remote::{Answers, Question, Remote};
use kalfit_model::{Alpha, PhasedModel, Population, Slots};

/// Number of tests up to which an ensemble is narrow: threads then work at several α at once.
const NARROW_TESTS: usize = 64;
/// Number of rows, and of tests, up to which an ensemble is narrow in any case.
const NARROW_ROWS: usize = 1 << 15;
/// Maximal number of rows in work at a time, over all threads, for an ensemble to be narrow.
const MAX_ROWS_IN_WORK: usize = 1 << 24;

/// An ensemble and a model, ready to evaluate ℓ(α).
#[derive(Debug)]
pub struct ProfileLikelihood<'a> {
    /// The model.
    pub model: &'a PhasedModel,
    /// The tests; none where they are remote.
    pub tests: &'a [PhasedTest],
    /// The free values of α.
    pub slots: &'a Slots,
    /// Coordinate and bounds of each free value.
    pub coordinates: Vec<Coordinate>,
    pub(crate) settings: &'a Settings,
    /// Covariances of noises, which are sought relative to the edge.
    pub edges: CorrelationBounds,
    /// Slots of the levels that a known covariance bounds from below.
    pub(crate) lower_bounded: BTreeSet<usize>,
    /// Pairs of exchangeable processes.
    pub twins: Vec<ExchangeablePair>,
    /// Groups of the tests, where the model has levels.
    grouping: Option<Arc<Grouping>>,
    units: OnceLock<Vec<f64>>,
    scales: OnceLock<Scales>,
    order: OnceLock<Vec<usize>>,
    indirect: Indirect,
    scale: Option<Scale>,
    /// Answers of remote tests; `None` where the tests are here.
    answers: Option<Arc<Answers>>,
    batching: Batching,
    /// Decides before each run of the filters whether it is made.
    before_runs: Option<BeforeRuns<'a>>,
    filter_passes: AtomicUsize,
    score_passes: AtomicUsize,
    passes: AtomicUsize,
    /// ℓ at the points that were tried, by the bits of the values.
    tried: Mutex<HashMap<Vec<u64>, Option<f64>>>,
}

/// Results of the filters for an ensemble at one α.
pub struct Reduced {
    /// The reducer of the tests; `None` where reductions were scaled from another α, or are remote.
    reducer: Option<PhasedReducer>,
    pub reductions: Reductions,
    /// Filter results in lanes, stored for the scores.
    filtered: Option<FilteredPhases>,
}

/// ℓ at α with its gradient, at the best (μ, Σ).
#[derive(Debug, Clone)]
pub struct ProfilePoint {
    /// The free values.
    pub values: Vec<f64>,
    pub(crate) alpha: Alpha,
    /// The best (μ, Σ) at this α.
    pub estimate: Estimate,
    /// dℓ/dcoordinate of each free value.
    pub gradient: Vec<f64>,
    pub(crate) second_derivatives: SecondDerivatives,
}

/// Results from which second derivatives are computed.
#[derive(Debug, Clone)]
pub(crate) enum SecondDerivatives {
    /// Reductions and scores of each test, at values of α whose differences give second derivatives.
    Tests(Box<TestResults>),
    /// Exact information on the only value, which scales all noise, and between that value and (μ, Σ) along the tangent
    /// basis. Results of each test are computed on request.
    Scale(NoiseInformation),
}

/// Reductions and scores of each test at an α.
#[derive(Debug, Clone)]
pub(crate) struct TestResults {
    pub(crate) reductions: Reductions,
    /// dℓ_j/dvalue.
    pub(crate) scores: Vec<Gradient>,
}

impl ProfilePoint {
    /// ℓ at the best (μ, Σ).
    pub fn value(&self) -> f64 {
        self.estimate.log_likelihood
    }
}

/// Gradients of ℓ near a solved α, at the (μ, Σ) of the solved α.
#[derive(Debug)]
pub(crate) struct FixedLawPoint {
    pub(crate) values: Vec<f64>,
    /// Gradient along the tangent basis of (μ, Σ) of the solved point.
    pub(crate) inner: DVector<f64>,
    pub(crate) tests: TestResults,
    /// dℓ/dvalue through matrices of the covariance structure.
    pub(crate) matrix: Gradient,
}

impl<'a> ProfileLikelihood<'a> {
    /// ℓ(α) of tests under a model.
    pub fn new(
        model: &'a PhasedModel,
        tests: &'a [PhasedTest],
        slots: &'a Slots,
        settings: &'a Settings,
    ) -> ProfileLikelihood<'a> {
        let zero = || AtomicUsize::new(0);
        let edges = CorrelationBounds::of(model, slots, tests);
        let mut coordinates = Coordinate::of(model, slots);
        edges.bound(&mut coordinates);
        let lower_bounded = CorrelationBounds::least(model, slots, tests);
        lower_bounded.iter().for_each(|&(s, least)| coordinates[s].lower = coordinates[s].lower.max(least));
        ProfileLikelihood {
            model,
            tests,
            slots,
            coordinates,
            edges,
            lower_bounded: lower_bounded.into_iter().map(|(s, _)| s).collect(),
            settings,
            twins: ExchangeablePair::of(model, slots),
            grouping: grouping(model, tests).ok().flatten().map(Arc::new), // errors of `grouping` are reported before
            units: OnceLock::new(),
            scales: OnceLock::new(),
            order: OnceLock::new(),
            indirect: Indirect::of(model, tests, slots),
            scale: Scale::of(model, tests, slots),
            answers: None,
            batching: Batching::default(),
            before_runs: None,
            filter_passes: zero(),
            score_passes: zero(),
            passes: zero(),
            tried: Mutex::default(),
        }
    }

    /// ℓ(α) of remote tests; `units`: the sizes of the values that the tests suggest.
    pub fn elsewhere(
        model: &'a PhasedModel,
        (slots, settings): (&'a Slots, &'a Settings),
        (answers, units): (&Arc<Answers>, Vec<f64>),
    ) -> ProfileLikelihood<'a> {
        let objective = ProfileLikelihood::new(model, &[], slots, settings);
        // all tests together stand for one test that depends on every value
        ProfileLikelihood {
            scale: None,
            order: vec![0].into(),
            answers: Some(answers.clone()),
            units: units.into(),
            ..objective
        }
    }

    /// This likelihood while `before_runs` allows runs of the filters; afterwards ℓ is nowhere defined.
    pub fn while_waited_for(self, before_runs: BeforeRuns<'a>) -> ProfileLikelihood<'a> {
        ProfileLikelihood { before_runs: Some(before_runs), ..self }
    }

    /// Fails when the caller no longer waits for results.
    fn check_waited_for(&self) -> Result<(), DynamicError> {
        let goes_on = self.before_runs.is_none_or(|BeforeRuns(asks)| asks(self.filter_passes()));
        if goes_on { Ok(()) } else { Err(DynamicError::Interrupted) }
    }

    /// The groups of the tests, where the model has levels.
    pub fn grouping(&self) -> Option<&Grouping> {
        self.grouping.as_deref()
    }

    /// Whether the tests are remote: only results of all of them together are known.
    pub(crate) fn is_remote(&self) -> bool {
        self.answers.is_some()
    }

    /// Whether a request to remote tests has no answer yet.
    pub(crate) fn is_waiting(&self) -> bool {
        self.answers.as_ref().is_some_and(|answers| answers.is_waiting())
    }

    /// Makes several independent requests; requests to remote tests are sent all at once.
    pub(crate) fn together<T>(&self, ask: impl FnOnce() -> T) -> T {
        match &self.answers {
            Some(answers) => answers.together(ask),
            None => ask(),
        }
    }

    /// Whether tests or rows are so few that threads had better work at several α at once, and not too many rows are
    /// then in work.
    pub(crate) fn is_parallel_over_alpha(&self) -> bool {
        let (threads, rows) = (rayon::current_num_threads(), self.rows());
        let is_small = self.tests.len() <= NARROW_TESTS || rows.max(self.tests.len()) <= NARROW_ROWS;
        // each run of the filters serves later values of a scale, so these are evaluated one after the other
        !self.is_remote() && self.scale.is_none() && threads > 1 && is_small && rows * threads <= MAX_ROWS_IN_WORK
    }

    /// The result of `one` at each point; threads work at several points at once where tests or rows are few.
    pub(crate) fn each<P: Sync, T: Send>(&self, places: &[P], one: impl Fn(&P) -> T + Sync + Send) -> Vec<T> {
        if !self.is_parallel_over_alpha() {
            return places.iter().map(one).collect();
        }
        self.order(); // computed before the threads start
        places.par_iter().map(one).collect()
    }

    /// Sizes of noise and lengths of time in the data.
    pub(crate) fn scales(&self) -> &Scales {
        self.scales.get_or_init(|| Scales::of(self.model, self.tests, self.order()))
    }

    /// Size that the data suggest for each value; 1 where they suggest none.
    pub fn units(&self) -> &[f64] {
        self.units.get_or_init(|| {
            let unit = |slot: &kalfit_model::Slot| self.scales().guess(self.model, slot.parameter);
            let one = |(slot, coordinate): (_, &Coordinate)| if coordinate.log { unit(slot) } else { 1.0 };
            self.slots.slots().iter().zip(&self.coordinates).map(one).collect()
        })
    }

    /// Number of rows of all tests.
    pub(crate) fn rows(&self) -> usize {
        self.tests.iter().map(PhasedTest::row_count).sum()
    }

    /// The values after `part` of a step in the coordinates, within bounds.
    pub(crate) fn moved(&self, values: &[f64], step: &[f64], part: f64) -> Vec<f64> {
        let one = |((coordinate, v), d): ((&Coordinate, &f64), &f64)| {
            if *d == 0.0 { *v } else { coordinate.moved(*v, part * d) }
        };
        self.coordinates.iter().zip(values).zip(step).map(one).collect()
    }

    /// This likelihood by the filters and their backward runs alone, without scaling.
    #[cfg(test)]
    pub(crate) fn unscaled(self) -> ProfileLikelihood<'a> {
        ProfileLikelihood { scale: None, ..self }
    }

    /// Number of forward runs of the filters over all tests.
    pub(crate) fn filter_passes(&self) -> usize {
        self.filter_passes.load(Ordering::Relaxed)
    }

    /// Number of backward runs over all tests.
    pub(crate) fn score_passes(&self) -> usize {
        self.score_passes.load(Ordering::Relaxed)
    }

    /// Adds the counts of another profile likelihood of the same ensemble.
    pub(crate) fn add_counts(&self, other: &ProfileLikelihood<'_>) {
        let pairs = [
            (&self.filter_passes, &other.filter_passes),
            (&self.score_passes, &other.score_passes),
            (&self.passes, &other.passes),
        ];
        pairs.iter().for_each(|(own, more)| _ = own.fetch_add(more.load(Ordering::Relaxed), Ordering::Relaxed));
    }

    /// Number of iterations of the solver; each uses the reductions of all tests.
    pub(crate) fn passes(&self) -> usize {
        self.passes.load(Ordering::Relaxed)
    }

    /// α at the given sought values.
    pub fn alpha(&self, sought: &[f64]) -> Alpha {
        self.slots.alpha(self.model.shared(), &self.values(sought))
    }

    /// The free values of α at the given sought values; the two differ only in covariances of noises.
    pub(crate) fn values(&self, sought: &[f64]) -> Vec<f64> {
        self.edges.values(sought, &self.slots.alpha(self.model.shared(), sought))
    }

    /// The sought values at the given free values of α, with covariances beyond the edge brought inside.
    pub fn sought(&self, values: &[f64]) -> Vec<f64> {
        self.edges.sought(values, &self.slots.alpha(self.model.shared(), values))
    }

    /// The reductions at α.
    pub fn reduce(&self, values: &[f64]) -> Result<Reduced, DynamicError> {
        if let Some(answers) = &self.answers {
            self.filter_passes.fetch_add(1, Ordering::Relaxed);
            let remote = Remote { values: values.to_vec(), answers: answers.clone() };
            return Ok(Reduced { reducer: None, reductions: Reductions::elsewhere(remote), filtered: None });
        }
        if let Some(scale) = &self.scale
            && let Some(reductions) = scale.reductions(values[0], &|value| Ok(self.filter(&[value])?.reductions))?
        {
            return Ok(Reduced { reducer: None, reductions, filtered: None });
        }
        self.filter(values)
    }

    /// Reduces the tests by running the filters.
    fn filter(&self, values: &[f64]) -> Result<Reduced, DynamicError> {
        self.check_waited_for()?;
        // where one value scales all noise, scores are known without a backward pass
        let made = if self.scale.is_some() { PhasedReducer::passing } else { PhasedReducer::scoring };
        let mut reducer = made(self.model, &self.alpha(values), self.slots).map_err(Box::new)?;
        self.batching.share_steps(&mut reducer);
        self.filter_passes.fetch_add(1, Ordering::Relaxed);
        let (reductions, filtered) = match self.scale {
            Some(_) => (reducer.reduce(self.tests).map_err(Box::new)?, None), // the filters run rarely here
            None => {
                let told = (self.model, self.slots);
                self.batching.reduce(told, &mut reducer, self.tests).map_err(Box::new)?
            }
        };
        Ok(Reduced { reducer: Some(reducer), reductions, filtered })
    }

    /// ℓ(α) and its gradient; `near` is a population near the best one.
    pub fn solve(&self, values: &[f64], near: Option<&Population>) -> Result<ProfilePoint, DynamicError> {
        let alpha = self.alpha(values);
        if let Some(AtScale { estimate, gradient, information }) =
            self.scaled(values, &alpha, near, scale::MAX_EXACT_RATIO)?
        {
            let (gradient, told) = (vec![gradient], SecondDerivatives::Scale(information));
            return Ok(ProfilePoint { values: values.to_vec(), alpha, estimate, gradient, second_derivatives: told });
        }
        let reduced = self.reduce(values)?;
        let estimate = self.inner(&reduced.reductions, &alpha, near)?;
        self.solved(values, alpha, reduced, estimate)
    }

    /// The point with its gradient at the best (μ, Σ).
    fn solved(
        &self,
        values: &[f64],
        alpha: Alpha,
        reduced: Reduced,
        estimate: Estimate,
    ) -> Result<ProfilePoint, DynamicError> {
        let scores = self.scores(values, &reduced, &estimate.state.law())?;
        let matrix =
            matrix_gradient(self.model, &alpha, self.slots, &estimate.covariance, &estimate.state.covariance_score());
        let gradient = self.gradient(values, &scores, &matrix);
        let told = SecondDerivatives::Tests(Box::new(TestResults { reductions: reduced.reductions, scores }));
        Ok(ProfilePoint { values: values.to_vec(), alpha, estimate, gradient, second_derivatives: told })
    }

    /// ℓ(α) and its gradient where one value scales all noise; `None` for other models, and where no reductions can be
    /// scaled to this value.
    fn scaled(
        &self,
        values: &[f64],
        alpha: &Alpha,
        near: Option<&Population>,
        far: f64,
    ) -> Result<Option<AtScale>, DynamicError> {
        let Some(scale) = &self.scale else { return Ok(None) };
        self.check_waited_for()?;
        let how = (&self.structure(alpha), near, &self.settings.inner);
        let run = |value| Ok(self.filter(&[value])?.reductions);
        let found = scale.fit((values[0], self.coordinates[0]), (far, &run), how)?;
        let found = found.filter(|at| at.gradient.is_finite());
        found.iter().for_each(|at| self.count_passes(&at.estimate));
        Ok(found)
    }

    /// The reductions at a solved α.
    fn reductions_at<'s>(&self, iterate: &'s ProfilePoint) -> Result<Cow<'s, Reductions>, DynamicError> {
        match &iterate.second_derivatives {
            SecondDerivatives::Tests(tests) => Ok(Cow::Borrowed(&tests.reductions)),
            SecondDerivatives::Scale(_) => Ok(Cow::Owned(self.reduce(&iterate.values)?.reductions)),
        }
    }

    /// Reductions and scores of each test at a solved α.
    pub(crate) fn of_tests<'s>(&self, iterate: &'s ProfilePoint) -> Result<Cow<'s, TestResults>, DynamicError> {
        if let SecondDerivatives::Tests(tests) = &iterate.second_derivatives {
            return Ok(Cow::Borrowed(&**tests));
        }
        let reduced = self.reduce(&iterate.values)?;
        let scores = self.scores(&iterate.values, &reduced, &iterate.estimate.state.law())?;
        Ok(Cow::Owned(TestResults { reductions: reduced.reductions, scores }))
    }

    /// ℓ(α) alone; `None` where it is not defined.
    pub(crate) fn value(&self, values: &[f64]) -> Option<f64> {
        let alpha = self.alpha(values);
        let estimate = match self.scaled(values, &alpha, None, scale::MAX_ROUGH_RATIO).ok()? {
            Some(at) => at.estimate,
            None => self.inner(&self.reduce(values).ok()?.reductions, &alpha, None).ok()?,
        };
        Some(estimate.log_likelihood).filter(|value| value.is_finite())
    }

    /// ℓ(α) alone at each of several points, some at once where `at_a_time` is larger than 1. A point that was tried before
    /// is not tried again, and one where ℓ cannot reach what was found is not tried: it has no value. `go_on` is asked before
    /// each batch; the rest is `None` once it says no.
    pub(crate) fn tried_values(
        &self,
        places: &[Vec<f64>],
        at_a_time: usize,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Vec<Option<f64>> {
        let key = |place: &Vec<f64>| -> Vec<u64> { place.iter().map(|x| x.to_bits()).collect() };
        let tried = || self.tried.lock().unwrap_or_else(PoisonError::into_inner);
        let mut new: Vec<&Vec<f64>> = Vec::new();
        for place in places {
            if !tried().contains_key(&key(place)) && !new.contains(&place) {
                new.push(place);
            }
        }
        let mut goes_on = !new.is_empty() && go_on(); // before the bounds, which may take a run
        let bounds = if goes_on { self.bounds(&new) } else { Vec::new() };
        let mut order: Vec<usize> = (0..bounds.len()).collect();
        order.sort_by(|&a, &b| bounds[b].total_cmp(&bounds[a]));
        for some in order.chunks(at_a_time) {
            if !goes_on {
                break;
            }
            let best = tried().values().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
            if some.iter().all(|&k| bounds[k] < best) {
                break; // the bounds descend
            }
            let some: Vec<&Vec<f64>> = some.iter().map(|&k| new[k]).collect();
            let some = &some[..];
            let values = self.each(some, |place| self.value(place));
            tried().extend(some.iter().map(|place| key(place)).zip(values));
            goes_on = go_on();
        }
        places.iter().map(|place| tried().get(&key(place)).copied().flatten()).collect()
    }

    /// For each point a number that ℓ there does not exceed; infinity where no bound is known.
    pub(crate) fn bounds(&self, places: &[&Vec<f64>]) -> Vec<f64> {
        // the restricted likelihood has a determinant that may be of any size
        let scale = self.scale.as_ref().filter(|_| self.settings.inner.criterion == Criterion::Ml);
        let run = |value| Ok(self.filter(&[value])?.reductions);
        let of = |place: &&Vec<f64>| scale?.bound(place[0], &run).ok()?.filter(|bound| !bound.is_nan());
        places.iter().map(|place| of(place).unwrap_or(f64::INFINITY)).collect()
    }

    /// ℓ(α) alone, from a run of the filters at `values`: reductions scaled from far away would lose digits.
    pub(crate) fn filtered_value(&self, values: &[f64]) -> Option<f64> {
        let reductions = self.filter(values).ok()?.reductions;
        let estimate = self.inner(&reductions, &self.alpha(values), None).ok()?;
        Some(estimate.log_likelihood).filter(|value| value.is_finite())
    }

    /// The structure assumed for μ and Σ at α.
    fn structure<'s>(&'s self, alpha: &'s Alpha) -> Structure<'s> {
        Structure::of(self.model, alpha, self.grouping.as_ref())
    }

    /// The best (μ, Σ) for given reductions.
    pub(crate) fn inner(
        &self,
        reductions: &Reductions,
        alpha: &Alpha,
        near: Option<&Population>,
    ) -> Result<Estimate, DynamicError> {
        let structure = self.structure(alpha);
        let settings = &self.settings.inner;
        let estimate = match near {
            Some(start) => estimate::fit_from(reductions, &structure, start, settings, &mut Silent)?,
            None => estimate::fit(reductions, &structure, settings, &mut Silent)?,
        };
        self.count_passes(&estimate);
        Ok(estimate)
    }

    fn count_passes(&self, estimate: &Estimate) {
        self.passes.fetch_add(estimate.passes, Ordering::Relaxed);
    }

    /// The gradients of ℓ at other values of α and the (μ, Σ) of `iterate`; `None` where ℓ is not defined.
    pub(crate) fn shift(&self, iterate: &ProfilePoint, values: &[f64]) -> Option<FixedLawPoint> {
        let alpha = self.alpha(values);
        let reduced = self.reduce(values).ok()?;
        self.passes.fetch_add(1, Ordering::Relaxed);
        let at = iterate.estimate.state.at_other_alpha(&reduced.reductions, &alpha).ok()??;
        let scores = self.scores(values, &reduced, &at.law()).ok()?;
        let matrix = matrix_gradient(self.model, &alpha, self.slots, &at.covariance(), &at.covariance_score());
        let inner = at.gradient(&iterate.estimate.state);
        let tests = TestResults { reductions: reduced.reductions, scores };
        Some(FixedLawPoint { values: values.to_vec(), inner, tests, matrix })
    }

    /// The point after a step in α and, along the tangent basis of `iterate`, in (μ, Σ); `None` where ℓ is not defined.
    pub(crate) fn step(&self, iterate: &ProfilePoint, values: &[f64], inner: &DVector<f64>) -> Option<ProfilePoint> {
        let alpha = self.alpha(values);
        let reduced = self.reduce(values).ok()?;
        self.passes.fetch_add(1, Ordering::Relaxed);
        let state = iterate.estimate.state.moved(&reduced.reductions, &alpha, inner)?;
        self.solved(values, alpha, reduced, Estimate::unfinished(state)).ok()
    }

    /// ℓ(α) and dℓ/dα with (μ, Σ) solved for, after steps that moved (μ, Σ) together with α.
    pub(crate) fn settle(&self, iterate: &ProfilePoint) -> Result<ProfilePoint, DynamicError> {
        let (values, alpha) = (&iterate.values, self.alpha(&iterate.values));
        let reduced = self.reduce(values)?;
        let structure = self.structure(&alpha);
        let estimate = estimate::fit_on(&iterate.estimate.state, &reduced.reductions, &structure)?;
        self.count_passes(&estimate);
        self.solved(values, alpha, reduced, estimate)
    }

    /// The result of [`ProfileLikelihood::shift`] at `iterate` itself.
    pub(crate) fn at_iterate(&self, iterate: &ProfilePoint) -> Option<FixedLawPoint> {
        let state = &iterate.estimate.state;
        let sigma = &iterate.estimate.covariance;
        Some(FixedLawPoint {
            values: iterate.values.clone(),
            inner: state.newton_iterate.tangent.gradient.clone(),
            tests: self.of_tests(iterate).ok()?.into_owned(),
            matrix: matrix_gradient(self.model, &iterate.alpha, self.slots, sigma, &state.covariance_score()),
        })
    }

    /// The reductions at a solved α, and the estimate on these reductions.
    pub(crate) fn with_reductions(&self, iterate: ProfilePoint) -> Result<(Reductions, Estimate), DynamicError> {
        let ProfilePoint { values, estimate, second_derivatives: told, .. } = iterate;
        if let SecondDerivatives::Tests(tests) = told {
            return Ok((tests.reductions, estimate));
        }
        let run = |value| Ok(self.filter(&[value])?.reductions);
        let scaled = self.scale.as_ref().map(|scale| scale.last_reductions(values[0], &run)).transpose()?.flatten();
        let reductions = match scaled {
            Some(reductions) => reductions,
            None => self.filter(&values)?.reductions,
        };
        let state = estimate.state.with_reductions(&reductions).map_err(FitError::from)?;
        Ok((reductions, Estimate { state, ..estimate }))
    }

    /// Slots of the values that occur in matrices of the covariance structures.
    pub(crate) fn matrix_slots(&self) -> Vec<usize> {
        matrices::slots(self.model, self.slots)
    }

    /// Slots of the values on which the complete data do not depend: values of a carry, and of a phase that is known by
    /// estimates of a filter.
    pub(crate) fn hidden_slots(&self) -> Vec<usize> {
        let carried = self.model.phases.iter().flat_map(|phase| carried(phase, self.slots));
        let hidden: BTreeSet<usize> = carried.chain(self.indirect.parameters(self.model, self.slots)).collect();
        (0..self.slots.len()).filter(|&s| hidden.contains(&self.slots.slots()[s].parameter)).collect()
    }

    /// Whether the restricted likelihood is maximised.
    pub(crate) fn restricted(&self) -> bool {
        self.settings.inner.criterion == Criterion::Reml
    }

    /// Indices of the tests, sorted by id: an order independent of the order given.
    pub fn order(&self) -> &[usize] {
        self.order.get_or_init(|| by_id(self.tests))
    }

    /// dℓ_j/dvalue of each test at given values and a given law of ξ.
    pub fn scores(&self, values: &[f64], reduced: &Reduced, law: &InitialLaw) -> Result<Vec<Gradient>, DynamicError> {
        self.check_waited_for()?;
        let Reduced { reducer, reductions, filtered } = reduced;
        if let Some(remote) = reductions.remote() {
            self.score_passes.fetch_add(1, Ordering::Relaxed);
            let sum = remote.ask(Question::Score { law: law.message() }).filter(|sum| sum.len() == values.len());
            let sum = sum.ok_or(DynamicError::Fit(FitError::NotFinite))?;
            return Ok(vec![sum.into_iter().enumerate().collect()]);
        }
        let fresh = match (reducer, &self.scale) {
            (Some(_), _) => None,
            (None, scale) => match scale.as_ref().and_then(|scale| scale.scores(values[0], reductions, law)) {
                Some(scores) => return Ok(scores),
                None => Some(PhasedReducer::scoring(self.model, &self.alpha(values), self.slots).map_err(Box::new)?),
            },
        };
        let reducer = reducer.as_ref().or(fresh.as_ref()).expect("one of them is there");
        self.score_passes.fetch_add(1, Ordering::Relaxed);
        let scorer = PhasedScorer::new(self.model, reducer, self.slots).map_err(Box::new)?;
        let known = (self.batching.classes(reducer, self.tests), filtered.as_ref());
        let mut scores = scorer.scores(self.tests, reductions, law, known).map_err(Box::new)?;
        self.edges.pull(values, &self.alpha(values), self.slots, &mut scores);
        let alpha = |values: &[f64]| self.alpha(values);
        let around = Around { model: self.model, tests: self.tests, slots: self.slots, alpha: &alpha };
        self.indirect.add(&around, (reducer, values), (reductions, law), &mut scores).map_err(Box::new)?;
        add_exact(&around, values, (reductions, law), &mut scores).map_err(Box::new)?;
        Ok(scores)
    }

    /// Moments of the complete data of each test at a solved α.
    pub(crate) fn complete(&self, iterate: &ProfilePoint) -> Result<Vec<PhasedComplete>, DynamicError> {
        self.filter_passes.fetch_add(1, Ordering::Relaxed);
        self.score_passes.fetch_add(1, Ordering::Relaxed);
        let law = iterate.estimate.state.law();
        let reducer = PhasedReducer::scoring(self.model, &iterate.alpha, self.slots).map_err(Box::new)?;
        let scorer = PhasedScorer::new(self.model, &reducer, self.slots).map_err(Box::new)?;
        let reductions = self.reductions_at(iterate)?;
        Ok(scorer.all_complete(self.tests, &reductions, &law).map_err(Box::new)?)
    }

    /// The expected log-likelihood of the complete data at α and its gradient by the coordinates; `None` where either
    /// is not finite.
    pub(crate) fn expected(&self, complete: &[PhasedComplete], values: &[f64]) -> Option<(f64, Vec<f64>)> {
        let alpha = self.alpha(values);
        let reducer = PhasedReducer::scoring(self.model, &alpha, self.slots).ok()?;
        let scorer = PhasedScorer::new(self.model, &reducer, self.slots).ok()?;
        let (own, mut scores): (Vec<f64>, Vec<Gradient>) =
            scorer.all_expected(self.tests, complete).ok()??.into_iter().unzip();
        self.edges.pull(values, &alpha, self.slots, &mut scores);
        let value: f64 = self.order().iter().map(|&j| own[j]).sum();
        let gradient = self.gradient(values, &scores, &Gradient::new());
        (value.is_finite() && gradient.iter().all(|g| g.is_finite())).then_some((value, gradient))
    }

    /// The noise levels among the free values, from an α where no level is zero.
    pub(crate) fn levels(&self, alpha: &Alpha) -> Result<Levels, DynamicError> {
        let reducer = PhasedReducer::scoring(self.model, alpha, self.slots).map_err(Box::new)?;
        Ok(Levels::new(self.model, &reducer, self.slots, self.tests).map_err(Box::new)?)
    }

    /// dℓ/dcoordinate of each value, from the scores of the tests and of the matrices.
    pub fn gradient(&self, values: &[f64], scores: &[Gradient], matrix: &Gradient) -> Vec<f64> {
        let mut gradient = vec![0.0; values.len()];
        for (slot, bar) in self.order().iter().flat_map(|&j| &scores[j]).chain(matrix) {
            gradient[*slot] += bar;
        }
        let slope = |(s, value): (usize, &f64)| self.coordinates[s].slope(*value);
        gradient.iter_mut().zip(values.iter().enumerate().map(slope)).for_each(|(g, slope)| *g *= slope);
        gradient
    }
}

/// Indices of the tests, sorted by id. Most ids differ in the first eight bytes, which are compared as one number.
fn by_id(tests: &[PhasedTest]) -> Vec<usize> {
    let first =
        |id: &str| id.bytes().chain(std::iter::repeat(0)).take(8).fold(0, |word, byte| word << 8 | u64::from(byte));
    let keyed = |(number, test): (usize, &PhasedTest)| (first(&test.id), number);
    let mut order: Vec<(u64, usize)> = tests.par_iter().enumerate().map(keyed).collect();
    let id = |number: usize| &*tests[number].id;
    order.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then_with(|| id(a.1).cmp(id(b.1))).then(a.1.cmp(&b.1)));
    order.into_iter().map(|(_, number)| number).collect()
}

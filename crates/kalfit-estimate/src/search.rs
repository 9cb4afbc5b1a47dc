//! The search: DL/EM, or Fisher scoring followed by Newton's method with EM as the safeguard.

use std::sync::Arc;

use nalgebra::DMatrix;

use crate::certificate::{Certificate, certificate};
use crate::climb::{step_along_flat, step_off_boundary};
use crate::em;
use crate::em::ConditionalStep;
use crate::error::FitError;
use crate::local::{Local, Objective};
use crate::newton::{Attempt, Damping, NewtonIterate};
use crate::order::Order;
use crate::point::Point;
use crate::problem::Problem;
use crate::result::{Estimate, FinalState};
use crate::rounding::rounding;
use crate::settings::{Progress, Settings, Silent, Solver, Step, Stop};
use crate::sums::Sums;
use crate::{Criterion, Structure, pilot, quadratic, scoring, start, unobserved};
use kalfit_model::Population;

/// Maximum number of scoring steps before Newton's method takes over.
const SCORING_STEPS: usize = 5;
/// Scoring hands over to Newton's method once a step promises, or the last one has given, a gain in ℓ below this.
const MIN_SCORING_GAIN: f64 = 0.5;
/// Scoring also hands over once a step has gained less than this fraction of what it promised.
const MIN_SCORING_RATIO: f64 = 0.7;
/// Newton's method in ψ steps alone while each step reduces the decrement to less than this fraction of the one before;
/// otherwise the quadratic model in Σ is tried first.
const FAST_REDUCTION: f64 = 0.1;
/// Largest number of mean coordinates and elements of Σ up to which the quadratic model in Σ is tried at every step: up
/// to that number the model costs little.
const CHEAP_MODEL_SIZE: usize = 120;
/// Where rounding keeps every step from raising ℓ, a decrement of at most this many tolerances is accepted: a millionth
/// of a standard error by default.
const ROUNDING_TOLERANCES: f64 = 1e2;
/// Below this decrement the next step is probably the last: Newton's method roughly squares the decrement.
const LAST_STEP_DECREMENT: f64 = 1e-3;
/// Decrement, in standard errors, that stops a search on a subset of the tests: far below the subset's sampling error.
const PILOT_TOLERANCE: f64 = 1e-2;
/// Number of EM steps between two evaluations of the certificate.
const EM_CHECK_INTERVAL: usize = 16;
/// Columns of the factor smaller than this (in η) are tried at exactly zero when the search has ended.
const SNAP_SIZE: f64 = 1e-5;
/// Columns of the factor smaller than this (in η) are tried at exactly zero once during the search, where the model in
/// Σ finds no step: if only few matrices of a lower rank meet the constraints, the decrement near them is unreliable.
const EARLY_SNAP_SIZE: f64 = 1e-3;

/// Where a search begins.
pub(crate) enum Beginning<'a> {
    /// At a start computed from the model file or from the data.
    Open,
    /// At values near the optimum, which need not meet the structure.
    Near(&'a Population),
    /// At a point near the optimum.
    At(Point),
}

pub(crate) struct Search<'a> {
    problem: Problem,
    settings: &'a Settings,
    progress: &'a mut dyn Progress,
    trace: Vec<f64>,
}

impl<'a> Search<'a> {
    pub(crate) fn new(problem: Problem, settings: &'a Settings, progress: &'a mut dyn Progress) -> Self {
        Search { problem, settings, progress, trace: Vec::new() }
    }

    /// Searches for the optimum. A start that is not known to be near the optimum is first improved on a subset of the
    /// tests, or by Fisher scoring.
    pub(crate) fn run(mut self, beginning: Beginning<'_>, structure: &Structure<'_>) -> Result<Estimate, FitError> {
        let is_near = !matches!(beginning, Beginning::Open);
        let start = match beginning {
            Beginning::Open => start::start(&self.problem, structure)?,
            Beginning::Near(values) => start::near(&self.problem, values)?,
            Beginning::At(point) => point,
        };
        self.problem.set_far(self.settings.solver == Solver::Newton);
        let (iterate, stop) = match self.settings.solver {
            Solver::Newton => {
                let start_root = start.root.clone();
                let first = match is_near || self.problem.is_far() {
                    true => self.iterate(start, None)?,
                    false => match self.pilot_start(&start, structure)? {
                        Some(iterate) => iterate,
                        None => self.scored_start(start)?,
                    },
                };
                let (iterate, stop) = self.newton(first)?;
                let iterate = self.exact(iterate)?;
                (self.restored(iterate, &start_root)?, stop)
            }
            Solver::Em => self.em(start)?,
        };
        self.finish(iterate, stop, structure)
    }

    fn accept(&mut self, value: f64, decrement: Option<f64>) {
        self.trace.push(value);
        self.progress.step(Step { passes: self.problem.passes(), log_likelihood: value, decrement });
    }

    /// The reason why the search must stop now, if there is one.
    fn stop_reason(&self) -> Option<Stop> {
        if self.progress.stops() {
            return Some(Stop::Interrupted);
        }
        (self.problem.passes() >= self.settings.max_passes).then_some(Stop::PassLimit)
    }

    fn iterate(&self, point: Point, near: Option<&DMatrix<f64>>) -> Result<NewtonIterate, FitError> {
        NewtonIterate::new(&self.problem, &self.problem.covariance, point, near).ok_or(FitError::NotFinite)
    }

    /// The iterate at a point whose sums are computed already.
    fn iterate_from_sums(&self, point: Point, mut sums: Sums) -> Result<NewtonIterate, FitError> {
        let problem = &self.problem;
        NewtonIterate::at(Local::of(&mut sums), problem.mean_jacobian(), &problem.covariance, point)
            .ok_or(FitError::NotFinite)
    }

    /// Newton's method, with an EM step where Newton's method finds none.
    fn newton(&mut self, mut iterate: NewtonIterate) -> Result<(NewtonIterate, Stop), FitError> {
        self.accept(iterate.local.value, Some(iterate.decrement()));
        let mut damping = Damping::default();
        let mut failures = 0;
        let mut before = f64::INFINITY;
        let mut tried_at_zero = false;
        let tests = self.problem.classes.tests as f64;
        loop {
            if iterate.decrement() < LAST_STEP_DECREMENT {
                iterate = self.exact(iterate)?;
            }
            if iterate.decrement() <= self.settings.tolerance {
                let (objective, map) = (&self.problem, &self.problem.covariance);
                match step_off_boundary(objective, map, tests, &mut iterate)
                    .or_else(|| step_along_flat(objective, map, &mut iterate))
                {
                    Some(better) => iterate = better,
                    None => return Ok((iterate, Stop::Certified)),
                }
            }
            if let Some(stop) = self.stop_reason() {
                return Ok((iterate, stop));
            }
            self.problem.set_near_end(iterate.decrement() < LAST_STEP_DECREMENT);
            let fast = iterate.decrement() < FAST_REDUCTION * before;
            before = iterate.decrement();
            if !fast || iterate.local.gradient_size() <= CHEAP_MODEL_SIZE {
                let mut next = quadratic::step(&self.problem, &self.problem.covariance, tests, &mut iterate);
                if next.is_none()
                    && iterate.decrement() < LAST_STEP_DECREMENT
                    && !std::mem::replace(&mut tried_at_zero, true)
                {
                    let half_decrement = 0.5 * iterate.decrement();
                    next = self.with_zero_columns(&mut iterate, EARLY_SNAP_SIZE, half_decrement)?;
                }
                if let Some(next) = next {
                    iterate = next;
                    self.accept(iterate.local.value, Some(iterate.decrement()));
                    continue;
                }
            }
            match damping.attempt(&self.problem, &self.problem.covariance, &mut iterate) {
                Attempt::Better(next) => {
                    iterate = *next;
                    failures = 0;
                }
                Attempt::BelowRounding if iterate.decrement() <= ROUNDING_TOLERANCES * self.settings.tolerance => {
                    return Ok((iterate, Stop::Certified));
                }
                Attempt::Failed | Attempt::BelowRounding if self.problem.is_far() => {
                    iterate = self.exact(iterate)?;
                    continue;
                }
                Attempt::Failed | Attempt::BelowRounding => {
                    failures += 1;
                    match self.safeguard(&mut iterate, failures <= 3)? {
                        Some(next) => iterate = next,
                        _ if iterate.decrement() <= ROUNDING_TOLERANCES * self.settings.tolerance => {
                            return Ok((iterate, Stop::Certified));
                        }
                        _ => return Ok((iterate, Stop::Stalled)),
                    }
                }
            }
            self.accept(iterate.local.value, Some(iterate.decrement()));
        }
    }

    /// The optimum of a subset of the tests, as a start for all; `None` where the tests are too few, or where the
    /// subset's search does not converge.
    fn pilot_start(&self, start: &Point, structure: &Structure<'_>) -> Result<Option<NewtonIterate>, FitError> {
        let Some(problem) = pilot::problem(&self.problem, structure)? else { return Ok(None) };
        let settings = Settings { tolerance: PILOT_TOLERANCE.max(self.settings.tolerance), ..self.settings.clone() };
        let mut silent = Silent;
        let mut search = Search::new(problem, &settings, &mut silent);
        let ended = search.scored_start(start.clone()).and_then(|scored| search.newton(scored));
        let Ok((end, Stop::Certified)) = ended else { return Ok(None) };
        let point = start::from_pilot(&self.problem, &search.problem, &end.point)?;
        Ok(self.iterate(point, None).ok())
    }

    /// The start, improved by Fisher scoring while scoring promises a large gain. ℓ need not rise at every step: where
    /// it falls, the better point before is returned, which needs no new pass.
    fn scored_start(&mut self, start: Point) -> Result<NewtonIterate, FitError> {
        let mut best: Option<(Sums, Point)> = None;
        let mut point = start;
        let mut expected = 0.0;
        for _ in 0..SCORING_STEPS {
            let near = best.as_ref().and_then(|(sums, _)| sums.near());
            point = scoring::with_least_squares_mean(&self.problem, point).ok_or(FitError::NotFinite)?;
            let sums = self.problem.sums(&point, Order::Expected, near).ok_or(FitError::NotFinite)?;
            let before = best.as_ref().map(|(sums, _)| sums.value);
            if let Some((best_sums, at)) =
                best.take_if(|(best_sums, _)| sums.value.is_nan() || sums.value < best_sums.value)
            {
                drop(sums);
                return self.iterate_from_sums(at, best_sums);
            }
            self.accept(sums.value, None);
            let gained = before.map_or(f64::INFINITY, |before| sums.value - before);
            drop(best.take()); // with many states, both do not fit in memory
            let (next, promised) = scoring::step(&self.problem, &point, &sums);
            let was_reliable = gained >= MIN_SCORING_RATIO * expected;
            expected = promised;
            best = Some((sums.without_expected(), point));
            point = next;
            if promised < MIN_SCORING_GAIN || gained < MIN_SCORING_GAIN || !was_reliable || self.progress.stops() {
                break;
            }
        }
        let iterate = self.iterate(point, best.as_ref().and_then(|(sums, _)| sums.near()))?;
        match best.filter(|(sums, _)| sums.value > iterate.local.value) {
            Some((sums, point)) => self.iterate_from_sums(point, sums),
            None => Ok(iterate),
        }
    }

    /// An EM step, where it raises ℓ and `wanted` is true.
    fn safeguard(&mut self, iterate: &mut NewtonIterate, wanted: bool) -> Result<Option<NewtonIterate>, FitError> {
        let sums = self.problem.sums(&iterate.point, Order::Mean, None).ok_or(FitError::NotFinite)?;
        let next = em::step(&self.problem, &iterate.point, &sums, &mut ConditionalStep::Covariance);
        self.try_successor(iterate, next, |next, iterate| wanted && next.local.value > iterate.local.value)
    }

    /// The iterate at `point` if `good` accepts that iterate; `iterate` must then not be used any more.
    fn try_successor(
        &self,
        iterate: &mut NewtonIterate,
        point: Point,
        good: impl FnOnce(&NewtonIterate, &NewtonIterate) -> bool,
    ) -> Result<Option<NewtonIterate>, FitError> {
        let mut failed = None;
        let next = iterate.try_successor(&self.problem, |iterate| {
            let next = self.iterate(point, iterate.near()).map_err(|error| failed = Some(error)).ok()?;
            good(&next, iterate).then_some(next)
        });
        failed.map_or(Ok(next), Err)
    }

    /// The paper's algorithm. Every step is checked to raise ℓ; the certificate is evaluated every few steps.
    fn em(&mut self, mut point: Point) -> Result<(NewtonIterate, Stop), FitError> {
        let mut turn = ConditionalStep::Mean;
        let mut before = f64::NEG_INFINITY;
        let mut steps = 0_usize;
        let order = em::order(&self.problem);
        loop {
            let sums = self.problem.sums(&point, order, None).ok_or(FitError::NotFinite)?;
            if self.problem.criterion() == Criterion::Reml && turn == ConditionalStep::Mean {
                // the restricted likelihood is taken at the mean of least squares, so the step in the mean comes first
                point = em::step(&self.problem, &point, &sums, &mut turn);
                continue;
            }
            if !sums.value.is_finite() {
                return Err(FitError::NotFinite);
            }
            if sums.value < before - 1e-9 * (1.0 + before.abs()) {
                return Err(FitError::NotMonotone { before, after: sums.value });
            }
            before = sums.value;
            self.accept(sums.value, None);
            if steps.is_multiple_of(EM_CHECK_INTERVAL) || self.stop_reason().is_some() {
                let iterate = self.iterate(point.clone(), sums.near())?;
                if iterate.decrement() <= self.settings.tolerance {
                    return Ok((iterate, Stop::Certified));
                }
                if let Some(stop) = self.stop_reason() {
                    return Ok((iterate, stop));
                }
            }
            point = em::step(&self.problem, &point, &sums, &mut turn);
            steps += 1;
        }
    }

    /// The iterate with exact second derivatives, from now on.
    fn exact(&mut self, iterate: NewtonIterate) -> Result<NewtonIterate, FitError> {
        if !self.problem.is_far() {
            return Ok(iterate);
        }
        self.problem.set_far(false);
        self.problem.set_near_end(iterate.decrement() < LAST_STEP_DECREMENT);
        self.recomputed(iterate)
    }

    /// The iterate with derivatives by the covariance of the mean at its own point.
    fn recomputed(&mut self, mut iterate: NewtonIterate) -> Result<NewtonIterate, FitError> {
        let same = iterate.point.clone();
        Ok(self.try_successor(&mut iterate, same, |_, _| true)?.unwrap_or(iterate))
    }

    /// Sets nearly zero columns of the factor to zero, computes the final certificate, and converts the result to the
    /// user's units.
    fn finish(
        mut self,
        mut iterate: NewtonIterate,
        mut stop: Stop,
        structure: &Structure<'_>,
    ) -> Result<Estimate, FitError> {
        let max_decrement = iterate.decrement().max(self.settings.tolerance);
        iterate = self.with_zero_columns(&mut iterate, SNAP_SIZE, max_decrement)?.unwrap_or(iterate);
        if self.problem.criterion() == Criterion::Reml {
            // the second derivatives are exact only with the covariance of the mean at this very point
            iterate = self.recomputed(iterate)?;
            if stop == Stop::Stalled {
                // steps by the derivatives of the point before may fail where those of this one succeed
                let (next, how) = self.newton(iterate)?;
                (iterate, stop) = (self.recomputed(next)?, how);
            }
        }
        let passes = self.problem.passes();
        self.problem.set_near_end(false);
        let sums = self.problem.at_end(&iterate).ok_or(FitError::NotFinite)?;
        let certificate = certified(&self.problem, &iterate);
        if stop == Stop::Certified && !certificate.holds(ROUNDING_TOLERANCES * self.settings.tolerance) {
            stop = Stop::Stalled;
        }
        let settings = self.settings.clone();
        let state = FinalState {
            newton_iterate: iterate,
            sums,
            problem: Arc::new(self.problem),
            assumed: structure.into(),
            settings,
            joint: None,
        };
        Ok(Estimate { passes, ..into_estimate(state, certificate, stop, self.trace, self.settings.solver) })
    }

    /// The iterate with the distribution of directions of ξ that no test observes reset to the distribution at the
    /// start, where Newton's steps have changed that distribution.
    fn restored(&mut self, mut iterate: NewtonIterate, start: &DMatrix<f64>) -> Result<NewtonIterate, FitError> {
        let (map, information) = (&self.problem.covariance, &self.problem.classes.information);
        let Some(root) = unobserved::restored(map, information, start, &iterate.point.root) else { return Ok(iterate) };
        let point = Point { root, ..iterate.point.clone() };
        let max_decrement = iterate.decrement().max(self.settings.tolerance);
        let fine = |next: &NewtonIterate, iterate: &NewtonIterate| {
            is_as_good(next, iterate) && next.decrement() <= max_decrement
        };
        Ok(self.try_successor(&mut iterate, point, fine)?.unwrap_or(iterate))
    }

    /// The iterate with columns of the factor below this size set to zero; `None` where no column is that small, where
    /// ℓ falls, or where the decrement becomes too large.
    fn with_zero_columns(
        &mut self,
        iterate: &mut NewtonIterate,
        size: f64,
        max_decrement: f64,
    ) -> Result<Option<NewtonIterate>, FitError> {
        let mut root = iterate.point.root.clone();
        let mut changed = false;
        for block in self.problem.covariance.blocks() {
            for &c in block {
                let largest = block.iter().map(|&i| root[(i, c)].abs()).fold(0.0, f64::max);
                if largest > 0.0 && largest < size {
                    block.iter().for_each(|&i| root[(i, c)] = 0.0);
                    changed = true;
                }
            }
        }
        if !changed {
            return Ok(None);
        }
        let Some(root) = self.problem.covariance.on_constraints(&root) else { return Ok(None) };
        let point = Point { root, ..iterate.point.clone() };
        self.try_successor(iterate, point, |next, iterate| {
            is_as_good(next, iterate) && next.decrement() <= max_decrement
        })
    }
}

/// Whether ℓ at `next` is no lower than at `iterate`, up to rounding.
fn is_as_good(next: &NewtonIterate, iterate: &NewtonIterate) -> bool {
    next.local.value >= iterate.local.value - 1e-9
}

impl Estimate {
    /// The estimate at an iterate where no search has ended.
    pub fn unfinished(state: FinalState) -> Estimate {
        let certificate = certified(&state.problem, &state.newton_iterate);
        into_estimate(state, certificate, Stop::PassLimit, Vec::new(), Solver::Newton)
    }
}

/// The certificate of an iterate, with the bound on rounding errors.
fn certified(problem: &Problem, iterate: &NewtonIterate) -> Certificate {
    let (certificate, _) = certificate(&problem.covariance, iterate, problem.classes.tests as f64);
    certificate.with_rounding(&rounding(&problem.classes.frame, iterate))
}

/// The estimate in the user's units.
fn into_estimate(state: FinalState, certificate: Certificate, stop: Stop, trace: Vec<f64>, solver: Solver) -> Estimate {
    let problem = &state.problem;
    let Population { mean, coefficients, covariance } = problem.values_of(&state.newton_iterate.point);
    Estimate {
        mean,
        coefficients,
        covariance,
        log_likelihood: state.sums.value,
        composite: None,
        certificate,
        stop,
        trace,
        passes: problem.passes(),
        classes: problem.classes.len(),
        criterion: problem.criterion(),
        solver,
        state,
    }
}

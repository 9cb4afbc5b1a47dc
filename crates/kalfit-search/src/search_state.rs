//! State, start and end of a search.

use nalgebra::DVector;

use crate::Standing;
use crate::joint::JointInformation;
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint};
use crate::quadratic::{LevelScale, ProfileInformation};
use crate::record::{Candidate, Origin};
use kalfit_estimate::{Progress, Stage, Step, Stop};
use kalfit_model::Population;

/// Longest step of a logarithm.
pub(super) const LONGEST: f64 = 2.0;
/// Decrement, in tolerances, that is near enough to the optimum where rounding keeps the search from advancing.
pub(super) const NEAR_ENOUGH: f64 = 1e2;
/// Step of a logarithm above which the value is moving far.
pub(super) const FAR_STEP: f64 = 0.25;
/// Decrement, in standard errors, up to which a search has arrived.
const ARRIVED_DECREMENT: f64 = 1e-5;
/// Value, relative to the size that the data suggest, below which a value is not recorded as a former size.
const MIN_SIZE: f64 = 1e-3;
/// Value at which a value at zero restarts, relative to the former size.
const RESTART_SIZE: f64 = 5e-2;
/// Smallest change of ℓ that counts as a rise.
pub(super) const MIN_RISE: f64 = 1e-8;

/// Start of a search.
#[derive(Debug, Clone)]
pub(crate) struct SearchStart {
    pub(crate) values: Vec<f64>,
    pub(crate) origin: Origin,
    /// Curvature of ℓ about the start, estimated on a part of the data.
    pub(crate) curvature: Option<ProfileInformation>,
}

impl From<Vec<f64>> for SearchStart {
    fn from(values: Vec<f64>) -> SearchStart {
        SearchStart { values, origin: Origin::default(), curvature: None }
    }
}

impl From<Candidate> for SearchStart {
    fn from(Candidate { values, origin }: Candidate) -> SearchStart {
        SearchStart { values, origin, curvature: None }
    }
}

/// State of a search.
pub struct SearchState<'b, 'a> {
    pub(super) objective: &'b ProfileLikelihood<'a>,
    pub(super) progress: &'b mut dyn Progress,
    pub(crate) iterate: ProfilePoint,
    pub(super) origin: Origin,
    /// Noise levels that returned from zero.
    pub(super) returned: Vec<usize>,
    pub(crate) standing: Vec<Standing>,
    pub(crate) trace: Vec<f64>,
    /// Former size of each value: the last value before zero, or the size that the data suggest.
    pub(super) before_zero: Vec<f64>,
    /// Lower limit of each value: the lower bound, or a little more where ℓ is not defined at the bound.
    pub(super) lower_limit: Vec<f64>,
    pub(super) damping: f64,
    pub(super) best_known: Option<f64>,
    pub(super) held: Option<usize>,
    /// Whether each value was stopped on the way to zero or to infinity.
    pub(super) marked_unbounded: Vec<bool>,
    pub(super) flat_probes: usize,
    pub(super) ridges: RidgesSeen,
    /// Decrement at the last quasi-Newton step; `None` where no quasi-Newton step came before.
    pub(super) last_decrement: Option<f64>,
    pub(super) given_up: bool,
    /// Number of consecutive steps that did not raise ℓ.
    pub(super) flat_steps: usize,
    /// Number of consecutive steps that raised ℓ by more than predicted.
    pub(super) short_steps: usize,
    /// Whether differences are two-sided far from the optimum, too.
    pub(super) is_central: bool,
    /// Whether levels enter the next step by their logarithms or by their variances.
    pub(super) level_scale: LevelScale,
}

/// Record of the ridges of ℓ that a search has met.
#[derive(Debug, Default)]
pub(super) struct RidgesSeen {
    /// Largest distance of the present point from the top of a ridge, in standard errors.
    pub(super) below: f64,
    /// Number of attempts that found no ridge.
    pub(super) failures: usize,
    /// Number of moves along ridges.
    pub(super) moves: usize,
}

/// End of a search.
pub struct SearchEnd {
    /// The last point of the search.
    pub iterate: ProfilePoint,
    /// Origin of the start.
    pub(crate) origin: Origin,
    /// Noise levels that returned from zero.
    pub(crate) returned: Vec<usize>,
    pub(crate) standing: Vec<Standing>,
    pub(crate) joint: JointInformation,
    pub(crate) certificate: f64,
    pub(crate) stop: Stop,
    pub(crate) trace: Vec<f64>,
    pub(super) before_zero: Vec<f64>,
    pub(super) level_scale: LevelScale,
    /// Whether the search was given up because ℓ could not reach the best known end.
    pub(crate) given_up: bool,
}

impl SearchEnd {
    /// Whether a level is at zero, or at the least value at which ℓ is defined.
    pub(crate) fn is_at_zero(&self, s: usize) -> bool {
        self.iterate.values[s] == 0.0 || self.standing[s] == Standing::Vanishing
    }

    /// The values as a new start, with each zero raised to [`RESTART_SIZE`] times the former size.
    pub(crate) fn restart(&self) -> Vec<f64> {
        let zero = |(value, before): (&f64, &f64)| if *value == 0.0 { RESTART_SIZE * before } else { *value };
        self.iterate.values.iter().zip(&self.before_zero).map(zero).collect()
    }
}

impl<'b, 'a> SearchState<'b, 'a> {
    /// The state of a search that starts at `iterate`.
    pub fn new(
        objective: &'b ProfileLikelihood<'a>,
        progress: &'b mut dyn Progress,
        iterate: ProfilePoint,
    ) -> SearchState<'b, 'a> {
        let n = iterate.values.len();
        let trace = vec![iterate.value()];
        let unit = |(value, unit): (&f64, &f64)| if *value > MIN_SIZE * unit { *value } else { *unit };
        let before_zero = iterate.values.iter().zip(objective.units()).map(unit).collect();
        let lower_limit = objective.coordinates.iter().map(|coordinate| coordinate.lower).collect();
        let mut search = SearchState {
            objective,
            progress,
            iterate,
            origin: Origin::default(),
            returned: Vec::new(),
            standing: vec![Standing::Inside; n],
            trace,
            before_zero,
            lower_limit,
            damping: 0.0,
            best_known: None,
            held: None,
            marked_unbounded: vec![false; n],
            flat_probes: 0,
            ridges: RidgesSeen::default(),
            last_decrement: None,
            given_up: false,
            flat_steps: 0,
            short_steps: 0,
            is_central: false,
            level_scale: LevelScale::Logarithm,
        };
        search.update_standing();
        search
    }

    /// Updates the standing of each value: at a bound beyond which ℓ rises, or free to move.
    pub(super) fn update_standing(&mut self) {
        for s in 0..self.standing.len() {
            let (coordinate, value, slope) =
                (self.objective.coordinates[s], self.iterate.values[s], self.iterate.gradient[s]);
            self.standing[s] = match self.standing[s] {
                kept if self.marked_unbounded[s] => kept,
                _ if coordinate.log && value == 0.0 => Standing::Lower,
                _ if self.is_vanishing(s) => Standing::Vanishing,
                _ if coordinate.at_lower(value) && slope <= 0.0 => Standing::Lower,
                _ if coordinate.at_upper(value) && slope >= 0.0 => Standing::Upper,
                _ => Standing::Inside,
            };
        }
    }

    /// Holds a value fixed.
    pub fn hold(&mut self, slot: usize) {
        self.held = Some(slot);
    }

    /// Sets the best known ℓ: a search that cannot reach this ℓ is given up.
    pub(crate) fn with_best_known(mut self, best_known: Option<f64>) -> Self {
        self.best_known = best_known;
        self
    }

    /// Sets the origin of the start.
    pub(crate) fn with_origin(mut self, origin: Origin) -> Self {
        self.origin = origin;
        self
    }

    /// Declares the start to be a maximum: derivatives are by two-sided differences from the first step.
    pub(crate) fn near_its_end(mut self) -> Self {
        self.last_decrement = Some(0.0);
        self
    }

    /// Whether the search cannot reach the best known ℓ.
    pub(super) fn cannot_reach_best(&self, decrement: f64) -> bool {
        let room = if decrement > ARRIVED_DECREMENT { (3.0 * decrement).min(1.0) } else { 0.0 };
        let promised = self.iterate.value() + 2.0 * decrement * decrement + room;
        self.trace.len() > 3 && self.best_known.is_some_and(|best_known| promised < best_known)
    }

    /// Whether the search cannot reach the best known ℓ, and no level is at zero, from where the level could return.
    pub(super) fn is_out_of_reach(&self, decrement: f64) -> bool {
        self.cannot_reach_best(decrement) && self.zeros().is_empty()
    }

    pub(super) fn active(&self) -> Vec<bool> {
        let moves = |(s, standing): (usize, &Standing)| *standing == Standing::Inside && self.held != Some(s);
        self.standing.iter().enumerate().map(moves).collect()
    }

    pub(super) fn tolerance(&self) -> f64 {
        self.objective.settings.inner.tolerance.max(1e-7)
    }

    /// Loss of ℓ that may be rounding.
    pub(super) fn slack(&self) -> f64 {
        1e-12 * self.iterate.value().abs().max(1.0)
    }

    /// Whether the caller requests that the search stop.
    pub(super) fn stops(&self) -> bool {
        self.progress.stops()
    }

    /// Reports a stage of the search.
    pub(super) fn report_stage(&mut self, stage: Stage<'_>) {
        self.progress.stage(stage);
    }

    /// Reports a step: ℓ after the step, and the decrement where known.
    pub(super) fn report_step(&mut self, decrement: Option<f64>) {
        self.trace.push(self.iterate.value());
        let passes = self.objective.filter_passes();
        self.progress.step(Step { passes, log_likelihood: self.iterate.value(), decrement });
    }

    /// Gradient of ℓ along the tangent basis of (μ, Σ); zero where (μ, Σ) have been solved for.
    pub(super) fn inner_gradient(&self) -> &DVector<f64> {
        &self.iterate.estimate.state.newton_iterate.tangent.gradient
    }

    /// The point at other values, solved from the present (μ, Σ); `None` where ℓ is not defined.
    pub(super) fn at(&self, values: &[f64]) -> Option<ProfilePoint> {
        let near = Population::from(&self.iterate.estimate);
        let solved = self.objective.solve(values, Some(&near)).ok()?;
        solved.value().is_finite().then_some(solved)
    }

    /// Moves the search to a new point.
    pub(super) fn move_to(&mut self, next: ProfilePoint) {
        for s in 0..next.values.len() {
            let (before, value) = (self.iterate.values[s], next.values[s]);
            if value <= self.lower_limit[s] && before > self.lower_limit[s] && before > MIN_SIZE * self.before_zero[s] {
                self.before_zero[s] = before;
            }
        }
        self.iterate = next;
    }
}

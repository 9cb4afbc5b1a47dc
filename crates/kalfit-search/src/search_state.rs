//! Where a search is, where it began and where it ended.

use nalgebra::DVector;

use crate::Standing;
use crate::joint::JointInformation;
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint};
use crate::quadratic::{LevelScale, ProfileInformation};
use kalfit_estimate::{Progress, Stage, Step, Stop};
use kalfit_model::Population;

/// Longest step of a logarithm.
pub(super) const LONGEST: f64 = 2.0;
/// Where rounding keeps the search from going on, so many tolerances are near enough.
pub(super) const NEAR_ENOUGH: f64 = 1e2;
/// A step of a logarithm beyond this goes far.
pub(super) const DRIFT: f64 = 0.25;
/// A search that promises no more than this, as a decrement, has arrived.
const ARRIVED: f64 = 1e-5;
/// A level below this part of what the data suggest has no size of its own.
const FAR_BELOW: f64 = 1e-3;
/// A value that returns from zero does so at this part of what it was.
const RETURN: f64 = 5e-2;
/// ℓ rises when it rises by more than this.
pub(super) const RISE: f64 = 1e-8;

/// Where a search begins.
#[derive(Debug, Clone)]
pub(crate) struct SearchStart {
    pub(crate) values: Vec<f64>,
    /// How ℓ curves about it, as far as a part of the data tells.
    pub(crate) curvature: Option<ProfileInformation>,
}

impl From<Vec<f64>> for SearchStart {
    fn from(values: Vec<f64>) -> SearchStart {
        SearchStart { values, curvature: None }
    }
}

/// Where a search is.
pub struct SearchState<'b, 'a> {
    pub(super) objective: &'b ProfileLikelihood<'a>,
    pub(super) progress: &'b mut dyn Progress,
    pub(crate) home: ProfilePoint,
    pub(crate) standing: Vec<Standing>,
    pub(crate) trace: Vec<f64>,
    /// The value of each coordinate before it was set to zero.
    pub(super) before_zero: Vec<f64>,
    /// The least value of each level: its bound, or a little more where ℓ is not defined there.
    pub(super) bottom: Vec<f64>,
    pub(super) damping: f64,
    pub(super) floor: Option<f64>,
    pub(super) held: Option<usize>,
    /// Values left on their way to zero or to infinity.
    pub(super) drifted: Vec<bool>,
    pub(super) faint_looks: usize,
    pub(super) ridges: RidgesSeen,
    /// What the last step without second derivatives promised, as a decrement.
    pub(super) glided: Option<f64>,
    pub(super) given_up: bool,
    /// Steps one after the other that did not raise ℓ.
    pub(super) level_steps: usize,
    /// … and that raised it by more than was promised.
    pub(super) short_steps: usize,
    /// Differences are taken to both sides, also far from the end.
    pub(super) is_central: bool,
    /// What levels stand by in the next step.
    pub(super) level_scale: LevelScale,
}

/// What a search knows of ridges of ℓ.
#[derive(Debug, Default)]
pub(super) struct RidgesSeen {
    /// How far below the top of one it is, in standard errors.
    pub(super) below: f64,
    /// How often there was none where one was looked for.
    pub(super) missed: usize,
    /// How often it moved along one.
    pub(super) moves: usize,
}

/// Where it ended.
pub struct SearchEnd {
    pub home: ProfilePoint,
    pub(crate) standing: Vec<Standing>,
    pub(crate) joint: JointInformation,
    pub(crate) certificate: f64,
    pub(crate) stop: Stop,
    pub(crate) trace: Vec<f64>,
    pub(super) before_zero: Vec<f64>,
    pub(super) level_scale: LevelScale,
    /// Nothing higher than another end was in sight.
    pub(crate) given_up: bool,
}

impl SearchEnd {
    /// A level at zero, or as near to it as ℓ is defined.
    pub(crate) fn is_at_zero(&self, s: usize) -> bool {
        self.home.values[s] == 0.0 || self.standing[s] == Standing::Vanishing
    }

    /// The values as a start elsewhere: those at zero a little above it, where they can move.
    pub(crate) fn restart(&self) -> Vec<f64> {
        let zero = |(value, before): (&f64, &f64)| if *value == 0.0 { RETURN * before } else { *value };
        self.home.values.iter().zip(&self.before_zero).map(zero).collect()
    }
}

impl<'b, 'a> SearchState<'b, 'a> {
    pub fn new(
        objective: &'b ProfileLikelihood<'a>,
        progress: &'b mut dyn Progress,
        home: ProfilePoint,
    ) -> SearchState<'b, 'a> {
        let n = home.values.len();
        let trace = vec![home.value()];
        let unit = |(value, unit): (&f64, &f64)| if *value > FAR_BELOW * unit { *value } else { *unit };
        let before_zero = home.values.iter().zip(objective.units()).map(unit).collect();
        let bottom = objective.coordinates.iter().map(|coordinate| coordinate.lower).collect();
        let mut search = SearchState {
            objective,
            progress,
            home,
            standing: vec![Standing::Inside; n],
            trace,
            before_zero,
            bottom,
            damping: 0.0,
            floor: None,
            held: None,
            drifted: vec![false; n],
            faint_looks: 0,
            ridges: RidgesSeen::default(),
            glided: None,
            given_up: false,
            level_steps: 0,
            short_steps: 0,
            is_central: false,
            level_scale: LevelScale::Logarithm,
        };
        search.place();
        search
    }

    /// Values at bounds that want to go beyond are held there, others are let go.
    pub(super) fn place(&mut self) {
        for s in 0..self.standing.len() {
            let (coordinate, value, slope) =
                (self.objective.coordinates[s], self.home.values[s], self.home.gradient[s]);
            self.standing[s] = match self.standing[s] {
                kept if self.drifted[s] => kept,
                _ if coordinate.log && value == 0.0 => Standing::Lower,
                _ if self.is_vanishing(s) => Standing::Vanishing,
                _ if coordinate.at_lower(value) && slope <= 0.0 => Standing::Lower,
                _ if coordinate.at_upper(value) && slope >= 0.0 => Standing::Upper,
                _ => Standing::Inside,
            };
        }
    }

    /// Holds a value where it is.
    pub fn hold(&mut self, slot: usize) {
        self.held = Some(slot);
    }

    /// Gives up where no more than this ℓ is in sight.
    pub(crate) fn beyond(mut self, floor: Option<f64>) -> Self {
        self.floor = floor;
        self
    }

    /// ℓ of another end is out of reach.
    pub(super) fn hopeless(&self, decrement: f64) -> bool {
        let room = if decrement > ARRIVED { (3.0 * decrement).min(1.0) } else { 0.0 };
        let promised = self.home.value() + 2.0 * decrement * decrement + room;
        self.trace.len() > 3 && self.floor.is_some_and(|floor| promised < floor)
    }

    /// The same without levels at zero, which could return.
    pub(super) fn is_lost(&self, decrement: f64) -> bool {
        self.hopeless(decrement) && self.zeros().is_empty()
    }

    pub(super) fn active(&self) -> Vec<bool> {
        let moves = |(s, standing): (usize, &Standing)| *standing == Standing::Inside && self.held != Some(s);
        self.standing.iter().enumerate().map(moves).collect()
    }

    pub(super) fn tolerance(&self) -> f64 {
        self.objective.settings.inner.tolerance.max(1e-7)
    }

    /// What ℓ may lose by rounding.
    pub(super) fn slack(&self) -> f64 {
        1e-12 * self.home.value().abs().max(1.0)
    }

    /// Somebody asks the search to end where it is.
    pub(super) fn stops(&self) -> bool {
        self.progress.stops()
    }

    /// Says how it goes.
    pub(super) fn say(&mut self, stage: Stage<'_>) {
        self.progress.stage(stage);
    }

    /// Says where a step has led, and how far that is from the optimum where it is known.
    pub(super) fn tell(&mut self, decrement: Option<f64>) {
        self.trace.push(self.home.value());
        let passes = self.objective.filter_passes();
        self.progress.step(Step { passes, log_likelihood: self.home.value(), decrement });
    }

    /// Gradient along the coordinates of (μ, Σ): nothing where they have been solved for.
    pub(super) fn inner_gradient(&self) -> &DVector<f64> {
        &self.home.estimate.state.newton_iterate.tangent.gradient
    }

    /// ℓ at other values, from the (μ, Σ) at hand; `None` where it is not defined.
    pub(super) fn at(&self, values: &[f64]) -> Option<ProfilePoint> {
        let near = Population::from(&self.home.estimate);
        let solved = self.objective.solve(values, Some(&near)).ok()?;
        solved.value().is_finite().then_some(solved)
    }

    /// Takes up a place.
    pub(super) fn arrive(&mut self, next: ProfilePoint) {
        for s in 0..next.values.len() {
            let (before, value) = (self.home.values[s], next.values[s]);
            if value <= self.bottom[s] && before > self.bottom[s] && before > FAR_BELOW * self.before_zero[s] {
                self.before_zero[s] = before;
            }
        }
        self.home = next;
    }
}

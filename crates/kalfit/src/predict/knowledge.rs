//! What is known of the estimates, carried to what is predicted: the delta method.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::ensemble::Label;
use crate::infer::Estimated;
use crate::model::{Alpha, Level, Phase, PhasedModel};
use crate::predict::course::Value;
use crate::predict::{Estimation, Initial};

/// One number that was estimated, as a model names it.
#[derive(Debug, Clone, PartialEq)]
pub enum Known {
    /// Of μ, of the regression coefficients or of Σ.
    Population(Estimated),
    /// A dynamic parameter.
    Parameter {
        /// Its place in the model.
        parameter: usize,
        /// The text of its level.
        level: Option<String>,
    },
}

/// How far estimates can be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct Knowledge {
    /// What was estimated.
    pub quantities: Vec<Known>,
    /// Covariance of the estimates.
    pub covariance: DMatrix<f64>,
    /// What the data do not determine.
    pub open: Vec<Known>,
    /// Free variances and noise levels whose estimate is zero.
    pub at_zero: Vec<Known>,
    /// How many tests, or groups of the outermost level, they are from; infinitely many of values that are given.
    pub tests: f64,
    /// By restricted maximum likelihood: Σ allows for the means that were estimated with it.
    pub is_restricted: bool,
}

impl Knowledge {
    /// Of values that are given: nothing was estimated.
    pub fn exact() -> Knowledge {
        Knowledge {
            quantities: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            open: Vec::new(),
            at_zero: Vec::new(),
            tests: f64::INFINITY,
            is_restricted: true,
        }
    }
}

impl Knowledge {
    /// The same with some numbers known exactly.
    #[must_use]
    pub fn without(&self, is_exact: &dyn Fn(&Known) -> bool) -> Knowledge {
        let kept: Vec<usize> = (0..self.quantities.len()).filter(|&i| !is_exact(&self.quantities[i])).collect();
        Knowledge {
            quantities: kept.iter().map(|&i| self.quantities[i].clone()).collect(),
            covariance: self.covariance.select_rows(&kept).select_columns(&kept),
            open: self.open.iter().filter(|known| !is_exact(known)).cloned().collect(),
            at_zero: self.at_zero.iter().filter(|known| !is_exact(known)).cloned().collect(),
            tests: self.tests,
            is_restricted: self.is_restricted,
        }
    }
}

/// A step of a free value is this part of its standard error,
const PART: f64 = 1e-3;
/// and at most this part of the value.
const MOST: f64 = 1e-3;
/// What hangs on something that is not determined by less than this part does not hang on it.
const FAINT: f64 = 1e-9;

/// Free values of α moved to both sides, for derivatives.
#[derive(Debug)]
pub(super) struct Steps {
    /// Of each quantity, and then of each one that is open: (place of its lower side among `moved`, distance of the sides).
    places: Vec<Option<(usize, f64)>>,
    /// Of each noise level that was estimated as zero, its place among `moved`, where it is one.
    probes: Vec<usize>,
    /// (element, column) of each regression coefficient.
    regressions: Vec<(usize, usize)>,
    moved: Vec<Alpha>,
}

impl Steps {
    pub(super) fn new(model: &PhasedModel, alpha: &Alpha, knowledge: Option<&Knowledge>) -> Steps {
        let of_phase = |(phase, range): (&Phase, Range<usize>)| {
            let own = phase.model.mean.regression.iter();
            own.map(move |regression| (range.start + regression.element, regression.column)).collect::<Vec<_>>()
        };
        let regressions = model.phases.iter().zip(model.ranges()).flat_map(of_phase).collect();
        let mut steps = Steps { places: Vec::new(), probes: Vec::new(), regressions, moved: Vec::new() };
        let Some(knowledge) = knowledge else { return steps };
        let errors = (0..knowledge.quantities.len()).map(|i| Some(knowledge.covariance[(i, i)].max(0.0).sqrt()));
        let all = knowledge.quantities.iter().zip(errors).chain(knowledge.open.iter().map(|open| (open, None)));
        for (known, error) in all {
            let place = match known {
                Known::Population(_) => None,
                Known::Parameter { parameter, level } => {
                    steps.both_sides(model, alpha, (*parameter, level.as_deref()), error)
                }
            };
            steps.places.push(place);
        }
        for known in &knowledge.at_zero {
            let Known::Parameter { parameter, level } = known else { continue };
            let mut alpha = alpha.clone();
            if let Some(own) = value(model, &mut alpha, (*parameter, level.as_deref())) {
                *own = 1.0;
                steps.probes.push(steps.moved.len());
                steps.moved.push(alpha);
            }
        }
        steps
    }

    /// Whether a free variance or noise level that was estimated as zero would be seen in a value.
    pub(super) fn hangs_on_zero(
        &self,
        knowledge: &Knowledge,
        initial: &Initial,
        value: &Value,
        sides: &[&Value],
    ) -> bool {
        let p = initial.mean.len();
        let own = value.sensitivity.rows(0, p);
        let is_seen = |known: &Known| match *known {
            Known::Population(Estimated::Covariance(i, _)) => {
                initial.levels.contains(&(i / p)) && own[i % p].abs() > FAINT * own.amax()
            }
            _ => false,
        };
        let variance = |side: &Value| side.population(&initial.covariance) + side.process;
        let moves = |&place: &usize| variance(sides[place]) > variance(value) * (1.0 + FAINT);
        knowledge.at_zero.iter().any(is_seen) || self.probes.iter().any(moves)
    }

    pub(super) fn moved(&self) -> impl Iterator<Item = &Alpha> {
        self.moved.iter()
    }

    fn both_sides(
        &mut self,
        model: &PhasedModel,
        alpha: &Alpha,
        (parameter, level): (usize, Option<&str>),
        error: Option<f64>,
    ) -> Option<(usize, f64)> {
        let value = *value(model, &mut alpha.clone(), (parameter, level))?;
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let step = error.map_or(MOST * size, |error| (PART * error).min(MOST * size));
        if step <= 0.0 {
            return None;
        }
        let place = self.moved.len();
        let mut sides = [value - step, value + step];
        sides.iter_mut().for_each(|side| {
            let mut alpha = alpha.clone();
            if let Some(own) = self::value(model, &mut alpha, (parameter, level)) {
                *own = *side;
            }
            self.moved.push(alpha);
        });
        Some((place, sides[1] - sides[0]))
    }

    /// Variances of the estimates of a value's mean and variance over tests; `sides`: the value at each α that is moved. `None` where it hangs
    /// on what the data do not determine.
    pub(super) fn estimation(
        &self,
        knowledge: &Knowledge,
        initial: &Initial,
        value: &Value,
        sides: &[&Value],
    ) -> Option<Estimation> {
        let p = initial.mean.len();
        let own = value.sensitivity.rows(0, p).into_owned();
        let by_mean = initial.shrinkage.as_ref().map_or(own.clone(), |shrinkage| shrinkage.transpose() * &own);
        let slope = |at: usize, of: &dyn Fn(&Value) -> f64| match self.places[at] {
            Some((place, width)) => (of(sides[place + 1]) - of(sides[place])) / width,
            None => 0.0,
        };
        let level_of = |i: usize| initial.levels.contains(&(i / p));
        // (of the mean, of the variance by the initial state, of that by process noise)
        let slopes = |at: usize, known: &Known| match *known {
            Known::Population(Estimated::Mean(i)) => [by_mean.get(i).copied().unwrap_or(0.0), 0.0, 0.0],
            Known::Population(Estimated::Coefficient(c)) => [value.sensitivity[p + c], 0.0, 0.0],
            Known::Population(Estimated::Covariance(i, j)) if level_of(i) => {
                let both = if i == j { 1.0 } else { 2.0 };
                [0.0, both * own[i % p] * own[j % p], 0.0]
            }
            Known::Population(_) => [0.0; 3],
            Known::Parameter { .. } => [
                slope(at, &|side| side.mean),
                slope(at, &|side| side.population(&initial.covariance)),
                slope(at, &|side| side.process),
            ],
        };
        let count = knowledge.quantities.len();
        let open = knowledge.open.iter().enumerate().any(|(k, known)| match known {
            Known::Population(_) => {
                let found = slopes(count + k, known);
                found[0].abs() > FAINT * own.amax() || found[1].abs() > FAINT * own.amax().powi(2)
            }
            Known::Parameter { .. } => self.places[count + k].is_some_and(|(place, _)| {
                let moves = |of: &dyn Fn(&Value) -> f64, size: f64| {
                    (of(sides[place + 1]) - of(sides[place])).abs() > FAINT * MOST * size
                };
                let variance = |side: &Value| side.population(&initial.covariance) + side.process;
                moves(&|side| side.mean, value.mean.abs() + own.amax()) || moves(&variance, variance(value))
            }),
        });
        if open {
            return None;
        }
        let all: Vec<[f64; 3]> = knowledge.quantities.iter().enumerate().map(|(at, known)| slopes(at, known)).collect();
        let gradient = |of: &dyn Fn(&[f64; 3]) -> f64| DVector::from_iterator(count, all.iter().map(of));
        let variance = |of: &dyn Fn(&[f64; 3]) -> f64| {
            let gradient = gradient(of);
            gradient.dot(&(&knowledge.covariance * &gradient))
        };
        // of the states in it: one mean, whatever it is made of, and each column that means are regressed on
        let is_in = |element: usize| own[element].abs() > FAINT * own.amax();
        let mut columns: Vec<usize> = Vec::new();
        let mut means = 0;
        for known in &knowledge.quantities {
            match *known {
                Known::Population(Estimated::Mean(i)) if i < p && is_in(i) => means = 1,
                Known::Population(Estimated::Coefficient(c)) if is_in(self.regressions[c].0) => {
                    columns.push(self.regressions[c].1);
                }
                _ => {}
            }
        }
        columns.sort_unstable();
        columns.dedup();
        let found =
            [variance(&|slopes| slopes[0]), variance(&|slopes| slopes[1] + slopes[2]), variance(&|slopes| slopes[1])];
        let [mean, variance, population] = found.map(|x| if x < 0.0 { 0.0 } else { x });
        let is_known = mean.is_finite() && variance.is_finite() && population.is_finite();
        is_known.then_some(Estimation {
            mean,
            variance,
            population,
            lost: means + columns.len(),
            is_restricted: knowledge.is_restricted,
            tests: knowledge.tests,
        })
    }
}

/// The value of a parameter at a level; `None` where α has none of its own there.
fn value<'a>(
    model: &PhasedModel,
    alpha: &'a mut Alpha,
    (parameter, level): (usize, Option<&str>),
) -> Option<&'a mut f64> {
    match (alpha.values.get_mut(parameter)?, level) {
        (Level::Common(value), None) => Some(value),
        (Level::Each { values, .. }, Some(text)) => {
            let literal = model.shared().literals.iter().position(|literal| literal == text)?;
            values.get_mut(&Label::literal(literal))
        }
        (Level::Each { other, .. }, None) => other.as_mut(),
        (Level::Common(_), Some(_)) => None,
    }
}

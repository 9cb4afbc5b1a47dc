//! Scores through phases that are known by a filter's estimates (theory §8). The derivatives of these estimates by α,
//! through Γ, S and φ, come from differences: the phase is evaluated at other values of α, with the rest of the test
//! and the law of ξ unchanged.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use crate::colours::colours;
use kalfit_filter::reduce::{PhasedReducer, ReduceError, Reductions};
use kalfit_filter::score::InitialLaw;
use kalfit_filter::score::{Gradient, PhaseLaws, SmootherPlan, add, dependences};
use kalfit_model::{Alpha, PhasedModel, Slots};
use kalfit_model::{Evidence, PhaseReduction, PhasedTest};

/// Step of a value, relative to the size of the value. Differences of fourth order are good to about 1e-11 of ℓ.
const STEP: f64 = 2e-3;
/// Number of lengths tried for a step that leaves the model's domain.
const MAX_TRIALS: usize = 4;
/// Factor by which a step is shortened at each further trial.
const SHORTENING: f64 = 0.1;
/// Weights of ℓ at -2, -1, 1 and 2 steps.
pub(super) const WEIGHTS: [(f64, f64); 4] =
    [(-2.0, 1.0 / 12.0), (-1.0, -8.0 / 12.0), (1.0, 8.0 / 12.0), (2.0, -1.0 / 12.0)];

/// An ensemble, and α as a function of the sought values.
pub struct Around<'a> {
    /// The model.
    pub model: &'a PhasedModel,
    /// The tests of the ensemble.
    pub tests: &'a [PhasedTest],
    /// The free values of α.
    pub slots: &'a Slots,
    /// α at given sought values.
    pub alpha: &'a dyn Fn(&[f64]) -> Alpha,
}

/// The parts of an ensemble that are known by estimates.
#[derive(Debug)]
pub(crate) struct Indirect {
    /// Whether some test has estimates, by phase.
    phases: Vec<bool>,
    /// Index of each test with estimates, and slots of the free values that the estimates depend on.
    tests: Vec<(usize, Vec<usize>)>,
}

impl Indirect {
    pub(crate) fn of(model: &PhasedModel, tests: &[PhasedTest], slots: &Slots) -> Indirect {
        let depends: Vec<Vec<usize>> = model.phases.iter().map(|phase| dependences(phase, slots)).collect();
        let mut phases = vec![false; model.phases.len()];
        let mut all = Vec::new();
        for (j, test) in tests.iter().enumerate() {
            let mut own = BTreeSet::new();
            for (at, evidence) in test.phases.iter().enumerate().filter(|(at, e)| is_indirect(model, *at, e)) {
                phases[at] = true;
                let Some(cells) = evidence.cells() else { continue };
                let texts = (0..cells.rows()).map(|row| cells.texts(row));
                own.extend(texts.flat_map(|texts| depends[at].iter().filter_map(move |&p| slots.find(p, texts))));
            }
            if !own.is_empty() {
                all.push((j, own.into_iter().collect()));
            }
        }
        Indirect { phases, tests: all }
    }

    /// Indices of the free parameters that estimates depend on.
    pub(crate) fn parameters(&self, model: &PhasedModel, slots: &Slots) -> Vec<usize> {
        let phases = model.phases.iter().zip(&self.phases).filter(|(_, has)| **has);
        phases.flat_map(|(phase, _)| dependences(phase, slots)).collect()
    }

    /// Adds the contributions of estimates to the scores of their tests.
    pub(crate) fn add(
        &self,
        around: &Around<'_>,
        (reducer, values): (&PhasedReducer, &[f64]),
        (reductions, law): (&Reductions, &InitialLaw),
        scores: &mut [Gradient],
    ) -> Result<(), ReduceError> {
        if self.tests.is_empty() {
            return Ok(());
        }
        let tests = around.tests;
        let pieces = |reducer: &PhasedReducer, list: &[usize]| -> Result<Vec<Vec<PhaseReduction>>, ReduceError> {
            let one = |&j: &usize| reducer.pieces_of(&tests[j], &mut reducer.workspace());
            let all: Vec<Result<Vec<PhaseReduction>, ReduceError>> = list.par_iter().map(one).collect();
            all.into_iter().collect()
        };
        for colour in self.colours(values.len(), tests.len()) {
            let own = |(j, slots): &(usize, Vec<usize>)| slots.iter().find(|s| colour.contains(s)).map(|s| (*j, *s));
            let touched: Vec<(usize, usize)> = self.tests.iter().filter_map(own).collect();
            let list: Vec<usize> = touched.iter().map(|(j, _)| *j).collect();
            let home = pieces(reducer, &list)?;
            let places = WEIGHTS.map(|(sign, _)| sign);
            let (moved, steps) = moved(around, values, (&colour, &places), |reducer| pieces(reducer, &list))?;
            for (k, &(j, slot)) in touched.iter().enumerate() {
                let laws = PhaseLaws::new(law, &around.model.ranges(), reductions.get(j).covariates);
                let mut sum = 0.0;
                for (there, (_, weight)) in moved.iter().zip(WEIGHTS) {
                    let mixed = mixed(around.model, &tests[j], &home[k], &there[k]);
                    sum += weight * SmootherPlan::new(&mixed, &laws).likelihood(&mixed, &laws);
                }
                add(&mut scores[j], &vec![(slot, sum / steps[&slot])]);
            }
        }
        Ok(())
    }

    /// Sets of values without a common test.
    fn colours(&self, count: usize, tests: usize) -> Vec<Vec<usize>> {
        let mut touching = vec![Vec::new(); count];
        self.tests.iter().for_each(|(j, slots)| slots.iter().for_each(|&s| touching[s].push(*j)));
        let touching = touching.iter().enumerate().filter(|(_, tests)| !tests.is_empty());
        colours(touching.map(|(s, tests)| (s, Some(&**tests))), tests)
    }
}

/// Results of `at` with the values of a colour moved by each of `places`, in steps, and the steps.
pub(super) fn moved<T>(
    around: &Around<'_>,
    values: &[f64],
    (colour, places): (&[usize], &[f64]),
    at: impl Fn(&PhasedReducer) -> Result<T, ReduceError>,
) -> Result<(Vec<T>, BTreeMap<usize, f64>), ReduceError> {
    let mut part = 1.0;
    let mut last = None;
    for _ in 0..MAX_TRIALS {
        let step = |&s: &usize| {
            let size = if values[s] != 0.0 { values[s].abs() } else { 1.0 };
            (s, part * STEP * size)
        };
        let steps: BTreeMap<usize, f64> = colour.iter().map(step).collect();
        let one = |sign: &f64| {
            let mut values = values.to_vec();
            steps.iter().for_each(|(&s, h)| values[s] += sign * h);
            at(&PhasedReducer::scoring(around.model, &(around.alpha)(&values), around.slots)?)
        };
        match places.iter().map(one).collect::<Result<Vec<T>, ReduceError>>() {
            Ok(moved) => return Ok((moved, steps)),
            Err(error) => last = Some(error),
        }
        part *= SHORTENING;
    }
    Err(last.expect("there was a try"))
}

/// Whether a phase is known by a filter's estimates, made here or elsewhere.
fn is_indirect(model: &PhasedModel, at: usize, evidence: &Evidence) -> bool {
    match evidence {
        Evidence::Estimates(_) => true,
        Evidence::Rows(_) => model.phases.get(at).is_some_and(|phase| phase.filter.is_some()),
        Evidence::Reduced(_) => false,
    }
}

/// The phases of a test: phases known by estimates from `there`, at another α, other phases from `home`.
fn mixed(
    model: &PhasedModel,
    test: &PhasedTest,
    home: &[PhaseReduction],
    there: &[PhaseReduction],
) -> Vec<PhaseReduction> {
    let choose =
        |(at, evidence): (usize, &Evidence)| if is_indirect(model, at, evidence) { &there[at] } else { &home[at] };
    test.phases.iter().enumerate().map(choose).cloned().collect()
}

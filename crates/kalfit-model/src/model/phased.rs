//! Models of tests in several phases: a [`Model`] of each phase, and what a phase inherits from the phase before
//! (theory §7).

use std::sync::Arc;

use nalgebra::DMatrix;

use crate::ensemble::{LevelSlots, Selection};
use crate::model::{CovarianceStructure, Expression, Initial, Linear, Model};

/// The model of a whole test: its phases, in the order in which they happen.
///
/// Invariants, which the maker of a model must keep: there is at least one phase; all phases have the same `title`,
/// `columns`, `text_columns`, `literals`, `parameters` and `group`, so that one [`Alpha`](crate::Alpha) and one
/// [`Labels`](crate::Labels) serve all phases; the first phase has an empty `carry`; names of phases differ; a model of
/// several phases has a `column`; a model with levels has a single phase without a filter.
#[derive(Debug, Clone, PartialEq)]
pub struct PhasedModel {
    /// The phases.
    pub phases: Vec<Phase>,
    /// Index of the text column that names the phase of a row; `None` where all rows are of the only phase.
    pub column: Option<usize>,
    /// What tests have in common; empty where tests are independent of each other. The crossed factors (theory §16) stand
    /// first, then the nested levels of groups, the outermost first (theory §11).
    pub levels: Vec<GroupLevel>,
}

/// A level of groups of tests, or a factor whose groups cross those of the levels: ξ of a test is the sum of μ, of a
/// deviation of each group that contains the test, and of a deviation of the test. The covariance of the model is the
/// covariance of the deviations of tests.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupLevel {
    /// Name of the level, equal to the name of the column.
    pub name: String,
    /// Index of the text column with the name of the group, constant within a test. A group of a nested level is
    /// identified by this name and the names of all groups that contain the group, a group of a factor by this name alone.
    pub column: usize,
    /// Whether this is a crossed factor: its groups contain tests of any group of the other levels.
    pub crossed: bool,
    /// Covariance of the deviations of groups, p × p, without a `known` part.
    pub covariance: CovarianceStructure,
    /// The members of a test, where a crossed factor has several in one test (multiple membership, theory §16); empty
    /// where `column` names the only one.
    pub members: Vec<Membership>,
}

/// One of several groups of a crossed factor that a test meets: the instrument in one slot of a test bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Membership {
    /// Name of the slot.
    pub slot: String,
    /// Index of the text column with the name of the group, constant within a test; missing where the slot is empty.
    pub column: usize,
    /// Which effect of the group acts on each estimated state.
    pub selection: Arc<Selection>,
}

impl GroupLevel {
    /// The text columns that name the groups of a test.
    pub fn columns(&self) -> impl Iterator<Item = usize> + '_ {
        let only = self.members.is_empty().then_some(self.column);
        only.into_iter().chain(self.members.iter().map(|member| member.column))
    }

    /// Names of the effects of a group, one for each of the estimated states of these names: that of the state or, where
    /// a test has several members, without the slot.
    pub fn effect_names(&self, states: &[String]) -> Vec<String> {
        effect_names(&self.members, states)
    }

    /// Whether there is an effect of this index: where a test has several members, some states have none of their own.
    pub fn has_effect(&self, effect: usize) -> bool {
        let mut pairs = self.members.iter().flat_map(|member| member.selection.pairs());
        self.members.is_empty() || pairs.any(|pair| pair.1 == effect)
    }
}

/// Names of the effects of a group with these members, one for each of the estimated states of these names.
pub fn effect_names(members: &[Membership], states: &[String]) -> Vec<String> {
    let mut names: Vec<Option<String>> = vec![None; states.len()];
    for member in members {
        for &(state, effect) in member.selection.pairs() {
            names[effect] = stem(&states[state], &member.slot).map(str::to_owned);
        }
    }
    let is_effect = |name: &String| names.contains(&Some(name.clone()));
    let own = |(name, state): (&Option<String>, &String)| match name {
        Some(name) => name.clone(),
        // an effect may have the name of a state that has none
        None if is_effect(state) => format!("{state} (no effect)"),
        None => state.clone(),
    };
    names.iter().zip(states).map(own).collect()
}

/// The slot that a state is of, and its name without the slot: `A` and `bias` of `bias_A`; that with the longest name
/// where several fit.
pub fn slot_of<'s, 'n>(state: &'n str, slots: impl Iterator<Item = &'s str>) -> Option<(&'s str, &'n str)> {
    slots.filter_map(|slot| Some((slot, stem(state, slot)?))).min_by_key(|(_, stem)| stem.len())
}

fn stem<'n>(state: &'n str, slot: &str) -> Option<&'n str> {
    state.strip_suffix(slot)?.strip_suffix('_').filter(|stem| !stem.is_empty())
}

/// One phase.
#[derive(Debug, Clone, PartialEq)]
pub struct Phase {
    /// Name of the phase; `main` for the only phase of a model file without phases.
    pub name: String,
    /// Index in [`Model::literals`] of the text that marks the rows of the phase in the phase column; `None` without
    /// such a column.
    pub label: Option<usize>,
    /// States, measurements and constraints of the phase.
    pub model: Model,
    /// What x_0 inherits from the phase before, at most one entry for each state, in ascending order of state.
    pub carry: Vec<Carry>,
    /// The suboptimal filter whose estimates replace the measurements of the phase (theory §8).
    pub filter: Option<Filter>,
}

/// What x_0 of a state inherits: a linear form in the final states of the phase before, which is added to x_0;
/// coefficients are expressions in parameters and in columns constant within the test, evaluated on the first row of
/// the phase that inherits.
#[derive(Debug, Clone, PartialEq)]
pub struct Carry {
    /// Index of the state that inherits.
    pub state: usize,
    /// Terms in the states of the phase before.
    pub from: Linear,
}

/// A filter that need not be optimal.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    /// Indices of the states that the filter does not estimate but whose uncertainty the filter accounts for (Schmidt),
    /// ascending.
    pub consider: Vec<usize>,
    /// Prior mean of the filter, one number for each of the n states.
    pub mean: Vec<f64>,
    /// Prior covariance of the filter, n × n, positive semidefinite.
    pub covariance: DMatrix<f64>,
    /// (index of the parameter, value) for each parameter whose value in the filter differs from the value in the
    /// model.
    pub parameters: Vec<(usize, f64)>,
}

/// Name of the only phase of a model without phases.
pub const MAIN: &str = "main";

impl PhasedModel {
    /// The model of the first phase, for the fields that all phases have in common: title, columns, texts, parameters
    /// and group.
    pub fn shared(&self) -> &Model {
        &self.phases[0].model
    }

    /// The models of all phases, for writing. A field that all phases have in common must be changed in every model.
    pub fn models_mut(&mut self) -> impl Iterator<Item = &mut Model> {
        self.phases.iter_mut().map(|phase| &mut phase.model)
    }

    /// Σ_i p_i: the number of estimated states of all phases together.
    pub fn dimension(&self) -> usize {
        self.phases.iter().map(|phase| phase.model.dimension()).sum()
    }

    /// For each phase, the range of the estimated states of the phase among the estimated states of all phases.
    pub fn ranges(&self) -> Vec<std::ops::Range<usize>> {
        let mut end = 0;
        let range = |phase: &Phase| {
            let start = end;
            end += phase.model.dimension();
            start..end
        };
        self.phases.iter().map(range).collect()
    }

    /// (structure, range of states) of each block of Σ: a block for each phase or, with groups, a block for the only
    /// phase and then a block for each level of groups, the innermost first.
    pub fn blocks(&self) -> impl Iterator<Item = (&CovarianceStructure, std::ops::Range<usize>)> {
        let p = self.dimension();
        let phases = self.phases.iter().map(|phase| &phase.model.covariance).zip(self.ranges());
        let levels = self.levels.iter().rev().enumerate();
        phases.chain(levels.map(move |(l, level)| (&level.covariance, (l + 1) * p..(l + 2) * p)))
    }

    /// Names of the elements of all blocks of Σ: the estimated states, then, as `level.state`, the estimated states at
    /// each level of groups, the innermost first.
    pub fn element_names(&self) -> Vec<String> {
        let state_names = self.estimated_names();
        let of = |level: &GroupLevel| {
            level.effect_names(&state_names).iter().map(|name| format!("{}.{name}", level.name)).collect::<Vec<_>>()
        };
        state_names.iter().cloned().chain(self.levels.iter().rev().flat_map(of)).collect()
    }

    /// How the effects of each level enter a test.
    pub fn slots(&self) -> LevelSlots {
        let of = |level: &GroupLevel| level.members.iter().map(|member| member.selection.clone()).collect();
        LevelSlots::new(self.levels.iter().rev().map(of))
    }

    /// The crossed factors.
    pub fn factors(&self) -> &[GroupLevel] {
        &self.levels[..self.levels.iter().take_while(|level| level.crossed).count()]
    }

    /// The nested levels of groups, the outermost first.
    pub fn nested(&self) -> &[GroupLevel] {
        &self.levels[self.factors().len()..]
    }

    /// Whether there is only one phase.
    pub fn is_single(&self) -> bool {
        self.phases.len() == 1
    }

    /// Names of the estimated states of all phases, as `phase.state` where there are several phases.
    pub fn estimated_names(&self) -> Vec<String> {
        let of = |phase: &Phase| -> Vec<String> {
            let names = phase.model.estimated_names();
            if self.is_single() { names } else { names.iter().map(|name| format!("{}.{name}", phase.name)).collect() }
        };
        self.phases.iter().flat_map(of).collect()
    }
}

impl From<Model> for PhasedModel {
    fn from(model: Model) -> PhasedModel {
        let phase = Phase { name: MAIN.to_owned(), label: None, model, carry: Vec::new(), filter: None };
        PhasedModel { phases: vec![phase], column: None, levels: Vec::new() }
    }
}

impl Phase {
    /// The expressions in all linear forms that x_0 inherits.
    pub fn inherited_expressions(&self) -> impl Iterator<Item = &Expression> {
        self.carry.iter().flat_map(|carry| carry.from.expressions())
    }

    /// Indices of the states through which anything unknown enters, in the order of the coordinates of the reduction of
    /// the phase: the estimated states in the order of μ and Σ, then the states that only inherit.
    pub fn entering(&self) -> Vec<usize> {
        let mut states = self.model.estimated.clone();
        states.extend(self.carry.iter().map(|carry| carry.state).filter(|state| !self.model.estimated.contains(state)));
        states
    }

    /// The model with all entering states as ξ, from which the reduction is made: x_0 = a + E σ + ζ with σ the
    /// coordinates of [`Phase::entering`]. A state that only inherits keeps the known `initial`, which gives a and P0.
    pub fn entry_model(&self) -> Model {
        let mut model = self.model.clone();
        model.estimated = self.entering();
        debug_assert!(
            self.carry.iter().all(|carry| model.states[carry.state].initial != Initial::Stationary),
            "a stationary state inherits nothing"
        );
        let q = model.estimated.len();
        if let Some(known) = &mut model.covariance.known {
            known.iter_mut().for_each(|row| row.resize(q, Expression::Number(0.0)));
            known.resize(q, vec![Expression::Number(0.0); q]);
        }
        model
    }
}

//! Elements of μ and Σ by name.

use std::collections::HashMap;

use kalfit::model::{Initial, Membership, State, effect_names};

use crate::error::{Result, Span, SpecError, SpecProblem, StructureProblem};
use crate::names::NameIndex;
use crate::semidefinite::CovarianceDefect;
use crate::states::start_words;
use crate::suggest::suggest;
use crate::table::TomlField;

/// What the rows of a matrix are.
#[derive(Clone, Copy)]
enum ElementSet {
    Estimated,
    All,
}

/// States that a message lists; of more it says how many.
const LISTED: usize = 12;

/// The estimated states in the order of μ and Σ, or all states in file order.
#[derive(Clone)]
pub(crate) struct NamedElements {
    index: NameIndex,
    /// The other states, and how they start.
    others: HashMap<String, &'static str>,
    /// Which states these are, for messages about shapes.
    kind: ElementSet,
    /// Whether the state is random at all.
    random: Vec<bool>,
    /// Whether the state varies here; its variance is zero when not.
    pub(crate) varies: Vec<bool>,
    /// The list that says so, in words.
    list: Option<String>,
    /// States that are no effects here, and why.
    without_effect: HashMap<String, String>,
}

impl NamedElements {
    /// Of the states with these indices.
    pub(crate) fn new(states: &[State], estimated: &[usize]) -> NamedElements {
        let mut index = NameIndex::default();
        for &state in estimated {
            index.add(&states[state].name, 0..0);
        }
        let others = states.iter().filter(|state| state.initial != Initial::Estimated);
        let others = others.map(|state| (state.name.clone(), start_words(&state.initial))).collect();
        let random: Vec<bool> = estimated.iter().map(|&state| states[state].random).collect();
        NamedElements {
            index,
            others,
            kind: ElementSet::Estimated,
            varies: random.clone(),
            random,
            list: None,
            without_effect: HashMap::new(),
        }
    }

    /// The effects of a factor with slots, which act on the states of each slot; other states do not vary.
    pub(crate) fn of_slots(&self, members: &[Membership]) -> NamedElements {
        let names: Vec<String> = (0..self.len()).map(|i| self.name(i)).collect();
        let effects = effect_names(members, &names);
        let pairs = || members.iter().flat_map(|member| member.selection.pairs());
        let is_effect = |i: usize| pairs().any(|pair| pair.1 == i);
        let mut own = NamedElements { index: NameIndex::default(), without_effect: HashMap::new(), ..self.clone() };
        for (i, name) in names.iter().enumerate() {
            own.index.add(&effects[i], 0..0);
            own.random[i] = self.random[i] && is_effect(i);
            if !(0..self.len()).any(|other| is_effect(other) && effects[other] == *name) {
                let hint = match pairs().find(|pair| pair.0 == i) {
                    Some((_, effect)) => format!("here it is `{}`, in whatever slot", effects[*effect]),
                    None => "it is of no slot".to_owned(),
                };
                own.without_effect.insert(name.clone(), hint);
            }
        }
        NamedElements { varies: own.random.clone(), ..own }
    }

    /// All states, hidden ones too.
    pub(crate) fn whole(states: &[State]) -> NamedElements {
        let mut index = NameIndex::default();
        for state in states {
            index.add(&state.name, 0..0);
        }
        let random = vec![true; states.len()];
        NamedElements {
            index,
            others: HashMap::new(),
            kind: ElementSet::All,
            varies: random.clone(),
            random,
            list: None,
            without_effect: HashMap::new(),
        }
    }

    /// The same of which only those in a list vary, each random and named once.
    pub(crate) fn varying(&self, list: &TomlField<'_>) -> Result<NamedElements> {
        let place = list.what();
        let mut varies = vec![false; self.len()];
        for (name, span) in list.texts()? {
            let i = self.find(name, &place, &span)?;
            let name = name.to_owned();
            if !self.random[i] {
                return Err(SpecError::new(StructureProblem::Common { name, place }).at(span));
            }
            if std::mem::replace(&mut varies[i], true) {
                return Err(SpecError::new(StructureProblem::ListedTwice { name, place }).at(span));
            }
        }
        Ok(NamedElements { varies, list: Some(place), ..self.clone() })
    }

    /// The problem that a state which does not vary has a variance or covariance: `what`.
    pub(crate) fn still(&self, i: usize, what: &'static str, place: &str) -> StructureProblem {
        let (name, place) = (self.name(i), place.to_owned());
        match &self.list {
            Some(list) if self.random[i] => StructureProblem::NotVarying { name, list: list.clone(), what, place },
            _ => StructureProblem::NotRandom { name, what, place },
        }
    }

    /// What the rows and columns of a matrix are.
    pub(crate) fn order(&self) -> String {
        match self.kind {
            ElementSet::Estimated => "a row and a column for every estimated state, in the order of Σ".to_owned(),
            ElementSet::All if self.len() > LISTED => {
                format!("a row and a column for each of all {} states, in file order", self.len())
            }
            ElementSet::All => {
                let names: Vec<&str> = self.index.names().collect();
                format!("a row and a column for every state, in the order {}", names.join(", "))
            }
        }
    }

    /// p.
    pub(crate) fn len(&self) -> usize {
        self.varies.len()
    }

    pub(crate) fn name(&self, i: usize) -> String {
        self.index.name(i).to_owned()
    }

    /// "a, b".
    pub(crate) fn pair_name(&self, i: usize, j: usize) -> String {
        format!("{}, {}", self.index.name(j), self.index.name(i))
    }

    /// The element of a name.
    pub(crate) fn find(&self, name: &str, place: &str, span: &Span) -> Result<usize> {
        if let Some(hint) = self.without_effect.get(name) {
            let (name, place, hint) = (name.to_owned(), place.to_owned(), hint.clone());
            return Err(SpecError::new(StructureProblem::NoEffectOf { name, place, hint }).at(span.clone()));
        }
        if let Some(i) = self.index.get(name) {
            return Ok(i);
        }
        let (name, place) = (name.to_owned(), place.to_owned());
        let error = match self.others.get(&name) {
            Some(start) => SpecError::new(SpecProblem::NotEstimated { name, place, start }),
            None => {
                let hint = suggest(&name, self.index.names());
                SpecError::new(SpecProblem::UnknownName { what: "state", name, place }).maybe_hint(hint)
            }
        };
        Err(error.at(span.clone()))
    }
}

/// The two names of an element, "a, b", spaces aside.
pub(crate) fn pair<'d>(field: &TomlField<'d>, place: &str) -> Result<(&'d str, &'d str)> {
    pair_of(field.key, &field.key_span, place)
}

/// The two names in a text.
pub(crate) fn pair_of<'t>(text: &'t str, span: &Span, place: &str) -> Result<(&'t str, &'t str)> {
    let names: Vec<&str> = text.split(',').map(str::trim).take(3).collect();
    match names.as_slice() {
        [first, second] if !first.is_empty() && !second.is_empty() => Ok((first, second)),
        _ => {
            let (found, place, example) = (text.to_owned(), place.to_owned(), "a, b".to_owned());
            let variance = |name: &&str| format!("the variance of `{name}` is the element `{name}, {name}`");
            let hint = names.first().filter(|_| names.len() == 1).map(variance);
            let problem = StructureProblem::NotAnElement { found, place, example };
            Err(SpecError::new(problem).at(span.clone()).maybe_hint(hint))
        }
    }
}

/// The error of a matrix that is no covariance.
pub(crate) fn to_problem(defect: &CovarianceDefect, place: &str, name: &dyn Fn(usize) -> String) -> SpecError {
    let error = SpecError::new(defect.problem(place, name));
    match defect {
        CovarianceDefect::Eigenvalues { .. } => error.hint("every pair is possible by itself, but not all together"),
        _ => error,
    }
}

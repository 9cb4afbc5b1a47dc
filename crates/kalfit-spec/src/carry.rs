//! `[phases.NAME.carry]`: what x_0 of a phase inherits from the states in which the phase before it ended.

use std::collections::BTreeMap;

use kalfit::model::{Carry, Expression, Initial, Linear, State};

use crate::error::{Result, Span, SpecError, SpecProblem, StructureProblem};
use crate::expression::{self, ExpressionScope, ZERO};
use crate::names::{NameContext, NameIndex};
use crate::states::rate_of;
use crate::suggest::{nearest, suggest};
use crate::table::TomlField;
use crate::token::is_name;

/// The phase before, as far as its states are concerned.
pub(crate) struct PhaseBefore<'b> {
    pub(crate) name: &'b str,
    pub(crate) index: &'b mut NameIndex,
    pub(crate) states: &'b [State],
}

/// What is inherited, in ascending order of state, and where that is said.
#[derive(Default)]
pub(crate) struct InheritedStates {
    pub(crate) carry: Vec<Carry>,
    pub(crate) spans: BTreeMap<String, Span>,
}

/// Reads `carry`. The hidden rate of a second-order process goes where its owner goes, and adds nothing of its own.
pub(crate) fn read(
    context: &mut NameContext<'_>,
    field: &TomlField<'_>,
    states: &mut [State],
    mut before: PhaseBefore<'_>,
) -> Result<InheritedStates> {
    let place = context.phase.table("carry");
    let mut inherited = InheritedStates::default();
    for field in field.section(place.as_str())?.fields() {
        let state = visible(context, &field, &place)?;
        if states[state].initial == Initial::Stationary {
            return Err(stationary(context, &field));
        }
        let from = form(context, &field, &mut before)?;
        if let Some(rate) = rate_of(states, state) {
            let from = rates(&field, &from, before.states)?;
            states[rate].initial = Initial::Known { mean: ZERO, variance: ZERO };
            inherited.carry.push(Carry { state: rate, from });
        }
        inherited.carry.push(Carry { state, from });
        inherited.spans.insert(field.key.to_owned(), field.key_span);
    }
    inherited.carry.sort_by_key(|carry| carry.state);
    Ok(inherited)
}

/// The state of a key; hidden ones cannot be named.
fn visible(context: &NameContext<'_>, field: &TomlField<'_>, place: &str) -> Result<usize> {
    context.states.get(field.key).filter(|_| is_name(field.key)).ok_or_else(|| {
        let hidden = context.states.get(field.key).is_some();
        let hint = if hidden {
            Some("a hidden rate goes where its owner goes".to_owned())
        } else {
            suggest(field.key, context.states.names().filter(|name| is_name(name)))
        };
        let problem = SpecProblem::UnknownName { what: "state", name: field.key.to_owned(), place: place.to_owned() };
        SpecError::new(problem).at(field.key_span.clone()).maybe_hint(hint)
    })
}

fn stationary(context: &NameContext<'_>, field: &TomlField<'_>) -> SpecError {
    let phase = context.phase.name.as_deref().unwrap_or_default();
    SpecError::new(StructureProblem::StationaryInherits { name: field.key.to_owned() }).at(field.key_span.clone()).hint(
        format!(
            "say what phase `{phase}` adds: `initial = \"estimated\"`, or `initial = {{ mean = 0, sigma = 0 }}` for nothing"
        ),
    )
}

/// The linear form of one key, in the states of the phase before.
fn form(context: &mut NameContext<'_>, field: &TomlField<'_>, before: &mut PhaseBefore<'_>) -> Result<Linear> {
    let place = field.what();
    std::mem::swap(&mut context.states, before.index);
    let from = expression::linear(context, field, ExpressionScope::carry(&place));
    std::mem::swap(&mut context.states, before.index);
    let from = from?;
    refuse_own(context, field, &from, before.name)?;
    if from.terms.is_empty() {
        return Err(no_state(context, field, &from, before));
    }
    Ok(from)
}

/// Refuses a bare name that is a state of this phase only: it would be read as a column.
fn refuse_own(context: &NameContext<'_>, field: &TomlField<'_>, from: &Linear, before: &str) -> Result<()> {
    let text = field.as_text().unwrap_or_default();
    let own = |name: &&str| context.states.get(name).is_some() && !text.contains(&format!("`{name}`"));
    let Some(name) = columns(context, from).into_iter().find(own) else { return Ok(()) };
    let (name, before) = (name.to_owned(), before.to_owned());
    let error = SpecError::new(StructureProblem::OwnStateInCarry { name: name.clone(), before });
    Err(error.at(field.span.clone()).hint(format!("a column of this name is written `` `{name}` ``")))
}

fn no_state(context: &NameContext<'_>, field: &TomlField<'_>, from: &Linear, before: &PhaseBefore<'_>) -> SpecError {
    let meant = columns(context, from).into_iter().find_map(|name| nearest(name, before.index.names()));
    let hint = match meant {
        Some(state) => format!("did you mean `{state}`?"),
        None => "without `carry` a state starts afresh; `offset` adds a known amount to an estimated start".to_owned(),
    };
    let (name, before) = (field.key.to_owned(), before.name.to_owned());
    SpecError::new(StructureProblem::InheritsNothing { name, before }).at(field.span.clone()).hint(hint)
}

/// Numeric columns of a form.
fn columns<'c>(context: &'c NameContext<'_>, from: &Linear) -> Vec<&'c str> {
    let mut found = Vec::new();
    for part in from.terms.iter().map(|(_, coefficient)| coefficient).chain([&from.constant]) {
        part.any(&mut |part| {
            if let Expression::Column(column) = part {
                found.push(context.columns[*column].name.as_str());
            }
            false
        });
    }
    found
}

/// What the hidden rate inherits: the same form in the rates, since coefficients are constant within a test.
fn rates(field: &TomlField<'_>, from: &Linear, before: &[State]) -> Result<Linear> {
    let mut terms = Vec::with_capacity(from.terms.len());
    for (state, coefficient) in &from.terms {
        let Some(rate) = rate_of(before, *state) else {
            let (name, other) = (field.key.to_owned(), before[*state].name.clone());
            let hint = "write the process as two states, with `derivative`, to say what its rate inherits";
            return Err(SpecError::new(StructureProblem::NoRate { name, other }).at(field.span.clone()).hint(hint));
        };
        terms.push((rate, coefficient.clone()));
    }
    Ok(Linear { terms, constant: ZERO })
}

//! `as` of `[crossed.NAME]`: several members of one factor in a test, such as the instruments in the slots of a bench.

use std::sync::Arc;

use kalfit::ensemble::Selection;
use kalfit::model::{Membership, State, slot_of};

use crate::error::{Result, SpecError, SpecProblem, StructureProblem};
use crate::names::NameContext;
use crate::table::TomlField;

/// A factor whose levels stand in slots, before its states are known.
pub(crate) struct Slots<'t> {
    /// In words.
    place: String,
    /// Name of each slot, and its column.
    all: Vec<(TomlField<'t>, usize)>,
}

impl<'t> Slots<'t> {
    /// Reads the columns of the slots.
    pub(crate) fn read(context: &mut NameContext<'_>, field: &TomlField<'t>) -> Result<Slots<'t>> {
        let place = field.what();
        let section = field.section(place.as_str())?;
        let mut all: Vec<(TomlField<'t>, usize)> = Vec::new();
        for slot in section.fields() {
            let column = slot.text()?;
            if all.iter().any(|(other, _)| other.as_text().is_some_and(|other| other.trim() == column.trim())) {
                let problem = StructureProblem::ListedTwice { name: column.to_owned(), place };
                return Err(SpecError::new(problem).at(slot.span.clone()).hint("each slot has a column of its own"));
            }
            let index = context.text_column(column, slot.span.clone(), &place);
            all.push((slot, index));
        }
        if all.len() < 2 {
            let problem =
                StructureProblem::TooFew { place, found: "fewer than two slots", expected: "a column for each" };
            let hint = "a factor with one level in each test is a column of `crossed` in `[data]`";
            return Err(SpecError::new(problem).at(field.span.clone()).hint(hint));
        }
        Ok(Slots { place, all })
    }

    /// The members of a test: the effect on `bias` acts in slot `A` on the estimated state `bias_A`.
    pub(crate) fn members(&self, states: &[State], estimated: &[usize]) -> Result<Vec<Membership>> {
        let mut stems: Vec<(&str, usize)> = Vec::new();
        let mut selections = Vec::with_capacity(self.all.len());
        for (slot, _) in &self.all {
            let mut pairs = Vec::new();
            for (i, &state) in estimated.iter().enumerate() {
                let of = slot_of(&states[state].name, self.all.iter().map(|(slot, _)| slot.key));
                let Some((_, own)) = of.filter(|(own, _)| *own == slot.key) else { continue };
                let known = stems.iter().find(|(known, _)| *known == own).copied();
                let (_, effect) = known.unwrap_or((own, i));
                if known.is_none() {
                    stems.push((own, i));
                }
                self.refuse_unlike(slot, [&states[estimated[effect]], &states[state]])?;
                pairs.push((i, effect));
            }
            selections.push(pairs);
        }
        for ((slot, _), pairs) in self.all.iter().zip(&selections) {
            let missing = stems.iter().find(|(_, effect)| pairs.iter().all(|pair| pair.1 != *effect));
            if pairs.is_empty() || missing.is_some() {
                let stem = missing.map_or("NAME", |(stem, _)| stem);
                let (slot_name, state) = (slot.key.to_owned(), format!("{stem}_{}", slot.key));
                let problem = StructureProblem::NoStateOfSlot { slot: slot_name, place: self.place.clone(), state };
                let hint = "the states of a slot end in `_` and its name: `bias_A` and `bias_B` of the slots A and B";
                return Err(SpecError::new(problem).at(slot.key_span.clone()).hint(hint));
            }
        }
        let member = |((slot, column), pairs): (&(TomlField<'_>, usize), Vec<(usize, usize)>)| Membership {
            slot: slot.key.to_owned(),
            column: *column,
            selection: Arc::new(Selection::new(pairs)),
        };
        Ok(self.all.iter().zip(selections).map(member).collect())
    }

    /// Refuses states of two slots that one effect cannot act on.
    fn refuse_unlike(&self, slot: &TomlField<'_>, [first, second]: [&State; 2]) -> Result<()> {
        let what = match () {
            () if first.unit != second.unit => "units",
            () if first.random != second.random => "`random`",
            () => return Ok(()),
        };
        let (first, second) = (first.name.clone(), second.name.clone());
        let problem =
            SpecProblem::Structure(StructureProblem::UnlikeSlots { first, second, what, place: self.place.clone() });
        Err(SpecError::new(problem).at(slot.key_span.clone()))
    }
}

//! `[outputs]`: what is linear in the states as measurements are, and is predicted instead of measured.

use kalfit::predict::Output;

use crate::error::{Result, SpecError, SpecProblem};
use crate::expression::{self, ExpressionScope};
use crate::keys;
use crate::names::{NameContext, NameIndex, check_label};
use crate::phases::{self, PhaseSource};
use crate::table::{TomlField, TomlTable};

/// Outputs of one file.
const MAX_OUTPUTS: usize = 500;

/// The outputs of a file, in a table by name.
pub(crate) fn listed<'d>(field: &TomlField<'d>) -> Result<TomlTable<'d>> {
    let section = field.section("`[outputs]`")?;
    let found = section.len();
    if found == 0 || found > MAX_OUTPUTS {
        let problem = SpecProblem::Count { what: "outputs", found, expected: format!("1 to {MAX_OUTPUTS}") };
        return Err(SpecError::new(problem).at(field.key_span.clone()));
    }
    Ok(section)
}

/// The outputs of a phase: those that name it, and those that name none.
pub(crate) fn outputs(
    context: &mut NameContext<'_>,
    section: &TomlTable<'_>,
    source: &PhaseSource<'_>,
) -> Result<Vec<Output>> {
    let mut all = Vec::new();
    for field in section.fields() {
        check_label("output", field.key, &field.key_span)?;
        if let Some(output) = one(context, &field, source)? {
            all.push(output);
        }
    }
    Ok(all)
}

fn one(context: &mut NameContext<'_>, field: &TomlField<'_>, source: &PhaseSource<'_>) -> Result<Option<Output>> {
    let mut section = field.section(format!("output `{}`", field.key))?.with_keys(keys::OUTPUT)?;
    let equation = section.need("equation")?;
    let unit = section.take("unit").map(|unit| unit.text().map(str::to_owned)).transpose()?;
    if let Some(phase) = section.take("phase")
        && phase.text()? != source.name
    {
        return Ok(None);
    }
    let place = equation.what();
    let equation = expression::linear(context, &equation, ExpressionScope::equation(&place))?;
    section.finish("here", None)?;
    Ok(Some(Output { name: field.key.to_owned(), unit, equation }))
}

/// Refuses outputs of phases that there are not, and names that are states' at the same time.
pub(crate) fn check(section: &TomlTable<'_>, sources: &[PhaseSource<'_>], states: &[&NameIndex]) -> Result<()> {
    for field in section.fields() {
        if states.iter().any(|states| states.get(field.key).is_some()) {
            let problem = SpecProblem::BadName { what: "output", name: field.key.to_owned(), why: "a state has it" };
            return Err(SpecError::new(problem).at(field.key_span.clone()).hint("states are told anyway"));
        }
        let own = field.section(format!("output `{}`", field.key))?;
        let Some(phase) = own.peek("phase") else { continue };
        let place = phase.what();
        if sources.iter().all(|source| source.span.is_none()) {
            return Err(phase.no_effect("with a model without phases"));
        }
        phases::find(phase.text()?, sources.iter().map(|source| source.name), &place, &phase.span)?;
    }
    Ok(())
}

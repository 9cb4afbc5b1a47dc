//! A model as it describes tests that nobody has made: without measurements, and with outputs, which are linear in the states as
//! measurements are.
//!
//! The tables of the two files are read together. Places in the file of outputs are counted from the end of the model's text, so that
//! every message still knows its file.

use kalfit::predict::Output;
use toml::de::DeTable;

use crate::beside::{BesideError, located, moved};
use crate::build::{self, MAX_BYTES, Purpose};
use crate::error::{Problem, Result, SpecError};
use crate::expression::{self, Scope};
use crate::merge::shifted_table;
use crate::names::{Context, Index, check_label};
use crate::phases::{self, Source};
use crate::spec::Spec;
use crate::table::{Field, Section};

/// The file of outputs in messages.
const PLACE: &str = "the file of outputs";
const KEYS: [&str; 3] = ["equation", "unit", "phase"];
/// Outputs of one file.
const MAX_OUTPUTS: usize = 500;

/// A model for designs of tests.
#[derive(Debug, Clone)]
pub struct DesignSpec {
    /// The model, which measures nothing.
    pub spec: Spec,
    /// The outputs of each phase.
    pub outputs: Vec<Vec<Output>>,
}

impl Spec {
    /// The same model for designs of tests that nobody has made: it reads the columns of its motion and of the outputs, not those of its
    /// measurements; and those of its levels only with `levels`. `outputs`: the text of a file of `[outputs.NAME]`.
    ///
    /// # Errors
    /// What is wrong with the text.
    pub fn design(&self, outputs: Option<&str>, levels: bool) -> std::result::Result<DesignSpec, BesideError> {
        let second = outputs.unwrap_or_default();
        let found = second.len() as u64;
        if found > MAX_BYTES {
            let problem = Problem::TooLarge { found, limit: MAX_BYTES };
            return Err(BesideError::File(SpecError::new(problem)));
        }
        let (text, offset) = (format!("{}\n{second}", self.text), self.text.len() + 1);
        self.designed(&text, offset, (outputs.is_some(), levels)).map_err(|error| located(error, offset))
    }

    fn designed(&self, text: &str, offset: usize, (named, levels): (bool, bool)) -> Result<DesignSpec> {
        let (first, second) = (&text[..offset - 1], &text[offset..]);
        let own = DeTable::parse(second).map_err(|error| moved(build::not_toml(&error, second), offset))?;
        let own = shifted_table(own.into_inner(), offset);
        let base = DeTable::parse(first).map_err(|error| build::not_toml(&error, first))?.into_inner();
        let mut table = Section::open(PLACE, offset..text.len(), &own).only(&["outputs"])?;
        let outputs = match table.take("outputs") {
            Some(field) => Some(listed(&field)?),
            None if named => {
                return Err(table.missing("outputs").hint("an output is a table, as in `[outputs.range]`"));
            }
            None => None,
        };
        let root = Section::open("the model file", 0..text.len(), &base);
        let purpose = Purpose::Designs { outputs: outputs.as_ref(), levels };
        let build::Built { model, layout, mut places, outputs } = build::model(text, root, purpose)?;
        places.columns.retain(|_, span| span.start < offset); // places are those of the model file
        let spec = Spec { model, layout, places, ..self.clone() };
        Ok(DesignSpec { spec, outputs })
    }
}

fn listed<'d>(field: &Field<'d>) -> Result<Section<'d>> {
    let section = field.section("`[outputs]`")?;
    let found = section.len();
    if found == 0 || found > MAX_OUTPUTS {
        let problem = Problem::Count { what: "outputs", found, expected: format!("1 to {MAX_OUTPUTS}") };
        return Err(SpecError::new(problem).at(field.key_span.clone()));
    }
    Ok(section)
}

/// The outputs of a phase: those that name it, and those that name none.
pub(crate) fn outputs(context: &mut Context<'_>, section: &Section<'_>, source: &Source<'_>) -> Result<Vec<Output>> {
    let mut all = Vec::new();
    for field in section.fields() {
        check_label("output", field.key, &field.key_span)?;
        if let Some(output) = one(context, &field, source)? {
            all.push(output);
        }
    }
    Ok(all)
}

fn one(context: &mut Context<'_>, field: &Field<'_>, source: &Source<'_>) -> Result<Option<Output>> {
    let mut section = field.section(format!("output `{}`", field.key))?.only(&KEYS)?;
    let equation = section.need("equation")?;
    let unit = section.take("unit").map(|unit| unit.text().map(str::to_owned)).transpose()?;
    if let Some(phase) = section.take("phase")
        && phase.text()? != source.name
    {
        return Ok(None);
    }
    let place = equation.what();
    let equation = expression::linear(context, &equation, Scope::equation(&place))?;
    section.finish("here", None)?;
    Ok(Some(Output { name: field.key.to_owned(), unit, equation }))
}

/// Refuses outputs of phases that there are not, and names that are states' at the same time.
pub(crate) fn check(section: &Section<'_>, sources: &[Source<'_>], states: &[&Index]) -> Result<()> {
    for field in section.fields() {
        if states.iter().any(|states| states.get(field.key).is_some()) {
            let problem = Problem::BadName { what: "output", name: field.key.to_owned(), why: "a state has it" };
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

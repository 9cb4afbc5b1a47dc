//! `[phases]`: which phases there are, and what each takes from the top level.

use kalfit::model::MAIN;

use crate::error::{Result, Span, SpecError, SpecProblem};
use crate::keys;
use crate::names::{PhaseInWords, check_label, phase_key};
use crate::suggest::suggest;
use crate::table::{TomlField, TomlTable};

/// Phases of one model.
const MAX_PHASES: usize = 100;
/// States of all phases together, and measurements: phases that share tables make much of a small file.
const MAX_TOGETHER: usize = 2_000;

/// Where the tables of a phase stand.
pub(crate) struct PhaseSource<'d> {
    /// Its name.
    pub(crate) name: &'d str,
    /// Its key in `[phases]`; `None` for the only phase of a file without phases.
    pub(crate) span: Option<Span>,
    own: Option<TomlTable<'d>>,
    top: Vec<TomlField<'d>>,
}

/// The phases in order of appearance; without `[phases]` there is one, made of the top level.
pub(crate) fn open<'d>(root: &mut TomlTable<'d>) -> Result<Vec<PhaseSource<'d>>> {
    let top: Vec<TomlField<'d>> = keys::phase_tables().filter_map(|key| root.take(key)).collect();
    let Some(field) = root.take("phases") else {
        return Ok(vec![PhaseSource { name: MAIN, span: None, own: None, top }]);
    };
    let section = field.section("`[phases]`")?;
    let found = section.len();
    if found == 0 || found > MAX_PHASES {
        let problem = SpecProblem::Count { what: "phases", found, expected: format!("1 to {MAX_PHASES}") };
        return Err(SpecError::new(problem)
            .at(field.key_span)
            .hint("a phase has tables, as in `[phases.coast.states]`"));
    }
    let mut phases = Vec::with_capacity(found);
    for field in section.fields() {
        check_label("phase", field.key, &field.key_span)?;
        let own = known(field.section(format!("`[{}]`", phase_key(field.key)))?)?;
        phases.push(PhaseSource { name: field.key, span: Some(field.key_span), own: Some(own), top: top.clone() });
    }
    refuse_idle(&phases, &top)?;
    Ok(phases)
}

fn known(section: TomlTable<'_>) -> Result<TomlTable<'_>> {
    if let Some(field) = section.peek("parameters") {
        let problem = SpecProblem::UnknownKey { key: field.key.to_owned(), place: section.place.clone() };
        let hint = "phases share parameters by name: they stand in `[parameters]`";
        return Err(SpecError::new(problem).at(field.key_span).hint(hint));
    }
    section.with_keys(keys::PHASE)
}

/// Refuses tables of the top level that no phase takes, and what the first phase cannot have.
fn refuse_idle(phases: &[PhaseSource<'_>], top: &[TomlField<'_>]) -> Result<()> {
    if let Some(carry) = phases[0].own("carry") {
        let hint = "phases happen in the order in which the file names them first";
        return Err(carry.no_effect("in the first phase, which inherits nothing").hint(hint));
    }
    match top.iter().find(|field| phases.iter().all(|phase| phase.own(field.key).is_some())) {
        None => Ok(()),
        Some(field) => Err(field.no_effect("when every phase has its own")),
    }
}

impl<'d> PhaseSource<'d> {
    /// A key of the phase itself.
    pub(crate) fn own(&self, key: &str) -> Option<TomlField<'d>> {
        self.own.as_ref().and_then(|own| own.peek(key))
    }

    /// A table of the phase, its own or that of the top level.
    pub(crate) fn table(&self, key: &str) -> Option<TomlField<'d>> {
        self.own(key).or_else(|| self.top.iter().find(|field| field.key == key).cloned())
    }

    /// The phase in messages.
    pub(crate) fn within(&self) -> PhaseInWords {
        let own = keys::names(keys::PHASE).into_iter().filter(|key| self.own(key).is_some()).collect();
        PhaseInWords { name: self.span.as_ref().map(|_| self.name.to_owned()), own }
    }

    /// An error that arose while this phase was read: one in a table of the top level says which phase takes it.
    pub(crate) fn explain(&self, key: &str, error: SpecError) -> SpecError {
        if self.span.is_none() || self.own(key).is_some() || error.label.is_some() {
            return error;
        }
        let error = match (&error.span, self.table(key)) {
            (None, None) => error.at(self.span.clone().expect("it is a phase of the file")),
            _ => error,
        };
        error.label(format!("for phase `{}`, which has no `{key}` of its own", self.name))
    }

    /// Refuses models that are too large when all phases are taken together.
    pub(crate) fn count(&self, what: &'static str, found: usize) -> Result<()> {
        if found <= MAX_TOGETHER {
            return Ok(());
        }
        let problem = SpecProblem::Count { what, found, expected: format!("at most {MAX_TOGETHER}") };
        let error = SpecError::new(problem);
        Err(self.span.clone().map_or(error.clone(), |span| error.at(span)))
    }
}

/// Refuses a name that is no phase.
pub(crate) fn find<'n>(
    name: &str,
    known: impl Iterator<Item = &'n str> + Clone,
    place: &str,
    span: &Span,
) -> Result<()> {
    if known.clone().any(|phase| phase == name) {
        return Ok(());
    }
    let problem = SpecProblem::UnknownName { what: "phase", name: name.to_owned(), place: place.to_owned() };
    Err(SpecError::new(problem).at(span.clone()).maybe_hint(suggest(name, known)))
}

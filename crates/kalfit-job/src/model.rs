//! The model file, read, with what `--set` says.

use kalfit::model::Parameter;
use kalfit::{Alpha, Model};
use kalfit_data::Datum;
use kalfit_spec::Spec;

use crate::document::Document;
use crate::failure::Failure;
use crate::job::ModelJob;

/// Reads the model; `data` were named beside it.
pub(crate) fn load(job: &ModelJob, data: &[Datum]) -> Result<Spec, Failure> {
    let mut spec = read(&job.document).map_err(|failure| swapped(failure, &job.document, data))?;
    set(&mut spec, &job.set)?;
    Ok(spec)
}

/// Endings of tables.
const TABLES: [&str; 8] = [".csv", ".tsv", ".txt", ".parquet", ".arrow", ".ipc", ".feather", ".gz"];

/// Whether a name is that of a table, by its ending.
pub(crate) fn is_table(name: &str) -> bool {
    TABLES.iter().any(|ending| name.to_lowercase().ends_with(ending))
}

/// Of a model that is none, where the model stands among the data: the one was named in the other's place.
fn swapped(mut failure: Failure, document: &Document, data: &[Datum]) -> Failure {
    let name = document.name();
    let model = data.iter().find_map(|datum| match datum {
        Datum::Named(name) if name.ends_with(".toml") => Some(name),
        _ => None,
    });
    if let (Failure::Model { error, .. }, Some(model), true) = (&mut failure, model, is_table(&name)) {
        error.hint = Some(format!("the model comes first, then the data: `{model} {name}`"));
    }
    failure
}

/// Refuses a model with crossed factors; `what` is not done with it, as the beginning of a sentence.
pub(crate) fn refuse_crossed(spec: &Spec, what: &'static str, hint: &'static str) -> Result<(), Failure> {
    if spec.model.factors().is_empty() { Ok(()) } else { Err(Failure::Crossed { what, hint }) }
}

/// Reads a model as it stands.
///
/// # Errors
/// [`Failure::Model`], with the place in the text.
pub fn read(document: &Document) -> Result<Spec, Failure> {
    let (name, text) = (document.name(), text(document)?);
    Spec::parse(&name, &text).map_err(|mut error| {
        if name.to_lowercase().ends_with(".json") {
            error.hint = Some("this should be a model file; results of a fit are given by `--from`".to_owned());
        } else if is_table(&name) {
            error.hint = Some("the model file comes first, then the data".to_owned());
        }
        Failure::model(error, &name, Some(text))
    })
}

/// The text of a model or of a hypothesis.
pub(crate) fn text(document: &Document) -> Result<String, Failure> {
    match document {
        Document::File(path) => Spec::read_text(path).map_err(|error| Failure::model(error, &document.name(), None)),
        Document::Text { text, .. } => Ok(text.clone()),
    }
}

/// Does what `--set` says.
pub(crate) fn set(spec: &mut Spec, assignments: &[String]) -> Result<(), Failure> {
    assignments
        .iter()
        .try_for_each(|assignment| spec.set(assignment).map_err(|error| Failure::Set { error: Box::new(error) }))
}

/// The values of all parameters of a model without free ones.
pub(crate) fn alpha(spec: &Spec) -> Alpha {
    Alpha::fixed(&spec.model.shared().parameters).expect("no parameter is free")
}

/// True when some parameter has no value, or may have levels without one.
pub(crate) fn has_free(model: &Model) -> bool {
    model.parameters.iter().any(Parameter::is_free)
}

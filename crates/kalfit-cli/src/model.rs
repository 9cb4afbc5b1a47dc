//! The model file, read, with what `--set` says.

use std::path::Path;

use kalfit::model::ParameterError;
use kalfit::{Alpha, Model};
use kalfit_spec::Spec;

use crate::failure::{Failure, Place};
use crate::job::ModelJob;

/// Reads the model.
pub(crate) fn load(job: &ModelJob) -> Result<Spec, Failure> {
    let mut spec = read(&job.path)?;
    set(&mut spec, &job.set)?;
    Ok(spec)
}

/// Reads a model file as it stands.
pub(crate) fn read(path: &Path) -> Result<Spec, Failure> {
    let text = Spec::read_text(path).map_err(|error| Failure::model(error, path, None))?;
    let name = path.display().to_string();
    Spec::parse(&name, &text).map_err(|error| Failure::model(error, path, Some(text)))
}

/// Does what `--set` says.
pub(crate) fn set(spec: &mut Spec, assignments: &[String]) -> Result<(), Failure> {
    assignments
        .iter()
        .try_for_each(|assignment| spec.set(assignment).map_err(|error| Failure::Set { error: Box::new(error) }))
}

/// The values of all parameters, which must be known.
pub(crate) fn alpha(spec: &Spec) -> Result<Alpha, Failure> {
    Alpha::fixed(&spec.model.parameters).map_err(|ParameterError::Free { names }| {
        let span = names.first().and_then(|name| spec.parameter_span(name));
        Failure::Free { place: Place::in_model(spec, span, "free"), names }
    })
}

/// Names of the free parameters.
pub(crate) fn free_parameters(model: &Model) -> Vec<String> {
    model.parameters.iter().filter(|p| p.is_free()).map(|p| p.name.clone()).collect()
}

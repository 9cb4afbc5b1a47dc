//! The model file, read, with what `--set` says.

use std::path::Path;

use kalfit::model::Parameter;
use kalfit::{Alpha, Model};
use kalfit_spec::Spec;

use crate::failure::Failure;
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

/// The values of all parameters of a model without free ones.
pub(crate) fn alpha(spec: &Spec) -> Alpha {
    Alpha::fixed(&spec.model.shared().parameters).expect("no parameter is free")
}

/// True when some parameter has no value, or may have levels without one.
pub(crate) fn has_free(model: &Model) -> bool {
    model.parameters.iter().any(Parameter::is_free)
}

//! A model under parts of a hypothesis: what it says of μ, of Σ, of α.

use kalfit::model::{CovarianceStructure, MeanStructure, Parameter, Phase, Value};
use kalfit::{Model, PhasedModel};

/// A model with each phase's changed.
pub(crate) fn each(model: &PhasedModel, change: &dyn Fn(usize, Model) -> Model) -> PhasedModel {
    let of = |(i, phase): (usize, &Phase)| Phase { model: change(i, phase.model.clone()), ..phase.clone() };
    PhasedModel { phases: model.phases.iter().enumerate().map(of).collect(), ..model.clone() }
}

/// The model under what the hypothesis says of the mean alone; `None` when that is nothing.
pub(crate) fn with_mean(model: &PhasedModel, null: &PhasedModel) -> Option<PhasedModel> {
    let of = |model: &PhasedModel| -> Vec<MeanStructure> {
        model.phases.iter().map(|phase| unstarted(&phase.model.mean)).collect()
    };
    let said = |i: usize, model: Model| Model { mean: null.phases[i].model.mean.clone(), ..model };
    (of(model) != of(null)).then(|| each(model, &said))
}

/// The model under what the hypothesis says of the covariance alone, that of each level among it; `None` when that is nothing.
pub(crate) fn with_covariance(model: &PhasedModel, null: &PhasedModel) -> Option<PhasedModel> {
    let of = |model: &PhasedModel| -> Vec<CovarianceStructure> {
        model.blocks().map(|(structure, _)| CovarianceStructure { start: None, ..structure.clone() }).collect()
    };
    let said = |i: usize, model: Model| Model { covariance: null.phases[i].model.covariance.clone(), ..model };
    (of(model) != of(null)).then(|| PhasedModel { levels: null.levels.clone(), ..each(model, &said) })
}

/// The model under what the hypothesis says of the parameters alone; `None` when that is nothing.
pub(crate) fn with_parameters(model: &PhasedModel, null: &PhasedModel) -> Option<PhasedModel> {
    let said = |_: usize, model: Model| Model { parameters: null.shared().parameters.clone(), ..model };
    (unstarted_parameters(model.shared()) != unstarted_parameters(null.shared())).then(|| each(model, &said))
}

/// Whether the hypothesis says nothing but of the mean.
pub(crate) fn is_of_mean(model: &PhasedModel, null: &PhasedModel) -> bool {
    with_mean(model, null).is_some() && with_covariance(model, null).is_none() && with_parameters(model, null).is_none()
}

/// A structure without start values, which constrain nothing.
fn unstarted(mean: &MeanStructure) -> MeanStructure {
    MeanStructure { start: vec![None; mean.start.len()], ..mean.clone() }
}

fn unstarted_parameters(model: &Model) -> Vec<Parameter> {
    let one = |parameter: &Parameter| {
        let value = match parameter.value {
            Value::Free { .. } => Value::Free { start: None },
            fixed => fixed,
        };
        Parameter { value, unit: None, ..parameter.clone() }
    };
    model.parameters.iter().map(one).collect()
}

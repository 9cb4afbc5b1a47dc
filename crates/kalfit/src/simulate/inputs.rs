//! Which columns a model reads as inputs.

use crate::model::{CovarianceKind, Expression, Initial, Linear, Model, Motion, Phase};
use crate::simulate::SimulateError;

/// A drawn value must not change what the model does with other cells: a column that a phase measures and that is an input of
/// it too is refused.
pub(super) fn refuse_measured_inputs(phase: &Phase) -> Result<(), SimulateError> {
    let model = &phase.model;
    let is_measured = |column: usize| model.measurements.iter().any(|m| m.column == column);
    let mut clash = None;
    let mut all = expressions(model);
    phase.carry.iter().for_each(|carry| linear(&carry.from, &mut all));
    for expression in all {
        expression.any(&mut |part| {
            if let Expression::Column(column) = part {
                clash = clash.or(Some(*column).filter(|&column| is_measured(column)));
            }
            clash.is_some()
        });
    }
    let mut others = model.clock.time.into_iter().chain(model.mean.regression.iter().map(|r| r.column));
    clash = clash.or_else(|| others.find(|&column| is_measured(column)));
    let mut texts = model.text_columns.iter().map(|column| &column.name);
    let text = texts.find(|name| model.measurements.iter().any(|m| model.columns[m.column].name == **name));
    match clash.map(|column| &model.columns[column].name).or(text) {
        Some(column) => Err(SimulateError::MeasuredInput { column: column.clone() }),
        None => Ok(()),
    }
}

/// Every expression of the model that rows are read for.
fn expressions(model: &Model) -> Vec<&Expression> {
    let mut all: Vec<&Expression> = Vec::new();
    for state in &model.states {
        match &state.motion {
            Motion::Constant => {}
            Motion::Continuous { derivative: form, noise_variance }
            | Motion::Discrete { next: form, noise_variance } => {
                linear(form, &mut all);
                all.push(noise_variance);
            }
        }
        if let Initial::Known { mean, variance } = &state.initial {
            all.extend([mean, variance]);
        }
        all.extend(&state.offset);
    }
    for measurement in &model.measurements {
        linear(&measurement.equation, &mut all);
        all.extend(&measurement.filter);
        all.push(&measurement.noise_variance);
    }
    all.extend(model.process_noise_covariance.iter().chain(&model.noise_covariance).map(|(.., covariance)| covariance));
    all.extend(&model.clock.initial_time);
    all.extend(model.covariance.known.iter().flatten().flatten());
    if let CovarianceKind::Proportional(m) | CovarianceKind::Correlation(m) | CovarianceKind::Fixed(m) =
        &model.covariance.kind
    {
        all.extend(m.iter().flatten());
    }
    all
}

fn linear<'a>(form: &'a Linear, all: &mut Vec<&'a Expression>) {
    all.extend(form.terms.iter().map(|(_, coefficient)| coefficient));
    all.push(&form.constant);
}

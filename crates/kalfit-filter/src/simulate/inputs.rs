//! Columns that a model reads as inputs.

use crate::simulate::SimulateError;
use kalfit_model::{Expression, Phase};

/// Refuses a column that a phase both measures and reads as an input: a drawn value must not change the coefficients of
/// the model on other cells.
pub(super) fn refuse_measured_inputs(phase: &Phase) -> Result<(), SimulateError> {
    let model = &phase.model;
    let is_measured = |column: usize| model.measurements.iter().any(|m| m.column == column);
    let mut measured_input = None;
    let model_expressions = model.expressions().into_iter().map(|(_, expression)| expression);
    for expression in model_expressions.chain(phase.carry.iter().flat_map(|carry| carry.from.expressions())) {
        expression.any(&mut |part| {
            if let Expression::Column(column) = part {
                measured_input = measured_input.or(Some(*column).filter(|&column| is_measured(column)));
            }
            measured_input.is_some()
        });
    }
    let mut remaining_columns = model.clock.time.into_iter().chain(model.mean.regression.iter().map(|r| r.column));
    measured_input = measured_input.or_else(|| remaining_columns.find(|&column| is_measured(column)));
    let mut texts = model.text_columns.iter().map(|column| &column.name);
    let text = texts.find(|name| model.measurements.iter().any(|m| model.columns[m.column].name == **name));
    match measured_input.map(|column| &model.columns[column].name).or(text) {
        Some(column) => Err(SimulateError::MeasuredInput { column: column.clone() }),
        None => Ok(()),
    }
}

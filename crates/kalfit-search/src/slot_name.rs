//! The name of a free value in messages.

use kalfit_model::Labels;
use kalfit_model::{Model, Slots};

/// `` `tau` ``, or `` `sigma` for lot B ``.
pub fn slot_name(model: &Model, labels: &Labels, slots: &Slots, s: usize) -> String {
    let slot = slots.slots()[s];
    let parameter = &model.parameters[slot.parameter];
    match (parameter.per, slot.level) {
        (Some(column), Some(level)) => {
            format!("`{}` for {} {}", parameter.name, model.text_columns[column].name, labels.text(level))
        }
        _ => format!("`{}`", parameter.name),
    }
}

//! The least that noise can be.

use kalfit::Model;
use kalfit::model::{Alpha, Value};

/// α with each known parameter at its value and each other one at its lower bound, or zero.
pub(super) fn least(model: &Model) -> Alpha {
    Alpha::common(model.parameters.iter().map(|parameter| match parameter.value {
        Value::Fixed(value) => value,
        Value::Free { .. } => parameter.lower.unwrap_or(0.0),
    }))
}

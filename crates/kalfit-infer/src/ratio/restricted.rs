//! Checks whether a hypothesis on α lies within a model, and counts the free values that the hypothesis removes.

use kalfit_model::Label;
use kalfit_model::{Alpha, Model, Parameter, PhasedModel, Slots};
use kalfit_model::{Evidence, PhasedTest};

/// Why a hypothesis on α cannot be tested within a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotNestedParameter {
    /// The model fixes the parameter at another value, or the hypothesis leaves the parameter free.
    #[error("the model fixes parameter `{name}` at {expected}, and the hypothesis {}", fixed_words(found))]
    Fixed {
        /// Name of the parameter.
        name: String,
        /// Value of the parameter under the hypothesis; `None` where the hypothesis leaves the parameter free.
        found: Option<f64>,
        /// Value of the parameter in the model.
        expected: f64,
    },
    /// The hypothesis has more than one value where the model has one.
    #[error("the hypothesis lets parameter `{name}` differ where the model has one value")]
    Levels {
        /// Name of the parameter.
        name: String,
    },
    /// The hypothesis fixes the parameter at a value that the model does not allow.
    #[error("the hypothesis has parameter `{name}` at {found}, and the model wants it {expected}")]
    OutOfBounds {
        /// Name of the parameter.
        name: String,
        /// Value of the parameter under the hypothesis.
        found: f64,
        /// The bound, in words.
        expected: String,
    },
    /// The parameter is free in hypothesis and model, with different bounds.
    #[error("the bounds of parameter `{name}` are not the same in the hypothesis as in the model")]
    Bounds {
        /// Name of the parameter.
        name: String,
    },
}

fn fixed_words(found: &Option<f64>) -> String {
    found.map_or("leaves it free".to_owned(), |value| format!("has it at {value}"))
}

/// Free values of α that a hypothesis removes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Restricted {
    /// Number of free values that the hypothesis removes.
    pub count: usize,
    /// Number of free values of the model that the hypothesis fixes at a bound.
    pub at_bound: usize,
}

/// A free value of the model under the hypothesis: still free, in a slot, or fixed at a value.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Target {
    Slot(usize),
    Value(f64),
}

/// One of the two models of a comparison.
struct ComparedModel<'a> {
    model: &'a Model,
    slots: &'a Slots,
    /// α with zero for every free value; only the fixed values are used.
    alpha: Alpha,
}

impl<'a> ComparedModel<'a> {
    fn new((model, slots): (&'a PhasedModel, &'a Slots)) -> ComparedModel<'a> {
        let model = model.shared();
        ComparedModel { model, slots, alpha: slots.alpha(model, &vec![0.0; slots.len()]) }
    }
}

/// Counts the free values of α that a hypothesis removes from a model; the [`Slots`] of hypothesis and model are the
/// free values that occur in `tests`.
///
/// # Errors
/// Fails when the hypothesis is not within the model.
pub fn restricted(
    null: (&PhasedModel, &Slots),
    wide: (&PhasedModel, &Slots),
    tests: &[PhasedTest],
) -> Result<Restricted, NotNestedParameter> {
    let (null, wide) = (ComparedModel::new(null), ComparedModel::new(wide));
    let mut targets: Vec<Option<Target>> = vec![None; wide.slots.len()];
    for index in 0..wide.model.parameters.len() {
        let mut previous_labels: Option<&[Label]> = None;
        let rows = tests.iter().flat_map(|test| &test.phases).filter_map(Evidence::cells);
        for texts in rows.flat_map(|test| (0..test.rows()).map(|row| test.texts(row))) {
            // most rows have the same labels as the row before
            if previous_labels.replace(texts) != Some(texts) {
                record_target(index, texts, (&null, &wide), &mut targets)?;
            }
        }
    }
    let mut at_bound = 0;
    for (slot, target) in wide.slots.slots().iter().zip(&targets) {
        let (model, hypothesis) = (&wide.model.parameters[slot.parameter], &null.model.parameters[slot.parameter]);
        match target {
            Some(Target::Value(value)) => at_bound += usize::from(on_bound(model, *value)?),
            Some(Target::Slot(_)) if (model.lower, model.upper) != (hypothesis.lower, hypothesis.upper) => {
                return Err(NotNestedParameter::Bounds { name: model.name.clone() });
            }
            _ => {}
        }
    }
    Ok(Restricted { count: wide.slots.len().saturating_sub(null.slots.len()), at_bound })
}

/// Records the target, under the hypothesis, of the model's value of parameter `index` on a row with labels `texts`.
fn record_target(
    index: usize,
    texts: &[Label],
    (null, wide): (&ComparedModel<'_>, &ComparedModel<'_>),
    targets: &mut [Option<Target>],
) -> Result<(), NotNestedParameter> {
    let name = || wide.model.parameters[index].name.clone();
    // a row without a level of the parameter does not need the parameter: otherwise the filters would have failed
    let (Ok(found), Ok(expected)) = (null.alpha.value(index, texts), wide.alpha.value(index, texts)) else {
        return Ok(());
    };
    let slot = null.slots.find(index, texts);
    let Some(wide_slot) = wide.slots.find(index, texts) else {
        return match slot {
            None if found == expected => Ok(()),
            None => Err(NotNestedParameter::Fixed { name: name(), found: Some(found), expected }),
            Some(_) => Err(NotNestedParameter::Fixed { name: name(), found: None, expected }),
        };
    };
    let target = slot.map_or(Target::Value(found), Target::Slot);
    match targets[wide_slot].replace(target) {
        Some(before) if before != target => Err(NotNestedParameter::Levels { name: name() }),
        _ => Ok(()),
    }
}

/// Whether a value is on a bound of a parameter; an error when the value is out of bounds.
fn on_bound(parameter: &Parameter, value: f64) -> Result<bool, NotNestedParameter> {
    let outside = |expected: String| {
        Err(NotNestedParameter::OutOfBounds { name: parameter.name.clone(), found: value, expected })
    };
    let zero = parameter.positive.then_some(0.0);
    let lower = parameter.lower.or(zero);
    if let Some(lower) = lower.filter(|lower| value < *lower) {
        return outside(format!("at least {lower}"));
    }
    if let Some(upper) = parameter.upper.filter(|upper| value > *upper) {
        return outside(format!("at most {upper}"));
    }
    Ok(lower == Some(value) || parameter.upper == Some(value))
}

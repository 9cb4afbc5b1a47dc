//! The free values of α: one for a common parameter, one for each level of a parameter that has levels.

use std::collections::BTreeMap;

use crate::ensemble::{Label, Labels, Test};
use crate::model::{Alpha, Level, Model, Parameter, Value};

/// One free value of α.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Slot {
    /// Index of the parameter in [`Model::parameters`].
    pub parameter: usize,
    /// Level of the parameter, if the parameter has levels.
    pub level: Option<Label>,
}

/// All free values of α, in the order of the parameters of the model; the values of one parameter are in the
/// alphabetical order of the levels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Slots {
    slots: Vec<Slot>,
    positions: Vec<ParameterSlots>,
}

/// Slots of the values of one parameter.
#[derive(Debug, Clone, PartialEq)]
enum ParameterSlots {
    Fixed,
    Common(usize),
    Each { column: usize, positions: BTreeMap<Label, usize> },
}

impl Slots {
    /// The free values of a model, with the levels that occur in `tests`.
    pub fn new(model: &Model, labels: &Labels, tests: &[Test]) -> Slots {
        Slots::of(model, labels, &tests.iter().collect::<Vec<_>>())
    }

    /// The empty list of slots, for a model whose parameters are all known.
    pub fn none(model: &Model) -> Slots {
        Slots { slots: Vec::new(), positions: model.parameters.iter().map(|_| ParameterSlots::Fixed).collect() }
    }

    /// [`Slots::new`] from references to tests.
    pub(crate) fn of(model: &Model, labels: &Labels, tests: &[&Test]) -> Slots {
        let mut slots = Slots::default();
        for (parameter, definition) in model.parameters.iter().enumerate() {
            let positions = match (definition.value, definition.per) {
                (Value::Fixed(_), _) => ParameterSlots::Fixed,
                (Value::Free { .. }, None) => ParameterSlots::Common(slots.add(parameter, None)),
                (Value::Free { .. }, Some(column)) => {
                    let mut levels = levels(definition, column, tests);
                    levels.sort_by(|a, b| labels.text(*a).cmp(labels.text(*b)));
                    let add_level = |level: Label| (level, slots.add(parameter, Some(level)));
                    ParameterSlots::Each { column, positions: levels.into_iter().map(add_level).collect() }
                }
            };
            slots.positions.push(positions);
        }
        slots
    }

    fn add(&mut self, parameter: usize, level: Option<Label>) -> usize {
        self.slots.push(Slot { parameter, level });
        self.slots.len() - 1
    }

    /// The free values.
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Number of free values.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Whether α has no free values.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Whether some value of the parameter is free.
    pub fn is_free(&self, parameter: usize) -> bool {
        match &self.positions[parameter] {
            ParameterSlots::Fixed => false,
            ParameterSlots::Common(_) => true,
            ParameterSlots::Each { positions, .. } => !positions.is_empty(),
        }
    }

    /// For each parameter of the model, whether some value is free.
    pub fn free(&self) -> Vec<bool> {
        (0..self.positions.len()).map(|parameter| self.is_free(parameter)).collect()
    }

    /// The slots of all other parameters, with these parameters fixed.
    pub fn without(&self, parameters: &[usize]) -> Slots {
        let is_kept = |slot: &Slot| !parameters.contains(&slot.parameter);
        let before = |slot: usize| self.slots[..slot].iter().filter(|slot| is_kept(slot)).count();
        let one = |(parameter, positions): (usize, &ParameterSlots)| match positions {
            _ if parameters.contains(&parameter) => ParameterSlots::Fixed,
            ParameterSlots::Fixed => ParameterSlots::Fixed,
            ParameterSlots::Common(slot) => ParameterSlots::Common(before(*slot)),
            ParameterSlots::Each { column, positions } => ParameterSlots::Each {
                column: *column,
                positions: positions.iter().map(|(&level, &slot)| (level, before(slot))).collect(),
            },
        };
        Slots {
            slots: self.slots.iter().filter(|slot| is_kept(slot)).copied().collect(),
            positions: self.positions.iter().enumerate().map(one).collect(),
        }
    }

    /// Index of the slot of a parameter whose free value is common to all rows; `None` for any other parameter.
    pub fn common(&self, parameter: usize) -> Option<usize> {
        match &self.positions[parameter] {
            ParameterSlots::Common(slot) => Some(*slot),
            ParameterSlots::Fixed | ParameterSlots::Each { .. } => None,
        }
    }

    /// Index of the slot of a parameter on a row with text cells `texts`; `None` where the value is fixed.
    pub fn find(&self, parameter: usize, texts: &[Label]) -> Option<usize> {
        match &self.positions[parameter] {
            ParameterSlots::Fixed => None,
            ParameterSlots::Common(slot) => Some(*slot),
            ParameterSlots::Each { column, positions } => positions.get(&texts[*column]).copied(),
        }
    }

    /// α with the slot values `values` and the fixed values of the model.
    pub fn alpha(&self, model: &Model, values: &[f64]) -> Alpha {
        let level = |(parameter, positions): (&Parameter, &ParameterSlots)| match positions {
            ParameterSlots::Fixed => parameter.level(),
            ParameterSlots::Common(slot) => Level::Common(values[*slot]),
            ParameterSlots::Each { column, positions } => {
                let mut each: BTreeMap<Label, f64> =
                    parameter.fixed_levels.iter().map(|(&literal, &v)| (Label::literal(literal), v)).collect();
                each.extend(positions.iter().map(|(&level, &slot)| (level, values[slot])));
                Level::Each { column: *column, values: each, other: None }
            }
        };
        Alpha { values: model.parameters.iter().zip(&self.positions).map(level).collect() }
    }
}

/// Levels of a text column that occur in the tests and have no fixed value.
fn levels(parameter: &Parameter, column: usize, tests: &[&Test]) -> Vec<Label> {
    let mut levels: Vec<Label> =
        tests.iter().flat_map(|test| (0..test.rows()).map(|row| test.texts(row)[column])).collect();
    levels.sort_unstable();
    levels.dedup();
    levels.retain(|level| !level.is_missing() && !parameter.fixed_levels.keys().any(|&l| Label::literal(l) == *level));
    levels
}

//! α as it stands in an exchange file: values by name and by level, so that files of different places compare.

use std::collections::{BTreeMap, BTreeSet};

use kalfit::model::{Level, Value};
use kalfit::{Alpha, Labels, Model};
use serde::{Deserialize, Serialize};

/// The value of one dynamic parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterValue {
    /// Its name.
    pub name: String,
    /// The column whose levels have a value each.
    #[serde(default)]
    pub per: Option<String>,
    /// Values by level.
    #[serde(default)]
    pub levels: BTreeMap<String, f64>,
    /// The value common to all tests, or of every other level.
    #[serde(default)]
    pub value: Option<f64>,
}

/// Where two α's are not the same.
#[derive(Debug, Clone, PartialEq)]
pub struct AlphaDifference {
    /// The parameter.
    pub name: String,
    /// The level; `None` for a value common to all or to every other level.
    pub level: Option<String>,
    /// The first α's value.
    pub first: f64,
    /// The second α's value.
    pub second: f64,
}

impl ParameterValue {
    /// The values of an α, in the order of the model. `labels` has the texts of its levels; the model's own suffice for an α made
    /// of the model alone.
    pub fn all(model: &Model, alpha: &Alpha, labels: &Labels) -> Vec<ParameterValue> {
        let of = |(parameter, level): (&kalfit::model::Parameter, &Level)| {
            let (per, levels, value) = match level {
                Level::Common(value) => (None, BTreeMap::new(), Some(*value)),
                Level::Each { column, values, other } => {
                    let values = values.iter().map(|(label, value)| (labels.text(*label).to_owned(), *value));
                    (Some(model.text_columns[*column].name.clone()), values.collect(), *other)
                }
            };
            ParameterValue { name: parameter.name.clone(), per, levels, value }
        };
        model.parameters.iter().zip(&alpha.values).map(of).collect()
    }

    /// The values that a model gives, in its order; free parameters have none.
    pub fn known(model: &Model) -> Vec<ParameterValue> {
        let of = |parameter: &kalfit::model::Parameter| {
            let levels = parameter.fixed_levels.iter();
            ParameterValue {
                name: parameter.name.clone(),
                per: parameter.per.map(|column| model.text_columns[column].name.clone()),
                levels: levels.map(|(&literal, &value)| (model.literals[literal].clone(), value)).collect(),
                value: match parameter.value {
                    Value::Fixed(value) => Some(value),
                    Value::Free { .. } => None,
                },
            }
        };
        model.parameters.iter().map(of).collect()
    }

    fn at(&self, level: Option<&String>) -> Option<f64> {
        level.and_then(|level| self.levels.get(level)).copied().or(self.value)
    }

    /// The first level at which both have a value and these are not the same, bit for bit.
    fn difference(&self, other: &ParameterValue) -> Option<AlphaDifference> {
        let levels: BTreeSet<&String> = self.levels.keys().chain(other.levels.keys()).collect();
        std::iter::once(None).chain(levels.into_iter().map(Some)).find_map(|level| {
            let (first, second) = (self.at(level)?, other.at(level)?);
            let (name, level) = (self.name.clone(), level.cloned());
            (first.to_bits() != second.to_bits()).then_some(AlphaDifference { name, level, first, second })
        })
    }
}

/// The first difference between the parameters that both have.
pub fn difference(first: &[ParameterValue], second: &[ParameterValue]) -> Option<AlphaDifference> {
    first.iter().find_map(|one| one.difference(second.iter().find(|other| other.name == one.name)?))
}

/// Adds what `more` knows to `known`, which must not differ from it.
pub fn merge(known: &mut Vec<ParameterValue>, more: &[ParameterValue]) {
    for new in more {
        match known.iter_mut().find(|old| old.name == new.name) {
            None => known.push(new.clone()),
            Some(old) => {
                old.value = old.value.or(new.value);
                old.per = old.per.take().or_else(|| new.per.clone());
                new.levels.iter().for_each(|(level, value)| {
                    old.levels.entry(level.clone()).or_insert(*value);
                });
            }
        }
    }
}

impl std::fmt::Display for AlphaDifference {
    /// The parameter as `--set` names it: `tau`, `sigma[A]`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.level {
            None => write!(f, "{}", self.name),
            Some(level) => write!(f, "{}[{level}]", self.name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(name: &str, levels: &[(&str, f64)], value: Option<f64>) -> ParameterValue {
        let per = (!levels.is_empty()).then(|| "lot".to_owned());
        let levels = levels.iter().map(|(level, value)| ((*level).to_owned(), *value)).collect();
        ParameterValue { name: name.to_owned(), per, levels, value }
    }

    #[test]
    fn files_of_other_lots_agree_and_add_up() {
        let mut first = vec![value("tau", &[], Some(0.1)), value("s", &[("A", 1.0)], None)];
        let second = [value("s", &[("B", 2.0)], None), value("more", &[], Some(3.0))];
        assert_eq!(difference(&first, &second), None);
        merge(&mut first, &second);
        assert_eq!(first[1], value("s", &[("A", 1.0), ("B", 2.0)], None));
        assert_eq!(first[2].name, "more");
    }

    #[test]
    fn the_first_difference_is_named_with_its_level() {
        let found = difference(&[value("s", &[("A", 1.0)], None)], &[value("s", &[], Some(2.0))]).expect("they differ");
        assert_eq!((found.to_string(), found.first, found.second), ("s[A]".to_owned(), 1.0, 2.0));
    }

    #[test]
    fn numbers_survive_json_bit_for_bit() {
        let all: Vec<ParameterValue> =
            [0.1, -0.0, 5e-324, f64::MAX, 1.0 / 3.0].iter().map(|&x| value(&format!("p{x:e}"), &[], Some(x))).collect();
        let text = serde_json::to_string(&all).expect("plain numbers");
        let back: Vec<ParameterValue> = serde_json::from_str(&text).expect("what was written");
        assert_eq!(difference(&all, &back), None);
        let bits = |all: &[ParameterValue]| all.iter().map(|p| p.value.map(f64::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&all), bits(&back));
    }
}

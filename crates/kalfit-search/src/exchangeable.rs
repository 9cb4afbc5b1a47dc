//! Exchangeable parts of a model: two processes of one kind that are measured in the same way. Exchanging the
//! parameters and hidden states of the two processes leaves ℓ unchanged. So ends that differ by an exchange are one
//! end, and two coinciding processes are one process with the sum of their variances.

use crate::Coordinate;
use crate::exchange::Exchange;
use crate::scales::time_constants;
use kalfit_model::{PhasedModel, Slots};

/// Two processes of one kind whose free values may be exchanged, pair by pair.
#[derive(Debug, Clone, PartialEq)]
pub struct ExchangeablePair {
    /// Pairs (slot of the one process, slot of the other process). Time constants, which distinguish the processes,
    /// come first.
    pub pairs: Vec<(usize, usize)>,
}

/// Relative difference up to which values are equal.
const EQUAL: f64 = 1e-2;

impl ExchangeablePair {
    /// All exchangeable pairs in a model of one phase.
    pub(crate) fn of(model: &PhasedModel, slots: &Slots) -> Vec<ExchangeablePair> {
        ExchangeablePair::all(model, slots, true)
    }

    /// Pairs of processes of one kind that are measured differently: each may explain what the other one does, but not
    /// as well.
    pub(crate) fn unlike(model: &PhasedModel, slots: &Slots) -> Vec<ExchangeablePair> {
        ExchangeablePair::all(model, slots, false)
    }

    /// Pairs of processes of one kind whose exchange keeps the model unchanged (`preserves`), or changes it.
    fn all(model: &PhasedModel, slots: &Slots, preserves: bool) -> Vec<ExchangeablePair> {
        let [phase] = &model.phases[..] else { return Vec::new() };
        let levels = !model.levels.is_empty();
        let constants = time_constants(model);
        let (model, count) = (&phase.model, phase.model.states.len());
        let pairs = (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j)));
        // contributions of groups to a state are not compared
        let apart =
            |&(i, j): &(usize, usize)| !(levels && (model.estimated.contains(&i) || model.estimated.contains(&j)));
        let exchanges = pairs.filter(apart).filter_map(|(i, j)| Exchange::of(model, i, j));
        let twins = exchanges.filter(|exchange| exchange.preserves(model) == preserves).filter_map(|exchange| {
            let slots_of = |(p, q)| Some((slots.common(p)?, slots.common(q)?));
            let mut pairs: Vec<(usize, usize)> =
                exchange.parameters.into_iter().map(slots_of).collect::<Option<_>>()?;
            let parameter = |slot: usize| slots.slots()[slot].parameter;
            pairs.sort_by_key(|(s, _)| !constants.contains(&parameter(*s)));
            (!pairs.is_empty()).then_some(ExchangeablePair { pairs })
        });
        let mut found: Vec<ExchangeablePair> = Vec::new();
        for twin in twins {
            // hidden states of a pair give the same pair again
            if !found.contains(&twin) {
                found.push(twin);
            }
        }
        found
    }

    /// The values with the two processes exchanged.
    pub fn exchanged(&self, values: &[f64]) -> Vec<f64> {
        let mut values = values.to_vec();
        self.pairs.iter().for_each(|&(s, t)| values.swap(s, t));
        values
    }

    /// Exchanges the two processes if the first pair of different values is not in ascending order.
    fn order(&self, values: &mut [f64]) {
        let first = self.pairs.iter().find(|(s, t)| values[*s] != values[*t]);
        if first.is_some_and(|(s, t)| values[*s] > values[*t]) {
            self.pairs.iter().for_each(|&(s, t)| values.swap(s, t));
        }
    }

    /// Slot of the level that is zero after the two processes are [merged](ExchangeablePair::merged).
    pub(crate) fn freed(&self, coordinates: &[Coordinate]) -> Option<usize> {
        self.pairs.iter().map(|&(_, t)| t).find(|&t| coordinates[t].level.is_some())
    }

    /// Slot of a time constant of the process whose level is zero after the two processes are merged.
    pub(crate) fn shape(&self, coordinates: &[Coordinate]) -> Option<usize> {
        self.pairs.iter().map(|&(_, t)| t).find(|&t| coordinates[t].level.is_none() && coordinates[t].log)
    }

    /// The values with two coinciding processes merged: one process has the sum of both variances and time constants
    /// between those of both, and the other process is at zero; `None` where the two do not coincide.
    pub(crate) fn merged(&self, values: &[f64], coordinates: &[Coordinate]) -> Option<Vec<f64>> {
        let (levels, shapes): (Vec<_>, Vec<_>) =
            self.pairs.iter().copied().partition(|(s, _)| coordinates[*s].level.is_some());
        let close =
            |(s, t): &(usize, usize)| (values[*s] - values[*t]).abs() <= EQUAL * values[*s].abs().max(values[*t].abs());
        let [(s, t)] = levels[..] else { return None };
        let exponent = coordinates[s].level?;
        if shapes.is_empty() || !shapes.iter().all(close) || values[s] == 0.0 || values[t] == 0.0 {
            return None;
        }
        let mut merged = values.to_vec();
        let (one, other) = (values[s].powf(exponent), values[t].powf(exponent));
        let part = other / (one + other);
        for (s, t) in shapes.into_iter().filter(|&(s, t)| values[s] != values[t]) {
            let (a, b) = (coordinates[s].of_value(values[s]), coordinates[t].of_value(values[t]));
            merged[s] = coordinates[s].moved(values[s], part * (b - a));
        }
        merged[s] = (one + other).powf(exponent.recip());
        merged[t] = 0.0;
        (merged[s] <= coordinates[s].upper && coordinates[t].lower <= 0.0).then_some(merged)
    }
}

/// The values with the processes of each exchangeable pair in ascending order of the first different value.
pub fn ordered(twins: &[ExchangeablePair], values: &[f64]) -> Vec<f64> {
    let mut values = values.to_vec();
    for _ in 0..twins.len() {
        twins.iter().for_each(|pair| pair.order(&mut values));
    }
    values
}

/// The values with exchangeable processes in the order that is nearest to `reference`.
pub(crate) fn aligned(twins: &[ExchangeablePair], values: &[f64], reference: &[f64]) -> Vec<f64> {
    let apart = |a: f64, b: f64| if a > 0.0 && b > 0.0 { (a / b).ln().abs() } else { (a - b).abs() };
    let mut values = values.to_vec();
    for pair in twins {
        let distance = |cross: bool| -> f64 {
            let of = |&(s, t): &(usize, usize)| {
                let (s, t, a, b) =
                    if cross { (t, s, reference[s], reference[t]) } else { (s, t, reference[s], reference[t]) };
                apart(values[s], a) + apart(values[t], b)
            };
            pair.pairs.iter().map(of).sum()
        };
        if distance(true) < distance(false) {
            pair.pairs.iter().for_each(|&(s, t)| values.swap(s, t));
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::build::{Formula, constant, free, gauss_markov, gauss_markov_2, measurement, name};

    /// A model with two drifts in this measurement equation, the second with this noise level; its values are tau,
    /// sigma, rest, spread, noise.
    fn drifts(equation: Formula, level: Formula) -> (PhasedModel, Slots) {
        let model = kalfit_model::Model::builder("")
            .time("t")
            .state(constant("bias"))
            .state(gauss_markov("one", "tau", "sigma"))
            .state(gauss_markov("two", "rest", level))
            .measurement(measurement("y", equation, "noise"));
        let names = ["tau", "sigma", "rest", "spread", "noise"];
        let model: PhasedModel =
            names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().unwrap();
        let slots = Slots::new(model.shared(), &kalfit_model::Labels::default(), &[]);
        (model, slots)
    }

    #[test]
    fn processes_that_are_measured_alike_may_change_places() {
        let both = || name("bias") + name("one") + name("two");
        let (model, slots) = drifts(both(), name("spread"));
        let twins = ExchangeablePair::of(&model, &slots);
        assert_eq!(twins, [ExchangeablePair { pairs: vec![(0, 2), (1, 3)] }], "time constants first");
        assert_eq!(ordered(&twins, &[9.0, 1.0, 4.0, 2.0, 0.1]), [4.0, 2.0, 9.0, 1.0, 0.1]);
        let near = aligned(&twins, &[9.0, 1.0, 4.0, 2.0, 0.1], &[4.1, 2.0, 8.0, 1.0, 0.1]);
        assert_eq!(near, [4.0, 2.0, 9.0, 1.0, 0.1]);
        assert_eq!(ExchangeablePair::unlike(&model, &slots), []);
        // measured differently, or with a level that occurs elsewhere, too, they may not
        for (equation, level) in [
            (name("bias") + name("one") + 2.0 * name("two"), name("spread")),
            (both(), name("spread") * name("noise")),
            (both(), name("sigma") * name("spread")),
        ] {
            let (model, slots) = drifts(equation.clone(), level.clone());
            assert_eq!(ExchangeablePair::of(&model, &slots), [], "{equation:?}, {level:?}");
        }
    }

    #[test]
    fn processes_of_one_kind_that_are_measured_otherwise_are_unlike() {
        let (model, slots) = drifts(name("bias") + name("one") + 2.0 * name("two"), name("spread"));
        let unlike = ExchangeablePair::unlike(&model, &slots);
        assert_eq!(unlike, [ExchangeablePair { pairs: vec![(0, 2), (1, 3)] }]);
        assert_eq!(unlike[0].exchanged(&[9.0, 1.0, 4.0, 2.0, 0.1]), [4.0, 2.0, 9.0, 1.0, 0.1]);
        // a level that stands in another place too has no counterpart
        let (model, slots) = drifts(name("bias") + name("one") + 2.0 * name("two"), name("spread") * name("noise"));
        assert_eq!(ExchangeablePair::unlike(&model, &slots), []);
    }

    #[test]
    fn processes_of_second_order_change_places_with_their_hidden_rates() {
        let model = |equation: Formula, level: Formula| {
            let model = kalfit_model::Model::builder("")
                .time("t")
                .state(constant("bias"))
                .state(gauss_markov_2("one", "tau", "sigma"))
                .state(gauss_markov_2("two", "rest", level))
                .measurement(measurement("y", equation, "noise"));
            let names = ["tau", "sigma", "rest", "spread", "noise"];
            let model: PhasedModel =
                names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().unwrap();
            let slots = Slots::new(model.shared(), &kalfit_model::Labels::default(), &[]);
            ExchangeablePair::of(&model, &slots)
        };
        let both = || name("bias") + name("one") + name("two");
        assert_eq!(model(both(), name("spread")), [ExchangeablePair { pairs: vec![(0, 2), (1, 3)] }]);
        assert_eq!(model(name("bias") + name("one") + 2.0 * name("two"), name("spread")), []);
        assert_eq!(model(both(), name("sigma") * name("spread")), []);
    }

    #[test]
    fn processes_that_coincide_are_one_of_both_variances() {
        let (model, slots) = drifts(name("bias") + name("one") + name("two"), name("spread"));
        let (twins, coordinates) = (ExchangeablePair::of(&model, &slots), Coordinate::of(&model, &slots));
        let merged = twins[0].merged(&[5.0, 3.0, 5.001, 4.0, 0.1], &coordinates).unwrap();
        let between = 5.0 * (5.001f64 / 5.0).powf(16.0 / 25.0); // by their variances
        assert!((merged[0] - between).abs() < 1e-12 && (merged[1] - 5.0).abs() < 1e-12, "{merged:?}");
        assert_eq!(merged[3], 0.0);
        // no merged process where a level would exceed its bounds
        for (level, lower, upper) in [(1, 0.0, 4.5), (3, 0.1, f64::INFINITY)] {
            let mut bounded = coordinates.clone();
            (bounded[level].lower, bounded[level].upper) = (lower, upper);
            assert_eq!(twins[0].merged(&[5.0, 3.0, 5.001, 4.0, 0.1], &bounded), None, "level {level}");
        }
        assert_eq!(twins[0].merged(&[5.0, 3.0, 6.0, 4.0, 0.1], &coordinates), None, "they are two");
    }
}

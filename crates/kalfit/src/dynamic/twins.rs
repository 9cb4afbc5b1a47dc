//! Parts of a model that may change places: two processes of one kind that are measured alike. Exchanging their parameters changes
//! nothing, so ends that differ by it are one end, and two that coincide are one process of their variances' sum.

use crate::dynamic::Coordinate;
use crate::dynamic::scales::time_constants;
use crate::model::{Expression, Initial, Linear, Model, Motion, PhasedModel, Slots, State};

/// Two processes of one kind whose free values, place by place, may be exchanged.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Twins {
    /// Slots of the two: (of the one, of the other). What tells them apart comes first: time constants.
    pub(crate) pairs: Vec<(usize, usize)>,
}

/// Values that are closer than this are equal: a part of them.
const EQUAL: f64 = 1e-2;

impl Twins {
    /// All pairs of such processes in a model of one phase.
    pub(crate) fn of(model: &PhasedModel, slots: &Slots) -> Vec<Twins> {
        let [phase] = &model.phases[..] else { return Vec::new() };
        let levels = !model.levels.is_empty();
        let constants = time_constants(model);
        let (model, count) = (&phase.model, phase.model.states.len());
        let pairs = (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j)));
        // what groups add to a state is not looked at
        let apart =
            |&(i, j): &(usize, usize)| !(levels && (model.estimated.contains(&i) || model.estimated.contains(&j)));
        let twins = pairs.filter(apart).filter_map(|(i, j)| {
            let mut pairs: Vec<(usize, usize)> = exchanged(model, i, j)?
                .into_iter()
                .map(|(p, q)| Some((slots.common(p)?, slots.common(q)?)))
                .collect::<Option<_>>()?;
            let parameter = |slot: usize| slots.slots()[slot].parameter;
            pairs.sort_by_key(|(s, _)| !constants.contains(&parameter(*s)));
            (!pairs.is_empty()).then_some(Twins { pairs })
        });
        twins.collect()
    }

    /// Exchanges the two where they are not in order.
    fn order(&self, values: &mut [f64]) {
        let first = self.pairs.iter().find(|(s, t)| values[*s] != values[*t]);
        if first.is_some_and(|(s, t)| values[*s] > values[*t]) {
            self.pairs.iter().for_each(|&(s, t)| values.swap(s, t));
        }
    }

    /// Where the two coincide, one of them with the variance of both and the other at zero.
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
        merged[s] = (values[s].powf(exponent) + values[t].powf(exponent)).powf(exponent.recip());
        merged[t] = 0.0;
        Some(merged)
    }
}

/// The values with all exchangeable processes in order.
pub(crate) fn ordered(twins: &[Twins], values: &[f64]) -> Vec<f64> {
    let mut values = values.to_vec();
    for _ in 0..twins.len() {
        twins.iter().for_each(|pair| pair.order(&mut values));
    }
    values
}

/// Exchangeable processes of `values` in the places that bring them nearest to `home`.
pub(crate) fn aligned(twins: &[Twins], values: &[f64], home: &[f64]) -> Vec<f64> {
    let apart = |a: f64, b: f64| if a > 0.0 && b > 0.0 { (a / b).ln().abs() } else { (a - b).abs() };
    let mut values = values.to_vec();
    for pair in twins {
        let distance = |cross: bool| -> f64 {
            let of = |&(s, t): &(usize, usize)| {
                let (s, t, a, b) = if cross { (t, s, home[s], home[t]) } else { (s, t, home[s], home[t]) };
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

/// The parameters that go over into each other as two states change places, if that changes nothing else.
fn exchanged(model: &Model, i: usize, j: usize) -> Option<Vec<(usize, usize)>> {
    if [i, j].iter().any(|s| model.estimated.contains(s) || model.states[*s].initial == Initial::Estimated) {
        return None;
    }
    let mut pairs = Vec::new();
    match_states(&model.states[i], &model.states[j], (i, j), &mut pairs)?;
    pairs.sort_unstable();
    pairs.dedup();
    let one_to_one = |(p, q): &(usize, usize)| pairs.iter().all(|(a, b)| (a == p) == (b == q) && (a != q) && (b != p));
    let alike = |(p, q): &(usize, usize)| {
        let (p, q) = (&model.parameters[*p], &model.parameters[*q]);
        p.is_free() && q.is_free() && p.per.is_none() && q.per.is_none() && (p.lower, p.upper) == (q.lower, q.upper)
    };
    let apart: Vec<(usize, usize)> = pairs.iter().copied().filter(|(p, q)| p != q).collect();
    let swap = Swap { states: (i, j), parameters: &apart };
    (apart.iter().all(one_to_one) && apart.iter().all(alike) && swap.leaves(model)).then_some(apart)
}

/// Pairs of parameters at the same places of two states; `None` where the states are of different kinds.
fn match_states(a: &State, b: &State, (i, j): (usize, usize), pairs: &mut Vec<(usize, usize)>) -> Option<()> {
    let place = |state: usize| {
        if state == i {
            j
        } else if state == j {
            i
        } else {
            state
        }
    };
    let mut forms = |a: &Linear, b: &Linear| -> Option<()> {
        let mut other: Vec<&(usize, Expression)> = b.terms.iter().collect();
        for (state, coefficient) in &a.terms {
            let at = other.iter().position(|(of, _)| *of == place(*state))?;
            match_expressions(coefficient, &other.remove(at).1, pairs)?;
        }
        other.is_empty().then_some(())?;
        match_expressions(&a.constant, &b.constant, pairs)
    };
    match (&a.motion, &b.motion) {
        (
            Motion::Continuous { derivative: a, noise_variance: v },
            Motion::Continuous { derivative: b, noise_variance: w },
        ) => {
            forms(a, b)?;
            match_expressions(v, w, pairs)?;
        }
        (Motion::Discrete { next: a, noise_variance: v }, Motion::Discrete { next: b, noise_variance: w }) => {
            forms(a, b)?;
            match_expressions(v, w, pairs)?;
        }
        _ => return None,
    }
    match (&a.initial, &b.initial) {
        (Initial::Known { mean: a, variance: v }, Initial::Known { mean: b, variance: w }) => {
            match_expressions(a, b, pairs)?;
            match_expressions(v, w, pairs)
        }
        (a, b) => (a == b).then_some(()),
    }
}

fn match_expressions(a: &Expression, b: &Expression, pairs: &mut Vec<(usize, usize)>) -> Option<()> {
    use Expression::{Binary, Call, If, Negate, Not, Parameter};
    match (a, b) {
        (Parameter(p), Parameter(q)) => pairs.push((*p, *q)),
        (Negate(a), Negate(b)) | (Not(a), Not(b)) => match_expressions(a, b, pairs)?,
        (Binary(o, a, b), Binary(p, c, d)) if o == p => {
            match_expressions(a, c, pairs)?;
            match_expressions(b, d, pairs)?;
        }
        (Call(f, a), Call(g, b)) if f == g && a.len() == b.len() => {
            a.iter().zip(b).try_for_each(|(a, b)| match_expressions(a, b, pairs))?;
        }
        (If(a, b, c), If(d, e, f)) => {
            [(a, d), (b, e), (c, f)].into_iter().try_for_each(|(a, b)| match_expressions(a, b, pairs))?;
        }
        _ => return (a == b).then_some(()),
    }
    Some(())
}

/// Two states and some parameters in each other's place.
struct Swap<'a> {
    states: (usize, usize),
    parameters: &'a [(usize, usize)],
}

impl Swap<'_> {
    /// The exchange makes the same model of it.
    fn leaves(&self, model: &Model) -> bool {
        let others = (0..model.states.len()).filter(|s| *s != self.states.0 && *s != self.states.1);
        let state = |s: usize| {
            let state = &model.states[s];
            let motion = match &state.motion {
                Motion::Constant => true,
                Motion::Continuous { derivative: f, noise_variance: v }
                | Motion::Discrete { next: f, noise_variance: v } => self.keeps(f) && self.expression(v) == *v,
            };
            let initial = match &state.initial {
                Initial::Known { mean, variance } => {
                    self.expression(mean) == *mean && self.expression(variance) == *variance
                }
                _ => true,
            };
            motion && initial && state.offset.as_ref().is_none_or(|offset| self.expression(offset) == *offset)
        };
        let measured = |m: &crate::model::Measurement| {
            self.keeps(&m.equation)
                && self.expression(&m.noise_variance) == m.noise_variance
                && m.filter.as_ref().is_none_or(|filter| self.expression(filter) == *filter)
        };
        let crossed = |(i, j, c): &(usize, usize, Expression)| {
            let touches = [i, j].iter().any(|s| **s == self.states.0 || **s == self.states.1);
            !touches && self.expression(c) == *c
        };
        let uncrossed = |(_, _, c): &(usize, usize, Expression)| self.expression(c) == *c;
        let named = |entry: &Expression| self.expression(entry) == *entry;
        let matrices = match &model.covariance.kind {
            crate::model::CovarianceKind::Fixed(m)
            | crate::model::CovarianceKind::Proportional(m)
            | crate::model::CovarianceKind::Correlation(m) => m.iter().flatten().all(named),
            _ => true,
        };
        others.into_iter().all(state)
            && model.measurements.iter().all(measured)
            && model.process_noise_covariance.iter().all(crossed)
            && model.noise_covariance.iter().all(uncrossed)
            && matrices
            && model.covariance.known.iter().flatten().flatten().all(named)
            && model.clock.initial_time.as_ref().is_none_or(named)
    }

    /// A linear form stays the same.
    fn keeps(&self, form: &Linear) -> bool {
        let place = |s: usize| match s {
            s if s == self.states.0 => self.states.1,
            s if s == self.states.1 => self.states.0,
            s => s,
        };
        let found = |(s, coefficient): &(usize, Expression)| {
            let there = form.terms.iter().find(|(state, _)| *state == place(*s));
            there.is_some_and(|(_, other)| self.expression(coefficient) == *other)
        };
        form.terms.iter().all(found) && self.expression(&form.constant) == form.constant
    }

    fn expression(&self, expression: &Expression) -> Expression {
        let of = |part: &Expression| Box::new(self.expression(part));
        match expression {
            Expression::Parameter(p) => {
                let other = self.parameters.iter().find_map(|&(a, b)| match *p {
                    p if p == a => Some(b),
                    p if p == b => Some(a),
                    _ => None,
                });
                Expression::Parameter(other.unwrap_or(*p))
            }
            Expression::Negate(a) => Expression::Negate(of(a)),
            Expression::Not(a) => Expression::Not(of(a)),
            Expression::Binary(operator, a, b) => Expression::Binary(*operator, of(a), of(b)),
            Expression::Call(function, list) => {
                Expression::Call(*function, list.iter().map(|part| self.expression(part)).collect())
            }
            Expression::If(a, b, c) => Expression::If(of(a), of(b), of(c)),
            other => other.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::{Formula, constant, free, gauss_markov, measurement, name};

    /// Two drifts, the second with this weight and noise level, and the values of tau, sigma, rest, spread.
    fn drifts(equation: Formula, level: Formula) -> (PhasedModel, Slots) {
        let model = crate::Model::builder("")
            .time("t")
            .state(constant("bias"))
            .state(gauss_markov("one", "tau", "sigma"))
            .state(gauss_markov("two", "rest", level))
            .measurement(measurement("y", equation, "noise"));
        let names = ["tau", "sigma", "rest", "spread", "noise"];
        let model: PhasedModel =
            names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().unwrap();
        let slots = Slots::new(model.shared(), &crate::Labels::default(), &[]);
        (model, slots)
    }

    #[test]
    fn processes_that_are_measured_alike_may_change_places() {
        let both = || name("bias") + name("one") + name("two");
        let (model, slots) = drifts(both(), name("spread"));
        let twins = Twins::of(&model, &slots);
        assert_eq!(twins, [Twins { pairs: vec![(0, 2), (1, 3)] }], "time constants first");
        assert_eq!(ordered(&twins, &[9.0, 1.0, 4.0, 2.0, 0.1]), [4.0, 2.0, 9.0, 1.0, 0.1]);
        let near = aligned(&twins, &[9.0, 1.0, 4.0, 2.0, 0.1], &[4.1, 2.0, 8.0, 1.0, 0.1]);
        assert_eq!(near, [4.0, 2.0, 9.0, 1.0, 0.1]);
        // measured otherwise, or by a level that stands in another place too, they may not
        for (equation, level) in [
            (name("bias") + name("one") + 2.0 * name("two"), name("spread")),
            (both(), name("spread") * name("noise")),
            (both(), name("sigma") * name("spread")),
        ] {
            let (model, slots) = drifts(equation.clone(), level.clone());
            assert_eq!(Twins::of(&model, &slots), [], "{equation:?}, {level:?}");
        }
    }

    #[test]
    fn processes_that_coincide_are_one_of_both_variances() {
        let (model, slots) = drifts(name("bias") + name("one") + name("two"), name("spread"));
        let (twins, coordinates) = (Twins::of(&model, &slots), Coordinate::of(&model, &slots));
        let merged = twins[0].merged(&[5.0, 3.0, 5.001, 4.0, 0.1], &coordinates).unwrap();
        assert_eq!((merged[0], merged[3]), (5.0, 0.0));
        assert!((merged[1] - 5.0).abs() < 1e-12, "{merged:?}");
        assert_eq!(twins[0].merged(&[5.0, 3.0, 6.0, 4.0, 0.1], &coordinates), None, "they are two");
    }
}

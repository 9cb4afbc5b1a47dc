//! Parts of a model that may change places: two processes of one kind that are measured alike. Exchanging their parameters changes
//! nothing, hidden states of theirs changing places as well, so ends that differ by it are one end, and two that coincide are one
//! process of their variances' sum.

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
        let mut found: Vec<Twins> = Vec::new();
        for twin in twins {
            // hidden states of a pair are the pair once more
            if !found.contains(&twin) {
                found.push(twin);
            }
        }
        found
    }

    /// Exchanges the two where they are not in order.
    fn order(&self, values: &mut [f64]) {
        let first = self.pairs.iter().find(|(s, t)| values[*s] != values[*t]);
        if first.is_some_and(|(s, t)| values[*s] > values[*t]) {
            self.pairs.iter().for_each(|&(s, t)| values.swap(s, t));
        }
    }

    /// The level that is at zero where the two are [merged](Twins::merged).
    pub(crate) fn freed(&self, coordinates: &[Coordinate]) -> Option<usize> {
        self.pairs.iter().map(|&(_, t)| t).find(|&t| coordinates[t].level.is_some())
    }

    /// A time constant of that process.
    pub(crate) fn shape(&self, coordinates: &[Coordinate]) -> Option<usize> {
        self.pairs.iter().map(|&(_, t)| t).find(|&t| coordinates[t].level.is_none() && coordinates[t].log)
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

/// The parameters that go over into each other as two states change places, and with them the states that drive each of them alone, if
/// that changes nothing else.
fn exchanged(model: &Model, i: usize, j: usize) -> Option<Vec<(usize, usize)>> {
    let (mut states, mut pairs) = (vec![(i, j)], Vec::new());
    let mut matched = 0;
    while let Some(&(a, b)) = states.get(matched) {
        match_states(&model.states[a], &model.states[b], &mut states, &mut pairs)?;
        matched += 1;
    }
    let known = |s: usize| !model.estimated.contains(&s) && model.states[s].initial != Initial::Estimated;
    if !states.iter().all(|&(a, b)| known(a) && known(b)) {
        return None;
    }
    pairs.sort_unstable();
    pairs.dedup();
    let one_to_one = |(p, q): &(usize, usize)| pairs.iter().all(|(a, b)| (a == p) == (b == q) && (a != q) && (b != p));
    let alike = |(p, q): &(usize, usize)| {
        let (p, q) = (&model.parameters[*p], &model.parameters[*q]);
        p.is_free() && q.is_free() && p.per.is_none() && q.per.is_none() && (p.lower, p.upper) == (q.lower, q.upper)
    };
    let apart: Vec<(usize, usize)> = pairs.iter().copied().filter(|(p, q)| p != q).collect();
    let swap = Swap { states: &states, parameters: &apart };
    (apart.iter().all(one_to_one) && apart.iter().all(alike) && swap.leaves(model)).then_some(apart)
}

/// The state in whose place this one comes.
fn place(states: &[(usize, usize)], state: usize) -> usize {
    let other = |&(a, b): &(usize, usize)| if a == state { Some(b) } else { (b == state).then_some(a) };
    states.iter().find_map(other).unwrap_or(state)
}

/// Pairs of parameters at the same places of two states, and of the states that drive one of them each; `None` where the states are of
/// different kinds.
fn match_states(a: &State, b: &State, states: &mut Vec<(usize, usize)>, pairs: &mut Vec<(usize, usize)>) -> Option<()> {
    match (&a.motion, &b.motion) {
        (
            Motion::Continuous { derivative: a, noise_variance: v },
            Motion::Continuous { derivative: b, noise_variance: w },
        )
        | (Motion::Discrete { next: a, noise_variance: v }, Motion::Discrete { next: b, noise_variance: w }) => {
            match_forms(a, b, states, pairs)?;
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

/// The same of two linear forms. A state that only one of them has, and only one more is in the other, takes that one's place: the hidden
/// rate of a process of second order, say.
fn match_forms(
    a: &Linear,
    b: &Linear,
    states: &mut Vec<(usize, usize)>,
    pairs: &mut Vec<(usize, usize)>,
) -> Option<()> {
    let mut other: Vec<&(usize, Expression)> = b.terms.iter().collect();
    let mut own: Vec<&(usize, Expression)> = Vec::new();
    for term in &a.terms {
        match other.iter().position(|(of, _)| *of == place(states, term.0)) {
            Some(at) => match_expressions(&term.1, &other.remove(at).1, pairs)?,
            None => own.push(term),
        }
    }
    match (&own[..], &other[..]) {
        ([], []) => {}
        ([(s, x)], [(t, y)]) if place(states, *s) == *s && place(states, *t) == *t => {
            states.push((*s, *t));
            match_expressions(x, y, pairs)?;
        }
        _ => return None,
    }
    match_expressions(&a.constant, &b.constant, pairs)
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

/// Some states and some parameters in each other's place.
struct Swap<'a> {
    states: &'a [(usize, usize)],
    parameters: &'a [(usize, usize)],
}

impl Swap<'_> {
    /// The exchange makes the same model of it.
    fn leaves(&self, model: &Model) -> bool {
        let moves = |s: usize| self.states.iter().any(|&(a, b)| a == s || b == s);
        let others = (0..model.states.len()).filter(|s| !moves(*s));
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
        let crossed = |(i, j, c): &(usize, usize, Expression)| !moves(*i) && !moves(*j) && self.expression(c) == *c;
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
        let found = |(s, coefficient): &(usize, Expression)| {
            let there = form.terms.iter().find(|(state, _)| *state == place(self.states, *s));
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
    use crate::build::{Formula, constant, free, gauss_markov, gauss_markov_2, measurement, name};

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
    fn processes_of_second_order_change_places_with_their_hidden_rates() {
        let model = |equation: Formula, level: Formula| {
            let model = crate::Model::builder("")
                .time("t")
                .state(constant("bias"))
                .state(gauss_markov_2("one", "tau", "sigma"))
                .state(gauss_markov_2("two", "rest", level))
                .measurement(measurement("y", equation, "noise"));
            let names = ["tau", "sigma", "rest", "spread", "noise"];
            let model: PhasedModel =
                names.into_iter().fold(model, |model, name| model.parameter(free(name))).build().unwrap();
            let slots = Slots::new(model.shared(), &crate::Labels::default(), &[]);
            Twins::of(&model, &slots)
        };
        let both = || name("bias") + name("one") + name("two");
        assert_eq!(model(both(), name("spread")), [Twins { pairs: vec![(0, 2), (1, 3)] }]);
        assert_eq!(model(name("bias") + name("one") + 2.0 * name("two"), name("spread")), []);
        assert_eq!(model(both(), name("sigma") * name("spread")), []);
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

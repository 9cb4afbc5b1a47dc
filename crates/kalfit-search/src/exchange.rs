//! Exchange of two processes: which states and parameters change places, and whether the model stays unchanged.

use kalfit_model::{Expression, Initial, Linear, Model, Motion, Site, State};

/// Exchange of two processes of one kind: pairs of states, and pairs of parameters at the same places in the two
/// processes.
#[derive(Debug)]
pub(super) struct Exchange {
    states: Vec<(usize, usize)>,
    /// Pairs of parameter indices, without parameters that both processes share.
    pub(super) parameters: Vec<(usize, usize)>,
}

impl Exchange {
    /// The exchange of two states, and of the hidden states that drive each of them alone; `None` where the states are
    /// not of one kind, or where a parameter would have to change places with several.
    pub(super) fn of(model: &Model, i: usize, j: usize) -> Option<Exchange> {
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
        let one_to_one =
            |(p, q): &(usize, usize)| pairs.iter().all(|(a, b)| (a == p) == (b == q) && (a != q) && (b != p));
        let alike = |(p, q): &(usize, usize)| {
            let (p, q) = (&model.parameters[*p], &model.parameters[*q]);
            p.is_free() && q.is_free() && p.per.is_none() && q.per.is_none() && (p.lower, p.upper) == (q.lower, q.upper)
        };
        let parameters: Vec<(usize, usize)> = pairs.iter().copied().filter(|(p, q)| p != q).collect();
        let whole = parameters.iter().all(one_to_one) && parameters.iter().all(alike);
        whole.then_some(Exchange { states, parameters })
    }

    /// Whether the exchange keeps the model unchanged.
    pub(super) fn preserves(&self, model: &Model) -> bool {
        let moves = |s: usize| self.states.iter().any(|&(a, b)| a == s || b == s);
        let all = model.expressions();
        let at = |site: Site| all.iter().find(|(other, _)| *other == site).map(|(_, expression)| *expression);
        let stays = |(site, expression): &(Site, &Expression)| {
            let other = match *site {
                Site::Rate { state, from } => at(Site::Rate { state, from: exchanged_state(&self.states, from) }),
                Site::Coefficient { measurement, state } => {
                    at(Site::Coefficient { measurement, state: exchanged_state(&self.states, state) })
                }
                _ => Some(*expression),
            };
            other.is_some_and(|other| self.exchanged(expression) == *other)
        };
        let own = |site: Site| site.of_state().is_some_and(moves);
        all.iter().filter(|(site, _)| !own(*site)).all(stays)
            && model.process_noise_covariance.iter().all(|(i, j, _)| !moves(*i) && !moves(*j))
    }

    /// The expression with the parameters exchanged.
    fn exchanged(&self, expression: &Expression) -> Expression {
        expression.replaced(&|parameter| partner(&self.parameters, parameter).map(Expression::Parameter))
    }
}

/// The state for which `state` is exchanged; `state` if there is none.
fn exchanged_state(states: &[(usize, usize)], state: usize) -> usize {
    partner(states, state).unwrap_or(state)
}

/// The other index of the pair that contains `index`; `None` where no pair does.
fn partner(pairs: &[(usize, usize)], index: usize) -> Option<usize> {
    pairs.iter().find_map(|&(a, b)| if a == index { Some(b) } else { (b == index).then_some(a) })
}

/// Adds the pairs of parameters at the same places of two states, and the pairs of states that drive the two; `None`
/// where the states are of different kinds.
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

/// Adds the pairs from two linear forms. If each form has one state that the other form lacks, the two states are a
/// pair, such as the hidden rates of two processes of second order.
fn match_forms(
    a: &Linear,
    b: &Linear,
    states: &mut Vec<(usize, usize)>,
    pairs: &mut Vec<(usize, usize)>,
) -> Option<()> {
    let mut other: Vec<&(usize, Expression)> = b.terms.iter().collect();
    let mut own: Vec<&(usize, Expression)> = Vec::new();
    for term in &a.terms {
        match other.iter().position(|(of, _)| *of == exchanged_state(states, term.0)) {
            Some(at) => match_expressions(&term.1, &other.remove(at).1, pairs)?,
            None => own.push(term),
        }
    }
    match (&own[..], &other[..]) {
        ([], []) => {}
        ([(s, x)], [(t, y)]) if exchanged_state(states, *s) == *s && exchanged_state(states, *t) == *t => {
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

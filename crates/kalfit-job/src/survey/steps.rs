//! Steps of unequal length under motions that take one step like the next.

use kalfit::Model;
use kalfit::model::{Expression, Linear, Motion};
use kalfit::record::plain;

/// So many steps tell how long steps are.
const MOST_STEPS: usize = 1 << 16;

/// A step is another one than the usual from this ratio on: between jitter and a row that is missing.
const UNEQUAL: f64 = 1.5;

/// Lengths of steps, where some motion does not ask for them.
pub(super) struct RowSteps<'m> {
    model: &'m Model,
    /// States whose motion from row to row has no `dt`, and no column that could stand for it.
    blind: Vec<usize>,
    lengths: Vec<f64>,
}

impl<'m> RowSteps<'m> {
    pub(super) fn of(model: &'m Model) -> RowSteps<'m> {
        let is_blind = |state: &usize| match &model.states[*state].motion {
            Motion::Discrete { next, noise_variance } => is_blind(*state, next, noise_variance),
            Motion::Constant | Motion::Continuous { .. } => false,
        };
        let blind = (0..model.states.len()).filter(is_blind).collect();
        RowSteps { model, blind, lengths: Vec::new() }
    }

    pub(super) fn push(&mut self, length: f64) {
        if !self.blind.is_empty() && self.lengths.len() < MOST_STEPS {
            self.lengths.push(length);
        }
    }

    /// A sentence for each such state, where lengths are unequal.
    pub(super) fn notes(&self, column: &str) -> Vec<String> {
        let mut sorted = self.lengths.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let Some(&usual) = sorted.get(sorted.len() / 2) else { return Vec::new() };
        let others = sorted.iter().filter(|one| **one > UNEQUAL * usual || UNEQUAL * **one < usual).count();
        if others == 0 {
            return Vec::new();
        }
        let steps = format!(
            "{others} of {} steps in column `{column}` are not of the usual length {}, but from {} to {}",
            sorted.len(),
            plain(usual, 4),
            plain(sorted[0], 4),
            plain(sorted[sorted.len() - 1], 4)
        );
        self.blind.iter().map(|state| self.note(*state, &steps, usual)).collect()
    }

    fn note(&self, state: usize, steps: &str, usual: f64) -> String {
        let (name, motion) = (&self.model.states[state].name, &self.model.states[state].motion);
        let length = if usual == 1.0 { "dt".to_owned() } else { format!("(dt / {})", plain(usual, 4)) };
        let cure = match motion.parts().and_then(|(next, _)| factor(state, next)) {
            Some(Expression::Number(1.0)) => {
                format!("multiply its `step_noise` by `sqrt({length})`, or give `noise_density` in its place")
            }
            Some(Expression::Parameter(index)) => {
                let rho = &self.model.parameters[*index].name;
                let twice = if usual == 1.0 { "2 * dt".to_owned() } else { format!("2 * {length}") };
                format!(
                    "write `next = \"{rho}^{length} * {name}\"`, with `{rho}` above zero, and let `step_noise` grow with `dt`, by \
                     `sqrt(1 - {rho}^({twice}))` where `sqrt(1 - {rho}^2)` stands"
                )
            }
            _ => format!(
                "let `next` and `step_noise` depend on `dt`, as `f^{length}` for a factor `f` and `sqrt({length})` for noise"
            ),
        };
        format!(
            "state `{name}` takes one step from each row to the next, however long: {steps}. If it moves with time, {cure}"
        )
    }
}

/// It moves, and nothing in its motion tells how long a step is.
fn is_blind(state: usize, next: &Linear, noise: &Expression) -> bool {
    let mut tells = |part: &Expression| matches!(part, Expression::Step | Expression::Column(_));
    let stays =
        noise.as_number() == Some(0.0) && factor(state, next).is_some_and(|factor| factor.as_number() == Some(1.0));
    !stays && !next.expressions().chain([noise]).any(|one| one.any(&mut tells))
}

/// What the state is multiplied by, where its next value is made of nothing else.
fn factor(state: usize, next: &Linear) -> Option<&Expression> {
    match next.terms.as_slice() {
        [(own, factor)] if *own == state && next.constant.as_number() == Some(0.0) => Some(factor),
        _ => None,
    }
}

//! What a model says that may not be meant.

use kalfit::model::{Expression, Linear, Model, Motion};

use crate::spec::Spec;

/// Unit labels of states whose values are millionths of what equations take.
const MILLIONTHS: [&str; 2] = ["ppm", "parts per million"];

impl Spec {
    /// Questions about the model, in sentences without a full stop: units that the equations seem to forget.
    pub fn questions(&self) -> Vec<String> {
        let mut found: Vec<String> = Vec::new();
        for phase in &self.model.phases {
            found.extend(millionths(&phase.model).into_iter().filter(|one| !found.contains(one)).collect::<Vec<_>>());
        }
        found
    }
}

/// States in parts per million that act on an input as they are.
fn millionths(model: &Model) -> Vec<String> {
    let measured =
        model.measurements.iter().map(|m| (&m.equation, format!("the equation of measurement `{}`", m.name)));
    let moved = model.states.iter().filter_map(|state| match &state.motion {
        Motion::Constant => None,
        Motion::Continuous { derivative, .. } => {
            Some((derivative, format!("the derivative of state `{}`", state.name)))
        }
        Motion::Discrete { next, .. } => Some((next, format!("the next value of state `{}`", state.name))),
    });
    measured.chain(moved).flat_map(|(equation, place)| in_equation(model, equation, &place)).collect()
}

fn in_equation(model: &Model, equation: &Linear, place: &str) -> Vec<String> {
    let asks = |(state, coefficient): &(usize, Expression)| {
        let state = &model.states[*state];
        let unit = state.unit.as_ref()?;
        let named = MILLIONTHS.contains(&unit.trim().to_lowercase().as_str());
        (named && acts_whole(coefficient)).then(|| {
            let name = &state.name;
            format!("state `{name}` is in {unit}, but {place} multiplies it by a column without the factor 1e-6: is `1e-6 * {name}` meant?")
        })
    };
    equation.terms.iter().filter_map(asks).collect()
}

/// The coefficient holds a column, and nothing that may be 1e-6.
fn acts_whole(coefficient: &Expression) -> bool {
    let scales = |part: &Expression| match part {
        Expression::Number(x) => (1e-7..=1e-5).contains(&x.abs()) || (1e5..=1e7).contains(&x.abs()),
        Expression::Parameter(_) => true,
        _ => false,
    };
    coefficient.any(&mut |part| matches!(part, Expression::Column(_))) && !coefficient.any(&mut |part| scales(part))
}

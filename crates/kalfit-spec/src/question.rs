//! What a model says that may not be meant.

use kalfit::model::{Expression, Function, Linear, Model, Motion, Operator};

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

/// So much of a state in millionths acts, at most, where its factor turns them into parts, whatever the units of the column and of
/// what is measured: 1e-6 times 1000 or 3600 is below it.
const MOST: f64 = 1e-2;

/// The coefficient multiplies a column, by a factor that cannot be one of millionths.
fn acts_whole(coefficient: &Expression) -> bool {
    let has_column = coefficient.any(&mut |part| matches!(part, Expression::Column(_)));
    has_column && size(coefficient).is_some_and(|size| size > MOST)
}

/// The product of the numbers in a coefficient, in which columns count as 1; the largest of those that are summed. `None` where it
/// hangs on a parameter, or on more than numbers tell.
fn size(coefficient: &Expression) -> Option<f64> {
    let has_column = |part: &Expression| part.any(&mut |one| matches!(one, Expression::Column(_)));
    Some(match coefficient {
        Expression::Number(x) => x.abs(),
        Expression::Column(_) | Expression::Step | Expression::TextEquals { .. } | Expression::Not(_) => 1.0,
        Expression::Negate(a) => size(a)?,
        Expression::Binary(Operator::Multiply, a, b) => size(a)? * size(b)?,
        Expression::Binary(Operator::Divide, a, b) => size(a)? / size(b)?,
        Expression::Binary(Operator::Power, a, b) => size(a)?.powf(b.as_number()?),
        // of `x - 20` the column tells the size
        Expression::Binary(Operator::Add | Operator::Subtract, a, b) => {
            let terms = [a, b].into_iter().filter(|term| has_column(term) || !has_column(coefficient));
            terms.map(|term| size(term)).collect::<Option<Vec<f64>>>()?.into_iter().fold(0.0, f64::max)
        }
        Expression::If(_, a, b) => size(a)?.max(size(b)?),
        Expression::Call(Function::Abs | Function::Min | Function::Max, terms) => {
            terms.iter().map(size).collect::<Option<Vec<f64>>>()?.into_iter().fold(0.0, f64::max)
        }
        Expression::Call(Function::Sqrt, terms) => size(terms.first()?)?.sqrt(),
        Expression::Call(..) | Expression::Binary(..) => 1.0,
        Expression::Parameter(_) => return None,
    })
}

//! How EM moves each free value.

use crate::DynamicError;
use crate::profile_likelihood::{ProfileLikelihood, ProfilePoint};

/// Step of a coordinate that tests whether the complete data let it move.
const PROBE: f64 = 1e-4;

/// How one free value moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Way {
    /// A noise level moves in closed form: `count` variances are proportional to its `degree`-th power.
    Level { degree: f64, count: f64 },
    /// The value moves on the expected log-likelihood of the complete data.
    Expected,
    /// The value moves on ℓ itself: the complete data determine it, or do not depend on it.
    Likelihood,
}

/// The way of each free value: from the model and, where the model does not decide, from trial steps.
pub(super) fn ways(objective: &ProfileLikelihood<'_>, iterate: &ProfilePoint) -> Result<Vec<Way>, DynamicError> {
    let levels = objective.levels(&iterate.alpha)?;
    let mut direct = objective.matrix_slots();
    direct.extend(objective.hidden_slots());
    let first = |s: usize| match levels.of(objective.slots, s) {
        _ if direct.contains(&s) => Way::Likelihood,
        // a level at zero would stay there
        Some(_) if iterate.values[s] == 0.0 => Way::Likelihood,
        Some((degree, count)) => Way::Level { degree, count },
        None => Way::Expected,
    };
    let mut ways: Vec<Way> = (0..iterate.values.len()).map(first).collect();
    if !ways.contains(&Way::Expected) {
        return Ok(ways);
    }
    let complete = objective.complete(iterate)?;
    for parameter in 0..objective.model.shared().parameters.len() {
        let own = |s: &usize| objective.slots.slots()[*s].parameter == parameter && ways[*s] == Way::Expected;
        let own: Vec<usize> = (0..iterate.values.len()).filter(own).collect();
        let moves = |sign: f64| {
            let mut values = iterate.values.clone();
            own.iter().for_each(|&s| values[s] = objective.coordinates[s].moved(values[s], sign * PROBE));
            values != iterate.values && objective.expected(&complete, &values).is_some()
        };
        if !own.is_empty() && !moves(1.0) && !moves(-1.0) {
            own.iter().for_each(|&s| ways[s] = Way::Likelihood);
        }
    }
    Ok(ways)
}

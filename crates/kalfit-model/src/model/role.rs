//! What parameters are for, found from every place in which they stand.
//!
//! A parameter that does nothing but scale noise has no sign of its own: ℓ depends on the variances, and these are even in a
//! standard deviation and at least zero where they are proportional to a variance. So such a parameter can be taken as positive
//! without loss, and so can a time constant, which cannot pass through zero.

use crate::model::{CovarianceKind, CovarianceStructure, Expression, Model, Motion, Phase, PhasedModel, Site};

mod timely;
mod variance;

use timely::Decay;
use variance::Use;

/// What a parameter is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// It stands in variances and covariances of noise only, as a scale: they depend on it through v = θ^power, and it can be taken
    /// as positive.
    Scale {
        /// 2 for a standard deviation, 1 for a variance (and for what serves as both).
        power: i32,
    },
    /// It stands in the motion of states as a time constant only (-1/τ times the state itself, or exp(-dt/τ)), and in variances: it
    /// is positive.
    TimeConstant,
    /// Anything else, and what stands nowhere.
    Other,
}

/// Where an expression stands.
#[derive(Debug, Clone, Copy, PartialEq)]
enum RolePlace {
    /// A variance of noise, of a known start, or of a matrix of Σ.
    Variance,
    /// A covariance of these.
    Covariance,
    /// The derivative of a state; `own`: the coefficient of that state itself.
    Derivative { own: bool },
    /// The next value of a state.
    Next { own: bool },
    /// A coefficient, an input, a condition, a correlation.
    Elsewhere,
}

/// The role of each parameter of a model.
///
/// A parameter is a [`Role::Scale`] when it stands nowhere but in variances and covariances, in one variance at least, and
/// - every variance is even in it, built of products, quotients, powers, roots, sums and alternatives (`sigma`, `if(a, sd, 0)`,
///   `sigma * (1 + b * T)` in sigma, `sqrt(a^2 + b^2 * x)` in a and b), or it is a factor of every variance (`variance = "v"`),
///   or a variance added to what is known or even (`variance = "v + tau2"`);
/// - where it stands in covariances, it is a factor of these and of the variances: `rho * sd0 * sd1`. What covariance two positive
///   standard deviations can give is then for the others there to say, such as a rho that may take either sign. In
///   `l1 * l2` beside the variances `l1^2 + u1` they are loadings, whose signs mean something: not scales.
///
/// Terms of a sum that may be negative (`a + b * T`) and functions such as exp make it [`Role::Other`].
pub fn roles(model: &PhasedModel) -> Vec<Role> {
    roles_among(model, model.shared().parameters.len())
}

/// As [`roles`], of a model that need not have its parameters yet.
pub(crate) fn roles_among(model: &PhasedModel, parameters: usize) -> Vec<Role> {
    let mut occurrences = vec![Vec::new(); parameters];
    let mut note = |place, expression| {
        let inside = Expression::parameters(expression);
        inside.into_iter().for_each(|parameter| occurrences[parameter].push((place, expression)));
    };
    model.phases.iter().for_each(|phase| each_expression(phase, &mut note));
    model.levels.iter().for_each(|level| each_of_level(&level.covariance, &mut note));
    occurrences.iter().enumerate().map(|(parameter, places)| role(parameter, places)).collect()
}

fn role(parameter: usize, occurrences: &[(RolePlace, &Expression)]) -> Role {
    match scale(parameter, occurrences) {
        Some(power) => Role::Scale { power },
        None if is_time_constant(parameter, occurrences) => Role::TimeConstant,
        None => Role::Other,
    }
}

/// k, where the parameter scales noise as v = θ^k.
fn scale(parameter: usize, occurrences: &[(RolePlace, &Expression)]) -> Option<i32> {
    let paired = occurrences.iter().any(|(place, _)| *place == RolePlace::Covariance);
    let mut power = None;
    for (place, expression) in occurrences {
        if paired && expression.exponents(parameter).is_none() {
            return None;
        }
        match (place, expression.use_as_variance(parameter)) {
            (RolePlace::Variance, Use::Deviation) => power = power.or(Some(2)),
            (RolePlace::Variance, Use::Variance) => power = Some(1),
            (RolePlace::Covariance, _) => {}
            _ => return None,
        }
    }
    power
}

/// Every motion that it stands in decays with it, one at least by itself.
fn is_time_constant(parameter: usize, occurrences: &[(RolePlace, &Expression)]) -> bool {
    let mut decays = false;
    for (place, expression) in occurrences {
        let (found, own) = match place {
            RolePlace::Variance | RolePlace::Covariance => {
                let scaled = expression.exponents(parameter).is_some();
                (if scaled { Decay::None } else { expression.decay(parameter) }, false)
            }
            RolePlace::Derivative { own } => (expression.rate(parameter), *own),
            RolePlace::Next { own } => (expression.decay(parameter), *own),
            RolePlace::Elsewhere => return false,
        };
        match found {
            Decay::Other => return false,
            Decay::Falling => decays |= own,
            Decay::None => {}
        }
    }
    decays
}

/// Every expression of a phase and where it stands.
fn each_expression<'m>(phase: &'m Phase, visit: &mut dyn FnMut(RolePlace, &'m Expression)) {
    let model = &phase.model;
    for (site, expression) in model.expressions() {
        visit(place(model, site), expression);
    }
    phase.carries().for_each(|expression| visit(RolePlace::Elsewhere, expression));
}

fn place(model: &Model, site: Site) -> RolePlace {
    let moved = |state: usize, own: bool| match model.states[state].motion {
        Motion::Discrete { .. } => RolePlace::Next { own },
        _ => RolePlace::Derivative { own },
    };
    match site {
        Site::Rate { state, from } => moved(state, state == from),
        Site::Input(state) => moved(state, false),
        Site::ProcessNoise(_) | Site::InitialVariance(_) | Site::Noise(_) => RolePlace::Variance,
        Site::ProcessCovariance | Site::NoiseCovariance => RolePlace::Covariance,
        Site::KnownCovariance { diagonal } => of_matrix(diagonal),
        Site::Structure { diagonal } => of_structure(&model.covariance.kind, diagonal),
        _ => RolePlace::Elsewhere,
    }
}

fn of_matrix(diagonal: bool) -> RolePlace {
    if diagonal { RolePlace::Variance } else { RolePlace::Covariance }
}

fn of_structure(kind: &CovarianceKind, diagonal: bool) -> RolePlace {
    if matches!(kind, CovarianceKind::Correlation(_)) { RolePlace::Elsewhere } else { of_matrix(diagonal) }
}

/// Every expression of the matrix of a level.
fn each_of_level<'m>(covariance: &'m CovarianceStructure, visit: &mut dyn FnMut(RolePlace, &'m Expression)) {
    for (site, expression) in covariance.kind.expressions() {
        let diagonal = site == Site::Structure { diagonal: true };
        visit(of_structure(&covariance.kind, diagonal), expression);
    }
}

#[cfg(test)]
mod tests;

//! Roles of parameters, derived from every expression in which they occur.
//!
//! The sign of a parameter that only scales noise does not matter: ℓ depends on the variances, which are even functions
//! of a standard deviation and proportional to a variance, which is never negative. So such a parameter can be taken as
//! positive without loss, and so can a time constant, which cannot pass through zero.

use crate::model::{
    CovarianceKind, CovarianceStructure, Expression, Function, Model, Motion, Operator, Phase, PhasedModel, Site,
};

mod timely;
mod variance;

use timely::Decay;
use variance::Use;

/// Role of a parameter in a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A scale of noise: the parameter θ occurs only in variances and covariances, as v = θ^power, and can be taken as
    /// positive.
    Scale {
        /// 2 for a standard deviation, 1 for a variance (and for a parameter that serves as both).
        power: i32,
    },
    /// A time constant τ > 0: in the motion of states the parameter occurs only as -1/τ times the moving state or as
    /// exp(-dt/τ), elsewhere only in variances.
    TimeConstant,
    /// Any other role, including the role of a parameter that occurs nowhere.
    Other,
}

/// Kind of position in which an expression occurs.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SiteKind {
    /// A variance of noise, of a known start, or of a matrix of Σ.
    Variance,
    /// A covariance of noises, of known starts, or in a matrix of Σ.
    Covariance,
    /// The derivative of a state; the flag is true in the coefficient of the state that moves.
    Derivative { on_itself: bool },
    /// The next value of a state; the flag is true in the coefficient of the state that moves.
    Next { on_itself: bool },
    /// Any other position: a coefficient, an input, a condition, a correlation.
    Elsewhere,
}

/// The role of each parameter of a model.
///
/// A parameter is a [`Role::Scale`] when it occurs only in variances and covariances, in at least one variance, and
/// - every variance is an even function of the parameter, built of products, quotients, powers, roots, sums and
///   alternatives (standard deviations `sigma`, `if(a, sd, 0)`, `sigma * (1 + b * T)` for sigma, `sqrt(a^2 + b^2 * x)`
///   for a and b); or the parameter is a factor of every variance (`variance = "v"`), or a variance added to terms that
///   are known or even (`variance = "v + tau2"`);
/// - where the parameter occurs in covariances, the parameter is a factor of all covariances and variances with the
///   parameter, and no covariance changes its sign with a standard deviation alone: `rho * sd0 * sd1`. The sign of the covariance
///   is then the sign of the other factors, such as a rho of either sign. In `l1 * l2` together with the variances
///   `l1^2 + u1` the parameters are loadings, whose signs matter, and not scales; nor is theta in `theta * s^2`.
///
/// Parameters in terms of a sum that may be negative (`a + b * T`) or in functions such as exp have [`Role::Other`].
pub fn roles(model: &PhasedModel) -> Vec<Role> {
    roles_among(model, model.shared().parameters.len())
}

/// The role of each of `parameters` parameters, as in [`roles`], for a model whose list of parameters may still be
/// empty.
pub(crate) fn roles_among(model: &PhasedModel, parameters: usize) -> Vec<Role> {
    let mut occurrences = vec![Vec::new(); parameters];
    let mut record_site = |site_kind, expression| {
        let inside = Expression::parameters(expression);
        inside.into_iter().for_each(|parameter| occurrences[parameter].push((site_kind, expression)));
    };
    model.phases.iter().for_each(|phase| each_expression(phase, &mut record_site));
    model.levels.iter().for_each(|level| each_level_expression(&level.covariance, &mut record_site));
    occurrences.iter().enumerate().map(|(parameter, places)| role(parameter, places)).collect()
}

fn role(parameter: usize, occurrences: &[(SiteKind, &Expression)]) -> Role {
    match scale(parameter, occurrences) {
        Some(power) => Role::Scale { power },
        None if is_time_constant(parameter, occurrences) => Role::TimeConstant,
        None => Role::Other,
    }
}

/// k, if the parameter scales noise as v = θ^k.
fn scale(parameter: usize, occurrences: &[(SiteKind, &Expression)]) -> Option<i32> {
    let paired = occurrences.iter().any(|(site_kind, _)| *site_kind == SiteKind::Covariance);
    let (mut power, mut signed) = (None, false);
    for (site_kind, expression) in occurrences {
        if paired && expression.exponents(parameter).is_none() {
            return None;
        }
        match (site_kind, expression.use_as_variance(parameter)) {
            (SiteKind::Variance, Use::Deviation) => power = power.or(Some(2)),
            (SiteKind::Variance, Use::Variance) => power = Some(1),
            (SiteKind::Covariance, _) => signed |= expression.has_sign_of(parameter),
            _ => return None,
        }
    }
    // a variance has no sign either way
    power.filter(|power| !(signed && *power == 2))
}

impl Expression {
    /// Whether the expression changes its sign with the parameter, and with no other parameter.
    fn has_sign_of(&self, parameter: usize) -> bool {
        let others = self.parameters();
        self.is_odd(parameter) && !others.into_iter().any(|other| other != parameter && self.is_odd(other))
    }

    /// Whether the expression, a product that may have alternatives, changes its sign with the parameter.
    fn is_odd(&self, parameter: usize) -> bool {
        let of = |part: &Expression| part.is_odd(parameter);
        match self {
            Expression::Parameter(index) => *index == parameter,
            Expression::Negate(a) => of(a),
            Expression::Binary(Operator::Multiply | Operator::Divide, a, b) => of(a) != of(b),
            Expression::Binary(Operator::Power, a, n) => {
                n.as_number().is_some_and(|n| n.rem_euclid(2.0) == 1.0) && of(a)
            }
            Expression::Binary(Operator::Add | Operator::Subtract, a, b) | Expression::If(_, a, b) => of(a) || of(b),
            Expression::Call(Function::Min | Function::Max, arguments) => arguments.iter().any(&of),
            _ => false,
        }
    }
}

/// Whether the parameter is a decay wherever it occurs in motion, and at least once in the coefficient of the state
/// that moves.
fn is_time_constant(parameter: usize, occurrences: &[(SiteKind, &Expression)]) -> bool {
    let mut decays = false;
    for (site_kind, expression) in occurrences {
        let (dependence, on_itself) = match site_kind {
            SiteKind::Variance | SiteKind::Covariance => {
                let scaled = expression.exponents(parameter).is_some();
                (if scaled { Decay::None } else { expression.decay(parameter) }, false)
            }
            SiteKind::Derivative { on_itself } => (expression.rate(parameter), *on_itself),
            SiteKind::Next { on_itself } => (expression.decay(parameter), *on_itself),
            SiteKind::Elsewhere => return false,
        };
        match dependence {
            Decay::Other => return false,
            Decay::Falling => decays |= on_itself,
            Decay::None => {}
        }
    }
    decays
}

/// Visits every expression of a phase, with the kind of position of the expression.
fn each_expression<'m>(phase: &'m Phase, visit: &mut dyn FnMut(SiteKind, &'m Expression)) {
    let model = &phase.model;
    for (site, expression) in model.expressions() {
        visit(site_kind(model, site), expression);
    }
    phase.inherited_expressions().for_each(|expression| visit(SiteKind::Elsewhere, expression));
}

fn site_kind(model: &Model, site: Site) -> SiteKind {
    let moved = |state: usize, on_itself: bool| match model.states[state].motion {
        Motion::Discrete { .. } => SiteKind::Next { on_itself },
        _ => SiteKind::Derivative { on_itself },
    };
    match site {
        Site::Rate { state, from } => moved(state, state == from),
        Site::Input(state) => moved(state, false),
        Site::ProcessNoise(_) | Site::InitialVariance(_) | Site::Noise(_) => SiteKind::Variance,
        Site::ProcessCovariance | Site::NoiseCovariance => SiteKind::Covariance,
        Site::KnownCovariance { diagonal } => matrix_site_kind(diagonal),
        Site::Structure { diagonal } => structure_site_kind(&model.covariance.kind, diagonal),
        _ => SiteKind::Elsewhere,
    }
}

fn matrix_site_kind(diagonal: bool) -> SiteKind {
    if diagonal { SiteKind::Variance } else { SiteKind::Covariance }
}

fn structure_site_kind(kind: &CovarianceKind, diagonal: bool) -> SiteKind {
    if matches!(kind, CovarianceKind::Correlation(_)) { SiteKind::Elsewhere } else { matrix_site_kind(diagonal) }
}

/// Visits every expression of the covariance matrix of a level of groups, with the kind of position.
fn each_level_expression<'m>(covariance: &'m CovarianceStructure, visit: &mut dyn FnMut(SiteKind, &'m Expression)) {
    for (site, expression) in covariance.kind.expressions() {
        let diagonal = site == Site::Structure { diagonal: true };
        visit(structure_site_kind(&covariance.kind, diagonal), expression);
    }
}

#[cfg(test)]
mod tests;

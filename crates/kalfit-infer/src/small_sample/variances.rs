//! Which free parameters are variances of noise, in which the covariance of the data is linear.

use std::collections::{BTreeMap, BTreeSet};

use kalfit_model::{Expression, Operator, PhasedModel, Site};

/// The free values that are parameters θ, with their coordinates.
#[derive(Debug, Clone)]
pub(crate) struct Variances {
    /// Indices of the free values.
    pub(crate) slots: Vec<usize>,
    /// Whether θ are variances, in which the covariance of the data is linear; else θ are the coordinates of the search.
    pub(crate) linear: bool,
    /// dθ/dcoordinate of each, and d²θ/dcoordinate² over it; 1 and 0 where θ are the coordinates.
    pub(crate) by_coordinate: Vec<[f64; 2]>,
    /// dvalue/dθ of each, with the value as users know it.
    pub(crate) value_by_theta: Vec<f64>,
    /// The value of each, as users know it, and its power that is a variance; zero where θ is no variance.
    pub(crate) values: Vec<[f64; 2]>,
}

/// For each parameter in `moving` the exponent k: all covariances of noise are linear in the θ^k together. `None` where
/// they are not, or where a parameter occurs elsewhere in the model.
pub(super) fn exponents(model: &PhasedModel, moving: &BTreeSet<usize>) -> Option<BTreeMap<usize, f64>> {
    let mut found = BTreeMap::new();
    let phases = model.phases.iter().flat_map(|phase| phase.model.expressions());
    let levels = model.levels.iter().flat_map(|level| level.covariance.kind.expressions());
    for (site, expression) in phases.chain(levels) {
        if expression.parameters().is_disjoint(moving) {
            continue;
        }
        if !matches!(
            site,
            Site::Noise(_) | Site::ProcessNoise(_) | Site::InitialVariance(_) | Site::KnownCovariance { .. }
        ) {
            return None;
        }
        for term in sums(expression, moving)?.into_iter().flatten() {
            let mut powers = term.into_iter().filter(|(_, power)| *power != 0.0);
            let Some((parameter, power)) = powers.next() else { continue };
            if powers.next().is_some() || *found.entry(parameter).or_insert(power) != power {
                return None;
            }
        }
    }
    (found.len() == moving.len() && found.values().all(|power| *power > 0.0)).then_some(found)
}

/// Powers of the moving parameters in a product.
type Term = BTreeMap<usize, f64>;
/// The terms of a sum.
type Sum = Vec<Term>;

/// Most values of conditions in one expression, taken together.
const MOST_ALTERNATIVES: usize = 256;

/// The sums of products of powers of the moving parameters, each times a factor without them, that the expression may be,
/// one for each choice of its conditions; `None` for any other form.
fn sums(expression: &Expression, moving: &BTreeSet<usize>) -> Option<Vec<Sum>> {
    if expression.parameters().is_disjoint(moving) {
        let is_zero = expression.as_number() == Some(0.0);
        return Some(vec![if is_zero { Sum::new() } else { vec![Term::new()] }]);
    }
    let of = |part: &Expression| sums(part, moving);
    let is_known = |part: &Expression| part.parameters().is_disjoint(moving);
    match expression {
        Expression::Parameter(index) => Some(vec![vec![Term::from([(*index, 1.0)])]]),
        Expression::Negate(a) => of(a),
        Expression::Binary(Operator::Add | Operator::Subtract, a, b) => {
            pairs(&of(a)?, &of(b)?, &|one, other| [one, other].concat())
        }
        Expression::Binary(Operator::Multiply, a, b) if a == b => of(a)?.iter().map(|sum| power(sum, 2.0)).collect(),
        Expression::Binary(Operator::Multiply, a, b) => pairs(&of(a)?, &of(b)?, &|one, other| {
            one.iter().flat_map(|a| other.iter().map(|b| product(a, b))).collect()
        }),
        Expression::Binary(Operator::Divide, a, b) if is_known(b) => of(a),
        Expression::Binary(Operator::Power, a, n) => {
            let n = n.as_number()?;
            of(a)?.iter().map(|sum| power(sum, n)).collect()
        }
        Expression::If(condition, a, b) if is_known(condition) => {
            let all = [of(a)?, of(b)?].concat();
            (all.len() <= MOST_ALTERNATIVES).then_some(all)
        }
        _ => None,
    }
}

/// Both of two expressions, for each pair of choices.
fn pairs(a: &[Sum], b: &[Sum], both: &dyn Fn(&[Term], &[Term]) -> Sum) -> Option<Vec<Sum>> {
    let few = a.len() * b.len() <= MOST_ALTERNATIVES;
    few.then(|| a.iter().flat_map(|one| b.iter().map(|other| both(one, other))).collect())
}

/// The power of a single term; `None` of a sum.
fn power(sum: &[Term], n: f64) -> Option<Sum> {
    match sum {
        [] => Some(Sum::new()),
        [single] => Some(vec![single.iter().map(|(&parameter, power)| (parameter, power * n)).collect()]),
        _ => None,
    }
}

fn product(a: &Term, b: &Term) -> Term {
    let mut all = a.clone();
    b.iter().for_each(|(&parameter, power)| *all.entry(parameter).or_insert(0.0) += power);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::build::{Noise, constant, free, measurement, name, variance, when};

    /// The exponents in a model with one measurement of this noise.
    fn of(noise: impl Into<Noise>) -> Option<BTreeMap<usize, f64>> {
        let model = kalfit_model::Model::builder("")
            .state(constant("a"))
            .measurement(measurement("y", "a", noise))
            .parameter(free("s"))
            .parameter(free("t"));
        exponents(&model.build().expect("a model"), &BTreeSet::from([0, 1]))
    }

    #[test]
    fn variances_are_told_from_other_parameters() {
        let square = |a: &str| name(a) * name(a);
        assert_eq!(of(variance(square("s") + name("t") * 3.0)), Some(BTreeMap::from([(0, 2.0), (1, 1.0)])));
        assert_eq!(of(variance(name("s") + name("t") * name("s"))), None, "a product of two is not linear");
        assert_eq!(of(variance(name("s") + square("s") + name("t"))), None, "two powers of one are not linear");
        let either = when(name("x").equals(1.0), name("s"), name("t"));
        assert_eq!(of(variance(either.power(2.0) * 3.0)), Some(BTreeMap::from([(0, 2.0), (1, 2.0)])));
        assert_eq!(of(variance(name("s") * name("s") / (name("t") + 1.0))), None, "a quotient is not linear");
    }
}

//! Covariances of noises, sought within the cone of positive semidefinite matrices.
//!
//! A parameter c that occurs only as a factor of one covariance, f c, is bounded by the edge e = √(V_i V_j)/|f|, the
//! least over all rows. So t = c/e is sought between -1 and 1: every t is feasible, whatever the variances, and the
//! edge is a bound like any other.
//!
//! A known covariance c bounds the variances of the two noises from below, V_i ≥ c²/V_j: a lower bound of the noise
//! level.
//!
//! ```text
//! c = t e(α)      ∂ℓ/∂t = e ∂ℓ/∂c      ∂ℓ/∂α at fixed t = ∂ℓ/∂α + t ∂ℓ/∂c ∂e/∂α
//! ```

use crate::Coordinate;
use crate::covariances::ValueCovariances;
use kalfit_filter::score::{Gradient, add};
use kalfit_model::{Alpha, Expression, Model, Operator, PhasedModel, Scope, Site, Slots, Tape};
use kalfit_model::{Evidence, PhasedTest};
use kalfit_model::{Label, Test};

/// Maximal number of rows with different cells over which an edge is computed.
const MOST_ROWS: usize = 4096;
/// Relative margin between a covariance and the edge, because of rounding.
const EDGE_MARGIN: f64 = 1e-9;
/// Part of the edge at which a start beyond the edge is placed.
const START_PART: f64 = 0.95;

/// All covariances of noises that are sought relative to the edge.
#[derive(Debug, Clone, Default)]
pub struct CorrelationBounds(Vec<CorrelationBound>);

/// A covariance of noises that is sought relative to a bound, the edge.
#[derive(Debug, Clone)]
struct CorrelationBound {
    slot: usize,
    variances: [Expression; 2],
    /// The factor f of the parameter c.
    factor: Expression,
    rows: Vec<(Vec<f64>, Vec<Label>)>,
}

/// The edge e, and the derivatives of e by the other values of α.
struct BoundValue {
    slot: usize,
    edge: f64,
    slopes: Gradient,
}

impl CorrelationBounds {
    /// The free covariances of a model without given bounds, whose parameter occurs in no other expression.
    pub(crate) fn of(model: &PhasedModel, slots: &Slots, tests: &[PhasedTest]) -> CorrelationBounds {
        let parameters = &model.shared().parameters;
        let open = |&p: &usize| {
            let parameter = &parameters[p];
            slots.common(p).is_some() && !parameter.positive && parameter.lower.is_none() && parameter.upper.is_none()
        };
        CorrelationBounds(
            (0..parameters.len()).filter(open).filter_map(|p| CorrelationBound::of(model, slots, tests, p)).collect(),
        )
    }

    /// Bounds the coordinate of each covariance by -1 and 1.
    pub(crate) fn bound(&self, coordinates: &mut [Coordinate]) {
        for edge in &self.0 {
            (coordinates[edge.slot].lower, coordinates[edge.slot].upper) = (-1.0, 1.0);
        }
    }

    /// Slots of levels whose variance a known covariance bounds from below, with the least value of the level.
    pub(crate) fn least(model: &PhasedModel, slots: &Slots, tests: &[PhasedTest]) -> Vec<(usize, f64)> {
        let alpha = slots.alpha(model.shared(), &vec![1.0; slots.len()]);
        let mut least: std::collections::BTreeMap<usize, f64> = Default::default();
        for (at, phase) in model.phases.iter().enumerate() {
            for entry in noise_pairs(&phase.model) {
                let evidence = || tests.iter().filter_map(|test| test.phases.get(at));
                for (own, other) in [(0, 1), (1, 0)] {
                    let (own, other) = (entry.variances[own], entry.variances[other]);
                    for (slot, value) in known(own, (other, entry.covariance), (model, slots), &alpha, evidence()) {
                        let most = least.entry(slot).or_insert(0.0);
                        *most = most.max(value);
                    }
                }
            }
        }
        least.into_iter().filter(|(_, value)| *value > 0.0).collect()
    }

    /// Whether a slot is a covariance that is sought relative to the edge.
    pub fn has(&self, slot: usize) -> bool {
        self.0.iter().any(|edge| edge.slot == slot)
    }

    /// The values of α at the given sought values.
    pub(crate) fn values(&self, sought: &[f64], alpha: &Alpha) -> Vec<f64> {
        let mut values = sought.to_vec();
        for edge in &self.0 {
            values[edge.slot] = sought[edge.slot] * edge.least(alpha).map_or(0.0, |(least, _)| least);
        }
        values
    }

    /// The sought values at the given values of α; a covariance beyond the edge becomes [`START_PART`] times the edge.
    pub(crate) fn sought(&self, values: &[f64], alpha: &Alpha) -> Vec<f64> {
        let mut sought = values.to_vec();
        for edge in &self.0 {
            let part =
                edge.least(alpha).filter(|(least, _)| *least > 0.0).map_or(0.0, |(least, _)| values[edge.slot] / least);
            sought[edge.slot] = if part.abs() > 1.0 { START_PART * part.signum() } else { part };
        }
        sought
    }

    /// Slots of the bounded covariances of noises of which one variance depends on a parameter.
    pub(crate) fn beside(&self, parameter: usize) -> Vec<usize> {
        let of =
            |edge: &&CorrelationBound| edge.variances.iter().any(|variance| variance.exponent(parameter) != Some(0.0));
        self.0.iter().filter(of).map(|edge| edge.slot).collect()
    }

    /// Converts derivatives by the values of α to derivatives by the sought values.
    pub(crate) fn pull(&self, sought: &[f64], alpha: &Alpha, slots: &Slots, scores: &mut [Gradient]) {
        for at in self.0.iter().map(|edge| edge.at(alpha, slots)) {
            for score in scores.iter_mut() {
                let Ok(place) = score.binary_search_by_key(&at.slot, |(slot, _)| *slot) else { continue };
                let bar = score[place].1;
                score[place].1 = bar * at.edge;
                let through = |&(slot, slope): &(usize, f64)| (slot, bar * sought[at.slot] * slope);
                add(score, &at.slopes.iter().map(through).collect());
            }
        }
    }

    /// Converts variances of the sought values to variances of the values of α.
    pub fn spread(
        &self,
        (sought, alpha): (&[f64], &Alpha),
        (slots, coordinates): (&Slots, &[Coordinate]),
        values: &[f64],
        covariances: &mut ValueCovariances,
    ) {
        for at in self.0.iter().map(|edge| edge.at(alpha, slots)) {
            let mut weights = vec![0.0; covariances.shared.len()];
            for (weight, &s) in weights.iter_mut().zip(&covariances.shared) {
                let own = if s == at.slot { at.edge } else { 0.0 };
                let through = at.slopes.iter().filter(|(slot, _)| *slot == s).map(|(_, slope)| slope).sum::<f64>();
                *weight = own + sought[at.slot] * through * coordinates[s].slope(values[s]);
            }
            let variance: f64 = weights
                .iter()
                .enumerate()
                .flat_map(|(i, a)| weights.iter().enumerate().map(move |(k, b)| (i, k, a * b)))
                .map(|(i, k, weight)| weight * covariances.whole[(i, k)])
                .sum();
            covariances.alpha[at.slot] = covariances.alpha[at.slot].and(Some(variance)).filter(|v| *v > 0.0);
        }
    }
}

impl CorrelationBound {
    fn of(model: &PhasedModel, slots: &Slots, tests: &[PhasedTest], parameter: usize) -> Option<CorrelationBound> {
        let depends_on_parameter = |expression: &Expression| expression.exponent(parameter) != Some(0.0);
        let mut found = None;
        for (at, phase) in model.phases.iter().enumerate() {
            let mut own = noise_pairs(&phase.model);
            own.retain(|entry| depends_on_parameter(entry.covariance));
            let is_covariance = |site: Site| matches!(site, Site::NoiseCovariance | Site::ProcessCovariance);
            let rest = phase.model.expressions().into_iter().filter(|(site, _)| !is_covariance(*site));
            let elsewhere =
                rest.map(|(_, expression)| expression).chain(phase.inherited_expressions()).any(depends_on_parameter);
            match &own[..] {
                _ if elsewhere => return None,
                [] => {}
                [entry] if found.is_none() && is_multiple(entry.covariance, parameter) => {
                    let one = |index: usize| (index == parameter).then_some(Expression::Number(1.0));
                    let factor = entry.covariance.replaced(&one);
                    found = Some((at, entry.variances.map(Expression::clone), factor));
                }
                _ => return None,
            }
        }
        let (at, variances, factor) = found?;
        let all = [&variances[0], &variances[1], &factor];
        if all.iter().any(|e| e.any(&mut |part| matches!(part, Expression::Step))) {
            return None;
        }
        let rows = rows(&all, tests.iter().filter_map(|test| test.phases.get(at)))?;
        Some(CorrelationBound { slot: slots.common(parameter)?, variances, factor, rows })
    }

    /// The least edge over all rows, and the index of that row; `None` where no row has the covariance.
    fn least(&self, alpha: &Alpha) -> Option<(f64, usize)> {
        let edge = |row: usize| -> Option<f64> {
            let scope = self.scope(row, alpha);
            let of = |expression: &Expression| expression.evaluate(&scope).ok();
            let [a, b] = [of(&self.variances[0])?, of(&self.variances[1])?];
            let factor = of(&self.factor)?.abs();
            (factor > 0.0)
                .then(|| (1.0 - EDGE_MARGIN) * (a.max(0.0) * b.max(0.0)).sqrt() / factor)
                .filter(|e| e.is_finite())
        };
        let all = (0..self.rows.len()).filter_map(|row| Some((edge(row)?, row)));
        all.reduce(|least, other| if other.0 < least.0 { other } else { least })
    }

    fn at(&self, alpha: &Alpha, slots: &Slots) -> BoundValue {
        let none = BoundValue { slot: self.slot, edge: 0.0, slopes: Gradient::new() };
        let Some((edge, row)) = self.least(alpha).filter(|(edge, _)| *edge > 0.0) else { return none };
        let scope = self.scope(row, alpha);
        let (mut slopes, mut tape) = (Gradient::new(), Tape::default());
        for (expression, weight) in [(&self.variances[0], 0.5), (&self.variances[1], 0.5), (&self.factor, -1.0)] {
            let Ok(value) = expression.evaluate(&scope) else { return none };
            let _ = expression.differentiate(weight * edge / value, &scope, &mut tape, &mut |parameter, bar| {
                if let Some(slot) = slots.find(parameter, scope.texts).filter(|_| bar.is_finite()) {
                    add(&mut slopes, &vec![(slot, bar)]);
                }
            });
        }
        BoundValue { edge, slopes, ..none }
    }

    fn scope<'a>(&'a self, row: usize, alpha: &'a Alpha) -> Scope<'a> {
        let (numbers, texts) = &self.rows[row];
        Scope { numbers, texts, step: 0.0, alpha }
    }
}

/// (Slot of θ, least level θ with θ^k f ≥ c²/V) for each row; empty where another value than θ is free.
fn known<'a>(
    own: &Expression,
    (other, covariance): (&Expression, &Expression),
    (model, slots): (&PhasedModel, &Slots),
    alpha: &Alpha,
    evidence: impl Iterator<Item = &'a Evidence>,
) -> Vec<(usize, f64)> {
    let free = |expression: &Expression| -> Vec<usize> {
        let parameters = 0..model.shared().parameters.len();
        parameters.filter(|&p| slots.is_free(p) && expression.exponent(p) != Some(0.0)).collect()
    };
    let ([parameter], true) = (&free(own)[..], free(other).is_empty() && free(covariance).is_empty()) else {
        return Vec::new();
    };
    let Some(exponent) = own.exponent(*parameter).filter(|k| *k > 0.0) else { return Vec::new() };
    let all = [own, other, covariance];
    if all.iter().any(|e| e.any(&mut |part| matches!(part, Expression::Step))) {
        return Vec::new();
    }
    let one = |(numbers, texts): (Vec<f64>, Vec<Label>)| -> Option<(usize, f64)> {
        let scope = Scope { numbers: &numbers, texts: &texts, step: 0.0, alpha };
        // with the level at 1, the variance is the factor f of the level's power
        let [factor, variance, covariance] =
            [own.evaluate(&scope), other.evaluate(&scope), covariance.evaluate(&scope)];
        let least = covariance.ok()?.powi(2) / (variance.ok()? * factor.ok()?);
        let slot = slots.find(*parameter, &texts)?;
        least.is_finite().then(|| (slot, (1.0 + EDGE_MARGIN) * least.powf(exponent.recip())))
    };
    rows(&all, evidence).unwrap_or_default().into_iter().filter_map(one).collect()
}

/// Covariance and variances of two noises.
struct NoisePair<'a> {
    covariance: &'a Expression,
    variances: [&'a Expression; 2],
}

fn noise_pairs(model: &Model) -> Vec<NoisePair<'_>> {
    let noise = |state: usize| model.states[state].motion.noise_variance();
    let measured = model.noise_covariance.iter().map(|(i, j, covariance)| {
        let of = |m: &usize| &model.measurements[*m].noise_variance;
        Some(NoisePair { covariance, variances: [of(i), of(j)] })
    });
    let moved = model
        .process_noise_covariance
        .iter()
        .map(|(i, j, covariance)| Some(NoisePair { covariance, variances: [noise(*i)?, noise(*j)?] }));
    measured.chain(moved).flatten().collect()
}

/// Whether a covariance is c times an expression without c, for either sign of c.
fn is_multiple(covariance: &Expression, c: usize) -> bool {
    let is_one_sided = |part: &Expression| match part {
        Expression::Call(_, arguments) => arguments.iter().any(|argument| argument.mentions(c)),
        Expression::Binary(Operator::Power, base, _) => base.mentions(c),
        _ => false,
    };
    covariance.exponent(c) == Some(1.0) && !covariance.any(&mut |part| is_one_sided(part))
}

/// The rows of tests, as (numbers, texts), without repetitions; numbers that no expression reads are zero. `None` where
/// there are more than [`MOST_ROWS`] rows.
fn rows<'a>(
    expressions: &[&Expression],
    evidence: impl Iterator<Item = &'a Evidence>,
) -> Option<Vec<(Vec<f64>, Vec<Label>)>> {
    let reads = |column: usize| {
        let own = &mut |part: &Expression| matches!(part, Expression::Column(c) if *c == column);
        expressions.iter().any(|expression| expression.any(own))
    };
    let tests = evidence.filter_map(|evidence| if let Evidence::Rows(test) = evidence { Some(test) } else { None });
    let cells = |test: &Test, row: usize| {
        let number = |(column, x): (usize, &f64)| if reads(column) { *x } else { 0.0 };
        (test.numbers(row).iter().enumerate().map(number).collect::<Vec<f64>>(), test.texts(row).to_vec())
    };
    let mut all: std::collections::BTreeMap<(Vec<u64>, Vec<Label>), Vec<f64>> = Default::default();
    for test in tests {
        for row in 0..test.rows() {
            let (numbers, texts) = cells(test, row);
            all.entry((numbers.iter().map(|x| x.to_bits()).collect(), texts)).or_insert(numbers);
            if all.len() > MOST_ROWS {
                return None;
            }
        }
    }
    Some(all.into_iter().map(|((_, texts), numbers)| (numbers, texts)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use kalfit_model::build::{Formula, constant, free, measurement, name};

    /// Two instruments with noise levels s and 2r, and a given covariance of the two noises.
    fn instruments(covariance: Formula) -> (PhasedModel, Slots, Vec<PhasedTest>) {
        let model = kalfit_model::Model::builder("")
            .state(constant("level"))
            .measurement(measurement("y", "level", "s"))
            .measurement(measurement("z", "level", 2.0 * name("r")))
            .noise_covariance("y", "z", covariance);
        let model: PhasedModel =
            ["s", "r", "c"].into_iter().fold(model, |model, name| model.parameter(free(name))).build().unwrap();
        let mut test = Test::new("one", model.shared().columns.len(), 0);
        test.push(&vec![1.0; model.shared().columns.len()], &[], kalfit_model::Source::default());
        let tests: Vec<PhasedTest> = vec![test.into()];
        let slots = Slots::in_phases(&model, &kalfit_model::Labels::default(), &tests);
        (model, slots, tests)
    }

    #[test]
    fn a_covariance_is_a_part_of_what_it_may_be_and_so_are_its_slopes() {
        let (model, slots, tests) = instruments(3.0 * name("c"));
        let edges = CorrelationBounds::of(&model, &slots, &tests);
        assert!(edges.has(2) && !edges.has(0));
        let alpha = |values: &[f64]| slots.alpha(model.shared(), values);
        let sought = [0.5, 0.3, 0.8];
        let values = |sought: &[f64]| edges.values(sought, &alpha(sought));
        // √(s² (2r)²)/3
        assert!((values(&sought)[2] - 0.8 * 0.5 * 0.6 / 3.0).abs() < 1e-9, "{:?}", values(&sought));
        let back = edges.sought(&values(&sought), &alpha(&values(&sought)));
        assert!((back[2] - 0.8).abs() < 1e-9, "{back:?}");
        // ℓ = 2s + 3r + 5c, against differences in the sought values
        let value = |sought: &[f64]| values(sought).iter().zip([2.0, 3.0, 5.0]).map(|(v, w)| v * w).sum::<f64>();
        let mut scores = vec![vec![(0, 2.0), (1, 3.0), (2, 5.0)]];
        edges.pull(&sought, &alpha(&sought), &slots, &mut scores);
        for (slot, slope) in &scores[0] {
            let moved = |h: f64| {
                let mut moved = sought;
                moved[*slot] += h;
                value(&moved)
            };
            let quotient = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - quotient).abs() < 1e-8, "slot {slot}: {slope}, difference quotient {quotient}");
        }
    }

    #[test]
    fn what_stands_elsewhere_too_is_no_part_of_an_edge() {
        let one_sided = (name("c") * name("s")).max(name("c") * 2.0);
        let size = (name("c") * name("c")).power(0.5);
        for covariance in [name("c") * name("c"), name("c") + 0.1, name("c") * name("s"), one_sided, size] {
            let (model, slots, tests) = instruments(covariance.clone());
            let sought = CorrelationBounds::of(&model, &slots, &tests);
            let is_factor = covariance == name("c") * name("s");
            assert_eq!(sought.has(2), is_factor, "{covariance:?}");
        }
    }

    #[test]
    fn a_known_covariance_bounds_the_level_beside_it() {
        for (sought, known) in [("y", "z"), ("z", "y")] {
            let noise = |of: &str| if of == sought { name("s") } else { Formula::from(0.5) };
            let model = kalfit_model::Model::builder("")
                .state(constant("level"))
                .measurement(measurement("y", "level", noise("y")))
                .measurement(measurement("z", "level", noise("z")))
                .noise_covariance(sought, known, 0.2)
                .parameter(free("s"));
            let model: PhasedModel = model.build().unwrap();
            let mut test = Test::new("one", model.shared().columns.len(), 0);
            test.push(&vec![1.0; model.shared().columns.len()], &[], kalfit_model::Source::default());
            let tests: Vec<PhasedTest> = vec![test.into()];
            let slots = Slots::in_phases(&model, &kalfit_model::Labels::default(), &tests);
            let least = CorrelationBounds::least(&model, &slots, &tests);
            // s 0.5 ≥ 0.2
            assert!(least.len() == 1 && least[0].0 == 0 && (least[0].1 - 0.4).abs() < 1e-8, "{sought}: {least:?}");
        }
    }
}
